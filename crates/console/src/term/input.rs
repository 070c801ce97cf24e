//! Keys, pastes, sizes, mouse and signals, read by threads of their own.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use std::{io, thread};

use crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers, MouseButton, MouseEventKind};
use signal_hook::consts::signal::{SIGCONT, SIGTSTP};
use signal_hook::iterator::{Handle, Signals};
use signal_hook::low_level;
use zeroize::Zeroizing;

use super::encode;
use super::output::THREAD_PREFIX;
use super::secret;
use super::signals::{ENDING, Handled};
use crate::app::{Action, Key};

/// Interval of checks for the end: each costs CPU on an idle console, and nobody waits for this thread.
const PATIENCE: Duration = Duration::from_secs(5);
/// Pause after a failed read.
const REST: Duration = Duration::from_millis(200);

pub fn start(stop: Arc<AtomicBool>, typed: impl Fn(Action) + Send + 'static) -> io::Result<thread::JoinHandle<()>> {
    let read = move || {
        while !stop.load(Ordering::Relaxed) {
            match next() {
                Ok(heard) => {
                    for action in heard {
                        typed(action);
                    }
                }
                // The watchdog finds out whether the terminal is gone.
                Err(_) => thread::sleep(REST),
            }
        }
    };
    thread::Builder::new().name(format!("{THREAD_PREFIX}input")).spawn(read)
}

fn next() -> io::Result<Vec<Action>> {
    if event::poll(PATIENCE)? { event::read().map(actions) } else { Ok(Vec::new()) }
}

fn actions(event: Event) -> Vec<Action> {
    match event {
        Event::Key(key) if key.kind != KeyEventKind::Release => keys(key).into_iter().map(Action::Key).collect(),
        Event::Paste(text) => vec![Action::Paste(Zeroizing::new(text))],
        Event::Mouse(mouse) => match mouse.kind {
            MouseEventKind::ScrollUp => vec![Action::Wheel { up: true }],
            MouseEventKind::ScrollDown => vec![Action::Wheel { up: false }],
            MouseEventKind::Down(MouseButton::Left) => vec![Action::Click { column: mouse.column, row: mouse.row }],
            _ => Vec::new(),
        },
        Event::Resize(columns, rows) => {
            let (columns, rows) = encode::known((columns, rows), |name| std::env::var(name).ok());
            vec![Action::Resize { columns, rows }]
        }
        _ => Vec::new(),
    }
}

/// Escape and a key close together arrive as Alt and that key: split again.
fn keys(event: KeyEvent) -> Vec<Key> {
    let control = event.modifiers.contains(KeyModifiers::CONTROL);
    let alt = event.modifiers.contains(KeyModifiers::ALT);
    let key = match event.code {
        KeyCode::Char(character) if control => Key::Control(character.to_ascii_lowercase()),
        KeyCode::Char(character) => Key::Char(character),
        KeyCode::Enter => Key::Enter,
        KeyCode::Esc => Key::Escape,
        KeyCode::Tab => Key::Tab,
        KeyCode::BackTab => Key::BackTab,
        KeyCode::Backspace => Key::Backspace,
        KeyCode::Delete => Key::Delete,
        KeyCode::Up => Key::Up,
        KeyCode::Down => Key::Down,
        KeyCode::Left => Key::Left,
        KeyCode::Right => Key::Right,
        KeyCode::PageUp => Key::PageUp,
        KeyCode::PageDown => Key::PageDown,
        KeyCode::Home => Key::Home,
        KeyCode::End => Key::End,
        _ => return Vec::new(),
    };
    if alt { vec![Key::Escape, key] } else { vec![key] }
}

#[derive(Debug)]
pub struct Listener {
    handle: Handle,
    _handled: Handled,
}

impl Listener {
    pub fn start(heard: impl Fn(i32) + Send + 'static) -> io::Result<Self> {
        let mut signals = Signals::new(ENDING.into_iter().chain([SIGTSTP, SIGCONT]))?;
        let handle = signals.handle();
        let wait = move || signals.forever().for_each(heard);
        thread::Builder::new().name(format!("{THREAD_PREFIX}signals")).spawn(wait)?;
        Ok(Self { handle, _handled: Handled::begin() })
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        self.handle.close();
        // Otherwise the closed handler would swallow the signal.
        drop(secret::keep_default());
    }
}

pub fn stop_here() -> io::Result<()> {
    low_level::emulate_default_handler(SIGTSTP)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pressed(code: KeyCode, modifiers: KeyModifiers) -> Vec<Key> {
        keys(KeyEvent::new(code, modifiers))
    }

    #[test]
    fn keys_in_our_words() {
        assert_eq!(pressed(KeyCode::Char('G'), KeyModifiers::SHIFT), [Key::Char('G')]);
        assert_eq!(pressed(KeyCode::Char('c'), KeyModifiers::CONTROL), [Key::Control('c')]);
        assert_eq!(pressed(KeyCode::Char('q'), KeyModifiers::ALT), [Key::Escape, Key::Char('q')]);
        assert_eq!(pressed(KeyCode::F(5), KeyModifiers::NONE), []);
    }
}

//! Questions for secrets. What is typed is not shown, not even between two questions, and the terminal is as it was
//! when they are over, also if a signal ends the process.

use std::fs::{File, OpenOptions};
use std::io::{self, IsTerminal as _, Read as _, Write as _};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;

use rustix::termios::{InputModes, LocalModes, OptionalActions, SpecialCodeIndex, Termios, tcgetattr, tcsetattr};
use signal_hook::consts::signal::SIGCONT;
use signal_hook::iterator::Signals;
use signal_hook::low_level;
use zeroize::Zeroizing;

use super::output::patiently;
use super::signals::{ENDING, Handled};

/// The longest line that a terminal delivers, bytes.
const LONGEST: usize = 4096;
/// Ctrl-C.
const CANCEL: u8 = 3;

struct Modes {
    terminal: File,
    before: Termios,
    hidden: Termios,
}

/// Set while there are questions.
static ASKING: Mutex<Option<Modes>> = Mutex::new(None);

fn asking() -> MutexGuard<'static, Option<Modes>> {
    ASKING.lock().unwrap_or_else(PoisonError::into_inner)
}

fn set(terminal: &File, modes: &Termios) -> io::Result<()> {
    // What was typed in between is nobody's answer, and the shell must not run it.
    patiently(|| Ok(tcsetattr(terminal, OptionalActions::Flush, modes)?))
}

/// The terminal without its echo, until dropped.
pub struct Hidden(File);

impl Hidden {
    /// `None` if standard input is no terminal. What was typed before is dropped.
    pub fn begin() -> io::Result<Option<Self>> {
        if !io::stdin().is_terminal() {
            return Ok(None);
        }
        let Ok(terminal) = OpenOptions::new().read(true).write(true).open("/dev/tty") else { return Ok(None) };
        keep_default()?;
        let before = tcgetattr(&terminal)?;
        let hidden = without_echo(before.clone());
        *asking() = Some(Modes { terminal: terminal.try_clone()?, before, hidden: hidden.clone() });
        let begun = Self(terminal);
        set(&begun.0, &hidden)?;
        Ok(Some(begun))
    }

    /// `None` if the answer is Ctrl-C, Ctrl-D or nothing. An answer that was typed ahead counts.
    pub fn ask(&mut self, question: &str) -> io::Result<Option<Zeroizing<String>>> {
        write!(self.0, "{question}: ")?;
        let mut bytes = Zeroizing::new([0_u8; LONGEST]);
        let count = loop {
            match self.0.read(bytes.as_mut_slice()) {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                count => break count?,
            }
        };
        let line = bytes.get(..count).unwrap_or_default();
        let Some(line) = line.strip_suffix(b"\n").filter(|line| !line.contains(&CANCEL)) else {
            writeln!(self.0)?;
            return Ok(None);
        };
        let text = std::str::from_utf8(line).map_err(|_| io::Error::other("what was typed is not UTF-8"))?;
        Ok(Some(Zeroizing::new(text.to_owned())).filter(|text| !text.is_empty()))
    }
}

impl Drop for Hidden {
    fn drop(&mut self) {
        end();
    }
}

/// Ctrl-C is read, and ends a line as enter does; no key ends or stops the process. The rest is for a terminal that
/// another program left in an odd state.
fn without_echo(mut modes: Termios) -> Termios {
    modes.local_modes.remove(LocalModes::ECHO | LocalModes::ISIG);
    modes.local_modes.insert(LocalModes::ECHONL | LocalModes::ICANON);
    modes.input_modes.remove(InputModes::IGNCR | InputModes::INLCR);
    modes.input_modes.insert(InputModes::ICRNL);
    modes.special_codes[SpecialCodeIndex::VEOL] = CANCEL;
    modes
}

/// Gives the terminal its echo back; `false` if there was no question.
fn end() -> bool {
    let Some(Modes { terminal, before, .. }) = asking().take() else { return false };
    // A terminal that fails now cannot be helped.
    drop(set(&terminal, &before));
    true
}

/// After a stop: the shell has set modes of its own meanwhile.
fn hide_again() {
    if let Some(Modes { terminal, hidden, .. }) = &*asking() {
        // If the terminal is gone, the question ends.
        tcsetattr(terminal, OptionalActions::Now, hidden).ok();
    }
}

/// From now on a signal that nobody handles ends the process, and the terminal has its echo back. A program that has
/// listened to a signal once never gets the system's own action back, so a thread repeats that action.
pub fn keep_default() -> io::Result<()> {
    static STARTED: Mutex<bool> = Mutex::new(false);
    let mut started = STARTED.lock().unwrap_or_else(PoisonError::into_inner);
    if !*started {
        let mut signals = Signals::new(ENDING.into_iter().chain([SIGCONT]))?;
        thread::Builder::new().name("signals".to_owned()).spawn(move || signals.forever().for_each(received))?;
        *started = true;
    }
    Ok(())
}

fn received(signal: i32) {
    if signal == SIGCONT {
        hide_again();
    } else if end() || !Handled::by_anybody() {
        // It fails only for signals that do not end a process.
        drop(low_level::emulate_default_handler(signal));
    }
}

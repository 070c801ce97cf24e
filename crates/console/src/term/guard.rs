//! Raw mode and alternate screen, and the way back: on quit, on a signal, on a panic.

use std::io::{self, IsTerminal, Write};
use std::panic::{self, PanicHookInfo};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread;

use crossterm::terminal::{disable_raw_mode, enable_raw_mode};

/// Alternate screen, no cursor, bracketed paste.
const ENTER: &str = "\x1b[?1049h\x1b[?25l\x1b[?2004h\x1b[2J";
/// The way back, also from a half-drawn frame and with the mouse taken.
const LEAVE: &str = "\x1b[?2026l\x1b[m\x1b[?1006l\x1b[?1000l\x1b[?2004l\x1b[?25h\x1b[?1049l";
/// Buttons and wheel are sent to the console, in cells.
pub const TAKE_MOUSE: &str = "\x1b[?1000h\x1b[?1006h";
/// The terminal has the mouse for itself again.
pub const LEAVE_MOUSE: &str = "\x1b[?1006l\x1b[?1000l";
/// The prefix of the console's thread names.
pub const THREAD_PREFIX: &str = "console-";

static ENTERED: AtomicBool = AtomicBool::new(false);
/// Removes our pictures before the screen is given back.
static TAKE_PICTURES: OnceLock<&'static str> = OnceLock::new();

type Hook = Box<dyn Fn(&PanicHookInfo<'_>) + Send + Sync + 'static>;

/// Holds the terminal in the console's modes; restores it when dropped.
#[derive(Debug)]
pub struct Guard {
    _private: (),
}

impl Guard {
    /// Takes the terminal; when it is given back, `take_pictures` is written first. A panic of the console restores it
    /// before anything is printed; if the panic was not in the caller's thread, `broken` is called, because nothing
    /// draws or reads any more. A panic of any other thread is passed to `fault` and leaves the terminal alone.
    ///
    /// # Errors
    /// If the terminal refuses.
    pub fn enter(
        take_pictures: &'static str,
        fault: impl Fn(String) + Send + Sync + 'static,
        broken: impl Fn(String) + Send + Sync + 'static,
    ) -> io::Result<Self> {
        // One console per process: the first one counts.
        TAKE_PICTURES.get_or_init(|| take_pictures);
        take()?;
        let previous: Arc<Hook> = Arc::new(panic::take_hook());
        let console = thread::current().id();
        panic::set_hook(Box::new(move |info| {
            let thread = thread::current();
            let own = thread.name().is_some_and(|name| name.starts_with(THREAD_PREFIX));
            if own || thread.id() == console || !ENTERED.load(Ordering::SeqCst) {
                restore();
                previous(info);
                if own {
                    broken(describe(info));
                }
            } else {
                fault(describe(info));
            }
        }));
        Ok(Self { _private: () })
    }
}

impl Drop for Guard {
    fn drop(&mut self) {
        restore();
    }
}

/// Takes the terminal, at the beginning or after a suspension.
///
/// # Errors
/// If the terminal refuses.
pub fn take() -> io::Result<()> {
    if ENTERED.load(Ordering::SeqCst) {
        // The shell may have changed the modes behind our back; enabling them twice has no effect.
        patiently(disable_raw_mode)?;
    }
    patiently(enable_raw_mode)?;
    ENTERED.store(true, Ordering::SeqCst);
    write(ENTER)
}

/// In the background, changing modes stops the process, and is interrupted when it continues.
fn patiently(change: impl Fn() -> io::Result<()>) -> io::Result<()> {
    loop {
        match change() {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            result => return result,
        }
    }
}

/// Gives the terminal back, once; nothing is written to one that is gone.
pub fn restore() {
    if !ENTERED.swap(false, Ordering::SeqCst) {
        return;
    }
    if io::stdin().is_terminal() {
        // Nothing can be done about a terminal that fails now.
        drop(write(&[TAKE_PICTURES.get().copied().unwrap_or_default(), LEAVE].concat()));
        drop(disable_raw_mode());
    }
}

/// The terminal is gone or stuck: write nothing to it any more.
pub fn abandon() {
    if ENTERED.swap(false, Ordering::SeqCst) && io::stdin().is_terminal() {
        drop(disable_raw_mode());
    }
}

/// Writes to the terminal, bypassing our buffers.
///
/// # Errors
/// If the terminal is gone.
pub fn write(bytes: &str) -> io::Result<()> {
    let mut out = io::stdout().lock();
    out.write_all(bytes.as_bytes())?;
    out.flush()
}

fn describe(info: &PanicHookInfo<'_>) -> String {
    let place = info.location().map(|at| format!("{}:{}", at.file(), at.line())).unwrap_or_default();
    let thread = thread::current();
    let payload = info.payload();
    let text = payload.downcast_ref::<&str>().copied();
    let text = text.or_else(|| payload.downcast_ref::<String>().map(String::as_str)).unwrap_or("no reason given");
    format!("{} failed at {place}: {text}", thread.name().unwrap_or("a background task"))
}

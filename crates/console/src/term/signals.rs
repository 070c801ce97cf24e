//! Signals become events; afterwards they end the process again as usual.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::{io, thread};

use signal_hook::consts::signal::{SIGCONT, SIGHUP, SIGINT, SIGQUIT, SIGTERM, SIGTSTP};
use signal_hook::iterator::{Handle, Signals};
use signal_hook::{flag, low_level};

use super::guard::THREAD_PREFIX;

/// Signals that end the console.
const ENDING: [i32; 4] = [SIGTERM, SIGHUP, SIGINT, SIGQUIT];

/// Whether a signal asks for a suspension.
pub fn suspends(signal: i32) -> bool {
    signal == SIGTSTP
}

/// Whether a signal says that this process was stopped from outside and runs again.
pub fn continues(signal: i32) -> bool {
    signal == SIGCONT
}

/// Whether a signal says that the terminal hung up.
pub fn hangs_up(signal: i32) -> bool {
    signal == SIGHUP
}

/// Whether a signal ends the console.
pub fn ends(signal: i32) -> bool {
    ENDING.contains(&signal)
}

/// Listens until dropped.
#[derive(Debug)]
pub struct Listener {
    handle: Handle,
}

impl Listener {
    /// Passes every signal to `heard`, from a thread of its own.
    ///
    /// # Errors
    /// If the handlers cannot be installed.
    pub fn start(heard: impl Fn(i32) + Send + 'static) -> io::Result<Self> {
        let mut signals = Signals::new(ENDING.into_iter().chain([SIGTSTP, SIGCONT]))?;
        let handle = signals.handle();
        let wait = move || signals.forever().for_each(heard);
        thread::Builder::new().name(format!("{THREAD_PREFIX}signals")).spawn(wait)?;
        Ok(Self { handle })
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        self.handle.close();
        for signal in ENDING {
            // Without this the closed handler would swallow the signal for good.
            drop(flag::register_conditional_default(signal, Arc::new(AtomicBool::new(true))));
        }
    }
}

/// Stops this process until it is continued.
///
/// # Errors
/// If the signal cannot be raised.
pub fn stop_here() -> io::Result<()> {
    low_level::emulate_default_handler(SIGTSTP)
}

//! Signals that nobody handles. A program that has listened to a signal once never gets the system's own action back,
//! so a thread repeats that action.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::{io, thread};

use signal_hook::consts::signal::{SIGCONT, SIGHUP, SIGINT, SIGQUIT, SIGTERM, SIGTSTP};
use signal_hook::iterator::Signals;
use signal_hook::low_level;

use super::secret;

pub const ENDING: [i32; 4] = [SIGTERM, SIGHUP, SIGINT, SIGQUIT];

static HANDLERS: AtomicUsize = AtomicUsize::new(0);

/// While one exists, its owner handles the signals of [`ENDING`], and stops.
#[derive(Debug)]
pub struct Handled(());

impl Handled {
    pub fn begin() -> Self {
        HANDLERS.fetch_add(1, Ordering::SeqCst);
        Self(())
    }
}

impl Drop for Handled {
    fn drop(&mut self) {
        HANDLERS.fetch_sub(1, Ordering::SeqCst);
    }
}

/// From now on a signal that nobody handles ends or stops the process, and the terminal has its echo back.
pub fn keep_default() -> io::Result<()> {
    static STARTED: Mutex<bool> = Mutex::new(false);
    let mut started = STARTED.lock().unwrap_or_else(PoisonError::into_inner);
    if !*started {
        let mut signals = Signals::new(ENDING.into_iter().chain([SIGTSTP, SIGCONT]))?;
        thread::Builder::new().name("signals".to_owned()).spawn(move || signals.forever().for_each(received))?;
        *started = true;
    }
    Ok(())
}

fn received(signal: i32) {
    let is_ours = match signal {
        SIGCONT => return secret::ask_again(),
        SIGTSTP => secret::pause(),
        _ => secret::end(),
    };
    if is_ours || HANDLERS.load(Ordering::SeqCst) == 0 {
        // It fails only for signals that do nothing.
        drop(low_level::emulate_default_handler(signal));
    }
}

//! The signals that end a program, and whether anybody handles them.

use std::sync::atomic::{AtomicUsize, Ordering};

use signal_hook::consts::signal::{SIGHUP, SIGINT, SIGQUIT, SIGTERM};

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

    pub fn by_anybody() -> bool {
        HANDLERS.load(Ordering::SeqCst) > 0
    }
}

impl Drop for Handled {
    fn drop(&mut self) {
        HANDLERS.fetch_sub(1, Ordering::SeqCst);
    }
}

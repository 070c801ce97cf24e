//! Whether the terminal shows what is typed: not while a passphrase is. Whatever ends the line
//! mode, dropping this brings it back.

use rustix::stdio::stdin;
use rustix::termios::{LocalModes, OptionalActions, tcgetattr, tcsetattr};

/// The terminal's echo.
#[derive(Debug)]
pub struct Echo {
    shown: bool,
}

impl Echo {
    /// As the terminal has it.
    pub fn new() -> Self {
        Self { shown: true }
    }

    /// Shows what is typed.
    pub fn on(&mut self) {
        self.set(true);
    }

    /// Shows what is typed, or not; a pipe has no echo, and a terminal that fails is watched elsewhere.
    pub fn set(&mut self, shown: bool) {
        if self.shown == shown {
            return;
        }
        self.shown = shown;
        if let Ok(mut modes) = tcgetattr(stdin()) {
            modes.local_modes.set(LocalModes::ECHO, shown);
            // The newline that ends a secret is still shown.
            modes.local_modes.set(LocalModes::ECHONL, !shown);
            let _ = tcsetattr(stdin(), OptionalActions::Now, &modes);
        }
    }
}

impl Drop for Echo {
    fn drop(&mut self) {
        self.on();
    }
}

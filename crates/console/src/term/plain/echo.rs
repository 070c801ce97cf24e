//! Whether the terminal shows what is typed: not while a passphrase is. Dropping this restores it, however the line
//! mode ends.

use rustix::stdio::stdin;
use rustix::termios::{LocalModes, OptionalActions, tcgetattr, tcsetattr};

/// The terminal's echo.
#[derive(Debug)]
pub struct Echo {
    shown: bool,
}

impl Echo {
    /// The terminal's present setting.
    pub fn new() -> Self {
        Self { shown: true }
    }

    /// Shows what is typed.
    pub fn on(&mut self) {
        self.set(true);
    }

    /// Shows what is typed, or not; a pipe has no echo, and a failing terminal is noticed elsewhere.
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

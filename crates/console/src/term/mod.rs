//! The only module that knows the terminal: guard, signals, keys, renderer, colours, clipboard.
//!
//! [`run`] is the console: one thread reads keys, one waits for signals, one owns the screen and draws only the newest
//! frame, and the caller's thread feeds `app::update`. It restores the terminal however it ends. What is shown is
//! decided in `app` and `ui`.

pub mod ask;
pub mod backend;
pub mod encode;
pub mod files;
pub mod guard;
pub mod host;
pub mod input;
pub mod pixels;
pub mod renderer;

#[cfg(test)]
mod library;
mod session;

use std::io::{self, IsTerminal};
use std::path::PathBuf;

use tokio::runtime::Handle;

use crate::app::Keymap;
use crate::app::tour::Cast;
use crate::config::Pictures;
use crate::model::{ErrorKind, ProfileName};
use crate::service::{Client, Failure};
use crate::ui::{ThemeError, Themes};

/// The console's appearance and permissions.
#[expect(clippy::struct_excessive_bools, reason = "each is a setting of its own")]
#[derive(Debug, Clone)]
pub struct ConsoleOptions {
    /// A theme's name; `None` = chosen by the terminal's colours.
    pub theme: Option<String>,
    /// The available themes.
    pub themes: Themes,
    /// Which keys do what.
    pub keymap: Keymap,
    /// Draw with ASCII characters only.
    pub ascii: bool,
    /// Take the mouse from the beginning.
    pub mouse: bool,
    /// The operator who speaks, if it is not the profile's owner.
    pub operator: Option<String>,
    /// Hide what changes keys, grants or records.
    pub read_only: bool,
    /// Bytes a second for drawing of data; `None` = 4 kB/s over SSH, else no limit.
    pub bytes_per_second: Option<u32>,
    /// How pictures are shown.
    pub pictures: Pictures,
    /// Where screen, filters and orders are kept for the next start.
    pub kept: PathBuf,
    /// Nanoseconds without a key after which the keyring locks; `None` = never.
    pub lock_after: Option<u64>,
    /// Ask for the passphrase of a locked keyring at the start; not if it is given in another way.
    pub asks_passphrase: bool,
    /// The profiles of the home.
    pub profiles: Vec<ProfileName>,
    /// Who is who in the tour, if the console starts with it.
    pub tour: Option<Cast>,
    /// Whether the caller can leave a site running after the console.
    pub leaves_site: bool,
}

/// Why the console ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ExitReason {
    /// The operator quit.
    Quit,
    /// The operator quit; a site continues without the console.
    LeaveSite,
    /// The site refused this console; the message is still to be shown.
    Refused(Failure),
    /// A signal asked for it.
    Signal(i32),
    /// The terminal vanished or hung up (SIGHUP); nothing may be printed.
    TerminalGone,
}

impl ExitReason {
    /// The exit code of a process that ends for this reason.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Quit | Self::LeaveSite => 0,
            Self::Refused(failure) => failure.kind.exit_code(),
            Self::Signal(number) => u8::try_from(128 + number).unwrap_or(ErrorKind::Internal.exit_code()),
            Self::TerminalGone => 129,
        }
    }
}

/// Why the console cannot run.
#[derive(Debug, thiserror::Error)]
pub enum TermError {
    /// The theme cannot be used.
    #[error(transparent)]
    Theme(#[from] ThemeError),
    /// The terminal failed at a request.
    #[error("the terminal cannot be used: {0}; try another terminal or TERM")]
    Terminal(#[from] io::Error),
    /// A part of the console itself failed.
    #[error("the console failed: {0}; what was captured is safe, start it again")]
    Fault(String),
}

impl TermError {
    /// Decides the exit code.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Theme(_) => ErrorKind::Input,
            Self::Terminal(_) | Self::Fault(_) => ErrorKind::Internal,
        }
    }
}

/// Whether there is a terminal to read keys from and to draw on.
pub fn is_interactive() -> bool {
    io::stdin().is_terminal() && io::stdout().is_terminal()
}

/// Runs the console until it ends; the first frame is drawn before `client` is asked anything.
///
/// It claims the profile itself (`OpenConsole`). The thread that reads keys may linger for some seconds afterwards, and
/// forever if the terminal is gone: the caller should end the process soon.
///
/// # Errors
/// [`TermError`] if the terminal fails.
pub fn run(client: Client, handle: &Handle, options: &ConsoleOptions) -> Result<ExitReason, TermError> {
    session::Session::open(client, handle, options)?.run()
}

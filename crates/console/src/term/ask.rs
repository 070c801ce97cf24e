//! A secret requested at the terminal, not shown while it is typed.

use std::fs::OpenOptions;
use std::io::{self, BufRead as _, BufReader, IsTerminal as _, Write as _};

use rustix::termios::{LocalModes, OptionalActions, Termios, tcgetattr, tcsetattr};
use zeroize::Zeroizing;

/// Space for a line, so that a secret's buffer is never moved.
const CAPACITY: usize = 4096;
/// The character Ctrl-C types when it sends no signal.
const CANCEL: char = '\u{3}';

/// Restores the terminal's previous modes.
struct Kept<'a>(&'a std::fs::File, Termios);

impl Drop for Kept<'_> {
    fn drop(&mut self) {
        tcsetattr(self.0, OptionalActions::Now, &self.1).ok();
    }
}

/// Asks for a secret at the terminal that controls this process; `None` if standard input is not a terminal, or the
/// answer is Ctrl-C, Ctrl-D or nothing.
///
/// # Errors
/// Errors of the terminal.
pub fn secret(question: &str) -> io::Result<Option<Zeroizing<String>>> {
    if !io::stdin().is_terminal() {
        return Ok(None);
    }
    let Ok(mut terminal) = OpenOptions::new().read(true).write(true).open("/dev/tty") else { return Ok(None) };
    let before = tcgetattr(&terminal)?;
    let mut modes = before.clone();
    // Ctrl-C is read, rather than being a signal: the terminal would be left without its echo.
    modes.local_modes.remove(LocalModes::ECHO | LocalModes::ISIG);
    modes.local_modes.insert(LocalModes::ECHONL);
    tcsetattr(&terminal, OptionalActions::Flush, &modes)?;
    write!(terminal, "{question}: ")?;
    let kept = Kept(&terminal, before);
    let mut line = Zeroizing::new(String::with_capacity(CAPACITY));
    BufReader::new(&terminal).read_line(&mut line)?;
    drop(kept);
    let typed = line.trim_end_matches(['\r', '\n']).len();
    line.truncate(typed);
    Ok(Some(line).filter(|line| !line.is_empty() && !line.contains(CANCEL)))
}

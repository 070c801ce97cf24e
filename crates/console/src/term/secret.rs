//! Questions for secrets. What is typed is not shown, not even between two questions, and the terminal is as it was
//! when they are over, also if a signal ends the process. After a stop (Ctrl-Z, or a signal) the question is asked again.

use std::fs::{File, OpenOptions};
use std::io::{self, IsTerminal as _, Read as _, Write as _};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;

use rustix::process::{Signal, getpgrp, getpid, kill_process};
use rustix::termios::{
    InputModes, LocalModes, OptionalActions, QueueSelector, SpecialCodeIndex, Termios, tcflush, tcgetattr, tcgetpgrp,
    tcsetattr,
};
use signal_hook::consts::signal::{SIGCONT, SIGTSTP};
use signal_hook::iterator::Signals;
use signal_hook::low_level;
use zeroize::Zeroizing;

use super::output::patiently;
use super::signals::{ENDING, Handled};

/// The longest line that a terminal delivers, bytes.
const LONGEST: usize = 4096;
/// Ctrl-C.
const CANCEL: u8 = 3;
/// Ctrl-Z.
const STOP: u8 = 26;

struct Modes {
    terminal: File,
    before: Termios,
    hidden: Termios,
    /// That waits for its answer.
    question: Option<String>,
}

/// Set while there are questions.
static ASKING: Mutex<Option<Modes>> = Mutex::new(None);

fn asking() -> MutexGuard<'static, Option<Modes>> {
    ASKING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Does not wait for output, which Ctrl-S may hold up forever.
fn set(terminal: &File, modes: &Termios) -> io::Result<()> {
    patiently(|| Ok(tcsetattr(terminal, OptionalActions::Now, modes)?))?;
    // What was typed in between is nobody's answer, and the shell must not run it.
    patiently(|| Ok(tcflush(terminal, QueueSelector::IFlush)?))
}

/// In the background the terminal is the shell's: to set its modes would stop this process.
fn set_in_foreground(terminal: &File, modes: &Termios) -> bool {
    // A terminal that fails now cannot be helped.
    tcgetpgrp(terminal).is_ok_and(|group| group == getpgrp()) && set(terminal, modes).is_ok()
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
        *asking() = Some(Modes { terminal: terminal.try_clone()?, before, hidden: hidden.clone(), question: None });
        let begun = Self(terminal);
        set(&begun.0, &hidden)?;
        Ok(Some(begun))
    }

    /// `None` if the answer is Ctrl-C, Ctrl-D or nothing. An answer that was typed ahead counts.
    pub fn ask(&mut self, question: &str) -> io::Result<Option<Zeroizing<String>>> {
        note(Some(question));
        write!(self.0, "{question}: ")?;
        let mut bytes = Zeroizing::new([0_u8; LONGEST]);
        let line = self.read(&mut bytes);
        note(None);
        let line = line?;
        let Some(line) = line.strip_suffix(b"\n").filter(|line| !line.contains(&CANCEL)) else {
            writeln!(self.0)?;
            return Ok(None);
        };
        let text = std::str::from_utf8(line).map_err(|_| io::Error::other("what was typed is not UTF-8"))?;
        Ok(Some(Zeroizing::new(text.to_owned())).filter(|text| !text.is_empty()))
    }

    fn read<'a>(&mut self, bytes: &'a mut Zeroizing<[u8; LONGEST]>) -> io::Result<&'a [u8]> {
        let count = loop {
            match self.0.read(bytes.as_mut_slice()) {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                // The thread for signals gives the terminal back first.
                Ok(count) if bytes.get(..count).is_some_and(|line| line.contains(&STOP)) => {
                    kill_process(getpid(), Signal::TSTP)?;
                }
                count => break count?,
            }
        };
        Ok(bytes.get(..count).unwrap_or_default())
    }
}

fn note(question: Option<&str>) {
    if let Some(modes) = &mut *asking() {
        modes.question = question.map(str::to_owned);
    }
}

impl Drop for Hidden {
    fn drop(&mut self) {
        end();
    }
}

/// Ctrl-C and Ctrl-Z are read, and end a line as enter does; no key sends a signal. The rest is for a terminal that
/// another program left in an odd state.
fn without_echo(mut modes: Termios) -> Termios {
    modes.local_modes.remove(LocalModes::ECHO | LocalModes::ISIG);
    modes.local_modes.insert(LocalModes::ECHONL | LocalModes::ICANON | LocalModes::IEXTEN);
    modes.input_modes.remove(InputModes::IGNCR | InputModes::INLCR);
    modes.input_modes.insert(InputModes::ICRNL);
    modes.special_codes[SpecialCodeIndex::VEOL] = CANCEL;
    modes.special_codes[SpecialCodeIndex::VEOL2] = STOP;
    modes
}

/// Gives the terminal its echo back; `false` if there was no question.
fn end() -> bool {
    let Some(Modes { terminal, before, .. }) = asking().take() else { return false };
    set_in_foreground(&terminal, &before);
    true
}

/// Gives the terminal its echo back until [`ask_again`]; `false` if there is no question.
fn pause() -> bool {
    let asking = asking();
    let Some(Modes { terminal, before, .. }) = &*asking else { return false };
    set_in_foreground(terminal, before);
    true
}

/// After a stop: the shell has set modes of its own meanwhile.
fn ask_again() {
    let asking = asking();
    let Some(Modes { terminal, hidden, question, .. }) = &*asking else { return };
    if set_in_foreground(terminal, hidden)
        && let Some(question) = question
    {
        // If the terminal is gone, the question ends.
        drop(write!(&*terminal, "\r{question}: "));
    }
}

/// From now on a signal that nobody handles ends or stops the process, and the terminal has its echo back. A program
/// that has listened to a signal once never gets the system's own action back, so a thread repeats that action.
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
        SIGCONT => return ask_again(),
        SIGTSTP => pause(),
        _ => end(),
    };
    if is_ours || !Handled::by_anybody() {
        // It fails only for signals that do nothing.
        drop(low_level::emulate_default_handler(signal));
    }
}

//! The console as lines, for screen readers and pipes: `console --plain`. Words in, sentences
//! out, over the same state and the same commands as the full screen; nothing is ever redrawn.

mod echo;
mod text;
mod words;

use std::collections::VecDeque;
use std::io::{self, BufRead as _, IsTerminal, Write as _};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread;
use std::time::Duration;

use tokio::runtime::Handle;
use zeroize::Zeroizing;

use self::echo::Echo;
use self::words::Meaning;
use super::guard::THREAD_PREFIX;
use super::outside::{Heard, Outside, sender};
use super::signals::{self, Listener};
use super::{ConsoleOptions, ExitReason, TermError, clipboard};
use crate::app::feed::Feed;
use crate::app::popup::Popup;
use crate::app::update::{start, under_way};
use crate::app::{Action, Effect, State, update};
use crate::model::{Timestamp, clean_lines};
use crate::service::{Client, NoticeLevel};
use crate::ui::Theme;

/// How often the terminal is checked.
const WATCH_EVERY: Duration = Duration::from_secs(1);
/// The widest line, characters.
const WIDEST: usize = 2_000;

/// One run of the line mode.
pub struct Plain {
    outside: Outside,
    state: State,
    theme: Theme,
    ears: Receiver<Heard>,
    lines: VecDeque<Zeroizing<String>>,
    over: bool,
    typed: bool,
    echo: Echo,
    show: bool,
    said: Said,
    _signals: Listener,
}

/// What was said last, so that it is not repeated.
#[derive(Default)]
struct Said {
    work: Option<String>,
    popup: Option<String>,
}

/// Runs the line mode until it is left.
///
/// # Errors
/// [`TermError`] if signals or threads cannot be had.
pub fn run(client: Client, handle: &Handle, options: &ConsoleOptions) -> Result<ExitReason, TermError> {
    let (mouth, ears) = channel();
    let directory = super::directory(options)?;
    let mut state = super::first_state(&client, options, &directory);
    // A form would take the first command for the passphrase; the status says that it is locked.
    state.settings.asks_passphrase = false;
    state.size = (text::COLUMNS, text::ROWS);
    let signals = Listener::start(sender(&mouth, Heard::Signal))?;
    read_lines(sender(&mouth, |line| line))?;
    let outside = Outside { client, handle: handle.clone(), mouth, directory };
    outside.listen();
    let typed = io::stdin().is_terminal();
    let plain = Plain {
        outside,
        state,
        theme: options.themes.named("mono")?,
        ears,
        lines: VecDeque::new(),
        over: false,
        typed,
        echo: Echo::new(),
        show: true,
        said: Said::default(),
        _signals: signals,
    };
    plain.run()
}

fn read_lines(heard: impl Fn(Heard) + Send + 'static) -> io::Result<()> {
    let read = move || {
        let mut input = io::stdin().lock();
        loop {
            let mut line = Zeroizing::new(String::new());
            match input.read_line(&mut line) {
                Ok(1..) => heard(Heard::Line(Zeroizing::new(line.trim_end_matches(['\r', '\n']).to_owned()))),
                Ok(0) | Err(_) => return heard(Heard::NoMoreLines),
            }
        }
    };
    thread::Builder::new().name(format!("{THREAD_PREFIX}lines")).spawn(read).map(drop)
}

type Ended = Option<Result<ExitReason, TermError>>;

impl Plain {
    fn run(mut self) -> Result<ExitReason, TermError> {
        self.say("AuthROS line mode. Type help for the commands, quit to leave.");
        let effects = start(&mut self.state);
        let mut ended = self.carry_out(effects);
        while ended.is_none() {
            let heard = self.ears.recv_timeout(self.patience());
            ended = match heard {
                Ok(heard) => self.hear(heard),
                Err(RecvTimeoutError::Timeout) => self.act(Action::Tick(Timestamp::now())),
                Err(RecvTimeoutError::Disconnected) => Some(Ok(ExitReason::Quit)),
            };
            ended = ended.or_else(|| self.speak_and_listen());
        }
        self.echo.on();
        ended.unwrap_or(Ok(ExitReason::Quit))
    }

    fn patience(&self) -> Duration {
        let due = self.state.deadline().map(|at| Duration::from_nanos(at.0.saturating_sub(Timestamp::now().0)));
        due.map_or(WATCH_EVERY, |due| due.min(WATCH_EVERY))
    }

    fn hear(&mut self, heard: Heard) -> Ended {
        match heard {
            Heard::Act(action) => self.act(action),
            Heard::Line(line) => {
                self.lines.push_back(line);
                None
            }
            Heard::NoMoreLines if self.typed && !io::stdin().is_terminal() => Some(Ok(ExitReason::TerminalGone)),
            Heard::NoMoreLines => {
                self.over = true;
                None
            }
            Heard::Signal(signal) if signals::hangs_up(signal) => Some(Ok(ExitReason::TerminalGone)),
            Heard::Signal(signal) if signals::ends(signal) => Some(Ok(ExitReason::Signal(signal))),
            Heard::Signal(signal) if signals::suspends(signal) => self.suspend(),
            Heard::Signal(_) => None,
            Heard::TerminalFailed => Some(Ok(ExitReason::TerminalGone)),
            Heard::Broken(what) => Some(Err(TermError::Fault(what))),
        }
    }

    fn suspend(&mut self) -> Ended {
        self.echo.on();
        match signals::stop_here() {
            Ok(()) => self.act(Action::Resumed),
            Err(error) => Some(Err(error.into())),
        }
    }

    fn act(&mut self, action: Action) -> Ended {
        let mut effects = update(&mut self.state, Action::Tick(Timestamp::now()));
        effects.extend(update(&mut self.state, action));
        self.carry_out(effects)
    }

    fn carry_out(&mut self, effects: Vec<Effect>) -> Ended {
        for effect in effects {
            match effect {
                Effect::Send(command, tag) => self.outside.ask(command, tag),
                Effect::Quit => return Some(Ok(ExitReason::Quit)),
                Effect::LeaveSite => return Some(Ok(ExitReason::LeaveSite)),
                Effect::Leave(failure) => return Some(Ok(ExitReason::Refused(failure))),
                Effect::Suspend => return self.suspend(),
                Effect::Redraw => self.show = true,
                Effect::CopyText(text) if io::stdout().is_terminal() => self.put(&clipboard::sequence(&text)),
                Effect::CopyText(_) => {
                    self.say("Output is not a terminal, so nothing was copied; the text is on the next line.")
                }
                Effect::WriteFiles { base, directory, files } => self.outside.write(base, directory, files),
                Effect::FindPaths(sought) => self.outside.find(sought),
                Effect::ReadText(path) => self.outside.read(path),
                Effect::SpeakFor(profile) => self.outside.speak_for(profile),
                Effect::ShowTheme(_) | Effect::ToggleAscii | Effect::Mouse(_) => {
                    self.say("Line mode has neither colours nor a mouse.");
                }
            }
        }
        None
    }

    /// Typed lines are handled at once; those of a pipe wait until the previous one is done and reported.
    fn speak_and_listen(&mut self) -> Ended {
        loop {
            self.speak();
            let ready = self.typed || self.is_idle() && !(self.show && self.state.popups.is_empty());
            let Some(line) = self.lines.pop_front_if(|_| ready) else {
                return (self.over && ready).then_some(Ok(ExitReason::Quit));
            };
            let before = self.state.screen;
            let ended = self.take(&line);
            self.show |= self.state.screen != before;
            if ended.is_some() {
                self.speak();
                return ended;
            }
        }
    }

    fn is_idle(&self) -> bool {
        let feeds = self.state.screen.feeds().iter().all(|feed| !self.state.awaits(*feed));
        let identity = self.is_answered(Feed::Identity) && !self.state.feeds.slot(Feed::Robots).outstanding;
        self.state.work.is_empty() && self.state.reading.is_none() && identity && (feeds || !self.exists())
    }

    /// Whether a first answer came, success or failure.
    fn is_answered(&self, feed: Feed) -> bool {
        !self.state.awaits(feed)
    }

    fn exists(&self) -> bool {
        self.state.identity.as_ref().is_some_and(|identity| identity.exists)
    }

    fn take(&mut self, line: &str) -> Ended {
        match words::meaning(&self.state, line) {
            Meaning::Actions(actions) => actions.into_iter().find_map(|action| self.act(action)),
            Meaning::Show => {
                self.show = true;
                None
            }
            Meaning::Status => {
                let status = text::status(&self.state);
                self.say(&status);
                None
            }
            Meaning::Help => {
                text::help(&self.state).iter().for_each(|line| self.say(line));
                None
            }
            Meaning::Row(place) => {
                let keys = self.state.row_keys();
                if let Some(table) = self.state.table_mut() {
                    table.select(&keys, place);
                }
                let name = keys.get(place).cloned().unwrap_or_default();
                self.say(&format!("Row {} selected: {name}", place + 1));
                None
            }
            Meaning::Unknown(why) => {
                self.say(&why);
                None
            }
        }
    }

    /// Says what is new: messages, running commands, popups, the screen if it was asked for.
    fn speak(&mut self) {
        self.echo.set(!words::is_secret(&self.state));
        while let Some(toast) = self.state.toasts.shown().cloned() {
            let word = match toast.level {
                NoticeLevel::Info => "Note",
                NoticeLevel::Warning => "Warning",
                NoticeLevel::Error => "Error",
            };
            self.say(&format!("{word}: {}", toast.text));
            self.state.toasts.dismiss();
        }
        let work = under_way(&self.state);
        if work != self.said.work {
            if let Some(work) = &work {
                self.say(&format!("Working: {work}."));
            }
            self.said.work = work;
        }
        self.speak_popup();
        let arrived = self.is_idle() || self.state.screen.feeds().iter().all(|feed| !self.state.awaits(*feed));
        if self.show && self.state.popups.is_empty() && arrived && self.is_answered(Feed::Site) {
            self.show = false;
            let status = text::status(&self.state);
            self.say(&status);
            text::screen(&self.state, &self.theme).iter().for_each(|line| self.say(line));
        }
    }

    fn speak_popup(&mut self) {
        let now = self.state.popups.last().map(|popup| self.mark(popup));
        if now == self.said.popup {
            return;
        }
        let lines = match self.state.popups.last() {
            None => Vec::new(),
            Some(Popup::Form(_, form)) => {
                let mut lines = Vec::new();
                if form.focus == 0 && form.error.is_none() {
                    lines.push(format!("{}. 'esc' alone cancels.", form.title));
                    lines.extend(form.notes.iter().cloned());
                }
                lines.extend(form.error.iter().map(|error| format!("Error: {error}")));
                lines.push(text::question(form));
                lines
            }
            Some(popup) => {
                let mut lines = text::popup(&self.state, &self.theme, popup);
                lines.push(format!("Commands: {}.", words::words(&self.state, popup)));
                lines
            }
        };
        self.said.popup = now;
        lines.iter().for_each(|line| self.say(line));
    }

    fn say(&mut self, text: &str) {
        self.put(&format!("{}\n", clean_lines(text, WIDEST)));
    }

    fn put(&mut self, bytes: &str) {
        let mut out = io::stdout().lock();
        if out.write_all(bytes.as_bytes()).and_then(|()| out.flush()).is_err() {
            // A reader that has gone wants no more.
            drop(self.outside.mouth.send(Heard::TerminalFailed));
        }
    }

    /// What makes a popup worth saying again: a new one, another line of a form, an answer. What changes continuously
    /// is said once.
    fn mark(&self, popup: &Popup) -> String {
        let depth = self.state.popups.len();
        match popup {
            Popup::Form(purpose, form) => format!("{depth} {purpose:?} {} {:?}", form.focus, form.error),
            Popup::Provenance(lookup) => format!("{depth} provenance {} {}", lookup.id, lookup.answer.is_some()),
            Popup::Record(opening) => {
                format!("{depth} record {} {}", opening.lookup.id, opening.lookup.answer.is_some())
            }
            Popup::Quit(leaving) => format!("{depth} quit {leaving:?}"),
            Popup::Tasks | Popup::Confirm(_) => format!("{depth} {:?}", std::mem::discriminant(popup)),
            other => format!("{depth} {}", text::popup(&self.state, &self.theme, other).join(" ")),
        }
    }
}

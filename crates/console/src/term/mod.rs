//! The only module that knows the terminal: guard, signals, keys, renderer, colours, clipboard.
//! One thread reads keys, one waits for signals, one draws the newest frame; the caller's feeds `app::update`.

pub mod encode;
pub mod files;
pub mod input;
mod output;
pub mod pixels;
pub mod renderer;
pub mod secret;
pub mod signals;

use std::io::{self, IsTerminal};
use std::panic::{self, PanicHookInfo};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, MutexGuard, OnceLock, PoisonError, TryLockError};
use std::thread;
use std::time::{Duration, Instant};

use crate::app::kept::{kept, recall};
use crate::app::update::{start, update};
use crate::app::{Action, Effect, Settings, State, Tag};
use crate::config::Pictures;
use crate::model::{ErrorKind, ProfileName, Timestamp, Zone};
use crate::service::client::site_gone;
use crate::service::{Client, Command, Failure};
use crate::ui::{Theme, ThemeError, Themes};
use crossterm::terminal::{disable_raw_mode, enable_raw_mode};
use encode::Depth;
use input::Listener;
use output::{THREAD_PREFIX, patiently, write};
use pixels::Pixels;
use renderer::{Budget, OVER_SSH, Painter, Stage, Wish};
use signal_hook::consts::signal::{SIGCONT, SIGHUP, SIGTSTP};
use tokio::runtime::Handle;
use tokio::sync::broadcast::error::RecvError;

#[derive(Debug, Clone)]
pub struct ConsoleOptions {
    /// [`Session::open`] fills in the process, directories, time zone and theme names.
    pub settings: Settings,
    /// `None` = by the terminal's colours.
    pub theme: Option<String>,
    pub themes: Themes,
    pub ascii: bool,
    /// Take the mouse at the start.
    pub mouse: bool,
    /// For drawing of data; `None` = 4 kB/s over SSH, else no limit.
    pub bytes_per_second: Option<u32>,
    pub pictures: Pictures,
    /// File of screen, filters and orders for the next start.
    pub kept: PathBuf,
    /// A warning to begin with.
    pub warning: Option<String>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ExitReason {
    Quit,
    /// A site is to continue after the console.
    LeaveSite,
    /// The site's message, still to be shown.
    Refused(Failure),
    Signal(i32),
    /// The terminal vanished or hung up (SIGHUP): nothing may be printed.
    TerminalGone,
}

impl ExitReason {
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Quit | Self::LeaveSite => 0,
            Self::Refused(failure) => failure.kind.exit_code(),
            Self::Signal(number) => u8::try_from(128 + number).unwrap_or(ErrorKind::Internal.exit_code()),
            Self::TerminalGone => 129,
        }
    }
}

#[derive(Debug, thiserror::Error)]
pub enum TermError {
    #[error(transparent)]
    Theme(#[from] ThemeError),
    #[error("the terminal cannot be used: {0}; try another terminal or TERM")]
    Terminal(#[from] io::Error),
    #[error("the console failed: {0}; what was captured is safe, start it again")]
    Fault(String),
}

impl TermError {
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Theme(_) => ErrorKind::Input,
            Self::Terminal(_) | Self::Fault(_) => ErrorKind::Internal,
        }
    }
}

pub fn is_interactive() -> bool {
    io::stdin().is_terminal() && io::stdout().is_terminal()
}

/// Draws the first frame before asking `client` anything, and claims the profile (`OpenConsole`).
/// The thread that reads keys may outlive it, forever if the terminal is gone: end the process soon.
pub fn run(client: Client, handle: &Handle, options: &ConsoleOptions) -> Result<ExitReason, TermError> {
    Session::open(client, handle, options)?.run()
}

/// Interval of checks that the terminal exists.
const WATCH_EVERY: Duration = Duration::from_secs(1);
/// Pause until a new size counts as settled.
const SETTLE: Duration = Duration::from_millis(40);
/// A frame written for longer means a stuck terminal.
const STUCK_AFTER: Duration = Duration::from_millis(1500);

pub struct Session {
    host: Host,
    stage: Arc<Stage>,
    messages: Receiver<Message>,
    stop: Arc<AtomicBool>,
    reading: Option<thread::JoinHandle<()>>,
    resized: Option<(u16, u16, Instant)>,
    watched_at: Instant,
    themes: Themes,
    mouse: bool,
    kept: PathBuf,
    profile: ProfileName,
    _guard: Guard,
    _signals: Listener,
}

impl Session {
    pub fn open(client: Client, handle: &Handle, options: &ConsoleOptions) -> Result<Self, TermError> {
        let depth = Depth::from_environment(|name| std::env::var(name).ok());
        let theme = theme(options, depth)?;
        let directory = std::env::current_dir()?;
        let mut state = first_state(options, &directory);
        state.theme.clone_from(&theme.name);
        if let Some(kept) = files::read(&options.kept) {
            recall(&mut state, &kept);
        }
        let (size, reported) = encode::size()?;
        state.size = size;
        if !reported {
            state.warn(encode::ADVICE);
        }
        if let Some(warning) = &options.warning {
            state.warn(warning.clone());
        }
        let (sending, messages) = channel();
        let signals = Listener::start(sender(&sending, Message::Signal))?;
        let guard = Guard::enter(
            pixels::taking_away(options.pictures),
            sender(&sending, |fault| Message::Act(Action::Fault(fault))),
            sender(&sending, Message::Broken),
        )?;
        let over_ssh = std::env::var_os("SSH_CONNECTION").is_some();
        let rate = options.bytes_per_second.or_else(|| over_ssh.then_some(OVER_SSH));
        let painter = Painter::new(depth, state.size).with_pixels(Pixels::new(options.pictures, rate));
        let stage = Arc::new(Stage::new(state, theme));
        let budget = Budget::new(rate, Instant::now());
        renderer::start(Arc::clone(&stage), painter, budget, sender(&sending, |_| Message::TerminalFailed))?;
        let stop = Arc::new(AtomicBool::new(false));
        let reading = Some(input::start(Arc::clone(&stop), sender(&sending, Message::Act))?);
        let session = Self {
            profile: client.profile().clone(),
            host: Host { client, handle: handle.clone(), messages: sending, directory },
            stage,
            messages,
            stop,
            reading,
            resized: None,
            watched_at: Instant::now(),
            themes: options.themes.clone(),
            mouse: options.mouse,
            kept: options.kept.clone(),
            _guard: guard,
            _signals: signals,
        };
        session.host.listen();
        if session.mouse {
            session.stage.change(Wish::Now, |scene| scene.extra.push_str(TAKE_MOUSE));
        }
        Ok(session)
    }

    pub fn run(mut self) -> Result<ExitReason, TermError> {
        let ended = self.work();
        if matches!(ended, Ok(ExitReason::LeaveSite)) {
            self.leave_the_keys();
        }
        self.close();
        ended
    }

    fn work(&mut self) -> Result<ExitReason, TermError> {
        let effects = start(&mut self.stage.scene().state);
        let mut ended = self.carry_out(effects)?;
        loop {
            if let Some(reason) = ended {
                return Ok(reason);
            }
            ended = match self.messages.recv_timeout(self.patience()) {
                Ok(message) => self.receive(message)?,
                Err(RecvTimeoutError::Timeout) => None,
                Err(RecvTimeoutError::Disconnected) => return Err(TermError::Fault("its threads ended".to_owned())),
            };
            if ended.is_none() {
                ended = self.look_around()?;
            }
        }
    }

    fn patience(&self) -> Duration {
        let deadline = self.stage.scene().state.deadline();
        let now = Timestamp::now();
        let due = deadline.map(|at| Duration::from_nanos(at.0.saturating_sub(now.0)));
        let settled = self.resized.map(|(_, _, at)| at.saturating_duration_since(Instant::now()));
        [due, settled].into_iter().flatten().fold(WATCH_EVERY, Duration::min)
    }

    fn receive(&mut self, message: Message) -> Result<Option<ExitReason>, TermError> {
        match message {
            Message::Act(Action::Resize { columns, rows }) => {
                self.resized = Some((columns, rows, Instant::now() + SETTLE));
                Ok(None)
            }
            Message::Act(action) => self.act(action),
            Message::Signal(SIGTSTP) => self.suspend(),
            // Stopped from outside, and running again.
            Message::Signal(SIGCONT) => self.retake(),
            Message::TerminalFailed if io::stdin().is_terminal() => {
                Err(TermError::Fault("the terminal no longer accepts output".to_owned()))
            }
            Message::Signal(SIGHUP) | Message::TerminalFailed => Ok(Some(ExitReason::TerminalGone)),
            Message::Signal(_) if !io::stdin().is_terminal() => Ok(Some(ExitReason::TerminalGone)),
            Message::Signal(signal) => Ok(Some(ExitReason::Signal(signal))),
            Message::Broken(what) => Err(TermError::Fault(what)),
        }
    }

    /// Checks the terminal, a settled size and the deadline.
    fn look_around(&mut self) -> Result<Option<ExitReason>, TermError> {
        if self.watched_at.elapsed() >= WATCH_EVERY {
            self.watched_at = Instant::now();
            if !io::stdin().is_terminal() {
                return Ok(Some(ExitReason::TerminalGone));
            }
        }
        if let Some((columns, rows, _)) = self.resized.take_if(|(_, _, at)| *at <= Instant::now()) {
            // Even at the old size: the terminal may have cut off its content.
            self.stage.change(Wish::None, |scene| scene.anew = true);
            return self.act(Action::Resize { columns, rows });
        }
        let deadline = self.stage.scene().state.deadline();
        if deadline.is_some_and(|at| at <= Timestamp::now()) {
            return self.act(Action::Tick(Timestamp::now()));
        }
        Ok(None)
    }

    fn act(&mut self, action: Action) -> Result<Option<ExitReason>, TermError> {
        let wish = match action {
            Action::Answered { .. } | Action::Told(_) | Action::Missed | Action::Tick(_) => Wish::Data,
            _ => Wish::Now,
        };
        let effects = self.stage.change(wish, |scene| {
            let mut effects = update(&mut scene.state, Action::Tick(Timestamp::now()));
            effects.extend(update(&mut scene.state, action));
            effects
        });
        self.carry_out(effects)
    }

    fn carry_out(&mut self, effects: Vec<Effect>) -> Result<Option<ExitReason>, TermError> {
        for effect in effects {
            match effect {
                Effect::Send(command, tag) => self.host.ask(command, tag),
                Effect::Quit => return Ok(Some(ExitReason::Quit)),
                Effect::LeaveSite => return Ok(Some(ExitReason::LeaveSite)),
                Effect::Leave(failure) => return Ok(Some(ExitReason::Refused(failure))),
                Effect::Suspend => return self.suspend(),
                Effect::Redraw => self.stage.change(Wish::Now, |scene| scene.anew = true),
                Effect::ShowTheme(name) => self.show_theme(&name),
                Effect::ToggleAscii => self.stage.change(Wish::Now, |scene| scene.theme.ascii = !scene.theme.ascii),
                Effect::Mouse(taken) => self.take_mouse(taken),
                Effect::CopyText(text) => {
                    self.stage.change(Wish::Now, |scene| scene.extra.push_str(&files::sequence(&text)));
                }
                Effect::SpeakFor(profile) => self.host.speak_for(profile),
                Effect::WriteFiles { base, directory, files } => {
                    let base = base.unwrap_or_else(|| self.host.directory.clone());
                    self.host
                        .aside(move || Action::FilesWritten(files::write_all(&base, directory.as_deref(), &files)));
                }
                Effect::FindPaths(sought) => self.host.aside(move || {
                    let found = files::find(&sought);
                    Action::PathsFound(sought, found)
                }),
                Effect::ReadText(path) => self.host.aside(move || {
                    let read = files::read_text(&path);
                    Action::TextRead(path, read)
                }),
            }
        }
        Ok(None)
    }

    fn show_theme(&self, name: &str) {
        // The state's names come from here.
        let Ok(mut theme) = self.themes.named(name) else { return };
        self.stage.change(Wish::Now, |scene| {
            let old = &scene.theme;
            (theme.ascii, theme.depth, theme.pixels) = (old.ascii, old.depth, old.pixels);
            scene.theme = theme;
            drop(update(&mut scene.state, Action::ThemeIs(name.to_owned())));
        });
    }

    fn take_mouse(&mut self, taken: bool) {
        self.mouse = taken;
        let bytes = if taken { TAKE_MOUSE } else { LEAVE_MOUSE };
        self.stage.change(Wish::Now, |scene| scene.extra.push_str(bytes));
    }

    /// Gives the terminal to the shell until SIGCONT.
    fn suspend(&mut self) -> Result<Option<ExitReason>, TermError> {
        self.stage.change(Wish::None, |scene| scene.suspended = true);
        {
            let _writing = self.stage.output.lock().unwrap_or_else(PoisonError::into_inner);
            restore();
            input::stop_here()?;
        }
        self.stage.change(Wish::None, |scene| scene.suspended = false);
        match self.retake()? {
            None => self.act(Action::Resumed),
            ended => Ok(ended),
        }
    }

    /// Takes the terminal back from other programs.
    fn retake(&mut self) -> Result<Option<ExitReason>, TermError> {
        let taken = {
            let _writing = self.stage.output.lock().unwrap_or_else(PoisonError::into_inner);
            take().and_then(|()| encode::size())
        };
        self.stage.change(Wish::Now, |scene| scene.anew = true);
        if self.mouse {
            self.take_mouse(true);
        }
        let ((columns, rows), _) = taken?;
        self.act(Action::Resize { columns, rows })
    }

    /// The question for the passphrase would share keys with the reading thread. The terminal is still without echo.
    fn leave_the_keys(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        // A new size wakes it without a key; otherwise it ends within its patience.
        rustix::process::kill_process(rustix::process::getpid(), rustix::process::Signal::WINCH).ok();
        if let Some(reading) = self.reading.take() {
            drop(reading.join());
        }
    }

    fn close(&self) {
        self.stop.store(true, Ordering::Relaxed);
        if *self.host.client.profile() == self.profile {
            files::write(&self.kept, &kept(&self.stage.scene().state));
        }
        self.stage.change(Wish::None, |scene| scene.over = true);
        let writing = finished(&self.stage);
        if writing.is_some() {
            restore();
        } else {
            abandon();
        }
    }
}

fn first_state(options: &ConsoleOptions, directory: &Path) -> State {
    let mut state = State::new(Settings {
        directory: directory.to_owned(),
        home: std::env::var_os("HOME").map(PathBuf::from),
        themes: options.themes.names(),
        process: std::process::id(),
        zone: Zone::system(),
        ..options.settings.clone()
    });
    (state.now, state.mouse) = (Timestamp::now(), options.mouse);
    state
}

/// Waits for the frame being written; `None` if the terminal is stuck.
fn finished(stage: &Stage) -> Option<MutexGuard<'_, ()>> {
    let patience = Instant::now() + STUCK_AFTER;
    loop {
        match stage.output.try_lock() {
            Ok(writing) => return Some(writing),
            Err(TryLockError::Poisoned(poisoned)) => return Some(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) if Instant::now() >= patience => return None,
            Err(TryLockError::WouldBlock) => thread::sleep(Duration::from_millis(5)),
        }
    }
}

fn theme(options: &ConsoleOptions, depth: Depth) -> Result<Theme, TermError> {
    let fitting = if depth == Depth::None { "mono" } else { "night" };
    let theme = options.themes.named(options.theme.as_deref().unwrap_or(fitting))?;
    let pixels = options.pictures != Pictures::HalfBlocks;
    Ok(Theme { ascii: options.ascii, depth, pixels, ..theme })
}

pub enum Message {
    Act(Action),
    Signal(i32),
    TerminalFailed,
    /// A thread of the console panicked.
    Broken(String),
}

pub struct Host {
    pub client: Client,
    pub handle: Handle,
    pub messages: Sender<Message>,
    pub directory: PathBuf,
}

impl Host {
    pub fn listen(&self) {
        let mut events = self.client.events();
        let say = sender(&self.messages, Message::Act);
        self.handle.spawn(async move {
            loop {
                match events.recv().await {
                    Ok(event) => say(Action::Told(event)),
                    Err(RecvError::Lagged(_)) => say(Action::Missed),
                    Err(RecvError::Closed) => return,
                }
            }
        });
    }

    pub fn speak_for(&mut self, profile: ProfileName) {
        self.client = self.client.for_profile(profile);
    }

    pub fn ask(&self, command: Command, tag: Tag) {
        let answer = self.client.send(command);
        let say = sender(&self.messages, Message::Act);
        self.handle.spawn(async move {
            let result = answer.await.unwrap_or_else(|_| Err(site_gone()));
            say(Action::Answered { tag, result: Box::new(result) });
        });
    }

    /// Does work that may block outside of the updating thread.
    fn aside(&self, work: impl FnOnce() -> Action + Send + 'static) {
        let say = sender(&self.messages, Message::Act);
        self.handle.spawn_blocking(move || say(work()));
    }
}

pub fn sender<T, W: Fn(T) -> Message>(messages: &Sender<Message>, wrap: W) -> impl Fn(T) + use<T, W> {
    let messages = messages.clone();
    // After the end nobody listens.
    move |thing| drop(messages.send(wrap(thing)))
}

/// Alternate screen, no cursor, bracketed paste.
const ENTER: &str = "\x1b[?1049h\x1b[?25l\x1b[?2004h\x1b[2J";
/// Also from a half-drawn frame, and with the mouse taken.
const LEAVE: &str = "\x1b[?2026l\x1b[m\x1b[?1006l\x1b[?1000l\x1b[?2004l\x1b[?25h\x1b[?1049l";
/// Buttons and wheel, in cells.
pub const TAKE_MOUSE: &str = "\x1b[?1000h\x1b[?1006h";
pub const LEAVE_MOUSE: &str = "\x1b[?1006l\x1b[?1000l";

static ENTERED: AtomicBool = AtomicBool::new(false);
/// Written before the screen is given back.
static TAKE_PICTURES: OnceLock<&'static str> = OnceLock::new();

type Hook = Box<dyn Fn(&PanicHookInfo<'_>) + Send + Sync + 'static>;

/// Restores the terminal when dropped.
#[derive(Debug)]
pub struct Guard(());

impl Guard {
    /// A panic in one of the console's threads restores the terminal before it prints, and calls `broken` unless it is
    /// the caller's; a panic elsewhere goes to `fault` and leaves the terminal alone.
    pub fn enter(
        take_pictures: &'static str,
        fault: impl Fn(String) + Send + Sync + 'static,
        broken: impl Fn(String) + Send + Sync + 'static,
    ) -> io::Result<Self> {
        // One console per process: the first counts.
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
        Ok(Self(()))
    }
}

impl Drop for Guard {
    fn drop(&mut self) {
        restore();
    }
}

pub fn take() -> io::Result<()> {
    if ENTERED.load(Ordering::SeqCst) {
        // The shell may have changed the modes; enabling them twice has no effect.
        patiently(disable_raw_mode)?;
    }
    patiently(enable_raw_mode)?;
    ENTERED.store(true, Ordering::SeqCst);
    write(ENTER)
}

/// Only once; writes nothing to a terminal that is gone.
pub fn restore() {
    if !ENTERED.swap(false, Ordering::SeqCst) {
        return;
    }
    if io::stdin().is_terminal() {
        // A terminal that fails now cannot be helped.
        drop(write(&[TAKE_PICTURES.get().copied().unwrap_or_default(), LEAVE].concat()));
        drop(disable_raw_mode());
    }
}

/// Writes nothing more to a terminal that is gone or stuck.
pub fn abandon() {
    if ENTERED.swap(false, Ordering::SeqCst) && io::stdin().is_terminal() {
        drop(disable_raw_mode());
    }
}

fn describe(info: &PanicHookInfo<'_>) -> String {
    let place = info.location().map(|at| format!("{}:{}", at.file(), at.line())).unwrap_or_default();
    let thread = thread::current();
    let payload = info.payload();
    let text = payload.downcast_ref::<&str>().copied();
    let text = text.or_else(|| payload.downcast_ref::<String>().map(String::as_str)).unwrap_or("no reason given");
    format!("{} failed at {place}: {text}", thread.name().unwrap_or("a background task"))
}

#[cfg(test)]
mod library;

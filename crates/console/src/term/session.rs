//! One run of the console: wires keys, signals, answers and events to `app::update`, and its
//! effects to the site, the terminal and the files.

use std::io::{self, IsTerminal};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Arc, MutexGuard, PoisonError, TryLockError};
use std::thread;
use std::time::{Duration, Instant};

use tokio::runtime::Handle;

use super::encode::Depth;
use super::host::{Host, Message, sender};
use super::input::{self, Listener};
use super::pixels::{self, Pixels};
use super::renderer::{self, Budget, OVER_SSH, Painter, Stage, Wish};
use super::{ConsoleOptions, ExitReason, TermError, backend, files, guard};
use crate::app::when::Zone;
use crate::app::{Action, Effect, Settings, State, update};
use crate::config::Pictures;
use crate::model::{ProfileName, Timestamp};
use crate::service::Client;
use crate::ui::{Theme, Themes};

/// How often the terminal is checked.
const WATCH_EVERY: Duration = Duration::from_secs(1);
/// How long to wait for a size to settle.
const SETTLE: Duration = Duration::from_millis(40);
/// How long a frame being written is waited for before the terminal counts as stuck.
const STUCK_AFTER: Duration = Duration::from_millis(1500);

/// One run of the console.
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
    /// The profile whose screens are remembered.
    profile: ProfileName,
    _guard: guard::Guard,
    _signals: Listener,
}

impl Session {
    /// Takes the terminal and draws the first frame.
    pub fn open(client: Client, handle: &Handle, options: &ConsoleOptions) -> Result<Self, TermError> {
        let depth = Depth::from_environment(|name| std::env::var(name).ok());
        let theme = theme(options, depth)?;
        let directory = std::env::current_dir()?;
        let mut state = first_state(&client, options, &directory);
        state.theme.clone_from(&theme.name);
        if let Some(kept) = super::files::read(&options.kept) {
            crate::app::resume::recall(&mut state, &kept);
        }
        let (size, reported) = backend::size()?;
        state.size = size;
        if !reported {
            state.warn(backend::ADVICE);
        }
        let (sending, messages) = channel();
        let signals = Listener::start(sender(&sending, Message::Signal))?;
        let guard = guard::Guard::enter(
            pixels::taking_away(options.pictures),
            sender(&sending, |fault| Message::Act(Action::Fault(fault))),
            sender(&sending, Message::Broken),
        )?;
        let rate = bytes_per_second(options);
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
            session.stage.change(Wish::Now, |scene| scene.extra.push_str(guard::TAKE_MOUSE));
        }
        Ok(session)
    }

    /// Runs until the console ends, and restores the terminal.
    pub fn run(mut self) -> Result<ExitReason, TermError> {
        let effects = crate::app::update::start(&mut self.stage.scene().state);
        let mut ended = self.carry_out(effects);
        while ended.is_none() {
            let received = self.messages.recv_timeout(self.patience());
            ended = match received {
                Ok(message) => self.receive(message),
                Err(RecvTimeoutError::Timeout) => None,
                Err(RecvTimeoutError::Disconnected) => Some(Err(TermError::Fault("its threads ended".to_owned()))),
            };
            ended = ended.or_else(|| self.look_around());
        }
        self.close();
        if matches!(ended, Some(Ok(ExitReason::LeaveSite))) {
            self.leave_the_keys();
        }
        ended.unwrap_or(Ok(ExitReason::Quit))
    }

    /// How long until the next check is due.
    fn patience(&self) -> Duration {
        let deadline = self.stage.scene().state.deadline();
        let now = Timestamp::now();
        let due = deadline.map(|at| Duration::from_nanos(at.0.saturating_sub(now.0)));
        let settled = self.resized.map(|(_, _, at)| at.saturating_duration_since(Instant::now()));
        [due, settled].into_iter().flatten().fold(WATCH_EVERY, Duration::min)
    }

    fn receive(&mut self, message: Message) -> Option<Result<ExitReason, TermError>> {
        match message {
            Message::Act(Action::Resize { columns, rows }) => {
                self.resized = Some((columns, rows, Instant::now() + SETTLE));
                None
            }
            Message::Act(action) => self.act(action),
            Message::Signal(signal) if input::ends(signal) => Some(Ok(ended_by(signal))),
            Message::Signal(signal) if input::suspends(signal) => self.suspend(),
            Message::Signal(signal) if input::continues(signal) => self.retake(),
            Message::Signal(_) => None,
            Message::TerminalFailed if io::stdin().is_terminal() => {
                Some(Err(TermError::Fault("the terminal accepts no more output".to_owned())))
            }
            Message::TerminalFailed => Some(Ok(ExitReason::TerminalGone)),
            Message::Broken(what) => Some(Err(TermError::Fault(what))),
        }
    }

    /// Is the terminal still there, has time changed anything?
    fn look_around(&mut self) -> Option<Result<ExitReason, TermError>> {
        if self.watched_at.elapsed() >= WATCH_EVERY {
            self.watched_at = Instant::now();
            if !io::stdin().is_terminal() {
                return Some(Ok(ExitReason::TerminalGone));
            }
        }
        if let Some((columns, rows, _)) = self.resized.take_if(|(_, _, at)| *at <= Instant::now()) {
            // Even if the size is the old one again: the terminal may have cut off its content.
            self.stage.change(Wish::None, |scene| scene.anew = true);
            return self.act(Action::Resize { columns, rows });
        }
        let deadline = self.stage.scene().state.deadline();
        if deadline.is_some_and(|at| at <= Timestamp::now()) {
            return self.act(Action::Tick(Timestamp::now()));
        }
        None
    }

    fn act(&mut self, action: Action) -> Option<Result<ExitReason, TermError>> {
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

    fn carry_out(&mut self, effects: Vec<Effect>) -> Option<Result<ExitReason, TermError>> {
        for effect in effects {
            match effect {
                Effect::Send(command, tag) => self.host.ask(command, tag),
                Effect::Quit => return Some(Ok(ExitReason::Quit)),
                Effect::LeaveSite => return Some(Ok(ExitReason::LeaveSite)),
                Effect::Leave(failure) => return Some(Ok(ExitReason::Refused(failure))),
                Effect::Suspend => return self.suspend(),
                Effect::Redraw => self.stage.change(Wish::Now, |scene| scene.anew = true),
                Effect::ShowTheme(name) => self.show_theme(&name),
                Effect::ToggleAscii => self.stage.change(Wish::Now, |scene| scene.theme.ascii = !scene.theme.ascii),
                Effect::Mouse(taken) => self.take_mouse(taken),
                Effect::CopyText(text) => {
                    self.stage.change(Wish::Now, |scene| scene.extra.push_str(&files::sequence(&text)));
                }
                Effect::SpeakFor(profile) => self.host.speak_for(profile),
                Effect::WriteFiles { base, directory, files } => self.host.write(base, directory, files),
                Effect::FindPaths(sought) => self.host.find(sought),
                Effect::ReadText(path) => self.host.read(path),
            }
        }
        None
    }

    fn show_theme(&self, name: &str) {
        // The names are those of the state, which come from here.
        let Ok(theme) = self.themes.named(name) else { return };
        self.stage.change(Wish::Now, |scene| {
            let now = &scene.theme;
            scene.theme = theme.with_ascii(now.ascii).with_shades(now.shades).with_pixels(now.pixels);
            drop(update(&mut scene.state, Action::ThemeIs(name.to_owned())));
        });
    }

    fn take_mouse(&mut self, taken: bool) {
        self.mouse = taken;
        let bytes = if taken { guard::TAKE_MOUSE } else { guard::LEAVE_MOUSE };
        self.stage.change(Wish::Now, |scene| scene.extra.push_str(bytes));
    }

    /// Gives the terminal to the shell until this process is continued.
    fn suspend(&mut self) -> Option<Result<ExitReason, TermError>> {
        self.stage.change(Wish::None, |scene| scene.suspended = true);
        let stopped = {
            let _writing = self.stage.output.lock().unwrap_or_else(PoisonError::into_inner);
            guard::restore();
            input::stop_here()
        };
        if let Err(error) = stopped {
            return Some(Err(error.into()));
        }
        self.stage.change(Wish::None, |scene| scene.suspended = false);
        self.retake().or_else(|| self.act(Action::Resumed))
    }

    /// Takes the terminal again after other programs had it.
    fn retake(&mut self) -> Option<Result<ExitReason, TermError>> {
        let taken = {
            let _writing = self.stage.output.lock().unwrap_or_else(PoisonError::into_inner);
            guard::take().and_then(|()| backend::size())
        };
        self.stage.change(Wish::Now, |scene| scene.anew = true);
        if self.mouse {
            self.take_mouse(true);
        }
        match taken {
            Ok(((columns, rows), _)) => self.act(Action::Resize { columns, rows }),
            Err(error) => Some(Err(error.into())),
        }
    }

    /// Waits until the thread that reads keys has ended: the next question at the terminal would share them with it.
    fn leave_the_keys(&mut self) {
        // A new size is what it wakes up for without a key; without that it ends within its patience.
        rustix::process::kill_process(rustix::process::getpid(), rustix::process::Signal::WINCH).ok();
        if let Some(reading) = self.reading.take() {
            drop(reading.join());
        }
    }

    /// Ends the threads and gives the terminal back.
    fn close(&self) {
        self.stop.store(true, Ordering::Relaxed);
        if *self.host.client.profile() == self.profile {
            super::files::write(&self.kept, &crate::app::resume::kept(&self.stage.scene().state));
        }
        self.stage.change(Wish::None, |scene| scene.over = true);
        let writing = finished(&self.stage);
        if writing.is_some() {
            guard::restore();
        } else {
            guard::abandon();
        }
    }
}

/// The state before the first answer.
fn first_state(client: &Client, options: &ConsoleOptions, directory: &Path) -> State {
    let mut state = State::new(Settings {
        profile: client.profile().clone(),
        operator: options.operator.clone(),
        read_only: options.read_only,
        directory: directory.to_owned(),
        home: std::env::var_os("HOME").map(PathBuf::from),
        keymap: options.keymap.clone(),
        themes: options.themes.names(),
        lock_after: options.lock_after,
        process: std::process::id(),
        asks_passphrase: options.asks_passphrase,
        profiles: options.profiles.clone(),
        tour: options.tour.clone(),
        leaves_site: options.leaves_site,
        zone: Zone::new(jiff::tz::TimeZone::system()),
    });
    (state.now, state.mouse) = (Timestamp::now(), options.mouse);
    state
}

/// Waits for the frame being written; `None` if the terminal takes no bytes.
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

fn ended_by(signal: i32) -> ExitReason {
    let gone = input::hangs_up(signal) || !io::stdin().is_terminal();
    if gone { ExitReason::TerminalGone } else { ExitReason::Signal(signal) }
}

fn theme(options: &ConsoleOptions, depth: Depth) -> Result<Theme, TermError> {
    let fitting = if depth == Depth::None { "mono" } else { "night" };
    let theme = options.themes.named(options.theme.as_deref().unwrap_or(fitting))?;
    let pixels = options.pictures != Pictures::HalfBlocks;
    Ok(theme.with_ascii(options.ascii).with_shades(depth.shades()).with_pixels(pixels))
}

fn bytes_per_second(options: &ConsoleOptions) -> Option<u32> {
    let over_ssh = std::env::var_os("SSH_CONNECTION").is_some();
    options.bytes_per_second.or_else(|| over_ssh.then_some(OVER_SSH))
}

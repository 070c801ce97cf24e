//! A program without keys that speaks with the network for the site: found, started, supervised, ended.

use std::collections::{BTreeMap, VecDeque};
use std::io::{BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use std::{fs::File, os::fd::AsRawFd as _, os::unix::process::CommandExt as _, thread::JoinHandle};

use serde::Serialize;

use crate::pipe::write::{MOST_UNCONFIRMED, MOST_UNCONFIRMED_BYTES, Order, Report};
use crate::pipe::{VERSION, receive, send};
use crate::{Result, RosError, lock, model::clean};

const NOBODY: u32 = 65534;
/// Shown where the kernel raises no walls around such a program.
pub const UNCONFINED: &str = "this kernel does not confine the program that speaks with the network (Landlock and \
                              seccomp are needed): if compromised, it could open anything its user can open";
/// Time to leave its domain before it is killed.
pub(crate) const LEAVING: Duration = Duration::from_millis(1500);

/// From the settings, otherwise beside this program. The error is the path that was tried.
pub fn find(name: &str, given: Option<&Path>) -> Result<PathBuf, String> {
    let beside = || std::env::current_exe().ok().and_then(|own| Some(own.parent()?.join(name)));
    let path = given.map(Path::to_owned).or_else(beside).unwrap_or_else(|| PathBuf::from(name));
    if path.is_file() { Ok(path) } else { Err(clean(&path.display().to_string(), 200)) }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Errand {
    pub program: PathBuf,
    pub arguments: Vec<String>,
    pub environment: Vec<(&'static str, String)>,
}

/// Starts it with no environment but the errand's, no terminal, its own process group, and only the two pipes open.
/// Under root it runs as `nobody`, or not at all.
pub fn start(errand: &Errand) -> Result<(Child, ChildStdin, ChildStdout)> {
    let system = |error: &std::io::Error| RosError::system("start the program that speaks with the network", error);
    // In a user namespace without that user, root is an ordinary user of the machine.
    let map = std::fs::read_to_string("/proc/self/uid_map").unwrap_or_default();
    let mut child = if rustix::process::geteuid().is_root() && has_nobody(&map) {
        start_as_nobody(errand).map_err(|error| RosError::not_as_nobody(&errand.program, &error))?
    } else {
        command(errand, &errand.program).spawn().map_err(|error| system(&error))?
    };
    match (child.stdin.take(), child.stdout.take()) {
        (Some(to), Some(from)) => Ok((child, to, from)),
        _ => Err(system(&std::io::Error::other("it has no pipes"))),
    }
}

/// Whether a user namespace's map (first user, the same outside, count) has `nobody`. An unknown map has.
fn has_nobody(map: &str) -> bool {
    let span = |line: &str| {
        let mut numbers = line.split_whitespace().map(str::parse::<u32>);
        Some((numbers.next()?.ok()?, numbers.nth(1)?.ok()?))
    };
    let mut spans = map.lines().filter_map(span).peekable();
    spans.peek().is_none() || spans.any(|(first, count)| NOBODY.checked_sub(first).is_some_and(|place| place < count))
}

fn start_as_nobody(errand: &Errand) -> std::io::Result<Child> {
    let spawn = |path: &Path| command(errand, path).gid(NOBODY).uid(NOBODY).spawn();
    spawn(&errand.program).or_else(|_| {
        // It may be where only root gets to, as below /root; everybody may execute the file itself.
        let opened = File::open(&errand.program)?;
        spawn(Path::new(&format!("/proc/self/fd/{}", opened.as_raw_fd())))
    })
}

fn command(errand: &Errand, path: &Path) -> Command {
    let mut command = Command::new(path);
    command
        .arg0(&errand.program)
        .args(&errand.arguments)
        .env_clear()
        .envs(errand.environment.iter().map(|(name, value)| (name, value)))
        .current_dir("/")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .process_group(0);
    command
}

/// Waits until it ends, and kills it if that takes too long. Whether it left its domain in order.
pub fn end(child: &mut Child) -> bool {
    let begun = Instant::now();
    while begun.elapsed() < LEAVING {
        match child.try_wait() {
            Ok(None) => std::thread::sleep(Duration::from_millis(10)),
            ended => return ended.is_ok_and(|status| status.is_some_and(|status| status.success())),
        }
    }
    drop(child.kill());
    drop(child.wait());
    false
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Participant {
    domain: u16,
    /// Prefix of its ids, 12 bytes as hex.
    prefix: String,
}

impl Participant {
    pub fn new(domain: u16, prefix: String) -> Option<Self> {
        let is_name = prefix.len() == 24 && prefix.bytes().all(|byte| byte.is_ascii_hexdigit());
        is_name.then_some(Self { domain, prefix })
    }

    /// Has a run of `program` announce in the domain that this participant was killed: nodes would wait for it. Does
    /// not wait for that run, which lasts four seconds.
    pub fn bury(self, program: &Path) {
        let arguments = ["--domain".to_owned(), self.domain.to_string(), "--bury".to_owned(), self.prefix];
        let errand = Errand { program: program.to_owned(), arguments: arguments.into(), environment: Vec::new() };
        // Where this fails, the participant is forgotten after its lease.
        let Ok((mut child, ..)) = start(&errand) else { return };
        drop(std::thread::Builder::new().name("ros2 last".to_owned()).spawn(move || drop(child.wait())));
    }
}

/// Interval between checks that a program still reports, as it does once a tick.
pub(crate) const TICK: Duration = Duration::from_millis(500);
/// It is killed after this many checks without a report; counting checks blames nobody when the machine slept.
const SILENT_TICKS: u32 = 10;

#[derive(Debug, Default)]
pub(crate) struct Silence {
    reports: u64,
    ticks: u32,
}

impl Silence {
    /// At a tick, with the reports so far: whether the program is to be killed.
    pub fn is_too_long(&mut self, reports: u64) -> bool {
        self.ticks = if reports == self.reports { self.ticks + 1 } else { 0 };
        self.reports = reports;
        let is_over = self.ticks >= SILENT_TICKS;
        self.ticks = if is_over { 0 } else { self.ticks };
        is_over
    }
}

/// The shortest and the longest time between two starts.
const FIRST_PAUSE: Duration = Duration::from_millis(50);
const LONGEST_PAUSE: Duration = Duration::from_secs(5);
const BEGAN_WELL: Duration = Duration::from_secs(10);

/// When a program that has ended is started again: at once, and ever later while it ends soon after its starts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Restarts {
    begun: Instant,
    pause: Duration,
}

impl Restarts {
    /// At the first start.
    pub fn begin() -> Self {
        Self { begun: Instant::now(), pause: FIRST_PAUSE }
    }

    pub fn left(&self) -> Duration {
        self.pause.saturating_sub(self.begun.elapsed())
    }

    /// At a later start.
    pub fn again(&mut self) {
        let is_well = self.begun.elapsed() >= BEGAN_WELL;
        self.pause = if is_well { FIRST_PAUSE } else { (self.pause * 2).min(LONGEST_PAUSE) };
        self.begun = Instant::now();
    }
}

const JOINING: Duration = Duration::from_secs(10);
/// Time to answer about a topic: it discovers first, and waits for subscribers.
const ANSWERING: Duration = Duration::from_secs(10);
pub fn other_version(found: u32) -> String {
    format!("it uses pipe version {found}, but {VERSION} is required; install both programs from the same release")
}

/// The error of a program that takes longer.
const SILENT: &str = "the program that publishes does not answer";
const LONGEST_REASON: usize = 400;
const MOST_ANSWERS: usize = 4096;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Declined {
    pub reason: String,
    pub occupied: bool,
}

#[derive(Debug, Default)]
pub struct State {
    pub joined: bool,
    /// Whether it can open no file and no local socket.
    pub confined: bool,
    /// Its answers about topics, by their number.
    pub answers: BTreeMap<u32, Result<(), Declined>>,
    unconfirmed: VecDeque<usize>,
    unconfirmed_bytes: usize,
    dropped: u64,
    /// Sent, and not yet acknowledged by a subscriber.
    pub unacknowledged: u64,
    /// Sent to subscribers that do not acknowledge.
    pub best_effort: u64,
    left: bool,
    reports: u64,
    broken: Option<String>,
    participant: Option<Participant>,
}

impl State {
    pub fn take(&mut self, report: Report, domain: u16) -> Result<(), String> {
        self.reports += 1;
        match report {
            Report::Hello { version, domain: joined, confined } => {
                if (version, joined) != (VERSION, domain) {
                    return Err(other_version(version));
                }
                (self.joined, self.confined) = (true, confined);
            }
            Report::Joined { participant } => self.participant = Participant::new(domain, participant),
            Report::Ready { writer } => self.answer(writer, Ok(())),
            Report::Refused { writer, reason, occupied } => {
                self.answer(writer, Err(Declined { reason: clean(&reason, LONGEST_REASON), occupied }));
            }
            Report::Taken { messages, dropped, unacknowledged, unconfirmed } => {
                for _ in 0..messages {
                    let Some(size) = self.unconfirmed.pop_front() else { break };
                    self.unconfirmed_bytes -= size;
                }
                self.dropped += u64::from(dropped.min(messages));
                (self.unacknowledged, self.best_effort) = (u64::from(unacknowledged), unconfirmed);
            }
            Report::Left => self.left = true,
            Report::Alive => {}
            Report::Failed { reason } => return Err(clean(&reason, LONGEST_REASON)),
        }
        Ok(())
    }

    fn answer(&mut self, writer: u32, answer: Result<(), Declined>) {
        if self.answers.len() < MOST_ANSWERS {
            self.answers.insert(writer, answer);
        }
    }

    pub fn hand_out(&mut self, size: usize) {
        self.unconfirmed.push_back(size);
        self.unconfirmed_bytes += size;
    }

    pub fn take_back(&mut self) {
        self.unconfirmed_bytes -= self.unconfirmed.pop_back().unwrap_or(0);
    }

    /// Messages that it has not confirmed, and their bytes.
    pub fn unconfirmed(&self) -> (usize, usize) {
        (self.unconfirmed.len(), self.unconfirmed_bytes)
    }

    /// Messages that subscribers missed; of an ended program, also those that it held or that were not acknowledged.
    pub fn missed(&self) -> u64 {
        let held = if self.broken.is_some() { self.unconfirmed.len() as u64 + self.unacknowledged } else { 0 };
        self.dropped + held
    }
}

#[derive(Default)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
    to_child: Mutex<Option<ChildStdin>>,
    child: Mutex<Option<Child>>,
}

pub fn kill(child: &Mutex<Option<Child>>) {
    if let Some(child) = lock(child).as_mut() {
        drop(child.kill());
    }
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }

    fn read(&self, from: &mut impl Read, domain: u16) -> String {
        loop {
            match receive::<Report>(from) {
                Ok(Some((report, _))) => {
                    let taken = self.state().take(report, domain);
                    self.changed.notify_all();
                    if let Err(reason) = taken {
                        return reason;
                    }
                }
                Ok(None) => return "the program that publishes has ended".to_owned(),
                Err(error) => return error.to_string(),
            }
        }
    }

    fn watch_over(&self) {
        let mut silence = Silence::default();
        let mut state = self.state();
        while state.broken.is_none() {
            let (next, waited) = self.changed.wait_timeout(state, TICK).unwrap_or_else(PoisonError::into_inner);
            state = next;
            if waited.timed_out() && silence.is_too_long(state.reports) {
                drop(state);
                kill(&self.child);
                state = self.state();
            }
        }
    }
}

pub struct Run {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
    errand: Errand,
    domain: u16,
    restarts: Restarts,
}

impl Run {
    /// `domain` is the one that its hello must name.
    pub fn start(errand: &Errand, domain: u16) -> Result<Self> {
        let (child, to, from) = start(errand)?;
        let shared = Arc::new(Shared::default());
        *lock(&shared.child) = Some(child);
        *lock(&shared.to_child) = Some(to);
        let (errand, restarts) = (errand.clone(), Restarts::begin());
        let mut run = Self { shared: Arc::clone(&shared), threads: Vec::new(), errand, domain, restarts };
        let reading = Arc::clone(&shared);
        run.keep("ros out", move || {
            let reason = reading.read(&mut BufReader::new(from), domain);
            reading.state().broken.get_or_insert(reason);
            reading.changed.notify_all();
            // A caller that writes to it must not wait for it.
            kill(&reading.child);
        })?;
        run.keep("ros out watch", move || shared.watch_over())?;
        Ok(run)
    }

    /// The run that replaces this one, which knows no topic yet; `None` while this one lasts. An error says why nothing
    /// is published until a later call.
    pub fn successor(&mut self) -> Result<Option<Self>, String> {
        let Some(reason) = self.broken() else { return Ok(None) };
        if !self.restarts.left().is_zero() {
            return Err(reason);
        }
        self.restarts.again();
        let mut next = Self::start(&self.errand, self.domain).map_err(|error| error.to_string())?;
        next.restarts = self.restarts;
        next.joined()?;
        Ok(Some(next))
    }

    fn keep(&mut self, name: &str, work: impl FnOnce() + Send + 'static) -> Result<()> {
        let started = std::thread::Builder::new().name(name.to_owned()).spawn(work);
        self.threads.push(started.map_err(|error| RosError::system("start a thread for a program", &error))?);
        Ok(())
    }

    pub fn order<T: Serialize>(&self, order: &Order<T>, payload: &[u8]) -> Result<(), String> {
        let mut to = lock(&self.shared.to_child);
        let sent = to.as_mut().map(|to| send(to, order, payload).and_then(|()| Ok(to.flush()?)));
        match sent {
            Some(Ok(())) => Ok(()),
            Some(Err(error)) => {
                // Half a frame may be in the pipe: nothing can follow it.
                *to = None;
                Err(error.to_string())
            }
            None => Err("the program that publishes has ended".to_owned()),
        }
    }

    /// False if the program does not get it.
    pub fn publish(&self, writer: u32, message: &[u8]) -> bool {
        // Counted first: it may be confirmed immediately.
        self.shared.state().hand_out(message.len());
        let sent = self.order(&Order::<()>::Publish { writer }, message).is_ok();
        if !sent {
            self.shared.state().take_back();
        }
        sent
    }

    pub fn is_crowded(&self) -> bool {
        let (messages, bytes) = self.state().unconfirmed();
        messages >= MOST_UNCONFIRMED / 2 || bytes >= MOST_UNCONFIRMED_BYTES / 2
    }

    /// Waits until `find` returns something, at most for `patience`.
    pub fn wait<T>(
        &self,
        patience: Duration,
        mut find: impl FnMut(&mut State) -> Option<T>,
    ) -> Result<Option<T>, String> {
        let begun = Instant::now();
        let mut state = self.shared.state();
        loop {
            if let Some(found) = find(&mut state) {
                return Ok(Some(found));
            }
            if let Some(reason) = &state.broken {
                return Err(reason.clone());
            }
            let left = patience.saturating_sub(begun.elapsed());
            if left.is_zero() {
                return Ok(None);
            }
            state = self.shared.changed.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    pub fn joined(&self) -> Result<(), String> {
        self.wait(JOINING, |state| state.joined.then_some(()))?.ok_or_else(|| SILENT.to_owned())
    }

    /// Announces a topic and waits for the answer; a program that gives none is killed.
    pub fn announce<T: Serialize>(
        &self,
        writer: u32,
        order: &Order<T>,
        payload: &[u8],
    ) -> Result<Result<(), Declined>, String> {
        self.order(order, payload)?;
        let answer = self.wait(ANSWERING, |state| state.answers.remove(&writer))?;
        answer.ok_or_else(|| {
            self.kill();
            SILENT.to_owned()
        })
    }

    pub fn state(&self) -> MutexGuard<'_, State> {
        self.shared.state()
    }

    pub fn kill(&self) {
        kill(&self.shared.child);
    }

    /// Whether subscribers have everything, or the program has ended.
    pub fn is_sent(&self) -> bool {
        let state = self.state();
        state.left || state.broken.is_some()
    }

    pub fn broken(&self) -> Option<String> {
        self.shared.state().broken.clone()
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        // The end of its pipe tells it to leave.
        lock(&self.shared.to_child).take();
        let child = lock(&self.shared.child).take();
        if let Some(mut child) = child {
            let has_left = end(&mut child);
            let participant = self.shared.state().participant.take();
            if let Some(participant) = participant.filter(|_| !has_left) {
                participant.bury(&self.errand.program);
            }
        }
        self.shared.state().broken.get_or_insert_with(|| "it was ended".to_owned());
        self.shared.changed.notify_all();
        for thread in self.threads.drain(..) {
            drop(thread.join());
        }
    }
}

#[cfg(test)]
mod tests;

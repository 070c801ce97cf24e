//! Starts the program that reads, forwards its reports, and restarts it when it ends or falls silent.

use std::io::{BufReader, Read, Write};
use std::path::PathBuf;
use std::process::{Child, ChildStdin};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::errand;
use super::standing::Reading;
use super::state::{Outcome, State};
use crate::model::TopicName;
use crate::pipe::read::{Told, Wish};
use crate::pipe::{receive, send};
use crate::ros::child;
use crate::ros::{CaptureNotice, MessageSink, RosError};

/// Interval between checks that the program still reports.
const TICK: Duration = Duration::from_millis(500);
/// After this many checks without a report it is killed. It reports once a tick; checks are counted, not time, so that
/// a machine that slept blames nobody.
const SILENT_TICKS: u32 = 10;
/// The shortest and the longest pause before a start.
const FIRST_PAUSE: Duration = Duration::from_millis(50);
const LONGEST_PAUSE: Duration = Duration::from_secs(5);
/// A program that ran this long started well.
const BEGAN_WELL: Duration = Duration::from_secs(10);

/// Shared by the threads of a capture.
pub struct Shared {
    /// The domain.
    pub domain: u16,
    program: PathBuf,
    sink: Arc<dyn MessageSink>,
    state: Mutex<State>,
    to_child: Mutex<Option<ChildStdin>>,
    running: Mutex<Option<Child>>,
    frames: AtomicU64,
    stopping: AtomicBool,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Shared {
    /// Nothing runs yet.
    pub fn new(domain: u16, program: PathBuf, sink: Arc<dyn MessageSink>) -> Self {
        Self {
            domain,
            program,
            sink,
            state: Mutex::new(State::new(domain)),
            to_child: Mutex::default(),
            running: Mutex::default(),
            frames: AtomicU64::new(0),
            stopping: AtomicBool::new(false),
        }
    }

    /// What is known.
    pub fn state(&self) -> MutexGuard<'_, State> {
        locked(&self.state)
    }

    fn hand_on(&self, outcome: Outcome) {
        if self.is_stopping() {
            return;
        }
        outcome.wishes.iter().for_each(|wish| self.wish(wish));
        outcome.notices.into_iter().for_each(|notice| self.sink.notice(notice));
        outcome.messages.into_iter().for_each(|message| self.sink.accept(message));
        outcome.definitions.into_iter().for_each(|message| self.sink.define(message));
    }

    /// Captures the messages that still wait for the identity of their publisher, of a topic or of all.
    pub fn settle(&self, topic: Option<&str>) {
        let mut outcome = Outcome::default();
        self.state().settle(Instant::now(), |name| topic.is_none_or(|topic| topic == name), &mut outcome);
        self.hand_on(outcome);
    }

    /// Captures a topic from now on.
    pub fn watch(&self, topic: &TopicName) {
        let mut outcome = Outcome::default();
        if self.state().watch(topic, &mut outcome) {
            self.wish(&Wish::Watch { topic: topic.to_string() });
            self.hand_on(outcome);
        }
    }

    /// Stops capturing it.
    pub fn unwatch(&self, topic: &TopicName) {
        let mut outcome = Outcome::default();
        if self.state().unwatch(topic, Instant::now(), &mut outcome) {
            self.hand_on(outcome);
            self.wish(&Wish::Unwatch { topic: topic.to_string() });
        }
    }

    /// A program that does not receive it is restarted, and told then.
    fn wish(&self, wish: &Wish) {
        if let Some(to) = locked(&self.to_child).as_mut() {
            drop(send(to, wish, &[]).map(|()| to.flush()));
        }
    }

    fn is_stopping(&self) -> bool {
        self.stopping.load(Ordering::Acquire)
    }

    /// The end of its pipe tells the program to leave.
    pub fn stop(&self) {
        self.stopping.store(true, Ordering::Release);
        locked(&self.to_child).take();
    }

    fn wait(&self, pause: Duration) {
        let begun = Instant::now();
        while begun.elapsed() < pause && !self.is_stopping() {
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// One run of the program, to its end; returns why it ended.
    fn run_once(&self) -> String {
        let (child, to, from) = match child::start(&errand(&self.program, self.domain, false)) {
            Ok(started) => started,
            Err(error) => return error.to_string(),
        };
        *locked(&self.running) = Some(child);
        *locked(&self.to_child) = Some(to);
        if self.is_stopping() {
            locked(&self.to_child).take();
        }
        // What is watched from here on is sent by the call that watches it; twice does no harm.
        let watched: Vec<TopicName> = self.state().watched.iter().cloned().collect();
        watched.iter().for_each(|topic| self.wish(&Wish::Watch { topic: topic.to_string() }));
        let reason = self.read(&mut BufReader::with_capacity(256 << 10, from));
        locked(&self.to_child).take();
        // Not under the lock, which is needed to kill a silent program.
        let child = locked(&self.running).take();
        if let Some(mut child) = child {
            let has_left = if self.is_stopping() {
                child::end(&mut child)
            } else {
                drop(child.kill());
                child.wait().is_ok_and(|status| status.success())
            };
            let participant = self.state().participant.take();
            if let Some(participant) = participant.filter(|_| !has_left) {
                participant.bury(&self.program);
            }
        }
        reason
    }

    fn read(&self, from: &mut impl Read) -> String {
        loop {
            match receive::<Told>(from) {
                Ok(Some((told, payload))) => {
                    self.frames.fetch_add(1, Ordering::AcqRel);
                    let outcome = self.state().take(told, payload, Instant::now());
                    match outcome {
                        Ok(outcome) => self.hand_on(outcome),
                        Err(reason) => return reason,
                    }
                }
                Ok(None) => return "the program that reads it ended".to_owned(),
                Err(error) => return error.to_string(),
            }
        }
    }

    fn supervise(&self) {
        let mut pause = FIRST_PAUSE;
        while !self.is_stopping() {
            let begun = Instant::now();
            let reason = self.run_once();
            if self.is_stopping() {
                return;
            }
            let first = {
                let mut state = self.state();
                let first = !matches!(state.reading, Reading::Down { .. });
                state.restarts += 1;
                state.reading = Reading::Down { reason: reason.clone() };
                first
            };
            if first {
                self.hand_on(Outcome { notices: vec![CaptureNotice::ReadingBroken { reason }], ..Outcome::default() });
            }
            pause = if begun.elapsed() >= BEGAN_WELL { FIRST_PAUSE } else { pause };
            self.wait(pause);
            pause = (pause * 2).min(LONGEST_PAUSE);
        }
    }

    fn watch_over(&self) {
        let (mut before, mut silent) = (0, 0);
        while !self.is_stopping() {
            self.wait(TICK);
            let now = self.frames.load(Ordering::Acquire);
            silent = if now == before { silent + 1 } else { 0 };
            before = now;
            if silent >= SILENT_TICKS {
                silent = 0;
                self.kill();
            }
        }
        // The end of its pipe tells it to leave. One that stays and goes on talking would hold up the caller that stops it.
        let begun = Instant::now();
        while begun.elapsed() < child::LEAVING && locked(&self.running).is_some() {
            std::thread::sleep(Duration::from_millis(20));
        }
        self.kill();
    }

    fn kill(&self) {
        if let Some(child) = locked(&self.running).as_mut() {
            drop(child.kill());
        }
    }
}

fn thread(name: &str, work: impl FnOnce() + Send + 'static) -> Result<JoinHandle<()>, RosError> {
    let started = std::thread::Builder::new().name(name.to_owned()).spawn(work);
    started.map_err(|error| RosError::system("start a thread for ROS 2", &error))
}

/// Runs the program again and again until the capture is stopped.
///
/// # Errors
/// [`RosError::System`] if there is no thread to be had.
pub fn keep_reading(shared: &Arc<Shared>) -> Result<JoinHandle<()>, RosError> {
    let shared = Arc::clone(shared);
    thread("ros2", move || shared.supervise())
}

/// Kills a program that no longer reports.
///
/// # Errors
/// See [`keep_reading`].
pub fn keep_watch(shared: &Arc<Shared>) -> Result<JoinHandle<()>, RosError> {
    let shared = Arc::clone(shared);
    thread("ros2 watch", move || shared.watch_over())
}

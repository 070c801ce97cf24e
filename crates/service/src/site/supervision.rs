//! Keeps the background tasks of a site running: one that panics, or ends although still wanted, is restarted after a
//! pause that doubles. `SiteStatus` shows every task.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, Weak};
use std::time::{Duration, Instant};

use tokio::task::{AbortHandle, JoinHandle};

use super::parts::Lifetime;
use crate::crypto::fault;
use crate::hub::Hub;
use crate::model::{RecordState, Timestamp, clean, locked};
use crate::pipeline::{Network, Owner};
use crate::reply::{HealthLevel, Part, PartHealth, Result, TaskState, TaskView, internal};
use crate::site::{Lanes, Parts, blocking};

const PAUSES: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(8));
/// After working this long, a failing task gets the first pause again.
const STEADY: Duration = Duration::from_secs(60);
/// How often a pausing thread checks whether the site ends.
const LOOK: Duration = Duration::from_millis(50);

pub(super) struct Supervisor {
    hub: Arc<Hub>,
    life: Arc<Lifetime>,
    /// In starting order.
    tasks: Mutex<Vec<Arc<Task>>>,
}

struct Task {
    name: String,
    standing: Mutex<Standing>,
    /// Ends the present run, and why that was done.
    run: Mutex<(Option<AbortHandle>, Option<&'static str>)>,
}

/// Also where the task is aborted, it is not shown any more.
struct Listed(Arc<Supervisor>, Arc<Task>);

impl Drop for Listed {
    fn drop(&mut self) {
        self.0.remove(&self.1);
    }
}

struct Standing {
    begun: Instant,
    restarts: u64,
    pause: Duration,
    resumes: Option<Instant>,
    reason: Option<String>,
}

impl Supervisor {
    pub fn new(hub: Arc<Hub>, life: Arc<Lifetime>) -> Self {
        Self { hub, life, tasks: Mutex::default() }
    }

    fn add(&self, name: String) -> Arc<Task> {
        let standing = Standing { begun: Instant::now(), restarts: 0, pause: PAUSES.0, resumes: None, reason: None };
        let task = Arc::new(Task { name, standing: Mutex::new(standing), run: Mutex::default() });
        locked(&self.tasks).push(Arc::clone(&task));
        task
    }

    fn remove(&self, task: &Arc<Task>) {
        locked(&self.tasks).retain(|other| !Arc::ptr_eq(other, task));
    }

    /// Ends the present runs of tasks with this name, alone or with a profile's, so that they restart; threads cannot
    /// be ended.
    pub fn restart(&self, name: &str, why: &'static str) {
        let is_of = |task: &&Arc<Task>| task.name.split(' ').next() == Some(name);
        for task in locked(&self.tasks).iter().filter(is_of) {
            let mut run = locked(&task.run);
            if let Some(handle) = run.0.take() {
                run.1 = Some(why);
                handle.abort();
            }
        }
    }

    pub fn views(&self) -> Vec<TaskView> {
        locked(&self.tasks).iter().map(|task| task.view()).collect()
    }

    /// Keeps work running until the site ends; aborting the handle ends it.
    pub fn keep<Whose, Work, Run>(self: &Arc<Self>, name: &str, part: &Arc<Whose>, work: Work) -> JoinHandle<()>
    where
        Whose: Send + Sync + 'static,
        Work: Fn(Arc<Whose>) -> Run + Send + 'static,
        Run: Future<Output = ()> + Send + 'static,
    {
        self.keep_while(name, part, |_| true, work)
    }

    /// Keeps work running while it is wanted and the site does not end.
    pub fn keep_while<Whose, Wanted, Work, Run>(
        self: &Arc<Self>,
        name: &str,
        part: &Arc<Whose>,
        wanted: Wanted,
        work: Work,
    ) -> JoinHandle<()>
    where
        Whose: Send + Sync + 'static,
        Wanted: Fn(&Arc<Whose>) -> bool + Send + 'static,
        Work: Fn(Arc<Whose>) -> Run + Send + 'static,
        Run: Future<Output = ()> + Send + 'static,
    {
        let (supervisor, part, task) = (Arc::clone(self), Arc::clone(part), self.add(name.to_owned()));
        let listed = Listed(Arc::clone(self), Arc::clone(&task));
        tokio::spawn(async move {
            let _until_it_ends = listed;
            loop {
                let (run, name) = (work(Arc::clone(&part)), task.name.clone());
                let mut running = Aborted(tokio::spawn(async move {
                    tokio::select! {
                        () = run => {}
                        () = fault::task_fails(&name) => {}
                    }
                }));
                locked(&task.run).0 = Some(running.0.abort_handle());
                let ended = (&mut running.0).await;
                let restarted = std::mem::take(&mut *locked(&task.run)).1;
                if supervisor.life.is_ending() || !wanted(&part) {
                    break;
                }
                let reason = ended.err().map_or_else(|| "it ended too early".to_owned(), reason_of);
                let reason = restarted.map_or(reason, str::to_owned);
                let pause = supervisor.tell_ended(&task, &reason);
                if !supervisor.life.rest(pause).await {
                    break;
                }
                task.begins_again();
                supervisor.hub.changed(Part::Health);
            }
        })
    }

    /// Keeps a thread running until it ends on its own: only a panic restarts it.
    pub fn keep_thread(
        self: &Arc<Self>,
        name: &'static str,
        mut work: impl FnMut() + Send + 'static,
    ) -> Result<std::thread::JoinHandle<()>> {
        let (supervisor, task) = (Arc::downgrade(self), self.add(name.to_owned()));
        let run = move || {
            while let Err(panic) = catch_unwind(AssertUnwindSafe(&mut work)) {
                if !rest(&supervisor, &task, &words(&*panic)) {
                    break;
                }
            }
            if let Some(supervisor) = supervisor.upgrade() {
                supervisor.remove(&task);
            }
        };
        let spawned = std::thread::Builder::new().name(name.to_owned()).spawn(run);
        spawned.map_err(|error| internal(format!("thread {name} cannot be started: {error}")))
    }

    fn tell_ended(&self, task: &Task, reason: &str) -> Duration {
        let pause = task.ended(reason);
        self.hub.alarm(&format!(
            "the task '{}' of this site failed and restarts in {:.1} s, nothing acknowledged is lost: {reason}",
            task.name,
            pause.as_secs_f32()
        ));
        self.hub.changed(Part::Health);
        pause
    }
}

impl Task {
    fn view(&self) -> TaskView {
        let standing = locked(&self.standing);
        TaskView {
            name: clean(&self.name, 80),
            state: if standing.resumes.is_some() { TaskState::Resting } else { TaskState::Running },
            restarts: standing.restarts,
            next_try: standing.resumes.map(|at| at.saturating_duration_since(Instant::now()).as_secs()),
            reason: standing.reason.clone(),
        }
    }

    /// Returns the pause.
    fn ended(&self, reason: &str) -> Duration {
        let mut standing = locked(&self.standing);
        let pause = if standing.begun.elapsed() >= STEADY { PAUSES.0 } else { standing.pause };
        standing.pause = (pause * 2).min(PAUSES.1);
        standing.resumes = Some(Instant::now() + pause);
        standing.reason = Some(clean(reason, 200));
        pause
    }

    fn begins_again(&self) {
        let mut standing = locked(&self.standing);
        standing.begun = Instant::now();
        standing.restarts += 1;
        standing.resumes = None;
    }
}

pub(super) struct Aborted(pub JoinHandle<()>);

impl Drop for Aborted {
    fn drop(&mut self) {
        self.0.abort();
    }
}

/// Pauses a thread that panicked; returns whether it is still wanted. An end of the site only shortens the pause: what
/// the thread holds must be finished.
fn rest(supervisor: &Weak<Supervisor>, task: &Task, reason: &str) -> bool {
    let Some(pause) = supervisor.upgrade().map(|supervisor| supervisor.tell_ended(task, reason)) else { return false };
    let resumes = Instant::now() + pause;
    while Instant::now() < resumes && supervisor.upgrade().is_some_and(|supervisor| !supervisor.life.is_ending()) {
        std::thread::sleep(LOOK);
    }
    task.begins_again();
    supervisor.upgrade().is_some_and(|supervisor| {
        supervisor.hub.changed(Part::Health);
        !supervisor.life.is_stopping()
    })
}

fn reason_of(error: tokio::task::JoinError) -> String {
    match error.try_into_panic() {
        Ok(panic) => words(&*panic),
        Err(_) => "it was cancelled".to_owned(),
    }
}

fn words(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
    clean(text.unwrap_or("a bug in the program; please report it"), 200)
}

const LOOK_EVERY: Duration = Duration::from_secs(10);
/// Part of the health.
pub(super) const PART: &str = "stages";

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Stage {
    Anchorer,
    Watcher,
    Verifier,
}

impl Stage {
    const ALL: [Self; 3] = [Self::Anchorer, Self::Watcher, Self::Verifier];

    /// Name of its tasks, or the beginning of it.
    fn task(self) -> &'static str {
        match self {
            Self::Anchorer => "anchorer",
            Self::Watcher => "watcher",
            Self::Verifier => "verifier",
        }
    }

    fn work(self) -> &'static str {
        match self {
            Self::Anchorer => "records wait to be anchored",
            Self::Watcher => "blocks wait to be read",
            Self::Verifier => "records wait to be verified",
        }
    }

    /// Longest time with work and no progress: many times the need of a busy machine.
    fn patience(self) -> Duration {
        match self {
            Self::Watcher | Self::Verifier => Duration::from_secs(60),
            Self::Anchorer => Duration::from_secs(180),
        }
    }
}

/// Waiting work, and a number that changes with any progress.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Work {
    waiting: u64,
    done: u64,
}

/// One stage's work when it last made progress.
#[derive(Debug, Clone, Copy)]
struct Progress {
    since: Instant,
    work: Work,
    /// When it was found standing, and when its task was last restarted.
    standing: Option<(Timestamp, Instant)>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Found {
    Going,
    /// It stands, and its task must be restarted.
    Restart,
    Standing,
}

#[derive(Debug, Default)]
pub struct Judge(BTreeMap<Stage, Progress>);

impl Judge {
    /// `work` is `None` while the stage waits for somebody else.
    fn look(&mut self, stage: Stage, work: Option<Work>, now: Instant) -> Found {
        let Some(work) = work.filter(|work| work.waiting > 0) else {
            self.0.remove(&stage);
            return Found::Going;
        };
        let begun = Progress { since: now, work, standing: None };
        let known = self.0.entry(stage).or_insert(begun);
        let moved = work.done != known.work.done || work.waiting < known.work.waiting;
        if moved {
            *known = begun;
            return Found::Going;
        }
        known.work = work;
        if now.duration_since(known.since) < stage.patience() {
            return Found::Going;
        }
        match &mut known.standing {
            Some((_, restarted)) if now.duration_since(*restarted) < stage.patience() => Found::Standing,
            Some((_, restarted)) => {
                *restarted = now;
                Found::Restart
            }
            none => {
                *none = Some((Timestamp::now(), now));
                Found::Restart
            }
        }
    }

    /// With since when, and how much waits.
    fn standing(&self) -> impl Iterator<Item = (Stage, Timestamp, u64)> {
        self.0.iter().filter_map(|(stage, progress)| Some((*stage, progress.standing?.0, progress.work.waiting)))
    }
}

pub struct Standstill {
    pub parts: Parts,
    pub lanes: Arc<Lanes>,
    pub judge: Mutex<Judge>,
}

impl Standstill {
    pub async fn keep(self: Arc<Self>) {
        while self.parts.life.beat(LOOK_EVERY).await {
            let network = self.parts.link.network_now().filter(|_| !self.parts.link.is_silent());
            let blocks = match &network {
                Some(network) => self.unread(network).await,
                None => None,
            };
            let found = blocking(&self, move |stages| stages.work(network.as_ref())).await;
            // Others report an unreadable ledger.
            let Ok(mut works) = found else { continue };
            works.insert(Stage::Watcher, blocks);
            for stage in Stage::ALL {
                self.judge_one(stage, works.get(&stage).copied().flatten());
            }
        }
    }

    /// The stages are another process's now.
    pub fn forget(&self) {
        *locked(&self.judge) = Judge::default();
    }

    /// Blocks of the chain that the watcher has not read.
    async fn unread(&self, network: &Network) -> Option<Work> {
        let head = network.chain.head().await.ok()?.number;
        let read = *self.parts.link.scans().borrow();
        Some(Work { waiting: head.saturating_sub(read), done: read })
    }

    fn work(&self, network: Option<&Network>) -> Result<BTreeMap<Stage, Option<Work>>> {
        let states = self.parts.plant.ledger.counts.in_each_state()?;
        let of = |state: RecordState| states.get(&state).copied().unwrap_or(0);
        let beyond = |last: RecordState| -> u64 {
            states.iter().filter(|(state, _)| **state > last && **state <= RecordState::Verified).map(|(_, n)| n).sum()
        };
        let checked = network.map(|_| Work {
            waiting: of(RecordState::Confirmed),
            done: of(RecordState::Verified) + of(RecordState::Tampered),
        });
        let anchored = match network {
            // A transaction in flight keeps the next ones waiting.
            Some(network) if of(RecordState::Submitted) == 0 => {
                Some(Work { waiting: self.unbatched(network)?, done: beyond(RecordState::Stored) })
            }
            _ => None,
        };
        Ok([(Stage::Verifier, checked), (Stage::Anchorer, anchored)].into())
    }

    /// Records in no batch that an open owner anchors whose lanes are not paused.
    fn unbatched(&self, network: &Network) -> Result<u64> {
        let owners = self.parts.owners.all();
        let pauses = self.lanes.pauses(network);
        let is_going =
            |owner: &Owner| pauses.iter().any(|(account, pause)| *account == owner.address && pause.is_none());
        let open = owners
            .iter()
            .filter(|owner| !owner.is_locked() && is_going(owner) && network.directory.identity(owner.address).is_ok());
        open.map(|owner| Ok(self.parts.plant.ledger.batches.unbatched(owner.address)?.0)).sum()
    }

    fn judge_one(&self, stage: Stage, work: Option<Work>) {
        let mut judge = locked(&self.judge);
        let before = judge.standing().any(|(standing, ..)| standing == stage);
        let found = judge.look(stage, work, Instant::now());
        drop(judge);
        match found {
            Found::Restart => {
                self.parts.hub.alarm(&self.text().unwrap_or_default());
                self.parts.supervisor.restart(stage.task(), "it had work but made no progress");
            }
            Found::Going if before => {
                self.parts.hub.inform(&format!("the {} makes progress again", stage.task()));
            }
            Found::Going | Found::Standing => return,
        }
        self.parts.hub.changed(Part::Health);
    }

    fn text(&self) -> Option<String> {
        let judge = locked(&self.judge);
        let standing: Vec<String> = judge
            .standing()
            .map(|(stage, since, waiting)| {
                format!(
                    "{waiting} {}, and the {} has done nothing since {} UTC",
                    stage.work(),
                    stage.task(),
                    since.clock()
                )
            })
            .collect();
        (!standing.is_empty()).then(|| {
            format!(
                "{}; nothing acknowledged is lost; it is restarted automatically; if that does not help, stop the site, \
                 start it again and report this with its log",
                standing.join("; ")
            )
        })
    }

    pub fn health(&self) -> Option<PartHealth> {
        let since = locked(&self.judge).standing().map(|(_, since, _)| since).min();
        Some(PartHealth { since, ..PartHealth::new(PART, HealthLevel::Failed, &self.text()?) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn work(waiting: u64, done: u64) -> Work {
        Work { waiting, done }
    }

    #[test]
    fn a_stage_with_work_and_without_progress_is_reported_and_restarted_and_no_other_is() {
        let (mut judge, begun) = (Judge::default(), Instant::now());
        let at = |seconds: u64| begun + Duration::from_secs(seconds);
        let mut look = |seconds: u64, work: Work| {
            // Without a chain nothing is known of its work.
            let known = Some(work).filter(|_| seconds != 251);
            let found = judge.look(Stage::Verifier, known, at(seconds));
            (found, judge.standing().count())
        };
        assert_eq!(look(0, work(602, 100)), (Found::Going, 0));
        assert_eq!(look(59, work(900, 100)), (Found::Going, 0), "more came");
        assert_eq!(look(60, work(4_295, 100)), (Found::Restart, 1));
        assert_eq!(look(65, work(4_300, 100)), (Found::Standing, 1));
        assert_eq!(look(120, work(4_300, 100)), (Found::Restart, 1), "and again");
        assert_eq!(look(121, work(4_300, 101)), (Found::Going, 0), "one is enough");
        assert_eq!(look(190, work(4_299, 101)), (Found::Going, 0), "or one less");
        assert_eq!(look(251, work(4_299, 101)), (Found::Going, 0), "the chain is away, which is reported");
        assert_eq!(look(252, work(4_299, 101)), (Found::Going, 0), "the time begins anew");
        assert_eq!(look(311, work(0, 101)), (Found::Going, 0));
        assert_eq!(look(400, work(1, 101)), (Found::Going, 0), "without work nothing stands");
    }
}

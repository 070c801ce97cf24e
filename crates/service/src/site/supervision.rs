//! Keeps the background tasks of a site running: one that panics, or ends although still wanted, is restarted after a
//! pause that doubles. `SiteStatus` shows every task.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::{Duration, Instant};

use tokio::task::{AbortHandle, JoinHandle};

use super::lifetime::Lifetime;
use crate::crypto::fault;
use crate::model::clean;
use crate::service::event::Part;
use crate::service::failure::internal;
use crate::service::hub::Hub;
use crate::service::reply::{Result, TaskState, TaskView};

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
        self.tasks.lock().unwrap_or_else(PoisonError::into_inner).push(Arc::clone(&task));
        task
    }

    fn remove(&self, task: &Arc<Task>) {
        self.tasks.lock().unwrap_or_else(PoisonError::into_inner).retain(|other| !Arc::ptr_eq(other, task));
    }

    /// Ends the present runs of tasks with this name, alone or with a profile's, so that they restart; threads cannot
    /// be ended.
    pub fn restart(&self, name: &str, why: &'static str) {
        let is_of = |task: &&Arc<Task>| task.name.split(' ').next() == Some(name);
        for task in self.tasks.lock().unwrap_or_else(PoisonError::into_inner).iter().filter(is_of) {
            let mut run = task.run.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some(handle) = run.0.take() {
                run.1 = Some(why);
                handle.abort();
            }
        }
    }

    pub fn views(&self) -> Vec<TaskView> {
        self.tasks.lock().unwrap_or_else(PoisonError::into_inner).iter().map(|task| task.view()).collect()
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
                task.run.lock().unwrap_or_else(PoisonError::into_inner).0 = Some(running.0.abort_handle());
                let ended = (&mut running.0).await;
                let restarted = std::mem::take(&mut *task.run.lock().unwrap_or_else(PoisonError::into_inner)).1;
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
        let standing = self.standing.lock().unwrap_or_else(PoisonError::into_inner);
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
        let mut standing = self.standing.lock().unwrap_or_else(PoisonError::into_inner);
        let pause = if standing.begun.elapsed() >= STEADY { PAUSES.0 } else { standing.pause };
        standing.pause = (pause * 2).min(PAUSES.1);
        standing.resumes = Some(Instant::now() + pause);
        standing.reason = Some(clean(reason, 200));
        pause
    }

    fn begins_again(&self) {
        let mut standing = self.standing.lock().unwrap_or_else(PoisonError::into_inner);
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

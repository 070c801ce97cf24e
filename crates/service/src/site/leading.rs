//! The lease of the store in this site: it is renewed or taken here, and the holder's work begins and ends with it. The site of
//! a file holds it from its beginning to its end.

use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

use tokio::sync::mpsc;
use tokio::task::JoinHandle;

use super::supervision::Supervisor;
use super::{Needs, Site, identity, workers};
use crate::event::{NoticeLevel, Part};
use crate::model::counted;
use crate::pipeline::Owner;
use crate::reply::{HealthLevel, LeaseView, PartHealth, Result, WorkerView};
use crate::site::storage::may_hold;
use crate::store::notes::HoldersSettings;
use crate::store::{BEAT, Claim, LeaseState, Worker};

/// How soon it is seen that the lease was won or lost.
const LOOK: Duration = Duration::from_millis(250);
const ABOUT: &str = "lease";

/// Work that ends when it is dropped.
pub(super) struct Term {
    /// `None` = another process holds the lease.
    number: Option<u64>,
    supervisor: Arc<Supervisor>,
    owners: Arc<identity::Owners>,
    tasks: Vec<JoinHandle<()>>,
    /// Those whose work was begun.
    begun: Vec<Weak<Owner>>,
    /// Each task has it until its last step ended.
    token: Arc<()>,
}

impl Term {
    pub fn keep<Whose, Work, Run>(&mut self, name: &str, part: &Arc<Whose>, work: Work)
    where
        Whose: Send + Sync + 'static,
        Work: Fn(Arc<Whose>) -> Run + Send + 'static,
        Run: Future<Output = ()> + Send + 'static,
    {
        self.keep_while(name, part, |_| true, work);
    }

    /// Until the owner is closed.
    pub fn keep_for<Whose, Work, Run>(&mut self, owner: &Arc<Owner>, name: &str, part: &Arc<Whose>, work: Work)
    where
        Whose: Send + Sync + 'static,
        Work: Fn(Arc<Whose>, Arc<Owner>) -> Run + Send + 'static,
        Run: Future<Output = ()> + Send + 'static,
    {
        let name = format!("{name} {}", owner.profile);
        let (owners, owner, given) = (Arc::clone(&self.owners), Arc::clone(owner), Arc::clone(owner));
        let is_wanted = move |_: &Arc<Whose>| owners.is_open(&owner);
        self.keep_while(&name, part, is_wanted, move |part| work(part, Arc::clone(&given)));
    }

    /// Once, also if it was opened just as the term began.
    fn begin_for(&mut self, site: &Arc<Site>, owner: &Arc<Owner>) {
        self.begun.retain(|begun| begun.strong_count() > 0);
        if !self.begun.iter().any(|begun| begun.as_ptr() == Arc::as_ptr(owner)) {
            self.begun.push(Arc::downgrade(owner));
            workers::hold_for(site, owner, self);
        }
    }

    fn keep_while<Whose, Wanted, Work, Run>(&mut self, name: &str, part: &Arc<Whose>, wanted: Wanted, work: Work)
    where
        Whose: Send + Sync + 'static,
        Wanted: Fn(&Arc<Whose>) -> bool + Send + 'static,
        Work: Fn(Arc<Whose>) -> Run + Send + 'static,
        Run: Future<Output = ()> + Send + 'static,
    {
        let token = Arc::clone(&self.token);
        let work = move |part| {
            let (run, token) = (work(part), Arc::clone(&token));
            async move {
                run.await;
                drop(token);
            }
        };
        self.tasks.retain(|task| !task.is_finished());
        self.tasks.push(self.supervisor.keep_while(name, part, wanted, work));
    }
}

impl Drop for Term {
    fn drop(&mut self) {
        self.tasks.iter().for_each(JoinHandle::abort);
    }
}

struct Leading {
    site: Arc<Site>,
    needs: Needs,
    term: Option<Term>,
    /// The last term's token, as long as something of it runs.
    former: Weak<()>,
    beating: Option<JoinHandle<Result<()>>>,
    due: Instant,
}

/// Until the site stops.
pub(super) fn lead(site: &Arc<Site>, needs: Needs, opened: mpsc::UnboundedReceiver<Arc<Owner>>) {
    let (site, due) = (Arc::clone(site), Instant::now() + BEAT);
    let mut leading = Leading { site, needs, term: None, former: Weak::new(), beating: None, due };
    leading.follow();
    tokio::spawn(leading.run(opened));
}

impl Leading {
    async fn run(mut self, mut opened: mpsc::UnboundedReceiver<Arc<Owner>>) {
        let site = Arc::clone(&self.site);
        let is_shared = site.plant.ledger.lease.is_shared();
        loop {
            let look = async {
                match is_shared {
                    true => tokio::time::sleep(LOOK).await,
                    false => std::future::pending().await,
                }
            };
            tokio::select! {
                Some(owner) = opened.recv() => self.opened(&owner),
                () = look => {
                    self.beat().await;
                    self.follow();
                }
                () = site.stopped() => break,
            }
        }
        if let Some(term) = &mut self.term {
            // They end themselves, at a good place.
            term.tasks.clear();
        }
    }

    /// Its work is that of the present holder, or of one that follows it.
    fn follow(&mut self) {
        let number = self.site.plant.ledger.lease.held();
        if self.term.as_ref().is_some_and(|term| term.number == number) {
            return;
        }
        if let Some(term) = self.term.take() {
            self.former = Arc::downgrade(&term.token);
            self.tell(number);
        }
        let parts = &self.site.parts;
        let (supervisor, owners) = (Arc::clone(&parts.supervisor), Arc::clone(&parts.owners));
        let (tasks, begun, token) = (Vec::new(), Vec::new(), Arc::default());
        let mut term = Term { number, supervisor, owners, tasks, begun, token };
        match number {
            Some(_) => {
                workers::hold(&self.site, self.needs, &mut term);
                parts.owners.all().iter().for_each(|owner| term.begin_for(&self.site, owner));
            }
            None => workers::follow(&self.site, self.needs, &mut term),
        }
        self.term = Some(term);
    }

    fn opened(&mut self, owner: &Arc<Owner>) {
        if let Some(term) = self.term.as_mut().filter(|term| term.number.is_some()) {
            term.begin_for(&self.site, owner);
        }
    }

    fn tell(&self, number: Option<u64>) {
        let hub = &self.site.parts.hub;
        let (level, text) = match number {
            Some(number) => (NoticeLevel::Info, format!("this worker holds lease {number}: it anchors and verifies")),
            // It gives the lease up.
            None if self.site.parts.life.is_ending() => return,
            None => {
                let text =
                    "this worker no longer holds the lease, so it anchors and verifies nothing until it takes it again";
                (NoticeLevel::Warning, text.to_owned())
            }
        };
        hub.notice_about(ABOUT, level, &text);
        hub.changed(Part::Health);
    }

    /// Claims no lease as long as work of the last one goes on.
    async fn beat(&mut self) {
        // What only looks into the store is no worker.
        if !self.needs.chain {
            return;
        }
        if let Some(ended) = self.beating.take_if(|beating| beating.is_finished())
            && let Ok(Err(failure)) = ended.await
        {
            let text = format!("this worker gave no sign of life: {}", failure.message);
            self.site.parts.hub.notice_about(ABOUT, NoticeLevel::Error, &text);
        }
        if self.beating.is_some() || Instant::now() < self.due {
            return;
        }
        self.due = Instant::now() + BEAT;
        let claim = match self.term.as_ref().and_then(|term| term.number) {
            Some(_) => Claim::Renew,
            None if self.former.strong_count() == 0 => Claim::Take,
            None => Claim::Nothing,
        };
        let (ledger, home) = (self.site.plant.ledger.clone(), self.site.parts.home.clone());
        let settings = self.site.parts.config.alike();
        let name = worker_name(self.site.gateway.served().map(|view| view.address).as_deref());
        let beat = move || -> Result<()> {
            let claim = if may_hold(&ledger, &home)? { claim } else { Claim::Nothing };
            ledger.lease.beat(&name, claim)?;
            // What other workers compare theirs with.
            if ledger.lease.held().is_some() && ledger.notes.read(&HoldersSettings {})?.as_ref() != Some(&settings) {
                ledger.notes.write(&HoldersSettings {}, &settings)?;
            }
            Ok(())
        };
        self.beating = Some(tokio::task::spawn_blocking(beat));
    }
}

/// This machine's name, with the address that the gateway listens on.
pub(super) fn worker_name(address: Option<&str>) -> String {
    let host = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let host = if host.trim().is_empty() { "unknown" } else { host.trim() };
    address.map_or_else(|| host.to_owned(), |address| format!("{host} {address}"))
}

pub(super) fn view(state: LeaseState) -> LeaseView {
    let worker = |Worker { name, is_own, silent }| WorkerView { name, is_own, silent };
    let LeaseState { number, holder, since, workers } = state;
    let since = holder.as_ref().map(|_| since);
    let (holder, workers) = (holder.map(worker), workers.into_iter().map(worker).collect());
    LeaseView { number, holder, since, workers, unlike: Vec::new() }
}

/// Who holds it, in words; `Failed` if nobody does.
pub(crate) fn standing(state: &LeaseState) -> (HealthLevel, String) {
    let workers = counted(state.workers.len() as u64, "worker");
    match &state.holder {
        Some(holder) if holder.is_own => (HealthLevel::Ok, format!("held here, {workers}")),
        Some(holder) => (HealthLevel::Ok, format!("held by {}, {workers}", holder.name)),
        None => (HealthLevel::Failed, format!("no worker holds it, so nothing is anchored or verified, {workers}")),
    }
}

impl Site {
    /// `None` on a file.
    pub(super) fn lease_health(&self) -> Result<Option<PartHealth>> {
        let Some(lease) = self.plant.ledger.lease.state()? else { return Ok(None) };
        let (level, text) = standing(&lease);
        Ok(Some(PartHealth { since: view(lease).since, ..PartHealth::new(ABOUT, level, &text) }))
    }
}

#[cfg(test)]
mod tests {
    use tokio::sync::Notify;

    use super::*;
    use crate::site::testing::Ground;

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn work_ends_with_its_term_and_is_shown_no_more() {
        let ground = Ground::with(&[]);
        let (supervisor, owners) = (Arc::clone(&ground.parts.supervisor), Arc::clone(&ground.parts.owners));
        let (tasks, begun, token) = (Vec::new(), Vec::new(), Arc::default());
        let mut term = Term { number: Some(1), supervisor, owners, tasks, begun, token };
        let going = Arc::new(Notify::new());
        term.keep("work", &going, |going| async move {
            going.notify_one();
            std::future::pending::<()>().await;
        });
        going.notified().await;
        let (supervisor, left) = (Arc::clone(&ground.parts.supervisor), Arc::downgrade(&term.token));
        assert_eq!((supervisor.views().len(), left.strong_count() > 1), (1, true));
        drop(term);
        while left.strong_count() > 0 || !supervisor.views().is_empty() {
            tokio::task::yield_now().await;
        }
    }
}

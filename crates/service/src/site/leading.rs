//! The lease of the store in this site: it is renewed or taken here, and the holder's work begins and ends with it. The site of
//! a file holds it from its beginning to its end.

use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

use tokio::sync::mpsc;
use tokio::task::{JoinHandle, block_in_place};

use super::chain::link;
use super::supervision::Supervisor;
use crate::chain::{BlockRef, ChainError};
use crate::hub::Hub;
use crate::model::{counted, locked};
use crate::pipeline::anchorer::Anchorer;
use crate::pipeline::stages::Stage;
use crate::pipeline::{Directory, Network, Owner, PipelineError, network_pin, verifier, watcher};
use crate::reply::{Failure, HealthLevel, LeaseView, NoticeLevel, Part, PartHealth, Result, WorkerView};
use crate::site::storage::may_hold;
use crate::site::{
    Administering, Audit, ChainProofs, Clock, Connection, Devices, Joined, Lanes, Needs, NetworkState, Quarantine,
    RosSide, Sharing, Site, Standstill, Storage, TimeStamps, identity,
};
use crate::store::notes::HoldersSettings;
use crate::store::{BEAT, Claim, LeaseState, StoreError, Worker};

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
            hold_for(site, owner, self);
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
                hold(&self.site, self.needs, &mut term);
                parts.owners.all().iter().for_each(|owner| term.begin_for(&self.site, owner));
            }
            None => follow(&self.site, self.needs, &mut term),
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

/// Between looks of a process that follows the holder of the lease, and after a failure.
const BETWEEN_ROUNDS: Duration = Duration::from_millis(400);
const AWAY: Duration = Duration::from_secs(2);
const BETWEEN_LOOKS_AT_OTHERS: Duration = Duration::from_secs(1);

/// Shortest interval between looks at an owner's records: each queries all of the owner's topics.
const BETWEEN_LOOKS: Duration = Duration::from_millis(25);

/// Pause after a look, as a multiple of its length: with many topics a look is slow.
const TIMES_A_LOOK: u32 = 4;

pub(super) fn start(site: &Arc<Site>, needs: Needs, opened: mpsc::UnboundedReceiver<Arc<Owner>>) -> Result<()> {
    let supervisor = &site.parts.supervisor;
    supervisor.keep("news", &site.parts.hub, Hub::run);
    if site.parts.home.original().is_some() {
        // This site only reads: it captures, sends and keeps nothing.
        if needs.chain {
            supervisor.keep("chain", &site.connection, Connection::keep_connected);
        }
        return Ok(());
    }
    supervisor.keep("audit", &site.audit, Audit::keep);
    supervisor.keep("room", &site.storage, Storage::keep_room);
    supervisor.keep("clock", &site.clock, Clock::keep);
    tokio::spawn(Arc::clone(&site.storage).check_after_crash());
    if needs.ros {
        site.sealer.begin()?;
        let task = supervisor.keep_while("ros", &site.ros, |ros| ros.is_wanted(), RosSide::keep);
        *locked(&site.ros_task) = Some(task);
    }
    if needs.chain {
        supervisor.keep("chain", &site.connection, Connection::keep_connected);
    }
    if site.plant.ledger.lease.is_shared() {
        supervisor.keep("others", site, look_at_others);
    }
    lead(site, needs, opened);
    Ok(())
}

/// What one site does for all that share its store, as long as it holds the lease.
pub(super) fn hold(site: &Arc<Site>, needs: Needs, term: &mut Term) {
    term.keep("quarantine", &site.quarantine, Quarantine::keep);
    term.keep("retention", &site.storage, Storage::keep_retention);
    term.keep("heads", &site.audit, Audit::keep_heads);
    if needs.chain {
        term.keep("owners", site, resume_owners);
        term.keep("watcher", site, watch);
        if site.stamps.is_wanted() {
            term.keep("time stamps", &site.stamps, TimeStamps::keep);
        }
        term.keep("chain proofs", &site.chain_proofs, ChainProofs::keep);
        term.keep("verifier", site, verify);
        term.keep("stages", &site.standstill, Standstill::keep);
        term.keep("scrubber", &site.audit, Audit::keep_scrubbing);
        term.keep("expiry", &site.sharing, Sharing::keep_settled);
        term.keep("parties", &site.administering, Administering::keep_parties_known);
    }
}

/// The same for one open owner.
pub(super) fn hold_for(site: &Arc<Site>, owner: &Arc<Owner>, term: &mut Term) {
    term.keep_for(owner, "anchorer", site, anchor);
    if site.parts.config.lanes > 1 {
        term.keep_for(owner, "lanes", &site.lanes, Lanes::keep_extra);
    }
    term.keep_for(owner, "courier", &site.devices, Devices::keep_attending);
    if site.joined.remote.is_some() {
        term.keep_for(owner, "mirror", &site.joined, Joined::mirror);
    }
}

/// What one does that does not hold it.
pub(super) fn follow(site: &Arc<Site>, needs: Needs, term: &mut Term) {
    site.standstill.forget();
    site.parts.sender.forget();
    if needs.chain {
        term.keep("follower", site, follow_holder);
    }
}

async fn watch(site: Arc<Site>) {
    let (mut seen, mut state) = (0, site.parts.link.follow());
    let mut is_taken_over = !site.plant.ledger.lease.is_shared();
    while !site.parts.life.is_stopping() {
        let Some(network) = site.parts.link.network_now() else {
            if state.changed().await.is_err() {
                return;
            }
            continue;
        };
        let begun = Instant::now();
        let taken_over = match is_taken_over {
            true => Ok(()),
            false => block_in_place(|| watcher::take_over(&site.plant, &network)),
        };
        is_taken_over = taken_over.is_ok();
        let round = match taken_over {
            Ok(()) => watcher::watch_round(&site.plant, &network).await,
            Err(error) => Err(error),
        };
        let pause = match round {
            Ok(head) => {
                site.parts.hub.stages.spent(Stage::Watch, begun.elapsed());
                see(&site, &network, (head, begun), &mut seen).await;
                site.lanes.tend(&network).await;
                network.chain.next_block(head.number, watcher::PATIENCE).await.err().map(|error| away(&error))
            }
            Err(PipelineError::Chain(error @ ChainError::Swapped { .. })) => {
                site.parts.link.lose_chain(error.into());
                continue;
            }
            Err(error @ PipelineError::NodeBehind { .. }) => {
                Some(format!("the chain's node is behind; anchoring is paused, records are safe: {error}"))
            }
            Err(error @ PipelineError::Chain(_)) => Some(away(&error)),
            Err(error) => {
                let text = format!("the chain is not followed now; anchoring is paused, records are safe: {error}");
                site.tell_unread(&error, &text);
                tokio::time::sleep(AWAY).await;
                continue;
            }
        };
        if let Some(problem) = pause {
            site.parts.link.answers(false);
            site.parts.hub.notice_about(link::ABOUT, NoticeLevel::Error, &problem);
            tokio::time::sleep(AWAY).await;
        }
    }
}

impl Site {
    /// Only what is the chain's trouble ends with its next answer.
    fn tell_unread(&self, error: &PipelineError, text: &str) {
        match error {
            // This worker's work for all ends.
            PipelineError::Store(StoreError::NotHolder { .. }) => {}
            PipelineError::Store(_) => self.parts.hub.alarm(text),
            _ => {
                self.parts.link.answers(false);
                self.parts.hub.notice_about(link::ABOUT, NoticeLevel::Error, text);
            }
        }
    }
}

/// The head was requested at `begun` at the earliest. Those waiting for its block look next.
async fn see(site: &Site, network: &Network, (head, begun): (BlockRef, Instant), seen: &mut u64) {
    site.parts.link.saw_head(head, begun);
    site.parts.link.has_scanned(head.number);
    site.parts.link.answers(true);
    // Only a gateway needs this, and it costs a few requests.
    if site.gateway.is_serving() {
        site.parts.link.measure(&network.chain).await;
    }
    if std::mem::replace(seen, head.number) != head.number {
        site.parts.hub.changed(Part::Chain);
        site.parts.hub.confirmed.notify_one();
    }
}

/// Reads from the store what the holder of the lease reads from the chain.
async fn follow_holder(site: Arc<Site>) {
    let (mut follower, mut seen, mut known) = (watcher::Follower::default(), 0, None::<Arc<Directory>>);
    let mut pause = Duration::ZERO;
    while site.parts.life.rest(pause).await {
        pause = BETWEEN_ROUNDS;
        let Some(network) = site.parts.link.network_now() else { continue };
        if !known.as_ref().is_some_and(|known| Arc::ptr_eq(known, &network.directory)) {
            (follower, known) = (watcher::Follower::default(), Some(Arc::clone(&network.directory)));
        }
        let begun = Instant::now();
        match follower.round(&site.plant, &network).await {
            Ok(Some(head)) => see(&site, &network, (head, begun), &mut seen).await,
            // The holder reads it next.
            Ok(None) => pause = BETWEEN_ROUNDS / 2,
            Err(error) => {
                let text = format!("the chain's state is not known here, and reading is refused meanwhile: {error}");
                site.tell_unread(&error, &text);
                pause = AWAY;
            }
        }
    }
}

/// What other processes changed in the store and this one keeps in memory.
async fn look_at_others(site: Arc<Site>) {
    let mut head = 0;
    while site.parts.life.rest(BETWEEN_LOOKS_AT_OTHERS).await {
        let looked = block_in_place(|| {
            site.admissions.open()?;
            let ledger = &site.plant.ledger;
            if ledger.lease.held().is_some() {
                ledger.feed.number_waiting()?;
            }
            Ok::<_, Failure>((ledger.feed.head()?, network_pin(&ledger.rights)?.is_some()))
        });
        match looked {
            Ok((newest, is_bound)) => {
                if std::mem::replace(&mut head, newest) != newest {
                    site.parts.hub.feed_changed();
                }
                if is_bound && matches!(*site.parts.link.state(), NetworkState::Bare(_)) {
                    site.parts.link.set(NetworkState::Connecting);
                }
            }
            Err(failure) => {
                site.parts.hub.warn(&format!("what other workers changed is not seen here: {}", failure.message));
            }
        }
    }
}

fn away(error: &dyn std::fmt::Display) -> String {
    format!("the chain does not answer; anchoring is paused, records are safe: {error}")
}

async fn verify(site: Arc<Site>) {
    while !site.parts.life.is_stopping() {
        tokio::select! {
            () = site.parts.hub.confirmed.notified() => {}
            () = tokio::time::sleep(Duration::from_secs(1)) => {}
        }
        while let Some(network) = site.parts.link.network_now() {
            // If it is still at work when the lease is lost, the states it expects keep it from harm.
            let plant = site.plant.clone();
            let round = tokio::task::spawn_blocking(move || verifier::verify_round(&plant, &network)).await;
            match round {
                Ok(Ok(0)) => break,
                Ok(Ok(_)) => {}
                Ok(Err(error)) => {
                    site.parts.hub.alarm(&format!("records cannot be verified at the moment and are waiting: {error}"));
                    tokio::time::sleep(Duration::from_secs(1)).await;
                    break;
                }
                // The supervisor reports a panic and recovers.
                Err(error) => return pass_on(error),
            }
        }
    }
}

/// Turns a panic of a part into a panic of the whole task.
fn pass_on(error: tokio::task::JoinError) {
    if let Ok(panic) = error.try_into_panic() {
        std::panic::resume_unwind(panic);
    }
}

/// Resumes at each open owner's state on the chain, whenever the network comes up.
async fn resume_owners(site: Arc<Site>) {
    let mut state = site.parts.link.follow();
    while !site.parts.life.is_stopping() {
        tokio::select! {
            up = state.wait_for(|state| matches!(state, NetworkState::Up(_))) => if up.is_err() { return },
            () = site.parts.life.stopped() => return,
        }
        for owner in site.parts.owners.all() {
            if let Err(failure) = site.profiles.resume(&owner).await {
                site.parts.hub.alarm(&failure.message);
            }
        }
        if state.changed().await.is_err() {
            return;
        }
    }
}

/// Anchors one owner's records until the owner is closed or the site ends.
async fn anchor(site: Arc<Site>, owner: Arc<Owner>) {
    let mut pause = Duration::from_millis(250);
    let mut anchorer = Anchorer::new(site.parts.config.anchor_mode);
    let mut scanned = site.parts.link.scans();
    while !site.parts.life.is_stopping() && site.parts.owners.is_open(&owner) {
        let Some(network) = site.parts.link.network_now() else {
            tokio::time::sleep(Duration::from_millis(200)).await;
            continue;
        };
        // Subscribed before the round, so that nothing stored meanwhile is missed.
        let stored = site.parts.hub.stored.notified();
        let begun = Instant::now();
        let round = async {
            let lanes = site.lanes.of(&owner, &network)?;
            let (sender, account) = (&site.parts.sender, owner.address);
            Ok::<_, Failure>(anchorer.round(&site.plant, &network, sender, account, &lanes).await?)
        };
        match round.await {
            Ok(round) => {
                site.parts.hub.stages.spent(Stage::Anchor, begun.elapsed());
                pause = Duration::from_millis(250);
                if round.submitted > 0 {
                    site.parts.hub.changed(Part::Uploads);
                }
                if !round.next.is_zero() {
                    let look = if round.submitted == 0 { begun.elapsed() } else { Duration::ZERO };
                    let rest = round.next.min(BETWEEN_LOOKS.max(look * TIMES_A_LOOK));
                    tokio::time::sleep(rest).await;
                    tokio::select! {
                        () = stored => {}
                        // A block may have freed a lane.
                        _ = scanned.changed() => {}
                        () = tokio::time::sleep(round.next.saturating_sub(rest)) => {}
                    }
                }
            }
            Err(error) => {
                let why = format!("records of {} are waiting to be anchored: {}", owner.profile, error.message);
                link::tell_trouble(&site.parts.hub, error.kind, &why);
                tokio::time::sleep(pause).await;
                pause = (pause * 2).min(Duration::from_secs(5));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use tokio::sync::Notify;

    use super::*;
    use crate::reply::Event;
    use crate::site::testing::{Ground, site_with_chain};

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn a_database_that_is_away_is_not_taken_for_a_silent_chain() {
        let (site, _folder) = site_with_chain();
        let (mut events, server) = (site.events(), std::path::PathBuf::from("postgres://db/fleet"));
        site.tell_unread(&StoreError::NotHolder { server: server.clone() }.into(), "another holds the lease");
        let away = StoreError::ServerAway { server, detail: "refused".to_owned() };
        site.tell_unread(&away.into(), "the database is away");
        let subject = loop {
            match events.recv().await.expect("the site is there") {
                Event::Notice { text, about, .. } if text == "the database is away" => break about,
                Event::Notice { text, .. } => assert_ne!(text, "another holds the lease"),
                Event::Changed { .. } => {}
            }
        };
        assert!(subject.is_none() && !site.parts.link.is_silent());
        site.stop().await;
    }

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

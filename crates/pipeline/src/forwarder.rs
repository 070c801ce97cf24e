//! The durable outbox of a robot: passes records to a gateway and follows its feed until they are verified there.
//! `submitted` has the gateway's signed receipt; only after `verified` is the local ciphertext deleted.

mod line;

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use tokio::sync::{Notify, watch};
use tokio::task::block_in_place;

use self::line::{Line, Outbox};
use crate::crypto::{CryptoError, GatewayAccess};
use crate::gateway::feed::{FeedId, MOST_NAMED};
use crate::gateway::{
    Client, Code, Context, Credentials, Endpoint, Feed, FeedEntry, FeedPage, GatewayError, Place, Trust,
};
use crate::model::{Address, Digest, ErrorKind, Fact, Header, ProfileName, RecordState, RecorderId, Token, counted};
use crate::store::{KeptStanding, RecordRow};
use crate::{PipelineError, Plant, Result, chain::AnchorProof, chain::merkle::Leaf, store::notes::ProofsTaken};

/// The longest pause before a record refused for its own sake is sent again.
const LONGEST_RETRY: Duration = Duration::from_secs(3600);
/// How long a gateway with several addresses may take to answer at one: robots turn to the next within ten seconds.
const PATIENCE_OF_SEVERAL: Duration = Duration::from_secs(5);

/// How long the robot keeps ciphertext that its gateway also holds.
#[derive(Debug, Clone)]
pub struct CopyKeeping {
    /// After the inclusion proof was checked and the gateway has signed that the record is verified.
    pub time: Duration,
    /// With less room than this on the disk, such copies are deleted early, oldest first.
    pub reserve: u64,
}

impl Default for CopyKeeping {
    fn default() -> Self {
        Self { time: Duration::from_secs(7 * 24 * 3600), reserve: 0 }
    }
}

#[derive(Debug, Clone, Copy)]
pub struct Pace {
    /// Pause after the first failure; it doubles, up to `longest_pause`.
    pub first_pause: Duration,
    pub longest_pause: Duration,
    /// The time between two looks at the gateway's feed.
    pub check: Duration,
    /// The time between two searches for copies that may be deleted.
    pub tidy: Duration,
    /// Before a record refused for its own sake is sent again; it doubles, up to [`LONGEST_RETRY`].
    pub retry: Duration,
}

impl Default for Pace {
    fn default() -> Self {
        Self {
            first_pause: Duration::from_millis(250),
            longest_pause: Duration::from_secs(5),
            check: Duration::from_secs(1),
            tidy: Duration::from_secs(10),
            retry: Duration::from_secs(60),
        }
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Link {
    Connecting,
    Up,
    /// Connected at an address that is not the first: which, and in place of which.
    InPlace(String),
    /// It does not answer; meanwhile the outbox grows.
    Away(String),
    /// It answers but refuses this robot as such; the robot tries again at long intervals.
    Refused(String),
}

/// What a session does besides uploads and checks, periodically.
#[async_trait::async_trait]
pub trait Errand: Send {
    async fn begin(&mut self, client: &mut Client) -> Result<(), ForwardError>;

    async fn run(&mut self, client: &mut Client) -> Result<(), ForwardError>;
}

#[derive(Debug, thiserror::Error)]
pub enum ForwardError {
    #[error(transparent)]
    Gateway(#[from] GatewayError),
    #[error(transparent)]
    Here(#[from] PipelineError),
}

impl From<crate::store::StoreError> for ForwardError {
    fn from(error: crate::store::StoreError) -> Self {
        Self::Here(error.into())
    }
}

impl ForwardError {
    fn link(&self, owner: Address) -> Link {
        let text = self.to_string();
        match self {
            Self::Gateway(GatewayError::Recalled(at)) => Link::Refused(format!(
                "{owner} revoked this robot at {at}: what it records now is not accepted; ask that owner to enrol it again \
                 (`authros robot enrol`)"
            )),
            Self::Gateway(error) if error.kind() == ErrorKind::Refused => Link::Refused(text),
            _ => Link::Away(text),
        }
    }
}

#[derive(Clone)]
struct Gate {
    endpoint: Endpoint,
    /// The robot's name and K_T there.
    credentials: Credentials,
    trust: Trust,
    /// The file that records what was seen of it.
    trust_file: PathBuf,
}

#[derive(Clone)]
pub struct Robot {
    pub owner: Address,
    pub context: Context,
    pub name: ProfileName,
    pub token: Token,
    /// How long the gateway may take to answer; with several addresses it gets at most five seconds at each.
    pub patience: Duration,
    pub home: PathBuf,
}

impl Robot {
    fn gate(&self, access: &GatewayAccess) -> Result<Gate, CryptoError> {
        let (trust_file, addresses) = (self.home.join("gateway.json"), access.addresses.clone());
        let trust = trust_in(&trust_file, access.fingerprint)?;
        let credentials = Credentials { name: self.name.clone(), key: access.transport.clone(), token: self.token };
        let patience = if addresses.len() > 1 { self.patience.min(PATIENCE_OF_SEVERAL) } else { self.patience };
        let endpoint = Endpoint { addresses, context: self.context, patience, source: None };
        Ok(Gate { endpoint, credentials, trust, trust_file })
    }
}

pub struct Forwarder {
    outbox: Outbox,
    robot: Robot,
    gate: Gate,
    link: watch::Sender<Link>,
    errand: Option<Box<dyn Errand>>,
    named: Option<watch::Receiver<GatewayAccess>>,
}

impl Forwarder {
    /// [`CryptoError::NotAKey`] if the home is another robot's.
    pub fn new(plant: Plant, robot: Robot, access: &GatewayAccess) -> Result<Self, CryptoError> {
        let gate = robot.gate(access)?;
        let (outbox, link) = (Outbox::new(plant, robot.home.clone()), watch::channel(Link::Connecting).0);
        Ok(Self { outbox, robot, gate, link, errand: None, named: None })
    }

    pub fn keeping(mut self, keeping: CopyKeeping) -> Self {
        self.outbox.keeping = keeping;
        self
    }

    pub fn with_errand(self, errand: Box<dyn Errand>) -> Self {
        Self { errand: Some(errand), ..self }
    }

    pub fn following(self, named: watch::Receiver<GatewayAccess>) -> Self {
        Self { named: Some(named), ..self }
    }

    pub fn link(&self) -> watch::Receiver<Link> {
        self.link.subscribe()
    }

    pub fn refused(&self) -> Arc<Mutex<HashSet<Digest>>> {
        Arc::clone(&self.outbox.refused)
    }

    /// Deletes ciphertext proven long enough ago, on a full disk the oldest early. What the gateway has not signed for
    /// stays.
    pub fn tidy(&self) -> Result<()> {
        self.outbox.tidy()
    }

    /// Works until it is dropped; `stored` signals when records wait. Can be cancelled at any point.
    pub async fn run(&mut self, stored: &Notify) {
        loop {
            let outbox = (&mut self.outbox, self.robot.owner);
            let mut line = Line::new(outbox, self.gate.clone(), self.link.clone(), &mut self.errand);
            tokio::select! {
                never = line.run(stored) => match never {},
                () = changed(&mut self.named) => {}
            }
            self.apply_addresses();
        }
    }

    fn apply_addresses(&mut self) {
        let Some(named) = &mut self.named else { return };
        let access = named.borrow_and_update().clone();
        match self.robot.gate(&access) {
            Ok(gate) => self.gate = gate,
            Err(error) => {
                let text = format!("the gateway's new addresses cannot be used, the old ones stay: {error}");
                self.outbox.plant.observer.alert(true, text);
            }
        }
    }
}

async fn changed(named: &mut Option<watch::Receiver<GatewayAccess>>) {
    if let Some(named) = named
        && named.changed().await.is_ok()
    {
        return;
    }
    std::future::pending().await
}

/// Whether a refusal concerns the record itself, so that others may pass.
fn is_about_a_record(error: &GatewayError) -> bool {
    matches!(
        error,
        GatewayError::TooLarge(_) | GatewayError::Refused(Code::Malformed | Code::NotYours | Code::Tampered)
    )
}

fn trust_in(file: &Path, fingerprint: crate::model::SignerId) -> Result<Trust, CryptoError> {
    if !file.exists() {
        return Ok(Trust::pinned(fingerprint));
    }
    let trust = Trust::load(file)?;
    if trust.pinned == Some(fingerprint) {
        return Ok(trust);
    }
    let found = "it names a different gateway than the enrolment; use another --home for this enrolment".to_owned();
    Err(CryptoError::NotAKey { path: crate::crypto::error::shown(file), wanted: "the note of this gateway", found })
}

/// Records in one question to the gateway.
const PAGE: usize = 256;
/// Pages of the feed taken between two looks at the outbox.
const MOST_PAGES: usize = 8;
/// Checks of the feed between two questions whether the gateway still has what it signed for.
const SWEEP: u32 = 60;

/// What a robot learns of its records: the gateway's feed, cut to what was numbered here.
#[derive(Debug)]
struct Proofs {
    owner: Address,
    id: FeedId,
    /// The highest number read so far: rows of a recorder that was not known by then come after it.
    newest: u64,
    /// Who numbered what waits here: every start of a ring is another one.
    recorders: BTreeMap<RecorderId, Told>,
    /// Where the next look for lost records begins, while one is under way.
    sweep: Option<i64>,
    swept: Option<Instant>,
}

#[derive(Debug, Clone, Copy, Default)]
struct Told {
    place: u64,
    /// The lowest number of an entry that could not be dealt with: its proof does not hold, or its receipt was lost.
    held: Option<u64>,
    again: Option<Instant>,
    pause: Duration,
}

impl Told {
    /// The number up to which all is dealt with.
    fn done(&self) -> u64 {
        self.held.map_or(self.place, |held| self.place.min(held.saturating_sub(1)))
    }
}

impl Proofs {
    /// A place that cannot be read is reported and replaced by the beginning: nothing is lost by that.
    fn load(plant: &Plant, owner: Address) -> Self {
        let kept = plant.ledger.notes.read(&ProofsTaken { owner });
        let kept = kept.inspect_err(|error| plant.observer.alert(true, error.to_string()));
        let (id, newest) = kept.ok().flatten().unwrap_or_default();
        Self { owner, id, newest, recorders: BTreeMap::new(), sweep: None, swept: None }
    }

    fn done(&self) -> u64 {
        self.recorders.values().map(Told::done).min().unwrap_or(self.newest)
    }

    /// Follows these recorders, and goes back for held entries when it is time and the rest was read.
    fn follow(&mut self, recorders: &BTreeSet<RecorderId>, now: Instant) {
        self.recorders.retain(|recorder, _| recorders.contains(recorder));
        for recorder in recorders {
            let told = self.recorders.entry(*recorder).or_insert(Told { place: self.newest, ..Told::default() });
            match told.held {
                _ if told.place < self.newest => {}
                Some(held) if told.again.is_none_or(|again| again <= now) => {
                    (told.place, told.held) = (held.saturating_sub(1), None);
                }
                Some(_) => {}
                None => told.pause = Duration::ZERO,
            }
        }
    }

    /// Recorders that are read up to date, and those that are behind: neither waits for the other.
    fn groups(&self) -> [Vec<RecorderId>; 2] {
        let mut sorted: Vec<(&RecorderId, &Told)> = self.recorders.iter().collect();
        sorted.sort_by_key(|(_, told)| told.place);
        let (behind, live): (Vec<_>, Vec<_>) = sorted.into_iter().partition(|(_, told)| told.place < self.newest);
        [live, behind].map(|group| group.into_iter().take(MOST_NAMED).map(|(recorder, _)| *recorder).collect())
    }

    fn asks(&self, group: &[RecorderId]) -> Option<Feed> {
        let after = group.iter().filter_map(|recorder| self.recorders.get(recorder)).map(|told| told.place).min()?;
        let places = vec![Place { owner: self.owner, after, grant: 0 }];
        Some(Feed { id: self.id, recorders: group.to_vec(), places, ..Feed::of(self.owner) })
    }

    /// Returns whether the feed is another one than it was.
    fn took(&mut self, page: &FeedPage, asked: &Feed) -> bool {
        if page.is_anew {
            self.newest = 0;
            self.recorders.values_mut().for_each(|told| *told = Told::default());
        }
        for recorder in &asked.recorders {
            self.recorders.entry(*recorder).and_modify(|told| told.place = told.place.max(page.upto));
        }
        (self.id, self.newest) = (page.id, self.newest.max(page.upto));
        page.is_anew
    }

    fn hold(&mut self, (recorder, number): (RecorderId, u64), first_pause: Duration) {
        let Some(told) = self.recorders.get_mut(&recorder) else { return };
        if told.held.is_none() {
            told.pause = (told.pause * 2).clamp(first_pause, LONGEST_HOLD);
            told.again = Some(Instant::now() + told.pause);
        }
        told.held = Some(told.held.map_or(number, |held| held.min(number)));
    }
}

/// The longest pause before an entry whose proof does not hold is checked again.
const LONGEST_HOLD: Duration = Duration::from_secs(600);

impl Line<'_> {
    /// Follows the feed, and sometimes asks whether the gateway still has what it signed for. Returns whether it was
    /// asked.
    async fn check(&mut self, client: &mut Client) -> Result<bool, ForwardError> {
        let ledger = &self.outbox.plant.ledger;
        if ledger.forwarding.undecided(None, 1)?.rows.is_empty() {
            return Ok(false);
        }
        let recorders = ledger.forwarding.recorders()?;
        self.proofs.follow(&recorders, Instant::now());
        for group in self.proofs.groups() {
            for _ in 0..MOST_PAGES {
                let Some(asked) = self.proofs.asks(&group) else { break };
                let page = client.feed(&asked).await?;
                block_in_place(|| self.told(&page, &asked))?;
                if page.upto == page.head {
                    break;
                }
            }
        }
        self.sweep(client).await?;
        Ok(true)
    }

    fn told(&mut self, page: &FeedPage, asked: &Feed) -> Result<()> {
        let ledger = &self.outbox.plant.ledger;
        let told: Vec<&FeedEntry> = page.entries.iter().filter(|entry| entry.fact != Fact::Stored).collect();
        let rows = ledger.records.find_all(&told.iter().map(|entry| entry.digest).collect::<Vec<_>>())?;
        let (mut proofs, mut doubted, mut early) = (Vec::new(), Vec::new(), Vec::new());
        for (entry, row) in told.into_iter().zip(rows) {
            match row {
                Some(row) if row.state == RecordState::Submitted => match self.holds(&row, &entry.proof) {
                    true => proofs.push((row.digest, entry.proof.clone())),
                    false => doubted.push((row.recorder, entry.number)),
                },
                // Its receipt was lost: it is sent again, and then this counts.
                Some(row) if row.state == RecordState::Stored => early.push((row.recorder, entry.number)),
                _ => {}
            }
        }
        if !doubted.is_empty() {
            let text = format!(
                "the gateway claims to have verified {} that its proofs show in no anchored batch; kept here as unverified",
                counted(doubted.len() as u64, "record")
            );
            self.outbox.plant.observer.alert(true, text);
        }
        let verified: Vec<Digest> = proofs.iter().map(|(digest, _)| *digest).collect();
        if !proofs.is_empty() {
            let statement = page.statement(self.outbox.plant.provider);
            // Before its state changes: a verified record without it would be kept forever.
            ledger.forwarding.keep_proven(KeptStanding {
                time: page.time,
                statement,
                signature: page.signature,
                proofs,
            })?;
            self.moved = true;
        }
        self.decide(&verified, &[], &[])?;
        let before = (self.proofs.id, self.proofs.done());
        if self.proofs.took(page, asked) && before.0 != FeedId::default() {
            // It was restored from a backup: what it signed for since may be gone.
            self.proofs.sweep = Some(0);
        }
        let first_pause = self.outbox.pace.check;
        doubted.into_iter().chain(early).for_each(|entry| self.proofs.hold(entry, first_pause));
        let now = (self.proofs.id, self.proofs.done());
        if now != before && (!page.entries.is_empty() || now.0 != before.0) {
            ledger.notes.write(&ProofsTaken { owner: self.proofs.owner }, &now)?;
        }
        Ok(())
    }

    /// Asks which of the next page of records that the gateway signed for it does not have any more, or only altered.
    async fn sweep(&mut self, client: &mut Client) -> Result<(), ForwardError> {
        if self.proofs.swept.is_none_or(|at| at.elapsed() >= self.outbox.pace.check * SWEEP) {
            let is_first = self.proofs.swept.replace(Instant::now()).is_none();
            if !is_first && self.proofs.sweep.is_none() {
                self.proofs.sweep = Some(0);
            }
        }
        let Some(after) = self.proofs.sweep else { return Ok(()) };
        let page = self.outbox.plant.ledger.forwarding.undecided(Some(after), PAGE)?;
        self.proofs.sweep = page.next;
        let digests: Vec<Digest> = page.rows.iter().map(|row| row.digest).collect();
        if digests.is_empty() {
            return Ok(());
        }
        let missing = client.missing(&digests).await?;
        let of = |wanted: Code| -> Vec<Digest> {
            missing.iter().filter(|(_, code)| *code == wanted).map(|(digest, _)| *digest).collect()
        };
        Ok(block_in_place(|| self.decide(&[], &of(Code::NotFound), &of(Code::Tampered)))?)
    }

    /// Whether a proof leads from the very bytes stored here to the root of an anchored batch.
    fn holds(&self, row: &RecordRow, proof: &[u8]) -> bool {
        let Ok(AnchorProof { inclusion: Some(inclusion), .. }) = AnchorProof::parse(proof) else { return false };
        let Ok(Some(blob)) = self.outbox.plant.ciphertext.get(row.digest) else { return false };
        let Ok((header, _)) = Header::parse(&blob) else { return false };
        let digest = Digest(self.outbox.plant.provider.sm3(&[&blob]));
        digest == row.digest && inclusion.proves(&Leaf::of(&header, digest))
    }

    fn decide(&self, verified: &[Digest], unknown: &[Digest], tampered: &[Digest]) -> Result<()> {
        let (ledger, observer) = (&self.outbox.plant.ledger, &self.outbox.plant.observer);
        if !verified.is_empty() {
            ledger.forwarding.settle(verified, RecordState::Verified)?;
            observer.verified(verified);
        }
        if !unknown.is_empty() && ledger.forwarding.settle(unknown, RecordState::Stored)? > 0 {
            let records = counted(unknown.len() as u64, "record");
            let text = format!(
                "the gateway no longer has what it signed for, {records}: it is sent again, and the receipts are kept"
            );
            observer.alert(true, text);
        }
        if !tampered.is_empty() && ledger.forwarding.settle(tampered, RecordState::Tampered)? > 0 {
            observer.tampered(tampered);
            let records = counted(tampered.len() as u64, "record");
            let text = format!("altered at the gateway after it signed: {records}; the originals are kept here");
            observer.alert(true, text);
        }
        if !(verified.is_empty() && unknown.is_empty() && tampered.is_empty()) {
            observer.records_changed();
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;

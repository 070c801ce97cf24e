//! Data on the disk: space for it, retention, and integrity after a crash.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use tokio::task::block_in_place;

use crate::command::{ErasureWishes, UploadQuery};
use crate::crypto::{JoinKey, read_public};
use crate::model::{Address, ByteSize, Digest, ProfileName, RecordKind, RecordState, Timestamp, clean, counted};
use crate::paths::Home;
use crate::pipeline::importer::SOURCE;
use crate::pipeline::retention::{self, LONGEST_REASON, Retention, Round};
use crate::pipeline::{Owner, Plant, Reader, network_pin};
use crate::reply::{ErasureView, Failure, NoticeLevel, Part, Result, input, refused};
use crate::site::recordings::RECORDING;
use crate::site::{Parts, Reading};
use crate::store::files::free_bytes;
use crate::store::notes::{ProfileAccounts, SharedSystemKeys, StoreWasGone};
use crate::store::{Erasure, IncidentRow, Ledger, RecordQuery, RecordRow, Reserve, StoreError};

/// Shortest and longest interval between looks at the disk.
const LOOKS: (Duration, Duration) = (Duration::from_millis(250), Duration::from_secs(2));
/// Assumed fastest fill rate of a disk, bytes a second.
const FASTEST: u64 = 1 << 30;
/// Bytes set aside for states; each takes a few hundred.
const MOST_FOR_STATES: u64 = 4 << 20;
/// With less free space, what is set aside is released.
const LAST: u64 = 512 << 10;
/// Records re-read from the store: a crash can only have touched what was written last.
const NEWEST: usize = 256;
/// Time for the process that started the site to listen.
const LISTENING: Duration = Duration::from_millis(500);

pub(in crate::site) struct Storage {
    parts: Parts,
    /// Space for the states of records on a full disk.
    states: Reserve,
    reading: Arc<Reading>,
    /// Records are named one caller at a time.
    naming: tokio::sync::Mutex<()>,
    /// Named ciphertext may be left to delete.
    has_named: AtomicBool,
    /// Records that owners elsewhere erased and incidents hold, as of the last look.
    held: AtomicU64,
}

impl Storage {
    pub fn new(parts: &Parts, reading: &Arc<Reading>) -> Self {
        Self {
            parts: parts.clone(),
            states: working_reserve(&parts.home, parts.config.disk_reserve),
            reading: Arc::clone(reading),
            naming: tokio::sync::Mutex::default(),
            has_named: AtomicBool::new(true),
            held: AtomicU64::new(0),
        }
    }

    /// Watches the free space on the disk, and the cache.
    pub async fn keep_room(self: Arc<Self>) {
        let (mut held, mut pause, mut away) = (None, LOOKS.0, None);
        let reserve = self.parts.config.disk_reserve;
        while self.parts.life.beat(pause).await {
            let now_away = self.parts.plant.ciphertext.cache().and_then(|cache| cache.away).map(|away| away.since);
            if std::mem::replace(&mut away, now_away) != now_away {
                self.parts.hub.changed(Part::Health);
            }
            if self.parts.is_on_server() {
                pause = LOOKS.1;
                continue;
            }
            let Ok(free) = block_in_place(|| free_bytes(self.parts.home.root())) else { continue };
            pause = if free.saturating_sub(reserve) / FASTEST > LOOKS.1.as_secs() { LOOKS.1 } else { LOOKS.0 };
            if free < reserve && held.is_none() {
                held = Some(self.parts.plant.ledger.records.hold());
                self.tell_room(NoticeLevel::Error, &self.full_text(free));
            }
            if free < reserve.min(LAST) && self.states.is_held() {
                // Removing a file takes no space.
                drop(block_in_place(|| self.states.release()));
            }
            // More than the reserve, so that it does not flutter.
            if free >= reserve.saturating_add(reserve / 4) {
                if held.take().is_some() {
                    self.tell_room(NoticeLevel::Info, "there is disk space again: records are accepted again");
                }
                if !self.states.is_held() && free >= reserve.saturating_add(MOST_FOR_STATES) {
                    drop(block_in_place(|| self.states.refill()));
                }
            }
        }
    }

    fn tell_room(&self, level: NoticeLevel, text: &str) {
        self.parts.hub.notice(level, text);
        self.parts.hub.changed(Part::Health);
    }

    fn full_text(&self, free: u64) -> String {
        format!(
            "the disk of {} has {} left, less than disk.reserve ({}): no further record is acknowledged; captured \
             messages wait in memory, and those that do not fit are dropped and counted; free some space, then capture \
             resumes automatically",
            self.parts.home.root().display(),
            ByteSize(free),
            ByteSize(self.parts.config.disk_reserve)
        )
    }

    /// The store refuses records, or replaced a lost one.
    pub fn fault(&self) -> Result<Option<String>> {
        if self.parts.plant.ledger.records.takes_records().is_err() {
            return Ok(Some(self.full_text(free_bytes(self.parts.home.root()).unwrap_or(0))));
        }
        let ledger = &self.parts.plant.ledger;
        let missed = ledger.notes.read(&StoreWasGone {})?;
        let unbound = missed.is_some() && network_pin(&ledger.rights)?.is_none();
        Ok(missed.filter(|_| unbound).map(|missed| format!("{}; {STORE_LOST}", store_loss(&self.parts.home, missed))))
    }

    pub async fn tell_of_copy(self: Arc<Self>) {
        let (what, text) = match self.parts.is_on_server() {
            true => (
                "restored database",
                "the database was restored to an earlier time: it lacks what this home had committed there. Own records are \
                 numbered under a new recorder, readers read the feed from its beginning, and robots send again what they \
                 still have",
            ),
            false => (
                "copied home",
                "this home is a copy: its ledger is not the file it was when last used. New records are numbered under a \
                 new recorder; do not run it at the same time as the original",
            ),
        };
        if let Ok(profile) = "site".parse::<ProfileName>() {
            let written = self.parts.log.write(&profile, what, "a new recorder begins", "noticed").await;
            if let Err(failure) = written {
                self.parts.hub.alarm(&failure.message);
            }
        }
        tokio::time::sleep(LISTENING).await;
        self.parts.hub.warn(text);
    }

    /// Checks once, in the background, if the previous run did not close its files.
    pub async fn check_after_crash(self: Arc<Self>) {
        if self.parts.plant.ledger.inspection.ended_cleanly() {
            return;
        }
        match block_in_place(|| contradictions(&self.parts.plant)) {
            Ok(found) if found.is_empty() => {
                self.parts.hub.inform("the previous run did not shut down cleanly; the store is sound");
            }
            Ok(found) => found.iter().for_each(|text| self.parts.hub.alarm(text)),
            Err(failure) => {
                self.parts.hub.alarm(&format!(
                    "after an unclean shutdown it could not be checked whether everything is there: {}",
                    failure.message
                ));
            }
        }
    }
}

/// The ledger of a home, if need be with the space set aside for states. The second value: the home is a copy.
pub(in crate::site) fn open_ledger(home: &Home) -> Result<(Ledger, bool), StoreError> {
    if home.original().is_some() {
        // A read-only home records nothing, so it needs no recorder of its own.
        return Ok((Ledger::open(&home.ledger())?, false));
    }
    let missed = misses_store(home);
    let opened = match Ledger::open_in_place(&home.ledger()) {
        Err(StoreError::DiskFull { .. }) if std::fs::remove_file(home.working_reserve()).is_ok() => {
            Ledger::open_in_place(&home.ledger())
        }
        opened => opened,
    }?;
    if missed {
        opened.0.notes.write(&StoreWasGone {}, &Timestamp::now())?;
    }
    Ok(opened)
}

/// Whether a home without a store, or with an empty file for one, must have had one: it has keys or an embedded chain.
pub(crate) fn misses_store(home: &Home) -> bool {
    let is_empty = std::fs::metadata(home.ledger()).is_ok_and(|file| file.len() == 0);
    (is_empty || !home.ledger().exists()) && (home.chain().join("chain.db").exists() || !home.profiles().is_empty())
}

/// What is wrong with a store that replaced a lost one, until it is bound to a contract.
pub(crate) fn store_loss(home: &Home, missed: Timestamp) -> String {
    format!("{} was gone at {missed}, and its records with it", home.ledger().display())
}

pub(crate) const STORE_LOST: &str =
    "restore the last backup: `authros backup restore FILE`; without one, name the contract with --contract";

/// Sets space aside for states, never leaving less than the reserve itself.
pub(in crate::site) fn working_reserve(home: &Home, reserve: u64) -> Reserve {
    // Without space now, it is tried again later.
    Reserve::open(&home.working_reserve(), reserve.min(MOST_FOR_STATES)).0
}

fn contradictions(plant: &Plant) -> Result<Vec<String>> {
    let mut found: Vec<String> = plant
        .ledger
        .inspection
        .contradictions()?
        .into_iter()
        .map(|text| format!("after an unclean shutdown, in the ledger: {text}; keep a copy of the home"))
        .collect();
    for digest in plant.ledger.inspection.newest_stored(NEWEST)? {
        let blob = plant.ciphertext.get(digest)?;
        if blob.is_none_or(|blob| plant.provider.sm3(&[&blob]) != digest.0) {
            found.push(format!("after an unclean shutdown: record {digest} is not in the store as it was written"));
        }
    }
    Ok(found)
}

type Accounts = BTreeMap<ProfileName, Vec<Address>>;

/// The second value: the database was restored to an earlier time than this home has seen, and `works` accepts it. What only
/// looks is refused: it changes nothing.
pub(in crate::site) fn open_on_server(
    home: &Home,
    url: &str,
    roots: Option<&Path>,
    works: bool,
) -> Result<(Ledger, bool)> {
    if home.ledger().exists() {
        return Err(refused(format!(
            "{} has records in a file already, and a gateway on a server begins in a new home: give another --home, or \
             leave store.url empty",
            home.root().display()
        )));
    }
    let watermark = home.watermark();
    let (ledger, restored) = match Ledger::on_server_of(url, roots, &watermark) {
        Err(StoreError::ServerRestored { .. }) if works => {
            // Another gateway's never had what this home has seen.
            check_gateway(&Ledger::on_server(url, roots)?, home)?;
            Ledger::renew_on_server(url, roots, &watermark)?;
            (Ledger::on_server_of(url, roots, &watermark)?, true)
        }
        opened => (opened?, false),
    };
    check_gateway(&ledger, home)?;
    Ok((ledger, restored))
}

fn check_gateway(ledger: &Ledger, home: &Home) -> Result<()> {
    match other_gateway(&known(ledger)?, ledger.path(), home) {
        // Without a profile, a saved keyring may still be restored.
        Some(text) if !own(home).is_empty() => Err(refused(text)),
        _ => Ok(()),
    }
}

/// A home without keys may open another gateway's store, to restore them, but does no work there; nor does one without the
/// present join key.
pub(in crate::site) fn may_hold(ledger: &Ledger, home: &Home) -> Result<bool> {
    if !ledger.lease.is_shared() {
        return Ok(true);
    }
    let is_shut_out = match ledger.notes.read(&SharedSystemKeys {})? {
        Some(sealed) => JoinKey::load(&home.gateway(), sealed.join)?.is_none(),
        None => false,
    };
    Ok(!is_shut_out && other_gateway(&known(ledger)?, ledger.path(), home).is_none())
}

/// Refuses a new profile where the store is another gateway's.
pub(in crate::site) fn check_unused(parts: &Parts) -> Result<()> {
    let ledger = &parts.plant.ledger;
    let other = if parts.is_on_server() { other_gateway(&known(ledger)?, ledger.path(), &parts.home) } else { None };
    other.map_or(Ok(()), |text| Err(refused(text)))
}

/// Refuses to serve if another home with accounts of its own uses the same store.
pub(in crate::site) fn check_all_accounts(parts: &Parts) -> Result<()> {
    if !parts.is_on_server() {
        return Ok(());
    }
    let (ledger, own) = (&parts.plant.ledger, own(&parts.home));
    let mut others = known(ledger)?;
    others.retain(|_, accounts| !accounts.iter().any(|account| own.contains(account)));
    if others.is_empty() { Ok(()) } else { Err(refused(text(&others, ledger.path(), &parts.home))) }
}

/// What to say if a store that knows these accounts is not this home's.
pub(crate) fn other_gateway(known: &Accounts, store: &Path, home: &Home) -> Option<String> {
    let own = own(home);
    let is_own = known.is_empty() || known.values().flatten().any(|account| own.contains(account));
    (!is_own).then(|| text(known, store, home))
}

fn known(ledger: &Ledger) -> Result<Accounts> {
    Ok(ledger.notes.read(&ProfileAccounts {})?.unwrap_or_default())
}

fn own(home: &Home) -> BTreeSet<Address> {
    let public = |profile| read_public(&home.keyring(&profile)).ok();
    home.profiles().into_iter().filter_map(public).map(|public| public.address).collect()
}

fn text(accounts: &Accounts, store: &Path, home: &Home) -> String {
    let accounts: Vec<String> = accounts.values().flatten().map(ToString::to_string).collect();
    format!(
        "{} is the database of another gateway, whose account is {}, and {} has no keyring of it; name a database of its own in \
         store.url, or bring that keyring here with `authros keys restore FILE`",
        store.display(),
        accounts.join(", "),
        home.root().display()
    )
}

const LOOK: Duration = Duration::from_secs(1);
/// Looks between learning names: robots' records arrive without the names that rules use.
const LEARN: u32 = 10;

const MOST: usize = 100_000;
const PAGE: usize = 10_000;
/// Interval of the checks whether the bytes are gone, and their number.
const ERASING_LOOK: (Duration, u32) = (Duration::from_millis(500), 240);

impl Storage {
    pub async fn keep_retention(self: Arc<Self>) {
        let keeping = self.parts.config.keeping();
        let (mut rules, mut looks) = (Retention::new(keeping.clone()), 0u32);
        while self.parts.life.beat(LOOK).await {
            if let Err(failure) = self.look_for_named() {
                self.parts.hub.warn(&failure.message);
            }
            let learns = !keeping.is_empty() && looks.is_multiple_of(LEARN);
            looks = looks.wrapping_add(1);
            for owner in self.parts.owners.all() {
                if learns && let Err(failure) = self.reading.learn_own_names(&owner.profile).await {
                    self.parts.hub.warn(&failure.message);
                }
                let applied = match keeping.is_empty() {
                    true => self.sweep(&owner).await,
                    false => self.apply(&owner, &mut rules).await,
                };
                if let Err(failure) = applied {
                    self.parts.hub.alarm(&format!("retention of {} is waiting: {}", owner.profile, failure.message));
                }
            }
            if let Err(failure) = self.sweep_told().await {
                self.parts.hub.alarm(&format!(
                    "records that owners erased elsewhere are still here; retrying: {}",
                    failure.message
                ));
            }
        }
    }

    /// Without rules only erased records are left to delete, and mostly there are none.
    async fn sweep(&self, owner: &Owner) -> Result<()> {
        if !self.has_named.load(Ordering::Acquire) {
            return Ok(());
        }
        // Not while an erasure takes over what a rule has named.
        let _one_at_a_time = self.naming.lock().await;
        let deleted = block_in_place(|| retention::delete(&self.parts.plant, owner))?;
        self.tell(owner, &Round { deleted, ..Round::default() }).await
    }

    /// Erasures by owners whose homes join this gateway, whichever profile is open here.
    async fn sweep_told(&self) -> Result<()> {
        if !self.has_named.load(Ordering::Acquire) {
            return Ok(());
        }
        let _one_at_a_time = self.naming.lock().await;
        block_in_place(|| retention::delete_told(&self.parts.plant))?;
        let held = self.parts.plant.ledger.erasures.held_although_erased()?;
        if self.held.swap(held, Ordering::AcqRel) < held {
            let text = format!(
                "erased elsewhere by the owner, but held here by an incident: {}; `authros incident remove NAME --yes` releases \
                 what it holds",
                counted(held, "record")
            );
            self.parts.hub.warn(&text);
        }
        Ok(())
    }

    /// Another process of the store may have named some.
    fn look_for_named(&self) -> Result<()> {
        let named = block_in_place(|| self.parts.plant.ledger.erasures.has_named())?;
        self.has_named.store(named, Ordering::Release);
        Ok(())
    }

    async fn apply(&self, owner: &Owner, rules: &mut Retention) -> Result<()> {
        let _one_at_a_time = self.naming.lock().await;
        let round = block_in_place(|| rules.round(&self.parts.plant, owner))?;
        self.tell(owner, &round).await
    }

    async fn tell(&self, owner: &Owner, round: &Round) -> Result<()> {
        for (topic, count) in &round.named {
            self.parts
                .log
                .write(&owner.profile, "retention", &format!("{topic}: {}", counted(*count, "record")), "named")
                .await?;
        }
        if round.deleted > 0 {
            self.parts.log.write(&owner.profile, "retention", &counted(round.deleted, "record"), "deleted").await?;
        }
        Ok(())
    }

    /// Shows what would be erased, or erases it.
    pub async fn erase(&self, owner: &Owner, wishes: ErasureWishes) -> Result<ErasureView> {
        let reason = clean(wishes.reason.trim(), LONGEST_REASON);
        if reason.is_empty() || wishes.reason.chars().count() > LONGEST_REASON {
            return Err(input(format!("say why in 1 to {LONGEST_REASON} characters: --reason TEXT")));
        }
        let (plant, network) = (&self.parts.plant, self.parts.link.network().await?);
        self.reading.name_asked(owner.address, Some(owner.index()), wishes.topic.as_ref())?;
        let query = self.narrowed(owner, &wishes)?;
        let rows = block_in_place(|| chosen(&Reader { plant, network: &network, reader: owner }, &wishes, &query))?;
        let incidents = plant.ledger.incidents.list(owner.address)?;
        let (view, erasable) = planned(&rows, &incidents);
        if !wishes.sure || erasable.is_empty() {
            return Ok(view);
        }
        if !view.held.is_empty() {
            let names = view.held.join(", ");
            return Err(refused(format!(
                "incidents hold some of these records: {names}; release them with `authros incident remove NAME --yes`, or \
                 choose other records"
            )));
        }
        let (records, topics) = (counted(view.records, "record"), counted(view.topics.len() as u64, "topic"));
        if let Some(shown) = wishes.shown.filter(|shown| *shown != view.records) {
            return Err(refused(format!(
                "repeat the command, with --until if more is being captured: {records} of {topics} would go by now, not the \
                 {shown} that were shown, so nothing was erased"
            )));
        }
        let subject = clean(&format!("{records} of {topics}: {reason}; {}", view.topics.join(" ")), 900);
        let erasure = Erasure { at: Timestamp::now(), by: owner.profile.to_string(), reason };
        let digests = erasable.iter().map(|row| row.digest).collect();
        let named = self.name_erased(owner, erasable, erasure);
        let named = self.parts.log.deed(&owner.profile, "erase", &subject, named).await?;
        let left = self.wait_for_erasing(digests).await?;
        Ok(ErasureView { named: named.named, missing: named.missing, deleted: !left, ..view })
    }

    /// Records of the topic, robot and span, by the rules of lists.
    fn narrowed(&self, owner: &Owner, wishes: &ErasureWishes) -> Result<RecordQuery> {
        let (topic, robot) = (wishes.topic.clone(), wishes.robot.clone());
        let asked = UploadQuery { topic, robot, since: wishes.since, until: wishes.until, ..UploadQuery::default() };
        let query = self.reading.of_robot(&[owner.address], asked)?;
        Ok(RecordQuery { owner: Some(owner.address), limit: PAGE, ..query })
    }

    async fn name_erased(&self, owner: &Owner, rows: Vec<RecordRow>, erasure: Erasure) -> Result<retention::Erased> {
        let _one_at_a_time = self.naming.lock().await;
        let named = block_in_place(|| retention::name(&self.parts.plant, owner, &rows, &erasure));
        self.has_named.store(true, Ordering::Release);
        self.parts.hub.stored.notify_waiters();
        Ok(named?)
    }

    /// Waits a while for the deletion; returns whether something is left.
    async fn wait_for_erasing(&self, mut digests: Vec<Digest>) -> Result<bool> {
        for _ in 0..ERASING_LOOK.1 {
            while let Some(last) = digests.last() {
                let retained = self.parts.plant.ledger.retention.find(*last)?;
                if retained.is_some_and(|retained| retained.deleted_at.is_none()) {
                    break;
                }
                digests.pop();
            }
            if digests.is_empty() {
                return Ok(false);
            }
            if !self.parts.life.beat(ERASING_LOOK.0).await {
                break;
            }
        }
        Ok(true)
    }
}

/// Said with every erasure.
const STAYS: [&str; 4] = [
    "copies that readers have fetched",
    "backups, exports and evidence bundles made before",
    "a robot's own disk, until its copies leave by outbox.keep or expire in its ring",
    "the files of a Redis cache, until its server rewrites them, and what a disk keeps of overwritten blocks",
];

fn chosen(reader: &Reader<'_>, wishes: &ErasureWishes, query: &RecordQuery) -> Result<Vec<RecordRow>> {
    let (ledger, owner) = (&reader.plant.ledger, reader.reader.address);
    let mut rows = Vec::new();
    for id in &wishes.records {
        let row = ledger.records.by_id(id)?.filter(|row| row.owner == owner && row.kind.is_content());
        let unknown = || input(format!("there is no message or attachment '{}' of this profile here", clean(id, 70)));
        rows.push(row.ok_or_else(unknown)?);
    }
    if !wishes.records.is_empty() {
        rows.sort_by_key(|row| row.digest);
        rows.dedup_by_key(|row| row.digest);
        return Ok(rows);
    }
    let of_topics = wishes.topic.is_some() || wishes.robot.is_some();
    if !of_topics && wishes.recording.is_none() {
        return Err(input(
            "choose what to erase: --topic, --robot or --recording, with --since and --until, or --record",
        ));
    }
    // A recording includes its attachments; a topic has none.
    let kinds = [RecordKind::Data, RecordKind::Attachment];
    for kind in kinds.into_iter().filter(|kind| !of_topics || *kind == RecordKind::Data) {
        let query = RecordQuery { kind: Some(kind), ..query.clone() };
        rows.extend(chosen_of(reader, wishes.recording.as_deref(), query)?);
        if rows.len() > MOST {
            return Err(too_many());
        }
    }
    Ok(rows)
}

fn too_many() -> Failure {
    input(format!("these are more than {MOST} records; choose a shorter span and repeat the command for the rest"))
}

fn chosen_of(reader: &Reader<'_>, recording: Option<&str>, query: RecordQuery) -> Result<Vec<RecordRow>> {
    let mut rows = Vec::new();
    for row in reader.plant.ledger.records.all(query) {
        let row = row?;
        let is_left_out = match recording {
            Some(recording) => !is_imported(reader, &row, recording)?,
            None => false,
        };
        rows.extend(Some(row).filter(|_| !is_left_out));
        if rows.len() > MOST {
            return Err(too_many());
        }
    }
    Ok(rows)
}

/// Whether an import of a recording sealed it, by its sealed tags. Deleted records cannot be opened.
fn is_imported(reader: &Reader<'_>, row: &RecordRow, recording: &str) -> Result<bool> {
    let opened = reader.own_contents(row)?;
    Ok(opened.is_some_and(|opened| {
        let has = |name: &str, value: &str| opened.head.tags.get(name).is_some_and(|tag| tag == value);
        has(RECORDING, recording) && has(SOURCE.0, SOURCE.1)
    }))
}

/// What would become of these records, and those that can go.
fn planned(rows: &[RecordRow], incidents: &[IncidentRow]) -> (ErasureView, Vec<RecordRow>) {
    let erasable: Vec<RecordRow> = rows.iter().filter(|row| retention::can_be(row)).cloned().collect();
    let holds = |incident: &&IncidentRow| erasable.iter().any(|row| is_held(row, incident));
    let held = incidents.iter().filter(holds).map(|incident| incident.name.to_string()).collect();
    let topics: BTreeSet<String> = erasable.iter().map(|row| clean(&row.topic, 255)).collect();
    let view = ErasureView {
        records: erasable.len() as u64,
        bytes: erasable.iter().map(|row| row.bytes).sum(),
        topics: topics.into_iter().collect(),
        waiting: rows.iter().filter(|row| row.state.is_pending()).count() as u64,
        gone: rows.iter().filter(|row| row.deleted_at.is_some()).count() as u64,
        other: rows.iter().filter(|row| is_other(row)).count() as u64,
        held,
        stays: STAYS.map(ToOwned::to_owned).to_vec(),
        ..ErasureView::default()
    };
    (view, erasable)
}

/// Quarantined, discarded or altered: decided elsewhere.
fn is_other(row: &RecordRow) -> bool {
    row.deleted_at.is_none() && !row.state.is_pending() && row.state != RecordState::Verified
}

fn is_held(row: &RecordRow, incident: &IncidentRow) -> bool {
    let span = &incident.span;
    row.captured_at >= span.since && span.until.is_none_or(|until| row.captured_at < until) && span.is_about(&row.topic)
}

#[cfg(test)]
mod tests;

//! Messages that do not become records: noted in memory, written to the ledger every second, and reported in gap
//! records in their topic's own sequence, so that its readers learn of them.

use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::{collections::BTreeMap, path::Path, time::Duration};

use crate::model::{Address, GapReport, LossReason, RecordKind, RecordState, Timestamp};
use crate::statement::{self, Speaker, Statement};
use crate::store::{GapRow, Loss, StateCounts, StoreError, Waiting, WaitingFile};
use crate::{Author, Plant, Result};
use crate::{recorder::CapturedMessage, ros::Message, sealer::plan::Stream, store::notes::LossesCounted};

/// How long losses are collected before a gap record reports them.
pub const GATHERED: Duration = Duration::from_secs(3);
/// Takes the place of a message type.
pub const TYPE: &str = "authros/Gap";
/// Entries kept apart in memory.
const MOST: usize = 4096;
/// The most gap records sealed at once.
const ROUND: usize = 256;

#[derive(Debug, Clone, Copy)]
pub struct Lost<'a> {
    pub topic: &'a str,
    pub publisher: &'a str,
    pub count: u64,
    /// `header.seq` of the first and the last.
    pub numbers: Option<(u32, u32)>,
}

impl<'a> Lost<'a> {
    pub fn message(message: &'a Message) -> Self {
        let numbers = message.header_seq.map(|number| (number, number));
        Self { topic: &message.topic, publisher: &message.caller_id, count: 1, numbers }
    }
}

type Key = (Address, String, LossReason, String);

#[derive(Default)]
pub struct InMemory(BTreeMap<Key, Loss>);

impl InMemory {
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Not what nobody watches: the ring on the disk keeps it, as long as that goes.
    pub fn add(&mut self, item: &CapturedMessage) {
        if !item.ring && item.kind != RecordKind::Definition {
            let at = item.message.captured_at;
            let loss = loss_of(&item.author, Lost::message(&item.message), LossReason::End, at);
            merge(&mut self.0, key_of(&loss), loss);
        }
    }
}

#[derive(Default)]
pub struct Losses {
    noted: Mutex<BTreeMap<Key, Loss>>,
    /// Held while losses move from memory into the ledger, so that nobody counts them twice or not at all.
    moving: Mutex<()>,
    authors: Mutex<BTreeMap<Address, Arc<Author>>>,
    /// Code of a [`LossReason`].
    cause: AtomicU8,
    /// Holds what is not in the ledger yet while the disk is full.
    file: Mutex<Option<WaitingFile>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Losses {
    pub fn know(&self, author: &Arc<Author>) {
        lock(&self.authors).insert(author.address, Arc::clone(author));
    }

    /// Opens the file that holds losses while the disk is full, and takes over what a dead process left in it; returns
    /// the number of those messages. The first file counts.
    pub fn keep_in(&self, path: &Path, plant: &Plant) -> Result<u64, StoreError> {
        let mut file = lock(&self.file);
        if file.is_some() {
            return Ok(0);
        }
        let (mut opened, left) = WaitingFile::open(path, plant.ledger.notes.read(&LossesCounted {})?.unwrap_or(0))?;
        let died: Vec<Loss> = left.lost.into_iter().chain(left.waiting).collect();
        let count = died.iter().map(|loss| loss.count).sum();
        if count > 0 {
            // From here on all of it is lost, and nothing of it waits.
            opened.write(&Waiting { lost: died.clone(), waiting: Vec::new() })?;
            let mut noted = lock(&self.noted);
            died.into_iter().for_each(|loss| merge(&mut noted, key_of(&loss), loss));
        }
        *file = Some(opened);
        Ok(count)
    }

    pub fn is_noted(&self) -> bool {
        lock(&self.file).as_ref().is_some_and(|file| !file.is_empty())
    }

    /// Replaces what is noted in the file: losses that the ledger has not counted, and these messages, which wait.
    pub fn note_waiting(&self, waiting: InMemory) -> Result<(), StoreError> {
        let _moving = lock(&self.moving);
        let mut file = lock(&self.file);
        let Some(file) = file.as_mut() else { return Ok(()) };
        let lost = lock(&self.noted).values().cloned().collect();
        let now = Waiting { lost, waiting: waiting.0.into_values().collect() };
        if file.is_empty() && now == Waiting::default() { Ok(()) } else { file.write(&now) }
    }

    pub fn cause(&self) -> LossReason {
        LossReason::from_code(self.cause.load(Ordering::Acquire)).unwrap_or(LossReason::Memory)
    }

    pub fn blame(&self, reason: LossReason) {
        self.cause.store(reason.code(), Ordering::Release);
    }

    /// Notes a loss; quick, and never fails.
    pub fn note(&self, author: &Arc<Author>, lost: Lost<'_>, reason: LossReason) {
        let now = Timestamp::now();
        let mut noted = lock(&self.noted);
        // A peer can invent names without end; beyond a limit they share an entry.
        let publisher = if noted.len() < MOST { lost.publisher } else { "" };
        let loss = loss_of(author, Lost { publisher, ..lost }, reason, now);
        merge(&mut noted, key_of(&loss), loss);
    }

    /// Losses in transport and in the recorder that the ledger has not counted yet.
    fn unwritten(&self, owner: Address, topic: Option<&str>) -> (u64, u64) {
        let noted = lock(&self.noted);
        let of = |loss: &&Loss| loss.owner == owner && topic.is_none_or(|topic| topic == loss.topic);
        let (transport, recorder): (Vec<&Loss>, Vec<&Loss>) =
            noted.values().filter(of).partition(|loss| loss.reason == LossReason::Transport);
        let sum = |losses: Vec<&Loss>| losses.iter().map(|loss| loss.count).sum::<u64>();
        (sum(transport), sum(recorder))
    }

    /// Counts of ledger and memory together: consistent, each loss once.
    pub fn counts(&self, plant: &Plant, owner: Address) -> Result<StateCounts, StoreError> {
        let _still = lock(&self.moving);
        let mut counts = plant.ledger.counts.by_state(Some(owner))?;
        let (in_transport, in_recorder) = self.unwritten(owner, None);
        counts.lost_in_transport += in_transport;
        counts.lost_in_recorder += in_recorder;
        *counts.data.entry(RecordState::Dropped).or_default() += in_recorder;
        for topic in &mut counts.topics {
            let (in_transport, in_recorder) = self.unwritten(owner, Some(&topic.topic));
            topic.missed += in_transport;
            topic.dropped += in_recorder;
            topic.lost += in_recorder;
            topic.captured += in_recorder;
        }
        Ok(counts)
    }

    /// Counts the noted losses in the ledger; if that fails they stay noted.
    pub fn write(&self, plant: &Plant) -> Result<(), StoreError> {
        let _moving = lock(&self.moving);
        let taken = std::mem::take(&mut *lock(&self.noted));
        if taken.is_empty() {
            return Ok(());
        }
        let losses = taken.values().cloned().collect();
        // What the file says of them is counted with the same commit.
        let number = lock(&self.file).as_ref().map(WaitingFile::number);
        let written = match number {
            Some(number) => plant.ledger.losses.count_up_to(losses, number),
            None => plant.ledger.losses.count(losses),
        };
        if written.is_err() {
            let mut noted = lock(&self.noted);
            let newer = std::mem::replace(&mut *noted, taken);
            newer.into_iter().for_each(|(key, loss)| merge(&mut noted, key, loss));
        }
        written
    }

    /// Seals a gap record for everything lost by `by` and not yet reported; returns the streams whose numbers advanced.
    /// For the one thread that seals captured messages. After an error, what is sealed so far stays.
    pub fn tell(&self, plant: &Plant, by: Timestamp) -> Result<Vec<(Stream, u64)>> {
        if plant.ledger.records.takes_records().is_err() {
            return Ok(Vec::new());
        }
        let authors: Vec<_> = lock(&self.authors).values().cloned().collect();
        let mut told = Vec::new();
        for author in authors {
            for gap in plant.ledger.losses.open_gaps(author.address, by, ROUND)? {
                told.extend(tell_one(plant, &author, &gap)?);
            }
        }
        if !told.is_empty() {
            plant.observer.records_changed();
        }
        Ok(told)
    }
}

fn key_of(loss: &Loss) -> Key {
    (loss.owner, loss.topic.clone(), loss.reason, loss.publisher.clone())
}

fn loss_of(author: &Author, lost: Lost<'_>, reason: LossReason, at: Timestamp) -> Loss {
    Loss {
        owner: author.address,
        topic: lost.topic.to_owned(),
        publisher: lost.publisher.to_owned(),
        reason,
        count: lost.count,
        numbers: lost.numbers,
        first_at: at,
        last_at: at,
    }
}

fn merge(noted: &mut BTreeMap<Key, Loss>, key: Key, loss: Loss) {
    let Some(known) = noted.get_mut(&key) else {
        noted.insert(key, loss);
        return;
    };
    known.count += loss.count;
    known.last_at = loss.last_at;
    known.numbers = match (known.numbers, loss.numbers) {
        (Some((first, _)), Some((_, last))) => Some((first, last)),
        (one, other) => one.or(other),
    };
}

/// `None` if there is no key to seal with now; it is reported later.
fn tell_one(plant: &Plant, author: &Author, gap: &GapRow) -> Result<Option<(Stream, u64)>> {
    let Some(keys) = author.sealing() else { return Ok(None) };
    let Some(topic) = keys.topic(&gap.topic) else { return Ok(None) };
    let Some(reason) = LossReason::from_word(&gap.reason) else { return Ok(None) };
    let body = GapReport {
        topic_id: topic.id,
        topic: gap.topic.clone(),
        publisher: gap.publisher.clone(),
        reason,
        count: gap.count,
        numbers: gap.numbers,
        first_at: gap.first_at,
        last_at: gap.last_at,
    }
    .encode();
    let speaker = Speaker::of(&keys, author.address, &topic);
    let statement = Statement { kind: RecordKind::Gap, topic: &gap.topic, type_name: TYPE, body: &body };
    let seq = statement::put(plant, &speaker, statement, |row| {
        let seq = row.seq;
        plant.ledger.losses.close_gap(gap, row).map(|()| seq)
    })?;
    Ok(Some(((author.address, keys.signer, topic.id), seq)))
}

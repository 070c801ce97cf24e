//! What a robot's owner asks of its ring: noted in the ledger, so that a restart continues, then brought into the
//! outbox, file by file. Bringing in a record twice changes nothing.

#[cfg(test)]
mod tests;

use std::collections::{BTreeSet, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::model::{Address, Header, RingSpan};
use crate::store::notes::{AskedSpan, AskedSpans};
use crate::store::{DiskRing, NewRecord, Notes, RingRecord, StoreError};
use crate::{PipelineError, Plant, Result, crypto::SealedRecord};

/// The most spans asked for at a time.
const MOST: usize = 64;

pub type SharedRing = Arc<Mutex<DiskRing>>;

/// Durable when this returns. `number` is that of the owner's notice.
pub fn ask(notes: &Notes, number: u64, span: &RingSpan) -> Result<()> {
    notes.change(&AskedSpans {}, |asked| {
        // A restored home numbers its notices from 1 again.
        if asked.iter().any(|known| known.number == number && known.span == *span) {
            return Ok(());
        }
        if asked.len() >= MOST {
            return Err(PipelineError::Refused(format!(
                "{MOST} spans of the ring are requested already; wait until the \
                 robot has sent them"
            )));
        }
        asked.push_back(AskedSpan { number, span: span.clone() });
        Ok(())
    })
}

/// Oldest request first.
pub fn waiting(notes: &Notes) -> Result<Vec<RingSpan>, StoreError> {
    Ok(notes.read(&AskedSpans {})?.unwrap_or_default().into_iter().map(|asked| asked.span).collect())
}

#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Brought {
    /// Messages that are in the outbox now and were not before.
    pub messages: u64,
    pub topics: BTreeSet<String>,
}

struct Work {
    asked: AskedSpan,
    parts: VecDeque<u64>,
    brought: Brought,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Step {
    Idle,
    /// New messages in the outbox; there is more to do.
    Moved(u64),
    Done(RingSpan, Brought),
}

pub struct Pulls {
    plant: Plant,
    ring: SharedRing,
    owner: Address,
    work: Option<Work>,
}

impl Pulls {
    pub fn new(plant: Plant, ring: SharedRing, owner: Address) -> Self {
        Self { plant, ring, owner, work: None }
    }

    fn ring(&self) -> MutexGuard<'_, DiskRing> {
        self.ring.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Handles at most one file of the ring.
    pub fn step(&mut self) -> Result<Step> {
        let Some(mut work) = self.take_work()? else { return Ok(Step::Idle) };
        let Some(part) = work.parts.front().copied() else {
            self.plant.ledger.notes.change(&AskedSpans {}, |asked| {
                asked.retain(|known| *known != work.asked);
                Ok::<_, PipelineError>(())
            })?;
            return Ok(Step::Done(work.asked.span, work.brought));
        };
        let records = self.ring().select(part, &work.asked.span);
        let moved = records.map_err(PipelineError::from).and_then(|records| self.bring_in(records, &mut work.brought));
        if moved.is_ok() {
            work.parts.pop_front();
        }
        self.work = Some(work);
        moved.map(Step::Moved)
    }

    fn take_work(&mut self) -> Result<Option<Work>, StoreError> {
        if let Some(work) = self.work.take() {
            return Ok(Some(work));
        }
        let asked = self.plant.ledger.notes.read(&AskedSpans {})?;
        let Some(asked) = asked.and_then(|mut asked| asked.pop_front()) else { return Ok(None) };
        let parts = self.ring().parts_of(&asked.span).into();
        Ok(Some(Work { asked, parts, brought: Brought::default() }))
    }

    /// Returns how many messages are new.
    fn bring_in(&self, records: Vec<RingRecord>, brought: &mut Brought) -> Result<u64> {
        let (mut rows, mut new) = (Vec::new(), Brought::default());
        for record in records {
            let (topic, is_definition) = (record.topic.clone(), record.is_definition);
            if self.plant.ledger.records.find(record.digest)?.is_none()
                && let Some(row) = self.row(record)
            {
                if !is_definition {
                    new.messages += 1;
                    new.topics.insert(topic);
                }
                rows.push(row);
            }
        }
        self.plant.keep(rows, |rows| self.plant.ledger.records.append(rows))?;
        self.plant.observer.records_changed();
        brought.messages += new.messages;
        brought.topics.extend(new.topics);
        Ok(new.messages)
    }

    /// The row of a record; `None` if its bytes are damaged or another owner's.
    fn row(&self, record: RingRecord) -> Option<NewRecord> {
        let RingRecord { digest, signature, topic, type_name, simulated, plain_length, blob, .. } = record;
        if self.plant.provider.sm3(&[&blob]) != digest.0 {
            return None;
        }
        let (header, _) = Header::parse(&blob).ok()?;
        if header.owner != self.owner || !header.recorder.is_ring() {
            return None;
        }
        let row = NewRecord::foreign(SealedRecord { header, blob, digest, signature }, self.owner);
        Some(NewRecord { topic, type_name, simulated, bytes: plain_length, ..row })
    }
}

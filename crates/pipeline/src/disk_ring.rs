//! What a robot's owner asks of its ring: noted in the ledger, so that it is done after a restart too, and then brought
//! from the ring into the outbox, file by file. Bringing in a record twice changes nothing.

#[cfg(test)]
mod tests;

use std::collections::{BTreeSet, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::{PipelineError, Plant};
use crate::crypto::SealedRecord;
use crate::model::{Address, Header, RingSpan};
use crate::store::notes::{AskedSpan, AskedSpans};
use crate::store::{DiskRing, NewRecord, Notes, RingRecord, StoreError};

/// The most spans asked for at a time.
const MOST: usize = 64;

/// A ring, filled by the sealer and read when its owner asks.
pub type SharedRing = Arc<Mutex<DiskRing>>;

/// Notes that the owner asks for a span, by the number of its notice; durable when this returns.
///
/// # Errors
/// [`PipelineError::Refused`] if more is asked for already than is noted, errors of the ledger.
pub fn ask(notes: &Notes, number: u64, span: &RingSpan) -> Result<(), PipelineError> {
    notes.change(&AskedSpans {}, |asked| {
        // A restored home numbers its notices from 1 again.
        if asked.iter().any(|known| known.number == number && known.span == *span) {
            return Ok(());
        }
        if asked.len() >= MOST {
            return Err(PipelineError::Refused(format!("{MOST} spans of the ring are asked for already")));
        }
        asked.push_back(AskedSpan { number, span: span.clone() });
        Ok(())
    })
}

/// The spans asked for and not brought in yet, the oldest request first.
pub fn waiting(notes: &Notes) -> Result<Vec<RingSpan>, StoreError> {
    Ok(notes.read(&AskedSpans {})?.unwrap_or_default().into_iter().map(|asked| asked.span).collect())
}

/// What was brought in for one request.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Brought {
    /// Messages that are in the outbox now and were not before.
    pub messages: u64,
    pub topics: BTreeSet<String>,
}

/// A request at work.
struct Work {
    asked: AskedSpan,
    parts: VecDeque<u64>,
    brought: Brought,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Step {
    /// Nothing is asked for.
    Idle,
    /// So many messages are in the outbox now that were not before; there is more to do.
    Moved(u64),
    /// A request is done.
    Done(RingSpan, Brought),
}

/// Brings what is asked for into the outbox.
pub struct Pulls {
    plant: Plant,
    ring: SharedRing,
    owner: Address,
    work: Option<Work>,
}

impl Pulls {
    /// From the ring into the outbox of `plant`, for records of `owner`.
    pub fn new(plant: Plant, ring: SharedRing, owner: Address) -> Self {
        Self { plant, ring, owner, work: None }
    }

    fn ring(&self) -> MutexGuard<'_, DiskRing> {
        self.ring.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Does a little, at most one file of the ring.
    pub fn step(&mut self) -> Result<Step, PipelineError> {
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
    fn bring_in(&self, records: Vec<RingRecord>, brought: &mut Brought) -> Result<u64, PipelineError> {
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

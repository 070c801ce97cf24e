//! What this gateway tells and hands to the other gateways of its fleet: only to those that its keeper named, and only
//! while it knows its chain.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::GatewayDesk;
use super::admission::Standing as Access;
use crate::gateway::command::holdings::{MOST_HANDED, MOST_HANDED_BYTES, MOST_TOLD};
use crate::gateway::{
    Caller, Code, Fetched, HandedOver, Held, HoldingPlace, Holdings, ManyHandedOver, Refusal, Wanted,
};
use crate::model::{Address, Ranges, RecorderId, TopicId};
use crate::pipeline::Network;
use crate::store::{HeldRecord, HoldingPage, HoldingRow};

/// How long what was looked up is told: all gateways of a fleet ask for the same newest records.
const TOLD_AGAIN: Duration = Duration::from_millis(400);
/// The most parts that are remembered.
const MOST_REMEMBERED: usize = 8;

/// What was looked up lately, for all who ask from a place in it.
#[derive(Default)]
pub(super) struct Told(Mutex<Vec<Part>>);

/// What is held behind a place.
struct Part {
    looked: Instant,
    after: HoldingPlace,
    next: HoldingPlace,
    page: HoldingPage,
}

impl Part {
    fn new(after: HoldingPlace, page: HoldingPage) -> Self {
        Self { looked: Instant::now(), after, next: page.last.map_or(after, place), page }
    }

    /// Whether it says what is behind a place. Behind its end it does if there was no more.
    fn tells(&self, after: HoldingPlace) -> bool {
        self.after <= after && (after < self.next || after == self.next && !self.page.more)
    }

    fn behind(&self, after: HoldingPlace) -> Holdings {
        let rows = &self.page.rows;
        let begin = rows.partition_point(|row| place(row.place) <= after);
        Holdings { held: by_topic(rows.get(begin..).unwrap_or_default()), next: self.next, more: self.page.more }
    }
}

impl Told {
    /// The answer for a place: from what somebody just got, or from a new look. Nobody else looks meanwhile.
    fn at(
        &self,
        after: HoldingPlace,
        look: impl FnOnce() -> Result<HoldingPage, Refusal>,
    ) -> Result<Holdings, Refusal> {
        let mut told = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        told.retain(|part| part.looked.elapsed() < TOLD_AGAIN);
        if let Some(part) = told.iter().rev().find(|part| part.tells(after)) {
            return Ok(part.behind(after));
        }
        let part = Part::new(after, look()?);
        let holdings = part.behind(after);
        if told.len() < MOST_REMEMBERED {
            told.push(part);
        }
        Ok(holdings)
    }
}

fn place((block, batch, leaf): (u64, u64, u64)) -> HoldingPlace {
    HoldingPlace { block, batch, leaf }
}

impl GatewayDesk {
    /// The network, if the caller keeps a gateway that this one's keeper named.
    pub(super) fn among_fellows(&self, caller: &Caller) -> Result<Network, Refusal> {
        let network = self.fresh_network()?;
        if caller.device.is_none() && self.gateway.fellows.is_keeper(&network, &caller.account) {
            return Ok(network);
        }
        let text = format_args!(
            "{} keeps no gateway of this fleet; `authros fleet add` names one by its fingerprint",
            caller.account
        );
        Err(Refusal::new(Code::NotAuthorised, text))
    }

    /// What is held here behind a place.
    pub(super) fn told_holdings(&self, caller: &Caller, after: HoldingPlace) -> Result<Holdings, Refusal> {
        self.among_fellows(caller)?;
        self.gateway.told.at(after, || {
            let most = usize::try_from(MOST_TOLD).unwrap_or(usize::MAX);
            let page = self.gateway.plant.ledger.holdings((after.block, after.batch, after.leaf), most);
            page.map_err(Refusal::because(Code::Internal))
        })
    }

    /// The records of some ranges, as many as fit into an answer.
    pub(super) fn handed_over(&self, caller: &Caller, wanted: &[Wanted]) -> Result<ManyHandedOver, Refusal> {
        let network = self.among_fellows(caller)?;
        let range = |one: &Wanted| ((one.owner, one.recorder, one.topic_id), (one.first, one.last));
        let ranges: Vec<_> = wanted.iter().map(range).collect();
        let found = self.gateway.plant.ledger.held_between(&ranges, MOST_HANDED);
        let found = found.map_err(Refusal::because(Code::Internal))?;
        let (mut handed, mut bytes) = (HandedOver::default(), 0);
        // Of the longest records no more are in memory than go into an answer.
        for some in found.chunk_by(fitting()) {
            let least = some.first().map_or(0, |held| usize::try_from(held.row.bytes).unwrap_or(usize::MAX));
            if bytes > 0 && least.saturating_add(bytes) > MOST_HANDED_BYTES {
                return Ok(before(handed, some.first()));
            }
            for (held, record) in some.iter().zip(self.all_bytes_of(&network, some)?) {
                let record = match record {
                    Ok(record) => record,
                    // What is not right here is nothing to give; the audit of records tells of it.
                    Err(refusal) if matches!(refusal.code, Code::NotFound | Code::Tampered) => continue,
                    Err(refusal) => return Err(refusal),
                };
                let length = size(&record);
                if bytes > 0 && bytes + length > MOST_HANDED_BYTES {
                    return Ok(before(handed, Some(held)));
                }
                bytes += length;
                handed.records.push(record);
            }
        }
        Ok(match found.last() {
            Some(last) if found.len() >= MOST_HANDED => behind(handed, last, wanted),
            _ => ManyHandedOver { handed, range: 0 },
        })
    }

    /// Whether records of this owner are taken here from other gateways: what its robots would be asked, too.
    pub(super) fn check_owner(&self, owner: &Address) -> Result<(), Refusal> {
        let network = self.known_network()?;
        if self.standing_of(&network, owner)? == Access::Fellow {
            return Err(Refusal::new(Code::NotAuthorised, format_args!("{owner} was not admitted with records")));
        }
        Ok(())
    }
}

/// An answer that is to go on with a record.
fn before(mut handed: HandedOver, next: Option<&HeldRecord>) -> ManyHandedOver {
    handed.next = next.map(|held| held.row.seq);
    ManyHandedOver { handed, range: next.map_or(0, |held| number(held.range)) }
}

/// An answer that is to go on behind a record, if something was asked for there.
fn behind(mut handed: HandedOver, last: &HeldRecord, wanted: &[Wanted]) -> ManyHandedOver {
    let (mut range, mut next) = (last.range, None);
    if wanted.get(range).is_some_and(|wanted| last.row.seq < wanted.last) {
        next = Some(last.row.seq + 1);
    } else if let Some(following) = wanted.get(range + 1) {
        (range, next) = (range + 1, Some(following.first));
    }
    handed.next = next;
    ManyHandedOver { handed, range: if next.is_some() { number(range) } else { 0 } }
}

fn number(range: usize) -> u16 {
    u16::try_from(range).unwrap_or(u16::MAX)
}

/// Whether a record follows another one into the same part of an answer: until its bytes would not fit in.
fn fitting() -> impl FnMut(&HeldRecord, &HeldRecord) -> bool {
    let most = MOST_HANDED_BYTES as u64;
    let mut sum: Option<u64> = None;
    move |HeldRecord { row: before, .. }, HeldRecord { row, .. }| {
        let together = sum.unwrap_or(before.bytes).saturating_add(row.bytes);
        let fits = together <= most;
        sum = Some(if fits { together } else { row.bytes });
        fits
    }
}

fn size(record: &Fetched) -> usize {
    record.blob.len() + record.proof.len() + 256
}

/// Owner, recorder, topic id.
type Topic = ([u8; 20], [u8; 16], [u8; 16]);

/// Rows as ranges, topic by topic.
fn by_topic(rows: &[HoldingRow]) -> Vec<Held> {
    let mut topics: BTreeMap<Topic, Vec<u64>> = BTreeMap::new();
    for row in rows {
        topics.entry((row.owner.0, row.recorder.0, row.topic_id.0)).or_default().push(row.seq);
    }
    let held = |((owner, recorder, topic), numbers)| Held {
        owner: Address(owner),
        recorder: RecorderId(recorder),
        topic_id: TopicId(topic),
        ranges: Ranges::of(numbers),
    };
    topics.into_iter().map(held).collect()
}

#[cfg(test)]
#[path = "handing_tests.rs"]
mod tests;

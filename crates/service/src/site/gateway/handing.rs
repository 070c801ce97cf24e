//! What this gateway tells and hands to the other gateways of its fleet: only to those that its keeper named, and only
//! while it knows its chain.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::GatewayDesk;
use super::admission::Standing as Access;
use crate::gateway::command::holdings::{MOST_HANDED, MOST_HANDED_BYTES, MOST_TOLD};
use crate::gateway::{Caller, Code, Fetched, HandedOver, Held, HoldingPlace, Holdings, Refusal, Wanted};
use crate::model::{Address, Digest, Ranges, RecorderId, TopicId};
use crate::pipeline::Network;
use crate::store::{HoldingRow, RecordRow};

/// How long an answer about holdings is given again: all gateways of a fleet ask for the same newest records.
const TOLD_AGAIN: Duration = Duration::from_millis(400);
/// The most answers that are remembered.
const MOST_REMEMBERED: usize = 16;

/// What was told lately, by the place it was asked from.
#[derive(Default)]
pub(super) struct Told(Mutex<BTreeMap<HoldingPlace, (Instant, Holdings)>>);

impl Told {
    /// The answer for a place: the one that somebody just got, or a new one. Nobody else looks meanwhile.
    fn at(&self, after: HoldingPlace, look: impl FnOnce() -> Result<Holdings, Refusal>) -> Result<Holdings, Refusal> {
        let mut told = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        told.retain(|_, (when, _)| when.elapsed() < TOLD_AGAIN);
        if let Some((_, holdings)) = told.get(&after) {
            return Ok(holdings.clone());
        }
        let holdings = look()?;
        if told.len() < MOST_REMEMBERED {
            told.insert(after, (Instant::now(), holdings.clone()));
        }
        Ok(holdings)
    }
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
            let page = page.map_err(Refusal::because(Code::Internal))?;
            let next = page.last.map_or(after, |(block, batch, leaf)| HoldingPlace { block, batch, leaf });
            Ok(Holdings { held: by_topic(page.rows), next, more: page.more })
        })
    }

    /// The records of a range, as many as fit into an answer.
    pub(super) fn handed_over(&self, caller: &Caller, wanted: &Wanted) -> Result<HandedOver, Refusal> {
        let network = self.among_fellows(caller)?;
        let internal = Refusal::because(Code::Internal);
        let ledger = &self.gateway.plant.ledger;
        let which = (wanted.owner, wanted.recorder, wanted.topic_id);
        let found = ledger.held_between(which, (wanted.first, wanted.last), MOST_HANDED).map_err(&internal)?;
        let full = found.len() >= MOST_HANDED;
        let digests: Vec<Digest> = found.iter().map(|(_, digest)| *digest).collect();
        let rows: Vec<RecordRow> = ledger.records(&digests).map_err(&internal)?.into_iter().flatten().collect();
        let (mut handed, mut bytes) = (HandedOver::default(), 0);
        // Of the longest records no more are in memory than go into an answer.
        for some in rows.chunk_by(fitting()) {
            let least = some.first().map_or(0, |row| usize::try_from(row.bytes).unwrap_or(usize::MAX));
            if bytes > 0 && least.saturating_add(bytes) > MOST_HANDED_BYTES {
                handed.next = some.first().map(|row| row.seq);
                return Ok(handed);
            }
            for (row, record) in some.iter().zip(self.all_bytes_of(&network, some)?) {
                let record = match record {
                    Ok(record) => record,
                    // What is not right here is nothing to give; the audit of records tells of it.
                    Err(refusal) if matches!(refusal.code, Code::NotFound | Code::Tampered) => continue,
                    Err(refusal) => return Err(refusal),
                };
                let length = size(&record);
                if bytes > 0 && bytes + length > MOST_HANDED_BYTES {
                    handed.next = Some(row.seq);
                    return Ok(handed);
                }
                bytes += length;
                handed.records.push(record);
            }
        }
        let last = found.last().map(|(seq, _)| *seq).filter(|last| full && *last < wanted.last);
        handed.next = last.map(|last| last + 1);
        Ok(handed)
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

/// Whether a record follows another one into the same part of an answer: until its bytes would not fit in.
fn fitting() -> impl FnMut(&RecordRow, &RecordRow) -> bool {
    let most = MOST_HANDED_BYTES as u64;
    let mut sum: Option<u64> = None;
    move |before, row| {
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
fn by_topic(rows: Vec<HoldingRow>) -> Vec<Held> {
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

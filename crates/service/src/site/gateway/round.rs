//! One round with another gateway of the fleet: what does it hold, what of that is lacking here, and that is taken over.
//! Everything is bounded here, whatever the other one says; a round that was cut short is resumed, because its state is
//! what is held.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use async_trait::async_trait;

use super::copies::Copies;
use super::fetching::{Claim, Which};
use super::round_erased::{ErasureCourse, TookErased, read_erasures};
use super::visit::Visit;
use crate::gateway::{
    Client, Code, ErasurePlace, Erasures, Fetched, GatewayError, HandedOver, Held, HoldingPlace, Holdings,
    ManyHandedOver, Refusal, ToldErasure, Wanted,
};
use crate::model::{Address, Digest, Ranges, RecorderId, TopicId};
use crate::store::Lacking;

/// How many blocks are read again: a gateway may note anchors of a block a moment later than of the next.
const AGAIN: u64 = 16;
/// How often these are.
const LATE: Duration = Duration::from_secs(10);
/// How often holdings are read from the beginning: anchors of old blocks may become known late.
const WHOLE: Duration = Duration::from_secs(600);

/// The other gateway.
#[async_trait]
pub(super) trait Other: Send {
    /// What it holds after a place.
    async fn holdings(&mut self, after: HoldingPlace) -> Result<Holdings, GatewayError>;

    /// Records of a range.
    async fn hand_over(&mut self, wanted: Wanted) -> Result<HandedOver, GatewayError>;

    /// Records of several ranges; `None` if it is of an earlier version.
    async fn hand_over_many(&mut self, wanted: &[Wanted]) -> Result<Option<ManyHandedOver>, GatewayError>;

    /// What was erased there after a place; `None` if it is of an earlier version.
    async fn erasures(&mut self, after: ErasurePlace) -> Result<Option<Erasures>, GatewayError>;
}

#[async_trait]
impl Other for Client {
    async fn holdings(&mut self, after: HoldingPlace) -> Result<Holdings, GatewayError> {
        Client::holdings(self, after).await
    }

    async fn hand_over(&mut self, wanted: Wanted) -> Result<HandedOver, GatewayError> {
        Client::hand_over(self, wanted).await
    }

    async fn hand_over_many(&mut self, wanted: &[Wanted]) -> Result<Option<ManyHandedOver>, GatewayError> {
        match Client::hand_over_many(self, wanted.to_vec()).await {
            Err(GatewayError::Refused(Code::Malformed)) => Ok(None),
            handed => handed.map(Some),
        }
    }

    async fn erasures(&mut self, after: ErasurePlace) -> Result<Option<Erasures>, GatewayError> {
        match Client::erasures(self, after).await {
            Err(GatewayError::Refused(Code::Malformed)) => Ok(None),
            told => told.map(Some),
        }
    }
}

/// This gateway.
#[async_trait]
pub(super) trait Here: Sync {
    /// Whether records of an owner are taken here at all.
    fn welcomes(&self, owner: &Address) -> Result<(), Refusal>;

    /// Which records are kept here at all.
    fn copies(&self) -> Copies;

    /// Which of these records are lacking, topic by topic.
    fn lacking(&self, held: &[Held]) -> Result<Vec<Lacking>, Refusal>;

    /// Keeps other lines from fetching the same records until the claim is dropped.
    fn claim(&self, which: Which, wanted: Vec<u64>) -> Claim;

    /// Takes records, each checked as if its robot had sent it.
    async fn take(&self, parts: Vec<Handed>) -> Result<Took, Refusal>;

    /// Erases here what its owners had erased, as far as all of it holds; what is done is counted in `round`. With patience,
    /// an anchor that the chain here does not have yet is waited for.
    async fn erase(&self, told: Vec<ToldErasure>, patient: bool, round: &mut Round) -> Result<TookErased, Refusal>;
}

/// What was handed over of what was asked for.
pub(super) struct Handed {
    /// What was asked for.
    pub wanted: Wanted,
    /// The last number that is dealt with by these records.
    pub until: u64,
    /// The records.
    pub records: Vec<Fetched>,
}

/// What became of records that were handed over.
#[derive(Debug, Default)]
pub(super) struct Took {
    /// Those that are held now.
    pub taken: BTreeSet<Numbered>,
    /// Those whose anchors the chain here does not have yet: they are asked for again.
    pub later: BTreeSet<Numbered>,
    /// Why others are not held.
    pub refused: Vec<Refusal>,
    /// Why some of `later` could not be judged: the chain here says nothing now.
    pub silent: Option<Refusal>,
}

/// A number of a topic.
pub(super) type Numbered = (Address, RecorderId, TopicId, u64);

/// How far a gateway's holdings were read.
#[derive(Debug, Default)]
pub(super) struct Course {
    pub(super) after: HoldingPlace,
    pub(super) newest: u64,
    pub(super) at_end: bool,
    begun: Option<Instant>,
    /// When the newest blocks were read again, and up to which block holdings were read then.
    again: Option<(Instant, u64)>,
    /// What was kept here when holdings were read from the beginning.
    copies: Option<Copies>,
    /// Numbers that it told and did not give, or gave with something that does not hold.
    pub(super) set_aside: BTreeSet<Numbered>,
    /// Numbers that it told and that another line was fetching then.
    pub(super) elsewhere: BTreeMap<Which, Vec<u64>>,
    pub(super) twice: BTreeSet<Digest>,
    /// Whether the last of its records were true: then many are judged together, else each answer by itself.
    pub(super) was_true: bool,
    /// It is of an earlier version, which hands over one range at a time.
    pub(super) one_by_one: bool,
    /// Owners whose records are not taken, of those that would be kept here.
    pub(super) passed_over: BTreeSet<Address>,
    erased: ErasureCourse,
}

impl Course {
    /// Whether all of its holdings were read.
    pub fn is_at_end(&self) -> bool {
        self.at_end
    }

    /// A session with the gateway has begun.
    pub fn connected(&mut self) {
        self.erased.connected();
        self.one_by_one = false;
    }

    /// How many owners have records there that are not taken here.
    pub fn passed_over(&self) -> u64 {
        self.passed_over.len() as u64
    }

    /// How many of the numbers that were set aside are not here still; those that came another way are forgotten.
    fn still_aside(&mut self, here: &impl Here) -> Result<u64, Ended> {
        let mut topics: BTreeMap<(Address, RecorderId, TopicId), Vec<u64>> = BTreeMap::new();
        for (owner, recorder, topic_id, number) in &self.set_aside {
            topics.entry((*owner, *recorder, *topic_id)).or_default().push(*number);
        }
        self.set_aside.clear();
        for ((owner, recorder, topic_id), numbers) in topics {
            let held = Held { owner, recorder, topic_id, ranges: Ranges::of(numbers) };
            let lacking = here.lacking(&[held]).map_err(Ended::Here)?;
            let numbers =
                lacking.iter().flat_map(|lacking| lacking.numbers.iter()).flat_map(|(first, last)| first..=last);
            self.set_aside.extend(numbers.map(|number| (owner, recorder, topic_id, number)));
        }
        Ok(self.set_aside.len() as u64)
    }

    /// Reads from the beginning the first time, now and then, when an owner may use this gateway who might not before, and
    /// when other records fall to this gateway.
    fn begin(&mut self, here: &impl Here, now: Instant) -> Copies {
        let copies = here.copies();
        let due = self.begun.is_none_or(|begun| now.duration_since(begun) >= WHOLE && self.at_end);
        let other = self.copies.as_ref() != Some(&copies);
        if due || other || self.passed_over.iter().any(|owner| here.welcomes(owner).is_ok()) {
            (self.after, self.begun, self.at_end) = (HoldingPlace::default(), Some(now), false);
            (self.again, self.copies) = (None, Some(copies.clone()));
            self.set_aside.clear();
            self.elsewhere.clear();
            self.twice.clear();
            self.passed_over.clear();
        }
        copies
    }

    /// All of it was read up to a place. Goes on there; now and then some blocks before it, and at once if the chain here did
    /// not have some of them yet.
    pub(super) fn rest(&mut self, next: HoldingPlace, before: u64, lagged: bool, now: Instant) {
        let back_to = |block: u64| HoldingPlace { block: block.saturating_sub(AGAIN), ..HoldingPlace::default() };
        self.after = next;
        if lagged {
            (self.newest, self.after) = (before, back_to(before));
            return;
        }
        match self.again {
            Some((last, _)) if now.duration_since(last) < LATE => {}
            Some((_, block)) => (self.after, self.again) = (back_to(block), Some((now, self.newest))),
            None => self.again = Some((now, self.newest)),
        }
    }
}

/// What came of a round.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Round {
    /// Records taken.
    pub taken: u64,
    /// Records that are gone here at their owners' word, or going, by owner.
    pub erased: BTreeMap<Address, u64>,
    /// Records that were lacking and still are.
    pub lacking: u64,
    /// Records that both anchored, newly seen.
    pub twice: u64,
    /// What was refused, by reason.
    pub refused: BTreeMap<Code, u64>,
    /// Whether there is more to do at once.
    pub more: bool,
}

/// Why a round ended early.
#[derive(Debug)]
pub(super) enum Ended {
    /// The connection, or the other one refused.
    Gateway(GatewayError),
    /// This gateway cannot take anything now.
    Here(Refusal),
    /// The other one says what cannot be, or sends what does not hold.
    Lies(String),
}

impl From<GatewayError> for Ended {
    fn from(error: GatewayError) -> Self {
        match error {
            // A message without a meaning is a lie, too: the sender has a session under our key.
            GatewayError::Malformed { .. } => Self::Lies(error.to_string()),
            error => Self::Gateway(error),
        }
    }
}

/// One round; what was done is in `round` even if it ends early.
///
/// # Errors
/// [`Ended`].
pub(super) async fn reconcile(
    other: &mut impl Other,
    here: &impl Here,
    course: &mut Course,
    round: &mut Round,
) -> Result<(), Ended> {
    read_erasures(other, here, &mut course.erased, round).await?;
    let copies = course.begin(here, Instant::now());
    Visit::new(other, here, &copies, (&mut *course, &mut *round)).read_on().await?;
    // What it told and did not give is not here, whenever it told it.
    round.lacking += course.still_aside(here)?;
    Ok(())
}

/// Room and admission are this keeper's business, and no lie of the other one; nor is a record of the contract that it used
/// before.
pub(super) fn is_a_lie(code: Code) -> bool {
    !matches!(code, Code::NotYours | Code::Quota | Code::NotAuthorised | Code::Suspended | Code::NotRegistered)
}

/// Whether a refusal says that nothing can be taken here now, whosever it is.
pub(super) fn is_of_here(code: Code) -> bool {
    matches!(code, Code::Stale | Code::Internal | Code::Closing)
}

#[cfg(test)]
#[path = "round_tests.rs"]
pub(super) mod tests;

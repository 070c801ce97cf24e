//! One round with another gateway of the fleet: what does it hold, what of that is lacking here, and that is taken over.
//! Everything is bounded here, whatever the other one says; a round that was cut short is resumed, because its state is
//! what is held.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use async_trait::async_trait;

use super::copies::Copies;
use super::fetching::{Claim, Which};
use super::round_erased::{ErasureCourse, TookErased, read_erasures};
use crate::gateway::{
    Client, Code, ErasurePlace, Erasures, Fetched, GatewayError, HandedOver, Held, HoldingPlace, Holdings, Refusal,
    ToldErasure, Wanted,
};
use crate::model::{Address, Digest, Ranges, RecorderId, TopicId};
use crate::store::Lacking;

/// The most answers about holdings that are read in a round.
pub(super) const MOST_PAGES: usize = 8;
/// The most requests for records in a round.
const MOST_REQUESTS: usize = 256;
/// No further records are asked for once a round took so many bytes.
const MOST_BYTES: usize = 64 * 1024 * 1024;
/// After so many refusals of what it sent, a gateway is left alone for a while.
pub(super) const MOST_REFUSED: usize = 16;
/// After so many records whose anchors the chain here does not have yet, the round is over.
const MOST_LATER: usize = 1024;
/// The most numbers that are remembered as not to be had, until holdings are read from the beginning again.
const MOST_SET_ASIDE: usize = 16_384;
/// The most records remembered as anchored twice.
const MOST_TWICE: usize = 4096;
/// The most owners remembered as not admitted.
const MOST_PASSED_OVER: usize = 1024;
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

    /// Which of these records are lacking.
    fn lacking(&self, held: &Held) -> Result<Lacking, Refusal>;

    /// Keeps other lines from fetching the same records until the claim is dropped.
    fn claim(&self, which: Which, wanted: Vec<u64>) -> Claim;

    /// Takes records of a range, each checked as if its robot had sent it.
    async fn take(&self, wanted: &Wanted, records: Vec<Fetched>) -> Result<Took, Refusal>;

    /// Erases here what its owners had erased, as far as all of it holds; what is done is counted in `round`. With patience,
    /// an anchor that the chain here does not have yet is waited for.
    async fn erase(&self, told: Vec<ToldErasure>, patient: bool, round: &mut Round) -> Result<TookErased, Refusal>;
}

/// What became of records that were handed over.
#[derive(Debug, Default)]
pub(super) struct Took {
    /// The numbers that are held now.
    pub taken: Vec<u64>,
    /// Those whose anchors the chain here does not have yet: they are asked for again.
    pub later: Vec<u64>,
    /// Why others are not held.
    pub refused: Vec<Refusal>,
}

/// A number of a topic.
type Numbered = (Address, RecorderId, TopicId, u64);

/// How far a gateway's holdings were read.
#[derive(Debug, Default)]
pub(super) struct Course {
    after: HoldingPlace,
    newest: u64,
    at_end: bool,
    begun: Option<Instant>,
    /// When the newest blocks were read again, and up to which block holdings were read then.
    again: Option<(Instant, u64)>,
    /// What was kept here when holdings were read from the beginning.
    copies: Option<Copies>,
    /// Numbers that it told and did not give, or gave with something that does not hold.
    set_aside: BTreeSet<Numbered>,
    /// Numbers that it told and that another line was fetching then.
    elsewhere: BTreeMap<Which, Vec<u64>>,
    twice: BTreeSet<Digest>,
    /// Owners whose records are not taken.
    passed_over: BTreeSet<Address>,
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
            let lacking = here.lacking(&held).map_err(Ended::Here)?.numbers;
            let numbers = lacking.iter().flat_map(|(first, last)| first..=last);
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
    fn rest(&mut self, next: HoldingPlace, before: u64, lagged: bool, now: Instant) {
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

/// What is left of a round's bounds.
struct Left {
    requests: usize,
    bytes: usize,
    refusals: usize,
    later: usize,
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
    read_on(other, (here, &copies), course, round).await?;
    // What it told and did not give is not here, whenever it told it.
    round.lacking += course.still_aside(here)?;
    Ok(())
}

async fn read_on<Place: Here>(
    other: &mut impl Other,
    (here, copies): (&Place, &Copies),
    course: &mut Course,
    round: &mut Round,
) -> Result<(), Ended> {
    let mut left = Left { requests: MOST_REQUESTS, bytes: MOST_BYTES, refusals: MOST_REFUSED, later: MOST_LATER };
    let before = course.newest;
    if !left_to_others(other, (here, copies), course, round, &mut left).await? {
        round.more = true;
        return Ok(());
    }
    for _ in 0..MOST_PAGES {
        let page = other.holdings(course.after).await?;
        if page.next < course.after || page.more && page.next == course.after {
            return Err(Ended::Lies("its list of what it holds does not advance".to_owned()));
        }
        for held in &page.held {
            if !one(other, (here, copies), course, round, (held, &mut left)).await? {
                // The same part is told again; what was taken of it is here by then.
                (round.more, course.at_end) = (true, false);
                return Ok(());
            }
        }
        course.newest = course.newest.max(page.next.block);
        course.at_end = !page.more;
        if !page.more {
            course.rest(page.next, before, left.later < MOST_LATER, Instant::now());
            return Ok(());
        }
        course.after = page.next;
    }
    round.more = true;
    Ok(())
}

/// Asks for what another line was fetching and has not brought; `false` = the round's bounds are reached.
async fn left_to_others<Place: Here>(
    other: &mut impl Other,
    (here, copies): (&Place, &Copies),
    course: &mut Course,
    round: &mut Round,
    left: &mut Left,
) -> Result<bool, Ended> {
    let topics: Vec<Which> = course.elsewhere.keys().copied().collect();
    for which in topics {
        let Some(numbers) = course.elsewhere.remove(&which) else { continue };
        let (owner, recorder, topic_id) = which;
        let held = Held { owner, recorder, topic_id, ranges: Ranges::of(numbers.clone()) };
        let done = one(other, (here, copies), course, round, (&held, left)).await;
        if !matches!(done, Ok(true)) {
            course.elsewhere.entry(which).or_default().extend(numbers);
            return done;
        }
    }
    Ok(true)
}

/// What is told of one topic; `false` = the round's bounds are reached.
async fn one<Place: Here>(
    other: &mut impl Other,
    (here, copies): (&Place, &Copies),
    course: &mut Course,
    round: &mut Round,
    (held, left): (&Held, &mut Left),
) -> Result<bool, Ended> {
    match here.welcomes(&held.owner) {
        Ok(()) => {}
        Err(refusal) if is_of_here(refusal.code) => return Err(Ended::Here(refusal)),
        Err(_) => {
            if course.passed_over.len() < MOST_PASSED_OVER {
                course.passed_over.insert(held.owner);
            }
            return Ok(true);
        }
    }
    let ranges = copies.kept((&held.owner, &held.recorder, &held.topic_id), &held.ranges);
    if ranges.is_empty() {
        return Ok(true);
    }
    let held = &Held { ranges, ..*held };
    let Lacking { numbers, twice } = here.lacking(held).map_err(Ended::Here)?;
    for digest in twice {
        if course.twice.len() < MOST_TWICE && course.twice.insert(digest) {
            round.twice += 1;
        }
    }
    let Held { owner, recorder, topic_id, .. } = *held;
    let wanted: Vec<u64> = numbers
        .iter()
        .flat_map(|(first, last)| first..=last)
        .filter(|number| !course.set_aside.contains(&(owner, recorder, topic_id, *number)))
        .collect();
    let claim = here.claim((owner, recorder, topic_id), wanted);
    if !claim.elsewhere.is_empty() {
        round.lacking += claim.elsewhere.len() as u64;
        if course.elsewhere.values().map(Vec::len).sum::<usize>() + claim.elsewhere.len() > MOST_SET_ASIDE {
            return Ok(false);
        }
        course.elsewhere.entry((owner, recorder, topic_id)).or_default().extend(&claim.elsewhere);
    }
    let wanted = Ranges::of(claim.numbers.clone());
    let mut open = wanted.count();
    for (first, last) in wanted.iter() {
        let mut next = Some(first);
        while let Some(first) = next {
            if left.requests == 0 || left.bytes == 0 {
                round.lacking += open;
                return Ok(false);
            }
            let asked = Wanted { owner, recorder, topic_id, first, last };
            let (until, taken) = some(other, here, course, round, (&asked, left)).await?;
            open = open.saturating_sub(until - first + 1);
            round.taken += taken;
            next = (until < last).then(|| until + 1);
        }
    }
    Ok(true)
}

/// Asks for records of a range once; returns the last number that is dealt with, and how many were taken.
async fn some(
    other: &mut impl Other,
    here: &impl Here,
    course: &mut Course,
    round: &mut Round,
    (asked, left): (&Wanted, &mut Left),
) -> Result<(u64, u64), Ended> {
    let handed = other.hand_over(*asked).await?;
    let until = match handed.next {
        None => asked.last,
        Some(next) if (asked.first + 1..=asked.last).contains(&next) => next - 1,
        Some(_) => return Err(Ended::Lies("what it hands over does not advance".to_owned())),
    };
    let bytes: usize = handed.records.iter().map(|record| record.blob.len()).sum();
    (left.requests, left.bytes) = (left.requests - 1, left.bytes.saturating_sub(bytes));
    let Took { taken, later, refused } = here.take(asked, handed.records).await.map_err(Ended::Here)?;
    round.lacking += later.len() as u64;
    for number in (asked.first..=until).filter(|number| !taken.contains(number) && !later.contains(number)) {
        if course.set_aside.len() >= MOST_SET_ASIDE {
            return Err(Ended::Lies("it tells of far more than it hands over".to_owned()));
        }
        course.set_aside.insert((asked.owner, asked.recorder, asked.topic_id, number));
    }
    for refusal in refused {
        *round.refused.entry(refusal.code).or_default() += 1;
        if !is_a_lie(refusal.code) {
            continue;
        }
        left.refusals -= 1;
        if left.refusals == 0 {
            return Err(Ended::Lies(format!("{MOST_REFUSED} of its records do not hold, the last one: {refusal}")));
        }
    }
    left.later = left.later.saturating_sub(later.len());
    if left.later == 0 {
        let why = "the node here does not have the blocks with its anchors yet";
        return Err(Ended::Here(Refusal::new(Code::Stale, why)));
    }
    Ok((until, taken.len() as u64))
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
mod tests;

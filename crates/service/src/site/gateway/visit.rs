//! What is done in a round with another gateway: its holdings are read, what is lacking here is claimed, asked for, and
//! taken some at a time.

use std::time::{Duration, Instant};

use super::copies::Copies;
use super::fetching::{Claim, Which};
use super::round::{Course, Ended, Handed, Here, Other, Round, Took, is_a_lie, is_of_here};
use crate::gateway::command::holdings::{MOST_HANDED, MOST_HANDED_BYTES, MOST_RANGES, MOST_TOLD};
use crate::gateway::{Code, HandedOver, Held, ManyHandedOver, Refusal, Wanted};
use crate::model::{Address, Header, Ranges};
use crate::store::Lacking;

/// So long records that came wait for others, so that a slow gateway does not keep them from other lines.
const LONGEST: Duration = Duration::from_secs(1);
/// Of so many topics it is looked at once what is lacking.
const TOPICS: usize = 16;
/// The most answers about holdings that are read in a round.
pub(super) const MOST_PAGES: usize = 8;
/// The most requests for records in a round.
pub(super) const MOST_REQUESTS: usize = 256;
/// No further records are asked for once a round took so many bytes.
const MOST_BYTES: usize = 64 * 1024 * 1024;
/// After so many refusals of what it sent, a gateway is left alone for a while.
pub(super) const MOST_REFUSED: usize = 16;
/// After so many records whose anchors the chain here does not have yet, the round is over.
pub(super) const MOST_LATER: usize = 1024;
/// The most numbers that are remembered as not to be had, until holdings are read from the beginning again.
const MOST_SET_ASIDE: usize = 16_384;
/// The most records remembered as anchored twice.
const MOST_TWICE: usize = 4096;
/// The most owners remembered as not admitted.
const MOST_PASSED_OVER: usize = 1024;

/// What is left of a round's bounds.
struct Left {
    requests: usize,
    bytes: usize,
    refusals: usize,
    later: usize,
}

/// What is to be asked for: ranges of several topics go into one request.
#[derive(Default)]
struct List {
    wanted: Vec<Wanted>,
    /// Nobody else fetches them meanwhile.
    claims: Vec<Claim>,
}

impl List {
    fn count(&self) -> u64 {
        self.wanted.iter().map(Wanted::count).sum()
    }

    /// Whether one answer can also hold this range.
    fn has_room_for(&self, one: &Wanted) -> bool {
        self.wanted.len() < MOST_RANGES && self.count().saturating_add(one.count()) <= MOST_HANDED as u64
    }
}

/// Records that were handed over and are not taken yet: they are checked and written together, because each
/// write costs more than a record.
#[derive(Default)]
struct Basket {
    parts: Vec<Handed>,
    /// Nobody else fetches them meanwhile.
    claims: Vec<Claim>,
    records: usize,
    bytes: usize,
    /// When the first of them came.
    since: Option<Instant>,
}

impl Basket {
    fn add(&mut self, part: Handed) {
        self.since.get_or_insert_with(Instant::now);
        self.records += part.records.len();
        self.bytes += part.records.iter().map(|record| record.blob.len()).sum::<usize>();
        self.parts.push(part);
    }

    fn is_full(&self) -> bool {
        let waited = self.since.is_some_and(|since| since.elapsed() >= LONGEST);
        waited || self.records >= MOST_HANDED || self.bytes >= MOST_HANDED_BYTES || self.parts.len() >= MOST_HANDED
    }
}

/// One round with another gateway.
pub(super) struct Visit<'a, Far, Near> {
    other: &'a mut Far,
    here: &'a Near,
    copies: &'a Copies,
    course: &'a mut Course,
    round: &'a mut Round,
    left: Left,
    list: List,
    basket: Basket,
    /// The last owner who was looked at, and whether its records are taken here.
    last: Option<(Address, bool)>,
}

impl<'a, Far: Other, Near: Here> Visit<'a, Far, Near> {
    /// Nothing is done yet.
    pub fn new(
        other: &'a mut Far,
        here: &'a Near,
        copies: &'a Copies,
        (course, round): (&'a mut Course, &'a mut Round),
    ) -> Self {
        let left = Left { requests: MOST_REQUESTS, bytes: MOST_BYTES, refusals: MOST_REFUSED, later: MOST_LATER };
        let (list, basket) = (List::default(), Basket::default());
        Self { other, here, copies, course, round, left, list, basket, last: None }
    }

    /// Reads on where the last round ended.
    ///
    /// # Errors
    /// [`Ended`].
    pub async fn read_on(mut self) -> Result<(), Ended> {
        let before = self.course.newest;
        if !self.left_to_others().await? {
            self.round.more = true;
            return Ok(());
        }
        for _ in 0..MOST_PAGES {
            let page = self.other.holdings(self.course.after).await?;
            if page.next < self.course.after || page.more && page.next == self.course.after {
                return Err(Ended::Lies("its list of what it holds does not advance".to_owned()));
            }
            if !self.all(&page.held).await? {
                // The same part is told again; what was taken of it is here by then.
                (self.round.more, self.course.at_end) = (true, false);
                return Ok(());
            }
            self.course.newest = self.course.newest.max(page.next.block);
            self.course.at_end = !page.more;
            if !page.more {
                self.course.rest(page.next, before, self.left.later < MOST_LATER, Instant::now());
                return Ok(());
            }
            self.course.after = page.next;
        }
        self.round.more = true;
        Ok(())
    }

    /// Asks for what another line was fetching and has not brought; `false` = the round's bounds are reached.
    async fn left_to_others(&mut self) -> Result<bool, Ended> {
        let elsewhere = std::mem::take(&mut self.course.elsewhere);
        let held = |(which, numbers): (&Which, &Vec<u64>)| {
            let (owner, recorder, topic_id) = *which;
            Held { owner, recorder, topic_id, ranges: Ranges::of(numbers.clone()) }
        };
        let told: Vec<Held> = elsewhere.iter().map(held).collect();
        let done = self.all(&told).await;
        if !matches!(done, Ok(true)) {
            // What of it is here by now is seen the next time.
            self.course.elsewhere = elsewhere;
        }
        done
    }

    /// What is told of these topics, all taken; `false` = the round's bounds are reached.
    async fn all(&mut self, told: &[Held]) -> Result<bool, Ended> {
        let done = self.each(told).await;
        if !matches!(done, Err(Ended::Here(_))) {
            // A line that breaks again and again brings something all the same.
            self.empty().await?;
        }
        done
    }

    async fn each(&mut self, told: &[Held]) -> Result<bool, Ended> {
        for some in told.chunks(TOPICS) {
            let kept = self.kept(some)?;
            let (lacking, requests) = (self.here.lacking(&kept).map_err(Ended::Here)?, self.left.requests);
            for (held, lacking) in kept.iter().zip(lacking) {
                if !self.one(held, lacking, requests == self.left.requests).await? {
                    self.ask_for_all().await?;
                    return Ok(false);
                }
            }
        }
        self.ask_for_all().await
    }

    /// What of these topics is kept here.
    fn kept(&mut self, told: &[Held]) -> Result<Vec<Held>, Ended> {
        let mut kept = Vec::with_capacity(told.len());
        for held in told {
            let ranges = self.copies.kept((&held.owner, &held.recorder, &held.topic_id), &held.ranges);
            // Only of what falls to this gateway it matters who is admitted.
            if !ranges.is_empty() && self.is_welcome(&held.owner)? {
                kept.push(Held { ranges, ..*held });
            }
        }
        Ok(kept)
    }

    fn is_welcome(&mut self, owner: &Address) -> Result<bool, Ended> {
        if let Some((_, welcome)) = self.last.filter(|(last, _)| last == owner) {
            return Ok(welcome);
        }
        let welcome = match self.here.welcomes(owner) {
            Ok(()) => true,
            Err(refusal) if is_of_here(refusal.code) => return Err(Ended::Here(refusal)),
            Err(_) => {
                if self.course.passed_over.len() < MOST_PASSED_OVER {
                    self.course.passed_over.insert(*owner);
                }
                false
            }
        };
        self.last = Some((*owner, welcome));
        Ok(welcome)
    }

    /// What is told of one topic; `false` = the round's bounds are reached. Unless what is lacking was looked up just now,
    /// another line may have brought it meanwhile.
    async fn one(&mut self, held: &Held, Lacking { numbers, twice }: Lacking, just_now: bool) -> Result<bool, Ended> {
        for digest in twice {
            if self.course.twice.len() < MOST_TWICE && self.course.twice.insert(digest) {
                self.round.twice += 1;
            }
        }
        let Held { owner, recorder, topic_id, .. } = *held;
        let wanted: Vec<u64> = numbers
            .iter()
            .flat_map(|(first, last)| first..=last)
            .filter(|number| !self.course.set_aside.contains(&(owner, recorder, topic_id, *number)))
            .collect();
        if wanted.is_empty() {
            return Ok(true);
        }
        let claim = self.here.claim((owner, recorder, topic_id), wanted);
        if !claim.elsewhere.is_empty() && !self.leave_to_others((owner, recorder, topic_id), &claim.elsewhere) {
            return Ok(false);
        }
        let mut wanted = Ranges::of(claim.numbers.clone());
        if !just_now {
            let claimed = Held { owner, recorder, topic_id, ranges: wanted };
            wanted = self.here.lacking(&[claimed]).map_err(Ended::Here)?.pop().unwrap_or_default().numbers;
        }
        // What was on the list before is asked for and taken without this claim, so that it does not end with those.
        let done = self.fetch((owner, recorder, topic_id), &wanted).await;
        self.list.claims.push(claim);
        done
    }

    /// Remembers what another line is fetching; `false` = there is too much of it.
    fn leave_to_others(&mut self, which: Which, numbers: &[u64]) -> bool {
        self.round.lacking += numbers.len() as u64;
        let elsewhere = &mut self.course.elsewhere;
        if elsewhere.values().map(Vec::len).sum::<usize>() + numbers.len() > MOST_SET_ASIDE {
            return false;
        }
        elsewhere.entry(which).or_default().extend(numbers);
        true
    }

    /// Puts all of these numbers, which are claimed, on the list; `false` = the round's bounds are reached.
    async fn fetch(&mut self, (owner, recorder, topic_id): Which, wanted: &Ranges) -> Result<bool, Ended> {
        let mut open = wanted.count();
        for (first, last) in wanted.iter().flat_map(requested) {
            let one = Wanted { owner, recorder, topic_id, first, last };
            // The first one may be longer than an answer.
            let has_room = self.list.wanted.is_empty() || self.asks_together() && self.list.has_room_for(&one);
            if !has_room && !self.ask_for_all().await? {
                self.round.lacking += open;
                return Ok(false);
            }
            open -= one.count();
            self.list.wanted.push(one);
        }
        Ok(true)
    }

    /// Of one that is not known to be honest, each answer is judged by itself.
    fn asks_together(&self) -> bool {
        self.course.was_true && !self.course.one_by_one
    }

    /// Asks for all that is on the list; `false` = the round's bounds are reached.
    async fn ask_for_all(&mut self) -> Result<bool, Ended> {
        while !self.list.wanted.is_empty() {
            if self.left.requests == 0 || self.left.bytes == 0 {
                self.round.lacking += self.list.count();
                self.list.wanted.clear();
                self.basket.claims.append(&mut self.list.claims);
                return Ok(false);
            }
            self.ask_for_some().await?;
        }
        // They end when what was handed over is taken.
        self.basket.claims.append(&mut self.list.claims);
        Ok(true)
    }

    /// One request, for the first ranges of the list or all of them. What is dealt with leaves it.
    async fn ask_for_some(&mut self) -> Result<(), Ended> {
        let together = self.asks_together() && self.list.wanted.len() > 1;
        let many = if together {
            match self.other.hand_over_many(&self.list.wanted).await? {
                Some(many) => many,
                None => {
                    self.course.one_by_one = true;
                    return Ok(());
                }
            }
        } else {
            let Some(first) = self.list.wanted.first() else { return Ok(()) };
            ManyHandedOver { handed: self.other.hand_over(*first).await?, range: 0 }
        };
        let asked = if together { self.list.wanted.len() } else { 1 };
        let parts = dealt_with(&mut self.list.wanted, asked, many)?;
        let bytes: usize = parts.iter().flat_map(|part| &part.records).map(|record| record.blob.len()).sum();
        (self.left.requests, self.left.bytes) = (self.left.requests - 1, self.left.bytes.saturating_sub(bytes));
        parts.into_iter().for_each(|part| self.basket.add(part));
        if !self.course.was_true || self.basket.is_full() {
            self.empty().await?;
        }
        Ok(())
    }

    /// Takes what is in the basket.
    async fn empty(&mut self) -> Result<(), Ended> {
        let Basket { parts, claims, .. } = std::mem::take(&mut self.basket);
        if parts.is_empty() {
            return Ok(());
        }
        let asked: Vec<(Wanted, u64)> = parts.iter().map(|part| (part.wanted, part.until)).collect();
        let took = self.here.take(parts).await.map_err(Ended::Here)?;
        drop(claims);
        self.note(&asked, took)
    }

    fn note(&mut self, asked: &[(Wanted, u64)], took: Took) -> Result<(), Ended> {
        let Took { taken, later, refused, silent } = took;
        self.round.taken += taken.len() as u64;
        self.round.lacking += later.len() as u64;
        for (Wanted { owner, recorder, topic_id, first, .. }, until) in asked {
            let numbers = (*first..=*until).map(|number| (*owner, *recorder, *topic_id, number));
            for one in numbers.filter(|one| !taken.contains(one) && !later.contains(one)) {
                if self.course.set_aside.len() >= MOST_SET_ASIDE {
                    return Err(Ended::Lies("it tells of far more than it hands over".to_owned()));
                }
                self.course.set_aside.insert(one);
            }
        }
        self.course.was_true =
            !refused.iter().any(|refusal| is_a_lie(refusal.code)) && (self.course.was_true || !taken.is_empty());
        self.note_refused(&refused)?;
        if let Some(refusal) = silent {
            return Err(Ended::Here(refusal));
        }
        self.left.later = self.left.later.saturating_sub(later.len());
        if self.left.later == 0 {
            let why = "the node here does not have the blocks with its anchors yet";
            return Err(Ended::Here(Refusal::new(Code::Stale, why)));
        }
        Ok(())
    }

    fn note_refused(&mut self, refused: &[Refusal]) -> Result<(), Ended> {
        for refusal in refused {
            *self.round.refused.entry(refusal.code).or_default() += 1;
            if !is_a_lie(refusal.code) {
                continue;
            }
            self.left.refusals -= 1;
            if self.left.refusals == 0 {
                return Err(Ended::Lies(format!("{MOST_REFUSED} of its records do not hold, the last one: {refusal}")));
            }
        }
        Ok(())
    }
}

/// A range in parts that may be asked for.
fn requested((first, last): (u64, u64)) -> impl Iterator<Item = (u64, u64)> {
    let step = usize::try_from(MOST_TOLD).unwrap_or(usize::MAX);
    (first..=last).step_by(step).map(move |begin| (begin, last.min(begin.saturating_add(MOST_TOLD - 1))))
}

/// Takes off a list what an answer for its first `asked` ranges deals with: each range, or a part of it, with its records.
fn dealt_with(list: &mut Vec<Wanted>, asked: usize, many: ManyHandedOver) -> Result<Vec<Handed>, Ended> {
    let ManyHandedOver { handed: HandedOver { records, next }, range } = many;
    let mut parts: Vec<Handed> = Vec::with_capacity(asked);
    let part = |wanted: &Wanted, until| Handed { wanted: *wanted, until, records: Vec::new() };
    match next {
        None => parts.extend(list.drain(..asked.min(list.len())).map(|wanted| part(&wanted, wanted.last))),
        Some(next) => {
            let range = usize::from(range);
            let on = list.get(range).filter(|on| range < asked && (on.first..=on.last).contains(&next)).copied();
            let on = on.filter(|on| range > 0 || next > on.first);
            let on = on.ok_or_else(|| Ended::Lies("what it hands over does not advance".to_owned()))?;
            parts.extend(list.drain(..range).map(|wanted| part(&wanted, wanted.last)));
            if next > on.first {
                parts.push(part(&on, next - 1));
            }
            list.iter_mut().take(1).for_each(|rest| rest.first = next);
        }
    }
    for record in records {
        // One that nobody asked for is refused with whatever it comes with.
        let place = Header::parse(&record.blob)
            .ok()
            .and_then(|(header, _)| parts.iter().position(|part| part.wanted.has(&header)));
        if let Some(part) = parts.get_mut(place.unwrap_or(0)) {
            part.records.push(record);
        }
    }
    Ok(parts)
}

#[cfg(test)]
#[path = "visit_many_tests.rs"]
mod many_tests;
#[cfg(test)]
#[path = "visit_tests.rs"]
mod tests;

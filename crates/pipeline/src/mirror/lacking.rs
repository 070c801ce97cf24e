//! What each gateway lacks of what others list, or this home has; and which numbers nobody lists. Of numbers alone: no
//! gateway is believed that a record is sound, only compared with what the others say.

use std::collections::{BTreeMap, BTreeSet};

use crate::gateway::{Entry, Standing};
use crate::model::{Address, Ranges, RecorderId, Spans, TopicId};

/// The numbers that one recorder gave on one topic of one owner.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Series {
    /// The owner.
    pub owner: Address,
    /// The recorder.
    pub recorder: RecorderId,
    /// Pseudonym of the topic.
    pub topic_id: TopicId,
}

/// What somebody has of a series.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Numbers {
    /// Every number it knows of, whatever became of the record.
    pub known: Ranges,
    /// Those whose bytes it has.
    pub held: Ranges,
    /// Of those, the ones it calls verified.
    pub verified: Ranges,
    /// The lowest one of an epoch that the reader was granted; `None` = none is.
    pub first: Option<u64>,
}

/// What a gateway lists.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Listing {
    /// The owners whose records it listed to the end.
    pub told: BTreeSet<Address>,
    /// The numbers.
    pub series: BTreeMap<Series, Numbers>,
}

impl Listing {
    /// Adds what the same gateway told besides, of other owners or once more.
    pub fn add(&mut self, later: Self) {
        self.told.extend(later.told);
        for (series, more) in later.series {
            let numbers = self.series.entry(series).or_default();
            numbers.known = numbers.known.union(&more.known);
            numbers.held = numbers.held.union(&more.held);
            numbers.verified = numbers.verified.union(&more.verified);
            numbers.first = [numbers.first, more.first].into_iter().flatten().min();
        }
    }
}

/// A list that is being read, entry by entry.
#[derive(Default)]
pub struct Gathering {
    series: BTreeMap<Series, Gathered>,
    spans: usize,
}

#[derive(Default)]
struct Gathered {
    known: Spans,
    held: Spans,
    verified: Spans,
    /// The first epoch that the reader was granted.
    granted: Option<u64>,
    first: Option<u64>,
}

impl Gathering {
    /// So many ranges and series one gateway may make of an owner's numbers.
    pub const MOST: usize = 500_000;

    /// Adds an entry; `granted` says from which epoch on the reader was granted the topic. `false` = it is too much.
    pub fn add(&mut self, entry: &Entry, granted: impl FnOnce() -> Option<u64>) -> bool {
        let series = Series { owner: entry.owner, recorder: entry.recorder, topic_id: entry.topic_id };
        let one = self.series.entry(series).or_insert_with(|| Gathered { granted: granted(), ..Gathered::default() });
        let before = one.size();
        one.known.add(entry.seq);
        if matches!(entry.standing, Standing::Acknowledged | Standing::Anchored | Standing::Verified) {
            one.held.add(entry.seq);
        }
        if entry.standing == Standing::Verified {
            one.verified.add(entry.seq);
        }
        if one.granted.is_some_and(|granted| entry.epoch >= granted) {
            one.first = Some(one.first.map_or(entry.seq, |first| first.min(entry.seq)));
        }
        self.spans = (self.spans + one.size()).saturating_sub(before);
        self.spans + self.series.len() <= Self::MOST
    }

    /// What was listed of these owners, each to the end.
    pub fn listing(self, told: BTreeSet<Address>) -> Listing {
        let numbers = |one: Gathered| Numbers {
            known: one.known.ranges(),
            held: one.held.ranges(),
            verified: one.verified.ranges(),
            first: one.first,
        };
        Listing { told, series: self.series.into_iter().map(|(series, one)| (series, numbers(one))).collect() }
    }
}

impl Gathered {
    fn size(&self) -> usize {
        self.known.size() + self.held.size() + self.verified.size()
    }
}

/// What this home has.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Here {
    /// The numbers.
    pub series: BTreeMap<Series, Numbers>,
    /// What was recorded here: no gateway need have it.
    pub own: BTreeSet<Series>,
    /// What was deleted, as its owner states or a retention record says: nobody need have it.
    pub gone: BTreeMap<Series, Ranges>,
}

/// Numbers that a gateway lacks, and who has them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Lack {
    /// Of this series.
    pub series: Series,
    /// These numbers.
    pub numbers: Ranges,
    /// The places of the gateways that list them.
    pub holders: Vec<usize>,
    /// Whether they are in this home.
    pub is_here: bool,
}

/// What was found.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Compared {
    /// What each gateway lacks.
    pub lacking: Vec<Vec<Lack>>,
    /// How many further numbers of records that are not verified anywhere each one does not have yet.
    pub waiting: Vec<u64>,
    /// Numbers between others that nobody lists and this home does not know of.
    pub nowhere: Vec<(Series, Ranges)>,
}

impl Compared {
    /// How many different numbers fewer gateways have than this.
    pub fn short_of(&self, copies: usize) -> u64 {
        let mut short: BTreeMap<Series, Ranges> = BTreeMap::new();
        for lack in self.lacking.iter().flatten().filter(|lack| lack.holders.len() < copies) {
            let numbers = short.entry(lack.series).or_default();
            *numbers = numbers.union(&lack.numbers);
        }
        short.values().fold(0, |sum: u64, numbers| sum.saturating_add(numbers.count()))
    }
}

/// Compares the lists of all gateways, in their order; `None` is one that told nothing, and is not compared.
pub fn compare(gateways: &[Option<&Listing>], here: &Here) -> Compared {
    let listed = gateways.iter().flatten().flat_map(|listing| listing.series.keys());
    let all: BTreeSet<Series> = listed.chain(here.series.keys()).copied().collect();
    let mut compared =
        Compared { lacking: vec![Vec::new(); gateways.len()], waiting: vec![0; gateways.len()], ..Compared::default() };
    let nothing = Numbers::default();
    for series in all {
        // Of those that told of the owner; one that lists nothing of the series has nothing of it.
        let mut parties: Vec<Party<'_>> = Vec::with_capacity(gateways.len());
        for (place, listing) in gateways.iter().enumerate() {
            if let Some(listing) = listing.filter(|one| one.told.contains(&series.owner)) {
                parties.push((place, listing.series.get(&series).unwrap_or(&nothing)));
            }
        }
        compare_one(series, &parties, here, &mut compared);
    }
    compared
}

/// A gateway's place, and what it lists of a series.
type Party<'a> = (usize, &'a Numbers);

fn compare_one(series: Series, parties: &[Party<'_>], here: &Here, compared: &mut Compared) {
    let (nothing, no_numbers) = (Numbers::default(), Ranges::default());
    let known_here = here.series.get(&series).unwrap_or(&nothing);
    let source = if here.own.contains(&series) { &nothing } else { known_here };
    let gone = here.gone.get(&series).unwrap_or(&no_numbers);
    let sum = |of: fn(&Numbers) -> &Ranges, and: &Numbers| {
        parties.iter().fold(of(and).clone(), |sum, (_, numbers)| sum.union(of(numbers)))
    };
    let verified = sum(|numbers| &numbers.verified, source).without(gone);
    let unverified = sum(|numbers| &numbers.held, source).without(gone).without(&verified);
    for (place, numbers) in parties {
        let lacking = verified.without(&numbers.held);
        if let Some(lacks) = compared.lacking.get_mut(*place)
            && !lacking.is_empty()
        {
            lacks.extend(by_holders(series, lacking, parties, source));
        }
        if let Some(waiting) = compared.waiting.get_mut(*place) {
            *waiting += unverified.without(&numbers.held).count();
        }
    }
    let known = sum(|numbers| &numbers.known, known_here).union(gone);
    let first = parties.iter().map(|(_, numbers)| *numbers).chain([known_here]).filter_map(|one| one.first).min();
    // A ring loses its oldest, and is asked for spans.
    if !series.recorder.is_ring()
        && let Some((first, (_, last))) = first.zip(known.ends())
    {
        let nowhere = Ranges::of_spans(vec![(first, last)]).without(&known);
        if !nowhere.is_empty() {
            compared.nowhere.push((series, nowhere));
        }
    }
}

/// Divides what one lacks by who has it.
fn by_holders(series: Series, lacking: Ranges, parties: &[Party<'_>], here: &Numbers) -> Vec<Lack> {
    let mut parts = vec![Lack { series, numbers: lacking, holders: Vec::new(), is_here: false }];
    let holders = parties.iter().map(|(place, numbers)| (Some(*place), *numbers)).chain([(None, here)]);
    for (place, numbers) in holders {
        let mut divided = Vec::with_capacity(parts.len());
        for part in parts {
            let mut with = Lack { numbers: part.numbers.common(&numbers.held), ..part.clone() };
            match place {
                Some(place) => with.holders.push(place),
                None => with.is_here = true,
            }
            let without = Lack { numbers: part.numbers.without(&numbers.held), ..part };
            divided.extend([with, without].into_iter().filter(|part| !part.numbers.is_empty()));
        }
        parts = divided;
    }
    parts.sort_by_key(|part| part.numbers.ends());
    parts
}

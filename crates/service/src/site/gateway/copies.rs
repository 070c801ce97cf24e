//! Which gateways of a fleet keep a record, where not all of them do: those with the highest weight for it among the
//! gateways that are there (rendezvous hashing). Each reckons by itself, and all who know the same gateways agree.

use std::fmt;

use crate::crypto::Provider;
use crate::model::{Address, Ranges, RecorderId, SignerId, TopicId};

/// Numbers of a topic that are kept together.
const TOGETHER: u64 = 256;
const LABEL: &[u8] = b"AuthROS/copies/1";

/// What is kept here of what other gateways hold.
#[derive(Clone, Default)]
pub(super) enum Copies {
    /// All of it.
    #[default]
    All,
    /// What falls to this gateway.
    Some(Choice),
}

/// Among whom a few are chosen.
#[derive(Clone)]
pub(super) struct Choice {
    provider: &'static dyn Provider,
    most: usize,
    own: Words,
    others: Vec<Words>,
}

/// SM3 in four words.
type Words = [u64; 4];

impl fmt::Debug for Copies {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::All => formatter.write_str("All"),
            Self::Some(choice) => write!(formatter, "{} of {}", choice.most, choice.others.len() + 1),
        }
    }
}

impl PartialEq for Copies {
    fn eq(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::All, Self::All) => true,
            (Self::Some(one), Self::Some(other)) => {
                (one.most, one.own, &one.others) == (other.most, other.own, &other.others)
            }
            (Self::All, Self::Some(_)) | (Self::Some(_), Self::All) => false,
        }
    }
}

impl Copies {
    /// `most` gateways keep each record: among `own`, the key of this gateway, and `others`, those of the gateways that
    /// are there.
    pub fn of(provider: &'static dyn Provider, most: Option<u16>, own: SignerId, mut others: Vec<SignerId>) -> Self {
        others.retain(|key| *key != own);
        others.sort_unstable();
        others.dedup();
        match most.map(usize::from) {
            Some(most) if most <= others.len() => {
                let (own, others) = (words(own.0), others.into_iter().map(|key| words(key.0)).collect());
                Self::Some(Choice { provider, most, own, others })
            }
            _ => Self::All,
        }
    }

    /// Those of these numbers that are kept here.
    pub fn kept(&self, which: (&Address, &RecorderId, &TopicId), told: &Ranges) -> Ranges {
        let Self::Some(choice) = self else { return told.clone() };
        let mut kept = Kept::default();
        for (first, last) in told.iter() {
            let mut next = first;
            while next <= last {
                let part = next / TOGETHER;
                let end = last.min(part.saturating_mul(TOGETHER).saturating_add(TOGETHER - 1));
                if choice.falls_here(which, part) {
                    kept.add(next, end);
                }
                next = end.saturating_add(1);
            }
        }
        kept.end()
    }
}

impl Choice {
    fn falls_here(&self, (owner, recorder, topic_id): (&Address, &RecorderId, &TopicId), part: u64) -> bool {
        let place = [LABEL, &owner.0, &recorder.0, &topic_id.0, &part.to_be_bytes()];
        let place = words(self.provider.sm3(&place));
        let own = weight(&place, &self.own);
        let before = self.others.iter().filter(|other| weight(&place, other) > own);
        before.take(self.most).count() < self.most
    }
}

fn words(hash: [u8; 32]) -> Words {
    let (eights, _) = hash.as_chunks::<8>();
    let mut words = Words::default();
    words.iter_mut().zip(eights).for_each(|(word, bytes)| *word = u64::from_be_bytes(*bytes));
    words
}

/// Both are hashes already; this only mixes them, because it is done for every gateway and every record that is told of.
fn weight(place: &Words, gateway: &Words) -> u64 {
    place.iter().zip(gateway).fold(0, |mixed: u64, (one, other)| {
        // The finaliser of SplitMix64.
        let mixed = (mixed ^ one ^ other.rotate_left(32)).wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    })
}

/// Ranges that are joined where they touch.
#[derive(Default)]
struct Kept {
    ranges: Ranges,
    open: Option<(u64, u64)>,
}

impl Kept {
    fn add(&mut self, first: u64, last: u64) {
        self.open = match self.open {
            Some((begin, end)) if first == end + 1 => Some((begin, last)),
            before => {
                self.put(before);
                Some((first, last))
            }
        };
    }

    fn put(&mut self, range: Option<(u64, u64)>) {
        if let Some((first, last)) = range {
            self.ranges.push(first, last);
        }
    }

    fn end(mut self) -> Ranges {
        self.put(self.open);
        self.ranges
    }
}

#[cfg(test)]
#[allow(clippy::expect_used, reason = "a test fails by panicking")]
mod tests {
    use super::*;
    use crate::crypto::{ProviderName, provider};

    const OWNER: Address = Address([1; 20]);
    const TOPIC: TopicId = TopicId([3; 16]);

    fn key(number: u8) -> SignerId {
        SignerId([number; 32])
    }

    fn fleet(of: u8) -> Vec<SignerId> {
        (1..=of).map(key).collect()
    }

    fn copies(most: u16, own: SignerId, there: &[SignerId]) -> Copies {
        Copies::of(provider(ProviderName::default()), Some(most), own, there.to_vec())
    }

    fn keepers(most: u16, there: &[SignerId], recorder: u8, number: u64) -> Vec<SignerId> {
        let told = Ranges::of(vec![number]);
        let keeps = |own: &SignerId| {
            let kept = copies(most, *own, there).kept((&OWNER, &RecorderId([recorder; 16]), &TOPIC), &told);
            !kept.is_empty()
        };
        there.iter().copied().filter(keeps).collect()
    }

    #[test]
    fn each_record_falls_to_as_many_gateways_as_are_wanted_and_evenly() {
        let there = fleet(20);
        let mut load = [0u32; 20];
        for recorder in 0..200 {
            let chosen = keepers(3, &there, recorder, 5);
            assert_eq!(chosen.len(), 3, "{chosen:?}");
            chosen.iter().for_each(|key| load[usize::from(key.0[0]) - 1] += 1);
        }
        assert!(load.iter().all(|count| (12..=50).contains(count)), "600 copies at 20 gateways: {load:?}");
    }

    #[test]
    fn when_a_gateway_is_gone_one_other_takes_its_place_and_the_rest_stays_as_it_is() {
        let there = fleet(8);
        for recorder in 0..50 {
            let before = keepers(2, &there, recorder, 700);
            let left: Vec<SignerId> = there.iter().copied().filter(|key| *key != before[0]).collect();
            let after = keepers(2, &left, recorder, 700);
            assert!(after.len() == 2 && after.contains(&before[1]), "{before:?} {after:?}");
        }
    }

    #[test]
    fn where_fewer_are_there_than_wanted_all_keep_everything() {
        let told = Ranges::of((1..=2000).collect());
        for (most, others) in [(Some(2), 1), (Some(9), 3), (None, 30)] {
            let all = Copies::of(provider(ProviderName::default()), most, key(99), fleet(others));
            assert_eq!(all.kept((&OWNER, &RecorderId([2; 16]), &TOPIC), &told), told);
        }
    }

    #[test]
    fn what_falls_here_and_elsewhere_is_all_that_was_told() {
        let there = fleet(3);
        let told = Ranges::of((1..=255).chain(300..=5000).chain([9000, Ranges::HIGHEST]).collect());
        let of = |own| copies(1, own, &there).kept((&OWNER, &RecorderId([2; 16]), &TOPIC), &told);
        let parts: Vec<Ranges> = there.iter().map(|own| of(*own)).collect();
        assert!(parts.iter().all(|part| !part.is_empty() && part.count() < told.count()));
        let numbers = |ranges: &Ranges| -> Vec<u64> { ranges.iter().flat_map(|(first, last)| first..=last).collect() };
        assert_eq!(Ranges::of(parts.iter().flat_map(numbers).collect()), told, "nothing falls to nobody");
        assert_eq!(parts.iter().map(Ranges::count).sum::<u64>(), told.count(), "one keeps each");
    }
}

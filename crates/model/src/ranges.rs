//! Ranges of numbers, ascending and apart: which records of a topic there are.

/// A set of numbers from 1 to [`Self::HIGHEST`], as ranges in ascending order with a gap between any two, so that every
/// set has exactly one form.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Ranges(Vec<(u64, u64)>);

impl Ranges {
    /// The highest number that a record may have.
    pub const HIGHEST: u64 = i64::MAX.unsigned_abs();

    /// Of these numbers, in any order; those that no record can have are left out.
    pub fn of(mut numbers: Vec<u64>) -> Self {
        numbers.sort_unstable();
        let mut found = Self::default();
        for number in numbers.into_iter().filter(|number| (1..=Self::HIGHEST).contains(number)) {
            match found.0.last_mut() {
                Some((_, last)) if number <= *last => {}
                Some((_, last)) if number == *last + 1 => *last = number,
                _ => found.0.push((number, number)),
            }
        }
        found
    }

    /// Adds a range behind all others; `false`, and nothing is added, if it is reversed, overlaps or touches the one
    /// before it, or has a number that no record can have.
    pub fn push(&mut self, first: u64, last: u64) -> bool {
        let least = self.0.last().map_or(1, |(_, last)| last.saturating_add(2));
        let fits = first >= least && first <= last && last <= Self::HIGHEST;
        if fits {
            self.0.push((first, last));
        }
        fits
    }

    /// First and last number of each range.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = (u64, u64)> + '_ {
        self.0.iter().copied()
    }

    /// How many numbers these are.
    pub fn count(&self) -> u64 {
        self.0.iter().fold(0, |sum: u64, (first, last)| sum.saturating_add(last - first).saturating_add(1))
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The lowest and the highest of them.
    pub fn ends(&self) -> Option<(u64, u64)> {
        Some((self.0.first()?.0, self.0.last()?.1))
    }

    /// Whether a number is among them.
    pub fn contains(&self, number: u64) -> bool {
        let behind = self.0.partition_point(|(first, _)| *first <= number);
        behind.checked_sub(1).and_then(|place| self.0.get(place)).is_some_and(|(_, last)| number <= *last)
    }

    /// Of these ranges, in any order, which may overlap; numbers that no record can have are left out.
    pub fn of_spans(mut spans: Vec<(u64, u64)>) -> Self {
        spans.sort_unstable();
        let mut found = Self::default();
        for (first, last) in spans {
            let (first, last) = (first.max(1), last.min(Self::HIGHEST));
            match found.0.last_mut() {
                _ if first > last => {}
                Some((_, end)) if first <= end.saturating_add(1) => *end = last.max(*end),
                _ => found.0.push((first, last)),
            }
        }
        found
    }

    /// The numbers of both.
    pub fn union(&self, other: &Self) -> Self {
        Self::of_spans(self.iter().chain(other.iter()).collect())
    }

    /// Its numbers without those of another.
    pub fn without(&self, other: &Self) -> Self {
        let (mut left, mut taken) = (Self::default(), other.iter().peekable());
        for (mut first, last) in self.iter() {
            while taken.next_if(|(_, end)| *end < first).is_some() {}
            // What takes of this range; the last of them may take of the next one, too.
            while first <= last
                && let Some((begin, end)) = taken.peek().copied().filter(|(begin, _)| *begin <= last)
            {
                if begin > first {
                    left.0.push((first, begin - 1));
                }
                first = end.saturating_add(1);
                taken.next_if(|(_, end)| *end < last);
            }
            if first <= last {
                left.0.push((first, last));
            }
        }
        left
    }

    /// The numbers that are in both.
    pub fn common(&self, other: &Self) -> Self {
        self.without(&self.without(other))
    }
}

/// Numbers as they come, mostly one after the other: what they take of memory follows from the ranges that they make.
#[derive(Debug, Clone, Default)]
pub struct Spans {
    spans: Vec<(u64, u64)>,
    /// How many there were when they were last put in order.
    ordered: usize,
}

impl Spans {
    /// So many may wait before they are put in order.
    const LOOSE: usize = 256;

    /// Adds a number.
    pub fn add(&mut self, number: u64) {
        match self.spans.last_mut() {
            Some((first, last)) if (*first..=*last).contains(&number) => {}
            Some((_, last)) if last.checked_add(1) == Some(number) => *last = number,
            _ => {
                if self.spans.len() >= self.ordered * 2 + Self::LOOSE {
                    self.spans = Ranges::of_spans(std::mem::take(&mut self.spans)).0;
                    self.ordered = self.spans.len();
                }
                self.spans.push((number, number));
            }
        }
    }

    /// How many ranges are in memory.
    pub fn size(&self) -> usize {
        self.spans.len()
    }

    /// The numbers, in order.
    pub fn ranges(self) -> Ranges {
        Ranges::of_spans(self.spans)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn operations_on_ranges_are_those_on_sets(
            one in proptest::collection::btree_set(0_u64..40, 0..30),
            other in proptest::collection::btree_set(0_u64..40, 0..30),
            spans in proptest::collection::vec((0_u64..40, 0_u64..40), 0..12),
        ) {
            // No record has the number 0.
            let set = |numbers: &BTreeSet<u64>| numbers.iter().copied().filter(|number| *number > 0).collect::<Vec<_>>();
            let numbers = |ranges: &Ranges| ranges.iter().flat_map(|(first, last)| first..=last).collect::<Vec<_>>();
            let (left, right) = (Ranges::of(set(&one)), Ranges::of(set(&other)));
            let spanned: BTreeSet<u64> = spans.iter().flat_map(|(first, last)| *first..=*last).collect();
            let cases = [
                (left.union(&right), set(&(&one | &other))),
                (left.without(&right), set(&(&one - &other))),
                (left.common(&right), set(&(&one & &other))),
                (Ranges::of_spans(spans), set(&spanned)),
            ];
            for (found, expected) in cases {
                prop_assert_eq!(&found, &Ranges::of(expected.clone()), "in their one form");
                prop_assert_eq!(found.count(), expected.len() as u64);
                prop_assert_eq!(found.ends(), expected.first().copied().zip(expected.last().copied()));
                prop_assert!((0..41).all(|number| found.contains(number) == expected.contains(&number)));
                prop_assert_eq!(numbers(&found), expected);
            }
        }
    }

    #[test]
    fn numbers_in_any_order_become_few_ranges_on_the_way() {
        let mut spans = Spans::default();
        // Each pair the wrong way round.
        (0..20_000_u64).for_each(|number| spans.add((number ^ 1) + 1));
        assert!(spans.size() < 1_000, "{}", spans.size());
        assert_eq!(spans.ranges(), Ranges::of((1..=20_000).collect()));
        let mut scattered = Spans::default();
        (1..=2_000_u64).rev().for_each(|number| scattered.add(number * 2));
        scattered.add(u64::MAX);
        assert_eq!(scattered.ranges(), Ranges::of((1..=2_000).map(|number| number * 2).collect()));
    }

    #[test]
    fn ranges_at_the_ends_of_what_there_is_are_joined_and_taken_apart() {
        let all = Ranges::of_spans(vec![(0, u64::MAX)]);
        assert_eq!(pairs(&all), [(1, Ranges::HIGHEST)]);
        assert_eq!(Ranges::of_spans(vec![(Ranges::HIGHEST + 1, u64::MAX), (9, 8)]), Ranges::default());
        let middle = Ranges::of(vec![5]);
        assert_eq!(pairs(&all.without(&middle)), [(1, 4), (6, Ranges::HIGHEST)]);
        assert_eq!((all.without(&all), all.common(&middle)), (Ranges::default(), middle));
    }

    fn pairs(ranges: &Ranges) -> Vec<(u64, u64)> {
        ranges.iter().collect()
    }

    #[test]
    fn numbers_become_ranges_that_do_not_touch() {
        let ranges = Ranges::of(vec![7, 1, 2, 3, 9, 8, 2, 0, u64::MAX, 20]);
        assert_eq!(pairs(&ranges), [(1, 3), (7, 9), (20, 20)]);
        assert_eq!((ranges.count(), Ranges::default().count()), (7, 0));
        assert!(Ranges::of(Vec::new()).is_empty());
    }

    #[test]
    fn a_range_is_added_behind_the_others_or_not_at_all() {
        let mut ranges = Ranges::default();
        assert!(!ranges.push(0, 4), "no record has the number 0");
        assert!(ranges.push(2, 4));
        for (first, last) in [(1, 1), (3, 9), (4, 9), (5, 9), (9, 8), (9, Ranges::HIGHEST + 1), (u64::MAX, u64::MAX)] {
            assert!(!ranges.push(first, last), "{first} to {last}");
        }
        assert!(ranges.push(6, Ranges::HIGHEST) && !ranges.push(u64::MAX, u64::MAX));
        assert_eq!(pairs(&ranges), [(2, 4), (6, Ranges::HIGHEST)]);
        assert_eq!(ranges.count(), Ranges::HIGHEST - 5 + 3);
    }
}

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
}

#[cfg(test)]
mod tests {
    use super::*;

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

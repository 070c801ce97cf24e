//! Counts gaps in `header.seq`: messages a publisher sent that never arrived.

/// Follows the sequence numbers of one publisher.
#[derive(Debug, Default)]
pub(super) struct Sequence {
    last: Option<u32>,
}

impl Sequence {
    /// Takes the next number; returns how many are missing before it. The first, a repeated, and a lower one (a
    /// publisher that restarted) miss none; the step from the highest to 0 is not a gap.
    pub fn follow(&mut self, next: u32) -> u64 {
        let step = self.last.map_or(1, |last| next.wrapping_sub(last));
        self.last = Some(next);
        // More than half the range ahead counts as behind.
        if (1..1 << 31).contains(&step) { u64::from(step - 1) } else { 0 }
    }
}

/// The sequence number at the start of a body that begins with a header.
pub(super) fn header_seq(body: &[u8]) -> Option<u32> {
    body.first_chunk().copied().map(u32::from_le_bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn gaps_restarts_repeats_and_the_turn() {
        let mut sequence = Sequence::default();
        let missed: Vec<u64> = [7, 8, 8, 12, 0, 1, 3].into_iter().map(|next| sequence.follow(next)).collect();
        assert_eq!(missed, [0, 0, 0, 3, 0, 0, 1]);
        let mut sequence = Sequence::default();
        let missed: Vec<u64> = [u32::MAX - 1, u32::MAX, 0, 2].into_iter().map(|next| sequence.follow(next)).collect();
        assert_eq!(missed, [0, 0, 0, 1]);
        assert_eq!(header_seq(&[1, 0, 0]), None);
        assert_eq!(header_seq(&[2, 1, 0, 0, 9]), Some(258));
    }

    proptest! {
        #[test]
        fn what_is_dropped_is_counted(first in any::<u32>(), kept in prop::collection::vec(any::<bool>(), 1..200)) {
            let mut sequence = Sequence::default();
            sequence.follow(first);
            let mut missed = 0;
            let mut next = first;
            for keep in &kept {
                next = next.wrapping_add(1);
                if *keep {
                    missed += sequence.follow(next);
                }
            }
            let last_kept = kept.iter().rposition(|keep| *keep).map_or(0, |index| index + 1);
            let dropped = kept[..last_kept].iter().filter(|keep| !**keep).count();
            prop_assert_eq!(missed, dropped as u64);
        }
    }
}

//! Numbers that are the same in every run with the same seed.

/// A linear congruential generator; nothing secret depends on it.
pub(super) struct Chance(u64);

impl Chance {
    /// From a seed.
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// A number below `limit`; 0 if that is 0.
    pub fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33).checked_rem(limit).unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_gives_the_same_numbers_and_another_one_others() {
        let of = |seed| {
            let mut chance = Chance::new(seed);
            (0..20).map(|_| chance.below(5)).collect::<Vec<_>>()
        };
        assert_eq!(of(7), of(7));
        assert_ne!(of(7), of(8));
        assert!((0..5).all(|number| of(7).contains(&number)), "{:?}", of(7));
        assert_eq!(Chance::new(1).below(0), 0);
    }
}

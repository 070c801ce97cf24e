//! How soon a mirror's next round may begin. Rounds end when somebody begins or ceases to share, and a gateway that ends each
//! at once must not keep this site opening sessions.

use std::time::Duration;

/// A round that lasted so long says nothing of the next one.
const LONG: Duration = Duration::from_secs(10);
/// Short rounds in a row without a pause: several owners share within a moment.
const FREE: u32 = 4;
/// The first pause after those, and the longest.
const PAUSES: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(5));

/// Counts short rounds in a row.
#[derive(Debug, Default)]
pub(super) struct Pace {
    short: u32,
}

impl Pace {
    /// The pause after a round that lasted so long.
    pub fn after(&mut self, lasted: Duration) -> Duration {
        if lasted >= LONG {
            self.short = 0;
            return Duration::ZERO;
        }
        self.short = self.short.saturating_add(1);
        match self.short.checked_sub(FREE + 1) {
            None => Duration::ZERO,
            Some(further) => (PAUSES.0 * 2_u32.pow(further.min(8))).min(PAUSES.1),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_few_grants_in_a_row_wait_for_nothing_and_rounds_without_end_become_rare() {
        let mut pace = Pace::default();
        let short: Vec<u128> = (0..10).map(|_| pace.after(Duration::from_millis(600)).as_millis()).collect();
        assert_eq!(short, [0, 0, 0, 0, 500, 1_000, 2_000, 4_000, 5_000, 5_000]);
        assert_eq!(pace.after(Duration::from_secs(10)), Duration::ZERO);
        assert_eq!(pace.after(Duration::from_secs(1)), Duration::ZERO, "a long round begins the count anew");
    }
}

//! When background tasks look around: at common moments, so that an idle site wakes the processor seldom.

use std::sync::LazyLock;
use std::time::Duration;

use tokio::time::Instant;

use super::Site;

/// What all beats are counted from.
static BEGUN: LazyLock<Instant> = LazyLock::new(Instant::now);

impl Site {
    /// Waits for the next whole multiple of `period`; `false` = the site stops.
    pub(super) async fn beat(&self, period: Duration) -> bool {
        tokio::select! {
            () = tokio::time::sleep_until(next(*BEGUN, Instant::now(), period)) => true,
            () = self.stopped() => false,
        }
    }
}

/// The first moment after `now` that is whole periods after `begun`; at least half a period away, so that work that
/// ends shortly before a beat does not begin again at once.
fn next(begun: Instant, now: Instant, period: Duration) -> Instant {
    let nanoseconds = period.as_nanos().max(1);
    let since = (now - begun).as_nanos() + nanoseconds / 2;
    let until = nanoseconds - since % nanoseconds + nanoseconds / 2;
    now + Duration::from_nanos(u64::try_from(until).unwrap_or(u64::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_beat_is_a_whole_multiple_half_a_period_away_at_least() {
        let (begun, period) = (Instant::now(), Duration::from_secs(2));
        let after = |milliseconds: u64| {
            next(begun, begun + Duration::from_millis(milliseconds), period).duration_since(begun).as_millis()
        };
        assert_eq!(after(0), 2000);
        assert_eq!(after(1000), 4000);
        assert_eq!(after(999), 2000);
        assert_eq!(after(2500), 4000);
        assert_eq!(after(3999), 6000);
    }
}

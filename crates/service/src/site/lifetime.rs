//! How long a site lives: told to end, ending, stopped; and when background tasks look around, at common moments, so
//! that an idle site seldom wakes the processor.

use std::sync::LazyLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use tokio::sync::watch;
use tokio::time::Instant;

/// All beats are counted from this.
static BEGUN: LazyLock<Instant> = LazyLock::new(Instant::now);

/// The life of a site, followed by all its parts.
pub(super) struct Lifetime {
    /// Set as soon as the site was told to end; background tasks are not restarted from then on.
    ending: AtomicBool,
    /// Whether it is to run until it is told to end, and not for one command.
    stays: AtomicBool,
    stopping: watch::Sender<bool>,
}

impl Lifetime {
    pub fn new() -> Self {
        Self { ending: AtomicBool::new(false), stays: AtomicBool::new(false), stopping: watch::channel(false).0 }
    }

    /// The site was told to end: nothing new is begun, what was captured is still stored.
    pub fn end(&self) {
        self.ending.store(true, Ordering::Release);
    }

    /// The site is to run until it is told to end.
    pub fn stay(&self) {
        self.stays.store(true, Ordering::Release);
    }

    /// Whether it is to run until it is told to end.
    pub fn is_to_stay(&self) -> bool {
        self.stays.load(Ordering::Acquire)
    }

    /// Everything captured is stored.
    pub fn stop(&self) {
        self.stopping.send_replace(true);
    }

    /// Whether the site was told to end; it may still be storing what was captured.
    pub fn is_ending(&self) -> bool {
        self.ending.load(Ordering::Acquire)
    }

    /// Whether the site is stopping.
    pub fn is_stopping(&self) -> bool {
        *self.stopping.borrow()
    }

    /// Waits until the site is stopping.
    pub async fn stopped(&self) {
        let mut stopping = self.stopping.subscribe();
        // An error means that the site is gone, which is an end too.
        drop(stopping.wait_for(|stopping| *stopping).await);
    }

    /// Waits for the next whole multiple of `period`; `false` = the site stops.
    pub async fn beat(&self, period: Duration) -> bool {
        tokio::select! {
            () = tokio::time::sleep_until(next(*BEGUN, Instant::now(), period)) => true,
            () = self.stopped() => false,
        }
    }
}

/// The first moment after `now` that is a whole number of periods after `begun`; at least half a period away, so that
/// work that ends shortly before a beat does not begin again at once.
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

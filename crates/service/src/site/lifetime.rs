//! The life of a site, and common moments at which background tasks look around, so that an idle site seldom wakes the
//! processor.

use std::sync::LazyLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use tokio::sync::watch;
use tokio::time::Instant;

static BEGUN: LazyLock<Instant> = LazyLock::new(Instant::now);

pub(super) struct Lifetime {
    /// Background tasks are not restarted from then on.
    ending: AtomicBool,
    /// Whether it stays, instead of ending with one command.
    stays: AtomicBool,
    stopping: watch::Sender<bool>,
}

impl Lifetime {
    pub fn new() -> Self {
        Self { ending: AtomicBool::new(false), stays: AtomicBool::new(false), stopping: watch::channel(false).0 }
    }

    /// Nothing new begins; captured messages are still stored.
    pub fn end(&self) {
        self.ending.store(true, Ordering::Release);
    }

    pub fn stay(&self) {
        self.stays.store(true, Ordering::Release);
    }

    pub fn is_to_stay(&self) -> bool {
        self.stays.load(Ordering::Acquire)
    }

    /// Everything captured is stored.
    pub fn stop(&self) {
        self.stopping.send_replace(true);
    }

    /// It may still be storing captured messages.
    pub fn is_ending(&self) -> bool {
        self.ending.load(Ordering::Acquire)
    }

    pub fn is_stopping(&self) -> bool {
        *self.stopping.borrow()
    }

    pub async fn stopped(&self) {
        let mut stopping = self.stopping.subscribe();
        // An error means that the site is gone, which is an end too.
        drop(stopping.wait_for(|stopping| *stopping).await);
    }

    /// Pauses; `false` = the site stops.
    pub async fn rest(&self, pause: Duration) -> bool {
        tokio::select! {
            () = tokio::time::sleep(pause) => true,
            () = self.stopped() => false,
        }
    }

    /// Waits for the next whole multiple of `period`; `false` = the site stops.
    pub async fn beat(&self, period: Duration) -> bool {
        let now = Instant::now();
        self.rest(next(*BEGUN, now, period) - now).await
    }
}

/// The next whole multiple of `period`, at least half a period away, so that work ending shortly before a beat does not
/// begin again immediately.
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

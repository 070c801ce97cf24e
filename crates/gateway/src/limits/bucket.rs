//! A token bucket: how much may come at once, and how much sustained.

use std::time::{Duration, Instant};

/// Fills at a rate, up to a burst; may go into debt, which must be waited out.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bucket {
    level: f64,
    rate: f64,
    burst: f64,
    at: Instant,
}

impl Bucket {
    pub fn new(rate: f64, burst: f64, now: Instant) -> Self {
        Self { level: burst, rate, burst, at: now }
    }

    fn fill(&mut self, now: Instant) {
        let passed = now.saturating_duration_since(self.at).as_secs_f64();
        self.level = (self.level + passed * self.rate).min(self.burst);
        self.at = now.max(self.at);
    }

    pub fn take_if_there(&mut self, now: Instant) -> bool {
        self.fill(now);
        let there = self.level >= 1.0;
        if there {
            self.level -= 1.0;
        }
        there
    }

    /// How long to wait until the debt is filled again.
    pub fn take(&mut self, now: Instant, amount: f64) -> Duration {
        self.fill(now);
        self.level -= amount;
        Duration::try_from_secs_f64((-self.level / self.rate).max(0.0)).unwrap_or(Duration::MAX)
    }

    pub fn is_full(&mut self, now: Instant) -> bool {
        self.fill(now);
        self.level >= self.burst
    }
}

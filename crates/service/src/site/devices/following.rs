//! Whether robots follow their owner into a new epoch: one that does not still writes for a reader who lost access.

use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use super::Devices;
use crate::model::{ErrorKind, Timestamp};
use crate::pipeline::Owner;
use crate::service::reply::{Failure, Result, TransactionView};
use crate::store::NewestRecord;
use crate::store::notes::Enrolled;

/// How long a working robot may stay in an older epoch.
const BOUND: Duration = Duration::from_secs(12);
/// How long to wait for a robot that fell silent.
const SILENCE: Duration = Duration::from_secs(3);
const LOOK: Duration = Duration::from_millis(200);
/// Nanoseconds; a robot whose newest record is older is not at work.
const AT_WORK: u64 = 10_000_000_000;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Pace {
    Settled,
    Silent,
    Behind,
}

impl Pace {
    /// `begun` is when the owner told the robot of `epoch`.
    fn of(newest: Option<NewestRecord>, epoch: u64, begun: Timestamp) -> Self {
        let Some(newest) = newest.filter(|newest| newest.epoch < epoch) else { return Self::Settled };
        let heard = newest.acknowledged_at;
        if newest.captured_at > begun && heard > begun && heard.0.saturating_add(AT_WORK / 2) > Timestamp::now().0 {
            return Self::Behind;
        }
        let earliest = begun.0.saturating_sub(AT_WORK);
        if newest.captured_at.0 > earliest && heard.0 > earliest { Self::Silent } else { Self::Settled }
    }
}

impl Devices {
    /// Announces the epoch of `deed`, and fails as [`ErrorKind::Incomplete`] if a working robot stays in an older one.
    pub async fn lead(&self, owner: &Owner, deed: TransactionView) -> Result<TransactionView> {
        let (begun, from) = (Timestamp::now(), Instant::now());
        let incomplete = |text: String| Failure::new(ErrorKind::Incomplete, format!("{}; but {text}", deed.text));
        let network = self.parts.link.network().await?;
        block_in_place(|| self.enrolments.tell_devices(owner, &network))
            .map_err(|failure| incomplete(failure.message))?;
        let robots = self.enrolments.lent(owner, &network)?;
        let pace = |robot: &Enrolled| {
            let newest = self.parts.plant.ledger.counts.newest_of(owner.address, robot.device)?;
            Ok((robot.name.to_string(), Pace::of(newest, deed.epoch, begun)))
        };
        loop {
            let paces = block_in_place(|| robots.iter().map(pace).collect::<Result<Vec<_>>>())?;
            let behind: Vec<String> =
                paces.iter().filter(|(_, pace)| *pace == Pace::Behind).map(|(name, _)| format!("'{name}'")).collect();
            let waits = paces.iter().any(|(_, pace)| *pace == Pace::Silent) && from.elapsed() < SILENCE;
            if behind.is_empty() && (!waits || self.parts.life.is_stopping()) {
                break;
            }
            if from.elapsed() >= BOUND || self.parts.life.is_stopping() {
                let names = behind.join(", ");
                return Err(incomplete(format!(
                    "FAILED: {names} still seals under an older epoch {} s later; check `authros status` here and the \
                     robot's own log, or revoke it too",
                    from.elapsed().as_secs()
                )));
            }
            tokio::time::sleep(LOOK).await;
        }
        let Some(untold) = self.enrolments.untold(Some(owner.address)) else { return Ok(deed) };
        let text = format!("{}; {untold}; they are notified as soon as their gateway can be reached", deed.text);
        Ok(TransactionView { text, ..deed })
    }

    pub fn untold_text(&self) -> Option<String> {
        self.enrolments.untold(None)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_is_behind_only_with_what_it_captured_since() {
        let now = Timestamp::now();
        let before = |seconds: u64| Timestamp(now.0 - seconds * 1_000_000_000);
        let newest = |epoch, captured_at, acknowledged_at| Some(NewestRecord { epoch, captured_at, acknowledged_at });
        let begun = before(4);
        for (record, pace) in [
            (None, Pace::Settled),
            (newest(5, now, now), Pace::Settled),
            (newest(4, now, now), Pace::Behind),
            // Captured before, however late it came: an outbox is being emptied.
            (newest(4, before(5), now), Pace::Silent),
            (newest(4, before(3_600), now), Pace::Settled),
            (newest(4, before(6), before(6)), Pace::Silent),
            (newest(4, before(3_600), before(3_600)), Pace::Settled),
            // Its clock is ahead, and it has been silent for long.
            (newest(4, now, before(60)), Pace::Settled),
        ] {
            assert_eq!(Pace::of(record, 5, begun), pace, "{record:?}");
        }
    }
}

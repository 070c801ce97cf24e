//! Whether robots follow their owner into a new epoch. A robot that goes on under an older one still writes for a reader
//! who was to lose access, so the command that ended that access says so.

use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use super::Devices;
use super::enrolled::words;
use crate::model::{ErrorKind, Timestamp};
use crate::pipeline::Owner;
use crate::service::reply::{Failure, TransactionView};
use crate::store::NewestRecord;
use crate::store::notes::Enrolled;

/// How long a robot at work may go on under an older epoch.
const BOUND: Duration = Duration::from_secs(12);
/// How long a robot that was at work until now may be silent before nobody waits for it.
const SILENCE: Duration = Duration::from_secs(3);
const LOOK: Duration = Duration::from_millis(200);
/// A robot whose newest record was captured and came this long ago, nanoseconds, is not at work.
const AT_WORK: u64 = 10_000_000_000;

/// A robot's place between two epochs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Pace {
    /// It seals under the new epoch, or is not at work.
    Settled,
    /// It was at work until now and has not been heard of since.
    Silent,
    /// It sends records that it captured since, under an older epoch.
    Behind,
}

impl Pace {
    /// By a robot's newest record; `begun` is when it was told of `epoch`.
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
    /// Tells the robots of an owner about the epoch that began with `deed`, and waits until those at work seal under it.
    /// Names those that cannot be told because their gateway is away.
    ///
    /// # Errors
    /// [`ErrorKind::Incomplete`] if a notice cannot be sealed, or a robot at work goes on under an older epoch.
    pub async fn lead(&self, owner: &Arc<Owner>, deed: TransactionView) -> Result<TransactionView, Failure> {
        let (begun, from) = (Timestamp::now(), Instant::now());
        let incomplete = |text: String| Failure::new(ErrorKind::Incomplete, format!("{}; but {text}", deed.text));
        let network = self.parts.link.network().await?;
        block_in_place(|| self.enrolments.tell_devices(owner, &network))
            .map_err(|failure| incomplete(failure.message))?;
        let robots = self.enrolments.lent(owner, &network)?;
        loop {
            let paces = block_in_place(|| self.paces(owner, &robots, (deed.epoch, begun)))?;
            let behind: Vec<String> =
                paces.iter().filter(|(_, pace)| *pace == Pace::Behind).map(|(name, _)| format!("'{name}'")).collect();
            let waits = paces.iter().any(|(_, pace)| *pace == Pace::Silent) && from.elapsed() < SILENCE;
            if behind.is_empty() && (!waits || self.parts.life.is_stopping()) {
                break;
            }
            if from.elapsed() >= BOUND || self.parts.life.is_stopping() {
                let names = behind.join(", ");
                return Err(incomplete(format!(
                    "FAILED: {names} still seals under an older epoch {} s later; look at `authros status` here and at \
                     the robot's own messages, or recall it too",
                    from.elapsed().as_secs()
                )));
            }
            tokio::time::sleep(LOOK).await;
        }
        let untold = self.enrolments.untold(Some(owner.address));
        if untold.is_empty() {
            return Ok(deed);
        }
        let text = format!("{}; {}; they are told as soon as their gateway can be reached", deed.text, words(&untold));
        Ok(TransactionView { text, ..deed })
    }

    /// The robots of an owner that lack a notice, of any owner, in words; `None` if there are none.
    pub fn untold_text(&self) -> Option<String> {
        let untold = self.enrolments.untold(None);
        (!untold.is_empty()).then(|| words(&untold))
    }

    fn paces(
        &self,
        owner: &Owner,
        robots: &[Enrolled],
        (epoch, begun): (u64, Timestamp),
    ) -> Result<Vec<(String, Pace)>, Failure> {
        let pace = |robot: &Enrolled| {
            let newest = self.parts.plant.ledger.counts.newest_of(owner.address, robot.device)?;
            Ok::<_, Failure>((robot.name.to_string(), Pace::of(newest, epoch, begun)))
        };
        robots.iter().map(pace).collect()
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

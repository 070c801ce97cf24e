//! Compares the machine's clock with one that does not jump. A jump is reported, audited, and part of the health until
//! it is over or accepted.

use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::model::steady_clock::{Reading, SETTLING, look};
use crate::model::{ProfileName, coarse};
use crate::reply::{HealthLevel, NoticeLevel, Part, PartHealth, Result};
use crate::site::{Parts, blocking};

const LOOK: Duration = Duration::from_secs(1);
/// Seconds; less is not a jump.
const SHORTEST: i64 = 5;
/// Seconds that the chain may be ahead of this machine.
const CHAIN_AHEAD: u64 = 60;
const ABOUT: &str = "clock";
/// Profile of the audit line if none is open.
const NOBODY: &str = "site";

/// Seconds that the machine's clock advanced beyond those passed since `begun`.
fn gained(reading: &Reading, begun: Instant) -> i64 {
    let machine = i64::try_from(reading.machine.seconds()).unwrap_or(i64::MAX);
    machine.saturating_sub(i64::try_from(begun.elapsed().as_secs()).unwrap_or(0))
}

/// `24 h ahead`, `60 min back`.
fn span(seconds: i64) -> String {
    let way = if seconds < 0 { "back" } else { "ahead" };
    format!("{} {way}", coarse(Duration::from_secs(seconds.unsigned_abs())))
}

/// The chain's own time cannot be corrected here, only waited for.
fn behind_chain(seconds: u64) -> String {
    let behind = coarse(Duration::from_secs(seconds));
    format!(
        "run `timedatectl set-ntp true`: this clock is {behind} behind the chain, whose time decides when grants and device authorisations \
         begin and end; if this clock is right, the chain's was ahead: until it is reached, give new grants an end more \
         than {behind} from now"
    )
}

pub struct Clock {
    pub parts: Parts,
}

impl Clock {
    pub async fn keep(self: Arc<Self>) {
        let begun = Instant::now();
        let (mut before, mut ahead) = (gained(&look(), begun), 0);
        self.compare_with_records().await;
        while self.parts.life.beat(LOOK).await {
            let reading = look();
            let (now, doubted) = (gained(&reading, begun), reading.ahead());
            let jump = now - before;
            if jump.abs() >= SHORTEST {
                self.tell_jump(jump, doubted).await;
            } else if ahead != 0 && doubted == 0 {
                self.tell_belief().await;
            }
            (before, ahead) = (now, doubted);
        }
    }

    async fn tell_jump(&self, jump: i64, doubted: i64) {
        let text = format!("this machine's clock jumped {}", span(jump));
        if doubted.abs() < SHORTEST {
            let text = format!("{text}: it is correct again; records captured meanwhile keep the time they were given");
            self.parts.hub.notice_about(ABOUT, NoticeLevel::Info, &text);
        } else {
            let order = if jump < 0 { "new records are dated earlier than those before them; " } else { "" };
            let settling = SETTLING.as_secs();
            let text = format!(
                "{text}; run `timedatectl set-ntp true` if it is wrong: {order}grants, device authorisations and the embedded chain follow \
                 it once it has been stable for {settling} s"
            );
            self.parts.hub.notice_about(ABOUT, NoticeLevel::Error, &text);
        }
        self.note_clock(&format!("jumped {}", span(jump))).await;
        self.parts.hub.changed(Part::Health);
    }

    async fn tell_belief(&self) {
        let text = format!(
            "this machine's new clock time has been stable for {} s: grants, device authorisations and the embedded \
             chain now use it",
            SETTLING.as_secs()
        );
        self.parts.hub.notice_about(ABOUT, NoticeLevel::Info, &text);
        self.note_clock("the new time is now used").await;
        self.parts.hub.changed(Part::Health);
        self.parts.hub.changed(Part::Grants);
    }

    /// A machine without a battery wakes up in the past. Capture times do not count: a recording has its own.
    async fn compare_with_records(self: &Arc<Self>) {
        let Ok(Some(newest)) =
            blocking(self, |clock| Ok(clock.parts.plant.ledger.inspection.newest_acknowledgement()?)).await
        else {
            return;
        };
        let behind = newest.seconds().saturating_sub(look().machine.seconds());
        if i64::try_from(behind).is_ok_and(|behind| behind >= SHORTEST) {
            let away = coarse(Duration::from_secs(behind));
            let text = format!(
                "run `timedatectl set-ntp true`: this machine's clock is {away} behind the newest record, so new records \
                 are dated earlier than those before them"
            );
            self.parts.hub.notice_about(ABOUT, NoticeLevel::Error, &text);
            self.note_clock(&format!("{away} behind the newest record")).await;
        }
    }

    async fn note_clock(&self, subject: &str) {
        let open = self.parts.owners.all().first().map(|owner| owner.profile.clone());
        let Some(profile) = open.or_else(|| NOBODY.parse::<ProfileName>().ok()) else { return };
        let written: Result<()> = self.parts.log.write(&profile, "clock", subject, "noticed").await;
        if let Err(failure) = written {
            self.parts.hub.alarm(&failure.message);
        }
    }

    pub fn health(&self) -> Option<PartHealth> {
        let reading = look();
        let head = self.parts.link.newest_head();
        let chain = head.map_or(0, |head| head.timestamp.saturating_sub(reading.steady.seconds()));
        let text = if reading.ahead().abs() >= SHORTEST {
            let settling = SETTLING.as_secs();
            format!(
                "run `timedatectl set-ntp true` if it is wrong: it jumped {}, and is not used until it has been stable for \
                 {settling} s",
                span(reading.ahead())
            )
        } else if chain > CHAIN_AHEAD {
            behind_chain(chain)
        } else {
            return None;
        };
        Some(PartHealth::new(ABOUT, HealthLevel::Waiting, &text))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Timestamp;

    #[test]
    fn a_clock_that_is_set_gains_or_loses_and_one_that_goes_does_neither() {
        let begun = Instant::now();
        let at = |seconds| {
            let time = Timestamp::from_seconds(seconds);
            gained(&Reading { steady: time, machine: time }, begun)
        };
        assert!((at(1_000_000) - at(1_000_000)).abs() <= 1);
        assert!((at(1_086_400) - at(1_000_000) - 86_400).abs() <= 1);
        let text = behind_chain(259_168);
        assert!(
            text.starts_with("run `timedatectl set-ntp true`") && text.contains("is 3 d behind the chain"),
            "{text}"
        );
        assert_eq!((span(86_400), span(-3_600)), ("24 h ahead".to_owned(), "60 min back".to_owned()));
    }
}

//! Compares the machine's clock with one that does not jump. A jump is reported, audited, and part of the health until
//! it is over or accepted.

use crate::site::parts::Parts;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::blocking;
use crate::model::ProfileName;
use crate::model::steady_clock::{Reading, SETTLING, look};
use crate::service::event::{NoticeLevel, Part};
use crate::service::reply::{Failure, HealthLevel, PartHealth};

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

/// `86400 s ahead`, `3600 s back`.
fn span(seconds: i64) -> String {
    let way = if seconds < 0 { "back" } else { "ahead" };
    format!("{} s {way}", seconds.unsigned_abs())
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
                "{text}: {order}grants, device authorisations and the embedded chain use it once it has been stable \
                 for {settling} s; correct it if it is wrong (timedatectl set-ntp true)"
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
            let text = format!(
                "this machine's clock is {behind} s behind the newest record: new records are dated earlier than those \
                 before them; correct it (timedatectl set-ntp true)"
            );
            self.parts.hub.notice_about(ABOUT, NoticeLevel::Error, &text);
            self.note_clock(&format!("{behind} s behind the newest record")).await;
        }
    }

    async fn note_clock(&self, subject: &str) {
        let open = self.parts.owners.all().first().map(|owner| owner.profile.clone());
        let Some(profile) = open.or_else(|| NOBODY.parse::<ProfileName>().ok()) else { return };
        let written: Result<(), Failure> = self.parts.log.write(&profile, "clock", subject, "noticed").await;
        if let Err(failure) = written {
            self.parts.hub.alarm(&failure.message);
        }
    }

    pub fn health(&self) -> Option<PartHealth> {
        let reading = look();
        let head = self.parts.link.newest_head();
        let chain = head.map_or(0, |head| head.timestamp.saturating_sub(reading.steady.seconds()));
        let text = if reading.ahead().abs() >= SHORTEST {
            format!("jumped {}, not used until it has been stable for {} s", span(reading.ahead()), SETTLING.as_secs())
        } else if chain > CHAIN_AHEAD {
            format!(
                "{chain} s behind the chain, whose time decides when grants and device authorisations begin and end; \
                 new grants need an end later than the chain's time"
            )
        } else {
            return None;
        };
        Some(PartHealth { part: ABOUT.to_owned(), level: HealthLevel::Waiting, text, since: None, retry: None })
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
        assert_eq!((span(86_400), span(-3_600)), ("86400 s ahead".to_owned(), "3600 s back".to_owned()));
    }
}

//! Rules over the figures of a site. Their texts name no topic, contact or key, and accounts by eight digits only.

use std::cmp::Reverse;
use std::time::Duration;

use crate::config::AlertLimits;
use crate::figures::{Figures, GrantFigures, OwnerFigures, RobotFigures, short};
use crate::model::{Timestamp, coarse, counted, grouped};
use crate::reply::{AlertView, HealthLevel, PartHealth, Severity};

/// Time after a start to work off the backlog, without judging ages.
const SETTLING: Duration = Duration::from_secs(120);
/// A robot silent for this long is away.
const AWAY: Duration = Duration::from_secs(86_400);
/// How long losses count as ongoing.
const LOSING: Duration = Duration::from_secs(300);

const GRANT: &str = "grant_ends";
/// A grant of which less than this part is left ends soon: no alarm the moment a short one is made.
const PART: u32 = 10;

pub const RULES: [&str; 12] = [
    "audit",
    "chain",
    "clock",
    "disk",
    "gap",
    GRANT,
    "quarantine",
    "robot_silent",
    "stages",
    "store",
    "tampered",
    "unanchored",
];

pub fn rule_of(key: &str) -> &str {
    key.split('/').next().unwrap_or(key)
}

/// The worst first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    Firing,
    /// Too close to the limit to begin or end an alert, or unknown.
    Between,
    Clear,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Judged {
    pub key: String,
    pub severity: Severity,
    pub level: Level,
    pub text: String,
}

impl Judged {
    fn new(key: impl Into<String>, severity: Severity, level: Level, text: impl Into<String>) -> Self {
        Self { key: key.into(), severity, level, text: text.into() }
    }
}

#[derive(Debug)]
pub struct Judge {
    limits: AlertLimits,
    since: Option<Timestamp>,
    losses: Option<Losses>,
    grants: Option<Vec<GrantFigures>>,
}

#[derive(Debug, Clone, Copy)]
struct Losses {
    first: u64,
    last: u64,
    grew: Option<Timestamp>,
}

impl Judge {
    pub fn new(limits: AlertLimits) -> Self {
        Self { limits, since: None, losses: None, grants: None }
    }

    pub fn judge(&mut self, figures: &Figures) -> Vec<Judged> {
        let since = *self.since.get_or_insert(figures.now);
        let settled = passed(figures.now, since) >= SETTLING;
        let mut judged = self.robots(figures, settled);
        for owner in &figures.owners {
            judged.extend(self.unanchored(figures, owner, settled));
            judged.extend(records(owner));
        }
        judged.extend(self.disk(figures));
        judged.push(self.gap(figures));
        judged.extend(self.clock(figures));
        judged.extend(self.ending_grants(figures));
        judged.extend(self.audit(figures, settled));
        let text = "The chain is unreachable or a transaction lane is stuck: anchoring is paused, records are \
                     safe. See `authros status`.";
        judged.extend(part(figures, "chain", text));
        let text = "The store accepts no records, or may lose what it accepts. See `authros status`.";
        judged.extend(part(figures, "store", text));
        judged.push(stages(figures));
        judged
    }

    fn robots(&self, figures: &Figures, settled: bool) -> Vec<Judged> {
        let Some(limit) = self.limits.robot_silent else { return Vec::new() };
        let silent = figures.robots.iter().map(|robot| (robot, passed(figures.now, robot.last_seen)));
        let present = silent.filter(|(_, silent)| *silent < AWAY);
        let judge = |(RobotFigures { robot, .. }, silent): (&RobotFigures, Duration)| {
            let silence = coarse(silent);
            let text = format!("Nothing received from robot {robot} for {silence}; check its agent and its network.");
            let level = aged(silent, limit, settled);
            Judged::new(format!("robot_silent/{robot}"), Severity::Warning, level, text)
        };
        present.map(judge).collect()
    }

    fn unanchored(&self, figures: &Figures, owner: &OwnerFigures, settled: bool) -> Option<Judged> {
        let limit = self.limits.unanchored?;
        let waited = owner.oldest_unanchored.map_or(Duration::ZERO, |oldest| passed(figures.now, oldest));
        let (account, waiting) = (&owner.owner, coarse(waited));
        let text = format!(
            "The oldest record of account {account} has been waiting {waiting} for a block; records are safe. See \
             `authros chain status`."
        );
        let level = unless_caused(figures, owner, aged(waited, limit, settled));
        Some(Judged::new(format!("unanchored/{account}"), Severity::Critical, level, text))
    }

    fn disk(&self, figures: &Figures) -> Option<Judged> {
        let limit = self.limits.disk;
        if limit == 0 {
            return None;
        }
        let level = match figures.disk {
            Some((free, _)) if free < limit => Level::Firing,
            Some((free, _)) if free >= limit.saturating_add(limit / 10) => Level::Clear,
            _ => Level::Between,
        };
        let (free, reserve) = figures.disk.unwrap_or_default();
        let text = format!(
            "{} MiB are free on the home's disk; below {} MiB no record is acknowledged. Free some space.",
            free >> 20,
            reserve >> 20
        );
        Some(Judged::new("disk", Severity::Critical, level, text))
    }

    fn gap(&mut self, figures: &Figures) -> Judged {
        let lives = figures.owners.iter().map(|owner| &owner.life);
        let total: u64 = lives.map(|life| life.lost_in_transport.saturating_add(life.lost_in_recorder)).sum();
        let losses = self.losses.get_or_insert(Losses { first: total, last: total, grew: None });
        if total > losses.last {
            losses.grew = Some(figures.now);
        }
        losses.last = total;
        let losing = losses.grew.is_some_and(|grew| passed(figures.now, grew) < LOSING);
        let (lost, untold) = (total.saturating_sub(losses.first), figures.untold_gaps);
        let text = format!(
            "Messages are being lost: {} since this site was started; not in a gap record yet: {}. See `authros status`.",
            grouped(lost),
            counted(untold, "loss")
        );
        Judged::new("gap", Severity::Warning, firing(losing || untold > 0), text)
    }

    fn clock(&self, figures: &Figures) -> Option<Judged> {
        let limit = self.limits.clock?.as_secs();
        let seconds = figures.clock_ahead.unsigned_abs();
        let way = if figures.clock_ahead < 0 { "behind" } else { "ahead of" };
        let away = coarse(Duration::from_secs(seconds));
        let text = format!(
            "Run `timedatectl set-ntp true`: this machine's clock is {away} {way} the time used for grants and device authorisations."
        );
        Some(Judged::new("clock", Severity::Warning, over(seconds.into(), limit.into()), text))
    }

    fn ending_grants(&mut self, figures: &Figures) -> Vec<Judged> {
        let Some(limit) = self.limits.grant_ends else { return Vec::new() };
        if figures.grants.is_some() {
            self.grants.clone_from(&figures.grants);
        }
        let left = |grant: &GrantFigures| passed(grant.ends, figures.now);
        let going = self.grants.iter().flatten().filter(|grant| grant.ends > figures.now);
        let judge = |grant: &GrantFigures| {
            let GrantFigures { owner, reader, given, begun, ends } = grant;
            let soon = begun.map_or(limit, |begun| limit.min(passed(*ends, begun) / PART));
            let how = if *given { "`authros grant extend` extends it" } else { "only its owner can extend it" };
            let text = format!("The grant of account {owner} to {reader} ends at {ends}; {how}.");
            let level = firing(left(grant) <= soon);
            Judged::new(format!("{GRANT}/{owner}-{reader}"), Severity::Warning, level, text)
        };
        going.map(judge).collect()
    }

    /// Alerts whose rule lacks data neither continue nor end.
    pub fn not_known(&self, standing: &[AlertView]) -> Vec<Judged> {
        let waits = self.limits.grant_ends.is_some() && self.grants.is_none();
        let of_grants = standing.iter().filter(|alert| rule_of(&alert.key) == GRANT && waits);
        let between = |alert: &AlertView| Judged::new(&*alert.key, alert.severity, Level::Between, &*alert.text);
        of_grants.map(between).collect()
    }

    fn audit(&self, figures: &Figures, settled: bool) -> Option<Judged> {
        let limit = self.limits.audit?;
        // Without a chain, heads are not anchored.
        figures.parts.iter().find(|part| part.part == "chain")?;
        let judge = |owner: &OwnerFigures| {
            let waited = owner.audit_unanchored.map_or(Duration::ZERO, |oldest| passed(figures.now, oldest));
            (unless_caused(figures, owner, aged(waited, limit, settled)), Reverse(waited))
        };
        let worst = figures.owners.iter().map(judge).min();
        let (level, Reverse(waited)) = worst.unwrap_or((Level::Clear, Reverse(Duration::ZERO)));
        let age = coarse(waited);
        let text = format!(
            "The oldest audit log line not covered by an anchored head is {age} old. See `authros chain status`."
        );
        // While every profile is locked, alerts neither begin nor end.
        let level = if figures.audit_locked { Level::Between } else { level };
        Some(Judged::new("audit", Severity::Warning, level, text))
    }
}

fn records(owner: &OwnerFigures) -> [Judged; 2] {
    let (account, held, tampered) = (&owner.owner, owner.life.quarantined, owner.life.tampered);
    let text = format!(
        "Quarantined for account {account}, because the publisher is not pinned: {}. Release or discard what is held; \
         see `authros topics quarantine list`.",
        counted(held, "message")
    );
    let held = Judged::new(format!("quarantine/{account}"), Severity::Warning, firing(held > 0), text);
    let text = format!(
        "Different from the chain: {} of account {account}. Run `authros audit`, and restore the home from a backup.",
        counted(tampered, "record")
    );
    [held, Judged::new(format!("tampered/{account}"), Severity::Critical, firing(tampered > 0), text)]
}

/// Without a chain, or with its lane paused, an account anchors nothing, which the chain's own alert says: one cause, one
/// alert.
fn unless_caused(figures: &Figures, owner: &OwnerFigures, level: Level) -> Level {
    let is_cause = |part: &PartHealth| {
        let is_unaffected = part.unaffected.iter().any(|account| short(&account.to_string()) == owner.owner);
        part.part == "chain" && part.level == HealthLevel::Failed && !is_unaffected
    };
    if level == Level::Firing && figures.parts.iter().any(is_cause) { Level::Between } else { level }
}

fn part(figures: &Figures, name: &str, text: &str) -> Option<Judged> {
    let part = figures.parts.iter().find(|part| part.part == name)?;
    let level = match part.level {
        HealthLevel::Failed => Level::Firing,
        HealthLevel::Ok => Level::Clear,
        HealthLevel::Waiting | HealthLevel::Absent => Level::Between,
    };
    Some(Judged::new(name, Severity::Critical, level, text))
}

/// The part exists only while a stage stands still.
fn stages(figures: &Figures) -> Judged {
    let stands = figures.parts.iter().any(|part| part.part == "stages" && part.level == HealthLevel::Failed);
    let text = "A stage of this site is stuck with work to do; it is restarted, nothing acknowledged is lost. See \
                `authros status`; if it stays stuck, stop the site and start it again.";
    Judged::new("stages", Severity::Critical, firing(stands), text)
}

fn firing(is_trouble: bool) -> Level {
    if is_trouble { Level::Firing } else { Level::Clear }
}

fn over(value: u128, limit: u128) -> Level {
    if value > limit {
        return Level::Firing;
    }
    if value <= limit - limit / 10 { Level::Clear } else { Level::Between }
}

fn aged(age: Duration, limit: Duration, settled: bool) -> Level {
    match over(age.as_nanos(), limit.as_nanos()) {
        Level::Firing if !settled => Level::Between,
        level => level,
    }
}

fn passed(now: Timestamp, then: Timestamp) -> Duration {
    Duration::from_nanos(now.0.saturating_sub(then.0))
}

#[cfg(test)]
mod tests;

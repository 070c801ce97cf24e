//! Figures of a site that is well, and changes that make each rule find something wrong: for tests.

use std::time::Duration;

use crate::config::AlertLimits;
use crate::figures::{Figures, GrantFigures, OwnerFigures, RobotFigures};
use crate::model::Timestamp;
use crate::reply::{HealthLevel, LifeLine, PartHealth};

/// When the tests begin, seconds.
const BEGUN: u64 = 1_700_000_000;

/// Limits as in the settings, except the disk's.
pub fn limits() -> AlertLimits {
    AlertLimits {
        robot_silent: Some(Duration::from_secs(600)),
        unanchored: Some(Duration::from_secs(600)),
        disk: 1000 << 20,
        clock: Some(Duration::from_secs(5)),
        grant_ends: Some(Duration::from_secs(3600)),
        audit: Some(Duration::from_secs(900)),
    }
}

fn part_of(name: &str) -> PartHealth {
    PartHealth::new(name, HealthLevel::Ok, "redis://secret@host /topic")
}

/// A grant that ends this long after the beginning.
pub fn grant(second: u64) -> GrantFigures {
    let ends = Timestamp::from_seconds(BEGUN + second);
    GrantFigures { owner: "0a0b0c0d".to_owned(), reader: "0e0f0a0b".to_owned(), given: true, begun: None, ends }
}

/// All is well at `second` after the beginning.
pub fn well(second: u64) -> Figures {
    let now = Timestamp::from_seconds(BEGUN + second);
    let owner = OwnerFigures { owner: "0a0b0c0d".to_owned(), ..OwnerFigures::default() };
    Figures {
        now,
        owners: vec![owner],
        robots: vec![RobotFigures { robot: "12345678".to_owned(), last_seen: now }],
        parts: vec![part_of("chain"), part_of("store")],
        disk: Some((2000 << 20, 64 << 20)),
        grants: Some(vec![grant(2 * 86_400)]),
        ..Figures::default()
    }
}

/// This many seconds earlier.
pub fn before(figures: &Figures, seconds: u64) -> Timestamp {
    Timestamp::from_seconds(figures.now.seconds() - seconds)
}

fn life(set: impl Fn(&mut LifeLine)) -> impl Fn(&mut Figures) {
    move |figures| figures.owners.iter_mut().for_each(|owner| set(&mut owner.life))
}

pub type Trouble = Box<dyn Fn(&mut Figures)>;

/// Each alert's key, and what begins it.
pub fn troubles() -> Vec<(&'static str, Trouble)> {
    let failed = |name: &'static str| {
        move |figures: &mut Figures| {
            for part in figures.parts.iter_mut().filter(|part| part.part == name) {
                part.level = HealthLevel::Failed;
            }
        }
    };
    let rules: [(&'static str, Trouble); 13] = [
        ("robot_silent/12345678", Box::new(|it| it.robots[0].last_seen = before(it, 601))),
        ("unanchored/0a0b0c0d", Box::new(|it| it.owners[0].oldest_unanchored = Some(before(it, 601)))),
        ("disk", Box::new(|it| it.disk = Some((999 << 20, 64 << 20)))),
        ("gap", Box::new(life(|life| life.lost_in_transport = 3))),
        ("gap", Box::new(|it| it.untold_gaps = 1)),
        ("quarantine/0a0b0c0d", Box::new(life(|life| life.quarantined = 2))),
        ("tampered/0a0b0c0d", Box::new(life(|life| life.tampered = 1))),
        ("clock", Box::new(|it| it.clock_ahead = -6)),
        ("grant_ends/0a0b0c0d-0e0f0a0b", Box::new(|it| it.grants = Some(vec![grant(3600)]))),
        ("store", Box::new(failed("store"))),
        ("chain", Box::new(failed("chain"))),
        (
            "stages",
            Box::new(|it| {
                it.parts.push(part_of("stages"));
                it.parts.iter_mut().filter(|part| part.part == "stages").for_each(|part| {
                    part.level = HealthLevel::Failed;
                });
            }),
        ),
        ("audit", Box::new(|it| it.owners[0].audit_unanchored = Some(before(it, 901)))),
    ];
    rules.into()
}

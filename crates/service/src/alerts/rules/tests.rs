//! Every rule begins one alert and ends it, by figures that are fed and a clock of the test's own.

use super::*;
use crate::service::alerts::Standing;
use crate::service::alerts::state::Change;
use crate::service::figures::PartFigures;
use crate::service::reply::LifeLine;

/// What goes wrong.
type Trouble = Box<dyn Fn(&mut Figures)>;

/// When the tests begin, seconds.
const BEGUN: u64 = 1_700_000_000;

fn limits() -> AlertLimits {
    AlertLimits {
        robot_silent: Some(Duration::from_secs(600)),
        unanchored: Some(Duration::from_secs(600)),
        disk: 1000 << 20,
        clock: Some(Duration::from_secs(5)),
        audit: Some(Duration::from_secs(900)),
    }
}

fn part_of(name: &str) -> PartFigures {
    PartFigures { part: name.to_owned(), well: true, failed: false, text: "redis://secret@host /topic".to_owned() }
}

/// All is well at `second` after the beginning.
fn well(second: u64) -> Figures {
    let now = Timestamp::from_seconds(BEGUN + second);
    let owner = OwnerFigures { owner: "0a0b0c0d".to_owned(), ..OwnerFigures::default() };
    Figures {
        now,
        owners: vec![owner],
        robots: vec![RobotFigures { robot: "12345678".to_owned(), last_seen: now }],
        parts: vec![part_of("chain"), part_of("vault")],
        disk: Some((2000 << 20, 64 << 20)),
        ..Figures::default()
    }
}

fn before(figures: &Figures, seconds: u64) -> Timestamp {
    Timestamp::from_seconds(figures.now.seconds() - seconds)
}

fn life(set: impl Fn(&mut LifeLine)) -> impl Fn(&mut Figures) {
    move |figures| figures.owners.iter_mut().for_each(|owner| set(&mut owner.life))
}

/// A site that is well, then in trouble for three looks, then well again: the keys of what began and what ended.
fn told(trouble: &dyn Fn(&mut Figures)) -> (Vec<String>, Vec<String>) {
    let (mut judge, mut standing) = (Judge::new(limits()), Standing::default());
    let (mut begun, mut ended) = (Vec::new(), Vec::new());
    for look in 0..80 {
        let mut figures = well(look * 10);
        if (20..23).contains(&look) {
            trouble(&mut figures);
        }
        let judged = judge.judge(&figures);
        for text in judged.iter().map(|judged| &judged.text) {
            assert!(!text.contains("secret") && !text.contains("/topic"), "{text}");
        }
        for change in standing.look(figures.now, "0a0b0c0d", judged) {
            match change {
                Change::Begun(alert) => begun.push(alert.key),
                Change::Resolved(alert, _) => ended.push(alert.key),
            }
        }
    }
    assert!(standing.all().is_empty(), "{:?}", standing.all());
    (begun, ended)
}

#[test]
fn every_rule_begins_once_and_ends_once() {
    let failed = |name: &'static str| {
        move |figures: &mut Figures| {
            for part in figures.parts.iter_mut().filter(|part| part.part == name) {
                (part.well, part.failed) = (false, true);
            }
        }
    };
    let rules: [(&str, Trouble); 11] = [
        ("robot_silent/12345678", Box::new(|it| it.robots[0].last_seen = before(it, 601))),
        ("unanchored/0a0b0c0d", Box::new(|it| it.owners[0].oldest_unanchored = Some(before(it, 601)))),
        ("disk", Box::new(|it| it.disk = Some((999 << 20, 64 << 20)))),
        ("gap", Box::new(life(|life| life.lost_in_transport = 3))),
        ("gap", Box::new(|it| it.untold_gaps = 1)),
        ("quarantine/0a0b0c0d", Box::new(life(|life| life.quarantined = 2))),
        ("tampered/0a0b0c0d", Box::new(life(|life| life.tampered = 1))),
        ("clock", Box::new(|it| it.clock_ahead = -6)),
        ("vault", Box::new(failed("vault"))),
        ("chain", Box::new(failed("chain"))),
        ("audit", Box::new(|it| it.audit_unanchored = Some(before(it, 901)))),
    ];
    assert_eq!(told(&|_| {}), (vec![], vec![]), "all is well");
    for (key, trouble) in rules {
        assert_eq!(told(&*trouble), (vec![key.to_owned()], vec![key.to_owned()]));
    }
}

#[test]
fn what_hovers_at_a_limit_neither_begins_nor_ends() {
    assert_eq!(
        [601, 600, 541, 540].map(|value| over(value, 600)),
        [Level::Firing, Level::Between, Level::Between, Level::Clear]
    );
    let mut judge = Judge::new(limits());
    let mut disk = |mebibytes: u64| {
        let figures = Figures { disk: Some((mebibytes << 20, 0)), ..well(0) };
        judge.judge(&figures).into_iter().find(|judged| judged.key == "disk").map(|judged| judged.level)
    };
    assert_eq!(
        [999, 1000, 1099, 1100].map(&mut disk),
        [Some(Level::Firing), Some(Level::Between), Some(Level::Between), Some(Level::Clear)]
    );
}

#[test]
fn ages_of_a_site_that_was_just_started_are_not_judged_and_a_robot_that_is_away_is_not_silent() {
    let level = |second: u64, silent: u64| {
        let mut judge = Judge::new(limits());
        judge.judge(&well(0));
        let mut figures = well(second);
        figures.robots[0].last_seen = before(&figures, silent);
        judge.judge(&figures).into_iter().find(|judged| judged.key.starts_with("robot")).map(|judged| judged.level)
    };
    assert_eq!(level(60, 3600), Some(Level::Between));
    assert_eq!(level(120, 3600), Some(Level::Firing));
    assert_eq!(level(120, 86_400), None);
}

#[test]
fn rules_that_are_off_find_nothing() {
    let mut judge = Judge::new(AlertLimits::default());
    let keys: Vec<String> = judge.judge(&well(0)).into_iter().map(|judged| judged.key).collect();
    assert_eq!(keys, ["quarantine/0a0b0c0d", "tampered/0a0b0c0d", "gap", "chain", "vault"]);
}

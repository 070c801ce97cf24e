//! Every rule begins one alert and ends it, with given figures and the test's own clock.

use super::*;
use crate::alerts::Change;
use crate::alerts::Standing;
use crate::alerts::troubles::{before, grant, limits, troubles, well};
use crate::model::Address;

/// A site that is well, then in trouble for three looks, then well again: the keys of the alerts that began and ended.
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
    assert_eq!(told(&|_| {}), (vec![], vec![]), "all is well");
    for (key, trouble) in troubles() {
        assert_eq!(told(&*trouble), (vec![key.to_owned()], vec![key.to_owned()]));
    }
}

#[test]
fn every_rule_is_named_and_every_name_is_a_rule() {
    let found: std::collections::BTreeSet<String> =
        troubles().into_iter().map(|(key, _)| rule_of(key).to_owned()).collect();
    assert_eq!(found.iter().map(String::as_str).collect::<Vec<_>>(), RULES);
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
    assert_eq!(keys, ["quarantine/0a0b0c0d", "tampered/0a0b0c0d", "gap", "chain", "store", "stages"]);
}

#[test]
fn a_grant_that_ends_is_told_until_it_is_extended_or_over_and_not_forgotten_without_a_chain() {
    let level = |judged: &[Judged]| judged.iter().find(|judged| judged.key.starts_with(GRANT)).map(|it| it.level);
    let with = |second, grants| Figures { grants, ..well(second) };
    let mut judge = Judge::new(limits());
    let alert = crate::alerts::state_tests::alert("grant_ends/0a0b0c0d-0e0f0a0b");
    assert_eq!(level(&judge.judge(&with(0, None))), None);
    let waits = judge.not_known(&[alert.clone(), crate::alerts::state_tests::alert("disk")]);
    assert_eq!((waits.len(), level(&waits)), (1, Some(Level::Between)), "of a process before: it waits for the chain");
    assert_eq!(level(&judge.judge(&with(10, Some(vec![grant(3611)])))), Some(Level::Clear));
    assert_eq!(level(&judge.judge(&with(11, Some(vec![grant(3611)])))), Some(Level::Firing));
    assert_eq!(
        level(&judge.judge(&with(20, None))),
        Some(Level::Firing),
        "the chain is away, the grant ends all the same"
    );
    assert_eq!(level(&judge.judge(&with(30, Some(vec![grant(90_000)])))), Some(Level::Clear), "extended");
    assert_eq!(level(&judge.judge(&with(40, Some(Vec::new())))), None, "revoked");
    assert_eq!(level(&judge.judge(&with(50, Some(vec![grant(50)])))), None, "over");
    assert!(judge.not_known(&[alert]).is_empty());
}

#[test]
fn a_short_grant_is_no_alarm_until_a_tenth_of_it_is_left() {
    // It began at 0 and ends after 20,000 s; the limit is an hour.
    let short = GrantFigures { begun: Some(well(0).now), ..grant(20_000) };
    let level = |second: u64| {
        let figures = Figures { grants: Some(vec![short.clone()]), ..well(second) };
        let judged = Judge::new(limits()).judge(&figures);
        judged.into_iter().find(|judged| judged.key.starts_with(GRANT)).map(|judged| judged.level)
    };
    assert_eq!(
        [0, 17_999, 18_000, 19_999].map(level),
        [Level::Clear, Level::Clear, Level::Firing, Level::Firing].map(Some)
    );
    let long =
        Figures { grants: Some(vec![GrantFigures { begun: Some(well(0).now), ..grant(90_000) }]), ..well(86_000) };
    let judged = Judge::new(limits()).judge(&long);
    let of_grant = judged.into_iter().find(|judged| judged.key.starts_with(GRANT)).expect("judged");
    assert_eq!(of_grant.level, Level::Clear, "a tenth is 9,000 s, but the setting says an hour");
}

#[test]
fn what_a_dead_chain_causes_is_no_alert_of_its_own() {
    let mut judge = Judge::new(limits());
    judge.judge(&well(0));
    let mut figures = well(5_000);
    figures.owners[0].oldest_unanchored = Some(before(&figures, 4_000));
    figures.owners[0].audit_unanchored = Some(before(&figures, 4_000));
    assert_eq!(firing(judge.judge(&figures)), ["unanchored/0a0b0c0d", "audit"], "the chain says that it is well");
    figures.parts.iter_mut().filter(|part| part.part == "chain").for_each(|part| part.level = HealthLevel::Failed);
    assert_eq!(firing(judge.judge(&figures)), ["chain"]);
}

#[test]
fn an_accounts_paused_lane_hides_no_alert_of_another_account() {
    let mut judge = Judge::new(limits());
    judge.judge(&well(0));
    let mut figures = well(5_000);
    let waiting = Some(before(&figures, 4_000));
    let owner =
        |owner: &str| OwnerFigures { owner: owner.to_owned(), oldest_unanchored: waiting, ..OwnerFigures::default() };
    figures.owners = ["0a0b0c0d", "09090909"].map(owner).into();
    let chain = figures.parts.iter_mut().find(|part| part.part == "chain").expect("a part");
    (chain.level, chain.unaffected) = (HealthLevel::Failed, vec![Address([9; 20])]);
    assert_eq!(firing(judge.judge(&figures)), ["unanchored/09090909", "chain"]);
    figures.owners[0].audit_unanchored = waiting;
    assert_eq!(firing(judge.judge(&figures)), ["unanchored/09090909", "chain"], "its lane is paused");
    figures.owners[1].audit_unanchored = waiting;
    assert_eq!(firing(judge.judge(&figures)), ["unanchored/09090909", "audit", "chain"]);
}

fn firing(judged: Vec<Judged>) -> Vec<String> {
    judged.into_iter().filter(|judged| judged.level == Level::Firing).map(|judged| judged.key).collect()
}

#[test]
fn a_clock_days_away_is_told_in_days_and_the_remedy_comes_first() {
    let figures = Figures { clock_ahead: -259_168, ..well(0) };
    let judged = Judge::new(limits()).judge(&figures);
    let clock = judged.into_iter().find(|judged| judged.key == "clock").expect("judged");
    assert!(
        clock.text.starts_with("Run `timedatectl set-ntp true`") && clock.text.contains("3 d behind"),
        "{}",
        clock.text
    );
}

#[test]
fn who_reads_by_a_grant_that_ends_is_sent_to_its_owner() {
    let text = |given| {
        let figures = Figures { grants: Some(vec![GrantFigures { given, ..grant(3600) }]), ..well(0) };
        let judged = Judge::new(limits()).judge(&figures);
        judged.into_iter().find(|judged| judged.key.starts_with(GRANT)).map(|judged| judged.text).expect("an alert")
    };
    assert!(text(true).contains("`authros grant extend`"), "{}", text(true));
    assert!(text(false).contains("its owner") && !text(false).contains("grant extend"), "{}", text(false));
}

#[test]
fn an_audit_alert_from_before_a_restart_is_not_over_because_nobody_has_unlocked_a_profile() {
    let mut judge = Judge::new(limits());
    let mut standing = Standing::of([crate::alerts::state_tests::alert("audit")]);
    let mut look = |second, audit_locked| {
        let figures = Figures { audit_locked, ..well(second) };
        let changes = standing.look(figures.now, "0a0b0c0d", judge.judge(&figures));
        (changes.len(), standing.all().len())
    };
    for number in 0..40 {
        assert_eq!(look(number * 10, true), (0, 1), "look {number}");
    }
    assert_eq!([look(400, false), look(410, false)], [(0, 1), (1, 0)], "unlocked, and all lines are covered");
}

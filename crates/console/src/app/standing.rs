//! What is not well now, as alerts.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use crate::app::{State, alerts::Alert, alerts::health};
use crate::model::{Address, Timestamp, coarse};
use crate::screens::{grants::state::is_active, grants::state::is_given, robots, topics::capture::not_captured};
use crate::service::NoticeLevel;
use crate::service::reply::{AlertView, GrantRow, LifeLine, Severity, SiteView};

const MOST_NOTICES: usize = 3;

pub fn refresh(state: &mut State) {
    let found = standing(state);
    state.alerts.refresh(found, state.now);
}

fn standing(state: &State) -> Vec<Alert> {
    let alert = |about: &str, level, text| Alert::new(about, level, text, state.now);
    let mut found = Vec::new();
    if let Some(site) = &state.site {
        found.extend(site.health.iter().filter_map(|part| {
            let (level, text) = health(part)?;
            Some(Alert { since: part.since.unwrap_or(state.now), lasts: true, ..alert(&part.part, level, text) })
        }));
        found.extend(
            life(&site.life).into_iter().map(|(count, level, what)| alert(what, level, format!("{count} {what}"))),
        );
        let ending = ending(state, site);
        found.extend(judged(state, site, &ending));
        found.extend(ending.values().map(|(row, text)| {
            alert(&format!("grant {} {}", row.grantee, row.epoch), NoticeLevel::Info, text.clone())
        }));
    }
    if let Some((since, text)) = robots::keys::drift(state) {
        found.push(Alert { since, lasts: true, ..alert("robots out of date", NoticeLevel::Warning, text) });
    }
    if let Some((about, text)) = identity(state) {
        found.push(alert(about, NoticeLevel::Warning, text));
    }
    for line in state.log.urgent(MOST_NOTICES) {
        // The same text repeated is one alert, active since the first time.
        match found.iter_mut().find(|alert| alert.about == line.text) {
            Some(alert) => (alert.count, alert.since) = (alert.count + 1, alert.since.min(line.at)),
            None => found.push(Alert { since: line.at, ..alert(&line.text, line.level, line.text.clone()) }),
        }
    }
    found
}

/// Alerts of the site's own rules, with the site's times, regardless of consoles.
fn judged(state: &State, site: &SiteView, ending: &Ending<'_>) -> Vec<Alert> {
    let shown = |alert: &AlertView, resolved| {
        let level = match alert.severity {
            Severity::Warning => NoticeLevel::Warning,
            Severity::Critical => NoticeLevel::Error,
        };
        let about = format!("alert {}", alert.key);
        Alert { resolved, lasts: true, ..Alert::new(&about, level, alert.text.clone(), alert.begun) }
    };
    let is_news = |alert: &&AlertView| !is_told_otherwise(&alert.key, state, site, ending);
    let standing = site.alerts.iter().filter(is_news).map(|alert| shown(alert, None));
    let over = site.alerts_over.iter().filter(|over| is_news(&&over.alert));
    standing.chain(over.map(|over| shown(&over.alert, Some(over.ended)))).collect()
}

/// Whether health, record counts or grants say the same in more helpful words.
fn is_told_otherwise(key: &str, state: &State, site: &SiteView, ending: &Ending<'_>) -> bool {
    let own = state.identity.as_ref().and_then(|identity| identity.address);
    let (rule, subject) = key.split_once('/').unwrap_or((key, ""));
    let chain_trouble = || site.health.iter().filter(|part| part.part == "chain" && health(part).is_some());
    match rule {
        "chain" | "store" => true,
        // Nothing is anchored without a chain, or in a paused lane: one cause, one alert.
        "unanchored" => chain_trouble().any(|part| !part.unaffected.iter().any(|other| is_of(*other, subject))),
        "audit" => chain_trouble().any(|part| part.unaffected.is_empty()),
        "tampered" | "quarantine" => own.is_some_and(|own| is_of(own, subject)),
        "gap" => site.life.lost_in_transport > 0 || site.life.dropped > site.life.discarded,
        GRANT_ENDS => ending.contains_key(&subject.to_ascii_lowercase()),
        // Including rules of a later version.
        _ => false,
    }
}

fn is_of(account: Address, subject: &str) -> bool {
    begins(account).eq_ignore_ascii_case(subject)
}

fn begins(account: Address) -> String {
    account.to_string().trim_start_matches("0x").chars().take(8).collect()
}

/// The worst that the profile lacks.
fn identity(state: &State) -> Option<(&'static str, String)> {
    let identity = state.identity.as_ref().filter(|identity| identity.exists)?;
    if !identity.unlocked {
        let off = not_captured(state).map_or_else(String::new, |what| format!(": {what}"));
        return Some(("locked", format!("locked{off}; u unlocks")));
    }
    if let Some(what) = not_captured(state) {
        return Some(("not captured", what));
    }
    (!identity.registered).then(|| ("not registered", "not registered on this chain: 6, then R registers".to_owned()))
}

/// The site's rule, whose text names accounts by eight digits only.
const GRANT_ENDS: &str = "grant_ends";

/// Grants given whose end is near by that rule, by its subject, each with what to do.
type Ending<'a> = BTreeMap<String, (&'a GrantRow, String)>;

fn subject(row: &GrantRow) -> String {
    format!("{}-{}", begins(row.owner), begins(row.grantee)).to_ascii_lowercase()
}

fn ending<'a>(state: &'a State, site: &SiteView) -> Ending<'a> {
    let near = site.alerts.iter().filter_map(|alert| alert.key.strip_prefix(GRANT_ENDS));
    let near: BTreeSet<String> = near.map(|rest| rest.trim_start_matches('/').to_ascii_lowercase()).collect();
    let given = state.grants.rows.iter().filter(|row| !near.is_empty() && is_given(row) && is_active(row));
    let told = |row: &'a GrantRow| {
        let subject = Some(subject(row)).filter(|subject| near.contains(subject))?;
        Some((subject, (row, expiring(row, state.now)?)))
    };
    given.filter_map(told).collect()
}

fn expiring(row: &GrantRow, now: Timestamp) -> Option<String> {
    let left = Duration::from_nanos(row.expires?.0.checked_sub(now.0)?);
    let who = row.name.clone().unwrap_or_else(|| row.grantee.short());
    Some(format!("5, then e extends: the grant to {who} ends in {}, and a new epoch begins then", coarse(left)))
}

fn life(life: &LifeLine) -> Vec<(u64, NoticeLevel, &'static str)> {
    let dropped = life.dropped.saturating_sub(life.discarded);
    let counted = [
        (life.tampered, NoticeLevel::Error, "tampered: not the bytes that were anchored (3, then / tampered)"),
        (
            life.right_ended,
            NoticeLevel::Warning,
            "unauthorised: restore the account or authorise the device again, \
                                                  then they resume",
        ),
        (life.quarantined, NoticeLevel::Warning, "quarantined: sent by a node that is not the pinned publisher"),
        (dropped, NoticeLevel::Warning, "dropped by the recorder before sealing; gap records count them"),
        (life.lost_in_transport, NoticeLevel::Warning, "lost in transport before capture"),
    ];
    counted.into_iter().filter(|(count, ..)| *count > 0).collect()
}

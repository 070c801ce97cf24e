//! What is not well now, as alerts.

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
        found.extend(judged(state, site));
        found.extend(state.grants.rows.iter().filter_map(|row| {
            let text = expiring(row, site, state.now)?;
            Some(alert(&format!("grant {} {}", row.grantee, row.epoch), NoticeLevel::Info, text))
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
fn judged(state: &State, site: &SiteView) -> Vec<Alert> {
    let shown = |alert: &AlertView, resolved| {
        let level = match alert.severity {
            Severity::Warning => NoticeLevel::Warning,
            Severity::Critical => NoticeLevel::Error,
        };
        let about = format!("alert {}", alert.key);
        Alert { resolved, lasts: true, ..Alert::new(&about, level, alert.text.clone(), alert.begun) }
    };
    let is_news = |alert: &&AlertView| !is_told_otherwise(&alert.key, state, site);
    let standing = site.alerts.iter().filter(is_news).map(|alert| shown(alert, None));
    let over = site.alerts_over.iter().filter(|over| is_news(&&over.alert));
    standing.chain(over.map(|over| shown(&over.alert, Some(over.ended)))).collect()
}

/// Whether health, record counts or grants say the same in more helpful words.
fn is_told_otherwise(key: &str, state: &State, site: &SiteView) -> bool {
    let own = state.identity.as_ref().and_then(|identity| identity.address);
    let (rule, subject) = key.split_once('/').unwrap_or((key, ""));
    match rule {
        "chain" | "store" => true,
        // Nothing is anchored without a chain: one cause, one alert.
        "unanchored" | "audit" => site.health.iter().any(|part| part.part == "chain" && health(part).is_some()),
        "tampered" | "quarantine" => own.is_some_and(|own| begins(own).eq_ignore_ascii_case(subject)),
        "gap" => site.life.lost_in_transport > 0 || site.life.dropped > site.life.discarded,
        GRANT_ENDS => {
            state.grants.rows.iter().any(|row| ends(row, subject) && expiring(row, site, state.now).is_some())
        }
        // Including rules of a later version.
        _ => false,
    }
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

/// Whether a subject of that rule is this grant.
fn ends(row: &GrantRow, subject: &str) -> bool {
    format!("{}-{}", begins(row.owner), begins(row.grantee)).eq_ignore_ascii_case(subject)
}

/// A grant given whose end is near, by the site's rule.
fn expiring(row: &GrantRow, site: &SiteView, now: Timestamp) -> Option<String> {
    let until = row.expires.filter(|_| is_given(row) && is_active(row))?;
    let is_near = |alert: &AlertView| {
        alert.key.strip_prefix(GRANT_ENDS).is_some_and(|rest| ends(row, rest.trim_start_matches('/')))
    };
    let left = Duration::from_nanos(until.0.checked_sub(now.0).filter(|_| site.alerts.iter().any(is_near))?);
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

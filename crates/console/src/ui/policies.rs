//! How robots stand to their policies: a cell of a list, and what there is to say of a robot in full.

use super::theme::Role;
use super::words;
use crate::app::policies::{Standing, words as stands};
use crate::app::words::counted;
use crate::model::{Timestamp, clean};
use crate::service::reply::{RobotRow, RobotView};

/// A name of what is known, the words, and their role.
pub type Fact = (&'static str, String, Role);

/// Mark, words and role of how a robot stands to its policy.
pub fn standing(row: &RobotRow) -> (String, Role) {
    let (mark, role) = match Standing::of(row) {
        Standing::Unset => return (stands(row), Role::Dim),
        Standing::Wrong => ("✖", Role::Bad),
        Standing::Drifts => ("◐", Role::Warning),
        Standing::InForce => ("●", Role::Good),
    };
    (format!("{mark} {}", stands(row)), role)
}

/// What the list knows of a robot.
pub fn row_facts(row: &RobotRow, now: Timestamp) -> Vec<Fact> {
    let (text, role) = standing(row);
    let wanted = match row.wanted {
        0 => "no policy was set".to_owned(),
        _ => text,
    };
    let mut facts = vec![("policy", wanted, role), runs(row)];
    facts.extend(drift(row, now));
    facts.push(("waiting", format!("{} of it here", counted(row.waiting, "record")), Role::Body));
    facts
}

fn runs(row: &RobotRow) -> Fact {
    let text = match row.running {
        None => "it has not told yet what it works by".to_owned(),
        Some(0) => "it works by its own settings alone".to_owned(),
        Some(version) => format!("it works by version {version}"),
    };
    ("runs", text, Role::Body)
}

fn drift(row: &RobotRow, now: Timestamp) -> Option<Fact> {
    let since = row.drift_since?;
    Some(("drift", format!("since {}, for {}", words::second(since), words::age(since, now)), Role::Warning))
}

/// All that is known of a robot, besides its topics and the policy's text.
pub fn facts(view: &RobotView, now: Timestamp) -> Vec<Fact> {
    let row = &view.row;
    let seen = row.last_seen.map_or_else(
        || "never".to_owned(),
        |at| {
            format!("{}, {} ago; {} wait here", words::second(at), words::age(at, now), counted(row.waiting, "record"))
        },
    );
    let (stands, role) = standing(row);
    let policy = match (row.wanted, view.set_at) {
        (0, _) => ("policy", "no policy was set".to_owned(), Role::Dim),
        (_, Some(at)) => ("policy", format!("{stands}; set {}", words::second(at)), role),
        (_, None) => ("policy", stands, role),
    };
    let mut facts = vec![policy, runs(row)];
    facts.extend(drift(row, now));
    facts.extend(view.refused.iter().map(|why| ("refused", format!("it refused: {}", clean(why, 300)), Role::Bad)));
    let overruled = view.overruled.iter();
    facts.extend(overruled.map(|what| ("overruled", format!("on the robot: {}", clean(what, 300)), Role::Body)));
    facts.push(("last seen", seen, Role::Body));
    facts.push(("device", row.device.to_hex(), Role::Dim));
    for address in view.gateway.iter().flat_map(|gateway| &gateway.addresses) {
        facts.push(("gateway", clean(address, 255), Role::Body));
    }
    let enrolled = if view.enrolled.is_empty() { "all topics".to_owned() } else { view.enrolled.join(" ") };
    facts.push(("enrolled", enrolled, Role::Body));
    facts
}

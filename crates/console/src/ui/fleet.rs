//! The fleet: a row for each other gateway, what is wrong with one, and what there is to say of it in full.

use ratatui::layout::Rect;

use super::canvas::{Canvas, below, row};
use super::table::{Column, Sheet, draw_part};
use super::theme::Role;
use super::words;
use crate::app::State;
use crate::app::fleet::{Standing, short};
use crate::app::screens::gateway::fellow_key;
use crate::app::table::Table;
use crate::app::words::counted;
use crate::model::{Timestamp, clean};
use crate::service::reply::FellowView;

/// What was heard within this many nanoseconds is heard now.
const NOW: u64 = 10_000_000_000;
/// The word for that.
const JUST_NOW: &str = "now";

/// A name of what is known, the words, and their role.
pub type Fact = (&'static str, String, Role);

const COLUMNS: &[Column] = &[
    Column::text("State", 17),
    Column::name("Gateway"),
    Column::text("Key", 9).from(76),
    Column::text("Heard", 6),
    Column::number("Taken", 8),
    Column::number("Refused", 7),
    Column::number("Twice", 5).from(70).below(100),
    Column::number("Anchored twice", 14).from(100),
];

/// Rows that the fleet takes besides those of its gateways: title, heads, what is wrong, a gap.
pub fn around(fellows: &[&FellowView]) -> u16 {
    3 + u16::from(fellows.iter().any(|one| one.problem.is_some()))
}

/// Draws the fleet; `here` = the row under the cursor, if that is one of its rows.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, fellows: &[&FellowView], here: Option<usize>) {
    let keys: Vec<String> = fellows.iter().map(|one| fellow_key(one)).collect();
    let cells = |index: usize| fellows.get(index).map_or_else(Vec::new, |one| cells(state, one));
    let troubled = |one: &&&FellowView| one.problem.is_some();
    let wrong = here.and_then(|place| fellows.get(place)).filter(troubled).or(fellows.iter().find(troubled));
    let height = area.height.saturating_sub(u16::from(wrong.is_some()));
    let sheet = Sheet {
        title: "Fleet",
        note: note(state, fellows, usize::from(height.saturating_sub(2))),
        columns: COLUMNS,
        keys: &keys,
        cells: &cells,
        // The filter is shown once, above the other part of the list.
        table: &Table::default(),
        empty: "No gateway of the fleet matches the filter.",
        old: false,
    };
    draw_part(canvas, Rect { height, ..area }, &sheet, here);
    if let Some(one) = wrong {
        let problem = one.problem.as_deref().unwrap_or_default();
        let text = format!("  ✖ {}: {}", clean(&one.address, 60), clean(problem, 300));
        canvas.put(row(below(area, height), 0), &text, Role::Bad);
    }
}

/// How many there are, how many are well, and that there are more than fit.
fn note(state: &State, fellows: &[&FellowView], rows: usize) -> String {
    let all = state.gateway.all_fellows().len();
    let well = fellows.iter().filter(|one| one.reconciled).count();
    let mut note = format!("{} of {}, {well} reconciled", fellows.len(), counted(all as u64, "other gateway"));
    let left = fellows.len().saturating_sub(rows);
    if left > 0 {
        note.push_str(&format!(", {left} more rows"));
    }
    if state.gateway.view.as_ref().is_some_and(|view| view.served.is_none()) {
        note.push_str("; no gateway runs here, so none is asked");
    }
    note
}

/// Mark, words and role of how a gateway stands.
pub fn standing(one: &FellowView) -> (String, Role) {
    let standing = Standing::of(one);
    let (mark, role) = match standing {
        Standing::Trouble => ("✖", Role::Bad),
        Standing::NotHeard => ("○", Role::Warning),
        Standing::Lacking(_) => ("◐", Role::Warning),
        Standing::Reading => ("◐", Role::Accent),
        Standing::Reconciled => ("●", Role::Good),
    };
    let words = match standing {
        Standing::Lacking(records) => format!("lacking {}", words::count(records)),
        other => other.words(),
    };
    (format!("{mark} {words}"), role)
}

/// How long ago it was heard.
fn heard(at: Option<Timestamp>, now: Timestamp) -> String {
    match at {
        None => "never".to_owned(),
        Some(at) if now.0.saturating_sub(at.0) < NOW => JUST_NOW.to_owned(),
        Some(at) => words::age(at, now),
    }
}

fn refused(one: &FellowView) -> u64 {
    one.refused.iter().map(|row| row.count).fold(0, u64::saturating_add)
}

fn cells(state: &State, one: &FellowView) -> Vec<(String, Role)> {
    let counted = |count: u64, role| (words::count(count), if count > 0 { role } else { Role::Dim });
    vec![
        standing(one),
        (clean(&one.address, 255), Role::Body),
        (short(&one.key), Role::Dim),
        (heard(one.heard, state.shown_at()), Role::Dim),
        counted(one.taken, Role::Body),
        counted(refused(one), Role::Warning),
        counted(one.anchored_twice, Role::Body),
        counted(one.anchored_twice, Role::Body),
    ]
}

/// All that is known of a gateway.
pub fn facts(state: &State, one: &FellowView) -> Vec<Fact> {
    let (stands, role) = standing(one);
    let told = |at: Timestamp| match heard(Some(at), state.shown_at()) {
        // A clock would move all the time, and say no more.
        age if age == JUST_NOW => age,
        age => format!("{}, {age} ago", words::second(at)),
    };
    let account = "no account known here has registered this key".to_owned();
    let records = |count: u64| format!("{} {}", words::count(count), if count == 1 { "record" } else { "records" });
    let mut facts = vec![
        ("state", stands, role),
        ("address", clean(&one.address, 255), Role::Body),
        ("key", one.key.to_hex(), Role::Body),
        ("account", one.account.map_or(account, |account| account.to_string()), Role::Body),
        ("added", words::second(one.added_at), Role::Dim),
        ("heard", one.heard.map_or_else(|| "not since this site started".to_owned(), told), Role::Body),
        ("lacking", format!("{} of its records are missing here", words::count(one.lacking)), Role::Body),
        ("taken", format!("{} since this site started", records(one.taken)), Role::Body),
    ];
    if let Some(problem) = &one.problem {
        facts.insert(1, ("trouble", clean(problem, 300), Role::Bad));
    }
    if one.away {
        let text = "away: others keep what fell to it until it is back".to_owned();
        facts.insert(1, ("copies", text, Role::Warning));
    }
    if one.refused.is_empty() {
        facts.push(("refused", "none".to_owned(), Role::Dim));
    }
    let refused = one.refused.iter();
    facts.extend(
        refused.map(|row| ("refused", format!("{}: {}", records(row.count), clean(&row.text, 200)), Role::Warning)),
    );
    let twice = match one.anchored_twice {
        0 => ("twice", "no record was anchored by both".to_owned(), Role::Dim),
        count => ("twice", format!("{} anchored by both; harmless", records(count)), Role::Body),
    };
    facts.push(twice);
    if one.erased > 0 {
        let text = format!("{} erased here at its word, which its owner signed", records(one.erased));
        facts.push(("erased", text, Role::Body));
    }
    if one.passed_over > 0 {
        let owners = counted(one.passed_over, "owner");
        let text = format!("{owners} may not use this gateway: not taken; authros gateway admit lets an owner use it");
        facts.push(("owners", text, Role::Warning));
    }
    facts
}

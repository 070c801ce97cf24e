//! The Gateway screen: what is served, system keys and their dates, refusals, and the senders.

use ratatui::layout::Rect;

use super::canvas::{Canvas, below, row};
use super::keys::line;
use super::table::{Column, Sheet, draw as draw_table, order};
use super::theme::Role;
use super::topics::empty;
use super::words;
use crate::app::State;
use crate::app::feed::Feed;
use crate::app::screens::gateway::SORTS;
use crate::app::screens::grants::day;
use crate::model::clean;
use crate::service::reply::{GatewayStatusView, SenderView, SystemKeyView};

/// The most reasons of refusals shown.
const MOST_REASONS: usize = 4;

const COLUMNS: &[Column] = &[
    Column::text("State", 9),
    Column::name("Robot or operator"),
    Column::text("Account", 13),
    Column::text("From", 21).from(90),
    Column::number("Frames", 8),
    Column::number("Bytes", 9),
    Column::text("Since UTC", 9).from(100),
    Column::text("Last UTC", 8),
];

/// Draws the screen.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State) {
    let Some(view) = &state.gateway.view else {
        canvas.put(area, "Gateway", Role::Title);
        canvas.put(below(area, 1), empty(state, Feed::Gateway, "Asking…"), Role::Dim);
        return;
    };
    let taken = draw_about(canvas, area, view);
    let rest = below(area, taken);
    if view.served.is_some() || !view.senders.is_empty() {
        draw_senders(canvas, rest, state);
    }
}

/// What is served, its keys, its refusals; returns the rows that took.
fn draw_about(canvas: &mut Canvas, area: Rect, view: &GatewayStatusView) -> u16 {
    canvas.put(area, "Gateway", Role::Title);
    let Some(served) = &view.served else {
        let (first, second) = match &view.through {
            Some(through) => (format!("This site has joined another one: {through}"), "Its gateway is managed there."),
            None => (
                "This site has no gateway.".to_owned(),
                "Records go straight to its vault and chain. Start one with: authros gateway serve",
            ),
        };
        canvas.put(row(area, 1), &clean(&first, 300), Role::Body);
        canvas.put(row(area, 2), second, Role::Dim);
        return 4;
    };
    line(canvas, row(area, 1), "Listens", &format!("{}, {} connections", served.address, view.connections), Role::Good);
    line(canvas, row(area, 2), "Fingerprint", &format!("{} (to be pinned)", served.fingerprint), Role::Body);
    line(canvas, row(area, 3), "Anchors as", &served.account.to_string(), Role::Body);
    let mut place = 4;
    for key in &view.keys {
        line(
            canvas,
            row(area, place),
            if key.current { "System key" } else { "Next key" },
            &system_key(key),
            Role::Body,
        );
        place += 1;
    }
    if let Some(expires) = view.list_expires {
        let text = format!("version {}, not valid after {} UTC", view.list_version, day(expires));
        line(canvas, row(area, place), "Key list", &text, Role::Dim);
        place += 1;
    }
    place + draw_refused(canvas, below(area, place), view) + 1
}

fn system_key(key: &SystemKeyView) -> String {
    let id: String = key.id.to_hex().chars().take(16).collect();
    let word = if key.current { "in use" } else { "waits" };
    format!("{id}…  {word}, {} to {} UTC", day(key.not_before), day(key.not_after))
}

fn draw_refused(canvas: &mut Canvas, area: Rect, view: &GatewayStatusView) -> u16 {
    if view.refused.is_empty() {
        line(canvas, area, "Refused", "none since start", Role::Dim);
        return 1;
    }
    let mut place = 0;
    for refused in view.refused.iter().take(MOST_REASONS) {
        let reason = refused.text.split(';').next().unwrap_or_default();
        let label = if place == 0 { "Refused" } else { "" };
        line(canvas, row(area, place), label, &format!("{:>7}  {reason}", words::count(refused.count)), Role::Warning);
        place += 1;
    }
    if view.refused.len() > MOST_REASONS {
        let more: u64 = view.refused.iter().skip(MOST_REASONS).map(|refused| refused.count).sum();
        line(
            canvas,
            row(area, place),
            "",
            &format!("{:>7}  for other reasons (9: audit)", words::count(more)),
            Role::Dim,
        );
        place += 1;
    }
    place
}

fn draw_senders(canvas: &mut Canvas, area: Rect, state: &State) {
    let gateway = &state.gateway;
    let rows = gateway.visible();
    let keys: Vec<String> = rows.iter().map(|row| row.name.to_string()).collect();
    let all = gateway.view.as_ref().map_or(0, |view| view.senders.len());
    let connected = rows.iter().filter(|row| row.sessions > 0).count();
    let order = order(&SORTS, &gateway.table);
    let note = format!("{} of {all}, {connected} connected, by {order}", rows.len());
    let cells = |index: usize| rows.get(index).map_or_else(Vec::new, |row| cells(row));
    let empty = "Nobody is enrolled yet; `authros agent enrol` adds a robot or operator.";
    let sheet = Sheet {
        title: "Senders",
        note,
        columns: COLUMNS,
        keys: &keys,
        cells: &cells,
        table: &gateway.table,
        empty,
        old: false,
    };
    draw_table(canvas, area, &sheet);
}

fn cells(row: &SenderView) -> Vec<(String, Role)> {
    let (word, role) = if row.sessions > 0 { ("connected", Role::Good) } else { ("away", Role::Dim) };
    vec![
        (word.to_owned(), role),
        (row.name.to_string(), Role::Body),
        (row.account.short(), Role::Accent),
        (row.peer.clone().unwrap_or_default(), Role::Dim),
        (words::count(row.frames), Role::Body),
        (words::size(row.bytes), Role::Body),
        (row.since.map(crate::model::Timestamp::clock).unwrap_or_default(), Role::Dim),
        (row.last.map(crate::model::Timestamp::clock).unwrap_or_default(), Role::Dim),
    ]
}

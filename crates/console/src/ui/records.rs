//! The Uploads and Shared screens: a page of records.

use ratatui::layout::Rect;

use super::canvas::Canvas;
use super::table::{Column, Sheet, draw as draw_table, with_local_time};
use super::theme::Role;
use super::topics::{empty, simulated};
use super::words;
use crate::app::State;
use crate::app::feed::Feed;
use crate::app::screens::grants::day;
use crate::app::screens::records::{Records, Wanted};
use crate::model::{RecordKind, RecordState};
use crate::service::reply::{Caveat, RecordView, ShownState};

const UPLOADS: &[Column] = &[
    Column::text("State", 11),
    Column::name("Topic"),
    Column::text("Type", 27).from(120),
    Column::number("Seq", 7),
    Column::number("Size", 8),
    Column::text("UTC", 8),
    Column::number("Epoch", 5).from(130),
    Column::number("Block", 8).from(100),
    Column::text("Id", 16).from(140),
    Column::text("", 3).below(70),
    Column::text("", 9).from(70),
];

const SHARED: &[Column] = &[
    Column::text("State", 11),
    Column::text("Owner", 13),
    Column::name("Topic"),
    Column::text("Type", 27).from(120),
    Column::number("Seq", 7),
    Column::number("Size", 8),
    Column::text("UTC", 8).from(70),
    Column::number("Epoch", 5).from(130),
    Column::number("Block", 8).from(110),
    Column::text("Id", 16).from(150),
    Column::text("", 3).below(100),
    Column::text("", 9).from(100),
];

/// Draws the Uploads screen.
pub fn draw_uploads(canvas: &mut Canvas, area: Rect, state: &State) {
    let nothing = "No records yet: watch a topic (2, then w).";
    draw(
        canvas,
        area,
        state,
        (&state.uploads, Feed::Uploads),
        ("Uploads", UPLOADS, empty(state, Feed::Uploads, nothing)),
    );
}

/// Draws the Shared screen.
pub fn draw_shared(canvas: &mut Canvas, area: Rect, state: &State) {
    let nothing = "Nobody shares with you yet: give others your address (6, then y).";
    draw(
        canvas,
        area,
        state,
        (&state.shared, Feed::Shared),
        ("Shared with me", SHARED, empty(state, Feed::Shared, nothing)),
    );
}

fn draw(canvas: &mut Canvas, area: Rect, state: &State, list: (&Records, Feed), look: (&str, &[Column], &str)) {
    let (records, feed) = list;
    let slot = state.feeds.slot(feed);
    let (title, columns, empty) = look;
    let rows = records.visible(&state.topics.rows, state.now);
    let keys: Vec<String> = rows.iter().map(|row| row.id.clone()).collect();
    let with_owner = columns.iter().any(|column| column.title == "Owner");
    let cells = |index: usize| rows.get(index).map_or_else(Vec::new, |row| cells(state, row, with_owner));
    let empty = if records.table.filter.text().is_empty() { empty } else { "No records match the filter." };
    let mut note = note(records, &Wanted::read(records.table.filter.text(), &state.topics.rows, state.now));
    if slot.left || slot.told != slot.generation {
        note.push_str(", reading…");
    }
    let columns = &with_local_time(columns, state);
    let sheet =
        Sheet { title, note, columns, keys: &keys, cells: &cells, table: &records.table, empty, old: slot.left };
    draw_table(canvas, area, &sheet);
}

fn note(records: &Records, wanted: &Wanted) -> String {
    let order = if records.table.sort == 0 { "newest first" } else { "oldest first" };
    let mut note = format!("{order}, page {}", records.path.len() + 1);
    if let Some(at) = records.anchor {
        note.push_str(&format!(" as of {} (home: newest)", at.clock()));
    }
    if records.next.is_some() {
        note.push_str(", more below");
    }
    let asked = &wanted.asked;
    let words = [
        asked.topic.as_ref().map(|topic| format!("only {topic}")),
        asked.type_name.as_ref().map(|name| format!("only {name}")),
        asked.owner.as_ref().map(|owner| format!("of {}", owner.short())),
        asked.kind.map(|kind| format!("only of kind {}", kind.word())),
        asked.since.map(|since| format!("since {} UTC", day(since))),
        asked.until.map(|until| format!("until {} UTC", day(until))),
    ];
    let searched = asked.words.iter().map(|word| format!("with '{word}'"));
    let tags = asked.tags.iter().map(|(name, value)| format!("tag {name}={value}"));
    for word in words.into_iter().flatten().chain(searched).chain(tags) {
        note.push_str(", ");
        note.push_str(&word);
    }
    if !records.table.marks.is_empty() {
        note.push_str(&format!(", {} marked", records.table.marks.len()));
    }
    if !wanted.rest.is_empty() {
        note.push_str(", ids on this page only");
    }
    note
}

fn cells(state: &State, row: &RecordView, with_owner: bool) -> Vec<(String, Role)> {
    let topic = match row.kind {
        RecordKind::Data => row.topic.clone(),
        kind => format!("{} ({})", row.topic, kind.word()),
    };
    let mut cells = vec![(short_state(row.state.word()).to_owned(), state_role(row.state))];
    if with_owner {
        let short = || row.owner.map(|owner| owner.short());
        cells.push((row.owner_name.clone().or_else(short).unwrap_or_default(), Role::Accent));
    }
    cells.extend([
        (topic, Role::Body),
        (row.type_name.clone(), Role::Dim),
        (row.seq.to_string(), Role::Body),
        (words::size(row.bytes), Role::Body),
        (state.clock(row.captured_at), Role::Dim),
        (row.epoch.to_string(), Role::Dim),
        (row.block.map(|block| block.to_string()).unwrap_or_default(), Role::Dim),
        (row.id.clone(), Role::Dim),
        (if row.simulated { "SIM".to_owned() } else { String::new() }, Role::Warning),
        simulated(row.simulated),
    ]);
    cells
}

/// A record's state, to fit into its column.
fn short_state(state: &str) -> &str {
    state.strip_prefix("waits: ").unwrap_or(state)
}

/// The role of a record's state.
pub fn state_role(state: ShownState) -> Role {
    match state {
        ShownState::Kept(RecordState::Verified) | ShownState::Verified(Caveat::NamesUnchecked) => Role::Good,
        ShownState::Kept(RecordState::Tampered) => Role::Bad,
        ShownState::Kept(RecordState::Quarantined | RecordState::Dropped | RecordState::RightEnded) => Role::Warning,
        ShownState::Kept(_) | ShownState::Verified(Caveat::Deleted | Caveat::Unread) => Role::Accent,
    }
}

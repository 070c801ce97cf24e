//! The Uploads and Shared screens: a page of records.

use ratatui::layout::Rect;

use super::canvas::Canvas;
use super::table::{Column, Layout, Sheet, draw as draw_table, with_local_time};
use super::theme::Role;
use super::topics::{empty, simulated};
use super::words;
use crate::app::feed::Feed;
use crate::app::screens::records::{Records, Wanted};
use crate::app::{Screen, State};
use crate::model::{RecordKind, RecordState, Timestamp};
use crate::service::reply::{Caveat, RecordView, ShownState};

const STATE: Column = Column::text("State", 11).named("state");
const TOPIC: Column = Column::name("Topic").named("topic");
const TYPE: Column = Column::text("Type", 27).named("type");
const SEQ: Column = Column::number("Seq", 7).named("seq");
const SIZE: Column = Column::number("Size", 8).named("size");
const TIME: Column = Column::text("UTC", 8).named("time");
const EPOCH: Column = Column::number("Epoch", 5).named("epoch");
const BLOCK: Column = Column::number("Block", 8).named("block");
const ID: Column = Column::text("Id", 16).named("id");
const DIGEST: Column = Column::text("SM3", 13).named("digest");
const TRANSACTION: Column = Column::text("Transaction", 13).named("transaction");

/// From which width the mark of simulated records is written out, columns.
const UPLOADS_WIDE: u16 = 70;
const SHARED_WIDE: u16 = 100;

const UPLOADS: &[Column] = &[
    STATE,
    TOPIC,
    TYPE,
    SEQ,
    SIZE,
    TIME,
    EPOCH,
    BLOCK,
    ID,
    DIGEST,
    TRANSACTION,
    Column::text("", 3).below(UPLOADS_WIDE),
    Column::text("", 9).from(UPLOADS_WIDE),
];

const SHARED: &[Column] = &[
    STATE,
    Column::text("Owner", 13).named("owner"),
    TOPIC,
    TYPE,
    SEQ,
    SIZE,
    TIME,
    EPOCH,
    BLOCK,
    ID,
    DIGEST,
    TRANSACTION,
    Column::text("", 3).below(SHARED_WIDE),
    Column::text("", 9).from(SHARED_WIDE),
];

/// All columns of Uploads, or of Shared.
pub(in crate::ui) fn all_columns(screen: Screen) -> &'static [Column] {
    if screen == Screen::Shared { SHARED } else { UPLOADS }
}

/// Draws the Uploads screen.
pub fn draw_uploads(canvas: &mut Canvas, area: Rect, state: &State) {
    let nothing = "No records yet: watch a topic (2, then w).";
    draw(
        canvas,
        area,
        state,
        (&state.uploads, Feed::Uploads, Screen::Uploads),
        ("Uploads", empty(state, Feed::Uploads, nothing)),
    );
}

/// Draws the Shared screen.
pub fn draw_shared(canvas: &mut Canvas, area: Rect, state: &State) {
    let nothing = "Nobody shares with you yet: give others your address (6, then y).";
    draw(
        canvas,
        area,
        state,
        (&state.shared, Feed::Shared, Screen::Shared),
        ("Shared with me", empty(state, Feed::Shared, nothing)),
    );
}

fn draw(canvas: &mut Canvas, area: Rect, state: &State, list: (&Records, Feed, Screen), look: (&str, &str)) {
    let (records, feed, screen) = list;
    let slot = state.feeds.slot(feed);
    let (title, empty) = look;
    let rows = records.visible(&state.topics.rows);
    let keys: Vec<String> = rows.iter().map(|row| row.id.clone()).collect();
    let layout = Layout::new(&with_local_time(all_columns(screen), state), screen, &records.table, area.width);
    let cells = |index: usize| {
        rows.get(index).map_or_else(Vec::new, |row| layout.pick(cells(state, row, screen == Screen::Shared)))
    };
    let empty = if records.table.filter.text().is_empty() { empty } else { "No records match the filter." };
    let mut note = note(records, &records.wanted(&state.topics.rows));
    note.push_str(&layout.note());
    if slot.left || slot.told != slot.generation {
        note.push_str(", reading…");
    }
    let columns = &layout.columns;
    let sheet =
        Sheet { title, note, columns, keys: &keys, cells: &cells, table: &records.table, empty, old: slot.left };
    draw_table(canvas, area, &sheet);
}

/// `2026-11-26 21:54:22`.
fn second(at: Timestamp) -> String {
    let text = at.to_string();
    text.get(..19).unwrap_or(&text).replace('T', " ")
}

fn note(records: &Records, wanted: &Wanted) -> String {
    let order = if records.table.sort == 0 { "newest first" } else { "oldest first" };
    let marked = records.table.marks.len();
    let marked = if marked > 0 { format!("{marked} marked, ") } else { String::new() };
    let mut note = format!("{marked}{order}, page {}", records.path.len() + 1);
    if let Some(at) = records.anchor {
        note.push_str(&format!(" as of {} (home: newest)", at.clock()));
    }
    if records.next.is_some() {
        note.push_str(", more below");
    }
    if records.arriving {
        note.push_str(", more is arriving from the gateway");
    }
    let asked = &wanted.asked;
    let words = [
        asked.topic.as_ref().map(|topic| format!("only {topic}")),
        asked.type_name.as_ref().map(|name| format!("only {name}")),
        asked.owner.as_ref().map(|owner| format!("of {}", owner.short())),
        asked.kind.map(|kind| format!("only of kind {}", kind.word())),
        asked.since.map(|since| format!("since {} UTC", second(since))),
        asked.until.map(|until| format!("until {} UTC", second(until))),
    ];
    let searched = asked.words.iter().map(|word| format!("with '{word}'"));
    let tags = asked.tags.iter().map(|(name, value)| format!("tag {name}={value}"));
    for word in words.into_iter().flatten().chain(searched).chain(tags) {
        note.push_str(", ");
        note.push_str(&word);
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
        (beginning(&row.digest.to_hex()), Role::Dim),
        (row.transaction.map(|hash| beginning(&hash.to_string())).unwrap_or_default(), Role::Dim),
        (if row.simulated { "SIM".to_owned() } else { String::new() }, Role::Dim),
        simulated(row.simulated),
    ]);
    cells
}

/// Enough of a digest or a hash to compare it by eye.
fn beginning(text: &str) -> String {
    text.chars().take(12).chain(['…']).collect()
}

/// A record's state, to fit into its column.
fn short_state(state: &str) -> &str {
    state.strip_prefix("waits: ").unwrap_or(state)
}

/// The role of a record's state.
pub fn state_role(state: ShownState) -> Role {
    match state {
        ShownState::Kept(RecordState::Verified) | ShownState::Verified(Caveat::NamesUnchecked) => Role::Good,
        ShownState::Kept(RecordState::Tampered) | ShownState::Refused(_) => Role::Bad,
        ShownState::Kept(RecordState::Quarantined | RecordState::Dropped | RecordState::RightEnded) => Role::Warning,
        ShownState::Kept(_) | ShownState::Verified(Caveat::Deleted | Caveat::Unread) => Role::Accent,
    }
}

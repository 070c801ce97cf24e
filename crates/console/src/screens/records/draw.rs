//! The screens Records and Received.

use crate::app::{Feed, Screen, State};
use crate::model::{RecordKind, Timestamp};
use crate::screens::records::state::{Records, Wanted};
use crate::service::reply::RecordView;
use crate::ui::{
    Canvas, Column, Layout, Rect, Role, Sheet, empty, marks::simulated, marks::state_role, table,
    table::with_local_time, words,
};

pub fn columns_of(screen: Screen) -> Vec<Column> {
    // From this width simulated records are marked in full.
    let (owner, wide) = match screen {
        Screen::Received => (Some(Column::text("Owner", 13).named("owner")), 100),
        _ => (None, 70),
    };
    let rest = [
        Column::name("Topic").named("topic"),
        Column::text("Type", 27).named("type"),
        Column::number("Seq", 7).named("seq"),
        Column::number("Size", 8).named("size"),
        Column::text("UTC", 8).named("time"),
        Column::number("Epoch", 5).named("epoch"),
        Column::number("Block", 8).named("block"),
        Column::text("Id", 16).named("id"),
        Column::text("SM3", 13).named("digest"),
        Column::text("Transaction", 13).named("transaction"),
        Column::text("", 3).below(wide),
        Column::text("", 9).from(wide),
    ];
    [Column::text("State", 11).named("state")].into_iter().chain(owner).chain(rest).collect()
}

pub fn draw(canvas: &mut Canvas, area: Rect, state: &State) {
    let screen = state.screen;
    let (title, records, feed) = match screen {
        Screen::Received => ("Received", &state.received, Feed::Received),
        _ => ("Records", &state.records, Feed::Records),
    };
    let nothing = match feed {
        Feed::Received => "Nobody shares with you yet: give others your address (6, then y).",
        _ => "No records yet: watch a topic (2, then w).",
    };
    let slot = state.feeds.slot(feed);
    let rows = records.visible(&state.topics.rows);
    let keys: Vec<String> = rows.iter().map(|row| row.id.clone()).collect();
    let layout = Layout::new(&with_local_time(&columns_of(screen), state), screen, &records.table, area.width);
    let cells = |index: usize| {
        rows.get(index).map_or_else(Vec::new, |row| layout.pick(record_cells(state, row, screen == Screen::Received)))
    };
    let wanted = records.wanted(&state.topics.rows);
    let empty = match &wanted {
        Err(wrong) => wrong.message.as_str(),
        Ok(_) if records.table.filter.text().is_empty() => empty(state, feed, nothing),
        Ok(_) => "No records match the filter.",
    };
    let mut note = wanted.as_ref().map_or_else(|_| "not searched".to_owned(), |wanted| note(records, wanted));
    note.push_str(&layout.note());
    if wanted.is_ok() && (slot.left || slot.told != slot.generation) {
        note.push_str(", reading…");
    }
    let columns = &layout.columns;
    let sheet =
        Sheet { title, note, columns, keys: &keys, cells: &cells, table: &records.table, empty, old: slot.left };
    table::draw(canvas, area, &sheet);
}

fn note(records: &Records, wanted: &Wanted) -> String {
    let order = if records.table.sort == 0 { "newest first" } else { "oldest first" };
    let marked = records.table.marks.len();
    let marked = if marked > 0 { format!("{marked} marked, ") } else { String::new() };
    // The meaning of times comes early: the end of a title is cut.
    let meant = |word: &str, at: Option<Timestamp>| {
        at.map_or_else(String::new, |at| format!("{word} {}, ", records.typed.1.meaning(at)))
    };
    let span = meant("since", wanted.asked.since) + &meant("until", wanted.asked.until);
    let mut note = format!("{marked}{span}{order}, page {}", records.path.len() + 1);
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
        asked.robot.as_ref().map(|robot| format!("of robot {robot}")),
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

fn record_cells(state: &State, row: &RecordView, with_owner: bool) -> Vec<(String, Role)> {
    let topic = match row.kind {
        RecordKind::Data => row.topic.clone(),
        kind => format!("{} ({})", row.topic, kind.word()),
    };
    let mut cells = vec![(row.state.word().trim_start_matches("waits: ").to_owned(), state_role(row.state))];
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

/// Enough to compare by eye.
fn beginning(text: &str) -> String {
    text.chars().take(12).chain(['…']).collect()
}

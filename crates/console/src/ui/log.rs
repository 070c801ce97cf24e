//! The Log screen: notices and audit lines, newest first.

use ratatui::layout::Rect;

use super::bars::notice_level;
use super::canvas::Canvas;
use super::table::{Column, Sheet, draw as draw_table, with_local_time};
use super::theme::Role;
use crate::app::State;
use crate::app::screens::log::{LogLine, Source, level_word};
use crate::service::NoticeLevel;

const COLUMNS: &[Column] =
    &[Column::text("UTC", 8), Column::text("Level", 7), Column::text("From", 11), Column::wide("What")];

/// Draws the screen.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State) {
    let log = &state.log;
    let lines = log.visible();
    let keys: Vec<String> = lines.iter().map(|line| line.key.clone()).collect();
    let least = match log.least {
        NoticeLevel::Info => "all levels",
        NoticeLevel::Warning => "warnings and errors",
        NoticeLevel::Error => "errors",
    };
    let from = log.source.map_or_else(|| "all sources".to_owned(), |source| format!("from {}", source.word()));
    let follows = if log.table.is_bound() { "held (home: newest)" } else { "newest first" };
    let note = format!("{} of {} lines, {least}, {from}, {follows}", lines.len(), log.count());
    let cells = |index: usize| lines.get(index).map_or_else(Vec::new, |line| cells(state, line));
    let sheet = Sheet {
        title: "Log",
        note,
        columns: &with_local_time(COLUMNS, state),
        keys: &keys,
        cells: &cells,
        table: &log.table,
        empty: "Nothing yet.",
        old: false,
    };
    draw_table(canvas, area, &sheet);
}

/// Audit lines also show their number.
fn from(line: &LogLine) -> String {
    match line.source {
        Source::Audit => line.key.clone(),
        source => source.word().to_owned(),
    }
}

fn cells(state: &State, line: &LogLine) -> Vec<(String, Role)> {
    let role = if line.level == NoticeLevel::Info { Role::Dim } else { notice_level(line.level).1 };
    vec![
        (state.clock(line.at), Role::Dim),
        (level_word(line.level).to_owned(), role),
        (from(line), Role::Dim),
        (line.text.clone(), Role::Body),
    ]
}

//! The Log screen.

use crate::app::State;
use crate::model::counted;
use crate::screens::log::state::{LogLine, Source};
use crate::service::NoticeLevel;
use crate::ui::{Canvas, Column, Rect, Role, Sheet, marks::notice_level, table, table::with_local_time, words};

const LOG_COLUMNS: &[Column] =
    &[Column::text("UTC", 8), Column::text("Level", 7), Column::text("From", 11), Column::wide("What")];

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
    let note = format!(
        "{} of {}, {least}, {from}, {follows}",
        words::count(lines.len() as u64),
        counted(log.count() as u64, "line")
    );
    let cells = |index: usize| lines.get(index).map_or_else(Vec::new, |line| log_cells(state, line));
    let (title, empty, columns) = ("Log", "Nothing yet.", &with_local_time(LOG_COLUMNS, state));
    let sheet = Sheet { title, note, columns, keys: &keys, cells: &cells, table: &log.table, empty, old: false };
    table::draw(canvas, area, &sheet);
}

fn log_cells(state: &State, line: &LogLine) -> Vec<(String, Role)> {
    let role = if line.level == NoticeLevel::Info { Role::Dim } else { notice_level(line.level).1 };
    // Audit lines show their number.
    let from = if line.source == Source::Audit { line.key.as_str() } else { line.source.word() };
    vec![
        (state.clock(line.at), Role::Dim),
        (line.level.word().to_owned(), role),
        (from.to_owned(), Role::Dim),
        (line.text.clone(), Role::Body),
    ]
}

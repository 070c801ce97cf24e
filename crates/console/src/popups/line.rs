//! A line of the log in full.

use crate::app::{Key, Popup, State};
use crate::screens::log::state::LogLine;
use crate::service::NoticeLevel;
use crate::ui::{Canvas, Rect, Role, draw_lines, marks::notice_level};

pub fn key(state: &mut State, line: LogLine, key: Key) {
    match key {
        Key::Escape | Key::Enter | Key::Char('q') => return,
        Key::Char('y') => state.copy(line.whole()),
        _ => {}
    }
    state.popups.push(Popup::Line(line));
}

pub fn draw(canvas: &mut Canvas, area: Rect, line: &LogLine) {
    let about = format!("{}  {}  {}", line.at.in_milliseconds(), line.level.word(), line.key);
    let role = if line.level == NoticeLevel::Info { Role::Body } else { notice_level(line.level).1 };
    draw_lines(canvas, area, "Log line", &[(about, Role::Dim), (line.text.clone(), role)], 0);
}

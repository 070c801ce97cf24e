//! Every alert in full.

use crate::app::{Key, Popup, State, scrolled};
use crate::ui::{Canvas, Piece, Rect, Role, draw_lines, marks::notice_level};

pub fn key(state: &mut State, scroll: usize, key: Key) {
    let most = state.alerts.shown().len() * 8;
    let scroll = scrolled(scroll, key, state.page_rows()).filter(|_| key != Key::Enter);
    state.popups.extend(scroll.map(|scroll| Popup::Alerts(scroll.min(most))));
}

pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, scroll: usize) {
    let mut lines: Vec<Piece> = Vec::new();
    for alert in state.alerts.shown() {
        let (mark, role) = notice_level(alert.level);
        let often = if alert.count > 1 { format!(", {} times", alert.count) } else { String::new() };
        let when = match alert.resolved {
            Some(at) => format!("resolved {}, began {}{often}", at.in_milliseconds(), alert.since.in_milliseconds()),
            None => format!("since {}{often}", alert.since.in_milliseconds()),
        };
        lines.push((format!("{mark}{}", alert.text), if alert.resolved.is_some() { Role::Dim } else { role }));
        lines.extend([(when, Role::Dim), Piece::default()]);
    }
    if lines.pop().is_none() {
        lines.push(("no alerts".to_owned(), Role::Dim));
    }
    draw_lines(canvas, area, "Alerts", &lines, scroll);
}

//! Labels with their values, and what stands where there is nothing.

use ratatui::layout::Rect;

use crate::app::{Feed, State};
use crate::ui::canvas::{Canvas, right_of, row, rows};
use crate::ui::theme::Role;

pub const LABEL: u16 = 12;

pub fn draw_fact(canvas: &mut Canvas, area: Rect, label: &str, value: &str, role: Role) {
    canvas.put(Rect { width: LABEL.min(area.width), ..area }, label, Role::Dim);
    canvas.put(right_of(area, LABEL), value, role);
}

/// Label, words, role.
pub type Fact = (&'static str, String, Role);

/// Returns the rows taken.
pub fn draw_facts(canvas: &mut Canvas, area: Rect, facts: &[Fact]) -> u16 {
    for (place, (label, value, role)) in (0u16..).zip(facts) {
        draw_fact(canvas, row(area, place), label, value, *role);
    }
    rows(facts.len())
}

pub fn empty<'a>(state: &'a State, feed: Feed, nothing: &'a str) -> &'a str {
    match &state.feeds.slot(feed).failure {
        Some(failure) => &failure.message,
        None if state.awaits(feed) && state.site.is_none() => "The site is starting…",
        None if state.awaits(feed) && state.feeds.slot(feed).outstanding => "Asking…",
        None => nothing,
    }
}

//! The Gateway screen: says that this site has none, or how it is.

use ratatui::layout::Rect;

use super::canvas::{Canvas, below};
use super::header::level;
use super::theme::Role;
use crate::app::State;
use crate::service::reply::HealthLevel;

/// Draws the screen.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State) {
    canvas.put(area, "Gateway", Role::Title);
    let health = state.site.iter().flat_map(|site| &site.health).find(|part| part.part == "gateway");
    let rest = below(area, 1);
    if let Some(part) = health.filter(|part| part.level != HealthLevel::Absent) {
        let (dot, role, _) = level(part);
        canvas.puts(rest, &[(dot, role), (" ", Role::Body), (&part.text, Role::Body)]);
    } else {
        canvas.put(rest, "Absent: this site has no gateway.", Role::Body);
        canvas.put(below(rest, 1), "Records go from this machine straight to its own vault and chain.", Role::Dim);
    }
}

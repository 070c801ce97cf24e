//! The possible next keys: the rest of every chord that began with the keys pressed.

use ratatui::layout::Rect;

use crate::app::State;
use crate::app::available::available;
use crate::app::key::{Key, chord_label};
use crate::app::keymap::Meaning;
use crate::ui::canvas::{Canvas, right_of, row};
use crate::ui::theme::Role;

/// Columns of the keys.
const KEYS: u16 = 8;

/// Draws it above the bar, where the eyes are.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, pressed: &[Key]) {
    let Meaning::Begins(begun) = state.settings.keymap.meaning(pressed, state.screen) else { return };
    let wanted = u16::try_from(begun.len()).unwrap_or(u16::MAX).saturating_add(2);
    let height = wanted.min(area.height);
    let place = Rect { y: area.bottom() - height, height, ..area };
    let inner = canvas.frame(place, &format!("{} and then", chord_label(pressed)));
    for (line, binding) in (0..inner.height).zip(begun) {
        let area = row(inner, line);
        let reason = available(state, binding.entry.verb).err();
        let (key_role, role) = if reason.is_some() { (Role::Dim, Role::Dim) } else { (Role::Key, Role::Body) };
        let rest = binding.on.get(pressed.len()..).unwrap_or_default();
        canvas.put(Rect { width: KEYS.min(area.width), ..area }, &chord_label(rest), key_role);
        let reason = reason.map(|reason| format!(" ({reason})")).unwrap_or_default();
        canvas.put(right_of(area, KEYS), &format!("{}{reason}", binding.help()), role);
    }
}

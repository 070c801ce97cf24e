//! The keys of a chord that may come next.

use crate::app::{Key, Popup, State, Verb, available::available, chord_label, keymap::Meaning};
use crate::ui::{Canvas, Rect, Role, right_of, row, rows};

pub fn key(state: &mut State, mut pressed: Vec<Key>, key: Key) -> Option<Verb> {
    if key == Key::Escape {
        return None;
    }
    pressed.push(key);
    let meaning = state.settings.keymap.meaning(&pressed, state.screen);
    match meaning {
        Meaning::Does(verb) => return Some(verb),
        Meaning::Begins(_) => state.popups.push(Popup::Chord(pressed)),
        Meaning::Nothing => state.inform(format!("'{}' does nothing here", chord_label(&pressed))),
    }
    None
}

const KEYS: u16 = 8;

/// Above the bar.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, pressed: &[Key]) {
    let Meaning::Begins(begun) = state.settings.keymap.meaning(pressed, state.screen) else { return };
    let height = rows(begun.len()).saturating_add(2).min(area.height);
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

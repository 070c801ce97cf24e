//! Themes, each shown while it is under the cursor.

use strum::IntoEnumIterator as _;

use crate::app::{Effect, Key, Popup, State, moved};
use crate::model::clean;
use crate::popups::state::ThemeChoice;
use crate::ui::{Canvas, Rect, Role, draw_list, framed, name_role, right_of, row, rows};

pub fn choose(state: &mut State) {
    let before = state.theme.clone();
    let selected = state.settings.themes.iter().position(|name| *name == before).unwrap_or(0);
    state.popups.push(Popup::Themes(ThemeChoice { selected, before }));
}

pub fn key(state: &mut State, mut choice: ThemeChoice, key: Key) {
    let themes = &state.settings.themes;
    match key {
        Key::Escape | Key::Char('q') => return state.effects.push(Effect::ShowTheme(choice.before)),
        Key::Enter => {
            let kept = themes.get(choice.selected).cloned().unwrap_or(choice.before);
            return state.inform(format!("theme: {kept}; to make it permanent, set console.theme in config.toml"));
        }
        Key::Char('T') => choice.selected = moved(choice.selected, themes.len(), Key::Down),
        _ => choice.selected = moved(choice.selected, themes.len(), key),
    }
    state.effects.extend(themes.get(choice.selected).cloned().map(Effect::ShowTheme));
    state.popups.push(Popup::Themes(choice));
}

/// With a sample of every role.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, choice: &ThemeChoice) {
    let names = &state.settings.themes;
    let inner = framed(canvas, area, "Theme", 44, rows(names.len().max(Role::iter().count())));
    draw_list(canvas, inner, names, choice.selected, |canvas, line, name, here| {
        canvas.put(line, &clean(name, 20), name_role(here));
    });
    for (line, role) in (0..inner.height).zip(Role::iter()) {
        canvas.put(right_of(row(inner, line), 24), role.word(), role);
    }
}

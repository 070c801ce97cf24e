//! Choosing a theme: each is shown as the cursor reaches it, and Esc restores the old one.

use super::action::Effect;
use super::key::Key;
use super::popup::Popup;
use super::state::State;

/// A theme being chosen.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ThemeChoice {
    /// The selected name.
    pub selected: usize,
    /// The previous theme, which Esc restores.
    pub before: String,
}

/// Opens the choice, on the theme in use.
pub fn choose(state: &mut State) -> Vec<Effect> {
    let before = state.theme.clone();
    let selected = state.settings.themes.iter().position(|name| *name == before).unwrap_or(0);
    state.popups.push(Popup::Themes(ThemeChoice { selected, before }));
    Vec::new()
}

/// A key while a theme is chosen.
pub fn key(state: &mut State, mut choice: ThemeChoice, key: Key) -> Vec<Effect> {
    let last = state.settings.themes.len().saturating_sub(1);
    match key {
        Key::Escape | Key::Char('q') => return vec![Effect::ShowTheme(choice.before)],
        Key::Enter => {
            let kept = state.settings.themes.get(choice.selected).cloned().unwrap_or(choice.before);
            state.inform(format!("theme: {kept}; to make it permanent, set console.theme in config.toml"));
            return Vec::new();
        }
        Key::Up | Key::BackTab | Key::Char('k') => choice.selected = choice.selected.saturating_sub(1),
        Key::Down | Key::Tab | Key::Char('j' | 'T') => choice.selected = (choice.selected + 1).min(last),
        Key::Home => choice.selected = 0,
        Key::End => choice.selected = last,
        _ => {}
    }
    let seen = state.settings.themes.get(choice.selected).cloned().map(Effect::ShowTheme);
    state.popups.push(Popup::Themes(choice));
    seen.into_iter().collect()
}

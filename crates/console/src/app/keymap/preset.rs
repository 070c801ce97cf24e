//! The preset as the text of a `keymap.toml`: the operator copies lines from it.

use std::fmt::Write as _;

use super::{Place, VERBS};
use crate::app::key::Key;

const OPENING: &str = "# Keys of the AuthROS console, as they are without a keymap.toml.
#
# Your own keymap.toml \
(beside config.toml) lists only what differs:
#   on    a key, or a list of up to three keys pressed one after the \
other
#   run   the command, by its name in the palette; \"none\" removes the preset's meaning
#   desc  your own help \
text (optional)
# [everywhere] applies to every screen, [lists] to screens with a list; a screen's own section takes \
precedence.
# Keys: characters as they are, space enter esc tab shift-tab backspace del up down left right pgup pgdn \
home end,
# ^x = Control and x. Terminals send ^h ^i ^j ^m as backspace, tab and enter, so these cannot be bound.
";

/// The preset, in the format of the operator's file.
pub fn text() -> String {
    let mut text = OPENING.to_owned();
    for place in Place::all() {
        let lines: Vec<[String; 3]> = VERBS
            .iter()
            .filter(|entry| Place::of(entry).contains(&place))
            .flat_map(|entry| entry.chords().map(|on| [keys(&on), quoted(entry.name), quoted(entry.help)]))
            .collect();
        if lines.is_empty() {
            continue;
        }
        let width = |column: usize| lines.iter().map(|line| line[column].chars().count()).max().unwrap_or(0);
        let (on_width, run_width) = (width(0), width(1));
        // Writing to a string cannot fail.
        let _ = write!(text, "\n[{}]\nkeys = [\n", place.name());
        for [on, run, desc] in &lines {
            let _ = writeln!(text, "  {{ on = {on:on_width$}, run = {run:run_width$}, desc = {desc} }},");
        }
        text.push_str("]\n");
    }
    text
}

fn keys(on: &[Key]) -> String {
    match on {
        [key] => quoted(&key.label()),
        keys => format!("[{}]", keys.iter().map(|key| quoted(&key.label())).collect::<Vec<_>>().join(", ")),
    }
}

fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::key::chord_label;
    use crate::app::keymap::Keymap;

    #[test]
    fn the_text_read_as_a_file_is_the_preset() {
        let read = Keymap::with_file("keymap.toml", &text()).expect("reads");
        let preset = Keymap::default();
        for screen in crate::app::Screen::ALL {
            let on = |keymap: &Keymap| -> Vec<(String, &'static str)> {
                let lines = keymap.bindings(screen).iter();
                let mut lines: Vec<_> = lines.map(|binding| (chord_label(&binding.on), binding.entry.name)).collect();
                lines.sort();
                lines
            };
            assert_eq!(on(&read), on(&preset));
        }
    }
}

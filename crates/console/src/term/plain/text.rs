//! Screens and popups as lines to be read aloud: no frames, no marks without a word, columns separated by commas. They
//! come from the same drawing as the full screen, so none is forgotten.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use unicode_width::UnicodeWidthStr;

use crate::app::available::available;
use crate::app::form::{Form, Input};
use crate::app::popup::Popup;
use crate::app::state::FRAME_ROWS;
use crate::app::verb::VERBS;
use crate::app::{Screen, State};
use crate::ui::canvas::{Canvas, RULE};
use crate::ui::{self, Theme};

/// Columns that a screen is drawn in before it becomes lines.
pub const COLUMNS: u16 = 120;
/// Rows of it; lists are read in pages of this many, less the frame's.
pub const ROWS: u16 = 46;
/// What stands before the row under the cursor.
const CURSOR: char = '▌';
/// Rows of title and column heads above a list.
const HEAD: usize = 2;

/// The screen in view.
pub fn screen(state: &State, theme: &Theme) -> Vec<String> {
    let area = Rect::new(0, 0, COLUMNS, ROWS - FRAME_ROWS + 2);
    let rows = drawn(area, theme, |canvas| ui::draw_content(canvas, area, state));
    let page = state.page_rows();
    let keys = state.row_keys();
    let here = state.table().map(|table| table.position(&keys));
    let mut lines = vec![format!("{} screen.", state.screen.title())];
    for (index, row) in rows.iter().enumerate() {
        let Some(text) = spoken(row) else { continue };
        let listed = here
            .zip(index.checked_sub(HEAD))
            .filter(|_| state.screen != Screen::Gateway)
            .map(|(here, line)| (here, here - here % page + line));
        lines.push(match listed.filter(|(_, place)| *place < keys.len()) {
            Some((here, place)) if here == place => format!("{}, selected: {text}", place + 1),
            Some((_, place)) => format!("{}: {text}", place + 1),
            // The list of this screen begins lower and is in two parts.
            None if row.starts_with(CURSOR) => format!("selected: {text}"),
            None => text,
        });
    }
    lines
}

/// Whom this console speaks for, and the state of the parts.
pub fn status(state: &State) -> String {
    let health = state.site.as_ref().map(|site| {
        let part = |part: &crate::service::reply::PartHealth| {
            let (_, _, word) = ui::header::level(part);
            format!("{} {word}", part.part)
        };
        site.health.iter().map(part).collect::<Vec<_>>().join(", ")
    });
    let badges =
        [(state.is_frozen(), ", paused"), (state.is_locked(), ", locked"), (state.settings.read_only, ", read-only")];
    let badges: String = badges.into_iter().filter(|(on, _)| *on).map(|(_, word)| word).collect();
    let operator = state.settings.operator.as_ref().map_or_else(String::new, |name| format!(", operator {name}"));
    format!(
        "Profile {}{operator}{badges}: {}.",
        state.settings.profile,
        health.unwrap_or_else(|| "the site is starting".to_owned())
    )
}

/// The popup over the screen, except forms, which ask line by line.
pub fn popup(state: &State, theme: &Theme, popup: &Popup) -> Vec<String> {
    let area = Rect::new(0, 0, COLUMNS, 200);
    let rows = drawn(area, theme, |canvas| ui::popups::draw(canvas, area, state, popup));
    rows.iter().filter_map(|row| spoken(row)).collect()
}

/// The question of the form line in focus.
pub fn question(form: &Form) -> String {
    let Some(line) = form.lines.get(form.focus) else { return String::new() };
    let hint = if line.hint.is_empty() { String::new() } else { format!(" ({})", line.hint) };
    match &line.input {
        Input::Text(field) if field.text().is_empty() => format!("{}{hint}:", line.label),
        Input::Text(field) => format!("{}{hint}, empty line keeps '{}':", line.label, field.shown()),
        Input::Choice { options, chosen } => {
            let words = (1..).zip(options.iter()).map(|(number, word)| format!("{number} {word}"));
            let words: Vec<String> = words.collect();
            format!("{}: {}; empty line keeps {}:", line.label, words.join(", "), chosen + 1)
        }
    }
}

/// The words that can be typed here.
pub fn help(state: &State) -> Vec<String> {
    let mut lines = vec![
        "Type a command and press enter. 'show' reads the screen, 'status' the health of the parts, 'row 3' or 'row \
         /robot1/odom' selects, 'filter odom' narrows the list, 'filter' alone shows everything again, 'quit' leaves."
            .to_owned(),
        format!("Screens: {}.", Screen::ALL.map(|screen| screen.title().to_lowercase()).join(", ")),
    ];
    let hidden = |changes: bool| state.settings.read_only && changes;
    for entry in VERBS.iter().filter(|entry| entry.palette && !hidden(entry.changes)) {
        if matches!(entry.verb, crate::app::Verb::Go(_)) {
            continue;
        }
        let reason =
            available(state, entry.verb).err().map(|reason| format!(" Not now: {reason}.")).unwrap_or_default();
        let end = if entry.help.ends_with(['?', ')']) { "" } else { "." };
        lines.push(format!("{}: {}{end}{reason}", entry.name, entry.help));
    }
    lines
}

fn drawn(area: Rect, theme: &Theme, draw: impl FnOnce(&mut Canvas)) -> Vec<String> {
    let mut buffer = Buffer::empty(area);
    draw(&mut Canvas::new(&mut buffer, theme).with_rules());
    (0..area.height).map(|row| text_of(&buffer, area.width, row)).collect()
}

fn text_of(buffer: &Buffer, width: u16, row: u16) -> String {
    let (mut text, mut column) = (String::new(), 0);
    while column < width {
        let symbol = buffer[(column, row)].symbol();
        text.push_str(symbol);
        column += u16::try_from(symbol.width().max(1)).unwrap_or(1);
    }
    text
}

/// A row as read aloud; `None` if nothing is left of it.
fn spoken(row: &str) -> Option<String> {
    let row = row.replace(RULE, "  ");
    let plain: String = row.chars().map(|character| if is_ornament(character) { ' ' } else { character }).collect();
    // Bars that have sunk to dots say nothing without the others.
    let says = |part: &&str| part.chars().any(|character| character != '.');
    let parts: Vec<&str> = plain.split("  ").map(str::trim).filter(says).collect();
    if parts.is_empty() { None } else { Some(parts.join(", ").replace('✓', "marked")) }
}

/// Frames, bars and dots: their meaning is beside them in words.
fn is_ornament(character: char) -> bool {
    matches!(character, '\u{2500}'..='\u{25ff}' | '•' | '✖' | '›' | '\u{2800}'..='\u{28ff}')
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::tests::Robot;
    use crate::app::{Action, Verb};

    fn theme() -> Theme {
        Theme::named("mono").expect("embedded")
    }

    fn at(screen: Screen) -> Robot {
        let mut robot = Robot::at_work(true);
        robot.act(Action::Resize { columns: COLUMNS, rows: ROWS });
        robot.act(Action::Do(Verb::Go(screen)));
        robot.site_answers(true);
        robot
    }

    #[test]
    fn every_screen_is_read_without_frames_and_marks() {
        for place in Screen::ALL {
            let lines = screen(&at(place).state, &theme());
            assert!(lines.len() > 1, "{place:?}");
            for line in &lines {
                assert!(!line.chars().any(is_ornament) && !line.contains("   "), "{line}");
            }
        }
        let lines = screen(&at(Screen::Topics).state, &theme());
        assert!(lines.iter().any(|line| line.starts_with("1, selected: ")), "{lines:#?}");
    }

    #[test]
    fn each_column_of_a_list_is_a_word_of_its_own() {
        let lines = screen(&at(Screen::Topics).state, &theme());
        let heads = lines.iter().find(|line| line.contains("Topic,")).expect("heads");
        for head in ["Topic", "Watched", "Hz", "kB/s", "Lost t/r", "Age"] {
            assert!(heads.split(", ").any(|part| part == head), "{head}: {heads}");
        }
        assert!(!help(&at(Screen::Topics).state).iter().any(|line| line.contains("?.")));
    }

    #[test]
    fn forms_are_asked_line_by_line() {
        let mut robot = at(Screen::Grants);
        robot.types("g");
        let Some(Popup::Form(_, form)) = robot.state.popups.last() else { panic!("no form") };
        assert!(question(form).starts_with("Address"), "{}", question(form));
        assert!(help(&robot.state).iter().any(|line| line.starts_with("revoke: ")));
    }
}

//! Popups in the middle of the screen; the large ones are in `windows`.

mod frame;
mod windows;

pub(in crate::ui) use windows::{
    Piece, coverage_lines, inside, provenance_lines, put_lines, record_lines as record_facts,
};

use ratatui::layout::{Position, Rect};
use strum::IntoEnumIterator as _;

use self::frame::{draw_list, framed, name_role};
use super::canvas::{Canvas, below, columns, right_of, row, rows};
use super::lists::{self, empty};
use super::table::Layout;
use super::theme::Role;
use super::words::wrap;
use crate::app::available::available;
use crate::app::choosing::{ALWAYS, ColumnChoice, ThemeChoice, choices, offered, wanted};
use crate::app::form::{Form, Input, Line};
use crate::app::keymap::{Binding, Key, Meaning, chord_label};
use crate::app::leaving::Leaving;
use crate::app::palette::whole_words;
use crate::app::popup::{Confirm, Help, Palette, Popup};
use crate::app::update::Feed;
use crate::app::verb::{Entry, VERBS};
use crate::app::{State, granting, opening, when};
use crate::model::clean;
use crate::service::reply::ContactRow;

pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, popup: &Popup) {
    match popup {
        Popup::Palette(palette) => draw_palette(canvas, area, state, palette),
        Popup::Help(help) => draw_help(canvas, area, state, help),
        Popup::Confirm(confirm) => draw_confirm(canvas, area, state, confirm),
        Popup::Form(_, form) => draw_form(canvas, area, form, when::meaning(form, &state.times()).as_deref()),
        Popup::Provenance(lookup) => windows::draw_provenance(canvas, area, lookup),
        Popup::Record(opening) => windows::draw_opened(canvas, area, opening),
        Popup::Chord(pressed) => draw_chord(canvas, area, state, pressed),
        Popup::Themes(choice) => draw_themes(canvas, area, state, choice),
        Popup::Columns(choice) => draw_columns(canvas, area, state, choice),
        Popup::Robot(lookup) => windows::draw_robot(canvas, area, state, lookup),
        Popup::Publishers(lookup) => windows::draw_publishers(canvas, area, state, lookup),
        Popup::Readers(topics) => windows::draw_readers(canvas, area, state, topics),
        Popup::Line(line) => windows::draw_line(canvas, area, line),
        Popup::Unlocked => {
            let lines = ["The keyring is already unlocked: no passphrase is needed.".to_owned()];
            draw_text(canvas, area, "Keyring", &lines, &[("enter", Role::Key), (" close", Role::Body)]);
        }
        Popup::Tasks => windows::draw_tasks(canvas, area, state),
        Popup::Alerts(scroll) => windows::draw_alerts(canvas, area, state, *scroll),
        Popup::Browse(selected) => draw_browse(canvas, area, state, *selected),
        Popup::Contacts(selected) => draw_contacts(canvas, area, state, *selected),
        Popup::Incidents(list) => windows::draw_incidents(canvas, area, state, list),
        Popup::Quit(leaving) => draw_quit(canvas, area, state, *leaving),
    }
}

/// The last line is the answer's.
fn draw_text(canvas: &mut Canvas, area: Rect, title: &str, lines: &[String], answer: &[(&str, Role)]) -> Rect {
    let widest = lines.iter().map(|line| columns(line)).max().unwrap_or(0);
    let width = widest.max(40).min(area.width.saturating_sub(6));
    let lines: Vec<String> = lines.iter().flat_map(|line| wrap(&clean(line, 2_000), width)).collect();
    let inner = framed(canvas, area, title, width, rows(lines.len()).saturating_add(2));
    let last = inner.height.saturating_sub(1);
    for (place, line) in (0..last.saturating_sub(1)).zip(&lines) {
        canvas.put(row(inner, place), line, Role::Body);
    }
    canvas.puts(row(inner, last), answer);
    inner
}

fn draw_confirm(canvas: &mut Canvas, area: Rect, state: &State, confirm: &Confirm) {
    let caution = granting::caution(state, &confirm.errand.command).unwrap_or_default();
    if let Some(typed) = &confirm.typed {
        let wanted = clean(&typed.wanted, 255);
        let mut lines = confirm.lines.clone();
        lines.push(format!("Type {wanted} and press enter to {}; esc cancels.", confirm.yes));
        let shown = typed.field.shown();
        draw_text(canvas, area, &confirm.title, &lines, &[("› ", Role::Key), (&shown, Role::Warning)]);
        return;
    }
    // Above the terms, and marked so that it is visible without colour.
    let caution = if caution.is_empty() { Vec::new() } else { wrap(&format!("◐ {}", clean(&caution, 500)), 60) };
    let lines: Vec<String> = caution.iter().map(|_| String::new()).chain(confirm.lines.iter().cloned()).collect();
    let answer =
        [("y", Role::Key), (" ", Role::Body), (confirm.yes, Role::Warning), ("    any other key cancels", Role::Dim)];
    let inner = draw_text(canvas, area, &confirm.title, &lines, &answer);
    for (place, line) in (0u16..).zip(&caution) {
        canvas.put(row(inner, place), line, Role::Warning);
    }
}

fn draw_quit(canvas: &mut Canvas, area: Rect, state: &State, leaving: Leaving) {
    let hints = leaving.hints(state);
    // Four hints fit 80 columns only with narrow gaps.
    let gap = if hints.len() > 3 { "  " } else { "    " };
    let answer: Vec<(&str, Role)> = hints
        .iter()
        .flat_map(|(key, word)| [(*key, Role::Key), (" ", Role::Body), (*word, Role::Body), (gap, Role::Body)])
        .collect();
    draw_text(canvas, area, "Quit?", &leaving.lines(state), &answer);
}

const TEXT: u16 = 34;

fn draw_browse(canvas: &mut Canvas, area: Rect, state: &State, selected: usize) {
    let choices = choices(state);
    let inner = framed(canvas, area, "Browse", 76, rows(choices.len()));
    draw_list(canvas, inner, &choices, selected, |canvas, line, choice, here| {
        canvas.put(Rect { width: TEXT.min(line.width), ..line }, &clean(&choice.text, 255), name_role(here));
        canvas.put(right_of(line, TEXT + 1), &clean(&choice.note, 255), Role::Dim);
    });
}

const KEYS: u16 = 8;

/// Above the bar.
pub fn draw_chord(canvas: &mut Canvas, area: Rect, state: &State, pressed: &[Key]) {
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

/// With a sample of every role.
fn draw_themes(canvas: &mut Canvas, area: Rect, state: &State, choice: &ThemeChoice) {
    let names = &state.settings.themes;
    let inner = framed(canvas, area, "Theme", 44, rows(names.len().max(Role::iter().count())));
    draw_list(canvas, inner, names, choice.selected, |canvas, line, name, here| {
        canvas.put(line, &clean(name, 20), name_role(here));
    });
    for (line, role) in (0..inner.height).zip(Role::iter()) {
        canvas.put(right_of(row(inner, line), 24), role.word(), role);
    }
}

const NAME: u16 = 17;

fn draw_palette(canvas: &mut Canvas, area: Rect, state: &State, palette: &Palette) {
    let inner = framed(canvas, area, "Commands", 72, 14);
    canvas.puts(inner, &[(": ", Role::Key), (palette.field.text(), Role::Accent)]);
    let before: String = palette.field.text().chars().take(palette.field.cursor()).collect();
    canvas.cursor = Some(Position { x: inner.x + 2 + columns(&before), y: inner.y });
    let matches = palette.matches(state);
    if matches.is_empty() {
        canvas.put(below(inner, 1), "no command matches", Role::Dim);
    }
    draw_list(canvas, below(inner, 1), &matches, palette.selected, |canvas, line, entry, here| {
        let reason = available(state, entry.verb).err();
        let role = if reason.is_some() { Role::Dim } else { Role::Body };
        canvas.put(line, entry.name, if here { Role::Selection } else { role });
        let key = state.settings.keymap.label(entry, state.screen);
        canvas.put(Rect { width: 9, ..right_of(line, NAME) }, &key, Role::Key);
        let text = reason.map_or_else(|| entry.help.to_owned(), |reason| format!("({reason}) {}", entry.help));
        canvas.put(right_of(line, NAME + 10), &text, role);
    });
}

const WIDTH: u16 = 66;
const BOX: u16 = 4;
const COLUMNS_NAME: u16 = 12;

fn draw_columns(canvas: &mut Canvas, area: Rect, state: &State, choice: &ColumnChoice) {
    let Some(table) = state.table() else { return };
    let width = opening::list_width(state);
    let shown = wanted(state.screen, table, width);
    let left_out = Layout::new(&lists::all_columns(state.screen), state.screen, table, width).left_out;
    let offered = offered(state.screen);
    let title = format!("Columns of {}", state.screen.title());
    let inner = framed(canvas, area, &title, WIDTH, rows(offered.len()));
    draw_list(canvas, inner, &offered, choice.selected, |canvas, line, column, here| {
        let (mark, role) = match (shown.contains(&column.name), column.name == ALWAYS) {
            (true, true) => ("[x]", Role::Dim),
            (true, false) => ("[x]", Role::Key),
            (false, _) => ("[ ]", Role::Body),
        };
        canvas.put(line, mark, role);
        let rest = right_of(line, BOX);
        canvas.put(Rect { width: COLUMNS_NAME.min(rest.width), ..rest }, column.name, name_role(here));
        let (words, role) = match left_out.contains(&column.name) {
            true => ("no room for it in this terminal", Role::Warning),
            false => (column.words, Role::Dim),
        };
        canvas.put(right_of(rest, COLUMNS_NAME + 1), words, role);
    });
}

const HELP_KEYS: u16 = 14;
const HELP_WIDTH: u16 = 72;

/// Keys, words, and the role of the words.
type Told = (String, String, Role);

/// Never cuts a sentence.
pub fn draw_help(canvas: &mut Canvas, area: Rect, state: &State, help: &Help) {
    let (title, told) = match &help.window {
        Some(hints) => {
            let told = hints.iter().map(|(keys, words)| ((*keys).to_owned(), (*words).to_owned(), Role::Body));
            ("Keys of this window".to_owned(), told.collect())
        }
        None => (format!("Keys of the {} screen", state.screen.title()), of_screen(state)),
    };
    let width = HELP_WIDTH.min(area.width.saturating_sub(6));
    let wanted = help.filter.text();
    let fits = |(keys, words, _): &&Told| whole_words(wanted, &format!("{keys} {words}"));
    let lines: Vec<Told> = told.iter().filter(fits).flat_map(|told| broken(told, width)).collect();
    let searched = help.filtering || !wanted.is_empty();
    let inner = framed(canvas, area, &title, HELP_WIDTH, rows(lines.len().max(1) + usize::from(searched)));
    let list = Rect { height: inner.height.saturating_sub(u16::from(searched)), ..inner };
    let first = help.scroll.min(lines.len().saturating_sub(usize::from(list.height)));
    for (place, (keys, words, role)) in (0..list.height).zip(lines.iter().skip(first)) {
        let key_role = if *role == Role::Dim { Role::Dim } else { Role::Key };
        canvas.put(Rect { width: HELP_KEYS.min(list.width), ..row(list, place) }, keys, key_role);
        canvas.put(right_of(row(list, place), HELP_KEYS), words, *role);
    }
    let below = lines.len().saturating_sub(first + usize::from(list.height));
    if first > 0 || below > 0 {
        let edge = Rect { y: inner.bottom().min(area.bottom().saturating_sub(1)), height: 1, ..inner };
        canvas.put_right(edge, &format!(" {first} above, {below} below "), Role::Dim);
    }
    if searched {
        canvas.puts(row(inner, inner.height.saturating_sub(1)), &[("/ ", Role::Key), (wanted, Role::Accent)]);
    }
}

/// Verbs of the screen first.
fn of_screen(state: &State) -> Vec<Told> {
    let hidden =
        |entry: &&Entry| state.settings.read_only && entry.changes || !crate::app::tour::knows(state, entry.verb);
    let bound = |entry: &&Entry| state.settings.keymap.of(entry, state.screen).next().is_some() && !hidden(entry);
    let (own, all): (Vec<&Entry>, Vec<&Entry>) = VERBS.iter().filter(bound).partition(|entry| !entry.on.is_empty());
    own.into_iter().chain(all).map(|entry| of_entry(state, entry)).collect()
}

fn of_entry(state: &State, entry: &Entry) -> Told {
    let bindings: Vec<&Binding> = state.settings.keymap.of(entry, state.screen).collect();
    let keys: Vec<String> = bindings.iter().map(|binding| chord_label(&binding.on)).collect();
    let words = bindings.iter().find(|binding| binding.desc.is_some()).map_or(entry.help, |binding| binding.help());
    let reason = available(state, entry.verb).err();
    let role = if reason.is_none() { Role::Body } else { Role::Dim };
    let words = reason.map_or_else(|| words.to_owned(), |reason| format!("{words} ({reason})"));
    (keys.join(", "), words, role)
}

fn broken((keys, words, role): &Told, width: u16) -> Vec<Told> {
    let lines = wrap(words, width.saturating_sub(HELP_KEYS)).into_iter().enumerate();
    lines.map(|(place, line)| (if place == 0 { keys.clone() } else { String::new() }, line, *role)).collect()
}

const LABEL: u16 = 13;
/// Characters of what Tab found.
const MOST_TOLD: usize = 20_000;
/// Rows of notes, fields and frame.
const ROWS: u16 = 12;
const FORM_WIDTH: u16 = 68;

/// `meaning` of the line under the cursor stands below it.
pub fn draw_form(canvas: &mut Canvas, area: Rect, form: &Form, meaning: Option<&str>) {
    let width = FORM_WIDTH.min(area.width.saturating_sub(6));
    let notes: Vec<String> = form.notes.iter().flat_map(|note| wrap(&clean(note, 500), width)).collect();
    let error: Vec<String> = form.error.iter().flat_map(|error| wrap(&clean(error, 500), width)).collect();
    let told: Vec<String> = form.told.iter().flat_map(|line| wrap(&clean(line, MOST_TOLD), width)).collect();
    let told = shortened(told, area.height.saturating_sub(ROWS));
    let needed = notes.len() + form.lines.len() + usize::from(meaning.is_some()) + 2 + error.len() + told.len();
    let inner = framed(canvas, area, &form.title, FORM_WIDTH, rows(needed));
    for (place, note) in (0..).zip(&notes) {
        canvas.put(row(inner, place), note, Role::Dim);
    }
    let mut place = rows(notes.len()) + 1;
    for (index, line) in form.lines.iter().enumerate() {
        draw_line(canvas, row(inner, place), line, index == form.focus);
        place += 1;
        if let Some(meaning) = meaning.filter(|_| index == form.focus) {
            canvas.put(right_of(row(inner, place), LABEL), meaning, Role::Accent);
            place += 1;
        }
    }
    let answers = error.iter().map(|line| (line, Role::Bad)).chain(told.iter().map(|line| (line, Role::Dim)));
    for (place, (line, role)) in (place + 1..).zip(answers) {
        canvas.put(row(inner, place), line, role);
    }
}

/// The last line says how many are missing.
fn shortened(mut lines: Vec<String>, room: u16) -> Vec<String> {
    let room = usize::from(room).max(2);
    let left = lines.len().saturating_sub(room - 1);
    if left > 1 {
        lines.truncate(room - 1);
        lines.push(format!("… {left} more lines"));
    }
    lines
}

fn draw_line(canvas: &mut Canvas, area: Rect, line: &Line, focused: bool) {
    canvas.put(area, if focused { "▌" } else { " " }, Role::Accent);
    canvas.put(right_of(area, 1), line.label, if focused { Role::Title } else { Role::Dim });
    let place = right_of(area, LABEL);
    match &line.input {
        Input::Text(field) => {
            let before: String = field.shown().chars().take(field.cursor()).collect();
            // Scrolls a long text so that the cursor is visible.
            let hidden = usize::from(columns(&before).saturating_sub(place.width.saturating_sub(1)));
            let shown: String = field.shown().chars().skip(hidden).collect();
            let empty = shown.is_empty();
            canvas.put(place, if empty { line.hint } else { &shown }, if empty { Role::Dim } else { Role::Body });
            if focused && place.width > 0 {
                let offset = columns(&before).min(place.width - 1);
                canvas.cursor = Some(Position { x: place.x + offset, y: place.y });
            }
        }
        Input::Choice { options, chosen } => {
            let word = options.get(*chosen).map(String::as_str).unwrap_or_default();
            let hint = if focused { "  space: change" } else { "" };
            canvas.puts(place, &[(word, Role::Body), (hint, Role::Dim)]);
        }
    }
}

const CONTACTS_NAME: u16 = 15;
const ADDRESS: u16 = 43;
const WIDEST: u16 = 124;

fn draw_contacts(canvas: &mut Canvas, area: Rect, state: &State, selected: usize) {
    let width = WIDEST.min(area.width.saturating_sub(6));
    let inner = framed(canvas, area, "Address book", width, rows(state.contacts.len().max(1)).saturating_add(3));
    let Some(chosen) = granting::chosen(state, selected) else {
        let text = empty(state, Feed::Contacts, "Nobody yet: n adds a contact.");
        canvas.put(inner, text, Role::Dim);
        return;
    };
    let list = Rect { height: inner.height.saturating_sub(3).max(1), ..inner };
    draw_list(canvas, list, &state.contacts, selected, draw_contact);
    let keys =
        |fingerprint: &Option<String>| fingerprint.as_deref().map_or_else(|| "none".to_owned(), |text| clean(text, 60));
    let noted = format!("noted       {}", keys(&chosen.fingerprint));
    let given = if chosen.given { "" } else { "  (from the chain, not confirmed by a person)" };
    canvas.puts(row(inner, inner.height.saturating_sub(2)), &[(&noted, Role::Body), (given, Role::Dim)]);
    let registered = format!("registered  {}", keys(&chosen.registered));
    canvas.put(row(inner, inner.height.saturating_sub(1)), &registered, Role::Body);
}

fn draw_contact(canvas: &mut Canvas, line: Rect, contact: &ContactRow, here: bool) {
    let name = Rect { width: CONTACTS_NAME.min(line.width), ..line };
    canvas.put(name, &contact.name.to_string(), name_role(here));
    let rest = right_of(line, CONTACTS_NAME + 1);
    let whole = rest.width > ADDRESS + 10;
    let address = if whole { contact.address.to_string() } else { contact.address.short() };
    canvas.put(rest, &address, Role::Accent);
    let role = match contact.state.as_str() {
        "same" => Role::Good,
        "differs" => Role::Bad,
        _ => Role::Dim,
    };
    canvas.put(right_of(rest, if whole { ADDRESS } else { 15 }), &clean(&contact.state, 20), role);
}

#[cfg(test)]
mod columns_tests {
    use super::*;
    use crate::app::Screen;

    #[test]
    fn every_column_that_is_offered_is_drawn_and_in_the_same_order() {
        for screen in [Screen::Topics, Screen::Records, Screen::Received] {
            let all = lists::all_columns(screen);
            let drawn: Vec<&str> = all.iter().map(|column| column.name).filter(|name| !name.is_empty()).collect();
            let named: Vec<&str> = offered(screen).iter().map(|column| column.name).collect();
            assert_eq!(drawn, named, "{screen:?}");
        }
    }
}

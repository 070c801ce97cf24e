//! Pure `draw(frame, state, theme)`: screens, popups, widgets. Nothing here changes state.
//!
//! ```text
//! AuthROS default   ros ● ok  chain ● ok  store ● ok  gateway ○ absent   FROZEN   header
//! 1 Overview  2 Topics  3 Uploads  4 Shared  5 Grants  6 Keys  7 Chain ...        header
//! Topics  12 of 40, by name, filter: odom                                         table
//!   Topic                 Watched     Hz     kB/s  Lost  Last                     table
//! ▌ /robot1/odom          watched   20.0     14.2   0/0  12:03:22  SIMULATED      one file per screen
//!            ┌ Grant ────────────────────────────┐
//!            │ Address  0x…                      │                                popups
//!            └───────────────────────────────────┘
//! ✖ chain: connection refused                              esc: hide, 2 more      bottom
//! space mark  w watch  / filter  s sort  ? help  q quit                           bottom
//! ```

pub mod bars;
pub mod detail;
pub mod gateway;
mod lists;
pub mod overview;
pub mod plot;
pub mod popups;
pub mod table;
pub mod theme;

use crate::app::tour::Tour;
use crate::app::{Screen, State};
use crate::model::{Timestamp, clean};
use ratatui::Frame;
use ratatui::buffer::Buffer;
use ratatui::layout::{Position, Rect};
use ratatui::style::Style;
use ratatui::widgets::{Block, Clear, Widget};
use theme::Depth;
use unicode_width::UnicodeWidthStr;

pub use self::plot::{BAYER, Placement};
pub use theme::{Role, Theme, ThemeError, Themes};

/// Columns of the smallest supported terminal.
pub const LEAST_COLUMNS: u16 = 60;
/// Rows of the smallest supported terminal.
pub const LEAST_ROWS: u16 = 18;

/// Returns the picture left to the terminal.
pub fn draw(frame: &mut Frame, state: &State, theme: &Theme) -> Option<Placement> {
    let area = frame.area();
    let mut canvas = Canvas::new(frame.buffer_mut(), theme);
    if area.width < LEAST_COLUMNS || area.height < LEAST_ROWS {
        let size = format!("Terminal too small: {}x{}, need {LEAST_COLUMNS}x{LEAST_ROWS}", area.width, area.height);
        canvas.put(area, &size, Role::Warning);
    } else {
        draw_whole(&mut canvas, area, state);
    }
    let (cursor, placement) = (canvas.cursor, canvas.placement());
    if theme.ascii {
        flatten(frame.buffer_mut());
    }
    if let Some(position) = cursor {
        frame.set_cursor_position(position);
    }
    placement
}

fn draw_whole(canvas: &mut Canvas, area: Rect, state: &State) {
    let strip = crate::app::tour::rows(state);
    let content = Rect { y: area.y + 2, height: area.height - 4 - strip, ..area };
    bars::draw(canvas, Rect { height: 2, ..area }, state);
    // Several message lines shorten the list instead of covering the cursor's row.
    let covered = bars::covered(state, area.width).saturating_sub(strip).min(content.height / 2);
    let list = detail::draw(canvas, Rect { height: content.height - covered, ..content }, state);
    match state.screen {
        Screen::Overview => overview::draw(canvas, list, state),
        Screen::Topics => lists::draw_topics(canvas, list, state),
        Screen::Uploads | Screen::Shared => lists::draw_records(canvas, list, state),
        Screen::Grants => lists::draw_grants(canvas, list, state),
        Screen::Keys => lists::draw_keys(canvas, list, state),
        Screen::Chain => lists::draw_chain(canvas, list, state),
        Screen::Gateway => gateway::draw(canvas, list, state),
        Screen::Log => lists::draw_log(canvas, list, state),
    }
    if let Some(popup) = state.popups.last() {
        popups::draw(canvas, content, state, popup);
    }
    if let Some(tour) = &state.tour {
        draw_tour(canvas, Rect { y: content.bottom(), height: strip, ..area }, tour);
    }
    // Several message lines take precedence over the strip.
    bars::draw_bottom(canvas, area, state);
}

pub struct Canvas<'a> {
    buffer: &'a mut Buffer,
    theme: &'a Theme,
    cursor: Option<Position>,
    placement: Option<Placement>,
}

/// Columns of the cleaned text.
pub fn columns(text: &str) -> u16 {
    u16::try_from(clean(text, usize::from(u16::MAX)).width()).unwrap_or(u16::MAX)
}

/// Saturates: more rows than any screen has.
pub fn rows(count: usize) -> u16 {
    u16::try_from(count).unwrap_or(u16::MAX)
}

pub fn below(area: Rect, rows: u16) -> Rect {
    let rows = rows.min(area.height);
    Rect { y: area.y + rows, height: area.height - rows, ..area }
}

/// Empty if `area` has no such row.
pub fn row(area: Rect, number: u16) -> Rect {
    Rect { height: area.height.saturating_sub(number).min(1), ..below(area, number) }
}

pub fn right_of(area: Rect, columns: u16) -> Rect {
    let columns = columns.min(area.width);
    Rect { x: area.x + columns, width: area.width - columns, ..area }
}

impl<'a> Canvas<'a> {
    pub fn new(buffer: &'a mut Buffer, theme: &'a Theme) -> Self {
        Self { buffer, theme, cursor: None, placement: None }
    }

    /// `None` in ASCII.
    pub fn depth(&self) -> Depth {
        if self.theme.ascii { Depth::None } else { self.theme.depth }
    }

    /// Only for pictures.
    pub fn paint(&mut self, place: Rect, character: char, style: Style) {
        if self.buffer.area().contains(Position { x: place.x, y: place.y }) {
            self.buffer[(place.x, place.y)].set_char(character).set_style(style);
        }
    }

    /// The place stays empty for the terminal's picture.
    pub fn place(&mut self, placement: Placement) {
        self.wipe(placement.area);
        self.placement = Some(placement);
    }

    /// `None` if anything was written over its place.
    pub fn placement(&mut self) -> Option<Placement> {
        let buffer = &*self.buffer;
        let free =
            |area: Rect| area.positions().all(|place| buffer.cell(place).is_some_and(|cell| cell.symbol() == " "));
        self.placement.take().filter(|placement| free(placement.area))
    }

    /// First row of `area`, cut at its edge; returns the columns taken.
    pub fn put(&mut self, area: Rect, text: &str, role: Role) -> u16 {
        let area = area.intersection(*self.buffer.area());
        if area.is_empty() || text.is_empty() {
            return 0;
        }
        // A gap that does not fit is not a cut text.
        let text = if text.trim().is_empty() { text.get(..usize::from(area.width)).unwrap_or(text) } else { text };
        let mut shown = clean(text, usize::from(area.width));
        if shown.width() > usize::from(area.width) {
            while shown.width() + 1 > usize::from(area.width) {
                shown.pop();
            }
            shown.push('…');
        }
        let width = usize::from(area.width);
        let (end, _) = self.buffer.set_stringn(area.x, area.y, &shown, width, self.theme.style(role));
        end - area.x
    }

    /// Returns what is left of `area`.
    pub fn puts(&mut self, area: Rect, pieces: &[(&str, Role)]) -> Rect {
        pieces.iter().fold(area, |rest, (text, role)| {
            let taken = self.put(rest, text, *role);
            right_of(rest, taken)
        })
    }

    pub fn put_right(&mut self, area: Rect, text: &str, role: Role) -> u16 {
        let width = columns(text).min(area.width);
        self.put(right_of(area, area.width - width), text, role)
    }

    /// Clears `area`; returns the space inside the frame.
    pub fn frame(&mut self, area: Rect, title: &str) -> Rect {
        Clear.render(area, self.buffer);
        let block = Block::bordered().border_style(self.theme.style(Role::Border));
        let inner = block.inner(area);
        block.render(area, self.buffer);
        let top = Rect { x: area.x + 1, y: area.y, width: area.width.saturating_sub(2), height: 1 };
        self.put(top, &format!(" {title} "), Role::Title);
        Rect { x: inner.x + 1, width: inner.width.saturating_sub(2), ..inner }
    }

    pub fn wipe(&mut self, area: Rect) {
        Clear.render(area.intersection(*self.buffer.area()), self.buffer);
    }
}

pub fn flatten(buffer: &mut Buffer) {
    for cell in &mut buffer.content {
        if !cell.symbol().is_ascii() {
            let plain = cell.symbol().chars().next().map_or(' ', plain);
            cell.set_char(plain);
        }
    }
}

fn plain(character: char) -> char {
    match character {
        '─' => '-',
        '│' => '|',
        '┌' | '┐' | '└' | '┘' => '+',
        '●' | '•' | '✓' => '*',
        '◐' | '…' => '~',
        '○' => 'o',
        '↑' => '^',
        '↓' => 'v',
        '✖' => 'X',
        '▌' | '›' => '>',
        '▁' | '▂' => '_',
        '▃' | '▄' | '▅' => '=',
        '▆' | '▇' | '█' => '#',
        '▀' => '"',
        '\u{2800}' => ' ',
        '\u{2801}'..='\u{28ff}' => dots(character),
        _ => '?',
    }
}

/// By how many of its eight dots are set.
fn dots(pattern: char) -> char {
    match (u32::from(pattern) & 0xff).count_ones() {
        1 | 2 => '.',
        3..=5 => ':',
        _ => '#',
    }
}

/// `12,345`.
pub fn count(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::with_capacity(digits.len() + digits.len() / 3);
    for (index, digit) in digits.char_indices() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// `20.0`, or `-`.
pub fn rate(rate: Option<f64>) -> String {
    rate.map_or_else(|| "-".to_owned(), |rate| format!("{rate:.1}"))
}

/// kB/s, or `-`.
pub fn kilobytes(bytes: Option<f64>) -> String {
    rate(bytes.map(|bytes| bytes / 1000.0))
}

/// `712 B`, `58.2 kB`, `1.3 MB`.
pub fn size(bytes: u64) -> String {
    let tenths = |unit: u64| format!("{}.{}", bytes / unit, bytes % unit * 10 / unit);
    match bytes {
        0..1_000 => format!("{bytes} B"),
        1_000..1_000_000 => format!("{} kB", tenths(1_000)),
        _ => format!("{} MB", tenths(1_000_000)),
    }
}

/// `once`, `3 times`.
pub fn times(number: u64) -> String {
    if number == 1 { "once".to_owned() } else { format!("{} times", count(number)) }
}

/// `2026-11-22T03:43:21Z`.
pub fn second(at: Timestamp) -> String {
    Timestamp::from_seconds(at.seconds()).to_string()
}

/// `4 s`, `12 min`, `3 h`, `9 d`.
pub fn age(then: Timestamp, now: Timestamp) -> String {
    let seconds = now.0.saturating_sub(then.0) / 1_000_000_000;
    match seconds {
        0..60 => format!("{seconds} s"),
        60..3_600 => format!("{} min", seconds / 60),
        3_600..86_400 => format!("{} h", seconds / 3_600),
        _ => format!("{} d", seconds / 86_400),
    }
}

/// `0.42 s`, `12 s`, `3.1 min`.
pub fn seconds(seconds: f64) -> String {
    match seconds {
        under if under < 10.0 => format!("{under:.2} s"),
        under if under < 120.0 => format!("{under:.0} s"),
        long => format!("{:.1} min", long / 60.0),
    }
}

/// Wraps at spaces if there are any.
pub fn wrap(text: &str, width: u16) -> Vec<String> {
    let width = usize::from(width.max(1));
    let indent = text.len() - text.trim_start_matches(' ').len();
    if indent > 0 && indent < width {
        let lines = wrap(&text[indent..], u16::try_from(width - indent).unwrap_or(1));
        return lines.into_iter().map(|line| format!("{}{line}", " ".repeat(indent))).collect();
    }
    let mut lines = vec![String::new()];
    for word in text.split(' ') {
        let last = lines.last().map_or(0, |line| line.width());
        if last > 0 && last + 1 + word.width() > width {
            lines.push(String::new());
        } else if last > 0 {
            append_word(&mut lines, " ", width);
        }
        append_word(&mut lines, word, width);
    }
    lines
}

fn append_word(lines: &mut Vec<String>, word: &str, width: usize) {
    for character in word.chars() {
        let full = lines.last().is_none_or(|line| line.width() + 1 > width);
        if full {
            lines.push(String::new());
        }
        if let Some(line) = lines.last_mut() {
            line.push(character);
        }
    }
}

pub fn draw_tour(canvas: &mut Canvas, area: Rect, tour: &Tour) {
    let Some([name, act, why]) = tour.lines() else { return };
    let (place, of) = tour.count();
    for line in 0..area.height {
        canvas.wipe(row(area, line));
    }
    canvas.put(row(area, 0), &"─".repeat(usize::from(area.width)), Role::Border);
    let head = format!("Tour {place} of {of}  ");
    canvas.puts(row(area, 1), &[(&head, Role::Title), (&name, Role::Accent)]);
    canvas.put_right(row(area, 1), "E ends the tour", Role::Dim);
    canvas.puts(row(area, 2), &[("do   ", Role::Key), (&act, Role::Body)]);
    canvas.puts(row(area, 3), &[("why  ", Role::Dim), (&why, Role::Dim)]);
}

#[cfg(test)]
mod canvas_tests {
    use super::*;
    use proptest::prelude::*;

    fn written(text: &str, width: u16) -> Buffer {
        let theme = Theme::named("night").expect("embedded");
        let mut buffer = Buffer::empty(Rect::new(0, 0, 40, 2));
        Canvas::new(&mut buffer, &theme).put(Rect::new(3, 0, width, 1), text, Role::Body);
        buffer
    }

    fn shown(buffer: &Buffer) -> String {
        buffer.content().iter().map(ratatui::buffer::Cell::symbol).collect()
    }

    #[test]
    fn a_cut_is_marked() {
        assert!(shown(&written("/robot1/camera/compressed", 10)).contains("/robot1/c…"));
        assert!(shown(&written("机器人机器人", 6)).contains('…'));
    }

    proptest! {
        #[test]
        fn no_hostile_text_reaches_a_cell_outside_its_place(text in any::<String>(), width in 1u16..60) {
            let buffer = written(&text, width);
            for (index, cell) in buffer.content().iter().enumerate() {
                let (x, y) = buffer.pos_of(index);
                let inside = y == 0 && x >= 3 && x < 3 + width;
                prop_assert!(inside || cell.symbol() == " ", "{x} {y} {:?}", cell.symbol());
                let harmless = |c: char| !c.is_control() && !matches!(c, '\u{200b}'..='\u{200f}' | '\u{202a}'..='\u{202e}'
                    | '\u{2066}'..='\u{2069}' | '\u{feff}');
                prop_assert!(cell.symbol().chars().all(harmless), "{:?}", cell.symbol());
            }
        }
    }
}

#[cfg(test)]
mod words_tests {
    use super::*;

    #[test]
    fn numbers() {
        assert_eq!([count(0), count(999), count(1_000), count(1_234_567)], ["0", "999", "1,000", "1,234,567"]);
        assert_eq!([size(712), size(58_234), size(1_300_000)], ["712 B", "58.2 kB", "1.3 MB"]);
        assert_eq!(rate(None), "-");
        let at = Timestamp::from_seconds;
        assert_eq!([age(at(96), at(100)), age(at(0), at(7_200)), age(at(9), at(1))], ["4 s", "2 h", "0 s"]);
        assert_eq!([seconds(0.416), seconds(12.3), seconds(186.0)], ["0.42 s", "12 s", "3.1 min"]);
    }

    #[test]
    fn lines_break_at_spaces_and_long_words_anywhere() {
        assert_eq!(wrap("what was read cannot be taken back", 12), ["what was", "read cannot", "be taken", "back"]);
        assert_eq!(wrap("0123456789", 4), ["0123", "4567", "89"]);
        assert_eq!(wrap("", 4), [""]);
        assert_eq!(wrap("  nobody but you", 9), ["  nobody", "  but you"]);
    }
}

#[cfg(test)]
mod tests;

//! The cells that screens write to, the only way to them; places on the screen; what ASCII shows instead.

use ratatui::buffer::Buffer;
use ratatui::layout::{Position, Rect};
use ratatui::style::Style;
use ratatui::widgets::{Block, Clear, Widget};
use unicode_width::UnicodeWidthStr;

use super::theme::{Depth, Role, Theme};
use super::words::wrap;
use crate::model::clean;
use crate::ros::readable::Raster;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Placement {
    /// All of them empty.
    pub area: Rect,
    pub raster: Raster,
}

pub struct Canvas<'a> {
    pub(super) buffer: &'a mut Buffer,
    pub(super) theme: &'a Theme,
    pub cursor: Option<Position>,
    pub(super) placement: Option<Placement>,
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

    /// In as many rows as it takes, so that what to do is not cut; returns the rows taken.
    pub fn put_wrapped(&mut self, area: Rect, text: &str, role: Role) -> u16 {
        let lines = wrap(&clean(text, 1_000), area.width);
        for (place, line) in (0..area.height).zip(&lines) {
            self.put(row(area, place), line, role);
        }
        rows(lines.len()).min(area.height)
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
        '█' => '#',
        '▀' => '"',
        '\u{2800}' => ' ',
        '\u{2801}'..='\u{28ff}' => dots(character),
        _ => '?',
    }
}

/// By where its dots are, and how many of the eight.
fn dots(pattern: char) -> char {
    const UPPER: u32 = 0x1b;
    let set = u32::from(pattern) & 0xff;
    match (set & UPPER, set & !UPPER) {
        _ if set.count_ones() > 5 => '#',
        (_, 0) => '\'',
        (0, _) => '.',
        _ => ':',
    }
}

#[cfg(test)]
mod tests {
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

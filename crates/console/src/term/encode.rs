//! Ratatui's backend: cells in as few bytes as the change needs, in the terminal's colours, kept in memory.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::io;

pub use crate::ui::theme::Depth;
use crate::ui::theme::{Rgb, SIXTEEN as BASIC, distance};
use ratatui::backend::{Backend, ClearType, WindowSize};
use ratatui::buffer::Cell;
use ratatui::layout::{Position, Rect, Size};
use ratatui::style::{Color, Modifier};
use unicode_width::UnicodeWidthStr;

/// Synchronised update: the terminal shows the frame as a whole.
pub const BEGIN_FRAME: &str = "\x1b[?2026h";
pub const END_FRAME: &str = "\x1b[?2026l";

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Look {
    foreground: Option<Sent>,
    background: Option<Sent>,
    modifier: Modifier,
}

/// Longest gap that is rewritten: skipping it takes as many bytes.
const SHORT_GAP: u16 = 3;

#[derive(Debug)]
pub struct Encoder {
    depth: Depth,
    shown: Vec<Vec<Option<(char, Look)>>>,
    look: Look,
    pen: Option<Position>,
    cursor: Option<Position>,
    out: String,
}

impl Encoder {
    /// For a terminal without style, its cursor hidden.
    pub fn new(depth: Depth) -> Self {
        Self { depth, shown: Vec::new(), look: Look::default(), pen: None, cursor: None, out: String::new() }
    }

    pub fn cell(&mut self, x: u16, y: u16, cell: &Cell) {
        self.begin();
        if !self.bridge(x, y) {
            self.move_to(Position { x, y });
        }
        let look =
            Look { foreground: self.depth.map(cell.fg), background: self.depth.map(cell.bg), modifier: cell.modifier };
        self.set_look(look);
        self.out.push_str(cell.symbol());
        self.remember(x, y, cell.symbol(), look);
        // Terminals disagree on the width of characters that are not one column wide.
        let narrow = cell.symbol().width() == 1;
        self.pen = narrow.then_some(Position { x: x + 1, y });
    }

    pub fn clear(&mut self) {
        self.begin();
        self.set_look(Look::default());
        self.out.push_str("\x1b[2J");
        self.shown.clear();
        self.pen = None;
    }

    /// A picture covers these cells.
    pub fn cover(&mut self, area: Rect) {
        for place in area.positions() {
            let row = self.shown.get_mut(usize::from(place.y));
            if let Some(cell) = row.and_then(|row| row.get_mut(usize::from(place.x))) {
                *cell = None;
            }
        }
    }

    /// Writes nothing if the cursor is there already.
    pub fn cursor(&mut self, wanted: Option<Position>) {
        match wanted {
            Some(position) if self.cursor != wanted || !self.out.is_empty() => {
                self.begin();
                self.move_to(position);
                if self.cursor.is_none() {
                    self.out.push_str("\x1b[?25h");
                }
            }
            None if self.cursor.is_some() => {
                self.begin();
                self.out.push_str("\x1b[?25l");
            }
            _ => {}
        }
        self.cursor = wanted;
    }

    /// Empty if nothing changed.
    pub fn take_frame(&mut self) -> String {
        if !self.out.is_empty() {
            self.set_look(Look::default());
            self.out.push_str(END_FRAME);
        }
        std::mem::take(&mut self.out)
    }

    /// Other programs used the terminal.
    pub fn forget(&mut self) {
        *self = Self::new(self.depth);
    }

    fn known(&self, x: u16, y: u16) -> Option<(char, Look)> {
        *self.shown.get(usize::from(y))?.get(usize::from(x))?
    }

    /// Only characters certainly one column wide are rewritten.
    fn remember(&mut self, x: u16, y: u16, symbol: &str, look: Look) {
        let (x, y) = (usize::from(x), usize::from(y));
        if self.shown.len() <= y {
            self.shown.resize_with(y + 1, Vec::new);
        }
        let Some(row) = self.shown.get_mut(y) else { return };
        if row.len() <= x {
            row.resize(x + 1, None);
        }
        if let Some(cell) = row.get_mut(x) {
            *cell = match symbol.as_bytes() {
                [plain @ b' '..=b'~'] => Some((char::from(*plain), look)),
                _ => None,
            };
        }
    }

    /// Rewrites the cells in between, if all are plain, known and in the pen's style.
    fn bridge(&mut self, x: u16, y: u16) -> bool {
        let Some(pen) = self.pen.filter(|pen| pen.y == y && pen.x < x && x - pen.x <= SHORT_GAP) else { return false };
        let between = (pen.x..x).map(|column| self.known(column, y).filter(|(_, look)| *look == self.look));
        let Some(text) = between.map(|cell| cell.map(|(character, _)| character)).collect::<Option<String>>() else {
            return false;
        };
        self.out.push_str(&text);
        self.pen = Some(Position { x, y });
        true
    }

    fn begin(&mut self) {
        if self.out.is_empty() {
            self.out.push_str(BEGIN_FRAME);
        }
    }

    fn move_to(&mut self, to: Position) {
        if self.pen == Some(to) {
            return;
        }
        let (row, column) = (to.y + 1, to.x + 1);
        let sequence = match self.pen {
            Some(pen) if pen.y == to.y && pen.x + 1 == to.x => "\x1b[C".to_owned(),
            Some(pen) if pen.y == to.y && pen.x < to.x => format!("\x1b[{}C", to.x - pen.x),
            _ if column == 1 => format!("\x1b[{row}H"),
            _ => format!("\x1b[{row};{column}H"),
        };
        self.out.push_str(&sequence);
        self.pen = Some(to);
    }

    fn set_look(&mut self, look: Look) {
        if self.look == look {
            return;
        }
        self.look = look;
        if look == Look::default() {
            return self.out.push_str("\x1b[m");
        }
        self.out.push_str("\x1b[0");
        let modifiers =
            [(Modifier::BOLD, ";1"), (Modifier::DIM, ";2"), (Modifier::UNDERLINED, ";4"), (Modifier::REVERSED, ";7")];
        for (_, code) in modifiers.into_iter().filter(|(modifier, _)| look.modifier.contains(*modifier)) {
            self.out.push_str(code);
        }
        self.colour(look.foreground, 30);
        self.colour(look.background, 40);
        self.out.push('m');
    }

    fn colour(&mut self, colour: Option<Sent>, base: u8) {
        let code = match colour {
            Some(Sent::Rgb(red, green, blue)) => format!(";{};2;{red};{green};{blue}", base + 8),
            Some(Sent::Indexed(index)) => format!(";{};5;{index}", base + 8),
            Some(Sent::Basic(index)) if index < 8 => format!(";{}", base + index),
            Some(Sent::Basic(index)) => format!(";{}", base + 52 + index),
            None => return,
        };
        self.out.push_str(&code);
    }
}

impl Depth {
    /// `NO_COLOR`, `COLORTERM`, `TERM`.
    pub fn from_environment(variable: impl Fn(&str) -> Option<String>) -> Self {
        let is = |name: &str| variable(name).filter(|value| !value.is_empty());
        let term = is("TERM").unwrap_or_default();
        if is("NO_COLOR").is_some() || term.is_empty() || term == "dumb" || term.starts_with("vt") {
            return Self::None;
        }
        let colour = is("COLORTERM").unwrap_or_default();
        if colour == "truecolor" || colour == "24bit" || term.ends_with("-direct") {
            return Self::True;
        }
        if term.contains("256color") { Self::Indexed } else { Self::Sixteen }
    }

    /// `None` = the terminal's own.
    pub fn map(self, colour: Color) -> Option<Sent> {
        let Color::Rgb(red, green, blue) = colour else { return None };
        match self {
            Self::True => Some(Sent::Rgb(red, green, blue)),
            Self::Indexed => Some(Sent::Indexed(indexed((red, green, blue)))),
            Self::Sixteen => Some(Sent::Basic(basic((red, green, blue)))),
            Self::None => None,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sent {
    /// `38;2;r;g;b`.
    Rgb(u8, u8, u8),
    /// `38;5;n`.
    Indexed(u8),
    /// `30` to `37`, `90` to `97`.
    Basic(u8),
}

const CUBE: [u8; 6] = [0, 95, 135, 175, 215, 255];

fn basic(colour: Rgb) -> u8 {
    let nearest = (0u8..16).min_by_key(|index| distance(colour, BASIC[usize::from(*index)]));
    nearest.unwrap_or(7)
}

/// Nearest of the 6x6x6 cube and the 24 greys.
fn indexed(colour: Rgb) -> u8 {
    let cube = (0u8..216).map(|place| {
        let part = |step: u8| CUBE[usize::from(place / step % 6)];
        (16 + place, (part(36), part(6), part(1)))
    });
    let greys = (0u8..24).map(|step| (232 + step, (8 + step * 10, 8 + step * 10, 8 + step * 10)));
    cube.chain(greys).min_by_key(|(_, other)| distance(colour, *other)).map_or(7, |(index, _)| index)
}

/// Keeps only the bytes of the frame.
#[derive(Debug)]
pub struct FrameBackend {
    pub encoder: Encoder,
    size: Size,
    shown: bool,
    position: Position,
    /// Changed cells that did not fit into a limited frame, by row and column.
    pub waiting: BTreeMap<(u16, u16), Cell>,
    /// Bytes of a frame, not counting the rest of whole rows; `None` = no limit, and waiting rows keep waiting: a key is
    /// answered with only what is new.
    pub most: Option<usize>,
}

impl FrameBackend {
    pub fn new(depth: Depth, size: Size) -> Self {
        Self {
            encoder: Encoder::new(depth),
            size,
            shown: false,
            position: Position::ORIGIN,
            waiting: BTreeMap::new(),
            most: None,
        }
    }

    pub fn resize(&mut self, size: Size) {
        self.waiting.clear();
        self.size = size;
    }

    pub fn take_frame(&mut self) -> String {
        self.encoder.cursor(self.shown.then_some(self.position));
        self.encoder.take_frame()
    }

    pub fn forget(&mut self) {
        self.waiting.clear();
        self.encoder.forget();
    }
}

impl Backend for FrameBackend {
    type Error = Infallible;

    fn draw<'a, I: Iterator<Item = (u16, u16, &'a Cell)>>(&mut self, content: I) -> Result<(), Infallible> {
        let Some(most) = self.most else {
            for (x, y, cell) in content {
                self.waiting.remove(&(y, x));
                self.encoder.cell(x, y, cell);
            }
            return Ok(());
        };
        self.waiting.extend(content.map(|(x, y, cell)| ((y, x), cell.clone())));
        while let Some(row) = self.waiting.first_key_value().map(|((y, _), _)| *y) {
            if self.encoder.out.len() >= most {
                break;
            }
            let rest = self.waiting.split_off(&(row + 1, 0));
            for ((y, x), cell) in std::mem::replace(&mut self.waiting, rest) {
                self.encoder.cell(x, y, &cell);
            }
        }
        Ok(())
    }

    fn hide_cursor(&mut self) -> Result<(), Infallible> {
        self.shown = false;
        Ok(())
    }

    fn show_cursor(&mut self) -> Result<(), Infallible> {
        self.shown = true;
        Ok(())
    }

    fn get_cursor_position(&mut self) -> Result<Position, Infallible> {
        Ok(self.position)
    }

    fn set_cursor_position<P: Into<Position>>(&mut self, position: P) -> Result<(), Infallible> {
        self.position = position.into();
        Ok(())
    }

    fn clear(&mut self) -> Result<(), Infallible> {
        self.waiting.clear();
        self.encoder.clear();
        Ok(())
    }

    fn clear_region(&mut self, _region: ClearType) -> Result<(), Infallible> {
        self.clear()
    }

    fn size(&self) -> Result<Size, Infallible> {
        Ok(self.size)
    }

    fn window_size(&mut self) -> Result<WindowSize, Infallible> {
        Ok(WindowSize { columns_rows: self.size, pixels: Size::ZERO })
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// Size of a terminal that reports none.
const USUAL: (u16, u16) = (80, 24);
const LARGEST: u16 = 1000;

pub const ADVICE: &str = "the terminal reports no size: stty rows 24 cols 80";

/// Columns and rows, and whether the terminal reports them.
pub fn size() -> io::Result<((u16, u16), bool)> {
    let reported = crossterm::terminal::size()?;
    let known = known(reported, |name| std::env::var(name).ok());
    Ok((known, known == reported))
}

/// Falls back to the environment, then to the usual size.
pub fn known(reported: (u16, u16), variable: impl Fn(&str) -> Option<String>) -> (u16, u16) {
    if reported.0 > 0 && reported.1 > 0 {
        return reported;
    }
    let said = |name: &str| {
        let number = variable(name).and_then(|text| text.trim().parse::<u16>().ok());
        number.filter(|number| (1..=LARGEST).contains(number))
    };
    said("COLUMNS").zip(said("LINES")).unwrap_or(USUAL)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ratatui::style::{Color, Style};

    fn cell(symbol: &'static str, style: Style) -> Cell {
        let mut cell = Cell::new(symbol);
        cell.set_style(style);
        cell
    }

    #[test]
    fn nothing_changed_is_no_byte() {
        let mut encoder = Encoder::new(Depth::True);
        encoder.cursor(None);
        assert_eq!(encoder.take_frame(), "");
        encoder.cursor(Some(Position { x: 3, y: 2 }));
        assert_eq!(encoder.take_frame(), "\x1b[?2026h\x1b[3;4H\x1b[?25h\x1b[?2026l");
        encoder.cursor(Some(Position { x: 3, y: 2 }));
        assert_eq!(encoder.take_frame(), "");
    }

    #[test]
    fn neighbours_share_move_and_style() {
        let mut encoder = Encoder::new(Depth::Indexed);
        let bold = Style::default().bold().fg(Color::Rgb(255, 0, 0));
        encoder.cell(0, 0, &cell("a", bold));
        encoder.cell(1, 0, &cell("b", bold));
        encoder.cell(5, 0, &cell("c", Style::default()));
        encoder.cell(7, 3, &cell("d", Style::default()));
        assert_eq!(encoder.take_frame(), "\x1b[?2026h\x1b[1H\x1b[0;1;38;5;196mab\x1b[3C\x1b[mc\x1b[4;8Hd\x1b[?2026l");
    }

    #[test]
    fn a_short_gap_of_known_cells_is_written_again() {
        let mut encoder = Encoder::new(Depth::True);
        for (x, letter) in (0u16..).zip(["a", "b", "c", "d", "e", "f", "g"]) {
            encoder.cell(x, 0, &cell(letter, Style::default()));
        }
        encoder.take_frame();
        encoder.cell(0, 0, &cell("A", Style::default()));
        encoder.cell(2, 0, &cell("C", Style::default()));
        encoder.cell(6, 0, &cell("G", Style::default()));
        assert_eq!(encoder.take_frame(), "\x1b[?2026h\x1b[1HAbCdefG\x1b[?2026l");
        encoder.cell(0, 0, &cell("x", Style::default().bold()));
        encoder.cell(2, 0, &cell("y", Style::default().bold()));
        assert_eq!(encoder.take_frame(), "\x1b[?2026h\x1b[1H\x1b[0;1mx\x1b[Cy\x1b[m\x1b[?2026l");
    }

    #[test]
    fn what_is_covered_is_not_written_again() {
        let mut encoder = Encoder::new(Depth::None);
        for x in 0..4 {
            encoder.cell(x, 0, &cell(" ", Style::default()));
        }
        encoder.take_frame();
        encoder.cover(Rect::new(1, 0, 2, 3));
        encoder.cell(0, 0, &cell("A", Style::default()));
        encoder.cell(3, 0, &cell("B", Style::default()));
        assert_eq!(encoder.take_frame(), "\x1b[?2026h\x1b[1HA\x1b[2CB\x1b[?2026l");
    }

    #[test]
    fn sixteen_colours_and_none() {
        let style = Style::default().fg(Color::Rgb(255, 255, 255)).bg(Color::Rgb(0, 0, 0)).reversed();
        let mut encoder = Encoder::new(Depth::Sixteen);
        encoder.cell(0, 0, &cell("a", style));
        assert!(encoder.take_frame().contains("\x1b[0;7;97;40ma\x1b[m"));
        let mut encoder = Encoder::new(Depth::None);
        encoder.cell(0, 0, &cell("a", style));
        assert!(encoder.take_frame().contains("\x1b[0;7ma"));
    }

    #[test]
    fn after_a_wide_character_the_place_is_said_anew() {
        let mut encoder = Encoder::new(Depth::None);
        encoder.cell(0, 0, &cell("机", Style::default()));
        encoder.cell(2, 0, &cell("x", Style::default()));
        assert!(encoder.take_frame().contains("机\x1b[1;3Hx"));
    }
}

#[cfg(test)]
mod colour_tests {
    use super::*;

    fn depth(pairs: &[(&str, &str)]) -> Depth {
        Depth::from_environment(|name| {
            pairs.iter().find(|(known, _)| *known == name).map(|(_, value)| (*value).to_owned())
        })
    }

    #[test]
    fn the_environment_says_how_many_colours() {
        assert_eq!(depth(&[("TERM", "xterm-256color"), ("COLORTERM", "truecolor")]), Depth::True);
        assert_eq!(depth(&[("TERM", "screen-256color")]), Depth::Indexed);
        assert_eq!(depth(&[("TERM", "linux")]), Depth::Sixteen);
        assert_eq!(depth(&[("TERM", "dumb")]), Depth::None);
        assert_eq!(depth(&[]), Depth::None);
        assert_eq!(depth(&[("TERM", "xterm-256color"), ("NO_COLOR", "1")]), Depth::None);
        assert_eq!(depth(&[("TERM", "xterm-256color"), ("NO_COLOR", "")]), Depth::Indexed);
    }

    #[test]
    fn a_colour_is_the_nearest_the_terminal_has() {
        let orange = Color::Rgb(255, 135, 0);
        assert_eq!(Depth::True.map(orange), Some(Sent::Rgb(255, 135, 0)));
        assert_eq!(Depth::Indexed.map(orange), Some(Sent::Indexed(208)));
        assert_eq!(Depth::Indexed.map(Color::Rgb(8, 8, 8)), Some(Sent::Indexed(232)));
        assert_eq!(Depth::Sixteen.map(Color::Rgb(255, 255, 255)), Some(Sent::Basic(15)));
        assert_eq!(Depth::Sixteen.map(Color::Rgb(20, 20, 10)), Some(Sent::Basic(0)));
        assert_eq!(Depth::None.map(orange), None);
        assert_eq!(Depth::True.map(Color::Reset), None);
    }
}

#[cfg(test)]
mod size_tests {
    use super::*;

    #[test]
    fn no_size_is_not_a_small_one() {
        let of = |reported, columns: &'static str, lines: &'static str| {
            known(reported, |name| Some(if name == "LINES" { lines } else { columns }.to_owned()))
        };
        assert_eq!(known((0, 0), |_| None), USUAL);
        assert_eq!(of((0, 0), "100", "30"), (100, 30));
        assert_eq!(of((0, 24), "100", "30"), (100, 30), "half a size is none");
        assert_eq!(of((7, 3), "100", "30"), (7, 3), "a small one is reported");
        for (columns, lines) in
            [("0", "30"), ("100", ""), ("wide", "30"), ("65536", "30"), ("1001", "30"), ("-1", "-1")]
        {
            assert_eq!(of((0, 0), columns, lines), USUAL, "{columns} {lines}");
        }
    }
}

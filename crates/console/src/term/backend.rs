//! Ratatui's backend over the encoder: frames end as bytes in memory, never on the tty.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::io;

use ratatui::backend::{Backend, ClearType, WindowSize};
use ratatui::buffer::Cell;
use ratatui::layout::{Position, Rect, Size};

use super::encode::{Depth, Encoder};

/// A terminal in memory that keeps only the bytes of the frame.
#[derive(Debug)]
pub struct FrameBackend {
    encoder: Encoder,
    size: Size,
    shown: bool,
    position: Position,
    /// Changed cells that did not fit into a small frame, by row and column.
    waiting: BTreeMap<(u16, u16), Cell>,
    /// The most bytes of a frame, not counting whole rows that exceed it.
    most: Option<usize>,
}

impl FrameBackend {
    /// Of that size and colour depth.
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

    /// The terminal has a new size; the next frame is drawn completely.
    pub fn resize(&mut self, size: Size) {
        self.waiting.clear();
        self.size = size;
    }

    /// The bytes of the last frame; empty if it equals the previous one.
    pub fn take_frame(&mut self) -> String {
        self.encoder.cursor(self.shown.then_some(self.position));
        self.encoder.take_frame()
    }

    /// Limits frames from now on to this many bytes, plus the rest of whole rows; the other rows wait. `None` = no
    /// limit, and what waits keeps waiting for a frame that has one: a key is answered with only what is new.
    pub fn limit(&mut self, most: Option<usize>) {
        self.most = most;
    }

    /// Whether rows wait for the next frame.
    pub fn waits(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// The cells in `area` were covered by a picture.
    pub fn cover(&mut self, area: Rect) {
        self.encoder.cover(area);
    }

    /// The terminal was used by other programs.
    pub fn forget(&mut self) {
        self.waiting.clear();
        self.encoder.forget();
    }
}

impl Backend for FrameBackend {
    type Error = Infallible;

    fn draw<'a, I: Iterator<Item = (u16, u16, &'a Cell)>>(&mut self, content: I) -> Result<(), Infallible> {
        if self.most.is_none() && self.waiting.is_empty() {
            for (x, y, cell) in content {
                self.encoder.cell(x, y, cell);
            }
            return Ok(());
        }
        let new = content.map(|(x, y, cell)| ((y, x), cell.clone()));
        let Some(most) = self.most else {
            for ((y, x), cell) in new {
                self.waiting.remove(&(y, x));
                self.encoder.cell(x, y, &cell);
            }
            return Ok(());
        };
        self.waiting.extend(new);
        while let Some(row) = self.waiting.first_key_value().map(|((y, _), _)| *y) {
            if self.encoder.length() >= most {
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

/// What such a terminal is taken for where LINES and COLUMNS do not say better.
const USUAL: (u16, u16) = (80, 24);
/// The largest that a variable may say.
const LARGEST: u16 = 1000;

/// What to do so that it is known.
pub const ADVICE: &str = "the terminal reports no size: stty rows 24 cols 80";

/// Columns and rows, and whether the terminal reports them.
///
/// # Errors
/// If the terminal cannot be asked.
pub fn size() -> io::Result<((u16, u16), bool)> {
    let reported = crossterm::terminal::size()?;
    let known = known(reported, |name| std::env::var(name).ok());
    Ok((known, known == reported))
}

/// The size reported, or that of the environment, or the usual one.
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

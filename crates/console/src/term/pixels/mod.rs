//! Pictures that the terminal draws itself, if configured: each is placed once, over empty cells, and removed when it
//! goes. The terminal is never queried, and of a picture only its pixels are sent.

mod kitty;
mod sixel;
#[cfg(test)]
mod tests;

use std::ops::RangeInclusive;

use crossterm::terminal::{WindowSize, window_size};
use ratatui::buffer::{Buffer, Cell};
use ratatui::layout::Rect;
use unicode_width::UnicodeWidthStr;

use crate::config::Pictures;
use crate::ros::readable::Raster;
use crate::ui::Placement;

/// No picture is read with more pixels than these, whatever size it claims.
const LARGEST: (usize, usize) = (512, 512);
/// The most bytes of one picture.
const MOST: usize = 256 * 1024;
/// This many are allowed on the slowest line too.
const LEAST: usize = 16 * 1024;
/// Seconds for which one picture may occupy a line of limited bytes a second.
const SECONDS: usize = 8;
/// A cell's width and height, pixels, if the terminal's are unknown.
const ASSUMED: (usize, usize) = (8, 16);
/// The plausible widths and heights of a cell.
const BELIEVED: RangeInclusive<usize> = 4..=64;

/// The widest and highest sixel, pixels: of larger ones xterm, with its defaults, shows only a part.
const LARGEST_SIXEL: usize = 1000;

/// Removes any picture of ours from the screen that is being left.
pub fn taking_away(way: Pictures) -> &'static str {
    match way {
        Pictures::HalfBlocks => "",
        Pictures::Sixel => "\x1b[m\x1b[2J",
        Pictures::Kitty => kitty::TAKE_AWAY,
    }
}

/// Returns a cell's width and height, pixels.
type Measure = fn() -> (usize, usize);

/// The picture that the terminal shows, and how to replace it.
#[derive(Debug)]
pub struct Pixels {
    way: Pictures,
    most: usize,
    measure: Measure,
    shown: Option<Placement>,
}

/// What takes the terminal from one picture to the next.
#[derive(Debug, Default)]
pub struct Change {
    /// To be written before the cells of the frame.
    pub away: &'static str,
    /// To be written after them.
    pub put: String,
    /// The cells that are now covered.
    pub covered: Option<Rect>,
}

impl Default for Pixels {
    fn default() -> Self {
        Self::new(Pictures::HalfBlocks, None)
    }
}

impl Pixels {
    /// None is shown yet; a line of limited `bytes_per_second` gets coarser ones.
    pub fn new(way: Pictures, bytes_per_second: Option<u32>) -> Self {
        let rate = bytes_per_second.map(|rate| usize::try_from(rate).unwrap_or(MOST));
        let most = rate.map_or(MOST, |rate| rate.saturating_mul(SECONDS).clamp(LEAST, MOST));
        Self { way, most, measure: cell_size, shown: None }
    }

    /// The screen is about to be cleared, and what was shown has to be placed again; returns the bytes that remove it.
    pub fn forget(&mut self) -> &'static str {
        match (self.shown.take(), self.way) {
            (Some(_), Pictures::Kitty) => kitty::TAKE_AWAY,
            // A sixel is part of its cells, and disappears with them.
            _ => "",
        }
    }

    /// The cells that have to be rewritten so that the picture shown makes way for `wanted`.
    pub fn cells_below(&self, wanted: Option<&Placement>, buffer: &Buffer) -> Vec<(u16, u16, Cell)> {
        match &self.shown {
            Some(shown) if self.way == Pictures::Sixel && wanted != Some(shown) => cells(buffer, shown.area),
            _ => Vec::new(),
        }
    }

    /// Shows a picture, or none; nothing is written if it is shown already.
    pub fn show(&mut self, wanted: Option<Placement>) -> Change {
        if wanted == self.shown {
            return Change::default();
        }
        let away = self.forget();
        let put = wanted.as_ref().map(|placement| self.put(placement)).unwrap_or_default();
        let covered = wanted.as_ref().map(|placement| placement.area);
        self.shown = wanted;
        Change { away, put, covered }
    }

    /// The cursor comes back to where it was: the next cells are written from there.
    fn put(&self, placement: &Placement) -> String {
        let (area, raster) = (placement.area, &placement.raster.fit(LARGEST));
        let (width, height) = (self.measure)();
        let room = (usize::from(area.width) * width, usize::from(area.height) * height);
        let picture = match self.way {
            Pictures::HalfBlocks => return String::new(),
            Pictures::Sixel => {
                let room = (room.0.min(LARGEST_SIXEL), room.1.min(LARGEST_SIXEL));
                sixel::encode(raster, filled(raster, room), self.most)
            }
            Pictures::Kitty => {
                let (across, down) = filled(raster, room);
                kitty::encode(raster, (across.div_ceil(width), down.div_ceil(height)), self.most)
            }
        };
        format!("\x1b7\x1b[{};{}H{picture}\x1b8", area.y + 1, area.x + 1)
    }
}

/// The cells of an area, to be written; the second column of a wide character belongs to its first.
fn cells(buffer: &Buffer, area: Rect) -> Vec<(u16, u16, Cell)> {
    let mut found = Vec::new();
    let area = area.intersection(*buffer.area());
    for y in area.top()..area.bottom() {
        // A wide character may begin left of the area.
        let mut x = area.left().saturating_sub(1);
        while x < area.right() {
            let cell = &buffer[(x, y)];
            let width = u16::try_from(cell.symbol().width().max(1)).unwrap_or(1);
            if x + width > area.left() {
                found.push((x, y, cell.clone()));
            }
            x += width;
        }
    }
    found
}

/// The size in which a picture fills this many pixels while keeping its shape.
fn filled(raster: &Raster, room: (usize, usize)) -> (usize, usize) {
    let (width, height) = (raster.width.max(1), raster.height.max(1));
    if width.saturating_mul(room.1) >= height.saturating_mul(room.0) {
        (room.0, (height.saturating_mul(room.0) / width).max(1))
    } else {
        ((width.saturating_mul(room.1) / height).max(1), room.1)
    }
}

/// A cell's width and height, pixels, from the kernel's data about the terminal (TIOCGWINSZ).
fn cell_size() -> (usize, usize) {
    window_size().ok().and_then(|window| cell_of(&window)).unwrap_or(ASSUMED)
}

/// `None` if the terminal told the kernel nothing, or nothing plausible.
fn cell_of(window: &WindowSize) -> Option<(usize, usize)> {
    let part = |pixels: u16, cells: u16| {
        let size = usize::from(pixels).checked_div(usize::from(cells))?;
        BELIEVED.contains(&size).then_some(size)
    };
    Some((part(window.width, window.columns)?, part(window.height, window.rows)?))
}

/// The picture in fewer pixels than `grid` has, down to one.
fn coarser(raster: &Raster, grid: &Raster) -> Raster {
    let less = |size: usize| (size - size.div_ceil(6)).max(1);
    raster.fit((less(grid.width), less(grid.height)))
}

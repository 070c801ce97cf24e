//! Plots as SVG, written as text: axes with ticks, bars, lines, columns and bands, a legend. No scripts, fonts or
//! external files, so that a page looks the same wherever it is opened.

mod axis;
mod canvas;
mod histogram;
mod plot;

pub use axis::Axis;
pub use histogram::histogram;
pub use plot::{Bar, Mark, Plot, Series, Side};

use canvas::{Anchor, Canvas, Text};

/// Colours that colour-blind people can tell apart; ours first.
pub const COLOURS: [&str; 8] = ["#0072b2", "#56b4e9", "#009e73", "#e69f00", "#d55e00", "#cc79a7", "#5d4a9c", "#6b6b00"];
/// The colour for figures of the paper or its authors.
pub const PAPER: &str = "#8c8c8c";

/// The least width of a page.
const WIDTH: f64 = 1040.0;
/// Width for each of its columns.
const COLUMN: f64 = 400.0;
/// Height of a plot with its title and labels.
const PLOT: f64 = 320.0;
/// The margin around everything.
const MARGIN: f64 = 20.0;
/// Between plots.
const GAP: f64 = 22.0;
/// Height of the title and the line about the machine.
const HEAD: f64 = 62.0;
/// Height of a line of a note.
const NOTE: f64 = 15.0;
/// Characters in a line of a note.
const NOTE_WIDTH: usize = 170;

/// A page of plots.
#[derive(Debug)]
pub struct Page {
    /// What was measured.
    pub title: String,
    /// Where.
    pub machine: String,
    /// Plots side by side.
    pub columns: usize,
    /// In order of reading.
    pub plots: Vec<Plot>,
    /// What must be known to read them.
    pub notes: Vec<String>,
}

/// The position of a plot.
#[derive(Debug, Clone, Copy)]
struct Area {
    x: f64,
    y: f64,
    width: f64,
    height: f64,
}

impl Page {
    /// The whole document.
    pub fn draw(&self) -> String {
        let columns = self.columns.max(1);
        let rows = super::spread::number(self.plots.len().div_ceil(columns));
        let notes: Vec<String> = self.notes.iter().flat_map(|note| wrapped(note)).collect();
        let plots_end = HEAD + rows * (PLOT + GAP);
        let height = plots_end + super::spread::number(notes.len()) * NOTE + 2.0 * MARGIN;
        let across = super::spread::number(columns);
        let whole = (across * COLUMN).max(WIDTH);
        let mut canvas = Canvas::new(whole, height, &self.title);
        canvas.text(MARGIN, 32.0, &self.title, Text { size: 19.0, bold: true, ..Text::default() });
        canvas.text(MARGIN, 52.0, &self.machine, Text { size: 11.5, colour: "#555555", ..Text::default() });
        let width = (whole - 2.0 * MARGIN - (across - 1.0) * GAP) / across;
        for (index, plot) in self.plots.iter().enumerate() {
            let column = super::spread::number(index % columns);
            let row = super::spread::number(index / columns);
            let (x, y) = (MARGIN + column * (width + GAP), HEAD + MARGIN + row * (PLOT + GAP));
            plot.draw(&mut canvas, Area { x, y, width, height: PLOT });
        }
        for (index, note) in notes.iter().enumerate() {
            let y = plots_end + MARGIN + NOTE * super::spread::number(index);
            let look = Text { size: 11.0, colour: "#555555", anchor: Anchor::Start, ..Text::default() };
            canvas.text(MARGIN, y, note, look);
        }
        canvas.end()
    }
}

/// A note in lines that fit the page.
fn wrapped(note: &str) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in note.split_whitespace() {
        let line = lines.last().map_or(0, |line| line.chars().count());
        if line > 0 && line + 1 + word.chars().count() > NOTE_WIDTH {
            lines.push(String::new());
        }
        if let Some(line) = lines.last_mut() {
            let space = if line.is_empty() { "" } else { " " };
            line.push_str(space);
            line.push_str(word);
        }
    }
    lines
}

#[cfg(test)]
mod tests;

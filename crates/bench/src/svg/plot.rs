//! One plot: what is drawn between two or three axes, its title and its legend.

use super::Area;
use super::axis::{Axis, short};
use super::canvas::{Anchor, Canvas, Text, fitted, width_of};
use crate::spread::number;

/// Height of the title and of each row of the legend.
const TITLE: f64 = 20.0;
const LEGEND: f64 = 16.0;
/// Margins left and right of the drawing, and below it.
const LEFT: f64 = 58.0;
const RIGHT: f64 = 14.0;
const RIGHT_WITH_AXIS: f64 = 50.0;
const BELOW: f64 = 26.0;
/// Height of a line of a tick's label.
const LINE: f64 = 12.0;
/// Share of a place that its bars take.
const GROUP: f64 = 0.8;
/// The widest bar.
const WIDEST_BAR: f64 = 64.0;
/// Size of the figure above a bar, and how much wider than the bar it may be.
const FIGURE: f64 = 9.5;
const FIGURE_BEYOND: f64 = 2.0;
/// How much wider bold letters are.
const BOLD: f64 = 1.18;
const GREY: &str = "#666666";
const PALE: &str = "#e4e4e4";

/// The axis a series is read on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// The left one.
    Left,
    /// The right one; the left one if there is none.
    Right,
}

/// A bar with its whiskers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bar {
    /// Its height.
    pub value: f64,
    /// The ends of the whiskers; none if both equal the value.
    pub whiskers: (f64, f64),
}

impl Bar {
    /// Without whiskers.
    pub fn plain(value: f64) -> Self {
        Self { value, whiskers: (value, value) }
    }

    /// With whiskers; none if the value is not a number.
    pub fn between(value: f64, from: f64, to: f64) -> Option<Self> {
        value.is_finite().then_some(Self { value, whiskers: (from, to) })
    }
}

/// The appearance of a series.
#[derive(Debug, Clone, PartialEq)]
pub enum Mark {
    /// A bar at each place that has one.
    Bars(Vec<Option<Bar>>),
    /// Points and the line through them.
    Line(Vec<(f64, f64)>),
    /// From, to, and height of each.
    Columns(Vec<(f64, f64, f64)>),
}

/// One series, drawn in one colour.
#[derive(Debug, Clone)]
pub struct Series {
    /// Its label in the legend.
    pub name: String,
    /// As SVG writes it.
    pub colour: &'static str,
    /// Its axis.
    pub side: Side,
    /// What it is.
    pub mark: Mark,
}

impl Series {
    /// Read on the left.
    pub fn new(name: impl Into<String>, colour: &'static str, mark: Mark) -> Self {
        Self { name: name.into(), colour, side: Side::Left, mark }
    }

    fn has_bar(&self, place: usize) -> bool {
        let Mark::Bars(bars) = &self.mark else { return false };
        bars.get(place).copied().flatten().is_some_and(|bar| bar.value.is_finite())
    }

    /// The values that the axis must cover.
    pub fn values(&self) -> Vec<f64> {
        match &self.mark {
            Mark::Bars(bars) => {
                bars.iter().flatten().flat_map(|bar| [bar.value, bar.whiskers.0, bar.whiskers.1]).collect()
            }
            Mark::Line(points) => points.iter().map(|point| point.1).collect(),
            Mark::Columns(columns) => columns.iter().map(|column| column.2).collect(),
        }
    }
}

/// One plot.
#[derive(Debug, Clone)]
pub struct Plot {
    /// Above it.
    pub title: String,
    /// From left to right.
    pub across: Axis,
    /// Upward, on the left.
    pub left: Axis,
    /// Upward, on the right.
    pub right: Option<Axis>,
    /// The series, from back to front.
    pub series: Vec<Series>,
}

impl Plot {
    pub(super) fn draw(&self, canvas: &mut Canvas, area: Area) {
        let look = Text { size: 13.0, bold: true, ..Text::default() };
        canvas.text(area.x, area.y + 12.0, &fitted(&self.title, 13.0 * BOLD, area.width), look);
        let rows = self.legend(canvas, area);
        let lines = self.across.ticks.iter().map(|(_, words)| words.lines().count()).max().unwrap_or(1);
        let top = TITLE + LEGEND * rows + 6.0;
        let right = if self.right.is_some() { RIGHT_WITH_AXIS } else { RIGHT };
        let inner = Area {
            x: area.x + LEFT,
            y: area.y + top,
            width: area.width - LEFT - right,
            height: area.height - top - BELOW - LINE * number(lines),
        };
        self.grid(canvas, inner);
        for series in &self.series {
            self.draw_series(canvas, inner, series);
        }
        self.labels(canvas, inner, area);
    }

    /// Rows that it took.
    fn legend(&self, canvas: &mut Canvas, area: Area) -> f64 {
        let (mut x, mut row) = (area.x, 1.0);
        for series in &self.series {
            let width = 14.0 + width_of(&series.name, 11.0) + 14.0;
            if x > area.x && x + width > area.x + area.width {
                (x, row) = (area.x, row + 1.0);
            }
            let y = area.y + TITLE + LEGEND * (row - 1.0);
            if matches!(series.mark, Mark::Line(_)) {
                canvas.line(&[(x, y + 5.0), (x + 10.0, y + 5.0)], series.colour, 2.0);
                canvas.dot(x + 5.0, y + 5.0, series.colour);
            } else {
                canvas.rectangle(x, y, (10.0, 10.0), series.colour, 1.0);
            }
            canvas.text(x + 14.0, y + 9.0, &series.name, Text::default());
            x += width;
        }
        row
    }

    fn grid(&self, canvas: &mut Canvas, inner: Area) {
        for (value, words) in &self.left.ticks {
            let y = inner.up(&self.left, *value);
            canvas.line(&[(inner.x, y), (inner.x + inner.width, y)], PALE, 1.0);
            let look = Text { size: 10.5, colour: GREY, anchor: Anchor::End, ..Text::default() };
            canvas.text(inner.x - 5.0, y + 3.5, words, look);
        }
        for (value, words) in self.right.iter().flat_map(|axis| &axis.ticks) {
            let y = self.right.as_ref().map_or(inner.y, |axis| inner.up(axis, *value));
            canvas.text(
                inner.x + inner.width + 5.0,
                y + 3.5,
                words,
                Text { size: 10.5, colour: GREY, ..Text::default() },
            );
        }
    }

    fn labels(&self, canvas: &mut Canvas, inner: Area, area: Area) {
        let foot = inner.y + inner.height;
        canvas.line(&[(inner.x, inner.y), (inner.x, foot), (inner.x + inner.width, foot)], GREY, 1.0);
        let look = Text { size: 10.5, colour: GREY, anchor: Anchor::Middle, ..Text::default() };
        for (value, words) in &self.across.ticks {
            let x = inner.x + inner.width * self.across.share(*value);
            if !self.across.named {
                canvas.line(&[(x, foot), (x, foot + 4.0)], GREY, 1.0);
            }
            for (line, words) in words.lines().enumerate() {
                canvas.text(x, foot + 15.0 + LINE * number(line), words, look);
            }
        }
        let middle = (inner.x + inner.width / 2.0, inner.y + inner.height / 2.0);
        canvas.text(middle.0, area.y + area.height - 2.0, &self.across.label, look);
        let upright = Text { upright: true, ..look };
        canvas.text(area.x + 10.0, middle.1, &self.left.label, upright);
        if let Some(axis) = &self.right {
            canvas.line(&[(inner.x + inner.width, inner.y), (inner.x + inner.width, foot)], GREY, 1.0);
            canvas.text(area.x + area.width - 3.0, middle.1, &axis.label, upright);
        }
    }

    fn draw_series(&self, canvas: &mut Canvas, inner: Area, series: &Series) {
        let axis = match (series.side, &self.right) {
            (Side::Right, Some(axis)) => axis,
            _ => &self.left,
        };
        let across = |value: f64| inner.x + inner.width * self.across.share(value);
        match &series.mark {
            Mark::Bars(bars) => self.draw_bars(canvas, inner, series, axis, bars),
            Mark::Line(points) => {
                let usable = points.iter().filter(|point| point.0.is_finite() && point.1.is_finite());
                let points: Vec<_> = usable.map(|(x, y)| (across(*x), inner.up(axis, *y))).collect();
                canvas.line(&points, series.colour, 2.0);
                points.iter().for_each(|(x, y)| canvas.dot(*x, *y, series.colour));
            }
            Mark::Columns(columns) => {
                for (from, to, height) in columns {
                    let (x, y) = (across(*from), inner.up(axis, *height));
                    let size = (across(*to) - x - 1.0, inner.y + inner.height - y);
                    canvas.rectangle(x, y, size, series.colour, 0.85);
                }
            }
        }
    }

    /// Bars of one series; those of others at the same place are beside them.
    fn draw_bars(&self, canvas: &mut Canvas, inner: Area, series: &Series, axis: &Axis, bars: &[Option<Bar>]) {
        let place = inner.width / number(self.across.ticks.len().max(1));
        for (index, bar) in bars.iter().enumerate() {
            let Some(bar) = bar.filter(|bar| bar.value.is_finite()) else { continue };
            let beside: Vec<_> = self.series.iter().filter(|other| other.has_bar(index)).collect();
            let turn = beside.iter().position(|other| std::ptr::eq(*other, series)).unwrap_or(0);
            let width = (place * GROUP / number(beside.len().max(1))).min(WIDEST_BAR);
            let first = place * number(index) + (place - width * number(beside.len())) / 2.0;
            let x = inner.x + first + width * number(turn);
            let y = inner.up(axis, bar.value);
            canvas.rectangle(x, y, (width - 1.5, inner.y + inner.height - y), series.colour, 0.9);
            let top = whiskers(canvas, inner, axis, bar, x + width / 2.0);
            let figure = short(bar.value);
            if width_of(&figure, FIGURE) <= width + FIGURE_BEYOND {
                let look = Text { size: FIGURE, colour: GREY, anchor: Anchor::Middle, ..Text::default() };
                canvas.text(x + width / 2.0, top.min(y) - 3.0, &figure, look);
            }
        }
    }
}

/// Returns their upper end.
fn whiskers(canvas: &mut Canvas, inner: Area, axis: &Axis, bar: Bar, x: f64) -> f64 {
    let (from, to) = bar.whiskers;
    if !(from.is_finite() && to.is_finite() && to > from) {
        return f64::INFINITY;
    }
    let (low, high) = (inner.up(axis, from), inner.up(axis, to));
    canvas.line(&[(x, low), (x, high)], "#333333", 1.0);
    for y in [low, high] {
        canvas.line(&[(x - 3.0, y), (x + 3.0, y)], "#333333", 1.0);
    }
    high
}

impl Area {
    /// The height of a value of an upward axis.
    fn up(self, axis: &Axis, value: f64) -> f64 {
        self.y + self.height * (1.0 - axis.share(value))
    }
}

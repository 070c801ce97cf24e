//! Pages of plots, drawn as SVG by plotters: bars with whiskers, histograms, a line on a second axis.

mod scale;

use std::io;

use plotters::chart::DualCoordChartContext;
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

pub use self::scale::Axis;
use self::scale::{Scale, short};
use crate::spread::{Spread, number};
use authros_service::Failure;
use authros_service::reply::internal;
pub use plotters::style::RGBColor;

/// Colours that colour-blind people can distinguish; ours first.
pub const COLOURS: [RGBColor; 8] = [
    RGBColor(0, 114, 178),
    RGBColor(86, 180, 233),
    RGBColor(0, 158, 115),
    RGBColor(230, 159, 0),
    RGBColor(213, 94, 0),
    RGBColor(204, 121, 167),
    RGBColor(93, 74, 156),
    RGBColor(107, 107, 0),
];
/// The colour for figures of the paper.
pub const PAPER: RGBColor = RGBColor(140, 140, 140);
const GREY: RGBColor = RGBColor(90, 90, 90);
const PALE: RGBColor = RGBColor(228, 228, 228);

/// Pixels: the least width of a page, a column of it, a plot's height, the page's title, a line of notes or legend.
const WIDTH: u32 = 1040;
const COLUMN: u32 = 400;
const PLOT: u32 = 340;
const HEAD: u32 = 64;
const LINE: u32 = 16;
/// The approximate width of a letter of the small text.
const LETTER: u32 = 6;
/// The share of a place that its bars take, and the most that one takes.
const GROUP: f64 = 0.8;
const WIDEST_BAR: f64 = 0.45;
/// Columns of a histogram.
const COLUMNS: usize = 24;

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Chart<'a, 'b> = DualCoordChartContext<'a, SVGBackend<'b>, Cartesian2d<Scale, Scale>, Cartesian2d<Scale, Scale>>;
type Drawn = Result<(), DrawingAreaErrorKind<io::Error>>;

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

/// One plot.
#[derive(Debug, Clone)]
pub struct Plot {
    /// Above it.
    pub title: String,
    /// From left to right.
    pub across: Axis,
    /// Upward, for bars and columns.
    pub left: Axis,
    /// Upward, for a line.
    pub right: Option<Axis>,
    /// From back to front.
    pub series: Vec<Series>,
}

/// One series, in one colour.
#[derive(Debug, Clone)]
pub struct Series {
    name: String,
    colour: RGBColor,
    mark: Mark,
}

/// How a series is drawn.
#[derive(Debug, Clone)]
pub enum Mark {
    /// A bar at each place that has one.
    Bars(Vec<Option<Bar>>),
    /// From, to, and height of each.
    Columns(Vec<(f64, f64, f64)>),
    /// Points and the line through them, on the right axis.
    Line(Vec<(f64, f64)>),
}

/// A bar with its whiskers.
#[derive(Debug, Clone, Copy)]
pub struct Bar {
    value: f64,
    whiskers: Option<(f64, f64)>,
}

impl Bar {
    /// Without whiskers; none if the value is not a number.
    pub fn plain(value: f64) -> Option<Self> {
        value.is_finite().then_some(Self { value, whiskers: None })
    }

    /// With whiskers; none if the value is not a number.
    pub fn between(value: f64, from: f64, to: f64) -> Option<Self> {
        let whiskers = (from.is_finite() && to > from).then_some((from, to));
        value.is_finite().then_some(Self { value, whiskers })
    }
}

impl Series {
    /// With its name in the legend.
    pub fn new(name: impl Into<String>, colour: RGBColor, mark: Mark) -> Self {
        Self { name: name.into(), colour, mark }
    }

    /// The values that an axis must cover.
    pub fn values(&self) -> Vec<f64> {
        match &self.mark {
            Mark::Bars(bars) => {
                let ends = |bar: &Bar| bar.whiskers.map_or([bar.value; 3], |(from, to)| [bar.value, from, to]);
                bars.iter().flatten().flat_map(ends).collect()
            }
            Mark::Columns(columns) => columns.iter().map(|column| column.2).collect(),
            Mark::Line(points) => points.iter().map(|point| point.1).collect(),
        }
    }

    fn bar(&self, place: usize) -> Option<Bar> {
        match &self.mark {
            Mark::Bars(bars) => bars.get(place).copied().flatten(),
            Mark::Columns(_) | Mark::Line(_) => None,
        }
    }
}

impl Page {
    /// The SVG document.
    ///
    /// # Errors
    /// If it cannot be drawn.
    pub fn draw(&self) -> Result<String, Failure> {
        let mut svg = String::new();
        self.draw_into(&mut svg).map_err(|error| internal(format!("the plots cannot be drawn: {error}")))?;
        Ok(svg)
    }

    fn draw_into(&self, svg: &mut String) -> Drawn {
        let columns = self.columns.max(1);
        let rows = self.plots.len().div_ceil(columns).max(1);
        let width = WIDTH.max(pixels(columns, COLUMN));
        let letters = usize::try_from((width - 40) / LETTER).unwrap_or(usize::MAX);
        let notes: Vec<String> = self.notes.iter().flat_map(|note| wrapped(note, letters)).collect();
        let height = HEAD + pixels(rows, PLOT) + pixels(notes.len(), LINE) + LINE;
        let root = SVGBackend::with_string(svg, (width, height)).into_drawing_area();
        root.fill(&WHITE)?;
        let (head, rest) = root.split_vertically(HEAD);
        let bold = ("sans-serif", 20).into_font().style(FontStyle::Bold);
        head.draw(&Text::new(self.title.clone(), (20, 14), bold))?;
        head.draw(&Text::new(self.machine.clone(), (20, 42), small()))?;
        let (plots, foot) = rest.split_vertically(pixels(rows, PLOT));
        for (area, plot) in plots.split_evenly((rows, columns)).iter().zip(&self.plots) {
            plot.draw(area)?;
        }
        for (area, note) in foot.split_evenly((notes.len() + 1, 1)).iter().zip(&notes) {
            area.draw(&Text::new(note.clone(), (20, 0), small()))?;
        }
        root.present()
    }
}

impl Plot {
    fn draw(&self, area: &Area<'_>) -> Drawn {
        let area = area.margin(6, 6, 16, 16);
        let (title, rest) = area.split_vertically(LINE + 4);
        let bold = ("sans-serif", 14).into_font().style(FontStyle::Bold);
        title.draw(&Text::new(self.title.clone(), (0, 2), bold))?;
        let rest = self.legend(&rest)?;
        let mut builder = ChartBuilder::on(&rest);
        builder.margin_top(10).x_label_area_size(40).y_label_area_size(62);
        builder.right_y_label_area_size(if self.right.is_some() { 56 } else { 8 });
        let (across, right) = (&self.across, self.right.as_ref().unwrap_or(&self.left));
        let mut chart = builder
            .build_cartesian_2d(across.scale.clone(), self.left.scale.clone())?
            .set_secondary_coord(across.scale.clone(), right.scale.clone());
        let mut mesh = chart.configure_mesh();
        mesh.disable_x_mesh().max_light_lines(0).bold_line_style(PALE).axis_style(GREY).label_style(small());
        mesh.x_labels(across.labels()).y_labels(self.left.labels()).axis_desc_style(small());
        let (named, valued) = (|value: &f64| across.written(*value), |value: &f64| self.left.written(*value));
        mesh.x_label_formatter(&named).y_label_formatter(&valued);
        mesh.x_desc(&across.label).y_desc(&self.left.label).draw()?;
        if self.right.is_some() {
            let valued = |value: &f64| right.written(*value);
            let mut axes = chart.configure_secondary_axes();
            axes.label_style(small()).axis_style(GREY).y_labels(right.labels()).y_label_formatter(&valued);
            axes.axis_desc_style(small()).y_desc(&right.label).draw()?;
        }
        self.series.iter().try_for_each(|series| self.draw_series(&mut chart, series))
    }

    /// Names the series above the chart; returns the area below the names.
    fn legend<'a>(&self, area: &Area<'a>) -> Result<Area<'a>, DrawingAreaErrorKind<io::Error>> {
        let (most, _) = area.dim_in_pixel();
        let (mut x, mut y) = (0, 0);
        for series in &self.series {
            let width = 26 + pixels(series.name.chars().count(), LETTER);
            if x > 0 && x + width > most {
                (x, y) = (0, y + LINE);
            }
            let (left, top) = (whole(x), whole(y));
            area.draw(&Rectangle::new([(left, top), (left + 10, top + 10)], series.colour.filled()))?;
            area.draw(&Text::new(series.name.clone(), (left + 14, top - 1), small()))?;
            x += width;
        }
        Ok(area.split_vertically(y + LINE).1)
    }

    fn draw_series(&self, chart: &mut Chart<'_, '_>, series: &Series) -> Drawn {
        let floor = self.left.floor();
        match &series.mark {
            Mark::Bars(bars) => {
                let (width, _) = chart.plotting_area().dim_in_pixel();
                let place = f64::from(width) / number(bars.len().max(1));
                for (at, bar) in bars.iter().enumerate() {
                    let Some(bar) = bar else { continue };
                    self.draw_bar(chart, series, (at, bar), place)?;
                }
                Ok(())
            }
            Mark::Columns(columns) => {
                let column = |&(from, to, height): &(f64, f64, f64)| {
                    Rectangle::new([(from, floor), (to - (to - from) * 0.08, height)], series.colour.mix(0.85).filled())
                };
                chart.draw_series(columns.iter().map(column)).map(drop)
            }
            Mark::Line(points) => {
                let line = PathElement::new(points.clone(), series.colour.stroke_width(2));
                chart.draw_secondary_series([line])?;
                let dot = |point: &(f64, f64)| Circle::new(*point, 3, series.colour.filled());
                chart.draw_secondary_series(points.iter().map(dot)).map(drop)
            }
        }
    }

    /// One bar, beside those of other series at the same place.
    fn draw_bar(&self, chart: &mut Chart<'_, '_>, series: &Series, (at, bar): (usize, &Bar), place: f64) -> Drawn {
        let beside: Vec<&Series> = self.series.iter().filter(|other| other.bar(at).is_some()).collect();
        let turn = beside.iter().position(|other| std::ptr::eq(*other, series)).unwrap_or(0);
        let width = (GROUP / number(beside.len().max(1))).min(WIDEST_BAR);
        let left = number(at) + 0.5 + width * (number(turn) - number(beside.len()) / 2.0);
        let (middle, right) = (left + width * 0.46, left + width * 0.92);
        let filled = series.colour.mix(0.9).filled();
        chart.draw_series([Rectangle::new([(left, self.left.floor()), (right, bar.value)], filled)])?;
        if let Some((from, to)) = bar.whiskers {
            let cap = |value: f64| vec![(middle - width * 0.12, value), (middle + width * 0.12, value)];
            let lines = [vec![(middle, from), (middle, to)], cap(from), cap(to)];
            chart.draw_series(lines.map(|line| PathElement::new(line, BLACK.stroke_width(1))))?;
        }
        let figure = short(bar.value);
        if number(figure.len()) * f64::from(LETTER) > place * width * 1.1 {
            return Ok(());
        }
        let top = bar.whiskers.map_or(bar.value, |(_, to)| to.max(bar.value));
        let style = TextStyle::from(("sans-serif", 10).into_font()).color(&GREY);
        let above = Text::new(figure, (middle, top), style.pos(Pos::new(HPos::Center, VPos::Bottom)));
        chart.draw_series([above]).map(drop)
    }
}

/// How often values occur, as in the paper's figures 16 and 17: counts in blue bars, their frequency as an orange line.
/// The farthest few per cent are counted in the last column, otherwise the rest would be squeezed into one.
pub fn histogram(title: impl Into<String>, values: &[f64], unit: &str) -> Plot {
    let Spread { min, p95, max, .. } = Spread::of(if values.is_empty() { &[0.0] } else { values });
    // Half of the range again above the 95th percentile.
    let end = max.min(p95 + (p95 - min) / 2.0);
    let width = ((end - min) / number(COLUMNS)).max(min.abs() * 1e-6).max(f64::MIN_POSITIVE);
    let edge = |column: usize| min + width * number(column);
    let mut counts = [0u32; COLUMNS];
    for value in values {
        counts[(1..COLUMNS).filter(|column| *value >= edge(*column)).count()] += 1;
    }
    let beyond = values.iter().filter(|value| **value > end).count();
    let all = number(values.len()).max(1.0);
    let columns = counts.iter().enumerate().map(|(at, count)| (edge(at), edge(at + 1), f64::from(*count)));
    let middles =
        counts.iter().enumerate().map(|(at, count)| (edge(at) + width / 2.0, f64::from(*count) * 100.0 / all));
    let count = Series::new("count", COLOURS[0], Mark::Columns(columns.collect()));
    let frequency = Series::new("frequency", COLOURS[3], Mark::Line(middles.collect()));
    let label = if beyond == 0 { unit.to_owned() } else { format!("{unit}; {beyond} above in the last column") };
    Plot {
        title: title.into(),
        across: Axis::between(label, min, edge(COLUMNS)),
        left: Axis::from_zero("count", count.values()),
        right: Some(Axis::from_zero("frequency, %", frequency.values())),
        series: vec![count, frequency],
    }
}

fn small() -> TextStyle<'static> {
    TextStyle::from(("sans-serif", 12).into_font()).color(&GREY)
}

fn pixels(count: usize, each: u32) -> u32 {
    u32::try_from(count).unwrap_or(u32::MAX).saturating_mul(each)
}

fn whole(pixels: u32) -> i32 {
    i32::try_from(pixels).unwrap_or(i32::MAX)
}

/// A note in lines of at most `letters` letters.
fn wrapped(note: &str, letters: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in note.split_whitespace() {
        let length = lines.last().map_or(0, |line| line.chars().count());
        if length > 0 && length + 1 + word.chars().count() > letters {
            lines.push(String::new());
        }
        if let Some(line) = lines.last_mut() {
            line.push_str(if line.is_empty() { "" } else { " " });
            line.push_str(word);
        }
    }
    lines
}

#[cfg(test)]
mod tests;

//! Lines of values over time in Braille dots, two parts by four levels to a cell, the ends of the scale at their side.

use ratatui::layout::Rect;

use super::canvas::{Canvas, right_of, row, rows};
use super::plot::DOTS;
use super::theme::Role;
use crate::app::history::Sample;

/// Columns of the scale at the right of a line, with its gap.
pub const SIDE: u16 = 8;

/// Part of the highest value above which all values are a narrow band, which gets the whole height.
const NARROW: f64 = 0.5;
/// Least height of a scale as part of its upper end; what differs less is no news.
const LEAST: f64 = 0.1;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scale {
    low: f64,
    high: f64,
    step: f64,
}

impl Scale {
    /// From 0, unless the values are a narrow band; its ends are round, so that small changes leave it as it is.
    pub fn around(values: &[Option<Sample>]) -> Self {
        let known = || values.iter().flatten().filter(|sample| is_finite(sample));
        let high = known().map(|sample| sample.high).fold(0.0, f64::max);
        let low = known().map(|sample| sample.low).fold(high, f64::min);
        let narrow = low > high * NARROW;
        // From 0, a fall of a tenth must still be another one of eight levels, so the upper end is close to the highest.
        let (low, steps) = if narrow { (low.min(high * (1.0 - LEAST)), 10.0) } else { (0.0, 40.0) };
        let step = rounded((high - low) / steps);
        // A value that is a step but for the last bits is on it.
        Self { low: (low / step + 1e-6).floor() * step, high: (high / step - 1e-6).ceil() * step, step }
    }

    /// For lines without room for their scale.
    pub fn from_zero(values: &[Option<Sample>]) -> Self {
        let highest = crate::app::history::highest(values);
        Self { low: 0.0, high: highest, step: highest }
    }

    /// The level of a value, from below.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within the levels; 0 if not a number")]
    fn level(&self, value: f64, levels: u16) -> u16 {
        let top = levels.saturating_sub(1);
        let level = ((value - self.low) / (self.high - self.low) * f64::from(top)).round();
        let level = level.clamp(0.0, f64::from(top)) as u16;
        // Little is not nothing.
        if self.low <= 0.0 && value > 0.0 { level.max(1).min(top) } else { level }
    }

    fn words(&self, value: f64) -> String {
        const UNITS: [(f64, &str); 6] = [(1e18, "E"), (1e15, "P"), (1e12, "T"), (1e9, "G"), (1e6, "M"), (1e3, "k")];
        if value <= 0.0 {
            return "0".to_owned();
        }
        let (unit, letter) = UNITS.into_iter().find(|(unit, _)| self.high >= unit * 10.0).unwrap_or((1.0, ""));
        let places = (0..3).find(|places| self.step / unit * 10f64.powi(*places) > 0.999).unwrap_or(3);
        format!("{:.*}{letter}", usize::try_from(places).unwrap_or(0), value / unit)
    }
}

fn is_finite(sample: &Sample) -> bool {
    sample.low.is_finite() && sample.mean.is_finite() && sample.high.is_finite()
}

/// The next 1, 2 or 5 times a power of ten.
fn rounded(least: f64) -> f64 {
    if !least.is_finite() || least <= 0.0 {
        return 1.0;
    }
    let power = 10f64.powf(least.log10().floor());
    [1.0, 2.0, 5.0].into_iter().map(|times| times * power).find(|step| *step >= least).unwrap_or(10.0 * power)
}

pub struct Graph<'a> {
    /// Two to a cell, oldest first.
    pub values: &'a [Option<Sample>],
    pub scale: Scale,
    pub role: Role,
    /// Whether arrows mark where the values changed.
    pub marks: bool,
}

/// The line at the left of `area`, its scale beside it.
pub fn draw(canvas: &mut Canvas, area: Rect, graph: &Graph) {
    let width = area.width.saturating_sub(SIDE).min(rows(graph.values.len().div_ceil(2)));
    if width == 0 || area.height == 0 {
        return;
    }
    let shown = newest(graph.values, width);
    let patterns = patterns(shown, &graph.scale, width, area.height);
    for (line, patterns) in (0u16..).zip(&patterns) {
        let text: String = patterns.iter().copied().map(dots).collect();
        canvas.put(Rect { width, ..row(area, line) }, &text, graph.role);
    }
    if graph.marks {
        draw_marks(canvas, Rect { width, ..area }, &patterns, &changes(shown));
    }
    let side = right_of(area, width + 1);
    if area.height > 1 {
        let Scale { low, high, .. } = graph.scale;
        canvas.put(row(side, 0), &graph.scale.words(high), Role::Dim);
        // A scale that does not begin at 0 must not be misread.
        let role = if low > 0.0 { Role::Body } else { Role::Dim };
        canvas.put(row(side, area.height - 1), &graph.scale.words(low), role);
    }
}

/// A line of one row, in a scale of its own from 0.
pub fn line(values: &[Option<Sample>], cells: u16) -> String {
    let shown = newest(values, cells);
    patterns(shown, &Scale::from_zero(shown), cells, 1).concat().into_iter().map(dots).collect()
}

fn newest(values: &[Option<Sample>], cells: u16) -> &[Option<Sample>] {
    values.get(values.len().saturating_sub(usize::from(cells) * 2)..).unwrap_or_default()
}

fn dots(pattern: u8) -> char {
    if pattern == 0 { ' ' } else { char::from_u32(0x2800 + u32::from(pattern)).unwrap_or(' ') }
}

/// Row by row from above: each part from its lowest to its highest value, and joined to the part before.
fn patterns(values: &[Option<Sample>], scale: &Scale, width: u16, height: u16) -> Vec<Vec<u8>> {
    let levels = height.saturating_mul(4);
    let mut patterns = vec![vec![0; usize::from(width)]; usize::from(height)];
    let mut set = |across: usize, level: u16| {
        let down = usize::from(levels - 1 - level);
        let bit = DOTS.get(across % 2).and_then(|column| column.get(down % 4)).copied().unwrap_or(0);
        if let Some(cell) = patterns.get_mut(down / 4).and_then(|row| row.get_mut(across / 2)) {
            *cell |= bit;
        }
    };
    let mut before: Option<(u16, u16)> = None;
    for (across, value) in values.iter().enumerate() {
        let ends =
            value.filter(is_finite).map(|value| (scale.level(value.low, levels), scale.level(value.high, levels)));
        if let Some((low, high)) = ends {
            let (lower, upper) = before.unwrap_or((low, high));
            (low.min(upper + 1)..=high.max(lower.saturating_sub(1))).for_each(|level| set(across, level));
        }
        before = ends;
    }
    patterns
}

/// What counts as a change, as part of the mean: a tenth, and what measuring adds to it.
const CHANGED: f64 = 0.07;
/// Parts in a row that a change lasts.
const LASTS: u16 = 3;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Change {
    /// The part that is the first.
    place: usize,
    rises: bool,
}

/// Where the values leave their mean since the last change.
fn changes(values: &[Option<Sample>]) -> Vec<Change> {
    let mut changes = Vec::new();
    let (mut sum, mut count, mut away, mut rose) = (0.0, 0u16, 0, false);
    for (place, value) in values.iter().enumerate() {
        let Some(Sample { mean: value, .. }) = value.filter(is_finite) else {
            (count, away) = (0, 0);
            continue;
        };
        if count == 0 {
            sum = 0.0;
        }
        let mean = sum / f64::from(count.max(1));
        let rises = value > mean;
        if count < LASTS || (value - mean).abs() <= mean * CHANGED {
            (sum, count, away) = (sum + value, count.saturating_add(1), 0);
            continue;
        }
        away = if rises == rose { away + 1 } else { 1 };
        rose = rises;
        if away == LASTS {
            changes.push(Change { place: place + 1 - usize::from(LASTS), rises });
            (sum, count, away) = (value, 1, 0);
        }
    }
    changes
}

/// Where the line leaves a cell free: a fall from above, a rise from below.
fn draw_marks(canvas: &mut Canvas, area: Rect, patterns: &[Vec<u8>], changes: &[Change]) {
    let is_free = |line: u16, cell: usize| {
        patterns.get(usize::from(line)).and_then(|cells| cells.get(cell)).is_some_and(|pattern| *pattern == 0)
    };
    for Change { place, rises } in changes.iter().copied() {
        let lines = (0..area.height).map(|line| if rises { area.height - 1 - line } else { line });
        let mut places = lines.flat_map(|line| [(line, place / 2 + 1), (line, place / 2)]);
        let Some((line, cell)) = places.find(|(line, cell)| is_free(*line, *cell)) else { continue };
        let (mark, role) = if rises { ("↑", Role::Body) } else { ("↓", Role::Warning) };
        canvas.put(Rect { width: 1, ..right_of(row(area, line), rows(cell)) }, mark, role);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ui::canvas::flatten;
    use crate::ui::theme::Theme;
    use proptest::prelude::*;
    use ratatui::buffer::Buffer;

    const ALL: Rect = Rect { x: 0, y: 0, width: 320, height: 20 };

    fn drawn(area: Rect, values: &[Option<Sample>]) -> Buffer {
        let theme = Theme::named("night").expect("embedded");
        let mut buffer = Buffer::empty(ALL);
        let graph = Graph { values, scale: Scale::around(values), role: Role::Accent, marks: true };
        draw(&mut Canvas::new(&mut buffer, &theme), area, &graph);
        buffer
    }

    /// The lowest and the highest level in each part, as the dots on the screen say.
    fn levels(buffer: &Buffer, area: Rect, parts: u16) -> Vec<Option<(u16, u16)>> {
        let is_set = |part: u16, level: u16| {
            let down = area.height * 4 - 1 - level;
            let symbol = buffer[(area.x + part / 2, area.y + down / 4)].symbol().chars().next().map_or(0, u32::from);
            let pattern = symbol.checked_sub(0x2800).filter(|pattern| *pattern < 0x100).unwrap_or(0);
            pattern & u32::from(DOTS[usize::from(part % 2)][usize::from(down % 4)]) != 0
        };
        let ends = |part: u16| {
            let set: Vec<u16> = (0..area.height * 4).filter(|level| is_set(part, *level)).collect();
            Some((*set.first()?, *set.last()?))
        };
        (0..parts).map(ends).collect()
    }

    /// What stands in a column of cells.
    fn column(buffer: &Buffer, area: Rect, x: u16) -> String {
        (area.y..area.bottom()).map(|y| buffer[(area.x + x, y)].symbol()).collect()
    }

    /// As on an Overview of 80 columns: 60 cells and the scale, in two rows.
    const NARROW_SCREEN: Rect = Rect { x: 11, y: 3, width: 69, height: 2 };

    #[allow(clippy::unnecessary_wraps, reason = "a graph has unknown parts, too")]
    fn level(value: f64) -> Option<Sample> {
        Some(Sample::level(value))
    }

    #[allow(clippy::cast_precision_loss, reason = "any numbers will do")]
    fn samples() -> impl Strategy<Value = Option<Sample>> {
        let sample = any::<[u64; 3]>().prop_map(|mut ends| {
            ends.sort_unstable();
            let [low, mean, high] = ends.map(|end| end as f64);
            Some(Sample { low, mean, high })
        });
        let level_of = |value: f64| Just(level(value));
        prop_oneof![
            6 => sample,
            1 => Just(None),
            1 => prop_oneof![level_of(0.0), level_of(u64::MAX as f64), level_of(f64::NAN), level_of(f64::INFINITY)],
        ]
    }

    proptest! {
        #[test]
        fn whatever_the_values_nothing_is_drawn_outside(
            values in prop::collection::vec(samples(), 0..700), width in 1u16..=300, height in 0u16..=12,
        ) {
            let area = Rect { x: 3, y: 2, width, height };
            let buffer = drawn(area, &values);
            for (index, cell) in buffer.content().iter().enumerate() {
                let (x, y) = buffer.pos_of(index);
                prop_assert!(area.contains((x, y).into()) || cell.symbol() == " ", "{x} {y} {:?}", cell.symbol());
            }
            prop_assert_eq!(line(&values, width).chars().count(), usize::from(width));
        }

        #[test]
        fn a_fall_of_a_tenth_shows_even_beside_a_stop(
            rate in 1.0..1e18f64, place in 10usize..50, lasts in 1usize..5, stops: bool,
        ) {
            let mut values = vec![level(rate); 120];
            values[2 * place..2 * (place + lasts)].fill(level(rate * 0.9));
            if stops {
                values[118] = Some(Sample { low: 0.0, mean: rate * 0.9, high: rate });
            }
            let buffer = drawn(NARROW_SCREEN, &values);
            let found = levels(&buffer, NARROW_SCREEN, 120);
            // The first part of the fall is joined to the line above.
            let fallen = found[2 * place + 1].expect("drawn");
            prop_assert!(fallen.1 < found[4].expect("drawn").0, "{found:?}");
            let cells = [1, place].map(|cell| column(&buffer, NARROW_SCREEN, u16::try_from(cell).expect("small")));
            prop_assert_ne!(&cells[0], &cells[1]);
        }

        #[test]
        fn a_stop_of_two_seconds_in_two_minutes_shows_in_any_width(
            rate in 1.0..1e18f64, second in 20usize..100, per_part in 1usize..10,
        ) {
            let rates: Vec<f64> = (0..120).map(|at| if (second..second + 2).contains(&at) { 0.0 } else { rate }).collect();
            let part = |rates: &[f64]| {
                let ends = rates.iter().fold((f64::INFINITY, 0.0f64), |ends, rate| (rate.min(ends.0), rate.max(ends.1)));
                let mean = rates.iter().sum::<f64>() / f64::from(u16::try_from(rates.len()).expect("few"));
                Some(Sample { low: ends.0, mean, high: ends.1 })
            };
            let values: Vec<Option<Sample>> = rates.chunks(per_part).map(part).collect();
            let found = levels(&drawn(NARROW_SCREEN, &values), NARROW_SCREEN, rows(values.len()));
            for (part, rates) in rates.chunks(per_part).enumerate() {
                let stopped = rates.iter().any(|rate| *rate < 0.5);
                prop_assert_eq!(found[part].expect("drawn").0 == 0, stopped, "{}: {:?}", part, found);
            }
        }

        #[test]
        fn a_slow_rise_climbs_and_never_falls(rate in 1.0..1e18f64, rise in 0.1..3.0f64) {
            let values: Vec<Option<Sample>> =
                (0..120u8).map(|at| level(rate * (1.0 + rise * f64::from(at) / 119.0))).collect();
            let found = levels(&drawn(Rect { height: 5, ..NARROW_SCREEN }, &values), Rect { height: 5, ..NARROW_SCREEN }, 120);
            // An arrow may stand where the line is not.
            let found: Vec<(u16, u16)> = found.into_iter().flatten().collect();
            prop_assert_eq!(found.len(), 120);
            prop_assert!(found.windows(2).all(|pair| pair[0].1 <= pair[1].1), "{:?}", found);
            prop_assert!(found[0].1 + 6 < found[119].1, "{:?}", found);
        }
    }

    #[test]
    fn the_scale_is_said_and_begins_at_0_unless_the_values_are_a_narrow_band() {
        let ends = |values: &[f64]| {
            let values: Vec<Option<Sample>> = values.iter().copied().map(level).collect();
            let scale = Scale::around(&values);
            [scale.words(scale.low), scale.words(scale.high)]
        };
        assert_eq!(ends(&[44.0, 44.0]), ["39.5", "44.0"]);
        assert_eq!(ends(&[44.0, 38.2]), ["38", "44"]);
        assert_eq!(ends(&[44.0, 0.0]), ["0", "44"]);
        assert_eq!(ends(&[0.9, 0.4]), ["0", "0.90"]);
        assert_eq!(ends(&[12_345.0, 11_900.0]), ["11.0k", "12.4k"]);
        assert_eq!(ends(&[0.0]), ["0", "0"]);
        assert_eq!(ends(&[]), ["0", "0"]);
        let buffer = drawn(NARROW_SCREEN, &[level(44.0); 120]);
        let side = |y: u16| (72..80).map(|x| buffer[(x, y)].symbol()).collect::<String>();
        assert_eq!([side(3).trim(), side(4).trim()], ["44.0", "39.5"]);
    }

    #[test]
    fn little_is_not_nothing() {
        let scale = Scale::around(&[level(1e9)]);
        let from_zero = Scale::around(&[level(1e9), level(0.0)]);
        assert_eq!([scale.level(0.001, 8), from_zero.level(0.001, 8), from_zero.level(0.0, 8)], [0, 1, 0]);
        assert_eq!(line(&[level(0.0), level(0.0), level(9.0), level(9.0), None, None], 3), "\u{28c0}\u{280f} ");
    }

    #[test]
    fn a_change_is_marked_where_it_begins_and_a_short_one_is_not() {
        let mut values = vec![level(100.0); 120];
        values[40..80].fill(level(90.0));
        values[100] = level(50.0);
        let (fall, rise) = (Change { place: 40, rises: false }, Change { place: 80, rises: true });
        assert_eq!(changes(&values), [fall, rise]);
        let text: String =
            drawn(Rect { height: 4, ..NARROW_SCREEN }, &values).content().iter().map(|c| c.symbol()).collect();
        assert_eq!(["↓", "↑"].map(|mark| text.matches(mark).count()), [1, 1]);
    }

    #[test]
    fn a_fall_of_a_tenth_shows_in_ascii_too() {
        let mut values = vec![level(44.0); 120];
        values[60..80].fill(level(39.6));
        let mut buffer = drawn(NARROW_SCREEN, &values);
        flatten(&mut buffer);
        assert_eq!([5, 35].map(|cell| column(&buffer, NARROW_SCREEN, cell)), ["' ", " ."]);
        assert!(buffer.content().iter().all(|cell| cell.symbol().is_ascii()));
    }
}

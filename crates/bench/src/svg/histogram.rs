//! Histograms like the paper's figures 16 and 17: bars for counts, an orange line for their frequency.

use super::COLOURS;
use super::axis::Axis;
use super::plot::{Mark, Plot, Series, Side};
use crate::spread::{Spread, number};

/// Columns.
const COLUMNS: usize = 24;

/// How often values occur. The farthest few per cent are counted in the last column, otherwise the rest would be
/// squeezed into one.
pub fn histogram(title: impl Into<String>, values: &[f64], unit: &str) -> Plot {
    let Spread { min, p95, max, .. } = Spread::of(values);
    // Half of the range again above the 95th percentile.
    let end = max.min(p95 + (p95 - min) / 2.0);
    let width = ((end - min) / number(COLUMNS)).max(f64::MIN_POSITIVE);
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
    let frequency = Series { side: Side::Right, ..Series::new("frequency", COLOURS[3], Mark::Line(middles.collect())) };
    let label = if beyond == 0 { unit.to_owned() } else { format!("{unit}; {beyond} above in the last column") };
    Plot {
        title: title.into(),
        across: Axis::around(label, [min, edge(COLUMNS)]),
        left: Axis::from_zero("count", count.values()),
        right: Some(Axis::from_zero("frequency, %", frequency.values())),
        series: vec![count, frequency],
    }
}

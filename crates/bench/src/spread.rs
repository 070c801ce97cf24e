//! The spread of measured values: least, median, 95th percentile, greatest; and their histogram in text.

use serde::Serialize;

/// Bars of a histogram.
const BARS: usize = 8;
/// The longest bar, characters.
const LONGEST_BAR: usize = 40;

/// Nearest-rank percentiles; all NaN (`null` in JSON) if there are no values.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[allow(missing_docs, reason = "the type's line says it")]
pub struct Spread {
    pub min: f64,
    pub p50: f64,
    pub p95: f64,
    pub max: f64,
}

impl Spread {
    /// For values in any order.
    pub fn of(values: &[f64]) -> Self {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let at = |percent: usize| {
            let rank = (sorted.len() * percent).div_ceil(100).max(1);
            sorted.get(rank - 1).copied().unwrap_or(f64::NAN)
        };
        Self { min: at(0), p50: at(50), p95: at(95), max: at(100) }
    }
}

/// Bars over equal parts of the range, each with its count.
pub fn histogram(values: &[f64], unit: &str) -> Vec<String> {
    let Spread { min, max, .. } = Spread::of(values);
    if values.is_empty() {
        return vec!["  nothing to show".to_owned()];
    }
    let width = ((max - min) / number(BARS)).max(f64::MIN_POSITIVE);
    let mut counts = [0usize; BARS];
    for value in values {
        let above = (1..BARS).filter(|bar| *value >= min + width * number(*bar)).count();
        counts[above] += 1;
    }
    let most = counts.iter().copied().max().unwrap_or(1).max(1);
    let line = |(bar, count): (usize, &usize)| {
        let from = min + width * number(bar);
        let length = (count * LONGEST_BAR).div_ceil(most);
        format!("  {from:>9.1} {unit} |{:<LONGEST_BAR$} {count}", "#".repeat(length))
    };
    counts.iter().enumerate().map(line).collect()
}

/// A bar for each name, as long as its value; by its logarithm if they differ by more than a hundred times.
pub fn bars(rows: &[(String, f64)], unit: &str) -> Vec<String> {
    let known = || rows.iter().map(|(_, value)| *value).filter(|value| value.is_finite() && *value > 0.0);
    let (least, most) = (known().fold(f64::INFINITY, f64::min), known().fold(0.0, f64::max));
    let far = most > least * 100.0;
    let width = rows.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
    let share =
        |value: f64| if far { (1.0 + (value / least).log10()) / (1.0 + (most / least).log10()) } else { value / most };
    let line = |(name, value): &(String, f64)| {
        let length = (1..=LONGEST_BAR).filter(|bar| share(*value) * number(LONGEST_BAR) >= number(*bar) - 0.5).count();
        format!("  {name:<width$} |{:<LONGEST_BAR$} {} {unit}", "#".repeat(length), decimal(*value))
    };
    let scale = far.then(|| "  (a bar grows with the logarithm)".to_owned());
    rows.iter().map(line).chain(scale).collect()
}

/// A count as a float; exact up to 2^32, and no count here is larger.
pub fn number(count: impl TryInto<u32>) -> f64 {
    f64::from(count.try_into().unwrap_or(u32::MAX))
}

/// One decimal, or a dash if there is no value.
pub fn decimal(value: f64) -> String {
    if value.is_finite() { format!("{value:.1}") } else { "-".to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearest_ranks() {
        let values: Vec<f64> = (1..=100).rev().map(f64::from).collect();
        assert_eq!(Spread::of(&values), Spread { min: 1.0, p50: 50.0, p95: 95.0, max: 100.0 });
        assert_eq!(Spread::of(&[7.0]), Spread { min: 7.0, p50: 7.0, p95: 7.0, max: 7.0 });
        let none = serde_json::to_value(Spread::of(&[])).expect("JSON");
        assert_eq!(none, serde_json::json!({ "min": null, "p50": null, "p95": null, "max": null }));
    }

    #[test]
    fn bars_are_as_long_as_their_values() {
        let of = |values: &[f64]| {
            let rows: Vec<_> = values.iter().map(|value| ("x".to_owned(), *value)).collect();
            bars(&rows, "ms").iter().map(|line| line.matches('#').count()).collect::<Vec<_>>()
        };
        assert_eq!(of(&[1.0, 2.0, 4.0, f64::NAN]), [10, 20, 40, 0]);
        assert_eq!(of(&[1.0, 1000.0]), [10, 40, 0]);
        assert_eq!(of(&[]), Vec::<usize>::new());
    }

    #[test]
    fn every_value_is_in_one_bar() {
        for values in [vec![1.0; 5], vec![0.0, 1.0, 2.0, 100.0], (0..1000).map(f64::from).collect()] {
            let counts = histogram(&values, "ms");
            let sum: usize = counts
                .iter()
                .map(|line| line.rsplit(' ').next().expect("count").parse::<usize>().expect("number"))
                .sum();
            assert_eq!((counts.len(), sum), (BARS, values.len()));
        }
        assert_eq!(histogram(&[], "ms").len(), 1);
    }
}

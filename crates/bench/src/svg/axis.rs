//! Axes: range, scale and ticks.

use crate::spread::number;

/// Approximate number of ticks on a linear axis.
const TICKS: f64 = 5.0;
/// The most ticks.
const MOST: u32 = 40;

/// The scale of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Scale {
    Linear,
    Logarithmic,
}

/// One axis.
#[derive(Debug, Clone)]
pub struct Axis {
    pub(super) label: String,
    from: f64,
    to: f64,
    scale: Scale,
    /// Value and label.
    pub(super) ticks: Vec<(f64, String)>,
    /// Whether it has named places instead of numbers.
    pub(super) named: bool,
}

impl Axis {
    /// From zero to a round number not less than any of the values.
    pub fn from_zero(label: impl Into<String>, values: impl IntoIterator<Item = f64>) -> Self {
        Self::linear(label.into(), 0.0, limits(values).map_or(1.0, |(_, most)| most))
    }

    /// Between round numbers around the values.
    pub fn around(label: impl Into<String>, values: impl IntoIterator<Item = f64>) -> Self {
        let (least, most) = limits(values).unwrap_or((0.0, 1.0));
        Self::linear(label.into(), least, most)
    }

    /// Between powers of ten around the values above zero.
    pub fn decades(label: impl Into<String>, values: impl IntoIterator<Item = f64>) -> Self {
        let (least, most) = limits(values.into_iter().filter(|value| *value > 0.0)).unwrap_or((1.0, 10.0));
        let first = least.log10().floor();
        let last = most.log10().ceil().max(first + 1.0);
        let powers = (0..MOST).map(|step| first + number(step)).take_while(|power| *power <= last);
        let ticks = powers.map(|power| (10f64.powf(power), short(10f64.powf(power)))).collect();
        let (from, to) = (10f64.powf(first), 10f64.powf(last));
        Self { label: label.into(), from, to, scale: Scale::Logarithmic, ticks, named: false }
    }

    /// A place for each name, in order; the middle of place `n` is at `n + 0.5`. A name may have several lines.
    pub fn places(label: impl Into<String>, names: impl IntoIterator<Item = String>) -> Self {
        let ticks: Vec<_> = names.into_iter().enumerate().map(|(at, name)| (number(at) + 0.5, name)).collect();
        let to = number(ticks.len()).max(1.0);
        Self { label: label.into(), from: 0.0, to, scale: Scale::Linear, ticks, named: true }
    }

    fn linear(label: String, least: f64, most: f64) -> Self {
        let range = if most > least { most - least } else { most.abs().max(1.0) };
        let step = round_step(range / TICKS);
        let (from, to) = ((least / step).floor() * step, (most / step).ceil() * step);
        let to = if to > from { to } else { from + step };
        let end = to + step * 1e-6;
        let values = (0..MOST).map(|tick| from + step * number(tick)).take_while(|value| *value <= end);
        let ticks = values.map(|value| (value, written(value, step))).collect();
        Self { label, from, to, scale: Scale::Linear, ticks, named: false }
    }

    /// The position of a value, as a share of the length; values beyond the ends are at the end.
    pub(super) fn share(&self, value: f64) -> f64 {
        let share = match self.scale {
            Scale::Linear => (value - self.from) / (self.to - self.from),
            Scale::Logarithmic => {
                (value.max(self.from).log10() - self.from.log10()) / (self.to.log10() - self.from.log10())
            }
        };
        share.clamp(0.0, 1.0)
    }
}

/// The least and the greatest of the values that are numbers.
fn limits(values: impl IntoIterator<Item = f64>) -> Option<(f64, f64)> {
    values.into_iter().filter(|value| value.is_finite()).fold(None, |found, value| {
        let (least, most) = found.unwrap_or((value, value));
        Some((value.min(least), value.max(most)))
    })
}

/// 1, 2 or 5 times a power of ten, not less than requested.
fn round_step(asked: f64) -> f64 {
    let power = 10f64.powf(asked.log10().floor());
    let steps = [1.0, 2.0, 5.0].map(|times| times * power);
    steps.into_iter().find(|step| *step >= asked * (1.0 - 1e-9)).unwrap_or(power * 10.0)
}

/// A tick's value with as many decimals as its step needs.
fn written(value: f64, step: f64) -> String {
    if step >= 1000.0 {
        return short(value);
    }
    let decimals = [(1.0, 0), (0.1, 1), (0.01, 2), (0.001, 3)].into_iter().find(|(least, _)| step >= least * 0.999);
    let text = match decimals {
        Some((_, decimals)) => format!("{value:.decimals$}"),
        None => format!("{value:e}"),
    };
    if text.trim_start_matches('-').chars().all(|digit| digit == '0' || digit == '.') { "0".to_owned() } else { text }
}

/// A number in few characters.
pub(super) fn short(value: f64) -> String {
    let (scaled, unit) = match value.abs() {
        size if size >= 999_500_000.0 => (value / 1e9, "G"),
        size if size >= 999_500.0 => (value / 1e6, "M"),
        size if size >= 10_000.0 => (value / 1e3, "k"),
        _ => (value, ""),
    };
    let size = scaled.abs();
    let text = match size {
        size if size >= 100.0 => format!("{scaled:.0}"),
        size if size >= 10.0 => format!("{scaled:.1}"),
        size if size >= 0.1 => format!("{scaled:.2}"),
        size if size >= 0.001 => format!("{scaled:.4}"),
        _ if size > 0.0 => format!("{scaled:.0e}"),
        _ => "0".to_owned(),
    };
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    format!("{text}{unit}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(axis: &Axis) -> Vec<&str> {
        axis.ticks.iter().map(|(_, words)| words.as_str()).collect()
    }

    #[test]
    fn ticks_are_round_and_hold_every_value() {
        let axis = Axis::from_zero("s", [0.7, 3.1, f64::NAN]);
        assert_eq!(words(&axis), ["0", "1", "2", "3", "4"]);
        assert_eq!(words(&Axis::around("ms", [6.19, 6.34])), ["6.15", "6.20", "6.25", "6.30", "6.35"]);
        assert_eq!(words(&Axis::decades("us", [0.05, 0.0, 12.0])), ["0.01", "0.1", "1", "10", "100"]);
        assert_eq!(words(&Axis::from_zero("gas", [5_300_000.0])), ["0", "2M", "4M", "6M"]);
        let same = Axis::around("ms", [5.0, 5.0]);
        assert!(same.ticks.len() >= 2 && same.share(5.0) <= 1.0, "{same:?}");
        assert!(Axis::from_zero("none", []).ticks.len() >= 2);
    }

    #[test]
    fn shares_stay_on_the_axis() {
        let axis = Axis::decades("us", [1.0, 1000.0]);
        for (value, share) in [(0.0, 0.0), (1.0, 0.0), (1000.0, 1.0), (1e9, 1.0), (31.622_776_6, 0.5)] {
            assert!((axis.share(value) - share).abs() < 1e-6, "{value}");
        }
        let places = Axis::places("", ["a", "b"].map(str::to_owned));
        assert!((places.share(0.5) - 0.25).abs() < 1e-9);
    }

    #[test]
    fn numbers_are_short() {
        let said = [0.0, 0.05, 0.5, 12.0, 999.6, 5_000.0, 65_012.0, 5_300_000.0, 3.0e9].map(short);
        assert_eq!(said, ["0", "0.05", "0.5", "12", "1000", "5000", "65k", "5.3M", "3G"]);
    }
}

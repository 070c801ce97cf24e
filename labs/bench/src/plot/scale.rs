//! The axes of a plot: numbers from zero or between two ends, powers of ten, or named places.

use std::ops::Range;

use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use plotters::coord::types::RangedCoordf64;

use crate::spread::number;

/// Labels of an axis of numbers.
const LABELS: usize = 6;
/// The most powers of ten on an axis.
const POWERS: usize = 40;
/// Room above the greatest value, as a share of it.
const ROOM: f64 = 0.08;

/// One axis.
#[derive(Debug, Clone)]
pub struct Axis {
    pub(super) label: String,
    pub(super) scale: Scale,
}

/// How values become positions.
#[derive(Debug, Clone)]
pub enum Scale {
    /// Evenly, from and to.
    Linear(f64, f64),
    /// By their logarithm, from one power of ten to another.
    Decades(f64, f64),
    /// Names; the middle of place `n` is at `n + 0.5`.
    Places(Vec<String>),
}

impl Axis {
    /// From zero to a little more than the greatest of the values.
    pub fn from_zero(label: impl Into<String>, values: impl IntoIterator<Item = f64>) -> Self {
        let most = limits(values).map_or(0.0, |(_, most)| most);
        let most = if most > 0.0 { most * (1.0 + ROOM) } else { 1.0 };
        Self { label: label.into(), scale: Scale::Linear(0.0, most) }
    }

    /// Between two values.
    pub fn between(label: impl Into<String>, from: f64, to: f64) -> Self {
        let scale = if to > from { Scale::Linear(from, to) } else { Scale::Linear(0.0, 1.0) };
        Self { label: label.into(), scale }
    }

    /// Between powers of ten around the values above zero.
    pub fn decades(label: impl Into<String>, values: impl IntoIterator<Item = f64>) -> Self {
        let (least, most) = limits(values.into_iter().filter(|value| *value > 0.0)).unwrap_or((1.0, 10.0));
        let first = least.log10().floor();
        let last = most.log10().ceil().max(first + 1.0);
        Self { label: label.into(), scale: Scale::Decades(10f64.powf(first), 10f64.powf(last)) }
    }

    /// A place for each name, in order.
    pub fn places(label: impl Into<String>, names: impl IntoIterator<Item = String>) -> Self {
        Self { label: label.into(), scale: Scale::Places(names.into_iter().collect()) }
    }

    /// Where bars begin.
    pub(super) fn floor(&self) -> f64 {
        self.scale.range().start
    }

    /// The most labels.
    pub(super) fn labels(&self) -> usize {
        match &self.scale {
            Scale::Linear(..) => LABELS,
            Scale::Decades(..) => POWERS,
            Scale::Places(names) => names.len(),
        }
    }

    /// The label of a position.
    pub(super) fn written(&self, value: f64) -> String {
        self.scale.format_ext(&value)
    }
}

impl Ranged for Scale {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, pixels: (i32, i32)) -> i32 {
        let Range { start, end } = self.range();
        let share = match self {
            Self::Decades(..) => (value.max(start).log10() - start.log10()) / (end.log10() - start.log10()),
            Self::Linear(..) | Self::Places(_) => (value - start) / (end - start),
        };
        RangedCoordf64::from(0.0..1.0).map(&share.clamp(0.0, 1.0), pixels)
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        match self {
            Self::Linear(from, to) => RangedCoordf64::from(*from..*to).key_points(hint),
            Self::Decades(from, to) => {
                let powers = (0..POWERS).map(|step| from * 10f64.powf(number(step)));
                powers.take_while(|power| *power <= to * 1.001).collect()
            }
            Self::Places(names) => (0..names.len()).map(|place| number(place) + 0.5).collect(),
        }
    }

    fn range(&self) -> Range<f64> {
        match self {
            Self::Linear(from, to) | Self::Decades(from, to) => *from..*to,
            Self::Places(names) => 0.0..number(names.len()).max(1.0),
        }
    }
}

impl ValueFormatter<f64> for Scale {
    fn format_ext(&self, value: &f64) -> String {
        match self {
            Self::Linear(..) | Self::Decades(..) => short(*value),
            Self::Places(names) => {
                let place = (0..names.len()).find(|place| (number(*place) + 0.5 - value).abs() < 0.25);
                place.and_then(|place| names.get(place)).cloned().unwrap_or_default()
            }
        }
    }
}

/// The least and the greatest of the values that are numbers.
fn limits(values: impl IntoIterator<Item = f64>) -> Option<(f64, f64)> {
    values.into_iter().filter(|value| value.is_finite()).fold(None, |found, value| {
        let (least, most) = found.unwrap_or((value, value));
        Some((value.min(least), value.max(most)))
    })
}

/// A number in few characters.
pub(super) fn short(value: f64) -> String {
    let (scaled, unit) = match value.abs() {
        size if size >= 999_500_000.0 => (value / 1e9, "G"),
        size if size >= 999_500.0 => (value / 1e6, "M"),
        size if size >= 10_000.0 => (value / 1e3, "k"),
        _ => (value, ""),
    };
    let text = match scaled.abs() {
        size if size >= 100.0 => format!("{scaled:.0}"),
        size if size >= 10.0 => format!("{scaled:.1}"),
        size if size >= 0.1 => format!("{scaled:.2}"),
        size if size >= 0.001 => format!("{scaled:.4}"),
        size if size > 1e-12 => format!("{scaled:.0e}"),
        _ => "0".to_owned(),
    };
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    format!("{text}{unit}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(axis: &Axis) -> Vec<String> {
        axis.scale.key_points(axis.labels()).into_iter().map(|value| axis.written(value)).collect()
    }

    #[test]
    fn labels_are_round_and_the_axis_holds_every_value() {
        assert_eq!(words(&Axis::from_zero("s", [0.7, 3.1, f64::NAN])), ["0", "1", "2", "3"]);
        assert_eq!(words(&Axis::decades("us", [0.05, 0.0, 12.0])), ["0.01", "0.1", "1", "10", "100"]);
        assert_eq!(words(&Axis::places("", ["a", "b"].map(str::to_owned))), ["a", "b"]);
        assert_eq!(Axis::from_zero("none", []).scale.range(), 0.0..1.0);
        assert_eq!(Axis::between("ms", f64::NAN, 5.0).scale.range(), 0.0..1.0);
    }

    #[test]
    fn positions_stay_on_the_axis() {
        let axis = Axis::decades("us", [1.0, 1000.0]);
        for (value, pixel) in [(0.0, 0), (1.0, 0), (1000.0, 300), (1e9, 300), (31.622_776_6, 150)] {
            assert_eq!(axis.scale.map(&value, (0, 300)), pixel, "{value}");
        }
        let places = Axis::places("", ["a", "b"].map(str::to_owned));
        assert_eq!(places.scale.map(&0.5, (0, 100)), 25);
    }

    #[test]
    fn numbers_are_short() {
        let said = [0.0, 0.05, 0.5, 12.0, 999.6, 5_000.0, 65_012.0, 5_300_000.0, 3.0e9].map(short);
        assert_eq!(said, ["0", "0.05", "0.5", "12", "1000", "5000", "65k", "5.3M", "3G"]);
    }
}

//! The spread of measured values: least, median, 95th percentile, greatest.

use serde::Serialize;

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
}

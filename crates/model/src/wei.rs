//! Amounts of ether, and prices of gas.

use std::fmt;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error as _};

const GWEI: u128 = 1_000_000_000;
const ETHER: u128 = GWEI * GWEI;

/// An amount in wei. In JSON it is a decimal string, since it exceeds what JSON numbers hold; for people it is in wei,
/// gwei or ether, cut after six decimals.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Wei(pub u128);

impl fmt::Display for Wei {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (unit, word) = match self.0 {
            0..1_000_000 => return write!(f, "{} wei", self.0),
            1_000_000..1_000_000_000_000_000 => (GWEI, "gwei"),
            _ => (ETHER, "ether"),
        };
        let part = self.0 % unit / (unit / 1_000_000);
        let number = format!("{}.{part:06}", self.0 / unit);
        write!(f, "{} {word}", number.trim_end_matches('0').trim_end_matches('.'))
    }
}

impl Serialize for Wei {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(&self.0)
    }
}

impl<'de> Deserialize<'de> for Wei {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        text.parse().map(Self).map_err(|_| D::Error::custom("an amount in wei is a decimal number in quotes"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn amounts_have_the_unit_that_suits_them() {
        for (wei, text) in [
            (0, "0 wei"),
            (999_999, "999999 wei"),
            (1_000_000, "0.001 gwei"),
            (1_875_000_000, "1.875 gwei"),
            (100 * GWEI, "100 gwei"),
            (2 * ETHER / 1_000, "0.002 ether"),
            (5 * ETHER + ETHER / 2, "5.5 ether"),
            (100 * ETHER, "100 ether"),
            (u128::MAX, "340282366920938463463.374607 ether"),
        ] {
            assert_eq!(Wei(wei).to_string(), text);
            let json = serde_json::to_string(&Wei(wei)).expect("json");
            assert_eq!(
                (json.as_str(), serde_json::from_str(&json).ok()),
                (format!("\"{wei}\"").as_str(), Some(Wei(wei)))
            );
        }
        assert!(serde_json::from_str::<Wei>("\"-1\"").is_err());
    }
}

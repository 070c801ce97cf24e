//! How a chain agrees on its next block, in the terms of the setting `chain.consensus`.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::display::clean;

/// How an embedded chain seals its blocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Consensus {
    /// Proof of authority as in Clique (EIP-225): signers take turns.
    Poa {
        /// Number of signers, 1 to 16.
        signers: u8,
        /// The least time between two blocks, whole milliseconds, at most 10 minutes.
        period: Duration,
    },
    /// Proof of work: Keccak-256 over seal hash and nonce, at a fixed difficulty. It is not ethash.
    Pow {
        /// Average number of hashes per block, 1 to 2^40.
        difficulty: u64,
    },
}

/// Why a text is not a consensus.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "'{0}' is not a valid consensus; choose poa, poa:SIGNERS:PERIOD_MS (1 to 16 signers, up to 600000 ms), pow, or \
     pow:DIFFICULTY (1 to 2^40, decimal or 0x and hex)"
)]
pub struct ConsensusError(String);

impl Consensus {
    /// The difficulty of the paper's proof-of-work network.
    pub const PAPER_DIFFICULTY: u64 = 0x4c_ccc8;
    /// The paper's proof of work.
    pub const POW: Self = Self::Pow { difficulty: Self::PAPER_DIFFICULTY };
    /// One signer; a block as soon as a transaction waits, at most every 100 ms.
    pub const POA: Self = Self::Poa { signers: 1, period: Duration::from_millis(100) };
    /// The most signers.
    pub const MOST_SIGNERS: u8 = 16;
    /// The longest period.
    pub const LONGEST_PERIOD: Duration = Duration::from_secs(600);
    /// The highest difficulty.
    pub const HIGHEST_DIFFICULTY: u64 = 1 << 40;

    /// `poa` or `pow`.
    pub fn word(&self) -> &'static str {
        match self {
            Self::Poa { .. } => "poa",
            Self::Pow { .. } => "pow",
        }
    }

    fn parse(text: &str) -> Option<Self> {
        let mut parts = text.split(':');
        let parsed = match (parts.next()?, parts.next(), parts.next()) {
            ("poa", None, _) => Self::POA,
            ("poa", Some(signers), Some(period)) => {
                Self::Poa { signers: number(signers)?.try_into().ok()?, period: Duration::from_millis(number(period)?) }
            }
            ("pow", None, _) => Self::POW,
            ("pow", Some(difficulty), None) => Self::Pow { difficulty: number(difficulty)? },
            _ => return None,
        };
        (parts.next().is_none() && parsed.is_usable()).then_some(parsed)
    }

    /// Whether its figures are within the limits of their fields.
    pub fn is_usable(&self) -> bool {
        match self {
            Self::Poa { signers, period } => {
                let whole = Duration::from_millis(u64::try_from(period.as_millis()).unwrap_or(u64::MAX)) == *period;
                (1..=Self::MOST_SIGNERS).contains(signers) && whole && *period <= Self::LONGEST_PERIOD
            }
            Self::Pow { difficulty } => (1..=Self::HIGHEST_DIFFICULTY).contains(difficulty),
        }
    }
}

/// Plain digits, or `0x` and hex digits; no sign, no spaces.
fn number(text: &str) -> Option<u64> {
    let (digits, radix) = text.strip_prefix("0x").map_or((text, 10), |hex| (hex, 16));
    digits.chars().all(|digit| digit.is_digit(radix)).then(|| u64::from_str_radix(digits, radix).ok())?
}

impl Default for Consensus {
    fn default() -> Self {
        Self::POA
    }
}

impl fmt::Display for Consensus {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Poa { signers, period } => write!(formatter, "poa:{signers}:{}", period.as_millis()),
            Self::Pow { difficulty } => write!(formatter, "pow:{difficulty}"),
        }
    }
}

impl FromStr for Consensus {
    type Err = ConsensusError;

    fn from_str(text: &str) -> Result<Self, ConsensusError> {
        Self::parse(text).ok_or_else(|| ConsensusError(clean(text, 40)))
    }
}

impl TryFrom<String> for Consensus {
    type Error = ConsensusError;

    fn try_from(text: String) -> Result<Self, ConsensusError> {
        text.parse()
    }
}

impl From<Consensus> for String {
    fn from(consensus: Consensus) -> Self {
        consensus.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn words() {
        let three = Consensus::Poa { signers: 3, period: Duration::from_secs(2) };
        for (text, expected) in [
            ("poa", Consensus::POA),
            ("poa:1:100", Consensus::POA),
            ("poa:3:2000", three),
            ("pow", Consensus::POW),
            ("pow:5033160", Consensus::POW),
            ("pow:0x4cccc8", Consensus::POW),
            ("pow:1", Consensus::Pow { difficulty: 1 }),
        ] {
            assert_eq!(text.parse(), Ok(expected), "{text}");
        }
        for bad in [
            "",
            "pos",
            "poa:",
            "poa:3",
            "poa:0:5",
            "poa:17:5",
            "poa:3:600001",
            "poa:3:5:1",
            "poa:+3:5",
            "pow:",
            "pow:0",
            "pow:0x",
            "pow:-1",
            "pow:1:1",
            "pow:1099511627777",
            "POA",
            " poa",
        ] {
            assert!(bad.parse::<Consensus>().is_err(), "{bad}");
        }
        let error = "pow\u{1b}[2J".parse::<Consensus>().expect_err("no consensus");
        assert!(!error.to_string().contains('\u{1b}') && error.to_string().contains("pow:DIFFICULTY"));
    }

    proptest! {
        #[test]
        fn text_and_json_round_trip(poa: bool, signers in 1u8..=16, period in 0u64..=600_000, difficulty in 1u64..=1 << 40) {
            let period = Duration::from_millis(period);
            let consensus = if poa { Consensus::Poa { signers, period } } else { Consensus::Pow { difficulty } };
            prop_assert_eq!(consensus.to_string().parse(), Ok(consensus));
            let json = serde_json::to_string(&consensus).expect("json");
            prop_assert_eq!(serde_json::from_str::<Consensus>(&json).expect("consensus"), consensus);
        }

        #[test]
        fn noise_never_panics(noise in "(poa|pow|:|0x|[0-9]|.){0,12}") {
            let _ = noise.parse::<Consensus>();
        }
    }
}

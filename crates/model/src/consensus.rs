//! How a chain agrees on its next block, in the terms of the setting `chain.consensus`.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use crate::Digest;
use crate::display::clean;
use crate::text::as_text;
use crate::wire::{Wire as _, WireError};

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Consensus {
    /// Proof of authority as in Clique (EIP-225), 1 to 16 signers. Period: least time between blocks, whole ms.
    Poa { signers: u8, period: Duration },
    /// Proof of work, not ethash: Keccak-256 over seal hash and nonce; 1 to 2^40 hashes per block on average.
    Pow { difficulty: u64 },
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "'{0}' is not a valid consensus; choose poa, poa:SIGNERS:PERIOD_MS (1 to 16 signers, up to 600000 ms), pow, or \
     pow:DIFFICULTY (1 to 2^40, decimal or 0x and hex)"
)]
pub struct ConsensusError(String);

impl Consensus {
    /// The difficulty of the paper's proof-of-work network.
    pub const PAPER_DIFFICULTY: u64 = 0x4c_ccc8;
    pub const POW: Self = Self::Pow { difficulty: Self::PAPER_DIFFICULTY };
    /// One signer; a block as soon as a transaction waits, at most every 100 ms.
    pub const POA: Self = Self::Poa { signers: 1, period: Duration::from_millis(100) };
    pub const MOST_SIGNERS: u8 = 16;
    pub const LONGEST_PERIOD: Duration = Duration::from_secs(600);
    pub const HIGHEST_DIFFICULTY: u64 = 1 << 40;

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

as_text!(Consensus);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AnchorMode {
    /// The Merkle root of a batch in one transaction.
    Batch,
    /// The paper's dataUpload: one transaction per record.
    Each,
}

// Head of a home's audit log, anchored on the chain while the log changes.

const LABEL: [u8; 20] = *b"AuthROS/audit-head/1";

/// `label (20) || line (8) || hash (32) || previous line (8) || previous hash (32)`, big endian.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AuditHead {
    pub line: u64,
    pub hash: Digest,
    /// Line of the head that this owner anchored before; 0 = none.
    pub previous_line: u64,
    /// Zeros if there is none.
    pub previous_hash: Digest,
}

crate::layout!(AuditHead {
    line: "line",
    hash: "hash",
    previous_line: "previous line",
    previous_hash: "previous hash",
});

impl AuditHead {
    pub fn encode(&self) -> Vec<u8> {
        self.behind(&LABEL)
    }

    /// Refuses a head that does not continue the previous one.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let head = Self::whole_behind(&LABEL, "label", bytes)?;
        if head.line <= head.previous_line {
            return Err(WireError::Value("line"));
        }
        Ok(head)
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

#[cfg(test)]
mod audit_head_tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_is_written_is_read_and_nothing_else(previous in 0u64..9, more in 1u64..9, hash: [u8; 32], other: [u8; 32], noise: Vec<u8>) {
            let (hash, previous_hash) = (Digest(hash), Digest(other));
            let head = AuditHead { line: previous + more, hash, previous_line: previous, previous_hash };
            let bytes = head.encode();
            prop_assert_eq!((bytes.len(), AuditHead::parse(&bytes)), (100, Ok(head)));
            prop_assert!((0..bytes.len()).all(|cut| AuditHead::parse(&bytes[..cut]).is_err()));
            prop_assert!(AuditHead::parse(&[bytes, vec![0]].concat()).is_err());
            prop_assert!(AuditHead::parse(&noise).is_err());
            let back = AuditHead { line: previous, ..head };
            prop_assert!(AuditHead::parse(&back.encode()).is_err(), "a head goes on from the one before");
        }
    }
}

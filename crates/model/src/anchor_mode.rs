//! How digests are put on the chain.

use std::fmt;
use std::str::FromStr;

/// The two ways of anchoring.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum AnchorMode {
    /// The Merkle root of a batch in one transaction.
    #[default]
    Batch,
    /// The paper's dataUpload: one transaction per record.
    Each,
}

/// The word does not name a mode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("choose batch (Merkle roots) or each (one dataUpload per record)")]
pub struct AnchorModeError;

impl FromStr for AnchorMode {
    type Err = AnchorModeError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "batch" => Ok(Self::Batch),
            "each" => Ok(Self::Each),
            _ => Err(AnchorModeError),
        }
    }
}

impl fmt::Display for AnchorMode {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Batch => "batch",
            Self::Each => "each",
        })
    }
}

//! Who seals the blocks of a chain, worded for readers who must trust them: an anchor proves no more than that they
//! agreed, and a block's time is their clock.

use serde::{Deserialize, Serialize};

use super::{Chain, ChainError};

/// The kind of sealers a chain has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SealerKind {
    /// One AuthROS program, with all keys in its home.
    Embedded,
    /// A development node: whoever runs it sets blocks and times.
    Development,
    /// Named accounts, under proof of authority.
    Authority,
    /// Proof of work.
    Work,
    /// Not reported by the node.
    Unknown,
}

/// Who seals a chain, as reported by its node.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SealedBy {
    /// The kind of sealers.
    pub kind: SealerKind,
    /// Whether a single party decides about blocks and their times.
    pub alone: bool,
    /// In words.
    pub text: String,
}

impl SealedBy {
    /// The embedded chain's.
    pub fn embedded() -> Self {
        let text = "an embedded AuthROS chain: a single program seals it, its keys are in the home of the person who \
                    runs it, and block times are that machine's clock";
        Self { kind: SealerKind::Embedded, alone: true, text: text.to_owned() }
    }

    /// What clientVersion, consensus and the list of sealers say.
    fn of(client: &str, consensus: &str, sealers: usize, difficulty: Option<&str>) -> Self {
        if client.starts_with("AuthROS/") {
            return Self::embedded();
        }
        let (kind, alone, text) = match consensus {
            "dev" => (
                SealerKind::Development,
                true,
                format!("a development node ({client}): the person who runs it decides on blocks and their times"),
            ),
            "poa" if sealers == 1 => (
                SealerKind::Authority,
                true,
                "proof of authority by a single account, according to its node".to_owned(),
            ),
            "poa" if sealers > 1 => (
                SealerKind::Authority,
                false,
                format!("proof of authority by {sealers} accounts, according to its node"),
            ),
            "pow" => {
                let difficulty = difficulty.unwrap_or("unknown");
                (SealerKind::Work, false, format!("proof of work with difficulty {difficulty}, according to its node"))
            }
            _ => (SealerKind::Unknown, false, format!("not stated by its node ({client})")),
        };
        Self { kind, alone, text }
    }
}

impl Chain {
    /// Who seals this chain, as the node reports it: the caller has to trust that node.
    ///
    /// # Errors
    /// Errors of the node.
    pub async fn sealed_by(&self) -> Result<SealedBy, ChainError> {
        let sealing = self.sealing().await?;
        let (client, consensus) = (&self.inner.client, self.inner.consensus);
        Ok(SealedBy::of(client, consensus, sealing.sealers.len(), sealing.difficulty.as_deref()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_who_decides_alone_is_told_from_several() {
        for (client, consensus, sealers, kind, alone) in [
            ("AuthROS/v0.1.0/embedded (proof of authority)", "poa", 3, SealerKind::Embedded, true),
            ("AuthROS/v0.1.0/embedded (proof of work by Keccak-256, not ethash)", "pow", 0, SealerKind::Embedded, true),
            ("anvil/v1.0", "dev", 0, SealerKind::Development, true),
            ("Geth/v1.10", "poa", 1, SealerKind::Authority, true),
            ("Geth/v1.10", "poa", 4, SealerKind::Authority, false),
            ("Geth/v1.10", "poa", 0, SealerKind::Unknown, false),
            ("Geth/v1.10", "pow", 0, SealerKind::Work, false),
            ("Geth/v1.13", "pos", 0, SealerKind::Unknown, false),
        ] {
            let found = SealedBy::of(client, consensus, sealers, None);
            assert_eq!((found.kind, found.alone), (kind, alone), "{client} {consensus}");
            assert!(!found.text.is_empty());
        }
    }
}

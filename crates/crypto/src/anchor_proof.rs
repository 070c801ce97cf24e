//! Proof that a record is anchored, carried with the record.

use crate::merkle::{Inclusion, LONGEST_PATH};
use crate::model::wire::{Reader, WireError};
use crate::model::{Address, Hash};

const VERSION: u8 = 1;

/// Where a record was anchored: version (1) || account (20) || transaction (32) || block (8) || block hash (32) ||
/// batched (1). For a batched record it continues: index (8) || leaves (8) || root (32) || steps (1) || 32 bytes a
/// step.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AnchorProof {
    /// Who anchored it.
    pub account: Address,
    /// The transaction.
    pub transaction: Hash,
    /// The number of its block.
    pub block: u64,
    /// That block's hash.
    pub block_hash: Hash,
    /// The record's place in its batch; `None` if its digest was uploaded on its own.
    pub inclusion: Option<Inclusion>,
}

impl AnchorProof {
    /// Its encoding.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = vec![VERSION];
        for part in [&self.account.0[..], &self.transaction.0, &self.block.to_be_bytes(), &self.block_hash.0] {
            out.extend_from_slice(part);
        }
        out.push(u8::from(self.inclusion.is_some()));
        if let Some(inclusion) = &self.inclusion {
            let path = &inclusion.path[..inclusion.path.len().min(LONGEST_PATH)];
            out.extend_from_slice(&inclusion.index.to_be_bytes());
            out.extend_from_slice(&inclusion.count.to_be_bytes());
            out.extend_from_slice(&inclusion.root.0);
            out.push(u8::try_from(path.len()).unwrap_or(0));
            path.iter().for_each(|step| out.extend_from_slice(&step.0));
        }
        out
    }

    /// From its encoding; each proof has exactly one.
    ///
    /// # Errors
    /// [`WireError`], with the field that is wrong.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(bytes);
        if reader.u8("version")? != VERSION {
            return Err(WireError::Value("version"));
        }
        let account = Address(reader.array("account")?);
        let transaction = Hash(reader.array("transaction")?);
        let block = reader.u64("block")?;
        let block_hash = Hash(reader.array("block hash")?);
        let inclusion = match reader.u8("batched")? {
            0 => None,
            1 => Some(inclusion(&mut reader)?),
            _ => return Err(WireError::Value("batched")),
        };
        reader.end()?;
        Ok(Self { account, transaction, block, block_hash, inclusion })
    }
}

fn inclusion(reader: &mut Reader<'_>) -> Result<Inclusion, WireError> {
    let (index, count) = (reader.u64("index")?, reader.u64("leaves")?);
    let root = Hash(reader.array("root")?);
    let steps = usize::from(reader.u8("steps")?);
    if steps > LONGEST_PATH {
        return Err(WireError::Value("steps"));
    }
    let path = (0..steps).map(|_| reader.array("step").map(Hash)).collect::<Result<_, _>>()?;
    Ok(Inclusion { index, count, path, root })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn proof(steps: Option<usize>) -> AnchorProof {
        let hash = |byte: usize| Hash([u8::try_from(byte).expect("small"); 32]);
        AnchorProof {
            account: Address([1; 20]),
            transaction: hash(2),
            block: 3,
            block_hash: hash(4),
            inclusion: steps.map(|steps| Inclusion {
                index: 5,
                count: 6,
                path: (0..steps).map(hash).collect(),
                root: hash(7),
            }),
        }
    }

    #[test]
    fn another_version_is_refused() {
        for version in [0, 2, 255] {
            let mut bytes = proof(Some(2)).encode();
            bytes[0] = version;
            assert_eq!(AnchorProof::parse(&bytes), Err(WireError::Value("version")), "{version}");
        }
    }

    #[test]
    fn proofs_round_trip_and_every_cut_is_refused() {
        for steps in [None, Some(0), Some(1), Some(LONGEST_PATH)] {
            let bytes = proof(steps).encode();
            assert_eq!(AnchorProof::parse(&bytes), Ok(proof(steps)));
            assert!((0..bytes.len()).all(|length| AnchorProof::parse(&bytes[..length]).is_err()));
            assert!(AnchorProof::parse(&[&bytes[..], &[0]].concat()).is_err());
        }
    }

    proptest! {
        #[test]
        fn what_parses_is_what_was_written(bytes in proptest::collection::vec(any::<u8>(), 0..700), steps in 0usize..20) {
            let mut like = proof(Some(steps.min(LONGEST_PATH))).encode();
            like.truncate(94);
            for candidate in [bytes.clone(), [like, bytes].concat()] {
                if let Ok(parsed) = AnchorProof::parse(&candidate) {
                    prop_assert_eq!(parsed.encode(), candidate);
                }
            }
        }
    }
}

//! Proof that a record is anchored, carried with the record.

use crate::merkle::{Inclusion, LONGEST_PATH};
use crate::model::wire::{Reader, Wire, WireError, put_list, read_list};
use crate::model::{Address, Hash, body, layout};

const VERSION: u8 = 1;

/// version (1) || account (20) || transaction (32) || block (8) || block hash (32) || batched (1), and of a batched
/// record: index (8) || leaves (8) || root (32) || steps (1) || 32 bytes a step.
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

layout!(AnchorProof {
    account: "account",
    transaction: "transaction",
    block: "block",
    block_hash: "block hash",
    inclusion: "batched",
});
body!(AnchorProof behind &[VERSION], "version");

impl Wire for Inclusion {
    fn put(&self, out: &mut Vec<u8>) {
        (self.index, self.count, self.root).put(out);
        put_list::<u8>(out, &self.path, LONGEST_PATH);
    }

    fn read(reader: &mut Reader<'_>, _: &'static str) -> Result<Self, WireError> {
        let (index, count, root) = (reader.u64("index")?, reader.u64("leaves")?, Wire::read(reader, "root")?);
        let path = read_list::<u8, _>(reader, 0..=LONGEST_PATH, ("steps", "step"))?;
        Ok(Self { index, count, path, root })
    }
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

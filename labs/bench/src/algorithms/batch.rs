//! The cost per record of signatures over batches, in a hypothetical version: one signature over the root of many
//! records' leaves, and each record's path to it.

use std::hint::black_box;

use super::work::{Piece, piece};
use authros_chain::merkle::{Inclusion, Leaf, Tree};
use authros_crypto::{Provider, SmKeyPair};
use authros_model::{Address, Digest, RecorderId, Signature, SignerId, TopicId};
use authros_service::Failure;
use authros_service::reply::internal;

/// Records of a batch.
const SIZES: [(&str, u32); 3] = [("authros-batch-16", 16), ("authros-batch-64", 64), ("authros-batch-256", 256)];

/// Records of one topic, bound together and signed once.
pub(super) struct Batch {
    by: &'static str,
    records: u32,
    leaves: Vec<Leaf>,
    places: Vec<Inclusion>,
    signature: Signature,
}

impl Batch {
    /// One of each size.
    pub fn all(provider: &'static dyn Provider, signer: &SmKeyPair) -> Result<Vec<Self>, Failure> {
        let one = |(by, records): (&'static str, u32)| {
            let leaf = |number: u32| Leaf {
                owner: Address([2; 20]),
                signer: SignerId([3; 32]),
                recorder: RecorderId([4; 16]),
                topic_id: TopicId([5; 16]),
                seq: u64::from(number) + 1,
                digest: Digest(provider.sm3(&[&number.to_be_bytes()])),
            };
            let leaves: Vec<Leaf> = (0..records).map(leaf).collect();
            let places = bind(&leaves)?;
            let signature = provider.sign(&signer.secret, &root(&places))?;
            Ok(Self { by, records, leaves, places, signature })
        };
        SIZES.into_iter().map(one).collect()
    }

    /// Signing and verifying it, timed per record.
    pub fn pieces<'a>(&'a self, provider: &'static dyn Provider, signer: &'a SmKeyPair) -> [Piece<'a>; 2] {
        let sign = move || {
            let places = black_box(bind(black_box(&self.leaves))?);
            Ok(provider.sign(&signer.secret, &root(&places))?.0.to_vec())
        };
        let verify = move || {
            let lead = |(leaf, place): (&Leaf, &Inclusion)| black_box(place).proves(leaf);
            if !self.leaves.iter().zip(&self.places).all(lead) {
                return Err(internal("a path"));
            }
            provider.verify(&signer.public, &root(&self.places), &self.signature)?;
            Ok(Vec::new())
        };
        let messages = self.records;
        [Piece { messages, ..piece("sign", self.by, sign) }, Piece { messages, ..piece("verify", self.by, verify) }]
    }
}

/// Each leaf's path under their root.
fn bind(leaves: &[Leaf]) -> Result<Vec<Inclusion>, Failure> {
    let tree = Tree::new(Leaf::hashes(leaves)).ok_or_else(|| internal("a batch"))?;
    let (root, count) = (tree.root(), leaves.len() as u64);
    Ok((0..leaves.len()).map(|at| Inclusion { index: at as u64, count, path: tree.path(at), root }).collect())
}

fn root(places: &[Inclusion]) -> [u8; 32] {
    places.first().map_or([0; 32], |place| place.root.0)
}

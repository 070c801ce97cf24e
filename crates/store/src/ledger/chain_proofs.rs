//! Proofs of the chain for anchored batches, and time stamps over their roots.

use std::path::PathBuf;

use super::rows::{optional, unsigned};
use super::{Proofs, Session};
use crate::StoreError;
use crate::database::{capped, count, whole};
use crate::model::{Address, Hash, SignerId, Timestamp};
use crate::sql::{Connection, params};

/// Of `batches.proof`.
const KEPT: i64 = 1;
const MISSED: i64 = 2;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnprovenBatch {
    pub key: u64,
    pub account: Address,
    pub root: Hash,
    pub block: u64,
    pub block_hash: Hash,
    /// Owners of its records, each with a signer.
    pub signers: Vec<(Address, SignerId)>,
}

/// With its Keccak-256.
pub type HashedNode = (Hash, Vec<u8>);

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptProof {
    pub hash: Hash,
    /// Of the tries of state and storage.
    pub nodes: Vec<Vec<u8>>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ProofCounts {
    pub newest: Option<u64>,
    /// Batches whose proof could not be had while the node had the state.
    pub missed: u64,
}

impl Proofs {
    /// In blocks up to this one, newest first.
    pub fn unproven_batches(&self, up_to_block: u64, limit: usize) -> Result<Vec<UnprovenBatch>, StoreError> {
        let (up_to, limit) = (whole("block", up_to_block)?, capped(limit));
        self.0.read(|connection| {
            let sql = "SELECT key, account, root, block, block_hash FROM batches INDEXED BY batches_unproven
                WHERE block IS NOT NULL AND proof IS NULL AND block <= ?1 AND account IS NOT NULL
                AND block_hash IS NOT NULL ORDER BY block DESC LIMIT ?2";
            let mut batches: Vec<UnprovenBatch> = connection.list(sql, params![up_to, limit], |row| {
                let (account, root, block_hash) = (Address(row.get(1)?), Hash(row.get(2)?), Hash(row.get(4)?));
                let (key, block) = (unsigned(row, 0)?, unsigned(row, 3)?);
                Ok(UnprovenBatch { key, account, root, block, block_hash, signers: Vec::new() })
            })?;
            for batch in &mut batches {
                batch.signers = signers(connection, whole("batch", batch.key)?)?;
            }
            Ok(batches)
        })
    }

    /// Stores the nodes that prove these batches, all in this block. Skips batches that have left the block.
    pub fn keep_chain_proof(
        &self,
        (block, hash): (u64, Hash),
        header: Vec<u8>,
        batches: Vec<u64>,
        nodes: Vec<HashedNode>,
    ) -> Result<(), StoreError> {
        let block = whole("block", block)?;
        self.0.write(move |Session { connection, .. }| {
            let sql = "SELECT nodes FROM chain_proofs WHERE block = ?1 AND hash = ?2";
            let before: Option<Vec<u8>> = connection.find(sql, params![block, hash.0], |row| row.get(0))?;
            let mut keys = before.unwrap_or_default();
            for (name, node) in &nodes {
                let key = node_key(connection, *name, node)?.to_be_bytes();
                if !keys.chunks_exact(8).any(|known| known == key) {
                    keys.extend(key);
                }
            }
            let sql = "INSERT INTO chain_proofs (block, hash, nodes) VALUES (?1, ?2, ?3)
                ON CONFLICT (block) DO UPDATE SET hash = excluded.hash, nodes = excluded.nodes";
            connection.run(sql, params![block, hash.0, keys])?;
            keep_header(connection, block, &header)?;
            let sql = "UPDATE batches SET proof = ?2 WHERE key = ?1 AND block = ?3 AND block_hash = ?4";
            connection.run_each(sql, batches.iter().map(|batch| (capped(*batch), KEPT, block, hash.0)))?;
            Ok(())
        })
    }

    /// `header`: RLP.
    pub fn keep_chain_header(&self, block: u64, header: Vec<u8>) -> Result<(), StoreError> {
        let block = whole("block", block)?;
        self.0.write(move |session| keep_header(session.connection, block, &header))
    }

    /// RLP.
    pub fn chain_header(&self, block: u64) -> Result<Option<Vec<u8>>, StoreError> {
        let block = whole("block", block)?;
        self.0.find("SELECT header FROM chain_headers WHERE block = ?1", [block], |row| row.get(0))
    }

    /// Counts batches whose proof could not be had; they are not requested again.
    pub fn miss_chain_proof(&self, batches: Vec<u64>) -> Result<(), StoreError> {
        let sql = "UPDATE batches SET proof = ?2 WHERE key = ?1 AND block IS NOT NULL AND proof IS NULL";
        self.0.run_each(sql, batches.into_iter().map(|batch| (capped(batch), MISSED)).collect()).map(drop)
    }

    pub fn chain_proof(&self, block: u64) -> Result<Option<KeptProof>, StoreError> {
        let block = whole("block", block)?;
        self.0.read(|connection| {
            let sql = "SELECT hash, nodes FROM chain_proofs WHERE block = ?1";
            let found = connection.find(sql, [block], |row| Ok((Hash(row.get(0)?), row.get::<Vec<u8>>(1)?)))?;
            let Some((hash, keys)) = found else { return Ok(None) };
            let mut find = connection.prepared("SELECT node FROM chain_nodes WHERE key = ?1")?;
            let (keys, rest) = keys.as_chunks::<8>();
            if !rest.is_empty() {
                let detail = format!("the proof kept for block {block} is cut short");
                return Err(StoreError::Corrupt { file: PathBuf::new(), detail });
            }
            let keys = keys.iter().map(|key| i64::from_be_bytes(*key));
            let nodes = keys.map(|key| find.one([key], |row| row.get(0))).collect::<Result<_, _>>()?;
            Ok(Some(KeptProof { hash, nodes }))
        })
    }

    pub fn chain_proof_counts(&self) -> Result<ProofCounts, StoreError> {
        let sql = "SELECT (SELECT max(block) FROM chain_proofs),
            (SELECT count(*) FROM batches INDEXED BY batches_without_proof WHERE proof = 2)";
        self.0.one(sql, [], |row| Ok(ProofCounts { newest: optional(row, 0)?, missed: unsigned(row, 1)? }))
    }
}

fn signers(connection: &Connection, batch: i64) -> Result<Vec<(Address, SignerId)>, StoreError> {
    let sql = "SELECT DISTINCT topics.owner, recorders.signer FROM leaves JOIN records ON records.n = leaves.record
        JOIN streams ON streams.key = records.stream JOIN topics ON topics.key = streams.topic
        JOIN recorders ON recorders.key = topics.recorder WHERE leaves.batch = ?1";
    Ok(connection.list(sql, [batch], |row| Ok((Address(row.get(0)?), SignerId(row.get(1)?))))?)
}

fn keep_header(connection: &Connection, block: i64, header: &[u8]) -> Result<(), StoreError> {
    let sql = "INSERT INTO chain_headers (block, header) VALUES (?1, ?2)
        ON CONFLICT (block) DO UPDATE SET header = excluded.header";
    connection.run(sql, params![block, header])
}

fn node_key(connection: &Connection, hash: Hash, node: &[u8]) -> Result<i64, StoreError> {
    let known = connection.find("SELECT key FROM chain_nodes WHERE hash = ?1", [hash.0], |row| row.get(0))?;
    if let Some(key) = known {
        return Ok(key);
    }
    let sql = "INSERT INTO chain_nodes (hash, node) VALUES (?1, ?2)";
    Ok(connection.inserted(sql, "key", params![hash.0, node])?)
}

/// Stamps requested from an authority that was added later.
const NEWEST: i64 = 48;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptStamp {
    pub key: u64,
    pub roots: Vec<Hash>,
    /// DER, by the authorities' certificates.
    pub tokens: Vec<Vec<u8>>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StampCounts {
    /// By at least one authority.
    pub stamped: u64,
    pub waiting: u64,
    /// When the newest began.
    pub newest: Option<Timestamp>,
    /// The end of the newest token's time.
    pub before: Option<Timestamp>,
}

impl Proofs {
    /// Stamps the oldest `most` of the batches closed since the last stamp; returns how many.
    pub fn begin_stamp(&self, most: usize, at: Timestamp) -> Result<u64, StoreError> {
        let (most, at) = (capped(most), whole("time", at.0)?);
        self.0.write(move |Session { connection, .. }| {
            let sql = "SELECT key, root FROM batches WHERE key > coalesce((SELECT max(upto) FROM stamps), 0)
                ORDER BY key LIMIT ?1";
            let found: Vec<(i64, [u8; 32])> = connection.list(sql, [most], |row| Ok((row.get(0)?, row.get(1)?)))?;
            let Some((upto, _)) = found.last() else { return Ok(0) };
            let roots: Vec<u8> = found.iter().flat_map(|(_, root)| *root).collect();
            let sql = "INSERT INTO stamps (made_at, upto, roots) VALUES (?1, ?2, ?3)";
            let key = connection.inserted(sql, "key", params![at, upto, roots])?;
            let sql = "INSERT INTO stamped_roots VALUES (?1, ?2) ON CONFLICT DO NOTHING";
            connection.run_each(sql, found.iter().map(|(_, root)| (root, key)))?;
            Ok(count(found.len()))
        })
    }

    /// The oldest that lack this authority's token and either all tokens or are among the newest.
    pub fn waiting_stamps(&self, authority: Hash, limit: usize) -> Result<Vec<KeptStamp>, StoreError> {
        let sql = "SELECT key, roots FROM stamps
            WHERE NOT EXISTS (SELECT 1 FROM stamp_tokens WHERE stamp = key AND authority = ?1)
            AND (key > (SELECT max(key) FROM stamps) - ?2
                 OR NOT EXISTS (SELECT 1 FROM stamp_tokens WHERE stamp = key))
            ORDER BY key LIMIT ?3";
        self.0.list(sql, params![authority.0, NEWEST, capped(limit)], |row| {
            Ok(KeptStamp { key: unsigned(row, 0)?, roots: hashes(&row.get::<Vec<u8>>(1)?), tokens: Vec::new() })
        })
    }

    /// An existing token stays.
    pub fn keep_token(&self, stamp: u64, authority: Hash, before: Timestamp, token: Vec<u8>) -> Result<(), StoreError> {
        let (stamp, before) = (whole("stamp", stamp)?, whole("time", before.0)?);
        let sql = "INSERT INTO stamp_tokens VALUES (?1, ?2, ?3, ?4) ON CONFLICT DO NOTHING";
        self.0.run(sql, (stamp, authority.0, before, token))
    }

    pub fn stamp_of(&self, root: Hash) -> Result<Option<u64>, StoreError> {
        self.0.find("SELECT stamp FROM stamped_roots WHERE root = ?1", [root.0], |row| unsigned(row, 0))
    }

    pub fn stamp(&self, key: u64) -> Result<Option<KeptStamp>, StoreError> {
        let number = whole("stamp", key)?;
        self.0.read(|connection| {
            let sql = "SELECT roots FROM stamps WHERE key = ?1";
            let Some(roots) = connection.find(sql, [number], |row| row.get::<Vec<u8>>(0))? else { return Ok(None) };
            let sql = "SELECT token FROM stamp_tokens WHERE stamp = ?1 ORDER BY authority";
            let tokens = connection.list(sql, [number], |row| row.get(0))?;
            Ok(Some(KeptStamp { key, roots: hashes(&roots), tokens }))
        })
    }

    pub fn stamp_counts(&self) -> Result<StampCounts, StoreError> {
        let sql = "SELECT (SELECT count(*) FROM stamps), (SELECT count(DISTINCT stamp) FROM stamp_tokens),
            (SELECT max(made_at) FROM stamps), (SELECT max(before) FROM stamp_tokens)";
        self.0.one(sql, [], |row| {
            let (all, stamped) = (unsigned(row, 0)?, unsigned(row, 1)?);
            let (newest, before) = (optional(row, 2)?.map(Timestamp), optional(row, 3)?.map(Timestamp));
            Ok(StampCounts { stamped, waiting: all.saturating_sub(stamped), newest, before })
        })
    }
}

fn hashes(bytes: &[u8]) -> Vec<Hash> {
    bytes.chunks_exact(Hash::LENGTH).filter_map(Hash::from_slice).collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::{numbered as record, open, open_again};
    use super::*;
    use crate::Ledger;
    use crate::model::Digest;
    use crate::{NewBatch, RootSighting};

    const ACCOUNT: Address = Address([1; 20]);

    fn anchored(ledger: &Ledger, number: u8, block: u64) {
        ledger.records.append(vec![record(number)]).expect("acknowledged");
        let root = Hash([number; 32]);
        let leaves = vec![(Digest([number; 32]), Vec::new())];
        ledger.batches.close(NewBatch { owner: ACCOUNT, root, leaves }).expect("closed");
        see(ledger, number, block);
    }

    fn see(ledger: &Ledger, number: u8, block: u64) {
        let (root, transaction) = (Hash([number; 32]), Hash([0xcc; 32]));
        let block_hash = Hash([u8::try_from(block).expect("small"); 32]);
        let sighting = RootSighting { account: ACCOUNT, root, count: 1, transaction, block, block_hash };
        ledger.batches.anchored(&[sighting]).expect("seen");
    }

    fn blocks(ledger: &Ledger, up_to: u64) -> Vec<u64> {
        ledger.proofs.unproven_batches(up_to, 9).expect("read").iter().map(|batch| batch.block).collect()
    }

    #[test]
    fn each_batch_waits_for_its_proof_from_its_block_on_and_nodes_are_kept_once() {
        let (home, ledger) = open();
        assert_eq!(ledger.proofs.chain_proof_counts(), Ok(ProofCounts::default()));
        [(1, 7), (2, 8), (3, 8), (4, 9)].into_iter().for_each(|(number, block)| anchored(&ledger, number, block));
        assert_eq!((blocks(&ledger, 8), blocks(&ledger, 6)), (vec![8, 8, 7], vec![]));
        let waiting = ledger.proofs.unproven_batches(8, 9).expect("read");
        assert!(waiting.iter().all(|batch| batch.account == ACCOUNT && batch.signers.len() == 1), "{waiting:?}");
        let keys = |block| -> Vec<u64> {
            waiting.iter().filter(|batch| batch.block == block).map(|batch| batch.key).collect()
        };
        let node = |number: u8| (Hash([number; 32]), vec![number; 3]);
        let keep = |block: u8, nodes| {
            ledger.proofs.keep_chain_proof(
                (u64::from(block), Hash([block; 32])),
                vec![block],
                keys(u64::from(block)),
                nodes,
            )
        };
        assert_eq!(keep(8, vec![node(1), node(2)]), Ok(()));
        assert_eq!(keep(7, vec![node(2), node(3)]), Ok(()));
        assert_eq!(keep(8, vec![node(2), node(4)]), Ok(()), "what is kept of a block grows");
        assert_eq!(blocks(&ledger, 9), [9]);
        let last = ledger.proofs.unproven_batches(9, 1).expect("read").remove(0).key;
        assert_eq!(ledger.proofs.miss_chain_proof(vec![last]), Ok(()));
        // Another process, later.
        ledger.close().expect("closed");
        let ledger = open_again(&home);
        assert_eq!(ledger.proofs.chain_proof_counts(), Ok(ProofCounts { newest: Some(8), missed: 1 }));
        let kept = ledger.proofs.chain_proof(8).expect("read").expect("kept");
        assert_eq!((kept.hash, kept.nodes), (Hash([8; 32]), vec![vec![1; 3], vec![2; 3], vec![4; 3]]));
        assert_eq!(ledger.proofs.chain_proof(9), Ok(None));
        ledger.proofs.keep_chain_header(9, vec![9]).expect("kept");
        let headers = [6, 7, 8, 9].map(|block| ledger.proofs.chain_header(block).expect("read"));
        assert_eq!(headers, [None, Some(vec![7]), Some(vec![8]), Some(vec![9])]);
        let nodes: i64 = ledger
            .database
            .read(|connection| Ok(connection.one("SELECT count(*) FROM chain_nodes", [], |row| row.get(0))?))
            .expect("read");
        assert_eq!(nodes, 4);
    }

    #[test]
    fn a_batch_that_a_reorganisation_moves_waits_again() {
        let (_home, ledger) = open();
        anchored(&ledger, 1, 7);
        let key = ledger.proofs.unproven_batches(7, 9).expect("read").remove(0).key;
        ledger
            .proofs
            .keep_chain_proof((7, Hash([7; 32])), vec![7], vec![key], vec![(Hash([1; 32]), vec![1])])
            .expect("kept");
        ledger.batches.take_back(7).expect("unwound");
        assert_eq!(blocks(&ledger, 9), Vec::<u64>::new(), "it is in no block");
        see(&ledger, 1, 8);
        assert_eq!(blocks(&ledger, 9), [8]);
        // The proof of a block in which it is no longer changes nothing for it.
        ledger
            .proofs
            .keep_chain_proof((7, Hash([7; 32])), vec![7], vec![key], vec![(Hash([1; 32]), vec![1])])
            .expect("kept");
        assert_eq!(blocks(&ledger, 9), [8]);
    }

    crate::ledger::tests::server::on_a_server! {
        each_batch_waits_for_its_proof_from_its_block_on_and_nodes_are_kept_once,
        a_batch_that_a_reorganisation_moves_waits_again,
    }
}

#[cfg(test)]
mod stamps_tests {
    use super::*;
    use crate::Ledger;
    use crate::NewBatch;
    use crate::ledger::tests::{numbered as record, open, open_again};
    use crate::model::{Address, Digest};

    fn close(ledger: &Ledger, number: u8) {
        ledger.records.append(vec![record(number)]).expect("acknowledged");
        let leaves = vec![(Digest([number; 32]), Vec::new())];
        ledger.batches.close(NewBatch { owner: Address([1; 20]), root: Hash([number; 32]), leaves }).expect("closed");
    }

    #[test]
    fn each_batch_is_put_under_one_stamp_and_waits_there_for_tokens() {
        let (home, ledger) = open();
        let begin = |most| ledger.proofs.begin_stamp(most, Timestamp(40));
        assert_eq!((begin(9), ledger.proofs.stamp_counts()), (Ok(0), Ok(StampCounts::default())));
        (1..=3).for_each(|number| close(&ledger, number));
        assert_eq!([begin(2), begin(2), begin(2)], [Ok(2), Ok(1), Ok(0)]);
        let (one, other) = (Hash([0xa; 32]), Hash([0xb; 32]));
        let waiting = |authority| -> Vec<Vec<u8>> {
            let stamps = ledger.proofs.waiting_stamps(authority, 9).expect("read");
            stamps.iter().map(|stamp| stamp.roots.iter().map(|root| root.0[0]).collect()).collect()
        };
        assert_eq!(waiting(one), [vec![1, 2], vec![3]]);
        let key = ledger.proofs.stamp_of(Hash([2; 32])).expect("read").expect("stamped");
        ledger.proofs.keep_token(key, one, Timestamp(50), vec![7]).expect("kept");
        ledger.proofs.keep_token(key, one, Timestamp(60), vec![8]).expect("the first stays");
        assert_eq!((waiting(one), waiting(other)), (vec![vec![3]], vec![vec![1, 2], vec![3]]));
        let counts = ledger.proofs.stamp_counts().expect("read");
        assert_eq!((counts.stamped, counts.waiting, counts.before), (1, 1, Some(Timestamp(50))));
        // Another process, later.
        ledger.close().expect("closed");
        let ledger = open_again(&home);
        let stamp = ledger.proofs.stamp(key).expect("read").expect("kept");
        assert_eq!((stamp.roots, stamp.tokens), (vec![Hash([1; 32]), Hash([2; 32])], vec![vec![7]]));
        assert_eq!((ledger.proofs.stamp_of(Hash([9; 32])), ledger.proofs.stamp(99)), (Ok(None), Ok(None)));
        close(&ledger, 4);
        assert_eq!(ledger.proofs.begin_stamp(9, Timestamp(70)), Ok(1));
        assert_eq!(ledger.proofs.stamp_counts().expect("read").newest, Some(Timestamp(70)));
    }

    crate::ledger::tests::server::on_a_server!(each_batch_is_put_under_one_stamp_and_waits_there_for_tokens);
}

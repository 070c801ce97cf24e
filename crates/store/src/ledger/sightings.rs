//! What the watcher read on the chain: blocks, and anchors in them.

use super::rows::{self, By, anchored, check, may, of_its_batch, time, unsigned};
use super::{Batches, Counts, Forwarding, Session, Trail, batches};
use crate::StoreError;
use crate::database::{capped, whole};
use crate::model::{Address, Digest, Hash, RecordState, RecorderId, Signature, SignerId, Timestamp, TopicId};
use crate::sql::{self, Connection, Row, params};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sighting {
    /// As the chain says.
    pub owner: Address,
    pub digest: Digest,
    pub transaction: Hash,
    pub block: u64,
    pub block_hash: Hash,
}

struct Standing {
    n: i64,
    state: RecordState,
    block: Option<i64>,
    block_hash: Option<[u8; 32]>,
}

impl Batches {
    /// Anchors found on the chain: pending records are now mined, mined ones move to the last block seen, tampered ones
    /// note it. Skips digests of other ledgers. Returns how many records changed.
    pub fn mined(&self, sightings: &[Sighting]) -> Result<u64, StoreError> {
        let sightings = sightings.to_vec();
        self.0.write_many(sightings.len(), move |session| {
            sightings.iter().try_fold(0, |changed, sighting| Ok(changed + see(session.connection, sighting)?))
        })
    }

    /// Records of this ledger that still wait for a block.
    pub fn waiting_digests(&self, sightings: &[Sighting]) -> Result<Vec<Digest>, StoreError> {
        self.0.read(|connection| {
            // An anchor that did not count is no reason to read its block again.
            let sql =
                "SELECT 1 FROM passed_over JOIN records ON n = record WHERE digest = ?1 AND passed_over.block = ?2";
            let mut waiting = Vec::new();
            for sighting in sightings {
                let found = standing(connection, sighting)?.filter(|found| found.block.is_none());
                let is_open = found.is_some_and(|found| may(By::Sight, found.state, RecordState::Mined));
                if is_open && !connection.has(sql, params![sighting.digest.0, whole("block", sighting.block)?])? {
                    waiting.push(sighting.digest);
                }
            }
            Ok(waiting)
        })
    }

    /// Mined records up to a block are confirmed; returns their captures, unordered.
    pub fn confirm(&self, up_to_block: u64) -> Result<Vec<Timestamp>, StoreError> {
        let block = whole("block", up_to_block)?;
        self.0.write(move |session| {
            let (mined, confirmed) = (RecordState::Mined.code(), RecordState::Confirmed.code());
            let sql = concat!(
                "UPDATE records INDEXED BY records_by_state SET state = ?3 WHERE state = ?2 AND ",
                anchored!("block"),
                " <= ?1 RETURNING captured_at"
            );
            Ok(session.connection.list(sql, params![block, mined, confirmed], |row| unsigned(row, 0).map(Timestamp))?)
        })
    }

    /// Blocks from this one on are gone. Records with a transaction signed here are submitted again, with the same
    /// bytes; others are stored or batched. Returns how many moved, and how many of those were verified, as only a
    /// broken chain causes.
    pub fn take_back(&self, from_block: u64) -> Result<(u64, u64), StoreError> {
        let block = whole("block", from_block)?;
        self.0.write(move |Session { connection, .. }| {
            // In the same commit: no anchor from elsewhere may be in them until the chain is read again. First, so that what a
            // worker rests on them meanwhile is seen.
            connection.run("DELETE FROM trail WHERE block >= ?1", [block])?;
            let sql = "UPDATE transactions SET state = 0, block = NULL, block_hash = NULL, gas_used = NULL
                WHERE state = 1 AND block >= ?1";
            connection.run(sql, [block])?;
            let batches = batches::take_back(connection, block)?;
            connection.run("DELETE FROM passed_over WHERE block >= ?1", [block])?;
            let sql = "UPDATE records SET tx = NULL, block = NULL, block_hash = NULL WHERE state = ?1 AND block >= ?2";
            connection.run(sql, params![RecordState::Tampered.code(), block])?;
            let unplace = |state| -> Result<u64, StoreError> {
                let with = |moved: u64, batch: &i64| Ok(moved + unplace(connection, state, (OF_BATCH, *batch))?);
                batches.iter().try_fold(unplace(connection, state, (OWN, block))?, with)
            };
            let verified: u64 = unplace(RecordState::Verified)?;
            let moved: u64 = unplace(RecordState::Mined)? + unplace(RecordState::Confirmed)?;
            Ok((moved + verified, verified))
        })
    }
}

fn see(connection: &Connection, sighting: &Sighting) -> Result<u64, StoreError> {
    let block = whole("block", sighting.block)?;
    let Some(standing) = standing(connection, sighting)? else { return Ok(0) };
    let known = standing.block == Some(block) && standing.block_hash == Some(sighting.block_hash.0);
    let state = match standing.state {
        state if may(By::Sight, state, RecordState::Mined) => RecordState::Mined,
        RecordState::Mined | RecordState::Tampered if !known => standing.state,
        _ => return Ok(0),
    };
    let sql = "UPDATE records SET state = ?2, tx = ?3, block = ?4, block_hash = ?5 WHERE n = ?1";
    connection.run(sql, params![standing.n, state.code(), sighting.transaction.0, block, sighting.block_hash.0])?;
    // In its batch's block it rests on the batch, whichever of the two was seen first.
    let sql = concat!(
        "UPDATE records SET tx = NULL, block = NULL, block_hash = NULL WHERE n = ?1 AND block = ",
        of_its_batch!("block")
    );
    connection.run(sql, [standing.n])?;
    Ok(u64::from(state == RecordState::Mined))
}

fn standing(connection: &Connection, sighting: &Sighting) -> Result<Option<Standing>, StoreError> {
    let sql = concat!(
        "SELECT n, state, ",
        anchored!("block"),
        ", ",
        anchored!("block_hash"),
        " FROM records JOIN topics ON key = topic WHERE digest = ?1 AND topics.owner = ?2"
    );
    Ok(connection.find(sql, params![sighting.digest.0, sighting.owner.0], |row| {
        Ok(Standing { n: row.get(0)?, state: rows::state(row, 1)?, block: row.get(2)?, block_hash: row.get(3)? })
    })?)
}

/// State ?1, with a block of their own from ?2 on.
const OWN: &str = "records INDEXED BY records_by_state SET {} WHERE state = ?1 AND block >= ?2";
/// State ?1, in batch ?2, without a transaction of their own.
const OF_BATCH: &str =
    "records SET {} WHERE +state = ?1 AND tx IS NULL AND n IN (SELECT record FROM leaves WHERE batch = ?2)";

/// Records lose their own or their batch's block. The first that applies: the batch's block, the own open transaction,
/// the batch's, another open upload.
fn unplace(connection: &Connection, from: RecordState, lost: (&str, i64)) -> Result<u64, StoreError> {
    // One that anchors a batch is released with the batch: a record that kept it for its own would stay submitted.
    const OPEN: &str = "EXISTS (SELECT 1 FROM transactions
         WHERE hash = records.tx AND transactions.state = 0 AND transactions.batch IS NULL)";
    const LEAF: &str = "EXISTS (SELECT 1 FROM leaves WHERE record = n)";
    const UPLOAD: &str = "(SELECT hash FROM transactions WHERE transactions.state = 0
         AND transactions.digests = records.digest ORDER BY nonce, key LIMIT 1)";
    const BATCH_IN_BLOCK: &str = concat!(of_its_batch!("block"), " IS NOT NULL");
    const BATCH_SENT: &str = concat!(of_its_batch!("tx"), " IS NOT NULL");
    let steps = [
        (RecordState::Mined, "NULL", BATCH_IN_BLOCK.to_owned()),
        (RecordState::Submitted, "tx", OPEN.to_owned()),
        (RecordState::Submitted, "NULL", BATCH_SENT.to_owned()),
        (RecordState::Batched, "NULL", LEAF.to_owned()),
        (RecordState::Submitted, UPLOAD, format!("{UPLOAD} IS NOT NULL")),
        (RecordState::Stored, "NULL", "TRUE".to_owned()),
    ];
    let mut moved = 0;
    for (to, transaction, condition) in steps {
        if from != to {
            check(By::Reorg, from, to)?;
        }
        let values = format!("state = ?3, tx = {transaction}, block = NULL, block_hash = NULL");
        let sql = format!("UPDATE {} AND {condition}", lost.0.replace("{}", &values));
        moved += connection.changed(&sql, params![from.code(), lost.1, to.code()])?;
    }
    Ok(moved)
}

// Blocks seen by the watcher, to find where chains diverge after a reorg.

/// The newest blocks, all kept.
pub(super) const DENSE: u64 = 1024;
/// Older blocks for each one kept.
const SPARSE: u64 = 256;

const SET_CURSOR: &str = "INSERT INTO cursor VALUES (1, ?1, ?2)
    ON CONFLICT (one) DO UPDATE SET block = excluded.block, hash = excluded.hash";

pub(super) fn cursor_in(connection: &Connection) -> Result<Option<(u64, Hash)>, StoreError> {
    Ok(connection.find("SELECT block, hash FROM cursor", [], block)?)
}

fn block(row: &Row<'_>) -> sql::Result<(u64, Hash)> {
    Ok((unsigned(row, 0)?, Hash(row.get(1)?)))
}

impl Trail {
    pub fn cursor(&self) -> Result<Option<(u64, Hash)>, StoreError> {
        self.0.read(cursor_in)
    }

    pub fn set_cursor(&self, block: u64, hash: Hash) -> Result<(), StoreError> {
        let block = whole("block", block)?;
        self.0.run(SET_CURSOR, (block, hash.0))
    }

    /// Moves the cursor and stores the blocks met in one commit.
    pub fn walk_to(&self, to: (u64, Hash), met: Vec<(u64, Hash)>) -> Result<(), StoreError> {
        let block = whole("block", to.0)?;
        self.0.write(move |Session { connection, .. }| {
            let sql = "INSERT INTO trail VALUES (?1, ?2) ON CONFLICT (block) DO UPDATE SET hash = excluded.hash";
            let mut keep = connection.prepared(sql)?;
            for (number, hash) in met.iter().chain([&to]) {
                keep.execute(params![whole("block", *number)?, hash.0])?;
            }
            connection.run(SET_CURSOR, params![block, to.1.0])?;
            let old = block.saturating_sub(whole("block", DENSE)?);
            if to.0.is_multiple_of(SPARSE) {
                let sql = "DELETE FROM trail WHERE block < ?1 AND block NOT IN
                    (SELECT max(block) FROM trail WHERE block < ?1 GROUP BY block / ?2)";
                connection.run(sql, params![old, whole("block", SPARSE)?])?;
            }
            Ok(())
        })
    }

    /// From this one on, oldest first.
    pub fn blocks(&self, from: u64) -> Result<Vec<(u64, Hash)>, StoreError> {
        self.0.list("SELECT block, hash FROM trail WHERE block >= ?1 ORDER BY block", [capped(from)], block)
    }

    pub fn end(&self) -> Result<Option<(u64, Hash)>, StoreError> {
        self.0.find("SELECT block, hash FROM trail ORDER BY block DESC LIMIT 1", [], block)
    }

    /// Moves a later cursor back to `to`. The blocks after it stay: records rest on them.
    pub fn walk_back(&self, to: (u64, Hash)) -> Result<(), StoreError> {
        let sql = "UPDATE cursor SET block = ?1, hash = ?2 WHERE block > ?1";
        self.0.run(sql, (whole("block", to.0)?, to.1.0))
    }
}

impl Counts {
    /// The signer's highest number in each topic of an owner, by topic id, except topics with these names.
    pub fn heights(&self, owner: Address, signer: SignerId, but: [&str; 2]) -> Result<Vec<(TopicId, u64)>, StoreError> {
        let (recorder, [one, other]) = (self.0.shared.recorder.of_signer(&signer), but);
        let sql = "SELECT topic_id, highest FROM
            (SELECT topic_id, (SELECT max(seq) FROM records WHERE topic = topics.key) AS highest FROM topics
             WHERE owner = ?1 AND keeper IS NULL AND name NOT IN (?2, ?3)
             AND recorder = (SELECT key FROM recorders WHERE id = ?4 AND signer = ?5)) AS numbered
            WHERE highest IS NOT NULL ORDER BY topic_id";
        self.0.list(sql, params![owner.0, one, other, recorder.0, signer.0], |row| {
            Ok((TopicId(row.get(0)?), unsigned(row, 1)?))
        })
    }

    /// The recorder before the signer's: of the previous key, or of the ledger that this one copies.
    pub fn predecessor(&self, owner: Address, signer: SignerId) -> Result<Option<RecorderId>, StoreError> {
        let recorder = self.0.shared.recorder.of_signer(&signer);
        let sql = "SELECT id FROM recorders WHERE key < coalesce(
                (SELECT key FROM recorders WHERE id = ?2 AND signer = ?3), 9223372036854775807)
            AND EXISTS (SELECT 1 FROM topics WHERE recorder = recorders.key AND owner = ?1 AND keeper IS NULL)
            ORDER BY key DESC LIMIT 1";
        self.0.find(sql, params![owner.0, recorder.0, signer.0], |row| row.get(0).map(RecorderId))
    }
}

// A robot's evidence for records that its gateway reports as verified.

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptStanding {
    pub time: Timestamp,
    /// Without label and domain.
    pub statement: Vec<u8>,
    /// By the gateway's identity key.
    pub signature: Signature,
    /// Verified records with the proofs of their anchors.
    pub proofs: Vec<(Digest, Vec<u8>)>,
}

impl Forwarding {
    /// Records with a statement keep it.
    pub fn keep_proven(&self, kept: KeptStanding) -> Result<(), StoreError> {
        self.0.write(move |session| {
            let (connection, time) = (session.connection, whole("time", kept.time.0)?);
            let sql = "INSERT INTO standings (at, statement, signature) VALUES (?1, ?2, ?3)";
            let key = connection.inserted(sql, "key", params![time, kept.statement, kept.signature.0])?;
            let now = whole("time", Timestamp::now().0)?;
            let sql =
                "INSERT INTO proven SELECT n, ?2, ?3, ?4, 0 FROM records WHERE digest = ?1 ON CONFLICT DO NOTHING";
            connection.run_each(sql, kept.proofs.iter().map(|(digest, proof)| (digest.0, key, proof, now)))?;
            Ok(())
        })
    }

    /// Verified before a time, with ciphertext, oldest first.
    pub fn proven_before(&self, moment: Timestamp, limit: usize) -> Result<Vec<Digest>, StoreError> {
        let (moment, limit) = (whole("time", moment.0)?, capped(limit));
        let verified = RecordState::Verified.code();
        let sql = "SELECT digest FROM proven JOIN records ON n = record
            WHERE gone = 0 AND at < ?1 AND state = ?3 ORDER BY at LIMIT ?2";
        self.0.list(sql, params![moment, limit, verified], |row| row.get(0).map(Digest))
    }

    /// Notes deleted ciphertext; statement and proof stay.
    pub fn proven_gone(&self, digests: &[Digest]) -> Result<(), StoreError> {
        let sql = "UPDATE proven SET gone = 1 WHERE record = (SELECT n FROM records WHERE digest = ?1)";
        self.0.run_each(sql, digests.iter().map(|digest| [digest.0]).collect()).map(drop)
    }

    /// With only this record's proof.
    pub fn proven(&self, digest: Digest) -> Result<Option<KeptStanding>, StoreError> {
        let sql = "SELECT s.at, statement, signature, proof FROM proven p JOIN standings s ON s.key = p.standing
            WHERE record = (SELECT n FROM records WHERE digest = ?1)";
        self.0.find(sql, [digest.0], |row| {
            let (time, signature) = (time(row, 0)?, Signature(row.get(2)?));
            Ok(KeptStanding { time, statement: row.get(1)?, signature, proofs: vec![(digest, row.get(3)?)] })
        })
    }
}

#[cfg(test)]
mod trail_tests {
    use super::*;
    fn hash(number: u64) -> Hash {
        let mut bytes = [0; 32];
        bytes[..8].copy_from_slice(&number.to_be_bytes());
        Hash(bytes)
    }

    #[test]
    fn old_blocks_thin_out_and_a_way_back_is_left() {
        let (_home, ledger) = crate::ledger::tests::open();
        for number in 1..=4096 {
            let met = if number % 3 == 0 { vec![(number - 1, hash(number - 1))] } else { Vec::new() };
            ledger.trail.walk_to((number, hash(number)), met).expect("walks");
        }
        let trail = ledger.trail.blocks(0).expect("read");
        assert!(trail.len() < 1300 && trail.is_sorted(), "{}", trail.len());
        assert!((3072..=4096).all(|number| trail.contains(&(number, hash(number)))), "the newest are all there");
        for bucket in 0..12 {
            assert!(trail.iter().any(|(number, _)| number / SPARSE == bucket), "{bucket}");
        }
        ledger.trail.walk_back((4000, hash(4000))).expect("walks back");
        assert_eq!(
            (ledger.trail.cursor(), ledger.trail.end()),
            (Ok(Some((4000, hash(4000)))), Ok(Some((4096, hash(4096))))),
            "what was read shows whether it is replaced before it is read again"
        );
        assert_eq!(ledger.trail.blocks(4095), Ok(vec![(4095, hash(4095)), (4096, hash(4096))]));
        ledger.trail.set_cursor(7, hash(7)).expect("set");
        ledger.trail.walk_back((3999, hash(3999))).expect("walks back");
        assert_eq!(ledger.trail.cursor(), Ok(Some((7, hash(7)))), "a cursor that is behind stays there");
    }

    crate::ledger::tests::server::on_a_server!(old_blocks_thin_out_and_a_way_back_is_left);
}

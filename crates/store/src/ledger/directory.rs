//! Who is registered and who may read what, as the contract's events say. Each event is a row, and events that no longer
//! count are marked: the current ones are found without the others, the others are history, and a replaced block can be
//! undone.

use std::path::Path;

use rusqlite::{Connection, Row, params};

use super::query::Glance;
use super::rows::{By, anchored, may, of_its_batch, unsigned};
use super::writer::Session;
use super::{Batches, Rights, batches};
use crate::StoreError;
use crate::crypto::merkle::Leaf;
use crate::database::{Statements as _, capped, count, whole};
use crate::model::{Address, Digest, Domain, RecordState, SignerId, Token};

/// The subject of an event, as far as it matters here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RightKind {
    Grant = 1,
    /// An envelope of another epoch.
    Envelope = 2,
    /// An extension of a grant.
    Extension = 3,
    /// An epoch began; if a grantee is named, by the revocation of its grant.
    Epoch = 4,
    Other = 5,
    /// The key of an epoch, wrapped for its own owner. It is history from the start: only its owner ever reads it.
    Own = 6,
}

/// An event to be stored.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RightEvent {
    pub block: u64,
    /// Its index among the block's events.
    pub place: u64,
    pub kind: RightKind,
    /// The owner of the right.
    pub owner: Option<Address>,
    /// The grantee, current or former.
    pub grantee: Option<Address>,
    /// The epoch it names.
    pub epoch: Option<u64>,
    /// The token of that epoch.
    pub token: Option<Token>,
    /// Everything but the envelope, encoded by its reader.
    pub event: String,
    pub envelope: Option<Vec<u8>>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptRight {
    pub block: u64,
    /// Its index among the block's events.
    pub place: u64,
    pub event: String,
    /// The epoch that began when its grant was revoked.
    pub revoked: Option<u64>,
}

/// The current events of the contract.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct StandingRights {
    /// Block and index of the last event stored; `None` before the first.
    pub last: Option<(u64, u64)>,
    /// Those that still count, in the chain's order.
    pub events: Vec<KeptRight>,
}

/// An envelope from an event.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptEnvelope {
    /// The epoch whose keys it contains.
    pub epoch: u64,
    /// The block of the event.
    pub block: u64,
    pub bytes: Vec<u8>,
}

/// What an event supersedes: an extension supersedes the one before it, an epoch the one before it, a revocation its
/// grant.
pub(super) const ENDING: [&str; 3] = [
    "UPDATE rights INDEXED BY rights_standing SET replaced = ?3
        WHERE owner = ?1 AND kind = 3 AND grantee = ?2 AND replaced IS NULL AND revoked IS NULL",
    "UPDATE rights INDEXED BY rights_standing SET replaced = ?2
        WHERE owner = ?1 AND kind = 4 AND replaced IS NULL AND revoked IS NULL",
    "UPDATE rights INDEXED BY rights_standing SET revoked = ?4, revoked_at = ?3
        WHERE owner = ?1 AND kind IN (1, 2, 3) AND grantee = ?2
        AND replaced IS NULL AND revoked IS NULL",
];
/// After every event of a block.
const WHOLE_BLOCK: i64 = i64::MAX;
/// How the contract is found again.
pub(super) const PIN: &str = "SELECT pin FROM contract";
/// Notes the last event.
const UP_TO: &str = "UPDATE contract SET block = ?1, place = ?2";

impl Rights {
    /// The file in which they are.
    pub fn path(&self) -> &Path {
        self.0.path()
    }

    /// Binds the ledger to one contract for good; `pin` says how it is found again.
    pub fn bind_contract(&self, domain: Domain, pin: &str) -> Result<(), StoreError> {
        let pin = pin.to_owned();
        self.0.write(move |session| {
            let connection = session.connection;
            let sql = "INSERT INTO contract VALUES (1, ?1, ?2, 0, -1) ON CONFLICT DO UPDATE SET pin = excluded.pin \
                       WHERE domain = excluded.domain AND pin <> excluded.pin";
            connection.run(sql, params![domain.0, pin])?;
            let bound = connection.query_row("SELECT domain FROM contract", [], |row| row.get(0).map(Domain))?;
            if bound == domain { Ok(()) } else { Err(StoreError::Bound { bound, domain }) }
        })
    }

    /// The pin of the contract that the ledger is bound to; `None` if it is bound to none yet.
    pub fn contract_pin(&self) -> Result<Option<String>, StoreError> {
        self.0.find(PIN, [], |row| row.get(0))
    }

    /// The same of a ledger that is not opened, because it may be in use or damaged; nothing is written.
    pub fn contract_pin_in(path: &Path) -> Result<Option<String>, StoreError> {
        if !path.exists() {
            return Ok(None);
        }
        Glance::at(path)?.contract_pin()
    }

    /// Stores events in the chain's order, all in one commit; those already there are skipped.
    pub fn keep_rights(&self, events: Vec<RightEvent>) -> Result<(), StoreError> {
        self.0.write_many(events.len(), move |session| keep_all(session, &events))
    }

    pub fn standing_rights(&self) -> Result<StandingRights, StoreError> {
        self.0.read(|connection| {
            let (block, place) = last_event(connection)?;
            let sql = "SELECT block, place, event, revoked FROM rights INDEXED BY rights_standing
                WHERE replaced IS NULL AND revoked IS NULL ORDER BY block, place";
            let events = connection.list(sql, [], kept)?;
            let last = (place >= 0).then_some((block.cast_unsigned(), place.cast_unsigned()));
            Ok(StandingRights { last, events })
        })
    }

    /// The events about an account that are neither grants nor epochs, in the chain's order.
    pub fn other_rights(&self, account: Address) -> Result<Vec<KeptRight>, StoreError> {
        let sql = "SELECT block, place, event, revoked FROM rights INDEXED BY rights_standing
            WHERE owner = ?1 AND kind = 5 AND replaced IS NULL AND revoked IS NULL ORDER BY block, place";
        self.0.list(sql, [account.0], kept)
    }

    /// Undoes the events of all blocks from `from` on, and what they superseded, in one commit.
    pub fn take_back_rights(&self, from: u64) -> Result<(), StoreError> {
        let from = whole("block", from)?;
        self.0.write_many(super::writer::MANY + 1, move |session| {
            let connection = session.connection;
            if last_event(connection)?.0 < from {
                return Ok(());
            }
            for sql in [
                "DELETE FROM envelopes WHERE block >= ?1",
                "DELETE FROM rights WHERE block >= ?1",
                "UPDATE rights SET replaced = NULL WHERE replaced >= ?1",
                "UPDATE rights SET revoked = NULL, revoked_at = NULL WHERE revoked_at >= ?1",
            ] {
                connection.run(sql, [from])?;
            }
            connection.run(UP_TO, [from - 1, WHOLE_BLOCK])?;
            Ok(())
        })
    }

    /// Every event of blocks `from` to `to`, in the chain's order.
    pub fn rights_in(&self, from: u64, to: u64) -> Result<Vec<KeptRight>, StoreError> {
        let (from, to) = (whole("block", from)?, whole("block", to)?);
        let sql = "SELECT block, place, event, revoked FROM rights WHERE block BETWEEN ?1 AND ?2 ORDER BY block, place";
        self.0.list(sql, [from, to], kept)
    }

    /// Which of these events, by block and index, are not stored.
    pub fn unknown_rights(&self, places: &[(u64, u64)]) -> Result<Vec<(u64, u64)>, StoreError> {
        self.0.read(|connection| {
            let sql = "SELECT 1 FROM rights WHERE block = ?1 AND place = ?2";
            connection.among(sql, places, |(block, place)| Ok([whole("block", block)?, whole("place", place)?]), false)
        })
    }

    /// Deletes all events, so that they are read again.
    pub fn forget_rights(&self) -> Result<(), StoreError> {
        self.0.write_many(super::writer::MANY + 1, move |session| {
            session.connection.execute_batch("DELETE FROM envelopes; DELETE FROM rights;")?;
            session.connection.run(UP_TO, [0, -1])?;
            Ok(())
        })
    }

    /// Grants that an account gave or received and that were revoked, with their extensions, in the chain's order.
    pub fn revoked_grants(&self, account: Address) -> Result<Vec<KeptRight>, StoreError> {
        self.0.read(|connection| {
            let mut found: Vec<KeptRight> = Vec::new();
            for (side, index) in [("owner", "rights_given"), ("grantee", "rights_received")] {
                let sql = format!(
                    "SELECT block, place, event, revoked FROM rights INDEXED BY {index}
                        WHERE {side} = ?1 AND revoked IS NOT NULL AND replaced IS NULL AND kind IN (1, 3)"
                );
                let one: Vec<_> = connection.list(&sql, [account.0], kept)?;
                found.extend(one);
            }
            found.sort_by_key(|row| (row.block, row.place));
            found.dedup();
            Ok(found)
        })
    }

    /// The envelopes of a current grant, or of the one whose revocation began the epoch `revoked`; in the chain's
    /// order.
    pub fn envelopes_between(
        &self,
        owner: Address,
        grantee: Address,
        revoked: Option<u64>,
    ) -> Result<Vec<KeptEnvelope>, StoreError> {
        let asked = whole("epoch", revoked.unwrap_or(0))?;
        let (index, which) = match revoked {
            None => ("rights_standing", "replaced IS NULL AND revoked IS NULL AND ?3 = 0"),
            Some(_) => ("rights_given", "revoked IS NOT NULL AND revoked = ?3"),
        };
        let sql = format!(
            "SELECT r.epoch, r.block, e.envelope FROM rights r INDEXED BY {index}
                JOIN envelopes e ON e.block = r.block AND e.place = r.place
                WHERE owner = ?1 AND kind IN (1, 2) AND grantee = ?2 AND {which}
                ORDER BY r.block, r.place"
        );
        self.0.list(&sql, params![owner.0, grantee.0, asked], |row| {
            Ok(KeptEnvelope { epoch: unsigned(row, 0)?, block: unsigned(row, 1)?, bytes: row.get(2)? })
        })
    }

    /// The envelopes that an owner made for itself, from one epoch to another; in the chain's order.
    pub fn own_envelopes(&self, owner: Address, from: u64, to: u64) -> Result<Vec<KeptEnvelope>, StoreError> {
        let (from, to) = (whole("epoch", from)?, whole("epoch", to)?);
        let sql = "SELECT r.epoch, r.block, e.envelope FROM rights r INDEXED BY rights_own
            JOIN envelopes e ON e.block = r.block AND e.place = r.place
            WHERE owner = ?1 AND epoch BETWEEN ?2 AND ?3 AND kind = 6 ORDER BY r.block, r.place";
        self.0.list(sql, params![owner.0, from, to], |row| {
            Ok(KeptEnvelope { epoch: unsigned(row, 0)?, block: unsigned(row, 1)?, bytes: row.get(2)? })
        })
    }

    /// The envelope of one event.
    pub fn envelope_at(&self, block: u64, place: u64) -> Result<Option<Vec<u8>>, StoreError> {
        let at = (whole("block", block)?, whole("place", place)?);
        let sql = "SELECT envelope FROM envelopes WHERE block = ?1 AND place = ?2";
        self.0.find(sql, [at.0, at.1], |row| row.get(0))
    }

    /// The token that an owner registered for an epoch.
    pub fn epoch_token(&self, owner: Address, epoch: u64) -> Result<Option<Token>, StoreError> {
        let epoch = whole("epoch", epoch)?;
        let sql = "SELECT token FROM rights INDEXED BY rights_tokens
            WHERE owner = ?1 AND epoch = ?2 AND token IS NOT NULL
            ORDER BY block, place LIMIT 1";
        self.0.find(sql, params![owner.0, epoch], |row| row.get(0).map(Token))
    }

    /// Whether an owner ever registered this token.
    pub fn ever_had_token(&self, owner: Address, token: Token) -> Result<bool, StoreError> {
        let sql = "SELECT 1 FROM rights INDEXED BY rights_tokens WHERE owner = ?1 AND token IS NOT NULL AND token = ?2";
        self.0.has(sql, params![owner.0, token.0])
    }
}

fn kept(row: &Row<'_>) -> rusqlite::Result<KeptRight> {
    let revoked = row.get::<_, Option<i64>>(3)?.map(i64::cast_unsigned);
    Ok(KeptRight { block: unsigned(row, 0)?, place: unsigned(row, 1)?, event: row.get(2)?, revoked })
}

/// Block and index of the last event stored; (0, -1) before the first.
fn last_event(connection: &Connection) -> Result<(i64, i64), StoreError> {
    let found = connection.find("SELECT block, place FROM contract", [], |row| Ok((row.get(0)?, row.get(1)?)))?;
    Ok(found.unwrap_or((0, -1)))
}

fn keep_all(session: &Session<'_>, events: &[RightEvent]) -> Result<(), StoreError> {
    let connection = session.connection;
    let (mut block, mut place) = last_event(connection)?;
    for event in events {
        let at = (whole("block", event.block)?, whole("place", event.place)?);
        if at <= (block, place) {
            continue;
        }
        end_others(connection, event)?;
        keep_one(connection, event)?;
        (block, place) = at;
    }
    connection.run(UP_TO, [block, place])?;
    Ok(())
}

/// Marks what an event supersedes.
fn end_others(connection: &Connection, event: &RightEvent) -> Result<(), StoreError> {
    let (Some(owner), block) = (event.owner, whole("block", event.block)?) else { return Ok(()) };
    let [extended, begun, revoked] = ENDING;
    match (event.kind, event.grantee) {
        (RightKind::Extension, Some(grantee)) => {
            connection.run(extended, params![owner.0, grantee.0, block])?;
        }
        (RightKind::Epoch, grantee) => {
            connection.run(begun, params![owner.0, block])?;
            let epoch = whole("epoch", event.epoch.unwrap_or(0))?;
            if let Some(grantee) = grantee {
                connection.run(revoked, params![owner.0, grantee.0, block, epoch])?;
            }
        }
        _ => {}
    }
    Ok(())
}

fn keep_one(connection: &Connection, event: &RightEvent) -> Result<(), StoreError> {
    let (block, place) = (whole("block", event.block)?, whole("place", event.place)?);
    let epoch = event.epoch.map(|epoch| whole("epoch", epoch)).transpose()?;
    let sql = "INSERT INTO rights (block, place, kind, owner, grantee, epoch, token, event, replaced)
        VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9)";
    connection.run(
        sql,
        params![
            block,
            place,
            event.kind as i64,
            event.owner.map(|owner| owner.0),
            event.grantee.map(|grantee| grantee.0),
            epoch,
            event.token.map(|token| token.0),
            event.event,
            (event.kind == RightKind::Own).then_some(block),
        ],
    )?;
    if let Some(envelope) = &event.envelope {
        connection.run("INSERT INTO envelopes VALUES (?1, ?2, ?3)", params![block, place, envelope])?;
    }
    Ok(())
}

// Records whose signer may not sign for its owner wait here, and anchors that do not count are ignored. The ledger
// does not know who has which right; its callers do.

/// The most records moved in one commit.
const MOST: usize = 8192;

/// A signer with records still to be anchored by an account.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WaitingSigner {
    /// The owner it signed for.
    pub owner: Address,
    pub signer: SignerId,
    /// Some of them are waiting for the right.
    pub held: bool,
    /// Some of them are ready to be anchored.
    pub ready: bool,
}

/// The streams of one signer and owner that an account anchors.
const STREAMS: &str =
    "SELECT s.key FROM streams s JOIN topics t ON t.key = s.topic JOIN recorders r ON r.key = t.recorder
        WHERE coalesce(t.keeper, t.owner) = ?1 AND t.owner = ?2 AND r.signer = ?3";

impl Batches {
    /// The signers of the records that `keeper` anchors and that are stored, in a closed batch, or waiting for a right.
    pub fn waiting_signers(&self, keeper: Address) -> Result<Vec<WaitingSigner>, StoreError> {
        let [held, stored, batched] =
            [RecordState::RightEnded, RecordState::Stored, RecordState::Batched].map(RecordState::code);
        let sql = "SELECT t.owner, r.signer, max(c.state = ?2), max(c.state <> ?2)
            FROM streams s JOIN topics t ON t.key = s.topic JOIN recorders r ON r.key = t.recorder
            JOIN counters c ON c.stream = s.key
            WHERE coalesce(t.keeper, t.owner) = ?1 AND c.records > 0 AND c.state IN (?2, ?3, ?4)
            GROUP BY t.owner, r.signer";
        self.0.list(sql, params![keeper.0, held, stored, batched], |row| {
            let (owner, signer) = (Address(row.get(0)?), SignerId(row.get(1)?));
            Ok(WaitingSigner { owner, signer, held: row.get(2)?, ready: row.get(3)? })
        })
    }

    /// A signer's right has ended: those of its records that no transaction anchors now wait. Unsent batches that
    /// contain one of them are dissolved, and their other records are stored again. Returns how many records began to
    /// wait; 0 once all do.
    pub fn hold_signer(&self, keeper: Address, owner: Address, signer: SignerId) -> Result<u64, StoreError> {
        self.0.write_many(MOST, move |session| {
            for batch in unsent_batches(session.connection, keeper, owner, signer)? {
                dissolve(session.connection, batch)?;
            }
            shift(session.connection, (keeper, owner, signer), RecordState::Stored, RecordState::RightEnded)
        })
    }

    /// A signer's right is back: its records are stored, and anchored like all others. Returns how many; 0 once none
    /// waits any more.
    pub fn free_signer(&self, keeper: Address, owner: Address, signer: SignerId) -> Result<u64, StoreError> {
        self.0.write_many(MOST, move |session| {
            shift(session.connection, (keeper, owner, signer), RecordState::RightEnded, RecordState::Stored)
        })
    }

    /// The blocks of these confirmed records do not count, because their signers had no right at that time: they leave
    /// their batches and are stored, to be anchored again. Returns how many were confirmed.
    pub fn pass_over(&self, digests: &[Digest]) -> Result<u64, StoreError> {
        let digests = digests.to_vec();
        self.0.write_many(digests.len(), move |session| {
            digests.iter().try_fold(0, |moved, digest| Ok(moved + pass_over_one(session.connection, *digest)?))
        })
    }

    /// Stored records that an account anchors and whose blocks were ignored, as leaves.
    pub fn passed_over_leaves(&self, keeper: Address, limit: usize) -> Result<Vec<Leaf>, StoreError> {
        let sql = "SELECT recorders.id, topics.topic_id, seq, digest, topics.owner, recorders.signer FROM passed_over
            JOIN records ON n = passed_over.record JOIN topics ON topics.key = records.topic
            JOIN recorders ON recorders.key = topics.recorder
            WHERE state = ?2 AND coalesce(topics.keeper, topics.owner) = ?1 ORDER BY n LIMIT ?3";
        self.0.list(sql, params![keeper.0, RecordState::Stored.code(), capped(limit)], batches::leaf)
    }
}

/// Moves up to [`MOST`] records of a signer.
fn shift(
    connection: &Connection,
    (keeper, owner, signer): (Address, Address, SignerId),
    from: RecordState,
    to: RecordState,
) -> Result<u64, StoreError> {
    if !may(By::Right, from, to) {
        return Err(StoreError::IllegalEdge { from, to });
    }
    let sql = format!(
        "UPDATE records SET state = ?5 WHERE n IN (SELECT n FROM records INDEXED BY records_by_state
            WHERE state = ?4 AND stream IN ({STREAMS}) LIMIT {MOST})"
    );
    let values = params![keeper.0, owner.0, signer.0, from.code(), to.code()];
    Ok(count(connection.run(&sql, values)?))
}

/// Closed, unsent batches that contain records of a signer.
fn unsent_batches(
    connection: &Connection,
    keeper: Address,
    owner: Address,
    signer: SignerId,
) -> Result<Vec<i64>, StoreError> {
    let sql = format!(
        "SELECT DISTINCT batch FROM records INDEXED BY records_by_state JOIN leaves ON record = n
            JOIN batches ON key = batch WHERE state = ?4 AND stream IN ({STREAMS})
            AND batches.tx IS NULL AND batches.block IS NULL"
    );
    let values = params![keeper.0, owner.0, signer.0, RecordState::Batched.code()];
    Ok(connection.list(&sql, values, |row| row.get(0))?)
}

/// An unsent batch is dissolved; its root stays known as this ledger's.
fn dissolve(connection: &Connection, batch: i64) -> Result<(), StoreError> {
    let [batched, stored] = [RecordState::Batched, RecordState::Stored];
    if !may(By::Right, batched, stored) {
        return Err(StoreError::IllegalEdge { from: batched, to: stored });
    }
    let sql = "UPDATE records SET state = ?3 WHERE +state = ?2 AND n IN (SELECT record FROM leaves WHERE batch = ?1)";
    connection.run(sql, params![batch, batched.code(), stored.code()])?;
    connection.run("REPLACE INTO left_places SELECT batch, leaf, record FROM leaves WHERE batch = ?1", [batch])?;
    connection.run("DELETE FROM leaves WHERE batch = ?1", [batch])?;
    Ok(())
}

fn pass_over_one(connection: &Connection, digest: Digest) -> Result<u64, StoreError> {
    let [confirmed, stored] = [RecordState::Confirmed, RecordState::Stored];
    if !may(By::Right, confirmed, stored) {
        return Err(StoreError::IllegalEdge { from: confirmed, to: stored });
    }
    let sql =
        concat!("SELECT n FROM records WHERE digest = ?1 AND state = ?2 AND ", anchored!("block"), " IS NOT NULL");
    let found: Option<i64> = connection.find(sql, params![digest.0, confirmed.code()], |row| row.get(0))?;
    let Some(record) = found else { return Ok(0) };
    for step in [
        concat!("REPLACE INTO passed_over SELECT n, ", anchored!("block"), " FROM records WHERE n = ?1"),
        "REPLACE INTO left_places SELECT batch, leaf, record FROM leaves WHERE record = ?1",
        "DELETE FROM leaves WHERE record = ?1",
    ] {
        connection.run(step, [record])?;
    }
    let sql = "UPDATE records SET state = ?2, tx = NULL, block = NULL, block_hash = NULL WHERE n = ?1";
    connection.run(sql, params![record, stored.code()])?;
    Ok(1)
}

/// A batch that all its records left is closed over the same ones again: it waits, as if it had never been sent.
pub(super) fn begin_again(connection: &Connection, batch: i64) -> Result<bool, StoreError> {
    let in_use = connection.has("SELECT 1 FROM leaves WHERE batch = ?1", [batch])?;
    if in_use {
        return Ok(false);
    }
    connection.run("DELETE FROM left_places WHERE batch = ?1", [batch])?;
    let sql = "UPDATE batches SET tx = NULL, account = NULL, block = NULL, block_hash = NULL, closed_here = 1
        WHERE key = ?1";
    connection.run(sql, [batch])?;
    Ok(true)
}

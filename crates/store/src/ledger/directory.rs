//! Who is registered and who may read, by the contract's events. Superseded events stay, marked, as history and to undo
//! a replaced block.

use std::path::Path;

use super::query::Glance;
use super::rows::{By, anchored, check, of_its_batch, optional, unsigned};
use super::writer::Session;
use super::{Batches, Rights, batches};
use crate::StoreError;
use crate::crypto::merkle::Leaf;
use crate::database::{capped, whole};
use crate::model::{Address, Digest, Domain, RecordState, SignerId, Token};
use crate::sql::{self, Connection, Row, params};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RightKind {
    Grant = 1,
    /// Of another epoch.
    Envelope = 2,
    /// Of a grant.
    Extension = 3,
    /// With a grantee: its grant was revoked.
    Epoch = 4,
    Other = 5,
    /// An epoch's key, wrapped for its owner, who alone reads it; history from the start.
    Own = 6,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RightEvent {
    pub block: u64,
    /// Among the block's events.
    pub place: u64,
    pub kind: RightKind,
    pub owner: Option<Address>,
    /// Current or former.
    pub grantee: Option<Address>,
    pub epoch: Option<u64>,
    /// Of that epoch.
    pub token: Option<Token>,
    /// All but the envelope, in its reader's encoding.
    pub event: String,
    pub envelope: Option<Vec<u8>>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptRight {
    pub block: u64,
    /// Among the block's events.
    pub place: u64,
    pub event: String,
    /// The epoch that began with its grant's revocation.
    pub revoked: Option<u64>,
}

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct StandingRights {
    /// Block and place; `None` before the first event.
    pub last: Option<(u64, u64)>,
    /// In the chain's order.
    pub events: Vec<KeptRight>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptEnvelope {
    /// Whose keys it contains.
    pub epoch: u64,
    /// Of the event.
    pub block: u64,
    pub bytes: Vec<u8>,
}

/// An extension or epoch supersedes the one before it, a revocation its grant.
pub(super) const ENDING: [&str; 3] = [
    "UPDATE rights INDEXED BY rights_standing SET replaced = ?3
        WHERE owner = ?1 AND kind = 3 AND grantee = ?2 AND replaced IS NULL AND revoked IS NULL",
    "UPDATE rights INDEXED BY rights_standing SET replaced = ?2
        WHERE owner = ?1 AND kind = 4 AND replaced IS NULL AND revoked IS NULL",
    "UPDATE rights INDEXED BY rights_standing SET revoked = ?4, revoked_at = ?3
        WHERE owner = ?1 AND kind IN (1, 2, 3) AND grantee = ?2
        AND replaced IS NULL AND revoked IS NULL",
];
const WHOLE_BLOCK: i64 = i64::MAX;
/// Identifies the contract.
pub(super) const PIN: &str = "SELECT pin FROM contract";
const UP_TO: &str = "UPDATE contract SET block = ?1, place = ?2";

impl Rights {
    pub fn path(&self) -> &Path {
        self.0.path()
    }

    /// A ledger is bound to one contract; `pin` identifies it.
    pub fn bind_contract(&self, domain: Domain, pin: &str) -> Result<(), StoreError> {
        let pin = pin.to_owned();
        self.0.write(move |Session { connection, .. }| {
            let sql = "INSERT INTO contract VALUES (1, ?1, ?2, 0, -1) ON CONFLICT (one) DO UPDATE SET pin = excluded.pin \
                       WHERE contract.domain = excluded.domain AND contract.pin <> excluded.pin";
            connection.run(sql, params![domain.0, pin])?;
            let bound = connection.one("SELECT domain FROM contract", [], |row| row.get(0).map(Domain))?;
            if bound == domain { Ok(()) } else { Err(StoreError::Bound { bound, domain }) }
        })
    }

    /// `None` if unbound.
    pub fn contract_pin(&self) -> Result<Option<String>, StoreError> {
        self.0.find(PIN, [], |row| row.get(0))
    }

    /// Reads a ledger that may be in use or damaged; writes nothing.
    pub fn contract_pin_in(path: &Path) -> Result<Option<String>, StoreError> {
        if !path.exists() {
            return Ok(None);
        }
        Glance::at(path)?.contract_pin()
    }

    /// Stores events in the chain's order in one commit; skips known ones.
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

    /// Neither grants nor epochs, in the chain's order.
    pub fn other_rights(&self, account: Address) -> Result<Vec<KeptRight>, StoreError> {
        let sql = "SELECT block, place, event, revoked FROM rights INDEXED BY rights_standing
            WHERE owner = ?1 AND kind = 5 AND replaced IS NULL AND revoked IS NULL ORDER BY block, place";
        self.0.list(sql, [account.0], kept)
    }

    /// Undoes the events of blocks from `from` on, and what they superseded, in one commit.
    pub fn take_back_rights(&self, from: u64) -> Result<(), StoreError> {
        let from = whole("block", from)?;
        self.0.write_many(super::writer::MANY + 1, move |Session { connection, .. }| {
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
            connection.run(UP_TO, [from - 1, WHOLE_BLOCK])
        })
    }

    /// In the chain's order.
    pub fn rights_in(&self, from: u64, to: u64) -> Result<Vec<KeptRight>, StoreError> {
        let (from, to) = (whole("block", from)?, whole("block", to)?);
        let sql = "SELECT block, place, event, revoked FROM rights WHERE block BETWEEN ?1 AND ?2 ORDER BY block, place";
        self.0.list(sql, [from, to], kept)
    }

    /// Block and place of events that are not stored.
    pub fn unknown_rights(&self, places: &[(u64, u64)]) -> Result<Vec<(u64, u64)>, StoreError> {
        self.0.read(|connection| {
            let sql = "SELECT 1 FROM rights WHERE block = ?1 AND place = ?2";
            connection.among(sql, places, |(block, place)| Ok([whole("block", block)?, whole("place", place)?]), false)
        })
    }

    /// Makes the watcher read them again.
    pub fn forget_rights(&self) -> Result<(), StoreError> {
        self.0.write_many(super::writer::MANY + 1, move |session| {
            session.connection.script("DELETE FROM envelopes; DELETE FROM rights;")?;
            session.connection.run(UP_TO, [0, -1])
        })
    }

    /// Revoked grants that an account gave or received, with extensions, in the chain's order.
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

    /// Of the current grant, or of the one whose revocation began `revoked`; in the chain's order.
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
        self.0.list(&sql, params![owner.0, grantee.0, asked], envelope)
    }

    /// Made by an owner for itself; in the chain's order.
    pub fn own_envelopes(&self, owner: Address, from: u64, to: u64) -> Result<Vec<KeptEnvelope>, StoreError> {
        let (from, to) = (whole("epoch", from)?, whole("epoch", to)?);
        let sql = "SELECT r.epoch, r.block, e.envelope FROM rights r INDEXED BY rights_own
            JOIN envelopes e ON e.block = r.block AND e.place = r.place
            WHERE owner = ?1 AND epoch BETWEEN ?2 AND ?3 AND kind = 6 ORDER BY r.block, r.place";
        self.0.list(sql, params![owner.0, from, to], envelope)
    }

    pub fn envelope_at(&self, block: u64, place: u64) -> Result<Option<Vec<u8>>, StoreError> {
        let sql = "SELECT envelope FROM envelopes WHERE block = ?1 AND place = ?2";
        self.0.find(sql, [whole("block", block)?, whole("place", place)?], |row| row.get(0))
    }

    pub fn epoch_token(&self, owner: Address, epoch: u64) -> Result<Option<Token>, StoreError> {
        let epoch = whole("epoch", epoch)?;
        let sql = "SELECT token FROM rights INDEXED BY rights_tokens
            WHERE owner = ?1 AND epoch = ?2 AND token IS NOT NULL
            ORDER BY block, place LIMIT 1";
        self.0.find(sql, params![owner.0, epoch], |row| row.get(0).map(Token))
    }

    pub fn ever_had_token(&self, owner: Address, token: Token) -> Result<bool, StoreError> {
        let sql = "SELECT 1 FROM rights INDEXED BY rights_tokens WHERE owner = ?1 AND token IS NOT NULL AND token = ?2";
        self.0.has(sql, params![owner.0, token.0])
    }
}

fn kept(row: &Row<'_>) -> sql::Result<KeptRight> {
    let (block, place, revoked) = (unsigned(row, 0)?, unsigned(row, 1)?, optional(row, 3)?);
    Ok(KeptRight { block, place, event: row.get(2)?, revoked })
}

fn envelope(row: &Row<'_>) -> sql::Result<KeptEnvelope> {
    Ok(KeptEnvelope { epoch: unsigned(row, 0)?, block: unsigned(row, 1)?, bytes: row.get(2)? })
}

/// Block and place; (0, -1) before the first event.
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
    connection.run(UP_TO, [block, place])
}

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
    let [owner, grantee] = [event.owner, event.grantee].map(|account| account.map(|account| account.0));
    let (kind, token) = (event.kind as i64, event.token.map(|token| token.0));
    let replaced = (event.kind == RightKind::Own).then_some(block);
    connection.run(sql, params![block, place, kind, owner, grantee, epoch, token, event.event, replaced])?;
    if let Some(envelope) = &event.envelope {
        connection.run("INSERT INTO envelopes VALUES (?1, ?2, ?3)", params![block, place, envelope])?;
    }
    Ok(())
}

// Callers decide rights; the ledger holds records of signers without a right, and ignores their anchors.

/// The account that anchors, the owner and the signer of records.
type Whose = (Address, Address, SignerId);

/// Per commit.
const MOST: usize = 8192;

/// Has records that an account is to anchor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WaitingSigner {
    /// For whom it signed.
    pub owner: Address,
    pub signer: SignerId,
    /// Records wait for its right.
    pub held: bool,
    /// Records wait for an anchor.
    pub ready: bool,
}

/// Of one signer and owner, anchored by one account.
const STREAMS: &str =
    "SELECT s.key FROM streams s JOIN topics t ON t.key = s.topic JOIN recorders r ON r.key = t.recorder
        WHERE coalesce(t.keeper, t.owner) = ?1 AND t.owner = ?2 AND r.signer = ?3";

impl Batches {
    /// Signers of stored, batched or held records that `keeper` anchors.
    pub fn waiting_signers(&self, keeper: Address) -> Result<Vec<WaitingSigner>, StoreError> {
        let [held, stored, batched] =
            [RecordState::RightEnded, RecordState::Stored, RecordState::Batched].map(RecordState::code);
        let sql = "SELECT t.owner, r.signer, max(CASE c.state WHEN ?2 THEN 1 ELSE 0 END),
                max(CASE c.state WHEN ?2 THEN 0 ELSE 1 END)
            FROM streams s JOIN topics t ON t.key = s.topic JOIN recorders r ON r.key = t.recorder
            JOIN counters c ON c.stream = s.key
            WHERE coalesce(t.keeper, t.owner) = ?1 AND c.records > 0 AND c.state IN (?2, ?3, ?4)
            GROUP BY t.owner, r.signer";
        self.0.list(sql, params![keeper.0, held, stored, batched], |row| {
            let (owner, signer) = (Address(row.get(0)?), SignerId(row.get(1)?));
            Ok(WaitingSigner { owner, signer, held: row.get(2)?, ready: row.get(3)? })
        })
    }

    /// A right ended: records without a transaction wait, and unsent batches with them dissolve. Returns how many began
    /// to wait; call until 0.
    pub fn hold_signer(&self, keeper: Address, owner: Address, signer: SignerId) -> Result<u64, StoreError> {
        self.0.write_many(MOST, move |session| {
            let whose = (keeper, owner, signer);
            for batch in unsent_batches(session.connection, whose)? {
                dissolve(session.connection, batch)?;
            }
            shift(session.connection, whose, (RecordState::Stored, RecordState::RightEnded))
        })
    }

    /// A right is back: its records are stored. Returns how many; call until 0.
    pub fn free_signer(&self, keeper: Address, owner: Address, signer: SignerId) -> Result<u64, StoreError> {
        self.0.write_many(MOST, move |session| {
            shift(session.connection, (keeper, owner, signer), (RecordState::RightEnded, RecordState::Stored))
        })
    }

    /// Confirmed records whose signers had no right at their blocks leave their batches, to be anchored again. Returns
    /// how many there were.
    pub fn pass_over(&self, digests: &[Digest]) -> Result<u64, StoreError> {
        let digests = digests.to_vec();
        self.0.write_many(digests.len(), move |session| {
            digests.iter().try_fold(0, |moved, digest| Ok(moved + pass_over_one(session.connection, *digest)?))
        })
    }

    /// Stored records whose blocks were ignored.
    pub fn passed_over_leaves(&self, keeper: Address, limit: usize) -> Result<Vec<Leaf>, StoreError> {
        let sql = "SELECT recorders.id, topics.topic_id, seq, digest, topics.owner, recorders.signer FROM passed_over
            JOIN records ON n = passed_over.record JOIN topics ON topics.key = records.topic
            JOIN recorders ON recorders.key = topics.recorder
            WHERE state = ?2 AND coalesce(topics.keeper, topics.owner) = ?1 ORDER BY n LIMIT ?3";
        self.0.list(sql, params![keeper.0, RecordState::Stored.code(), capped(limit)], batches::leaf)
    }
}

/// At most [`MOST`] records.
fn shift(
    connection: &Connection,
    (keeper, owner, signer): Whose,
    (from, to): (RecordState, RecordState),
) -> Result<u64, StoreError> {
    check(By::Right, from, to)?;
    let sql = format!(
        "UPDATE records SET state = ?5 WHERE n IN (SELECT n FROM records INDEXED BY records_by_state
            WHERE state = ?4 AND stream IN ({STREAMS}) LIMIT {MOST})"
    );
    let values = params![keeper.0, owner.0, signer.0, from.code(), to.code()];
    Ok(connection.changed(&sql, values)?)
}

fn unsent_batches(connection: &Connection, (keeper, owner, signer): Whose) -> Result<Vec<i64>, StoreError> {
    let sql = format!(
        "SELECT DISTINCT batch FROM records INDEXED BY records_by_state JOIN leaves ON record = n
            JOIN batches ON key = batch WHERE state = ?4 AND stream IN ({STREAMS})
            AND batches.tx IS NULL AND batches.block IS NULL"
    );
    let values = params![keeper.0, owner.0, signer.0, RecordState::Batched.code()];
    Ok(connection.list(&sql, values, |row| row.get(0))?)
}

const LEAVE_BATCH: &str = "INSERT INTO left_places SELECT batch, leaf, record FROM leaves WHERE batch = ?1
    ON CONFLICT (batch, leaf) DO UPDATE SET record = excluded.record";

/// The root stays known as this ledger's.
fn dissolve(connection: &Connection, batch: i64) -> Result<(), StoreError> {
    let [batched, stored] = [RecordState::Batched, RecordState::Stored];
    check(By::Right, batched, stored)?;
    let sql = "UPDATE records SET state = ?3 WHERE +state = ?2 AND n IN (SELECT record FROM leaves WHERE batch = ?1)";
    connection.run(sql, params![batch, batched.code(), stored.code()])?;
    connection.run(LEAVE_BATCH, [batch])?;
    connection.run("DELETE FROM leaves WHERE batch = ?1", [batch])
}

fn pass_over_one(connection: &Connection, digest: Digest) -> Result<u64, StoreError> {
    let [confirmed, stored] = [RecordState::Confirmed, RecordState::Stored];
    check(By::Right, confirmed, stored)?;
    let sql =
        concat!("SELECT n FROM records WHERE digest = ?1 AND state = ?2 AND ", anchored!("block"), " IS NOT NULL");
    let found: Option<i64> = connection.find(sql, params![digest.0, confirmed.code()], |row| row.get(0))?;
    let Some(record) = found else { return Ok(0) };
    for step in [
        concat!(
            "INSERT INTO passed_over SELECT n, ",
            anchored!("block"),
            " FROM records WHERE n = ?1 ON CONFLICT (record) DO UPDATE SET block = excluded.block"
        ),
        batches::LEAVE_PLACE,
        "DELETE FROM leaves WHERE record = ?1",
    ] {
        connection.run(step, [record])?;
    }
    let sql = "UPDATE records SET state = ?2, tx = NULL, block = NULL, block_hash = NULL WHERE n = ?1";
    connection.run(sql, params![record, stored.code()])?;
    Ok(1)
}

/// A batch that all its records left waits again when it is closed over the same ones.
pub(super) fn begin_again(connection: &Connection, batch: i64) -> Result<bool, StoreError> {
    if connection.has("SELECT 1 FROM leaves WHERE batch = ?1", [batch])? {
        return Ok(false);
    }
    connection.run("DELETE FROM left_places WHERE batch = ?1", [batch])?;
    let sql = "UPDATE batches SET tx = NULL, account = NULL, block = NULL, block_hash = NULL, closed_here = 1
        WHERE key = ?1";
    connection.run(sql, [batch])?;
    Ok(true)
}

//! Who is registered and who may read what, as a contract's events say. Each event is a row, and events that no longer
//! count are marked: the current ones are found without the others, the others are history, and a replaced block can be
//! undone.

use rusqlite::{Connection, OptionalExtension as _, Row, params};

use super::writer::Session;
use super::{Ledger, rows::unsigned};
use crate::model::{Address, Domain, Token};
use crate::store::StoreError;
use crate::store::database::whole;

/// The subject of an event, as far as it matters here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RightKind {
    /// A grant.
    Grant = 1,
    /// An envelope of another epoch.
    Envelope = 2,
    /// An extension of a grant.
    Extension = 3,
    /// An epoch began; if a grantee is named, by the revocation of its grant.
    Epoch = 4,
    /// Anything else.
    Other = 5,
}

/// An event to be stored.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RightEvent {
    /// Its block.
    pub block: u64,
    /// Its index among the block's events.
    pub place: u64,
    /// Its subject.
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
    /// The envelope.
    pub envelope: Option<Vec<u8>>,
}

/// A stored event.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptRight {
    /// Its block.
    pub block: u64,
    /// Its index among the block's events.
    pub place: u64,
    /// Its encoding.
    pub event: String,
    /// The epoch that began when its grant was revoked.
    pub revoked: Option<u64>,
}

/// The current events of a contract.
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
    /// Its bytes.
    pub bytes: Vec<u8>,
}

/// What an event supersedes: an extension supersedes the one before it, an epoch the one before it, a revocation its
/// grant.
pub(super) const ENDING: [&str; 3] = [
    "UPDATE rights INDEXED BY rights_standing SET replaced = ?4
     WHERE contract = ?1 AND owner = ?2 AND kind = 3 AND grantee = ?3 AND replaced IS NULL AND revoked IS NULL",
    "UPDATE rights INDEXED BY rights_standing SET replaced = ?3
     WHERE contract = ?1 AND owner = ?2 AND kind = 4 AND replaced IS NULL AND revoked IS NULL",
    "UPDATE rights INDEXED BY rights_standing SET revoked = ?5, revoked_at = ?4
     WHERE contract = ?1 AND owner = ?2 AND kind IN (1, 2, 3) AND grantee = ?3
     AND replaced IS NULL AND revoked IS NULL",
];
/// After every event of a block.
const WHOLE_BLOCK: i64 = i64::MAX;

impl Ledger {
    /// Stores events of a contract in the chain's order, all in one commit; those already there are skipped.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; then nothing is stored.
    pub fn keep_rights(&self, domain: Domain, events: Vec<RightEvent>) -> Result<(), StoreError> {
        self.write_many(events.len(), move |session| keep_all(session, domain, &events))
    }

    /// The current events of a contract; `None` if none were read yet.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn standing_rights(&self, domain: Domain) -> Result<Option<StandingRights>, StoreError> {
        self.read(|connection| {
            let Some((contract, block, place)) = contract(connection, domain)? else { return Ok(None) };
            let sql = "SELECT block, place, event, revoked FROM rights INDEXED BY rights_standing
                       WHERE contract = ?1 AND replaced IS NULL AND revoked IS NULL ORDER BY block, place";
            let mut statement = connection.prepare_cached(sql)?;
            let events = statement.query_map([contract], kept)?.collect::<Result<_, _>>()?;
            let last = (place >= 0).then_some((block.cast_unsigned(), place.cast_unsigned()));
            Ok(Some(StandingRights { last, events }))
        })
    }

    /// Undoes the events of all blocks from `from` on, and what they superseded, in one commit.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; then nothing is undone.
    pub fn take_back_rights(&self, domain: Domain, from: u64) -> Result<(), StoreError> {
        let from = whole("block", from)?;
        self.write_many(super::writer::MANY + 1, move |session| {
            let connection = session.connection;
            let kept = contract(connection, domain)?.filter(|(_, block, _)| *block >= from);
            let Some((contract, ..)) = kept else { return Ok(()) };
            for sql in [
                "DELETE FROM envelopes WHERE contract = ?1 AND block >= ?2",
                "DELETE FROM rights WHERE contract = ?1 AND block >= ?2",
                "UPDATE rights SET replaced = NULL WHERE contract = ?1 AND replaced >= ?2",
                "UPDATE rights SET revoked = NULL, revoked_at = NULL WHERE contract = ?1 AND revoked_at >= ?2",
            ] {
                connection.prepare_cached(sql)?.execute([contract, from])?;
            }
            let sql = "UPDATE contracts SET block = ?2 - 1, place = ?3 WHERE key = ?1 AND block >= ?2";
            connection.prepare_cached(sql)?.execute([contract, from, WHOLE_BLOCK])?;
            Ok(())
        })
    }

    /// Deletes everything read of a contract.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; then nothing is deleted.
    pub fn forget_rights(&self, domain: Domain) -> Result<(), StoreError> {
        self.write_many(super::writer::MANY + 1, move |session| {
            let Some((contract, ..)) = contract(session.connection, domain)? else { return Ok(()) };
            for table in ["envelopes", "rights"] {
                session.connection.execute(&format!("DELETE FROM {table} WHERE contract = ?1"), [contract])?;
            }
            session.connection.execute("DELETE FROM contracts WHERE key = ?1", [contract])?;
            Ok(())
        })
    }

    /// Grants that an account gave or received and that were revoked, with their extensions, in the chain's order.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn revoked_grants(&self, domain: Domain, account: Address) -> Result<Vec<KeptRight>, StoreError> {
        self.read(|connection| {
            let Some((contract, ..)) = contract(connection, domain)? else { return Ok(Vec::new()) };
            let mut found: Vec<KeptRight> = Vec::new();
            for (side, index) in [("owner", "rights_given"), ("grantee", "rights_received")] {
                let sql = format!(
                    "SELECT block, place, event, revoked FROM rights INDEXED BY {index}
                     WHERE contract = ?1 AND {side} = ?2 AND revoked IS NOT NULL AND replaced IS NULL AND kind IN (1, 3)"
                );
                let mut statement = connection.prepare_cached(&sql)?;
                for row in statement.query_map(params![contract, account.0], kept)? {
                    found.push(row?);
                }
            }
            found.sort_by_key(|row| (row.block, row.place));
            found.dedup();
            Ok(found)
        })
    }

    /// The envelopes of a current grant, or of the one whose revocation began the epoch `revoked`; in the chain's
    /// order.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn envelopes_between(
        &self,
        domain: Domain,
        owner: Address,
        grantee: Address,
        revoked: Option<u64>,
    ) -> Result<Vec<KeptEnvelope>, StoreError> {
        let asked = whole("epoch", revoked.unwrap_or(0))?;
        self.read(|connection| {
            let Some((contract, ..)) = contract(connection, domain)? else { return Ok(Vec::new()) };
            let (index, which) = match revoked {
                None => ("rights_standing", "replaced IS NULL AND revoked IS NULL AND ?4 = 0"),
                Some(_) => ("rights_given", "revoked IS NOT NULL AND revoked = ?4"),
            };
            let sql = format!(
                "SELECT r.epoch, r.block, e.envelope FROM rights r INDEXED BY {index}
                 JOIN envelopes e ON e.contract = r.contract AND e.block = r.block AND e.place = r.place
                 WHERE r.contract = ?1 AND owner = ?2 AND kind IN (1, 2) AND grantee = ?3 AND {which}
                 ORDER BY r.block, r.place"
            );
            let mut statement = connection.prepare_cached(&sql)?;
            let found = statement.query_map(params![contract, owner.0, grantee.0, asked], |row| {
                Ok(KeptEnvelope { epoch: unsigned(row, 0)?, block: unsigned(row, 1)?, bytes: row.get(2)? })
            })?;
            Ok(found.collect::<Result<_, _>>()?)
        })
    }

    /// The token that an owner registered for an epoch.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn epoch_token(&self, domain: Domain, owner: Address, epoch: u64) -> Result<Option<Token>, StoreError> {
        let epoch = whole("epoch", epoch)?;
        self.read(|connection| {
            let Some((contract, ..)) = contract(connection, domain)? else { return Ok(None) };
            let sql = "SELECT token FROM rights INDEXED BY rights_tokens
                       WHERE contract = ?1 AND owner = ?2 AND epoch = ?3 AND token IS NOT NULL
                       ORDER BY block, place LIMIT 1";
            let mut statement = connection.prepare_cached(sql)?;
            Ok(statement.query_row(params![contract, owner.0, epoch], |row| row.get(0).map(Token)).optional()?)
        })
    }

    /// Whether an owner ever registered this token.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn ever_had_token(&self, domain: Domain, owner: Address, token: Token) -> Result<bool, StoreError> {
        self.read(|connection| {
            let Some((contract, ..)) = contract(connection, domain)? else { return Ok(false) };
            let sql = "SELECT 1 FROM rights INDEXED BY rights_tokens
                       WHERE contract = ?1 AND owner = ?2 AND token IS NOT NULL AND token = ?3";
            Ok(connection.prepare_cached(sql)?.exists(params![contract, owner.0, token.0])?)
        })
    }
}

fn kept(row: &Row<'_>) -> rusqlite::Result<KeptRight> {
    let revoked = row.get::<_, Option<i64>>(3)?.map(i64::cast_unsigned);
    Ok(KeptRight { block: unsigned(row, 0)?, place: unsigned(row, 1)?, event: row.get(2)?, revoked })
}

/// The contract's key, and block and index of the last event stored.
fn contract(connection: &Connection, domain: Domain) -> Result<Option<(i64, i64, i64)>, StoreError> {
    let mut statement = connection.prepare_cached("SELECT key, block, place FROM contracts WHERE domain = ?1")?;
    let found = statement.query_row([domain.0], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)));
    Ok(found.optional()?)
}

fn keep_all(session: &Session<'_>, domain: Domain, events: &[RightEvent]) -> Result<(), StoreError> {
    let connection = session.connection;
    connection
        .prepare_cached("INSERT INTO contracts (domain, block, place) VALUES (?1, 0, -1) ON CONFLICT DO NOTHING")?
        .execute([domain.0])?;
    let Some((contract, mut block, mut place)) = contract(connection, domain)? else { return Ok(()) };
    for event in events {
        let at = (whole("block", event.block)?, whole("place", event.place)?);
        if at <= (block, place) {
            continue;
        }
        end_others(connection, contract, event)?;
        keep_one(connection, contract, event)?;
        (block, place) = at;
    }
    connection
        .prepare_cached("UPDATE contracts SET block = ?2, place = ?3 WHERE key = ?1")?
        .execute([contract, block, place])?;
    Ok(())
}

/// Marks what an event supersedes.
fn end_others(connection: &Connection, contract: i64, event: &RightEvent) -> Result<(), StoreError> {
    let (Some(owner), block) = (event.owner, whole("block", event.block)?) else { return Ok(()) };
    let [extended, begun, revoked] = ENDING;
    match (event.kind, event.grantee) {
        (RightKind::Extension, Some(grantee)) => {
            connection.prepare_cached(extended)?.execute(params![contract, owner.0, grantee.0, block])?;
        }
        (RightKind::Epoch, grantee) => {
            connection.prepare_cached(begun)?.execute(params![contract, owner.0, block])?;
            let epoch = whole("epoch", event.epoch.unwrap_or(0))?;
            if let Some(grantee) = grantee {
                connection.prepare_cached(revoked)?.execute(params![contract, owner.0, grantee.0, block, epoch])?;
            }
        }
        _ => {}
    }
    Ok(())
}

fn keep_one(connection: &Connection, contract: i64, event: &RightEvent) -> Result<(), StoreError> {
    let (block, place) = (whole("block", event.block)?, whole("place", event.place)?);
    let epoch = event.epoch.map(|epoch| whole("epoch", epoch)).transpose()?;
    connection
        .prepare_cached(
            "INSERT INTO rights (contract, block, place, kind, owner, grantee, epoch, token, event)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9)",
        )?
        .execute(params![
            contract,
            block,
            place,
            event.kind as i64,
            event.owner.map(|owner| owner.0),
            event.grantee.map(|grantee| grantee.0),
            epoch,
            event.token.map(|token| token.0),
            event.event,
        ])?;
    if let Some(envelope) = &event.envelope {
        connection
            .prepare_cached("INSERT INTO envelopes VALUES (?1, ?2, ?3, ?4)")?
            .execute(params![contract, block, place, envelope])?;
    }
    Ok(())
}

//! Witnesses: the parties that countersign for this home or are served by it, what they gave, what they were given, and
//! statements that contradict each other.

use rusqlite::{OptionalExtension as _, Row, params};

use super::rows::unsigned;
use super::{Ledger, database::whole};
use crate::model::{Address, Countersignature, Domain, Hash, SignedPosition, SignerId, Timestamp};
use crate::store::StoreError;

/// Batches are looked at again this far behind the last one under a position: they reach the chain out of order.
const BEHIND: i64 = 10_000;
/// What is kept of a party's statements on one network.
const MOST_KEPT: i64 = 1000;
/// The most contradictions kept of one party: more prove nothing more.
const MOST_CONTRADICTIONS: i64 = 16;

/// A party that is a witness of an owner here, or for which this home is one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WitnessRow {
    /// The owner here.
    pub owner: Address,
    /// SM3 of the party's key.
    pub key: SignerId,
    /// The party's account, on its own chain.
    pub account: Address,
    /// Its name here.
    pub name: String,
    /// Its gateway; `None` if it is never asked.
    pub address: Option<String>,
    /// Whether its statements are countersigned here.
    pub serves: bool,
    /// When it was added.
    pub added_at: Timestamp,
}

/// Batches that a witness has not countersigned yet, in the order of their closing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unwitnessed {
    /// The last of them.
    pub upto: u64,
    /// Their roots.
    pub roots: Vec<Hash>,
    /// The newest block that anchors one of them.
    pub block: u64,
}

/// A countersignature with the roots under it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptPosition {
    /// The roots in their order.
    pub roots: Vec<Hash>,
    /// What the witness gave.
    pub countersignature: Countersignature,
}

/// Two statements of one party that cannot both be true.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptContradiction {
    /// SM3 of the party's key.
    pub party: SignerId,
    /// When the later one arrived.
    pub at: Timestamp,
    /// What they contradict each other in.
    pub what: String,
    /// The one that was countersigned here.
    pub kept: Countersignature,
    /// The one that came later.
    pub later: SignedPosition,
}

/// What a witness gave an owner.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PositionCounts {
    /// How many countersignatures.
    pub positions: u64,
    /// When the newest was given, by the witness's clock.
    pub newest: Option<Timestamp>,
}

impl Ledger {
    /// Adds a party, or replaces what was written about it.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like: then nothing is changed.
    pub fn put_witness(&self, row: WitnessRow) -> Result<(), StoreError> {
        let added = whole("time", row.added_at.0)?;
        self.write(move |session| {
            let WitnessRow { owner, key, account, name, address, serves, .. } = row;
            session
                .connection
                .prepare_cached("INSERT OR REPLACE INTO witnesses VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)")?
                .execute(params![owner.0, key.0, account.0, name, address, serves, added])?;
            Ok(())
        })
    }

    /// Removes a party of an owner; whether it was there. What was countersigned for a party that nobody here serves any
    /// more is forgotten with it, so that it can begin anew; contradictions stay.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like: then nothing is changed.
    pub fn remove_witness(&self, owner: Address, key: SignerId) -> Result<bool, StoreError> {
        self.write(move |session| {
            let connection = session.connection;
            let removed =
                connection.execute("DELETE FROM witnesses WHERE owner = ?1 AND key = ?2", params![owner.0, key.0])?;
            connection.execute(
                "DELETE FROM countersigned WHERE party = ?1
                 AND NOT EXISTS (SELECT 1 FROM witnesses WHERE key = ?1 AND serves)",
                [key.0],
            )?;
            Ok(removed > 0)
        })
    }

    /// All parties of all owners here, by name.
    ///
    /// # Errors
    /// [`StoreError::Database`] and its kin.
    pub fn witnesses(&self) -> Result<Vec<WitnessRow>, StoreError> {
        self.read(|connection| {
            let sql =
                "SELECT owner, key, account, name, address, serves, added_at FROM witnesses ORDER BY name, key, owner";
            let mut statement = connection.prepare_cached(sql)?;
            let rows = statement.query_map([], |row| {
                Ok(WitnessRow {
                    owner: Address(row.get(0)?),
                    key: SignerId(row.get(1)?),
                    account: Address(row.get(2)?),
                    name: row.get(3)?,
                    address: row.get(4)?,
                    serves: row.get(5)?,
                    added_at: Timestamp(unsigned(row, 6)?),
                })
            })?;
            Ok(rows.collect::<Result<_, _>>()?)
        })
    }

    /// The oldest batches of an owner, in blocks up to `confirmed`, that this witness has not countersigned; at most `most`.
    ///
    /// # Errors
    /// [`StoreError::Database`] and its kin.
    pub fn unwitnessed(
        &self,
        (owner, witness): (Address, SignerId),
        network: Domain,
        confirmed: u64,
        most: usize,
    ) -> Result<Option<Unwitnessed>, StoreError> {
        let (confirmed, most) = (whole("block", confirmed)?, i64::try_from(most).unwrap_or(i64::MAX));
        self.read(|connection| {
            let sql = "SELECT key, root, block FROM batches
                       WHERE owner = ?1 AND block <= ?4 AND key > coalesce((SELECT max(upto) FROM positions
                           WHERE owner = ?1 AND witness = ?2 AND network = ?3), 0) - ?5
                       AND NOT EXISTS (SELECT 1 FROM witnessed_roots JOIN positions ON positions.key = position
                           WHERE root = batches.root AND witnessed_roots.witness = ?2 AND network = ?3)
                       ORDER BY key LIMIT ?6";
            let mut statement = connection.prepare_cached(sql)?;
            let rows = statement.query_map(params![owner.0, witness.0, network.0, confirmed, BEHIND, most], |row| {
                Ok((unsigned(row, 0)?, Hash(row.get(1)?), unsigned(row, 2)?))
            })?;
            let found: Vec<(u64, Hash, u64)> = rows.collect::<Result<_, _>>()?;
            let newest = found.iter().map(|(_, _, block)| *block).max();
            let upto = found.last().map(|(key, _, _)| *key);
            let roots = found.iter().map(|(_, root, _)| *root).collect();
            Ok(upto.zip(newest).map(|(upto, block)| Unwitnessed { upto, roots, block }))
        })
    }

    /// Stores a countersignature over these batches of an owner.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like: then the witness is asked again.
    pub fn keep_position(
        &self,
        (owner, witness): (Address, SignerId),
        network: Domain,
        batches: Unwitnessed,
        countersignature: Countersignature,
    ) -> Result<(), StoreError> {
        let (upto, at) = (whole("batch", batches.upto)?, whole("time", countersignature.at.0)?);
        self.write_many(batches.roots.len(), move |session| {
            let connection = session.connection;
            let roots: Vec<u8> = batches.roots.iter().flat_map(|root| root.0).collect();
            connection
                .prepare_cached(
                    "INSERT INTO positions (owner, witness, network, upto, at, roots, countersignature)
                     VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)",
                )?
                .execute(params![owner.0, witness.0, network.0, upto, at, roots, countersignature.encode()])?;
            let key = connection.last_insert_rowid();
            // A batch that left a chain is witnessed again on the next one.
            let mut add = connection.prepare_cached("INSERT OR REPLACE INTO witnessed_roots VALUES (?1, ?2, ?3)")?;
            for root in &batches.roots {
                add.execute(params![root.0, witness.0, key])?;
            }
            Ok(())
        })
    }

    /// The countersignatures over a batch's root on a network, by their numbers in this ledger.
    ///
    /// # Errors
    /// [`StoreError::Database`] and its kin.
    pub fn positions_of(&self, root: Hash, network: Domain) -> Result<Vec<u64>, StoreError> {
        self.read(|connection| {
            let sql = "SELECT position FROM witnessed_roots JOIN positions ON positions.key = position
                       WHERE root = ?1 AND network = ?2 ORDER BY position";
            let mut statement = connection.prepare_cached(sql)?;
            let rows = statement.query_map(params![root.0, network.0], |row| unsigned(row, 0))?;
            Ok(rows.collect::<Result<_, _>>()?)
        })
    }

    /// One of them.
    ///
    /// # Errors
    /// [`StoreError::Database`] and its kin; [`StoreError::Corrupt`] if it cannot be read.
    pub fn position(&self, key: u64) -> Result<Option<KeptPosition>, StoreError> {
        let key = whole("position", key)?;
        let found: Option<(Vec<u8>, Vec<u8>)> = self.read(|connection| {
            let sql = "SELECT roots, countersignature FROM positions WHERE key = ?1";
            Ok(connection.prepare_cached(sql)?.query_row([key], |row| Ok((row.get(0)?, row.get(1)?))).optional()?)
        })?;
        let Some((roots, bytes)) = found else { return Ok(None) };
        let roots = roots.chunks_exact(Hash::LENGTH).filter_map(Hash::from_slice).collect();
        Ok(Some(KeptPosition { roots, countersignature: self.parsed(&bytes)? }))
    }

    /// The newest countersignature that a witness gave an owner on a network.
    ///
    /// # Errors
    /// As [`Self::position`].
    pub fn newest_position(
        &self,
        (owner, witness): (Address, SignerId),
        network: Domain,
    ) -> Result<Option<Countersignature>, StoreError> {
        let sql = "SELECT countersignature FROM positions WHERE owner = ?1 AND witness = ?2 AND network = ?3
                   ORDER BY key DESC LIMIT 1";
        let found = self.read(|connection| {
            let mut statement = connection.prepare_cached(sql)?;
            Ok(statement.query_row(params![owner.0, witness.0, network.0], blob).optional()?)
        })?;
        found.map(|bytes| self.parsed(&bytes)).transpose()
    }

    /// What a witness gave an owner, on all networks.
    ///
    /// # Errors
    /// [`StoreError::Database`] and its kin.
    pub fn position_counts(&self, owner: Address, witness: SignerId) -> Result<PositionCounts, StoreError> {
        self.read(|connection| {
            let sql = "SELECT count(*), max(at) FROM positions WHERE owner = ?1 AND witness = ?2";
            Ok(connection.prepare_cached(sql)?.query_row(params![owner.0, witness.0], |row| {
                let newest = row.get::<_, Option<i64>>(1)?.map(|at| Timestamp(at.cast_unsigned()));
                Ok(PositionCounts { positions: unsigned(row, 0)?, newest })
            })?)
        })
    }

    /// What was countersigned here for a party on a network, the newest first: at most a thousand statements.
    ///
    /// # Errors
    /// As [`Self::position`].
    pub fn countersigned_of(&self, party: SignerId, network: Domain) -> Result<Vec<Countersignature>, StoreError> {
        let sql = "SELECT countersignature FROM countersigned WHERE party = ?1 AND network = ?2 ORDER BY key DESC";
        let found: Vec<Vec<u8>> = self.read(|connection| {
            let mut statement = connection.prepare_cached(sql)?;
            let rows = statement.query_map(params![party.0, network.0], blob)?;
            Ok(rows.collect::<Result<_, _>>()?)
        })?;
        found.iter().map(|bytes| self.parsed(bytes)).collect()
    }

    /// Stores what is countersigned for a party, before it is given; the newest thousand on a network stay.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like: then it must not be given.
    pub fn keep_countersigned(
        &self,
        party: SignerId,
        network: Domain,
        countersignature: Countersignature,
    ) -> Result<(), StoreError> {
        self.write(move |session| {
            let connection = session.connection;
            connection
                .prepare_cached("INSERT INTO countersigned (party, network, countersignature) VALUES (?1, ?2, ?3)")?
                .execute(params![party.0, network.0, countersignature.encode()])?;
            connection
                .prepare_cached(
                    "DELETE FROM countersigned WHERE key IN (SELECT key FROM countersigned WHERE party = ?1
                     AND network = ?2 ORDER BY key DESC LIMIT -1 OFFSET ?3)",
                )?
                .execute(params![party.0, network.0, MOST_KEPT])?;
            Ok(())
        })
    }

    /// How many statements of a party were countersigned here, and on how many networks.
    ///
    /// # Errors
    /// [`StoreError::Database`] and its kin.
    pub fn countersigned_count(&self, party: SignerId) -> Result<(u64, u64), StoreError> {
        self.read(|connection| {
            let sql = "SELECT count(*), count(DISTINCT network) FROM countersigned WHERE party = ?1";
            let mut statement = connection.prepare_cached(sql)?;
            Ok(statement.query_row([party.0], |row| Ok((unsigned(row, 0)?, unsigned(row, 1)?)))?)
        })
    }

    /// Stores a contradiction, with both statements; whether it is a new one, and there are few enough of that party.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like: then it is not stored.
    pub fn keep_contradiction(&self, found: KeptContradiction) -> Result<bool, StoreError> {
        let at = whole("time", found.at.0)?;
        self.write(move |session| {
            let KeptContradiction { party, what, kept, later, .. } = found;
            let added = session
                .connection
                .prepare_cached(
                    "INSERT OR IGNORE INTO contradictions (party, at, what, kept, later)
                     SELECT ?1, ?2, ?3, ?4, ?5 WHERE (SELECT count(*) FROM contradictions WHERE party = ?1) < ?6",
                )?
                .execute(params![party.0, at, what, kept.encode(), later.encode(), MOST_CONTRADICTIONS])?;
            Ok(added > 0)
        })
    }

    /// All contradictions of parties, oldest first.
    ///
    /// # Errors
    /// As [`Self::position`].
    pub fn two_histories(&self) -> Result<Vec<KeptContradiction>, StoreError> {
        type Found = (SignerId, Timestamp, String, Vec<u8>, Vec<u8>);
        let found: Vec<Found> = self.read(|connection| {
            let sql = "SELECT party, at, what, kept, later FROM contradictions ORDER BY key";
            let mut statement = connection.prepare_cached(sql)?;
            let rows = statement.query_map([], |row| {
                Ok((SignerId(row.get(0)?), Timestamp(unsigned(row, 1)?), row.get(2)?, row.get(3)?, row.get(4)?))
            })?;
            Ok(rows.collect::<Result<_, _>>()?)
        })?;
        let read = |(party, at, what, kept, later): Found| {
            let later = SignedPosition::parse(&later).map_err(|error| self.unreadable(&error))?;
            Ok(KeptContradiction { party, at, what, kept: self.parsed(&kept)?, later })
        };
        found.into_iter().map(read).collect()
    }

    fn parsed(&self, bytes: &[u8]) -> Result<Countersignature, StoreError> {
        Countersignature::parse(bytes).map_err(|error| self.unreadable(&error))
    }

    fn unreadable(&self, error: &crate::model::wire::WireError) -> StoreError {
        StoreError::Corrupt { file: self.path().to_owned(), detail: format!("a countersignature: {error}") }
    }
}

fn blob(row: &Row<'_>) -> rusqlite::Result<Vec<u8>> {
    row.get(0)
}

#[cfg(test)]
mod tests;

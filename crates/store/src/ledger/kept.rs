//! What a gateway keeps for others: public keys of their devices, and bindings of names.

use rusqlite::{Connection, OptionalExtension as _, params};

use super::Ledger;
use crate::model::bytes::hex;
use crate::model::{Address, Digest, FilterId, ProfileName, PublicKey, SignerId, TopicId};
use crate::store::StoreError;

/// The binding of a name at a gateway.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptBinding {
    /// Addr.
    pub account: Address,
    /// P_C when the transport key was allocated.
    pub signing: PublicKey,
    /// P_E at that time.
    pub envelope: PublicKey,
    /// The transport key, sealed by its keeper.
    pub sealed_key: Vec<u8>,
    /// The device that owns the name, with the topic id of its owner's notices to it; `None` if the name is its account's
    /// own.
    pub device: Option<(SignerId, TopicId)>,
}

impl Ledger {
    /// Stores a device's public key under its id.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like.
    pub fn keep_signer(&self, id: SignerId, key: PublicKey) -> Result<(), StoreError> {
        // It comes with every record of the device, and a commit for each would be what takes the time.
        if self.signer(id)?.is_some() {
            return Ok(());
        }
        self.write(move |session| add_signer(session.connection, id, key))
    }

    /// The public key of a device, if it is known.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn signer(&self, id: SignerId) -> Result<Option<PublicKey>, StoreError> {
        self.read(|connection| {
            let key = connection
                .prepare_cached("SELECT key FROM signers WHERE id = ?1")?
                .query_row([id.0], |row| row.get(0).map(PublicKey))
                .optional()?;
            Ok(key)
        })
    }

    /// Binds a name, replacing its previous binding.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; then nothing changes.
    pub fn bind(&self, name: &ProfileName, binding: KeptBinding) -> Result<(), StoreError> {
        let name = name.to_string();
        self.write(move |session| {
            session.connection.prepare_cached("REPLACE INTO bindings VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)")?.execute(
                params![
                    name,
                    binding.account.0,
                    binding.signing.0,
                    binding.envelope.0,
                    binding.sealed_key,
                    binding.device.map(|(device, _)| device.0),
                    binding.device.map(|(_, notices)| notices.0)
                ],
            )?;
            Ok(())
        })
    }

    /// Replaces the sealed form of a name's transport key; does nothing if another key has been bound meanwhile.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; then nothing changes.
    pub fn reseal_binding(&self, name: &str, before: Vec<u8>, after: Vec<u8>) -> Result<(), StoreError> {
        let name = name.to_owned();
        self.write(move |session| {
            session
                .connection
                .prepare_cached("UPDATE bindings SET sealed_key = ?3 WHERE name = ?1 AND sealed_key = ?2")?
                .execute(params![name, before, after])?;
            Ok(())
        })
    }

    /// From now on a name of `account` belongs to a device, whose notices are filed under `notices`; its transport key
    /// is unchanged. Returns whether there was such a name.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; then nothing changes.
    pub fn bind_device(
        &self,
        name: &str,
        account: Address,
        device: SignerId,
        notices: TopicId,
    ) -> Result<bool, StoreError> {
        let name = name.to_owned();
        self.write(move |session| {
            let changed = session
                .connection
                .prepare_cached("UPDATE bindings SET device = ?3, notices = ?4 WHERE name = ?1 AND account = ?2")?
                .execute(params![name, account.0, device.0, notices.0])?;
            Ok(changed > 0)
        })
    }

    /// The binding of a name.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn binding(&self, name: &ProfileName) -> Result<Option<KeptBinding>, StoreError> {
        self.read(|connection| {
            let binding = connection
                .prepare_cached(
                    "SELECT account, signing, envelope, sealed_key, device, notices FROM bindings WHERE name = ?1",
                )?
                .query_row([name.as_str()], |row| {
                    Ok(KeptBinding {
                        account: Address(row.get(0)?),
                        signing: PublicKey(row.get(1)?),
                        envelope: PublicKey(row.get(2)?),
                        sealed_key: row.get(3)?,
                        device: match row.get::<_, Option<_>>(4)? {
                            Some(device) => Some((SignerId(device), TopicId(row.get(5)?))),
                            None => None,
                        },
                    })
                })
                .optional()?;
            Ok(binding)
        })
    }

    /// Every bound name with its account, by name.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn bound_names(&self) -> Result<Vec<(String, Address)>, StoreError> {
        self.read(|connection| {
            let mut statement = connection.prepare_cached("SELECT name, account FROM bindings ORDER BY name")?;
            let rows = statement.query_map([], |row| Ok((row.get(0)?, Address(row.get(1)?))))?;
            Ok(rows.collect::<Result<_, _>>()?)
        })
    }

    /// Stores the meaning of a pseudonym (lower-case hex of a topic id, or of a type's filter id); the caller must have
    /// derived one from the other.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like.
    pub fn name(&self, owner: Address, id: String, name: String) -> Result<(), StoreError> {
        self.write(move |session| {
            session
                .connection
                .prepare_cached("INSERT INTO names VALUES (?1, ?2, ?3) ON CONFLICT DO NOTHING")?
                .execute(params![owner.0, id, name])?;
            Ok(())
        })
    }

    /// The name of a topic of an owner, derived by who asks; nothing happens if the topic is not here, or has a name.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn name_topic(&self, owner: Address, topic: TopicId, name: String) -> Result<(), StoreError> {
        let is_here = self.read(|connection| {
            let mut statement = connection.prepare_cached(
                "SELECT EXISTS (SELECT 1 FROM topics WHERE owner = ?1 AND topic_id = ?2 AND name = '')
                 AND NOT EXISTS (SELECT 1 FROM names WHERE owner = ?1 AND id = lower(hex(?2)))",
            )?;
            Ok(statement.query_row(params![owner.0, topic.0], |row| row.get::<_, bool>(0))?)
        })?;
        if is_here { self.name(owner, hex(&topic.0), name) } else { Ok(()) }
    }

    /// Every name that a topic of an owner ever had here: captured, learnt or given; none of them is proven.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn topic_names(&self, owner: Address, topic: TopicId) -> Result<Vec<String>, StoreError> {
        self.read(|connection| {
            let mut statement = connection.prepare_cached(
                "SELECT name FROM topics WHERE owner = ?1 AND topic_id = ?2 AND name <> ''
                 UNION SELECT name FROM names WHERE owner = ?1 AND id = lower(hex(?2))",
            )?;
            let rows = statement.query_map(params![owner.0, topic.0], |row| row.get(0))?;
            Ok(rows.collect::<Result<_, _>>()?)
        })
    }

    /// Whether a record has this id among its filters.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn has_filter(&self, digest: Digest, filter: FilterId) -> Result<bool, StoreError> {
        self.read(|connection| {
            let found = connection
                .prepare_cached(
                    "SELECT EXISTS (SELECT 1 FROM filters
                     WHERE filter = ?1 AND record = (SELECT n FROM records WHERE digest = ?2))",
                )?
                .query_row(params![filter.0, digest.0], |row| row.get(0))?;
            Ok(found)
        })
    }

    /// Up to `most` records of each of an owner's streams whose topic or type is known only by its pseudonym.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn unnamed(&self, owner: Address, most: usize) -> Result<Vec<Vec<Digest>>, StoreError> {
        self.read(|connection| {
            let mut statement = connection.prepare_cached(
                "SELECT s.key FROM streams s JOIN topics t ON t.key = s.topic
                 WHERE t.owner = ?1 AND t.name = ''
                 AND NOT EXISTS (SELECT 1 FROM names WHERE names.owner = ?1 AND id = lower(hex(t.topic_id))
                     AND (s.type_name = ''
                         OR EXISTS (SELECT 1 FROM names type WHERE type.owner = ?1 AND type.id = s.type_name)))",
            )?;
            let streams: Vec<i64> = statement.query_map([owner.0], |row| row.get(0))?.collect::<Result<_, _>>()?;
            let mut records = connection.prepare_cached(
                "SELECT digest FROM counters c JOIN records r ON r.state = c.state AND r.stream = c.stream
                 WHERE c.stream = ?1 AND c.records > 0 LIMIT ?2",
            )?;
            let most = i64::try_from(most).unwrap_or(i64::MAX);
            let of = |stream: i64| {
                let rows = records.query_map(params![stream, most], |row| row.get(0).map(Digest))?;
                Ok(rows.collect::<Result<_, _>>()?)
            };
            streams.into_iter().map(of).collect()
        })
    }
}

pub(super) fn add_signer(connection: &Connection, id: SignerId, key: PublicKey) -> Result<(), StoreError> {
    connection
        .prepare_cached("INSERT INTO signers VALUES (?1, ?2) ON CONFLICT DO NOTHING")?
        .execute(params![id.0, key.0])?;
    Ok(())
}

//! k_s: the system keys for key allocation, in a signed, versioned list that expires. One key is current, one is next.

use std::fs::{self, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

use zeroize::Zeroizing;

use crate::crypto::error::shown;
use crate::crypto::private_file::{create_private, make_private_directory, read_private, write_private};
use crate::crypto::{CryptoError, Provider, SmKeyPair, SmSecret, signer_id};
use crate::error::GatewayError;
use crate::hello::{Agreed, ListSummary};
use crate::model::wire::{Reader, WireError};
use crate::model::{Digest, Domain, PublicKey, Signature, SignerId, Timestamp};

const MAGIC: [u8; 8] = *b"\x89AuthSys";
const VERSION: u8 = 1;
const MOST_KEYS: usize = 2;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SystemKey {
    pub public: PublicKey,
    pub not_before: Timestamp,
    pub not_after: Timestamp,
}

impl SystemKey {
    /// SM3 of P_S.
    pub fn id(&self) -> SignerId {
        signer_id(&self.public)
    }

    pub fn is_in_use(&self, now: Timestamp) -> bool {
        self.not_before <= now && now < self.not_after
    }
}

/// magic (8) format (1) domain (32) gateway (32) version (8) issued (8) expires (8) count (1) keys (id 32, P_S 64, not
/// before 8, not after 8) signature (64).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SystemKeyList {
    pub domain: Domain,
    /// SM3 of its identity key.
    pub gateway: SignerId,
    /// Rises with every list.
    pub version: u64,
    pub issued_at: Timestamp,
    pub expires_at: Timestamp,
    /// The current key, then the next.
    pub keys: Vec<SystemKey>,
    /// By the identity key.
    pub signature: Signature,
}

impl SystemKeyList {
    pub fn sign(
        provider: &dyn Provider,
        domain: Domain,
        identity: &SmKeyPair,
        version: u64,
        (issued_at, expires_at): (Timestamp, Timestamp),
        keys: Vec<SystemKey>,
    ) -> Result<Self, CryptoError> {
        let gateway = signer_id(&identity.public);
        let mut list = Self { domain, gateway, version, issued_at, expires_at, keys, signature: Signature([0; 64]) };
        list.signature = provider.sign(&identity.secret, &list.signed_bytes())?;
        Ok(list)
    }

    fn unsigned(&self) -> Vec<u8> {
        let keys = &self.keys[..self.keys.len().min(MOST_KEYS)];
        let mut out = Vec::with_capacity(500);
        out.extend_from_slice(&MAGIC);
        out.push(VERSION);
        out.extend_from_slice(&self.domain.0);
        out.extend_from_slice(&self.gateway.0);
        for number in [self.version, self.issued_at.0, self.expires_at.0] {
            out.extend_from_slice(&number.to_be_bytes());
        }
        out.push(u8::try_from(keys.len()).unwrap_or(0));
        for key in keys {
            out.extend_from_slice(&key.id().0);
            out.extend_from_slice(&key.public.0);
            out.extend_from_slice(&key.not_before.0.to_be_bytes());
            out.extend_from_slice(&key.not_after.0.to_be_bytes());
        }
        out
    }

    fn signed_bytes(&self) -> Vec<u8> {
        [&b"AuthROS/systemkeys/1"[..], &self.domain.0, &self.unsigned()].concat()
    }

    pub fn encode(&self) -> Vec<u8> {
        [&self.unsigned()[..], &self.signature.0].concat()
    }

    /// Checks only the form.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(bytes);
        expect(reader.array("magic")? == MAGIC, "magic")?;
        expect(reader.u8("version")? == VERSION, "version")?;
        let list = Self {
            domain: Domain(reader.array("domain")?),
            gateway: SignerId(reader.array("gateway")?),
            version: reader.u64("version")?,
            issued_at: Timestamp(reader.u64("time of issue")?),
            expires_at: Timestamp(reader.u64("expiry")?),
            keys: read_keys(&mut reader)?,
            signature: Signature(reader.array("signature")?),
        };
        reader.end()?;
        Ok(list)
    }

    pub fn summary(&self, provider: &dyn Provider) -> ListSummary {
        ListSummary { version: self.version, digest: Digest(provider.sm3(&[&self.encode()])) }
    }

    /// Must be the hello's list, signed by that gateway for this network, not expired. Returns the key in use.
    pub fn check(
        &self,
        provider: &dyn Provider,
        domain: &Domain,
        agreed: &Agreed,
        now: Timestamp,
    ) -> Result<SystemKey, GatewayError> {
        let refuse = |why| Err(GatewayError::List(why));
        if self.domain != *domain {
            return refuse("it is of another network");
        }
        if self.gateway != agreed.gateway {
            return refuse("it is of another gateway");
        }
        if self.summary(provider) != agreed.list {
            return refuse("it is not the one the gateway announced");
        }
        provider.verify(&agreed.gateway_key, &self.signed_bytes(), &self.signature)?;
        if now >= self.expires_at {
            return refuse("it has expired, or this machine's clock is wrong");
        }
        let key = self.keys.iter().find(|key| key.is_in_use(now));
        let Some(key) = key else {
            return refuse("none of its keys is currently valid, or this machine's clock is wrong");
        };
        provider.check_public_key(&key.public)?;
        Ok(*key)
    }
}

fn read_keys(reader: &mut Reader<'_>) -> Result<Vec<SystemKey>, WireError> {
    let count = usize::from(reader.u8("key count")?);
    expect((1..=MOST_KEYS).contains(&count), "key count")?;
    (0..count).map(|_| read_key(reader)).collect()
}

fn read_key(reader: &mut Reader<'_>) -> Result<SystemKey, WireError> {
    let id = SignerId(reader.array("key id")?);
    let key = SystemKey {
        public: PublicKey(reader.array("system key")?),
        not_before: Timestamp(reader.u64("not before")?),
        not_after: Timestamp(reader.u64("not after")?),
    };
    expect(key.id() == id, "key id")?;
    Ok(key)
}

fn expect(condition: bool, field: &'static str) -> Result<(), WireError> {
    if condition { Ok(()) } else { Err(WireError::Value(field)) }
}

const LIST: &str = "system-keys.list";
const SYSTEM_KEY: &str = "system-";
const SUFFIX: &str = ".key";
const LONGEST_LIST: usize = 1024;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Schedule {
    pub lifetime: Duration,
    /// A retired key still opens requests in flight; covers differing clocks.
    pub grace: Duration,
}

impl Default for Schedule {
    fn default() -> Self {
        Self { lifetime: Duration::from_secs(7 * 24 * 3600), grace: Duration::from_secs(300) }
    }
}

fn after(moment: Timestamp, duration: Duration) -> Timestamp {
    Timestamp(moment.0.saturating_add(u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)))
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Rotation {
    pub published: bool,
    /// How many d_S.
    pub erased: usize,
}

pub struct Cabinet {
    directory: PathBuf,
    provider: &'static dyn Provider,
    domain: Domain,
    schedule: Schedule,
    identity: SmKeyPair,
    list: SystemKeyList,
    /// Listed ones, and retired ones in their grace period.
    keys: Vec<(SystemKey, SmSecret)>,
}

impl Cabinet {
    /// Creates missing keys and updates the list. `identity`, which signs it, belongs to the keeper and is stored
    /// elsewhere.
    pub fn open(
        directory: &Path,
        provider: &'static dyn Provider,
        domain: Domain,
        identity: SmKeyPair,
        schedule: Schedule,
        now: Timestamp,
    ) -> Result<Self, CryptoError> {
        make_private_directory(directory)?;
        let stored = read_list(&directory.join(LIST), provider, &domain, &identity)?;
        let directory = directory.to_owned();
        let mut keys = Vec::new();
        for key in stored.iter().flat_map(|list| &list.keys) {
            let secret = read_secret(&key_path(&directory, &key.id()))?;
            keys.push((*key, secret));
        }
        // The first one is published as every next one is.
        let list = match stored {
            Some(list) => list,
            None => sign_list(provider, domain, &identity, 0, now, Vec::new())?,
        };
        let mut cabinet = Self { directory, provider, domain, schedule, identity, list, keys };
        if !cabinet.rotate(now)?.published {
            // Clients refuse the older list of a restored home, which cannot know: each opening signs a newer version.
            cabinet.publish(now, cabinet.list.keys.clone())?;
        }
        cabinet.erase_strays()?;
        Ok(cabinet)
    }

    /// Whose list is in a directory; `None` without a readable one.
    pub fn founded_in(directory: &Path) -> Option<SignerId> {
        let bytes = read_private(&directory.join(LIST), LONGEST_LIST).ok()?;
        SystemKeyList::parse(&bytes).ok().map(|list| list.gateway)
    }

    pub fn identity(&self) -> &SmKeyPair {
        &self.identity
    }

    pub fn list(&self) -> &SystemKeyList {
        &self.list
    }

    /// d_S that still opens allocations.
    pub fn secret(&self, id: &SignerId, now: Timestamp) -> Option<&SmSecret> {
        let key = self.keys.iter().find(|(key, _)| key.id() == *id);
        key.filter(|(key, _)| now < after(key.not_after, self.schedule.grace)).map(|(_, secret)| secret)
    }

    /// Replaces an expired current key and erases keys past their grace period; after an error the old list stays in
    /// force.
    pub fn rotate(&mut self, now: Timestamp) -> Result<Rotation, CryptoError> {
        let mut rotation = Rotation::default();
        let current_ended = self.list.keys.first().is_none_or(|key| now >= key.not_after);
        if current_ended {
            self.publish_next(now)?;
            rotation.published = true;
        }
        rotation.erased = self.erase_retired(now)?;
        Ok(rotation)
    }

    fn publish(&mut self, now: Timestamp, keys: Vec<SystemKey>) -> Result<(), CryptoError> {
        // The seconds keep versions increasing even if the list was lost with its file.
        let version = (self.list.version + 1).max(now.seconds());
        let list = sign_list(self.provider, self.domain, &self.identity, version, now, keys)?;
        write_private(&self.directory.join(LIST), &list.encode())?;
        self.list = list;
        Ok(())
    }

    fn publish_next(&mut self, now: Timestamp) -> Result<(), CryptoError> {
        let lifetime = self.schedule.lifetime;
        let mut keys: Vec<SystemKey> = self.list.keys.iter().copied().filter(|key| now < key.not_after).collect();
        let mut fresh = Vec::new();
        while keys.len() < MOST_KEYS {
            let not_before = keys.last().map_or(now, |key| key.not_after);
            let (key, secret) = make_key(&self.directory, self.provider, not_before, lifetime)?;
            keys.push(key);
            fresh.push((key, secret));
        }
        self.publish(now, keys)?;
        self.keys.extend(fresh);
        Ok(())
    }

    fn erase_retired(&mut self, now: Timestamp) -> Result<usize, CryptoError> {
        let past = |key: &SystemKey| now >= after(key.not_after, self.schedule.grace);
        let ended: Vec<SignerId> = self.keys.iter().filter(|(key, _)| past(key)).map(|(key, _)| key.id()).collect();
        for id in &ended {
            erase(&key_path(&self.directory, id))?;
            self.keys.retain(|(key, _)| key.id() != *id);
        }
        Ok(ended.len())
    }

    /// Unlisted keys are from a crash before publishing, or were retired while the gateway was down.
    fn erase_strays(&self) -> Result<(), CryptoError> {
        let known: Vec<PathBuf> = self.keys.iter().map(|(key, _)| key_path(&self.directory, &key.id())).collect();
        let entries = fs::read_dir(&self.directory).map_err(CryptoError::read(&self.directory))?;
        for path in entries.flatten().map(|entry| entry.path()) {
            let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
            if name.starts_with(SYSTEM_KEY) && name.ends_with(SUFFIX) && !known.contains(&path) {
                erase(&path)?;
            }
        }
        Ok(())
    }
}

fn key_path(directory: &Path, id: &SignerId) -> PathBuf {
    directory.join(format!("{SYSTEM_KEY}{}{SUFFIX}", &id.to_hex()[..32]))
}

fn read_secret(path: &Path) -> Result<SmSecret, CryptoError> {
    let bytes: Zeroizing<Vec<u8>> = read_private(path, 32)?;
    SmSecret::from_slice(&bytes).map_err(|_| CryptoError::NotAKey {
        path: shown(path),
        wanted: "an SM2 private key of 32 bytes",
        found: "it is damaged; restore it, or remove it together with the list to start over".to_owned(),
    })
}

fn make_key(
    directory: &Path,
    provider: &dyn Provider,
    not_before: Timestamp,
    lifetime: Duration,
) -> Result<(SystemKey, SmSecret), CryptoError> {
    let pair = SmKeyPair::generate(provider)?;
    let key = SystemKey { public: pair.public, not_before, not_after: after(not_before, lifetime) };
    create_private(&key_path(directory, &key.id()), pair.secret.expose())?;
    Ok((key, pair.secret))
}

/// The list lasts as long as its last key.
fn sign_list(
    provider: &dyn Provider,
    domain: Domain,
    identity: &SmKeyPair,
    version: u64,
    now: Timestamp,
    keys: Vec<SystemKey>,
) -> Result<SystemKeyList, CryptoError> {
    let expires_at = keys.last().map_or(now, |key| key.not_after);
    SystemKeyList::sign(provider, domain, identity, version, (now, expires_at), keys)
}

/// `None` without a list; checks that it is intact, of this gateway and this network.
fn read_list(
    path: &Path,
    provider: &dyn Provider,
    domain: &Domain,
    identity: &SmKeyPair,
) -> Result<Option<SystemKeyList>, CryptoError> {
    if !path.exists() {
        return Ok(None);
    }
    let list = SystemKeyList::parse(&read_private(path, LONGEST_LIST)?)
        .map_err(CryptoError::malformed("list of system keys"))?;
    if list.domain != *domain {
        return Err(CryptoError::NotAccepted { what: "list of system keys", field: "network" });
    }
    provider.verify(&identity.public, &list.signed_bytes(), &list.signature)?;
    Ok(Some(list))
}

/// Overwrites a key before its removal. Journals and flash may keep copies: an encrypted disk prevents that.
fn erase(path: &Path) -> Result<(), CryptoError> {
    let write = CryptoError::write(path);
    let mut file = OpenOptions::new().write(true).open(path).map_err(&write)?;
    file.write_all(&[0; 32]).and_then(|()| file.sync_all()).map_err(&write)?;
    fs::remove_file(path).map_err(&write)?;
    let directory = path.parent().unwrap_or(path);
    fs::File::open(directory).and_then(|directory| directory.sync_all()).map_err(&write)
}

#[cfg(test)]
mod tests;

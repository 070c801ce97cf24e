//! k_s: the system keys for key allocation, in a signed, versioned list that expires. One key is current, one is next.

mod shelf;

use std::path::Path;
use std::time::Duration;

use crate::crypto::private_file::make_private_directory;
use crate::crypto::{CryptoError, Provider, SmKeyPair, SmSecret, signer_id};
use crate::error::GatewayError;
use crate::hello::{Agreed, ListSummary};
use crate::model::wire::{Reader, WireError};
use crate::model::{Digest, Domain, ErrorKind, PublicKey, Signature, SignerId, Timestamp};

use self::shelf::Folder;
pub use self::shelf::{Kept, Shelf};

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

/// Times that other workers may write first.
const ATTEMPTS: usize = 10;

pub struct Cabinet {
    shelf: Box<dyn Shelf>,
    provider: &'static dyn Provider,
    domain: Domain,
    schedule: Schedule,
    identity: SmKeyPair,
    kept: Kept,
    /// Version of the newest list that clients may have seen.
    shown: u64,
}

impl Cabinet {
    /// In a folder of a home. Creates missing keys and updates the list. `identity`, which signs it, belongs to the keeper and
    /// is stored elsewhere.
    pub fn open(
        directory: &Path,
        provider: &'static dyn Provider,
        domain: Domain,
        identity: SmKeyPair,
        schedule: Schedule,
        now: Timestamp,
    ) -> Result<Self, GatewayError> {
        make_private_directory(directory)?;
        Self::on(Box::new(Folder(directory.to_owned())), provider, domain, identity, schedule, now)
    }

    /// The same on any shelf.
    pub fn on(
        shelf: Box<dyn Shelf>,
        provider: &'static dyn Provider,
        domain: Domain,
        identity: SmKeyPair,
        schedule: Schedule,
        now: Timestamp,
    ) -> Result<Self, GatewayError> {
        // The first one is published as every next one is.
        let kept = Kept { list: sign_list(provider, domain, &identity, 0, now, Vec::new())?, keys: Vec::new() };
        let mut cabinet = Self { shelf, provider, domain, schedule, identity, kept, shown: 0 };
        cabinet.load()?;
        // Clients refuse the older list of a restored home, which cannot know: each opening signs a newer version.
        cabinet.settle(now, true)?;
        Ok(cabinet)
    }

    /// Whose list is in a directory; `None` without a readable one.
    pub fn founded_in(directory: &Path) -> Option<SignerId> {
        shelf::list_in(directory).ok().flatten().map(|list| list.gateway)
    }

    pub fn identity(&self) -> &SmKeyPair {
        &self.identity
    }

    /// Whether other workers may change the list, so that it is to be read again before it is shown.
    pub fn is_shared(&self) -> bool {
        self.shelf.is_shared()
    }

    pub fn kept(&self) -> &Kept {
        &self.kept
    }

    pub fn grace(&self) -> Duration {
        self.schedule.grace
    }

    /// Replaces an expired current key and erases keys past their grace period; after an error the old list stays in
    /// force.
    pub fn rotate(&mut self, now: Timestamp) -> Result<Rotation, GatewayError> {
        if self.is_shared() {
            self.load()?;
        }
        self.settle(now, false)
    }

    /// Checks that the list is intact, of this gateway and this network.
    fn load(&mut self) -> Result<(), GatewayError> {
        self.kept = match self.shelf.read()? {
            Some(kept) if kept.list.domain != self.domain => {
                return Err(CryptoError::NotAccepted { what: "list of system keys", field: "network" }.into());
            }
            Some(kept) => {
                self.provider.verify(&self.identity.public, &kept.list.signed_bytes(), &kept.list.signature)?;
                kept
            }
            None => Kept { list: self.signed(0, Timestamp(0), Vec::new())?, keys: Vec::new() },
        };
        self.shown = self.shown.max(self.kept.list.version);
        Ok(())
    }

    /// Stores what is due, or a newer list in any case.
    fn settle(&mut self, now: Timestamp, anew: bool) -> Result<Rotation, GatewayError> {
        for _ in 0..ATTEMPTS {
            // The shelf of all workers was restored to an earlier moment.
            let anew = anew || self.kept.list.version < self.shown;
            let Some(next) = self.due(now, anew)? else { return Ok(Rotation::default()) };
            let is_gone = |key: &SystemKey| !next.keys.iter().any(|(kept, _)| kept == key);
            let erased = self.kept.keys.iter().filter(|(key, _)| is_gone(key)).count();
            let published = next.list.version != self.kept.list.version;
            if self.shelf.write(&next)? {
                self.shown = self.shown.max(next.list.version);
                self.kept = next;
                return Ok(Rotation { published, erased });
            }
            self.load()?;
        }
        let text = "other workers of this gateway keep changing its system keys; try again".to_owned();
        Err(GatewayError::Shelf { kind: ErrorKind::Internal, text })
    }

    /// `None` if nothing is.
    fn due(&self, now: Timestamp, anew: bool) -> Result<Option<Kept>, CryptoError> {
        let Kept { list, keys } = &self.kept;
        let is_held = |key: &SystemKey| now < after(key.not_after, self.schedule.grace);
        let mut held: Vec<(SystemKey, SmSecret)> = keys.iter().filter(|(key, _)| is_held(key)).cloned().collect();
        if !anew && list.keys.first().is_some_and(|key| now < key.not_after) {
            return Ok((held.len() < keys.len()).then(|| Kept { list: list.clone(), keys: held }));
        }
        let mut listed: Vec<SystemKey> = list.keys.iter().copied().filter(|key| now < key.not_after).collect();
        while listed.len() < MOST_KEYS {
            let not_before = listed.last().map_or(now, |key| key.not_after);
            let pair = SmKeyPair::generate(self.provider)?;
            let not_after = after(not_before, self.schedule.lifetime);
            let key = SystemKey { public: pair.public, not_before, not_after };
            listed.push(key);
            held.push((key, pair.secret));
        }
        // The seconds keep versions increasing even if the list was lost with its file.
        let version = (list.version.max(self.shown) + 1).max(now.seconds());
        Ok(Some(Kept { list: self.signed(version, now, listed)?, keys: held }))
    }

    fn signed(&self, version: u64, now: Timestamp, keys: Vec<SystemKey>) -> Result<SystemKeyList, CryptoError> {
        sign_list(self.provider, self.domain, &self.identity, version, now, keys)
    }
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

#[cfg(test)]
mod tests;

//! k_s: the system keys for key allocation, in a signed, versioned list that expires. One key is current, one is next.

use std::fs::{self, OpenOptions};
use std::path::{Path, PathBuf};
use std::{io::Write as _, time::Duration};

use zeroize::Zeroizing;

use crate::crypto::private_file::{create_private, make_private_directory, read_private, write_private};
use crate::crypto::{CryptoError, Provider, SmKeyPair, SmSecret, signer_id};
use crate::hello::{Agreed, Context, ListSummary};
use crate::model::wire::{Reader, Wire as _, WireError, read_list};
use crate::model::{Digest, Domain, ErrorKind, PublicKey, Signature, SignerId, Timestamp, layout};
use crate::{crypto::error::shown, error::GatewayError};

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
        Context { provider, domain }: Context,
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
    pub fn check(&self, context: Context, agreed: &Agreed, now: Timestamp) -> Result<SystemKey, GatewayError> {
        let Context { provider, domain } = context;
        let refuse = |why| Err(GatewayError::List(why));
        if self.domain != domain {
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
    context: Context,
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
        context: Context,
        identity: SmKeyPair,
        schedule: Schedule,
        now: Timestamp,
    ) -> Result<Self, GatewayError> {
        make_private_directory(directory)?;
        Self::on(Box::new(Folder(directory.to_owned())), context, identity, schedule, now)
    }

    /// The same on any shelf.
    pub fn on(
        mut shelf: Box<dyn Shelf>,
        context: Context,
        identity: SmKeyPair,
        schedule: Schedule,
        now: Timestamp,
    ) -> Result<Self, GatewayError> {
        let kept = load(&mut *shelf, context, &identity)?;
        let shown = kept.list.version;
        let mut cabinet = Self { shelf, context, schedule, identity, kept, shown };
        // Clients refuse the older list of a restored home, which cannot know: each opening signs a newer version.
        cabinet.settle(now, true)?;
        Ok(cabinet)
    }

    /// Whose list is in a directory; `None` without a readable one.
    pub fn founded_in(directory: &Path) -> Option<SignerId> {
        list_in(directory).ok().flatten().map(|list| list.gateway)
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

    fn load(&mut self) -> Result<(), GatewayError> {
        self.kept = load(&mut *self.shelf, self.context, &self.identity)?;
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
            let pair = SmKeyPair::generate(self.context.provider)?;
            let not_after = after(not_before, self.schedule.lifetime);
            let key = SystemKey { public: pair.public, not_before, not_after };
            listed.push(key);
            held.push((key, pair.secret));
        }
        // The seconds keep versions increasing even if the list was lost with its file.
        let version = (list.version.max(self.shown) + 1).max(now.seconds());
        // The list lasts as long as its last key.
        let dates = (now, listed.last().map_or(now, |key| key.not_after));
        let list = SystemKeyList::sign(self.context, &self.identity, version, dates, listed)?;
        Ok(Some(Kept { list, keys: held }))
    }
}

/// Checks that the list is intact, of this gateway and this network. The first one is published as every next one is.
fn load(shelf: &mut dyn Shelf, context: Context, identity: &SmKeyPair) -> Result<Kept, GatewayError> {
    let Some(kept) = shelf.read()? else {
        let list = SystemKeyList::sign(context, identity, 0, (Timestamp(0), Timestamp(0)), Vec::new())?;
        return Ok(Kept { list, keys: Vec::new() });
    };
    if kept.list.domain != context.domain {
        return Err(CryptoError::NotAccepted { what: "list of system keys", field: "network" }.into());
    }
    context.provider.verify(&identity.public, &kept.list.signed_bytes(), &kept.list.signature)?;
    Ok(kept)
}

// Where the list of system keys and their secrets lie: in a folder of a home, or with all workers of a gateway.

/// Secrets kept at once: the listed ones, and retired ones of several schedules.
const MOST_SECRETS: usize = 16;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Kept {
    pub list: SystemKeyList,
    /// Listed ones, and retired ones in their grace period.
    pub keys: Vec<(SystemKey, SmSecret)>,
}

struct KeptSecret {
    not_before: Timestamp,
    not_after: Timestamp,
    pair: SmKeyPair,
}

layout!(KeptSecret { not_before: "not before", not_after: "not after", pair: "system key" });

impl Kept {
    /// d_S that still opens allocations, `grace` after its end at most.
    pub fn secret(&self, id: &SignerId, now: Timestamp, grace: Duration) -> Option<&SmSecret> {
        let key = self.keys.iter().find(|(key, _)| key.id() == *id);
        key.filter(|(key, _)| now < after(key.not_after, grace)).map(|(_, secret)| secret)
    }

    /// The secrets alone: count (1), then not before (8), not after (8) and d_S (32) each.
    pub fn secrets(&self) -> Zeroizing<Vec<u8>> {
        let keys = &self.keys[..self.keys.len().min(MOST_SECRETS)];
        // Reserved in one piece, with room for a tag: growing the buffer would leave unwiped copies behind.
        let mut out = Zeroizing::new(Vec::with_capacity(1 + 48 * keys.len() + 16));
        u8::try_from(keys.len()).unwrap_or_default().put(&mut out);
        for (SystemKey { not_before, not_after, .. }, secret) in keys {
            (*not_before, *not_after).put(&mut out);
            out.extend_from_slice(secret.expose());
        }
        out
    }

    /// From a list and secrets, which have those of all its keys.
    pub fn parse(list: &[u8], secrets: &[u8]) -> Result<Self, WireError> {
        let list = SystemKeyList::parse(list)?;
        let mut reader = Reader::new(secrets);
        let fields = ("number of system keys", "system key");
        let secrets: Vec<KeptSecret> = read_list::<u8, _>(&mut reader, 0..=MOST_SECRETS, fields)?;
        reader.end()?;
        let key = |KeptSecret { not_before, not_after, pair }| {
            let SmKeyPair { public, secret } = pair;
            (SystemKey { public, not_before, not_after }, secret)
        };
        let keys: Vec<(SystemKey, SmSecret)> = secrets.into_iter().map(key).collect();
        let is_there = |listed: &SystemKey| keys.iter().any(|(key, _)| key == listed);
        if !list.keys.iter().all(is_there) {
            return Err(WireError::Value("system key"));
        }
        Ok(Self { list, keys })
    }
}

pub trait Shelf: Send {
    /// `None` if there is nothing yet.
    fn read(&mut self) -> Result<Option<Kept>, GatewayError>;

    /// Replaces what was read, and erases the secrets of other keys. `false` if another worker was first, and nothing is
    /// changed.
    fn write(&mut self, kept: &Kept) -> Result<bool, GatewayError>;

    /// Whether several workers have it.
    fn is_shared(&self) -> bool;
}

const LIST: &str = "system-keys.list";
const SYSTEM_KEY: &str = "system-";
const SUFFIX: &str = ".key";
const LONGEST_LIST: usize = 1024;

/// Of one home.
pub(super) struct Folder(pub PathBuf);

impl Shelf for Folder {
    fn read(&mut self) -> Result<Option<Kept>, GatewayError> {
        let Some(list) = list_in(&self.0)? else { return Ok(None) };
        let secret = |key: &SystemKey| Ok::<_, CryptoError>((*key, read_secret(&self.path(key))?));
        let keys = list.keys.iter().map(secret).collect::<Result<_, CryptoError>>()?;
        Ok(Some(Kept { list, keys }))
    }

    /// New keys before the list that names them; unlisted ones are from a crash in between, or were retired while the gateway
    /// was down.
    fn write(&mut self, kept: &Kept) -> Result<bool, GatewayError> {
        for (key, secret) in &kept.keys {
            let path = self.path(key);
            if !path.exists() {
                create_private(&path, secret.expose())?;
            }
        }
        write_private(&self.0.join(LIST), &kept.list.encode())?;
        let known: Vec<PathBuf> = kept.keys.iter().map(|(key, _)| self.path(key)).collect();
        let entries = fs::read_dir(&self.0).map_err(CryptoError::read(&self.0))?;
        for path in entries.flatten().map(|entry| entry.path()) {
            let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
            if name.starts_with(SYSTEM_KEY) && name.ends_with(SUFFIX) && !known.contains(&path) {
                erase(&path)?;
            }
        }
        Ok(true)
    }

    fn is_shared(&self) -> bool {
        false
    }
}

impl Folder {
    fn path(&self, key: &SystemKey) -> PathBuf {
        self.0.join(format!("{SYSTEM_KEY}{}{SUFFIX}", &key.id().to_hex()[..32]))
    }
}

/// Checks only the form.
pub(super) fn list_in(directory: &Path) -> Result<Option<SystemKeyList>, CryptoError> {
    let path = directory.join(LIST);
    if !path.exists() {
        return Ok(None);
    }
    let list = SystemKeyList::parse(&read_private(&path, LONGEST_LIST)?);
    list.map(Some).map_err(CryptoError::malformed("list of system keys"))
}

fn read_secret(path: &Path) -> Result<SmSecret, CryptoError> {
    let bytes: Zeroizing<Vec<u8>> = read_private(path, 32)?;
    SmSecret::from_slice(&bytes).map_err(|_| CryptoError::NotAKey {
        path: shown(path),
        wanted: "an SM2 private key of 32 bytes",
        found: "it is damaged; restore it, or remove it together with the list to start over".to_owned(),
    })
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

//! Where the list of system keys and their secrets lie: in a folder of a home, or with all workers of a gateway.

use std::fs::{self, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

use zeroize::Zeroizing;

use super::{SystemKey, SystemKeyList, after};
use crate::crypto::error::shown;
use crate::crypto::private_file::{create_private, read_private, write_private};
use crate::crypto::{CryptoError, SmKeyPair, SmSecret};
use crate::error::GatewayError;
use crate::model::wire::{Reader, Wire as _, WireError, read_list};
use crate::model::{SignerId, Timestamp, layout};

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

//! The keys of one profile, and their file: a public header, then the secrets under SM4-GCM with the header as AAD.
//!
//! Every write raises the generation by one, and only over the very write that was read: a copy in memory that did not
//! see another's keys never replaces them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::error::shown;
use crate::keystore::{FileKey, SaveKeys, of_version};
use crate::model::wire::{Reader, Wire, WireError};
use crate::model::{Address, Domain, PublicKey, Token, layout};
use crate::private_file::{
    change_private, check_private_directory, create_private, directory_of, make_private_directory, read_private,
};
use crate::secret::Work;
use crate::{
    CryptoError, EoaSecret, EpochKey, EpochSalt, IndexKey, Passphrase, Provider, ProviderName, Result, Sm4Key,
    SmKeyPair, epoch_key, fault, provider, random_bytes, token,
};
use zeroize::Zeroizing;

/// Whether the chain knows an epoch's token.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EpochState {
    /// Its transaction is not confirmed.
    Pending,
    /// It is registered.
    Active,
}

/// The key of an epoch.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EpochSecret {
    /// EK.
    pub key: EpochKey,
    /// Whether the chain knows it.
    pub state: EpochState,
}

impl EpochSecret {
    /// The key of an epoch that begins, from K_C and a fresh salt, which is needed only here.
    /// # Errors
    /// [`CryptoError::Random`] if the random source fails.
    pub fn begin(sm4: &Sm4Key, domain: &Domain, owner: &Address, epoch: u64) -> Result<Self> {
        let salt = EpochSalt::generate()?;
        Ok(Self { key: epoch_key(sm4, salt.expose(), domain, owner, epoch), state: EpochState::Pending })
    }
}

/// The epochs of a profile on one network.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct NetworkKeys {
    /// Every epoch so far.
    pub epochs: BTreeMap<u64, EpochSecret>,
    /// The epoch that seals new records; 0 before the first.
    pub current: u64,
}

/// What is readable of a profile without its passphrase.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PublicIdentity {
    /// The EOA's address.
    pub address: Address,
    /// P_C.
    pub signing: PublicKey,
    /// P_E.
    pub envelope: PublicKey,
}

/// SM2 pairs of a profile other than the two in use.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct FurtherPairs {
    /// Former (d_E, P_E), oldest first: they open what was encrypted to them.
    pub envelopes: Vec<SmKeyPair>,
    /// The next (d_C, P_C), to be used once the chain has it: robots may know it already.
    pub next_signing: Option<SmKeyPair>,
    /// The next (d_E, P_E), to be used once the chain has it.
    pub next_envelope: Option<SmKeyPair>,
    /// The identity of the gateway that this profile keeps, if (d_C, P_C) has changed since the gateway was founded.
    pub gateway: Option<SmKeyPair>,
}

/// All secrets of one profile.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Keyring {
    /// The Ethereum account.
    pub eoa: EoaSecret,
    /// (d_C, P_C): signs.
    pub signing: SmKeyPair,
    /// (d_E, P_E): opens envelopes.
    pub envelope: SmKeyPair,
    /// K_C for future epochs.
    pub sm4: Sm4Key,
    /// IK.
    pub index: IndexKey,
    /// Epochs by network.
    pub networks: BTreeMap<Domain, NetworkKeys>,
    /// Former and future pairs.
    pub further: FurtherPairs,
}

impl Keyring {
    /// Fresh keys, with no network yet.
    /// # Errors
    /// [`CryptoError::Random`] if the random source fails.
    pub fn generate(provider: &dyn Provider) -> Result<Self> {
        Ok(Self {
            eoa: EoaSecret::generate()?,
            signing: SmKeyPair::generate(provider)?,
            envelope: SmKeyPair::generate(provider)?,
            sm4: Sm4Key::generate()?,
            index: IndexKey::generate()?,
            networks: BTreeMap::new(),
            further: FurtherPairs::default(),
        })
    }

    /// The public part.
    pub fn public(&self) -> PublicIdentity {
        PublicIdentity { address: self.eoa.address(), signing: self.signing.public, envelope: self.envelope.public }
    }

    /// Notes that the chain confirmed an epoch's token.
    /// # Errors
    /// [`CryptoError::NoEpoch`] if the keyring lacks the epoch.
    pub fn confirm_epoch(&mut self, domain: &Domain, epoch: u64) -> Result<()> {
        let network = self.networks.get_mut(domain).ok_or(CryptoError::NoEpoch(epoch))?;
        let secret = network.epochs.get_mut(&epoch).ok_or(CryptoError::NoEpoch(epoch))?;
        secret.state = EpochState::Active;
        Ok(())
    }

    /// EK of any past or present epoch, derived again.
    /// # Errors
    /// [`CryptoError::NoEpoch`] if the keyring lacks the epoch.
    pub fn epoch_key(&self, domain: &Domain, epoch: u64) -> Result<EpochKey> {
        let secret = self.networks.get(domain).and_then(|network| network.epochs.get(&epoch));
        Ok(secret.ok_or(CryptoError::NoEpoch(epoch))?.key.clone())
    }

    /// The token of an epoch.
    /// # Errors
    /// [`CryptoError::NoEpoch`] if the keyring lacks the epoch.
    pub fn token(&self, domain: &Domain, epoch: u64) -> Result<Token> {
        Ok(token(domain, &self.eoa.address(), epoch, &self.epoch_key(domain, epoch)?))
    }
}

const MAGIC: [u8; 8] = *b"\x89AuthKey";
const VERSION: u8 = 1;
const LABEL: &str = "AuthROS/keyring/1";
/// The largest keyring accepted, bytes: about 400,000 epochs.
const LARGEST: usize = 16 * 1024 * 1024;
const HEADER: usize = 266;

/// Identifies one write of a keyring file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Stamp {
    /// 1 for a new file, and one more with each write.
    generation: u64,
    /// Differs between writes of the same generation.
    save_salt: [u8; 24],
}

impl Stamp {
    fn next(self) -> Result<Self> {
        Ok(Self { generation: self.generation.saturating_add(1), save_salt: random_bytes()? })
    }
}

struct FileHeader {
    stamp: Stamp,
    work: Work,
    salt: [u8; 32],
    public: PublicIdentity,
    commit: [u8; 32],
    length: u32,
}

layout!(Stamp { generation: "generation", save_salt: "salt of the save" });
layout!(PublicIdentity { address: "address", signing: "signing key", envelope: "envelope key" });
layout!(FileHeader {
    stamp: "stamp",
    work: "work",
    salt: "salt",
    public: "identity",
    commit: "commitment",
    length: "length",
});

fn seal(keyring: &Keyring, key: &FileKey, stamp: Stamp) -> Result<Vec<u8>> {
    let mut sealed = encode(keyring);
    let keys = SaveKeys::derive(key, &stamp.save_salt, LABEL);
    let found = sealed.len() + 16;
    let too_long = CryptoError::Length { what: "keyring", found, allowed: "at most 16 MiB" };
    let length = u32::try_from(found).ok().filter(|_| found + HEADER <= LARGEST).ok_or(too_long)?;
    let public = keyring.public();
    let header = FileHeader { stamp, work: key.work, salt: key.salt, public, commit: keys.commit, length };
    let header = header.behind(&[&MAGIC[..], &[VERSION]].concat());
    provider(ProviderName::RustCrypto).gcm_seal(&keys.key, &keys.nonce, &header, &mut sealed)?;
    Ok([&header[..], &sealed].concat())
}

type Parts<'a> = (FileHeader, &'a [u8], &'a [u8]);

fn split<'a>(path: &Path, bytes: &'a [u8]) -> Result<Parts<'a>> {
    read_parts(bytes).map_err(|why| of_version(path, "a keyring", bytes, why).unwrap_or_else(|| damaged(path)))
}

fn read_parts(bytes: &[u8]) -> Result<Parts<'_>, WireError> {
    let mut reader = Reader::new(bytes.strip_prefix(&MAGIC).ok_or(WireError::Value("magic"))?);
    if reader.u8("version")? != VERSION {
        return Err(WireError::Value("version"));
    }
    let header = FileHeader::read(&mut reader, "header")?;
    let length = usize::try_from(header.length).map_err(|_| WireError::Value("length"))?;
    let sealed = reader.take(length, "sealed keys")?;
    reader.end()?;
    Ok((header, bytes.get(..HEADER).unwrap_or_default(), sealed))
}

fn damaged(path: &Path) -> CryptoError {
    CryptoError::DamagedKeyring(shown(path))
}

fn open(path: &Path, bytes: &[u8], key: &FileKey) -> Result<Keyring> {
    let (header, aad, sealed) = split(path, bytes)?;
    let keys = SaveKeys::committed(key, &header.stamp.save_salt, LABEL, &header.commit);
    let keys = keys.ok_or_else(|| CryptoError::WrongPassphrase(shown(path)))?;
    let plain = provider(ProviderName::RustCrypto).gcm_open(&keys.key, &keys.nonce, aad, sealed);
    let keyring = plain.ok().and_then(|plain| parse(&plain).ok());
    keyring.filter(|keyring| keyring.public() == header.public).ok_or_else(|| damaged(path))
}

fn read(path: &Path) -> Result<Zeroizing<Vec<u8>>> {
    let bytes = read_private(path, LARGEST)?;
    check_private_directory(&directory_of(path))?;
    Ok(bytes)
}

/// A keyring's public header, read without the passphrase. An altered file may lie here, but does not open.
/// # Errors
/// [`CryptoError::Read`], [`CryptoError::OpenToOthers`], [`CryptoError::DamagedKeyring`] or [`CryptoError::Version`].
pub fn read_public(path: &Path) -> Result<PublicIdentity> {
    let bytes = read(path)?;
    split(path, &bytes).map(|(header, _, _)| header.public)
}

/// The same of a keyring's bytes; `None` if they are no keyring.
pub fn public_of(bytes: &[u8]) -> Option<PublicIdentity> {
    read_parts(bytes).ok().map(|(header, _, _)| header.public)
}

/// Whether a file says that it is a keyring.
pub fn is_keyring_file(path: &Path) -> bool {
    read_private(path, LARGEST).is_ok_and(|bytes| bytes.starts_with(&MAGIC))
}

impl Keyring {
    /// Reads and opens a keyring; derives the passphrase's key (about 0.3 s).
    /// # Errors
    /// See [`UnlockedKeyring::open`].
    pub fn load(path: &Path, passphrase: &Passphrase) -> Result<Self> {
        UnlockedKeyring::open(path, passphrase).map(|unlocked| unlocked.keyring)
    }
}

/// A keyring in memory with its file's key, so that later saves need no derivation. Changes go through [`Self::change`]
/// alone, so memory never holds keys that the file lacks.
pub struct UnlockedKeyring {
    keyring: Keyring,
    path: PathBuf,
    key: FileKey,
    /// The write of the file that `keyring` is a copy of.
    stamp: Stamp,
    /// Keys are missing from `keyring`, so it must not be saved over the file.
    stripped: bool,
}

impl UnlockedKeyring {
    /// Wipes from memory the keys that open envelopes and old records, grant, and begin epochs: d_E, K_C, the secrets
    /// of all epochs, and the key of the file; the file itself keeps everything. EOA, (d_C, P_C) and IK stay in memory.
    /// # Errors
    /// [`CryptoError::Random`]; nothing is wiped then.
    pub fn strip(&mut self, provider: &dyn Provider) -> Result<()> {
        // Meaningless values take their place; the originals are wiped when dropped.
        let (envelope, sm4) = (SmKeyPair::generate(provider)?, Sm4Key::generate()?);
        self.stripped = true;
        self.keyring.envelope.secret = envelope.secret;
        self.keyring.sm4 = sm4;
        self.keyring.further.envelopes.clear();
        self.keyring.further.next_envelope = None;
        for network in self.keyring.networks.values_mut() {
            network.epochs.clear();
        }
        self.key.key = Zeroizing::new([0; 32]);
        Ok(())
    }

    /// The keys.
    pub fn keys(&self) -> &Keyring {
        &self.keyring
    }

    /// Writes a new keyring file, never over one that exists.
    /// # Errors
    /// [`CryptoError::Exists`], [`CryptoError::Write`] or [`CryptoError::OpenToOthers`].
    pub fn create(keyring: Keyring, path: &Path, passphrase: &Passphrase) -> Result<Self> {
        make_private_directory(&directory_of(path))?;
        let key = FileKey::new(passphrase)?;
        let stamp = Stamp { generation: 1, save_salt: random_bytes()? };
        create_private(path, &seal(&keyring, &key, stamp)?)?;
        Ok(Self { keyring, path: path.to_owned(), key, stamp, stripped: false })
    }

    /// Reads and opens a keyring file.
    /// # Errors
    /// `Read`, `OpenToOthers`, [`CryptoError::WrongPassphrase`], `DamagedKeyring` or [`CryptoError::Version`].
    pub fn open(path: &Path, passphrase: &Passphrase) -> Result<Self> {
        Self::of_file(path, &read(path)?, passphrase)
    }

    fn of_file(path: &Path, bytes: &[u8], passphrase: &Passphrase) -> Result<Self> {
        let (header, _, _) = split(path, bytes)?;
        let key = FileKey::with(passphrase, header.work, header.salt)?;
        let keyring = open(path, bytes, &key)?;
        Ok(Self { keyring, path: path.to_owned(), key, stamp: header.stamp, stripped: false })
    }

    /// Copies a saved keyring file to where there is none, once `accept` has seen whose it is and its passphrase has
    /// opened it.
    /// # Errors
    /// Those of `accept`, [`Self::open`] and [`Self::create`].
    pub fn restore<E: From<CryptoError>>(
        saved: &Path,
        path: &Path,
        passphrase: &Passphrase,
        accept: impl FnOnce(&PublicIdentity) -> Result<(), E>,
    ) -> Result<Self, E> {
        // It may lie in any folder: what is read is what its passphrase opens.
        let bytes = read_private(saved, LARGEST)?;
        accept(&split(saved, &bytes)?.0.public)?;
        let opened = Self::of_file(saved, &bytes, passphrase)?;
        make_private_directory(&directory_of(path))?;
        create_private(path, &bytes)?;
        Ok(Self { path: path.to_owned(), ..opened })
    }

    /// Changes the keys, in the file first and then here; if `change` or the write fails, neither is changed.
    /// # Errors
    /// Those of `change`; [`CryptoError::Superseded`] for a file that was not read; `Locked`, `Read`, `Write`.
    pub fn change<T>(&mut self, change: impl FnOnce(&mut Keyring) -> Result<T>) -> Result<T> {
        let mut keyring = self.keyring.clone();
        let value = change(&mut keyring)?;
        self.write(&keyring, &self.key.clone())?;
        self.keyring = keyring;
        Ok(value)
    }

    /// Changes the passphrase and saves.
    /// # Errors
    /// See [`Self::change`].
    pub fn change_passphrase(&mut self, passphrase: &Passphrase) -> Result<()> {
        let key = FileKey::new(passphrase)?;
        self.write(&self.keyring.clone(), &key)?;
        self.key = key;
        Ok(())
    }

    /// The only way over an existing file.
    fn write(&mut self, keyring: &Keyring, key: &FileKey) -> Result<()> {
        if self.stripped {
            return Err(CryptoError::Locked(shown(&self.path)));
        }
        let (path, read, next) = (&self.path, self.stamp, self.stamp.next()?);
        let bytes = seal(keyring, key, next)?;
        let stamp_of = |there: Zeroizing<Vec<u8>>| split(path, &there).map(|parts| parts.0.stamp);
        let written = change_private(path, LARGEST, |there| {
            let there = there.ok_or_else(|| CryptoError::read(path)(std::io::ErrorKind::NotFound.into()))?;
            let there = split(path, there)?.0.stamp;
            if there != read {
                let (read, found) = (read.generation, there.generation);
                return Err(CryptoError::Superseded { path: shown(path), read, found });
            }
            fault::point("keyring-compared");
            Ok(Some(bytes))
        });
        // A write can fail after the file was replaced, if its directory is not synced: the file is still ours.
        if written.is_ok() || read_private(path, LARGEST).and_then(stamp_of).ok() == Some(next) {
            self.stamp = next;
        }
        written?;
        fault::point("keyring-written");
        Ok(())
    }

    /// The path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl std::fmt::Debug for UnlockedKeyring {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("UnlockedKeyring").field("path", &self.path).finish_non_exhaustive()
    }
}

// The sealed part of a keyring file: EOA (32), d_C (32), d_E (32), K_C (16), IK (32), then a counted list of networks
// (domain, current epoch, counted epochs of number, EK and state), then the number of further pairs (4) and for
// each its use (1: former d_E, 2: next d_C, 3: next d_E, 4: gateway) and its secret (32), ordered by use.

const FORMER_ENVELOPE: u8 = 1;
const NEXT_SIGNING: u8 = 2;
const NEXT_ENVELOPE: u8 = 3;
const GATEWAY: u8 = 4;

fn encode(keyring: &Keyring) -> Zeroizing<Vec<u8>> {
    let epochs: usize = keyring.networks.values().map(|network| network.epochs.len()).sum();
    // Reserved in one piece, tag included: growing the buffer would leave unwiped copies behind.
    let further = further(keyring);
    let length = 256 + keyring.networks.len() * 44 + epochs * 41 + further.len() * 33;
    let mut out = Zeroizing::new(Vec::with_capacity(length));
    out.extend_from_slice(keyring.eoa.expose());
    out.extend_from_slice(keyring.signing.secret.expose());
    out.extend_from_slice(keyring.envelope.secret.expose());
    out.extend_from_slice(keyring.sm4.expose());
    out.extend_from_slice(keyring.index.expose());
    put_count(&mut out, keyring.networks.len());
    for (domain, network) in &keyring.networks {
        out.extend_from_slice(&domain.0);
        out.extend_from_slice(&network.current.to_be_bytes());
        put_count(&mut out, network.epochs.len());
        for (epoch, secret) in &network.epochs {
            out.extend_from_slice(&epoch.to_be_bytes());
            out.extend_from_slice(secret.key.expose());
            (secret.state == EpochState::Active).put(&mut out);
        }
    }
    put_count(&mut out, further.len());
    for (usage, pair) in further {
        out.push(usage);
        out.extend_from_slice(pair.secret.expose());
    }
    out
}

fn further(keyring: &Keyring) -> Vec<(u8, &SmKeyPair)> {
    let FurtherPairs { envelopes, next_signing, next_envelope, gateway } = &keyring.further;
    let former = envelopes.iter().map(|pair| (FORMER_ENVELOPE, pair));
    let signing = next_signing.iter().map(|pair| (NEXT_SIGNING, pair));
    let envelope = next_envelope.iter().map(|pair| (NEXT_ENVELOPE, pair));
    former.chain(signing).chain(envelope).chain(gateway.iter().map(|pair| (GATEWAY, pair))).collect()
}

fn put_count(out: &mut Vec<u8>, count: usize) {
    out.extend_from_slice(&u32::try_from(count).unwrap_or(u32::MAX).to_be_bytes());
}

fn parse(plain: &[u8]) -> Result<Keyring, WireError> {
    let mut reader = Reader::new(plain);
    let keyring = Keyring {
        eoa: EoaSecret::from_slice(reader.take(32, "EOA key")?).map_err(|_| WireError::Value("EOA key"))?,
        signing: Wire::read(&mut reader, "signing key")?,
        envelope: Wire::read(&mut reader, "envelope key")?,
        sm4: Wire::read(&mut reader, "SM4 key")?,
        index: Wire::read(&mut reader, "index key")?,
        networks: read_networks(&mut reader)?,
        further: read_further(&mut reader)?,
    };
    reader.end()?;
    Ok(keyring)
}

fn read_further(reader: &mut Reader<'_>) -> Result<FurtherPairs, WireError> {
    let count = reader.u32("number of further pairs")?;
    let (mut further, mut before) = (FurtherPairs::default(), FORMER_ENVELOPE);
    for _ in 0..count {
        let usage = reader.u8("use of a pair")?;
        let pair = SmKeyPair::read(reader, "further pair")?;
        // Ordered by use, each use but the first at most once, so that every value has exactly one encoding.
        if usage < before || (usage == before && usage != FORMER_ENVELOPE) {
            return Err(WireError::Value("use of a pair"));
        }
        before = usage;
        match usage {
            FORMER_ENVELOPE => further.envelopes.push(pair),
            NEXT_SIGNING => further.next_signing = Some(pair),
            NEXT_ENVELOPE => further.next_envelope = Some(pair),
            GATEWAY => further.gateway = Some(pair),
            _ => return Err(WireError::Value("use of a pair")),
        }
    }
    Ok(further)
}

fn read_networks(reader: &mut Reader<'_>) -> Result<BTreeMap<Domain, NetworkKeys>, WireError> {
    let count = reader.u32("number of networks")?;
    (0..count).map(|_| Ok((Domain(reader.array("domain")?), read_network(reader)?))).collect()
}

fn read_network(reader: &mut Reader<'_>) -> Result<NetworkKeys, WireError> {
    let current = reader.u64("current epoch")?;
    let count = reader.u32("number of epochs")?;
    let epochs: Result<_, WireError> = (0..count).map(|_| Ok((reader.u64("epoch")?, read_epoch(reader)?))).collect();
    Ok(NetworkKeys { epochs: epochs?, current })
}

fn read_epoch(reader: &mut Reader<'_>) -> Result<EpochSecret, WireError> {
    let (key, is_active) = (Wire::read(reader, "epoch key")?, bool::read(reader, "epoch state")?);
    Ok(EpochSecret { key, state: if is_active { EpochState::Active } else { EpochState::Pending } })
}

#[cfg(test)]
mod file_tests;
#[cfg(test)]
mod tests;

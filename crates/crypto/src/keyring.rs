//! The keys of one profile, and their file: a public header, then the secrets under SM4-GCM with the header as AAD.
//!
//! Every write raises the generation by one, and only over the very write that was read: a copy in memory that did not
//! see another's keys never replaces them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::error::shown;
use crate::keystore::{FileKey, SaveKeys, put_work, read_work};
use crate::model::wire::{Reader, WireError};
use crate::model::{Address, Domain, PublicKey, Token};
use crate::private_file::{
    change_private, check_private_directory, create_private, directory_of, make_private_directory, read_private,
};
use crate::secret::Work;
use crate::{
    CryptoError, EoaSecret, EpochKey, EpochSalt, IndexKey, Passphrase, Provider, ProviderName, Sm4Key, SmKeyPair,
    SmSecret, epoch_key, fault, provider, random_bytes, token,
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
    ///
    /// # Errors
    /// [`CryptoError::Random`] if the random source fails.
    pub fn begin(sm4: &Sm4Key, domain: &Domain, owner: &Address, epoch: u64) -> Result<Self, CryptoError> {
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
    ///
    /// # Errors
    /// [`CryptoError::Random`] if the random source fails.
    pub fn generate(provider: &dyn Provider) -> Result<Self, CryptoError> {
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
    ///
    /// # Errors
    /// [`CryptoError::NoEpoch`] if the keyring lacks the epoch.
    pub fn confirm_epoch(&mut self, domain: &Domain, epoch: u64) -> Result<(), CryptoError> {
        let network = self.networks.get_mut(domain).ok_or(CryptoError::NoEpoch(epoch))?;
        let secret = network.epochs.get_mut(&epoch).ok_or(CryptoError::NoEpoch(epoch))?;
        secret.state = EpochState::Active;
        Ok(())
    }

    /// EK of any past or present epoch, derived again.
    ///
    /// # Errors
    /// [`CryptoError::NoEpoch`] if the keyring lacks the epoch.
    pub fn epoch_key(&self, domain: &Domain, epoch: u64) -> Result<EpochKey, CryptoError> {
        let secret = self.networks.get(domain).and_then(|network| network.epochs.get(&epoch));
        Ok(secret.ok_or(CryptoError::NoEpoch(epoch))?.key.clone())
    }

    /// The token of an epoch.
    ///
    /// # Errors
    /// [`CryptoError::NoEpoch`] if the keyring lacks the epoch.
    pub fn token(&self, domain: &Domain, epoch: u64) -> Result<Token, CryptoError> {
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
    fn next(self) -> Result<Self, CryptoError> {
        Ok(Self { generation: self.generation.saturating_add(1), save_salt: random_bytes()? })
    }
}

struct FileHeader {
    stamp: Stamp,
    work: Work,
    salt: [u8; 32],
    public: PublicIdentity,
    commit: [u8; 32],
    length: usize,
}

impl FileHeader {
    fn encode(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(HEADER);
        out.extend_from_slice(&MAGIC);
        out.push(VERSION);
        out.extend_from_slice(&self.stamp.generation.to_be_bytes());
        out.extend_from_slice(&self.stamp.save_salt);
        put_work(&mut out, self.work);
        out.extend_from_slice(&self.salt);
        out.extend_from_slice(&self.public.address.0);
        out.extend_from_slice(&self.public.signing.0);
        out.extend_from_slice(&self.public.envelope.0);
        out.extend_from_slice(&self.commit);
        out.extend_from_slice(&u32::try_from(self.length).unwrap_or(u32::MAX).to_be_bytes());
        out
    }

    fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        Ok(Self {
            stamp: Stamp { generation: reader.u64("generation")?, save_salt: reader.array("salt of the save")? },
            work: read_work(reader)?,
            salt: reader.array("salt")?,
            public: PublicIdentity {
                address: Address(reader.array("address")?),
                signing: PublicKey(reader.array("signing key")?),
                envelope: PublicKey(reader.array("envelope key")?),
            },
            commit: reader.array("commitment")?,
            length: usize::try_from(reader.u32("length")?).map_err(|_| WireError::Value("length"))?,
        })
    }
}

fn seal(keyring: &Keyring, key: &FileKey, stamp: Stamp) -> Result<Vec<u8>, CryptoError> {
    let mut sealed = encode(keyring);
    let keys = SaveKeys::derive(key, &stamp.save_salt, LABEL);
    let length = sealed.len() + 16;
    if length + HEADER > LARGEST {
        return Err(CryptoError::Length { what: "keyring", found: length, allowed: "at most 16 MiB" });
    }
    let public = keyring.public();
    let header = FileHeader { stamp, work: key.work, salt: key.salt, public, commit: keys.commit, length };
    let header = header.encode();
    provider(ProviderName::RustCrypto).gcm_seal(&keys.key, &keys.nonce, &header, &mut sealed)?;
    Ok([&header[..], &sealed].concat())
}

type Parts<'a> = (FileHeader, &'a [u8], &'a [u8]);

fn split(bytes: &[u8]) -> Result<Parts<'_>, Refusal> {
    let mut reader = Reader::new(bytes);
    if reader.array("magic")? != MAGIC {
        return Err(Refusal::Damaged);
    }
    match reader.u8("version")? {
        VERSION => {}
        found => return Err(Refusal::Version(found)),
    }
    let header = FileHeader::read(&mut reader)?;
    let sealed = reader.take(header.length, "sealed keys")?;
    reader.end()?;
    Ok((header, bytes.get(..HEADER).unwrap_or_default(), sealed))
}

fn stamp_of(bytes: &[u8], path: &Path) -> Result<Stamp, CryptoError> {
    split(bytes).map(|(header, _, _)| header.stamp).map_err(|refusal| refusal.of(path))
}

enum Refusal {
    Passphrase,
    Damaged,
    Version(u8),
}

impl Refusal {
    fn of(self, path: &Path) -> CryptoError {
        match self {
            Self::Passphrase => CryptoError::WrongPassphrase(shown(path)),
            Self::Damaged => CryptoError::DamagedKeyring(shown(path)),
            Self::Version(found) => CryptoError::Version { path: shown(path), what: "a keyring", found },
        }
    }
}

impl From<WireError> for Refusal {
    fn from(_: WireError) -> Self {
        Self::Damaged
    }
}

fn open(bytes: &[u8], key: &FileKey) -> Result<Keyring, Refusal> {
    let (header, aad, sealed) = split(bytes)?;
    let keys = SaveKeys::committed(key, &header.stamp.save_salt, LABEL, &header.commit).ok_or(Refusal::Passphrase)?;
    let plain = provider(ProviderName::RustCrypto)
        .gcm_open(&keys.key, &keys.nonce, aad, sealed)
        .map_err(|_| Refusal::Damaged)?;
    let keyring = parse(&plain)?;
    if keyring.public() == header.public { Ok(keyring) } else { Err(Refusal::Damaged) }
}

fn read(path: &Path) -> Result<Zeroizing<Vec<u8>>, CryptoError> {
    let bytes = read_private(path, LARGEST)?;
    check_private_directory(&directory_of(path))?;
    Ok(bytes)
}

/// A keyring's public header, read without the passphrase. An altered file may lie here, but does not open.
///
/// # Errors
/// [`CryptoError::Read`], [`CryptoError::OpenToOthers`], [`CryptoError::DamagedKeyring`] or [`CryptoError::Version`].
pub fn read_public(path: &Path) -> Result<PublicIdentity, CryptoError> {
    let bytes = read(path)?;
    split(&bytes).map(|(header, _, _)| header.public).map_err(|refusal| refusal.of(path))
}

impl Keyring {
    /// Reads and opens a keyring; derives the passphrase's key (about 0.3 s).
    ///
    /// # Errors
    /// See [`UnlockedKeyring::open`].
    pub fn load(path: &Path, passphrase: &Passphrase) -> Result<Self, CryptoError> {
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
    ///
    /// # Errors
    /// [`CryptoError::Random`]; nothing is wiped then.
    pub fn strip(&mut self, provider: &dyn Provider) -> Result<(), CryptoError> {
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
    ///
    /// # Errors
    /// [`CryptoError::Exists`], [`CryptoError::Write`] or [`CryptoError::OpenToOthers`].
    pub fn create(keyring: Keyring, path: &Path, passphrase: &Passphrase) -> Result<Self, CryptoError> {
        make_private_directory(&directory_of(path))?;
        let key = FileKey::new(passphrase)?;
        let stamp = Stamp { generation: 1, save_salt: random_bytes()? };
        create_private(path, &seal(&keyring, &key, stamp)?)?;
        Ok(Self { keyring, path: path.to_owned(), key, stamp, stripped: false })
    }

    /// Reads and opens a keyring file.
    ///
    /// # Errors
    /// [`CryptoError::Read`], [`CryptoError::OpenToOthers`], [`CryptoError::WrongPassphrase`],
    /// [`CryptoError::DamagedKeyring`] or [`CryptoError::Version`].
    pub fn open(path: &Path, passphrase: &Passphrase) -> Result<Self, CryptoError> {
        let bytes = read(path)?;
        let (header, _, _) = split(&bytes).map_err(|refusal| refusal.of(path))?;
        let key = FileKey::with(passphrase, header.work, header.salt)?;
        let keyring = open(&bytes, &key).map_err(|refusal| refusal.of(path))?;
        Ok(Self { keyring, path: path.to_owned(), key, stamp: header.stamp, stripped: false })
    }

    /// Changes the keys, in the file first and then here; if `change` or the write fails, neither is changed.
    ///
    /// # Errors
    /// What `change` returns; [`CryptoError::Superseded`] if the file is not the one that was read,
    /// [`CryptoError::Locked`], [`CryptoError::Read`] or [`CryptoError::Write`].
    pub fn change<T>(&mut self, change: impl FnOnce(&mut Keyring) -> Result<T, CryptoError>) -> Result<T, CryptoError> {
        let mut keyring = self.keyring.clone();
        let value = change(&mut keyring)?;
        self.write(&keyring, &self.key.clone())?;
        self.keyring = keyring;
        Ok(value)
    }

    /// Changes the passphrase and saves.
    ///
    /// # Errors
    /// See [`Self::change`].
    pub fn change_passphrase(&mut self, passphrase: &Passphrase) -> Result<(), CryptoError> {
        let key = FileKey::new(passphrase)?;
        self.write(&self.keyring.clone(), &key)?;
        self.key = key;
        Ok(())
    }

    /// The only way over an existing file.
    fn write(&mut self, keyring: &Keyring, key: &FileKey) -> Result<(), CryptoError> {
        if self.stripped {
            return Err(CryptoError::Locked(shown(&self.path)));
        }
        let (path, read, next) = (&self.path, self.stamp, self.stamp.next()?);
        let bytes = seal(keyring, key, next)?;
        let written = change_private(path, LARGEST, |there| {
            let there = there.ok_or_else(|| CryptoError::read(path)(std::io::ErrorKind::NotFound.into()))?;
            let there = stamp_of(there, path)?;
            if there != read {
                let (read, found) = (read.generation, there.generation);
                return Err(CryptoError::Superseded { path: shown(path), read, found });
            }
            fault::point("keyring-compared");
            Ok(Some(bytes))
        });
        // A write can fail after the file was replaced, if its directory is not synced: the file is still ours.
        if written.is_ok() || read_private(path, LARGEST).and_then(|there| stamp_of(&there, path)).ok() == Some(next) {
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

const PENDING: u8 = 0;
const ACTIVE: u8 = 1;
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
            out.push(if secret.state == EpochState::Active { ACTIVE } else { PENDING });
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
        signing: read_pair(&mut reader, "signing key")?,
        envelope: read_pair(&mut reader, "envelope key")?,
        sm4: Sm4Key::new(reader.array("SM4 key")?),
        index: IndexKey::new(reader.array("index key")?),
        networks: read_networks(&mut reader)?,
        further: read_further(&mut reader)?,
    };
    reader.end()?;
    Ok(keyring)
}

/// The pair of a private key (32).
pub(super) fn read_pair(reader: &mut Reader<'_>, field: &'static str) -> Result<SmKeyPair, WireError> {
    SmSecret::from_slice(reader.take(32, field)?)
        .and_then(|secret| SmKeyPair::from_secret(provider(ProviderName::RustCrypto), secret))
        .map_err(|_| WireError::Value(field))
}

fn read_further(reader: &mut Reader<'_>) -> Result<FurtherPairs, WireError> {
    let count = reader.u32("number of further pairs")?;
    let (mut further, mut before) = (FurtherPairs::default(), FORMER_ENVELOPE);
    for _ in 0..count {
        let usage = reader.u8("use of a pair")?;
        let pair = read_pair(reader, "further pair")?;
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
    Ok(EpochSecret {
        key: EpochKey::new(reader.array("epoch key")?),
        state: match reader.u8("epoch state")? {
            PENDING => EpochState::Pending,
            ACTIVE => EpochState::Active,
            _ => return Err(WireError::Value("epoch state")),
        },
    })
}

#[cfg(test)]
mod file_tests;
#[cfg(test)]
mod tests;

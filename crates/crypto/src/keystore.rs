//! The Ethereum V3 keystore: an EOA key under scrypt or PBKDF2 and AES-128-CTR with a Keccak MAC, as JSON.

use std::path::Path;

use aes::Aes128;
use ctr_legacy::Ctr128BE;
use ctr_legacy::cipher::{KeyIvInit as _, StreamCipher as _};
use hmac::{Hmac, KeyInit as _, Mac as _};
use serde::{Deserialize, Serialize};
use sha2::Sha256;
use sha3::{Digest as _, Keccak256};
use subtle::ConstantTimeEq as _;
use zeroize::Zeroizing;

use crate::error::shown;
use crate::identity::check_account;
use crate::kdf::{self, Info, kept_key};
use crate::model::bytes::{hex, unhex};
use crate::model::wire::{Reader, Wire, WireError};
use crate::model::{Address, Domain, PublicKey, body, clean, layout};
use crate::secret::{Work, stretch};
use crate::{
    AccountSignature, CryptoError, EoaSecret, Passphrase, Provider, Result, SmSecret, TransportKey, TypedStructure,
    random_bytes, sign_hash,
};

#[derive(Serialize, Deserialize)]
struct Keystore {
    #[serde(default)]
    address: String,
    #[serde(alias = "Crypto")]
    crypto: Sealed,
    #[serde(default)]
    id: String,
    version: u32,
}

#[derive(Serialize, Deserialize)]
struct Sealed {
    cipher: String,
    cipherparams: CipherParams,
    ciphertext: String,
    kdf: String,
    kdfparams: serde_json::Value,
    mac: String,
}

#[derive(Serialize, Deserialize)]
struct CipherParams {
    iv: String,
}

#[derive(Serialize, Deserialize)]
struct ScryptParams {
    dklen: u32,
    n: u64,
    p: u32,
    r: u32,
    salt: String,
}

#[derive(Deserialize)]
struct Pbkdf2Params {
    c: u32,
    dklen: u32,
    prf: String,
    salt: String,
}

/// The most iterations of PBKDF2 that a foreign file may ask for: some seconds.
const MOST_ITERATIONS: u32 = 4_000_000;

#[derive(Debug)]
pub(super) enum Refusal {
    Passphrase,
    Content(String),
}

fn content(found: &str) -> Refusal {
    Refusal::Content(format!("{found}; export it again as a V3 keystore with scrypt"))
}

pub(super) fn open(bytes: &[u8], passphrase: &str) -> Result<EoaSecret, Refusal> {
    let store: Keystore = serde_json::from_slice(bytes).map_err(|_| content("its JSON is not a keystore"))?;
    let sealed = &store.crypto;
    if store.version != 3 || sealed.cipher != "aes-128-ctr" || !["scrypt", "pbkdf2"].contains(&&*sealed.kdf) {
        let kind = format!("it is version {}, {}, {}", store.version, sealed.cipher, sealed.kdf);
        return Err(content(&clean(&kind, 80)));
    }
    let iv: [u8; 16] = exactly(&sealed.cipherparams.iv).ok_or_else(|| content("its iv is not 16 bytes"))?;
    let masked: [u8; 32] = exactly(&sealed.ciphertext).ok_or_else(|| content("its ciphertext is not 32 bytes"))?;
    let mac: [u8; 32] = exactly(&sealed.mac).ok_or_else(|| content("its mac is not 32 bytes"))?;
    let key = derived(sealed, passphrase)?;
    if !bool::from(keccak_mac(&key, &masked).ct_eq(&mac)) {
        return Err(Refusal::Passphrase);
    }
    let secret = unmasked(&key, &iv, &masked).ok_or_else(|| content("it holds no valid key"))?;
    same_address(&store.address, &secret)?;
    Ok(secret)
}

fn derived(sealed: &Sealed, passphrase: &str) -> Result<Zeroizing<[u8; 32]>, Refusal> {
    let incomplete = |_| content("its kdfparams are incomplete");
    let salt = |text: &str| unhex(text).ok_or_else(|| content("its salt is not hex"));
    if sealed.kdf == "scrypt" {
        let out_of_range = || content("its scrypt parameters are out of range");
        let params = ScryptParams::deserialize(&sealed.kdfparams).map_err(incomplete)?;
        let work = work(&params).ok_or_else(out_of_range)?;
        return stretch::<32>(passphrase, &salt(&params.salt)?, work).map_err(|_| out_of_range());
    }
    let params = Pbkdf2Params::deserialize(&sealed.kdfparams).map_err(incomplete)?;
    if params.prf != "hmac-sha256" || params.dklen != 32 || !(1..=MOST_ITERATIONS).contains(&params.c) {
        return Err(content("its pbkdf2 parameters are out of range"));
    }
    pbkdf2(passphrase, &salt(&params.salt)?, params.c).ok_or_else(|| content("its pbkdf2 parameters are out of range"))
}

/// PBKDF2 (RFC 8018) with HMAC-SHA256, one block.
fn pbkdf2(passphrase: &str, salt: &[u8], iterations: u32) -> Option<Zeroizing<[u8; 32]>> {
    let keyed = Hmac::<Sha256>::new_from_slice(passphrase.as_bytes()).ok()?;
    let mut block = Zeroizing::new(<[u8; 32]>::from(
        keyed.clone().chain_update(salt).chain_update(1u32.to_be_bytes()).finalize().into_bytes(),
    ));
    let mut out = block.clone();
    for _ in 1..iterations {
        *block = keyed.clone().chain_update(*block).finalize().into_bytes().into();
        out.iter_mut().zip(block.iter()).for_each(|(out, byte)| *out ^= byte);
    }
    Some(out)
}

fn same_address(stated: &str, secret: &EoaSecret) -> Result<(), Refusal> {
    let stated = unhex(stated).unwrap_or_default();
    if stated.is_empty() || stated == secret.address().0 {
        Ok(())
    } else {
        Err(content("its address does not match its key"))
    }
}

fn work(params: &ScryptParams) -> Option<Work> {
    let log_n = u8::try_from(params.n.checked_ilog2()?).ok()?;
    let work = Work { log_n, r: params.r, p: params.p };
    (params.n.is_power_of_two() && log_n > 0 && params.dklen == 32 && work.is_bearable()).then_some(work)
}

fn exactly<const N: usize>(text: &str) -> Option<[u8; N]> {
    unhex(text)?.try_into().ok()
}

fn keccak_mac(key: &[u8; 32], masked: &[u8; 32]) -> [u8; 32] {
    Keccak256::new().chain_update(&key[16..]).chain_update(masked).finalize().into()
}

fn mask(key: &[u8; 32], iv: &[u8; 16], data: &mut [u8; 32]) {
    let mut half = Zeroizing::new([0; 16]);
    half.copy_from_slice(&key[..16]);
    Ctr128BE::<Aes128>::new(&(*half).into(), &(*iv).into()).apply_keystream(data);
}

fn unmasked(key: &[u8; 32], iv: &[u8; 16], masked: &[u8; 32]) -> Option<EoaSecret> {
    let mut secret = Zeroizing::new(*masked);
    mask(key, iv, &mut secret);
    EoaSecret::from_slice(&*secret).ok()
}

pub(super) fn seal(secret: &EoaSecret, passphrase: &str) -> Result<String> {
    let (salt, iv) = (random_bytes::<32>()?, random_bytes::<16>()?);
    let key = stretch::<32>(passphrase, &salt, Work::WRITTEN)?;
    let mut masked = *secret.expose();
    mask(&key, &iv, &mut masked);
    let Work { log_n, r, p } = Work::WRITTEN;
    let params = ScryptParams { dklen: 32, n: 1 << log_n, p, r, salt: hex(&salt) };
    let internal = |_| CryptoError::Internal("keystore encoding");
    let store = Keystore {
        address: hex(&secret.address().0),
        crypto: Sealed {
            cipher: "aes-128-ctr".into(),
            cipherparams: CipherParams { iv: hex(&iv) },
            ciphertext: hex(&masked),
            kdf: "scrypt".into(),
            kdfparams: serde_json::to_value(params).map_err(internal)?,
            mac: hex(&keccak_mac(&key, &masked)),
        },
        id: uuid(random_bytes()?),
        version: 3,
    };
    serde_json::to_string_pretty(&store).map_err(internal)
}

/// A random UUID (RFC 9562, version 4).
fn uuid(mut bytes: [u8; 16]) -> String {
    bytes[6] = bytes[6] & 0x0f | 0x40;
    bytes[8] = bytes[8] & 0x3f | 0x80;
    let text = hex(&bytes);
    [&text[..8], &text[8..12], &text[12..16], &text[16..20], &text[20..]].join("-")
}

// The notice of a new P_C is signed by the old key, its content by the account: a thief needs both.

/// The EIP-712 type that the account signs.
const TYPE: &str = "OwnerKey(address owner,bytes oldKey,bytes newKey)";
const WHAT: &str = "owner's new key";

/// A change from one P_C to another: old (64) || new (64) || signature of the account (65).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OwnerKeyChange {
    /// The P_C until now, which signs the notice.
    pub old: PublicKey,
    /// The P_C from now on.
    pub new: PublicKey,
    /// The owner's EOA signature over both.
    pub account_signature: AccountSignature,
}

layout!(OwnerKeyChange { old: "old key", new: "new key", account_signature: "account's signature" });
body!(OwnerKeyChange);

impl OwnerKeyChange {
    /// Length of the encoding, bytes.
    pub const LENGTH: usize = 193;

    /// The owner's change from `old` to `new`, signed by the account.
    /// # Errors
    /// [`CryptoError::Internal`].
    pub fn sign(domain: &Domain, account: &EoaSecret, old: PublicKey, new: PublicKey) -> Result<Self> {
        let hash = signed_hash(domain, &account.address(), &old, &new);
        Ok(Self { old, new, account_signature: sign_hash(account, &hash)? })
    }

    /// Whether the owner may change the `known` key to this one. The signer of the notice was checked with the record.
    /// # Errors
    /// [`CryptoError::NotAccepted`] for another key or an unsigned one; [`CryptoError::PublicPoint`].
    pub fn check(&self, provider: &dyn Provider, domain: &Domain, owner: &Address, known: &PublicKey) -> Result<()> {
        if self.old != *known || self.new == self.old {
            return Err(CryptoError::NotAccepted { what: WHAT, field: "old key" });
        }
        provider.check_public_key(&self.new)?;
        let hash = signed_hash(domain, owner, &self.old, &self.new);
        check_account(&hash, &self.account_signature, owner, WHAT)
    }
}

fn signed_hash(domain: &Domain, owner: &Address, old: &PublicKey, new: &PublicKey) -> [u8; 32] {
    TypedStructure::new(TYPE).address(owner).bytes(&old.0).bytes(&new.0).signing_hash(domain)
}

// How secret files are sealed at rest: the passphrase's key is derived once (scrypt); each save draws a salt and, as
// for records, derives its own key, nonce and commitment. The commitment tells a wrong passphrase from damage.

/// The key derived from a passphrase, and how it was derived.
#[derive(Clone)]
pub(super) struct FileKey {
    pub work: Work,
    pub salt: [u8; 32],
    pub key: Zeroizing<[u8; 32]>,
}

impl FileKey {
    pub fn new(passphrase: &Passphrase) -> Result<Self> {
        Self::with(passphrase, Work::of(passphrase), random_bytes()?)
    }

    pub fn with(passphrase: &Passphrase, work: Work, salt: [u8; 32]) -> Result<Self> {
        Ok(Self { work, salt, key: stretch(passphrase.expose(), &salt, work)? })
    }
}

pub(super) struct SaveKeys {
    pub key: Zeroizing<[u8; 16]>,
    pub nonce: [u8; 12],
    pub commit: [u8; 32],
}

impl SaveKeys {
    /// For a save with this salt, in a file of the kind that `label` names.
    pub fn derive(key: &FileKey, save_salt: &[u8; 24], label: &str) -> Self {
        let bytes = Zeroizing::new(kdf::derived::<60>(&*key.key, save_salt, &Info::new(label)));
        Self {
            key: Zeroizing::new(std::array::from_fn(|index| bytes[index])),
            nonce: std::array::from_fn(|index| bytes[16 + index]),
            commit: std::array::from_fn(|index| bytes[28 + index]),
        }
    }

    /// The same, if they are those that a file commits to; else the passphrase is another one.
    pub fn committed(key: &FileKey, save_salt: &[u8; 24], label: &str, commit: &[u8; 32]) -> Option<Self> {
        Some(Self::derive(key, save_salt, label)).filter(|keys| bool::from(keys.commit.ct_eq(commit)))
    }
}

/// What a file sealed under a passphrase begins with: magic (8), version (1), work (9), salt (32), salt of this save (24),
/// commitment (32).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct SealedHead {
    pub work: Work,
    pub salt: [u8; 32],
    pub save_salt: [u8; 24],
    pub commit: [u8; 32],
}

layout!(SealedHead { work: "work", salt: "salt", save_salt: "salt of the save", commit: "commitment" });

impl SealedHead {
    pub const LENGTH: usize = 106;
    const VERSION: u8 = 1;

    pub fn new(key: &FileKey, label: &str) -> Result<(Self, SaveKeys)> {
        let save_salt = random_bytes()?;
        let keys = SaveKeys::derive(key, &save_salt, label);
        Ok((Self { work: key.work, salt: key.salt, save_salt, commit: keys.commit }, keys))
    }

    pub fn keys(&self, key: &FileKey, label: &str) -> Option<SaveKeys> {
        SaveKeys::committed(key, &self.save_salt, label, &self.commit)
    }

    pub fn encode(&self, magic: &[u8; 8]) -> Vec<u8> {
        self.behind(&[&magic[..], &[Self::VERSION]].concat())
    }

    /// Refuses an unreasonable amount of work; of `version`, if that is another.
    pub fn read(reader: &mut Reader<'_>, magic: &[u8; 8]) -> Result<Self, WireError> {
        if reader.array("magic")? != *magic {
            return Err(WireError::Value("magic"));
        }
        if reader.u8("version")? != Self::VERSION {
            return Err(WireError::Value("version"));
        }
        Wire::read(reader, "head")
    }
}

/// Why a file that begins with a magic (8) and a version (1) was refused, if it is of another version.
pub(super) fn of_version(path: &Path, what: &'static str, bytes: &[u8], why: WireError) -> Option<CryptoError> {
    let found = bytes.get(8).filter(|_| why == WireError::Value("version"))?;
    Some(CryptoError::Version { path: shown(path), what, found: *found })
}

// A gateway's transport keys at rest, sealed under a key derived from its keeper's d_E, which no grant gives away.

const NONCE: usize = 12;

/// Seals the transport key of a name: nonce (12) || SM4-GCM (32 + 16), with the name as AAD.
/// # Errors
/// From the random source.
pub fn seal_transport_key(
    provider: &dyn Provider,
    keeper: &SmSecret,
    name: &str,
    key: &TransportKey,
) -> Result<Vec<u8>> {
    let nonce: [u8; NONCE] = random_bytes()?;
    Ok([&nonce[..], &sealed_key(provider, (&kept_key(keeper), &nonce), name.as_bytes(), key)?].concat())
}

/// Opens what [`seal_transport_key`] sealed for this name.
/// # Errors
/// [`CryptoError::BadCiphertext`] if it was sealed for another name, by another keeper, or altered.
pub fn open_transport_key(
    provider: &dyn Provider,
    keeper: &SmSecret,
    name: &str,
    sealed: &[u8],
) -> Result<TransportKey> {
    let (nonce, rest) = sealed.split_first_chunk::<NONCE>().ok_or(CryptoError::BadCiphertext)?;
    let plain = provider.gcm_open(&kept_key(keeper), nonce, name.as_bytes(), rest)?;
    TransportKey::from_slice(&plain).ok_or(CryptoError::BadCiphertext)
}

pub(super) fn sealed_key(
    provider: &dyn Provider,
    (sealing, nonce): (&[u8; 16], &[u8; 12]),
    aad: &[u8],
    key: &TransportKey,
) -> Result<Vec<u8>> {
    // Reserved in one piece, tag included: growing the buffer would leave an unwiped copy behind.
    let mut sealed = Vec::with_capacity(TransportKey::LENGTH + 16);
    sealed.extend_from_slice(key.expose());
    provider.gcm_seal(sealing, nonce, aad, &mut sealed)?;
    Ok(sealed)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The scrypt vector of the Web3 Secret Storage definition.
    const OFFICIAL: &str = r#"{"crypto":{"cipher":"aes-128-ctr",
        "cipherparams":{"iv":"83dbcc02d8ccb40e466191a123791e0e"},
        "ciphertext":"d172bf743a674da9cdad04534d56926ef8358534d458fffccd4e6ad2fbde479c",
        "kdf":"scrypt","kdfparams":{"dklen":32,"n":262144,"r":1,"p":8,
        "salt":"ab0c7876052600dd703518d6fc3fe8984592145b591fc8fb5c6d43190334ba19"},
        "mac":"2103ac29920d71da29f15d75b4a16dbe95cfd7ff8faea1056c33131d846e3097"},
        "id":"3198bc9c-6672-5ab3-d995-4942343ae5b6","version":3}"#;

    #[test]
    fn the_official_vector_opens() {
        let secret = open(OFFICIAL.as_bytes(), "testpassword").expect("opens");
        assert_eq!(hex(secret.expose()), "7a28b5ba57c53603b0b07b56bba752f7784bf506fa95edc395f5cf6c7514fe9d");
        assert!(matches!(open(OFFICIAL.as_bytes(), "wrong"), Err(Refusal::Passphrase)));
    }

    /// The PBKDF2 vector of the Web3 Secret Storage definition, of the same key.
    const PBKDF2: &str = r#"{"crypto":{"cipher":"aes-128-ctr",
        "cipherparams":{"iv":"6087dab2f9fdbbfaddc31a909735c1e6"},
        "ciphertext":"5318b4d5bcd28de64ee5559e671353e16f075ecae9f99c7a79a38af5f869aa46",
        "kdf":"pbkdf2","kdfparams":{"c":262144,"dklen":32,"prf":"hmac-sha256",
        "salt":"ae3cd4e7013836a3df6bd7241b12db061dbe2c6785853cce422d148a624ce0bd"},
        "mac":"517ead924a9d0dc3124507e3393d175ce3ff7c1e96529c6c555ce9e51205e9b2"},
        "id":"3198bc9c-6672-5ab3-d995-4942343ae5b6","version":3}"#;

    #[test]
    fn the_official_vector_of_pbkdf2_opens_and_its_iterations_are_bounded() {
        let secret = open(PBKDF2.as_bytes(), "testpassword").expect("opens");
        assert_eq!(hex(secret.expose()), "7a28b5ba57c53603b0b07b56bba752f7784bf506fa95edc395f5cf6c7514fe9d");
        assert!(matches!(open(PBKDF2.as_bytes(), "wrong"), Err(Refusal::Passphrase)));
        for (from, to) in [
            ("262144", "0"),
            ("262144", "4000001"),
            ("262144", "4294967296"),
            ("\"dklen\":32", "\"dklen\":64"),
            ("hmac-sha256", "hmac-sha1"),
            ("\"salt\":\"ae", "\"salt\":\"zz"),
        ] {
            let text = PBKDF2.replace(from, to);
            assert!(matches!(open(text.as_bytes(), "testpassword"), Err(Refusal::Content(_))), "{to}");
        }
    }

    #[test]
    fn sealed_ones_open_and_altered_ones_do_not() {
        let secret = EoaSecret::generate().expect("random");
        let text = seal(&secret, "correct horse").expect("seals");
        assert_eq!(open(text.as_bytes(), "correct horse").expect("opens").expose(), secret.expose());
        assert!(text.contains("\"n\": 131072"), "{text}");
        assert!(!text.contains(&hex(secret.expose())));
        let swapped = text.replace(&hex(&secret.address().0), &"11".repeat(20));
        assert!(matches!(open(swapped.as_bytes(), "correct horse"), Err(Refusal::Content(_))));
    }

    #[test]
    fn foreign_and_unbearable_files_are_refused_before_any_work() {
        for (from, to) in [
            ("\"n\":262144", "\"n\":1099511627776"),
            ("\"n\":262144", "\"n\":262143"),
            ("\"r\":1", "\"r\":4294967295"),
            ("\"dklen\":32", "\"dklen\":16"),
            ("\"version\":3", "\"version\":1"),
            ("\"kdf\":\"scrypt\"", "\"kdf\":\"pbkdf2\""),
            ("\"iv\":\"83", "\"iv\":\""),
            ("\"mac\":\"21", "\"mac\":\"zz"),
        ] {
            let text = OFFICIAL.replace(from, to);
            assert_ne!(text, OFFICIAL, "{from}");
            assert!(matches!(open(text.as_bytes(), "testpassword"), Err(Refusal::Content(_))), "{to}");
        }
        assert!(matches!(open(b"{}", "x"), Err(Refusal::Content(_))));
    }
}

#[cfg(test)]
mod owner_key_tests {
    use super::*;
    use crate::{ProviderName, SmKeyPair, provider};

    #[test]
    fn only_the_owners_account_and_only_from_the_known_key() {
        let provider = provider(ProviderName::RustCrypto);
        let [old, new, other] = [(); 3].map(|()| SmKeyPair::generate(provider).expect("generates").public);
        let (account, thief) = (EoaSecret::generate().expect("generates"), EoaSecret::generate().expect("generates"));
        let (domain, owner) = (Domain([1; 32]), account.address());
        let change = OwnerKeyChange::sign(&domain, &account, old, new).expect("signs");
        assert!(change.check(provider, &domain, &owner, &old).is_ok());
        assert!(change.check(provider, &domain, &owner, &other).is_err(), "a key that is not known");
        assert!(change.check(provider, &domain, &owner, &new).is_err(), "a second time");
        assert!(change.check(provider, &Domain([2; 32]), &owner, &old).is_err(), "of another network");
        assert!(change.check(provider, &domain, &thief.address(), &old).is_err(), "of another owner");
        assert!(OwnerKeyChange { new: other, ..change }.check(provider, &domain, &owner, &old).is_err());
        let forged = OwnerKeyChange::sign(&domain, &thief, old, other).expect("signs");
        assert!(forged.check(provider, &domain, &owner, &old).is_err(), "by another account");
        let nowhere = OwnerKeyChange::sign(&domain, &account, old, PublicKey([7; 64])).expect("signs");
        assert!(nowhere.check(provider, &domain, &owner, &old).is_err(), "no point of the curve");

        let bytes = change.encode();
        assert_eq!((bytes.len(), OwnerKeyChange::parse(&bytes)), (OwnerKeyChange::LENGTH, Ok(change)));
        assert!(OwnerKeyChange::parse(&bytes[1..]).is_err());
        for at in 0..bytes.len() {
            let mut altered = bytes.clone();
            altered[at] ^= 1;
            let altered = OwnerKeyChange::parse(&altered).expect("the form is right");
            assert!(altered.check(provider, &domain, &owner, &old).is_err(), "byte {at}");
        }
    }
}

#[cfg(test)]
mod kept_key_tests {
    use super::*;
    use crate::{ProviderName, provider};

    #[test]
    fn only_the_same_keeper_and_name_open_it() {
        let provider = provider(ProviderName::RustCrypto);
        let [keeper, other] = [1, 2].map(|byte| SmSecret::from_slice(&[byte; 32]).expect("in range"));
        let key = TransportKey::new([3; 32]);
        let sealed = seal_transport_key(provider, &keeper, "robot-1", &key).expect("seals");
        assert_eq!(open_transport_key(provider, &keeper, "robot-1", &sealed).expect("opens").expose(), key.expose());
        assert!(open_transport_key(provider, &keeper, "robot-2", &sealed).is_err());
        assert!(open_transport_key(provider, &other, "robot-1", &sealed).is_err());
        for place in 0..sealed.len() {
            let mut changed = sealed.clone();
            changed[place] ^= 1;
            assert!(open_transport_key(provider, &keeper, "robot-1", &changed).is_err());
            assert!(open_transport_key(provider, &keeper, "robot-1", &sealed[..place]).is_err());
        }
        assert!(!crate::model::bytes::hex(&sealed).contains(&crate::model::bytes::hex(key.expose())));
    }
}

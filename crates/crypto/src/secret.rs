//! Secret keys as types: range-checked on construction, wiped on drop, never printed; and the passphrase of a keyring,
//! with the slow derivation of a key from it (scrypt, RFC 7914).
#![allow(clippy::missing_errors_doc, reason = "`CryptoError` says whether the random source or the key's range failed")]

use std::fmt;
use std::hint::black_box;
use std::str::FromStr;
use std::sync::{LazyLock, OnceLock};

use crate::model::bytes::{hex, unhex};
use crate::model::wire::{Reader, Wire, WireError};
use crate::model::{Address, PublicKey, SignerId, clean};
use crate::provider::{self, Provider, ProviderName};
use crate::{CryptoError, Result, kdf, sm2 as kernels};
use scrypt::Params;
use sm2::dsa::SigningKey;
use subtle::ConstantTimeEq as _;
use zeroize::{Zeroize, ZeroizeOnDrop, Zeroizing};

/// Compared in constant time, never printed.
macro_rules! guarded {
    ($name:ident.$field:tt) => {
        impl PartialEq for $name {
            fn eq(&self, other: &Self) -> bool {
                self.$field[..].ct_eq(&other.$field[..]).into()
            }
        }

        impl Eq for $name {}

        impl fmt::Debug for $name {
            fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str(concat!(stringify!($name), "(secret)"))
            }
        }
    };
}

macro_rules! secret_bytes {
    ($($(#[$doc:meta])* $name:ident($size:literal);)*) => {$(
        $(#[$doc])*
        #[derive(Clone, Zeroize, ZeroizeOnDrop)]
        pub struct $name([u8; $size]);

        impl $name {
            /// Length in bytes.
            pub const LENGTH: usize = $size;

            /// From its bytes.
            pub fn new(bytes: [u8; $size]) -> Self {
                Self(bytes)
            }

            /// Fresh, from the operating system's random source.
            pub fn generate() -> Result<Self> {
                random_bytes().map(Self)
            }

            /// From a slice of exactly [`Self::LENGTH`] bytes.
            pub fn from_slice(bytes: &[u8]) -> Option<Self> {
                bytes.try_into().ok().map(Self)
            }

            /// The secret bytes; do not copy them anywhere that outlives their use.
            pub fn expose(&self) -> &[u8; $size] {
                &self.0
            }
        }

        guarded!($name.0);
        crate::model::layout!($name(0));
    )*};
}

secret_bytes! {
    /// K_C: the SM4 key of a profile. Input to epoch keys, never a working key.
    Sm4Key(16);
    /// EK: the key from which an epoch's topic keys are derived.
    EpochKey(32);
    /// The key that seals the records of one topic in one epoch.
    TopicKey(32);
    /// IK: turns topic names and tags into pseudonyms; stable across epochs.
    IndexKey(32);
    /// Turns the types and tags of one topic's records into pseudonyms; derived from IK, not the other way round.
    FilterKey(32);
    /// K_T: the key a client and its gateway mix into every session; it opens no record.
    TransportKey(32);
    /// r: the secret random salt of an epoch, drawn when it begins and not kept.
    EpochSalt(32);
    /// The key under which a gateway's workers share secrets in their database.
    JoinSecret(32);
    /// The secret from which the keys of one record are derived; who has it can read this record, and no other.
    RecordSecret(32);
}

/// Fresh random bytes, drawn again until they are in range.
fn drawn<T>(of: impl Fn(&[u8]) -> Result<T>) -> Result<T> {
    loop {
        if let Ok(secret) = of(&*Zeroizing::new(random_bytes::<32>()?)) {
            return Ok(secret);
        }
    }
}

/// The private key of an externally owned account.
#[derive(Clone, Zeroize, ZeroizeOnDrop)]
pub struct EoaSecret {
    secret: [u8; 32],
    /// Public, and asked for far oftener than anything is signed.
    #[zeroize(skip)]
    address: Address,
}

impl EoaSecret {
    /// Fresh, from the operating system's random source.
    pub fn generate() -> Result<Self> {
        drawn(Self::from_slice)
    }

    /// From 32 bytes, big endian, 1 to n - 1 of secp256k1.
    pub fn from_slice(bytes: &[u8]) -> Result<Self> {
        let range = CryptoError::SecretRange("secp256k1");
        let Ok(secret) = <[u8; 32]>::try_from(bytes) else { return Err(range) };
        let Ok(key) = k256::ecdsa::SigningKey::from_slice(bytes) else { return Err(range) };
        let mut point = [0; 64];
        point.copy_from_slice(&key.verifying_key().to_encoded_point(false).as_bytes()[1..]);
        Ok(Self { secret, address: Address::from_public_key(&point) })
    }

    /// The secret bytes; do not copy them anywhere that outlives their use.
    pub fn expose(&self) -> &[u8; 32] {
        &self.secret
    }

    /// The account's address.
    pub fn address(&self) -> Address {
        self.address
    }
}

guarded!(EoaSecret.secret);

/// The order n of the SM2 group (GB/T 32918.5-2017, 4), big endian.
pub(crate) const ORDER: [u8; 32] = [
    0xff, 0xff, 0xff, 0xfe, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x72, 0x03, 0xdf,
    0x6b, 0x21, 0xc6, 0x05, 0x2b, 0x53, 0xbb, 0xf4, 0x09, 0x39, 0xd5, 0x41, 0x23,
];

/// 04 || x || y, the uncompressed encoding of a point.
pub(crate) fn uncompressed(public: &PublicKey) -> [u8; 65] {
    let mut bytes = [4; 65];
    bytes[1..].copy_from_slice(&public.0);
    bytes
}

/// A point or a signature of its two numbers, not yet checked.
pub(crate) fn joined(one: &[u8; 32], other: &[u8; 32]) -> [u8; 64] {
    let mut both = [0; 64];
    both[..32].copy_from_slice(one);
    both[32..].copy_from_slice(other);
    both
}

/// Whether `number` + 1 < n and `number` > 0, in constant time.
fn is_secret(number: &[u8; 32]) -> bool {
    let mut bound = ORDER;
    bound[31] -= 1;
    let borrow = number.iter().zip(bound).rev().fold(0u16, |borrow, (digit, limit)| {
        u16::from(*digit).wrapping_sub(u16::from(limit)).wrapping_sub(borrow) >> 15
    });
    let any = number.iter().fold(0, |any, digit| any | digit);
    borrow == 1 && any != 0
}

/// An SM2 private key d, 1 to n - 2 (GB/T 32918.1-2016, 6.1). Keys derived from it are computed once, wiped with it.
pub struct SmSecret {
    bytes: Zeroizing<[u8; 32]>,
    kernel: OnceLock<Box<kernels::SigningKey>>,
    signing: OnceLock<Box<SigningKey>>,
    public: OnceLock<PublicKey>,
}

impl SmSecret {
    /// Fresh, from the operating system's random source.
    pub fn generate() -> Result<Self> {
        drawn(Self::from_slice)
    }

    /// From 32 bytes, big endian.
    pub fn from_slice(bytes: &[u8]) -> Result<Self> {
        let array = <[u8; 32]>::try_from(bytes).map(Zeroizing::new).map_err(|_| CryptoError::SecretRange("SM2"))?;
        if !is_secret(&array) {
            return Err(CryptoError::SecretRange("SM2"));
        }
        Ok(Self { bytes: array, kernel: OnceLock::new(), signing: OnceLock::new(), public: OnceLock::new() })
    }

    /// The secret bytes; do not copy them anywhere that outlives their use.
    pub fn expose(&self) -> &[u8; 32] {
        &self.bytes
    }

    pub(crate) fn kernel_key(&self) -> Result<&kernels::SigningKey> {
        if self.kernel.get().is_none() {
            // Another thread may have been first; its key is the same, and the second one wipes itself.
            let _ = self.kernel.set(Box::new(kernels::SigningKey::new(&self.bytes)?));
        }
        self.kernel.get().map(|key| &**key).ok_or(CryptoError::Internal("SM2"))
    }

    pub(crate) fn signing_key(&self) -> Result<&SigningKey> {
        if self.signing.get().is_none() {
            // Another thread may have been first; its key is the same.
            if let Err(mut second) = self.signing.set(Box::new(provider::signing_key(&self.bytes)?)) {
                wipe(&mut second);
            }
        }
        self.signing.get().map(|key| &**key).ok_or(CryptoError::Internal("SM2"))
    }

    /// The public key, computed by `provider` the first time.
    pub(crate) fn public_key(&self, provider: &dyn Provider) -> Result<&PublicKey> {
        if self.public.get().is_none() {
            let _ = self.public.set(provider.public_key(self)?);
        }
        self.public.get().ok_or(CryptoError::Internal("SM2"))
    }
}

impl Clone for SmSecret {
    fn clone(&self) -> Self {
        let (kernel, signing) = (OnceLock::new(), OnceLock::new());
        Self { bytes: self.bytes.clone(), kernel, signing, public: self.public.clone() }
    }
}

impl Drop for SmSecret {
    fn drop(&mut self) {
        if let Some(key) = self.signing.get_mut() {
            wipe(key);
        }
    }
}

/// The crate's key does not wipe itself, so its memory is overwritten here.
fn wipe(key: &mut SigningKey) {
    static BLANK: LazyLock<Option<SigningKey>> = LazyLock::new(|| provider::signing_key(&[1; 32]).ok());
    if let Some(blank) = BLANK.as_ref() {
        *key = blank.clone();
        black_box(key);
    }
}

guarded!(SmSecret.bytes);

/// An SM2 private key and its public key.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SmKeyPair {
    /// d.
    pub secret: SmSecret,
    /// P = [d]G.
    pub public: PublicKey,
}

impl SmKeyPair {
    /// A fresh pair.
    pub fn generate(provider: &dyn Provider) -> Result<Self> {
        Self::from_secret(provider, SmSecret::generate()?)
    }

    /// The pair of a private key.
    pub fn from_secret(provider: &dyn Provider, secret: SmSecret) -> Result<Self> {
        let public = *secret.public_key(provider)?;
        Ok(Self { secret, public })
    }

    /// The fingerprint of the public key.
    pub fn fingerprint(&self) -> Fingerprint {
        Fingerprint::of(&self.public)
    }
}

/// By the private key (32) alone.
impl Wire for SmKeyPair {
    fn put(&self, out: &mut Vec<u8>) {
        self.secret.bytes.put(out);
    }

    fn read(reader: &mut Reader<'_>, field: &'static str) -> Result<Self, WireError> {
        SmSecret::from_slice(reader.take(32, field)?)
            .and_then(|secret| Self::from_secret(provider::provider(ProviderName::RustCrypto), secret))
            .map_err(|_| WireError::Value(field))
    }
}

/// The first 16 bytes of SM3 of a public key, in eight groups of four hex characters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Fingerprint([u8; 16]);

/// Why a text is not a fingerprint.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "'{0}' is not a complete fingerprint; it has eight groups of four hex characters, as `authros identity show` \
     prints it"
)]
pub struct FingerprintError(String);

impl Fingerprint {
    /// Of `public`.
    pub fn of(public: &PublicKey) -> Self {
        Self::of_signer(&kdf::signer_id(public))
    }

    /// For the key whose SM3 is `signer`.
    pub fn of_signer(signer: &SignerId) -> Self {
        let mut first = [0; 16];
        first.copy_from_slice(&signer.0[..16]);
        Self(first)
    }
}

/// Also takes capitals and other separators (none, `:`, `-`). A part is refused: the rest could differ.
impl FromStr for Fingerprint {
    type Err = FingerprintError;

    fn from_str(text: &str) -> Result<Self, FingerprintError> {
        let parting = |character: &char| character.is_whitespace() || *character == ':' || *character == '-';
        let digits: String = text.chars().filter(|character| !parting(character)).collect();
        let bytes = unhex(&digits).filter(|_| !digits.starts_with("0x"));
        let bytes = bytes.and_then(|bytes| bytes.try_into().ok());
        bytes.map(Self).ok_or_else(|| FingerprintError(clean(text, 60)))
    }
}

impl fmt::Display for Fingerprint {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let groups: Vec<String> = self.0.chunks(2).map(hex).collect();
        formatter.write_str(&groups.join(" "))
    }
}

/// The fewest characters of a passphrase.
pub const SHORTEST_PASSPHRASE: usize = 8;

/// Begins each passphrase that the program makes itself; 32 hex digits follow.
const RANDOM_PASSPHRASE: &str = "random-";

/// A passphrase of at least [`SHORTEST_PASSPHRASE`] characters, wiped when dropped.
#[derive(Clone)]
pub struct Passphrase(Zeroizing<String>);

impl Passphrase {
    /// From what a person typed or a file holds, without the trailing line break.
    pub fn new(text: String) -> Result<Self> {
        let text = Zeroizing::new(text);
        let line = text.strip_suffix('\n').unwrap_or(&text);
        let line = line.strip_suffix('\r').unwrap_or(line);
        let count = line.chars().count();
        if count < SHORTEST_PASSPHRASE {
            return Err(CryptoError::ShortPassphrase(count));
        }
        Ok(Self(Zeroizing::new(line.to_owned())))
    }

    /// A random one: `random-` and 128 bits in hex.
    pub fn random() -> Result<Self> {
        let digits = Zeroizing::new(hex(&*Zeroizing::new(random_bytes::<16>()?)));
        Ok(Self(Zeroizing::new([RANDOM_PASSPHRASE, &digits].concat())))
    }

    /// Whether [`Passphrase::random`] made it.
    fn is_random(&self) -> bool {
        let digits = self.0.strip_prefix(RANDOM_PASSPHRASE);
        digits.is_some_and(|digits| digits.len() == 32 && digits.bytes().all(|digit| digit.is_ascii_hexdigit()))
    }

    /// The text; do not copy it anywhere that outlives its use.
    pub fn expose(&self) -> &str {
        &self.0
    }
}

impl fmt::Debug for Passphrase {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("Passphrase(secret)")
    }
}

/// The scrypt parameters; memory is 128 * r * 2^`log_n` bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Work {
    pub log_n: u8,
    pub r: u32,
    pub p: u32,
}

impl Wire for Work {
    fn put(&self, out: &mut Vec<u8>) {
        (self.log_n, self.r, self.p).put(out);
    }

    fn read(reader: &mut Reader<'_>, field: &'static str) -> Result<Self, WireError> {
        let (log_n, r, p) = Wire::read(reader, field)?;
        Some(Self { log_n, r, p }).filter(|work| work.is_bearable()).ok_or(WireError::Value(field))
    }
}

impl Work {
    /// For a passphrase that a person chose: 128 MiB, about 0.3 s.
    pub const WRITTEN: Self = Self { log_n: 17, r: 8, p: 1 };

    /// Nobody guesses 128 random bits, so a robot's start need not take 128 MiB to make that slow: 1 MiB.
    pub const RANDOM: Self = Self { log_n: 10, r: 8, p: 1 };

    /// What a new file under this passphrase is written with.
    pub fn of(passphrase: &Passphrase) -> Self {
        if passphrase.is_random() { Self::RANDOM } else { Self::WRITTEN }
    }

    /// Whether a foreign file may ask for these parameters: at most 512 MiB and 16 times the usual time.
    pub fn is_bearable(self) -> bool {
        let bytes = 128u64.saturating_mul(u64::from(self.r)).saturating_mul(1 << self.log_n.min(40));
        let usual = (128 * 8) << 17;
        self.r > 0 && self.p > 0 && bytes <= 4 * usual && bytes.saturating_mul(u64::from(self.p)) <= 16 * usual
    }
}

pub(super) fn stretch<const N: usize>(passphrase: &str, salt: &[u8], work: Work) -> Result<Zeroizing<[u8; N]>> {
    let params = Params::new(work.log_n, work.r, work.p).map_err(|_| CryptoError::Internal("scrypt"))?;
    let mut out = Zeroizing::new([0; N]);
    scrypt::scrypt(passphrase.as_bytes(), salt, &params, &mut *out).map_err(|_| CryptoError::Internal("scrypt"))?;
    Ok(out)
}

// Random bytes from the operating system; the only source of randomness in this crate.

/// `N` fresh random bytes.
pub fn random_bytes<const N: usize>() -> Result<[u8; N]> {
    let mut bytes = [0; N];
    getrandom::fill(&mut bytes).map_err(|_| CryptoError::Random)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secrets_are_compared_but_never_shown() {
        let key = Sm4Key::generate().expect("random");
        assert_eq!(key, Sm4Key::from_slice(key.expose()).expect("16 bytes"));
        assert_ne!(key, Sm4Key::generate().expect("random"));
        assert_eq!(format!("{key:?}"), "Sm4Key(secret)");
        assert!(Sm4Key::from_slice(&[0; 15]).is_none());
    }
}

#[cfg(test)]
mod eoa_tests {
    use super::*;

    #[test]
    fn addresses_of_well_known_keys() {
        let mut one = [0; 32];
        one[31] = 1;
        let address = EoaSecret::from_slice(&one).expect("in range").address();
        assert_eq!(address.to_string(), "0x7E5F4552091A69125d5DfCb7b8C2659029395Bdf");
        assert!(EoaSecret::from_slice(&[0; 32]).is_err());
        assert!(EoaSecret::from_slice(&[0xff; 32]).is_err());
        assert!(EoaSecret::from_slice(&[1; 31]).is_err());
        let shown = format!("{:?}", EoaSecret::from_slice(&one));
        assert!(!shown.contains(&"00".repeat(8)), "{shown}");
    }
}

#[cfg(test)]
mod sm2_secret_tests {
    use super::*;
    use crate::{ProviderName, provider};

    #[test]
    fn the_range_is_one_to_n_minus_two() {
        let with_last = |last: u8| {
            let mut bytes = ORDER;
            bytes[31] = last;
            bytes
        };
        let mut one = [0; 32];
        one[31] = 1;
        assert!(SmSecret::from_slice(&one).is_ok());
        assert!(SmSecret::from_slice(&with_last(0x21)).is_ok(), "n - 2");
        for bad in [[0; 32], with_last(0x22), with_last(0x23), with_last(0x24), [0xff; 32]] {
            assert!(SmSecret::from_slice(&bad).is_err(), "{bad:02x?}");
        }
        assert!(SmSecret::from_slice(&one[..31]).is_err());
    }

    #[test]
    fn fingerprints_are_eight_groups_and_debug_is_redacted() {
        let provider = provider(ProviderName::RustCrypto);
        let pair = SmKeyPair::generate(provider).expect("pair");
        provider.sign(&pair.secret, b"x").expect("signs");
        let shown = pair.fingerprint().to_string();
        assert_eq!(shown.len(), 39);
        for way in [shown.clone(), shown.to_uppercase(), shown.replace(' ', ""), shown.replace(' ', ":")] {
            assert_eq!(way.parse(), Ok(pair.fingerprint()), "{way}");
        }
        for bad in ["", &shown[..34], &format!("{shown}00"), &shown.replace(' ', "g")] {
            assert!(bad.parse::<Fingerprint>().is_err(), "{bad}");
        }
        assert_eq!(shown.replace(' ', ""), kdf::signer_id(&pair.public).to_hex()[..32]);
        assert!(!format!("{pair:?}").contains(&hex(pair.secret.expose())));
        assert_eq!(pair.clone(), pair);
    }
}

#[cfg(test)]
mod passphrase_tests {
    use super::*;

    #[test]
    fn short_ones_are_refused_and_line_breaks_do_not_count() {
        assert!(matches!(Passphrase::new("1234567\n".into()), Err(CryptoError::ShortPassphrase(7))));
        assert_eq!(Passphrase::new("12345678\r\n".into()).expect("long enough").expose(), "12345678");
        assert_eq!(Passphrase::new("密码密码密码密码".into()).expect("eight characters").expose().len(), 24);
        assert_eq!(Passphrase::random().expect("random").expose().len(), 39);
        assert_eq!(format!("{:?}", Passphrase::random()), "Ok(Passphrase(secret))");
    }

    #[test]
    fn scrypt_follows_rfc_7914_and_unbearable_work_is_refused() {
        let key = stretch::<64>("password", b"NaCl", Work { log_n: 10, r: 8, p: 16 }).expect("derives");
        assert_eq!(hex(&key[..8]), "fdbabe1c9d347200");
        assert!(Work::WRITTEN.is_bearable() && Work::RANDOM.is_bearable());
        assert_eq!(Work::of(&Passphrase::random().expect("random")), Work::RANDOM);
        let digits = "0123456789abcdef0123456789abcdef";
        for chosen in
            [digits, "random-0123456789abcdef", &format!("random-{}", &digits[..31]), &format!("random-{digits}0")]
        {
            assert_eq!(Work::of(&Passphrase::new(chosen.to_owned()).expect("long enough")), Work::WRITTEN, "{chosen}");
        }
        assert!(Work { log_n: 18, r: 8, p: 1 }.is_bearable());
        for (log_n, r, p) in
            [(63, 8, 1), (20, 8, 1), (17, 8, 17), (17, u32::MAX, 1), (40, 1 << 25, 1), (17, 0, 1), (10, 8, 0)]
        {
            assert!(!Work { log_n, r, p }.is_bearable(), "{log_n} {r} {p}");
        }
    }
}

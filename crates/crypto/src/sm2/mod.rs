//! SM2 (GB/T 32918-2016) by our own kernels: the steps of the standard, nonces, and tables for known signers.

#[cfg(test)]
mod tests;

use std::collections::HashMap;
use std::hash::{BuildHasher as _, RandomState};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, LazyLock, Mutex, PoisonError, RwLock};
use std::time::Instant;

use subtle::ConstantTimeEq as _;
use zeroize::{Zeroize, ZeroizeOnDrop, Zeroizing};

use crate::der::CipherParts;
use crate::kernel::sm2::{Affine, Scalar, Signer, SignerTable, multiply, multiply_both, multiply_generator, verifies};
use crate::model::{PublicKey, Signature};
use crate::provider::{DISTINGUISHED_ID, halves};
use crate::secret::{joined, random_bytes};
use crate::sm3::{Sm3Hasher, sm3};
use crate::{CryptoError, Result};

/// The point of a public key, checked to be on the curve and canonically encoded.
pub(super) fn point(public: &PublicKey) -> Result<Affine> {
    Affine::from_bytes(&public.0).ok_or(CryptoError::PublicPoint)
}

// Nonces are hedged: HMAC-SM3 of key, hash and fresh random bytes (RFC 6979, 3.2 and 3.6), so that a failing random
// source does not give a nonce away.

/// A key of HMAC-SM3, with its two pads already hashed.
struct Keyed {
    inner: Sm3Hasher,
    outer: Sm3Hasher,
}

impl Keyed {
    fn new(key: &[u8; 32]) -> Self {
        let padded = |pad: u8| {
            let mut block = Zeroizing::new([pad; 64]);
            block.iter_mut().zip(key).for_each(|(byte, key)| *byte ^= key);
            let mut hasher = Sm3Hasher::new();
            hasher.update(&*block);
            hasher
        };
        Self { inner: padded(0x36), outer: padded(0x5c) }
    }

    fn code(&self, parts: &[&[u8]]) -> Zeroizing<[u8; 32]> {
        let (mut inner, mut outer) = (self.inner.clone(), self.outer.clone());
        for part in parts {
            inner.update(part);
        }
        outer.update(&*Zeroizing::new(inner.finish()));
        Zeroizing::new(outer.finish())
    }
}

/// The nonces for one signature, one after the other until one fits.
struct Nonces {
    key: Keyed,
    value: Zeroizing<[u8; 32]>,
    used: bool,
}

impl Nonces {
    /// From the secret number, the hash modulo n, and fresh random bytes.
    pub fn new(secret: &[u8; 32], hash: &[u8; 32], random: &[u8; 32]) -> Self {
        let (mut key, mut value) = (Keyed::new(&[0; 32]), Zeroizing::new([1; 32]));
        for round in [0u8, 1] {
            let next = key.code(&[&value[..], &[round], secret, hash, random]);
            key = Keyed::new(&next);
            value = key.code(&[&value[..]]);
        }
        Self { key, value, used: false }
    }

    /// The next number from 1 to n - 1.
    pub fn next(&mut self) -> Zeroizing<Scalar> {
        loop {
            if self.used {
                let next = self.key.code(&[&self.value[..], &[0]]);
                self.key = Keyed::new(&next);
                self.value = self.key.code(&[&self.value[..]]);
            }
            self.used = true;
            self.value = self.key.code(&[&self.value[..]]);
            if let Some(number) = Scalar::from_bytes(&self.value) {
                return Zeroizing::new(number);
            }
        }
    }
}

// A table only makes verification faster; every signature is verified in full. It is built at a signer's third valid
// signature, and replaced only if its signer had none for an hour: no flood of signatures makes an hour pass.

/// The most bytes of all tables together.
const ROOM: usize = 64 << 20;
/// The most tables.
const MOST: usize = ROOM / (SignerTable::BYTES + 1024);
/// At most 64 KiB a signer, and room for a few thousand.
const _: () = assert!(SignerTable::BYTES <= 64 << 10 && MOST * SignerTable::BYTES <= ROOM && MOST >= 2_500);
/// The number of valid signatures at which a signer's table is built.
const SIGHTINGS: u8 = 3;
/// The most signers whose sightings are counted at once.
const COUNTED: usize = 4096;
/// Seconds without a valid signature before a table may be replaced. Not a number of verifications: a flood
/// of them takes a second.
const IDLE: u64 = 3600;

/// A known signer: its key was checked when the table was built.
struct Known {
    pub table: SignerTable,
    pub za: [u8; 32],
    /// When it last found a signature valid.
    used: AtomicU64,
}

impl Known {
    /// Notes a valid signature; an invalid one is anybody's and counts for nothing.
    pub fn used(&self, now: u64) {
        self.used.fetch_max(now, Ordering::Relaxed);
    }
}

struct Signers {
    tables: RwLock<HashMap<[u8; 64], Arc<Known>>>,
    /// By the hash of a key: the hash, and how often it was seen.
    sightings: Mutex<Vec<(u64, u8)>>,
    hasher: RandomState,
    most: usize,
    /// No table is idle before then: as long as it has not come, nobody looks through all of them.
    idle_from: AtomicU64,
}

/// Those of this process, and since when time is counted.
static SIGNERS: LazyLock<(Signers, Instant)> = LazyLock::new(|| (Signers::new(MOST), Instant::now()));

/// The signers of this process, and the seconds since their beginning by the clock that nobody sets.
fn of_process() -> (&'static Signers, u64) {
    let (signers, begun) = &*SIGNERS;
    (signers, begun.elapsed().as_secs())
}

impl Signers {
    pub fn new(most: usize) -> Self {
        Self {
            tables: RwLock::default(),
            sightings: Mutex::new(vec![(0, 0); COUNTED]),
            hasher: RandomState::new(),
            most,
            idle_from: AtomicU64::new(0),
        }
    }

    /// The table of a known signer.
    pub fn known(&self, public: &PublicKey) -> Option<Arc<Known>> {
        self.tables.read().unwrap_or_else(PoisonError::into_inner).get(&public.0).cloned()
    }

    /// Counts a valid signature; builds the signer's table at the third.
    pub fn seen(&self, public: &PublicKey, point: &Affine, za: &[u8; 32], now: u64) {
        if !self.is_due(public) || !self.has_room(now) {
            return;
        }
        let known = Arc::new(Known { table: SignerTable::new(point), za: *za, used: AtomicU64::new(now) });
        let mut tables = self.tables.write().unwrap_or_else(PoisonError::into_inner);
        if tables.len() >= self.most {
            let Some(idle) = self.idle(&tables, now) else { return };
            tables.remove(&idle);
        }
        tables.insert(public.0, known);
    }

    /// Whether this is the sighting at which a table is built; counting starts again after it. A signer may displace
    /// another's count: the hash is keyed, so nobody can do so on purpose.
    fn is_due(&self, public: &PublicKey) -> bool {
        let hash = self.hasher.hash_one(public.0);
        let mut sightings = self.sightings.lock().unwrap_or_else(PoisonError::into_inner);
        let place = usize::try_from(hash % COUNTED as u64).unwrap_or_default();
        let Some(sighting) = sightings.get_mut(place) else { return false };
        let count = if sighting.0 == hash { sighting.1.saturating_add(1) } else { 1 };
        let is_due = count >= SIGHTINGS;
        *sighting = (hash, if is_due { 0 } else { count });
        is_due
    }

    /// Whether there is room for a table, checked before it is built.
    fn has_room(&self, now: u64) -> bool {
        let tables = self.tables.read().unwrap_or_else(PoisonError::into_inner);
        tables.len() < self.most || self.idle(&tables, now).is_some()
    }

    /// The table unused for the longest time, if that is long enough.
    fn idle(&self, tables: &HashMap<[u8; 64], Arc<Known>>, now: u64) -> Option<[u8; 64]> {
        if now < self.idle_from.load(Ordering::Relaxed) {
            return None;
        }
        let used = tables.iter().map(|(key, known)| (key, known.used.load(Ordering::Relaxed)));
        let (key, used) = used.min_by_key(|one| one.1)?;
        if now.saturating_sub(used) >= IDLE {
            return Some(*key);
        }
        // Use moves forward only, and a table that takes the place of another one was used just now.
        self.idle_from.fetch_max(used + IDLE, Ordering::Relaxed);
        None
    }
}

// Signatures (GB/T 32918.2-2016, 6.1 and 7.1) under the ID 1234567812345678.

/// a, b, and the coordinates of G (GB/T 32918.5-2017, 4), as hashed into ZA.
const CURVE: [u8; 128] = curve();

const fn curve() -> [u8; 128] {
    let numbers: [u128; 8] = [
        0xffff_fffe_ffff_ffff_ffff_ffff_ffff_ffff,
        0xffff_ffff_0000_0000_ffff_ffff_ffff_fffc,
        0x28e9_fa9e_9d9f_5e34_4d5a_9e4b_cf65_09a7,
        0xf397_89f5_15ab_8f92_ddbc_bd41_4d94_0e93,
        0x32c4_ae2c_1f19_8119_5f99_0446_6a39_c994,
        0x8fe3_0bbf_f266_0be1_715a_4589_334c_74c7,
        0xbc37_36a2_f4f6_779c_59bd_cee3_6b69_2153,
        0xd0a9_877c_c62a_4740_02df_32e5_2139_f0a0,
    ];
    let (mut bytes, mut at) = ([0; 128], 0);
    while at < 128 {
        bytes[at] = numbers[at / 16].to_be_bytes()[at % 16];
        at += 1;
    }
    bytes
}

/// ZA (GB/T 32918.2-2016, 5.5): what a signature binds about the signer, besides the message.
fn za(public: &PublicKey) -> [u8; 32] {
    sm3(&[&[0, 0x80], DISTINGUISHED_ID.as_bytes(), &CURVE, &public.0])
}

/// e: the hash of ZA and the message, modulo n.
fn hash(za: &[u8; 32], message: &[u8]) -> Scalar {
    let mut hasher = Sm3Hasher::new();
    hasher.update(za);
    hasher.update(message);
    Scalar::reduced(&hasher.finish())
}

/// What signing needs from a secret key, computed once: 1 / (1 + d), the public key, ZA.
#[derive(Zeroize, ZeroizeOnDrop)]
pub(crate) struct SigningKey {
    secret: [u8; 32],
    inverse: Scalar,
    #[zeroize(skip)]
    public: PublicKey,
    #[zeroize(skip)]
    za: [u8; 32],
}

impl SigningKey {
    /// For d, 1 to n - 2.
    pub fn new(secret: &[u8; 32]) -> Result<Self> {
        let range = || CryptoError::SecretRange("SM2");
        let number = Zeroizing::new(Scalar::from_bytes(secret).ok_or_else(range)?);
        let one_more = Zeroizing::new(number.plus(&Scalar::ONE));
        if one_more.is_zero() {
            return Err(range());
        }
        let public = PublicKey(multiply_generator(&number).to_bytes());
        Ok(Self { secret: *secret, inverse: one_more.invert(), public, za: za(&public) })
    }

    pub fn public(&self) -> &PublicKey {
        &self.public
    }

    /// A signature whose nonce is derived from key, message and `random`.
    pub fn sign(&self, message: &[u8], random: &[u8; 32]) -> Signature {
        let e = hash(&self.za, message);
        let mut nonces = Nonces::new(&self.secret, &e.to_bytes(), random);
        loop {
            if let Some(signature) = self.sign_with(&e, &nonces.next()) {
                return signature;
            }
        }
    }

    /// A4 to A7; nothing if the nonce does not fit, which never happens in practice.
    fn sign_with(&self, e: &Scalar, nonce: &Scalar) -> Option<Signature> {
        let x = multiply_generator(nonce).x_bytes();
        let r = e.plus(&Scalar::reduced(&x));
        let both = Zeroizing::new(r.plus(nonce));
        // (k - r d) / (1 + d) is (k + r) / (1 + d) - r.
        let s = both.times(&self.inverse).minus(&r);
        if r.is_zero() || both.is_zero() || s.is_zero() {
            return None;
        }
        Some(Signature(joined(&r.to_bytes(), &s.to_bytes())))
    }
}

/// Checks a signature in full, using the signer's table if there is one.
pub(crate) fn verify(public: &PublicKey, message: &[u8], signature: &Signature) -> Result<()> {
    let (signers, now) = of_process();
    verify_among(signers, now, public, message, signature)
}

/// As [`verify`], with the tables of `signers` at the time `now`.
fn verify_among(signers: &Signers, now: u64, public: &PublicKey, message: &[u8], signature: &Signature) -> Result<()> {
    if let Some(known) = signers.known(public) {
        check(&known.table, &known.za, message, signature)?;
        known.used(now);
        return Ok(());
    }
    let (point, za) = (point(public)?, za(public));
    check(&point, &za, message, signature)?;
    signers.seen(public, &point, &za, now);
    Ok(())
}

/// Checks a signature in full, as for an unknown signer; only for measurements.
/// # Errors
/// [`CryptoError::PublicPoint`] or [`CryptoError::BadSignature`].
pub fn verify_as_stranger(public: &PublicKey, message: &[u8], signature: &Signature) -> Result<()> {
    check(&point(public)?, &za(public), message, signature)
}

fn check(signer: &impl Signer, za: &[u8; 32], message: &[u8], signature: &Signature) -> Result<()> {
    let (halves, _) = signature.0.as_chunks::<32>();
    let number = |at: usize| halves.get(at).and_then(Scalar::from_bytes).ok_or(CryptoError::BadSignature);
    let (r, s) = (number(0)?, number(1)?);
    if verifies(signer, &hash(za, message), &r, &s) { Ok(()) } else { Err(CryptoError::BadSignature) }
}

// Encryption (GB/T 32918.4-2016, 6.1 and 7.1) with points already checked.

pub(crate) fn encrypt(public: &PublicKey, plain: &[u8]) -> Result<CipherParts> {
    let point = point(public)?;
    loop {
        let random = Zeroizing::new(random_bytes()?);
        let parts = Scalar::from_bytes(&random).and_then(|k| encrypt_with(&Zeroizing::new(k), &point, plain));
        if let Some(parts) = parts {
            return Ok(parts);
        }
    }
}

/// A2 to A8 with a number from 1 to n - 1; nothing if the mask is all zeros.
fn encrypt_with(k: &Scalar, point: &Affine, plain: &[u8]) -> Option<CipherParts> {
    let [own, mut shared] = multiply_both(k, point);
    let coordinates = Zeroizing::new(shared.to_bytes());
    shared.zeroize();
    let mut text = plain.to_vec();
    let masked = mask(&coordinates, &mut text);
    if !masked {
        text.zeroize();
        return None;
    }
    let check = check_value(&coordinates, plain);
    let own = own.to_bytes();
    let (x, y) = halves(&own)?;
    Some(CipherParts { x, y, check, text })
}

/// Decrypts with a secret number; constant-time in it.
pub(crate) fn decrypt(secret: &[u8; 32], parts: CipherParts) -> Result<Zeroizing<Vec<u8>>> {
    let shared = shared(secret, &PublicKey(joined(&parts.x, &parts.y)))?;
    let coordinates = Zeroizing::new(shared.to_bytes());
    let mut plain = Zeroizing::new(parts.text);
    let masked = mask(&coordinates, &mut plain);
    let same = bool::from(check_value(&coordinates, &plain).ct_eq(&parts.check));
    if masked && same { Ok(plain) } else { Err(CryptoError::BadCiphertext) }
}

/// A secret number times a public key; constant-time in the number.
fn shared(secret: &[u8; 32], public: &PublicKey) -> Result<Zeroizing<Affine>> {
    let point = point(public)?;
    let number = Zeroizing::new(Scalar::from_bytes(secret).ok_or(CryptoError::SecretRange("SM2"))?);
    Ok(Zeroizing::new(multiply(&number, &point)))
}

/// The x coordinate of that.
pub(crate) fn shared_x(secret: &[u8; 32], public: &PublicKey) -> Result<Zeroizing<[u8; 32]>> {
    Ok(Zeroizing::new(shared(secret, public)?.x_bytes()))
}

/// XORs the stream derived from x2 || y2 (5.4.3) into the text; returns whether any byte of the stream was not zero.
fn mask(coordinates: &[u8; 64], text: &mut [u8]) -> bool {
    let mut start = Sm3Hasher::new();
    start.update(coordinates);
    let mut any = 0;
    for (number, piece) in (1u32..).zip(text.chunks_mut(32)) {
        let mut hasher = start.clone();
        hasher.update(&number.to_be_bytes());
        let stream = Zeroizing::new(hasher.finish());
        for (byte, mask) in piece.iter_mut().zip(*stream) {
            *byte ^= mask;
            any |= mask;
        }
    }
    any != 0
}

/// C3 = SM3(x2 || M || y2).
fn check_value(coordinates: &[u8; 64], plain: &[u8]) -> [u8; 32] {
    let (x, y) = coordinates.split_at(32);
    sm3(&[x, plain, y])
}

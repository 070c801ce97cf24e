//! SM4-GCM (RFC 8998, GB/T 36624) on the kernels: H and E(J0) come with the first stretch of the stream, and the text
//! is hashed while it is in the cache. [`super::gcm`] does the same over any block cipher.

use subtle::ConstantTimeEq as _;
use zeroize::Zeroizing;

use super::gcm::{LONGEST, TAG, lengths};
use super::kernel::{Available, FIRST, Ghash, Sm4};
use super::{CryptoError, Result, fault};

/// Bytes of the stream that come with H and E(J0).
const EARLY: usize = FIRST - 32;
/// The number of the block after those.
const NEXT: u32 = 16;
/// Bytes encrypted before they are hashed: few enough to stay in the first-level cache.
const STRETCH: usize = 4096;
/// The same in blocks.
const STRETCH_BLOCKS: u32 = 256;

struct Gcm<'a> {
    cipher: Sm4,
    nonce: &'a [u8; 12],
    first: Zeroizing<[u8; FIRST]>,
    hash: Ghash,
}

impl<'a> Gcm<'a> {
    fn new(kernel: Available, key: &[u8; 16], nonce: &'a [u8; 12], aad: &[u8], text: usize) -> Self {
        let cipher = Sm4::new(kernel, key);
        let first = cipher.first(nonce);
        let hash_key = Zeroizing::new(std::array::from_fn(|at| first[at]));
        let mut hash = Ghash::new(kernel, &hash_key, aad.len().max(text));
        hash.update(aad);
        Self { cipher, nonce, first, hash }
    }

    /// XORs the start of the text; at most [`EARLY`] bytes.
    fn apply_early(&self, text: &mut [u8]) {
        text.iter_mut().zip(&self.first[32..]).for_each(|(byte, mask)| *byte ^= mask);
    }

    fn tag(&mut self, aad: usize, text: usize) -> [u8; TAG] {
        self.hash.update(&lengths(aad, text));
        let mut tag = self.hash.finish();
        tag.iter_mut().zip(&self.first[16..32]).for_each(|(byte, mask)| *byte ^= mask);
        tag
    }
}

pub(super) fn seal(
    kernel: Available,
    key: &[u8; 16],
    nonce: &[u8; 12],
    aad: &[u8],
    text: &mut [u8],
) -> Result<[u8; TAG]> {
    if u64::try_from(text.len()).unwrap_or(u64::MAX) > LONGEST {
        return Err(CryptoError::Length { what: "text for SM4-GCM", found: text.len(), allowed: "under 64 GiB" });
    }
    let length = text.len();
    let mut gcm = Gcm::new(kernel, key, nonce, aad, length);
    let (early, rest) = text.split_at_mut(length.min(EARLY));
    gcm.apply_early(early);
    gcm.hash.update(early);
    let mut number = NEXT;
    for stretch in rest.chunks_mut(STRETCH) {
        gcm.cipher.apply(nonce, number, stretch);
        gcm.hash.update(stretch);
        number = number.wrapping_add(STRETCH_BLOCKS);
    }
    Ok(gcm.tag(aad.len(), length))
}

/// Checks the tag in constant time, and only then decrypts.
pub(super) fn open(
    kernel: Available,
    key: &[u8; 16],
    nonce: &[u8; 12],
    aad: &[u8],
    sealed: &[u8],
) -> Result<Zeroizing<Vec<u8>>> {
    let (text, found) = sealed.split_last_chunk::<TAG>().ok_or(CryptoError::BadCiphertext)?;
    if u64::try_from(text.len()).unwrap_or(u64::MAX) > LONGEST {
        return Err(CryptoError::BadCiphertext);
    }
    let mut gcm = Gcm::new(kernel, key, nonce, aad, text.len());
    gcm.hash.update(text);
    let equal = bool::from(gcm.tag(aad.len(), text.len()).ct_eq(found));
    if !equal && !fault::is_off("tag") {
        return Err(CryptoError::BadCiphertext);
    }
    let mut plain = Zeroizing::new(text.to_vec());
    let (early, rest) = plain.split_at_mut(text.len().min(EARLY));
    gcm.apply_early(early);
    gcm.cipher.apply(gcm.nonce, NEXT, rest);
    Ok(plain)
}

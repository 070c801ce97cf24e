//! SM4-GCM (RFC 8998, GB/T 36624) over any SM4 block, nonces of 96 bits, tags of 128; kernels have their own.

use ghash::universal_hash::UniversalHash as _;
use ghash::{Block, GHash};
use subtle::ConstantTimeEq as _;
use zeroize::Zeroizing;

use super::{CryptoError, Result, fault};

pub const TAG: usize = 16;
/// The longest text under one nonce: 2^32 - 2 blocks (NIST SP 800-38D, 5.2.1.1).
pub(super) const LONGEST: u64 = ((1 << 32) - 2) * 16;

pub(super) trait BlockCipher {
    fn encrypt_block(&self, block: &[u8; 16]) -> Result<[u8; 16]>;

    /// XORs `data` with the blocks `counter`, `counter` + 1, ... (32-bit counter at the end).
    fn apply_counter(&self, counter: [u8; 16], data: &mut [u8]) -> Result<()> {
        let mut block = counter;
        let mut number = u32::from_be_bytes([block[12], block[13], block[14], block[15]]);
        for chunk in data.chunks_mut(16) {
            let stream = self.encrypt_block(&block)?;
            chunk.iter_mut().zip(stream).for_each(|(byte, mask)| *byte ^= mask);
            number = number.wrapping_add(1);
            block[12..].copy_from_slice(&number.to_be_bytes());
        }
        Ok(())
    }
}

fn counter(nonce: &[u8; 12], number: u8) -> [u8; 16] {
    let mut block = [0; 16];
    block[..12].copy_from_slice(nonce);
    block[15] = number;
    block
}

/// The last block that is hashed: both lengths in bits.
pub(super) fn lengths(aad: usize, text: usize) -> [u8; 16] {
    let bits = |bytes: usize| u128::from(u64::try_from(bytes).unwrap_or(u64::MAX).wrapping_mul(8));
    (bits(aad) << 64 | bits(text)).to_be_bytes()
}

fn tag(cipher: &impl BlockCipher, nonce: &[u8; 12], aad: &[u8], text: &[u8]) -> Result<[u8; 16]> {
    let key = Zeroizing::new(cipher.encrypt_block(&[0; 16])?);
    let mut hash = GHash::new(&Block::from(*key));
    hash.update_padded(aad);
    hash.update_padded(text);
    hash.update(&[Block::from(lengths(aad.len(), text.len()))]);
    let mask = cipher.encrypt_block(&counter(nonce, 1))?;
    let mut tag: [u8; 16] = hash.finalize().into();
    tag.iter_mut().zip(mask).for_each(|(byte, mask)| *byte ^= mask);
    Ok(tag)
}

pub(super) fn seal(cipher: &impl BlockCipher, nonce: &[u8; 12], aad: &[u8], text: &mut [u8]) -> Result<[u8; TAG]> {
    if u64::try_from(text.len()).unwrap_or(u64::MAX) > LONGEST {
        return Err(CryptoError::Length { what: "text for SM4-GCM", found: text.len(), allowed: "under 64 GiB" });
    }
    cipher.apply_counter(counter(nonce, 2), text)?;
    tag(cipher, nonce, aad, text)
}

/// Checks the tag in constant time, and only then decrypts.
pub(super) fn open(
    cipher: &impl BlockCipher,
    nonce: &[u8; 12],
    aad: &[u8],
    sealed: &[u8],
) -> Result<Zeroizing<Vec<u8>>> {
    let (text, found) = sealed.split_last_chunk::<TAG>().ok_or(CryptoError::BadCiphertext)?;
    if u64::try_from(text.len()).unwrap_or(u64::MAX) > LONGEST {
        return Err(CryptoError::BadCiphertext);
    }
    let equal = bool::from(tag(cipher, nonce, aad, text)?.ct_eq(found));
    if !equal && !fault::is_off("tag") {
        return Err(CryptoError::BadCiphertext);
    }
    let mut plain = Zeroizing::new(text.to_vec());
    cipher.apply_counter(counter(nonce, 2), &mut plain)?;
    Ok(plain)
}

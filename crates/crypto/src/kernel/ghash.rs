//! GHASH (NIST SP 800-38D, 6.4) with whatever the processor offers: the kernels' products, or the `ghash` crate.
#![allow(unsafe_code, reason = "calls of functions that need features of the processor, which were asked for")]

use ghash::GHash;
use ghash::universal_hash::UniversalHash as _;
use zeroize::Zeroize as _;

use super::{Available, Kernel};
#[cfg(target_arch = "x86_64")]
use super::{ghash_avx512, ghash_pclmul};

#[allow(clippy::large_enum_variant, reason = "it lives on the stack for one text")]
pub(crate) enum Ghash {
    Crate(Box<GHash>),
    /// With vector instructions: powers of H (H^16 first), and the sum so far.
    #[cfg(target_arch = "x86_64")]
    Powers {
        kernel: Available,
        /// H^16 .. H^1 in POLYVAL's notation.
        powers: [u128; 16],
        hash: u128,
    },
}

impl Ghash {
    /// For a hash key, and texts no longer than `longest` bytes.
    pub fn new(kernel: Available, key: &[u8; 16], longest: usize) -> Self {
        #[cfg(target_arch = "x86_64")]
        if kernel.0 != Kernel::Portable {
            let count = longest.div_ceil(16).clamp(1, 16);
            // SAFETY: every kernel but the portable one has PCLMULQDQ.
            let powers = unsafe { ghash_pclmul::powers(times_x(u128::from_be_bytes(*key)), count) };
            return Self::Powers { kernel, powers, hash: 0 };
        }
        let _ = (kernel, longest);
        Self::Crate(Box::new(GHash::new(&(*key).into())))
    }

    /// Adds a text, padded with zeros to whole blocks.
    pub fn update(&mut self, text: &[u8]) {
        match self {
            Self::Crate(hash) => hash.update_padded(text),
            #[cfg(target_arch = "x86_64")]
            Self::Powers { kernel, powers, hash } => {
                let (whole, rest) = text.as_chunks::<16>();
                *hash = add(*kernel, powers, *hash, whole);
                if !rest.is_empty() {
                    let mut last = [0; 16];
                    last[..rest.len()].copy_from_slice(rest);
                    *hash = add(*kernel, powers, *hash, &[last]);
                }
            }
        }
    }

    pub fn finish(&self) -> [u8; 16] {
        match self {
            Self::Crate(hash) => hash.as_ref().clone().finalize().into(),
            #[cfg(target_arch = "x86_64")]
            Self::Powers { hash, .. } => hash.to_be_bytes(),
        }
    }
}

impl Drop for Ghash {
    fn drop(&mut self) {
        #[cfg(target_arch = "x86_64")]
        if let Self::Powers { powers, hash, .. } = self {
            powers.zeroize();
            hash.zeroize();
        }
    }
}

#[cfg(target_arch = "x86_64")]
fn add(kernel: Available, powers: &[u128; 16], hash: u128, blocks: &[[u8; 16]]) -> u128 {
    let (mut hash, mut rest) = (hash, blocks);
    if kernel.0 == Kernel::GfniAvx512 {
        let (batches, left) = blocks.as_flattened().as_chunks::<{ ghash_avx512::BATCH }>();
        if !batches.is_empty() {
            // SAFETY: `kernel` exists, so its features do.
            hash = unsafe { ghash_avx512::update(powers, hash, batches) };
        }
        rest = left.as_chunks::<16>().0;
    }
    // SAFETY: every kernel but the portable one has PCLMULQDQ, and the portable one never reaches this.
    unsafe { ghash_pclmul::update(powers, hash, rest) }
}

/// The product with x in POLYVAL's field, in constant time: it turns GHASH's key into POLYVAL's (RFC 8452, A).
#[cfg(target_arch = "x86_64")]
fn times_x(key: u128) -> u128 {
    const POLYNOMIAL: u128 = 0xc2 << 120 | 1;
    key << 1 ^ (key >> 127).wrapping_neg() & POLYNOMIAL
}

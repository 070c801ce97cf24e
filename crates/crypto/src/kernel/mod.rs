//! SM4 in counter mode, GHASH and SM3 by this processor's vector instructions, and SM2's arithmetic. All variants take
//! the same time for all secrets. The only `unsafe` is here and below: functions that need processor features are
//! called only with an [`Available`], or (SM2) through `way`, which detected them.
#![allow(unsafe_code, reason = "calls of functions that need features of the processor, which were asked for")]
#![allow(clippy::wildcard_imports, reason = "instructions of the processor, named like nothing else")]

use std::sync::OnceLock;

use zeroize::Zeroizing;

use crate::model::clean;

#[cfg(target_arch = "x86_64")]
mod aesni_avx2;
#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod gfni_avx2;
#[cfg(target_arch = "x86_64")]
mod gfni_avx512;
mod ghash;
#[cfg(target_arch = "x86_64")]
mod ghash_avx512;
#[cfg(target_arch = "x86_64")]
mod ghash_pclmul;
mod portable;
mod sbox;
pub(super) mod sm2;
mod sm3;
#[cfg(target_arch = "x86_64")]
mod sm3_avx2;
#[cfg(target_arch = "x86_64")]
mod sm3_avx512;
mod sm3_lanes;
#[cfg(target_arch = "x86_64")]
mod sm3_single;

#[cfg(test)]
pub(super) mod tests;

pub(super) use ghash::Ghash;
pub(super) use sm3::{BLOCK, INITIAL, compress, ending};
pub(super) use sm3_lanes::{LONG, digest_many};

/// The implementation of SM4 and GHASH.
#[derive(Debug, Clone, Copy, PartialEq, Eq, strum::Display, strum::EnumString)]
#[strum(serialize_all = "kebab-case", parse_err_ty = KernelError, parse_err_fn = unknown)]
pub enum Kernel {
    /// GFNI, AVX-512 and VPCLMULQDQ: 64 blocks at once.
    GfniAvx512,
    /// GFNI, AVX2 and PCLMULQDQ: 16 blocks at once.
    GfniAvx2,
    /// AES-NI, AVX2 and PCLMULQDQ: 16 blocks at once.
    AesniAvx2,
    /// Any processor: bitsliced, 64 blocks at once; GHASH by the `ghash` crate.
    Portable,
}

/// Why a kernel is not available.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum KernelError {
    /// No such kernel.
    #[error(
        "'{0}' is not an SM4 kernel; set AUTHROS_SM4_KERNEL to gfni-avx512, gfni-avx2, aesni-avx2 or portable, or \
         unset it"
    )]
    Unknown(String),
    /// Instructions are missing.
    #[error("this processor cannot run the SM4 kernel {0}; unset AUTHROS_SM4_KERNEL to use the best one it supports")]
    Unavailable(Kernel),
    /// Another kernel is already in use.
    #[error("the SM4 kernel {0} is already in use; choose one before anything is sealed or opened")]
    Decided(Kernel),
}

impl Kernel {
    /// All kernels, fastest first.
    pub const ALL: [Self; 4] = [Self::GfniAvx512, Self::GfniAvx2, Self::AesniAvx2, Self::Portable];

    /// The kernel, if this processor supports it.
    pub fn available(self) -> Option<Available> {
        self.has_features().then_some(Available(self))
    }

    #[cfg(target_arch = "x86_64")]
    fn has_features(self) -> bool {
        let multiplies = is_x86_feature_detected!("pclmulqdq") && is_x86_feature_detected!("avx2");
        let gfni = is_x86_feature_detected!("gfni");
        match self {
            Self::GfniAvx512 => {
                let wide = is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512bw");
                multiplies && gfni && wide && is_x86_feature_detected!("vpclmulqdq")
            }
            Self::GfniAvx2 => multiplies && gfni,
            Self::AesniAvx2 => multiplies && is_x86_feature_detected!("aes"),
            Self::Portable => true,
        }
    }

    #[cfg(not(target_arch = "x86_64"))]
    fn has_features(self) -> bool {
        self == Self::Portable
    }

    /// Makes the whole process use this kernel, for tests and measurements.
    /// # Errors
    /// [`KernelError::Unavailable`], or [`KernelError::Decided`] if another one is already in use.
    pub fn force(self) -> Result<(), KernelError> {
        let available = self.available().ok_or(KernelError::Unavailable(self))?;
        let decided = DECIDED.get_or_init(|| available);
        if decided.0 == self { Ok(()) } else { Err(KernelError::Decided(decided.0)) }
    }
}

fn unknown(text: &str) -> KernelError {
    KernelError::Unknown(clean(text, 40))
}

static DECIDED: OnceLock<Available> = OnceLock::new();

/// A kernel that this processor can run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Available(Kernel);

impl Available {
    /// The kernel this process uses: the forced one, otherwise the fastest.
    pub fn decided() -> Self {
        let fastest = || Kernel::ALL.into_iter().find_map(Kernel::available);
        *DECIDED.get_or_init(|| fastest().unwrap_or(Self(Kernel::Portable)))
    }

    /// Its name.
    pub fn kernel(self) -> Kernel {
        self.0
    }
}

/// A counter position: the nonce's three words and the number of the next block.
#[derive(Debug, Clone, Copy)]
struct Counter {
    nonce: [u32; 3],
    number: u32,
}

/// Bytes of the first blocks of a nonce.
pub(super) const FIRST: usize = 256;

fn words(nonce: &[u8; 12]) -> [u32; 3] {
    let mut words = [0; 3];
    for (word, bytes) in words.iter_mut().zip(nonce.as_chunks::<4>().0) {
        *word = u32::from_be_bytes(*bytes);
    }
    words
}

pub(super) struct Sm4 {
    kernel: Available,
    keys: Zeroizing<[u32; 32]>,
}

/// Calls a function of a kernel.
macro_rules! by_kernel {
    ($kernel:expr, $function:ident($($argument:expr),+)) => {
        match $kernel.0 {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: `$kernel` exists, so its features do.
            Kernel::GfniAvx512 => unsafe { gfni_avx512::$function($($argument),+) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: as above.
            Kernel::GfniAvx2 => unsafe { gfni_avx2::$function($($argument),+) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: as above.
            Kernel::AesniAvx2 => unsafe { aesni_avx2::$function($($argument),+) },
            _ => portable::$function($($argument),+),
        }
    };
}

impl Sm4 {
    pub fn new(kernel: Available, key: &[u8; 16]) -> Self {
        Self { kernel, keys: Zeroizing::new(by_kernel!(kernel, expand(key))) }
    }

    /// XORs `text` with the encrypted blocks nonce || number, nonce || number + 1, ... (modulo 2^32).
    pub fn apply(&self, nonce: &[u8; 12], number: u32, text: &mut [u8]) {
        by_kernel!(self.kernel, apply(&self.keys, Counter { nonce: words(nonce), number }, text));
    }

    /// Everything GCM needs besides the text, in one batch: E(0), E(nonce || 1), and stream blocks 2 to 15.
    pub fn first(&self, nonce: &[u8; 12]) -> Zeroizing<[u8; FIRST]> {
        Zeroizing::new(by_kernel!(self.kernel, first(&self.keys, words(nonce))))
    }
}

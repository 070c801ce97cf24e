//! The passphrase that opens a keyring, and the slow derivation of a key from it (scrypt, RFC 7914).

use std::fmt;

use scrypt::Params;
use zeroize::Zeroizing;

use crate::CryptoError;
use crate::model::bytes::hex;

/// The fewest characters of a passphrase.
pub const SHORTEST_PASSPHRASE: usize = 8;

/// A passphrase of at least [`SHORTEST_PASSPHRASE`] characters, wiped when dropped.
#[derive(Clone)]
pub struct Passphrase(Zeroizing<String>);

impl Passphrase {
    /// From what a person typed or a file holds, without the trailing line break.
    ///
    /// # Errors
    /// [`CryptoError::ShortPassphrase`] if it has too few characters.
    pub fn new(text: String) -> Result<Self, CryptoError> {
        let text = Zeroizing::new(text);
        let line = text.strip_suffix('\n').unwrap_or(&text);
        let line = line.strip_suffix('\r').unwrap_or(line);
        let count = line.chars().count();
        if count < SHORTEST_PASSPHRASE {
            return Err(CryptoError::ShortPassphrase(count));
        }
        Ok(Self(Zeroizing::new(line.to_owned())))
    }

    /// A random one of 128 bits, in hex.
    ///
    /// # Errors
    /// [`CryptoError::Random`] if the random source fails.
    pub fn random() -> Result<Self, CryptoError> {
        let bytes = Zeroizing::new(random_bytes::<16>()?);
        Ok(Self(Zeroizing::new(hex(&*bytes))))
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

impl Work {
    /// The parameters this program writes: 128 MiB, about 0.3 s.
    pub const WRITTEN: Self = Self { log_n: 17, r: 8, p: 1 };

    /// Whether a foreign file may ask for these parameters: at most 512 MiB and 16 times the usual time.
    pub fn is_bearable(self) -> bool {
        let bytes = 128u64.saturating_mul(u64::from(self.r)).saturating_mul(1 << self.log_n.min(40));
        let usual = (128 * 8) << 17;
        self.r > 0 && self.p > 0 && bytes <= 4 * usual && bytes.saturating_mul(u64::from(self.p)) <= 16 * usual
    }
}

/// Derives `N` bytes from a passphrase.
pub(super) fn stretch<const N: usize>(
    passphrase: &str,
    salt: &[u8],
    work: Work,
) -> Result<Zeroizing<[u8; N]>, CryptoError> {
    let params = Params::new(work.log_n, work.r, work.p).map_err(|_| CryptoError::Internal("scrypt"))?;
    let mut out = Zeroizing::new([0; N]);
    scrypt::scrypt(passphrase.as_bytes(), salt, &params, &mut *out).map_err(|_| CryptoError::Internal("scrypt"))?;
    Ok(out)
}

// Random bytes from the operating system; the only source of randomness in this crate.

/// `N` fresh random bytes.
///
/// # Errors
/// [`CryptoError::Random`] if the operating system provides none.
pub fn random_bytes<const N: usize>() -> Result<[u8; N], CryptoError> {
    let mut bytes = [0; N];
    getrandom::fill(&mut bytes).map_err(|_| CryptoError::Random)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_ones_are_refused_and_line_breaks_do_not_count() {
        assert!(matches!(Passphrase::new("1234567\n".into()), Err(CryptoError::ShortPassphrase(7))));
        assert_eq!(Passphrase::new("12345678\r\n".into()).expect("long enough").expose(), "12345678");
        assert_eq!(Passphrase::new("密码密码密码密码".into()).expect("eight characters").expose().len(), 24);
        assert_eq!(Passphrase::random().expect("random").expose().len(), 32);
        assert_eq!(format!("{:?}", Passphrase::random()), "Ok(Passphrase(secret))");
    }

    #[test]
    fn scrypt_follows_rfc_7914_and_unbearable_work_is_refused() {
        let key = stretch::<64>("password", b"NaCl", Work { log_n: 10, r: 8, p: 16 }).expect("derives");
        assert_eq!(hex(&key[..8]), "fdbabe1c9d347200");
        assert!(Work::WRITTEN.is_bearable());
        assert!(Work { log_n: 18, r: 8, p: 1 }.is_bearable());
        for (log_n, r, p) in
            [(63, 8, 1), (20, 8, 1), (17, 8, 17), (17, u32::MAX, 1), (40, 1 << 25, 1), (17, 0, 1), (10, 8, 0)]
        {
            assert!(!Work { log_n, r, p }.is_bearable(), "{log_n} {r} {p}");
        }
    }
}

//! A transport key at rest: sealed under a key derived from d_E, so that it opens only where the keyring is open. Magic
//! (8) || version (1) || salt (32) || SM4-GCM(K_T) (48).

use std::path::Path;

use zeroize::Zeroizing;

use super::kdf::{Info, key_and_nonce};
use super::keystore::sealed_key;
use super::private_file::{read_private, write_private};
use super::{Provider, Result, SmSecret, TransportKey, random_bytes};
use crate::model::wire::Reader;
use crate::model::{Domain, ProfileName, SignerId};

const MAGIC: [u8; 9] = *b"\x89AuthTrK\x01";
const LENGTH: usize = MAGIC.len() + 32 + TransportKey::LENGTH + 16;

/// What a transport key is for; a key sealed for something else does not open.
#[derive(Debug, Clone, Copy)]
pub struct TransportUse<'a> {
    /// The network.
    pub domain: &'a Domain,
    /// The gateway's fingerprint.
    pub gateway: &'a SignerId,
    /// N.
    pub name: &'a ProfileName,
}

fn sealing_key(secret: &SmSecret, salt: &[u8; 32], usage: TransportUse<'_>) -> (Zeroizing<[u8; 16]>, [u8; 12]) {
    let info = Info::new("AuthROS/kept-transport-key/1").fixed(&usage.domain.0).fixed(&usage.gateway.0);
    key_and_nonce(secret.expose(), salt, &info.text(usage.name.as_str()))
}

/// Writes K_T to disk, sealed under d_E.
/// # Errors
/// [`CryptoError::Write`] or [`CryptoError::Random`].
pub fn save_transport_key(
    path: &Path,
    provider: &dyn Provider,
    secret: &SmSecret,
    usage: TransportUse<'_>,
    key: &TransportKey,
) -> Result<()> {
    let salt = random_bytes()?;
    let (sealing, nonce) = sealing_key(secret, &salt, usage);
    let sealed = sealed_key(provider, (&sealing, &nonce), &MAGIC, key)?;
    write_private(path, &[&MAGIC[..], &salt, &sealed].concat())
}

/// K_T from its file; `None` if there is none, or if it is for something else: the caller allocates a new one.
/// # Errors
/// [`CryptoError::OpenToOthers`] or [`CryptoError::Read`].
pub fn load_transport_key(
    path: &Path,
    provider: &dyn Provider,
    secret: &SmSecret,
    usage: TransportUse<'_>,
) -> Result<Option<TransportKey>> {
    if !path.exists() {
        return Ok(None);
    }
    let bytes = read_private(path, LENGTH)?;
    let mut reader = Reader::new(&bytes);
    let parts = reader.array("magic").and_then(|magic: [u8; 9]| Ok((magic, reader.array("salt")?)));
    let Some((_, salt)) = parts.ok().filter(|(magic, _)| *magic == MAGIC) else { return Ok(None) };
    let (sealing, nonce) = sealing_key(secret, &salt, usage);
    let opened = provider.gcm_open(&sealing, &nonce, &MAGIC, reader.rest());
    Ok(opened.ok().and_then(|plain| TransportKey::from_slice(&plain)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ProviderName, provider};

    #[test]
    fn it_opens_for_the_same_use_under_the_same_keyring_only() {
        let home = tempfile::tempdir().expect("folder");
        let path = home.path().join("transport");
        let provider = provider(ProviderName::RustCrypto);
        let (secret, key) = (SmSecret::generate().expect("secret"), TransportKey::generate().expect("key"));
        let (domain, gateway, name) = (Domain([1; 32]), SignerId([2; 32]), "alice".parse().expect("a name"));
        let usage = TransportUse { domain: &domain, gateway: &gateway, name: &name };
        let load = |secret: &SmSecret, usage| load_transport_key(&path, provider, secret, usage).expect("reads");
        assert_eq!(load(&secret, usage), None, "nothing there");
        save_transport_key(&path, provider, &secret, usage, &key).expect("writes");
        assert_eq!(load(&secret, usage), Some(key.clone()));
        assert_eq!(load(&SmSecret::generate().expect("another"), usage), None);
        let (away, other, bob) = (Domain([9; 32]), SignerId([9; 32]), "bob".parse().expect("a name"));
        assert_eq!(load(&secret, TransportUse { domain: &away, ..usage }), None);
        assert_eq!(load(&secret, TransportUse { gateway: &other, ..usage }), None);
        assert_eq!(load(&secret, TransportUse { name: &bob, ..usage }), None);
        let bytes = std::fs::read(&path).expect("bytes");
        assert!(!bytes.windows(32).any(|window| window == key.expose()), "never in clear");
        for at in 0..bytes.len() {
            let mut altered = bytes.clone();
            altered[at] ^= 1;
            write_private(&path, &altered).expect("writes");
            assert_eq!(load(&secret, usage), None, "byte {at}");
        }
    }
}

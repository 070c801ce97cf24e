//! HKDF-SM3 (RFC 5869) and HMAC-SM3 (GM/T 0042-2015), and how keys, tokens and pseudonyms are derived (docs/format.md,
//! 3). An info is a label, fixed-width parts raw, and variable parts with a two-byte big-endian length before them.

use crate::model::{Address, Domain, FilterId, Hash, PublicKey, SignerId, Token, TopicId};
use crate::secret::uncompressed;
use crate::sm3::sm3;
use crate::{CryptoError, EoaSecret, EpochKey, FilterKey, IndexKey, Result, Sm4Key, SmSecret, TopicKey};
use hkdf::Hkdf;
use hmac::{Hmac, KeyInit as _, Mac as _};
use sm3::Sm3;
use zeroize::Zeroizing;

/// Fills `out` from input key material, salt and info (RFC 5869, extract and expand).
/// # Errors
/// [`CryptoError::Length`] if `out` is longer than 255 hashes (8,160 bytes).
pub fn hkdf_sm3(key_material: &[u8], salt: &[u8], info: &[u8], out: &mut [u8]) -> Result<()> {
    let found = out.len();
    Hkdf::<Sm3>::new(Some(salt), key_material).expand(info, out).map_err(|_| CryptoError::Length {
        what: "derived key",
        found,
        allowed: "at most 8,160",
    })
}

/// `N` bytes of HKDF-SM3; that `N` is allowed is checked at compile time.
pub fn derived<const N: usize>(key_material: &[u8], salt: &[u8], info: &Info) -> [u8; N] {
    filled(&Hkdf::new(Some(salt), key_material), info)
}

/// Like [`derived`], from key material and salt already extracted (RFC 5869, expand only).
pub fn expanded<const N: usize>(extracted: &[u8; 32], info: &Info) -> [u8; N] {
    let Ok(hkdf) = Hkdf::from_prk(extracted) else { unreachable!("it has the length of a hash") };
    filled(&hkdf, info)
}

fn filled<const N: usize>(hkdf: &Hkdf<Sm3>, info: &Info) -> [u8; N] {
    const { assert!(N <= 255 * 32, "HKDF-SM3 gives at most 8,160 bytes") };
    let mut out = [0; N];
    if hkdf.expand(info.as_bytes(), &mut out).is_err() {
        unreachable!("the length was checked at compile time");
    }
    out
}

/// HMAC-SM3 of the concatenation of `parts`.
pub fn hmac_sm3(key: &[u8], parts: &[&[u8]]) -> [u8; 32] {
    let mut block = Zeroizing::new([0; 64]);
    if key.len() > block.len() {
        block[..32].copy_from_slice(&sm3(&[key]));
    } else {
        block[..key.len()].copy_from_slice(key);
    }
    let mut mac = Hmac::<Sm3>::new(&(*block).into());
    for part in parts {
        mac.update(part);
    }
    mac.finalize().into_bytes().into()
}

/// The info of a derivation: a label, then its parts in order.
#[derive(Debug, Clone)]
pub struct Info(Vec<u8>);

impl Info {
    /// Begins with `label`.
    pub fn new(label: &str) -> Self {
        Self(label.as_bytes().to_vec())
    }

    /// A part of fixed width.
    #[must_use]
    pub fn fixed(mut self, part: &[u8]) -> Self {
        self.0.extend_from_slice(part);
        self
    }

    /// A number, eight bytes big endian.
    #[must_use]
    pub fn number(self, number: u64) -> Self {
        self.fixed(&number.to_be_bytes())
    }

    /// A text of any length up to 65,535 bytes.
    #[must_use]
    pub fn text(mut self, text: &str) -> Self {
        crate::model::wire::put_text(&mut self.0, text);
        self
    }

    /// The bytes.
    pub fn as_bytes(&self) -> &[u8] {
        &self.0
    }
}

/// Binds everything signed, derived and hashed to a network: SM3(label || chain id (8) || genesis hash || contract).
pub fn domain(chain_id: u64, genesis: &Hash, contract: &Address) -> Domain {
    Domain(sm3(&[b"AuthROS/domain/1", &chain_id.to_be_bytes(), &genesis.0, &contract.0]))
}

/// EK of an epoch, from K_C and the epoch's secret salt.
pub fn epoch_key(key: &Sm4Key, salt: &[u8; 32], domain: &Domain, owner: &Address, epoch: u64) -> EpochKey {
    let info = Info::new("AuthROS/epoch/1").fixed(&domain.0).fixed(&owner.0).number(epoch);
    EpochKey::new(derived(key.expose(), salt, &info))
}

/// The public commitment to an epoch's key.
pub fn token(domain: &Domain, owner: &Address, epoch: u64, key: &EpochKey) -> Token {
    Token(sm3(&[b"AuthROS/token/1", &domain.0, &owner.0, &epoch.to_be_bytes(), key.expose()]))
}

/// The key of a topic in an epoch, from the pseudonym in every header: who has EK needs no topic name to open a record.
pub fn topic_key(key: &EpochKey, topic: &TopicId) -> TopicKey {
    TopicKey::new(derived(key.expose(), &[], &Info::new("AuthROS/topic/1").fixed(&topic.0)))
}

/// The pseudonym of a topic, the same in every epoch.
pub fn topic_id(key: &IndexKey, topic: &str) -> TopicId {
    TopicId(derived(key.expose(), &[], &Info::new("AuthROS/topicid/1").text(topic)))
}

/// The pseudonym of a type or tag: `kind` is `type` or the tag's name.
pub fn filter_id(key: &IndexKey, kind: &str, value: &str) -> FilterId {
    FilterId(derived(key.expose(), &[], &Info::new("AuthROS/filterid/1").text(kind).text(value)))
}

/// The filter key of a topic, for devices that compute pseudonyms for their own topics only.
pub fn filter_key(key: &IndexKey, topic: &TopicId) -> FilterKey {
    FilterKey::new(derived(key.expose(), &[], &Info::new("AuthROS/filterkey/1").fixed(&topic.0)))
}

/// The pseudonym of a type or tag under the filter key of its topic: `kind` is `type` or `tag`.
pub fn topic_filter_id(key: &FilterKey, kind: &str, value: &str) -> FilterId {
    FilterId(derived(key.expose(), &[], &Info::new("AuthROS/topicfilterid/1").text(kind).text(value)))
}

/// The key of an owner's `index`-th extra anchoring account on a network, from the owner's EOA key.
/// # Errors
/// [`CryptoError::SecretRange`] if the derived number is not a valid key (probability about 2^-127).
pub fn anchoring_secret(owner: &EoaSecret, domain: &Domain, index: u8) -> Result<EoaSecret> {
    let info = Info::new("AuthROS/anchoring/1").fixed(&domain.0).number(u64::from(index));
    let bytes = Zeroizing::new(derived::<32>(owner.expose(), &[], &info));
    EoaSecret::from_slice(&*bytes)
}

/// A key of SM4 and its one nonce.
pub fn key_and_nonce(key_material: &[u8], salt: &[u8], info: &Info) -> (Zeroizing<[u8; 16]>, [u8; 12]) {
    let bytes = Zeroizing::new(derived::<28>(key_material, salt, info));
    let key = Zeroizing::new(std::array::from_fn(|index| bytes[index]));
    (key, std::array::from_fn(|index| bytes[16 + index]))
}

/// The key that seals a gateway's transport keys at rest, derived from its keeper's d_E.
pub(super) fn kept_key(keeper: &SmSecret) -> Zeroizing<[u8; 16]> {
    Zeroizing::new(derived(keeper.expose(), &[], &Info::new("AuthROS/binding/1")))
}

/// The key that seals an owner's notices to a device: from the owner's EOA key, given to the device at enrolment.
pub fn notice_key(owner: &EoaSecret, domain: &Domain, device: &SignerId) -> TopicKey {
    let info = Info::new("AuthROS/notice/1").fixed(&domain.0).fixed(&device.0);
    TopicKey::new(derived(owner.expose(), &[], &info))
}

/// The topic under which notices to a device are filed; no ROS name begins like this.
pub fn notice_topic(device: &SignerId) -> String {
    format!("authros/keys/{device}")
}

/// SM3 of 04 || x || y: identifies a signer in headers and on the chain.
pub fn signer_id(public: &PublicKey) -> SignerId {
    SignerId(sm3(&[&uncompressed(public)]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn hmac_by_definition(key: &[u8], data: &[u8]) -> [u8; 32] {
        let mut block = [0; 64];
        let hashed = sm3(&[key]);
        let key = if key.len() > 64 { &hashed[..] } else { key };
        block[..key.len()].copy_from_slice(key);
        let inner = sm3(&[&block.map(|b| b ^ 0x36), data]);
        sm3(&[&block.map(|b| b ^ 0x5c), &inner])
    }

    proptest! {
        #[test]
        fn hmac_and_hkdf_follow_their_definitions(
            key in proptest::collection::vec(any::<u8>(), 0..100),
            salt in proptest::collection::vec(any::<u8>(), 0..100),
            info in proptest::collection::vec(any::<u8>(), 0..100),
        ) {
            prop_assert_eq!(hmac_sm3(&key, &[&info]), hmac_by_definition(&key, &info));
            let extracted = hmac_by_definition(&salt, &key);
            let first = hmac_by_definition(&extracted, &[&info[..], &[1]].concat());
            let second = hmac_by_definition(&extracted, &[&first[..], &info, &[2]].concat());
            let mut out = [0; 50];
            hkdf_sm3(&key, &salt, &info, &mut out).expect("derives");
            prop_assert_eq!(&out[..32], &first[..]);
            prop_assert_eq!(&out[32..], &second[..18]);
        }
    }

    #[test]
    fn infos_cannot_run_into_each_other() {
        let one = Info::new("x").text("ab").text("c");
        let other = Info::new("x").text("a").text("bc");
        assert_ne!(one.as_bytes(), other.as_bytes());
        assert_eq!(Info::new("l").fixed(&[9]).number(1).text("t").as_bytes(), b"l\x09\0\0\0\0\0\0\0\x01\0\x01t");
        assert!(hkdf_sm3(b"k", b"", b"", &mut vec![0; 8161]).is_err());
    }
}

#[cfg(test)]
mod derive_tests {
    use super::hkdf_sm3;
    use super::*;

    #[test]
    fn every_input_matters_and_nothing_else_does() {
        let owner = Address([2; 20]);
        let home = domain(7, &Hash([1; 32]), &Address([9; 20]));
        let key = Sm4Key::new([3; 16]);
        let epoch =
            |salt: u8, domain: &Domain, owner: &Address, number| epoch_key(&key, &[salt; 32], domain, owner, number);
        let base = epoch(4, &home, &owner, 1);
        assert_eq!(base, epoch(4, &home, &owner, 1));
        let away = domain(8, &Hash([1; 32]), &Address([9; 20]));
        let others = [epoch(5, &home, &owner, 1), epoch(4, &away, &owner, 1), epoch(4, &home, &Address([0; 20]), 1)];
        assert!(others.iter().chain([&epoch(4, &home, &owner, 2)]).all(|other| *other != base));

        assert_ne!(token(&home, &owner, 1, &base), token(&home, &owner, 2, &base));
        assert_ne!(topic_key(&base, &TopicId([1; 16])), topic_key(&base, &TopicId([2; 16])));
        let index = IndexKey::new([6; 32]);
        assert_ne!(topic_id(&index, "/a"), topic_id(&index, "/b"));
        assert_ne!(filter_id(&index, "type", "a"), filter_id(&index, "typea", ""));
        let (one, two) = (filter_key(&index, &TopicId([1; 16])), filter_key(&index, &TopicId([2; 16])));
        assert_ne!(one, two);
        assert_ne!(topic_filter_id(&one, "type", "a"), topic_filter_id(&two, "type", "a"));
        assert_ne!(topic_filter_id(&one, "type", "a"), topic_filter_id(&one, "typea", ""));
    }

    #[test]
    fn derivations_are_as_documented() {
        let home = domain(1, &Hash([0; 32]), &Address([0; 20]));
        let expected = sm3(&[b"AuthROS/domain/1", &[0, 0, 0, 0, 0, 0, 0, 1], &[0; 32], &[0; 20]]);
        assert_eq!(home, Domain(expected));
        let mut out = [0; 32];
        let info = [&b"AuthROS/topic/1"[..], &[7; 16]].concat();
        hkdf_sm3(&[1; 32], &[], &info, &mut out).expect("derives");
        assert_eq!(topic_key(&EpochKey::new([1; 32]), &TopicId([7; 16])).expose(), &out);
        let info = [&b"AuthROS/filterkey/1"[..], &[7; 16]].concat();
        hkdf_sm3(&[2; 32], &[], &info, &mut out).expect("derives");
        let key = filter_key(&IndexKey::new([2; 32]), &TopicId([7; 16]));
        assert_eq!(key.expose(), &out);
        let mut id = [0; 8];
        hkdf_sm3(&out, &[], b"AuthROS/topicfilterid/1\0\x03tag\0\x03a=1", &mut id).expect("derives");
        assert_eq!(topic_filter_id(&key, "tag", "a=1"), FilterId(id));
    }
}

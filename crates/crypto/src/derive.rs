//! How keys, tokens and pseudonyms are derived from each other (docs/format.md, section 3). Every derivation begins
//! with its own label; none reads a clock, a file or a random source.

use zeroize::Zeroizing;

use crate::model::{Address, Domain, FilterId, Hash, PublicKey, SignerId, Token, TopicId};

use super::kdf::{Info, derived};
use super::secret::uncompressed;
use super::sm3::sm3;
use super::{CryptoError, EoaSecret, EpochKey, FilterKey, IndexKey, Sm4Key, SmSecret, TopicKey};

/// Binds everything signed, derived and hashed to one chain and contract: SM3(label || chain id (8) || genesis hash ||
/// contract).
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

/// The key of a topic in an epoch, derived from its pseudonym, which every header carries: anyone who has EK can open a
/// record without knowing the topic's name.
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
///
/// # Errors
/// [`CryptoError::SecretRange`] if the derived number is not a valid key (probability about 2^-127).
pub fn anchoring_secret(owner: &EoaSecret, domain: &Domain, index: u8) -> Result<EoaSecret, CryptoError> {
    let info = Info::new("AuthROS/anchoring/1").fixed(&domain.0).number(u64::from(index));
    let bytes = Zeroizing::new(derived::<32>(owner.expose(), &[], &info));
    EoaSecret::from_slice(&*bytes)
}

/// The key that seals a gateway's transport keys at rest, derived from its keeper's d_E.
pub(super) fn kept_key(keeper: &SmSecret) -> Zeroizing<[u8; 16]> {
    Zeroizing::new(derived(keeper.expose(), &[], &Info::new("AuthROS/binding/1")))
}

/// The key that seals an owner's notices to a device, derived from the owner's EOA key: the owner need not store it,
/// the device gets it at enrolment, and nobody else has it.
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
    use super::super::kdf::hkdf_sm3;
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

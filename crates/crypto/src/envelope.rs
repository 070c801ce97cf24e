//! The wrapped keys of a grant: SM2 encryption to the grantee's P_E around terms and keys, signed by the owner's d_C.
//! The terms must be exactly those of the chain's event. And an owner's new SM2 pairs for the holder of the former
//! ones, so that an old keyring leads to the newest: salt (32) || SM4-GCM(d_C || d_E) (80) under a key that only the
//! account's own key gives, encrypted to the former P_E. So an exposed d_E alone opens no later pair.

use std::collections::BTreeSet;

use crate::kdf::{Info, key_and_nonce};
use crate::model::grant::MOST_TOPICS;
use crate::model::wire::{Reader, Wire, WireError, put_list, read_list};
use crate::model::{Domain, GrantTerms, Identity, PublicKey, Scope, Signature, Timestamp, TopicId, TopicName};
use crate::sm3::sm3;
use crate::{
    CryptoError, EoaSecret, EpochKey, IndexKey, Provider, Result, SmKeyPair, SmSecret, TopicKey, random_bytes,
};
use zeroize::Zeroizing;

/// The largest envelope, bytes.
pub const LARGEST_ENVELOPE: usize = 64 * 1024;
const VERSION: u8 = 1;
const WHAT: &str = "key envelope";

/// The keys a grant gives.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum GrantedKeys {
    /// Every topic of some epochs.
    All {
        /// (epoch, EK), each epoch once, including the grant's own.
        epochs: Vec<(u64, EpochKey)>,
        /// IK, for computing topic and filter ids.
        index_key: IndexKey,
    },
    /// Some topics of some epochs.
    Topics {
        /// (epoch, topic, its id, its key), each pair of epoch and topic once.
        keys: Vec<(u64, String, TopicId, TopicKey)>,
    },
}

/// The terms of a grant with the keys that match them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WrappedKeys {
    /// The terms, as the chain's event states them.
    pub terms: GrantTerms,
    /// The keys they give.
    pub keys: GrantedKeys,
}

/// Seals keys for a grantee: version || length (4) || SM2 ciphertext (DER) || signature (64).
/// # Errors
/// [`CryptoError::Inconsistent`], [`CryptoError::PublicPoint`], or [`CryptoError::Length`] beyond [`LARGEST_ENVELOPE`].
pub fn wrap(
    provider: &dyn Provider,
    domain: &Domain,
    wrapped: &WrappedKeys,
    owner: &SmKeyPair,
    grantee: &PublicKey,
) -> Result<Vec<u8>> {
    check_fit(wrapped)?;
    let plain = encode(domain, wrapped);
    let too_long = |found| CryptoError::Length { what: WHAT, found, allowed: "at most 65,536" };
    if plain.len() > LARGEST_ENVELOPE {
        return Err(too_long(plain.len()));
    }
    let sealed = provider.encrypt(grantee, &plain)?;
    let length = u32::try_from(sealed.len()).map_err(|_| too_long(sealed.len()))?;
    let mut envelope = [&[VERSION], &length.to_be_bytes()[..], &sealed].concat();
    let signature = provider.sign(&owner.secret, &signed_bytes(domain, &envelope))?;
    envelope.extend_from_slice(&signature.0);
    if envelope.len() > LARGEST_ENVELOPE { Err(too_long(envelope.len())) } else { Ok(envelope) }
}

/// Checks the owner's signature, opens the envelope and compares every field with the chain's event.
/// # Errors
/// `Malformed`, `BadSignature`, `BadCiphertext`, or [`CryptoError::NotAccepted`] naming the field that differs.
pub fn unwrap(
    provider: &dyn Provider,
    domain: &Domain,
    envelope: &[u8],
    expected: &GrantTerms,
    owner: &PublicKey,
    grantee: &SmSecret,
) -> Result<WrappedKeys> {
    let (signed, sealed, signature) = parts(envelope).map_err(CryptoError::malformed(WHAT))?;
    provider.verify(owner, &signed_bytes(domain, signed), &signature)?;
    let plain = provider.decrypt(grantee, sealed)?;
    let (named, wrapped) = parse(&plain).map_err(CryptoError::malformed(WHAT))?;
    compare(domain, &named, expected, &wrapped.terms)?;
    check_fit(&wrapped)?;
    Ok(wrapped)
}

fn parts(envelope: &[u8]) -> Result<(&[u8], &[u8], Signature), WireError> {
    if envelope.len() > LARGEST_ENVELOPE {
        return Err(WireError::Long(envelope.len() - LARGEST_ENVELOPE));
    }
    let mut reader = Reader::new(envelope);
    if reader.u8("version")? != VERSION {
        return Err(WireError::Value("version"));
    }
    let length = usize::try_from(reader.u32("length")?).map_err(|_| WireError::Value("length"))?;
    let sealed = reader.take(length, "sealed keys")?;
    let signature = Signature(reader.array("signature")?);
    reader.end()?;
    Ok((&envelope[..envelope.len() - Signature::LENGTH], sealed, signature))
}

fn signed_bytes(domain: &Domain, envelope: &[u8]) -> Vec<u8> {
    [&b"AuthROS/envelope-signature/1"[..], &domain.0, &sm3(&[envelope])].concat()
}

fn compare(domain: &Domain, named: &Domain, expected: &GrantTerms, terms: &GrantTerms) -> Result<()> {
    let fields = [
        ("domain", domain != named),
        ("owner", expected.owner != terms.owner),
        ("grantee", expected.grantee != terms.grantee),
        ("epoch", expected.epoch != terms.epoch),
        ("expiry", expected.expiry != terms.expiry),
        ("scope", expected.scope != terms.scope),
    ];
    let differing = fields.into_iter().find(|(_, differs)| *differs);
    differing.map_or(Ok(()), |(field, _)| Err(CryptoError::NotAccepted { what: WHAT, field }))
}

/// Same kind of scope, no epoch beyond the grant's, its own covered, nothing twice, only valid names of the scope.
fn check_fit(wrapped: &WrappedKeys) -> Result<()> {
    let epoch = wrapped.terms.epoch;
    let fits = match (&wrapped.keys, &wrapped.terms.scope) {
        (GrantedKeys::All { epochs, .. }, Scope::All) => {
            let numbers: BTreeSet<u64> = epochs.iter().map(|(number, _)| *number).collect();
            numbers.len() == epochs.len() && is_range(&numbers, epoch)
        }
        (GrantedKeys::Topics { keys }, Scope::Topics(topics)) => {
            let numbers: BTreeSet<u64> = keys.iter().map(|(number, ..)| *number).collect();
            let pairs: BTreeSet<(u64, TopicId)> = keys.iter().map(|(number, _, id, _)| (*number, *id)).collect();
            let named = keys.iter().all(|(_, name, id, _)| name.parse::<TopicName>().is_ok() && topics.contains(id));
            topics.len() <= MOST_TOPICS && pairs.len() == keys.len() && named && is_range(&numbers, epoch)
        }
        _ => false,
    };
    if fits { Ok(()) } else { Err(CryptoError::Inconsistent("set of keys of the grant")) }
}

fn is_range(numbers: &BTreeSet<u64>, epoch: u64) -> bool {
    numbers.first().is_some_and(|first| *first > 0) && numbers.last() == Some(&epoch)
}

// The bytes inside an envelope: label, domain, owner, grantee, epoch, expiry, scope, keys.

const LABEL: &[u8] = b"AuthROS/envelope/1";
const ALL: u8 = 1;
const TOPICS: u8 = 2;
const LONGEST_ENTRY: usize = 8 + 2 + 255 + 16 + 32;

fn encode(domain: &Domain, wrapped: &WrappedKeys) -> Zeroizing<Vec<u8>> {
    let entries = match &wrapped.keys {
        GrantedKeys::All { epochs, .. } => epochs.len(),
        GrantedKeys::Topics { keys } => keys.len(),
    };
    // Reserved in one piece: growing the buffer would leave unwiped copies of keys behind.
    let mut out = Zeroizing::new(Vec::with_capacity(1024 + entries * LONGEST_ENTRY));
    let terms = &wrapped.terms;
    out.extend_from_slice(LABEL);
    (*domain, terms.owner, terms.grantee, terms.epoch).put(&mut out);
    (terms.expiry.is_some(), terms.expiry.unwrap_or_default()).put(&mut out);
    match &terms.scope {
        Scope::All => ALL.put(&mut out),
        Scope::Topics(topics) => {
            TOPICS.put(&mut out);
            put_list::<u16>(&mut out, topics, usize::MAX);
        }
    }
    match &wrapped.keys {
        GrantedKeys::All { epochs, index_key } => {
            ALL.put(&mut out);
            index_key.put(&mut out);
            put_list::<u16>(&mut out, epochs, usize::MAX);
        }
        GrantedKeys::Topics { keys } => {
            TOPICS.put(&mut out);
            put_list::<u16>(&mut out, keys, usize::MAX);
        }
    }
    out
}

fn parse(plain: &[u8]) -> Result<(Domain, WrappedKeys), WireError> {
    let mut reader = Reader::new(plain.strip_prefix(LABEL).ok_or(WireError::Value("label"))?);
    let domain = Wire::read(&mut reader, "domain")?;
    let terms = GrantTerms {
        owner: Wire::read(&mut reader, "owner")?,
        grantee: Wire::read(&mut reader, "grantee")?,
        epoch: reader.u64("epoch")?,
        expiry: match Wire::read(&mut reader, "expiry")? {
            (false, Timestamp(0)) => None,
            (true, moment) => Some(moment),
            _ => return Err(WireError::Value("expiry")),
        },
        scope: match reader.u8("scope")? {
            ALL => Scope::All,
            TOPICS => Scope::Topics(read_list::<u16, _>(&mut reader, 0..=MOST_TOPICS, ("scope", "scope"))?),
            _ => return Err(WireError::Value("scope")),
        },
    };
    let kind = reader.u8("kind of keys")?;
    let index_key = if kind == ALL { Some(Wire::read(&mut reader, "index key")?) } else { None };
    let (any, words) = (0..=usize::from(u16::MAX), ("number of keys", "key"));
    let keys = match (kind, index_key) {
        (ALL, Some(index_key)) => GrantedKeys::All { epochs: read_list::<u16, _>(&mut reader, any, words)?, index_key },
        (TOPICS, _) => GrantedKeys::Topics { keys: read_list::<u16, _>(&mut reader, any, words)? },
        _ => return Err(WireError::Value("kind of keys")),
    };
    reader.end()?;
    Ok((domain, WrappedKeys { terms, keys }))
}

const HAND_OVER: &str = "transfer of SM2 keys";
const SECRETS: usize = 2 * 32;

fn sealing_key(eoa: &EoaSecret, salt: &[u8; 32], domain: &Domain) -> (Zeroizing<[u8; 16]>, [u8; 12]) {
    let info = Info::new("AuthROS/handover/1").fixed(&domain.0).fixed(&eoa.address().0);
    key_and_nonce(eoa.expose(), salt, &info)
}

/// What the pairs are bound to: the network, the account, and the public keys in the event that carries them.
fn context(domain: &Domain, eoa: &EoaSecret, signing: &PublicKey, envelope: &PublicKey) -> Vec<u8> {
    [&b"AuthROS/handover/1"[..], &domain.0, &eoa.address().0, &signing.0, &envelope.0].concat()
}

/// Wraps the new (d_C, P_C) and (d_E, P_E) for the P_E that they replace.
/// # Errors
/// [`CryptoError::Random`], or [`CryptoError::PublicPoint`] if `former` is not a valid key.
pub fn hand_over(
    provider: &dyn Provider,
    domain: &Domain,
    eoa: &EoaSecret,
    (signing, envelope): (&SmKeyPair, &SmKeyPair),
    former: &PublicKey,
) -> Result<Vec<u8>> {
    let salt: [u8; 32] = random_bytes()?;
    let (key, nonce) = sealing_key(eoa, &salt, domain);
    // Reserved in one piece, tag included: growing the buffer would leave an unwiped copy behind.
    let mut sealed = Zeroizing::new(Vec::with_capacity(SECRETS + 16));
    sealed.extend_from_slice(signing.secret.expose());
    sealed.extend_from_slice(envelope.secret.expose());
    provider.gcm_seal(&key, &nonce, &context(domain, eoa, &signing.public, &envelope.public), &mut sealed)?;
    provider.encrypt(former, &[&salt[..], &sealed].concat())
}

/// The pairs of `identity`, from the envelope in its event: (d_C, P_C) and (d_E, P_E).
/// # Errors
/// `BadCiphertext` with another `former` or `eoa`, `Malformed`, or [`CryptoError::NotAccepted`] for other pairs.
pub fn take_over(
    provider: &dyn Provider,
    domain: &Domain,
    eoa: &EoaSecret,
    identity: &Identity,
    envelope: &[u8],
    former: &SmSecret,
) -> Result<(SmKeyPair, SmKeyPair)> {
    let opened = provider.decrypt(former, envelope)?;
    let mut reader = Reader::new(&opened);
    let salt = reader.array("salt").map_err(CryptoError::malformed(HAND_OVER))?;
    let (key, nonce) = sealing_key(eoa, &salt, domain);
    let bound = context(domain, eoa, &identity.signing, &identity.envelope);
    let plain = provider.gcm_open(&key, &nonce, &bound, reader.rest())?;
    let ([first, second], []) = plain.as_chunks::<32>() else {
        return Err(CryptoError::malformed(HAND_OVER)(WireError::Value("secrets")));
    };
    let signing = SmKeyPair::from_secret(provider, SmSecret::from_slice(first)?)?;
    let pair = SmKeyPair::from_secret(provider, SmSecret::from_slice(second)?)?;
    if (signing.public, pair.public) == (identity.signing, identity.envelope) {
        Ok((signing, pair))
    } else {
        Err(CryptoError::NotAccepted { what: HAND_OVER, field: "keys" })
    }
}

#[cfg(test)]
mod handover_tests {
    use super::*;
    use crate::model::{Signature, Token};
    use crate::{ProviderName, provider};

    struct Change {
        eoa: EoaSecret,
        former: SmKeyPair,
        new: (SmKeyPair, SmKeyPair),
        identity: Identity,
        envelope: Vec<u8>,
    }

    const HOME: Domain = Domain([7; 32]);

    fn change() -> Change {
        let sm2 = provider(ProviderName::RustCrypto);
        let pair = || SmKeyPair::generate(sm2).expect("a pair");
        let (eoa, former, new) = (EoaSecret::generate().expect("a key"), pair(), (pair(), pair()));
        let envelope = hand_over(sm2, &HOME, &eoa, (&new.0, &new.1), &former.public).expect("wrapped");
        let (signing, public) = (new.0.public, new.1.public);
        let identity = Identity { token: Token([1; 32]), signing, envelope: public, proof: Signature([0; 64]) };
        Change { eoa, former, new, identity, envelope }
    }

    #[test]
    fn new_pairs_open_with_the_keys_before_them_and_with_nothing_else() {
        let sm2 = provider(ProviderName::RustCrypto);
        let Change { eoa, former, new, identity, envelope } = change();
        let open = |domain: &Domain, eoa: &EoaSecret, identity: &Identity, secret: &SmSecret| {
            take_over(sm2, domain, eoa, identity, &envelope, secret)
        };
        assert_eq!(open(&HOME, &eoa, &identity, &former.secret).expect("opens"), new);
        let stranger = EoaSecret::generate().expect("a key");
        assert!(open(&HOME, &stranger, &identity, &former.secret).is_err(), "d_E alone is not enough");
        assert!(open(&HOME, &eoa, &identity, &new.1.secret).is_err(), "another d_E");
        assert!(open(&Domain([8; 32]), &eoa, &identity, &former.secret).is_err(), "another network");
        let other = Identity { signing: former.public, ..identity };
        assert!(open(&HOME, &eoa, &other, &former.secret).is_err(), "another identity");
        for length in 0..envelope.len() {
            let cut = take_over(sm2, &HOME, &eoa, &identity, &envelope[..length], &former.secret);
            assert!(cut.is_err(), "{length} bytes");
        }
    }
}

#[cfg(test)]
mod tests;

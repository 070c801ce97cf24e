//! The wrapped keys of a grant: SM2 encryption to the grantee's P_E around terms and keys, signed by the owner's d_C.
//! The terms must be exactly those of the chain's event. And an owner's new SM2 pairs for the holder of the former
//! ones, so that an old keyring leads to the newest: salt (32) || SM4-GCM(d_C || d_E) (80) under a key that only the
//! account's own key gives, encrypted to the former P_E. So an exposed d_E alone opens no later pair.

use std::collections::BTreeSet;

use crate::kdf::{Info, key_and_nonce};
use crate::model::grant::MOST_TOPICS;
use crate::model::wire::{Reader, WireError, put_text};
use crate::model::{Address, Domain, GrantTerms, Identity, PublicKey, Scope, Signature, Timestamp, TopicId, TopicName};
use crate::sm3::sm3;
use crate::{CryptoError, EoaSecret, EpochKey, IndexKey, Provider, SmKeyPair, SmSecret, TopicKey, random_bytes};
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
///
/// # Errors
/// [`CryptoError::Inconsistent`] if keys and terms do not match, [`CryptoError::PublicPoint`], [`CryptoError::Length`]
/// if the envelope would exceed [`LARGEST_ENVELOPE`].
pub fn wrap(
    provider: &dyn Provider,
    domain: &Domain,
    wrapped: &WrappedKeys,
    owner: &SmKeyPair,
    grantee: &PublicKey,
) -> Result<Vec<u8>, CryptoError> {
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
///
/// # Errors
/// [`CryptoError::Malformed`], [`CryptoError::BadSignature`], [`CryptoError::BadCiphertext`], or
/// [`CryptoError::NotAccepted`] naming the field that differs.
pub fn unwrap(
    provider: &dyn Provider,
    domain: &Domain,
    envelope: &[u8],
    expected: &GrantTerms,
    owner: &PublicKey,
    grantee: &SmSecret,
) -> Result<WrappedKeys, CryptoError> {
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

fn compare(domain: &Domain, named: &Domain, expected: &GrantTerms, terms: &GrantTerms) -> Result<(), CryptoError> {
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
fn check_fit(wrapped: &WrappedKeys) -> Result<(), CryptoError> {
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
/// The longest key entry: epoch, name with its length, id and key.
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
    out.extend_from_slice(&domain.0);
    out.extend_from_slice(&terms.owner.0);
    out.extend_from_slice(&terms.grantee.0);
    out.extend_from_slice(&terms.epoch.to_be_bytes());
    put_expiry(&mut out, terms.expiry);
    put_scope(&mut out, &terms.scope);
    put_keys(&mut out, &wrapped.keys, entries);
    out
}

fn put_expiry(out: &mut Vec<u8>, expiry: Option<Timestamp>) {
    out.push(u8::from(expiry.is_some()));
    out.extend_from_slice(&expiry.map_or(0, |moment| moment.0).to_be_bytes());
}

fn put_scope(out: &mut Vec<u8>, scope: &Scope) {
    match scope {
        Scope::All => out.push(ALL),
        Scope::Topics(topics) => {
            out.push(TOPICS);
            out.extend_from_slice(&u16::try_from(topics.len()).unwrap_or(u16::MAX).to_be_bytes());
            topics.iter().for_each(|topic| out.extend_from_slice(&topic.0));
        }
    }
}

fn put_keys(out: &mut Vec<u8>, keys: &GrantedKeys, entries: usize) {
    let count = u16::try_from(entries).unwrap_or(u16::MAX).to_be_bytes();
    match keys {
        GrantedKeys::All { epochs, index_key } => {
            out.push(ALL);
            out.extend_from_slice(index_key.expose());
            out.extend_from_slice(&count);
            for (epoch, key) in epochs {
                out.extend_from_slice(&epoch.to_be_bytes());
                out.extend_from_slice(key.expose());
            }
        }
        GrantedKeys::Topics { keys } => {
            out.push(TOPICS);
            out.extend_from_slice(&count);
            for (epoch, name, id, key) in keys {
                out.extend_from_slice(&epoch.to_be_bytes());
                put_text(out, name);
                out.extend_from_slice(&id.0);
                out.extend_from_slice(key.expose());
            }
        }
    }
}

fn parse(plain: &[u8]) -> Result<(Domain, WrappedKeys), WireError> {
    let mut reader = Reader::new(plain);
    if reader.take(LABEL.len(), "label")? != LABEL {
        return Err(WireError::Value("label"));
    }
    let domain = Domain(reader.array("domain")?);
    let terms = GrantTerms {
        owner: Address(reader.array("owner")?),
        grantee: Address(reader.array("grantee")?),
        epoch: reader.u64("epoch")?,
        expiry: read_expiry(&mut reader)?,
        scope: read_scope(&mut reader)?,
    };
    let keys = read_keys(&mut reader)?;
    reader.end()?;
    Ok((domain, WrappedKeys { terms, keys }))
}

fn read_expiry(reader: &mut Reader<'_>) -> Result<Option<Timestamp>, WireError> {
    match (reader.u8("expiry")?, reader.u64("expiry")?) {
        (0, 0) => Ok(None),
        (1, moment) => Ok(Some(Timestamp(moment))),
        _ => Err(WireError::Value("expiry")),
    }
}

fn read_scope(reader: &mut Reader<'_>) -> Result<Scope, WireError> {
    match reader.u8("scope")? {
        ALL => Ok(Scope::All),
        TOPICS => {
            let count = usize::from(reader.u16("scope")?);
            if count > MOST_TOPICS {
                return Err(WireError::Value("scope"));
            }
            let topics: Result<_, WireError> = (0..count).map(|_| reader.array("scope").map(TopicId)).collect();
            topics.map(Scope::Topics)
        }
        _ => Err(WireError::Value("scope")),
    }
}

fn read_keys(reader: &mut Reader<'_>) -> Result<GrantedKeys, WireError> {
    match reader.u8("kind of keys")? {
        ALL => {
            let index_key = IndexKey::new(reader.array("index key")?);
            let count = reader.u16("number of keys")?;
            let epochs: Result<_, WireError> =
                (0..count).map(|_| Ok((reader.u64("epoch")?, EpochKey::new(reader.array("epoch key")?)))).collect();
            Ok(GrantedKeys::All { epochs: epochs?, index_key })
        }
        TOPICS => {
            let count = reader.u16("number of keys")?;
            let keys: Result<_, WireError> = (0..count).map(|_| read_topic(reader)).collect();
            Ok(GrantedKeys::Topics { keys: keys? })
        }
        _ => Err(WireError::Value("kind of keys")),
    }
}

fn read_topic(reader: &mut Reader<'_>) -> Result<(u64, String, TopicId, TopicKey), WireError> {
    Ok((
        reader.u64("epoch")?,
        reader.text("topic")?,
        TopicId(reader.array("topic id")?),
        TopicKey::new(reader.array("topic key")?),
    ))
}

const HAND_OVER: &str = "hand-over of SM2 keys";
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
///
/// # Errors
/// [`CryptoError::Random`], or [`CryptoError::PublicPoint`] if `former` is not a valid key.
pub fn hand_over(
    provider: &dyn Provider,
    domain: &Domain,
    eoa: &EoaSecret,
    (signing, envelope): (&SmKeyPair, &SmKeyPair),
    former: &PublicKey,
) -> Result<Vec<u8>, CryptoError> {
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
///
/// # Errors
/// [`CryptoError::BadCiphertext`] if `former` or `eoa` is not the key it was wrapped for, [`CryptoError::Malformed`], or
/// [`CryptoError::NotAccepted`] if the pairs are not those of `identity`.
pub fn take_over(
    provider: &dyn Provider,
    domain: &Domain,
    eoa: &EoaSecret,
    identity: &Identity,
    envelope: &[u8],
    former: &SmSecret,
) -> Result<(SmKeyPair, SmKeyPair), CryptoError> {
    let opened = provider.decrypt(former, envelope)?;
    let mut reader = Reader::new(&opened);
    let salt = reader.array("salt").map_err(CryptoError::malformed(HAND_OVER))?;
    let (key, nonce) = sealing_key(eoa, &salt, domain);
    let bound = context(domain, eoa, &identity.signing, &identity.envelope);
    let plain = provider.gcm_open(&key, &nonce, &bound, reader.rest())?;
    let (first, second) = plain
        .split_at_checked(32)
        .filter(|(_, second)| second.len() == 32)
        .ok_or(WireError::Value("secrets"))
        .map_err(CryptoError::malformed(HAND_OVER))?;
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

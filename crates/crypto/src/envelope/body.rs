//! The bytes inside an envelope: label, domain, owner, grantee, epoch, expiry, scope, keys.

use zeroize::Zeroizing;

use crate::crypto::{EpochKey, IndexKey, TopicKey};
use crate::model::grant::MOST_TOPICS;
use crate::model::wire::{Reader, WireError, put_text};
use crate::model::{Address, Domain, GrantTerms, Scope, Timestamp, TopicId};

use super::{GrantedKeys, WrappedKeys};

const LABEL: &[u8] = b"AuthROS/envelope/1";
const ALL: u8 = 1;
const TOPICS: u8 = 2;
/// The longest key entry: epoch, name with its length, id and key.
const LONGEST_ENTRY: usize = 8 + 2 + 255 + 16 + 32;

pub(super) fn encode(domain: &Domain, wrapped: &WrappedKeys) -> Zeroizing<Vec<u8>> {
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

pub(super) fn parse(plain: &[u8]) -> Result<(Domain, WrappedKeys), WireError> {
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

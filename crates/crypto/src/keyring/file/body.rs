//! The sealed part of a keyring file: EOA (32), d_C (32), d_E (32), K_C (16), IK (32), then a counted list of networks
//! (domain, current epoch, counted epochs of number, EK and state), then the number of further pairs (4) and for
//! each its use (1: former d_E, 2: next d_C, 3: next d_E, 4: gateway) and its secret (32), ordered by use.

use std::collections::BTreeMap;

use zeroize::Zeroizing;

use crate::crypto::keyring::{EpochSecret, EpochState, FurtherPairs, Keyring, NetworkKeys};
use crate::crypto::{EoaSecret, EpochKey, IndexKey, ProviderName, Sm4Key, SmKeyPair, SmSecret, provider};
use crate::model::Domain;
use crate::model::wire::{Reader, WireError};

const PENDING: u8 = 0;
const ACTIVE: u8 = 1;
const FORMER_ENVELOPE: u8 = 1;
const NEXT_SIGNING: u8 = 2;
const NEXT_ENVELOPE: u8 = 3;
const GATEWAY: u8 = 4;

pub(super) fn encode(keyring: &Keyring) -> Zeroizing<Vec<u8>> {
    let epochs: usize = keyring.networks.values().map(|network| network.epochs.len()).sum();
    // Reserved in one piece, tag included: growing the buffer would leave unwiped copies behind.
    let further = further(keyring);
    let length = 256 + keyring.networks.len() * 44 + epochs * 41 + further.len() * 33;
    let mut out = Zeroizing::new(Vec::with_capacity(length));
    out.extend_from_slice(keyring.eoa.expose());
    out.extend_from_slice(keyring.signing.secret.expose());
    out.extend_from_slice(keyring.envelope.secret.expose());
    out.extend_from_slice(keyring.sm4.expose());
    out.extend_from_slice(keyring.index.expose());
    put_count(&mut out, keyring.networks.len());
    for (domain, network) in &keyring.networks {
        out.extend_from_slice(&domain.0);
        out.extend_from_slice(&network.current.to_be_bytes());
        put_count(&mut out, network.epochs.len());
        for (epoch, secret) in &network.epochs {
            out.extend_from_slice(&epoch.to_be_bytes());
            out.extend_from_slice(secret.key.expose());
            out.push(if secret.state == EpochState::Active { ACTIVE } else { PENDING });
        }
    }
    put_count(&mut out, further.len());
    for (usage, pair) in further {
        out.push(usage);
        out.extend_from_slice(pair.secret.expose());
    }
    out
}

fn further(keyring: &Keyring) -> Vec<(u8, &SmKeyPair)> {
    let FurtherPairs { envelopes, next_signing, next_envelope, gateway } = &keyring.further;
    let former = envelopes.iter().map(|pair| (FORMER_ENVELOPE, pair));
    let signing = next_signing.iter().map(|pair| (NEXT_SIGNING, pair));
    let envelope = next_envelope.iter().map(|pair| (NEXT_ENVELOPE, pair));
    former.chain(signing).chain(envelope).chain(gateway.iter().map(|pair| (GATEWAY, pair))).collect()
}

fn put_count(out: &mut Vec<u8>, count: usize) {
    out.extend_from_slice(&u32::try_from(count).unwrap_or(u32::MAX).to_be_bytes());
}

pub(super) fn parse(plain: &[u8]) -> Result<Keyring, WireError> {
    let mut reader = Reader::new(plain);
    let keyring = Keyring {
        eoa: EoaSecret::from_slice(reader.take(32, "EOA key")?).map_err(|_| WireError::Value("EOA key"))?,
        signing: read_pair(&mut reader, "signing key")?,
        envelope: read_pair(&mut reader, "envelope key")?,
        sm4: Sm4Key::new(reader.array("SM4 key")?),
        index: IndexKey::new(reader.array("index key")?),
        networks: read_networks(&mut reader)?,
        further: read_further(&mut reader)?,
    };
    reader.end()?;
    Ok(keyring)
}

fn read_pair(reader: &mut Reader<'_>, field: &'static str) -> Result<SmKeyPair, WireError> {
    SmSecret::from_slice(reader.take(32, field)?)
        .and_then(|secret| SmKeyPair::from_secret(provider(ProviderName::RustCrypto), secret))
        .map_err(|_| WireError::Value(field))
}

fn read_further(reader: &mut Reader<'_>) -> Result<FurtherPairs, WireError> {
    let count = reader.u32("number of further pairs")?;
    let (mut further, mut before) = (FurtherPairs::default(), FORMER_ENVELOPE);
    for _ in 0..count {
        let usage = reader.u8("use of a pair")?;
        let pair = read_pair(reader, "further pair")?;
        // Ordered by use, each use but the first at most once, so that every value has exactly one encoding.
        if usage < before || (usage == before && usage != FORMER_ENVELOPE) {
            return Err(WireError::Value("use of a pair"));
        }
        before = usage;
        match usage {
            FORMER_ENVELOPE => further.envelopes.push(pair),
            NEXT_SIGNING => further.next_signing = Some(pair),
            NEXT_ENVELOPE => further.next_envelope = Some(pair),
            GATEWAY => further.gateway = Some(pair),
            _ => return Err(WireError::Value("use of a pair")),
        }
    }
    Ok(further)
}

fn read_networks(reader: &mut Reader<'_>) -> Result<BTreeMap<Domain, NetworkKeys>, WireError> {
    let count = reader.u32("number of networks")?;
    (0..count).map(|_| Ok((Domain(reader.array("domain")?), read_network(reader)?))).collect()
}

fn read_network(reader: &mut Reader<'_>) -> Result<NetworkKeys, WireError> {
    let current = reader.u64("current epoch")?;
    let count = reader.u32("number of epochs")?;
    let epochs: Result<_, WireError> = (0..count).map(|_| Ok((reader.u64("epoch")?, read_epoch(reader)?))).collect();
    Ok(NetworkKeys { epochs: epochs?, current })
}

fn read_epoch(reader: &mut Reader<'_>) -> Result<EpochSecret, WireError> {
    Ok(EpochSecret {
        key: EpochKey::new(reader.array("epoch key")?),
        state: match reader.u8("epoch state")? {
            PENDING => EpochState::Pending,
            ACTIVE => EpochState::Active,
            _ => return Err(WireError::Value("epoch state")),
        },
    })
}

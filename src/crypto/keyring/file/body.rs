//! The sealed part of a keyring file: EOA (32), d_C (32), d_E (32), K_C (16), IK (32), then a counted
//! list of networks (domain, current epoch, counted epochs of number, salt, K_C and state).

use std::collections::BTreeMap;

use zeroize::Zeroizing;

use crate::crypto::keyring::{EpochSecret, EpochState, Keyring, NetworkKeys};
use crate::crypto::{EoaSecret, EpochSalt, IndexKey, ProviderName, Sm4Key, SmKeyPair, SmSecret, provider};
use crate::model::Domain;
use crate::model::wire::{Reader, WireError};

const PENDING: u8 = 0;
const ACTIVE: u8 = 1;

pub(super) fn encode(keyring: &Keyring) -> Zeroizing<Vec<u8>> {
    let epochs: usize = keyring.networks.values().map(|network| network.epochs.len()).sum();
    // Reserved in one piece, tag included: growing would leave unwiped copies behind.
    let mut out = Zeroizing::new(Vec::with_capacity(256 + keyring.networks.len() * 44 + epochs * 57));
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
            out.extend_from_slice(secret.salt.expose());
            out.extend_from_slice(secret.sm4.expose());
            out.push(if secret.state == EpochState::Active { ACTIVE } else { PENDING });
        }
    }
    out
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
    };
    reader.end()?;
    Ok(keyring)
}

fn read_pair(reader: &mut Reader<'_>, field: &'static str) -> Result<SmKeyPair, WireError> {
    SmSecret::from_slice(reader.take(32, field)?)
        .and_then(|secret| SmKeyPair::from_secret(provider(ProviderName::RustCrypto), secret))
        .map_err(|_| WireError::Value(field))
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
        salt: EpochSalt::new(reader.array("epoch salt")?),
        sm4: Sm4Key::new(reader.array("SM4 key")?),
        state: match reader.u8("epoch state")? {
            PENDING => EpochState::Pending,
            ACTIVE => EpochState::Active,
            _ => return Err(WireError::Value("epoch state")),
        },
    })
}

use super::*;
use crate::{ProviderName, provider};

const HOME: Domain = Domain([1; 32]);

impl Keyring {
    pub(crate) fn start_epoch(&mut self, domain: &Domain) -> Result<u64> {
        let owner = self.eoa.address();
        let network = self.networks.entry(*domain).or_default();
        let epoch = network.epochs.last_key_value().map_or(0, |(last, _)| *last) + 1;
        let secret = EpochSecret::begin(&self.sm4, domain, &owner, epoch)?;
        network.epochs.insert(epoch, secret);
        network.current = epoch;
        Ok(epoch)
    }

    pub(crate) fn current_epoch(&self, domain: &Domain) -> Option<u64> {
        self.networks.get(domain).map(|network| network.current).filter(|epoch| *epoch > 0)
    }

    pub(crate) fn pending_epochs(&self, domain: &Domain) -> Vec<u64> {
        let epochs = self.networks.get(domain).into_iter().flat_map(|network| &network.epochs);
        epochs.filter(|(_, secret)| secret.state == EpochState::Pending).map(|(epoch, _)| *epoch).collect()
    }
}

fn keyring() -> Keyring {
    Keyring::generate(provider(ProviderName::RustCrypto)).expect("generates")
}

#[test]
fn epochs_begin_at_one_wait_for_the_chain_and_differ() {
    let mut keyring = keyring();
    assert_eq!(keyring.current_epoch(&HOME), None);
    assert_eq!(keyring.start_epoch(&HOME).expect("starts"), 1);
    assert_eq!(keyring.pending_epochs(&HOME), [1]);
    keyring.confirm_epoch(&HOME, 1).expect("confirms");
    assert_eq!(keyring.start_epoch(&HOME).expect("starts"), 2);
    assert_eq!((keyring.current_epoch(&HOME), keyring.pending_epochs(&HOME)), (Some(2), vec![2]));
    assert_ne!(keyring.epoch_key(&HOME, 1).expect("key"), keyring.epoch_key(&HOME, 2).expect("key"));
    assert_ne!(keyring.token(&HOME, 1).expect("token"), keyring.token(&HOME, 2).expect("token"));
    assert!(matches!(keyring.confirm_epoch(&HOME, 3), Err(CryptoError::NoEpoch(3))));
    assert!(matches!(keyring.epoch_key(&Domain([2; 32]), 1), Err(CryptoError::NoEpoch(1))));
}

#[test]
fn old_epoch_keys_survive_a_new_sm4_key() {
    let mut keyring = keyring();
    keyring.start_epoch(&HOME).expect("starts");
    let before = keyring.epoch_key(&HOME, 1).expect("key");
    keyring.sm4 = Sm4Key::new([9; 16]);
    assert_eq!(keyring.epoch_key(&HOME, 1).expect("key"), before);
    keyring.start_epoch(&HOME).expect("starts");
    assert_ne!(keyring.epoch_key(&HOME, 2).expect("key"), before);
}

#[test]
fn networks_do_not_share_epochs() {
    let mut keyring = keyring();
    let away = Domain([2; 32]);
    keyring.start_epoch(&HOME).expect("starts");
    assert_eq!(keyring.start_epoch(&away).expect("starts"), 1);
    assert_ne!(keyring.epoch_key(&HOME, 1).expect("key"), keyring.epoch_key(&away, 1).expect("key"));
}

#[test]
fn debug_shows_no_secret() {
    let mut keyring = keyring();
    keyring.start_epoch(&HOME).expect("starts");
    let shown = format!("{keyring:?}");
    let hex = crate::model::bytes::hex;
    for secret in [hex(keyring.eoa.expose()), hex(keyring.sm4.expose()), hex(keyring.index.expose())] {
        assert!(!shown.contains(&secret[..16]));
    }
    assert!(!shown.contains(&format!("{:?}", keyring.sm4.expose())));
}

//! Join files, opened: what a passphrase holder may have put there, and the system keys that workers share.

use authros::crypto::{JoinFile, JoinKey, ProviderName, SmKeyPair, provider};
use authros::gateway::{Cabinet, Context, GatewayError, Kept, Schedule, Shelf};
use authros::model::{Domain, SignerId, Timestamp};

use crate::{Sample, sample, way};

const WAYS: u8 = 2;

/// The content of a join file, or a list of system keys with its length (2) before it and their secrets.
pub fn run(data: &[u8]) -> bool {
    match way(data, WAYS) {
        Some((0, bytes)) => content(bytes),
        Some((1, bytes)) => shared(bytes),
        _ => false,
    }
}

fn content(bytes: &[u8]) -> bool {
    let Ok(file) = JoinFile::parse(bytes) else { return false };
    assert_eq!(file.encode(), bytes, "one encoding for one file");
    true
}

fn shared(bytes: &[u8]) -> bool {
    let Some((length, rest)) = bytes.split_first_chunk() else { return false };
    let Some((list, secrets)) = rest.split_at_checked(usize::from(u16::from_be_bytes(*length))) else { return false };
    let Ok(kept) = Kept::parse(list, secrets) else { return false };
    assert_eq!((&kept.list.encode()[..], &kept.secrets()[..]), (list, secrets), "one encoding for one cabinet");
    assert!(kept.list.keys.iter().all(|listed| kept.keys.iter().any(|(key, _)| key == listed)));
    true
}

struct Nowhere;

impl Shelf for Nowhere {
    fn read(&mut self) -> Result<Option<Kept>, GatewayError> {
        Ok(None)
    }

    fn write(&mut self, _: &Kept) -> Result<bool, GatewayError> {
        Ok(true)
    }

    fn is_shared(&self) -> bool {
        true
    }
}

/// Valid encodings of both kinds.
pub fn samples() -> Vec<Sample> {
    let join = JoinKey::generate(3).expect("random");
    let mut file = JoinFile::new(Domain([1; 32]), 31_337, SignerId([2; 32]), "keeper".parse().expect("a name"), join);
    (file.keyring, file.settings) = (b"as on disk".to_vec(), "confirmations = \"3\"\n".to_owned());
    let provider = provider(ProviderName::RustCrypto);
    let identity = SmKeyPair::generate(provider).expect("random");
    let (schedule, now) = (Schedule::default(), Timestamp::from_seconds(2_000_000_000));
    let context = Context { provider, domain: Domain([1; 32]) };
    let cabinet = Cabinet::on(Box::new(Nowhere), context, identity, schedule, now).expect("opens");
    let list = cabinet.kept().list.encode();
    let length = u16::try_from(list.len()).expect("short").to_be_bytes();
    let shared = [&length[..], &list, &cabinet.kept().secrets()].concat();
    vec![sample("file", 0, &file.encode()), sample("system-keys", 1, &shared), sample("nothing", 1, &[0])]
}

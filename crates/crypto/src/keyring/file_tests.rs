//! The file of a keyring: written, read, damaged, and written by two at once.

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::sync::LazyLock;

use proptest::prelude::*;

use crate::keyring::*;
use crate::model::{Domain, ErrorKind};
use crate::private_file::write_private;

fn sample() -> Keyring {
    let mut keyring = Keyring::generate(provider(ProviderName::RustCrypto)).expect("generates");
    for domain in [Domain([1; 32]), Domain([2; 32])] {
        for _ in 0..3 {
            keyring.start_epoch(&domain).expect("starts");
        }
        keyring.confirm_epoch(&domain, 1).expect("confirms");
    }
    keyring
}

/// An unstretched key, so that hundreds of openings do not take minutes.
fn quick_key() -> FileKey {
    FileKey { work: Work::WRITTEN, salt: [1; 32], key: Zeroizing::new([2; 32]) }
}

const STAMP: Stamp = Stamp { generation: 7, save_salt: [3; 24] };

static SAMPLE: LazyLock<(Keyring, Vec<u8>)> = LazyLock::new(|| {
    let keyring = sample();
    let bytes = seal(&keyring, &quick_key(), STAMP).expect("seals");
    (keyring, bytes)
});

static WITH_FURTHER: LazyLock<Keyring> = LazyLock::new(|| {
    let pair = || SmKeyPair::generate(provider(ProviderName::RustCrypto)).expect("generates");
    let mut keyring = SAMPLE.0.clone();
    keyring.further.envelopes = vec![pair(), pair()];
    keyring.further.next_signing = Some(pair());
    keyring.further.next_envelope = Some(pair());
    keyring.further.gateway = Some(pair());
    keyring
});

#[test]
fn further_pairs_come_back() {
    let bytes = seal(&WITH_FURTHER, &quick_key(), STAMP).expect("seals");
    assert!(open(Path::new("a"), &bytes, &quick_key()).is_ok_and(|opened| opened == *WITH_FURTHER));
    let mut one = SAMPLE.0.clone();
    for take in 0..4 {
        one.further = crate::keyring::FurtherPairs::default();
        match take {
            0 => one.further.envelopes = WITH_FURTHER.further.envelopes.clone(),
            1 => one.further.next_signing = WITH_FURTHER.further.next_signing.clone(),
            2 => one.further.next_envelope = WITH_FURTHER.further.next_envelope.clone(),
            _ => one.further.gateway = WITH_FURTHER.further.gateway.clone(),
        }
        assert_eq!(parse(&encode(&one)).as_ref(), Ok(&one));
    }
    let plain = encode(&SAMPLE.0);
    let secret = WITH_FURTHER.signing.secret.expose();
    let twice = [&plain[..plain.len() - 4], &[0, 0, 0, 2, 4], secret, &[4], secret].concat();
    assert!(parse(&twice).is_err(), "one gateway");
    let plain = encode(&WITH_FURTHER);
    assert!(plain.capacity() >= plain.len() + 16);
}

#[test]
fn another_version_is_refused_by_its_number() {
    let home = tempfile::tempdir().expect("directory");
    let closed = home.path().join("closed");
    make_private_directory(&closed).expect("makes");
    let path = closed.join("a.keyring");
    for version in [0, 2, 255] {
        let mut bytes = SAMPLE.1.clone();
        bytes[8] = version;
        write_private(&path, &bytes).expect("writes");
        let opened = Keyring::load(&path, &passphrase("correct horse")).map(drop);
        for error in [opened, read_public(&path).map(drop)].map(|refused| refused.expect_err("another version")) {
            assert!(matches!(error, CryptoError::Version { found, .. } if found == version), "{error}");
            assert!(error.kind() == ErrorKind::Input && error.to_string().contains("reads only version 1"), "{error}");
        }
    }
}

fn passphrase(text: &str) -> Passphrase {
    Passphrase::new(text.into()).expect("long enough")
}

#[test]
fn saved_loaded_changed_and_saved_again() {
    let home = tempfile::tempdir().expect("directory");
    let path = home.path().join("profiles").join("default.keyring");
    let keyring = sample();
    let unlocked = UnlockedKeyring::create(keyring.clone(), &path, &passphrase("correct horse")).expect("creates");
    drop(unlocked);
    assert_eq!(read_public(&path).expect("reads"), keyring.public());

    let mut unlocked = UnlockedKeyring::open(&path, &passphrase("correct horse")).expect("opens");
    assert_eq!(unlocked.keyring, keyring);
    let before = fs::read(&path).expect("reads");
    unlocked.change(|keys| keys.start_epoch(&Domain([1; 32]))).expect("saves");
    let after = fs::read(&path).expect("reads");
    assert_ne!(before[17..41], after[17..41], "each save has its own salt");
    let loaded = Keyring::load(&path, &passphrase("correct horse")).expect("loads");
    assert_eq!(loaded, unlocked.keyring);
    assert_eq!(fs::metadata(&path).expect("there").permissions().mode() & 0o777, 0o600);

    unlocked.change_passphrase(&passphrase("battery staple")).expect("changes");
    let refused = Keyring::load(&path, &passphrase("correct horse")).expect_err("refused");
    assert!(matches!(refused, CryptoError::WrongPassphrase(_)) && refused.kind() == ErrorKind::Refused);
    assert_eq!(Keyring::load(&path, &passphrase("battery staple")).expect("loads"), unlocked.keyring);
    assert!(UnlockedKeyring::create(keyring, &path, &passphrase("another one")).is_err(), "never over a keyring");
}

#[test]
fn open_permissions_are_refused_on_load_and_on_save() {
    let home = tempfile::tempdir().expect("directory");
    let closed = home.path().join("closed");
    make_private_directory(&closed).expect("makes");
    let path = closed.join("a.keyring");
    let (keyring, bytes) = &*SAMPLE;
    write_private(&path, bytes).expect("writes");
    let chmod = |path: &Path, mode| fs::set_permissions(path, fs::Permissions::from_mode(mode)).expect("chmod");
    chmod(&path, 0o640);
    let error = Keyring::load(&path, &passphrase("correct horse")).expect_err("refused");
    assert!(error.to_string().contains(&format!("chmod 600 {}", path.display())), "{error}");
    assert!(read_public(&path).is_err());
    chmod(&path, 0o600);
    assert!(read_public(&path).is_ok());
    chmod(&closed, 0o755);
    let error = read_public(&path).expect_err("refused");
    assert!(error.to_string().contains("chmod 700"), "{error}");
    let other = closed.join("b.keyring");
    assert!(UnlockedKeyring::create(keyring.clone(), &other, &passphrase("correct horse")).is_err());
}

#[test]
fn a_directory_that_cannot_be_written_is_the_homes_fault() {
    let (keyring, _) = &*SAMPLE;
    let path = Path::new("/proc/nowhere/a.keyring");
    let created = UnlockedKeyring::create(keyring.clone(), path, &passphrase("correct horse"));
    assert_eq!(created.expect_err("refused").kind(), ErrorKind::Home);
}

#[test]
fn the_file_shows_no_secret() {
    let (keyring, bytes) = &*SAMPLE;
    let secrets = [keyring.eoa.expose(), keyring.signing.secret.expose(), keyring.envelope.secret.expose()];
    for secret in secrets {
        assert!(!bytes.windows(8).any(|window| window == &secret[..8]));
    }
    assert_eq!(bytes.len(), HEADER + encode(keyring).len() + 16);
}

#[test]
fn the_buffer_of_secrets_never_grows() {
    let (keyring, _) = &*SAMPLE;
    let plain = encode(keyring);
    assert!(plain.capacity() >= plain.len() + 16);
    assert!(plain.capacity() < 2 * plain.len(), "reserved once");
}

proptest! {
    #[test]
    fn any_flipped_bit_any_cut_and_any_extension_is_refused(at in any::<prop::sample::Index>(), bit in 0u8..8) {
        let (keyring, bytes) = &*SAMPLE;
        let mut altered = bytes.clone();
        // Work and scrypt salt would choose the key, which this test supplies itself.
        let at = at.index(bytes.len());
        altered[at] ^= 1 << bit;
        let refused = open(Path::new("a"), &altered, &quick_key()).is_err();
        prop_assert!(refused, "byte {}", at);
        prop_assert!(open(Path::new("a"), &bytes[..at], &quick_key()).is_err());
        prop_assert!(open(Path::new("a"), &[&bytes[..], &[bit]].concat(), &quick_key()).is_err());
        prop_assert!(open(Path::new("a"), bytes, &quick_key()).is_ok_and(|opened| opened == *keyring));
    }

    #[test]
    fn noise_never_panics(noise in proptest::collection::vec(any::<u8>(), 0..500),
                          at in any::<prop::sample::Index>(), bit in 0u8..8) {
        prop_assert!(open(Path::new("a"), &noise, &quick_key()).is_err());
        prop_assert!(parse(&noise).is_err());
        for keyring in [&SAMPLE.0, &*WITH_FURTHER] {
            let mut plain = encode(keyring);
            let at = at.index(plain.len());
            plain[at] ^= 1 << bit;
            let _ = parse(&plain);
            prop_assert!(parse(&plain[..at]).is_err());
        }
    }
}

#[test]
fn a_stripped_keyring_keeps_what_seals_and_never_takes_the_files_place() {
    let home = tempfile::tempdir().expect("temporary directory");
    let path = home.path().join("profiles/a/keyring");
    let passphrase = Passphrase::new("a long passphrase".to_owned()).expect("long enough");
    let domain = crate::model::Domain([1; 32]);
    let mut keyring = Keyring::generate(provider(ProviderName::RustCrypto)).expect("generates");
    keyring.start_epoch(&domain).expect("starts");
    keyring.further = WITH_FURTHER.further.clone();
    let mut unlocked = UnlockedKeyring::create(keyring.clone(), &path, &passphrase).expect("written");
    let before = std::fs::read(&path).expect("a file");

    unlocked.strip(provider(ProviderName::RustCrypto)).expect("stripped");
    let left = &unlocked.keyring;
    assert_eq!((&left.eoa, &left.signing, &left.index), (&keyring.eoa, &keyring.signing, &keyring.index));
    assert_ne!(left.envelope.secret, keyring.envelope.secret, "d_E is gone");
    assert_eq!(left.envelope.public, keyring.envelope.public);
    assert!(left.further.envelopes.is_empty() && left.further.next_envelope.is_none(), "and those before and after it");
    assert!(left.sm4 != keyring.sm4 && left.networks[&domain].epochs.is_empty(), "K_C and the epochs are gone");
    assert!(matches!(unlocked.change(|_| Ok(())), Err(CryptoError::Locked(_))));
    assert!(matches!(unlocked.change_passphrase(&passphrase), Err(CryptoError::Locked(_))));
    assert_eq!(std::fs::read(&path).expect("a file"), before);
    assert_eq!(UnlockedKeyring::open(&path, &passphrase).expect("opens").keyring, keyring);
}

/// An opened keyring file in a folder of its own.
fn opened_twice(home: &Path) -> (UnlockedKeyring, UnlockedKeyring) {
    let path = home.join("profiles/a/keyring");
    let one = UnlockedKeyring::create(sample(), &path, &passphrase("correct horse")).expect("creates");
    (one, UnlockedKeyring::open(&path, &passphrase("correct horse")).expect("opens"))
}

fn generation(path: &Path) -> u64 {
    split(path, &fs::read(path).expect("reads")).expect("a keyring").0.stamp.generation
}

#[test]
fn of_two_copies_only_the_one_that_knows_the_file_replaces_it() {
    let home = tempfile::tempdir().expect("directory");
    let (mut one, mut two) = opened_twice(home.path());
    let path = one.path().to_owned();
    let begin = |keys: &mut Keyring| keys.start_epoch(&Domain([1; 32]));
    let epoch = one.change(begin).expect("saves");
    let (before, keys) = (fs::read(&path).expect("reads"), one.keys().clone());

    for refused in [two.change(begin).map(drop), two.change_passphrase(&passphrase("battery staple"))] {
        let error = refused.expect_err("out of date");
        assert!(matches!(error, CryptoError::Superseded { read: 1, found: 2, .. }), "{error}");
        assert_eq!(error.kind(), ErrorKind::Refused);
        assert!(error.to_string().contains("run the command again"), "{error}");
    }
    assert_eq!(fs::read(&path).expect("reads"), before, "the file is untouched");
    assert!(!two.keys().networks[&Domain([1; 32])].epochs.contains_key(&epoch), "and so is the copy");

    one.change(begin).expect("the other one goes on");
    let mut anew = UnlockedKeyring::open(&path, &passphrase("correct horse")).expect("opens");
    assert_eq!(anew.keys().networks[&Domain([1; 32])].epochs[&epoch], keys.networks[&Domain([1; 32])].epochs[&epoch]);
    anew.change(begin).expect("saves");
    assert!(one.change(begin).is_err(), "now this one is out of date");
}

#[test]
fn a_file_of_the_same_generation_that_another_wrote_is_another() {
    let home = tempfile::tempdir().expect("directory");
    let (mut one, mut two) = opened_twice(home.path());
    let (path, first) = (one.path().to_owned(), fs::read(one.path()).expect("reads"));
    one.change(|_| Ok(())).expect("saves");
    write_private(&path, &first).expect("an older copy is put back");
    assert!(one.change(|_| Ok(())).is_err(), "older than what was written");
    two.change(|_| Ok(())).expect("saves");
    assert_eq!(generation(&path), 2);
    assert!(one.change(|_| Ok(())).is_err(), "generation 2, but not its own");
    fs::remove_file(&path).expect("removed");
    assert!(matches!(two.change(|_| Ok(())), Err(CryptoError::Read { .. })), "a file that is gone");
    assert!(!path.exists());
}

#[test]
fn the_generation_only_grows_and_an_altered_one_does_not_open() {
    let home = tempfile::tempdir().expect("directory");
    let (mut one, _) = opened_twice(home.path());
    let path = one.path().to_owned();
    assert_eq!(generation(&path), 1);
    one.change(|_| Ok(())).expect("saves");
    one.change_passphrase(&passphrase("battery staple")).expect("saves");
    assert!(one.change(|_| Err::<(), _>(CryptoError::Random)).is_err());
    assert_eq!(generation(&path), 3, "a change that fails writes nothing");
    let bytes = fs::read(&path).expect("reads");
    for at in 9..17 {
        let mut altered = bytes.clone();
        altered[at] ^= 1;
        write_private(&path, &altered).expect("writes");
        let refused = Keyring::load(&path, &passphrase("battery staple")).expect_err("refused");
        assert!(matches!(refused, CryptoError::DamagedKeyring(_)), "byte {at}: {refused}");
    }
}

#[test]
fn copies_that_save_at_once_lose_nothing() {
    let home = tempfile::tempdir().expect("directory");
    let (one, two) = opened_twice(home.path());
    let path = one.path().to_owned();
    let saved: Vec<usize> = std::thread::scope(|scope| {
        let work = |mut copy: UnlockedKeyring| move || (0..20).filter(|_| copy.change(|_| Ok(())).is_ok()).count();
        let threads = [one, two].map(|copy| scope.spawn(work(copy)));
        threads.into_iter().map(|thread| thread.join().expect("ends")).collect()
    });
    assert!(saved == [20, 0] || saved == [0, 20], "one of them, and never in turns: {saved:?}");
    assert_eq!(generation(&path), 21);
}

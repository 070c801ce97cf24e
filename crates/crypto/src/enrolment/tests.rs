use proptest::prelude::*;

use super::*;
use crate::model::ErrorKind;
use crate::{CryptoError, EpochKey, Passphrase, ProviderName, provider};

fn issue(epoch: u64, key: SealingKey) -> EpochIssue {
    EpochIssue { epoch, token: Token([7; 32]), ends: (epoch == 3).then_some(Timestamp(9)), key }
}

fn sample(topics: usize) -> Enrolment {
    let filters = crate::FilterKey::new([12; 32]);
    let issued = IssuedTopic { id: TopicId([11; 16]), filters, key: TopicKey::new([9; 32]) };
    let keys = (0..topics).map(|number| (format!("/robot{number}/odom"), issued.clone())).collect();
    let key = if topics == 0 { SealingKey::Epoch(EpochKey::new([8; 32])) } else { SealingKey::Topics(keys) };
    let next = (topics > 1).then(|| (Timestamp(99), issue(4, key.clone())));
    Enrolment {
        domain: Domain([1; 32]),
        chain_id: 77,
        gateway: GatewayAccess {
            addresses: (0..2).map(|number| format!("gateway{number}.example:7000")).collect(),
            fingerprint: SignerId([2; 32]),
            transport: TransportKey::new([5; 32]),
        },
        name: "robot-1".parse().expect("a name"),
        owner: Address([3; 20]),
        owner_key: PublicKey([4; 64]),
        notice_id: TopicId([10; 16]),
        device: SmKeyPair::generate(provider(ProviderName::RustCrypto)).expect("pair"),
        index: (topics == 0).then(|| IndexKey::new([6; 32])),
        notice_key: TopicKey::new([7; 32]),
        token: Token([8; 32]),
        last_notice: (topics > 1).then_some(LastNotice {
            recorder: RecorderId([9; 16]),
            number: 12,
            at: Timestamp(13),
        }),
        keys: IssuedKeys { now: issue(3, key), next },
    }
}

#[test]
fn every_shape_comes_back_and_no_cut_does() {
    for topics in 0..4 {
        let enrolment = sample(topics);
        let bytes = enrolment.encode();
        assert_eq!(Enrolment::parse(&bytes), Ok(enrolment));
        for cut in 0..bytes.len() {
            assert!(Enrolment::parse(&bytes[..cut]).is_err(), "{cut}");
        }
    }
    let mut backwards = sample(2).keys;
    backwards.next = backwards.next.map(|(moment, issue)| (moment, EpochIssue { epoch: 3, ..issue }));
    assert!(IssuedKeys::parse(&backwards.encode()).is_err(), "the next epoch is a later one");
}

#[test]
fn without_the_index_key_only_named_topics_can_be_sealed() {
    let mut enrolment = sample(2);
    assert!(enrolment.index.is_none());
    enrolment.keys.next = None;
    enrolment.keys.now.key = SealingKey::Epoch(EpochKey::new([8; 32]));
    assert!(Enrolment::parse(&enrolment.encode()).is_err());
}

#[test]
fn notices_have_a_kind_and_unknown_ones_say_nothing() {
    let keys = sample(2).keys;
    assert_eq!(Notice::parse(&keys.encode()), Ok(Notice::Keys(keys)));
    assert_eq!(Notice::parse(&[9, 1, 2]), Ok(Notice::Unknown(9)));
    assert!(Notice::parse(&[]).is_err() && Notice::parse(&[0, 1]).is_err());
}

#[test]
fn a_file_opens_with_its_passphrase_alone() {
    let home = tempfile::tempdir().expect("directory");
    let path = home.path().join("robot.enrolment");
    let passphrase = |text: &str| Passphrase::new(text.to_owned()).expect("long enough");
    let sealed = SealedEnrolment::new(sample(2), &passphrase("correct horse")).expect("stretches");
    sealed.create(&path).expect("writes");
    assert!(sealed.create(&path).is_err(), "never over another");
    let opened = SealedEnrolment::open(&path, &passphrase("correct horse")).expect("opens");
    assert_eq!(opened.enrolment, sealed.enrolment);
    let kept = SealedEnrolment::kept_in(home.path());
    let mut later = SealedEnrolment::open(&path, &passphrase("correct horse")).expect("opens");
    later.enrolment.keys.now.epoch = 8;
    later.enrolment.keys.next = None;
    later.save(&kept).expect("writes");
    let mut again = opened;
    again.catch_up(&kept).expect("reads");
    assert_eq!(again.enrolment, later.enrolment, "what it was told since");
    SealedEnrolment::new(sample(1), &passphrase("correct horse")).expect("stretches").save(&kept).expect("writes");
    again.catch_up(&kept).expect("reads");
    assert_eq!(again.enrolment, later.enrolment, "another one's is not taken");
    let wrong = SealedEnrolment::open(&path, &passphrase("battery staple"));
    assert!(matches!(wrong, Err(CryptoError::WrongPassphrase(_))));
    let whole = sealed.seal().expect("seals");
    for at in [0, 8, 20, 60, 80, 108, 111, whole.len() - 1] {
        let mut altered = whole.clone();
        altered[at] ^= 1;
        crate::private_file::write_private(&path, &altered).expect("writes");
        assert!(SealedEnrolment::open(&path, &passphrase("correct horse")).is_err(), "byte {at}");
    }
    for version in [0, 2, 255] {
        let mut other = whole.clone();
        other[8] = version;
        crate::private_file::write_private(&path, &other).expect("writes");
        let error = SealedEnrolment::open(&path, &passphrase("correct horse")).map(drop).expect_err("another version");
        assert!(matches!(error, CryptoError::Version { found, .. } if found == version), "{error}");
        assert!(error.kind() == ErrorKind::Input && error.to_string().contains("reads only version 1"), "{error}");
    }
    let secret = sealed.enrolment.gateway.transport.expose();
    assert!(!whole.windows(8).any(|window| window == &secret[..8]));
    assert!(!format!("{:?}", sealed.enrolment).contains("05, 05"), "no secret is shown");
}

proptest! {
    #[test]
    fn noise_never_panics_and_what_parses_has_one_encoding(noise in proptest::collection::vec(any::<u8>(), 0..500), at: usize, bit in 0u8..8) {
        let _ = (Enrolment::parse(&noise), Notice::parse(&noise));
        if let Ok(issued) = IssuedKeys::parse(&noise) {
            prop_assert_eq!(&issued.encode()[..], &noise[..]);
        }
        let mut bytes = sample(2).keys.encode();
        let at = at % bytes.len();
        bytes[at] ^= 1 << bit;
        if let Ok(issued) = IssuedKeys::parse(&bytes) {
            prop_assert_eq!(&issued.encode()[..], &bytes[..]);
        }
    }
}

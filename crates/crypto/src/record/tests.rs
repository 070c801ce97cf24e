use std::collections::BTreeMap;

use proptest::prelude::*;

use super::*;
use crate::model::{ErrorKind, Verdict};
use crate::{ProviderName, SmSecret, provider};

/// Everything needed to seal and open one record.
pub(crate) struct Sample {
    provider: &'static dyn Provider,
    signer: SmKeyPair,
    key: TopicKey,
    head: Head,
    body: Vec<u8>,
}

impl Sample {
    pub(crate) fn new(name: ProviderName, body: &[u8]) -> Self {
        let provider = provider(name);
        let secret = SmSecret::from_slice(&[5; 32]).expect("in range");
        let head = Head {
            topic: "/robot1/odom".into(),
            type_name: "nav_msgs/Odometry".into(),
            md5sum: "cd5e73d190d741a2f92e81eda573aca7".into(),
            definition: Digest([4; 32]),
            caller_id: "/robot1".into(),
            boot_id: [5; 16],
            compression: Compression::None,
            plain_length: u64::try_from(body.len()).expect("fits"),
            tags: BTreeMap::from([("mission".into(), "7".into())]),
        };
        let signer = SmKeyPair::from_secret(provider, secret).expect("pair");
        Self { provider, signer, key: TopicKey::new([6; 32]), head, body: body.to_vec() }
    }

    pub(crate) fn request(&self) -> SealRequest<'_> {
        SealRequest {
            domain: Domain([1; 32]),
            owner: Address([2; 20]),
            signer: &self.signer,
            epoch: 3,
            topic_key: &self.key,
            recorder: RecorderPrefix::ledger([4; 7]),
            seq: 9,
            topic_id: TopicId([8; 16]),
            kind: RecordKind::Data,
            filters: vec![FilterId([1; 8]), FilterId([2; 8])],
            captured_at: Timestamp(1_700_000_000_000_000_000),
            head: &self.head,
            body: &self.body,
        }
    }

    pub(crate) fn seal(&self) -> SealedRecord {
        seal(self.provider, &self.request()).expect("seals")
    }

    fn expected() -> Expected {
        Expected {
            domain: Domain([1; 32]),
            owner: Address([2; 20]),
            recorder: None,
            epoch: Some(3),
            seq: Some(9),
            topic_id: Some(TopicId([8; 16])),
            names: Names::Given("/robot1/odom".into()),
        }
    }

    fn open(&self, blob: &[u8], signature: &Signature, anchor: Anchor) -> Result<OpenedRecord> {
        let recorder = Some(RecorderPrefix::ledger([4; 7]).of_signer(&signer_id(&self.signer.public)));
        let expected = Expected { recorder, ..Self::expected() };
        open(self.provider, blob, signature, &self.signer.public, anchor, &self.key, &expected)
    }
}

#[test]
fn sealed_by_one_provider_opened_by_the_other() {
    let [one, second, third] = ProviderName::ALL;
    for [sealer, opener] in [[one, second], [second, one], [one, third], [third, one]] {
        let record = Sample::new(sealer, b"the message").seal();
        assert_eq!(record.digest, Digest(crate::sm3::sm3(&[&record.blob])));
        let opener = Sample::new(opener, b"the message");
        let opened = opener.open(&record.blob, &record.signature, Anchor::Chain(record.digest)).expect("opens");
        assert_eq!(
            (opened.head, &opened.body[..], opened.digest),
            (opener.head.clone(), &b"the message"[..], record.digest)
        );
        assert_eq!(opened.verdict, Verdict::Verified);
        let unanchored = opener.open(&record.blob, &record.signature, Anchor::Unanchored).expect("opens");
        assert_eq!(unanchored.verdict, Verdict::Unanchored);
    }
}

#[test]
fn an_empty_body_is_a_record_too_and_no_two_sealings_are_alike() {
    let sample = Sample::new(ProviderName::RustCrypto, b"");
    let (one, other) = (sample.seal(), sample.seal());
    assert_ne!(one.blob, other.blob);
    assert_eq!(one.blob.len(), other.blob.len());
    assert!(sample.open(&one.blob, &one.signature, Anchor::Chain(one.digest)).expect("opens").body.is_empty());
}

#[test]
fn names_and_plaintext_do_not_show() {
    let sample = Sample::new(ProviderName::RustCrypto, b"a very secret message");
    let blob = sample.seal().blob;
    for needle in [&b"robot1"[..], b"nav_msgs", b"mission", b"secret"] {
        assert!(!blob.windows(needle.len()).any(|window| window == needle));
    }
}

#[test]
fn the_checks_come_in_order() {
    let sample = Sample::new(ProviderName::RustCrypto, b"message");
    let SealedRecord { blob, digest, signature, .. } = sample.seal();
    let other = Sample { key: TopicKey::new([9; 32]), ..Sample::new(ProviderName::RustCrypto, b"message") };
    let bad_signature = Signature([7; 64]);
    let anchored = Anchor::Chain(digest);
    let wrong = Anchor::Chain(Digest([0; 32]));

    let parse = sample.open(&blob[1..], &bad_signature, wrong).expect_err("parse");
    assert!(matches!(parse, CryptoError::DamagedRecord(_)) && parse.kind() == ErrorKind::Tampered);
    assert!(matches!(other.open(&blob, &bad_signature, wrong), Err(CryptoError::Tampered("digest"))));
    assert!(matches!(other.open(&blob, &bad_signature, anchored), Err(CryptoError::Tampered("signature"))));
    let key = other.open(&blob, &signature, anchored).expect_err("key");
    assert!(matches!(key, CryptoError::WrongKey) && key.kind() == ErrorKind::Refused);

    let stranger = SmKeyPair::generate(sample.provider).expect("pair").public;
    let checked = check(sample.provider, &blob, &signature, &stranger, anchored);
    assert!(matches!(checked, Err(CryptoError::Tampered("signature"))));
    let (header, found, verdict) =
        check(sample.provider, &blob, &signature, &sample.signer.public, anchored).expect("valid");
    assert_eq!((header.seq, found, verdict), (9, digest, Verdict::Verified));
}

/// An owner who signs bytes that were not sealed correctly: only the tags can tell.
#[test]
fn signed_but_altered_ciphertext_is_caught_by_its_tag() {
    let sample = Sample::new(ProviderName::RustCrypto, b"message");
    let SealedRecord { mut blob, .. } = sample.seal();
    let (header, length) = Header::parse(&blob).expect("parses");
    let body = length + usize::try_from(header.head_length).expect("fits");
    for (at, what) in [(length, "sealed head"), (body, "sealed body")] {
        blob[at] ^= 1;
        let digest = Digest(sample.provider.sm3(&[&blob]));
        let signature =
            sample.provider.sign(&sample.signer.secret, &signed_bytes(&header.domain, &digest)).expect("signs");
        let opened = sample.open(&blob, &signature, Anchor::Chain(digest));
        assert!(matches!(opened, Err(CryptoError::Tampered(found)) if found == what));
        blob[at] ^= 1;
    }
}

#[test]
fn another_record_than_the_one_asked_for_is_not_shown() {
    let sample = Sample::new(ProviderName::RustCrypto, b"message");
    let record = sample.seal();
    let asked = |expected: Expected| {
        let anchor = Anchor::Chain(record.digest);
        let public = &sample.signer.public;
        open(sample.provider, &record.blob, &record.signature, public, anchor, &sample.key, &expected)
    };
    let base = Sample::expected;
    assert!(asked(Expected::any_of(Domain([1; 32]), Address([2; 20]), base().names)).is_ok());
    let other = Expected { names: Names::Given("/robot2/odom".into()), ..base() };
    assert!(matches!(asked(other), Err(CryptoError::FalseName("topic"))));
    for (expected, field) in [
        (Expected { domain: Domain([0; 32]), ..base() }, "domain"),
        (Expected { owner: Address([0; 20]), ..base() }, "owner"),
        (Expected { epoch: Some(4), ..base() }, "epoch"),
        (Expected { recorder: Some(crate::model::RecorderId([0; 16])), ..base() }, "recorder"),
        (Expected { seq: Some(10), ..base() }, "seq"),
        (Expected { topic_id: Some(TopicId([0; 16])), ..base() }, "topic id"),
    ] {
        assert!(matches!(asked(expected), Err(CryptoError::NotAsked(found)) if found == field), "{field}");
    }
}

#[test]
fn what_could_not_be_opened_is_not_sealed() {
    let sample = Sample::new(ProviderName::RustCrypto, b"message");
    let refused = |change: &dyn Fn(&mut SealRequest<'_>)| {
        let mut request = sample.request();
        change(&mut request);
        seal(sample.provider, &request).expect_err("refused").kind() == ErrorKind::Input
    };
    assert!(refused(&|request| request.seq = 0));
    assert!(refused(&|request| request.epoch = 0));
    assert!(refused(&|request| request.filters = vec![FilterId([0; 8]); 5]));
    assert!(refused(&|request| request.body = b"longer than the head says"));
    let head = Head { topic: "x".repeat(70_000), ..sample.head.clone() };
    assert!(seal(sample.provider, &SealRequest { head: &head, ..sample.request() }).is_err());
    let tags = (0..65).map(|number| (number.to_string(), String::new())).collect();
    let head = Head { tags, ..sample.head.clone() };
    assert!(seal(sample.provider, &SealRequest { head: &head, ..sample.request() }).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn any_flipped_bit_any_cut_and_any_extension_is_refused(
        body in proptest::collection::vec(any::<u8>(), 0..300), at in any::<prop::sample::Index>(), bit in 0u8..8,
        more in proptest::collection::vec(any::<u8>(), 1..20),
    ) {
        let sample = Sample::new(ProviderName::RustCrypto, &body);
        let SealedRecord { blob, digest, signature, .. } = sample.seal();
        for anchor in [Anchor::Chain(digest), Anchor::Unanchored] {
            let mut altered = blob.clone();
            altered[at.index(blob.len())] ^= 1 << bit;
            let mut forged = signature;
            forged.0[at.index(64)] ^= 1 << bit;
            prop_assert!(sample.open(&altered, &signature, anchor).is_err());
            prop_assert!(sample.open(&blob, &forged, anchor).is_err());
            prop_assert!(sample.open(&blob[..at.index(blob.len())], &signature, anchor).is_err());
            prop_assert!(sample.open(&[&blob[..], &more].concat(), &signature, anchor).is_err());
            prop_assert_eq!(sample.open(&blob, &signature, anchor).expect("opens").body, body.clone());
        }
    }

    #[test]
    fn noise_never_panics(noise in proptest::collection::vec(any::<u8>(), 0..600)) {
        let sample = Sample::new(ProviderName::RustCrypto, b"");
        prop_assert!(sample.open(&noise, &Signature([1; 64]), Anchor::Unanchored).is_err());
    }
}

#[test]
fn one_record_opens_by_its_own_secret_and_no_other_does() {
    let sample = Sample::new(ProviderName::default(), b"the message");
    let (record, another) = (sample.seal(), sample.seal());
    let secret = RecordSecret::of(&sample.key, &record.header);
    // RFC 5869: extract is HMAC under the salt; expanded with the header's names it gives the same keys as the whole
    // derivation.
    assert_eq!(*secret.expose(), crate::hmac_sm3(&record.header.salt.0, &[sample.key.expose()]));
    let revealed = open_revealed(sample.provider, &record.blob, &secret).expect("opens");
    assert_eq!((revealed.body.as_slice(), revealed.head), (&b"the message"[..], sample.head.clone()));
    let mut budget = 20;
    let mut within = || open_revealed_within(sample.provider, &record.blob, &secret, &mut budget).expect("opens");
    assert!(within().is_some() && within().is_none(), "eleven bytes of twenty, and not eleven more");
    assert_eq!(budget, 9);
    let other = open_revealed(sample.provider, &another.blob, &secret);
    assert!(matches!(other, Err(CryptoError::WrongKey)), "another record of the same topic stays closed");
    let mut altered = record.blob.clone();
    *altered.last_mut().expect("bytes") ^= 1;
    assert!(matches!(open_revealed(sample.provider, &altered, &secret), Err(CryptoError::Tampered(_))));
    assert!(RecordSecret::from_slice(&[0; 33]).is_none() && !format!("{secret:?}").contains("32"));
}

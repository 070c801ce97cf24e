//! How long sealing, checking and opening take, per provider, at the sizes robots send: 1 KiB (odometry), 58 KB (a
//! compressed picture), 800 KB (the paper's largest).

#![allow(clippy::expect_used, missing_docs, reason = "a benchmark that cannot go on stops")]

use std::collections::BTreeMap;

use authros::crypto::{
    Anchor, Expected, Provider, ProviderName, SealRequest, SealedRecord, SmKeyPair, TopicKey, check, open, provider,
    seal,
};
use authros::model::head::Compression;
use authros::model::{Address, Digest, Domain, Head, RecordKind, RecorderId, Timestamp, TopicId};
use divan::counter::BytesCount;

const SIZES: [usize; 3] = [1024, 58_000, 800_000];
const DOMAIN: Domain = Domain([1; 32]);
const OWNER: Address = Address([2; 20]);

struct Bench {
    provider: &'static dyn Provider,
    signer: SmKeyPair,
    key: TopicKey,
    head: Head,
    body: Vec<u8>,
}

impl Bench {
    fn new(name: ProviderName, size: usize) -> Self {
        let provider = provider(name);
        let head = Head {
            topic: "/robot1/odom".into(),
            type_name: "nav_msgs/Odometry".into(),
            md5sum: "cd5e73d190d741a2f92e81eda573aca7".into(),
            definition: Digest([4; 32]),
            caller_id: "/robot1".into(),
            boot_id: [5; 16],
            compression: Compression::None,
            plain_length: u64::try_from(size).expect("fits"),
            tags: BTreeMap::from([("simulated".into(), "yes".into())]),
        };
        let signer = SmKeyPair::generate(provider).expect("a pair of keys");
        Self { provider, signer, key: TopicKey::new([6; 32]), head, body: vec![0x5a; size] }
    }

    fn seal(&self) -> SealedRecord {
        let request = SealRequest {
            domain: DOMAIN,
            owner: OWNER,
            signer: &self.signer,
            epoch: 1,
            topic_key: &self.key,
            recorder: RecorderId([3; 16]),
            seq: 1,
            topic_id: TopicId([4; 16]),
            kind: RecordKind::Data,
            filters: Vec::new(),
            captured_at: Timestamp(1),
            head: &self.head,
            body: &self.body,
        };
        seal(self.provider, &request).expect("a sealed record")
    }
}

fn main() {
    divan::main();
}

#[divan::bench(args = SIZES, consts = [false, true])]
fn sealing<const LIBSM: bool>(bencher: divan::Bencher<'_, '_>, size: usize) {
    let bench = Bench::new(name(LIBSM), size);
    bench.seal();
    bencher.counter(BytesCount::new(size)).bench(|| bench.seal());
}

#[divan::bench(args = SIZES, consts = [false, true])]
fn checking<const LIBSM: bool>(bencher: divan::Bencher<'_, '_>, size: usize) {
    let bench = Bench::new(name(LIBSM), size);
    let SealedRecord { blob, digest, signature, .. } = bench.seal();
    let anchor = Anchor::Chain(digest);
    bencher
        .counter(BytesCount::new(size))
        .bench(|| check(bench.provider, &blob, &signature, &bench.signer.public, anchor).expect("valid"));
}

#[divan::bench(args = SIZES, consts = [false, true])]
fn opening<const LIBSM: bool>(bencher: divan::Bencher<'_, '_>, size: usize) {
    let bench = Bench::new(name(LIBSM), size);
    let SealedRecord { blob, digest, signature, .. } = bench.seal();
    let (anchor, expected) = (Anchor::Chain(digest), Expected::any_of(DOMAIN, OWNER));
    bencher.counter(BytesCount::new(size)).bench(|| {
        open(bench.provider, &blob, &signature, &bench.signer.public, anchor, &bench.key, &expected).expect("opens")
    });
}

fn name(libsm: bool) -> ProviderName {
    if libsm { ProviderName::Libsm } else { ProviderName::default() }
}

//! What a gateway of the fleet hands over, judged on a chain: anchors are real ones, made by somebody else.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use std::collections::BTreeMap;

use super::*;
use crate::chain::Call;
use crate::chain::merkle::Leaf;
use crate::crypto::{EoaSecret, SealRequest, SealedRecord, SmKeyPair, TopicKey, prove, seal};
use crate::model::head::Compression;
use crate::model::{Head, Party, Ranges, RecordKind, RecordState, RecorderId, Signature, Timestamp, Token, TopicId};
use crate::pipeline::Owner;
use crate::service::command::Administration;
use crate::site::Needs;
use crate::site::testing::{registered, site_of, site_with_chain};

pub(in crate::site::gateway) const RECORDER: RecorderId = RecorderId([4; 16]);
pub(in crate::site::gateway) const TOPIC: TopicId = TopicId([8; 16]);

pub(in crate::site::gateway) fn record(
    network: &Network,
    owner: &Owner,
    signer: &SmKeyPair,
    (seq, body): (u64, &[u8]),
) -> SealedRecord {
    record_on(TOPIC, (network, owner.address), signer, (seq, body))
}

fn record_on(
    topic_id: TopicId,
    (network, owner): (&Network, Address),
    signer: &SmKeyPair,
    (seq, body): (u64, &[u8]),
) -> SealedRecord {
    let head = Head {
        topic: "/odom".into(),
        type_name: "nav_msgs/Odometry".into(),
        md5sum: "cd5e73d190d741a2f92e81eda573aca7".into(),
        definition: Digest([4; 32]),
        caller_id: "/robot1".into(),
        boot_id: [5; 16],
        compression: Compression::None,
        plain_length: body.len() as u64,
        tags: BTreeMap::new(),
    };
    let request = SealRequest {
        domain: network.domain,
        owner,
        signer,
        epoch: 1,
        topic_key: &TopicKey::new([6; 32]),
        recorder: RECORDER,
        seq,
        topic_id,
        kind: RecordKind::Data,
        filters: Vec::new(),
        captured_at: Timestamp(seq),
        head: &head,
        body,
    };
    seal(crate::crypto::provider(crate::crypto::ProviderName::RustCrypto), &request).expect("sealed")
}

/// Sends a transaction of an account that is not of this home, and waits for its block.
async fn by_hand(network: &Network, eoa: &EoaSecret, call: &Call) -> (crate::model::Hash, u64, crate::model::Hash) {
    let chain = &network.chain;
    let nonce = chain.nonce(eoa.address(), true).await.expect("a nonce");
    let signed = chain.sign(eoa, nonce, call).await.expect("signed");
    chain.broadcast(&signed.raw).await.expect("sent");
    loop {
        if let Some(receipt) = chain.receipt(signed.hash).await.expect("answered") {
            assert!(receipt.success, "{call:?}");
            return (signed.hash, receipt.block, receipt.block_hash);
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// The record as a gateway hands it over that anchored it, alone in its batch.
pub(in crate::site::gateway) async fn anchored(
    network: &Network,
    by: &EoaSecret,
    sealed: &SealedRecord,
    signer: &SmKeyPair,
) -> Fetched {
    let Header { owner, recorder, topic_id, seq, .. } = sealed.header;
    let root = Leaf { owner, recorder, topic_id, seq, digest: sealed.digest }.hash();
    let previous = network.chain.anchor_head(by.address()).await.expect("answered");
    let (transaction, block, block_hash) = by_hand(network, by, &Call::Anchor { root, count: 1, previous }).await;
    let inclusion = Some(Inclusion { index: 0, count: 1, path: Vec::new(), root });
    let proof = AnchorProof { account: by.address(), transaction, block, block_hash, inclusion }.encode();
    Fetched { signer: signer.public, signature: sealed.signature, proof, blob: sealed.blob.clone() }
}

/// Somebody else on this chain, who keeps the other gateway.
pub(in crate::site::gateway) async fn stranger(network: &Network) -> EoaSecret {
    newcomer(network).await.0
}

/// An account that is not of this home, with its d_C.
async fn newcomer(network: &Network) -> (EoaSecret, SmKeyPair) {
    let (eoa, provider) =
        (EoaSecret::generate().expect("a key"), crate::crypto::provider(crate::crypto::ProviderName::RustCrypto));
    let [signing, envelope] = [(); 2].map(|()| SmKeyPair::generate(provider).expect("a pair"));
    let identity = prove(provider, &network.domain, &eoa.address(), &signing, &envelope.public, Token([3; 32]));
    by_hand(network, &eoa, &Call::Register { identity: identity.expect("proven") }).await;
    (eoa, signing)
}

/// Records as one answer to what was asked for.
pub(in crate::site::gateway) fn handed(wanted: Wanted, records: Vec<Fetched>) -> Vec<Handed> {
    vec![Handed { wanted, until: wanted.last, records }]
}

/// The numbers, of whatever topics.
pub(in crate::site::gateway) fn numbers(of: BTreeSet<Numbered>) -> Vec<u64> {
    of.into_iter().map(|(.., number)| number).collect()
}

pub(in crate::site::gateway) fn codes(refusals: &[Refusal]) -> Vec<Code> {
    refusals.iter().map(|refusal| refusal.code).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn what_another_gateway_hands_over_is_judged_by_the_block_that_anchors_it() {
    let (site, _folder) = site_with_chain();
    let (keeper, alice) = (registered(&site, "keeper").await, registered(&site, "alice").await);
    let (_running, ended) = tokio::sync::oneshot::channel();
    site.gateway.serve(&keeper, "127.0.0.1:0".parse().expect("an address"), false, ended).await.expect("serves");
    let network = site.network().await.expect("a chain");
    let (desk, other) = (site.gateway.served_desk().expect("serves"), stranger(&network).await);
    let anchors = Anchors::default();
    let here = Taking { desk: &desk, anchors: &anchors, copies: Copies::All };
    let wanted = Wanted { owner: alice.address, recorder: RECORDER, topic_id: TOPIC, first: 1, last: 9 };
    assert!(here.welcomes(&alice.address).is_ok(), "a profile of this home");
    let refusal = here.welcomes(&other.address()).expect_err("nobody admitted it");
    assert_eq!(refusal.code, Code::NotAuthorised);

    let own = alice.signing();
    let first = record(&network, &alice, &own, (1, b"one"));
    let first_handed = anchored(&network, &other, &first, &own).await;
    for _ in 0..2 {
        let Took { taken, refused, .. } = here.take(handed(wanted, vec![first_handed.clone()])).await.expect("asked");
        assert_eq!((numbers(taken), codes(&refused)), (vec![1], Vec::new()), "twice is once");
    }
    let ledger = &site.plant.ledger;
    let row = ledger.record(first.digest).expect("read").expect("held");
    assert!(row.block.is_some() && row.state >= RecordState::Mined, "{row:?}");
    assert_eq!(ledger.stored_leaves(keeper.address, 9).expect("read"), [], "nobody anchors it again");

    // A robot that is recalled: what it signed before stays good, what is anchored afterwards is not.
    let robot = SmKeyPair::generate(site.plant.provider).expect("a pair");
    site.devices.lend(&alice, signer_id(&robot.public), None).await.expect("lent");
    let before = anchored(&network, &other, &record(&network, &alice, &robot, (2, b"two")), &robot).await;
    site.devices.recall(&alice, &signer_id(&robot.public).to_string()).await.expect("recalled");
    let after = anchored(&network, &other, &record(&network, &alice, &robot, (3, b"three")), &robot).await;
    let Took { taken, refused, .. } = here.take(handed(wanted, vec![before, after])).await.expect("asked");
    assert_eq!((numbers(taken), codes(&refused)), (vec![2], vec![Code::Signature]), "{refused:?}");

    // Anchored by somebody, and signed by nobody who may.
    let thief = SmKeyPair::generate(site.plant.provider).expect("a pair");
    let stolen = anchored(&network, &other, &record(&network, &alice, &thief, (4, b"four")), &thief).await;
    let unsigned = Fetched { signature: Signature([7; 64]), ..first_handed.clone() };
    // A true proof of another record, and another record under a number that is taken, beside a good one.
    let elsewhere = record(&network, &alice, &own, (5, b"five"));
    let proven = anchored(&network, &other, &elsewhere, &own).await;
    let foreign = Fetched { proof: first_handed.proof.clone(), ..proven.clone() };
    let second = anchored(&network, &other, &record(&network, &alice, &own, (1, b"another one")), &own).await;
    let lies = vec![stolen, unsigned, foreign, second, proven];
    let Took { taken, refused, .. } = here.take(handed(wanted, lies)).await.expect("asked");
    let expected = [Code::Signature, Code::Signature, Code::Tampered, Code::Malformed];
    assert_eq!((numbers(taken), codes(&refused)), (vec![5], expected.to_vec()), "{refused:?}");
    // An anchor that the chain here does not have: in a block that may come yet, and in one that is long here.
    let genuine = AnchorProof::parse(&first_handed.proof).expect("a proof");
    let newest = network.chain.head().await.expect("answered").number;
    let sixth = record(&network, &alice, &own, (6, b"six"));
    let inclusion = anchored(&network, &other, &sixth, &own).await;
    let place = AnchorProof::parse(&inclusion.proof).expect("a proof").inclusion;
    let elsewhere = |block| {
        let transaction = crate::model::Hash([0x77; 32]);
        let proof = AnchorProof { transaction, block, inclusion: place.clone(), ..genuine.clone() }.encode();
        Fetched { proof, ..inclusion.clone() }
    };
    let Took { taken, later, refused, .. } =
        here.take(handed(wanted, vec![elsewhere(newest + 9)])).await.expect("asked");
    assert_eq!(
        (numbers(taken), numbers(later), codes(&refused)),
        (Vec::new(), vec![6], Vec::new()),
        "it comes later, perhaps"
    );
    let Took { taken, later, refused, .. } = here.take(handed(wanted, vec![elsewhere(1)])).await.expect("asked");
    assert_eq!(
        (numbers(taken), numbers(later), codes(&refused)),
        (Vec::new(), Vec::new(), vec![Code::Tampered]),
        "a lie"
    );
    let told = Ranges::of((1..=9).collect());
    let lacking = ledger.lacking((alice.address, RECORDER, TOPIC), &told).expect("read").numbers;
    assert_eq!(lacking.iter().collect::<Vec<_>>(), [(3, 4), (6, 9)]);
    assert_eq!(ledger.record(first.digest).expect("read").map(|row| row.seq), Some(1), "the first one stays");
    site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn an_owner_over_its_quota_or_suspended_is_refused_whoever_brings_its_records() {
    let settings = [("gateway.quota_bytes", "4KiB"), ("gateway.quota_streams", "1")];
    let (site, _folder) = site_of(&settings, Needs { ros: false, chain: true });
    let keeper = registered(&site, "keeper").await;
    let (_running, ended) = tokio::sync::oneshot::channel();
    site.gateway.serve(&keeper, "127.0.0.1:0".parse().expect("an address"), true, ended).await.expect("serves");
    let network = site.network().await.expect("a chain");
    let (desk, other) = (site.gateway.served_desk().expect("serves"), stranger(&network).await);
    let (guest, own) = newcomer(&network).await;
    let (anchors, owner) = (Anchors::default(), guest.address());
    let here = Taking { desk: &desk, anchors: &anchors, copies: Copies::All };
    while desk.account(&owner).await.is_err() {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    assert!(here.welcomes(&owner).is_ok(), "an open gateway");
    let all_of = |topic_id| Wanted { owner, recorder: RECORDER, topic_id, first: 1, last: 9 };
    let hers = async |topic, seq, body: &[u8]| {
        anchored(&network, &other, &record_on(topic, (&network, owner), &own, (seq, body)), &own).await
    };
    let take = async |topic, records| {
        let Took { taken, refused, .. } = here.take(handed(all_of(topic), records)).await.expect("asked");
        (numbers(taken), codes(&refused))
    };
    let long = vec![7; 8 * 1024];
    assert_eq!(take(TOPIC, vec![hers(TOPIC, 1, b"one").await]).await, (vec![1], Vec::new()));
    let second = TopicId([9; 16]);
    let beyond = hers(second, 1, b"another topic").await;
    assert_eq!(take(second, vec![beyond.clone()]).await, (Vec::new(), vec![Code::Quota]), "one stream");
    let large = hers(TOPIC, 2, &long).await;
    assert_eq!(take(TOPIC, vec![large.clone()]).await, (Vec::new(), vec![Code::Quota]), "four KiB");
    assert_eq!(take(TOPIC, vec![hers(TOPIC, 3, b"three").await]).await, (vec![3], Vec::new()), "this one fits");
    let (of_topic, of_second) = ((owner, RECORDER, TOPIC), (owner, RECORDER, second));
    let told = Ranges::of(vec![1, 2, 3]);
    let lacking = |which| site.plant.ledger.lacking(which, &told).expect("read").numbers.count();
    assert_eq!((lacking(of_topic), lacking(of_second)), (1, 3), "nothing of what was refused is here");

    // The keeper admits it: no quota any more. Suspended, nothing of it is taken, however good it is.
    site.gateway.admissions.admit(&keeper.profile, &Party::Address(owner)).await.expect("admitted");
    let act = Administration::Suspend { account: Party::Address(owner) };
    site.administering.administer(&keeper, &act).await.expect("suspended");
    while desk.account(&owner).await.is_ok() {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    assert_eq!(take(TOPIC, vec![large.clone()]).await, (Vec::new(), vec![Code::Suspended]));
    assert_eq!((lacking(of_topic), lacking(of_second)), (1, 3));
    let act = Administration::Restore { account: Party::Address(owner) };
    site.administering.administer(&keeper, &act).await.expect("restored");
    while desk.account(&owner).await.is_err() {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    assert_eq!(take(TOPIC, vec![large]).await, (vec![2], Vec::new()), "anchored before that, and admitted by now");
    assert_eq!(take(second, vec![beyond]).await, (vec![1], Vec::new()));
    site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn records_of_several_owners_are_taken_together_and_one_who_may_not_spoils_nothing() {
    let settings = [("gateway.quota_bytes", "4KiB")];
    let (site, _folder) = site_of(&settings, Needs { ros: false, chain: true });
    let (keeper, alice) = (registered(&site, "keeper").await, registered(&site, "alice").await);
    let (_running, ended) = tokio::sync::oneshot::channel();
    site.gateway.serve(&keeper, "127.0.0.1:0".parse().expect("an address"), true, ended).await.expect("serves");
    let network = site.network().await.expect("a chain");
    let (desk, other) = (site.gateway.served_desk().expect("serves"), stranger(&network).await);
    let (guest, hers) = newcomer(&network).await;
    while desk.account(&guest.address()).await.is_err() {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let anchors = Anchors::default();
    let here = Taking { desk: &desk, anchors: &anchors, copies: Copies::All };
    let own = alice.signing();
    let of_alice = async |topic, seq, body: &[u8]| {
        anchored(&network, &other, &record_on(topic, (&network, alice.address), &own, (seq, body)), &own).await
    };
    let of_guest = async |topic, seq, body: &[u8]| {
        anchored(&network, &other, &record_on(topic, (&network, guest.address()), &hers, (seq, body)), &hers).await
    };
    let second = TopicId([9; 16]);
    let asked = |owner, topic_id| Wanted { owner, recorder: RECORDER, topic_id, first: 1, last: 9 };
    let nobody = Address([0x5a; 20]);
    let parts = [
        (asked(alice.address, TOPIC), vec![of_alice(TOPIC, 1, b"one").await]),
        (asked(guest.address(), TOPIC), vec![of_guest(TOPIC, 1, &vec![7; 8 * 1024]).await]),
        // Beyond its quota is one topic's record, not the other one's.
        (asked(guest.address(), second), vec![of_guest(second, 1, b"short").await]),
        // Asked of one topic, answered with another one's.
        (asked(alice.address, TOPIC), vec![of_alice(second, 2, b"two").await]),
        (asked(nobody, TOPIC), vec![of_alice(TOPIC, 5, b"of nobody").await]),
        (asked(alice.address, second), vec![of_alice(second, 1, b"one of the other topic").await]),
    ];
    let parts = parts.into_iter().flat_map(|(wanted, records)| handed(wanted, records)).collect();
    let Took { taken, later, refused, .. } = here.take(parts).await.expect("asked");
    let expected = [
        (alice.address, RECORDER, TOPIC, 1),
        (alice.address, RECORDER, second, 1),
        (guest.address(), RECORDER, second, 1),
    ];
    assert_eq!((taken, later), (BTreeSet::from(expected), BTreeSet::new()));
    assert_eq!(codes(&refused), [Code::NotRegistered, Code::Malformed, Code::Quota], "{refused:?}");

    // Under a number that is taken: only this one is refused, whoever came with it.
    let parts = [
        (asked(alice.address, TOPIC), vec![of_alice(TOPIC, 1, b"another one").await, of_alice(TOPIC, 2, b"two").await]),
        (asked(guest.address(), TOPIC), vec![of_guest(TOPIC, 2, b"short").await]),
    ];
    let parts = parts.into_iter().flat_map(|(wanted, records)| handed(wanted, records)).collect();
    let Took { taken, refused, .. } = here.take(parts).await.expect("asked");
    let expected = [(alice.address, RECORDER, TOPIC, 2), (guest.address(), RECORDER, TOPIC, 2)];
    assert_eq!((taken, codes(&refused)), (BTreeSet::from(expected), vec![Code::Malformed]), "{refused:?}");
    site.stop().await;
}

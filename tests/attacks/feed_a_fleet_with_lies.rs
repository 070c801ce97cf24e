//! A gateway of the fleet that its neighbour trusts by fingerprint turns hostile: it tells endless holdings and hands over
//! forged records, replayed ones, those of other owners, and proofs of anchors that never were.

use std::time::Duration;

use authros::chain::AnchorProof;
use authros::chain::merkle::{Inclusion, Leaf};
use authros::crypto::{ProviderName, SmKeyPair, provider};
use authros::gateway::{Fetched, HandedOver, Held, HoldingPlace, Holdings, Query, Selection, Upload};
use authros::model::{Address, Digest, Hash, Header, PublicKey, Ranges, RecorderId, Signature, Timestamp, TopicId};

use super::hostile_fellow::{HostileFellow, seen};
use super::support::gate::Gate;
use super::support::member::{Member, connect};
use super::support::{Home, count, list, wait_until};
use super::{Outcome, judge};

/// Numbers told at a time.
const TOLD: u64 = 8192;

/// Without an end: each part is of one owner who is admitted there, and one who is not.
fn endless(owner: Address, stranger: Address, place: (RecorderId, TopicId)) -> impl Fn(&HoldingPlace) -> Holdings {
    move |after| {
        let (recorder, topic_id) = place;
        let first = after.block * TOLD + 1;
        let ranges = Ranges::of((first..first + TOLD - 1).collect());
        let of = |owner, ranges| Held { owner, recorder, topic_id, ranges };
        let held = vec![of(stranger, Ranges::of(vec![1])), of(owner, ranges)];
        Holdings { held, next: HoldingPlace { block: after.block + 1, ..*after }, more: true }
    }
}

/// A record with an anchor that has the right form and is on no chain.
fn with_proof(upload: &Upload, signer: PublicKey) -> Fetched {
    let (header, _) = Header::parse(&upload.blob).expect("a record");
    let digest = Digest(provider(ProviderName::RustCrypto).sm3(&[&upload.blob]));
    let Header { owner, recorder, topic_id, seq, .. } = header;
    let root = Leaf { owner, recorder, topic_id, seq, digest }.hash();
    let inclusion = Some(Inclusion { index: 0, count: 1, path: Vec::new(), root });
    let (transaction, block_hash) = (Hash([1; 32]), Hash([2; 32]));
    let proof = AnchorProof { account: owner, transaction, block: 1, block_hash, inclusion }.encode();
    Fetched { signer, signature: upload.signature, proof, blob: upload.blob.clone() }
}

/// What is handed over: carol signed the first of these, which was never sent anywhere, and nothing else.
fn lies(carol: &Member, mallory: &Member) -> Vec<Fetched> {
    let (hers, his) = (carol.keyring.signing.clone(), mallory.keyring.signing.clone());
    let of = |member: &Member, signer: &SmKeyPair, seq| {
        with_proof(&member.record(signer, "/odom", seq, b"a message"), signer.public)
    };
    let genuine = of(carol, &hers, 1);
    vec![
        // No anchor, and one that the chain does not have.
        Fetched { proof: Vec::new(), ..genuine.clone() },
        genuine.clone(),
        // Signed by somebody without a right, by nobody, and said to be signed by another key.
        of(carol, &his, 1),
        Fetched { signature: Signature([7; 64]), ..genuine.clone() },
        Fetched { signer: his.public, ..genuine.clone() },
        // Another number than asked for, another owner's, another byte, no record.
        of(carol, &hers, 9_000_000),
        of(mallory, &his, 1),
        Fetched { blob: [&genuine.blob[..], &[0]].concat(), ..genuine.clone() },
        Fetched { blob: b"nothing".to_vec(), ..genuine },
    ]
}

#[tokio::test(flavor = "multi_thread")]
async fn feed_a_fleet_with_lies() {
    let (gate, away) = (Gate::new(), Home::new());
    let member = |name: &str| {
        away.profile(name).with(&gate.options()).enrol();
        Member::of(&away, name, gate.gateway.domain)
    };
    let (carol, mallory) = (member("carol"), member("mallory"));
    let keeper = gate.home.profile("gateway");
    keeper.json(&["gateway", "admit", &carol.address().to_string()]);
    let (topic_id, _) = carol.topic("/odom");
    let handed = lies(&carol, &mallory);
    let fellow = HostileFellow {
        holdings: Box::new(endless(carol.address(), mallory.address(), (carol.recorder, topic_id))),
        hand_over: Box::new(move |wanted| HandedOver { records: handed.clone(), next: Some(wanted.first + 1) }),
        ..HostileFellow::silent()
    };
    let (liar, server) = fellow.serve(&gate, &away, mallory.keyring.signing.clone()).await;

    let told = tokio::task::block_in_place(|| {
        wait_until(60, "the lies are noticed", || {
            let fellow = seen(&gate);
            fellow["problem"].is_string().then_some(fellow)
        })
    });
    let asked = liar.asked();
    // It is left alone now: it is not asked any more for half a minute at least, shortened at random.
    tokio::time::sleep(Duration::from_secs(3)).await;
    let later = liar.asked();
    let refused: u64 = list(&told, "refused").iter().map(|row| count(row, "count")).sum();
    let parts = list(&keeper.json(&["status"]), "health");
    let part = parts.into_iter().find(|part| part["part"] == "fleet").expect("a part");

    let credentials = carol.allocate(&gate.gateway, "scout-1").await.expect("admitted");
    let mut client = connect(&gate.gateway, &credentials).await;
    let (selection, limit) = (Selection::all(carol.address()), 500);
    let query = Query { selection, from: Timestamp(0), until: Timestamp(u64::MAX), cursor: 0, limit };
    let page = client.query(&query).await.expect("her own");
    server.stop(Duration::from_secs(2)).await;
    println!("asked {asked:?} times, then {later:?}: {told}");
    let outcome = if !page.entries.is_empty() || count(&told, "taken") > 0 {
        Outcome::Succeeded(format!("{} records taken: {told}", page.entries.len()))
    } else if asked != later || asked.iter().any(|asked| *asked > 4) {
        Outcome::Succeeded(format!("it goes on asking: {asked:?}, {later:?}"))
    } else if refused < 9 || part["level"] != "failed" || count(&told, "passed_over") != 1 {
        Outcome::Otherwise(format!("it is not told: {told} {part}"))
    } else {
        Outcome::Refused(super::support::text(&told, "problem"))
    };
    judge("feed_a_fleet_with_lies", outcome);
}

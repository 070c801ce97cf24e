//! A thief of an owner's signing key d_C, with a gateway that a fleet trusts by fingerprint, wants the owner's records to be gone
//! everywhere: states that they were erased, with d_C alone, with other records' signatures, as another owner, for another
//! chain, for records that nobody anchored, in lists without an end. Then the owner's own word, given with both keys.

use std::sync::Mutex;
use std::time::Duration;

use authros::chain::AnchorProof;
use authros::chain::merkle::{Inclusion, Leaf};
use authros::crypto::{AccountSignature, EoaSecret, ErasedStatement, Provider, SmKeyPair};
use authros::gateway::{
    Client, ErasedRecord, ErasureNotice, ErasurePlace, Erasures, Fetched, GatewayError, Standing, Upload,
};
use authros::model::{Digest, Domain, Hash, Header, RecorderId, Timestamp};
use serde_json::Value;

use super::hostile_fellow::{HostileFellow, seen};
use super::support::gate::Gate;
use super::support::member::{Member, connect};
use super::support::{Home, count, list, text, wait_until};
use super::{Outcome, judge};

const LEDGER: RecorderId = RecorderId([7; 16]);

/// What is told of a record, stated by these keys.
fn told(
    provider: &dyn Provider,
    (digest, record): (Digest, &Fetched),
    (signing, account): (&SmKeyPair, &EoaSecret),
) -> ErasureNotice {
    let about = (&digest, record.blob.as_slice());
    let when = (Digest([0x77; 32]), Timestamp::now());
    let statement = ErasedStatement::sign(provider, signing, about, when).expect("signs");
    let account_signature = statement.sign_by_account(provider, account, about).expect("signs");
    ErasureNotice { digest, account_signature, left: ErasedRecord { record: record.clone(), statement } }
}

/// A record with its public header in place of its bytes.
fn without_bytes(record: &Fetched) -> Fetched {
    let (_, length) = Header::parse(&record.blob).expect("a header");
    Fetched { blob: record.blob[..length].to_vec(), ..record.clone() }
}

/// Carol's own records, verified at the gateway: digest, and all of it.
pub async fn stored(client: &mut Client, uploads: Vec<Upload>, provider: &dyn Provider) -> Vec<(Digest, Fetched)> {
    let digests: Vec<Digest> = uploads.iter().map(|upload| Digest(provider.sm3(&[&upload.blob]))).collect();
    client.upload(uploads).await.expect("taken");
    for _ in 0..600 {
        let standings = client.check(&digests).await.expect("answered").standings();
        if standings.iter().all(|standing| *standing == Standing::Verified) {
            break;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    let mut records = Vec::new();
    for digest in digests {
        records.push((digest, client.fetch(&digest).await.expect("hers")));
    }
    records
}

/// Everything that a thief of one key can say, and what is nobody's word.
pub fn lies(carol: &Member, mallory: &Member, records: &[(Digest, Fetched)]) -> Vec<ErasureNotice> {
    let provider = carol.provider();
    let (hers, his) = (&carol.keyring, &mallory.keyring);
    let [(first, one), (second, other)] = records else { panic!("two records") };
    let (one, other) = (without_bytes(one), without_bytes(other));
    let by = |signing: &SmKeyPair, account: &EoaSecret| told(provider, (*first, &one), (signing, account));
    let genuine = by(&hers.signing, &hers.eoa);
    let of_other = told(provider, (*second, &other), (&hers.signing, &hers.eoa));
    let with = |record: Fetched| {
        let left = ErasedRecord { record, ..genuine.left.clone() };
        ErasureNotice { left, ..genuine.clone() }
    };
    // Another chain's: everything in it is signed by carol, for that one.
    let (mut header, _) = Header::parse(&one.blob).expect("a header");
    header.domain = Domain([9; 32]);
    let elsewhere = Fetched { blob: header.encode(), ..one.clone() };
    // One that is in no block.
    let unsent = carol.record(&hers.signing, "/odom", 99, b"never sent");
    let digest = Digest(provider.sm3(&[&unsent.blob]));
    let (header, length) = Header::parse(&unsent.blob).expect("a record");
    let Header { owner, recorder, topic_id, seq, .. } = header;
    let root = Leaf { owner, recorder, topic_id, seq, digest }.hash();
    let inclusion = Some(Inclusion { index: 0, count: 1, path: Vec::new(), root });
    let (transaction, block_hash) = (Hash([1; 32]), Hash([2; 32]));
    let proof = AnchorProof { account: owner, transaction, block: 1, block_hash, inclusion }.encode();
    let blob = unsent.blob[..length].to_vec();
    let unsent = Fetched { signer: hers.signing.public, signature: unsent.signature, proof, blob };
    vec![
        by(&hers.signing, &his.eoa),
        ErasureNotice { account_signature: AccountSignature([0; 65]), ..genuine.clone() },
        by(&his.signing, &hers.eoa),
        by(&his.signing, &his.eoa),
        ErasureNotice { digest: *first, ..of_other.clone() },
        ErasureNotice { account_signature: of_other.account_signature, ..genuine.clone() },
        ErasureNotice { left: of_other.left.clone(), ..genuine.clone() },
        with(Fetched { proof: Vec::new(), ..one.clone() }),
        with(Fetched { proof: other.proof.clone(), ..one.clone() }),
        told(provider, (*first, &elsewhere), (&hers.signing, &hers.eoa)),
        told(provider, (digest, &unsent), (&hers.signing, &hers.eoa)),
    ]
}

/// Again and again the same lies, on ever further pages.
fn without_end(lies: Vec<ErasureNotice>) -> impl Fn(&ErasurePlace) -> Erasures {
    move |after| {
        let next = ErasurePlace { ledger: LEDGER, number: after.number + 1 };
        Erasures { told: lies.clone(), next, more: true }
    }
}

fn noticed(gate: &Gate, what: &str) -> Value {
    tokio::task::block_in_place(|| {
        wait_until(60, "it is noticed", || {
            let fellow = seen(gate);
            fellow["problem"].as_str().is_some_and(|problem| problem.contains(what)).then_some(fellow)
        })
    })
}

#[tokio::test(flavor = "multi_thread")]
async fn erase_a_fleet_with_one_key() {
    let (gate, away) = (Gate::new(), Home::new());
    let member = |name: &str| {
        away.profile(name).with(&gate.options()).enrol();
        Member::of(&away, name, gate.gateway.domain)
    };
    let (carol, mallory) = (member("carol"), member("mallory"));
    let keeper = gate.home.profile("gateway");
    keeper.json(&["gateway", "admit", &carol.address().to_string()]);
    let credentials = carol.allocate(&gate.gateway, "scout-1").await.expect("admitted");
    let mut client = connect(&gate.gateway, &credentials).await;
    let upload = |seq, body: &[u8]| carol.record(&carol.keyring.signing, "/odom", seq, body);
    let records = stored(&mut client, vec![upload(1, b"a face"), upload(2, b"another one")], carol.provider()).await;

    let fellow =
        HostileFellow { erasures: Box::new(without_end(lies(&carol, &mallory, &records))), ..HostileFellow::silent() };
    let (fellow, server) = fellow.serve(&gate, &away, mallory.keyring.signing.clone()).await;
    let told = noticed(&gate, "it says were erased do not hold");
    let asked = fellow.asked();
    // It is left alone now, for half a minute at least, shortened at random.
    tokio::time::sleep(Duration::from_secs(3)).await;
    let later = fellow.asked();
    let mut lost = Vec::new();
    for (digest, record) in &records {
        if client.fetch(digest).await.ok().as_ref() != Some(record) {
            lost.push(digest.to_string());
        }
    }
    let parts = list(&keeper.json(&["status"]), "health");
    let part = parts.into_iter().find(|part| part["part"] == "fleet").expect("a part");
    server.stop(Duration::from_secs(2)).await;
    println!("asked {asked:?} times, then {later:?}: {told}");

    // The same gateway with lists that stand still, and then with the owner's own word.
    keeper.json(&["fleet", "remove", &text(&told, "address")]);
    let stands = HostileFellow {
        erasures: Box::new(|_| Erasures {
            told: Vec::new(),
            next: ErasurePlace { ledger: LEDGER, number: 1 },
            more: true,
        }),
        ..HostileFellow::silent()
    };
    let folder = Home::new();
    let (_, server) = stands.serve(&gate, &folder, mallory.keyring.signing.clone()).await;
    let still = noticed(&gate, "does not advance");
    server.stop(Duration::from_secs(2)).await;
    keeper.json(&["fleet", "remove", &text(&still, "address")]);
    let hers = (&carol.keyring.signing, &carol.keyring.eoa);
    let honest = told_once(told_of(&carol, &records[0], hers));
    let folder = Home::new();
    let (_, server) = HostileFellow { erasures: Box::new(honest), ..HostileFellow::silent() }
        .serve(&gate, &folder, mallory.keyring.signing.clone())
        .await;
    let erased = tokio::task::block_in_place(|| {
        wait_until(60, "her own word is obeyed", || {
            let fellow = seen(&gate);
            (count(&fellow, "erased") == 1).then_some(fellow)
        })
    });
    let mut gone = false;
    for _ in 0..100 {
        gone = matches!(client.fetch(&records[0].0).await, Err(GatewayError::Erased(_)));
        if gone {
            break;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    server.stop(Duration::from_secs(2)).await;
    let lines = list(&keeper.json(&["audit", "list", "--action", "fleet erase"]), "audit");
    let refused: u64 = list(&told, "refused").iter().map(|row| count(row, "count")).sum();
    let outcome = if !lost.is_empty() || count(&told, "erased") > 0 {
        Outcome::Succeeded(format!("{lost:?} gone: {told}"))
    } else if asked != later || asked[2] > 8 {
        Outcome::Succeeded(format!("it goes on asking: {asked:?}, {later:?}"))
    } else if refused < 16 || part["level"] != "failed" || !gone || lines.len() != 1 {
        Outcome::Otherwise(format!("{refused} refused, {part}, {erased}, gone: {gone}, {lines:?}"))
    } else {
        Outcome::Refused(text(&told, "problem"))
    };
    judge("erase_a_fleet_with_one_key", outcome);
}

pub fn told_of(carol: &Member, (digest, record): &(Digest, Fetched), keys: (&SmKeyPair, &EoaSecret)) -> ErasureNotice {
    told(carol.provider(), (*digest, &without_bytes(record)), keys)
}

fn told_once(erasure: ErasureNotice) -> impl Fn(&ErasurePlace) -> Erasures {
    let left = Mutex::new(vec![erasure]);
    move |_| {
        let told = std::mem::take(&mut *left.lock().expect("not poisoned"));
        Erasures { told, next: ErasurePlace { ledger: LEDGER, number: 1 }, more: false }
    }
}

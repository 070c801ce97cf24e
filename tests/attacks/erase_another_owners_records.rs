//! An owner whom a gateway admits wants another owner's records gone: he tells the gateway that they were erased, in his own
//! session and in one that he stole from her together with her d_C. Then she tells it herself, with both her keys.

use std::time::Duration;

use authros::chain::AnchorProof;
use authros::chain::merkle::{Inclusion, Leaf};
use authros::crypto::{AccountSignature, EoaSecret, ErasedStatement, Provider, SmKeyPair};
use authros::gateway::{
    Client, Code, ErasedRecord, ErasureNotice, ErasureOutcome, Feed, Fetched, GatewayError, Upload,
};
use authros::model::{Address, Digest, Domain, Hash, Header, Timestamp};

use super::support::gate::Gate;
use super::support::member::{Member, connect, until_verified};
use super::support::{Home, list};
use super::{Outcome, judge};

/// That a record was erased, stated by these keys.
fn notice(
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
async fn stored(
    client: &mut Client,
    carol: Address,
    uploads: Vec<Upload>,
    provider: &dyn Provider,
) -> Vec<(Digest, Fetched)> {
    let digests: Vec<Digest> = uploads.iter().map(|upload| Digest(provider.sm3(&[&upload.blob]))).collect();
    client.upload(uploads).await.expect("taken");
    until_verified(client, Feed::of(carol), &digests).await;
    let mut records = Vec::new();
    for digest in digests {
        records.push((digest, client.fetch(&digest).await.expect("hers")));
    }
    records
}

/// Everything that a thief of one key can say, and what is nobody's word.
fn lies(carol: &Member, mallory: &Member, records: &[(Digest, Fetched)]) -> Vec<ErasureNotice> {
    let provider = carol.provider();
    let (hers, his) = (&carol.keyring, &mallory.keyring);
    let [(first, one), (second, other)] = records else { panic!("two records") };
    let (one, other) = (without_bytes(one), without_bytes(other));
    let by = |signing: &SmKeyPair, account: &EoaSecret| notice(provider, (*first, &one), (signing, account));
    let genuine = by(&hers.signing, &hers.eoa);
    let of_other = notice(provider, (*second, &other), (&hers.signing, &hers.eoa));
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
    let owner = header.owner;
    let root = Leaf::of(&header, digest).hash();
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
        with(Fetched { proof: vec![9], ..one.clone() }),
        with(Fetched { proof: other.proof.clone(), ..one.clone() }),
        notice(provider, (*first, &elsewhere), (&hers.signing, &hers.eoa)),
        notice(provider, (digest, &unsent), (&hers.signing, &hers.eoa)),
    ]
}

fn notice_of(carol: &Member, (digest, record): &(Digest, Fetched), keys: (&SmKeyPair, &EoaSecret)) -> ErasureNotice {
    notice(carol.provider(), (*digest, &without_bytes(record)), keys)
}

#[tokio::test(flavor = "multi_thread")]
async fn erase_another_owners_records() {
    let (gate, away) = (Gate::new(), Home::new());
    let keeper = gate.home.profile("gateway");
    let member = |name: &str| {
        away.profile(name).with(&gate.options()).enrol();
        let member = Member::of(&away, name, gate.gateway.domain);
        keeper.json(&["gateway", "allow", &member.address().to_string()]);
        member
    };
    let (carol, mallory) = (member("carol"), member("mallory"));
    let (hers, his) = ((&carol.keyring.signing, &carol.keyring.eoa), &mallory.keyring.eoa);
    let stolen = carol.allocate(&gate.gateway, "scout-1").await.expect("admitted");
    let own = mallory.allocate(&gate.gateway, "scout-2").await.expect("admitted");
    let (mut as_her, mut as_himself) = (connect(&gate.gateway, &stolen).await, connect(&gate.gateway, &own).await);
    let upload = |seq, body: &[u8]| carol.record(&carol.keyring.signing, "/odom", seq, body);
    let records =
        stored(&mut as_her, carol.address(), vec![upload(1, b"a face"), upload(2, b"another one")], carol.provider())
            .await;

    // In his own session nothing of hers is heard, whoever signed it.
    let mut wrong = Vec::new();
    for keys in [hers, (&carol.keyring.signing, his), (&mallory.keyring.signing, his)] {
        match as_himself.erase(vec![notice_of(&carol, &records[0], keys)]).await {
            Err(GatewayError::Refused(Code::NotAuthorised)) => {}
            other => wrong.push(format!("in his own session: {other:?}")),
        }
    }
    // In hers, with d_C and without her account. What says that it is another owner's is none of hers.
    let mut refused = 0;
    for lie in lies(&carol, &mallory, &records) {
        match as_her.erase(vec![lie]).await {
            Ok(outcomes) if outcomes == [ErasureOutcome::Refused] => refused += 1,
            other => wrong.push(format!("in her session: {other:?}")),
        }
    }
    let mut kept = true;
    for (digest, record) in &records {
        kept &= as_her.fetch(digest).await.ok().as_ref() == Some(record);
    }
    let audit = || list(&keeper.json(&["audit", "list", "--action", "gateway erase"]), "audit");
    let before = audit();

    let word = as_her.erase(vec![notice_of(&carol, &records[0], hers)]).await;
    let mut gone = false;
    for _ in 0..100 {
        gone = matches!(as_her.fetch(&records[0].0).await, Err(GatewayError::Erased(_)));
        if gone {
            break;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    let outcome = if !kept || !before.is_empty() {
        Outcome::Succeeded(format!("records are gone: {before:?} {wrong:?}"))
    } else if !wrong.is_empty() || !gone || audit().len() != 1 {
        Outcome::Otherwise(format!("{wrong:?}; her own word: {word:?}, gone: {gone}, {:?}", audit()))
    } else {
        Outcome::Refused(format!("NotAuthorised in his session, {refused} lies refused in hers"))
    };
    judge("erase_another_owners_records", outcome);
}

//! A reader who never had a record that its owner erased: only the owner's word says so, and no gateway's.

use std::time::Duration;

use super::keeping::{elsewhere, proof_of, taken_with};
use super::*;
use crate::chain::AnchorProof;
use crate::crypto::{ErasedStatement, SealedRecord, SmKeyPair};
use crate::gateway::{ErasedRecord, Fetched};
use crate::model::{Address, Header, Verdict};
use crate::pipeline::PipelineError;
use crate::pipeline::intake::{Accepted, Anchors, Intake};
use crate::pipeline::reader::Reader;
use crate::pipeline::verifier::verify_round;
use crate::store::{NewRecord, RootSighting, StatedErasure, ToldErased};

const REPORT: Digest = Digest([0x77; 32]);
const AT: Timestamp = Timestamp(1_700_000_000_000_000_000);

async fn line() -> Line {
    let line = Line::new().await;
    let plant = Plant { observer: Arc::new(super::super::fixture::Notes::default()), ..line.plant };
    let line = Line { plant, ..line };
    line.owner.prepare_epoch(line.network.domain, 1).expect("prepared");
    line.owner.seal_under(line.network.domain, 1).expect("seals");
    line
}

fn header_of(sealed: &SealedRecord) -> &[u8] {
    let (_, length) = Header::parse(&sealed.blob).expect("a header");
    &sealed.blob[..length]
}

fn stated(line: &Line, by: &SmKeyPair, digest: &Digest, header: &[u8]) -> ErasedStatement {
    ErasedStatement::sign(line.plant.provider, by, (digest, header), (REPORT, AT)).expect("signs")
}

/// What an honest gateway has left of a record that was anchored alone in its batch and erased.
async fn left(line: &Line, sealed: &SealedRecord) -> ErasedRecord {
    let proof = proof_of(line, sealed).await;
    let (signing, header) = (line.owner.signing(), header_of(sealed));
    let statement = stated(line, &signing, &sealed.digest, header);
    let record = Fetched { signer: signing.public, signature: sealed.signature, proof, blob: header.to_vec() };
    ErasedRecord { record, statement }
}

async fn take(line: &Line, owner: Address, digest: Digest, erased: ErasedRecord) -> Result<Accepted, PipelineError> {
    let (plant, network, keeper, patience) = (&line.plant, &line.network, Address([8; 20]), Duration::ZERO);
    let anchors = Anchors::default();
    let intake = Intake { plant, network, anchors: &anchors, keeper, patience };
    intake.accept_erased(&line.owner, owner, digest, erased).await
}

fn is_held(taken: &Result<Accepted, PipelineError>, changed: bool) -> bool {
    matches!(taken, Ok(Accepted::Held(found)) if *found == changed)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_an_owner_states_to_be_erased_is_listed_with_its_proof() {
    let line = line().await;
    let (owner, sealed) = (line.owner.address, elsewhere(&line.owner, 1, b"a face", None));
    let (digest, ledger) = (sealed.digest, &line.plant.ledger);
    let erased = left(&line, &sealed).await;
    assert!(is_held(&take(&line, owner, digest, erased.clone()).await, true));
    assert!(is_held(&take(&line, owner, digest, erased).await, false), "twice is once");
    let noted = line.plant.ledger.records.find(digest).expect("read").expect("noted");
    let reader = Reader { plant: &line.plant, network: &line.network, reader: &line.owner };
    assert_eq!(reader.check(&noted).await.expect("checked"), (Verdict::Unanchored, digest), "not confirmed here yet");
    for _ in 0..20 {
        line.watch().await;
        verify_round(&line.plant, &line.network).expect("a round");
        if ledger.records.find(digest).expect("read").is_some_and(|row| row.state == RecordState::Verified) {
            break;
        }
    }
    let row = ledger.records.find(digest).expect("read").expect("noted");
    assert_eq!((row.state, row.deleted_at), (RecordState::Verified, Some(AT)), "{row:?}");
    assert_eq!((row.seq, row.captured_at, row.bytes), (1, Timestamp(1), 6), "as its header says");
    let retained = ledger.retention.find(digest).expect("read").expect("accounted for");
    let words = retained.erased.expect("by somebody").to_string();
    assert_eq!(words, "erased 2023-11-14T22:13:20Z by its owner, its proof remains");
    assert_eq!(reader.check(&row).await.expect("checked"), (Verdict::Deleted, digest));
    let opened = reader.open(&row).await;
    assert!(matches!(opened, Err(PipelineError::Erased { .. })), "{opened:?}");
    assert_eq!(ledger.retention.given_up(owner), Ok(1));

    // An altered ledger makes no erasure of a hole: the statement is checked each time.
    let thief = SmKeyPair::generate(line.plant.provider).expect("a pair");
    let forged = stated(&line, &thief, &digest, header_of(&sealed)).encode();
    let forged = StatedErasure { digest, statement: forged, account: None };
    ledger.erasures.keep(vec![forged]).expect("written");
    assert_eq!(reader.check(&row).await.expect("checked"), (Verdict::Missing, digest));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_a_gateway_says_was_erased_is_not_believed() {
    let line = line().await;
    let (owner, sealed) = (line.owner.address, elsewhere(&line.owner, 1, b"a face", None));
    let (digest, header) = (sealed.digest, header_of(&sealed));
    let honest = left(&line, &sealed).await;
    let with = |record: Fetched| ErasedRecord { record, ..honest.clone() };
    let says = |statement| ErasedRecord { statement, ..honest.clone() };
    let own = line.owner.signing();
    let keeper = SmKeyPair::generate(line.plant.provider).expect("a pair");
    let other = Header { captured_at: Timestamp(9), ..sealed.header.clone() }.encode();
    let lies = [
        ("the gateway's own word", says(stated(&line, &keeper, &digest, header))),
        ("the owner's word on another record", says(stated(&line, &own, &Digest([1; 32]), header))),
        ("another retention record", says(ErasedStatement { report: Digest([1; 32]), ..honest.statement })),
        ("another time", says(ErasedStatement { at: Timestamp(1), ..honest.statement })),
        ("another header", with(Fetched { blob: other, ..honest.record.clone() })),
        ("the whole record", with(Fetched { blob: sealed.blob.clone(), ..honest.record.clone() })),
        ("no header", with(Fetched { blob: b"nothing".to_vec(), ..honest.record.clone() })),
        ("another signature", with(Fetched { signature: Signature([7; 64]), ..honest.record.clone() })),
        ("no proof", with(Fetched { proof: vec![9], ..honest.record.clone() })),
        ("half a proof", with(Fetched { proof: honest.record.proof[..99].to_vec(), ..honest.record.clone() })),
    ];
    for (what, lie) in lies {
        let told = take(&line, owner, digest, lie).await;
        assert!(matches!(told, Ok(Accepted::Refused(_))), "{what}: {told:?}");
        assert_eq!(line.plant.ledger.records.find(digest).expect("read"), None, "{what}");
    }
    let told = take(&line, Address([1; 20]), digest, honest.clone()).await;
    assert!(matches!(told, Ok(Accepted::Refused(_))), "another owner's: {told:?}");
    // The proof of another record.
    let second = elsewhere(&line.owner, 2, b"a wall", None);
    let proof = left(&line, &second).await.record.proof;
    let told = take(&line, owner, digest, with(Fetched { proof, ..honest.record.clone() })).await;
    assert!(matches!(told, Ok(Accepted::Refused(_))), "{told:?}");
    assert_eq!(line.plant.ledger.records.find(digest).expect("read"), None);

    // Who has the bytes keeps them.
    assert!(is_held(&taken_with(&line, sealed.clone(), honest.record.proof.clone()).await, true));
    assert!(is_held(&take(&line, owner, digest, honest).await, false), "nothing to do");
    let row = line.plant.ledger.records.find(digest).expect("read").expect("here");
    assert_eq!(row.deleted_at, None);
    assert_eq!(line.plant.ciphertext.get(digest).expect("read"), Some(sealed.blob));
}

/// A robot brings a record in the very moment in which its owner tells that she had it erased.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn bytes_that_arrive_while_they_are_erased_do_not_stay() {
    let line = line().await;
    let (plant, sealed) = (&line.plant, elsewhere(&line.owner, 1, b"a face", None));
    let (digest, ledger) = (sealed.digest, &line.plant.ledger);
    let ErasedRecord { record, statement } = left(&line, &sealed).await;
    let proof = AnchorProof::parse(&record.proof).expect("a proof");
    let AnchorProof { account, transaction, block, block_hash, inclusion } = proof;
    let inclusion = inclusion.expect("in a batch");
    let (root, count) = (inclusion.root, inclusion.count);
    let anchor = RootSighting { account, root, count, transaction, block, block_hash };
    let brought = NewRecord::foreign(sealed.clone(), Address([8; 20]));
    let listed = NewRecord { blob: None, ..brought.clone() };
    let taken = crate::pipeline::intake::taken_erased(record.blob, &statement);
    let kept = plant.keep([brought], |rows| {
        let told = ledger.erasures.take_told(listed, (taken, vec![1; 65]), (inclusion, anchor))?;
        assert_eq!(told, ToldErased::Listed);
        ledger.records.append(rows.into())
    });
    kept.expect("acknowledged");
    assert_eq!(plant.ciphertext.get(digest), Ok(None));
    let row = ledger.records.find(digest).expect("read").expect("listed");
    assert_eq!(row.deleted_at, Some(AT));
}

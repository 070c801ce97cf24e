//! Row and place of a record are compared as of one moment, however old the row is that is asked for, and its proof is of
//! the anchor that it rests on.

use super::keeping::{elsewhere, taken, taken_with};
use super::*;
use crate::chain::AnchorProof;
use crate::chain::merkle::Inclusion;
use crate::model::{Address, Hash};
use crate::pipeline::chain_proofs::anchor_proof;
use crate::pipeline::columns::{Comparison, Heads};
use crate::pipeline::intake::Accepted;
use crate::pipeline::reader::Reader;
use crate::store::{NewBatch, NewRecord, RootSighting, Sighting};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_record_that_another_line_proved_meanwhile_is_not_called_altered() {
    let line = Line::new().await;
    line.owner.prepare_epoch(line.network.domain, 1).expect("prepared");
    line.owner.seal_under(line.network.domain, 1).expect("seals");
    line.watch().await;
    let sealed = elsewhere(&line.owner, 1, b"where it is", None);
    let digest = sealed.digest;
    let row = NewRecord::foreign(sealed.clone(), Address([8; 20]));
    line.plant.keep([row], |row| line.plant.ledger.records.append(row.into())).expect("taken");
    let before = line.plant.ledger.records.find(digest).expect("read").expect("there");

    // The line to another gateway brings its proof.
    let head = line.network.chain.head().await.expect("a head");
    let root = before.leaf().hash();
    let inclusion = Inclusion { index: 0, count: 1, path: Vec::new(), root };
    let (account, transaction) = (Address([8; 20]), Hash([9; 32]));
    let anchor = RootSighting { account, root, count: 1, transaction, block: head.number, block_hash: head.hash };
    assert_eq!(line.plant.ledger.batches.take_in(digest, inclusion, anchor), Ok(true));

    // As the first line asks for it: by its own proof's block, and with the row of before.
    let reader = Reader { plant: &line.plant, network: &line.network, reader: &line.owner };
    for asked in [before.clone(), RecordRow { block: Some(head.number), ..before.clone() }] {
        let opened = reader.open_bytes(&asked, &sealed.blob).await;
        assert!(opened.is_ok(), "{:?}", opened.err());
    }
    let keys = &reader;
    let comparison = Comparison { plant: &line.plant, keys, heads: &Heads::default(), filters: &[] };
    for asked in [before.clone(), RecordRow { block: Some(head.number), ..before }] {
        let shown = comparison.of(vec![asked]).expect("compared").remove(0);
        assert_eq!((shown.differs, shown.row.block), (None, Some(head.number)), "as it is now");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_record_in_a_batch_and_uploaded_alone_is_proven_by_the_anchor_it_rests_on() {
    let line = Line::new().await;
    line.owner.prepare_epoch(line.network.domain, 1).expect("prepared");
    line.owner.seal_under(line.network.domain, 1).expect("seals");
    line.watch().await;
    let sealed = elsewhere(&line.owner, 1, b"where it is", None);
    let (digest, owner) = (sealed.digest, line.owner.address);
    let proof = || anchor_proof(line.plant.ledger.records.placed(digest).expect("read").expect("here"));
    let held = taken(&line, sealed.clone()).await.expect("taken in");
    assert!(matches!(held, Accepted::Held(true)), "{held:?}");
    let of_batch = proof().expect("in a block");
    assert!(of_batch.inclusion.is_some(), "{of_batch:?}");

    let call = Call::DataUpload { digest, token: Token([1; 32]), timestamp: Timestamp(1) };
    let sent = line.sender.send(&line.network.chain, &line.owner.eoa(), call, "dataUpload").await;
    let (transaction, receipt) = sent.expect("uploaded");
    line.watch().await;
    let alone = proof().expect("in a block");
    let (block, block_hash) = (receipt.block, receipt.block_hash);
    assert_eq!(alone, AnchorProof { account: owner, transaction, block, block_hash, inclusion: None });
    let held = taken_with(&line, sealed.clone(), alone.encode()).await.expect("judged");
    assert!(matches!(held, Accepted::Held(false)), "a reader finds it on the chain: {held:?}");

    line.plant.ledger.batches.take_back(block).expect("replaced");
    assert_eq!(proof(), Some(of_batch), "its batch is in an older block");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_record_whose_upload_and_batch_are_in_one_block_is_not_called_altered() {
    let line = Line::new().await;
    line.owner.prepare_epoch(line.network.domain, 1).expect("prepared");
    line.owner.seal_under(line.network.domain, 1).expect("seals");
    line.watch().await;
    let sealed = elsewhere(&line.owner, 1, b"twice in one block", None);
    let (digest, owner, account) = (sealed.digest, line.owner.address, Address([8; 20]));
    let row = NewRecord::foreign(sealed, account);
    line.plant.keep([row], |row| line.plant.ledger.records.append(row.into())).expect("taken");
    let row = line.plant.ledger.records.find(digest).expect("read").expect("there");
    let (root, batches) = (row.leaf().hash(), &line.plant.ledger.batches);
    batches.close(NewBatch { owner: account, root, leaves: vec![(digest, Vec::new())] }).expect("closed");

    let head = line.network.chain.head().await.expect("a head");
    let (block, block_hash, transaction) = (head.number, head.hash, Hash([9; 32]));
    let alone = Sighting { owner, digest, transaction: Hash([7; 32]), block, block_hash };
    assert_eq!(batches.mined(&[alone]), Ok(1));
    let seen = RootSighting { account, root, count: 1, transaction, block, block_hash };
    assert_eq!(batches.anchored(&[seen]), Ok(1));

    let keys = &Reader { plant: &line.plant, network: &line.network, reader: &line.owner };
    let comparison = Comparison { plant: &line.plant, keys, heads: &Heads::default(), filters: &[] };
    let shown = comparison.of(vec![row]).expect("compared").remove(0);
    assert_eq!((shown.differs, shown.row.block), (None, Some(block)));
    let proof = anchor_proof(line.plant.ledger.records.placed(digest).expect("read").expect("here"));
    let proof = proof.expect("in a block");
    assert_eq!((proof.account, proof.transaction, proof.inclusion.is_some()), (account, transaction, true));
}

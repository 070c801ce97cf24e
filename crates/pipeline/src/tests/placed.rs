//! Row and place of a record are compared as of one moment, however old the row is that is asked for.

use super::keeping::elsewhere;
use super::*;
use crate::chain::merkle::Inclusion;
use crate::model::{Address, Hash};
use crate::pipeline::columns::{Comparison, Heads};
use crate::pipeline::reader::Reader;
use crate::store::{NewRecord, RootSighting};

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

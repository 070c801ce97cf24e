//! Reorgs: the chain's folder is copied, and the copy continues differently.

use std::path::Path;

use super::*;
use crate::chain::{Call, ChainError};
use crate::crypto::EoaSecret;
use crate::model::{Digest, RecordState, SignerId};
use crate::pipeline::fixture::{Process, by_hand, digest, embedded, identity, network};

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).expect("folder");
    for entry in std::fs::read_dir(from).expect("folder") {
        let path = entry.expect("entry").path();
        std::fs::copy(&path, to.join(path.file_name().expect("name"))).expect("copied");
    }
}

/// A process whose chain can continue in two ways from here: as it is, and in the second folder.
async fn fork(mut process: Process, home: &Path) -> Process {
    let pin = process.network.chain.pin();
    let elsewhere = embedded(&home.join("nowhere"), None).await;
    process.network.chain = elsewhere;
    // Once it can be opened again, nobody writes to the file any more.
    let again = embedded(&home.join("a"), pin).await;
    copy(&home.join("a"), &home.join("b"));
    process.network.chain = again;
    process
}

/// The other continuation of the chain: `blocks` blocks by a stranger.
async fn other_way(process: &Process, home: &Path, blocks: u64) -> crate::chain::Chain {
    let chain = embedded(&home.join("b"), process.network.chain.pin()).await;
    let stranger = EoaSecret::generate().expect("key");
    by_hand(&chain, &stranger, &identity(&chain, &stranger)).await;
    for number in 1..blocks {
        let device = SignerId([u8::try_from(number % 250).expect("small") + 1; 32]);
        by_hand(&chain, &stranger, &Call::Lend { device, until: None }).await;
    }
    chain
}

fn digests(numbers: std::ops::Range<u64>) -> Vec<Digest> {
    numbers.map(digest).collect()
}

async fn reorg_of(depth: u64) {
    let home = tempfile::tempdir().expect("folder");
    let process = Process::on_embedded(&home.path().join("a")).await;
    process.store(0..2);
    process.anchor(2).await;
    process.rounds_until("the first are confirmed", |process| process.count(RecordState::Confirmed) == 2).await;
    let mut process = fork(process, home.path()).await;
    let newcomer = EoaSecret::generate().expect("key");
    by_hand(&process.network.chain, &newcomer, &identity(&process.network.chain, &newcomer)).await;
    process.store(2..2 + depth);
    for number in 0..depth {
        process.anchor(1).await;
        process
            .rounds_until("one more is in a block", |process| process.count(RecordState::Confirmed) == 3 + number)
            .await;
    }
    process
        .rounds_until("the lane is empty", |process| process.sender.room(process.eoa.address()).ok() == Some(1024))
        .await;
    let verified = digests(0..2 + depth / 2);
    process.plant.ledger.records.advance(&verified, RecordState::Confirmed, RecordState::Verified).expect("verified");
    assert!(process.network.directory.identity(newcomer.address()).is_ok());

    process.network.chain = other_way(&process, home.path(), depth + 2).await;
    watch_round(&process.plant, &process.network).await.expect("goes back");
    assert_eq!(process.count(RecordState::Submitted), depth, "their transactions are open again");
    assert_eq!((process.count(RecordState::Verified), process.count(RecordState::Mined)), (2, 0));
    assert!(process.network.directory.identity(newcomer.address()).is_err(), "never registered on this chain");
    assert!(process.network.directory.identity(process.eoa.address()).is_ok());
    let told = process.notes.all();
    assert!(told.iter().any(|(urgent, text)| *urgent && text.contains("replaced its last")), "{told:?}");
    assert_eq!(process.notes.with("verified before"), usize::from(depth > 1));
    process
        .rounds_until("all are anchored again", |process| {
            process.count(RecordState::Confirmed) == depth && process.count(RecordState::Verified) == 2
        })
        .await;
    let total = usize::try_from(2 + depth).expect("small");
    assert_eq!(process.anchored(0..2 + depth).await, vec![1; total]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reorg_of_one_block() {
    reorg_of(1).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reorg_of_eight_blocks() {
    reorg_of(8).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reorg_of_sixty_four_blocks() {
    reorg_of(64).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reorg_while_the_directory_is_lost_is_noticed_all_the_same() {
    let home = tempfile::tempdir().expect("folder");
    let process = Process::on_embedded(&home.path().join("a")).await;
    let mut process = fork(process, home.path()).await;
    process.store(0..3);
    process.anchor(3).await;
    process.rounds_until("they are confirmed", |process| process.count(RecordState::Confirmed) == 3).await;
    let chain = other_way(&process, home.path(), 6).await;
    process.plant.ledger.rights.forget_rights().expect("lost");
    process.network = network(chain);
    restore(&process.plant, &process.network).expect("restores");
    watch_round(&process.plant, &process.network).await.expect("goes back");
    assert_eq!(process.count(RecordState::Confirmed), 0);
    process.rounds_until("all are anchored again", |process| process.count(RecordState::Confirmed) == 3).await;
    assert_eq!(process.anchored(0..3).await, [1, 1, 1]);
    assert!(process.network.directory.identity(process.eoa.address()).is_ok());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reorg_before_blocks_are_read_again_is_noticed_all_the_same() {
    let home = tempfile::tempdir().expect("folder");
    let process = Process::on_embedded(&home.path().join("a")).await;
    let mut process = fork(process, home.path()).await;
    let common = process.network.chain.head().await.expect("head").number;
    process.store(0..3);
    process.anchor(3).await;
    process.rounds_until("they are confirmed", |process| process.count(RecordState::Confirmed) == 3).await;
    // An event was missed: the cursor goes back, and the process ends before it reads on.
    note(&process.plant.ledger.notes, common + 1).expect("noted");
    let head = process.network.chain.head().await.expect("head").number;
    reorg::look(&process.plant, &process.network, head).await.expect("goes back");
    let cursor = process.plant.ledger.trail.cursor().expect("read");
    assert!(cursor.is_some_and(|(number, _)| number <= common), "{cursor:?}");

    process.network.chain = other_way(&process, home.path(), 6).await;
    watch_round(&process.plant, &process.network).await.expect("goes back");
    let counts = [RecordState::Submitted, RecordState::Confirmed].map(|state| process.count(state));
    assert_eq!(counts, [3, 0], "nothing rests on a block that is gone");
    process.rounds_until("all are anchored again", |process| process.count(RecordState::Confirmed) == 3).await;
    assert_eq!(process.anchored(0..3).await, [1, 1, 1]);
}

#[tokio::test(flavor = "multi_thread")]
async fn another_chain_stops_everything_and_changes_nothing() {
    let home = tempfile::tempdir().expect("folder");
    let mut process = Process::on_embedded(&home.path().join("a")).await;
    process.store(0..2);
    process.anchor(2).await;
    process.rounds_until("they are confirmed", |process| process.count(RecordState::Confirmed) == 2).await;
    let cursor = process.plant.ledger.trail.cursor();
    let own = process.network.chain.clone();
    let other = Process::on_embedded(&home.path().join("b")).await;
    // The connection is the same and knows its pin; behind it is another chain.
    process.network.chain = other.network.chain.pretending(own.pin().expect("pinned"));
    let error = watch_round(&process.plant, &process.network).await.expect_err("another chain");
    assert!(matches!(error, PipelineError::Chain(ChainError::Swapped { what: "chain id", .. })), "{error}");
    assert!(error.to_string().contains("authros --home NEW records import OLD"), "{error}");
    assert_eq!(process.count(RecordState::Confirmed), 2);
    assert_eq!(process.plant.ledger.trail.cursor(), cursor);
    process.network.chain = own;
    watch_round(&process.plant, &process.network).await.expect("the pinned chain is back");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_process_beside_the_holder_knows_what_it_has_read_goes_back_with_it_and_takes_over() {
    let home = tempfile::tempdir().expect("folder");
    let process = Process::on_embedded(&home.path().join("a")).await;
    let mut process = fork(process, home.path()).await;
    let (mut follower, mut beside) = (Follower::default(), network(process.network.chain.clone()));
    let newcomer = EoaSecret::generate().expect("key");
    by_hand(&process.network.chain, &newcomer, &identity(&process.network.chain, &newcomer)).await;
    let known = |beside: &Network| beside.directory.identity(newcomer.address()).is_ok();
    let read = follower.round(&process.plant, &beside).await.expect("reads the store");
    assert!(read.is_none() && !known(&beside), "the holder has not read the newest block");
    let head = watch_round(&process.plant, &process.network).await.expect("reads the chain");
    let read = follower.round(&process.plant, &beside).await.expect("reads the store");
    assert_eq!((read.map(|read| read.hash), known(&beside)), (Some(head.hash), true));
    // An event of a block after that is taken alone.
    let device = SignerId([7; 32]);
    by_hand(&process.network.chain, &newcomer, &Call::Lend { device, until: None }).await;
    watch_round(&process.plant, &process.network).await.expect("reads the chain");
    assert!(follower.round(&process.plant, &beside).await.expect("reads the store").is_some());
    let loans = beside.directory.account(newcomer.address()).map(|account| account.devices.len());
    assert_eq!(loans, Some(1));

    process.network.chain = other_way(&process, home.path(), 6).await;
    beside.chain = process.network.chain.clone();
    let read = follower.round(&process.plant, &beside).await.expect("reads the store");
    assert!(read.is_none() && known(&beside), "the holder does not know the other chain");
    watch_round(&process.plant, &process.network).await.expect("goes back");
    assert!(follower.round(&process.plant, &beside).await.expect("reads the store").is_some() && !known(&beside));
    assert!(beside.directory.identity(process.eoa.address()).is_ok());

    let other = EoaSecret::generate().expect("key");
    by_hand(&beside.chain, &other, &identity(&beside.chain, &other)).await;
    take_over(&process.plant, &beside).expect("begins where the holder ended");
    watch_round(&process.plant, &beside).await.expect("reads on");
    assert!(beside.directory.identity(other.address()).is_ok());
}

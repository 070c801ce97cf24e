//! The crate as others use it, on the embedded chain.

mod lagging;

use std::path::Path;
use std::time::{Duration, Instant};

use super::*;
use crate::crypto::EoaSecret;
use crate::model::{ErrorKind, Identity, PublicKey, Signature, Timestamp, Token};

fn embedded(directory: &Path) -> ChainOptions {
    let endpoint = Endpoint::Embedded { directory: directory.to_owned(), consensus: None };
    ChainOptions { endpoint, contract: None, pinned: None }
}

fn node(url: &str) -> ChainOptions {
    ChainOptions { endpoint: Endpoint::Node { url: url.into(), roots: None }, ..embedded(Path::new("")) }
}

fn register(number: u8) -> Call {
    let key = PublicKey([number; 64]);
    let identity = Identity { token: Token([number; 32]), signing: key, envelope: key, proof: Signature([1; 64]) };
    Call::Register { identity, envelope: Vec::new() }
}

fn upload(number: u64, token: u8) -> Call {
    let mut digest = [0; 32];
    digest[..8].copy_from_slice(&(number + 1).to_be_bytes());
    Call::DataUpload { digest: Digest(digest), token: Token([token; 32]), timestamp: Timestamp(number) }
}

async fn mined(chain: &Chain, hash: Hash) -> Receipt {
    let deadline = Instant::now() + Duration::from_secs(30);
    loop {
        let head = chain.head().await.expect("head").number;
        if let Some(receipt) = chain.receipt(hash).await.expect("receipt") {
            return receipt;
        }
        assert!(Instant::now() < deadline, "not mined");
        chain.next_block(head, Duration::from_secs(1)).await.expect("block");
    }
}

async fn send(chain: &Chain, eoa: &EoaSecret, call: &Call) -> Receipt {
    let nonce = chain.nonce(eoa.address(), true).await.expect("nonce");
    let signed = chain.sign(eoa, nonce, call).await.expect("signs");
    assert_eq!(chain.broadcast(&signed.raw).await, Ok(signed.hash));
    mined(chain, signed.hash).await
}

/// A chain with a contract and one account registered under token 1.
async fn site(directory: &Path) -> (Chain, EoaSecret, Pin) {
    let chain = Chain::connect(embedded(directory)).await.expect("opens");
    let eoa = EoaSecret::generate().expect("key");
    let pin = chain.deploy(&eoa).await.expect("deploys");
    assert!(send(&chain, &eoa, &register(1)).await.success);
    (chain, eoa, pin)
}

async fn reopened(directory: &Path, pin: &Pin) -> Result<Chain, ChainError> {
    Chain::connect(ChainOptions { pinned: Some(pin.clone()), ..embedded(directory) }).await
}

#[tokio::test(flavor = "multi_thread")]
async fn from_deployment_to_a_query() {
    let home = tempfile::tempdir().expect("folder");
    let (chain, eoa, pin) = site(home.path()).await;
    let owner = eoa.address();
    let receipt = send(&chain, &eoa, &upload(5, 1)).await;
    assert!(receipt.success && receipt.gas_used > 21_000 && receipt.reason.is_none());
    let Call::DataUpload { digest, token, .. } = upload(5, 1) else { unreachable!() };
    assert!(chain.uploaded_at(owner, digest).await.expect("an answer").is_some());
    assert_eq!(chain.uploaded_at(owner, Digest([9; 32])).await, Ok(None));
    let unknown = chain.data_query(Address([9; 20]), token, Address([9; 20])).await.expect("answers");
    assert_eq!((unknown.authorised, unknown.epoch), (false, 0));
    let answer = chain.data_query(owner, token, owner).await.expect("answers");
    assert_eq!(answer, QueryAnswer { authorised: true, epoch: 1, count: 1, last: digest });
    assert!(!chain.data_query(Address([9; 20]), token, owner).await.expect("answers").authorised);
    let events = chain.events(pin.deployed_at, receipt.block).await.expect("events");
    assert_eq!(events.len(), 5);
    assert_eq!(events[2].event, Event::DelayFixed { seconds: crate::DEFAULT_DELAY.as_secs() });
    assert!(matches!(events[3].event, Event::Registered { owner: who, .. } if who == owner));
    assert!(matches!(events[4].event, Event::DataUploaded { digest: what, .. } if what == digest));
    assert_eq!((events[4].block, events[4].block_hash), (receipt.block, receipt.block_hash));
    assert!(events.iter().all(|event| event.timestamp.is_some()));
    let status = chain.status(Some(owner)).await.expect("status");
    assert_eq!((status.kind.as_str(), status.consensus.as_str()), ("embedded", "poa"));
    assert_eq!((status.nonce, status.pending, status.balance), (Some(3), Some(0), Some("0".into())));
}

#[tokio::test(flavor = "multi_thread")]
async fn refusals_come_with_their_reason() {
    let home = tempfile::tempdir().expect("folder");
    let (chain, eoa, _) = site(home.path()).await;
    let stranger = Address([9; 20]);
    let grant = Call::AuthorityGrant {
        grantee: stranger,
        epoch: 1,
        expiry: None,
        scope: crate::model::Scope::All,
        envelope: vec![1],
    };
    let error = chain.simulate(eoa.address(), &grant).await.expect_err("refused");
    assert_eq!((error.kind(), &error), (ErrorKind::Refused, &ChainError::Reverted { code: "grantee".to_owned() }));
    assert!(error.to_string().contains("ask them to run `authros identity register`"), "{error}");
    assert_eq!(chain.sign(&eoa, 9, &grant).await, Err(error));
    assert_eq!(chain.simulate(eoa.address(), &upload(1, 1)).await, Ok(()));
    assert!(send(&chain, &eoa, &upload(1, 1)).await.success);
    let nonce = chain.nonce(eoa.address(), true).await.expect("nonce");
    let twice = chain.sign(&eoa, nonce, &upload(1, 1)).await.expect("gas is known already");
    chain.broadcast(&twice.raw).await.expect("sent");
    let receipt = mined(&chain, twice.hash).await;
    assert!(!receipt.success && receipt.reason.is_some_and(|reason| reason.contains("already anchored this digest")));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_nonce_gap_waits_and_duplicates_are_known() {
    let home = tempfile::tempdir().expect("folder");
    let (chain, eoa, _) = site(home.path()).await;
    let next = chain.nonce(eoa.address(), true).await.expect("nonce");
    let early = chain.sign(&eoa, next + 1, &upload(2, 1)).await.expect("signs");
    chain.broadcast(&early.raw).await.expect("waits");
    assert_eq!(chain.broadcast(&early.raw).await, Err(ChainError::AlreadyKnown));
    let other = EoaSecret::generate().expect("key");
    send(&chain, &other, &register(7)).await;
    assert_eq!(chain.receipt(early.hash).await, Ok(None), "a block was sealed without it");
    assert_eq!(chain.nonce(eoa.address(), true).await, Ok(next));
    let first = chain.sign(&eoa, next, &upload(1, 1)).await.expect("signs");
    chain.broadcast(&first.raw).await.expect("sent");
    assert!(mined(&chain, first.hash).await.success && mined(&chain, early.hash).await.success);
    assert_eq!(chain.broadcast(&early.raw).await, Err(ChainError::NonceTooLow));
    let other_price = chain.sign(&eoa, next, &upload(3, 1)).await.expect("signs");
    assert_eq!(chain.broadcast(&other_price.raw).await, Err(ChainError::NonceTooLow));
}

#[tokio::test(flavor = "multi_thread")]
async fn many_transactions_share_a_block() {
    let home = tempfile::tempdir().expect("folder");
    let (chain, eoa, _) = site(home.path()).await;
    let next = chain.nonce(eoa.address(), true).await.expect("nonce");
    let mut sent = Vec::new();
    for number in 0..200 {
        sent.push(chain.sign(&eoa, next + number, &upload(number, 1)).await.expect("signs"));
    }
    for one in &sent {
        chain.broadcast(&one.raw).await.expect("sent");
    }
    let before = chain.status(Some(eoa.address())).await.expect("status");
    assert!(before.nonce.zip(before.pending).is_some_and(|(nonce, pending)| nonce + pending == next + 200));
    let last = mined(&chain, sent[199].hash).await.block;
    let first = mined(&chain, sent[0].hash).await.block;
    assert!(last - first < 50);
    let events = chain.events(first, last).await.expect("events");
    let numbers: Vec<u64> = events
        .iter()
        .filter_map(|event| match event.event {
            Event::DataUploaded { number, .. } => Some(number),
            _ => None,
        })
        .collect();
    assert_eq!(numbers, (1..=200).collect::<Vec<u64>>());
}

#[tokio::test(flavor = "multi_thread")]
async fn another_chains_transaction_is_refused() {
    let homes = [tempfile::tempdir().expect("folder"), tempfile::tempdir().expect("folder")];
    let (chain, eoa, _) = site(homes[0].path()).await;
    let other = Chain::connect(embedded(homes[1].path())).await.expect("opens");
    assert_ne!((chain.chain_id(), chain.genesis()), (other.chain_id(), other.genesis()));
    let signed = chain.sign(&eoa, 0, &upload(1, 1)).await.expect("signs");
    let error = other.broadcast(&signed.raw).await.expect_err("refused");
    assert!(matches!(&error, ChainError::Rejected { reason, .. } if reason.contains("chain id")), "{error}");
    let huge = vec![0xf9; 200_000];
    assert!(
        matches!(other.broadcast(&huge).await, Err(ChainError::Rejected { reason, .. }) if reason.contains("oversized"))
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_restart_keeps_everything() {
    let home = tempfile::tempdir().expect("folder");
    let (chain, eoa, pin) = site(home.path()).await;
    let receipt = send(&chain, &eoa, &upload(1, 1)).await;
    let token = Token([1; 32]);
    let count =
        async |chain: &Chain| chain.data_query(eoa.address(), token, eoa.address()).await.expect("answers").count;
    let (head, before) = (chain.head().await, count(&chain).await);
    let events = chain.events(0, u64::MAX).await.expect("events");
    let pending = chain.sign(&eoa, 3, &upload(2, 1)).await.expect("signs");
    chain.broadcast(&pending.raw).await.expect("sent");
    drop(chain);
    let chain = reopened(home.path(), &pin).await.expect("opens again");
    assert_eq!(
        chain.block(receipt.block).await.map(|block| block.map(|block| block.hash)),
        Ok(Some(receipt.block_hash))
    );
    assert_eq!(
        chain.block(head.expect("head").number).await.expect("block"),
        chain.block(receipt.block).await.expect("block")
    );
    assert_eq!(chain.events(0, receipt.block).await, Ok(events));
    assert!(mined(&chain, pending.hash).await.success, "what waited was sealed before the end");
    assert_eq!(count(&chain).await, before + 1);
    assert!(send(&chain, &eoa, &upload(3, 1)).await.success);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cut_write_ahead_log_gives_an_earlier_block() {
    let home = tempfile::tempdir().expect("folder");
    let (chain, eoa, _) = site(home.path()).await;
    for number in 0..4 {
        send(&chain, &eoa, &upload(number, 1)).await;
    }
    let head = chain.head().await.expect("head").number;
    let (database, log) = (home.path().join("chain.db"), home.path().join("chain.db-wal"));
    let log = std::fs::read(log).expect("log");
    let mut heights = Vec::new();
    for part in 1..=8 {
        let copy = tempfile::tempdir().expect("folder");
        std::fs::copy(&database, copy.path().join("chain.db")).expect("copies");
        std::fs::write(copy.path().join("chain.db-wal"), &log[..log.len() * part / 8]).expect("writes");
        let cut = Chain::connect(embedded(copy.path())).await.expect("opens");
        let found = cut.head().await.expect("head");
        if cut.genesis() == chain.genesis() {
            assert_eq!(chain.block(found.number).await.expect("block"), Some(found));
            heights.push(found.number);
        }
    }
    assert!(heights.is_sorted() && heights.last() == Some(&head), "{heights:?} of {head}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_changed_file_is_tampered() {
    for change in [
        "UPDATE chain SET consensus = 'pow:1'",
        "UPDATE sent SET raw = (SELECT raw FROM sent WHERE block = 2) WHERE block = 3",
        "UPDATE sent SET receipt = (SELECT receipt FROM sent WHERE block = 2) WHERE block = 3",
        "DELETE FROM sent WHERE block = 3",
        "UPDATE block SET header = (SELECT header FROM block WHERE number = 2) WHERE number = 3",
        "DELETE FROM block WHERE number = 2",
        "UPDATE chain SET signer = randomblob(32)",
        "UPDATE chain SET chain_id = chain_id + 1",
    ] {
        let home = tempfile::tempdir().expect("folder");
        let (chain, eoa, pin) = site(home.path()).await;
        assert_eq!(send(&chain, &eoa, &upload(1, 1)).await.block, 3);
        drop(chain);
        let connection = rusqlite::Connection::open(home.path().join("chain.db")).expect("opens");
        connection.busy_timeout(Duration::from_secs(5)).expect("waits");
        assert!(connection.execute(change, []).expect("changes") > 0);
        drop(connection);
        let error = reopened(home.path(), &pin).await.expect_err(change);
        assert_eq!(error.kind(), ErrorKind::Tampered, "{change}: {error}");
    }
    let home = tempfile::tempdir().expect("folder");
    std::fs::write(home.path().join("chain.db"), vec![7; 10_000]).expect("writes");
    let error = Chain::connect(embedded(home.path())).await.expect_err("no database");
    assert_eq!(error.kind(), ErrorKind::Tampered);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_pin_notices_another_chain_or_contract() {
    let homes = [tempfile::tempdir().expect("folder"), tempfile::tempdir().expect("folder")];
    let (chain, eoa, pin) = site(homes[0].path()).await;
    let other = chain.deploy(&eoa).await.expect("deploys");
    assert_ne!(other.contract, pin.contract);
    assert_eq!(chain.use_contract(pin.contract).await, Ok(pin.clone()));
    let nothing = Address([9; 20]);
    assert_eq!(chain.use_contract(nothing).await, Err(ChainError::NotTheContract(nothing)));
    drop(chain);
    let error = reopened(homes[1].path(), &pin).await.expect_err("another chain");
    assert!(matches!(error, ChainError::Gone { .. }) && error.kind() == ErrorKind::Refused, "no file: {error}");
    let (another, _, _) = site(homes[1].path()).await;
    drop(another);
    let error = reopened(homes[1].path(), &pin).await.expect_err("another chain");
    assert!(matches!(error, ChainError::Swapped { what: "chain id", .. }) && error.kind() == ErrorKind::Refused);
    for (what, pinned) in [
        ("genesis block", Pin { genesis: Hash([1; 32]), ..pin.clone() }),
        ("contract code hash", Pin { contract: nothing, ..pin.clone() }),
        ("contract code hash", Pin { code_hash: Hash([1; 32]), ..pin.clone() }),
    ] {
        let error = reopened(homes[0].path(), &pinned).await.expect_err(what);
        assert!(matches!(&error, ChainError::Swapped { what: found, .. } if *found == what), "{error}");
    }
    let options = ChainOptions { contract: Some(nothing), pinned: Some(pin.clone()), ..embedded(homes[0].path()) };
    assert!(matches!(Chain::connect(options).await, Err(ChainError::Swapped { what: "contract", .. })));
    assert!(reopened(homes[0].path(), &pin).await.is_ok());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_node_that_does_not_answer_is_unreachable() {
    let silent = std::net::TcpListener::bind("127.0.0.1:0").expect("binds");
    let silent = silent.local_addr().expect("address");
    let closed = {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("binds");
        listener.local_addr().expect("address")
    };
    let listener = std::net::TcpListener::bind(silent);
    for url in [
        format!("http://{closed}"),
        format!("https://{closed}"),
        "ipc:/nowhere/geth.ipc".into(),
        format!("http://{silent}"),
    ] {
        let error = Chain::connect(node(&url)).await.expect_err("no node");
        assert_eq!(error.kind(), ErrorKind::Unreachable, "{error}");
        assert!(error.to_string().contains(&url), "{error}");
    }
    drop(listener);
    let error = Chain::connect(node("ftp://127.0.0.1")).await.expect_err("no such node");
    assert_eq!(error.kind(), ErrorKind::Input);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_file_has_one_owner_and_no_other_reader() {
    use std::os::unix::fs::PermissionsExt;
    let home = tempfile::tempdir().expect("folder");
    let directory = home.path().join("chain");
    let (chain, eoa, _) = site(&directory).await;
    let mode = |path: &Path| std::fs::metadata(path).expect("metadata").permissions().mode() & 0o777;
    assert_eq!(mode(&directory), 0o700);
    for name in ["chain.db", "chain.db-wal"] {
        assert_eq!(mode(&directory.join(name)), 0o600);
    }
    let error = Chain::connect(embedded(&directory)).await.expect_err("open already");
    assert!(error.kind() == ErrorKind::Home && error.to_string().contains("another process"), "{error}");
    let Call::DataUpload { digest, .. } = upload(5, 1) else { unreachable!() };
    send(&chain, &eoa, &upload(5, 1)).await;
    let dump = chain.dump().await.expect("dumps");
    let holds = |needle: &[u8]| dump.iter().any(|bytes| bytes.windows(needle.len()).any(|window| window == needle));
    assert!(holds(&digest.0) && holds(eoa.address().as_bytes()));
    assert!(!holds(&eoa.expose()[..]));
    assert_eq!(chain.fund_from_node(eoa.address()).await, Ok(false));
}

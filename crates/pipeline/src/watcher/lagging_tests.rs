//! Several nodes behind one URL, some of them behind the others: nothing of the chain is missed, nothing is undone.

use std::path::Path;
use std::sync::atomic::Ordering::SeqCst;
use std::sync::atomic::{AtomicBool, AtomicU64};
use std::sync::{Arc, OnceLock};

use async_trait::async_trait;
use serde_json::{Value, json};

use super::*;
use crate::chain::relay::{Relay, RelayError, RelayLine};
use crate::chain::{Call, Chain, ChainOptions, Endpoint};
use crate::crypto::{EoaSecret, IndexKey, Names, TopicKey};
use crate::model::{Address, Header, RecordState, Scope, SignerId, Timestamp, Token};
use crate::pipeline::columns::Keys;
use crate::pipeline::fixture::{Process, by_hand, identity, network};
use crate::pipeline::record_audit::{RecordAudit, Scope as Audited, audit};
use crate::store::RecordRow;

/// A chain as it is seen through nodes that lag. Their headers name no logs, and what they do not have they call empty:
/// the worst there is.
struct Lag {
    chain: Chain,
    /// How far the logs are behind.
    logs: AtomicU64,
    /// How far everything else is behind.
    blocks: AtomicU64,
    /// A revoked grant, which no question may find in force again: the directory to search, its owner and its grantee.
    revoked: OnceLock<(Arc<Directory>, Address, Address)>,
    came_back: AtomicBool,
}

fn quantity(value: &Value) -> Option<u64> {
    u64::from_str_radix(value.as_str()?.strip_prefix("0x")?, 16).ok()
}

#[async_trait]
impl Relay for Lag {
    async fn ask(&self, method: &str, parameters: Value) -> Result<Value, RelayError> {
        if let Some((directory, owner, reader)) = self.revoked.get()
            && directory.grant_between(*owner, *reader).is_some()
        {
            self.came_back.store(true, SeqCst);
        }
        let head = self.chain.head().await.expect("head").number;
        let old = head - self.blocks.load(SeqCst);
        match method {
            "eth_getBlockByNumber" => {
                let number = quantity(&parameters[0]).unwrap_or(old);
                if number > old {
                    return Ok(Value::Null);
                }
                let mut block = self.chain.relay(method, &json!([format!("{number:#x}"), false])).await?;
                if block.is_object() {
                    block["logsBloom"] = Value::Null;
                }
                Ok(block)
            }
            "eth_getLogs" => {
                let hash = &parameters[0]["blockHash"];
                let block = self.chain.relay("eth_getBlockByHash", &json!([hash, false])).await;
                let number = block.ok().and_then(|block| quantity(&block["number"])).unwrap_or(0);
                let is_late = number + self.logs.load(SeqCst) > head;
                if is_late { Ok(json!([])) } else { self.chain.relay(method, &parameters).await }
            }
            _ => self.chain.relay(method, &parameters).await,
        }
    }

    fn place(&self) -> String {
        "nodes that lag".to_owned()
    }
}

/// A process that sees its chain through nodes that lag; and the chain itself.
async fn behind(process: &mut Process) -> (Arc<Lag>, Chain) {
    let chain = process.network.chain.clone();
    let lag = Arc::new(Lag {
        chain: chain.clone(),
        logs: AtomicU64::new(0),
        blocks: AtomicU64::new(0),
        revoked: OnceLock::new(),
        came_back: AtomicBool::new(false),
    });
    let endpoint = Endpoint::Relay(RelayLine(Arc::clone(&lag) as Arc<dyn Relay>));
    let options = ChainOptions { endpoint, contract: None, pinned: chain.pin() };
    process.network = network(Chain::connect(options).await.expect("connects"));
    restore(&process.plant, &process.network).expect("restores");
    watch_round(&process.plant, &process.network).await.expect("reads");
    (lag, chain)
}

async fn newcomer(chain: &Chain) -> EoaSecret {
    let eoa = EoaSecret::generate().expect("key");
    by_hand(chain, &eoa, &identity(chain, &eoa)).await;
    eoa
}

fn grant_to(reader: &EoaSecret) -> Call {
    let (grantee, envelope) = (reader.address(), vec![1; 120]);
    Call::AuthorityGrant { grantee, epoch: 1, expiry: None, scope: Scope::All, envelope }
}

async fn lend(chain: &Chain, eoa: &EoaSecret, number: u8) {
    by_hand(chain, eoa, &Call::Lend { device: SignerId([number; 32]), until: None }).await;
}

/// What a directory that never missed anything knows.
async fn expect_as_on_the_chain(process: &Process, chain: &Chain, accounts: &[Address]) {
    let whole = process.network.directory.blank();
    for at in chain.events(0, u64::MAX).await.expect("events") {
        whole.apply(&at);
    }
    for account in accounts {
        assert_eq!(process.network.directory.account(*account), whole.account(*account));
        assert_eq!(process.network.directory.grants_of(*account), whole.grants_of(*account));
    }
    let stored = process.network.directory.blank();
    assert!(kept::read_back(&process.plant.ledger.rights, &stored).expect("read"));
    for account in accounts {
        assert_eq!(stored.account(*account), whole.account(*account), "and so it is stored");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn rights_that_the_logs_did_not_tell_at_first_are_read_in_their_order() {
    let home = tempfile::tempdir().expect("folder");
    for late in [1, 2, 5] {
        let mut process = Process::on_embedded(&home.path().join(late.to_string())).await;
        let (lag, chain) = behind(&mut process).await;
        lag.logs.store(late, SeqCst);
        let own = process.eoa.clone();
        let reader = newcomer(&chain).await;
        watch_round(&process.plant, &process.network).await.expect("reads");
        assert!(process.network.directory.identity(reader.address()).is_err(), "the answer was stale");
        by_hand(&chain, &own, &grant_to(&reader)).await;
        watch_round(&process.plant, &process.network).await.expect("reads");
        for number in 1..=10 {
            lend(&chain, &own, number).await;
            watch_round(&process.plant, &process.network).await.expect("reads");
        }
        // The newest ones are still due.
        lag.logs.store(0, SeqCst);
        for number in 11..=17 {
            lend(&chain, &own, number).await;
            watch_round(&process.plant, &process.network).await.expect("reads");
        }
        expect_as_on_the_chain(&process, &chain, &[own.address(), reader.address()]).await;
        assert!(process.notes.with("differ from those on the chain") > 0, "it is told");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_right_that_ended_does_not_come_back_while_the_chain_is_read_again() {
    let home = tempfile::tempdir().expect("folder");
    let mut process = Process::on_embedded(home.path()).await;
    let (lag, chain) = behind(&mut process).await;
    let (own, reader) = (process.eoa.clone(), newcomer(&chain).await);
    by_hand(&chain, &own, &grant_to(&reader)).await;
    watch_round(&process.plant, &process.network).await.expect("reads");
    lag.logs.store(1, SeqCst);
    lend(&chain, &own, 1).await;
    watch_round(&process.plant, &process.network).await.expect("reads");
    lag.logs.store(0, SeqCst);
    let revoke = Call::AuthorityRevoke { grantee: reader.address(), new_token: Token([9; 32]), envelope: Vec::new() };
    by_hand(&chain, &own, &revoke).await;
    watch_round(&process.plant, &process.network).await.expect("reads");
    let directory = Arc::clone(&process.network.directory);
    assert!(directory.grant_between(own.address(), reader.address()).is_none(), "revoked");
    assert!(lag.revoked.set((directory, own.address(), reader.address())).is_ok());
    lend(&chain, &own, 2).await;
    watch_round(&process.plant, &process.network).await.expect("reads");
    assert!(process.notes.with("differ from those on the chain") > 0, "it was read again");
    assert!(!lag.came_back.load(SeqCst), "the grant was in force while the revoke was read again");
    expect_as_on_the_chain(&process, &chain, &[own.address(), reader.address()]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_receipt_shows_what_the_logs_did_not() {
    let home = tempfile::tempdir().expect("folder");
    let mut process = Process::on_embedded(home.path()).await;
    let (lag, _) = behind(&mut process).await;
    lag.logs.store(1_000, SeqCst);
    process.store(0..1);
    process.anchor(1).await;
    process
        .rounds_until("its transaction is closed", |process| {
            process.sender.room(process.eoa.address()).ok() == Some(1024)
        })
        .await;
    assert_eq!(process.count(RecordState::Submitted), 1, "no event of it was seen");
    lag.logs.store(0, SeqCst);
    process.rounds_until("its event is read", |process| process.count(RecordState::Confirmed) == 1).await;
    assert_eq!(process.anchored(0..1).await, [1]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_node_that_names_an_older_head_is_waited_for_and_nothing_is_undone() {
    let home = tempfile::tempdir().expect("folder");
    let mut process = Process::on_embedded(home.path()).await;
    let (lag, chain) = behind(&mut process).await;
    process.store(0..2);
    process.anchor(2).await;
    process.rounds_until("they are confirmed", |process| process.count(RecordState::Confirmed) == 2).await;
    let reader = newcomer(&chain).await;
    watch_round(&process.plant, &process.network).await.expect("reads");
    let cursor = process.plant.ledger.trail.cursor().expect("read");
    lag.blocks.store(2, SeqCst);
    let error = watch_round(&process.plant, &process.network).await.expect_err("it is behind");
    assert!(matches!(error, PipelineError::NodeBehind { .. }), "{error}");
    assert_eq!(process.plant.ledger.trail.cursor().expect("read"), cursor);
    assert_eq!(process.count(RecordState::Confirmed), 2);
    assert!(process.network.directory.identity(reader.address()).is_ok(), "registered all the same");
    assert_eq!(process.notes.with("replaced its last"), 0);
    lag.blocks.store(0, SeqCst);
    watch_round(&process.plant, &process.network).await.expect("it has caught up");
}

/// A process beside its chain, or behind nodes that could lag, with that chain: blocks are read in different ways.
async fn near_or_far(home: &Path, is_near: bool) -> (Process, Chain) {
    let mut process = Process::on_embedded(home).await;
    if is_near {
        let (_, chain) = behind(&mut process).await;
        return (process, chain);
    }
    watch_round(&process.plant, &process.network).await.expect("reads");
    let chain = process.network.chain.clone();
    (process, chain)
}

#[tokio::test(flavor = "multi_thread")]
async fn blocks_that_are_replaced_while_they_are_read_again_take_their_records_back() {
    let home = tempfile::tempdir().expect("folder");
    for is_near in [true, false] {
        let (process, chain) = near_or_far(&home.path().join(is_near.to_string()), is_near).await;
        let below = process.plant.ledger.trail.end().expect("read").expect("a block");
        process.store(0..1);
        process.anchor(1).await;
        process.rounds_until("it is confirmed", |process| process.count(RecordState::Confirmed) == 1).await;
        let (head, trail) = (chain.head().await.expect("head"), &process.plant.ledger.trail);
        assert!(below.0 < head.number, "{below:?}");
        // What was read there is not what is there now, and the round found out nothing when it began.
        let replaced = (head.number, Hash([9; 32]));
        trail.walk_to(replaced, Vec::new()).expect("walked");
        trail.walk_back(below).expect("goes back");
        let reached = read_on(&process.plant, &process.network, head).await.expect("reads");
        assert!(matches!(reached, Reached::Differs(block) if block == head.number), "near: {is_near}");
        assert_eq!(trail.end(), Ok(Some(replaced)), "the next round still sees it");
        watch_round(&process.plant, &process.network).await.expect("reads");
        assert_eq!(process.notes.with("replaced its last"), 1);
        process.rounds_until("it is confirmed", |process| process.count(RecordState::Confirmed) == 1).await;
        assert_eq!(process.anchored(0..1).await, [1]);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_false_block_below_the_newest_one_is_found_and_read_again() {
    let home = tempfile::tempdir().expect("folder");
    for (is_near, is_cursor) in [(true, true), (true, false), (false, true), (false, false)] {
        let case = format!("near {is_near}, cursor {is_cursor}");
        let (process, chain) = near_or_far(&home.path().join(&case), is_near).await;
        let (own, trail) = (process.eoa.clone(), &process.plant.ledger.trail);
        let below = trail.end().expect("read").expect("a block");
        for number in 1..=3 {
            lend(&chain, &own, number).await;
            watch_round(&process.plant, &process.network).await.expect("reads");
        }
        trail.walk_to((below.0 + 2, Hash([9; 32])), Vec::new()).expect("noted");
        if !is_cursor {
            trail.walk_back(below).expect("goes back");
        }
        watch_round(&process.plant, &process.network).await.expect(&case);
        let head = chain.head().await.expect("head").number;
        assert_eq!(trail.cursor().expect("read").map(|(number, _)| number), Some(head), "{case}");
        for (number, hash) in trail.blocks(0).expect("read") {
            let there = chain.block(number).await.expect("answers").expect("a block");
            assert_eq!(there.hash, hash, "{case}: block {number}");
        }
        expect_as_on_the_chain(&process, &chain, &[own.address()]).await;
    }
}

/// No keyring is open.
struct Locked;

impl Keys for Locked {
    fn opening(&self, _header: &Header) -> Option<(TopicKey, Names)> {
        None
    }

    fn index_key(&self, _row: &RecordRow) -> Option<IndexKey> {
        None
    }
}

async fn audited(process: &Process) -> RecordAudit {
    let (plant, network) = (process.plant.clone(), process.network.clone());
    let runtime = tokio::runtime::Handle::current();
    let work = move || {
        let log = plant.ledger.audit.clone();
        let scope = Audited {
            deep: false,
            since: Timestamp(0),
            accounts: Vec::new(),
            keys: Arc::new(Locked),
            looked_at: Arc::default(),
        };
        audit(&plant, Some(Ok(&network)), &log, &scope, &runtime)
    };
    tokio::task::spawn_blocking(work).await.expect("ends").expect("answers")
}

#[tokio::test(flavor = "multi_thread")]
async fn an_audit_finds_events_that_the_ledger_missed_and_the_watcher_then_reads_them() {
    let home = tempfile::tempdir().expect("folder");
    let process = Process::on_embedded(home.path()).await;
    let (chain, own) = (process.network.chain.clone(), process.eoa.clone());
    let reader = newcomer(&chain).await;
    lend(&chain, &own, 1).await;
    process.round().await;
    assert!(audited(&process).await.ok, "{:?}", audited(&process).await.findings);

    let block = chain.head().await.expect("head").number;
    process.plant.ledger.rights.take_back_rights(block).expect("forgotten");
    let found = audited(&process).await;
    let told: Vec<_> = found.findings.iter().filter(|finding| finding.subject == format!("block {block}")).collect();
    assert_eq!((told.len(), found.missing), (1, 1), "{:?}", found.findings);
    assert!(told[0].text.contains("Lent") && told[0].text.contains("audit again"), "{}", told[0].text);

    process.round().await;
    assert!(audited(&process).await.ok, "read again");
    expect_as_on_the_chain(&process, &chain, &[own.address(), reader.address()]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_audit_finds_events_that_the_chain_does_not_have() {
    let home = tempfile::tempdir().expect("folder");
    let process = Process::on_embedded(home.path()).await;
    let chain = process.network.chain.clone();
    lend(&chain, &process.eoa, 1).await;
    process.round().await;
    let events = chain.events(0, u64::MAX).await.expect("events");
    let last = events.last().expect("lent");
    let forged = Told {
        block: last.block,
        place: last.log_index + 1,
        transaction: last.transaction,
        event: Event::Recalled { owner: process.eoa.address(), device: SignerId([1; 32]) },
        proven: false,
    };
    kept::keep(&process.plant.ledger.rights, &[forged]).expect("stored");
    let found = audited(&process).await;
    assert!(found.tampered == 1 && found.findings[0].text.contains("Recalled"), "{:?}", found.findings);
    process.round().await;
    assert!(audited(&process).await.ok, "taken back");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_audit_finds_anchors_that_were_never_seen() {
    let home = tempfile::tempdir().expect("folder");
    let mut process = Process::on_embedded(home.path()).await;
    let (lag, _) = behind(&mut process).await;
    process.store(0..1);
    lag.logs.store(1_000, SeqCst);
    process.anchor(1).await;
    process
        .rounds_until("its transaction is closed", |process| {
            process.sender.room(process.eoa.address()).ok() == Some(1024)
        })
        .await;
    lag.logs.store(0, SeqCst);
    let found = audited(&process).await;
    assert!(found.findings.iter().any(|finding| finding.text.contains("DataUploaded")), "{:?}", found.findings);
    process.rounds_until("its event is read", |process| process.count(RecordState::Confirmed) == 1).await;
}

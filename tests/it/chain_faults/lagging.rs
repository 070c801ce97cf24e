//! Several nodes behind one URL, one of them behind the others: nothing that is on the chain is missed, and where the
//! newest is not known nobody is served by the old.

use std::fs;
use std::process::Command;
use std::time::{Duration, Instant};

use authros::gateway::{Client, Code, Feed, GatewayError};
use serde_json::Value;

use super::NO_NODE;
use crate::support::member::{Gateway, Member, connect};
use crate::support::{Anvil, Authros, Home, Proxy, Running, heavy, length, list, long, skipped, text, wait_until};

/// How long two views may differ, seconds: ten blocks of 200 ms, and what the commands take on a busy machine.
const SOON: u64 = 20;

/// A home's site that sees the chain in its own way.
struct View {
    authros: Authros,
    proxy: Option<Proxy>,
    _site: Running,
}

impl View {
    fn of(home: &Home, node: &Anvil, contract: Option<&str>, robots: &str, is_direct: bool) -> Self {
        let proxy = (!is_direct).then(|| Proxy::before(node.port()));
        let url = proxy.as_ref().map_or_else(|| node.http(), Proxy::http);
        let mut authros = home.authros().with(&["--chain", &url, "--robots", robots]);
        if let Some(contract) = contract {
            authros = authros.with(&["--contract", contract]);
        }
        let site = authros.serve(home);
        Self { authros, proxy, _site: site }
    }

    fn lag(&self, blocks: u64, every: u64, refuses: bool) {
        self.proxy.as_ref().expect("not direct").answer_logs_late(blocks, every, refuses);
    }

    fn withheld(&self) -> u64 {
        self.proxy.as_ref().map_or(0, Proxy::spoilt)
    }

    /// What it knows of grants.
    fn grants(&self) -> Vec<Value> {
        list(&self.authros.json(&["grant", "list"]), "grants")
    }
}

/// A second home with only the keys of the first.
fn with_keys_of(first: &Home) -> Home {
    use std::os::unix::fs::PermissionsExt;
    let second = Home::new();
    fs::create_dir(second.path()).expect("made");
    let copied = Command::new("cp").arg("-a").arg(first.path().join("profiles")).arg(second.path()).status();
    assert!(copied.is_ok_and(|status| status.success()), "the keys are copied");
    fs::set_permissions(second.path(), fs::Permissions::from_mode(0o700)).expect("its mode is set");
    second
}

fn expect_alike(late: &View, direct: &View, is_granted: bool) {
    let words = if is_granted { "the grant has reached the reader" } else { "the revoke has reached the reader" };
    wait_until(SOON, words, || {
        let known = late.grants();
        let has_one = known.iter().any(|grant| grant["state"] == "active");
        (!known.is_empty() && has_one == is_granted && known == direct.grants()).then_some(())
    });
}

/// Registrations, grants, anchors and revokes while the logs come late: nothing of them is lost.
#[test]
fn nothing_is_missed_where_the_logs_come_from_a_node_that_is_behind() {
    let _alone = heavy();
    let Some(node) = Anvil::start(&["--block-time", "0.2"]) else { skipped!(NO_NODE) };
    let home = Home::new();
    let owner = View::of(&home, &node, None, "1", false);
    let contract = text(&owner.authros.json(&["chain", "status"]), "contract");
    let readers = Home::new();
    let reader = View::of(&readers, &node, Some(&contract), "0", false);
    let reader_address = text(&reader.authros.json(&["identity", "show"]), "address");
    let twin = with_keys_of(&readers);
    let direct = View::of(&twin, &node, Some(&contract), "0", true);

    let ways: Vec<(u64, u64, bool)> = if long() {
        [1, 2, 3, 7].into_iter().flat_map(|every| [1, 2, 5].map(|blocks| (blocks, every, blocks != 2))).collect()
    } else {
        vec![(5, 1, true), (1, 2, true), (2, 3, false), (5, 7, true)]
    };
    // In the long run for five hundred blocks.
    let end = Instant::now() + length(Duration::ZERO, Duration::from_secs(100));
    let mut captured = 0;
    for (blocks, every, refuses) in ways.iter().copied().cycle().take(ways.len() * if long() { 20 } else { 1 }) {
        for view in [&owner, &reader] {
            view.lag(blocks, every, refuses);
        }
        owner.authros.json(&["grant", "add", &reader_address]);
        expect_alike(&reader, &direct, true);
        owner.authros.capture(&["/robot1/odom"], 5);
        captured += 5;
        owner.authros.json(&["grant", "end", &reader_address]);
        expect_alike(&reader, &direct, false);
        if long() && Instant::now() > end {
            break;
        }
    }
    assert!(owner.withheld() + reader.withheld() > 0, "no question reached the node that is behind");
    let records = owner.authros.records(&["records", "list", "--oldest"]);
    assert_eq!(records.len(), captured, "each once");
    assert!(records.iter().all(|record| record["state"] == "verified"), "{records:?}");
    let audit = owner.authros.json(&["audit"]);
    assert_eq!(audit["ok"], true, "{audit}");
}

fn answer(result: Result<impl std::fmt::Debug, GatewayError>) -> Result<(), Code> {
    match result {
        Ok(_) => Ok(()),
        Err(GatewayError::Refused(code) | GatewayError::RefusedInClear(code)) => Err(code),
        other => panic!("neither an answer nor a refusal: {other:?}"),
    }
}

async fn ask(session: &mut Client, feed: &Feed) -> Result<(), Code> {
    answer(session.feed(feed).await)
}

/// A gateway's node falls a hundred blocks behind what the gateway has read: it refuses until that node has caught up.
#[tokio::test(flavor = "multi_thread")]
async fn a_gateway_whose_node_is_behind_refuses_instead_of_serving_on() {
    let Some(node) = Anvil::start(&["--block-time", "1"]) else { skipped!(NO_NODE) };
    let proxy = Proxy::before(node.port());
    let home = Home::new();
    let url = proxy.http();
    let keeper = home.profile("gateway").with(&["--json", "--chain", &url]);
    let mut process = keeper.spawn(&["gateway", "serve", "--listen", "127.0.0.1:0"]);
    let told = process.wait_for_text("\"joined\"", 60);
    let line = told.lines().find(|line| line.contains("\"joined\"")).expect("one line");
    let gateway = Gateway::of(&serde_json::from_str(line).expect("JSON"));
    let (alice, bob) = (home.profile("alice"), home.profile("bob"));
    let (alice, bob) = (alice.with(&["--chain", &url]), bob.with(&["--chain", &url]));
    let (_, bob_address) = (alice.enrol(), bob.enrol());
    // The grant is told when its block was read, and with it all these.
    node.mine(150);
    alice.json(&["grant", "add", &bob_address]);
    let owner = Member::of(&home, "alice", gateway.domain);
    let reader = Member::of(&home, "bob", gateway.domain);
    let credentials = reader.allocate(&gateway, "bob").await.expect("allocates");
    let mut session = connect(&gateway, &credentials).await;
    let feed = Feed::of(owner.address());
    let granted = Instant::now();
    while ask(&mut session, &feed).await.is_err() {
        assert!(granted.elapsed() < Duration::from_secs(30), "granted, and fresh");
        tokio::time::sleep(Duration::from_millis(200)).await;
    }

    proxy.fall_behind(100);
    // What was known a moment ago may still be served: as long as no new block was due.
    let behind = Instant::now();
    while ask(&mut session, &feed).await.is_ok() {
        assert!(behind.elapsed() < Duration::from_secs(30), "the newest blocks are not known");
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
    for _ in 0..8 {
        assert_eq!(ask(&mut session, &feed).await, Err(Code::Stale), "the newest blocks are not known");
        tokio::time::sleep(Duration::from_millis(500)).await;
    }
    proxy.calm();
    let caught_up = Instant::now();
    while let Err(code) = ask(&mut session, &feed).await {
        assert_eq!(code, Code::Stale);
        assert!(caught_up.elapsed() < Duration::from_secs(30), "it has caught up");
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
    drop(process);
}

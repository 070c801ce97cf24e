//! An operator without a chain client: joins a site on another home through its gateway, registers, reads what is
//! shared, and is cut off by a revoke.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use authros::crypto::{Keyring, Passphrase, ProviderName, domain, provider};
use authros::gateway::{
    Applicant, Client, Code, Context, Credentials, Endpoint, Feed, GatewayError, NetworkName, Relayed, Trust,
};
use authros::model::{Digest, ProfileName, SignerId};
use serde_json::{Value, json};
use support::member::Live;
use support::{Authros, Home, Running, count, ids, list, poll, text, wait_until};

const REFUSED: i32 = 5;
const PATIENCE: Duration = Duration::from_secs(30);

/// A site with robots and a gateway, and its CURA.
struct Gate {
    home: Home,
    _site: Running,
    _gateway: Running,
    alice: Authros,
    address: String,
    fingerprint: String,
}

fn gate(robots: &str) -> Gate {
    let home = Home::new();
    let alice = home.profile("alice");
    let site = alice.with(&["--robots", robots]).serve(&home);
    let mut gateway = alice.with(&["--json"]).spawn(&["gateway", "serve", "--listen", "127.0.0.1:0"]);
    gateway.wait_for_text("fingerprint", 60);
    let told: Value = serde_json::from_str(gateway.stdout().lines().next().expect("a line")).expect("JSON");
    let (address, fingerprint) = (text(&told["gateway"], "address"), text(&told["gateway"], "gateway"));
    Gate { home, _site: site, _gateway: gateway, alice, address, fingerprint }
}

impl Gate {
    fn joined(&self, home: &Home, profile: &str) -> Authros {
        home.profile(profile).with(&["--site", &self.address, "--gateway-key", &self.fingerprint])
    }
}

fn shared(authros: &Authros) -> BTreeSet<String> {
    ids(&wait_until(60, "a list", || authros.records_so_far(&["received", "list", "--oldest"])))
}

#[test]
fn an_operator_without_a_chain_client_reads_what_is_shared_until_the_revoke() {
    let gate = gate("2");
    gate.alice.capture(&["/robot1/odom"], 5);
    let away = Home::new();
    let bob = gate.joined(&away, "bob");
    let address = bob.enrol();
    // Who may use a gateway is its keeper's choice; anyone may read the chain and register.
    let refused = bob.fails(REFUSED, &["received", "list", "--oldest"]);
    assert!(refused.contains("does not allow the account"), "{refused}");
    assert!(list(&gate.alice.json(&["gateway", "allowed"]), "allowed").is_empty());
    let admitted = gate.alice.json(&["gateway", "allow", &address]);
    assert_eq!(
        (&list(&admitted, "allowed")[0]["owner"], list(&admitted, "allowed").len()),
        (&address.clone().into(), 1)
    );
    assert!(!away.path().join("chain").exists(), "no chain of its own");
    let status = bob.json(&["chain", "status"]);
    assert_eq!(status["kind"], "relay", "{status}");
    assert!(text(&status, "through").contains("not by your own node"), "{status}");
    let here = gate.alice.json(&["chain", "status"]);
    assert_eq!((&status["genesis"], &status["contract"]), (&here["genesis"], &here["contract"]));
    assert!(shared(&bob).is_empty(), "nothing without a grant");

    gate.alice.json(&["grant", "add", &address]);
    let own = gate.alice.records(&["records", "list", "--oldest"]);
    wait_until(60, "what is shared comes in", || (shared(&bob) == ids(&own)).then_some(()));
    for record in wait_until(60, "a list", || bob.records_so_far(&["received", "list", "--oldest"])) {
        let id = text(&record, "id");
        assert_eq!((&record["topic"], &record["type"]), (&"/robot1/odom".into(), &"nav_msgs/Odometry".into()));
        let checked = wait_until(60, "verified", || {
            let checked = bob.json(&["records", "check", &id]);
            (checked["verdict"] == "verified").then_some(checked)
        });
        assert_eq!(checked["digest"], record["digest"]);
        let opened = bob.json(&["records", "open", &id]);
        assert_eq!(opened["verdict"], "verified", "{opened}");
        let at_home = gate.alice.json(&["records", "open", &id]);
        assert_eq!((&opened["message"], &opened["tags"]), (&at_home["message"], &at_home["tags"]));
    }

    // Live: a running site gets what is captured without asking.
    let site = bob.serve(&away);
    gate.alice.capture(&["/robot1/odom"], 3);
    let all = ids(&gate.alice.records(&["records", "list", "--oldest"]));
    assert_eq!(all.len(), 8);
    wait_until(60, "live records come in", || (shared(&bob) == all).then_some(()));

    gate.alice.json(&["grant", "end", &address]);
    gate.alice.capture(&["/robot1/odom"], 3);
    let later: BTreeSet<String> =
        ids(&gate.alice.records(&["records", "list", "--oldest"])).difference(&all).cloned().collect();
    assert_eq!(later.len(), 3);
    wait_until(60, "the revoke is seen", || shared(&bob).is_empty().then_some(()));
    for id in &later {
        assert_ne!(bob.run(&["records", "open", id]).code, Some(0), "{id} is not there");
    }
    site.stop("TERM", 30).expect_code(0);
    let digests = gate.alice.records(&["records", "list", "--oldest"]);
    let digests = digests.iter().filter(|record| later.contains(&text(record, "id")));
    let digests: Vec<Vec<u8>> = digests.map(|record| support::unhex(&text(record, "digest"))).collect();
    for file in support::authros::files_below(&away.path()) {
        let bytes = std::fs::read(&file).unwrap_or_default();
        assert!(digests.iter().all(|digest| !support::holds(&bytes, digest)), "{}", file.display());
    }
}

#[test]
fn only_the_gateway_whose_key_was_told_is_joined() {
    let gate = gate("0");
    let away = Home::new();
    let wrong = "ab".repeat(32);
    let other = away.profile("bob").with(&["--site", &gate.address, "--gateway-key", &wrong]);
    let message = other.fails(REFUSED, &["identity", "register"]);
    assert!(message.contains("not the pinned gateway") && message.contains(&wrong), "{message}");
    let unnamed = away.profile("bob").with(&["--site", &gate.address]).fails(REFUSED, &["identity", "register"]);
    assert!(unnamed.contains(&gate.fingerprint) && unnamed.contains("confirm it with its operator"), "{unnamed}");
    // On explicit request; from then on it is pinned.
    let bob = away.profile("bob").with(&["--site", &gate.address]);
    bob.with(&["--trust-first"]).enrol();
    assert_eq!(bob.json(&["identity", "show"])["registered"], true);
    let message = other.fails(REFUSED, &["chain", "status"]);
    assert!(message.contains("not the pinned gateway"), "{message}");
}

/// The operator's side by hand, over the protocol's own client.
struct Operator {
    endpoint: Endpoint,
    trust: Trust,
    keyring: Keyring,
    network: NetworkName,
}

impl Operator {
    async fn new(gate: &Gate, home: &Home, profile: &str) -> Self {
        let profile: ProfileName = profile.parse().expect("a name");
        let directory = home.path().join("profiles").join(profile.as_str());
        let words = std::fs::read_to_string(directory.join("passphrase")).expect("a passphrase");
        let words = Passphrase::new(words.lines().next().expect("a line").to_owned()).expect("usable");
        let keyring = Keyring::load(&directory.join("keyring"), &words).expect("opens");
        let network = Client::inquire(std::slice::from_ref(&gate.address), PATIENCE).await.expect("tells");
        let domain = domain(network.chain_id, &network.genesis, &network.contract);
        let context = Context { provider: provider(ProviderName::RustCrypto), domain };
        let endpoint = Endpoint { addresses: vec![gate.address.clone()], context, patience: PATIENCE, source: None };
        let gateway: SignerId = gate.fingerprint.parse().expect("hex");
        Self { endpoint, trust: Trust::pinned(gateway), keyring, network }
    }

    async fn connect(&mut self, name: &str) -> Client {
        let name: ProfileName = name.parse().expect("a name");
        let keys = &self.keyring;
        let (signing, envelope) = (&keys.signing, keys.envelope.public);
        let applicant = Applicant { name: &name, signing, envelope, account: &keys.eoa };
        let (key, _) = Client::allocate(&self.endpoint, &mut self.trust, &applicant).await.expect("allocates");
        let token = keys.token(&self.network.domain(), 1).expect("the first epoch");
        let credentials = Credentials { name, key, token };
        Client::connect(&self.endpoint, &mut self.trust, &credentials).await.expect("connects")
    }
}

/// The moments at which the chain was first seen at each height.
async fn heights(mut client: Client, until: tokio::sync::oneshot::Receiver<()>) -> Vec<(u64, Instant)> {
    let (mut seen, mut until): (Vec<(u64, Instant)>, _) = (Vec::new(), until);
    while until.try_recv().is_err() {
        if let Ok(Relayed::Result(height)) = client.relay("eth_blockNumber", &json!([])).await {
            let height = u64::from_str_radix(height.trim_matches('"').trim_start_matches("0x"), 16).expect("hex");
            if seen.last().is_none_or(|(last, _)| *last < height) {
                seen.push((height, Instant::now()));
            }
        }
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    seen
}

#[test]
fn a_live_subscriber_is_cut_by_the_revokes_block() {
    let gate = gate("1");
    let away = Home::new();
    let address = gate.joined(&away, "bob").enrol();
    gate.alice.json(&["gateway", "allow", &address]);
    gate.alice.json(&["grant", "add", &address]);
    let owner = text(&gate.alice.json(&["identity", "show"]), "address").parse().expect("an address");
    gate.alice.run(&["topics", "watch", "/robot1/odom"]).expect_code(0);
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().expect("threads");
    let (cut, seen, revoked, received) = runtime.block_on(async {
        let mut bob = Operator::new(&gate, &away, "bob").await;
        let mut live = bob.connect("bob-live").await;
        let mut follower = Live::begin(&mut live, Feed::of(owner)).await.expect("granted");
        let (end, ended) = tokio::sync::oneshot::channel();
        let heights = tokio::spawn(heights(bob.connect("bob-blocks").await, ended));
        let mut received: Vec<(Digest, Instant)> = Vec::new();
        for _ in 0..5 {
            let (entry, _) = follower.next(&mut live, PATIENCE).await.expect("a record");
            received.push((entry.digest, Instant::now()));
        }
        let alice = gate.alice.clone();
        let revoking = tokio::task::spawn_blocking(move || alice.json(&["grant", "end", &address]));
        let cut = loop {
            match follower.next(&mut live, PATIENCE).await {
                Ok((entry, _)) => received.push((entry.digest, Instant::now())),
                Err(GatewayError::Refused(Code::NotAuthorised)) => break Instant::now(),
                Err(error) => panic!("{error}"),
            }
        };
        let revoked = revoking.await.expect("revokes");
        tokio::time::sleep(Duration::from_secs(2)).await;
        let again = follower.next(&mut live, Duration::from_secs(2)).await;
        assert!(matches!(again, Err(GatewayError::Refused(Code::NotAuthorised))));
        let fetched = live.fetch(&received[0].0).await;
        assert!(matches!(fetched, Err(GatewayError::Refused(_))), "not even what it had");
        end.send(()).expect("watched");
        (cut, heights.await.expect("watched"), revoked, received)
    });
    let block = count(&revoked, "block");
    let at = seen.iter().find(|(height, _)| *height >= block).expect("the block was seen").1;
    let late = received.iter().filter(|(_, moment)| *moment > at).count();
    let (before, after) = (at.saturating_duration_since(cut), cut.saturating_duration_since(at));
    println!("revoke in block {block}: cut {after:?} after the block was seen here, or {before:?} before");
    println!("{} records before the cut, {late} of them arrived after the block was seen here", received.len());
    // What was captured meanwhile has reached its owner.
    let records = poll(60, || {
        let records = gate.alice.records(&["records", "list", "--oldest"]);
        records.iter().any(|record| record["epoch"] == 2).then_some(records)
    });
    let records = records.expect("captured in the next epoch");
    let given: BTreeSet<String> = received.iter().map(|(digest, _)| digest.to_hex()).collect();
    for record in records.iter().filter(|record| record["epoch"] == 2) {
        assert!(!given.contains(&text(record, "digest")), "of the next epoch: {record}");
    }
    assert!(list(&gate.alice.json(&["grant", "list"]), "grants").iter().all(|grant| grant["state"] != "active"));
    drop(gate.home);
}

//! A gateway in a home of its own over a chain that others use too, a robot that knows several of its addresses, an owner
//! and readers whose homes join it. Whatever happens to the gateway or to a line, nothing is lost and nothing is twice.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

mod console;
mod cutting;
mod erasing;
mod failures;
mod granting;
mod ground;
mod holding;
mod killing;
mod lost_machine;
mod postgres;
mod postgres_failover;
mod postgres_join;
mod sessions;
mod swarm;
mod workers;

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use ground::Ground;
use serde_json::Value;
use support::{Authros, Cable, Home, Running, count, free_port, heavy, is_verified, poll, text, wait_until};

const TOPIC: &str = "/robot1/odom";
const REFUSED: i32 = 5;

/// A gateway in a home of its own.
struct Gateway {
    home: Home,
    port: u16,
    chain: [String; 2],
    confirmations: &'static str,
    site: Option<Running>,
    key: String,
    domain: String,
    /// Its database, if it has no file.
    store: Option<String>,
}

impl Gateway {
    fn new(ground: &Ground) -> Self {
        Self::confirming_after(ground, "1")
    }

    /// One that calls an anchor confirmed after this many blocks.
    fn confirming_after(ground: &Ground, confirmations: &'static str) -> Self {
        Self::of([ground.url.clone(), ground.contract.clone()], confirmations, None)
    }

    /// One that reaches the chain by a line that can be cut.
    fn over(ground: &Ground, line: &Cable) -> Self {
        Self::of([format!("http://{}", line.address()), ground.contract.clone()], "1", None)
    }

    /// One whose records are in a database.
    fn on_server(ground: &Ground, url: &str) -> Self {
        Self::of([ground.url.clone(), ground.contract.clone()], "1", Some(url.to_owned()))
    }

    fn of(chain: [String; 2], confirmations: &'static str, store: Option<String>) -> Self {
        let (home, port, site, key, domain) = (Home::new(), free_port(), None, String::new(), String::new());
        let mut gateway = Self { home, port, chain, confirmations, site, key, domain, store };
        gateway.start();
        gateway
    }

    fn keeper(&self) -> Authros {
        let [url, contract] = &self.chain;
        let options = ["--chain", url, "--contract", contract, "--robots", "0", "--confirmations", self.confirmations];
        let keeper = self.home.profile("keeper").with(&options);
        match &self.store {
            Some(url) => keeper.with_variable("AUTHROS_STORE", url),
            None => keeper,
        }
    }

    fn address(&self) -> String {
        format!("127.0.0.1:{}", self.port)
    }

    fn start(&mut self) {
        let keeper = self.keeper().with(&["--json"]);
        let mut site = keeper.spawn(&["gateway", "serve", "--listen", &self.address()]);
        let said = site.wait_for_text("\"gateway\"", 120);
        let line = said.lines().find(|line| line.contains("\"gateway\"")).expect("a document");
        let view = serde_json::from_str::<Value>(line).expect("JSON")["gateway"].clone();
        (self.key, self.domain) = (text(&view, "gateway"), text(&view, "domain"));
        self.site = Some(site);
    }

    /// Another worker of the same gateway on its database: a home with the same keys, and an address of its own.
    fn worker_beside(&self) -> Self {
        let home = Home::new();
        let [from, to] = [&self.home, &home].map(|home| home.path().to_str().expect("UTF-8").to_owned());
        support::process::output_of("cp", &["-a", &from, &to]);
        let (chain, store, confirmations) = (self.chain.clone(), self.store.clone(), self.confirmations);
        let (port, key, domain) = (free_port(), String::new(), String::new());
        let mut worker = Self { home, port, chain, confirmations, site: None, key, domain, store };
        worker.start();
        worker
    }

    fn kill(&mut self) {
        self.site.take().expect("running").stop("KILL", 10);
    }

    fn admit(&self, owner: &str) {
        self.keeper().json(&["gateway", "allow", owner]);
    }
}

/// Somebody who joins a gateway, at a site that keeps running.
struct Member {
    home: Home,
    authros: Authros,
    address: String,
    site: Option<Running>,
}

impl Member {
    fn new(name: &str, gateway: &Gateway) -> Self {
        Self::at(None, name, (gateway, &[&gateway.address()]))
    }

    /// One whose transactions may cost something on that chain, and who knows these addresses of the gateway.
    fn at(ground: Option<&Ground>, name: &str, (gateway, addresses): (&Gateway, &[&str])) -> Self {
        let home = Home::new();
        let authros = home
            .profile(name)
            .with_variable("AUTHROS_SITE", &addresses.join(","))
            .with_variable("AUTHROS_GATEWAY_KEY", &gateway.key);
        if let Some(ground) = ground {
            ground.fund(&text(&authros.json(&["identity", "create"]), "address"));
        }
        let address = authros.enrol();
        gateway.admit(&address);
        let mut member = Self { home, authros, address, site: None };
        member.site = Some(member.authros.serve(&member.home));
        member
    }

    /// That many records are verified here, and the reader's list has the same, each once.
    fn shares_all_with(&self, reader: &Self, count: u64) {
        let own = self.verified(&["records", "list", "--oldest"], count);
        let shared = reader.verified(&["received", "list", "--oldest", "--owner", &self.address], count);
        assert_eq!(shared, own, "each once in the reader's list");
    }

    fn grant(&self, reader: &Self) {
        let print = text(&reader.authros.json(&["identity", "show"]), "fingerprint");
        let name = format!("reader-{}", reader.address[2..10].to_lowercase());
        self.authros.json(&["contacts", "add", &name, &reader.address, "--fingerprint", &print]);
        self.authros.json(&["grant", "add", "--to", &name]);
    }

    /// The ids of all records of a list, once there are this many and each is verified.
    fn verified(&self, list: &[&str], wanted: u64) -> BTreeSet<String> {
        let mut seen = Vec::new();
        let records = poll(180, || {
            seen = self.authros.records_so_far(list)?;
            let done = seen.len() as u64 >= wanted && seen.iter().all(is_verified);
            done.then(|| std::mem::take(&mut seen))
        });
        let Some(records) = records else {
            let name = |record: &Value| format!("{} {}", record["id"], record["state"]);
            let seen: Vec<String> = seen.iter().map(name).collect();
            panic!("not {wanted} records are verified here within 180 s, but {}: {seen:?}", seen.len());
        };
        let ids: BTreeSet<String> = records.iter().map(|record| text(record, "id")).collect();
        assert_eq!((records.len() as u64, ids.len() as u64), (wanted, wanted), "none lost and none twice");
        ids
    }
}

/// A robot that knows the gateway.
struct Robot {
    home: Home,
    enrolment: String,
}

impl Robot {
    fn enrol(owner: &Member, name: &str, gateway: &Gateway) -> Self {
        Self::at(owner, name, (gateway, &[&gateway.address()]))
    }

    /// One that knows these addresses of the gateway.
    fn at(owner: &Member, name: &str, (gateway, addresses): (&Gateway, &[&str])) -> Self {
        let home = Home::new();
        let enrolment = home.root().join("robot.enrolment").to_str().expect("UTF-8").to_owned();
        let mut arguments = vec!["robot", "enrol", "--name", name, "--topic", TOPIC, "--out", &enrolment];
        arguments.extend(addresses.iter().flat_map(|address| ["--gateway", address]));
        arguments.extend(["--gateway-key", &gateway.key]);
        let view = owner.authros.json(&arguments);
        assert_eq!(
            (text(&view["gateway"], "key"), &view["gateway"]["addresses"]),
            (gateway.key.clone(), &serde_json::json!(addresses))
        );
        Self { home, enrolment }
    }

    fn run(&self, arguments: &[&str]) -> Running {
        let agent = self.home.authros().with(&["--json"]);
        agent.spawn(&[&["robot", "run", &self.enrolment, "--robots", "1"], arguments].concat())
    }

    /// Runs for this many messages, until everything of the outbox is verified at the gateway; returns how many messages
    /// that are.
    fn bring(&self, messages: &str) -> u64 {
        let outcome = self.run(&["--count", messages]).wait(180).expect_code(0);
        let summary: Value = serde_json::from_str(outcome.stdout.lines().last().expect("a document")).expect("JSON");
        let captured = count(&summary, "captured");
        let [verified, pending, tampered] = ["verified", "pending", "tampered"].map(|field| count(&summary, field));
        assert_eq!((verified, pending, tampered), (captured, 0, 0), "{summary}");
        captured
    }
}

/// The newest figures of a running agent, once they pass the test.
fn figures(agent: &Running, what: &str, test: impl Fn(&Value) -> bool) -> Value {
    wait_until(90, what, || {
        let newest = agent.stdout().lines().rev().find_map(|line| serde_json::from_str::<Value>(line).ok())?;
        test(&newest).then_some(newest)
    })
}

fn is_home(figures: &Value) -> bool {
    figures["gateway"] == "connected"
}

fn is_in_place(figures: &Value) -> bool {
    figures["gateway"].as_str().is_some_and(|words| words.contains(" instead of "))
}

fn accepted(agent: &Running, more_than: u64) -> u64 {
    let found = figures(agent, "records are accepted", |figures| count(figures, "accepted") > more_than);
    count(&found, "accepted")
}

#[test]
fn a_robot_and_a_reader_turn_to_the_next_address_and_the_robot_goes_home() {
    let _alone = heavy();
    let ground = Ground::new();
    let gateway = Gateway::new(&ground);
    let line = Cable::to(gateway.port);
    let both: [&str; 2] = [&line.address(), &gateway.address()];
    let (alice, bob) = (Member::new("alice", &gateway), Member::at(None, "bob", (&gateway, &both)));
    alice.grant(&bob);
    let robot = Robot::at(&alice, "scout", (&gateway, &both));
    let agent = robot.run(&[]);
    figures(&agent, "its records are taken", |figures| is_home(figures) && count(figures, "accepted") > 10);

    line.cut();
    let begun = Instant::now();
    let away = figures(&agent, "the next address is used", is_in_place);
    let taken = accepted(&agent, count(&away, "accepted"));
    println!("the first line was cut: records go by the second one after {:?}", begun.elapsed());
    accepted(&agent, taken + 20);
    let shared = ["received", "list", "--oldest", "--owner", &alice.address];
    wait_until(60, "the reader has them, too", || {
        let seen = bob.authros.records_so_far(&shared)?;
        (seen.len() as u64 >= taken).then_some(())
    });
    line.mend();
    let begun = Instant::now();
    let back = figures(&agent, "it goes home", is_home);
    println!("the first line is back: the robot is home after {:?}", begun.elapsed());
    accepted(&agent, count(&back, "accepted") + 5);
    agent.stop("TERM", 20);

    let all = robot.bring("5");
    let own = alice.verified(&["records", "list", "--oldest"], all);
    assert_eq!(bob.verified(&shared, all), own, "the reader has the same");
}

#[test]
fn a_robot_of_one_address_is_given_another() {
    let ground = Ground::new();
    let gateway = Gateway::new(&ground);
    let line = Cable::to(gateway.port);
    let alice = Member::new("alice", &gateway);
    let robot = Robot::at(&alice, "scout", (&gateway, &[&line.address()]));
    let mut agent = robot.run(&[]);
    figures(&agent, "its records are taken", |figures| is_home(figures) && count(figures, "accepted") > 5);

    let address = gateway.address();
    let added = alice.authros.json(&["robot", "addresses", "add", "scout", &address]);
    assert_eq!(added["gateway"]["addresses"], serde_json::json!([line.address(), address]), "{added}");
    alice.authros.fails(REFUSED, &["robot", "addresses", "add", "scout", &address]);
    agent.wait_for_text("the gateway's addresses are now", 120);
    line.cut();
    let away = figures(&agent, "the new address is used", is_in_place);
    accepted(&agent, count(&away, "accepted") + 5);
    agent.stop("TERM", 20);
    // It is remembered.
    let all = robot.bring("5");
    alice.verified(&["records", "list", "--oldest"], all);
}

#[test]
fn what_died_with_a_gateways_disk_is_brought_again_by_its_robot() {
    let ground = Ground::new();
    let mut gateway = Gateway::new(&ground);
    let (alice, bob) = (Member::new("alice", &gateway), Member::new("bob", &gateway));
    alice.grant(&bob);
    let robot = Robot::enrol(&alice, "scout", &gateway);
    let before = robot.bring("5");
    let secret = gateway.home.file("secret", "a passphrase of its own\n", 0o600);
    let file = gateway.home.root().join("home.backup").to_str().expect("UTF-8").to_owned();
    gateway.keeper().json(&["backup", "create", &file, "--passphrase-file", &secret]);

    // It signs receipts for what follows, and its disk dies before it has proven any of it.
    gateway.kill();
    gateway.confirmations = "1000";
    gateway.start();
    let agent = robot.run(&[]);
    let receipted = accepted(&agent, before + 10);
    gateway.kill();
    agent.stop("TERM", 20);
    let lost = std::mem::replace(&mut gateway.home, Home::new());
    gateway.confirmations = "1";
    gateway.keeper().json(&["backup", "restore", &file, "--passphrase-file", &secret]);
    drop(lost);
    gateway.start();

    let all = robot.bring("5");
    assert!(all > receipted, "{all}");
    println!("{receipted} records had a receipt when the gateway's disk died; {all} are verified");
    let own = alice.verified(&["records", "list", "--oldest"], all);
    assert_eq!(
        bob.verified(&["received", "list", "--oldest", "--owner", &alice.address], all),
        own,
        "the reader has the same"
    );
}

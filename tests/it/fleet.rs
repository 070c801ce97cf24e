//! A fleet: gateways in homes of their own over one chain, a robot that knows several of them, an owner and a reader who
//! join all of them. Whatever happens to one gateway, nothing is lost and nothing is there twice.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

mod console;
mod copies;
mod cutting;
mod doubling;
mod earlier;
mod enduring;
mod erasing;
mod granting;
mod ground;
mod killing;
mod lacking;
mod parting;
mod reconciling;
mod sessions;
mod shared_vault;
mod swarm;

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use ground::Ground;
use reconciling::{name_each_other, reconciled};
use serde_json::Value;
use support::{Authros, Cable, Home, Running, count, free_port, heavy, is_verified, poll, text, wait_until};

const TOPIC: &str = "/robot1/odom";
const UNREACHABLE: i32 = 4;

/// A gateway in a home of its own.
struct Gateway {
    home: Home,
    port: u16,
    chain: [String; 2],
    confirmations: &'static str,
    site: Option<Running>,
    key: String,
    domain: String,
    /// The port of its figures, if it shows any.
    figures: Option<u16>,
    /// Its vault; if empty, one of its own.
    vault: String,
    /// Further settings, by environment.
    variables: Vec<(&'static str, &'static str)>,
}

impl Gateway {
    fn new(ground: &Ground) -> Self {
        Self::confirming_after(ground, "1")
    }

    /// One that calls an anchor confirmed after so many blocks.
    fn confirming_after(ground: &Ground, confirmations: &'static str) -> Self {
        Self::made(ground, confirmations, "")
    }

    /// One with these settings.
    fn set(ground: &Ground, variables: &[(&'static str, &'static str)]) -> Self {
        let mut gateway = Self::new(ground);
        gateway.kill();
        gateway.variables = variables.to_vec();
        gateway.start();
        gateway
    }

    /// One that keeps its records in this vault.
    fn keeping_in(ground: &Ground, vault: &str) -> Self {
        Self::made(ground, "1", vault)
    }

    /// One that reaches the chain by a line that can be cut.
    fn over(ground: &Ground, line: &Cable) -> Self {
        Self::of([format!("http://{}", line.address()), ground.contract.clone()], "1", "")
    }

    fn made(ground: &Ground, confirmations: &'static str, vault: &str) -> Self {
        Self::of([ground.url.clone(), ground.contract.clone()], confirmations, vault)
    }

    fn of(chain: [String; 2], confirmations: &'static str, vault: &str) -> Self {
        let (home, port, vault) = (Home::new(), free_port(), vault.to_owned());
        let (site, key, domain, figures) = (None, String::new(), String::new(), None);
        let variables = Vec::new();
        let mut gateway = Self { home, port, chain, confirmations, site, key, domain, figures, vault, variables };
        gateway.start();
        gateway
    }

    /// One that shows figures.
    fn with_figures(ground: &Ground) -> Self {
        let mut gateway = Self::new(ground);
        gateway.kill();
        gateway.figures = Some(free_port());
        gateway.start();
        gateway
    }

    fn keeper(&self) -> Authros {
        self.profile("keeper")
    }

    /// Somebody whose profile is in its home.
    fn profile(&self, name: &str) -> Authros {
        let [url, contract] = &self.chain;
        let options = ["--chain", url, "--contract", contract, "--robots", "0", "--confirmations", self.confirmations];
        let profile = self.home.profile(name).with(&options);
        let profile = self.variables.iter().fold(profile, |profile, (name, value)| profile.with_variable(name, value));
        if self.vault.is_empty() { profile } else { profile.with(&["--vault", &self.vault]) }
    }

    fn address(&self) -> String {
        format!("127.0.0.1:{}", self.port)
    }

    fn start(&mut self) {
        let figures = self.figures.map(|port| format!("127.0.0.1:{port}")).unwrap_or_default();
        let keeper = self.keeper().with(&["--json"]).with_variable("AUTHROS_METRICS_LISTEN", &figures);
        let mut site = keeper.spawn(&["gateway", "serve", "--listen", &self.address()]);
        let said = site.wait_for_text("\"gateway\"", 120);
        let line = said.lines().find(|line| line.contains("\"gateway\"")).expect("a document");
        let view = serde_json::from_str::<Value>(line).expect("JSON")["gateway"].clone();
        (self.key, self.domain) = (text(&view, "gateway"), text(&view, "domain"));
        self.site = Some(site);
    }

    fn kill(&mut self) {
        self.site.take().expect("running").stop("KILL", 10);
    }

    fn admit(&self, owner: &str) {
        self.keeper().json(&["gateway", "admit", owner]);
    }
}

/// Somebody who joins all gateways, at a site that keeps running.
struct Member {
    home: Home,
    authros: Authros,
    address: String,
    site: Option<Running>,
}

impl Member {
    fn new(name: &str, gateways: &[&Gateway]) -> Self {
        Self::on(None, name, gateways)
    }

    /// One whose transactions may cost something on that chain.
    fn on(ground: Option<&Ground>, name: &str, gateways: &[&Gateway]) -> Self {
        let (home, first) = (Home::new(), gateways[0]);
        let also: Vec<String> =
            gateways[1..].iter().map(|gateway| format!("{}={}", gateway.address(), gateway.key)).collect();
        let authros = home
            .profile(name)
            .with_variable("AUTHROS_SITE", &first.address())
            .with_variable("AUTHROS_GATEWAY_KEY", &first.key)
            .with_variable("AUTHROS_SITE_ALSO", &also.join(","));
        if let Some(ground) = ground {
            ground.fund(&text(&authros.json(&["identity", "create"]), "address"));
        }
        let address = authros.enrol();
        gateways.iter().filter(|gateway| gateway.site.is_some()).for_each(|gateway| gateway.admit(&address));
        let mut member = Self { home, authros, address, site: None };
        member.site = Some(member.authros.serve(&member.home));
        member
    }

    fn grant(&self, reader: &Self) {
        let print = text(&reader.authros.json(&["identity", "show"]), "fingerprint");
        let name = format!("reader-{}", reader.address[2..10].to_lowercase());
        self.authros.json(&["contacts", "add", &name, &reader.address, "--fingerprint", &print]);
        self.authros.json(&["grant", "--to", &name]);
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

/// A robot that knows these gateways.
struct Robot {
    home: Home,
    enrolment: String,
}

impl Robot {
    fn enrol(owner: &Member, name: &str, gateways: &[&Gateway]) -> Self {
        let home = Home::new();
        let enrolment = home.root().join("robot.enrolment").to_str().expect("UTF-8").to_owned();
        let places: Vec<String> = gateways.iter().map(|gateway| gateway.address()).collect();
        let mut arguments = vec!["agent", "enrol", "--name", name, "--topic", TOPIC, "--out", &enrolment];
        for (gateway, place) in gateways.iter().zip(&places) {
            arguments.extend(["--gateway", place, "--gateway-key", &gateway.key]);
        }
        let view = owner.authros.json(&arguments);
        assert_eq!(view["gateways"].as_array().map(Vec::len), Some(gateways.len()), "{view}");
        Self { home, enrolment }
    }

    /// What stays without a proof for three seconds goes to the next gateway.
    fn run(&self, arguments: &[&str]) -> Running {
        let agent = self.home.authros().with(&["--json"]).with_variable("AUTHROS_RESEND_AFTER", "3s");
        agent.spawn(&[&["agent", "run", &self.enrolment, "--robots", "1"], arguments].concat())
    }

    /// Runs until everything of the outbox is verified at some gateway; returns how many messages that are.
    fn settle(&self) -> u64 {
        let outcome = self.run(&["--count", "5"]).wait(180).expect_code(0);
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

fn is_connected(figures: &Value) -> bool {
    figures["gateway"].as_str().is_some_and(|words| words.starts_with("connected"))
}

fn accepted(agent: &Running, more_than: u64) -> u64 {
    let found = figures(agent, "records are accepted", |figures| count(figures, "accepted") > more_than);
    count(&found, "accepted")
}

#[test]
fn a_robot_turns_to_the_next_gateway_and_goes_home() {
    let _alone = heavy();
    let ground = Ground::new();
    let (mut first, second) = (Gateway::new(&ground), Gateway::new(&ground));
    let both = [&first, &second];
    let (alice, bob) = (Member::new("alice", &both), Member::new("bob", &both));
    alice.grant(&bob);
    let robot = Robot::enrol(&alice, "scout", &both);
    let agent = robot.run(&[]);
    figures(&agent, "the first gateway takes records", |figures| is_home(figures) && count(figures, "accepted") > 10);

    first.kill();
    let begun = Instant::now();
    let away = figures(&agent, "the second gateway takes over", |figures| {
        figures["gateway"].as_str().is_some_and(|words| words.contains("in place of"))
    });
    let taken = accepted(&agent, count(&away, "accepted"));
    println!("the first gateway was killed: the second takes records after {:?}", begun.elapsed());
    accepted(&agent, taken + 20);
    first.start();
    let begun = Instant::now();
    let back = figures(&agent, "it goes home", is_home);
    println!("the first gateway is back: the robot is home after {:?}", begun.elapsed());
    accepted(&agent, count(&back, "accepted") + 5);
    agent.stop("TERM", 20);

    let all = robot.settle();
    let own = alice.verified(&["uploads", "list"], all);
    assert_eq!(bob.verified(&["shared", "list", "--owner", &alice.address], all), own, "the reader has the same");
}

#[test]
fn the_disk_of_a_gateway_is_deleted_after_its_receipts_and_nothing_is_lost() {
    let ground = Ground::new();
    // It signs receipts and never gets as far as a proof.
    let mut first = Gateway::confirming_after(&ground, "1000");
    let second = Gateway::new(&ground);
    let both = [&first, &second];
    let (alice, bob) = (Member::new("alice", &both), Member::new("bob", &both));
    alice.grant(&bob);
    let robot = Robot::enrol(&alice, "scout", &both);
    let agent = robot.run(&[]);
    let before = figures(&agent, "the first gateway takes records", |figures| {
        is_home(figures) && count(figures, "accepted") > 10
    });
    first.kill();
    let receipted = count(&before, "accepted");
    let lost = std::mem::replace(&mut first.home, Home::new());
    drop(lost);
    accepted(&agent, receipted + 20);
    agent.stop("TERM", 20);

    let all = robot.settle();
    println!("{receipted} records and more had receipts of the gateway whose disk was deleted; {all} are verified");
    let own = alice.verified(&["uploads", "list"], all);
    assert_eq!(bob.verified(&["shared", "list", "--owner", &alice.address], all), own, "the reader has the same");
}

#[test]
fn a_robot_of_one_gateway_goes_on_and_is_given_another() {
    let ground = Ground::new();
    let (mut first, mut second) = (Gateway::new(&ground), Gateway::new(&ground));
    let alice = Member::new("alice", &[&first, &second]);
    let robot = Robot::enrol(&alice, "scout", &[&first]);
    let mut agent = robot.run(&[]);
    figures(&agent, "its gateway takes records", |figures| is_home(figures) && count(figures, "accepted") > 5);

    // The other one is away when it is added; the robot is told when it is back.
    second.kill();
    let (place, key) = (second.address(), second.key.clone());
    let added = alice.authros.json(&["devices", "gateways", "add", "scout", &place, &key]);
    let known = |view: &Value| -> Vec<bool> {
        let gateways = view["gateways"].as_array().expect("a list");
        gateways.iter().map(|gateway| gateway["known"] == true).collect()
    };
    assert_eq!(known(&added), [true, false], "{added}");
    alice.authros.fails(5, &["devices", "gateways", "add", "scout", &place, &key]);
    second.start();
    agent.wait_for_text("the owner names the gateways", 120);
    first.kill();
    let away = figures(&agent, "the new gateway takes over", |figures| {
        figures["gateway"].as_str().is_some_and(|words| words.contains("in place of"))
    });
    accepted(&agent, count(&away, "accepted") + 5);
    agent.stop("TERM", 20);
    first.start();
    let all = robot.settle();
    alice.verified(&["uploads", "list"], all);
}

/// Numbers that are the same at every run.
struct Chance(u64);

impl Chance {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % limit
    }
}

#[test]
fn three_gateways_are_killed_at_random_and_nothing_is_lost() {
    if !support::long() {
        return;
    }
    let _alone = heavy();
    let ground = Ground::new();
    let mut gateways = [Gateway::new(&ground), Gateway::new(&ground), Gateway::new(&ground)];
    let all = [&gateways[0], &gateways[1], &gateways[2]];
    let (alice, bob) = (Member::new("alice", &all), Member::new("bob", &all));
    alice.grant(&bob);
    name_each_other(&all);
    let robot = Robot::enrol(&alice, "scout", &all);
    let agent = robot.run(&[]);
    accepted(&agent, 0);
    let (mut chance, mut failovers, begun) = (Chance(22), Vec::new(), Instant::now());
    while begun.elapsed() < Duration::from_secs(240) {
        let one = usize::try_from(chance.below(3)).expect("small");
        let serves = gateways.iter().take(one).all(|before| before.site.is_none());
        let before = figures(&agent, "it is connected", is_connected)["gateway"].clone();
        gateways[one].kill();
        let killed = Instant::now();
        let newest = figures(&agent, "it is connected", |figures| {
            is_connected(figures) && (!serves || figures["gateway"] != before)
        });
        if serves {
            failovers.push(killed.elapsed());
        }
        accepted(&agent, count(&newest, "accepted"));
        std::thread::sleep(Duration::from_secs(chance.below(6)));
        gateways[one].start();
        std::thread::sleep(Duration::from_secs(chance.below(6)));
    }
    agent.stop("TERM", 20);
    failovers.sort();
    let middle = failovers.get(failovers.len() / 2);
    println!("{} gateways in use were killed: failover p50 {middle:?}, max {:?}", failovers.len(), failovers.last());

    let all = robot.settle();
    let own = alice.verified(&["uploads", "list"], all);
    let shared = ["shared", "list", "--owner", &alice.address];
    assert_eq!(bob.verified(&shared, all), own, "the reader has the same");
    let begun = Instant::now();
    gateways.iter().for_each(|gateway| drop(reconciled(gateway, 0)));
    println!("all three hold the same {:?} after the robot settled", begun.elapsed());
    for (gateway, name) in gateways.iter().zip(["carol", "dave", "erin"]) {
        let reader = Member::new(name, &[gateway]);
        alice.grant(&reader);
        assert_eq!(reader.verified(&shared, all), own, "{name}, who asks one gateway alone, has the same");
    }
}

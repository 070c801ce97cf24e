//! A site with simulated robots and a real node, watched from both sides.

use std::cell::RefCell;
use std::collections::BTreeMap;

use serde_json::Value;

use super::evidence::{self, Anchor, expect_chained, expect_once, lies, says_mined};
use crate::support::{Anvil, Authros, Home, Running, count, poll, text, wait_until};

/// The first robot's topic; 20 messages a second.
pub const TOPIC: &str = "/robot1/odom";
/// Every kind of record that a site creates by itself.
const KINDS: [&str; 3] = ["data", "definition", "gap"];

/// How records are put on the chain.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// One transaction per record.
    Each,
    /// One transaction per Merkle batch.
    Batch,
}

impl Mode {
    fn word(self) -> &'static str {
        match self {
            Self::Each => "each",
            Self::Batch => "batch",
        }
    }
}

/// One home, its site, and everything ever acknowledged in it.
pub struct Field {
    /// The home.
    pub home: Home,
    /// Its only profile.
    pub authros: Authros,
    /// The profile's account.
    pub address: String,
    /// The contract in use.
    pub contract: String,
    topics: Vec<String>,
    site: RefCell<Option<Running>>,
    known: RefCell<BTreeMap<String, Value>>,
}

impl Field {
    /// A new home whose site uses the node at `url`, with more options for every command.
    pub fn open(url: &str, mode: Mode, options: &[&str]) -> Self {
        Self::in_home(Home::new(), url, mode, 1, options)
    }

    /// The same in a home that may not be empty, with this many robots, each with a captured topic.
    pub fn in_home(home: Home, url: &str, mode: Mode, robots: usize, options: &[&str]) -> Self {
        let (word, number) = (mode.word(), robots.to_string());
        let authros = home.authros().with(&["--chain", url, "--anchor-mode", word, "--robots", &number]);
        let authros = authros.with(options);
        let site = authros.serve(&home);
        let address = text(&authros.json(&["identity", "show"]), "address");
        let contract = text(&authros.json(&["chain", "status"]), "contract");
        let site = RefCell::new(Some(site));
        let topics = (1..=robots).map(|robot| format!("/robot{robot}/odom")).collect();
        Self { home, authros, address, contract, topics, site, known: RefCell::default() }
    }

    /// Starts capturing the robots' topics.
    pub fn watch(&self) {
        for topic in &self.topics {
            self.authros.run(&["topics", "watch", topic]).expect_code(0);
        }
    }

    /// Captures until at least `least` more messages are acknowledged; returns all records.
    pub fn grow(&self, least: usize) -> Vec<Value> {
        let before = self.data().len();
        self.watch();
        wait_until(60, "records arrive", || (self.data().len() >= before + least).then_some(()));
        self.rest();
        self.records()
    }

    /// Stops capturing, and waits until everything in flight is acknowledged.
    pub fn rest(&self) {
        for topic in &self.topics {
            self.authros.run(&["topics", "unwatch", topic]).expect_code(0);
        }
        let mut last = 0;
        wait_until(30, "the last record arrives", || {
            std::thread::sleep(std::time::Duration::from_millis(250));
            let now = self.data().len();
            (std::mem::replace(&mut last, now) == now).then_some(())
        });
    }

    fn data(&self) -> Vec<Value> {
        self.authros.records(&["records", "list", "--oldest"])
    }

    /// All records of every kind; fails if an earlier one is gone or has changed.
    pub fn records(&self) -> Vec<Value> {
        let list = |kind: &&str| self.authros.records(&["records", "list", "--oldest", "--kind", kind]);
        let records: Vec<Value> = KINDS.iter().flat_map(list).collect();
        let mut known = self.known.borrow_mut();
        let now: BTreeMap<String, Value> = records.iter().map(|one| (text(one, "digest"), one.clone())).collect();
        assert_eq!(now.len(), records.len(), "every digest once");
        for (digest, record) in known.iter() {
            let kept = now.get(digest).unwrap_or_else(|| panic!("acknowledged, and lost: {record}"));
            assert_eq!((&kept["topic"], &kept["seq"]), (&record["topic"], &record["seq"]), "another record");
            assert!(!["tampered", "dropped"].contains(&text(kept, "state").as_str()), "{kept}");
        }
        *known = now;
        records
    }

    /// The chain's anchors as they are now.
    pub fn anchors(&self, node: &Anvil) -> Vec<Anchor> {
        evidence::anchors(node, &self.contract)
    }

    /// All records, checking that their states match the chain, unless blocks were replaced just before.
    pub fn true_records(&self, node: &Anvil) -> Vec<Value> {
        // The chain is queried last: it may only know more than the program did.
        let records = self.records();
        assert_eq!(lies(&records, &self.anchors(node)), Vec::<String>::new(), "states that lie");
        records
    }

    /// Waits until every state is true again, after blocks were replaced.
    pub fn expect_truth_within(&self, node: &Anvil, seconds: u64) -> Vec<Value> {
        let mut found = Vec::new();
        let records = poll(seconds, || {
            let records = self.records();
            found = lies(&records, &self.anchors(node));
            found.is_empty().then_some(records)
        });
        records.unwrap_or_else(|| panic!("{} states still lie after {seconds} s: {found:?}", found.len()))
    }

    /// While the chain is stalled: only `anchored` records claim to be in a block, now and later.
    pub fn expect_still(&self, node: &Anvil, anchored: usize) {
        for _ in 0..3 {
            let mined = self.true_records(node).into_iter().filter(says_mined).count();
            assert_eq!(mined, anchored, "records in blocks while no block comes");
            std::thread::sleep(std::time::Duration::from_millis(400));
        }
    }

    /// Waits until all records are verified, and every one is anchored once.
    pub fn expect_settled(&self, node: &Anvil, seconds: u64) -> Vec<Value> {
        let records = self.expect_verified(node, seconds);
        let anchors = self.anchors(node);
        expect_once(&records, &anchors);
        expect_chained(&anchors);
        records
    }

    /// Waits until all records are verified, with true states at each check.
    pub fn expect_verified(&self, node: &Anvil, seconds: u64) -> Vec<Value> {
        let mut words = BTreeMap::new();
        let records = poll(seconds, || {
            let records = self.true_records(node);
            words = states(&records);
            (words.len() == 1 && words.contains_key("verified")).then_some(records)
        });
        records.unwrap_or_else(|| panic!("not all verified within {seconds} s: {words:?}\n{}", self.said()))
    }

    /// The site's messages to the operator so far.
    pub fn said(&self) -> String {
        self.site.borrow().as_ref().map(|site| site.stderr()).unwrap_or_default()
    }

    /// Waits until the site reports one of these texts on its error output.
    pub fn expect_told(&self, words: &[&str], seconds: u64) {
        let told = poll(seconds, || {
            let said = self.said().to_lowercase();
            words.iter().any(|word| said.contains(word)).then_some(())
        });
        assert!(told.is_some(), "the operator is not told (one of {words:?}):\n{}", self.said());
    }

    /// Kills the site and starts it again.
    pub fn restart_site(&self) {
        if let Some(site) = self.site.take() {
            site.stop("KILL", 10);
        }
        self.site.replace(Some(self.authros.serve(&self.home)));
    }

    /// Kills the site and starts it again when it cannot use its chain, which it reports.
    pub fn restart_site_unready(&self, words: &[&str]) {
        if let Some(site) = self.site.take() {
            site.stop("KILL", 10);
        }
        self.site.replace(Some(self.authros.spawn(&["serve"])));
        self.expect_told(words, 60);
    }

    /// Waits until `chain status` says that this profile's lane is paused for this reason.
    pub fn expect_paused(&self, reason: &str, seconds: u64) {
        let mut lanes = Value::Null;
        let paused = poll(seconds, || {
            lanes = self.authros.json(&["chain", "status"])["lanes"].clone();
            (lanes[0]["paused"]["reason"] == reason).then_some(())
        });
        assert!(paused.is_some(), "no lane paused for {reason}: {lanes}\n{}", self.said());
    }

    /// Transactions of the profile that the program counts as not yet in a block.
    pub fn pending(&self) -> u64 {
        count(&self.authros.json(&["chain", "status"]), "pending")
    }
}

/// How many records are in each state.
pub fn states(records: &[Value]) -> BTreeMap<String, usize> {
    let mut words = BTreeMap::new();
    for record in records {
        *words.entry(text(record, "state")).or_default() += 1;
    }
    words
}

/// Digests of records.
pub fn digests(records: &[Value]) -> Vec<String> {
    records.iter().map(|record| text(record, "digest")).collect()
}

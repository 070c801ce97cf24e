//! A home whose chain does not come back: every message is sealed anew in a new home with the same keys, and the old one
//! goes on opening, exporting and proving what it has.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use support::{
    Anvil, Authros, Home, Running, count, heavy, is_verified, list, skipped, system_program, text, wait_until,
};

use crate::evidence::{expect_agreement, expect_same_levels, unzipped, verified};

const ROBOTS: u64 = 10;
/// Messages of each robot before the chain is lost.
const EACH: u64 = 100;
/// Messages that come after it is lost, at least.
const PENDING: usize = 100;
/// A topic whose records go into a small bundle, for the slow second verifier.
const FEW: &str = "/chatter";
const INCOMPLETE: i32 = 8;
const REFUSED: i32 = 5;
const REMEDY: &str = "authros --home NEW records import OLD";

fn utf8(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

/// A home with verified records, on a chain that is about to be lost.
struct Old {
    home: Home,
    authros: Authros,
    topics: Vec<String>,
    site: Option<Running>,
    /// The bundle and trust file made while the chain was there.
    bundle: PathBuf,
    trust: PathBuf,
}

impl Old {
    fn new(options: &[&str]) -> Self {
        let home = Home::new();
        let authros = home.authros().with(options).with(&["--robots", &ROBOTS.to_string()]);
        let site = Some(authros.serve(&home));
        let topics: Vec<String> = (1..=ROBOTS).map(|robot| format!("/robot{robot}/odom")).collect();
        authros.capture(&topics.iter().map(String::as_str).collect::<Vec<_>>(), EACH);
        let ros2 = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/support/ros2.mcap");
        assert_eq!(count(&authros.json(&["bag", "import", ros2]), "verified"), 7);
        let records = authros.records(&["records", "list", "--oldest"]);
        assert!(records.len() as u64 == ROBOTS * EACH + 7 && records.iter().all(is_verified));
        let newest = records.iter().map(|record| count(record, "block")).max().expect("records");
        wait_until(60, "the chain's proofs are kept", || {
            let status = authros.json(&["status"]);
            let kept = list(&status, "health").into_iter().find(|part| part["part"] == "proofs");
            let kept = kept.map(|part| text(&part, "text")).unwrap_or_default();
            let block = kept.rsplit(' ').next().and_then(|block| block.parse::<u64>().ok());
            block.filter(|block| *block >= newest)
        });
        let (bundle, trust) = (home.root().join("before.authros"), home.root().join("trust.toml"));
        authros.json(&["evidence", "export", utf8(&bundle), "--topic", &topics[0]]);
        fs::write(&trust, unzipped(&bundle, "trust.toml")).expect("written");
        Self { home, authros, topics, site, bundle, trust }
    }

    fn stop(&mut self) {
        if let Some(site) = self.site.take() {
            site.stop("INT", 30);
        }
    }

    /// Starts the site again, which cannot use its chain any more.
    fn start_without_its_chain(&mut self) {
        self.stop();
        let mut site = self.authros.spawn(&["serve"]);
        site.wait_for_text(REMEDY, 60);
        wait_until(60, "others can join", || self.home.socket());
        self.site = Some(site);
    }

    /// What comes while there is no chain is kept, and waits.
    fn capture_without_the_chain(&mut self) -> Vec<Value> {
        let before = self.records().len();
        for topic in &self.topics {
            self.authros.run(&["topics", "watch", topic]).expect_code(0);
        }
        wait_until(60, "messages come without the chain", || (self.records().len() >= before + PENDING).then_some(()));
        for topic in &self.topics {
            self.authros.run(&["topics", "unwatch", topic]).expect_code(0);
        }
        self.stop();
        let records = self.records();
        let verified = records.iter().filter(|record| is_verified(record)).count();
        assert_eq!(verified, before, "nothing that comes now is called verified");
        records
    }

    fn records(&self) -> Vec<Value> {
        self.authros.records(&["records", "list", "--oldest"])
    }

    /// All messages that the home opens, as one MCAP file.
    fn messages(&self, authros: &Authros) -> Vec<u8> {
        let file = self.home.root().join(format!("{}.mcap", files_in(self.home.root())));
        authros.run(&["bag", "export", "--mcap", utf8(&file), "--unanchored"]).expect_code(0);
        fs::read(&file).expect("written")
    }

    /// The old home without its chain: everything opens and is exported, nothing is called verified, and evidence made now
    /// proves what evidence made before proved.
    fn expect_open(&self, records: &[Value]) {
        let record = records.iter().find(|record| record["topic"] == FEW).expect("a verified record");
        let id = text(record, "id");
        let opened = self.authros.with(&["--json"]).run(&["records", "open", &id]).expect_code(INCOMPLETE).document();
        assert_eq!(
            (&opened["verdict"], opened["message"]["data"].is_string()),
            (&json!("not_checked"), true),
            "{opened}"
        );
        assert!(text(&opened, "reason").contains(REMEDY), "{opened}");
        let checked = self.authros.run(&["records", "check", &id]).expect_code(INCOMPLETE).stdout;
        assert!(checked.contains("not checked against the chain now: ") && checked.contains(REMEDY), "{checked}");
        let folder = self.home.root().join("one");
        self.authros.run(&["records", "export", &id, "--dir", utf8(&folder)]).expect_code(0);
        assert!(folder.join("proof.json").exists());

        // Captured before the first that no block has.
        let unanchored = records.iter().filter(|record| !is_verified(record)).map(|record| text(record, "captured_at"));
        let until = unanchored.min().expect("records wait");
        let again = self.home.root().join("after.authros");
        self.authros.json(&["evidence", "export", utf8(&again), "--topic", &self.topics[0], "--until", &until]);
        expect_same_levels(&self.bundle, &again, &self.trust);
        if system_program("python3").is_some() {
            let few = self.home.root().join("few.authros");
            let view = self.authros.json(&["evidence", "export", utf8(&few), "--topic", FEW, "--reveal", &id]);
            assert!(view["notes"].to_string().contains("the chain was not queried"), "{view}");
            expect_agreement(&few, Some(&self.trust));
        }
        let all = self.home.root().join("all.authros");
        self.authros.json(&["evidence", "export", utf8(&all), "--until", &until]);
        let told = verified(&all, Some(&self.trust)).expect_code(INCOMPLETE).document();
        let proven = list(&told, "records").iter().filter(|record| record["bytes"]["standing"] == "proven").count();
        assert!(proven as u64 >= ROBOTS * EACH, "{proven} of {}", list(&told, "records").len());
        let is_refused =
            |record: &Value| ["bytes", "key", "anchor"].iter().any(|level| record[level]["standing"] == "refused");
        assert!(!list(&told, "records").iter().any(is_refused), "{}", told["outcome"]);
    }

    /// Every message arrives in a new home, by one command, also if that is interrupted.
    fn expect_all_arrive(&self, records: &[Value], options: &[&str]) {
        let there = self.messages(&self.authros);
        let (home, old) = (Home::new(), self.home.path());
        let new = home.authros().with(options).with(&["--robots", "0"]);
        let import = ["records", "import", utf8(&old)];
        let begun = new.spawn(&import);
        wait_until(60, "the import runs", || home.socket());
        wait_until(60, "some are sealed", || {
            let listed = new.with(&["--json"]).run(&["records", "list", "--oldest", "--limit", "1000"]);
            (listed.code == Some(0) && list(&listed.document(), "records").len() > 20).then_some(())
        });
        begun.stop("KILL", 10);
        let view = new.json(&import);
        let (imported, already) = (count(&view, "imported"), count(&view, "already"));
        assert!(imported > 0 && already > 20, "{view}");
        assert_eq!((imported + already, list(&view, "left_out")), (records.len() as u64, Vec::new()), "{view}");
        let view = new.json(&import);
        assert_eq!((count(&view, "imported"), count(&view, "already")), (0, records.len() as u64), "{view}");

        // What the interrupted import sealed is anchored by whatever runs next.
        let site = new.serve(&home);
        let arrived = wait_until(60, "all are verified", || {
            Some(new.records(&["records", "list", "--oldest"])).filter(|records| records.iter().all(is_verified))
        });
        site.stop("INT", 30).expect_code(0);
        assert!(arrived.len() == records.len() && arrived.iter().all(is_verified), "{} of them", arrived.len());
        assert!(self.messages(&new) == there, "topics, types, definitions, capture times and bytes");
        let moments = |records: &[Value]| -> BTreeSet<String> {
            records.iter().map(|record| text(record, "topic") + &text(record, "captured_at")).collect()
        };
        assert_eq!(moments(&arrived), moments(records));
        let opened = new.json(&["records", "open", &text(&arrived[0], "id")]);
        let former = list(&opened, "tags").into_iter().find(|tag| tag[0] == "former.record").expect("named");
        assert!(
            opened["verdict"] == "verified" && records.iter().any(|record| record["digest"] == former[1]),
            "{opened}"
        );
        let address = |authros: &Authros| text(&authros.json(&["identity", "show"]), "address");
        assert_eq!(address(&new), address(&self.authros), "the same keys");
    }
}

fn files_in(folder: &Path) -> usize {
    fs::read_dir(folder).expect("a folder").count()
}

#[test]
fn a_wiped_node_costs_no_message() {
    let _alone = heavy();
    let Some(node) = Anvil::start(&[]) else { skipped!("no anvil; tests/run installs it into target/peers") };
    let url = node.http();
    let mut old = Old::new(&["--chain", &url]);
    let _empty = node.kill_and_start_empty(&[]);
    if let Some(site) = &mut old.site {
        site.wait_for_text(REMEDY, 60);
    }
    let records = old.capture_without_the_chain();
    assert!(old.authros.fails(REFUSED, &["chain", "status"]).contains(REMEDY));
    old.expect_all_arrive(&records, &["--chain", &url]);
    old.expect_open(&records);
}

#[test]
fn a_contract_that_is_gone_costs_no_message() {
    let _alone = heavy();
    let Some(node) = Anvil::start(&[]) else { skipped!("no anvil; tests/run installs it into target/peers") };
    let url = node.http();
    let mut old = Old::new(&["--chain", &url]);
    let contract = text(&old.authros.json(&["chain", "status"]), "contract");
    node.call("anvil_setCode", &json!([contract, "0x"]));
    old.start_without_its_chain();
    let records = old.capture_without_the_chain();
    let told = old.authros.fails(REFUSED, &["chain", "status"]);
    assert!(told.contains("contract code hash is no code") && told.contains(REMEDY), "{told}");
    old.expect_all_arrive(&records, &["--chain", &url]);
    old.expect_open(&records);
}

#[test]
fn an_embedded_chain_that_is_deleted_costs_no_message() {
    let _alone = heavy();
    let mut old = Old::new(&[]);
    old.stop();
    let lost = old.home.root().join("lost");
    fs::rename(old.home.path().join("chain"), &lost).expect("moved away");
    old.start_without_its_chain();
    let records = old.capture_without_the_chain();
    let told = old.authros.fails(REFUSED, &["chain", "status"]);
    assert!(told.contains("is gone") && told.contains(REMEDY), "{told}");
    let doctor = old.authros.run(&["doctor"]).stdout;
    assert!(doctor.contains("is gone") && doctor.contains(REMEDY), "{doctor}");
    old.expect_all_arrive(&records, &[]);
    old.expect_open(&records);
    // Put back, it is used again.
    fs::rename(&lost, old.home.path().join("chain")).expect("moved back");
    let record = records.iter().find(|record| record["topic"] == FEW).expect("a verified record");
    assert_eq!(old.authros.json(&["records", "open", &text(record, "id")])["verdict"], "verified");
}

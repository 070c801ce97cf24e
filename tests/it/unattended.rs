//! Capture while the profile is locked: a machine boots, seals and anchors without its owner, twice; its memory holds none of
//! the owner's keys; what needs them is refused; the owner comes later and has everything.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use authros::crypto::UnattendedCredential;
use serde_json::Value;
use support::authros::files_below;
use support::memory::{found_in, memory_of, secrets_below};
use support::{Authros, Home, Running, heavy, is_verified, text, wait_until};

const REFUSED: i32 = 5;
const COVERED: &str = "/robot1/odom";
const OTHER: &str = "/robot2/odom";

/// The owner's machine: two watched topics, one of them in the credential, and no passphrase any more.
struct Machine {
    _home: Home,
    authros: Authros,
    credential: PathBuf,
    /// Where the owner keeps the passphrase.
    passphrase: PathBuf,
    /// All that the owners of the home have, by name.
    secrets: Vec<(String, Vec<u8>)>,
    reader: String,
}

impl Machine {
    fn new() -> Self {
        let home = Home::new();
        let authros = home.authros().with(&["--robots", "2"]);
        let site = authros.serve(&home);
        let reader = home.profile("bob").enrol();
        for topic in [COVERED, OTHER] {
            authros.run(&["topics", "watch", topic]).expect_code(0);
        }
        wait_until(60, "the owner's own records", || {
            let records = authros.records(&["uploads", "list", "--topic", COVERED]);
            records.iter().any(is_verified).then_some(())
        });
        let credential = home.root().join("authros");
        let out = credential.to_str().expect("UTF-8");
        let made = authros.json(&["unattended", "prepare", "--out", out, "--topic", COVERED, "--until", "9d"]);
        assert_eq!(made["topics"], serde_json::json!([COVERED]), "{made}");
        site.stop("TERM", 30).expect_code(0);
        let secrets = secrets_below(&home.path());
        let kept = files_below(&home.path()).into_iter().filter(|path| path.ends_with("passphrase"));
        let own = kept.filter(|path| path.parent().is_some_and(|folder| folder.ends_with("default")));
        let [own] = &own.collect::<Vec<_>>()[..] else { panic!("one passphrase of the profile") };
        let passphrase = home.root().join("owner.passphrase");
        fs::rename(own, &passphrase).expect("moved away");
        Self { _home: home, authros, credential, passphrase, secrets, reader }
    }

    fn boot(&self) -> Running {
        let folder = self.credential.parent().and_then(Path::to_str).expect("UTF-8");
        // As systemd hands it over.
        let mut site = self.authros.with_variable("CREDENTIALS_DIRECTORY", folder).spawn(&["serve", "--unattended"]);
        site.wait_for_text("serving", 60);
        site
    }

    /// The owner at the keyboard.
    fn owner(&self) -> Authros {
        self.authros.with(&["--passphrase-file", self.passphrase.to_str().expect("UTF-8")])
    }

    fn state(&self) -> Value {
        self.authros.json(&["status"])["unattended"].clone()
    }

    fn records(&self, topic: &str) -> Vec<Value> {
        self.authros.records(&["uploads", "list", "--topic", topic])
    }

    /// Waits until more records of the covered topic are verified than there are now.
    fn gets_more(&self) -> usize {
        let verified = || self.records(COVERED).iter().filter(|record| is_verified(record)).count();
        let before = self.records(COVERED).len();
        wait_until(120, "records are sealed, anchored and verified", || {
            Some(verified()).filter(|now| *now > before + 5)
        })
    }

    fn expect_no_owner_in(&self, site: &Running) {
        let Some(memory) = memory_of(&site.id().to_string()) else {
            support::tell_skipped("unattended", "this user may not read the memory of a process of its own");
            return;
        };
        assert_eq!(found_in(&memory, &self.secrets), Vec::<&str>::new(), "keys of owners");
        let held = UnattendedCredential::read(&self.credential).expect("it opens");
        let held = [
            ("lent key".to_owned(), held.enrolment.device.secret.expose().to_vec()),
            ("account".to_owned(), held.witness.expose().to_vec()),
        ];
        let mut found = found_in(&memory, &held);
        found.sort_unstable();
        found.dedup();
        assert_eq!(found, ["account", "lent key"], "the search finds what is there");
    }
}

fn has_ended(state: &Value) -> bool {
    state["state"] == "ended"
}

#[test]
fn a_machine_boots_twice_without_its_owner_who_then_has_everything() {
    let _alone = heavy();
    let machine = Machine::new();
    let of_owner = machine.records(OTHER).len();

    let site = machine.boot();
    assert_eq!((&machine.state()["state"], &machine.state()["profile"]), (&"capturing".into(), &"default".into()));
    machine.gets_more();
    for arguments in [&["grant", &machine.reader][..], &["keys", "rotate"], &["keys", "export", "sm4", "--out", "/x"]] {
        let refused = machine.authros.fails(REFUSED, arguments);
        assert!(refused.contains("runs unattended until"), "{refused}");
    }
    site.stop("TERM", 30).expect_code(0);

    let site = machine.boot();
    let by_reboot = machine.gets_more();
    let status = machine.authros.json(&["status"]);
    let capture = support::list(&status, "health").into_iter().find(|part| part["part"] == "capture").expect("a part");
    assert!(capture["level"] == "ok" && text(&capture, "text").contains("the loan of its device ends"), "{capture}");
    let rows = support::list(&machine.authros.json(&["topics", "list"]), "topics");
    let waits = |name: &str| rows.iter().find(|row| row["topic"] == name).map(|row| row["held_up"].clone());
    assert_eq!((waits(COVERED), waits(OTHER)), (Some(Value::Null), Some("waits_for_key".into())));
    assert_eq!(machine.records(OTHER).len(), of_owner, "without its key nothing is sealed");
    machine.authros.fails(REFUSED, &["grant", &machine.reader]);
    machine.expect_no_owner_in(&site);

    // The owner comes, and the same process goes on with the profile's own keys.
    machine.owner().json(&["keys", "list"]);
    assert_eq!(machine.state()["state"], "attended");
    wait_until(60, "the other topic", || (machine.records(OTHER).len() > of_owner).then_some(()));
    machine.gets_more();
    let granted = machine.owner().json(&["grant", &machine.reader, "--topic", COVERED]);
    assert!(granted["transaction"].is_string(), "{granted}");
    for topic in [COVERED, OTHER] {
        machine.authros.run(&["topics", "unwatch", topic]).expect_code(0);
    }
    let all = wait_until(120, "everything is verified", || {
        let records = machine.authros.records(&["uploads", "list"]);
        records.iter().all(is_verified).then_some(records)
    });
    expect_dense(&machine.authros);
    expect_two_signers(&machine, &all, by_reboot);
    let audit = machine.owner().json(&["audit", "--deep"]);
    assert_eq!(audit["findings"], serde_json::json!([]), "{audit}");
    drop(site);
}

/// Of every kind, without a hole or a double over four changes of who seals.
fn expect_dense(authros: &Authros) {
    let mut numbers: BTreeMap<String, Vec<u64>> = BTreeMap::new();
    for kind in ["data", "definition", "gap"] {
        for record in authros.records(&["uploads", "list", "--kind", kind]) {
            numbers.entry(text(&record, "topic")).or_default().push(record["seq"].as_u64().expect("a number"));
        }
    }
    for (topic, mut numbers) in numbers.into_iter().filter(|(topic, _)| topic.starts_with('/')) {
        numbers.sort_unstable();
        let length = u64::try_from(numbers.len()).expect("few");
        assert_eq!(numbers, (1..=length).collect::<Vec<_>>(), "{topic}");
    }
}

/// The owner's key and the lent one signed, and the owner opens what either did.
fn expect_two_signers(machine: &Machine, all: &[Value], unattended: usize) {
    let mut covered: Vec<&Value> = all.iter().filter(|record| record["topic"] == COVERED).collect();
    covered.sort_by_key(|record| record["seq"].as_u64());
    let mut signers = BTreeMap::new();
    for record in [covered.first(), covered.get(unattended - 1), covered.last()].into_iter().flatten() {
        let shown = machine.owner().json(&["uploads", "show", &text(record, "id")]);
        let opened = machine.owner().json(&["shared", "open", &text(record, "id")]);
        assert!(opened["fields"].as_array().is_some_and(|fields| !fields.is_empty()), "{opened}");
        let step = |name: &str| {
            let steps = support::list(&shown, "steps");
            steps
                .iter()
                .find(|step| step[0] == name)
                .and_then(|step| Some(step[1].as_str()?.to_owned()))
                .unwrap_or_default()
        };
        *signers.entry((step("signature"), step("anchored by"))).or_insert(0) += 1;
    }
    let held = UnattendedCredential::read(&machine.credential).expect("it opens");
    let alone = (format!("SM2 by signer {}", held.enrolment.device_id()), held.witness.address().to_string());
    assert!(signers.len() == 2 && signers.get(&alone) == Some(&1), "{signers:?}, {alone:?}");
}

#[test]
fn what_was_recalled_captures_nothing_and_says_so() {
    let _alone = heavy();
    let machine = Machine::new();
    let site = machine.boot();
    machine.gets_more();
    site.stop("TERM", 30).expect_code(0);

    let ended = machine.owner().json(&["unattended", "end"]);
    assert!(ended["epoch"].as_u64() >= Some(2), "a new epoch: {ended}");
    let again = machine.owner().fails(REFUSED, &["unattended", "end"]);
    assert!(again.contains("nothing is on loan"), "{again}");

    let mut site = machine.boot();
    let state = wait_until(60, "it has ended", || Some(machine.state()).filter(has_ended));
    assert!(text(&state, "why").contains("recalled"), "{state}");
    wait_until(60, "it is told", || site.stderr().contains("unattended capture has ended").then_some(()));
    let records = machine.records(COVERED).len();
    wait_until(60, "the robots are there", || {
        let rows = support::list(&machine.authros.json(&["topics", "list"]), "topics");
        rows.iter()
            .find(|row| row["topic"] == COVERED)
            .filter(|row| row["publishers"] != serde_json::json!([]))
            .map(drop)
    });
    let status = machine.authros.with(&["--json"]).run(&["status"]).expect_code(4).document();
    assert!(status["health"].to_string().contains("unattended capture has ended"), "{status}");
    assert_eq!(machine.records(COVERED).len(), records, "nothing is sealed");
    site.expect_running();

    // The owner's word is enough to go on.
    machine.owner().json(&["keys", "list"]);
    assert_eq!(machine.state()["state"], "attended");
    machine.gets_more();
}

#[test]
fn a_credential_of_nobody_here_does_not_start_a_site() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "0"]);
    authros.enrol();
    let missing = authros.run(&["serve", "--unattended"]).expect_code(2);
    assert!(missing.stderr.contains("CREDENTIALS_DIRECTORY"), "{missing}");
    let file = home.file("noise", b"no credential", 0o600);
    let other = authros.run(&["serve", "--unattended", &file]).expect_code(3);
    assert!(other.stderr.contains("unattended prepare"), "{other}");
    let out = home.root().join("c").to_str().expect("UTF-8").to_owned();
    let nothing = authros.run(&["unattended", "prepare", "--out", &out]).expect_code(2);
    assert!(nothing.stderr.contains("no topic is watched"), "{nothing}");
}

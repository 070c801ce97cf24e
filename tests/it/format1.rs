//! What a program of version 1 wrote is read by this one: a sample of each format, made by `tests/format1/make`. And what a
//! later version writes is refused, with what to do.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

mod frames;
mod later;
mod postgres;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use authros::crypto::{Passphrase, SealedEnrolment, SealingKey};
use authros::model::{Address, Domain, SignerId};
use serde_json::{Value, json};

use crate::evidence::{by_the_second, expect_agreement, verified};
use crate::support::{Authros, Home, Running, free_port, is_verified, list, skipped, system_program, text, wait_until};

const ODOM: &str = "/robot1/odom";
/// What `own` and `received` of the expected document have of each record.
const FIELDS: [&str; 8] = ["digest", "seq", "kind", "topic", "type", "captured_at", "bytes", "epoch"];

fn sample(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/format1").join(name)
}

fn expected() -> Value {
    serde_json::from_slice(&fs::read(sample("expected.json")).expect("read")).expect("JSON")
}

/// A home of version 1, as its owner left it.
fn unpacked(name: &str) -> Home {
    let home = Home::new();
    let mut command = Command::new("tar");
    command.args(["--extract", "--gzip", "--preserve-permissions", "--no-same-owner", "--file"]);
    command.arg(sample(&format!("{name}.tar.gz"))).arg("--directory").arg(home.root());
    Running::start(command).wait(60).expect_code(0);
    home
}

/// A sample that only its owner may read; a clone has it readable for all.
fn private(home: &Home, name: &str) -> String {
    home.file(name, fs::read(sample(name)).expect("read"), 0o600)
}

/// A profile of these homes, whose keyrings have one passphrase.
fn profile(home: &Home, name: &str) -> Authros {
    home.profile(name).with(&["--robots", "0", "--passphrase-file", &private(home, "passphrase")])
}

fn briefly(records: &[Value]) -> Value {
    let one = |record: &Value| FIELDS.iter().map(|field| ((*field).to_owned(), record[field].clone())).collect();
    Value::Array(records.iter().map(|record| Value::Object(one(record))).collect())
}

/// Alice's records and what she reads are those of the sample.
fn expect_the_records(home: &Home) {
    let (alice, expected) = (profile(home, "alice"), expected());
    let own = alice.records(&["records", "list", "--oldest"]);
    assert_eq!(briefly(&own), expected["own"]);
    assert!(own.iter().all(is_verified), "{own:?}");
    let opened = alice.json(&["records", "open", &text(&expected["opened"], "digest")]);
    for field in ["verdict", "topic", "type", "message", "captured_at"] {
        assert_eq!(opened[field], expected["opened"][field], "{field} of {opened}");
    }
    assert_eq!(opened["verdict"], "verified");
    assert!(opened["message"].is_object(), "{opened}");
}

#[test]
fn a_home_is_read_and_goes_on() {
    let (home, expected) = (unpacked("site"), expected());
    expect_the_records(&home);
    let (alice, bob) = (profile(&home, "alice"), profile(&home, "bob"));
    let received = bob.records(&["received", "list", "--oldest"]);
    assert_eq!(briefly(&received), expected["received"]);
    let shared = received.iter().find(|record| record["topic"] == ODOM).expect("one of the topic");
    assert_eq!(bob.json(&["records", "open", &text(shared, "id")])["verdict"], "verified");
    for (name, account) in expected["accounts"].as_object().expect("accounts") {
        if name != "carol" {
            assert_eq!(&profile(&home, name).json(&["identity", "show"])["address"], account, "{name}");
        }
    }
    assert_eq!(list(&alice.json(&["incident", "list"]), "incidents").len(), 1);
    let audit = alice.json(&["audit", "--deep"]);
    assert_eq!((&audit["ok"], &audit["missing"]), (&true.into(), &0.into()), "{audit}");

    // Its chain, its ledger and its keys are written on.
    home.profile("alice")
        .with(&["--robots", "1", "--passphrase-file", &private(&home, "passphrase")])
        .capture(&[ODOM], 1);
    alice.json(&["keys", "rotate"]);
    assert_eq!(list(&alice.json(&["keys", "list"]), "epochs").len(), 2);
    assert_eq!(alice.records(&["records", "list", "--oldest"]).len(), list(&expected, "own").len() + 1);
}

#[test]
fn a_site_that_joined_a_gateway_goes_on_there() {
    let (site, member, expected) = (unpacked("site"), unpacked("member"), expected());
    let keeper = profile(&site, "keeper").with(&["--json"]);
    let mut gateway = keeper.spawn(&["gateway", "serve", "--listen", "127.0.0.1:0"]);
    let said = gateway.wait_for_text("\"gateway\"", 120);
    let line = said.lines().find(|line| line.contains("\"gateway\"")).expect("a document");
    let told: Value = serde_json::from_str(line).expect("JSON");
    assert_eq!(told["gateway"]["gateway"], expected["gateway"], "its fingerprint");
    let carol = profile(&member, "carol")
        .with_variable("AUTHROS_SITE", &text(&told["gateway"], "address"))
        .with_variable("AUTHROS_GATEWAY_KEY", &text(&expected, "gateway"));
    let joined = carol.serve(&member);
    let wanted = list(&expected, "received").len();
    let records = wait_until(60, "all of the topic is verified", || {
        let records = carol.records_so_far(&["received", "list", "--oldest"])?;
        (records.len() == wanted && records.iter().all(is_verified)).then_some(records)
    });
    assert_eq!(briefly(&records), expected["received"], "the same topic is granted to both");
    assert_eq!(carol.json(&["records", "open", &text(&records[0], "id")])["verdict"], "verified");
    joined.stop("TERM", 30).expect_code(0);
    gateway.stop("TERM", 30).expect_code(0);
}

#[test]
fn a_backup_is_restored() {
    let home = Home::new();
    let secret = private(&home, "backup.passphrase");
    let file = sample("site.backup").to_str().expect("UTF-8").to_owned();
    let restored = home.profile("alice").with(&["--robots", "0"]);
    restored.json(&["backup", "restore", &file, "--passphrase-file", &secret]);
    expect_the_records(&home);
}

#[test]
fn a_saved_keyring_is_brought_back() {
    let (home, expected) = (Home::new(), expected());
    let alice = profile(&home, "alice");
    alice.json(&["keys", "restore", &private(&home, "alice.keyring")]);
    assert_eq!(alice.json(&["identity", "show"])["address"], expected["accounts"]["alice"]);
}

#[test]
fn a_robot_opens_its_enrolment_and_has_its_ring() {
    let (home, expected) = (unpacked("robot"), expected());
    let (file, secret) = (private(&home, "scout.enrolment"), private(&home, "passphrase"));
    let passphrase = fs::read_to_string(&secret).expect("read");
    let passphrase = Passphrase::new(passphrase.trim_end().to_owned()).expect("a passphrase");
    let sealed = SealedEnrolment::open(Path::new(&file), &passphrase).expect("opens");
    let enrolment = &sealed.enrolment;
    assert_eq!(enrolment.name.as_str(), "scout");
    assert_eq!(enrolment.owner, text(&expected["accounts"], "alice").parse::<Address>().expect("an account"));
    assert_eq!(enrolment.gateway.fingerprint, text(&expected, "gateway").parse::<SignerId>().expect("an id"));
    assert_eq!(enrolment.domain, text(&expected, "domain").parse::<Domain>().expect("a domain"));
    let SealingKey::Topics(topics) = &enrolment.keys.now.key else { panic!("it has keys for its topics alone") };
    assert!(topics.contains_key(ODOM), "{:?}", topics.keys());

    // Its gateway is not there; what it sealed and what its ring holds is.
    let robot = home.authros().with(&["--json", "--robots", "0", "--passphrase-file", &secret]);
    let robot = robot
        .with_variable("AUTHROS_RING_KEEP", "36500d, 1MiB")
        .with_variable("AUTHROS_RING_TOPICS", "[\"/robot1/camera/**\"]");
    let ended = robot.run(&["robot", "run", &file, "--seconds", "1"]).expect_code(0);
    let figures: Value = serde_json::from_str(ended.stdout.lines().last().expect("a document")).expect("JSON");
    let told = ["captured", "accepted", "verified", "pending"].map(|name| &figures[name]);
    assert_eq!(told, [&json!(2), &json!(2), &json!(2), &json!(0)], "{figures}");
    assert_eq!(figures["ring"]["messages"], expected["ring"], "{figures}");
}

#[test]
fn a_bundle_comes_to_the_same_verdict_in_every_verifier() {
    if system_program("python3").is_none() {
        skipped!("no python3");
    }
    let (bundle, trust) = (sample("case.authros"), sample("trust.toml"));
    let verdict = fs::read_to_string(sample("verdict.txt")).expect("read");
    let said = crate::evidence::printed(&bundle, &trust, &[]);
    assert_eq!(said.trim_end(), verdict.trim_end(), "as the verifier in Python said when the sample was made");
    assert_eq!(verified(&bundle, Some(&trust)).expect_code(8).document()["outcome"], "incomplete");
    expect_agreement(&bundle, Some(&trust));
    expect_agreement(&bundle, None);
    let Some(pages) = by_the_page(&json!([{ "bundle": bundle, "trust": trust }])) else {
        skipped!("the page: no node, or its packages are not installed");
    };
    let theirs = by_the_second(&bundle, Some(&trust), &[]).document();
    let page = &pages[0];
    assert_eq!((&page["outcome"], &page["verdict"]), (&theirs["outcome"], &theirs["verdict"]), "{page}");
}

/// What the page's thread says of these cases; nothing without node or its packages.
fn by_the_page(cases: &Value) -> Option<Value> {
    let place = Path::new(env!("CARGO_MANIFEST_DIR")).join("tools/verify-page");
    if system_program("node").is_none() || !place.join("node_modules").exists() {
        return None;
    }
    let asked = tempfile::NamedTempFile::new().expect("a file");
    fs::write(asked.path(), cases.to_string()).expect("written");
    let mut command = Command::new("node");
    command.arg(place.join("test/judge.js")).stdin(fs::File::open(asked.path()).expect("there"));
    let output = command.output().expect("node");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(serde_json::from_slice(&output.stdout).expect("JSON"))
}

#[test]
fn an_exported_record_is_verified_against_its_chain() {
    let home = unpacked("site");
    let url = format!("127.0.0.1:{}", free_port());
    let mut chain = profile(&home, "alice").spawn(&["chain", "serve", "--listen", &url]);
    chain.wait_for_text(&url, 60);
    let folder = sample("record").to_str().expect("UTF-8").to_owned();
    let stranger = Authros::bare(home.root());
    let chain_url = format!("http://{url}");
    let found =
        stranger.run(&["evidence", "verify", &folder, "--chain", &chain_url, "--json"]).expect_code(0).document();
    assert_eq!(found["ok"], true, "{found}");
    chain.stop("TERM", 20).expect_code(0);
}

#[test]
fn a_recording_is_imported_with_its_times() {
    let (home, expected) = (Home::new(), expected());
    let authros = home.authros().with(&["--robots", "0"]);
    authros.enrol();
    authros.json(&["bag", "import", sample("recording.mcap").to_str().expect("UTF-8")]);
    let records = authros.records(&["records", "list", "--oldest", "--topic", ODOM]);
    let times = |records: &[Value]| records.iter().map(|record| text(record, "captured_at")).collect::<Vec<_>>();
    let own: Vec<Value> = list(&expected, "own").into_iter().filter(|record| record["topic"] == ODOM).collect();
    assert_eq!(times(&records), times(&own));
}

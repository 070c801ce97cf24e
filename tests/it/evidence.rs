//! An evidence bundle, from a home to someone who has neither home nor network and does not take our word.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

use support::{Anvil, Home, Outcome, Proxy, Running, Spoil, list, poll, skipped, system_program, text, wait_until};

pub(crate) struct Exported {
    pub home: Home,
    pub bundle: PathBuf,
    pub trust: PathBuf,
    revealed: String,
    records: Vec<Value>,
}

pub(crate) fn export() -> Exported {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]).with_variable("AUTHROS_AUDIT_ANCHOR_EVERY", "86400");
    authros.enrol();
    authros.capture(&["/robot1/odom"], 3);
    let records = authros.records(&["records", "list", "--oldest"]);
    let revealed = text(&records[0], "digest");
    let (bundle, trust) = (home.root().join("case.authros"), home.root().join("trust.toml"));
    let place = bundle.to_str().expect("UTF-8");
    let view =
        authros.json(&["evidence", "export", place, "--topic", "/robot1/odom", "--reveal", &text(&records[0], "id")]);
    // Heads are far apart here, and their absence is reported.
    let untold = list(&view, "notes").into_iter().filter(|note| !note.to_string().contains(" here: nothing says "));
    assert_eq!((&view["revealed"], untold.count()), (&1.into(), 0), "{view}");
    let again = authros.run(&["evidence", "export", place]);
    assert_eq!(again.code, Some(3), "a file that exists is not replaced: {again}");
    let audit = authros.json(&["audit", "list"]);
    // The newest first: a disclosure is logged before the export begins.
    let deeds: Vec<String> =
        list(&audit, "audit").iter().map(|line| text(line, "action") + " " + &text(line, "outcome")).collect();
    let place =
        |deed: &str| deeds.iter().position(|found| found == deed).unwrap_or_else(|| panic!("no {deed}: {deeds:?}"));
    assert!(place("disclose record begun") > place("export evidence begun"), "{deeds:?}");
    // The exporter's suggestion; here the test has checked it.
    let suggested = unzipped(&bundle, "trust.toml");
    fs::write(&trust, suggested).expect("written");
    Exported { home, bundle, trust, revealed, records }
}

/// All that a verifier says about the records and topics of one bundle, it says about those of the other, too. Who
/// assembled it is shown at another block, and a home that goes on states more.
pub(crate) fn expect_same_levels(one: &Path, other: &Path, trust: &Path) {
    let told = |bundle: &Path| verified(bundle, Some(trust)).expect_code(8).document();
    let (one, other) = (told(one), told(other));
    assert_eq!((&one["outcome"], &one["exporter"]["standing"]), (&other["outcome"], &other["exporter"]["standing"]));
    for field in ["records", "complete"] {
        let (before, after) = (list(&one, field), list(&other, field));
        assert!(!before.is_empty(), "{one}");
        for told in before {
            assert!(after.contains(&told), "every level, text and time of {told} in {after:?}");
        }
    }
}

/// One member, by a program that knows ZIP and nothing of us.
pub(crate) fn unzipped(bundle: &Path, name: &str) -> Vec<u8> {
    let script = "import sys, zipfile\nsys.stdout.buffer.write(zipfile.ZipFile(sys.argv[1]).read(sys.argv[2]))\n";
    let output = Command::new("python3").args(["-c", script]).arg(bundle).arg(name).output().expect("python3");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    output.stdout
}

/// `evidence verify` with an empty HOME, and without a network where this machine can do that.
pub(crate) fn verified(bundle: &Path, trust: Option<&Path>) -> Outcome {
    let empty = tempfile::tempdir().expect("directory");
    let cut = Command::new("unshare").args(["-rn", "true"]).status().is_ok_and(|status| status.success());
    let mut command = if cut { Command::new("unshare") } else { Command::new(env!("CARGO_BIN_EXE_authros")) };
    if cut {
        command.args(["-rn", env!("CARGO_BIN_EXE_authros")]);
    }
    command.env_clear().env("HOME", empty.path()).args(["evidence", "verify"]).arg(bundle).arg("--json");
    if let Some(trust) = trust {
        command.arg("--trust").arg(trust);
    }
    let outcome = Running::start(command).wait(60);
    assert_eq!(fs::read_dir(empty.path()).expect("listed").count(), 0, "nothing is left in HOME");
    outcome
}

/// The second verifier, in plain Python.
pub(crate) fn by_the_second(bundle: &Path, trust: Option<&Path>, options: &[&str]) -> Outcome {
    let mut command = Command::new("python3");
    command.env("PYTHONPATH", concat!(env!("CARGO_MANIFEST_DIR"), "/tools/verify"));
    command.args(["-B", "-m", "authros_verify"]).arg(bundle).arg("--json").args(options);
    if let Some(trust) = trust {
        command.arg("--trust").arg(trust);
    }
    Running::start(command).wait(120)
}

/// The library's example says of each record what the program says.
fn expect_the_example_agrees(bundle: &Path, trust: &Path, report: &Value) {
    let programs = Path::new(env!("CARGO_BIN_EXE_authros")).parent().expect("a folder");
    let mut command = Command::new(programs.join("examples/verify_bundle"));
    command.env_clear().arg(bundle).arg(trust);
    let said = Running::start(command).wait(60).expect_code(8).stdout;
    for record in list(report, "records") {
        assert!(said.contains(&text(&record, "digest")), "{record} in {said}");
        for (letter, level) in [('a', "bytes"), ('b', "key"), ('c', "anchor"), ('d', "time"), ('e', "opened")] {
            let standing = text(&record[level], "standing")
                .replace("unproven", "not proven")
                .replace("own_chain", "self-sealed chain");
            let line = format!("({letter}) {standing}: {}", text(&record[level], "text"));
            assert!(said.contains(&line), "{line} in {said}");
        }
    }
}

/// Both verifiers say the same of each record.
pub(crate) fn expect_agreement(bundle: &Path, trust: Option<&Path>) {
    let (ours, theirs) = (verified(bundle, trust), by_the_second(bundle, trust, &[]));
    assert_eq!(ours.code, theirs.code, "{ours}\n{theirs}");
    let (ours, theirs) = (ours.document(), theirs.document());
    assert_eq!((&ours["outcome"], &ours["verdict"]), (&theirs["outcome"], &theirs["verdict"]));
    let levels = |record: &Value| {
        let parts = ["standing", "reason"];
        let told =
            ["bytes", "key", "anchor", "time", "opened"].map(|level| parts.map(|part| record[level][part].clone()));
        (text(record, "digest"), told)
    };
    let all = |report: &Value| list(report, "records").iter().map(levels).collect::<Vec<_>>();
    assert_eq!(all(&ours), all(&theirs));
    let stretches = |report: &Value| list(report, "complete").iter().map(stretch).collect::<Vec<_>>();
    assert_eq!(stretches(&ours), stretches(&theirs));
}

/// What both verifiers say about a topic.
fn stretch(told: &Value) -> Vec<String> {
    let fields =
        ["recorder", "topic_id", "standing", "reason", "first", "last", "missing", "gaps", "uncounted", "twice"];
    fields.map(|name| &told[name]).into_iter().chain([&told["heads"]["number"]]).map(ToString::to_string).collect()
}

#[test]
fn a_bundle_is_verified_on_another_machine_and_every_lie_is_refused() {
    if system_program("python3").is_none() {
        skipped!("no python3");
    }
    let Exported { home, bundle, trust, revealed, records } = export();
    // The home seals its chain itself: that proves nothing against it, and is not a success.
    let report = verified(&bundle, Some(&trust)).expect_code(8).document();
    assert_eq!((text(&report, "outcome").as_str(), &report["pinned"]), ("incomplete", &true.into()), "{report}");
    assert_eq!(text(&report["exporter"], "standing"), "own_chain", "{report}");
    let found = list(&report, "records");
    assert_eq!(found.len(), records.len() + 1, "the messages and the record of their definition");
    for record in &found {
        let standing = |level: &str| text(&record[level], "standing");
        assert_eq!(standing("bytes"), "proven", "{record}");
        // The home seals its chain itself, which is reported.
        assert_eq!((standing("key"), standing("anchor")), ("own_chain".into(), "own_chain".into()), "{record}");
        let opened = text(record, "digest") == revealed;
        assert_eq!(standing("opened"), if opened { "own_chain" } else { "absent" }, "{record}");
        if opened {
            let disclosed = &record["disclosed"];
            assert_eq!(text(disclosed, "topic"), "/robot1/odom");
            assert!(disclosed["message"]["pose"]["pose"]["position"]["x"].is_number(), "its values: {disclosed}");
        } else {
            assert!(record["disclosed"].is_null(), "nothing else is readable: {record}");
        }
    }
    let is_whole = |stretch: &Value| stretch["missing"] == 0 && text(stretch, "standing") == "own_chain";
    assert!(list(&report, "complete").iter().all(is_whole), "{report}");
    let page = String::from_utf8(unzipped(&bundle, "report.html")).expect("text");
    for part in [
        "This page proves nothing",
        "/robot1/odom",
        revealed.as_str(),
        "Pose covariance",
        "self-sealed chain",
        "openssl pkeyutl",
    ] {
        assert!(page.contains(part), "no {part} in {page}");
    }
    assert!(!page.contains("<script") && !page.contains("://"), "{page}");
    told(&home, &bundle, &trust);
    expect_the_example_agrees(&bundle, &trust, &report);
    verified(&bundle, None).expect_code(8);
    expect_agreement(&bundle, Some(&trust));
    expect_agreement(&bundle, None);
    refused(&home, &bundle, &trust);
}

/// `verify` as people see it.
pub(crate) fn printed(bundle: &Path, trust: &Path, options: &[&str]) -> String {
    let empty = tempfile::tempdir().expect("directory");
    let mut command = Command::new(env!("CARGO_BIN_EXE_authros"));
    command
        .env_clear()
        .env("HOME", empty.path())
        .args(["evidence", "verify"])
        .arg(bundle)
        .arg("--trust")
        .arg(trust)
        .args(options);
    Running::start(command).wait(60).expect_code(8).stdout
}

/// The text output.
fn told(home: &Home, bundle: &Path, trust: &Path) {
    let own = printed(bundle, trust, &[]);
    assert!(own.starts_with("NOT FULLY PROVEN: only the exporter's own chain supports the file"), "{own}");
    assert!(own.lines().count() <= 25 && own.lines().all(|line| line.chars().count() <= 80), "{own}");
    assert!(own.contains("Not checked: report.html") && !own.contains("VERIFY.txt"), "{own}");
    assert!(!own.contains("record no."), "no record without --records: {own}");
    let all = printed(bundle, trust, &["--records"]);
    assert!(all.starts_with(&own), "the verdict first: {all}");
    assert!(all.contains("note: report.html was not checked"), "{all}");
    assert!(all.contains("'/robot1/odom' nav_msgs/Odometry") && all.contains("(f) self-sealed chain: topic"), "{all}");
    let denied = home.root().join("denied.toml");
    let pins = fs::read_to_string(trust).expect("text");
    let denying = pins.replace("sealed_by_exporter = true", "sealed_by_exporter = false");
    assert_ne!(pins, denying);
    fs::write(&denied, denying).expect("written");
    let told = printed(bundle, &denied, &[]);
    assert!(told.contains("Your trust file says that others seal this chain; its blocks say that one"), "{told}");
    expect_agreement(bundle, Some(&denied));
    let unsaid = home.root().join("unsaid.toml");
    fs::write(&unsaid, pins.replace("sealed_by_exporter = true", "")).expect("written");
    for outcome in [verified(bundle, Some(&unsaid)), by_the_second(bundle, Some(&unsaid), &[])] {
        assert_eq!(outcome.code, Some(3), "{outcome}");
    }
}

fn refused(home: &Home, bundle: &Path, trust: &Path) {
    let bytes = fs::read(bundle).expect("read");
    let altered = home.root().join("altered.authros");
    for part in 0..24 {
        let mut changed = bytes.clone();
        let at = part * (bytes.len() / 24);
        changed[at] ^= 1;
        fs::write(&altered, changed).expect("written");
        let outcome = verified(&altered, Some(trust));
        assert_eq!(outcome.code, Some(6), "byte {at}: {outcome}");
        let outcome = by_the_second(&altered, Some(trust), &[]);
        assert_eq!(outcome.code, Some(6), "byte {at}: {outcome}");
    }
    let pins = fs::read_to_string(trust).expect("text");
    let other = home.root().join("other.toml");
    let signer = pins.lines().find(|line| line.starts_with("signers")).expect("signers");
    let pinned = "signers = [\"0x0101010101010101010101010101010101010101\"]";
    fs::write(&other, pins.replace(signer, pinned)).expect("written");
    let report = verified(bundle, Some(&other)).expect_code(6).document();
    assert!(report.to_string().contains("who is not a signer you pinned"), "{report}");
    expect_agreement(bundle, Some(&other));
}

#[test]
fn the_same_export_twice_differs_in_its_signature_alone() {
    if system_program("python3").is_none() {
        skipped!("no python3");
    }
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]).with_variable("AUTHROS_AUDIT_ANCHOR_EVERY", "86400");
    authros.enrol();
    authros.capture(&["/robot1/odom"], 2);
    let id = text(&authros.records(&["records", "list", "--oldest"])[0], "id");
    let export = |name: &str| {
        let file = home.root().join(name);
        authros.run(&["evidence", "export", file.to_str().expect("UTF-8"), "--record", &id]).expect_code(0);
        file
    };
    let (one, other) = (export("one.authros"), export("other.authros"));
    let manifest = unzipped(&one, "manifest.json");
    assert_eq!(manifest, unzipped(&other, "manifest.json"), "every other member is named in it with its hashes");
    assert_ne!(unzipped(&one, "manifest.der"), unzipped(&other, "manifest.der"), "signatures are drawn anew");
}

/// The recorder's own head says how far a topic went: an omitted end is reported.
#[test]
fn a_topic_is_complete_to_the_number_that_the_recorders_head_names() {
    if system_program("python3").is_none() {
        skipped!("no python3");
    }
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]).with_variable("AUTHROS_AUDIT_ANCHOR_EVERY", "1");
    authros.enrol();
    authros.capture(&["/robot1/odom"], 3);
    let site = authros.serve(&home);
    let odom = authros.records(&["records", "list", "--oldest", "--topic", "/robot1/odom"]);
    let last = odom.iter().filter_map(|record| record["seq"].as_u64()).max().expect("numbers");
    let (trust, cut) = (home.root().join("trust.toml"), home.root().join("cut.authros"));
    let mut tries = 0;
    // A head in progress may cover fewer numbers, and its birth may be anchored later.
    let whole = wait_until(90, "the newest numbers and the birth are anchored, and exported", || {
        tries += 1;
        let file = home.root().join(format!("whole{tries}.authros"));
        authros.json(&["evidence", "export", file.to_str().expect("UTF-8"), "--topic", "/robot1/odom"]);
        fs::write(&trust, unzipped(&file, "trust.toml")).expect("written");
        let told = list(&verified(&file, Some(&trust)).expect_code(8).document(), "complete");
        let is_whole = |stretch: &Value| stretch["heads"]["number"] == last && stretch["born_at"].is_string();
        told.iter().any(is_whole).then_some(file)
    });
    // Number 1 is the record of the definition, which this list leaves out.
    let first = odom.iter().find(|record| record["seq"] == 2).expect("the first message");
    authros.json(&["evidence", "export", cut.to_str().expect("UTF-8"), "--record", &text(first, "id")]);
    site.stop("INT", 30).expect_code(0);
    let topic = |bundle: &Path| {
        let report = verified(bundle, Some(&trust)).expect_code(8).document();
        // The head covers every topic but its own.
        let named = |stretch: &Value| stretch["heads"].is_object();
        list(&report, "complete").into_iter().find(named).expect("the topic")
    };
    let (told, shorter) = (topic(&whole), topic(&cut));
    assert_eq!((&told["missing"], &told["heads"]["number"]), (&0.into(), &last.into()), "{told}");
    assert!(text(&told, "text").contains(&format!("complete to number {last} as of the heads record at")), "{told}");
    assert_eq!(shorter["missing"], last - 2, "{shorter}");
    assert!(text(&shorter, "text").contains(&format!("NOT complete to number {last}")), "{shorter}");
    assert!(told["born_at"].is_string() && told["predecessor"].is_null(), "{told}");
    expect_agreement(&whole, Some(&trust));
    expect_agreement(&cut, Some(&trust));
}

/// The proofs come from another program here (anvil), as do the headers, which nobody signs.
#[test]
fn a_foreign_nodes_proofs_show_the_anchor_and_its_unsigned_headers_are_named() {
    if system_program("python3").is_none() {
        skipped!("no python3");
    }
    let Some(node) = Anvil::start(&[]) else { skipped!("no anvil; tests/run installs it into target/peers") };
    let home = Home::new();
    let url = node.http();
    let authros = home.authros().with(&["--chain", &url, "--robots", "1"]);
    let made = authros.json(&["identity", "create"]);
    node.fund(&text(&made, "address"));
    authros.json(&["identity", "register"]);
    authros.capture(&["/robot1/odom"], 2);
    let (bundle, trust) = (home.root().join("case.authros"), home.root().join("trust.toml"));
    let view = authros.json(&["evidence", "export", bundle.to_str().expect("UTF-8")]);
    // The recorder states nothing in this test.
    let notes = list(&view, "notes");
    assert!(notes.iter().all(|note| note.to_string().contains("has no anchored")), "{view}");
    fs::write(&trust, unzipped(&bundle, "trust.toml")).expect("written");
    let report = verified(&bundle, Some(&trust)).expect_code(8).document();
    let found = list(&report, "records");
    assert!(found.len() >= 3, "{report}");
    for record in &found {
        let told = text(&record["anchor"], "text");
        assert_eq!(text(&record["bytes"], "standing"), "proven", "{record}");
        assert_eq!(text(&record["anchor"], "standing"), "unproven", "{record}");
        assert!(told.contains("anchored in block") && told.contains("no seal that this version can check"), "{told}");
        assert!(text(&record["key"], "text").contains("the key was"), "the registration is shown: {record}");
    }
    expect_agreement(&bundle, Some(&trust));
}

/// A node that keeps the newest states alone, as most do, proves nothing later: what was kept while it did goes into
/// the bundle, and it says the same.
#[test]
fn what_a_node_proved_in_time_is_in_the_bundle_when_it_proves_nothing_any_more() {
    let Some(node) = Anvil::start(&[]) else { skipped!("no anvil; tests/run installs it into target/peers") };
    let (proxy, home) = (Proxy::before(node.port()), Home::new());
    let url = proxy.http();
    let authros = home.authros().with(&["--chain", &url, "--robots", "1"]);
    let made = authros.json(&["identity", "create"]);
    node.fund(&text(&made, "address"));
    authros.json(&["identity", "register"]);
    let site = authros.serve(&home);
    authros.capture(&["/robot1/odom"], 2);
    let part = || {
        let parts = list(&authros.json(&["status"]), "health");
        parts.into_iter().find(|part| part["part"] == "proofs" && text(part, "text").starts_with("kept up to block"))
    };
    let told = poll(60, part).expect("the proofs are kept, and status says so");
    assert_eq!((&told["level"], text(&told, "text").contains("have none")), (&"ok".into(), false), "{told}");
    let (trust, early, late) =
        (home.root().join("trust.toml"), home.root().join("early.authros"), home.root().join("late.authros"));
    let export = |bundle: &Path| {
        let place = bundle.to_str().expect("UTF-8");
        authros.json(&["evidence", "export", place, "--topic", "/robot1/odom"])
    };
    // Several batches were anchored, and each is kept some seconds after its block.
    wait_until(60, "an export that asks the node for no proof", || {
        drop(fs::remove_file(&early));
        let before = proxy.seen("eth_getProof");
        export(&early);
        (proxy.seen("eth_getProof") == before).then_some(())
    });
    fs::write(&trust, unzipped(&early, "trust.toml")).expect("written");
    proxy.spoil("eth_getProof", Spoil::Refuse, u64::MAX);
    export(&late);
    assert_eq!(proxy.spoilt(), 0, "nobody was asked for a proof");
    expect_same_levels(&early, &late, &trust);
    assert_eq!(unzipped(&early, "chain/nodes.rlp"), unzipped(&late, "chain/nodes.rlp"));
    drop(site);
}

#[test]
fn patterns_and_robots_narrow_a_bundle() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "2"]).with_variable("AUTHROS_AUDIT_ANCHOR_EVERY", "86400");
    authros.enrol();
    authros.capture(&["/robot1/odom", "/robot2/odom", "/robot2/camera/compressed"], 2);
    let exported = |name: &str, narrowed: &[&str]| {
        let place = home.root().join(name);
        let place = place.to_str().expect("UTF-8").to_owned();
        let view = authros.json(&[&["evidence", "export", &place], narrowed].concat());
        view["records"].as_u64().expect("a count")
    };
    let both = exported("both.authros", &["--topic", "/robot*/odom"]);
    assert_eq!(exported("named.authros", &["--topic", "/robot1/odom", "--topic", "/robot2/odom"]), both);
    let robot = exported("robot.authros", &["--robot", "robot2"]);
    assert_eq!(exported("under.authros", &["--topic", "/robot2/**"]), robot);
    let one = exported("one.authros", &["--topic", "/robot2/odom", "--robot", "robot2"]);
    assert!(one < both && one < robot, "{one} of {both} and {robot}");
    let nowhere = home.root().join("none.authros");
    let nowhere = nowhere.to_str().expect("UTF-8");
    let told = authros.fails(3, &["evidence", "export", nowhere, "--topic", "/robot9/**"]);
    assert!(told.contains("contains none of your records"), "{told}");
}

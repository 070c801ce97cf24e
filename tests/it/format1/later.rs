//! What a later version wrote, made from the samples by raising their version: it is refused, says that it is later and what to
//! do, and nothing is changed.

use std::fs;
use std::path::Path;

use authros::crypto::AnchorProof;
use authros::evidence::archive;
use authros::gateway::hello::{Answer, Hello};
use authros::gateway::system_keys::SystemKeyList;
use authros::gateway::{Code, NetworkName};
use authros::model::header::Header;
use serde_json::json;

use super::{by_the_page, private, profile, sample, unpacked};
use crate::evidence::{by_the_second, verified};
use crate::support::{Authros, Home, list, skipped, system_program, text};

pub(super) const INPUT: i32 = 3;
const UNHEALTHY: i32 = 4;
const TAMPERED: i32 = 6;
const INCOMPLETE: i32 = 8;
/// Of the files that begin with a magic of eight bytes.
const AT: usize = 8;

/// A file of version 1 becomes one of version 2.
fn raise(path: &str, at: usize) {
    let mut bytes = fs::read(path).expect("read");
    assert_eq!(bytes[at], 1, "{path}");
    bytes[at] = 2;
    fs::write(path, bytes).expect("written");
}

fn expect_advice(said: &str) {
    let says = ["version", "schema", "format"].iter().any(|word| said.contains(word));
    assert!(says && said.contains("use a newer"), "{said}");
}

fn is_refused(authros: &Authros, command: &[&str]) {
    let said = authros.fails(INPUT, command);
    expect_advice(&said);
    assert!(said.contains('2'), "{said}");
}

#[test]
fn the_databases_of_a_home_are_left_alone() {
    for (file, later) in [("ledger.db", "PRAGMA user_version = 2"), ("chain/chain.db", "UPDATE chain SET version = 2")]
    {
        let home = unpacked("site");
        let alice = profile(&home, "alice");
        let path = home.path().join(file);
        rusqlite::Connection::open(&path).expect("opens").execute_batch(later).expect("raised");
        let before = fs::read(&path).expect("read");
        is_refused(&alice, &["records", "list"]);
        assert_eq!(fs::read(&path).expect("read"), before, "{file}");
    }
}

#[test]
fn sealed_files_are_named_with_their_version() {
    let home = unpacked("site");
    let alice = profile(&home, "alice");
    let keyring = private(&home, "alice.keyring");
    raise(&keyring, AT);
    is_refused(&profile(&Home::new(), "alice"), &["keys", "restore", &keyring]);
    raise(home.path().join("profiles/alice/keyring").to_str().expect("UTF-8"), AT);
    is_refused(&alice, &["keys", "list"]);
    let json = alice.with(&["--json"]);
    let checks = list(&json.run(&["doctor"]).expect_code(INCOMPLETE).document(), "checks");
    let keys = checks.iter().find(|check| check["name"] == "keys alice").expect("looked at");
    assert!(keys["status"] == "fail" && text(keys, "advice").starts_with("use a newer authros"), "{keys}");
    let status = json.run(&["status"]).expect_code(UNHEALTHY).document();
    assert_ne!(status["life"]["captured"], 0, "the store knows whose records these are: {status}");

    let (empty, enrolment) = (Home::new(), private(&home, "scout.enrolment"));
    raise(&enrolment, AT);
    is_refused(&profile(&empty, "default"), &["robot", "run", &enrolment]);

    let (backup, secret) = (private(&home, "site.backup"), private(&home, "backup.passphrase"));
    raise(&backup, AT);
    let restored = Home::new();
    let authros = restored.authros().with(&["--robots", "0", "--passphrase-file", &secret]);
    is_refused(&authros, &["backup", "restore", &backup]);
    assert!(!restored.path().join("ledger.db").exists(), "nothing was begun");
}

#[test]
fn settings_are_refused_by_their_line() {
    let home = Home::new();
    fs::create_dir(home.path()).expect("made");
    fs::write(home.path().join("config.toml"), "version = 2\n[chain]\nshards = 4\n").expect("written");
    let said = home.authros().fails(INPUT, &["config", "check"]);
    assert!(said.contains("config.toml line 1") && said.contains("later version"), "{said}");
    expect_advice(&said);
}

#[test]
fn a_bundle_and_a_trust_file_are_refused_by_every_verifier() {
    if system_program("python3").is_none() {
        skipped!("no python3");
    }
    let home = Home::new();
    let mut members = archive::read(&fs::read(sample("case.authros")).expect("read")).expect("an archive");
    // A later one has more than its number changed.
    let manifest = String::from_utf8(members["manifest.json"].clone()).expect("text");
    let later =
        manifest.replacen('{', "{\"purpose\": \"court\", ", 1).replace("authros-evidence/1", "authros-evidence/2");
    members.insert("manifest.json".to_owned(), later.into_bytes());
    let bundle = home.root().join("later.authros");
    fs::write(&bundle, archive::write(&members).expect("packed")).expect("written");
    let trust = home.root().join("later.toml");
    let pins = fs::read_to_string(sample("trust.toml")).expect("read");
    fs::write(&trust, format!("version = 2\n{pins}")).expect("written");

    for outcome in [verified(&bundle, None), by_the_second(&bundle, None, &[])] {
        let said = outcome.expect_code(TAMPERED);
        assert!(said.stdout.contains("authros-evidence/1"), "{said}");
        expect_advice(&said.stdout);
    }
    let good = sample("case.authros");
    for outcome in [verified(&good, Some(&trust)), by_the_second(&good, Some(&trust), &[])] {
        let said = outcome.expect_code(INPUT);
        let both = [said.stdout.as_str(), &said.stderr].concat();
        assert!(both.contains("later version"), "{said}");
        expect_advice(&both);
    }
    let cases = json!([{ "bundle": bundle }, { "bundle": good, "trust": trust }]);
    let Some(pages) = by_the_page(&cases) else { skipped!("the page: no node, or its packages are not installed") };
    expect_advice(&pages[0].to_string());
    assert_eq!(pages[0]["outcome"], "refused", "{pages}");
    expect_advice(&text(&pages[1], "trust"));
}

#[test]
fn an_exported_folder_is_refused_by_its_proof_and_by_its_record() {
    let home = Home::new();
    let copy = |name: &str, change: &dyn Fn(&Path)| {
        let folder = home.root().join(name);
        fs::create_dir(&folder).expect("made");
        for entry in fs::read_dir(sample("record")).expect("listed").flatten() {
            fs::copy(entry.path(), folder.join(entry.file_name())).expect("copied");
        }
        change(&folder);
        is_refused_by_its_words(&home, &folder);
    };
    copy("proof", &|folder| {
        let path = folder.join("proof.json");
        let proof = fs::read_to_string(&path).expect("read");
        let later = proof.replacen('{', "{\"purpose\": \"court\", ", 1).replace("authros-proof/1", "authros-proof/2");
        fs::write(path, later).expect("written");
    });
    copy("record", &|folder| raise(folder.join("record.bin").to_str().expect("UTF-8"), AT));
}

fn is_refused_by_its_words(home: &Home, folder: &Path) {
    let stranger = Authros::bare(home.root());
    expect_advice(&stranger.fails(INPUT, &["evidence", "verify", folder.to_str().expect("UTF-8")]));
}

#[test]
fn what_travels_is_refused_by_its_first_bytes() {
    let session = super::frames::stream("reader");
    let (mut hello, mut answer) = (session.hello, session.answer);
    (hello[0], answer[0]) = (2, 2);
    assert_eq!(Hello::parse(&hello).expect_err("a later hello").code, Code::Version);
    assert!(Code::Version.text().contains("use the same version on both sides"));
    expect_advice(&Answer::parse(&answer).expect_err("a later answer").to_string());
    expect_advice(&NetworkName::parse(&[2; 61]).expect_err("a later network").to_string());
    expect_advice(&AnchorProof::parse(&[2; 102]).expect_err("a later proof").to_string());
    let mut list = session.system_keys;
    list[AT] = 2;
    expect_advice(&SystemKeyList::parse(&list).expect_err("a later list").to_string());
    let mut record = fs::read(sample("record/record.bin")).expect("read");
    record[AT] = 2;
    expect_advice(&Header::parse(&record).expect_err("a later record").to_string());
}

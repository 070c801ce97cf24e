//! Backup under load, and the drill: another home restored from it, audited and working.

use std::collections::BTreeSet;
use std::fs;
use std::os::unix::fs::PermissionsExt;

use super::{INPUT, REFUSED, TAMPERED, all_verified};
use crate::support::{Authros, Home, count, heavy, wait_until};

const TOPICS: [&str; 2] = ["/robot1/odom", "/robot2/camera/compressed"];

fn path(home: &Home, name: &str) -> String {
    home.root().join(name).to_str().expect("UTF-8").to_owned()
}

/// Every (recorder, topic, number) of a home's ledger.
fn numbers(home: &Home) -> BTreeSet<(Vec<u8>, Vec<u8>, i64)> {
    let ledger = rusqlite::Connection::open(home.path().join("ledger.db")).expect("opens");
    let sql = "SELECT recorders.id, topic_id, seq FROM records JOIN topics ON topics.key = topic JOIN recorders ON recorders.key = recorder";
    let mut statement = ledger.prepare(sql).expect("a query");
    let rows = statement.query_map([], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?))).expect("rows");
    rows.collect::<Result<_, _>>().expect("rows")
}

fn audited(authros: &Authros) -> u64 {
    let found = authros.json(&["audit", "--deep"]);
    assert_eq!((&found["ok"], count(&found, "missing")), (&true.into(), 0), "{found}");
    count(&found, "records")
}

#[test]
fn a_back_up_under_load_becomes_a_home_that_goes_on() {
    let _alone = heavy();
    let (home, other) = (Home::new(), Home::new());
    let authros = home.authros().with(&["--robots", "2"]);
    let site = authros.serve(&home);
    authros.enrol();
    for topic in TOPICS {
        authros.run(&["topics", "watch", topic]).expect_code(0);
    }
    let enough = |least: usize| {
        wait_until(60, "records arrive", || {
            (authros.records(&["records", "list", "--oldest"]).len() >= least).then_some(())
        })
    };
    enough(60);
    let (file, secret) = (path(&home, "home.backup"), home.file("secret", "a passphrase of its own\n", 0o600));
    let backup = ["backup", "create", &file, "--passphrase-file", &secret];
    let told = authros.json(&backup);
    assert!(count(&told, "files") >= 5 && told["profiles"][0] == "default", "{told}");
    assert_eq!(fs::metadata(&file).expect("there").permissions().mode() & 0o777, 0o600);
    authros.fails(INPUT, &backup);
    authros.fails(
        INPUT,
        &["backup", "create", home.path().join("x").to_str().expect("UTF-8"), "--passphrase-file", &secret],
    );
    enough(120);
    site.stop("INT", 30).expect_code(0);
    assert!(
        !fs::read_dir(home.path())
            .expect("there")
            .flatten()
            .any(|entry| entry.file_name().to_string_lossy().starts_with(".authros-new-"))
    );

    let restored = other.authros().with(&["--robots", "2"]);
    let wrong = home.file("wrong", "another passphrase\n", 0o600);
    restored.fails(REFUSED, &["backup", "restore", &file, "--passphrase-file", &wrong]);
    let bytes = fs::read(&file).expect("read");
    for (name, spoiled) in
        [("cut", bytes[..bytes.len() - 1].to_vec()), ("altered", altered(&bytes)), ("none", b"x".repeat(5000))]
    {
        let spoiled = home.file(name, spoiled, 0o600);
        restored.fails(TAMPERED, &["backup", "restore", &spoiled, "--passphrase-file", &secret]);
    }
    assert!(!other.path().exists(), "a restore that failed leaves nothing");
    authros.fails(REFUSED, &["backup", "restore", &file, "--passphrase-file", &secret]);
    restored.json(&["backup", "restore", &file, "--passphrase-file", &secret]);
    assert_eq!(fs::metadata(other.path()).expect("there").permissions().mode() & 0o777, 0o700);

    // The contents of the backup, before anything continues.
    let copied = numbers(&other);
    assert!(copied.len() >= 60 && copied.is_subset(&numbers(&home)), "{} records", copied.len());
    let before = audited(&restored);
    assert!(before >= 60, "{before}");
    for topic in TOPICS {
        restored.run(&["topics", "unwatch", topic]).expect_code(0);
    }
    restored.capture(&[TOPICS[0]], 5);
    all_verified(&restored, 60);
    assert!(audited(&restored) > before);
    let here = numbers(&other);
    let new: Vec<_> = here.difference(&copied).collect();
    assert!(new.len() >= 5, "the restored home goes on");
    let there = numbers(&home);
    assert!(new.iter().all(|number| !there.contains(*number)), "no number is given twice");
    audited(&authros);
}

fn altered(bytes: &[u8]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    bytes
}

#[test]
fn backups_on_a_schedule_are_kept_so_many_and_one_can_be_tried_without_a_home() {
    let (home, other) = (Home::new(), Home::new());
    let authros = home.authros().with(&["--robots", "1"]);
    authros.capture(&["/robot1/odom"], 3);
    let (folder, secret) = (path(&home, "backups"), home.file("secret", "a passphrase of its own\n", 0o600));
    let backup = ["backup", "create", "--to", &folder, "--keep", "1", "--passphrase-file", &secret];
    authros.fails(INPUT, &backup);
    fs::create_dir(&folder).expect("a folder");
    let stays = format!("{folder}/notes.backup");
    fs::write(&stays, b"mine").expect("written");
    let old = format!("{folder}/authros-20010909T014640Z.backup");
    fs::write(&old, b"an old one").expect("written");
    let told = authros.json(&backup);
    assert!(told["notes"].to_string().contains("authros-20010909T014640Z.backup was removed"), "{told}");
    let names: BTreeSet<String> = fs::read_dir(&folder)
        .expect("there")
        .flatten()
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    assert_eq!(names.len(), 2, "{names:?}");
    let file = told["file"].as_str().expect("a file").to_owned();
    let drill = ["backup", "check", &file, "--passphrase-file", &secret];
    let elsewhere = other.authros();
    let found = elsewhere.json(&drill);
    assert_eq!((&found["ok"], count(&found, "missing")), (&true.into(), 0), "{found}");
    assert!(count(&found, "records") >= 3, "{found}");
    assert!(!other.path().exists(), "no home was made");
    let left: Vec<_> = fs::read_dir(other.root()).expect("there").flatten().map(|entry| entry.file_name()).collect();
    assert!(!left.iter().any(|name| name.to_string_lossy().contains("drill")), "{left:?}");
    let mut bytes = fs::read(&file).expect("read");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    let damaged = home.file("damaged.backup", &bytes, 0o600);
    elsewhere.fails(TAMPERED, &["backup", "check", &damaged, "--passphrase-file", &secret]);
}

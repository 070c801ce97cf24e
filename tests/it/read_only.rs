//! A home on a file system that cannot be written, as that of an image of a disk: it is listed and audited, and not a byte
//! of it changes.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::process::Command;

use support::authros::files_below;
use support::{Authros, Home, count, is_verified, list, poll, skipped, system_program, text};

const HOME: i32 = 7;
const TOPIC: &str = "/robot1/odom";

/// The program, in a namespace in which the home is mounted read-only.
fn looking(home: &Home) -> Option<Authros> {
    let unshare = system_program("unshare")?;
    let script = "mount --bind \"$0\" \"$0\" && mount -o remount,bind,ro \"$0\" && exec \"$@\"";
    let place = home.path().to_str().expect("UTF-8").to_owned();
    let inside = ["-r", "-m", "sh", "-c", script, &place];
    if !Command::new(&unshare).args(inside).arg("true").status().is_ok_and(|ended| ended.success()) {
        return None;
    }
    let authros = home.authros();
    let program = authros.program().to_str().expect("UTF-8").to_owned();
    let kept = fs::create_dir_all(home.root().join("tmp")).map(|()| home.root().join("tmp")).expect("a folder");
    let authros = authros.with_variable("TMPDIR", kept.to_str().expect("UTF-8"));
    Some(authros.with_program(&unshare).with_prefix(&[&inside[..], &[program.as_str()]].concat()))
}

/// Every file of a home with its bytes.
fn bytes(home: &Home) -> BTreeMap<PathBuf, Vec<u8>> {
    let files = files_below(&home.path()).into_iter().filter(|path| path.is_file());
    files.map(|path| (path.clone(), fs::read(&path).expect("read"))).collect()
}

#[test]
fn a_home_that_cannot_be_written_is_listed_and_audited_and_stays_as_it_is() {
    let home = Home::new();
    let Some(image) = looking(home_with_records(&home)) else {
        skipped!("nothing can be mounted here (unshare -r -m)")
    };
    let before = bytes(&home);
    let authros = home.authros();
    let status = image.json(&["status"]);
    let said = list(&status, "health").into_iter().find(|part| part["part"] == "home").expect("it is said");
    assert!(text(&said, "text").contains("is read-only"), "{said}");
    assert_eq!(count(&status["life"], "verified"), 5, "{status}");
    for audit in [&["audit"][..], &["audit", "--deep"]] {
        let found = image.with(&["--json"]).run(audit).expect_code(0);
        assert_eq!(found.document()["ok"], true, "{found}");
        assert!(found.stderr.contains("is read-only: it is read"), "{found}");
    }
    let records = image.records(&["records", "list", "--oldest"]);
    assert!(records.len() == 5 && records.iter().all(is_verified), "{records:?}");
    image.run(&["received", "list", "--oldest"]).expect_code(0);
    image.run(&["records", "open", &text(&records[0], "id")]).expect_code(0);
    let bundle = home.root().join("out.authros");
    image.run(&["evidence", "export", bundle.to_str().expect("UTF-8")]).expect_code(0);
    assert!(bundle.exists());
    let refused = image.fails(HOME, &["keys", "rotate"]);
    assert!(refused.contains("is read-only") && refused.contains("make it writable"), "{refused}");
    assert!(image.fails(HOME, &["capture", "--topic", TOPIC, "--count", "1"]).contains("is read-only"));
    assert_eq!(bytes(&home).keys().collect::<Vec<_>>(), before.keys().collect::<Vec<_>>(), "no file came or went");
    assert!(bytes(&home) == before, "not a byte was written");
    assert_eq!(fs::read_dir(home.root().join("tmp")).expect("read").count(), 0, "no copy is left behind");
    // Writable again, all goes on.
    authros.capture(&[TOPIC], 1);
    assert_eq!(authros.json(&["audit", "--deep"])["ok"], true);
}

#[test]
fn an_image_of_a_home_whose_site_was_killed_is_read_with_its_logs() {
    let home = Home::new();
    let authros = home_with_records(&home).authros().with(&["--robots", "1"]);
    let site = authros.serve(&home);
    authros.json(&["topics", "watch", TOPIC]);
    poll(60, || (authros.records(&["records", "list", "--oldest"]).len() > 10).then_some(())).expect("it goes on");
    site.stop("KILL", 10);
    let Some(image) = looking(&home) else { skipped!("nothing can be mounted here (unshare -r -m)") };
    let before = bytes(&home);
    assert!(image.records(&["records", "list", "--oldest"]).len() > 10);
    image.with(&["--json"]).run(&["audit", "--deep"]).expect_code(0);
    assert!(bytes(&home) == before, "not a byte was written");
}

/// With five verified records, and no process in it.
fn home_with_records(home: &Home) -> &Home {
    let authros = home.authros().with(&["--robots", "1"]);
    authros.enrol();
    authros.capture(&[TOPIC], 5);
    home
}

//! A home at rest: commands that only look leave every file as it was, to the byte and to its time.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::SystemTime;

use crate::support;

use support::Home;
use support::authros::files_below;

type Files = BTreeMap<PathBuf, (Vec<u8>, SystemTime)>;

fn files(home: &Home) -> Files {
    let read = |path: PathBuf| {
        let changed = std::fs::metadata(&path).and_then(|about| about.modified()).expect("a time");
        (path.clone(), (std::fs::read(&path).expect("read"), changed))
    };
    // A socket has no bytes.
    files_below(&home.path()).into_iter().filter(|path| path.is_file()).map(read).collect()
}

/// What is other than before, in words.
fn changes(before: &Files, after: &Files) -> Vec<String> {
    let all: std::collections::BTreeSet<&PathBuf> = before.keys().chain(after.keys()).collect();
    let word = |path: &PathBuf| match (before.get(path), after.get(path)) {
        (Some(one), Some(other)) if one == other => None,
        (Some((one, _)), Some((other, _))) if one == other => Some("its time"),
        (Some(_), Some(_)) => Some("its bytes"),
        (None, _) => Some("is new"),
        (_, None) => Some("is gone"),
    };
    all.into_iter().filter_map(|path| Some(format!("{}: {}", path.display(), word(path)?))).collect()
}

#[test]
fn who_only_looks_writes_nothing() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]);
    authros.enrol();
    authros.capture(&["/robot1/odom"], 3);
    let id = support::text(&authros.records(&["uploads", "list"])[0], "id");
    authros.run(&["audit"]).expect_code(0);
    let mut written = Vec::new();
    for looking in [
        &["status"][..],
        &["uploads", "list"],
        &["uploads", "show", &id],
        &["topics", "list"],
        &["grants", "list"],
        &["chain", "status"],
        &["audit"],
        &["doctor"],
    ] {
        let before = files(&home);
        let outcome = authros.run(looking);
        assert_eq!(outcome.code, Some(0), "{looking:?}: {outcome}");
        written.extend(changes(&before, &files(&home)).into_iter().map(|change| format!("{looking:?}: {change}")));
    }
    assert!(written.is_empty(), "{}", written.join("\n"));
}

//! Someone copies a home and runs it beside the first, so that each number of a topic stands for two records, and
//! either can be presented as the one.

use std::process::Command;

use authros::model::Header;
use serde_json::Value;

use crate::support::{Authros, Home, Running, count, text, wait_until};
use crate::{Outcome, judge};

const TOPIC: &str = "/robot1/odom";

fn site(home: &Home) -> (Authros, Running) {
    let authros = home.authros().with(&["--robots", "1"]);
    let running = authros.serve(home);
    (authros, running)
}

/// Everything captured since there were `before` records.
fn newer(authros: &Authros, before: &[Value]) -> Vec<Value> {
    let known: Vec<String> = before.iter().map(|record| text(record, "digest")).collect();
    let all = authros.records(&["records", "list", "--oldest", "--topic", TOPIC, "--state", "verified"]);
    all.into_iter().filter(|record| !known.contains(&text(record, "digest"))).collect()
}

/// What a record's owner has signed about it.
fn header(home: &Home, authros: &Authros, record: &Value, name: &str) -> Header {
    let folder = home.root().join(name);
    let place = folder.to_str().expect("UTF-8");
    authros.run(&["records", "export", &text(record, "id"), "--dir", place]).expect_code(0);
    Header::parse(&std::fs::read(folder.join("record.bin")).expect("the record")).expect("a record").0
}

#[test]
fn run_a_copied_home() {
    let (first, second) = (Home::new(), Home::new());
    let (authros, running) = site(&first);
    authros.json(&["topics", "watch", TOPIC]);
    let some = || (count(&authros.json(&["status"])["life"], "verified") >= 5).then_some(());
    wait_until(60, "records are verified", some);
    authros.json(&["topics", "unwatch", TOPIC]);
    let settled = || (count(&authros.json(&["status"])["life"], "pending") == 0).then_some(());
    wait_until(60, "all of them are", settled);
    let before = authros.records(&["records", "list", "--oldest", "--topic", TOPIC]);
    let copied = Command::new("cp").arg("-a").arg(first.path()).arg(second.path()).status();
    assert!(copied.is_ok_and(|status| status.success()), "the home is copied while it runs");

    authros.json(&["topics", "watch", TOPIC]);
    let (other, copy) = site(&second);
    other.json(&["topics", "watch", TOPIC]);
    let of_first = wait_until(60, "the first goes on", || Some(newer(&authros, &before)).filter(|all| all.len() >= 20));
    let of_second = wait_until(60, "the copy goes on", || Some(newer(&other, &before)).filter(|all| all.len() >= 20));
    let theirs = header(&second, &other, &of_second[of_second.len() - 1], "copied");
    let ours = header(&first, &authros, &of_first[of_first.len() - 1], "original");
    let told = copy.stderr();
    copy.stop("TERM", 30).expect_code(0);
    running.stop("TERM", 30).expect_code(0);
    judge(
        "run_a_copied_home",
        if ours.recorder == theirs.recorder {
            let recorder = ours.recorder;
            let text = format!("recorder {recorder} counts on in both homes ({} here, {} there)", ours.seq, theirs.seq);
            Outcome::Succeeded(text)
        } else {
            match told.lines().find(|line| line.contains("this home is a copy") && line.contains("new recorder")) {
                Some(words) => Outcome::Refused(words.to_owned()),
                None => Outcome::Otherwise(format!("two recorders, and no word of it: {told}")),
            }
        },
    );
}

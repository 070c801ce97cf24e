//! Someone who copied a home anchors under its account, on the same chain, while its owner watches without noticing.

use std::process::Command;

use serde_json::Value;

use crate::support::{Anvil, Authros, Home, count, poll, skipped, text, wait_until};
use crate::{Outcome, judge};

const TOPIC: &str = "/robot1/odom";

/// A site over a home on this node, capturing.
fn site(home: &Home, node: &Anvil) -> (Authros, crate::support::Running) {
    let authros = home.authros().with(&["--robots", "1", "--chain", &node.http()]);
    let running = authros.serve(home);
    (authros, running)
}

fn copy(from: &Home, to: &Home) {
    let copied = Command::new("cp").arg("-a").arg(from.path()).arg(to.path()).status();
    assert!(copied.is_ok_and(|status| status.success()), "the home is copied");
}

fn verified(authros: &Authros) -> u64 {
    count(&authros.json(&["status"])["life"], "verified")
}

#[test]
fn anchor_as_somebody_else() {
    let Some(node) = Anvil::start(&[]) else { skipped!("no anvil: npm install in tests/peers") };
    let (owner, thief) = (Home::new(), Home::new());
    let (authros, running) = site(&owner, &node);
    authros.json(&["topics", "watch", TOPIC]);
    wait_until(60, "the owner's records are verified", || (verified(&authros) >= 5).then_some(()));
    authros.json(&["topics", "unwatch", TOPIC]);
    wait_until(60, "all of them are", || (count(&authros.json(&["status"])["life"], "pending") == 0).then_some(()));
    running.stop("TERM", 30).expect_code(0);
    copy(&owner, &thief);

    let (authros, running) = site(&owner, &node);
    let (other, copied) = site(&thief, &node);
    let before = verified(&other);
    other.json(&["topics", "watch", TOPIC]);
    wait_until(60, "the thief's records are verified", || (verified(&other) >= before + 5).then_some(()));

    let told = poll(20, || {
        let outcome = authros.with(&["--json"]).run(&["status"]);
        let parts = outcome.document()["health"].as_array().cloned().unwrap_or_default();
        let is_told =
            |part: &&Value| outcome.code != Some(0) && text(part, "text").contains("without this home sending it");
        parts.iter().find(is_told).map(|part| text(part, "text"))
    });
    let audited = authros.run(&["audit", "list"]).stdout.contains("foreign anchor");
    let heard = running.stderr().contains("without this home sending it");
    copied.stop("TERM", 30).expect_code(0);
    running.stop("TERM", 30).expect_code(0);
    judge(
        "anchor_as_somebody_else",
        match told {
            Some(words) if audited && heard => Outcome::Refused(words),
            Some(words) => {
                Outcome::Otherwise(format!("{words}; in the audit log: {audited}, told when it happened: {heard}"))
            }
            None => Outcome::Succeeded(
                "the copy's records are verified, the owner's status says that all is well".to_owned(),
            ),
        },
    );
}

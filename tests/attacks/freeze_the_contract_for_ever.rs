//! The administrator pauses everyone's changes, and never lets them resume.

use crate::support::clock::days_ahead;
use crate::support::{Home, skipped, text};
use crate::{Outcome, judge};

#[test]
fn freeze_the_contract_for_ever() {
    let home = Home::new();
    let (boss, owner) = (home.profile("boss"), home.profile("owner"));
    boss.enrol();
    owner.enrol();
    boss.json(&["chain", "admin", "pause"]);
    let device = "ab".repeat(32);
    let lend = ["robot", "authorise", &device];
    let stopped = owner.fails(5, &lend);
    assert!(stopped.contains("paused"), "{stopped}");
    let Some(later) = days_ahead(&owner, 4) else { skipped!("no libfaketime (package faketime)") };
    let outcome = later.with(&["--json"]).run(&lend);
    if outcome.code != Some(0) {
        let words = text(&outcome.document()["error"], "message");
        let outcome = if words.contains("paused") {
            Outcome::Succeeded(format!("four days later still: {words}"))
        } else {
            Outcome::Otherwise(outcome.to_string())
        };
        return judge("freeze_the_contract_for_ever", outcome);
    }
    // It ended by itself; she tries the next pause at once.
    let again = days_ahead(&boss, 4).expect("libfaketime").with(&["--json"]).run(&["chain", "admin", "pause"]);
    let outcome = if again.code == Some(0) {
        Outcome::Succeeded("one pause after the other".to_owned())
    } else {
        let words = text(&again.document()["error"], "message");
        let named = again.code == Some(5) && words.contains("the next pause must wait");
        if named { Outcome::Refused(words) } else { Outcome::Otherwise(again.to_string()) }
    };
    judge("freeze_the_contract_for_ever", outcome);
}

//! The administrator of the contract names an account of her own as the successor of somebody who lost nothing.

use crate::support::clock::days_ahead;
use crate::support::{Authros, Home, list, skipped, text};
use crate::{Outcome, judge};

fn successor(authros: &Authros) -> Option<String> {
    let status = authros.json(&["chain", "status"]);
    list(&status["administration"], "successions").first().map(|named| text(named, "successor"))
}

#[test]
fn take_over_an_account_as_administrator() {
    let home = Home::new();
    let [boss, victim, accomplice, friend] = ["boss", "victim", "accomplice", "friend"].map(|name| home.profile(name));
    let [_, lost, next, recovery] = [&boss, &victim, &accomplice, &friend].map(Authros::enrol);
    if days_ahead(&boss, 1).is_none() {
        skipped!("no libfaketime (package faketime)");
    }
    let at = |authros: &Authros, days| days_ahead(authros, days).expect("libfaketime");
    victim.json(&["identity", "recovery", &recovery]);
    // Once openly, waiting for the delay; and once by setting a clock of her own forward.
    at(&boss, 8).json(&["chain", "succession", "propose", &lost, &next]);
    let early = at(&boss, 9).fails(5, &["chain", "succession", "complete", &lost]);
    at(&friend, 10).json(&["chain", "succession", "cancel", &lost]);
    let stopped = at(&boss, 30).fails(5, &["chain", "succession", "complete", &lost]);
    let outcome = match successor(&at(&boss, 30)) {
        Some(successor) => Outcome::Succeeded(format!("{successor} continues for {lost}")),
        None if early.contains("the succession is still pending")
            && stopped.contains("no succession of that account") =>
        {
            Outcome::Refused(format!("{early}; after the recovery account's veto: {stopped}"))
        }
        None => Outcome::Otherwise(format!("{early}; after the recovery account's veto: {stopped}")),
    };
    judge("take_over_an_account_as_administrator", outcome);
}

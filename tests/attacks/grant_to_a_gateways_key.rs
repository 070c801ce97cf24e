//! To get the keys of an owner who joins through the attacker's gateway: whoever relays the chain can present a key of
//! their own as the reader's. All it takes is an owner who grants to a key that nobody compared.

use super::support::Home;
use super::support::gate::Gate;
use super::{Outcome, judge};

#[test]
fn an_owner_grants_to_a_key_known_from_the_gateway_alone() {
    let (gate, away) = (Gate::new(), Home::new());
    let bob = gate.home.profile("bob").enrol();
    let alice = away.profile("alice").with(&gate.options());
    alice.enrol();
    let granted = alice.run(&["grant", "add", &bob]);
    let words = granted.stderr.lines().last().unwrap_or_default().to_owned();
    let outcome = if granted.code == Some(0) {
        Outcome::Succeeded("the keys were wrapped for whatever key the gateway showed as the reader's".to_owned())
    } else if words.contains("--fingerprint") {
        Outcome::Refused(words)
    } else {
        Outcome::Otherwise(granted.to_string())
    };
    judge("grant_to_a_gateways_key", outcome);
}

//! A gateway of an earlier version in a fleet: it ends the session at a Command that it does not know. That is told once, and
//! the others go on.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use authros::crypto::SmKeyPair;
use authros::gateway::{HandedOver, HoldingPlace, Holdings, Wanted};

use super::reconciling::{bring, fellows};
use super::sessions::{known, runtime};
use super::*;
use support::member::Member as Keys;
use support::stub_desk::{self, Tells};

/// Ends the session at Command 20.
struct Earlier {
    line: Cable,
    asked: AtomicUsize,
}

impl Tells for Earlier {
    fn holdings(&self, _: &HoldingPlace) -> Option<Holdings> {
        self.asked.fetch_add(1, Ordering::AcqRel);
        self.line.end_connections();
        None
    }

    fn hand_over(&self, _: &Wanted) -> HandedOver {
        HandedOver::default()
    }
}

#[test]
fn a_gateway_of_an_earlier_version_is_told_of_once_and_the_others_go_on() {
    let (ground, runtime) = (Ground::new(), runtime());
    let (first, second) = (Gateway::new(&ground), Gateway::new(&ground));
    let (alice, bob) = (Member::new("alice", &[&first, &second]), Member::new("bob", &[&first]));
    alice.grant(&bob);
    let keeper = Keys::of(&first.home, "keeper", first.domain.parse().expect("a domain"));
    let identity = SmKeyPair::generate(keeper.provider()).expect("a pair");
    let (folder, context) = (Home::new(), known(&first).endpoint().context);
    let earlier = Arc::new(Earlier { line: Cable::to(0), asked: AtomicUsize::new(0) });
    let tells = Arc::clone(&earlier) as Arc<dyn Tells>;
    let (server, key) =
        runtime.block_on(stub_desk::serve(context, &keeper, identity, &folder.root().join("earlier"), tells));
    earlier.line.lead_to(server.address().port());
    first.keeper().json(&["fleet", "add", &earlier.line.address(), "--gateway-key", &key]);
    name_each_other(&[&first, &second]);

    wait_until(60, "it is asked again and again", || (earlier.asked.load(Ordering::Acquire) >= 3).then_some(()));
    let problem = |key: &str| {
        let rows = fellows(&first);
        rows.iter().find(|row| row["key"] == *key).expect("named")["problem"].as_str().map(str::to_owned)
    };
    let problem_of_it = problem(&key).expect("told");
    assert!(problem_of_it.contains("of an earlier version"), "{problem_of_it}");
    wait_until(60, "the other one is at ease", || problem(&second.key).is_none().then_some(()));
    let said = first.site.as_ref().expect("running").stderr();
    let about = |line: &&str| line.contains(&earlier.line.address()) && line.contains("does not reconcile");
    assert_eq!(said.lines().filter(about).count(), 1, "{said}");

    let robot = Robot::enrol(&alice, "scout", &[&second]);
    let all = bring(&robot, "5");
    let at_bob = bob.verified(&["shared", "list", "--owner", &alice.address], all);
    assert_eq!(alice.verified(&["uploads", "list"], all), at_bob, "what is at the second one is at the first one too");
}

//! A reader asks every gateway which records it lacks: those of gateways that do not know each other, of some that do, and
//! with one that is away.

use super::reconciling::{bring, name_each_other, reconciled};
use super::*;
use support::list;

const INCOMPLETE: i32 = 8;
const REFUSED: i32 = 5;

/// What a reader is told, and the exit code.
fn told(member: &Member, further: &[&str]) -> (Option<i32>, Value) {
    let outcome = member.authros.with(&["--json"]).run(&[&["shared", "gateways"], further].concat());
    let view =
        serde_json::from_str(&outcome.stdout).unwrap_or_else(|_| panic!("{} {}", outcome.stdout, outcome.stderr));
    (outcome.code, view)
}

/// The records of the robot's topic that a gateway lacks: recorder, ranges, who has them, whether this home has them.
fn lacks(view: &Value, place: usize) -> Vec<(String, Value, Value, bool)> {
    let lacks = list(&list(view, "gateways")[place], "lacks");
    let odometry = lacks.iter().filter(|lack| lack["topic"] == TOPIC);
    odometry
        .map(|lack| (text(lack, "recorder"), lack["ranges"].clone(), lack["held_by"].clone(), lack["here"] == true))
        .collect()
}

#[test]
fn a_reader_is_told_which_records_each_gateway_lacks_and_who_has_them() {
    let _alone = heavy();
    let ground = Ground::new();
    let (mut first, mut second) = (Gateway::new(&ground), Gateway::new(&ground));
    let both = [&first, &second];
    let (alice, bob) = (Member::new("alice", &both), Member::new("bob", &both));
    let carol = Member::new("carol", &[&second]);
    alice.grant(&bob);
    alice.grant(&carol);
    let (scout, rover) = (Robot::enrol(&alice, "scout", &[&first]), Robot::enrol(&alice, "rover", &[&second]));
    let (at_first, at_second) = (bring(&scout, "10"), bring(&rover, "5"));
    let shared = ["shared", "list", "--owner", &alice.address];
    bob.verified(&shared, at_first + at_second);

    // Neither knows the other: each lacks what the other has, and nobody lacks a number.
    for member in [&bob, &alice] {
        let (code, view) = told(member, &["--owner", &alice.address]);
        assert_eq!((code, &view["ok"], &view["nowhere"]), (Some(INCOMPLETE), &Value::Bool(false), &0.into()), "{view}");
        let mut recorders = BTreeSet::new();
        for (place, other, least) in [(0, &second, at_second), (1, &first, at_first)] {
            let found = lacks(&view, place);
            let [(recorder, ranges, holders, here)] = &found[..] else { panic!("{view}") };
            let ranges: Vec<(u64, u64)> = serde_json::from_value(ranges.clone()).expect("pairs");
            let [range] = ranges[..] else { panic!("one range: {view}") };
            // Definitions and reports of losses have numbers, too.
            assert!(range.0 == 1 && range.1 >= least && range.1 < least + 5, "{least}: {view}");
            assert_eq!((holders, here), (&serde_json::json!([other.address()]), &true), "{view}");
            recorders.insert(recorder.clone());
        }
        assert_eq!(recorders.len(), 2, "each robot has numbers of its own: {view}");
    }
    let printed = bob.authros.run(&["shared", "gateways", "--topic", TOPIC]);
    assert_eq!(printed.code, Some(INCOMPLETE), "{}", printed.stdout);
    assert!(printed.stdout.contains(&format!("{} lacks:", second.address())), "{}", printed.stdout);
    assert!(printed.stdout.contains(&format!("{}, this home have them", first.address())), "{}", printed.stdout);
    // Where each record is to be at one gateway only, that is as it should be.
    let (code, view) = told(&bob, &["--copies", "1"]);
    assert_eq!((code, &view["ok"], &view["short"]), (Some(0), &Value::Bool(true), &0.into()), "{view}");
    assert!(!lacks(&view, 0).is_empty(), "it is told all the same: {view}");
    bob.authros.fails(REFUSED, &["shared", "gateways", "--owner", &carol.address]);
    // Who joins one alone learns of nothing that it lacks.
    let (code, view) = told(&carol, &[]);
    assert_eq!((code, list(&view, "gateways").len()), (Some(0), 1), "{view}");
    assert!(count(&list(&view, "gateways")[0], "records") >= at_second, "{view}");

    name_each_other(&both);
    both.into_iter().for_each(|gateway| drop(reconciled(gateway, 5)));
    let view = wait_until(60, "nothing is lacking", || {
        let (code, view) = told(&bob, &[]);
        (code == Some(0)).then_some(view)
    });
    let held: Vec<u64> = list(&view, "gateways").iter().map(|gateway| count(gateway, "records")).collect();
    assert!(held[0] == held[1] && held[0] >= at_first + at_second, "{view}");

    first.kill();
    let (code, view) = told(&bob, &["--owner", &alice.address]);
    let gateways = list(&view, "gateways");
    assert_eq!((code, &view["ok"]), (Some(UNREACHABLE), &Value::Bool(false)), "{view}");
    assert!(gateways[0]["problem"].is_string() && gateways[1]["problem"].is_null(), "{view}");
    assert_eq!((count(&gateways[1], "lacking"), count(&gateways[1], "records")), (0, held[1]), "{view}");
    // Nobody answers a reader whose only gateway is away.
    second.kill();
    carol.authros.fails(UNREACHABLE, &["shared", "gateways"]);
}

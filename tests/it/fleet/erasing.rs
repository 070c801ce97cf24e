//! An owner has recordings erased at her home: they are gone at every gateway of the fleet, also at one that was away, and one
//! that was killed meanwhile; readers of each are told so by their owner.

use super::reconciling::{bring, fellows};
use super::*;
use crate::support::erased::{pieces_of, with_any};
use crate::support::list;

const WHY: &str = "a passer-by asked for it";

/// How many records a gateway has erased at others' word since it runs.
fn erased(gateway: &Gateway) -> u64 {
    fellows(gateway).iter().map(|fellow| count(fellow, "erased")).sum()
}

fn erase(owner: &Authros, records: &[Value]) {
    let ids: Vec<String> = records.iter().map(|record| text(record, "id")).collect();
    let mut arguments = vec!["retention", "erase", "--reason", WHY, "--yes", "--record"];
    arguments.extend(ids.iter().map(String::as_str));
    let done = owner.json_within(120, &arguments);
    assert_eq!((count(&done, "named"), &done["deleted"]), (records.len() as u64, &Value::Bool(true)), "{done}");
}

fn is_gone(gateway: &Gateway, pieces: &[Vec<u8>]) -> Duration {
    let begun = Instant::now();
    wait_until(60, "no file of it has any of the bytes", || {
        with_any(&gateway.home.path(), pieces).is_empty().then_some(())
    });
    begun.elapsed()
}

/// A reader who joins this gateway alone, and afterwards: all are listed, and these with their owner's word instead of bytes.
fn told(alice: &Member, gateway: &Gateway, (name, messages): (&str, &[Value]), gone: &BTreeSet<String>) {
    let reader = Member::new(name, &[gateway]);
    alice.grant(&reader);
    let settled = |record: &Value| is_verified(record) || record["state"] == "deleted";
    let ids: BTreeSet<String> = messages.iter().map(|record| text(record, "id")).collect();
    let records = wait_until(180, "all are listed", || {
        let mut records = reader.authros.records_so_far(&["shared", "list", "--owner", &alice.address])?;
        records.retain(|record| ids.contains(&text(record, "id")));
        (records.len() >= ids.len() && records.iter().all(settled)).then_some(records)
    });
    assert_eq!(records.len(), ids.len(), "none lost and none twice");
    for record in records {
        let is_gone = gone.contains(&text(&record, "id"));
        assert_eq!(record["state"] == "deleted", is_gone, "{record}");
        if is_gone {
            let words = text(&record, "erased");
            assert!(words.starts_with("erased 20") && words.ends_with("by its owner, its proof remains"), "{words}");
            assert_eq!(reader.authros.json(&["shared", "check", &text(&record, "id")])["verdict"], "deleted");
        }
    }
}

#[test]
fn what_an_owner_erases_at_her_home_is_gone_at_every_gateway() {
    let _alone = heavy();
    let ground = Ground::new();
    let (first, mut second, mut third) = (Gateway::new(&ground), Gateway::new(&ground), Gateway::new(&ground));
    // Her profile is at home at the first one.
    let authros = first.profile("alice");
    let address = authros.enrol();
    [&first, &second, &third].iter().for_each(|gateway| gateway.admit(&address));
    let alice = Member { home: Home::new(), authros, address, site: None };
    name_each_other(&[&first, &second, &third]);
    let robot = Robot::enrol(&alice, "scout", &[&first]);
    let all = bring(&robot, "10");
    let messages = wait_until(180, "all is verified", || {
        let messages = alice.authros.records(&["uploads", "list", "--topic", TOPIC, "--kind", "data"]);
        (messages.len() >= 10 && messages.iter().all(is_verified)).then_some(messages)
    });
    [&second, &third].iter().for_each(|gateway| drop(reconciled(gateway, all)));
    let pieces = pieces_of(&first.home, &messages[..4]);
    let others = pieces_of(&first.home, &messages[4..]);
    let found = |gateway: &Gateway| !with_any(&gateway.home.path(), &pieces).is_empty();
    assert!([&first, &second, &third].iter().all(|gateway| found(gateway)), "the search finds what is there");

    // The third one is away.
    third.kill();
    erase(&alice.authros, &messages[..3]);
    println!("no byte is at the other gateway {:?} after the owner's own were gone", is_gone(&second, &pieces[..9]));
    assert!(!with_any(&second.home.path(), &others).is_empty(), "what was not chosen stays");
    // The second one dies as soon as it has heard of the next one.
    let before = wait_until(60, "three are counted", || Some(erased(&second)).filter(|count| *count == 3));
    erase(&alice.authros, &messages[3..4]);
    wait_until(60, "it has heard", || (erased(&second) > before).then_some(()));
    second.kill();
    second.start();
    is_gone(&second, &pieces);
    assert!(found(&third), "who is away keeps them until then");
    third.start();
    println!("no byte is at the gateway that was away {:?} after it was back", is_gone(&third, &pieces));
    wait_until(60, "all is at ease", || (erased(&third) >= 4 && reconciled(&third, 0).len() == 2).then_some(()));
    assert!(fellows(&third).iter().all(|fellow| fellow["problem"].is_null()), "{:?}", fellows(&third));
    assert!(!with_any(&third.home.path(), &others).is_empty(), "what was not chosen stays");
    let lines = list(&third.keeper().json(&["audit", "list", "--action", "fleet erase"]), "audit");
    assert!(lines.iter().all(|line| text(line, "subject").contains(&alice.address)) && !lines.is_empty(), "{lines:?}");

    let gone: BTreeSet<String> = messages[..4].iter().map(|record| text(record, "id")).collect();
    told(&alice, &second, ("bob", &messages), &gone);
    told(&alice, &third, ("carol", &messages), &gone);
    third.keeper().json_within(120, &["audit", "--deep"]);
}

#[test]
fn what_an_owner_erases_who_only_joins_gateways_is_gone_at_all_of_the_fleet() {
    let _alone = heavy();
    let ground = Ground::new();
    let (first, mut second, third) = (Gateway::new(&ground), Gateway::new(&ground), Gateway::new(&ground));
    name_each_other(&[&first, &second, &third]);
    // Her home joins two of the three, and none is at home there.
    let alice = Member::new("alice", &[&first, &second]);
    third.admit(&alice.address);
    let robot = Robot::enrol(&alice, "scout", &[&first]);
    let all = bring(&robot, "8");
    let messages = wait_until(180, "all is verified", || {
        let messages = alice.authros.records(&["uploads", "list", "--topic", TOPIC, "--kind", "data"]);
        (messages.len() >= 8 && messages.iter().all(is_verified)).then_some(messages)
    });
    [&second, &third].iter().for_each(|gateway| drop(reconciled(gateway, all)));
    let (pieces, later) = (pieces_of(&first.home, &messages[..2]), pieces_of(&first.home, &messages[2..3]));
    let others = pieces_of(&first.home, &messages[3..]);
    let found = |gateway: &Gateway| !with_any(&gateway.home.path(), &pieces).is_empty();
    assert!([&first, &second, &third].iter().all(|gateway| found(gateway)), "the search finds what is there");

    let asking = ["retention", "erase", "--reason", WHY, "--record", &text(&messages[0], "id")];
    let shown = alice.authros.with(&["--json"]).run(&asking).expect_code(2).stdout;
    let shown: Value = serde_json::from_str(&shown).expect("JSON");
    let stays = list(&shown, "stays");
    let names = |line: &Value| line.as_str().is_some_and(|line| line.contains(&first.address()));
    assert!(stays.iter().any(names) && found(&first), "it says who is told, and erases nothing yet: {stays:?}");
    erase(&alice.authros, &messages[..2]);
    for gateway in [&first, &second, &third] {
        println!("no byte is at the gateway {} {:?} after", gateway.address(), is_gone(gateway, &pieces));
        assert!(!with_any(&gateway.home.path(), &others).is_empty(), "what was not chosen stays");
    }
    // Both that she joins are told, each once, and write down by whom; the third hears it from them.
    let written =
        |gateway: &Gateway| list(&gateway.keeper().json(&["audit", "list", "--action", "fleet erase"]), "audit");
    let by = |gateway: &Gateway, who: &str| {
        let lines = written(gateway);
        lines.iter().any(|line| text(line, "outcome").contains(who) && text(line, "subject").contains(&alice.address))
    };
    assert!(by(&first, "told by their owner") || by(&second, "told by their owner"));
    assert!(by(&third, "told by 127.0.0.1"), "{:?}", written(&third));
    // A line is written when that gateway has answered, which may have heard it from the other before.
    let own = || list(&alice.authros.json(&["audit", "list", "--action", "erase elsewhere"]), "audit");
    let lines = wait_until(60, "both have answered", || Some(own()).filter(|lines| lines.len() == 2));
    assert!(lines.iter().all(|line| text(line, "outcome").contains("erases its copies")), "{lines:?}");

    // One that is away hears it when it is back, and nothing is told twice in the log.
    second.kill();
    erase(&alice.authros, &messages[2..3]);
    is_gone(&first, &later);
    assert!(!with_any(&second.home.path(), &later).is_empty(), "who is away keeps them until then");
    second.start();
    is_gone(&second, &later);
    is_gone(&third, &later);
    let gone: BTreeSet<String> = messages[..3].iter().map(|record| text(record, "id")).collect();
    told(&alice, &third, ("bob", &messages), &gone);
    let lines = wait_until(60, "they have answered", || Some(own()).filter(|lines| lines.len() >= 3));
    assert!(lines.len() <= 4, "{lines:?}");
}

//! An owner whose home only joins a gateway has recordings erased at home: they are gone at the gateway, also if it was away
//! or is killed meanwhile; readers who come afterwards are told so by their owner.

use super::*;
use crate::support::erased::{pieces_of, with_any};
use crate::support::list;

const WHY: &str = "a passer-by asked for it";

fn begin_to_erase(owner: &Authros, records: &[Value]) -> Running {
    let ids: Vec<String> = records.iter().map(|record| text(record, "id")).collect();
    let mut arguments = vec!["records", "erase", "--reason", WHY, "--yes", "--record"];
    arguments.extend(ids.iter().map(String::as_str));
    owner.with(&["--json"]).spawn(&arguments)
}

fn expect_erased(erasing: Running, records: &[Value]) {
    let done = erasing.wait(150).expect_code(0).document();
    assert_eq!((count(&done, "named"), &done["deleted"]), (records.len() as u64, &Value::Bool(true)), "{done}");
}

fn erase(owner: &Authros, records: &[Value]) {
    expect_erased(begin_to_erase(owner, records), records);
}

fn is_gone(gateway: &Gateway, pieces: &[Vec<u8>]) -> Duration {
    let begun = Instant::now();
    wait_until(60, "no file of it has any of the bytes", || {
        with_any(&gateway.home.path(), pieces).is_empty().then_some(())
    });
    begun.elapsed()
}

/// A reader who comes afterwards: all are listed, and these with their owner's word instead of bytes.
fn told(alice: &Member, gateway: &Gateway, (name, messages): (&str, &[Value]), gone: &BTreeSet<String>) {
    let reader = Member::new(name, gateway);
    alice.grant(&reader);
    let settled = |record: &Value| is_verified(record) || record["state"] == "deleted";
    let ids: BTreeSet<String> = messages.iter().map(|record| text(record, "id")).collect();
    let records = wait_until(180, "all are listed", || {
        let mut records =
            reader.authros.records_so_far(&["received", "list", "--oldest", "--owner", &alice.address])?;
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
            assert_eq!(reader.authros.json(&["records", "check", &text(&record, "id")])["verdict"], "deleted");
        }
    }
}

#[test]
fn what_an_owner_erases_whose_home_joins_a_gateway_is_gone_there() {
    let _alone = heavy();
    let ground = Ground::new();
    let mut gateway = Gateway::new(&ground);
    let alice = Member::new("alice", &gateway);
    Robot::enrol(&alice, "scout", &gateway).bring("8");
    let messages = wait_until(180, "all is verified", || {
        let messages = alice.authros.records(&["records", "list", "--oldest", "--topic", TOPIC, "--kind", "data"]);
        (messages.len() >= 8 && messages.iter().all(is_verified)).then_some(messages)
    });
    let (pieces, later) = (pieces_of(&gateway.home, &messages[..2]), pieces_of(&gateway.home, &messages[2..4]));
    let others = pieces_of(&gateway.home, &messages[4..]);
    let found = |gateway: &Gateway, pieces: &[Vec<u8>]| !with_any(&gateway.home.path(), pieces).is_empty();
    assert!(found(&gateway, &pieces), "the search finds what is there");

    let asking = ["records", "erase", "--reason", WHY, "--record", &text(&messages[0], "id")];
    let shown = alice.authros.with(&["--json"]).run(&asking).expect_code(2).stdout;
    let shown: Value = serde_json::from_str(&shown).expect("JSON");
    let stays = list(&shown, "stays");
    let names = |line: &Value| line.as_str().is_some_and(|line| line.contains(&gateway.address()));
    assert!(
        stays.iter().any(names) && found(&gateway, &pieces),
        "it says who is told, and erases nothing yet: {stays:?}"
    );
    erase(&alice.authros, &messages[..2]);
    println!("no byte is at the gateway {:?} after the owner's own were gone", is_gone(&gateway, &pieces));
    assert!(found(&gateway, &others), "what was not chosen stays");
    let written = list(&gateway.keeper().json(&["audit", "list", "--action", "gateway erase"]), "audit");
    assert!(!written.is_empty(), "it writes down by whom");
    for line in &written {
        assert!(text(line, "outcome").contains("as their owner requested"), "{line}");
        assert!(text(line, "subject").contains(&alice.address), "{line}");
    }
    let own = || list(&alice.authros.json(&["audit", "list", "--action", "erase elsewhere"]), "audit");
    let lines = wait_until(60, "it has answered", || Some(own()).filter(|lines| !lines.is_empty()));
    assert!(lines.iter().all(|line| text(line, "outcome").contains("erases its copies")), "{lines:?}");

    // One that is away hears it when it is back, also if it dies as soon as it has heard, and nothing is logged twice.
    // Her own bytes go when the chain, which is there, confirms that they were named.
    gateway.kill();
    let named = || list(&alice.authros.json(&["audit", "list", "--action", "erase"]), "audit").len();
    let before = named();
    let erasing = begin_to_erase(&alice.authros, &messages[2..4]);
    wait_until(60, "they are named", || (named() >= before + 2).then_some(()));
    assert!(found(&gateway, &later), "who is away keeps them until then");
    gateway.start();
    expect_erased(erasing, &messages[2..4]);
    wait_until(60, "it has heard", || {
        let lines = list(&gateway.keeper().json(&["audit", "list", "--action", "gateway erase"]), "audit");
        (lines.len() > written.len()).then_some(())
    });
    gateway.kill();
    gateway.start();
    is_gone(&gateway, &later);
    let gone: BTreeSet<String> = messages[..4].iter().map(|record| text(record, "id")).collect();
    told(&alice, &gateway, ("bob", &messages), &gone);
    let lines = wait_until(60, "it has answered", || Some(own()).filter(|lines| lines.len() >= 2));
    assert!(lines.len() <= 4, "{lines:?}");
    gateway.keeper().json_within(120, &["audit", "--deep"]);
}

//! What a home has only some of: a reader of one topic, and a reader to whom records are still coming.

use super::sessions::{known, runtime, session};
use super::*;
use support::member::Member as Keys;

const OTHER_TOPIC: &str = "/robot1/camera";

/// Records held in a home's ledger, read from beside.
fn held(home: &Home) -> u64 {
    let Ok(ledger) = rusqlite::Connection::open(home.path().join("ledger.db")) else { return 0 };
    let count = ledger.query_row("SELECT count(*) FROM records", [], |row| row.get::<_, i64>(0));
    count.map_or(0, i64::unsigned_abs)
}

/// Brings this many records of each topic in the owner's name; waits until all are verified.
fn bring(owner: &Member, gateway: &Gateway, topics: &[&str], each: u64) {
    let keys = Keys::of(&owner.home, "alice", gateway.domain.parse().expect("a domain"));
    let (runtime, place) = (runtime(), known(gateway));
    runtime.block_on(async {
        let (mut client, _) = session(&keys, &place, "bringer").await;
        let numbers: Vec<u64> = (1..=each).collect();
        for some in numbers.chunks(16) {
            let records = some.iter().flat_map(|seq| {
                topics.iter().map(|topic| keys.record(&keys.keyring.signing, topic, *seq, b"where it is"))
            });
            client.upload(records.collect()).await.expect("taken");
        }
    });
    owner.verified(&["records", "list", "--oldest"], each * topics.len() as u64);
}

fn audits_are_silent(authros: &Authros) {
    for audit in [&["audit"][..], &["audit", "--deep"]] {
        let outcome = authros.run(audit);
        assert_eq!(outcome.code, Some(0), "{audit:?}: {outcome}");
    }
}

#[test]
fn an_audit_of_a_reader_of_one_topic_misses_nothing_of_the_batches_it_has_some_of() {
    let ground = Ground::new();
    let gateway = Gateway::new(&ground);
    let (alice, bob) = (Member::new("alice", &gateway), Member::new("bob", &gateway));
    let print = text(&bob.authros.json(&["identity", "show"]), "fingerprint");
    alice.authros.json(&["contacts", "add", "bob", &bob.address, "--fingerprint", &print]);
    alice.authros.json(&["grant", "add", "--to", "bob", "--topic", TOPIC]);
    bring(&alice, &gateway, &[TOPIC, OTHER_TOPIC], 4);
    bob.verified(&["received", "list", "--oldest", "--owner", &alice.address], 4);
    // Eight records are in fewer batches: of some of them bob has a part.
    audits_are_silent(&bob.authros);
    audits_are_silent(&alice.authros);
    audits_are_silent(&gateway.keeper());
}

#[test]
fn a_list_shows_what_is_here_while_more_arrives() {
    let _alone = heavy();
    let ground = Ground::new();
    let mut gateway = Gateway::new(&ground);
    let line = Cable::to(gateway.port);
    let alice = Member::new("alice", &gateway);
    let mut bob = Member::at(None, "bob", (&gateway, &[&line.address()]));
    alice.grant(&bob);
    bob.site.take().expect("running").stop("TERM", 30).expect_code(0);
    bring(&alice, &gateway, &[TOPIC], 1_000);
    let before = held(&bob.home);

    bob.site = Some(bob.authros.serve(&bob.home));
    wait_until(120, "some are here", || (held(&bob.home) >= before + 30).then_some(()));
    // The gateway stands still, as a slow line would make it.
    line.mute();
    let here = held(&bob.home);
    if here < before + 1_000 {
        let page = bob.authros.json(&["received", "list", "--oldest", "--limit", "1000", "--owner", &alice.address]);
        let records = support::list(&page, "records");
        assert!(records.len() >= 20, "{} of {here} are listed", records.len());
        assert!(text(&page, "arriving").contains("still arriving"), "{}", page["arriving"]);
        let said = bob.authros.run(&["received", "list", "--oldest", "--owner", &alice.address]).expect_code(0);
        assert!(said.stdout.contains("this is what is here so far"), "{said}");
    }
    line.mend();
    bob.verified(&["received", "list", "--oldest", "--owner", &alice.address], 1_000);
    let page = bob.authros.json(&["received", "list", "--oldest", "--limit", "5", "--owner", &alice.address]);
    assert!(page["arriving"].is_null(), "{page}");

    // A gateway that is gone: the same records, with the reason why they may not be all.
    gateway.site.take().expect("running").stop("KILL", 20);
    wait_until(60, "the list says that the gateway is gone", || {
        let page = bob.authros.json(&["received", "list", "--oldest", "--limit", "5", "--owner", &alice.address]);
        assert_eq!(support::list(&page, "records").len(), 5, "{page}");
        let said = page["arriving"].as_str()?;
        (said.contains("still arriving") && said.contains("does not answer")).then_some(())
    });
}

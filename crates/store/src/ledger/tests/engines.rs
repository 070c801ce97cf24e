//! What only a server can do to a ledger: end connections, become a standby, wait for one, and serve several processes.

use super::server::{Cluster, shared, skip};
use super::*;
use crate::model::TopicPattern;

fn append(ledger: &Ledger, owner: u8, seq: u64) -> Result<(), StoreError> {
    ledger.records.append(vec![NewRecord { blob: Some(vec![owner; 100]), ..record(owner, 1, seq) }])
}

fn next(ledger: &Ledger, owner: u8) -> u64 {
    ledger.records.next_seq(Address([owner; 20]), SignerId([owner; 32]), TopicId([1; 16])).expect("read")
}

/// Of every connection of a ledger.
const END: &str = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE usename = 'authros'";

/// A server of its own, whose settings others do not feel.
fn own(name: &str) -> Option<(Cluster, Ledger)> {
    let started = shared().map_err(str::to_owned).and_then(|_| Cluster::start());
    match started {
        Ok(cluster) => {
            let ledger = Ledger::on_server(&cluster.schema(), None).expect("opens");
            Some((cluster, ledger))
        }
        Err(reason) => {
            skip(name, &reason);
            None
        }
    }
}

/// The server of all tests, if there is one.
fn common(name: &str) -> Option<&'static Cluster> {
    shared().map_err(|reason| skip(name, reason)).ok()
}

fn set(cluster: &Cluster, setting: &str) {
    let admin = cluster.admin().expect("connects");
    admin.script(setting).expect("set");
    admin.script("SELECT pg_reload_conf()").expect("heeded");
    // Sessions read it before their next statement.
    thread::sleep(std::time::Duration::from_millis(200));
}

#[test]
fn a_store_is_the_same_for_each_process_that_opens_it() {
    let Some(cluster) = common("engines::a_store_is_the_same") else { return };
    let url = cluster.schema();
    let first = Ledger::on_server(&url, None).expect("made");
    append(&first, 1, 1).expect("acknowledged");
    let other = Ledger::on_server(&url, None).expect("opened");
    assert_eq!(other.records.recorder(), first.records.recorder());
    assert_eq!((next(&other, 1), first.path()), (2, other.path()));
    assert!(first.path().starts_with("postgres:") && !first.path().exists(), "{}", first.path().display());
    // Both know the topic by its key, and write records of it at once.
    thread::scope(|scope| {
        for (ledger, first) in [(&first, 2), (&other, 102)] {
            scope.spawn(move || (first..first + 50).for_each(|seq| append(ledger, 1, seq).expect("acknowledged")));
        }
    });
    let counts = other.counts.by_state(None).expect("counts");
    assert!(counts.is_conserved() && counts.captured() == 101, "{counts:?}");
    assert_eq!(other.inspection.contradictions(), Ok(Vec::new()));
    first.close().expect("closed");
    assert_eq!(append(&other, 1, 999), Ok(()));
}

/// Each locks what the other changes next.
#[test]
fn processes_in_each_others_way_both_get_through() {
    let Some(cluster) = common("engines::processes_in_each_others_way") else { return };
    let url = cluster.schema();
    let ledgers = [0, 1].map(|_| Ledger::on_server(&url, None).expect("opened"));
    let all: Vec<NewRecord> = (1..=40).map(|seq| record(1, 1, seq)).collect();
    ledgers[0].records.append(all.clone()).expect("acknowledged");
    let digests: Vec<Digest> = all.iter().map(|record| record.digest).collect();
    thread::scope(|scope| {
        for (ledger, forward) in ledgers.iter().zip([true, false]) {
            let mut digests = digests.clone();
            if !forward {
                digests.reverse();
            }
            scope.spawn(move || {
                for _ in 0..3 {
                    let gone = ledger.database.write_many(40, {
                        let digests = digests.clone();
                        move |session| {
                            let sql = "UPDATE records SET deleted_at = coalesce(deleted_at, 0) + 1 WHERE digest = ?1";
                            Ok(session.connection.run_each(sql, digests.iter().map(|digest| [digest.0]))?)
                        }
                    });
                    assert_eq!(gone, Ok(40));
                }
            });
        }
    });
    let sum = ledgers[0].database.one("SELECT sum(deleted_at) FROM records", [], |row| row.get::<i64>(0));
    assert_eq!(sum, Ok(2 * 3 * 40), "each change took place once");
}

#[test]
fn a_connection_that_ends_is_opened_again_and_the_work_done_once() {
    let Some((cluster, ledger)) = own("engines::a_connection_that_ends") else { return };
    append(&ledger, 1, 1).expect("acknowledged");
    for seq in 2..=5 {
        cluster.admin().expect("connects").script(END).expect("ended");
        assert_eq!(append(&ledger, 1, seq), Ok(()));
        assert_eq!(next(&ledger, 1), seq + 1);
    }
    assert_eq!(ledger.counts.by_state(None).expect("counts").captured(), 5);
}

#[test]
fn who_finds_the_primary_a_standby_waits_for_the_next() {
    let Some((cluster, ledger)) = own("engines::who_finds_the_primary_a_standby") else { return };
    append(&ledger, 1, 1).expect("acknowledged");
    set(&cluster, "ALTER SYSTEM SET default_transaction_read_only = on");
    thread::scope(|scope| {
        let waiting = scope.spawn(|| append(&ledger, 1, 2));
        thread::sleep(std::time::Duration::from_millis(500));
        assert!(!waiting.is_finished(), "nobody takes it");
        let admin = cluster.admin();
        assert!(admin.is_err(), "no connection leads to a standby");
        std::fs::write(cluster.settings(), "").expect("a primary again");
        cluster.reload();
        assert_eq!(waiting.join().expect("no panic"), Ok(()));
    });
    assert_eq!(next(&ledger, 1), 3);
}

#[test]
fn what_no_standby_has_is_not_acknowledged() {
    let Some((cluster, ledger)) = own("engines::what_no_standby_has") else { return };
    append(&ledger, 1, 1).expect("acknowledged");
    // As a user whose own setting asks for less, and ends what takes long.
    let admin = cluster.admin().expect("connects");
    admin
        .script("ALTER ROLE authros SET synchronous_commit = off; ALTER ROLE authros SET statement_timeout = 100")
        .expect("set");
    admin.script(END).expect("ended");
    append(&ledger, 1, 1).expect("by a connection with these settings");
    set(&cluster, "ALTER SYSTEM SET synchronous_standby_names = 'absent'");
    let durability = ledger.inspection.durability().expect("read").expect("a server's");
    assert_eq!((durability.commits.as_str(), durability.standbys.as_str()), ("off", "absent"), "{durability:?}");
    assert!(!durability.fsync && !durability.is_standby && durability.ahead.abs() < 60_000, "{durability:?}");
    assert_eq!(durability.connected, None, "an ordinary user does not see them");
    // This would wait for the absent standby, too.
    let grant = "SET synchronous_commit = local; GRANT pg_monitor TO authros";
    cluster.admin().expect("connects").script(grant).expect("granted");
    let seen = ledger.inspection.durability().expect("read").expect("a server's");
    assert_eq!(seen.connected, Some(0));
    assert!(durability.version.contains('.'), "{durability:?}");
    let is_waiting = "SELECT count(*) FROM pg_stat_activity WHERE wait_event = 'SyncRep'";
    let waits = || cluster.admin().expect("connects").number(is_waiting).expect("read") == Some(1);
    for is_change in [true, false] {
        thread::scope(|scope| {
            // What was not there is forgotten: nothing changes by it.
            let answer = scope.spawn(|| match is_change {
                true => append(&ledger, 1, 2),
                false => ledger.notes.forget(&CopiedAt {}, &1),
            });
            while !waits() {
                assert!(!answer.is_finished(), "a change ({is_change}) was answered without a standby");
                thread::sleep(std::time::Duration::from_millis(20));
            }
            thread::sleep(std::time::Duration::from_millis(300));
            assert!(waits(), "nothing cuts it short");
            let cancel = "SELECT pg_cancel_backend(pid) FROM pg_stat_activity WHERE wait_event = 'SyncRep'";
            cluster.admin().expect("connects").script(cancel).expect("cancelled");
            let answer = answer.join().expect("no panic");
            assert!(matches!(&answer, Err(StoreError::Unknown { .. })), "{answer:?}");
        });
    }
    set(&cluster, "ALTER SYSTEM RESET synchronous_standby_names");
    assert_eq!(append(&ledger, 1, 2), Ok(()), "sent again");
}

/// As a database that was restored to an earlier time.
fn set_back(url: &str) {
    let server = Server::at(url, None).expect("an address").connect().expect("connects");
    server.script("UPDATE homes SET commits = commits - 1").expect("set back");
}

fn feed_of(ledger: &Ledger) -> [u8; 16] {
    ledger.feed.page(&[0; 16], &FeedFilter::default(), 0).expect("a page").id
}

#[test]
fn a_database_that_was_restored_is_written_only_after_a_new_recorder_and_feed_begin() {
    let Some((cluster, _)) = own("engines::a_database_that_was_restored") else { return };
    let (url, home) = (cluster.schema(), tempfile::tempdir().expect("a folder"));
    let watermark = home.path().join("watermark");
    let open = || Ledger::on_server_of(&url, None, &watermark);
    let ledger = open().expect("made");
    append(&ledger, 1, 1).expect("acknowledged");
    let (recorder, feed) = (ledger.records.recorder(), feed_of(&ledger));
    drop(ledger);
    let ledger = open().expect("all that was seen is there");
    cluster.admin().expect("connects").script(END).expect("ended");
    assert_eq!((append(&ledger, 1, 2), ledger.restored_meanwhile()), (Ok(()), None));

    set_back(&url);
    cluster.admin().expect("connects").script(END).expect("ended");
    for _ in 0..2 {
        let refused = append(&ledger, 1, 3).expect_err("this process knows what is not there");
        assert!(matches!(refused, StoreError::ServerRestored { .. }), "{refused}");
        assert_eq!(ledger.restored_meanwhile(), Some(refused));
    }
    drop(ledger);
    let refused = open().expect_err("it is not accepted yet");
    assert!(matches!(refused, StoreError::ServerRestored { .. }), "{refused}");
    let other = Ledger::on_server_of(&url, None, &home.path().join("other")).expect("a home that has seen nothing");
    assert_eq!((next(&other, 1), other.records.recorder()), (3, recorder), "nothing was changed");
    drop(other);

    Ledger::renew_on_server(&url, None, &watermark).expect("accepted");
    let ledger = open().expect("nothing is behind");
    assert_ne!(ledger.records.recorder(), recorder);
    assert_ne!(feed_of(&ledger), feed);
    assert_eq!(append(&ledger, 1, 3), Ok(()));
    drop(ledger);
    assert_eq!(next(&open().expect("nothing is behind"), 1), 4);
}

#[test]
fn an_empty_database_is_not_filled_for_a_home_that_has_seen_it_with_records() {
    let Some(cluster) = common("engines::an_empty_database_is_not_filled") else { return };
    let home = tempfile::tempdir().expect("a folder");
    let watermark = home.path().join("watermark");
    let ledger = Ledger::on_server_of(&cluster.schema(), None, &watermark).expect("made");
    append(&ledger, 1, 1).expect("acknowledged");
    drop(ledger);
    let (empty, seen) = (cluster.schema(), std::fs::read(&watermark).expect("written"));
    let looked = Glance::on_server(&empty, None, Some(&watermark)).map(drop);
    for opened in [looked, Ledger::on_server_of(&empty, None, &watermark).map(drop)] {
        let refused = opened.expect_err("it is another one, or lost everything");
        assert!(matches!(refused, StoreError::ServerEmpty { commits: 1.., .. }), "{refused}");
        assert_eq!(refused.kind(), ErrorKind::Refused);
    }
    assert_eq!(std::fs::read(&watermark).expect("there"), seen);
    let (glance, _) = Glance::on_server(&empty, None, None).expect("looked at");
    assert!(glance.is_none(), "nothing was made");
}

#[test]
fn a_connection_begins_and_ends_although_no_standby_is_there() {
    let Some((cluster, ledger)) = own("engines::a_connection_begins_and_ends") else { return };
    append(&ledger, 1, 1).expect("acknowledged");
    let url = cluster.schema();
    drop(Ledger::on_server(&url, None).expect("made"));
    set(&cluster, "ALTER SYSTEM SET synchronous_standby_names = 'absent'");
    cluster.admin().expect("connects").script(END).expect("ended");
    let is_left = "SELECT count(*) FROM pg_stat_activity WHERE usename = 'authros'";
    let admin = cluster.admin().expect("connects");
    let ended = (0..500).any(|_| {
        thread::sleep(std::time::Duration::from_millis(20));
        admin.number(is_left).expect("read") == Some(0)
    });
    assert!(ended, "a server that is to stop waits for them");
    assert_eq!(next(&Ledger::on_server(&url, None).expect("opened"), 1), 1);
}

#[test]
fn a_text_that_the_server_cannot_store_is_refused_alone() {
    let Some(cluster) = common("engines::a_text_that_the_server_cannot_store") else { return };
    let ledger = Ledger::on_server(&cluster.schema(), None).expect("opened");
    let bad = NewRecord { type_name: "a\0b".to_owned(), ..record(1, 1, 2) };
    let refused = ledger.records.append(vec![record(1, 1, 1), bad]).expect_err("refused");
    assert!(matches!(refused, StoreError::Nul { .. }) && refused.kind() == ErrorKind::Input, "{refused}");
    assert_eq!(next(&ledger, 1), 1, "all or none");
    assert_eq!(append(&ledger, 1, 1), Ok(()));
    let name = "é\u{10ffff}";
    ledger.names.keep(Address([1; 20]), "00".to_owned(), name.to_owned()).expect("kept");
}

#[test]
fn counts_are_folded_and_stay_the_same() {
    let Some(cluster) = common("engines::counts_are_folded") else { return };
    let ledger = Ledger::on_server(&cluster.schema(), None).expect("opened");
    ledger.lease.take();
    for seq in 1..=30 {
        append(&ledger, 1, seq).expect("acknowledged");
    }
    let digests: Vec<Digest> = (1..=10).map(|seq| record(1, 1, seq).digest).collect();
    ledger.records.advance(&digests, Stored, RecordState::Quarantined).expect("moved");
    let rows =
        || ledger.database.one("SELECT count(*) FROM counter_deltas", [], |row| row.get::<i64>(0)).expect("read");
    let (before, counts) = (rows(), ledger.counts.by_state(None).expect("counts"));
    ledger.database.write(|session| Ok(session.connection.script("SELECT fold()")?)).expect("folded");
    assert!(before > 30 && rows() == 2, "{before} rows, then {}", rows());
    assert_eq!(ledger.counts.by_state(None).expect("counts"), counts);
    assert_eq!(ledger.inspection.contradictions(), Ok(Vec::new()));
}

#[test]
fn a_later_schema_and_an_absent_server_are_refused_in_words() {
    let Some(cluster) = common("engines::a_later_schema") else { return };
    let url = cluster.schema();
    let ledger = Ledger::on_server(&url, None).expect("made");
    ledger.database.write(|session| session.connection.run("UPDATE about SET version = 2", [])).expect("a later one's");
    let error = Ledger::on_server(&url, None).expect_err("later");
    assert!(matches!(error, StoreError::Newer { found: 2, known: 1, .. }), "{error}");
    let error = Ledger::on_server("postgres://u:secret@127.0.0.1:1/x?sslmode=disable", None).expect_err("absent");
    assert_eq!(error.kind(), ErrorKind::Unreachable);
    assert!(error.to_string().contains("postgres://127.0.0.1:1/x") && !error.to_string().contains("secret"), "{error}");
}

#[test]
fn tables_that_disagree_are_told_of_a_server_too() {
    let Some(cluster) = common("engines::tables_that_disagree") else { return };
    let ledger = Ledger::on_server(&cluster.schema(), None).expect("opened");
    append(&ledger, 1, 1).expect("acknowledged");
    assert_eq!(ledger.inspection.contradictions(), Ok(Vec::new()));
    for (wrong, undone, told) in [
        (
            "INSERT INTO counter_deltas VALUES (1, 2, 0, 9, 0)",
            "DELETE FROM counter_deltas WHERE bytes = 9",
            "1 counts per state do not match the records",
        ),
        (
            "INSERT INTO epoch_deltas VALUES (1, 1, 0, 5, NULL)",
            "DELETE FROM epoch_deltas WHERE first_at = 5",
            "2 counts per epoch do not match the records",
        ),
        (
            "INSERT INTO counter_deltas VALUES (1, 2, 0, 0, 1)",
            "DELETE FROM counter_deltas WHERE records = 0",
            "1 streams have fewer or more records than were stored",
        ),
        ("UPDATE topics SET key = 70 WHERE key = 1", "UPDATE topics SET key = 1", "1 records without a topic"),
        ("INSERT INTO leaves VALUES (1, 1, 0)", "DELETE FROM leaves", "1 batch positions without a batch or record"),
    ] {
        let change = |sql| ledger.database.write(move |session| Ok(session.connection.script(sql)?));
        change(wrong).expect("changed");
        assert_eq!(ledger.inspection.contradictions(), Ok(vec![told.to_owned()]));
        change(undone).expect("changed back");
    }
    assert_eq!(ledger.inspection.contradictions(), Ok(Vec::new()));
}

/// SQLite asks the program, a server has a function of its own.
#[test]
fn patterns_match_names_in_statements_as_in_the_program() {
    let (_home, ledger) = open();
    let names =
        ["/robot1/odom", "/robot12/odom", "/robot1/a/b", "/odom", "id:0102", "/r\u{e9}sum\u{e9}", "/a\n/b", "/", ""];
    let patterns = [
        "/robot*/odom",
        "/robot?/odom",
        "/**",
        "/robot1/**",
        "**/odom",
        "/***/b",
        "**",
        "/*",
        "/robot1/odom",
        "/*/?/?",
        "*",
        "/robot./odom",
        "/(a|b)*",
        "id:0102",
        "/?*/**",
    ];
    let mut found = 0;
    for (pattern, name) in patterns.iter().flat_map(|pattern| names.map(|name| (*pattern, name))) {
        let expected = pattern == name || pattern.parse::<TopicPattern>().is_ok_and(|pattern| pattern.matches(name));
        let said = ledger.database.one("SELECT topic_matches(?1, ?2)", [pattern, name], |row| row.get::<bool>(0));
        assert_eq!(said, Ok(expected), "{pattern} {name:?}");
        found += usize::from(expected);
    }
    assert!(found > 20, "{found}");
}

/// What robots, owners and readers keep is not on a server: there it is empty, not damaged.
#[test]
fn what_a_desk_has_not_is_empty() {
    let (_home, ledger) = open();
    append(&ledger, 1, 1).expect("acknowledged");
    let (owner, digest) = (Address([1; 20]), record(1, 1, 1).digest);
    for topic in [None, Some("/odom")] {
        assert_eq!(ledger.pins.list(owner, topic).expect("pins"), []);
        assert_eq!(ledger.pins.alarms(owner, topic).expect("alarms"), []);
    }
    for (decided, newest_first) in [(false, true), (true, false)] {
        let query = HeldQuery { decided, newest_first, ..HeldQuery::default() };
        assert_eq!(ledger.quarantine.held(owner, &query).expect("held"), []);
    }
    assert_eq!(ledger.quarantine.unreported(owner, u64::MAX >> 1).expect("minutes"), None);
    assert_eq!(ledger.losses.open_gaps(owner, Timestamp(1), 9).expect("gaps"), []);
    assert_eq!(ledger.incidents.list(owner).expect("incidents"), []);
    let name = "crash".parse().expect("a name");
    assert_eq!(ledger.incidents.find(owner, &name).expect("an incident"), None);
    assert_eq!(ledger.forwarding.undecided(None, 9).expect("forwarded").rows, []);
    assert_eq!(ledger.forwarding.receipt_of(digest).expect("a receipt"), None);
    assert_eq!(ledger.forwarding.proven(digest).expect("a proof"), None);
}

server::on_a_server! {
    what_a_desk_has_not_is_empty,
    patterns_match_names_in_statements_as_in_the_program,
}

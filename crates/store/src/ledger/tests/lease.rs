//! The lease: two processes over one database, each a ledger of its own; and a file, which its process always holds.

use std::time::Duration;

use super::feed::places;
use super::server::{shared, skip};
use super::*;
use crate::model::Fact;

/// Two processes over one database; the first holds the lease.
fn two(name: &str) -> Option<[Ledger; 2]> {
    let cluster = shared().map_err(|reason| skip(name, reason)).ok()?;
    let url = cluster.schema();
    let both = [0, 1].map(|_| Ledger::on_server(&url, None).expect("opened"));
    beat(&both[0], "first", Claim::Take);
    beat(&both[1], "other", Claim::Renew);
    Some(both)
}

/// What it takes lasts, as far as it knows, however slow the machine is.
fn beat(ledger: &Ledger, name: &str, claim: Claim) {
    ledger.lease.beat(name, claim).expect("a sign of life");
    ledger.lease.lasts();
}

/// By the database's clock.
fn expire(ledger: &Ledger) {
    ledger.database.write(|session| session.connection.run("UPDATE lease SET until = now_ms() - 1", [])).expect("over");
}

fn walk(ledger: &Ledger, block: u64) -> Result<(), StoreError> {
    ledger.trail.walk_to((block, Hash([1; 32])), Vec::new())
}

fn cursor(ledger: &Ledger) -> Option<u64> {
    ledger.trail.cursor().expect("read").map(|(block, _)| block)
}

fn refuses(written: &Result<(), StoreError>) -> bool {
    matches!(written, Err(error @ StoreError::NotHolder { server })
        if error.kind() == ErrorKind::Refused && server.starts_with("postgres:"))
}

#[test]
fn a_file_is_held_by_its_process() {
    let home = tempfile::tempdir().expect("a folder");
    let ledger = Ledger::open(&home.path().join("ledger.db")).expect("opens");
    assert_eq!((ledger.lease.held(), ledger.lease.is_shared()), (Some(0), false));
    assert_eq!((ledger.lease.beat("x", Claim::Take), ledger.lease.state()), (Ok(()), Ok(None)));
    assert_eq!((walk(&ledger, 7), cursor(&ledger)), (Ok(()), Some(7)));
}

#[test]
fn one_process_holds_the_lease_and_the_other_writes_what_all_may() {
    let Some([first, other]) = two("lease::one_process_holds") else { return };
    assert_eq!((first.lease.held(), other.lease.held()), (Some(1), None));
    assert_eq!(walk(&first, 7), Ok(()));
    assert!(refuses(&walk(&other, 8)), "no lease");
    assert_eq!((cursor(&first), cursor(&other)), (Some(7), Some(7)));
    for (ledger, seq) in [(&first, 1), (&other, 2)] {
        assert_eq!(ledger.records.append(vec![record(1, 1, seq)]), Ok(()));
    }
    let digest = record(1, 1, 2).digest;
    assert!(other.records.advance(&[digest], RecordState::Stored, RecordState::Tampered).is_err());
    assert_eq!(first.records.advance(&[digest], RecordState::Stored, RecordState::Tampered), Ok(1));
    beat(&first, "first", Claim::Renew);
    beat(&other, "other", Claim::Renew);
    let state = other.lease.state().expect("read").expect("a server's");
    let names: Vec<(&str, bool)> =
        state.workers.iter().map(|worker| (worker.name.split(' ').next().expect("a name"), worker.is_own)).collect();
    assert_eq!(names, [("first", false), ("other", true)]);
    let holder = state.holder.expect("held");
    assert_eq!((Some(&holder.name), state.number), (state.workers.first().map(|worker| &worker.name), 1));
}

#[test]
fn a_lease_that_is_over_is_taken_and_its_last_holder_writes_nothing_more() {
    let Some([first, other]) = two("lease::a_lease_that_is_over") else { return };
    assert_eq!(walk(&first, 7), Ok(()));
    expire(&first);
    // As long as nobody takes it, it is the first one's.
    assert_eq!(walk(&first, 8), Ok(()));
    beat(&other, "other", Claim::Renew);
    assert_eq!(other.lease.held(), None, "it may not take it");
    beat(&other, "other", Claim::Take);
    assert_eq!((first.lease.held(), other.lease.held()), (Some(1), Some(2)), "the first does not know it yet");
    assert!(refuses(&walk(&first, 9)), "the database knows it");
    assert_eq!((walk(&other, 10), cursor(&first)), (Ok(()), Some(10)));
    beat(&first, "first", Claim::Renew);
    assert_eq!(first.lease.held(), None);
    // Nobody waits for the end of what was given up.
    other.close().expect("closed");
    beat(&first, "first", Claim::Take);
    assert_eq!((first.lease.held(), walk(&first, 11)), (Some(3), Ok(())));
}

/// By the number and the end of its lease a holder knows a database of an earlier moment.
#[test]
fn a_holder_does_not_go_on_in_a_database_that_was_restored() {
    let Some([first, other]) = two("lease::a_holder_does_not_go_on") else { return };
    let feed = || other.feed.page(&[0; 16], &places(0), 0).expect("read").id;
    let before = feed();
    beat(&first, "first", Claim::Renew);
    assert_eq!((first.lease.held(), feed()), (Some(1), before));
    first.database.write(|session| session.connection.run("UPDATE lease SET until = until - 1", [])).expect("restored");
    beat(&first, "first", Claim::Renew);
    assert_eq!(first.lease.held(), None);
    beat(&first, "first", Claim::Take);
    assert_eq!(first.lease.held(), Some(2));
    assert_ne!(feed(), before, "and the feed begins anew");
}

/// One that stops within a transaction has locked the lease's row.
#[test]
fn a_holder_that_stops_in_the_middle_of_a_write_does_not_keep_the_lease() {
    let Some([first, other]) = two("lease::a_holder_that_stops") else { return };
    thread::scope(|scope| {
        let (begun, has_begun) = std::sync::mpsc::channel();
        let database = first.database.held();
        let stopped = scope.spawn(move || {
            database.write(move |session| {
                session.connection.run("INSERT INTO cursor VALUES (1, 9, ?1)", [[1_u8; 32]])?;
                let _ = begun.send(());
                thread::sleep(Duration::from_secs(8));
                Ok(())
            })
        });
        has_begun.recv().expect("it stops");
        expire(&other);
        beat(&other, "other", Claim::Take);
        assert_eq!((other.lease.held(), cursor(&other)), (Some(2), None));
        assert!(refuses(&stopped.join().expect("no panic")), "and its work is undone");
    });
    assert_eq!(cursor(&other), None);
}

#[test]
fn the_holder_numbers_what_others_leave_and_each_lease_begins_the_feed_anew() {
    let Some([first, other]) = two("lease::the_holder_numbers") else { return };
    let page = |id: &[u8; 16], after| other.feed.page(id, &places(after), 9).expect("read");
    let rows = |page: &FeedPage| page.rows.iter().map(|row| (row.number, row.fact)).collect::<Vec<_>>();
    let notice = NewRecord { kind: RecordKind::Key, ..record(1, 4, 1) };
    other.records.append(vec![notice.clone()]).expect("acknowledged");
    let begun = page(&[0; 16], 0);
    assert_eq!((rows(&begun), other.feed.has_unnumbered()), (Vec::new(), Ok(true)));
    walk(&first, 7).expect("written");
    assert_eq!(first.feed.has_unnumbered(), Ok(false));
    assert_eq!(rows(&page(&begun.id, 0)), [(1, Fact::Stored)]);
    expire(&first);
    beat(&other, "other", Claim::Take);
    let next = page(&begun.id, 1);
    assert_ne!(next.id, begun.id);
    assert!(!next.is_anew && next.rows.is_empty(), "places of the former lease stand: {next:?}");
    other.database.write(|session| session.connection.run("UPDATE records SET state = 6", [])).expect("verified");
    first.database.write(|session| session.connection.run("UPDATE records SET deleted_at = 9", [])).expect("erased");
    assert_eq!(rows(&page(&begun.id, 1)), [(2, Fact::Verified)], "who is not the holder numbers nothing");
    walk(&other, 8).expect("written");
    assert_eq!(rows(&page(&begun.id, 1)), [(3, Fact::Erased)]);
}

#[test]
fn a_note_that_another_process_changed_meanwhile_is_not_overwritten() {
    use crate::notes::AdmittedOwners;
    let Some([first, other]) = two("lease::a_note") else { return };
    let owner =
        |number: u8| notes::AdmittedOwner { owner: Address([number; 20]), since: Timestamp(1), by: String::new() };
    for number in [1, 2] {
        let raced = first.notes.change(&AdmittedOwners {}, |list| {
            list.push(owner(10));
            other.notes.change(&AdmittedOwners {}, |list| {
                list.push(owner(number));
                Ok::<_, StoreError>(())
            })
        });
        assert!(matches!(raced, Err(StoreError::Raced { .. })), "{raced:?}");
    }
    assert_eq!(first.notes.read(&AdmittedOwners {}), Ok(Some(vec![owner(1), owner(2)])));
}

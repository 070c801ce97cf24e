//! What ages and last sights cost: counted in steps of SQLite's machine, not in time.

use rusqlite::StatementStatus::VmStep;

use super::*;
use crate::ledger::query::{LAST_SEEN, OLDEST, OWNERS, UNTOLD};

/// Steps that SQLite's machine takes for each query of the figures, over this many records in four streams.
fn steps(records: u64) -> Vec<i32> {
    let (_home, ledger) = open();
    for batch in 0..records / 100 {
        let one = |n: u64| record(1, u8::try_from(n % 4).expect("small"), batch * 100 + n + 1);
        ledger.records.append((0..100).map(one).collect()).expect("acknowledged");
    }
    assert_eq!(ledger.counts.owners(64).expect("owners").len(), 1);
    assert!(ledger.counts.oldest_unanchored(Address([1; 20])).expect("ages").is_some());
    assert_eq!(ledger.counts.last_seen(256).expect("signers").len(), 1);
    assert_eq!(ledger.losses.untold().expect("gaps"), 0);
    let counted = ledger.database.read(|connection| {
        let questions = [OWNERS, OLDEST, LAST_SEEN, UNTOLD];
        // The very statements that were run: they stay in the connection's cache, and one connection is reused.
        let file = connection.file().expect("a file");
        questions.iter().map(|sql| Ok(file.prepare_cached(sql)?.reset_status(VmStep))).collect()
    });
    counted.expect("statements")
}

#[test]
fn ages_cost_the_same_whatever_the_number_of_records() {
    let (few, many) = (steps(400), steps(20_000));
    assert!(few.iter().all(|steps| *steps > 0), "{few:?}");
    assert_eq!(few, many);
}

#[test]
fn a_robot_is_seen_when_its_records_arrive_whatever_its_clock_says() {
    let (_home, ledger) = open();
    let (before, year) = (Timestamp::now(), 365 * 86_400_000_000_000);
    let behind = NewRecord { captured_at: Timestamp(before.0 - year), ..record(1, 1, 1) };
    let ahead = NewRecord { captured_at: Timestamp(before.0 + year), ..record(2, 1, 1) };
    ledger.records.append(vec![behind, ahead]).expect("acknowledged");
    let seen = ledger.counts.last_seen(9).expect("signers");
    assert_eq!(seen.len(), 2);
    assert!(seen.iter().all(|seen| before <= seen.at && seen.at <= Timestamp::now()), "{seen:?}");
}

server::on_a_server! {
    a_robot_is_seen_when_its_records_arrive_whatever_its_clock_says,
}

//! How statements are planned and used, whatever they find.

use rusqlite::Connection;

use super::*;

#[test]
fn records_come_in_the_order_of_their_digests_in_the_question() {
    let (_home, ledger) = open();
    let records = [record(1, 1, 1), record(1, 2, 1), record(2, 1, 1)];
    ledger.records.append(records.to_vec()).expect("acknowledged");
    let [first, second, third] = records.map(|record| record.digest);
    let asked = [third, Digest([9; 32]), first, second, first];
    let found = ledger.records.find_all(&asked).expect("read");
    let digests: Vec<_> = found.iter().map(|row| row.as_ref().map(|row| row.digest)).collect();
    assert_eq!(digests, [Some(third), None, Some(first), Some(second), Some(first)]);
    let alone: Vec<_> = asked.map(|digest| ledger.records.find(digest).expect("read")).to_vec();
    assert_eq!(found, alone);
}

/// Planning costs more than most statements do.
#[test]
fn statements_are_planned_once_and_memory_is_not_counted() {
    let (_home, ledger) = open();
    ledger.records.append((1..=9).map(|seq| record(1, 1, seq)).collect()).expect("acknowledged");
    // Beside `batches` stand indices of a part of it.
    let sql = "SELECT leaf FROM records JOIN leaves ON record = n JOIN batches ON key = batch WHERE digest = ?1";
    let planned_again = |connection: &Connection| -> Result<i32, StoreError> {
        for seq in 1..=9 {
            let mut statement = connection.prepare_cached(sql)?;
            assert!(!statement.exists([record(1, 1, seq).digest.0])?, "none is anchored");
        }
        Ok(connection.prepare_cached(sql)?.get_status(rusqlite::StatementStatus::RePrepare))
    };
    assert_eq!(ledger.database.read(planned_again).expect("read"), 0);
    let plain = Connection::open(ledger.path()).expect("opens");
    assert!(planned_again(&plain).expect("read") >= 8, "as it is without the setting");
    let counts = ledger.database.read(|connection| {
        let mut options = connection.prepare("PRAGMA compile_options")?;
        let options: Vec<String> = options.query_map([], |row| row.get(0))?.collect::<Result<_, _>>()?;
        Ok(options.iter().any(|option| option == "DEFAULT_MEMSTATUS=0"))
    });
    assert!(counts.expect("read"), "built as .cargo/config.toml says");
}

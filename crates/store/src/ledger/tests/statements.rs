//! How statements are planned and used, whatever they find.

use std::collections::BTreeSet;

use rusqlite::Connection;

use super::*;
use crate::model::FilterId;

/// A file, and what was prepared for it since a test began to note that.
static NOTED: Mutex<Option<(String, BTreeSet<String>)>> = Mutex::new(None);

/// Called for every statement that is prepared.
pub(crate) fn note(connection: &Connection, sql: &str) {
    let mut noted = NOTED.lock().expect("nobody panics meanwhile");
    if let Some((file, statements)) = noted.as_mut()
        && connection.path() == Some(file.as_str())
    {
        statements.insert(sql.to_owned());
    }
}

/// As many rows as there are topics, signers, processes and reasons of loss, whatever the number of messages.
const SMALL: [&str; 10] =
    ["about", "contract", "counters", "cursor", "drops", "feeds", "intake", "recorders", "streams", "topics"];

/// Indices of the rows that wait for something.
const WAITING: [&str; 4] = ["held_undecided", "held_unreported", "retained_due", "transactions_open"];

/// A few rows, or one at the end of its table: parts of their statements, and why.
const FEW: [(&str, &str); 3] = [
    ("FROM trail ORDER BY block DESC LIMIT 1", "the last row"),
    ("FROM gaps WHERE owner = ?1 ORDER BY key DESC LIMIT ?2", "the last rows"),
    ("DELETE FROM passed_over WHERE block >= ?1", "once a reorganisation"),
];

/// Statements that sort more than the page they are for, and what.
const SORTING: [(&str, &str); 6] = [
    ("ORDER BY streams.key, captured_at LIMIT ?3", "what waits for a batch, for one with thousands of leaves"),
    ("WHERE state = ?2 AND coalesce(topics.keeper, topics.owner) = ?1 ORDER BY n LIMIT ?3", "what waits for a batch"),
    ("AND NOT EXISTS (SELECT 1 FROM retained WHERE record = n) ORDER BY captured_at", "what one topic must give up"),
    ("INDEXED BY gaps_open", "losses without a gap record"),
    ("ORDER BY nonce, transactions.key LIMIT 1", "the open transactions of a lane"),
    ("ORDER BY nonce, key LIMIT 1", "the open transactions of a lane"),
];

/// The lines of a statement's plan.
pub(super) fn plan_of(connection: &Connection, sql: &str) -> rusqlite::Result<Vec<String>> {
    let mut statement = connection.prepare(&format!("EXPLAIN QUERY PLAN {sql}"))?;
    let values = vec![1; statement.parameter_count()];
    statement.query_map(rusqlite::params_from_iter(values), |row| row.get(3))?.collect()
}

/// The table that a statement calls `name`; nothing if it is a query in it.
fn table_of<'a>(tables: &'a BTreeSet<String>, sql: &str, name: &'a str) -> Option<&'a str> {
    if tables.contains(name) {
        return Some(name);
    }
    let words = sql.split(|letter: char| !letter.is_alphanumeric() && letter != '_').filter(|word| !word.is_empty());
    let words: Vec<&str> = words.collect();
    let named = words.windows(2).find_map(|pair| match pair {
        [table, alias] if *alias == name => tables.get(*table),
        _ => None,
    });
    named.map(String::as_str)
}

/// What a plan reads or sorts that grows with the number of messages.
fn excess(tables: &BTreeSet<String>, sql: &str, plan: &[String]) -> Vec<String> {
    let has = |list: &[(&str, &str)]| list.iter().any(|(part, _)| sql.contains(part));
    let is_excess = |line: &&String| {
        if line.contains("TEMP B-TREE FOR ORDER BY") {
            return sql.contains("LIMIT") && !has(&SORTING);
        }
        let Some(scanned) = line.strip_prefix("SCAN ") else { return false };
        let name = scanned.split(' ').next().unwrap_or_default();
        let table = table_of(tables, sql, name);
        let waits = WAITING.iter().any(|index| scanned.ends_with(&format!("INDEX {index}")));
        table.is_some_and(|table| !SMALL.contains(&table)) && !waits && !has(&FEW)
    };
    plan.iter().filter(is_excess).cloned().collect()
}

#[test]
fn nothing_that_runs_for_each_message_page_or_block_reads_a_whole_table() {
    let (_home, ledger) = open();
    let file = ledger
        .database
        .read(|connection| Ok(connection.file().and_then(|file| file.path().map(str::to_owned))))
        .expect("read");
    *NOTED.lock().expect("no panic") = Some((file.expect("a file"), BTreeSet::new()));
    each_message(&ledger);
    each_block(&ledger);
    each_page(&ledger);
    each_of_a_robot(&ledger);
    assert_eq!(ledger.batches.take_back(4), Ok((21, 21)));
    let (_, noted) = NOTED.lock().expect("no panic").take().expect("noted");

    let tables = "SELECT name FROM sqlite_schema WHERE type = 'table'";
    let tables: BTreeSet<String> = ledger.database.list(tables, [], |row| row.get(0)).expect("tables");
    let reads = |sql: &&String| !sql.starts_with("PRAGMA");
    let found: Vec<(&String, Vec<String>)> = ledger
        .database
        .read(|connection| {
            let file = connection.file().expect("a file");
            Ok(noted.iter().filter(reads).map(|sql| (sql, plan_of(file, sql))).collect::<Vec<_>>())
        })
        .expect("read")
        .into_iter()
        .map(|(sql, plan)| (sql, excess(&tables, sql, &plan.expect("planned"))))
        .filter(|(_, excess)| !excess.is_empty())
        .collect();
    assert!(found.is_empty(), "{found:#?}");
    assert!(noted.len() > 60, "too few statements were noted: {}", noted.len());
    let undecided = noted.iter().find(|sql| sql.contains("FROM receipted CROSS JOIN")).expect("noted");
    let plan = ledger
        .database
        .read(|connection| Ok(plan_of(connection.file().expect("a file"), undecided)?))
        .expect("planned");
    assert!(plan.first().is_some_and(|first| first.starts_with("SEARCH receipted")), "{plan:?}");
}

#[test]
fn a_plan_that_reads_or_sorts_a_whole_table_is_found() {
    let (_home, ledger) = open();
    let tables = "SELECT name FROM sqlite_schema WHERE type = 'table'";
    let tables: BTreeSet<String> = ledger.database.list(tables, [], |row| row.get(0)).expect("tables");
    for (sql, is_found) in [
        ("SELECT digest FROM records WHERE bytes = ?1", true),
        ("SELECT one.digest FROM records one WHERE one.bytes = ?1", true),
        ("SELECT digest FROM records WHERE state = ?1 ORDER BY n LIMIT 5", true),
        ("SELECT digest FROM records WHERE digest = ?1", false),
        ("SELECT s.key FROM streams s", false),
    ] {
        let plan =
            ledger.database.read(|connection| Ok(plan_of(connection.file().expect("a file"), sql)?)).expect("planned");
        assert_eq!(!excess(&tables, sql, &plan).is_empty(), is_found, "{sql}: {plan:?}");
    }
}

const OWNER: Address = Address([1; 20]);

/// One record of each of more topics than are read one by one.
fn messages() -> Vec<NewRecord> {
    let message =
        |topic| NewRecord { blob: Some(vec![topic; 40]), filters: vec![FilterId([5; 8])], ..record(1, topic, 1) };
    (1..=30).map(message).collect()
}

fn digests(records: &[NewRecord]) -> Vec<Digest> {
    records.iter().map(|record| record.digest).collect()
}

fn each_message(ledger: &Ledger) {
    let messages = messages();
    ledger.records.append(messages.clone()).expect("acknowledged");
    ledger.records.append(messages.clone()).expect("known");
    let key = NewRecord { kind: RecordKind::Key, ..record(1, 31, 1) };
    let foreign = Some(Foreign { recorder: RecorderId([9; 16]), keeper: Address([5; 20]) });
    ledger.records.append(vec![key, NewRecord { foreign, ..record(1, 32, 1) }]).expect("acknowledged");
    let topic = TopicId([1; 16]);
    ledger.records.next_seq(OWNER, SignerId([1; 32]), topic).expect("read");
    ledger.counts.usage(OWNER).expect("read");
    ledger
        .counts
        .has_stream(OWNER, (RecorderId([9; 16]), topic), (RecordKind::Data, "a/B", SignerId([1; 32])))
        .expect("read");
    ledger.losses.count(vec![loss(LossReason::Memory, 1)]).expect("counted");
    let bad = NewRecord { state: RecordState::Quarantined, ..record(1, 33, 1) };
    let hold = Hold { digest: bad.digest, reason: "new", publisher: "/evil".to_owned() };
    ledger.quarantine.append_held(vec![bad], vec![hold]).expect("acknowledged");
    ledger.quarantine.unreported(OWNER, u64::MAX).expect("read");
    let bytes = Ciphertext::of(ledger);
    let all = digests(&messages);
    assert_eq!(bytes.get_many(&all).expect("read").into_iter().flatten().count(), 30);
    bytes.fronts(&all, 20).expect("read");
    ledger.records.find_all(&all).expect("read");
}

fn each_block(ledger: &Ledger) {
    let (messages, block_hash) = (messages(), Hash([4; 32]));
    ledger.batches.unbatched(OWNER).expect("read");
    ledger.batches.passed_over_leaves(OWNER, 9).expect("read");
    ledger.batches.waiting_signers(OWNER).expect("read");
    let mut leaves = ledger.batches.stored_leaves(OWNER, 100).expect("read");
    leaves.truncate(20);
    let tree = Tree::new(Leaf::hashes(&leaves)).expect("a tree");
    let (root, count) = (tree.root(), leaves.len() as u64);
    let paths = leaves.iter().enumerate().map(|(at, leaf)| (leaf.digest, tree.path(at))).collect();
    ledger.batches.close(NewBatch { owner: OWNER, root, leaves: paths }).expect("closed");
    ledger.batches.waiting(OWNER, 9).expect("read");
    let anchor = NewTransaction { anchors: Anchors::Batch(root), ..transaction(3, &[]) };
    ledger.lanes.submit(anchor).expect("kept");
    ledger
        .lanes
        .replace_transaction(
            Hash([3; 32]),
            NewTransaction { nonce: 3, anchors: Anchors::Batch(root), ..transaction(4, &[]) },
        )
        .expect("replaced");
    ledger.lanes.submit(transaction(5, &[messages[25].digest])).expect("kept");
    ledger.batches.open_roots(OWNER).expect("read");
    ledger.lanes.open_lane(OWNER).expect("read");
    ledger.lanes.lane_count(OWNER).expect("read");
    ledger.lanes.highest_nonce(OWNER).expect("read");
    ledger.lanes.anchoring_gas(OWNER, 9).expect("read");
    let mined = TransactionOutcome::Mined { block: 4, block_hash, gas_used: Some(1) };
    ledger.lanes.close_transactions(vec![(Hash([4; 32]), mined)]).expect("closed");
    let reverted = TransactionOutcome::Reverted { reason: "no".to_owned() };
    ledger.lanes.close_transactions(vec![(Hash([5; 32]), reverted)]).expect("closed");
    let seen = RootSighting { account: OWNER, root, count, transaction: Hash([4; 32]), block: 4, block_hash };
    let alone = Sighting { block_hash, ..sighting(&messages[25], 4) };
    assert_eq!(ledger.batches.waiting_roots(&[seen]), Ok(vec![root]));
    ledger.batches.waiting_digests(&[alone]).expect("read");
    ledger.inspection.unknown_roots(&[root]).expect("read");
    ledger.inspection.unknown_digests(&digests(&messages)).expect("read");
    ledger.rights.unknown_rights(&[(1, 1)]).expect("read");
    assert_eq!((ledger.batches.anchored(&[seen]), ledger.batches.mined(&[alone])), (Ok(20), Ok(1)));
    for block in [3, 4, 5] {
        ledger.trail.walk_to((block, block_hash), Vec::new()).expect("walked");
    }
    ledger.trail.blocks(4).expect("read");
    assert_eq!(ledger.trail.end(), ledger.trail.cursor());
    assert_eq!(ledger.batches.confirm(4).map(|times| times.len()), Ok(21));
    ledger.proofs.unproven_batches(9, 9).expect("read");
    let confirmed = ledger.records.in_state(None, RecordState::Confirmed, 512).expect("read");
    let confirmed: Vec<Digest> = confirmed.iter().map(|row| row.digest).collect();
    ledger.records.placed_all(&confirmed).expect("read");
    assert_eq!(ledger.records.advance(&confirmed, RecordState::Confirmed, RecordState::Verified), Ok(21));
}

fn each_page(ledger: &Ledger) {
    let places = vec![FeedPlace { owner: OWNER, after: 0, topics: None }];
    let page = ledger.feed.page(&[0; 16], &FeedFilter { places, ..FeedFilter::default() }, 100).expect("read");
    assert!(page.rows.len() > 20, "{page:?}");
    let all = RecordQuery { limit: 5, ..RecordQuery::default() };
    for query in [
        RecordQuery { newest_first: true, ..all.clone() },
        RecordQuery { since: Some(Timestamp(1_000)), ..all.clone() },
        RecordQuery { owner: Some(OWNER), ..all.clone() },
        RecordQuery { owners: Some(vec![OWNER]), state: Some(RecordState::Verified), ..all.clone() },
        RecordQuery { state: Some(RecordState::Stored), ..all.clone() },
        RecordQuery { topic: Some("/robot3/odom".to_owned()), ..all.clone() },
        RecordQuery { filters: vec![FilterId([5; 8]).into()], ..all },
    ] {
        let first = ledger.records.list(&query).expect("a page");
        ledger.records.list(&RecordQuery { after: first.next, ..query }).expect("a page");
    }
    let undecided = HeldQuery { limit: 9, ..HeldQuery::default() };
    assert_eq!(ledger.quarantine.held(OWNER, &undecided).expect("read").len(), 1);
    ledger.losses.gaps(OWNER, 9).expect("read");
    ledger.losses.open_gaps(OWNER, Timestamp(9), 9).expect("read");
    ledger.counts.by_state(Some(OWNER)).expect("read");
    ledger.counts.oldest_unanchored(OWNER).expect("read");
    ledger.erasures.list(0, 9).expect("read");
    ledger.erasures.told_to_delete(9).expect("read");
    ledger.retention.to_delete(OWNER, 9).expect("read");
    for topic in ledger.retention.topics(OWNER).expect("read").iter().take(1) {
        ledger.retention.oldest(topic, (Timestamp(0), Timestamp(9)), 9).expect("read");
    }
    ledger.inspection.audit_page(0, Timestamp(0), 9).expect("read");
    ledger.inspection.audit_batches(0, 9).expect("read");
}

fn each_of_a_robot(ledger: &Ledger) {
    let waiting = ledger.records.in_state(None, RecordState::Stored, 3).expect("read");
    let digests: Vec<Digest> = waiting.iter().map(|row| row.digest).collect();
    let receipt = KeptReceipt { time: Timestamp(7), digests: digests.clone(), signature: Signature([7; 64]) };
    assert_eq!(ledger.forwarding.accept(receipt), Ok(3));
    assert_eq!(ledger.forwarding.undecided(None, 9).expect("read").rows.len(), 3);
    ledger.forwarding.recorders().expect("read");
    ledger.forwarding.receipt_of(digests[0]).expect("read");
    let proofs = digests.iter().map(|digest| (*digest, vec![1])).collect();
    let standing = KeptStanding { time: Timestamp(8), statement: vec![1], signature: Signature([7; 64]), proofs };
    ledger.forwarding.keep_proven(standing).expect("kept");
    assert_eq!(ledger.forwarding.settle(&digests, RecordState::Verified), Ok(3));
    ledger.forwarding.proven_before(Timestamp(u64::MAX >> 1), 9).expect("read");
    ledger.forwarding.proven_gone(&digests).expect("noted");
}

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
    let here = ledger.database.read(|connection| planned_again(connection.file().expect("a file")));
    assert_eq!(here.expect("read"), 0);
    let plain = Connection::open(ledger.path()).expect("opens");
    assert!(planned_again(&plain).expect("read") >= 8, "as it is without the setting");
    let counts = ledger.database.read(|connection| {
        let options: Vec<String> = connection.list("PRAGMA compile_options", [], |row| row.get(0))?;
        Ok(options.iter().any(|option| option == "DEFAULT_MEMSTATUS=0"))
    });
    assert!(counts.expect("read"), "built as .cargo/config.toml says");
}

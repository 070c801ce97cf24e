//! How fast the ledger is on this machine: printed, never asserted. What is asserted of the plans is in `statements`.

use std::time::Instant;

use super::*;

fn rate(count: u64, since: Instant) -> f64 {
    u32::try_from(count).map_or(f64::INFINITY, f64::from) / since.elapsed().as_secs_f64()
}

#[test]
fn group_commit_beats_one_by_one() {
    let (_home, ledger) = open();
    let alone = Instant::now();
    (1..=200).for_each(|seq| ledger.records.append(vec![record(1, 1, seq)]).expect("acknowledged"));
    let alone = rate(200, alone);
    let many = Instant::now();
    thread::scope(|scope| {
        for writer in 2..66u8 {
            let ledger = &ledger;
            scope.spawn(move || {
                (1..=50).for_each(|seq| ledger.records.append(vec![record(writer, 1, seq)]).expect("acknowledged"));
            });
        }
    });
    let many = rate(64 * 50, many);
    let whole = Instant::now();
    for batch in 0..20 {
        let records = (1..=64).map(|seq| record(1, 2, batch * 64 + seq)).collect();
        ledger.records.append(records).expect("acknowledged");
    }
    let whole = rate(20 * 64, whole);
    println!("ledger: {alone:.0} records/s one by one, {many:.0} from 64 threads, {whole:.0} in batches of 64");
    assert_eq!(ledger.counts.by_state(None).expect("counts").captured(), 200 + 64 * 50 + 20 * 64);
}

#[test]
fn pages_and_counts_of_a_large_ledger() {
    let (home, ledger) = open();
    let filling = Instant::now();
    for batch in 0..100u64 {
        let one = |n: u64| record(1, u8::try_from(n % 8).expect("small"), batch * 1_000 + n);
        ledger.records.append((1..=1_000).map(one).collect()).expect("acknowledged");
    }
    println!("ledger: {:.0} records/s appended in batches of 1,000", rate(100_000, filling));
    let oldest = ledger.records.in_state(None, RecordState::Stored, 10_000).expect("page");
    let digests: Vec<Digest> = oldest.iter().map(|row| row.digest).collect();
    let moving = Instant::now();
    let leaves = digests.iter().map(|digest| (*digest, Vec::new())).collect();
    ledger.batches.close(NewBatch { owner: Address([1; 20]), root: Hash([7; 32]), leaves }).expect("moved");
    println!("ledger: {:.0} records/s moved in batches of 10,000", rate(10_000, moving));

    let queries = [
        ("newest page", RecordQuery { newest_first: true, ..RecordQuery::default() }),
        ("by topic", RecordQuery { topic: Some("/robot3/odom".to_owned()), ..RecordQuery::default() }),
        ("by state", RecordQuery { state: Some(RecordState::Batched), ..RecordQuery::default() }),
        ("by time", RecordQuery { since: Some(Timestamp(60_000)), ..RecordQuery::default() }),
    ];
    for (name, query) in queries {
        let started = Instant::now();
        let found = (0..50).map(|_| ledger.records.list(&query).expect("page").rows.len()).sum::<usize>();
        println!("ledger: {name}, 100 of 100,000: {:.2} ms", started.elapsed().as_secs_f64() * 20.0);
        assert_eq!(found, 5_000);
    }
    let started = Instant::now();
    let captured = (0..50).map(|_| ledger.counts.by_state(None).expect("counts").captured()).sum::<u64>();
    println!("ledger: counts of 100,000: {:.3} ms", started.elapsed().as_secs_f64() * 20.0);
    assert_eq!(captured, 5_000_000);

    drop(ledger);
    let started = Instant::now();
    drop(Ledger::open(&home.path().join("ledger.db")).expect("opens"));
    println!("ledger: opened with quick_check of 100,000 records: {:.0} ms", started.elapsed().as_secs_f64() * 1e3);
}

server::on_a_server!(group_commit_beats_one_by_one);

//! Ledgers of earlier versions are upgraded and lose nothing.

use super::*;

/// A ledger as version 1 left it: a verified, an uploaded and a stored record of one topic.
fn version_1(path: &Path) -> Vec<NewRecord> {
    let old = Schema { steps: &SCHEMA.steps[..1], ..SCHEMA };
    let connection = database::open_writer(path, &old).expect("version 1");
    name_recorder(&connection, path).expect("a recorder");
    connection
        .execute_batch(&format!(
            "INSERT INTO topics VALUES (1, x'{0}', 1, x'{1}', '/robot1/odom');
             INSERT INTO streams VALUES (1, 1, {2}, 'nav_msgs/Odometry', x'{3}');
             INSERT INTO transactions VALUES
                 (1, x'{4}', x'{0}', 5, x'aa', 'dataUpload', x'{5}', 1, 0, NULL, NULL, NULL, NULL, NULL);",
            "01".repeat(20),
            "01".repeat(16),
            RecordKind::Data.code(),
            "01".repeat(32),
            "05".repeat(32),
            record(1, 1, 2).digest.to_hex(),
        ))
        .expect("rows");
    let states = [RecordState::Verified, RecordState::Submitted, RecordState::Stored];
    let records: Vec<NewRecord> = (1..=3).map(|seq| record(1, 1, seq)).collect();
    for (record, state) in records.iter().zip(states) {
        let block = (state == RecordState::Verified).then_some(4);
        let transaction = (state != RecordState::Stored).then_some([5u8; 32]);
        connection
            .execute(
                "INSERT INTO records (digest, topic, stream, seq, epoch, signature, bytes, captured_at,
                 acknowledged_at, simulated, state, tx, block) VALUES (?1, 1, 1, ?2, 1, ?3, 1, ?2, 1, 0, ?4, ?5, ?6)",
                params![record.digest.0, record.seq.cast_signed(), [7u8; 64], state.code(), transaction, block],
            )
            .expect("a record");
    }
    records
}

#[test]
fn a_ledger_without_batches_is_adopted() {
    let home = tempfile::tempdir().expect("temporary directory");
    let path = home.path().join("ledger.db");
    let records = version_1(&path);
    let ledger = Ledger::open(&path).expect("adopted");
    let states: Vec<_> = records.iter().map(|record| state_of(&ledger, record)).collect();
    assert_eq!(states, [RecordState::Verified, RecordState::Submitted, RecordState::Stored]);
    let open = ledger.open_transactions(Address([1; 20])).expect("open");
    assert_eq!(open[0].anchors, Anchors::Digests(vec![records[1].digest]), "sent again as it is");
    ledger.close_transaction(Hash([5; 32]), TransactionOutcome::Replaced).expect("closed");
    assert_eq!(ledger.unbatched(Address([1; 20])).expect("count").0, 2);
    let leaves = ledger.stored_leaves(Address([1; 20]), 10).expect("leaves");
    assert_eq!(leaves.iter().map(|leaf| leaf.digest).collect::<Vec<_>>(), [records[1].digest, records[2].digest]);
    let leaves = leaves.into_iter().map(|leaf| (leaf.digest, Vec::new())).collect();
    let batch = NewBatch { owner: Address([1; 20]), root: Hash([8; 32]), leaves };
    ledger.close_batch(batch).expect("old records go into batches");
    assert_eq!(state_of(&ledger, &records[2]), RecordState::Batched);
    assert_eq!(ledger.batch_place(records[0].digest), Ok(None), "what was verified stays as it is");
}

//! Records: each row against its path, its batch and the chain; `deep` also against the stored bytes (`stored`). One
//! thread reads pages, and one thread per core checks them.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Mutex, PoisonError};
use std::{collections::HashMap, sync::atomic::Ordering, time::Instant};

use tokio::{runtime::Handle, task::JoinSet};

use crate::columns::{self, Keys};
use crate::crypto::record::{Checked, signed_bytes};
use crate::crypto::{Anchor, CryptoError, Unchecked, check_alone};
use crate::model::{Digest, Header, PublicKey, RecordKind, RecordState, Timestamp, clean, counted};
use crate::record_audit::{FindingKind, Network, Plant, Reading, Scope, Tally};
use crate::store::{AuditedRecord, RecordRow, Retained, StoreError};
use crate::{PipelineError, authority, chain::ChainError, chain::merkle::root_of, retention::is_stated};

const PAGE: usize = 512;
/// Bytes in one piece of work, unless a single record is larger.
const PIECE: u64 = 4 << 20;
const AT_ONCE: usize = 32;
const MOST_THREADS: usize = 16;

#[derive(Clone, Copy)]
pub(super) struct Bench<'a> {
    pub plant: &'a Plant,
    pub network: Option<&'a Network>,
    /// Whether there is a chain that could not be queried.
    pub blind: bool,
    pub deep: bool,
    pub keys: Option<&'a (dyn Keys + Send + Sync)>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Uploaded {
    /// It was not queried: the record is in a batch, in no block, or there is no chain.
    NotAsked,
    Nowhere,
    In(u64),
}

pub(super) type Looked = (AuditedRecord, Uploaded);

pub(super) fn compare(
    plant: &Plant,
    network: Option<&Network>,
    blind: bool,
    scope: &Scope,
    runtime: &Handle,
    tally: &mut Tally,
) -> Result<Reading, StoreError> {
    let bench = Bench { plant, network, blind, deep: scope.deep, keys: Some(&*scope.keys) };
    let threads = std::thread::available_parallelism().map_or(1, usize::from).min(MOST_THREADS);
    let begun = Instant::now();
    let (pieces, waiting) = sync_channel::<Vec<Looked>>(threads);
    let waiting = Mutex::new(waiting);
    let (read, counted) = std::thread::scope(|threads_of| {
        let workers: Vec<_> = (0..threads).map(|_| threads_of.spawn(|| work(bench, runtime, &waiting))).collect();
        let read = feed(bench, scope, runtime, pieces, tally);
        let counted: Vec<_> = workers.into_iter().map(|worker| worker.join().ok()).collect();
        (read, counted)
    });
    read?;
    for one in counted {
        let lost = || StoreError::Database {
            file: plant.ledger.path().to_owned(),
            detail: "a thread of the audit ended before it was done".to_owned(),
        };
        tally.join(one.ok_or_else(lost)??);
    }
    if scope.since.0 == 0 {
        compare_index(plant, tally)?;
    }
    Ok(Reading { seconds: begun.elapsed().as_secs_f64(), threads })
}

/// Whether the index of tags has entries that no header supports.
fn compare_index(plant: &Plant, tally: &mut Tally) -> Result<(), StoreError> {
    // Records whose bytes are not here reveal nothing about their tags.
    let strangers = plant.ledger.inspection.size_of_index(tally.last)?.saturating_sub(tally.indexed);
    if strangers > 0 && tally.unread == 0 {
        let text = format!("{} without a header: searches find records they should not", counted(strangers, "tag"));
        tally.find(FindingKind::Tampered, "index of tags", &text);
    }
    if tally.unnamed > 0 {
        let text = format!(
            "topic and type names and the SIMULATED mark of {} were not compared: they are sealed, and no open keyring \
             has their pseudonyms",
            counted(tally.unnamed, "record")
        );
        tally.note(&text);
    }
    Ok(())
}

fn feed(
    bench: Bench<'_>,
    scope: &Scope,
    runtime: &Handle,
    pieces: SyncSender<Vec<Looked>>,
    tally: &mut Tally,
) -> Result<(), StoreError> {
    let mut after = Some(0);
    let mut chain = bench.network;
    while let Some(from) = after {
        let page = bench.plant.ledger.inspection.audit_page(from, scope.since, PAGE)?;
        after = page.next;
        let mut records = Vec::with_capacity(page.records.len());
        for record in page.records {
            match record {
                Ok(record) => records.push(record),
                Err((row, reason)) => {
                    tally.audit.records += 1;
                    tally.find(FindingKind::Tampered, &format!("row {row}"), &format!("cannot be read: {reason}"));
                }
            }
        }
        let looked = match runtime.block_on(ask(chain, records)) {
            (looked, None) => looked,
            (looked, Some(error)) => {
                tally.find(FindingKind::Unreachable, "chain", &format!("not all records were compared: {error}"));
                chain = None;
                looked
            }
        };
        for piece in cut(looked) {
            let count = piece.len() as u64;
            if pieces.send(piece).is_err() {
                return Ok(());
            }
            scope.looked_at.fetch_add(count, Ordering::Relaxed);
        }
    }
    Ok(())
}

async fn ask(chain: Option<&Network>, records: Vec<AuditedRecord>) -> (Vec<Looked>, Option<ChainError>) {
    let mut looked: Vec<Looked> = records.into_iter().map(|record| (record, Uploaded::NotAsked)).collect();
    let Some(network) = chain else { return (looked, None) };
    let alone: Vec<usize> =
        (0..looked.len()).filter(|at| looked.get(*at).is_some_and(|one| stands_alone(&one.0))).collect();
    for some in alone.chunks(AT_ONCE) {
        let mut answers = JoinSet::new();
        for (at, row) in some.iter().filter_map(|at| Some((*at, &looked.get(*at)?.0.row))) {
            let (chain, owner, digest) = (network.chain.clone(), row.owner, row.digest);
            answers.spawn(async move { (at, chain.uploaded_at(owner, digest).await) });
        }
        while let Some(answer) = answers.join_next().await {
            match answer {
                Ok((at, Ok(block))) => {
                    if let Some(one) = looked.get_mut(at) {
                        one.1 = block.map_or(Uploaded::Nowhere, Uploaded::In);
                    }
                }
                Ok((_, Err(error))) => return (looked, Some(error)),
                Err(_) => {}
            }
        }
    }
    (looked, None)
}

/// Whether its own digest is on the chain, rather than its batch's root.
fn stands_alone(record: &AuditedRecord) -> bool {
    let in_its_batch = record.place.as_ref().is_some_and(|place| place.block == record.row.block);
    record.row.block.is_some() && !in_its_batch
}

fn cut(looked: Vec<Looked>) -> Vec<Vec<Looked>> {
    let mut pieces = vec![Vec::new()];
    let mut bytes = 0;
    for one in looked {
        bytes += one.0.row.bytes;
        if bytes > PIECE && pieces.last().is_some_and(|piece| !piece.is_empty()) {
            pieces.push(Vec::new());
            bytes = one.0.row.bytes;
        }
        if let Some(piece) = pieces.last_mut() {
            piece.push(one);
        }
    }
    pieces.retain(|piece| !piece.is_empty());
    pieces
}

fn work(bench: Bench<'_>, runtime: &Handle, waiting: &Mutex<Receiver<Vec<Looked>>>) -> Result<Tally, StoreError> {
    let mut tally = Tally::default();
    let mut failed = None;
    loop {
        let next = waiting.lock().unwrap_or_else(PoisonError::into_inner).recv();
        let Ok(piece) = next else { break };
        // After a failure the rest is received and dropped, so that the page reader does not wait forever.
        if failed.is_none() {
            match look_twice(bench, runtime, &piece) {
                Ok(looked) => tally.join(looked),
                Err(error) => failed = Some(error),
            }
        }
    }
    failed.map_or(Ok(tally), Err)
}

/// Examines some records. A finding counts only if it is still there when row, chain and bytes are read once more: a
/// block may have been replaced between the three, or the bytes been deleted on purpose.
fn look_twice(bench: Bench<'_>, runtime: &Handle, piece: &[Looked]) -> Result<Tally, StoreError> {
    let mut tally = Tally::default();
    look(bench, piece, &mut tally)?;
    if tally.findings().is_empty() {
        return Ok(tally);
    }
    let again = read_again(bench.plant, piece)?;
    match runtime.block_on(ask(bench.network, again)) {
        (again, None) => {
            tally = Tally::default();
            look(bench, &again, &mut tally)?;
            Ok(tally)
        }
        // Without the chain's second answer the first one stays.
        (_, Some(_)) => Ok(tally),
    }
}

/// Examines some records; `deep` also their bytes, all of them read before the first is checked.
pub(super) fn look(bench: Bench<'_>, piece: &[Looked], tally: &mut Tally) -> Result<(), StoreError> {
    for (record, uploaded) in piece {
        tally.audit.records += 1;
        tally.last = tally.last.max(record.number);
        tally.audit.pending += u64::from(record.row.state.is_pending() || record.row.state == RecordState::RightEnded);
        // What is missing is found among the bytes.
        if !is_missed(record)
            && let Some(text) = row_fault(bench, record, *uploaded)
        {
            tally.find(FindingKind::Tampered, &subject(record), &text);
        }
        if !bench.deep {
            tally.audit.bytes += record.row.bytes;
        }
    }
    if bench.deep { look_deep(bench, piece, tally) } else { look_at_headers(bench, piece, tally) }
}

pub(super) fn read_again(plant: &Plant, piece: &[Looked]) -> Result<Vec<AuditedRecord>, StoreError> {
    let first = piece.first().map_or(0, |(record, _)| record.number);
    let page = plant.ledger.inspection.audit_page(first.saturating_sub(1), Timestamp(0), piece.len())?;
    let mut now: HashMap<u64, AuditedRecord> =
        page.records.into_iter().flatten().map(|record| (record.number, record)).collect();
    let mut again = Vec::with_capacity(piece.len());
    for (record, _) in piece {
        // Rows between them may have been left out of the audit, for their age.
        let found = match now.remove(&record.number) {
            Some(found) => Some(found),
            None => {
                let page = plant.ledger.inspection.audit_page(record.number.saturating_sub(1), Timestamp(0), 1)?;
                page.records.into_iter().flatten().next_back()
            }
        };
        again.push(found.filter(|found| found.number == record.number).unwrap_or_else(|| record.clone()));
    }
    Ok(again)
}

/// Whether it is known as tampered because its bytes are no longer stored.
fn is_missed(record: &AuditedRecord) -> bool {
    record.row.state == RecordState::Tampered && record.row.deleted_at.is_none() && !record.is_stored
}

pub(super) fn subject(record: &AuditedRecord) -> String {
    format!("record {} ({} {})", record.row.id, record.row.topic, record.row.seq)
}

fn row_fault(bench: Bench<'_>, record: &AuditedRecord, uploaded: Uploaded) -> Option<String> {
    let row = &record.row;
    if row.state == RecordState::Tampered {
        return Some("has been marked as tampered since it was last verified".to_owned());
    }
    if !record.in_its_topic {
        return Some("its row names a different topic than its stream".to_owned());
    }
    if !record.as_retained {
        return Some("its row and retention disagree on when its ciphertext was deleted".to_owned());
    }
    if record.place.as_ref().is_some_and(|place| place.inclusion.is_none()) {
        return Some("its batch is missing from the ledger".to_owned());
    }
    let settled = matches!(row.state, RecordState::Mined | RecordState::Confirmed | RecordState::Verified);
    if settled && row.block.is_none() && bench.network.is_some() {
        return Some(format!("is {} but not in a block", row.state.word()));
    }
    if row.state.is_before_block() && row.block.is_some() {
        return Some(format!("is {} but in a block", row.state.word()));
    }
    if let Some((place, inclusion)) = record.place.as_ref().and_then(|place| Some((place, place.inclusion.as_ref()?))) {
        let root = root_of(row.leaf().hash(), inclusion.index, inclusion.count, &inclusion.path);
        if root != Some(inclusion.root) {
            return Some("its row does not lead to its batch's root: a field of it was changed".to_owned());
        }
        let same = (row.transaction, row.block_hash) == (place.transaction, place.block_hash);
        if row.block.is_some() && row.block == place.block && !same {
            return Some("its row names a different transaction or block than its batch".to_owned());
        }
        if place.is_contradicted {
            return Some("its batch names a different block than its transaction or the chain's proof".to_owned());
        }
    }
    match uploaded {
        Uploaded::Nowhere if record.place.is_some() => {
            Some("its row names a different block than its batch".to_owned())
        }
        Uploaded::Nowhere => Some("its digest is not on the chain".to_owned()),
        Uploaded::In(block) if row.block != Some(block) => {
            Some(format!("the chain has it in block {block}, its row names another"))
        }
        _ => None,
    }
}

/// The most gaps listed for one topic.
const MOST_HOLES: usize = 5;

/// Missing numbers of other recorders are only noted: a reader sees what it may, and a robot's records may be on their
/// way.
pub(super) fn compare_sequences(plant: &Plant, scope: &Scope, tally: &mut Tally) -> Result<(), StoreError> {
    let mut elsewhere = Vec::new();
    for sequence in plant.ledger.inspection.sequences()? {
        let lost = sequence.last.saturating_sub(sequence.count);
        // What is missing of a ring fell out of it, or was not asked for.
        if lost == 0 || sequence.recorder.is_ring() {
            continue;
        }
        if let Some(keeper) = sequence.keeper {
            if scope.accounts.contains(&keeper) {
                elsewhere.push(format!("{lost} of {} by the key {}", sequence.name, sequence.signer));
            }
            continue;
        }
        tally.audit.gaps += lost;
        let holes = plant.ledger.inspection.holes(&sequence, MOST_HOLES)?;
        let words: Vec<String> = holes.iter().take(MOST_HOLES).map(|(from, to)| span(*from, *to)).collect();
        let text = format!(
            "{lost} of the numbers 1 to {} that the key {} gave for {} are missing from the ledger: {}",
            sequence.last,
            sequence.signer,
            sequence.owner,
            words.join(", ")
        );
        tally.find(FindingKind::Gap, &sequence.name, &text);
    }
    if !elsewhere.is_empty() {
        let more = elsewhere.len().saturating_sub(MOST_HOLES);
        let more = if more > 0 { format!(" and of {}", counted(more as u64, "more topic")) } else { String::new() };
        elsewhere.truncate(MOST_HOLES);
        tally.note(&format!(
            "numbers that robots assigned are missing here: {}{more}; their records are on their way, at another \
             gateway, or held back at the robot, whose recorder states which numbers it assigned",
            elsewhere.join(", ")
        ));
    }
    for (topic, count) in plant.ledger.inspection.backwards()? {
        tally.note(&format!(
            "dated earlier than the record before, because the clock was set back or a recording was imported: {} of {}",
            counted(count, "record"),
            clean(&topic, 200)
        ));
    }
    Ok(())
}

fn span(from: u64, to: u64) -> String {
    if from == to { from.to_string() } else { format!("{from} to {to}") }
}

// The stored form of records: bytes against digest and signature, the header against the row, and, if nothing is
// stored any more, whether that is accounted for.

/// Reads the stored bytes together and computes their digests in parallel.
pub(super) fn look_deep(bench: Bench<'_>, piece: &[Looked], tally: &mut Tally) -> Result<(), StoreError> {
    let digests: Vec<Digest> = piece.iter().map(|(record, _)| record.row.digest).collect();
    let mut found = Vec::with_capacity(piece.len());
    // Never from the cache: an audit is of what is on the disk.
    for ((record, _), blob) in piece.iter().zip(bench.plant.ciphertext.get_many(&digests)?) {
        match blob {
            Some(blob) => found.push((record, blob, signer_of(bench, &record.row)?)),
            None => {
                let kept = bench.plant.ledger.retention.find(record.row.digest)?;
                match kept.and_then(|kept| Header::parse(&kept.header).ok()) {
                    Some((header, _)) => compare_tags(bench, record, &header, tally)?,
                    None => tally.unread += 1,
                }
                gone(bench, record, tally)?;
            }
        }
    }
    let mut records = Vec::with_capacity(found.len());
    for (record, blob, signer) in &found {
        let (signature, anchor) = (&record.row.signature, Anchor::Chain(record.row.digest));
        records.extend(signer.as_ref().map(|signer| Unchecked { blob, signature, signer, anchor }));
    }
    let mut checked = check_alone(bench.plant.provider, &records).into_iter();
    for (record, blob, signer) in &found {
        tally.audit.bytes += u64::try_from(blob.len()).unwrap_or(0);
        let checked = if signer.is_some() { checked.next() } else { None };
        if let Ok((header, _)) = Header::parse(blob) {
            compare_names(bench, &record.row, &header, blob, tally);
            compare_tags(bench, record, &header, tally)?;
        }
        match bytes_fault(bench, record, blob, checked) {
            Fault::None => {}
            Fault::Unchecked => tally.audit.unchecked += 1,
            Fault::Text(text) => tally.find(FindingKind::Tampered, &subject(record), &text),
        }
    }
    Ok(())
}

fn gone(bench: Bench<'_>, record: &AuditedRecord, tally: &mut Tally) -> Result<(), StoreError> {
    // It may have been deleted since its row was read.
    let Some(now) = bench.plant.ledger.records.find(record.row.digest)? else { return Ok(()) };
    let handed_over = now.state == RecordState::Verified && bench.network.is_none() && !bench.blind;
    if now.state == RecordState::Dropped || handed_over {
        tally.audit.given_up += 1;
    } else if let Some(retained) = bench.plant.ledger.retention.find(now.digest)? {
        match retention_fault(bench, &now, &retained)? {
            None => tally.audit.given_up += 1,
            Some(text) => tally.find(FindingKind::Tampered, &subject(record), &text),
        }
    } else if bench.plant.ciphertext.get(now.digest)?.is_none() {
        tally.find(FindingKind::Missing, &subject(record), "its stored bytes are missing from the store");
    }
    Ok(())
}

/// After retention deleted a record, a retention record on the chain must name it, and its header and signature must
/// still be its owner's.
fn retention_fault(bench: Bench<'_>, row: &RecordRow, retained: &Retained) -> Result<Option<String>, StoreError> {
    let told = bench.plant.ledger.records.find(retained.report)?.filter(|told| told.kind == RecordKind::Retention);
    let anchored = told.is_some_and(|told| told.block.is_some() || bench.network.is_none());
    if !anchored && !is_stated(bench.plant, bench.network, row.digest, retained) {
        return Ok(Some("its bytes were deleted, but no retention record on the chain covers it".to_owned()));
    }
    let Ok((header, _)) = Header::parse(&retained.header) else {
        return Ok(Some("the header kept of it is not a header".to_owned()));
    };
    if let Some(field) = header_fault(bench, row, &header) {
        return Ok(Some(format!("its row and the header kept of it differ in their {field}")));
    }
    let Some(signer) = signer_of(bench, row)? else { return Ok(None) };
    let signed = signed_bytes(&header.domain, &row.digest);
    let valid = bench.plant.provider.verify(&signer, &signed, &row.signature).is_ok();
    Ok((!valid).then(|| "its signature was not made by its signer".to_owned()))
}

/// The key that could have signed the record; `None` if that is not known here.
fn signer_of(bench: Bench<'_>, row: &RecordRow) -> Result<Option<PublicKey>, StoreError> {
    match bench.network {
        Some(network) => match authority::key_of(bench.plant, network, row) {
            Ok(signer) => Ok(signer),
            Err(PipelineError::Store(error)) => Err(error),
            Err(_) => Ok(None),
        },
        None => bench.plant.ledger.bindings.signer(row.signer),
    }
}

enum Fault {
    None,
    /// The signer's key is not known here.
    Unchecked,
    Text(String),
}

/// Inconsistencies in the stored bytes; `checked` is the result of their check, if the signer's key is known.
fn bytes_fault(bench: Bench<'_>, record: &AuditedRecord, blob: &[u8], checked: Option<Checked>) -> Fault {
    let row = &record.row;
    let altered = |what: &str| Fault::Text(format!("its stored bytes were altered: {what}"));
    let (header, fault) = match checked {
        Some(Ok((header, _, _))) => (header, Fault::None),
        Some(Err(CryptoError::Tampered("signature"))) => {
            return Fault::Text("its signature was not made by its signer".to_owned());
        }
        Some(Err(CryptoError::DamagedRecord(error))) => return altered(&error.to_string()),
        Some(Err(_)) => return altered("a different digest"),
        None if Digest(bench.plant.provider.sm3(&[blob])) != row.digest => return altered("a different digest"),
        // A record not verified yet is skipped by the verifier, and anchored again.
        None if row.block.is_some() && row.state == RecordState::Verified && bench.network.is_some() => {
            return Fault::Text("its signer had no right to sign for its owner at the anchoring block".to_owned());
        }
        None => match Header::parse(blob) {
            Ok((header, _)) => (header, Fault::Unchecked),
            Err(error) => return altered(&error.to_string()),
        },
    };
    match header_fault(bench, row, &header) {
        Some(field) => Fault::Text(format!("its row and its header differ in their {field}")),
        None => fault,
    }
}

fn header_fault(bench: Bench<'_>, row: &RecordRow, header: &Header) -> Option<&'static str> {
    let accepted = bench.network.is_none_or(|network| network.domain == header.domain);
    columns::header_difference(row, header).or((!accepted).then_some("network"))
}

/// Without a key and without reading bodies.
pub(super) fn look_at_headers(bench: Bench<'_>, piece: &[Looked], tally: &mut Tally) -> Result<(), StoreError> {
    let digests: Vec<Digest> = piece.iter().map(|(record, _)| record.row.digest).collect();
    for ((record, _), front) in piece.iter().zip(bench.plant.ciphertext.fronts(&digests, columns::FRONT)?) {
        let front = match front {
            None => bench.plant.ledger.retention.find(record.row.digest)?.map(|retained| retained.header),
            front => front,
        };
        let Some(front) = front else {
            tally.unread += 1;
            gone(bench, record, tally)?;
            continue;
        };
        match Header::parse(&front) {
            Ok((header, _)) => compare_header(bench, record, &header, &front, tally)?,
            Err(error) => {
                tally.find(FindingKind::Tampered, &subject(record), &format!("its stored bytes were altered: {error}"));
            }
        }
    }
    Ok(())
}

fn compare_header(
    bench: Bench<'_>,
    record: &AuditedRecord,
    header: &Header,
    front: &[u8],
    tally: &mut Tally,
) -> Result<(), StoreError> {
    if let Some(field) = header_fault(bench, &record.row, header) {
        tally.find(FindingKind::Tampered, &subject(record), &format!("its row and its header differ in their {field}"));
    }
    compare_names(bench, &record.row, header, front, tally);
    compare_tags(bench, record, header, tally)
}

/// Compares names in the row and in the sealed head with the header's pseudonyms, if these can be computed; `front` is
/// the record's first bytes.
fn compare_names(bench: Bench<'_>, row: &RecordRow, header: &Header, front: &[u8], tally: &mut Tally) {
    let Some(keys) = bench.keys else { return };
    let Some(index) = keys.index_key(row) else {
        tally.unnamed += 1;
        return;
    };
    let subject = || format!("record {} (number {})", row.id, row.seq);
    if let Some(field) = columns::name_difference(row, header, &index) {
        tally.find(FindingKind::Tampered, &subject(), &format!("its row and its header differ in their {field}"));
    }
    // What this ledger sealed has the names that it was captured under.
    if bench.plant.ledger.records.recorder().has(&row.recorder) {
        return;
    }
    let Some(opening) = keys.opening(header) else {
        tally.unnamed += 1;
        return;
    };
    if let Some(what) = columns::false_name(bench.plant, &opening, row.digest, front) {
        let text = format!(
            "signer {} wrote a false {what} into it, which does not belong to the pseudonym it is filed under; it is \
             not shown, and no other record is affected; if that is a device of yours, revoke it",
            row.signer
        );
        tally.find(FindingKind::FalseName, &subject(), &text);
    }
}

/// Whether the record is found by every id in its header.
fn compare_tags(
    bench: Bench<'_>,
    record: &AuditedRecord,
    header: &Header,
    tally: &mut Tally,
) -> Result<(), StoreError> {
    let indexed = bench.plant.ledger.inspection.indexed(record.number, &header.filters)?;
    tally.indexed += indexed;
    if indexed < u64::try_from(header.filters.len()).unwrap_or(u64::MAX) {
        tally.find(FindingKind::Tampered, &subject(record), "the tag index lacks some of its tags");
    }
    Ok(())
}

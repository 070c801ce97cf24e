//! Records: each row against its path, its batch and the chain; `deep` also its stored bytes, header and signature.
//! One thread reads pages, as many as there are cores check them.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use tokio::runtime::Handle;
use tokio::task::JoinSet;

use super::report::{FindingKind, Reading, Tally};
use super::{Network, Plant, Scope};
use crate::chain::ChainError;
use crate::chain::merkle::root_of;
use crate::crypto::record::signed_bytes;
use crate::crypto::{Anchor, CryptoError, check};
use crate::model::header::TAG_LENGTH;
use crate::model::{Digest, Header, PublicKey, RecordKind, RecordState};
use crate::pipeline::{PipelineError, signers};
use crate::store::{AuditedRecord, RecordRow, StoreError};

/// Rows of a page.
const PAGE: usize = 512;
/// Bytes that one piece of work may hold, unless a single record is larger.
const PIECE: u64 = 4 << 20;
/// Questions to the chain at once.
const AT_ONCE: usize = 32;
/// The most threads.
const MOST_THREADS: usize = 16;

/// What is compared with what, the same for every record.
#[derive(Clone, Copy)]
pub(super) struct Bench<'a> {
    pub plant: &'a Plant,
    pub network: Option<&'a Network>,
    /// Whether there is a chain that could not be asked.
    pub blind: bool,
    pub deep: bool,
}

/// Where the chain has a record that was uploaded by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Uploaded {
    /// It was not asked: the record is in a batch, in no block, or there is no chain.
    NotAsked,
    /// Nowhere.
    Nowhere,
    /// In this block.
    In(u64),
}

type Looked = (AuditedRecord, Uploaded);

/// Looks at every record; how long that took, and on how many threads.
pub(super) fn compare(
    plant: &Plant,
    network: Option<&Network>,
    blind: bool,
    scope: &Scope,
    runtime: &Handle,
    tally: &mut Tally,
) -> Result<Reading, StoreError> {
    let bench = Bench { plant, network, blind, deep: scope.deep };
    let threads = std::thread::available_parallelism().map_or(1, usize::from).min(MOST_THREADS);
    let begun = Instant::now();
    let (pieces, waiting) = sync_channel::<Vec<Looked>>(threads);
    let waiting = Mutex::new(waiting);
    let (read, counted) = std::thread::scope(|threads_of| {
        let workers: Vec<_> = (0..threads).map(|_| threads_of.spawn(|| work(bench, &waiting))).collect();
        let read = feed(bench, scope, runtime, pieces, tally);
        let counted: Vec<_> = workers.into_iter().map(|worker| worker.join().ok()).collect();
        (read, counted)
    });
    read?;
    for one in counted {
        let lost = || StoreError::Database {
            file: plant.ledger.path().to_owned(),
            detail: "a thread of the audit ended before its work".to_owned(),
        };
        tally.join(one.ok_or_else(lost)??);
    }
    Ok(Reading { seconds: begun.elapsed().as_secs_f64(), threads })
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
        let page = bench.plant.ledger.audit_page(from, scope.since, PAGE)?;
        after = page.next;
        let mut records = Vec::with_capacity(page.records.len());
        for record in page.records {
            match record {
                Ok(record) => records.push(record),
                Err((row, reason)) => {
                    tally.records += 1;
                    tally.find(FindingKind::Tampered, &format!("row {row}"), &format!("cannot be read: {reason}"));
                }
            }
        }
        let looked = match runtime.block_on(ask(chain, records)) {
            (looked, None) => looked,
            (looked, Some(error)) => {
                tally.find(FindingKind::Unreachable, "chain", &format!("records were not all compared: {error}"));
                chain = None;
                looked
            }
        };
        for piece in cut(looked) {
            if pieces.send(piece).is_err() {
                return Ok(());
            }
        }
    }
    Ok(())
}

/// Asks the chain about records that were uploaded by themselves.
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

/// Whether its own digest is on the chain, not its batch's root.
fn stands_alone(record: &AuditedRecord) -> bool {
    let in_its_batch = record.place.as_ref().is_some_and(|place| place.block == record.row.block);
    record.row.block.is_some() && !in_its_batch
}

/// Pieces of work of a bounded size.
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

fn work(bench: Bench<'_>, waiting: &Mutex<Receiver<Vec<Looked>>>) -> Result<Tally, StoreError> {
    let mut tally = Tally::default();
    let mut failed = None;
    loop {
        let next = waiting.lock().unwrap_or_else(PoisonError::into_inner).recv();
        let Ok(piece) = next else { break };
        // After a failure the rest is taken and left, so that whoever reads does not wait for ever.
        if failed.is_none() {
            failed = look(bench, &piece, &mut tally).err();
        }
    }
    failed.map_or(Ok(tally), Err)
}

/// Looks at some records, whose bytes are read in one go.
pub(super) fn look(bench: Bench<'_>, piece: &[Looked], tally: &mut Tally) -> Result<(), StoreError> {
    let blobs = if bench.deep {
        let digests: Vec<Digest> = piece.iter().map(|(record, _)| record.row.digest).collect();
        bench.plant.vault.get_many(&digests)?
    } else {
        Vec::new()
    };
    let mut blobs = blobs.into_iter();
    for (record, uploaded) in piece {
        tally.records += 1;
        tally.pending += u64::from(record.row.state.is_pending());
        if let Some(text) = row_fault(bench, record, *uploaded) {
            tally.find(FindingKind::Tampered, &subject(record), &text);
        }
        if bench.deep {
            stored(bench, record, blobs.next().flatten(), tally)?;
        } else {
            tally.bytes += record.row.bytes;
        }
    }
    Ok(())
}

fn subject(record: &AuditedRecord) -> String {
    format!("record {} ({} {})", record.row.id, record.row.topic, record.row.seq)
}

/// What does not fit in a row, by itself and with its batch.
fn row_fault(bench: Bench<'_>, record: &AuditedRecord, uploaded: Uploaded) -> Option<String> {
    let row = &record.row;
    if row.state == RecordState::Tampered {
        return Some("is known as tampered since it was last verified".to_owned());
    }
    if !record.in_its_topic {
        return Some("its row names another topic than its stream".to_owned());
    }
    let settled = matches!(row.state, RecordState::Mined | RecordState::Confirmed | RecordState::Verified);
    if settled && row.block.is_none() && !record.anchored_earlier && bench.network.is_some() {
        return Some(format!("is {} and stands in no block", row.state.word()));
    }
    if row.state < RecordState::Mined && row.block.is_some() {
        return Some(format!("is {} and stands in a block", row.state.word()));
    }
    if let Some(place) = &record.place {
        let Some(inclusion) = &place.inclusion else { return Some("its batch is gone from the ledger".to_owned()) };
        let root = root_of(row.leaf().hash(), inclusion.index, inclusion.count, &inclusion.path);
        if root != Some(inclusion.root) {
            return Some("its row does not lead to its batch's root: a field of it was changed".to_owned());
        }
        let same = (row.transaction, row.block_hash) == (place.transaction, place.block_hash);
        if row.block.is_some() && row.block == place.block && !same {
            return Some("its row names another transaction or block than its batch".to_owned());
        }
    }
    match uploaded {
        Uploaded::Nowhere if record.place.is_some() => Some("its row names another block than its batch".to_owned()),
        Uploaded::Nowhere => Some("its digest is not on the chain".to_owned()),
        Uploaded::In(block) if row.block != Some(block) => {
            Some(format!("the chain has it in block {block}, its row in another"))
        }
        _ => None,
    }
}

fn stored(
    bench: Bench<'_>,
    record: &AuditedRecord,
    blob: Option<Vec<u8>>,
    tally: &mut Tally,
) -> Result<(), StoreError> {
    let blob = match blob {
        None if record.has_copy => bench.plant.ledger.local_copy(record.row.digest)?,
        found => found,
    };
    let Some(blob) = blob else { return gone(bench, record, tally) };
    tally.bytes += u64::try_from(blob.len()).unwrap_or(0);
    match bytes_fault(bench, record, &blob)? {
        Fault::None => {}
        Fault::Unchecked => tally.unchecked += 1,
        Fault::Text(text) => tally.find(FindingKind::Tampered, &subject(record), &text),
    }
    Ok(())
}

/// Nothing is stored under a digest: whether that is as it should be.
fn gone(bench: Bench<'_>, record: &AuditedRecord, tally: &mut Tally) -> Result<(), StoreError> {
    // It may have been given up, or come into the vault, since its row was read.
    let Some(now) = bench.plant.ledger.record(record.row.digest)? else { return Ok(()) };
    let handed_over = now.state == RecordState::Verified && bench.network.is_none() && !bench.blind;
    if now.state == RecordState::Dropped || handed_over {
        tally.given_up += 1;
    } else if let Some(retained) = bench.plant.ledger.retained(now.digest)? {
        match retention_fault(bench, &now, retained.report, &retained.header)? {
            None => tally.given_up += 1,
            Some(text) => tally.find(FindingKind::Tampered, &subject(record), &text),
        }
    } else if bench.plant.vault.get(now.digest)?.is_none() && bench.plant.ledger.local_copy(now.digest)?.is_none() {
        tally.find(FindingKind::Missing, &subject(record), "its stored bytes are gone from the vault");
    }
    Ok(())
}

/// What does not fit where retention gave a record up: a retention record on the chain must tell of it, and what was
/// kept of it (header, signature) must still be its owner's word.
fn retention_fault(
    bench: Bench<'_>,
    row: &RecordRow,
    report: Digest,
    header: &[u8],
) -> Result<Option<String>, StoreError> {
    let told = bench.plant.ledger.record(report)?.filter(|told| told.kind == RecordKind::Retention);
    let anchored = told.is_some_and(|told| told.block.is_some() || bench.network.is_none());
    if !anchored {
        return Ok(Some("its bytes were deleted, and no retention record on the chain tells of it".to_owned()));
    }
    let Ok((header, _)) = Header::parse(header) else {
        return Ok(Some("the header that was kept of it is none".to_owned()));
    };
    if let Some(field) = header_fault(bench, row, &header) {
        return Ok(Some(format!("its row and the header that was kept of it differ in their {field}")));
    }
    let Some(signer) = signer_of(bench, row)? else { return Ok(None) };
    let signed = signed_bytes(&header.domain, &row.digest);
    let valid = bench.plant.provider.verify(&signer, &signed, &row.signature).is_ok();
    Ok((!valid).then(|| "its signature is not its signer's".to_owned()))
}

/// The key that could sign the record; `None` where that is not known here.
fn signer_of(bench: Bench<'_>, row: &RecordRow) -> Result<Option<PublicKey>, StoreError> {
    match bench.network {
        Some(network) => match signers::key_of(bench.plant, network, row) {
            Ok(signer) => Ok(signer),
            Err(PipelineError::Store(error)) => Err(error),
            Err(_) => Ok(None),
        },
        None => bench.plant.ledger.signer(row.signer),
    }
}

enum Fault {
    None,
    /// The signer's key is not known here.
    Unchecked,
    Text(String),
}

/// What does not fit in the stored bytes.
fn bytes_fault(bench: Bench<'_>, record: &AuditedRecord, blob: &[u8]) -> Result<Fault, StoreError> {
    let row = &record.row;
    let altered = |what: &str| Ok(Fault::Text(format!("its stored bytes were altered: {what}")));
    let signer = signer_of(bench, row)?;
    let (header, fault) = match signer {
        Some(signer) => match check(bench.plant.provider, blob, &row.signature, &signer, Anchor::Chain(row.digest)) {
            Ok((header, _, _)) => (header, Fault::None),
            Err(CryptoError::Tampered("signature")) => {
                return Ok(Fault::Text("its signature is not its signer's".to_owned()));
            }
            Err(CryptoError::DamagedRecord(error)) => return altered(&error.to_string()),
            Err(_) => return altered("another digest"),
        },
        None if Digest(bench.plant.provider.sm3(&[blob])) != row.digest => return altered("another digest"),
        None if row.block.is_some() && bench.network.is_some() => {
            return Ok(Fault::Text("its signer was not its owner's at the anchoring block".to_owned()));
        }
        None => match Header::parse(blob) {
            Ok((header, _)) => (header, Fault::Unchecked),
            Err(error) => return altered(&error.to_string()),
        },
    };
    Ok(match header_fault(bench, row, &header) {
        Some(field) => Fault::Text(format!("its row and its header differ in their {field}")),
        None => fault,
    })
}

/// Whether a message of `plain` bytes can be sealed in `sealed`: as it is, or compressed, which is done only where it
/// saves an eighth.
fn is_length(sealed: u64, plain: u64) -> bool {
    sealed == plain || sealed <= plain - plain / 8
}

/// The field in which a row and the header of its record differ.
fn header_fault(bench: Bench<'_>, row: &RecordRow, header: &Header) -> Option<&'static str> {
    let length = header.body_length.saturating_sub(TAG_LENGTH as u64);
    let fields = [
        ("owner", header.owner == row.owner),
        ("kind", header.kind == row.kind),
        ("signer", header.signer == row.signer),
        ("epoch", header.epoch == row.epoch),
        ("recorder", header.recorder == row.recorder),
        ("number", header.seq == row.seq),
        ("topic", header.topic_id == row.topic_id),
        ("time", header.captured_at == row.captured_at),
        ("length", is_length(length, row.bytes)),
        ("network", bench.network.is_none_or(|network| network.accepts(&header.domain))),
    ];
    fields.iter().find(|(_, same)| !same).map(|(field, _)| *field)
}

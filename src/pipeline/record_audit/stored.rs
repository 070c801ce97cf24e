//! What is stored of records: bytes against digest and signature, the header against the row, and where nothing is
//! stored any more, whether that was told.

use super::records::{Bench, Looked, subject};
use super::report::{FindingKind, Tally};
use crate::crypto::record::{Checked, signed_bytes};
use crate::crypto::{Anchor, CryptoError, Unchecked, check_alone};
use crate::model::header::TAG_LENGTH;
use crate::model::{Digest, Header, PublicKey, RecordKind, RecordState};
use crate::pipeline::{PipelineError, signers};
use crate::store::{AuditedRecord, RecordRow, StoreError};

/// Looks at the stored bytes of some records: read in one go, and their digests taken side by side.
pub(super) fn look_deep(bench: Bench<'_>, piece: &[Looked], tally: &mut Tally) -> Result<(), StoreError> {
    let digests: Vec<Digest> = piece.iter().map(|(record, _)| record.row.digest).collect();
    let mut found = Vec::with_capacity(piece.len());
    for ((record, _), blob) in piece.iter().zip(bench.plant.vault.get_many(&digests)?) {
        let blob = match blob {
            None if record.has_copy => bench.plant.ledger.local_copy(record.row.digest)?,
            blob => blob,
        };
        match blob {
            Some(blob) => found.push((record, blob, signer_of(bench, &record.row)?)),
            None => gone(bench, record, tally)?,
        }
    }
    let mut records = Vec::with_capacity(found.len());
    for (record, blob, signer) in &found {
        let (signature, anchor) = (&record.row.signature, Anchor::Chain(record.row.digest));
        records.extend(signer.as_ref().map(|signer| Unchecked { blob, signature, signer, anchor }));
    }
    let mut checked = check_alone(bench.plant.provider, &records).into_iter();
    for (record, blob, signer) in &found {
        tally.bytes += u64::try_from(blob.len()).unwrap_or(0);
        let checked = if signer.is_some() { checked.next() } else { None };
        match bytes_fault(bench, record, blob, checked) {
            Fault::None => {}
            Fault::Unchecked => tally.unchecked += 1,
            Fault::Text(text) => tally.find(FindingKind::Tampered, &subject(record), &text),
        }
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

/// What does not fit in the stored bytes; `checked` is what their check said, where the signer's key is known.
fn bytes_fault(bench: Bench<'_>, record: &AuditedRecord, blob: &[u8], checked: Option<Checked>) -> Fault {
    let row = &record.row;
    let altered = |what: &str| Fault::Text(format!("its stored bytes were altered: {what}"));
    let (header, fault) = match checked {
        Some(Ok((header, _, _))) => (header, Fault::None),
        Some(Err(CryptoError::Tampered("signature"))) => {
            return Fault::Text("its signature is not its signer's".to_owned());
        }
        Some(Err(CryptoError::DamagedRecord(error))) => return altered(&error.to_string()),
        Some(Err(_)) => return altered("another digest"),
        None if Digest(bench.plant.provider.sm3(&[blob])) != row.digest => return altered("another digest"),
        None if row.block.is_some() && bench.network.is_some() => {
            return Fault::Text("its signer was not its owner's at the anchoring block".to_owned());
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

//! The stored form of records: bytes against digest and signature, the header against the row, and, if nothing is
//! stored any more, whether that is accounted for.

use super::records::{Bench, Looked, subject};
use super::report::{FindingKind, Tally};
use crate::crypto::record::{Checked, signed_bytes};
use crate::crypto::{Anchor, CryptoError, Unchecked, check_alone};
use crate::model::{Digest, Header, PublicKey, RecordKind, RecordState};
use crate::pipeline::{PipelineError, authority, columns};
use crate::retention::is_stated;
use crate::store::{AuditedRecord, RecordRow, Retained, StoreError};

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
            Ok((header, _)) => compare(bench, record, &header, &front, tally)?,
            Err(error) => {
                tally.find(FindingKind::Tampered, &subject(record), &format!("its stored bytes were altered: {error}"));
            }
        }
    }
    Ok(())
}

fn compare(
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

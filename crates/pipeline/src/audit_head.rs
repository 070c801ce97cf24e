//! The head of the audit log, anchored while the log changes, as a record of each owner whose keyring is open: a head
//! signed by someone else proves nothing.

use std::time::Duration;

use crate::model::{Address, AuditHead, Digest, RecordKind, Timestamp};
use crate::statement::{self, Statement};
use crate::store::notes::{StatedAuditHead, StatedHead};
use crate::store::{AuditLog, Notes, RecordQuery, RecordRow, StoreError};
use crate::{Network, Owner, PipelineError, Plant, Result, reader::Reader};

pub(super) const TOPIC: &str = "authros/audit";
/// How many of the newest heads are opened for a check; each covers all lines below it.
const MOST_HEADS: usize = 100;

/// The head (number of lines, hash) in an account's newest record, as noted in the ledger; needs no key.
pub fn noted(notes: &Notes, owner: Address) -> Result<Option<(u64, Digest)>, StoreError> {
    Ok(notes.read(&StatedAuditHead { owner })?.map(|last| (last.line, last.hash)))
}

/// Seals the log's head if its oldest uncovered line is older than `every`. The caller holds [`Owner::changes`]: a head
/// must not be signed by a key that is being replaced. `Corrupt`, and no head, if the log does not continue from the
/// last.
pub fn state_head(
    plant: &Plant,
    network: &Network,
    log: &AuditLog,
    owner: &Owner,
    every: Duration,
) -> Result<Option<Digest>> {
    let Some(keys) = owner.sealing().filter(|keys| keys.domain == network.domain) else { return Ok(None) };
    let note = StatedAuditHead { owner: owner.address };
    let before = plant.ledger.notes.read(&note)?;
    if let Some(before) = before
        && let Err(fault) = log.compare(&[(before.line, before.hash)])
    {
        let file = plant.ledger.path().to_owned();
        return Err(StoreError::Corrupt { file, detail: fault.to_string() }.into());
    }
    let covered = before.map_or(0, |before| before.line);
    let Some(oldest) = log.written_after(covered)? else { return Ok(None) };
    let every = u64::try_from(every.as_nanos()).unwrap_or(u64::MAX);
    if Timestamp::now().0.saturating_sub(oldest.0) < every {
        return Ok(None);
    }
    let (line, hash) = log.head()?;
    let previous_hash = before.map_or(Digest([0; Digest::LENGTH]), |before| before.hash);
    let body = AuditHead { line, hash, previous_line: covered, previous_hash }.encode();
    let named = Statement { kind: RecordKind::Audit, topic: TOPIC, type_name: "authros/AuditHead", body: &body };
    let Some(digest) = statement::state(plant, owner.address, &keys, named)? else { return Ok(None) };
    // If interrupted here, the next head names the same predecessor, which is not a contradiction.
    plant.ledger.notes.write(&note, &StatedHead { line, hash })?;
    plant.observer.records_changed();
    Ok(Some(digest))
}

#[derive(Debug, Default)]
pub struct Heads {
    /// Number of lines and hash each, newest first, from records whose checks passed.
    pub good: Vec<(u64, Digest)>,
    /// Those in a block that the chain confirms.
    pub anchored: usize,
    /// Records that fail their checks, with the reason.
    pub bad: Vec<(String, String)>,
}

/// The newest heads that this owner anchored; a record that does not open is part of the answer.
pub async fn heads(reader: &Reader<'_>) -> Result<Heads> {
    let query = RecordQuery {
        owner: Some(reader.reader.address),
        topic: Some(TOPIC.to_owned()),
        kind: Some(RecordKind::Audit),
        limit: MOST_HEADS,
        newest_first: true,
        ..RecordQuery::default()
    };
    let page = reader.plant.ledger.records.list(&query)?;
    let mut heads = Heads::default();
    for row in &page.rows {
        match open(reader, row).await {
            Ok((head, anchored)) => {
                heads.good.push((head.line, head.hash));
                heads.anchored += usize::from(anchored);
            }
            Err(error) => heads.bad.push((row.id.clone(), error.to_string())),
        }
    }
    // The ledger's own note, in case a head's record was removed.
    heads.good.extend(tokio::task::block_in_place(|| noted(&reader.plant.ledger.notes, reader.reader.address))?);
    Ok(heads)
}

async fn open(reader: &Reader<'_>, row: &RecordRow) -> Result<(AuditHead, bool)> {
    let opened = reader.open(row).await?;
    let head = AuditHead::parse(&opened.body).map_err(|error| PipelineError::Refused(error.to_string()))?;
    Ok((head, opened.verdict == crate::model::Verdict::Verified))
}

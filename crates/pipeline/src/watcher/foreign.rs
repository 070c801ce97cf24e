//! Anchors by this home's accounts that this home did not send: a copy of it runs elsewhere, or a key is stolen.

use std::collections::HashMap;

use crate::chain::{Event, EventAt};
use crate::model::{Address, Digest, Hash, Timestamp, counted};
use crate::store::notes::{CopiedAt, ForeignAnchors, ForeignHistory, SeenForeign};
use crate::{Plant, Result, store::AuditEntry};

/// Time it stays in `status`, nanoseconds.
const RECENT: u64 = 24 * 3600 * 1_000_000_000;
/// The shortest time between two lines in the audit log; nanoseconds.
const LINES_EVERY: u64 = 3600 * 1_000_000_000;

pub fn text(found: &ForeignAnchors) -> String {
    let (ForeignAnchors { account, block, .. }, times) = (found, counted(found.count, "time"));
    format!(
        "{account} anchored {times} without this home sending it, last in block {block}: a copy of this home is \
         running elsewhere, or its key was stolen; stop the copy, or have the administrator propose a new account \
         (`authros chain succession propose LOST SUCCESSOR`)"
    )
}

/// Those seen within the last day.
pub fn recent(plant: &Plant) -> Result<Option<ForeignAnchors>> {
    let now = Timestamp::now().0;
    let seen = plant.ledger.notes.read(&SeenForeign {})?;
    Ok(seen.filter(|found| now.abs_diff(found.seen.0) < RECENT))
}

pub(super) fn look(plant: &Plant, events: &[EventAt], head: u64) -> Result<()> {
    let found = unknown(plant, events)?;
    if found.is_empty() {
        return Ok(());
    }
    let history = history(plant, head)?;
    let mut own: HashMap<Address, bool> = HashMap::new();
    for (account, at) in found.into_iter().filter(|(_, at)| at.block > history) {
        let known = own.get(&account).copied();
        let signs = known.map_or_else(|| plant.ledger.inspection.signs_for(account), Ok)?;
        own.insert(account, signs);
        if signs {
            tell(plant, account, at)?;
        }
    }
    Ok(())
}

/// A restored or copied ledger does not know what came between; anything on the chain when it is first examined is
/// history, not a rival.
fn history(plant: &Plant, head: u64) -> Result<u64> {
    if plant.ledger.notes.read(&CopiedAt {})?.is_none() {
        return Ok(0);
    }
    if let Some(history) = plant.ledger.notes.read(&ForeignHistory {})? {
        return Ok(history);
    }
    plant.ledger.notes.write(&ForeignHistory {}, &head)?;
    Ok(head)
}

fn unknown<'a>(plant: &Plant, events: &'a [EventAt]) -> Result<Vec<(Address, &'a EventAt)>> {
    let (mut roots, mut digests) = (HashMap::new(), HashMap::new());
    for at in events {
        match &at.event {
            Event::Anchored { account, root, .. } => drop(roots.insert(*root, (*account, at))),
            Event::DataUploaded { owner, digest, .. } => drop(digests.insert(*digest, (*owner, at))),
            _ => {}
        }
    }
    let asked: Vec<Hash> = roots.keys().copied().collect();
    let mut found: Vec<_> =
        plant.ledger.inspection.unknown_roots(&asked)?.iter().filter_map(|root| roots.remove(root)).collect();
    let asked: Vec<Digest> = digests.keys().copied().collect();
    found.extend(plant.ledger.inspection.unknown_digests(&asked)?.iter().filter_map(|digest| digests.remove(digest)));
    found.sort_by_key(|(_, at)| (at.block, at.log_index));
    Ok(found)
}

fn tell(plant: &Plant, account: Address, at: &EventAt) -> Result<()> {
    let (now, before) = (Timestamp::now(), plant.ledger.notes.read(&SeenForeign {})?);
    let before = before.filter(|before| before.account == account);
    // A chunk of events may be read twice.
    if before.as_ref().is_some_and(|before| (before.block, before.transaction) == (at.block, at.transaction)) {
        return Ok(());
    }
    let noted = before.as_ref().map(|before| before.noted).filter(|noted| now.0.abs_diff(noted.0) < LINES_EVERY);
    let count = before.map_or(0, |before| before.count) + 1;
    let (block, transaction) = (at.block, at.transaction);
    let found = ForeignAnchors { account, count, block, transaction, seen: now, noted: noted.unwrap_or(now) };
    plant.ledger.notes.write(&SeenForeign {}, &found)?;
    if noted.is_none() {
        plant.ledger.audit.append(AuditEntry {
            at: now,
            profile: account.to_string(),
            action: "foreign anchor".to_owned(),
            subject: format!("transaction {transaction} in block {block}"),
            outcome: "not sent by this home".to_owned(),
        })?;
    }
    plant.observer.foreign_anchors(&found);
    Ok(())
}

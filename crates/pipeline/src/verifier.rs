//! The last step: re-reads confirmed records from the vault and checks digest and signature, some at a time on as many
//! cores as it pays. Ledger and vault are asked for many at once (`reading`); each record is checked by itself.

mod reading;

use std::time::Instant;

use crate::crypto::{Anchor, Unchecked, check_many, fault};
use crate::model::{Digest, RecordState};
use crate::store::{RecordQuery, RecordRow, StoreError};

use self::reading::{ReadBack, read_back};
use super::authority::NoRight;
use super::stages::{Milestone, Stage};
use super::{Network, PipelineError, Plant, columns, proof};

/// Records per round: this many share the cost of a page of a ledger with many topics.
const ROUND: usize = 512;
/// Bytes read before they are checked together, unless a single record is larger.
const PIECE: u64 = 4 << 20;

/// What a page of records came to.
#[derive(Default)]
struct Outcome<'a> {
    good: Vec<&'a RecordRow>,
    bad: Vec<&'a RecordRow>,
    /// Anchored without a right.
    passed: Vec<(&'a RecordRow, NoRight)>,
}

/// Checks up to [`ROUND`] confirmed records; returns how many it decided about.
///
/// # Errors
/// Errors of vault and ledger; a vault that does not answer decides nothing.
pub fn verify_round(plant: &Plant, network: &Network) -> Result<usize, PipelineError> {
    let mut after = None;
    loop {
        let state = Some(RecordState::Confirmed);
        let page = plant.ledger.list(&RecordQuery { state, limit: ROUND, after, ..RecordQuery::default() })?;
        let decided = verify_page(plant, network, &page.rows)?;
        // If a part of the vault is down, later records are not kept waiting.
        match page.next {
            Some(next) if decided == 0 => after = Some(next),
            _ => return Ok(decided),
        }
    }
}

fn verify_page(plant: &Plant, network: &Network, rows: &[RecordRow]) -> Result<usize, PipelineError> {
    let begun = Instant::now();
    if !rows.is_empty() {
        fault::point("read-back");
    }
    let mut outcome = Outcome::default();
    let (mut piece, mut bytes) = (Vec::new(), 0u64);
    for row in rows.iter().filter(|row| plant.vault.answers(row.digest)) {
        bytes += row.bytes.min(PIECE);
        if bytes > PIECE {
            outcome.judge(plant, network, &std::mem::take(&mut piece))?;
            bytes = row.bytes.min(PIECE);
        }
        piece.push(row);
    }
    outcome.judge(plant, network, &piece)?;
    let Outcome { good, bad, passed } = outcome;
    if !rows.is_empty() {
        fault::point("checked");
    }
    settle(plant, &good, RecordState::Verified)?;
    settle(plant, &bad, RecordState::Tampered)?;
    pass_over(plant, &passed)?;
    if let Some(stages) = plant.observer.stages().filter(|_| !good.is_empty()) {
        stages.spent(Stage::Verify, begun.elapsed());
        stages.reached(Milestone::Verified, good.iter().map(|row| row.captured_at));
    }
    Ok(good.len() + bad.len() + passed.len())
}

impl<'a> Outcome<'a> {
    /// Reads some records and checks them together: each in full, including its signature, whoever wrote it.
    fn judge(&mut self, plant: &Plant, network: &Network, rows: &[&'a RecordRow]) -> Result<(), PipelineError> {
        let mut read = Vec::with_capacity(rows.len());
        for (row, found) in rows.iter().zip(read_back(plant, network, rows)) {
            match found {
                Ok(ReadBack::Bytes(blob, signer)) => read.push((*row, blob, signer)),
                Ok(ReadBack::Decided(sound)) => self.note(plant, row, Ok(sound))?,
                Ok(ReadBack::PassedOver(why)) => self.passed.push((*row, why)),
                Ok(ReadBack::Later) => {}
                Err(error) => self.note(plant, row, Err(error))?,
            }
        }
        let mut records = Vec::with_capacity(read.len());
        for (row, blob, signer) in &read {
            let (signature, anchor) = (&row.signature, Anchor::Chain(row.digest));
            records.push(Unchecked { blob, signature, signer, anchor });
        }
        let (mut same, mut other) = (Vec::with_capacity(read.len()), Vec::new());
        for ((row, ..), checked) in read.iter().zip(check_many(plant.provider, &records)) {
            let is_same = checked.is_ok_and(|(header, digest, _)| {
                digest == row.digest
                    && columns::header_difference(row, &header).is_none()
                    && network.domain == header.domain
            });
            if is_same { same.push(*row) } else { other.push(*row) }
        }
        self.bad.extend(other);
        for (row, sighted) in same.iter().zip(proof::were_sighted(plant, &same)?) {
            if sighted { self.good.push(row) } else { self.bad.push(row) }
        }
        Ok(())
    }

    /// If only a part of the vault is down, what is there waits; any other failure ends the round.
    fn note(
        &mut self,
        plant: &Plant,
        row: &'a RecordRow,
        sound: Result<bool, PipelineError>,
    ) -> Result<(), PipelineError> {
        match sound {
            Ok(true) => self.good.push(row),
            Ok(false) => self.bad.push(row),
            // The vault's health says so.
            Err(PipelineError::Store(StoreError::Unreachable { .. })) if !plant.vault.is_one() => {}
            Err(error) => return Err(error),
        }
        Ok(())
    }
}

fn settle(plant: &Plant, rows: &[&RecordRow], state: RecordState) -> Result<(), PipelineError> {
    if rows.is_empty() {
        return Ok(());
    }
    let digests: Vec<Digest> = rows.iter().map(|row| row.digest).collect();
    plant.ledger.advance(&digests, RecordState::Confirmed, state)?;
    if state == RecordState::Verified {
        // Local copies beside a vault that is only a cache stay until retention says otherwise.
        fault::point("verified");
        plant.observer.verified(&digests);
    } else {
        plant.observer.tampered(&digests);
        plant.observer.alert(
            true,
            format!("{} records differ from what was anchored, or are missing from the vault", digests.len()),
        );
    }
    plant.observer.records_changed();
    Ok(())
}

/// Records whose anchors do not count are stored again: they are anchored anew as soon as their signers may sign.
fn pass_over(plant: &Plant, passed: &[(&RecordRow, NoRight)]) -> Result<(), PipelineError> {
    let Some((_, why)) = passed.first() else { return Ok(()) };
    let digests: Vec<Digest> = passed.iter().map(|(row, _)| row.digest).collect();
    let moved = plant.ledger.pass_over(&digests)?;
    plant
        .observer
        .alert(false, format!("{moved} records will be anchored again because their block does not count: {why}"));
    plant.observer.records_changed();
    Ok(())
}

//! The last step: re-reads confirmed records from the vault and checks digest and signature, a few at a time on as many
//! cores as is worthwhile.

use std::time::Instant;

use crate::crypto::{Anchor, Unchecked, check_deleted, check_many, fault};
use crate::model::{Digest, PublicKey, RecordState};
use crate::store::{RecordQuery, RecordRow, StoreError};

use super::authority::NoRight;
use super::stages::{Milestone, Stage};
use super::{Network, PipelineError, Plant, authority, columns, proof};

/// Records a round.
const ROUND: usize = 128;
/// Bytes read before they are checked together, unless a single record is larger.
const PIECE: u64 = 4 << 20;

/// A record as it was read back.
enum ReadBack {
    /// Its stored bytes, and the key that could sign it.
    Bytes(Vec<u8>, PublicKey),
    /// Nothing to check: whether that is as it should be.
    Decided(bool),
    /// Its signer had no right at the anchoring block: that anchor does not count, a later one may.
    PassedOver(NoRight),
    /// The vault has just been given it again: the next round decides.
    Later,
}

/// The outcome of a page of records.
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
    /// Reads some records and checks them together.
    fn judge(&mut self, plant: &Plant, network: &Network, rows: &[&'a RecordRow]) -> Result<(), PipelineError> {
        let mut read = Vec::with_capacity(rows.len());
        for row in rows {
            match read_back(plant, network, row) {
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
        for ((row, ..), checked) in read.iter().zip(check_many(plant.provider, &records)) {
            let same = checked.is_ok_and(|(header, digest, _)| {
                digest == row.digest
                    && columns::header_difference(row, &header).is_none()
                    && network.accepts(&header.domain)
            });
            let sound = if same { proof::was_sighted(plant, row) } else { Ok(false) };
            self.note(plant, row, sound)?;
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

/// A vault that is only a cache may have forgotten the record; the ledger still has its copy.
fn put_back(plant: &Plant, row: &RecordRow) -> Result<(), PipelineError> {
    if plant.vault.durable() || plant.vault.contains(row.digest)? {
        return Ok(());
    }
    if let Some(copy) = plant.ledger.local_copy(row.digest)? {
        plant.vault.put(&[(row.digest, &copy)])?;
        fault::point("put-back");
    }
    Ok(())
}

fn read_back(plant: &Plant, network: &Network, row: &RecordRow) -> Result<ReadBack, PipelineError> {
    put_back(plant, row)?;
    let signer = match authority::signer_of(plant, network, row)? {
        Ok(signer) => signer,
        Err(NoRight::KeyUnknown { .. }) => return Ok(ReadBack::Decided(false)),
        Err(why) => return Ok(ReadBack::PassedOver(why)),
    };
    if let Some(blob) = plant.vault.get(row.digest)? {
        return Ok(ReadBack::Bytes(blob, signer));
    }
    // The vault lost it since it was checked; as long as there is a copy, nothing is gone.
    if let Some(copy) = plant.ledger.local_copy(row.digest)? {
        plant.vault.put(&[(row.digest, &copy)])?;
        return Ok(ReadBack::Later);
    }
    is_sound_without(plant, network, row, &signer).map(ReadBack::Decided)
}

/// After a reorganisation a record is verified again that retention has deleted meanwhile.
fn is_sound_without(
    plant: &Plant,
    network: &Network,
    row: &RecordRow,
    signer: &PublicKey,
) -> Result<bool, PipelineError> {
    let Some(retained) = plant.ledger.retained(row.digest)?.filter(|retained| retained.deleted_at.is_some()) else {
        return Ok(false);
    };
    let header = check_deleted(plant.provider, &retained.header, row.digest, &row.signature, signer);
    let same = header
        .is_ok_and(|header| columns::header_difference(row, &header).is_none() && network.accepts(&header.domain));
    Ok(same && proof::was_sighted(plant, row)?)
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
            format!("{} records differ from what was anchored, or are gone from the vault", digests.len()),
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
    plant.observer.alert(false, format!("{moved} records are to be anchored anew, their block does not count: {why}"));
    plant.observer.records_changed();
    Ok(())
}

//! The last step: re-reads confirmed records from the store, and checks digest and signature on several cores.

use std::{collections::HashMap, collections::hash_map::Entry, time::Instant};

use crate::authority::{self, NoRight};
use crate::crypto::{Anchor, Unchecked, check_deleted, check_many, fault};
use crate::model::{Digest, PublicKey, RecordState, counted};
use crate::stages::{Milestone, Stage};
use crate::store::{RecordQuery, RecordRow};
use crate::{Network, Plant, Result, chain_proofs, columns, retention::is_stated};

/// Records per round: this many share the cost of a page of a ledger with many topics.
const ROUND: usize = 512;
/// Bytes read before they are checked together, unless a single record is larger.
const PIECE: u64 = 4 << 20;

#[derive(Default)]
struct Outcome<'a> {
    good: Vec<&'a RecordRow>,
    bad: Vec<&'a RecordRow>,
    /// Anchored without a right.
    passed: Vec<(&'a RecordRow, NoRight)>,
}

/// Checks up to [`ROUND`] confirmed records; returns how many it decided about.
pub fn verify_round(plant: &Plant, network: &Network) -> Result<usize> {
    let state = Some(RecordState::Confirmed);
    let page = plant.ledger.records.list(&RecordQuery { state, limit: ROUND, ..RecordQuery::default() })?;
    verify_page(plant, network, &page.rows)
}

fn verify_page(plant: &Plant, network: &Network, rows: &[RecordRow]) -> Result<usize> {
    let begun = Instant::now();
    if !rows.is_empty() {
        fault::point("read-back");
    }
    let mut outcome = Outcome::default();
    let (mut piece, mut bytes) = (Vec::new(), 0u64);
    for row in rows {
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
    /// Own and foreign records alike are checked in full, signature included.
    fn judge(&mut self, plant: &Plant, network: &Network, rows: &[&'a RecordRow]) -> Result<()> {
        let mut signed = Vec::with_capacity(rows.len());
        let mut known: HashMap<_, Result<PublicKey, NoRight>> = HashMap::new();
        for &row in rows {
            let signer = match known.entry((row.owner, row.signer, row.block)) {
                Entry::Occupied(known) => known.get().clone(),
                Entry::Vacant(unknown) => unknown.insert(authority::signer_of(plant, network, row)?).clone(),
            };
            match signer {
                Ok(signer) => signed.push((row, signer)),
                Err(NoRight::KeyUnknown { .. }) => self.bad.push(row),
                // Its signer had no right at the anchoring block: that anchor does not count, but a later one may.
                Err(why) => self.passed.push((row, why)),
            }
        }
        let wanted: Vec<Digest> = signed.iter().map(|(row, _)| row.digest).collect();
        let mut read = Vec::with_capacity(signed.len());
        // Never from the cache: this proves what is on the disk.
        for ((row, signer), blob) in signed.into_iter().zip(plant.ciphertext.get_many(&wanted)?) {
            match blob {
                Some(blob) => read.push((row, blob, signer)),
                None if is_sound_without(plant, network, row, &signer)? => self.good.push(row),
                None => self.bad.push(row),
            }
        }
        let mut records = Vec::with_capacity(read.len());
        for (row, blob, signer) in &read {
            let (signature, anchor) = (&row.signature, Anchor::Chain(row.digest));
            records.push(Unchecked { blob, signature, signer, anchor });
        }
        let mut same = Vec::with_capacity(read.len());
        for ((row, ..), checked) in read.iter().zip(check_many(plant.provider, &records)) {
            let is_same = checked.is_ok_and(|(header, digest, _)| {
                digest == row.digest
                    && columns::header_difference(row, &header).is_none()
                    && network.domain == header.domain
            });
            if is_same { same.push(*row) } else { self.bad.push(row) }
        }
        for (row, sighted) in same.iter().zip(chain_proofs::were_sighted(plant, &same)?) {
            if sighted { self.good.push(row) } else { self.bad.push(row) }
        }
        Ok(())
    }
}

fn settle(plant: &Plant, rows: &[&RecordRow], state: RecordState) -> Result<()> {
    if rows.is_empty() {
        return Ok(());
    }
    let digests: Vec<Digest> = rows.iter().map(|row| row.digest).collect();
    plant.ledger.records.advance(&digests, RecordState::Confirmed, state)?;
    if state == RecordState::Verified {
        fault::point("verified");
        plant.observer.verified(&digests);
    } else {
        plant.observer.tampered(&digests);
        let records = counted(digests.len() as u64, "record");
        let text = format!("different from what was anchored, or missing from the store: {records}");
        plant.observer.alert(true, text);
    }
    plant.observer.records_changed();
    Ok(())
}

/// Records whose anchors do not count are stored again: they are anchored anew as soon as their signers may sign.
fn pass_over(plant: &Plant, passed: &[(&RecordRow, NoRight)]) -> Result<()> {
    let Some((_, why)) = passed.first() else { return Ok(()) };
    let digests: Vec<Digest> = passed.iter().map(|(row, _)| row.digest).collect();
    let moved = plant.ledger.batches.pass_over(&digests)?;
    let records = counted(moved, "record");
    let text = format!("{records} will be anchored again, because the block does not count: {why}");
    plant.observer.alert(false, text);
    plant.observer.records_changed();
    Ok(())
}

/// After a reorganisation a record is verified again although retention has deleted it meanwhile.
fn is_sound_without(plant: &Plant, network: &Network, row: &RecordRow, signer: &PublicKey) -> Result<bool> {
    let Some(retained) = plant.ledger.retention.find(row.digest)?.filter(|retained| retained.deleted_at.is_some())
    else {
        return Ok(false);
    };
    // Where the retention record is elsewhere, its owner's statement takes its place.
    if retained.stated.is_some() && !is_stated(plant, Some(network), row.digest, &retained) {
        return Ok(false);
    }
    let header = check_deleted(plant.provider, &retained.header, row.digest, &row.signature, signer);
    let same = header
        .is_ok_and(|header| columns::header_difference(row, &header).is_none() && network.domain == header.domain);
    Ok(same && chain_proofs::was_sighted(plant, row)?)
}

//! The last step: re-reads confirmed records from the vault and checks digest and signature, some at a time on as
//! many cores as it pays. Ledger and vault are asked for many at once; each record is checked by itself.

use std::time::Instant;

use crate::authority::{self, NoRight};
use crate::crypto::{Anchor, Unchecked, check_deleted, check_many, fault};
use crate::model::{Digest, PublicKey, RecordState};
use crate::retention::is_stated;
use crate::stages::{Milestone, Stage};
use crate::store::{RecordQuery, RecordRow, StoreError, Vault};
use crate::{Network, PipelineError, Plant, chain_proofs, columns};

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
    /// Reads some records and checks them together: each in full, including its signature, own and foreign ones alike.
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
        for (row, sighted) in same.iter().zip(chain_proofs::were_sighted(plant, &same)?) {
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

/// A record as it was read back.
enum ReadBack {
    /// Its stored bytes, and the key that could sign it.
    Bytes(Vec<u8>, PublicKey),
    /// There is nothing to check: whether that is as it should be.
    Decided(bool),
    /// Its signer had no right at the anchoring block: that anchor does not count, but a later one may.
    PassedOver(NoRight),
    /// It was just restored to the vault: the next round decides.
    Later,
}

/// Reads some records back, in their order. The caller bounds their bytes.
fn read_back(plant: &Plant, network: &Network, rows: &[&RecordRow]) -> Vec<Result<ReadBack, PipelineError>> {
    let mut signers = authority::Signers::new(plant, network);
    let there = put_back(plant, rows);
    let found: Vec<_> = there.into_iter().zip(rows).map(|(there, row)| there.and_then(|()| signers.of(row))).collect();
    let wanted = rows.iter().zip(&found).filter(|(_, signer)| matches!(signer, Ok(Ok(_))));
    let wanted: Vec<Digest> = wanted.map(|(row, _)| row.digest).collect();
    let mut blobs = ask(plant, &wanted, |vault, all| vault.get_many(all), |vault, one| vault.get(one)).into_iter();
    let one = |(row, signer): (&&RecordRow, Result<Result<PublicKey, NoRight>, PipelineError>)| {
        let signer = match signer? {
            Ok(signer) => signer,
            Err(NoRight::KeyUnknown { .. }) => return Ok(ReadBack::Decided(false)),
            Err(why) => return Ok(ReadBack::PassedOver(why)),
        };
        match blobs.next().transpose()?.flatten() {
            Some(blob) => Ok(ReadBack::Bytes(blob, signer)),
            None => without_bytes(plant, network, row, &signer),
        }
    };
    rows.iter().zip(found).map(one).collect()
}

/// Asks the vault for all at once; if only some of them fail, one by one, so that records stored elsewhere do not wait
/// for those.
fn ask<T>(
    plant: &Plant,
    digests: &[Digest],
    all: impl Fn(&dyn Vault, &[Digest]) -> Result<Vec<T>, StoreError>,
    one: impl Fn(&dyn Vault, Digest) -> Result<T, StoreError>,
) -> Vec<Result<T, StoreError>> {
    match all(&*plant.vault, digests) {
        Ok(found) => found.into_iter().map(Ok).collect(),
        Err(error) if plant.vault.is_one() => digests.iter().map(|_| Err(error.clone())).collect(),
        Err(_) => digests.iter().map(|digest| one(&*plant.vault, *digest)).collect(),
    }
}

/// A vault that is only a cache may have forgotten records; the ledger still has its copies.
fn put_back(plant: &Plant, rows: &[&RecordRow]) -> Vec<Result<(), PipelineError>> {
    if plant.vault.durable() {
        return rows.iter().map(|_| Ok(())).collect();
    }
    let digests: Vec<Digest> = rows.iter().map(|row| row.digest).collect();
    let there = ask(plant, &digests, |vault, all| vault.contains_many(all), |vault, one| vault.contains(one));
    let one = |(digest, there): (Digest, Result<bool, StoreError>)| {
        if there? {
            return Ok(());
        }
        if let Some(copy) = plant.ledger.local_copy(digest)? {
            plant.vault.put(&[(digest, &copy)])?;
            fault::point("put-back");
        }
        Ok(())
    };
    digests.into_iter().zip(there).map(one).collect()
}

/// The vault has no bytes of it.
fn without_bytes(
    plant: &Plant,
    network: &Network,
    row: &RecordRow,
    signer: &PublicKey,
) -> Result<ReadBack, PipelineError> {
    // The vault lost it since it was last checked; as long as there is a copy, nothing is gone.
    if let Some(copy) = plant.ledger.local_copy(row.digest)? {
        plant.vault.put(&[(row.digest, &copy)])?;
        return Ok(ReadBack::Later);
    }
    is_sound_without(plant, network, row, signer).map(ReadBack::Decided)
}

/// After a reorganisation a record is verified again although retention has deleted it meanwhile.
fn is_sound_without(
    plant: &Plant,
    network: &Network,
    row: &RecordRow,
    signer: &PublicKey,
) -> Result<bool, PipelineError> {
    let Some(retained) = plant.ledger.retained(row.digest)?.filter(|retained| retained.deleted_at.is_some()) else {
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

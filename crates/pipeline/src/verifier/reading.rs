//! The verifier's data from ledger and vault, requested for many records at once. The result for each record is the
//! same as if it were read alone.

use crate::crypto::{check_deleted, fault};
use crate::model::{Digest, PublicKey};
use crate::pipeline::authority::{self, NoRight};
use crate::pipeline::retention::erasing::is_stated;
use crate::pipeline::{Network, PipelineError, Plant, columns, proof};
use crate::store::{RecordRow, StoreError, Vault};

/// A record as it was read back.
pub(super) enum ReadBack {
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
pub(super) fn read_back(plant: &Plant, network: &Network, rows: &[&RecordRow]) -> Vec<Result<ReadBack, PipelineError>> {
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
    Ok(same && proof::was_sighted(plant, row)?)
}

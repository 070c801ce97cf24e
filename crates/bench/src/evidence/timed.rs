//! Verification of one bundle, timed beside what it cannot do without: SM3 and SM2 of the same records.

use std::hint::black_box;
use std::time::Instant;

use authros_crypto::pool;
use authros_crypto::record::signed_bytes;
use authros_evidence::{Bundle, Report, Standing, verify};
use authros_model::Digest;
use authros_service::Failure;
use authros_service::failure::internal;

use super::made::{Batch, Ground, Made};
use crate::account::{Account, Sealed};
use crate::spread::number;

/// Microseconds per record, a value for each run.
#[derive(Debug, Default)]
pub(super) struct Times {
    /// SM3 of each record and SM2 of its signature.
    pub reference: Vec<f64>,
    /// From the file's bytes to a bundle: the archive, and the manifest with SM3 and SHA-256 of every member.
    pub read: Vec<f64>,
    /// From the bundle to the verdict.
    pub check: Vec<f64>,
    /// Both.
    pub verify: Vec<f64>,
}

/// Times a bundle; the reference and the verification take turns.
///
/// # Errors
/// If it is not what was made, which would be a fault of this program.
pub(super) fn times(ground: &Ground, batches: &[Batch], made: &Made, runs: u32) -> Result<Times, Failure> {
    let records: Vec<(&Account, &Sealed)> =
        batches.iter().flat_map(Batch::records).map(|(signer, sealed)| (&**signer, sealed)).collect();
    let mut times = Times::default();
    for _ in 0..runs {
        times.reference.push(reference(ground, &records)?);
        let begun = Instant::now();
        let bundle = Bundle::parse(black_box(&made.file), ground.provider);
        let read = each(begun, records.len());
        let bundle = bundle.map_err(|error| internal(format!("a bundle is not read: {error}")))?;
        let begun = Instant::now();
        let report = verify(black_box(&bundle), Some(&ground.trust), ground.provider);
        let check = each(begun, records.len());
        expect(&report, records.len())?;
        times.read.push(read);
        times.check.push(check);
        times.verify.push(read + check);
    }
    Ok(times)
}

/// Microseconds since then for each of so many.
pub(super) fn each(begun: Instant, count: usize) -> f64 {
    begun.elapsed().as_secs_f64() * 1e6 / number(count)
}

/// The same threads as the verifier takes.
fn reference(ground: &Ground, records: &[(&Account, &Sealed)]) -> Result<f64, Failure> {
    let provider = ground.provider;
    let bytes = records.iter().map(|(_, sealed)| sealed.blob.len()).sum();
    let work = |(signer, sealed): &(&Account, &Sealed)| {
        let digest = Digest(provider.sm3(&[&sealed.blob]));
        let signed = signed_bytes(&signer.domain(), &digest);
        digest == sealed.leaf.digest && provider.verify(&signer.signing().public, &signed, &sealed.signature).is_ok()
    };
    let begun = Instant::now();
    let held = pool::each(records, pool::helpers_for(records.len(), bytes), work);
    let gone = each(begun, records.len());
    if held.into_iter().all(|held| held) { Ok(gone) } else { Err(internal("a signature does not hold")) }
}

/// The verdict on a whole bundle over a chain of the exporter's own.
fn expect(report: &Report, records: usize) -> Result<(), Failure> {
    let told = report.records.iter().map(|record| {
        (record.bytes.standing, record.key.standing, record.anchor.standing)
            == (Standing::Proven, Standing::OwnChain, Standing::OwnChain)
    });
    if report.records.len() == records && told.into_iter().all(|held| held) {
        return Ok(());
    }
    Err(internal(format!("a bundle does not hold: {}", report.last_line())))
}

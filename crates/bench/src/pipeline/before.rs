//! The state before a load: the speed of the disk, and another owner's records in ledger and vault, put there by the
//! store itself and moved to verified as the pipeline does it, but with nothing sealed and no chain.

use std::fs::File;
use std::io::Write as _;
use std::path::Path;
use std::time::Instant;

use crate::growth::fill::record;
use crate::growth::life::Life;
use crate::progress::Progress;
use crate::spread::Spread;
use authros_config::paths::Home;
use authros_crypto::sm3::sm3_many;
use authros_model::{Digest, ErrorKind, RecordState};
use authros_service::Failure;
use authros_store::{Ledger, NewRecord, open_vault};

/// Records put in at a time.
const BULK: u64 = 5_000;
/// Stored bytes of each: a message of 1 KiB, sealed.
const STORED: usize = 1_360;
/// How often an fsync is timed.
const TIMES: usize = 50;

/// Fills ledger and vault of a home that no site has opened yet.
///
/// # Errors
/// Errors of the store, such as a full disk.
pub(super) fn fill(home: &Home, wanted: u64) -> Result<(), Failure> {
    let (ledger, vault) = (Ledger::open(&home.ledger())?, open_vault(None, &home.vault())?);
    let (mut life, mut progress) = (Life::default(), Progress::new("records there before"));
    let most = usize::try_from(BULK).unwrap_or(usize::MAX);
    let mut there = 0;
    while there < wanted {
        let end = wanted.min(there + BULK);
        let blobs: Vec<Vec<u8>> = (there..end).map(blob).collect();
        let digests = sm3_many(&blobs.iter().map(Vec::as_slice).collect::<Vec<_>>());
        let entries = digests.iter().map(|digest| Digest(*digest)).zip(blobs.iter().map(Vec::as_slice));
        vault.put(&entries.collect::<Vec<_>>())?;
        let records = (there..end).zip(&digests);
        let records = records.map(|(number, digest)| NewRecord {
            digest: Digest(*digest),
            state: RecordState::Stored,
            ..record(number)
        });
        ledger.append(records.collect())?;
        life.verify(&ledger, most)?;
        there = end;
        progress.at(usize::try_from(there).unwrap_or(usize::MAX), usize::try_from(wanted).unwrap_or(usize::MAX));
    }
    vault.close();
    Ok(ledger.close()?)
}

/// Bytes that differ for every record.
fn blob(number: u64) -> Vec<u8> {
    let mut bytes = vec![0x5a; STORED];
    bytes[..8].copy_from_slice(&number.to_be_bytes());
    bytes
}

/// How long an fsync of another 4 KiB takes in a directory, milliseconds.
///
/// # Errors
/// If nothing can be written there.
pub(super) fn fsync_times(directory: &Path) -> Result<Spread, Failure> {
    let path = directory.join("fsync");
    let times = timed(&path).map_err(|error| {
        Failure::new(ErrorKind::Home, format!("{} cannot be written: {error}; set TMPDIR", directory.display()))
    });
    drop(std::fs::remove_file(&path));
    Ok(Spread::of(&times?))
}

fn timed(path: &Path) -> std::io::Result<Vec<f64>> {
    let mut file = File::create(path)?;
    let mut times = Vec::with_capacity(TIMES);
    for _ in 0..TIMES {
        file.write_all(&[0x5a; 4096])?;
        let begun = Instant::now();
        file.sync_data()?;
        times.push(begun.elapsed().as_secs_f64() * 1e3);
    }
    Ok(times)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_are_verified_in_the_ledger_and_whole_in_the_vault() {
        let directory = tempfile::tempdir().expect("a directory");
        let home = Home::new(directory.path().join("home"));
        authros_store::files::private_directory(home.root()).expect("made");
        fill(&home, 5_003).expect("filled");
        let ledger = Ledger::open(&home.ledger()).expect("a ledger");
        let counts = ledger.counts(None).expect("counted");
        assert_eq!((counts.data_in(RecordState::Verified), counts.pending()), (5_003, 0));
        let vault = open_vault(None, &home.vault()).expect("a vault");
        assert_eq!(vault.usage().expect("counted").entries, 5_003);
        let row = ledger.in_state(None, RecordState::Verified, 1).expect("a row").remove(0);
        let bytes = vault.get(row.digest).expect("read").expect("there");
        assert_eq!(authros_crypto::sm3::sm3(&[&bytes]), row.digest.0);
        let spread = fsync_times(directory.path()).expect("timed");
        assert!(spread.min > 0.0 && std::fs::read_dir(directory.path()).expect("read").count() == 1);
    }
}

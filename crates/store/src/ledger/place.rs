//! Where a ledger is stored: a copy opened elsewhere becomes a ledger of its own, like a restored one, so that no
//! number is ever used twice.

use std::os::unix::fs::MetadataExt as _;
use std::path::Path;

use super::Ledger;
use crate::model::clean;
use crate::store::{StoreError, snapshot};

/// The setting that records where the ledger was last opened.
pub(super) const PLACE: &str = "home:place";
/// Identifies the machine (machine-id(5)).
const MACHINE: &str = "/etc/machine-id";

impl Ledger {
    /// Opens the ledger of a home, and says whether it is a copy: its file is another one than when it was last opened,
    /// or it is on another machine. It then has a new recorder, and a note of how far the chain was known.
    ///
    /// # Errors
    /// See [`Ledger::open`].
    pub fn open_in_place(path: &Path) -> Result<(Self, bool), StoreError> {
        let ledger = Self::open(path)?;
        let here = place(path)?;
        let copied = match ledger.setting(PLACE)? {
            Some(there) if there == here => return Ok((ledger, false)),
            there => there.is_some(),
        };
        if !copied {
            ledger.put_setting(PLACE, &here)?;
            return Ok((ledger, false));
        }
        ledger.close()?;
        snapshot::renew_ledger(path)?;
        let ledger = Self::open(path)?;
        ledger.put_setting(PLACE, &here)?;
        Ok((ledger, true))
    }
}

/// The machine and the file's inode: a copy has another one.
fn place(path: &Path) -> Result<String, StoreError> {
    let about = std::fs::metadata(path).map_err(|error| StoreError::home(path, &error))?;
    let machine = std::fs::read_to_string(MACHINE).unwrap_or_default();
    Ok(format!("{} {}", clean(machine.trim(), 64), about.ino()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{Address, Digest, SignerId, TopicId};
    use crate::store::NewRecord;
    use crate::store::ledger::tests::record;

    #[test]
    fn a_copy_that_is_opened_elsewhere_numbers_under_a_recorder_of_its_own() {
        let home = tempfile::tempdir().expect("a folder");
        let (path, copy) = (home.path().join("ledger.db"), home.path().join("copy.db"));
        let (ledger, copied) = Ledger::open_in_place(&path).expect("made");
        let recorder = ledger.recorder();
        assert!(!copied);
        let (owner, signer) = (Address([1; 20]), SignerId([1; 32]));
        ledger.append(vec![record(1, 1, 1)]).expect("recorded");
        ledger.close().expect("closed");
        std::fs::copy(&path, &copy).expect("copied");
        let (ledger, copied) = Ledger::open_in_place(&path).expect("opened again");
        assert!(!copied && ledger.recorder() == recorder, "the first is as it was");
        assert_eq!(ledger.predecessor(owner, signer).expect("read"), None);
        let (other, copied) = Ledger::open_in_place(&copy).expect("the copy is opened");
        assert!(copied && other.recorder() != recorder);
        let before = recorder.of_signer(&signer);
        assert_eq!(other.predecessor(owner, signer).expect("read"), Some(before), "it says whose copy it is");
        assert_eq!(other.next_seq(owner, signer, TopicId([1; 16])), Ok(1), "and numbers anew");
        other.append(vec![NewRecord { digest: Digest([9; 32]), ..record(1, 1, 1) }]).expect("recorded");
        assert_eq!(other.predecessor(owner, signer).expect("read"), Some(before));
        let renewed = other.recorder();
        other.close().expect("closed");
        let (other, copied) = Ledger::open_in_place(&copy).expect("the copy is opened again");
        assert!(!copied && other.recorder() == renewed, "once is enough");
    }

    #[test]
    fn one_of_before_that_names_no_place_stays_what_it_is() {
        let home = tempfile::tempdir().expect("a folder");
        let path = home.path().join("ledger.db");
        let ledger = Ledger::open(&path).expect("made as before");
        let recorder = ledger.recorder();
        ledger.close().expect("closed");
        let (ledger, copied) = Ledger::open_in_place(&path).expect("opened");
        assert!(!copied && ledger.recorder() == recorder);
    }

    #[test]
    fn a_moved_file_is_no_copy() {
        let home = tempfile::tempdir().expect("a folder");
        let (path, moved) = (home.path().join("ledger.db"), home.path().join("moved.db"));
        let (ledger, _) = Ledger::open_in_place(&path).expect("made");
        let recorder = ledger.recorder();
        ledger.close().expect("closed");
        std::fs::rename(&path, &moved).expect("moved");
        let (ledger, copied) = Ledger::open_in_place(&moved).expect("opened");
        assert!(!copied && ledger.recorder() == recorder);
    }
}

//! Whether the bytes of records are in any file of a home.

use std::path::{Path, PathBuf};

use authros::model::Digest;
use authros::store::{Ciphertext, Ledger};
use serde_json::Value;

use super::{Home, holds, text};

/// Pieces from the beginning, the middle and the end of each record's ciphertext: it lies on many pages.
pub fn pieces_of(home: &Home, records: &[Value]) -> Vec<Vec<u8>> {
    let store = Ciphertext::of(&Ledger::open(&home.path().join("ledger.db")).expect("the site's own file"));
    let parts = |record| {
        let digest: Digest = text(record, "digest").parse().expect("a digest");
        let blob = store.get(digest).expect("read").expect("stored");
        [300, blob.len() / 2, blob.len() - 40].map(|at| blob[at..at + 32].to_vec())
    };
    records.iter().flat_map(parts).collect()
}

/// The files of a folder, and of those below it, in which one of these pieces is.
pub fn with_any(folder: &Path, pieces: &[Vec<u8>]) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
            found.extend(with_any(&path, pieces));
        } else if let Ok(bytes) = std::fs::read(&path)
            && pieces.iter().any(|piece| holds(&bytes, piece))
        {
            found.push(path);
        }
    }
    found
}

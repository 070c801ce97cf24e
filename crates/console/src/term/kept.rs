//! The file in which a console remembers its screen, filters and orders for the next start. A failure to read or write
//! it is ignored: it is only a memory aid.

use std::io::Read as _;
use std::path::Path;

use crate::app::resume::Kept;
use crate::store::files;

/// The longest file read, bytes.
const LONGEST: u64 = 64 * 1024;

/// The state left by the last run.
pub(super) fn read(path: &Path) -> Option<Kept> {
    let mut text = String::new();
    std::fs::File::open(path).ok()?.take(LONGEST).read_to_string(&mut text).ok()?;
    serde_json::from_str(&text).ok()
}

/// Saves it for the next run.
pub(super) fn write(path: &Path, kept: &Kept) {
    let Some(directory) = path.parent() else { return };
    let Ok(text) = serde_json::to_vec_pretty(kept) else { return };
    // A home that cannot be written has been reported before.
    if files::private_directory(directory).is_ok() {
        drop(files::atomic_write(path, &text));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_is_read_back_and_rubbish_is_nothing() {
        let home = tempfile::tempdir().expect("a directory");
        let path = home.path().join("console").join("default.json");
        assert_eq!(read(&path), None);
        let kept = Kept { screen: "Grants".to_owned(), local_time: true, ..Kept::default() };
        write(&path, &kept);
        assert_eq!(read(&path), Some(kept));
        std::fs::write(&path, "{ not json").expect("written");
        assert_eq!(read(&path), None);
    }
}

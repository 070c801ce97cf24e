//! A whole file that was compressed with zstd, unpacked for reading: SQLite and MCAP jump in it. It is private, in the
//! folder for temporary files, and gone when it is dropped.

use std::fs::File;
use std::io::{BufRead as _, BufReader, BufWriter, Read, Write as _};
use std::path::Path;

use tempfile::NamedTempFile;

use crate::ros::RosError;
use crate::ros::recording::{LARGEST_CHUNK, SPOILT, why};

/// Bytes written before the room left is looked at again.
const STEP: usize = 16 << 20;

/// Bytes that stay free on the disk.
const RESERVE: u64 = 512 << 20;

/// What comes out of a compressed file.
pub(crate) fn unpacked(path: &Path) -> Result<NamedTempFile, RosError> {
    let failed = |why: &str| RosError::recording(&format!("{} cannot be unpacked with zstd: {why}", path.display()));
    let told = |error: std::io::Error| failed(&why(&error));
    let made = NamedTempFile::new().map_err(told)?;
    let mut source = BufReader::with_capacity(1 << 18, File::open(path).map_err(told)?);
    let mut out = BufWriter::new(made.as_file());
    let window = u64::try_from(LARGEST_CHUNK).unwrap_or(u64::MAX);
    let mut buffer = vec![0; 1 << 18];
    let mut written = 0;
    while !source.fill_buf().map_err(told)?.is_empty() {
        let decoder = ruzstd::decoding::StreamingDecoder::new_with_max_window_size(&mut source, window);
        let mut decoder = decoder.map_err(|_| failed(SPOILT))?;
        loop {
            let read = decoder.read(&mut buffer).map_err(told)?;
            let bytes = buffer.get(..read).unwrap_or_default();
            if bytes.is_empty() {
                break;
            }
            out.write_all(bytes).map_err(told)?;
            if written / STEP != (written + read) / STEP {
                let room = rustix::fs::fstatvfs(made.as_file()).map_err(|error| told(error.into()))?;
                if room.f_bavail.saturating_mul(room.f_frsize) < RESERVE {
                    return Err(failed(&format!(
                        "less than {RESERVE} bytes are left in {}; name a larger folder in TMPDIR",
                        std::env::temp_dir().display()
                    )));
                }
            }
            written += read;
        }
        let decoder = decoder.into_frame_decoder();
        let told = decoder.get_checksum_from_data();
        if told.is_some() && told != decoder.get_calculated_checksum() {
            return Err(failed("what comes out does not match its checksum"));
        }
    }
    out.flush().map_err(told)?;
    drop(out);
    Ok(made)
}

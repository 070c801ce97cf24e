//! Reading at positions of a file that is mostly read sequentially.

use std::io::{BufRead, Read as _, Result, Seek};

/// Up to `length` bytes from a position on; fewer at the end of the file.
pub(crate) fn read_at(file: &mut (impl BufRead + Seek), at: u64, length: u64) -> Result<Vec<u8>> {
    go_to(file, at)?;
    let mut bytes = Vec::new();
    file.by_ref().take(length).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Moves to a position, keeping the read-ahead.
pub(crate) fn go_to(file: &mut (impl BufRead + Seek), at: u64) -> Result<()> {
    let here = file.stream_position()?;
    let step = i64::try_from(at).and_then(|at| i64::try_from(here).map(|here| at - here));
    file.seek_relative(step.unwrap_or(i64::MAX))
}

//! Reading at places of a file that is mostly read on and on.

use std::io::{BufRead, Read as _, Result, Seek};

/// Up to `length` bytes from a place on; fewer where the file ends.
pub(crate) fn read_at(file: &mut (impl BufRead + Seek), at: u64, length: u64) -> Result<Vec<u8>> {
    go_to(file, at)?;
    let mut bytes = Vec::new();
    file.by_ref().take(length).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Goes to a place; what was read ahead is kept.
pub(crate) fn go_to(file: &mut (impl BufRead + Seek), at: u64) -> Result<()> {
    let here = file.stream_position()?;
    let step = i64::try_from(at).and_then(|at| i64::try_from(here).map(|here| at - here));
    file.seek_relative(step.unwrap_or(i64::MAX))
}

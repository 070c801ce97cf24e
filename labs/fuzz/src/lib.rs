//! The work of the fuzz targets: each takes bytes, the first of which selects the test, and panics if the product
//! breaks a promise. `run` returns whether something valid was fully accepted.

pub mod backup;
pub mod bundle;
pub mod decoder;
pub mod export_folder;
pub mod frame;
pub mod join_file;
pub mod key_allocation;
pub mod picture;
pub mod proof;
pub mod record;
pub mod recording;
pub mod ros2_cdr;
pub mod sm2;
pub mod state_proof;
pub mod time_stamp;

mod cast;
mod messages;

/// A file name in the corpus, and its bytes.
pub type Sample = (&'static str, Vec<u8>);

/// The test selected, and its input.
fn way(data: &[u8], ways: u8) -> Option<(u8, &[u8])> {
    data.split_first().map(|(way, rest)| (way % ways, rest))
}

/// `genuine` XORed with `mask`, and whether that changed anything.
fn masked(genuine: &[u8], mask: &[u8]) -> (Vec<u8>, bool) {
    let mut bytes = genuine.to_vec();
    bytes.iter_mut().zip(mask).for_each(|(byte, bits)| *byte ^= bits);
    let changed = bytes != genuine;
    (bytes, changed)
}

/// A sample for a test.
fn sample(name: &'static str, way: u8, bytes: &[u8]) -> Sample {
    (name, [&[way], bytes].concat())
}

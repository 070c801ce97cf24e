//! What the fuzz targets do: each takes bytes, the first of which says how they are tried, and panics where the
//! product breaks its word. `run` gives whether something valid went all the way through.

pub mod backup;
pub mod bundle;
pub mod decoder;
pub mod export_folder;
pub mod frame;
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

/// A name for a file of the corpus, and its bytes.
pub type Sample = (&'static str, Vec<u8>);

/// The way of trying, and what it is tried with.
fn way(data: &[u8], ways: u8) -> Option<(u8, &[u8])> {
    data.split_first().map(|(way, rest)| (way % ways, rest))
}

/// `genuine` with `mask` laid over it (XOR), and whether that changed anything.
fn masked(genuine: &[u8], mask: &[u8]) -> (Vec<u8>, bool) {
    let mut bytes = genuine.to_vec();
    bytes.iter_mut().zip(mask).for_each(|(byte, bits)| *byte ^= bits);
    let changed = bytes != genuine;
    (bytes, changed)
}

/// A sample of a way.
fn sample(name: &'static str, way: u8, bytes: &[u8]) -> Sample {
    (name, [&[way], bytes].concat())
}

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

/// What is fuzzed.
pub struct Target {
    /// Also its folder in the corpus.
    pub name: &'static str,
    /// Valid encodings.
    pub samples: fn() -> Vec<Sample>,
    /// Whether the input was fully accepted; panics if a promise is broken.
    pub run: fn(&[u8]) -> bool,
}

/// All targets, by name.
pub const TARGETS: &[Target] = &[
    target("backup", backup::samples, backup::run),
    target("bag", recording::bags, recording::bag),
    target("bundle", bundle::samples, bundle::run),
    target("decoder", decoder::samples, decoder::run),
    target("export_folder", export_folder::samples, export_folder::run),
    target("frame", frame::samples, frame::run),
    target("join_file", join_file::samples, join_file::run),
    target("key_allocation", key_allocation::samples, key_allocation::run),
    target("mcap", recording::mcaps, recording::mcap),
    target("picture", picture::samples, picture::run),
    target("proof", proof::samples, proof::run),
    target("record", record::samples, record::run),
    target("ros2_cdr", ros2_cdr::samples, ros2_cdr::run),
    target("sm2", sm2::samples, sm2::run),
    target("state_proof", state_proof::samples, state_proof::run),
    target("time_stamp", time_stamp::samples, time_stamp::run),
];

const fn target(name: &'static str, samples: fn() -> Vec<Sample>, run: fn(&[u8]) -> bool) -> Target {
    Target { name, samples, run }
}

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

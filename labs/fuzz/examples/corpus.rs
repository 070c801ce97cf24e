//! After a change of format: `cargo run -p authros-fuzz --example corpus -- write` rewrites `labs/fuzz/corpus`. The targets
//! are compiled with the valid samples in it, so a second run without `write` then shows which files are fully
//! accepted.

use std::path::Path;
use std::{fs, io};

use authros_fuzz::{
    Sample, backup, bundle, decoder, export_folder, frame, join_file, key_allocation, picture, proof, record,
    recording, ros2_cdr, sm2, state_proof, time_stamp,
};

/// Name, valid encodings, and their target.
type Target = (&'static str, Vec<Sample>, fn(&[u8]) -> bool);

fn main() -> io::Result<()> {
    let write = std::env::args().nth(1).is_some_and(|word| word == "write");
    let targets: [Target; 16] = [
        ("frame", frame::samples(), frame::run),
        ("key_allocation", key_allocation::samples(), key_allocation::run),
        ("record", record::samples(), record::run),
        ("proof", proof::samples(), proof::run),
        ("export_folder", export_folder::samples(), export_folder::run),
        ("backup", backup::samples(), backup::run),
        ("join_file", join_file::samples(), join_file::run),
        ("decoder", decoder::samples(), decoder::run),
        ("picture", picture::samples(), picture::run),
        ("bag", recording::bags(), recording::bag),
        ("mcap", recording::mcaps(), recording::mcap),
        ("sm2", sm2::samples(), sm2::run),
        ("ros2_cdr", ros2_cdr::samples(), ros2_cdr::run),
        ("bundle", bundle::samples(), bundle::run),
        ("state_proof", state_proof::samples(), state_proof::run),
        ("time_stamp", time_stamp::samples(), time_stamp::run),
    ];
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus");
    for (target, samples, run) in targets {
        let folder = corpus.join(target);
        fs::create_dir_all(&folder)?;
        if write {
            for (name, bytes) in samples {
                fs::write(folder.join(name), &bytes)?;
            }
            continue;
        }
        for file in fs::read_dir(&folder)? {
            let path = file?.path();
            println!("{} {}", if run(&fs::read(&path)?) { "accepted" } else { "refused " }, path.display());
        }
    }
    Ok(())
}

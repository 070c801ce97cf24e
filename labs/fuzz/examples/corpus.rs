//! After a change of format: `cargo run -p authros-fuzz --example corpus -- write` rewrites `labs/fuzz/corpus`. The targets
//! are compiled with the valid samples in it, so a second run without `write` then shows which files are fully
//! accepted.

use std::path::Path;
use std::{fs, io};

use authros_fuzz::TARGETS;

fn main() -> io::Result<()> {
    let write = std::env::args().nth(1).is_some_and(|word| word == "write");
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus");
    for target in TARGETS {
        let folder = corpus.join(target.name);
        fs::create_dir_all(&folder)?;
        if write {
            for (name, bytes) in (target.samples)() {
                fs::write(folder.join(name), &bytes)?;
            }
            continue;
        }
        for file in fs::read_dir(&folder)? {
            let path = file?.path();
            println!("{} {}", if (target.run)(&fs::read(&path)?) { "accepted" } else { "refused " }, path.display());
        }
    }
    Ok(())
}

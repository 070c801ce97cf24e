//! The committed corpus of every fuzz target, replayed: each file must end as the target promises, without a panic, and
//! each target must fully accept at least one of its files.

use std::fs;
use std::path::{Path, PathBuf};

use authros_fuzz::TARGETS;

fn corpus() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus")
}

/// Replays a target's files; returns how many there are, and how many were fully accepted.
fn replayed(target: &str) -> (usize, usize) {
    let target = TARGETS.iter().find(|known| known.name == target).expect("a target of this name");
    let files = fs::read_dir(corpus().join(target.name)).expect("the target has a corpus");
    let read = files.map(|file| fs::read(file.expect("readable").path()).expect("readable"));
    let accepted: Vec<bool> = read.map(|bytes| (target.run)(&bytes)).collect();
    (accepted.len(), accepted.iter().filter(|&&accepted| accepted).count())
}

macro_rules! replay {
    ($($target:ident)+) => {
        const REPLAYED: &[&str] = &[$(stringify!($target)),+];
        $(
            #[test]
            fn $target() {
                let (files, accepted) = replayed(stringify!($target));
                assert!(files > 0 && accepted > 0, "{accepted} of {files} accepted");
            }
        )+
    };
}

replay! {
    backup bag bundle decoder export_folder frame join_file key_allocation
    mcap picture proof record ros2_cdr sm2 state_proof time_stamp
}

#[test]
fn every_target_and_every_folder_is_replayed() {
    let targets: Vec<&str> = TARGETS.iter().map(|target| target.name).collect();
    let mut folders: Vec<String> = fs::read_dir(corpus())
        .expect("readable")
        .map(|folder| folder.expect("readable").file_name().into_string().expect("a plain name"))
        .collect();
    folders.sort();
    assert_eq!((targets.as_slice(), folders), (REPLAYED, targets.iter().map(|&name| name.to_owned()).collect()));
}

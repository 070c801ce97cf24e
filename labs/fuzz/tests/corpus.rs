//! The committed corpus of every fuzz target, replayed: each file must end as the target promises, without a panic, and
//! each target must fully accept at least one of its files.

use std::fs;
use std::path::Path;

use authros_fuzz::{
    backup, bundle, decoder, export_folder, frame, join_file, key_allocation, picture, proof, record, recording,
    ros2_cdr, sm2, state_proof, time_stamp,
};

/// Replays a target's files; returns how many there are, and how many were fully accepted.
fn replayed(target: &str, run: fn(&[u8]) -> bool) -> (usize, usize) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(target);
    let files = fs::read_dir(folder).expect("the target has a corpus").map(|file| file.expect("readable").path());
    let accepted: Vec<bool> = files.map(|path| run(&fs::read(path).expect("readable"))).collect();
    (accepted.len(), accepted.iter().filter(|&&accepted| accepted).count())
}

macro_rules! replay {
    ($($target:ident: $run:expr;)+) => {$(
        #[test]
        fn $target() {
            let (files, accepted) = replayed(stringify!($target), $run);
            assert!(files > 0 && accepted > 0, "{accepted} of {files} accepted");
        }
    )+};
}

replay! {
    frame: frame::run;
    key_allocation: key_allocation::run;
    record: record::run;
    proof: proof::run;
    export_folder: export_folder::run;
    backup: backup::run;
    join_file: join_file::run;
    decoder: decoder::run;
    picture: picture::run;
    bag: recording::bag;
    mcap: recording::mcap;
    sm2: sm2::run;
    ros2_cdr: ros2_cdr::run;
    bundle: bundle::run;
    state_proof: state_proof::run;
    time_stamp: time_stamp::run;
}

#[test]
fn every_target_is_replayed() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let targets = fs::read_dir(root.join("fuzz_targets")).expect("readable").count();
    assert_eq!(targets, 16, "a new target belongs into the list above");
}

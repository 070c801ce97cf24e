//! Recordings with single bits flipped, through the program: no altered message is sealed unless the import reports
//! damage, or messages that no checksum covers.
#![allow(clippy::print_stdout, reason = "figures that the run shows")]
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use crate::support;

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use serde_json::Value;
use support::{Authros, Two, count, list, list_bag, long, skipped, system_program, two_profiles, write_bag};

const ROUNDS: usize = 10;

/// The same recording in every form: bags by rosbag, MCAP by us, also without chunk checksums.
fn recordings(two: &Two) -> Vec<(String, Vec<u8>)> {
    let mut forms = Vec::new();
    for compression in ["none", "bz2", "lz4"] {
        let bag = two.home.root().join(format!("{compression}.bag"));
        write_bag(&bag, compression, ROUNDS);
        forms.push((format!("bag, {compression}"), fs::read(&bag).expect("a bag")));
    }
    import(&two.alice, &two.home.root().join("none.bag"));
    for compression in ["none", "lz4", "zstd"] {
        let file = two.home.root().join(format!("{compression}.mcap"));
        let name = file.to_str().expect("UTF-8");
        two.alice.json_within(240, &["bag", "export", "--mcap", name, "--compression", compression]);
        let bytes = fs::read(&file).expect("a file");
        forms.push((format!("mcap, {compression}, no CRC"), without_checksums(bytes.clone())));
        forms.push((format!("mcap, {compression}"), bytes));
    }
    forms
}

/// MCAP as left by writers that compute no checksums: those of chunks (record 6) and of the data section (15) are zero.
fn without_checksums(mut bytes: Vec<u8>) -> Vec<u8> {
    let mut at = 8;
    while let Some(lead) = bytes.get(at..at + 9) {
        let length = u64::from_le_bytes(lead[1..].try_into().expect("8 bytes"));
        match lead[0] {
            6 => bytes[at + 33..at + 37].fill(0),
            15 => bytes[at + 9..at + 13].fill(0),
            2 => break,
            _ => {}
        }
        at += 9 + usize::try_from(length).expect("usize");
    }
    bytes
}

fn import(authros: &Authros, file: &Path) -> (Option<i32>, Value) {
    let name = file.to_str().expect("UTF-8");
    let outcome = authros.with(&["--json"]).spawn(&["bag", "import", name]).wait(240);
    let document = if outcome.code == Some(0) || !outcome.stdout.is_empty() { outcome.document() } else { Value::Null };
    (outcome.code, document)
}

/// A message of a bag without its caller, which a recording may leave out.
fn known(bag: &Path) -> BTreeSet<String> {
    let fields = |mut entry: Value| {
        entry[3] = Value::Null;
        entry.to_string()
    };
    list_bag(bag).into_iter().map(fields).collect()
}

#[test]
fn no_flipped_bit_is_sealed_untold() {
    if system_program("rosbag").is_none() {
        skipped!("no rosbag in /usr/bin");
    }
    let two = two_profiles(0);
    let forms = recordings(&two);
    let recorded = known(&two.home.root().join("none.bag"));
    let flips = if long() { 200 } else { 2 };
    // A fixed seed: a failing place can be reproduced.
    let mut chance = 0x9e37_79b9_7f4a_7c15_u64;
    let mut untold = 0;
    for (form, bytes) in &forms {
        let mut figures = [0_u64; 4];
        for _ in 0..flips {
            chance ^= chance << 13;
            chance ^= chance >> 7;
            chance ^= chance << 17;
            // The first 4 KiB of a bag are padding.
            let first = if form.starts_with("bag") { 4117 } else { 0 };
            let place = first + usize::try_from(chance >> 3).expect("usize") % (bytes.len() - first);
            let mut altered = bytes.clone();
            altered[place] ^= 1 << (chance & 7);
            let file = two.home.root().join(if form.starts_with("bag") { "altered.bag" } else { "altered.mcap" });
            fs::write(&file, altered).expect("written");
            let (code, summary) = import(&two.alice, &file);
            let damaged = code == Some(8) && !list(&summary, "damages").is_empty();
            let which = match code {
                Some(0) if count(&summary, "unguarded") > 0 => 2,
                Some(0) => 3,
                Some(_) if damaged => 1,
                // Left out or refused: then nothing of it may be sealed.
                _ => {
                    let sealed = summary["imported"].as_u64().unwrap_or(0);
                    assert_eq!(sealed, 0, "{form}, byte {place}, bit {}: exit {code:?}, {summary}", chance & 7);
                    0
                }
            };
            figures[which] += 1;
            if which == 3 {
                // Nothing was reported, so everything sealed must be what was recorded: Bob keeps only these.
                let (_, kept) = import(&two.bob, &file);
                untold += count(&kept, "imported");
                let whole = count(&kept, "imported") + count(&kept, "already");
                assert_eq!(whole, recorded.len() as u64, "{form}, byte {place}, bit {}: {kept}", chance & 7);
            }
        }
        let [refused, damaged, unguarded, whole] = figures;
        println!(
            "{form}: {flips} flips: {refused} refused, {damaged} damaged, {unguarded} unguarded, {whole} unharmed"
        );
    }
    let exported = two.home.root().join("untold.bag");
    if untold > 0 {
        two.bob.json_within(600, &["bag", "export", "--bag", exported.to_str().expect("UTF-8")]);
        let strange: Vec<String> = known(&exported).difference(&recorded).cloned().collect();
        assert!(strange.is_empty(), "sealed without a word though altered: {strange:?}");
    }
}

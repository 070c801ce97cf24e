//! Recordings altered at random: what is sealed under a topic is what ROS's own rosbag and the format's own mcap read for that
//! topic, or a line of damage says that it may not be.
#![allow(clippy::print_stdout, reason = "figures that the run shows")]
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use crate::support;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use authros::ros::recording::{BESIDE, Findings, Recording};
use serde::Deserialize;
use support::ros2::{folders_of_others, odd_mcaps, others_can_read, others_write_folders};
use support::{Home, hex, long, odd_bags, skipped, system_program};

/// Alterations of each file, and those of the long run.
const FEW: usize = 40;
const MANY: usize = 500;
/// Altered files that lie on the disk at a time.
const ROUND: usize = 400;
/// Bytes at the beginning of a bag that hold little but padding.
const PADDING: usize = 4110;
/// A finding's topic is this long at most.
const LONGEST: usize = 255;

/// Time and bytes of the messages of each topic, ordered.
type Topics = BTreeMap<String, Vec<(i128, String)>>;

/// What the other reader says of a file; messages as topic, nanoseconds, hex.
#[derive(Deserialize)]
struct Read {
    name: String,
    index: Option<Vec<(String, i128, String)>>,
    chunks: Option<Vec<(String, i128, String)>>,
}

fn by_topic(messages: impl IntoIterator<Item = (String, i128, String)>) -> Topics {
    let mut topics = Topics::new();
    for (topic, time, body) in messages {
        topics.entry(topic).or_default().push((time, body));
    }
    topics.values_mut().for_each(|messages| messages.sort());
    topics
}

/// What an import would seal, by the names in the file, and what it would tell; nothing if it refuses the file.
fn ours(path: &Path) -> Option<(Topics, Findings)> {
    let mut recording = Recording::open(path).ok()?;
    let mut messages = Vec::new();
    while let Some(message) = recording.next_message().expect("a file of this disk") {
        if &*message.channel.topic != BESIDE {
            messages.push((message.channel.topic.to_string(), i128::from(message.time.0), hex(&message.body)));
        }
    }
    Some((by_topic(messages), recording.findings().clone()))
}

/// Chance from a fixed seed: a failing alteration can be made again.
struct Chance(u64);

impl Chance {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    fn below(&mut self, most: usize) -> usize {
        usize::try_from(self.next() >> 16).expect("48 bits") % most.max(1)
    }

    /// A place in a file; seldom in the padding at the beginning of a bag.
    fn place(&mut self, bytes: &[u8]) -> usize {
        let is_bag = bytes.starts_with(b"#ROSBAG") && bytes.len() > PADDING && self.below(8) > 0;
        let first = if is_bag { PADDING } else { 0 };
        first + self.below(bytes.len() - first)
    }

    /// A part of a file: a few bytes, or many.
    fn part(&mut self, bytes: &[u8]) -> std::ops::Range<usize> {
        let longest = if self.below(2) == 0 { 16 } else { bytes.len() / 3 };
        let begin = self.place(bytes);
        begin..(begin + 1 + self.below(longest)).min(bytes.len())
    }
}

/// Numbers that lengths, counts and places are altered to.
const NUMBERS: [u64; 8] = [0, 1, 2, 0x7f, 0xffff, 0x7fff_ffff, 0xffff_ffff, u64::MAX];

/// One alteration of a file; its name, for who has to look.
fn alter(bytes: &mut Vec<u8>, chance: &mut Chance) -> &'static str {
    let (place, part) = (chance.place(bytes), chance.part(bytes));
    match chance.below(10) {
        0 => {
            bytes[place] ^= 1 << chance.below(8);
            "a bit"
        }
        1 => {
            bytes[place] = u8::try_from(chance.below(256)).expect("a byte");
            "a byte"
        }
        2 => {
            let number = NUMBERS[chance.below(NUMBERS.len())].to_le_bytes();
            let width = [2, 4, 8][chance.below(3)].min(bytes.len() - place);
            bytes[place..place + width].copy_from_slice(&number[..width]);
            "a number"
        }
        3 => {
            bytes.truncate(place.max(32));
            "cut off"
        }
        4 => {
            drop(bytes.drain(part));
            "taken out"
        }
        5 => {
            let twice = bytes[part.clone()].to_vec();
            drop(bytes.splice(part.end..part.end, twice));
            "twice"
        }
        6 => {
            let part = bytes[part].to_vec();
            drop(bytes.splice(place..place, part));
            "put elsewhere"
        }
        7 => {
            bytes[part].fill(0);
            "zeros"
        }
        _ => rename(bytes, chance),
    }
}

/// Puts the name of one topic in the place of another: what no format notices but by what else it says of them.
fn rename(bytes: &mut [u8], chance: &mut Chance) -> &'static str {
    let (from, to): (&[u8], &[u8]) = if chance.below(2) == 0 { (b"/left", b"/righ") } else { (b"/righ", b"/left") };
    let places: Vec<usize> = (0..bytes.len().saturating_sub(5)).filter(|at| bytes[*at..].starts_with(from)).collect();
    if let Some(place) = places.get(chance.below(places.len())) {
        bytes[*place..*place + to.len()].copy_from_slice(to);
    }
    "a topic's name"
}

/// Whether each message is among the others, as often at least; both are ordered.
fn is_within(messages: &[(i128, String)], others: &[(i128, String)]) -> bool {
    let mut others = others.iter();
    messages.iter().all(|message| others.any(|other| other == message))
}

/// Why what is sealed of an altered file is false; `None` if it is true, or told.
fn falsehood(path: &Path, read: &Read, original: &Topics) -> Option<String> {
    let (sealed, findings) = ours(path)?;
    if !findings.damages.is_empty() || findings.more_damages > 0 {
        return None;
    }
    let left_out = |topic: &str| {
        let shown: String = topic.chars().take(LONGEST).collect();
        findings.unusable.iter().any(|row| row.topic.is_empty() || row.topic == shown)
    };
    let ways: Vec<Topics> =
        [&read.index, &read.chunks].into_iter().flatten().map(|way| by_topic(way.clone())).collect();
    if ways.is_empty() {
        // They give up: then it must be what was recorded, unless nothing in the file could show that it is not.
        let strange = |(topic, messages): (&String, &Vec<(i128, String)>)| {
            let known: BTreeSet<_> = original.get(topic).into_iter().flatten().collect();
            messages.iter().any(|message| !known.contains(message)).then(|| topic.clone())
        };
        let strange = if findings.unguarded > 0 { None } else { sealed.iter().find_map(strange) };
        return strange.map(|topic| format!("under {topic} is sealed what was not recorded, and others give up"));
    }
    let names: BTreeSet<&String> = ways.iter().flat_map(Topics::keys).chain(sealed.keys()).collect();
    // Others may read less than is there, or nothing: then what is sealed must be what was recorded, and no less than they read.
    let is_more = |topic: &String| {
        let of = |topics: &Topics| topics.get(topic).cloned().unwrap_or_default();
        let unknown = findings.unguarded > 0 && ways.iter().all(|way| !way.contains_key(topic));
        unknown || is_within(&of(&sealed), &of(original)) && ways.iter().any(|way| is_within(&of(way), &of(&sealed)))
    };
    let is_true = |topic: &&String| {
        ways.iter().any(|way| way.get(*topic) == sealed.get(*topic)) || left_out(topic) || is_more(topic)
    };
    let topic = names.into_iter().find(|topic| !is_true(topic))?;
    let messages = |topics: &Topics| topics.get(topic).map_or(0, Vec::len);
    let others: Vec<usize> = ways.iter().map(messages).collect();
    Some(format!("under {topic} are sealed {} messages, others read {others:?}", messages(&sealed)))
}

/// Alters each file of a folder so often, and compares.
fn compare(home: &Home, written: &Path, other: impl Fn(&Path) -> Vec<Read>) {
    let times = if long() { MANY } else { FEW };
    let mut files: Vec<PathBuf> =
        fs::read_dir(written).expect("a folder").map(|file| file.expect("a file").path()).collect();
    files.sort();
    assert!(files.len() >= 8, "{files:?}");
    for file in files {
        let original = ours(&file).expect("a sound recording").0;
        let bytes = fs::read(&file).expect("written");
        let name = file.file_name().expect("named").to_string_lossy().into_owned();
        let mut chance = Chance(0x2545_f491_4f6c_dd1d ^ u64::from(name.bytes().map(u32::from).sum::<u32>()));
        let mut told = 0;
        for round in 0..times.div_ceil(ROUND) {
            let folder = home.root().join(format!("altered-{name}-{round}"));
            fs::create_dir(&folder).expect("created");
            let mut alterations = BTreeMap::new();
            for number in round * ROUND..times.min((round + 1) * ROUND) {
                let mut altered = bytes.clone();
                // The first is the file itself.
                let done: Vec<_> =
                    (0..number.min(1 + chance.below(3))).map(|_| alter(&mut altered, &mut chance)).collect();
                let altered_name = format!("{number:04}-{name}");
                fs::write(folder.join(&altered_name), altered).expect("written");
                alterations.insert(altered_name, done);
            }
            let read = other(&folder);
            assert_eq!(read.len(), alterations.len(), "the other reader came to the end of {name}");
            for one in &read {
                let path = folder.join(&one.name);
                let false_of = falsehood(&path, one, &original);
                assert!(
                    false_of.is_none(),
                    "{}, {:?}: {}",
                    one.name,
                    alterations[&one.name],
                    false_of.unwrap_or_default()
                );
                told += u64::from(ours(&path).is_none_or(|(_, findings)| !findings.is_whole()));
            }
            fs::remove_dir_all(&folder).expect("removed");
        }
        println!("{name}: {times} alterations, {told} of them told");
    }
}

fn parsed(lines: &str) -> Vec<Read> {
    lines.lines().map(|line| serde_json::from_str(line).expect("a line of JSON")).collect()
}

#[test]
fn of_an_altered_bag_is_sealed_what_rosbag_reads_or_damage_is_told() {
    if system_program("rosbag").is_none() {
        skipped!("no rosbag in /usr/bin");
    }
    let home = Home::new();
    let written = home.root().join("written");
    fs::create_dir(&written).expect("created");
    odd_bags("write", &written, 60);
    compare(&home, &written, |folder| parsed(&odd_bags("read", folder, 3_600)));
}

#[test]
fn of_an_altered_mcap_is_sealed_what_mcap_reads_or_damage_is_told() {
    if !others_can_read() {
        skipped!("no mcap in target/peers; tests/run installs it");
    }
    let home = Home::new();
    let written = home.root().join("written");
    fs::create_dir(&written).expect("created");
    odd_mcaps("write", &written, 60);
    compare(&home, &written, |folder| parsed(&odd_mcaps("read", folder, 3_600)));
}

/// Two recordings of rosbag2 in the storage, and in the compression of whole files or messages.
const CHOSEN: [&str; 8] = [
    "sqlite3_none_4_1",
    "sqlite3_none_9_1",
    "sqlite3_message_8_1",
    "sqlite3_message_5_1",
    "sqlite3_none_6_3",
    "sqlite3_file_8_3",
    "mcap_none_9_3",
    "mcap_file_8_3",
];

#[test]
fn of_an_altered_db3_is_sealed_what_others_read_or_damage_is_told() {
    if !others_write_folders() {
        skipped!("no rosbags in target/peers; tests/run installs it");
    }
    let home = Home::new();
    let (all, written) = (home.root().join("all"), home.root().join("written"));
    [&all, &written].iter().for_each(|folder| fs::create_dir(folder).expect("created"));
    folders_of_others("write", &all, 300);
    for name in ["none_4_1", "none_5_1", "none_6_1", "none_7_1", "none_8_1", "none_9_1", "none_8_3", "none_9_3"] {
        let file = format!("sqlite3_{name}_0.db3");
        fs::copy(all.join(format!("sqlite3_{name}")).join(&file), written.join(&file)).expect("copied");
    }
    compare(&home, &written, |folder| parsed(&folders_of_others("files", folder, 3_600)));
}

#[test]
fn of_an_altered_folder_is_sealed_what_was_recorded_or_damage_is_told() {
    if !others_write_folders() {
        skipped!("no rosbags in target/peers; tests/run installs it");
    }
    let home = Home::new();
    let written = home.root().join("written");
    fs::create_dir(&written).expect("created");
    folders_of_others("write", &written, 300);
    for name in CHOSEN {
        let folder = written.join(name);
        let original = ours(&folder).expect("a sound folder").0;
        let mut files: Vec<PathBuf> =
            fs::read_dir(&folder).expect("a folder").map(|file| file.expect("a file").path()).collect();
        files.sort();
        let mut chance = Chance(0x9e37_79b9_7f4a_7c15 ^ u64::from(name.bytes().map(u32::from).sum::<u32>()));
        for _ in 0..if long() { 100 } else { FEW } {
            // The description as often as all the others.
            let is_yaml = chance.below(2) == 0;
            let file = if is_yaml { folder.join("metadata.yaml") } else { files[chance.below(files.len())].clone() };
            let bytes = fs::read(&file).expect("written");
            let mut altered = bytes.clone();
            let done = alter(&mut altered, &mut chance);
            fs::write(&file, &altered).expect("written");
            if let Some((sealed, findings)) = ours(&folder)
                && findings.is_whole()
            {
                let is_known = |(topic, messages): (&String, &Vec<(i128, String)>)| {
                    original.get(topic).is_some_and(|known| is_within(messages, known))
                };
                let is_all = sealed == original || file.ends_with("metadata.yaml") && sealed.iter().all(is_known);
                // SQLite has no checksums: what else reads the file sees the same.
                assert!(is_all || findings.unguarded > 0, "{name}, {}: {done}", file.display());
            }
            fs::write(&file, &bytes).expect("written");
        }
    }
}

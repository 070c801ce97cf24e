//! Recordings of rosbag2 as other makers write and read them: folders in every version, storage, compression and split.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use authros::ros::recording::{BESIDE, Recording};
use serde::Deserialize;
use support::ros2::{folders_of_others, others_write_folders};
use support::{Home, count, list, skipped};

/// Time and bytes of each message, with its topic, ordered by time.
type Messages = Vec<(u64, String, String)>;

/// What rosbags reads of a folder.
#[derive(Deserialize)]
struct Read {
    name: String,
    messages: Vec<(String, u64, String)>,
    qos: BTreeMap<String, String>,
    counts: BTreeMap<String, u64>,
}

impl Read {
    fn all(folder: &Path) -> Vec<Self> {
        let lines = folders_of_others("read", folder, 300);
        lines.lines().map(|line| serde_json::from_str(line).expect("a line of JSON")).collect()
    }

    fn messages(&self) -> Messages {
        sorted(self.messages.iter().map(|(topic, time, body)| (*time, topic.clone(), body.clone())).collect())
    }
}

fn sorted(mut messages: Messages) -> Messages {
    messages.sort();
    messages
}

fn utf8(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

/// What an import would seal, in its order.
fn ours(path: &Path) -> Messages {
    let mut recording = Recording::open(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut found = Vec::new();
    while let Some(message) = recording.next_message().expect("readable") {
        if &*message.channel.topic != BESIDE {
            found.push((message.time.0, message.channel.topic.to_string(), support::hex(&message.body)));
        }
    }
    assert!(recording.findings().is_whole(), "{}: {:?}", path.display(), recording.findings());
    found
}

#[test]
fn every_folder_is_read_as_rosbags_reads_it_by_its_own_clock() {
    if !others_write_folders() {
        skipped!("no rosbags in target/peers; tests/run installs it");
    }
    let home = Home::new();
    let written = home.root().join("written");
    fs::create_dir(&written).expect("created");
    folders_of_others("write", &written, 300);
    let all = Read::all(&written);
    assert_eq!(all.len(), 84, "storage, compression, version and split");
    for read in all {
        let found = ours(&written.join(&read.name));
        assert_eq!(sorted(found.clone()), read.messages(), "{}", read.name);
        assert_eq!(found.len() as u64, read.counts.values().sum::<u64>(), "{}", read.name);
        // A file of MCAP is read in its order; those of SQLite have one by time.
        if read.name.starts_with("sqlite3") {
            assert!(found.is_sorted_by_key(|(time, ..)| *time), "{}", read.name);
        }
    }
}

#[test]
fn a_folder_is_sealed_once_and_comes_out_as_a_folder_that_others_read_alike() {
    if !others_write_folders() {
        skipped!("no rosbags in target/peers; tests/run installs it");
    }
    let home = Home::new();
    let _site = home.authros().with(&["--robots", "0"]).serve(&home);
    let (written, back) = (home.root().join("written"), home.root().join("back"));
    [&written, &back].iter().for_each(|folder| fs::create_dir(folder).expect("created"));
    folders_of_others("write", &written, 300);
    let chosen = ["sqlite3_file_5_3", "mcap_message_9_3", "sqlite3_message_4_1", "mcap_storage_8_1"];
    let all = Read::all(&written);
    for name in chosen {
        let authros = home.profile(name);
        authros.enrol();
        let folder = written.join(name);
        let summary = authros.json_within(240, &["bag", "import", utf8(&folder)]);
        let original = all.iter().find(|read| read.name == name).expect("written");
        let messages = original.messages.len() as u64;
        let figures = ["imported", "verified", "already", "skipped"].map(|field| count(&summary, field));
        assert_eq!(figures, [messages, messages, 0, 0], "{summary}");
        assert!(list(&summary, "damages").is_empty() && count(&summary, "attachments") > 0, "{summary}");
        let again = authros.json_within(240, &["bag", "import", utf8(&folder)]);
        assert_eq!((count(&again, "imported"), count(&again, "already")), (0, messages), "{again}");
        let view = authros.json_within(240, &["bag", "export", "--rosbag2", utf8(&back.join(name))]);
        assert_eq!(count(&view, "messages"), messages, "{view}");
        let taken = authros.run(&["bag", "export", "--rosbag2", utf8(&back.join(name))]);
        assert!(taken.code != Some(0) && taken.stderr.contains("already exists"), "{taken}");
    }
    for read in Read::all(&back) {
        let original = all.iter().find(|original| original.name == read.name).expect("written");
        assert_eq!(read.messages(), original.messages(), "{}", read.name);
        assert_eq!((&read.qos, &read.counts), (&original.qos, &original.counts), "{}", read.name);
    }
    // What says of itself that it is not whole is told with the file's name; what still is written is refused.
    let folder = written.join("mcap_none_8_3");
    fs::remove_file(folder.join("mcap_none_8_3_1.mcap")).expect("removed");
    let authros = home.profile("damaged");
    authros.enrol();
    let outcome = authros.with(&["--json"]).run(&["bag", "import", utf8(&folder)]).expect_code(8).document();
    assert_eq!(count(&outcome, "imported"), 80, "{outcome}");
    let told = outcome["damages"].to_string();
    assert!(told.contains("mcap_none_8_3_1.mcap was left out (40 messages)"), "{told}");
    fs::remove_file(folder.join("metadata.yaml")).expect("removed");
    let refused = authros.run(&["bag", "import", utf8(&folder)]);
    assert!(refused.code != Some(0) && refused.stderr.contains("ros2 bag reindex"), "{refused}");
}

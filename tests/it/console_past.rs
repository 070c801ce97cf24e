//! A robot user at the console looks into the past: freezes, pages back an hour, searches a span and exports it, while
//! records go on coming.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use authros::model::Timestamp;
use authros::ros::bag::BagWriter;
use authros::ros::recording::{Channel, ChunkCompression, Encoding};
use support::{Console, Home, Terminal, heavy, poll, text, wait_until};

const LIVE: &str = "/robot1/odom";
const PAST: &str = "/dive/depth";
/// Seconds allowed for anything on a busy machine.
const PATIENCE: u64 = 120;
/// Messages of the past, and the seconds between them: an hour and ten minutes.
const MESSAGES: u64 = 420;
const APART: u64 = 10;
/// An hour before the newest of them.
const OLD: u64 = MESSAGES - 1 - 3_600 / APART;

/// A dive that ended a minute ago.
struct Dive {
    begun: u64,
}

impl Dive {
    fn at(&self, number: u64) -> Timestamp {
        Timestamp::from_seconds(self.begun + number * APART)
    }

    fn record(path: &Path) -> Self {
        let dive = Self { begun: Timestamp::now().seconds() - 60 - MESSAGES * APART };
        let channel = Arc::new(Channel {
            topic: PAST.into(),
            type_name: "std_msgs/Float64".into(),
            md5sum: "fdb28210bfa9d7c91146260178d9a584".into(),
            definition: "float64 data\n".into(),
            caller_id: "/depth_gauge".into(),
            latching: false,
            encoding: Encoding::Ros1,
            about: BTreeMap::new(),
        });
        let file = File::create(path).expect("a file");
        let mut bag = BagWriter::begin(file, ChunkCompression::None).expect("begun");
        for number in 0..MESSAGES {
            let depth = f64::from(u32::try_from(number).expect("few")) / 4.0;
            bag.write(&channel, dive.at(number), &depth.to_le_bytes()).expect("written");
        }
        bag.finish().expect("finished");
        dive
    }
}

/// The topic and the time of each row on screen; on a wide terminal the pane is beside the list.
fn rows(console: &Console) -> Vec<(String, String)> {
    let shown = console.shown();
    let lists = shown.lines().map(|line| line.split('│').next().unwrap_or_default().to_owned());
    let row = |line: String| {
        let topic = line.split_whitespace().find(|word| word.starts_with('/'))?.to_owned();
        let is_clock = |word: &&str| word.len() == 8 && word.bytes().filter(|byte| *byte == b':').count() == 2;
        Some((topic, line.split_whitespace().find(is_clock)?.to_owned()))
    };
    lists.filter_map(row).collect()
}

fn waits_for(console: &Console, what: &str, holds: impl Fn(&Console) -> bool) {
    let held = poll(PATIENCE, || holds(console).then_some(()));
    assert!(held.is_some(), "{what} is not there:\n{}", console.shown());
}

/// Hides what is told: a message of several lines lies over the last rows of the list.
fn hide_messages(console: &mut Console) {
    while console.shown().contains("esc: hide") {
        let before = console.shown();
        console.press("\u{1b}");
        waits_for(console, "the message to be hidden", |console| console.shown() != before);
    }
}

/// The number of the page and the row under the cursor, which goes to the last row before the next page is read.
fn place(console: &Console) -> (Option<String>, Option<String>) {
    let shown = console.shown();
    let number = shown.split("page ").nth(1).map(|rest| rest.chars().take_while(char::is_ascii_digit).collect());
    let row = shown.lines().find(|line| line.starts_with('▌')).map(|line| line.trim_end().to_owned());
    (number, row)
}

/// Turns pages until the moment is on screen; the times of all of the past seen on the way.
fn page_back(console: &mut Console, until: &str) -> BTreeSet<String> {
    let mut seen = BTreeSet::new();
    for page in 2.. {
        hide_messages(console);
        let before = place(console);
        seen.extend(rows(console).into_iter().filter(|(topic, _)| topic == PAST).map(|(_, clock)| clock));
        if seen.contains(until) {
            break;
        }
        console.press("\u{1b}[6~");
        waits_for(console, &format!("page {page}"), |console| {
            let shown = console.shown();
            // A frame arrives in pieces: its first line may be there before its rows are.
            std::thread::sleep(Duration::from_millis(40));
            let is_whole = console.shown() == shown && !shown.contains("reading") && !rows(console).is_empty();
            is_whole && place(console) != before
        });
    }
    seen
}

#[test]
fn an_hour_is_paged_back_to_searched_and_exported_from_a_frozen_view_while_records_come() {
    let _alone = heavy();
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]);
    authros.enrol();
    let bag = home.root().join("dive.bag");
    let dive = Dive::record(&bag);
    let imported = authros.json_within(PATIENCE, &["bag", "import", bag.to_str().expect("UTF-8")]);
    assert_eq!(imported["imported"], MESSAGES, "{imported}");
    authros.run(&["topics", "watch", LIVE]).expect_code(0);
    for (columns, lines) in [(80, 24), (200, 50)] {
        let mut console = Console::open_in(&Terminal::of(columns, lines), &authros, &[]);
        console.press("3");
        console.wait_for(LIVE, PATIENCE);
        console.press("f");
        console.wait_for("FROZEN", PATIENCE);
        waits_for(&console, "a still page", |console| !console.shown().contains("reading"));

        // Back an hour, page after page: each record of the past is met, in its turn.
        let seen = page_back(&mut console, &dive.at(OLD).clock());
        let wanted: BTreeSet<String> = (OLD..MESSAGES).map(|number| dive.at(number).clock()).collect();
        let missed: Vec<&String> = wanted.difference(&seen).collect();
        assert!(missed.is_empty(), "not met while paging back: {missed:?}");

        // The same hour by its span: five of the past, and nothing that came since.
        let (since, until) = (dive.at(OLD), dive.at(OLD + 5));
        console.press(&format!("/topic:{PAST} since:{since} until:{until}\r"));
        let span: Vec<(String, String)> =
            (OLD..OLD + 5).rev().map(|number| (PAST.to_owned(), dive.at(number).clock())).collect();
        waits_for(&console, "the five of the span", |console| rows(console) == span);

        // All of them go into a folder, as the command line names them.
        let folder = home.root().join(format!("case-{columns}"));
        fs::create_dir(&folder).expect("a folder");
        console.press("a");
        console.wait_for("5 marked", PATIENCE);
        console.press("e");
        console.wait_for("Export 5 records", PATIENCE);
        console.press(&format!("\u{15}~/case-{columns}\r"));
        let written = wait_until(PATIENCE, "five records", || {
            let names = fs::read_dir(&folder).ok()?.flatten().map(|entry| entry.file_name());
            let names: Vec<String> = names.map(|name| name.to_string_lossy().into_owned()).collect();
            Some(names).filter(|names| names.len() == 5)
        });
        let terms = ["--since", &since.to_string(), "--until", &until.to_string()];
        let listed = authros.records(&[&["records", "list", "--oldest", "--topic", PAST], &terms[..]].concat());
        assert_eq!(listed.len(), 5, "{listed:?}");
        for record in &listed {
            let id = text(record, "id");
            assert!(written.iter().any(|name| name.contains(&id)), "{id} in {written:?}");
        }

        // What came meanwhile is there as soon as the view goes on; a further search begins anew.
        console.press("f");
        waits_for(&console, "the view to go on", |console| !console.shown().contains("FROZEN"));
        console.press(&format!("/{LIVE}\r"));
        waits_for(&console, "what came meanwhile", |console| {
            let shown = rows(console);
            !shown.is_empty() && shown.iter().all(|(topic, _)| topic == LIVE)
        });
        // What is told is hidden first, and marks go before the filter.
        for _ in 0..3 {
            hide_messages(&mut console);
            console.press("\u{1b}");
        }
        waits_for(&console, "no filter", |console| !console.shown().contains("filter:"));
        console.signal("TERM");
        console.wait(PATIENCE);
    }
}

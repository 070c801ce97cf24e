//! The columns that lists offer, and which are shown.

use crate::app::{screen::Screen, table::Table};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Offered {
    /// Its name, as in `:columns topic,state`.
    pub name: &'static str,
    pub words: &'static str,
    /// The width of the list from which it is usually shown, columns.
    pub from: u16,
}

/// The column every list shows: it carries the cursor.
pub const ALWAYS: &str = "topic";

/// Shown only if chosen.
const NEVER: u16 = u16::MAX;

const fn column(name: &'static str, from: u16, words: &'static str) -> Offered {
    Offered { name, words, from }
}

const TOPICS: &[Offered] = &[
    column("topic", 0, "Name of the topic (always shown)"),
    column("type", 150, "Message type"),
    column("publishers", 170, "Nodes that publish it"),
    column("pinned", 90, "Whether its publishers are pinned"),
    column("watched", 0, "Whether it is captured, or why not"),
    column("kept", NEVER, "How many of its messages are kept: every one, or by a rule"),
    column("hz", 0, "Messages a second"),
    column("rate", 0, "Kilobytes a second"),
    column("line", 110, "The last 16 seconds as a line"),
    column("captured", 130, "Messages captured so far"),
    column("lost", 70, "Messages lost: in transport, in the recorder"),
    column("age", 80, "Time since the last message"),
];

/// Of records: name, widths from which Records and Received show it usually, words.
const RECORDS: [(&str, [Option<u16>; 2], &str); 12] = [
    ("state", [Some(0), Some(0)], "Record state"),
    ("owner", [None, Some(0)], "Who shares it"),
    ("topic", [Some(0), Some(0)], "Name of the topic (always shown)"),
    ("type", [Some(120), Some(120)], "Message type"),
    ("seq", [Some(0), Some(0)], "Number of the record"),
    ("size", [Some(0), Some(0)], "Size of the message"),
    ("time", [Some(0), Some(70)], "When it was captured"),
    ("epoch", [Some(130), Some(130)], "Epoch of its key"),
    ("block", [Some(100), Some(110)], "Block that anchors it"),
    ("id", [Some(140), Some(150)], "Its id"),
    ("digest", [Some(NEVER), Some(NEVER)], "Beginning of its SM3 digest"),
    ("transaction", [Some(NEVER), Some(NEVER)], "Beginning of the transaction's hash"),
];

pub fn offered(screen: Screen) -> Vec<Offered> {
    let of_list = |list: usize| {
        let found = RECORDS.iter().filter_map(|(name, from, words)| Some(column(name, from[list]?, words)));
        found.collect()
    };
    match screen {
        Screen::Topics => TOPICS.to_vec(),
        Screen::Records => of_list(0),
        Screen::Received => of_list(1),
        Screen::Overview | Screen::Grants | Screen::Keys | Screen::Chain | Screen::Robots | Screen::Log => Vec::new(),
    }
}

/// Chosen columns in order, or else the usual ones for that width.
pub fn wanted(screen: Screen, table: &Table, width: u16) -> Vec<&'static str> {
    if !table.columns.is_empty() {
        return table.columns.clone();
    }
    offered(screen).iter().filter(|column| column.from <= width).map(|column| column.name).collect()
}

/// Those `names` that the screen offers, each once, plus [`ALWAYS`].
pub fn known<'a>(screen: Screen, names: impl IntoIterator<Item = &'a str>) -> Result<Vec<&'static str>, &'a str> {
    let mut found: Vec<&'static str> = Vec::new();
    for name in names {
        let column = offered(screen).into_iter().find(|column| column.name == name).ok_or(name)?;
        if !found.contains(&column.name) {
            found.push(column.name);
        }
    }
    if !found.is_empty() && !found.contains(&ALWAYS) {
        found.insert(0, ALWAYS);
    }
    Ok(found)
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ColumnChoice {
    pub selected: usize,
    /// Restored by Esc.
    pub before: Vec<&'static str>,
}

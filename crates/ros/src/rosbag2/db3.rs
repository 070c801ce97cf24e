//! Reads a closed `.db3` file. SQLite opens it as a file that nobody writes: no lock, no file beside it, no disturbed
//! recorder. Only the trees of tables are read, never an index, which might differ. A temporary table of SQLite's gives
//! the order, on disk where it grows: memory holds one message.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::path::{Path, PathBuf};
use std::{os::unix::ffi::OsStrExt as _, sync::Arc, time::SystemTime};

use rusqlite::{Connection, ErrorCode, OpenFlags, OptionalExtension as _, Row, Rows, params};
use rusqlite::{config::DbConfig, types::ValueRef};

use crate::mcap::{Beside, metadata_record};
use crate::model::{Timestamp, clean};
use crate::recording::{
    Channel, Encoding, Findings, MOST_CHANNEL_BYTES, MOST_CHANNELS, RecordedMessage, RecordingReader, TOO_LARGE,
    TYPE_HASH, kept_about, unpacked_body,
};
use crate::{Result, RosError, tcpros::LONGEST_MESSAGE};

const PAGE: i64 = 512;

/// SQLite lists this many faults of a table; at this number nothing is read.
const MOST_FAULTS: usize = 100;

/// No row of messages has fewer bytes.
const SMALLEST_ROW: u64 = 6;

/// Of a topic or definition, bytes.
const LONGEST_TEXT: i64 = 2 << 20;

/// Tables, and the columns that each must have.
const TABLES: [(&str, &[&str]); 2] = [
    ("topics", &["id", "name", "type", "serialization_format"]),
    ("messages", &["id", "topic_id", "timestamp", "data"]),
];

/// A topic's channel, or why its messages cannot be used.
#[derive(Debug)]
struct Topic {
    name: String,
    usable: Result<Arc<Channel>, String>,
}

#[derive(Debug, Clone, Copy)]
struct Place {
    time: i64,
    row: i64,
    topic: i64,
    size: i64,
}

/// Size and time of change, which show a file still being written.
type Stamp = (u64, Option<SystemTime>);

#[derive(Debug)]
pub struct Db3Reader {
    database: Connection,
    /// A database of its own: an error in the recording would undo what was written beside it.
    places: Connection,
    path: PathBuf,
    stamp: Stamp,
    topics: HashMap<i64, Topic>,
    page: VecDeque<Place>,
    last: (i64, i64),
    beside: VecDeque<RecordedMessage>,
    findings: Findings,
    done: u64,
    latest: Timestamp,
    ended: bool,
}

impl RecordingReader for Db3Reader {
    fn next_message(&mut self) -> Result<Option<RecordedMessage>> {
        while !self.ended {
            let Some(place) = self.next_place()? else {
                self.ended = true;
                if stamp(&self.path).is_ok_and(|now| now != self.stamp) {
                    self.findings.note(0, "the file changed while it was read: a recorder still writes it");
                }
                break;
            };
            if let Some(message) = self.message(place) {
                return Ok(Some(message));
            }
        }
        let beside = self.beside.pop_front();
        Ok(beside.map(|message| RecordedMessage { time: self.latest, ..message }))
    }

    fn findings(&self) -> &Findings {
        &self.findings
    }

    fn progress(&self) -> (u64, u64) {
        (self.done.min(self.stamp.0), self.stamp.0)
    }
}

impl Db3Reader {
    pub fn open(path: &Path) -> Result<Self> {
        refuse_journals(path)?;
        let stamp = stamp(path)?;
        let failed = |error: rusqlite::Error| unreadable(path, &error);
        let database = connect(path).map_err(failed)?;
        let columns = columns(&database).map_err(failed)?;
        for (table, needed) in TABLES {
            let found = columns.get(table).map_or(&[][..], Vec::as_slice);
            if !needed.iter().all(|column| found.iter().any(|known| known == column))
                || found.iter().any(|column| column.eq_ignore_ascii_case("rowid"))
            {
                return Err(RosError::recording(&format!(
                    "{} is an SQLite file, but no recording of rosbag2: it has no table '{table}' as rosbag2 makes it",
                    path.display()
                )));
            }
        }
        let mut reader = Self {
            database,
            places: Connection::open("").map_err(failed)?,
            path: path.to_owned(),
            stamp,
            topics: HashMap::new(),
            page: VecDeque::new(),
            last: (i64::MIN, i64::MIN),
            beside: VecDeque::new(),
            findings: Findings::default(),
            done: 0,
            latest: Timestamp(0),
            ended: false,
        };
        if reader.check(&columns).map_err(failed)? {
            reader.read_topics(&columns)?;
            reader.read_places().map_err(failed)?;
            reader.read_beside(&columns);
        } else {
            reader.ended = true;
        }
        Ok(reader)
    }

    /// SQLite checks its trees; `false` if nothing can be read safely.
    fn check(&mut self, columns: &BTreeMap<String, Vec<String>>) -> rusqlite::Result<bool> {
        let mut faults = Vec::new();
        for table in columns.keys() {
            let mut statement = self.database.prepare(&format!("PRAGMA main.quick_check('{table}')"))?;
            let mut rows = statement.query([])?;
            while let Some(row) = rows.next().unwrap_or_else(|error| {
                faults.push(error.to_string());
                None
            }) {
                faults.extend(row.get::<_, String>(0).ok().filter(|fault| fault != "ok"));
            }
        }
        if faults.is_empty() {
            return Ok(true);
        }
        // A page with two references might have any number of them: the trees have no end then.
        let endless = faults.len() >= MOST_FAULTS || faults.iter().any(|fault| fault.contains("2nd reference"));
        let rest = if endless { "nothing of it was read" } else { "what can be read of it was read" };
        self.findings.note(0, &format!("the database is damaged: {rest}"));
        Ok(!endless)
    }

    fn read_topics(&mut self, columns: &BTreeMap<String, Vec<String>>) -> Result<()> {
        let failed = |error: rusqlite::Error| unreadable(&self.path, &error);
        let definitions = definitions(&self.database, columns, &mut self.findings);
        let has = |column: &str| columns.get("topics").is_some_and(|known| known.iter().any(|name| name == column));
        let or_empty = |column: &str| if has(column) { bounded(column) } else { String::from("''") };
        let query = format!(
            "SELECT id, {}, {}, {}, {}, {} FROM main.topics NOT INDEXED LIMIT {}",
            bounded("name"),
            bounded("type"),
            bounded("serialization_format"),
            or_empty("offered_qos_profiles"),
            or_empty("type_description_hash"),
            MOST_CHANNELS + 1
        );
        let mut statement = self.database.prepare(&query).map_err(failed)?;
        let mut rows = statement.query([]).map_err(failed)?;
        let mut bytes = 0;
        while let Some(row) = next_row(&mut rows, "topics", &mut self.findings) {
            let Some(id) = row.get_ref(0).ok().and_then(|value| value.as_i64().ok()) else { continue };
            let [name, type_name, format, qos, hash] = [1, 2, 3, 4, 5].map(|column| text_at(row, column));
            bytes += name.as_deref().map_or(0, str::len) + type_name.as_deref().map_or(0, str::len);
            bytes += qos.as_deref().map_or(0, str::len) + 128;
            if self.topics.len() >= MOST_CHANNELS || bytes > MOST_CHANNEL_BYTES {
                self.findings.note(0, "the file has more topics than can be kept; those after them were left out");
                break;
            }
            let about = [("offered_qos_profiles", qos), (TYPE_HASH, hash)];
            let about =
                about.into_iter().filter_map(|(key, value)| Some((key, value.filter(|text| !text.is_empty())?)));
            let (about, whole) = kept_about(about.map(|(key, value)| (Arc::from(key), Arc::from(value))));
            if !whole {
                self.findings.note(0, "a topic's metadata is too long to keep");
            }
            let shown = name.clone().unwrap_or_default();
            let usable = channel(name, type_name, format.as_deref(), about, &definitions).map(Arc::new);
            self.topics.insert(id, Topic { name: shown, usable });
        }
        Ok(())
    }

    /// Sorts the places of all messages by time, in a table of their own.
    fn read_places(&mut self) -> rusqlite::Result<()> {
        self.places.execute_batch(
            "CREATE TABLE places(time INTEGER, row INTEGER, topic INTEGER, size INTEGER, PRIMARY KEY(time, row)) \
             WITHOUT ROWID; BEGIN",
        )?;
        let most = self.stamp.0 / SMALLEST_ROW + 1;
        let query = format!(
            "SELECT rowid, topic_id, timestamp, octet_length(data), typeof(data) FROM main.messages NOT INDEXED LIMIT {most}"
        );
        {
            let mut statement = self.database.prepare(&query)?;
            let mut rows = statement.query([])?;
            let mut put = self.places.prepare("INSERT OR IGNORE INTO places VALUES(?1, ?2, ?3, ?4)")?;
            while let Some(row) = next_row(&mut rows, "messages", &mut self.findings) {
                let number = |column| row.get_ref(column).ok().and_then(|value| value.as_i64().ok());
                let name =
                    || number(1).and_then(|topic| self.topics.get(&topic)).map_or("", |topic| topic.name.as_str());
                let is_blob = row.get_ref(4).is_ok_and(|kind| kind.as_bytes().is_ok_and(|kind| kind == b"blob"));
                let (Some(row_number), Some(topic), Some(time), Some(size), true) =
                    (number(0), number(1), number(2), number(3), is_blob)
                else {
                    self.findings.leave_out(name(), "its row is not as rosbag2 writes it");
                    continue;
                };
                if time < 0 {
                    self.findings.leave_out(name(), "its time lies before 1970");
                } else if put.execute(params![time, row_number, topic, size])? == 0 {
                    self.findings.leave_out(name(), "its row is duplicated");
                }
            }
        }
        self.places.execute_batch("COMMIT")
    }

    /// rosbag2's notes about the recording, in the form of its MCAP files.
    fn read_beside(&mut self, columns: &BTreeMap<String, Vec<String>>) {
        if !columns.get("metadata").is_some_and(|known| known.iter().any(|name| name == "metadata")) {
            return;
        }
        let query = format!("SELECT {} FROM main.metadata NOT INDEXED ORDER BY rowid LIMIT 64", bounded("metadata"));
        let texts = self.database.prepare(&query).and_then(|mut statement| {
            statement.query_map([], |row| Ok(text_at(row, 0)))?.collect::<rusqlite::Result<Vec<_>>>()
        });
        let Ok(texts) = texts else {
            self.findings.note(0, "the table of metadata cannot be read");
            return;
        };
        for text in texts {
            let Some(text) = text else {
                self.findings.note(0, "a row of metadata is too long or no text; it was skipped");
                continue;
            };
            self.findings.unguarded += 1;
            let body = metadata_record("rosbag2", &[("serialized_metadata", &text)]);
            let channel = Arc::new(Beside::Metadata.channel());
            self.beside.push_back(RecordedMessage { channel, time: Timestamp(0), sent: None, body });
        }
    }

    fn next_place(&mut self) -> Result<Option<Place>> {
        if self.page.is_empty() {
            let failed = |error: rusqlite::Error| unreadable(&self.path, &error);
            let query = "SELECT time, row, topic, size FROM places WHERE (time, row) > (?1, ?2) \
                         ORDER BY time, row LIMIT ?3";
            let mut statement = self.places.prepare_cached(query).map_err(failed)?;
            let rows = statement.query_map(params![self.last.0, self.last.1, PAGE], |row| {
                Ok(Place { time: row.get(0)?, row: row.get(1)?, topic: row.get(2)?, size: row.get(3)? })
            });
            self.page = rows.and_then(Iterator::collect).map_err(failed)?;
        }
        let place = self.page.pop_front();
        if let Some(place) = place {
            self.last = (place.time, place.row);
        }
        Ok(place)
    }

    fn message(&mut self, place: Place) -> Option<RecordedMessage> {
        self.done += u64::try_from(place.size).unwrap_or_default();
        let Some(topic) = self.topics.get(&place.topic) else {
            self.findings.leave_out("", &format!("its topic {} is not described anywhere in the file", place.topic));
            return None;
        };
        match self.read(topic, place) {
            Ok(message) => {
                self.latest = message.time;
                self.findings.unguarded += 1;
                Some(message)
            }
            Err(why) => {
                self.findings.leave_out(&topic.name, &why);
                None
            }
        }
    }

    fn read(&self, topic: &Topic, place: Place) -> Result<RecordedMessage, String> {
        let channel = topic.usable.clone()?;
        if usize::try_from(place.size).map_or(true, |size| size > LONGEST_MESSAGE) {
            return Err(TOO_LARGE.to_owned());
        }
        let body = self.body(place.row)?.ok_or_else(|| String::from("its row cannot be found again"))?;
        let (body, time) = (unpacked_body(channel.encoding, body)?, u64::try_from(place.time).unwrap_or_default());
        Ok(RecordedMessage { channel, time: Timestamp(time), sent: None, body })
    }

    fn body(&self, row: i64) -> Result<Option<Vec<u8>>, String> {
        let query = "SELECT data FROM main.messages NOT INDEXED WHERE rowid = ?1";
        let read = self.database.prepare_cached(query).and_then(|mut statement| {
            statement.query_row([row], |row| Ok(row.get_ref(0)?.as_blob().map(<[u8]>::to_vec).ok())).optional()
        });
        read.map(Option::flatten).map_err(|error| told(&error).to_owned())
    }
}

/// A row that cannot be read is damage.
fn next_row<'a, 'b>(rows: &'a mut Rows<'b>, table: &str, findings: &mut Findings) -> Option<&'a Row<'b>> {
    rows.next().unwrap_or_else(|error| {
        findings.note(0, &format!("the table of {table} cannot be read to its end: {}", told(&error)));
        None
    })
}

fn bounded(column: &str) -> String {
    format!("CASE WHEN octet_length({column}) <= {LONGEST_TEXT} THEN {column} END")
}

fn text_at(row: &Row<'_>, column: usize) -> Option<String> {
    match row.get_ref(column) {
        Ok(ValueRef::Text(text)) => String::from_utf8(text.to_vec()).ok(),
        _ => None,
    }
}

/// Encoding and text of each type, by name.
type Definitions = HashMap<String, (String, String)>;

fn definitions(database: &Connection, columns: &BTreeMap<String, Vec<String>>, findings: &mut Findings) -> Definitions {
    let mut kept = Definitions::new();
    // Recorders before Iron write none.
    if !columns.contains_key("message_definitions") {
        return kept;
    }
    let query = format!(
        "SELECT {}, {}, {} FROM main.message_definitions NOT INDEXED LIMIT {MOST_CHANNELS}",
        bounded("topic_type"),
        bounded("encoding"),
        bounded("encoded_message_definition")
    );
    let mut bytes = 0;
    let read = database.prepare(&query).and_then(|mut statement| {
        let mut rows = statement.query([])?;
        while let Some(row) = rows.next()? {
            let [name, encoding, text] = [0, 1, 2].map(|column| text_at(row, column));
            let (Some(name), Some(encoding), Some(text)) = (name, encoding, text) else { continue };
            bytes += name.len() + text.len() + 64;
            if bytes > MOST_CHANNEL_BYTES {
                break;
            }
            kept.entry(name).or_insert((encoding, text));
        }
        Ok(())
    });
    if read.is_err() || bytes > MOST_CHANNEL_BYTES {
        findings.note(0, "the table of definitions cannot be read to its end; types without one are shown as bytes");
    }
    kept
}

fn channel(
    name: Option<String>,
    type_name: Option<String>,
    format: Option<&str>,
    about: BTreeMap<Arc<str>, Arc<str>>,
    definitions: &Definitions,
) -> Result<Channel, String> {
    let not_text = |what: &str| format!("the {what} of its topic is too long or no text");
    let name = name.ok_or_else(|| not_text("name"))?;
    let type_name = type_name.ok_or_else(|| not_text("type"))?;
    match format {
        Some("cdr") => {}
        Some(other) => return Err(format!("its serialization format is '{}'; only cdr can be read", clean(other, 60))),
        None => return Err(not_text("serialization format")),
    }
    let described = definitions.get(&type_name).filter(|(known, _)| matches!(known.as_str(), "ros2msg" | "ros2idl"));
    let (idl, definition) = described.map_or((false, ""), |(known, text)| (known == "ros2idl", text.as_str()));
    let encoding = Encoding::Cdr { idl };
    Ok(Channel::plain((&name, &type_name, definition), encoding, about))
}

fn unreadable(path: &Path, error: &rusqlite::Error) -> RosError {
    RosError::recording(&format!("{} cannot be read as SQLite: {}", path.display(), told(error)))
}

/// Hides SQLite's own words.
fn told(error: &rusqlite::Error) -> &'static str {
    match error.sqlite_error_code() {
        Some(ErrorCode::NotADatabase) => "it is not a database, or its first page is damaged",
        Some(ErrorCode::DatabaseCorrupt) => "it is damaged there",
        Some(ErrorCode::CannotOpen | ErrorCode::PermissionDenied) => "it cannot be opened",
        Some(ErrorCode::SystemIoFailure) => "the disk does not give its bytes",
        Some(ErrorCode::DiskFull) => "there is no room for temporary files; name a larger folder in TMPDIR",
        _ => "it is not as a recorder writes it",
    }
}

fn stamp(path: &Path) -> Result<Stamp> {
    let found =
        std::fs::metadata(path).map_err(|error| RosError::recording(&format!("{}: {error}", path.display())))?;
    Ok((found.len(), found.modified().ok()))
}

/// A journal beside the file that is not empty.
fn journal(path: &Path) -> Option<PathBuf> {
    ["-wal", "-journal"].into_iter().find_map(|end| {
        let mut beside = path.as_os_str().to_owned();
        beside.push(end);
        let beside = PathBuf::from(beside);
        std::fs::symlink_metadata(&beside).is_ok_and(|found| found.len() > 0).then_some(beside)
    })
}

/// A recorder writes the file, or was killed while it did.
pub fn has_journal(path: &Path) -> bool {
    journal(path).is_some()
}

fn refuse_journals(path: &Path) -> Result<()> {
    let Some(beside) = journal(path) else { return Ok(()) };
    Err(RosError::recording(&format!(
        "{} has a journal beside it ({}): a recorder still writes it, or was killed; wait until it has finished, or \
         open a copy of both with `sqlite3 COPY.db3 .schema`, which applies the journal, and import the copy",
        path.display(),
        beside.display()
    )))
}

/// Runs nothing in the file's schema.
fn connect(path: &Path) -> rusqlite::Result<Connection> {
    let mut uri = String::from("file:");
    for byte in path.as_os_str().as_bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'/' | b'.' | b'-' | b'_' => uri.push(char::from(*byte)),
            other => uri.push_str(&format!("%{other:02x}")),
        }
    }
    uri.push_str("?immutable=1&mode=ro");
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_URI | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let database = Connection::open_with_flags(uri, flags)?;
    database.set_db_config(DbConfig::SQLITE_DBCONFIG_TRUSTED_SCHEMA, false)?;
    database.set_db_config(DbConfig::SQLITE_DBCONFIG_DEFENSIVE, true)?;
    database.set_db_config(DbConfig::SQLITE_DBCONFIG_ENABLE_TRIGGER, false)?;
    database.set_db_config(DbConfig::SQLITE_DBCONFIG_ENABLE_VIEW, false)?;
    database
        .execute_batch("PRAGMA temp_store = FILE; PRAGMA cell_size_check = ON; PRAGMA ignore_check_constraints = ON")?;
    Ok(database)
}

/// Of the plain tables that rosbag2 makes, not of views and virtual tables.
fn columns(database: &Connection) -> rusqlite::Result<BTreeMap<String, Vec<String>>> {
    let mut tables = BTreeMap::new();
    for table in ["topics", "messages", "message_definitions", "metadata"] {
        let query = "SELECT count(*) FROM main.sqlite_schema WHERE type = 'table' AND name = ?1 AND rootpage > 0 \
                     AND sql LIKE 'CREATE TABLE %'";
        if database.query_row(query, [table], |row| row.get::<_, i64>(0))? == 0 {
            continue;
        }
        let mut statement = database.prepare("SELECT name, hidden FROM pragma_table_xinfo(?1, 'main') LIMIT 64")?;
        let rows = statement.query_map([table], |row| Ok((row.get(0)?, row.get::<_, i64>(1)?)))?;
        let rows = rows.collect::<rusqlite::Result<Vec<(String, i64)>>>()?;
        // A computed column would run what the file says.
        if rows.iter().all(|(_, hidden)| *hidden == 0) {
            tables.insert(table.to_owned(), rows.into_iter().map(|(name, _)| name).collect());
        }
    }
    Ok(tables)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCHEMA: &str = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, \
        serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL); \
        CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data BLOB NOT NULL); \
        CREATE INDEX timestamp_idx ON messages (timestamp ASC); \
        INSERT INTO topics VALUES(1, '/a', 'std_msgs/msg/String', 'cdr', '- depth: 1'), (2, '/x', 'a/msg/B', 'rtps', '');";

    struct Made {
        folder: tempfile::TempDir,
    }

    impl Made {
        fn of(schema: &str) -> Self {
            let folder = tempfile::tempdir().expect("a folder");
            let made = Self { folder };
            Connection::open(made.path()).expect("opened").execute_batch(schema).expect("made");
            made
        }

        fn path(&self) -> PathBuf {
            self.folder.path().join("a b%#?.db3")
        }

        fn read(&self) -> (Vec<(String, u64, Vec<u8>)>, Findings) {
            let mut reader = Db3Reader::open(&self.path()).expect("opened");
            let mut found = Vec::new();
            while let Some(message) = reader.next_message().expect("read") {
                found.push((message.channel.topic.to_string(), message.time.0, message.body));
            }
            (found, reader.findings().clone())
        }

        fn refusal(&self) -> String {
            Db3Reader::open(&self.path()).err().map(|error| error.to_string()).unwrap_or_default()
        }
    }

    #[test]
    fn messages_come_by_time_and_what_stays_out_has_topic_reason_and_count() {
        let rows = "INSERT INTO messages VALUES(1, 1, 30, x'0001'), (2, 1, 10, x'0002'), (3, 2, 20, x'00'), \
                    (4, 9, 20, x'00'), (5, 1, -1, x'00'), (6, 1, 40, 'text'), (7, 1, 10, x'0003');";
        let (found, findings) = Made::of(&format!("{SCHEMA}{rows}")).read();
        let expected =
            [(10, vec![0, 2]), (10, vec![0, 3]), (30, vec![0, 1])].map(|(time, body)| ("/a".to_owned(), time, body));
        assert_eq!(found, expected);
        let mut why: Vec<_> = findings.unusable.iter().map(|row| (row.topic.as_str(), row.why.as_str())).collect();
        why.sort_unstable();
        assert_eq!(findings.messages_skipped(), 4);
        assert!(
            matches!(&why[..], [("", number), ("/a", row), ("/a", before), ("/x", format)]
            if number.contains("topic 9") && before.contains("1970") && row.contains("its row") && format.contains("'rtps'")),
            "{why:?}"
        );
        assert_eq!(findings.unguarded, 3, "SQLite has no checksums");
    }

    #[test]
    fn what_was_compressed_message_by_message_is_unpacked() {
        use crate::ros::recording::{ChunkCompression, pack};
        let hex = |bytes: &[u8]| bytes.iter().map(|byte| format!("{byte:02x}")).collect::<String>();
        let packed = pack(ChunkCompression::Zstd, &[0, 1, 0, 0, 42]).expect("packed");
        let rows = format!("INSERT INTO messages VALUES(1, 1, 1, x'{}'), (2, 1, 2, x'28b52ffd00');", hex(&packed));
        let (found, findings) = Made::of(&format!("{SCHEMA}{rows}")).read();
        assert_eq!(found, [("/a".to_owned(), 1, vec![0, 1, 0, 0, 42])]);
        assert!(findings.unusable[0].why.contains("zstd"), "{findings:?}");
    }

    #[test]
    fn views_virtual_tables_and_other_files_are_no_recording() {
        for schema in [
            "CREATE TABLE other(x)",
            "CREATE TABLE topics(id, name, type, serialization_format); CREATE TABLE m(id, topic_id, timestamp, data); \
             CREATE VIEW messages AS SELECT * FROM m",
            "CREATE TABLE topics(id, name, type, serialization_format); \
             CREATE TABLE messages(id, topic_id, timestamp, x, data AS (zeroblob(1000000000)))",
        ] {
            let said = Made::of(schema).refusal();
            assert!(said.contains("no recording of rosbag2"), "{said}");
        }
    }

    #[test]
    fn a_file_with_a_journal_is_refused_and_left_alone() {
        let made = Made::of(SCHEMA);
        for end in ["-wal", "-journal"] {
            let mut beside = made.path().into_os_string();
            beside.push(end);
            std::fs::write(&beside, "x").expect("written");
            let said = made.refusal();
            assert!(said.contains("a recorder still writes it") && said.contains(end), "{said}");
            std::fs::remove_file(&beside).expect("removed");
        }
        made.read();
        let names = std::fs::read_dir(made.folder.path()).expect("listed").count();
        assert_eq!(names, 1, "nothing is made beside it");
    }

    #[test]
    fn a_damaged_index_changes_nothing_and_a_damaged_tree_is_told() {
        let rows: String = (0..2000)
            .map(|number| format!("INSERT INTO messages VALUES({number}, 1, {number}, zeroblob(300));"))
            .collect();
        let made = Made::of(&format!("{SCHEMA}BEGIN;{rows}COMMIT;"));
        let bytes = std::fs::read(made.path()).expect("read");
        assert_eq!(made.read().0.len(), 2000);
        let (mut told, mut refused) = (0, 0);
        for page in 1..bytes.len() / 4096 {
            let mut altered = bytes.clone();
            altered[page * 4096..(page + 1) * 4096].fill(0);
            std::fs::write(made.path(), &altered).expect("written");
            // Without the table of topics nothing is a message of any.
            if Db3Reader::open(&made.path()).is_err() {
                assert!(made.refusal().contains("cannot be read as SQLite"), "page {page}");
                refused += 1;
                continue;
            }
            let (found, findings) = made.read();
            assert!(found.len() == 2000 || !findings.is_whole(), "page {page}: {} messages", found.len());
            told += usize::from(!findings.is_whole());
        }
        assert!(told > 10 && refused <= 1, "{told}, {refused} refused");
    }
}

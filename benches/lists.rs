//! What a page of the console's lists and a frame of its screens cost while the ledger grows from 10^3 to 10^6
//! records of 2,000 topics. `cargo bench --bench lists`; an argument gives the most records.

#![allow(
    clippy::expect_used,
    clippy::print_stdout,
    missing_docs,
    reason = "a benchmark that cannot go on stops, and prints its figures"
)]

use std::time::{Duration, Instant};

use authros::app::{Action, Key, Screen, Settings, State, Verb, update};
use authros::model::{Address, Digest, RecordKind, RecordState, Signature, SignerId, Timestamp, TopicId, clean};
use authros::service::reply::{RecordPage, RecordView, TopicRow};
use authros::service::{Reply, UploadQuery};
use authros::store::{Ledger, NewRecord, RecordQuery};
use authros::ui::{Theme, draw};
use ratatui::Terminal;
use ratatui::backend::TestBackend;

const OWNER: Address = Address([1; 20]);
const TOPICS: u64 = 2_000;
const BATCH: u64 = 5_000;
const ROUNDS: u32 = 21;

fn record(number: u64) -> NewRecord {
    let topic = number % TOPICS;
    let mut digest = [0; 32];
    digest[..8].copy_from_slice(&number.wrapping_mul(0x9e37_79b9_7f4a_7c15).to_be_bytes());
    digest[24..].copy_from_slice(&number.to_be_bytes());
    let mut topic_id = [0; 16];
    topic_id[..8].copy_from_slice(&topic.to_be_bytes());
    NewRecord {
        digest: Digest(digest),
        owner: OWNER,
        topic_id: TopicId(topic_id),
        seq: number / TOPICS + 1,
        foreign: None,
        epoch: 1,
        kind: RecordKind::Data,
        signer: SignerId([1; 32]),
        signature: Signature([7; 64]),
        filters: Vec::new(),
        topic: format!("/robot{}/sensor{}/data", topic / 20, topic % 20),
        type_name: if topic.is_multiple_of(20) { "nav_msgs/Odometry" } else { "sensor_msgs/LaserScan" }.to_owned(),
        bytes: 728,
        captured_at: Timestamp(1_700_000_000_000_000_000 + number * 1_000_000),
        simulated: true,
        state: if number.is_multiple_of(1_000) { RecordState::Quarantined } else { RecordState::Stored },
        local_copy: None,
    }
}

/// The middle one of a few runs, milliseconds.
fn median(mut run: impl FnMut()) -> f64 {
    let mut times: Vec<Duration> = (0..ROUNDS)
        .map(|_| {
            let begun = Instant::now();
            run();
            begun.elapsed()
        })
        .collect();
    times.sort();
    times[times.len() / 2].as_secs_f64() * 1e3
}

fn pages(ledger: &Ledger) -> Vec<(&'static str, f64)> {
    let newest = RecordQuery { owner: Some(OWNER), newest_first: true, limit: 18, ..RecordQuery::default() };
    let data = RecordQuery { kind: Some(RecordKind::Data), ..newest.clone() };
    let second = RecordQuery { after: ledger.list(&data).expect("page").next, ..data.clone() };
    let topic = RecordQuery { topic: Some("/robot3/sensor0/data".to_owned()), ..data.clone() };
    let held = RecordQuery { state: Some(RecordState::Quarantined), ..data.clone() };
    let none = RecordQuery { state: Some(RecordState::Tampered), ..data.clone() };
    let time = RecordQuery { until: Some(Timestamp(1_700_000_000_500_000_000)), ..data.clone() };
    let asked = [("page", data), ("next", second), ("topic", topic), ("held", held), ("none", none), ("time", time)];
    let mut figures: Vec<_> =
        asked.iter().map(|(name, query)| (*name, median(|| drop(ledger.list(query).expect("page"))))).collect();
    figures.push(("counts", median(|| drop(ledger.counts(Some(OWNER)).expect("counts")))));
    figures
}

fn view(row: &authros::store::RecordRow) -> RecordView {
    RecordView {
        id: row.id.clone(),
        owner: None,
        owner_name: None,
        seq: row.seq,
        topic: clean(&row.topic, 255),
        type_name: row.type_name.clone(),
        kind: row.kind.word().to_owned(),
        state: row.state.word().to_owned(),
        digest: row.digest,
        bytes: row.bytes,
        captured_at: row.captured_at,
        epoch: row.epoch,
        simulated: row.simulated,
        transaction: row.transaction,
        block: row.block,
    }
}

fn topics() -> Vec<TopicRow> {
    (0..TOPICS)
        .map(|number| {
            let record = record(number);
            let json = serde_json::json!({
                "topic": record.topic, "type": record.type_name, "publishers": ["/driver"], "watched": true,
                "simulated": true, "hz": 20.0, "bytes_per_second": 14_400.0, "messages": 500, "lost_in_transport": 0,
                "lost_in_recorder": 0, "last_message": null,
            });
            serde_json::from_value(json).expect("a row")
        })
        .collect()
}

/// A console at 200x50 on a screen, with the page that the ledger gives.
fn console(ledger: &Ledger, screen: Screen) -> State {
    let mut state = State::new(Settings::default());
    update(&mut state, Action::Tick(Timestamp(1_800_000_000_000_000_000)));
    update(&mut state, Action::Resize { columns: 200, rows: 50 });
    update(&mut state, Action::Do(Verb::Go(screen)));
    state.topics.set(topics(), Timestamp(1_800_000_000_000_000_000));
    let query = UploadQuery { limit: state.page_rows(), newest_first: true, ..UploadQuery::default() };
    let page = RecordQuery { owner: Some(OWNER), newest_first: true, limit: query.limit, ..RecordQuery::default() };
    let page = ledger.list(&page).expect("page");
    let records = page.rows.iter().map(view).collect();
    state.uploads.set(RecordPage { records, next: page.next }, query.limit);
    state
}

fn frames(ledger: &Ledger) -> Vec<(&'static str, f64)> {
    let theme = Theme::named("night").expect("a theme");
    let mut figures = Vec::new();
    for (name, screen) in [("overview", Screen::Overview), ("topics", Screen::Topics), ("uploads", Screen::Uploads)] {
        let mut state = console(ledger, screen);
        let mut terminal = Terminal::new(TestBackend::new(200, 50)).expect("a terminal");
        figures.push((
            name,
            median(|| {
                terminal.draw(|frame| draw(frame, &state, &theme)).expect("drawn");
            }),
        ));
        if screen == Screen::Topics {
            figures.push(("key", median(|| drop(update(&mut state, Action::Key(Key::Down))))));
            let rows = topics();
            figures.push((
                "rows in",
                median(|| {
                    state.topics.set(rows.clone(), state.now);
                }),
            ));
            for key in ['/', 'r', '7', '7'] {
                update(&mut state, Action::Key(Key::Char(key)));
            }
            figures.push((
                "filter",
                median(|| {
                    drop(update(&mut state, Action::Key(Key::Char('x'))));
                    drop(update(&mut state, Action::Key(Key::Backspace)));
                }),
            ));
            figures.push((
                "filtered",
                median(|| {
                    terminal.draw(|frame| draw(frame, &state, &theme)).expect("drawn");
                }),
            ));
        }
    }
    let answer = Reply::Topics(topics());
    figures.push(("encode", median(|| drop(serde_json::to_vec(&answer).expect("json")))));
    figures
}

fn print(records: u64, what: &str, figures: &[(&str, f64)]) {
    let line: Vec<String> = figures.iter().map(|(name, time)| format!("{name} {time:.2}")).collect();
    println!("{records:>9} records  {what:<7} ms: {}", line.join("  "));
}

fn main() {
    let most = std::env::args().skip(1).find_map(|argument| argument.parse().ok()).unwrap_or(1_000_000);
    let home = tempfile::tempdir().expect("a directory");
    let ledger = Ledger::open(&home.path().join("ledger.db")).expect("opens");
    let mut there = 0;
    for wanted in [1_000, 10_000, 100_000, 1_000_000].into_iter().filter(|wanted| *wanted <= most) {
        let begun = Instant::now();
        while there < wanted {
            let end = wanted.min(there + BATCH);
            ledger.append((there..end).map(record).collect()).expect("acknowledged");
            there = end;
        }
        println!("{wanted:>9} records  filled in {:.1} s", begun.elapsed().as_secs_f64());
        print(wanted, "ledger", &pages(&ledger));
        print(wanted, "console", &frames(&ledger));
    }
}

//! Active alerts and waiting deliveries in an append-only file: notes survive a kill, truncated lines are ignored.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fs::OpenOptions;
use std::io::Write as _;
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::rules::{Judged, Level};
use super::{Delivery, News};
use crate::model::Timestamp;
use crate::reply::AlertView;
use crate::store::files::atomic_write;

/// Beyond this the oldest are dropped and counted.
const MOST_WAITING: usize = 200;
/// Lines after which the file is rewritten.
const MOST_LINES: usize = 500;
/// Bytes, many times what the limits above need.
const LONGEST: u64 = 16 << 20;

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Line {
    Numbered(u64),
    Stand(Vec<AlertView>),
    Waits(Delivery),
    Done { number: u64, told: u64 },
    GivenUp(u64),
    Dropped(u64),
}

#[derive(Debug, Clone, Default, PartialEq, Eq)]
struct Kept {
    numbered: u64,
    standing: BTreeMap<String, AlertView>,
    waiting: VecDeque<Delivery>,
    dropped: u64,
}

impl Kept {
    fn apply(&mut self, line: Line) {
        match line {
            Line::Numbered(number) => self.numbered = self.numbered.max(number),
            Line::Stand(alerts) => {
                self.standing = alerts.into_iter().map(|alert| (alert.key.clone(), alert)).collect();
            }
            Line::Waits(delivery) => {
                self.numbered = self.numbered.max(delivery.number);
                match delivery.state {
                    News::Begun => drop(self.standing.insert(delivery.alert.key.clone(), delivery.alert.clone())),
                    News::Resolved => drop(self.standing.remove(&delivery.alert.key)),
                    News::Test => {}
                }
                self.waiting.push_back(delivery);
            }
            Line::Done { number, told } => {
                self.waiting.retain(|delivery| delivery.number != number);
                self.dropped = self.dropped.saturating_sub(told);
            }
            Line::GivenUp(number) => {
                self.waiting.retain(|delivery| delivery.number != number);
                self.dropped += 1;
            }
            Line::Dropped(count) => self.dropped = count,
        }
    }

    fn lines(&self) -> Vec<Line> {
        let mut lines = vec![Line::Numbered(self.numbered), Line::Dropped(self.dropped)];
        lines.extend(self.waiting.iter().cloned().map(Line::Waits));
        // After the waiting ones, which may have begun or ended alerts since.
        lines.push(Line::Stand(self.standing.values().cloned().collect()));
        lines
    }
}

#[derive(Debug)]
pub struct Queue {
    path: PathBuf,
    kept: Kept,
    lines: usize,
    /// The file ends within a line or could not be written: the next note rewrites it.
    torn: bool,
}

impl Queue {
    pub fn open(path: &Path) -> Self {
        let too_long = std::fs::metadata(path).is_ok_and(|about| about.len() > LONGEST);
        let bytes = if too_long { Vec::new() } else { std::fs::read(path).unwrap_or_default() };
        let whole = bytes.iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1);
        let (mut kept, mut lines, mut torn) = (Kept::default(), 0, too_long || whole < bytes.len());
        for line in bytes.get(..whole).unwrap_or_default().split_inclusive(|byte| *byte == b'\n') {
            lines += 1;
            match serde_json::from_slice(line) {
                Ok(line) => kept.apply(line),
                Err(_) => torn = true,
            }
        }
        Self { path: path.to_owned(), kept, lines, torn }
    }

    pub fn standing(&self) -> Vec<AlertView> {
        self.kept.standing.values().cloned().collect()
    }

    pub fn counts(&self) -> (u64, u64) {
        (u64::try_from(self.kept.waiting.len()).unwrap_or(u64::MAX), self.kept.dropped)
    }

    pub fn first(&self) -> Option<(Delivery, u64)> {
        Some((self.kept.waiting.front()?.clone(), self.kept.dropped))
    }

    pub fn add(&mut self, change: Change) {
        let (state, alert, ended) = match change {
            Change::Begun(alert) => (News::Begun, alert, None),
            Change::Resolved(alert, at) => (News::Resolved, alert, Some(at)),
        };
        self.wait(state, alert, ended);
    }

    /// For a destination that forgets alerts unless reminded.
    pub fn remind(&mut self) {
        for alert in self.standing() {
            self.wait(News::Begun, alert, None);
        }
    }

    pub fn next_number(&mut self) -> u64 {
        let number = self.kept.numbered + 1;
        self.note(Line::Numbered(number));
        number
    }

    fn wait(&mut self, state: News, alert: AlertView, ended: Option<Timestamp>) {
        // The first may be in flight.
        if self.kept.waiting.len() >= MOST_WAITING
            && let Some(oldest) = self.kept.waiting.get(1).map(|delivery| delivery.number)
        {
            self.note(Line::GivenUp(oldest));
        }
        let number = self.kept.numbered + 1;
        self.note(Line::Waits(Delivery { number, state, alert, ended }));
    }

    pub fn done(&mut self, number: u64, told: u64) {
        self.note(Line::Done { number, told });
    }

    pub fn give_up(&mut self) -> Option<String> {
        let (number, key) = self.kept.waiting.front().map(|first| (first.number, first.alert.key.clone()))?;
        self.note(Line::GivenUp(number));
        Some(key)
    }

    /// On a failed write, delivery continues; the file is rewritten as soon as possible.
    fn note(&mut self, line: Line) {
        let text = serde_json::to_string(&line).unwrap_or_default();
        self.kept.apply(line);
        self.torn = self.torn || self.append(&text).is_err();
        self.lines += 1;
        if self.torn || self.lines > MOST_LINES {
            self.write_anew();
        }
    }

    fn append(&self, text: &str) -> std::io::Result<()> {
        let mut file = OpenOptions::new().append(true).create(true).mode(0o600).open(&self.path)?;
        file.write_all(format!("{text}\n").as_bytes())?;
        file.sync_data()
    }

    fn write_anew(&mut self) {
        let lines = self.kept.lines();
        let text: String = lines.iter().map(|line| serde_json::to_string(line).unwrap_or_default() + "\n").collect();
        self.torn = atomic_write(&self.path, text.as_bytes()).is_err();
        self.lines = lines.len();
    }
}

/// Quiet looks before an alert ends.
const CALM_LOOKS: u8 = 2;

#[derive(Debug, Default)]
pub struct Standing {
    alerts: BTreeMap<String, Stands>,
}

#[derive(Debug)]
struct Stands {
    alert: AlertView,
    calm: u8,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Change {
    Begun(AlertView),
    Resolved(AlertView, Timestamp),
}

impl Standing {
    pub fn of(alerts: impl IntoIterator<Item = AlertView>) -> Self {
        let stands = |alert: AlertView| (alert.key.clone(), Stands { alert, calm: 0 });
        Self { alerts: alerts.into_iter().map(stands).collect() }
    }

    pub fn all(&self) -> Vec<AlertView> {
        self.alerts.values().map(|stands| stands.alert.clone()).collect()
    }

    pub fn look(&mut self, now: Timestamp, site: &str, judged: Vec<Judged>) -> Vec<Change> {
        let mut well: BTreeSet<String> = self.alerts.keys().cloned().collect();
        let mut changes = Vec::new();
        for Judged { key, severity, level, text } in judged {
            if level != Level::Clear {
                well.remove(&key);
            }
            match (self.alerts.get_mut(&key), level) {
                (Some(stands), Level::Firing) => {
                    stands.calm = 0;
                    stands.alert.text = text;
                }
                (Some(stands), Level::Between) => stands.calm = 0,
                (None, Level::Firing) => {
                    let alert = AlertView { key: key.clone(), severity, text, site: site.to_owned(), begun: now };
                    changes.push(Change::Begun(alert.clone()));
                    self.alerts.insert(key, Stands { alert, calm: 0 });
                }
                (None, Level::Between) | (_, Level::Clear) => {}
            }
        }
        changes.extend(well.iter().filter_map(|key| self.calmed(key)).map(|alert| Change::Resolved(alert, now)));
        changes
    }

    fn calmed(&mut self, key: &str) -> Option<AlertView> {
        let stands = self.alerts.get_mut(key)?;
        stands.calm += 1;
        if stands.calm < CALM_LOOKS {
            return None;
        }
        self.alerts.remove(key).map(|stands| stands.alert)
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;
    use crate::alerts::queue::state_tests::alert;

    fn at(second: u64) -> Timestamp {
        Timestamp::from_seconds(1_700_000_000 + second)
    }

    fn file() -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("alerts.queue");
        (folder, path)
    }

    #[test]
    fn a_test_takes_a_number_that_no_delivery_gets_again() {
        let (_folder, path) = file();
        let mut queue = Queue::open(&path);
        assert_eq!((queue.next_number(), queue.next_number()), (1, 2));
        let mut queue = Queue::open(&path);
        queue.add(Change::Begun(alert("disk")));
        assert_eq!(queue.first().map(|(delivery, _)| delivery.number), Some(3));
    }

    #[test]
    fn a_file_that_was_cut_anywhere_holds_all_its_whole_lines_and_goes_on() {
        let (_folder, path) = file();
        let mut queue = Queue::open(&path);
        let mut known = vec![queue.kept.clone()];
        let mut step = |work: &dyn Fn(&mut Queue)| {
            work(&mut queue);
            known.push(queue.kept.clone());
        };
        step(&|queue| queue.add(Change::Begun(alert("disk"))));
        step(&|queue| queue.add(Change::Begun(alert("store"))));
        step(&|queue| queue.done(1, 0));
        step(&|queue| queue.add(Change::Resolved(alert("disk"), at(9))));
        step(&|queue| queue.note(Line::GivenUp(2)));
        step(&|queue| queue.done(3, 1));
        let bytes = std::fs::read(&path).expect("the file");
        assert_eq!(std::fs::metadata(&path).expect("it").permissions().mode() & 0o777, 0o600);
        assert_eq!(known.last().expect("some").standing.keys().collect::<Vec<_>>(), ["store"]);
        for cut in 0..=bytes.len() {
            std::fs::write(&path, &bytes[..cut]).expect("cut");
            let whole = bytes[..cut].split(|byte| *byte == b'\n').count() - 1;
            let mut queue = Queue::open(&path);
            assert_eq!(queue.kept, known[whole], "cut at {cut}");
            queue.add(Change::Begun(alert("clock")));
            assert!(!queue.torn);
            assert_eq!(Queue::open(&path).kept, queue.kept, "cut at {cut}");
        }
    }

    #[test]
    fn it_is_bounded_and_what_was_given_up_is_told_with_the_next_that_is_taken() {
        let (_folder, path) = file();
        let mut queue = Queue::open(&path);
        for number in 0..MOST_WAITING + 3 {
            queue.add(Change::Begun(alert(&format!("robot_silent/{number}"))));
        }
        assert_eq!(queue.counts(), (200, 3));
        let (first, dropped) = queue.first().expect("one");
        assert_eq!((first.number, dropped), (1, 3), "the first may be on its way; the oldest behind it went");
        queue.done(first.number, dropped);
        let again = Queue::open(&path);
        assert_eq!((again.counts(), again.first().map(|(next, _)| next.number)), ((199, 0), Some(5)));
        assert_eq!(again.standing().len(), MOST_WAITING + 3, "what stands is known all the same");
    }

    #[test]
    fn it_is_written_anew_before_it_grows_large_and_then_holds_the_same() {
        let (_folder, path) = file();
        let mut queue = Queue::open(&path);
        queue.add(Change::Begun(alert("disk")));
        for round in 0..180 {
            queue.add(Change::Resolved(alert("disk"), at(round)));
            queue.add(Change::Begun(alert("disk")));
            let number = queue.first().map_or(0, |(first, _)| first.number);
            queue.done(number, 0);
        }
        let lines = std::fs::read_to_string(&path).expect("the file").lines().count();
        assert!(lines <= MOST_LINES, "{lines}");
        assert_eq!(Queue::open(&path).kept, queue.kept);
        assert_eq!(queue.standing(), [alert("disk")]);
    }

    #[test]
    fn what_cannot_be_written_is_delivered_all_the_same_and_written_once_it_can_be() {
        let (folder, _) = file();
        let place = folder.path().join("not there yet");
        let mut queue = Queue::open(&place.join("alerts.queue"));
        queue.add(Change::Begun(alert("disk")));
        assert!(queue.torn && queue.first().is_some());
        std::fs::create_dir(&place).expect("now it is");
        queue.done(1, 0);
        assert!(!queue.torn);
        assert_eq!(Queue::open(&place.join("alerts.queue")).standing(), [alert("disk")]);
    }
}

#[cfg(test)]
pub(super) mod state_tests {
    use super::*;
    use crate::alerts::{Delivery, News};
    use crate::reply::Severity;

    pub fn alert(key: &str) -> AlertView {
        let (severity, site) = (Severity::Critical, "0a0b0c0d".to_owned());
        let begun = Timestamp::from_seconds(1_700_000_000);
        AlertView { key: key.to_owned(), severity, text: "t".to_owned(), site, begun }
    }

    pub fn delivery(number: u64) -> Delivery {
        Delivery { number, state: News::Begun, alert: alert("disk"), ended: None }
    }

    fn judged(level: Level, text: &str) -> Vec<Judged> {
        vec![Judged { key: "disk".to_owned(), severity: Severity::Critical, level, text: text.to_owned() }]
    }

    #[test]
    fn an_alert_begins_once_changes_its_words_and_ends_once() {
        let mut standing = Standing::default();
        let mut look = |second, level| {
            let changes = standing.look(Timestamp::from_seconds(second), "s", judged(level, &second.to_string()));
            (changes, standing.all())
        };
        assert!(look(1, Level::Between).0.is_empty(), "what hovers does not begin");
        let (begun, _) = look(2, Level::Firing);
        assert!(matches!(&begun[..], [Change::Begun(alert)] if alert.begun.seconds() == 2 && alert.text == "2"));
        let (again, all) = look(3, Level::Firing);
        assert!(again.is_empty() && all[0].text == "3" && all[0].begun.seconds() == 2);
        // Calm for a moment, then close to the limit: the alert continues.
        for (second, level) in [(4, Level::Clear), (5, Level::Between), (6, Level::Clear), (7, Level::Firing)] {
            assert!(look(second, level).0.is_empty(), "{second}");
        }
        assert!(look(8, Level::Clear).0.is_empty());
        let (over, all) = look(9, Level::Clear);
        assert!(matches!(&over[..], [Change::Resolved(alert, at)] if alert.begun.seconds() == 2 && at.seconds() == 9));
        assert!(all.is_empty() && look(10, Level::Clear).0.is_empty());
    }

    #[test]
    fn what_stood_before_a_restart_does_not_begin_again_and_ends_where_its_rule_is_gone() {
        let mut standing = Standing::of([alert("disk"), alert("robot_silent/1")]);
        let now = Timestamp::from_seconds(1_700_000_100);
        assert!(standing.look(now, "s", judged(Level::Firing, "t")).is_empty());
        let over = standing.look(now, "s", judged(Level::Firing, "t"));
        assert_eq!(over, [Change::Resolved(alert("robot_silent/1"), now)]);
    }
}

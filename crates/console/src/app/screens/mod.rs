//! The state of the screens that have one: rows, cursor, filter and order.

pub mod topics;

use std::collections::VecDeque;

use super::table::Table;
use super::{palette, policies};
use crate::model::{Address, Clock, Sampling, Timestamp, TopicPattern, clean};
use crate::service::command::Term;
use crate::service::command::filter::words;
use crate::service::reply::{
    AuditView, Direction, GatewayStatusView, GrantRow, GrantState, HeldUp, RecordPage, RecordView, RobotRow,
    SenderView, TopicRow,
};
use crate::service::{Failure, NoticeLevel, UploadQuery};
use strum::IntoStaticStr;

/// Characters of a device id that distinguish robots of one name.
const DEVICE: usize = 8;

#[derive(Debug, Default)]
pub struct Gateway {
    pub view: Option<GatewayStatusView>,
    /// Empty while the keyring is locked.
    pub robots: Vec<RobotRow>,
    pub robots_at: Timestamp,
    /// Whether records came since: a robot's report is one.
    pub robots_told: bool,
    /// The profile's account.
    owner: Option<Address>,
    pub table: Table,
}

/// A name with a transport key, an enrolled robot of the profile, or both.
#[derive(Debug, Clone, Copy)]
pub struct Member<'a> {
    /// What the gateway knows.
    pub sender: Option<&'a SenderView>,
    /// What the owner's site knows.
    pub robot: Option<&'a RobotRow>,
}

impl Member<'_> {
    pub fn name(&self) -> String {
        let sender = self.sender.map(|sender| &sender.name);
        sender.or(self.robot.map(|robot| &robot.name)).map(ToString::to_string).unwrap_or_default()
    }

    pub fn is_connected(&self) -> bool {
        self.sender.is_some_and(|sender| sender.sessions > 0)
    }

    /// Its newest record, or else its last frame.
    pub fn last(&self) -> Option<Timestamp> {
        self.robot.and_then(|robot| robot.last_seen).or(self.sender.and_then(|sender| sender.last))
    }

    pub fn key(&self) -> String {
        match (self.sender, self.robot) {
            (None, Some(robot)) => format!("{} {}", robot.name, beginning(&robot.device.to_hex(), DEVICE)),
            _ => self.name(),
        }
    }

    fn text(&self) -> String {
        let state = if self.is_connected() { "connected" } else { "away" };
        let account = self.sender.map(|sender| sender.account.to_string()).unwrap_or_default();
        let peer = self.sender.and_then(|sender| sender.peer.clone()).unwrap_or_default();
        let policy = self.robot.map(policies::searched).unwrap_or_default();
        format!("{} {account} {peer} {state} {policy}", self.name())
    }
}

pub fn beginning(hex: &str, characters: usize) -> String {
    hex.trim_start_matches("0x").chars().take(characters).collect()
}

impl Gateway {
    pub fn set(&mut self, view: GatewayStatusView) {
        self.view = Some(view);
        self.settle();
    }

    pub fn set_robots(&mut self, rows: Vec<RobotRow>, owner: Option<Address>, now: Timestamp) {
        (self.robots, self.owner, self.robots_at, self.robots_told) = (rows, owner, now, false);
        self.settle();
    }

    fn settle(&mut self) {
        let keys = self.keys();
        self.table.settle(&keys);
    }

    pub fn all_members(&self) -> Vec<Member<'_>> {
        let mut alone: Vec<&RobotRow> = self.robots.iter().collect();
        let mut members = Vec::new();
        for sender in self.view.iter().flat_map(|view| &view.senders) {
            let own = Some(sender.account) == self.owner;
            let place = alone.iter().position(|robot| own && robot.name == sender.name);
            members.push(Member { sender: Some(sender), robot: place.map(|place| alone.remove(place)) });
        }
        members.extend(alone.into_iter().map(|robot| Member { sender: None, robot: Some(robot) }));
        members
    }

    pub fn shown(&self) -> Vec<Member<'_>> {
        let mut members = palette::narrow(self.table.filter.text(), self.all_members(), Member::text);
        match self.table.sort {
            1 => members.sort_by_key(Member::name),
            2 => members.sort_by_key(|row| std::cmp::Reverse(row.sender.map_or(0, |sender| sender.frames))),
            3 => members.sort_by_key(|row| row.robot.map_or((u8::MAX, 0), policies::urgency)),
            _ => members.sort_by_key(|row| !row.is_connected()),
        }
        if self.table.reversed {
            members.reverse();
        }
        members
    }

    pub fn keys(&self) -> Vec<String> {
        self.shown().iter().map(Member::key).collect()
    }

    pub fn selected(&self) -> Option<Member<'_>> {
        self.table.chosen(self.shown(), Member::key)
    }
}

/// `/robot1` of `/robot1/odom`; `None` for `/tf`.
pub fn robot_of(topic: &str) -> Option<&str> {
    let end = topic.get(1..)?.find('/')? + 1;
    topic.get(..end)
}

/// No topic name ends like this.
pub fn name_of(robot: &str) -> String {
    format!("{robot}/")
}

pub fn folded(name: &str) -> Option<&str> {
    name.strip_suffix('/')
}

/// The sum of rates and counts, and the worst state of any.
pub fn together(robot: &str, rows: &[&TopicRow]) -> TopicRow {
    let sum = |of: fn(&TopicRow) -> u64| rows.iter().map(|row| of(row)).sum();
    let rate = |of: fn(&TopicRow) -> Option<f64>| {
        let known = rows.iter().filter_map(|row| of(row));
        rows.iter().any(|row| of(row).is_some()).then(|| known.sum())
    };
    let held_up = |wanted| rows.iter().any(|row| row.watched && row.held_up == Some(wanted)).then_some(wanted);
    let mut publishers: Vec<String> = rows.iter().flat_map(|row| row.publishers.clone()).collect();
    publishers.sort();
    publishers.dedup();
    TopicRow {
        topic: name_of(robot),
        ros: rows.iter().map(|row| row.ros).min().unwrap_or(1),
        type_hash: None,
        qos: None,
        type_name: Some(format!("{} topics", rows.len())),
        publishers,
        unreached: rows.iter().flat_map(|row| row.unreached.clone()).collect(),
        watched: rows.iter().any(|row| row.watched),
        watched_by: None,
        watched_type: None,
        sampling: Sampling::default(),
        held_up: held_up(HeldUp::WaitsForKey).or(held_up(HeldUp::Paused)),
        simulated: rows.iter().all(|row| row.simulated),
        hz: rate(|row| row.hz),
        bytes_per_second: rate(|row| row.bytes_per_second),
        messages: sum(|row| row.messages),
        lost_in_transport: sum(|row| row.lost_in_transport),
        lost_in_recorder: sum(|row| row.lost_in_recorder),
        left_out: sum(|row| row.left_out),
        last_message: rows.iter().filter_map(|row| row.last_message).max(),
        pins: sum(|row| row.pins),
        unpinned: rows.iter().flat_map(|row| row.unpinned.clone()).collect(),
        quarantined: sum(|row| row.quarantined),
        alarm: rows.iter().any(|row| row.alarm),
    }
}

const MOST_GRANTS: usize = 2_000;

#[derive(Debug, Default)]
pub struct Grants {
    pub rows: Vec<GrantRow>,
    pub table: Table,
}

pub fn is_given(row: &GrantRow) -> bool {
    row.direction == Direction::Given
}

/// Whether a grant opens new records.
pub fn is_active(row: &GrantRow) -> bool {
    row.state == GrantState::Active
}

pub fn other_side(row: &GrantRow) -> Address {
    if is_given(row) { row.grantee } else { row.owner }
}

pub fn key(row: &GrantRow) -> String {
    format!("{}{}{}{}", row.transaction, row.direction.word(), row.grantee, row.epoch)
}

impl Grants {
    pub fn set(&mut self, mut rows: Vec<GrantRow>) {
        rows.truncate(MOST_GRANTS);
        self.rows = rows;
        let keys = self.keys();
        self.table.settle(&keys);
    }

    pub fn visible(&self) -> Vec<&GrantRow> {
        let text = |row: &&GrantRow| {
            let (direction, state) = (row.direction.word(), row.state.word());
            format!("{direction} {state} {} {}", other_side(row), row.topics.join(" "))
        };
        let mut rows = palette::narrow(self.table.filter.text(), self.rows.iter().collect(), text);
        match self.table.sort {
            1 => rows.sort_by_key(|row| (other_side(row), std::cmp::Reverse(row.block))),
            2 => rows.sort_by_key(|row| (row.state.word(), std::cmp::Reverse(row.block))),
            _ => rows.sort_by_key(|row| std::cmp::Reverse(row.block)),
        }
        if self.table.reversed {
            rows.reverse();
        }
        rows
    }

    pub fn keys(&self) -> Vec<String> {
        self.visible().into_iter().map(key).collect()
    }

    pub fn selected(&self) -> Option<&GrantRow> {
        self.table.chosen(self.visible(), |row| key(row))
    }

    /// When the time left of a grant that ends soon changes on screen.
    pub fn nearer_at(&self, now: Timestamp) -> Option<Timestamp> {
        let ends = self.rows.iter().filter(|row| is_active(row)).filter_map(|row| row.expires);
        let next = |end: Timestamp| {
            let left = end.0.checked_sub(now.0).filter(|left| (1..SOON).contains(left))?;
            let unit = if left < 2 * HOUR { MINUTE } else { HOUR };
            Some(Timestamp(end.0 - left / unit * unit + 1))
        };
        ends.filter_map(next).min()
    }
}

pub fn scope(topics: &[String]) -> String {
    match topics {
        [] => "all topics".to_owned(),
        [one] => clean(one, 60),
        many => format!("{} topics", many.len()),
    }
}

/// To follow other words; empty = no, or unknown.
pub fn earlier(row: &GrantRow) -> &'static str {
    if row.from.is_some_and(|from| from < row.epoch) { ", earlier records too" } else { "" }
}

pub fn end(expires: Option<Timestamp>) -> String {
    expires.map_or_else(|| "no end".to_owned(), |moment| format!("until {}", day(moment)))
}

/// Grants ending within this time show the time left, nanoseconds.
const SOON: u64 = 48 * HOUR;
const HOUR: u64 = 3_600_000_000_000;
const MINUTE: u64 = 60_000_000_000;

/// `None` if it does not end soon, or has ended.
pub fn soon(expires: Option<Timestamp>, now: Timestamp) -> Option<String> {
    let left = expires?.0.checked_sub(now.0).filter(|left| *left < SOON)?;
    Some(match left / MINUTE {
        0 => "in under 1 min".to_owned(),
        minutes @ 1..120 => format!("in {minutes} min"),
        minutes => format!("in {} h", minutes / 60),
    })
}

/// `2026-12-31 23:59` UTC.
pub fn day(moment: Timestamp) -> String {
    let text = moment.to_string();
    text.get(..16).map_or_else(|| text.clone(), |text| text.replace('T', " "))
}

const MOST_NOTICES: usize = 500;
pub const MOST_AUDIT: usize = 300;
/// Columns kept of a text.
const WIDEST: usize = 400;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LogLine {
    pub at: Timestamp,
    pub level: NoticeLevel,
    pub key: String,
    pub source: Source,
    pub text: String,
    /// The subject, if a later notice about it replaces this one.
    pub about: Option<String>,
    pub seen: bool,
}

impl LogLine {
    pub fn whole(&self) -> String {
        format!("{} {} {}: {}", self.at, self.level.word(), self.key, self.text)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, IntoStaticStr)]
#[strum(serialize_all = "lowercase")]
pub enum Source {
    /// The operator's commands and how they ended.
    Console,
    Site,
    Audit,
}

impl Source {
    pub const ALL: [Self; 3] = [Self::Console, Self::Site, Self::Audit];

    pub fn word(self) -> &'static str {
        self.into()
    }
}

#[derive(Debug)]
pub struct Log {
    notices: VecDeque<LogLine>,
    audit: Vec<LogLine>,
    pub table: Table,
    /// The least urgent level shown.
    pub least: NoticeLevel,
    /// `None` = all.
    pub source: Option<Source>,
    told: u64,
}

impl Default for Log {
    fn default() -> Self {
        let table = Table::following();
        Self { notices: VecDeque::new(), audit: Vec::new(), table, least: NoticeLevel::Info, source: None, told: 0 }
    }
}

impl Log {
    pub fn notice(&mut self, at: Timestamp, level: NoticeLevel, text: &str) {
        self.keep(at, level, text, Source::Console, None);
    }

    pub fn keep(&mut self, at: Timestamp, level: NoticeLevel, text: &str, source: Source, about: Option<String>) {
        self.told += 1;
        let (key, text) = (format!("notice {}", self.told), clean(text, WIDEST));
        self.notices.push_front(LogLine { at, level, key, source, text, about, seen: false });
        self.notices.truncate(MOST_NOTICES);
    }

    pub fn saw(&mut self, text: &str) {
        let text = clean(text, WIDEST);
        self.notices.iter_mut().filter(|line| line.text == text).for_each(|line| line.seen = true);
    }

    pub fn set_audit(&mut self, lines: Vec<AuditView>) {
        self.audit = lines.into_iter().take(MOST_AUDIT).map(audit_line).collect();
    }

    /// Newest first.
    pub fn visible(&self) -> Vec<&LogLine> {
        let wanted = |line: &&LogLine| line.level >= self.least && self.source.is_none_or(|from| line.source == from);
        let wanted = self.notices.iter().chain(&self.audit).filter(wanted).collect();
        let mut lines = palette::narrow(self.table.filter.text(), wanted, |line: &&LogLine| line.text.clone());
        lines.sort_by_key(|line| std::cmp::Reverse(line.at));
        lines
    }

    pub fn count(&self) -> usize {
        self.notices.len() + self.audit.len()
    }

    pub fn keys(&self) -> Vec<String> {
        self.visible().into_iter().map(|line| line.key.clone()).collect()
    }

    pub fn selected(&self) -> Option<&LogLine> {
        self.table.chosen(self.visible(), |line| line.key.as_str())
    }

    /// Newest unseen warnings and errors that the site reported unasked.
    pub fn urgent(&self, limit: usize) -> Vec<&LogLine> {
        // Lasting problems show as the health of their part; an operator's own mistake is no alert.
        let is_news = |line: &LogLine| line.source == Source::Site && line.about.is_none() && !line.seen;
        let is_alert = |line: &&LogLine| line.level > NoticeLevel::Info && is_news(line);
        self.notices.iter().filter(is_alert).take(limit).collect()
    }

    pub fn next_source(&mut self) {
        let place = self.source.map_or(0, |source| source as usize + 1);
        self.source = Source::ALL.get(place).copied();
    }

    pub fn next_level(&mut self) {
        self.least = match self.least {
            NoticeLevel::Info => NoticeLevel::Warning,
            NoticeLevel::Warning => NoticeLevel::Error,
            NoticeLevel::Error => NoticeLevel::Info,
        };
    }
}

fn audit_line(view: AuditView) -> LogLine {
    let good = ["ok", "done", "begun", "serving"].contains(&view.outcome.as_str());
    let level = if good { NoticeLevel::Info } else { NoticeLevel::Warning };
    let text = format!("{} {} {}: {}", view.by(), view.action, view.subject, view.outcome);
    let (key, text) = (format!("audit {}", view.line), clean(&text, WIDEST));
    LogLine { at: view.at, level, key, source: Source::Audit, text, about: None, seen: true }
}

#[derive(Debug, Default)]
pub struct Records {
    pub rows: Vec<RecordView>,
    /// Cursor of the next page.
    pub next: Option<String>,
    /// Cursors that led here; empty = first page.
    pub path: Vec<String>,
    /// Sort 0 = newest first, 1 = oldest first.
    pub table: Table,
    /// Hides younger records, so that the row of the cursor stays in place.
    pub anchor: Option<Timestamp>,
    /// The filter and when it was typed: `since:1m` counts from there, so that it stays the same request.
    pub typed: (String, Clock),
    /// Whether more records are on their way from the gateway.
    pub arriving: bool,
}

#[derive(Debug, Default, PartialEq, Eq)]
pub struct Wanted {
    /// Without its page.
    pub asked: UploadQuery,
    /// Parts of ids, which only narrow the page on screen.
    pub rest: String,
}

impl Wanted {
    /// State words, topic names and patterns, addresses, and terms such as `owner:bob`.
    pub fn read(filter: &str, topics: &[TopicRow], clock: &Clock) -> Result<Self, Failure> {
        let mut wanted = Self::default();
        for word in words(filter) {
            let word = word.as_str();
            if let Some((term, text)) = Term::split(word)? {
                wanted.asked.take(term, text, clock)?;
                continue;
            }
            if wanted.asked.take(Term::State, word, clock).is_ok() {
                continue;
            }
            if let Ok(owner) = word.parse::<Address>() {
                wanted.asked.owner = Some(owner.into());
            } else if word.starts_with('/') && word.contains(['*', '?']) {
                wanted.asked.take(Term::Topic, word, clock)?;
            } else if let Some(topic) = topic_named(word, topics) {
                wanted.asked.topic = Some(topic);
            } else if !is_of_an_id(word) {
                wanted.asked.words.push(word.to_owned());
            } else {
                wanted.rest.push_str(if wanted.rest.is_empty() { "" } else { " " });
                wanted.rest.push_str(word);
            }
        }
        Ok(wanted)
    }
}

fn is_of_an_id(word: &str) -> bool {
    let hex = word.len() >= 6 && word.bytes().all(|byte| byte.is_ascii_hexdigit());
    hex && word.bytes().any(|byte| byte.is_ascii_digit())
}

fn topic_named(word: &str, topics: &[TopicRow]) -> Option<TopicPattern> {
    if let Some(whole) = topics.iter().find(|row| row.topic == word) {
        return whole.topic.parse().ok();
    }
    let mut within = topics.iter().filter(|row| row.topic.contains(word));
    let only = within.next().filter(|_| within.next().is_none())?;
    only.topic.parse().ok()
}

impl Records {
    /// Notes when the filter was typed, if it changed.
    pub fn note_filter(&mut self, clock: &Clock) {
        let text = self.table.filter.text();
        if text != self.typed.0 {
            self.typed = (text.to_owned(), clock.clone());
        }
    }

    /// What the filter says, or why it says nothing.
    pub fn wanted(&self, topics: &[TopicRow]) -> Result<Wanted, Failure> {
        Wanted::read(self.table.filter.text(), topics, &self.typed.1)
    }

    /// As of the moment of the freeze, if frozen.
    /// `None` while the filter says nothing.
    pub fn query(&self, topics: &[TopicRow], limit: usize, frozen: Option<Timestamp>) -> Option<UploadQuery> {
        let asked = self.wanted(topics).ok()?.asked;
        // The query's end is exclusive; the record of that very moment still shows.
        let stands = [self.anchor, frozen].into_iter().flatten().map(|at| Timestamp(at.0.saturating_add(1)));
        Some(UploadQuery {
            until: asked.until.into_iter().chain(stands).min(),
            after: self.path.last().cloned(),
            limit: limit.clamp(1, 1_000),
            newest_first: self.table.sort == 0,
            ..asked
        })
    }

    pub fn set(&mut self, page: RecordPage, limit: usize) {
        self.arriving = page.arriving.is_some();
        self.rows = page.records;
        self.rows.truncate(limit.max(1));
        self.next = page.next;
    }

    pub fn visible(&self, topics: &[TopicRow]) -> Vec<&RecordView> {
        if self.table.filter.text().is_empty() {
            return self.rows.iter().collect();
        }
        // Nothing is shown by a filter that cannot be read.
        let Ok(wanted) = self.wanted(topics) else { return Vec::new() };
        palette::narrow(&wanted.rest, self.rows.iter().collect(), |row| haystack(row))
    }

    pub fn restart(&mut self) {
        self.path.clear();
        self.anchor = None;
        self.table.select::<&str>(&[], 0);
    }

    /// Once the cursor has left the newest record, nothing comes in above it.
    pub fn stand(&mut self) {
        if self.table.sort == 0 {
            self.anchor = self.anchor.or_else(|| self.rows.iter().map(|row| row.captured_at).max());
        }
    }

    /// False on the last page.
    pub fn forward(&mut self) -> bool {
        let Some(next) = self.next.take() else { return false };
        self.stand();
        self.path.push(next);
        self.table.select::<&str>(&[], 0);
        true
    }

    /// False on the first page.
    pub fn back(&mut self) -> bool {
        self.table.select::<&str>(&[], 0);
        self.path.pop().is_some() || self.anchor.take().is_some()
    }
}

fn haystack(row: &RecordView) -> String {
    let owner = row.owner.map(|owner| owner.to_string()).unwrap_or_default();
    let (state, kind) = (row.state.word(), row.kind.word());
    format!("{} {} {} {state} {kind} {owner}", row.id, row.topic, row.type_name)
}

#[cfg(test)]
mod robots_tests {
    use super::*;
    use crate::app::tests::fixtures;

    #[test]
    fn a_robot_is_the_first_part_of_a_name() {
        assert_eq!(robot_of("/robot1/camera/compressed"), Some("/robot1"));
        assert_eq!([robot_of("/tf"), robot_of(""), robot_of("odom")], [None; 3]);
        assert_eq!(robot_of("/机/odom"), Some("/机"));
        assert_eq!(folded(&name_of("/robot1")), Some("/robot1"));
        assert_eq!(folded("/robot1/odom"), None);
    }

    #[test]
    fn its_row_says_the_sum_and_the_worst() {
        let one = TopicRow { watched: true, messages: 7, ..fixtures::topic("/r/odom", 20.0) };
        let other = TopicRow { alarm: true, hz: None, ..fixtures::topic("/r/camera", 2.0) };
        let row = together("/r", &[&one, &other]);
        assert_eq!((row.topic.as_str(), row.hz, row.messages), ("/r/", Some(20.0), 7));
        assert_eq!(row.bytes_per_second, Some(130_400.0));
        assert!(row.alarm && row.watched);
    }
}

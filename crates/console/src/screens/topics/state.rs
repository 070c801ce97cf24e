//! The rows of the graph, their order, robots folded into one row, and recent transfer rates.

use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};

use crate::app::{history::Sample, history::window, matching::narrow, table::Table};
use crate::model::{Sampling, Timestamp, counted, natural};
use crate::service::reply::{HeldUp, TopicRow};

const MOST_TOPICS: usize = 5_000;

/// Samples in the line of a row.
pub const SAMPLES: usize = 16;

/// Samples kept, for the pane.
pub const KEPT_SAMPLES: usize = 60;

/// Nanoseconds between samples.
const SAMPLE_EVERY: u64 = 1_000_000_000;

#[derive(Debug, Default)]
pub struct Topics {
    /// By name.
    pub rows: Vec<TopicRow>,
    pub table: Table,
    history: HashMap<String, VecDeque<f64>>,
    /// The second of the newest samples.
    sampled: u64,
    /// Robots shown as one row.
    folded: BTreeSet<String>,
    /// Their rows.
    robots: BTreeMap<String, TopicRow>,
    /// The rows shown, computed once until filter, order or rows change.
    places: Vec<Place>,
    /// Filter, sort and direction of `places`.
    ordered: (String, usize, bool),
}

#[derive(Debug, Clone)]
enum Place {
    /// Its index among all rows.
    Topic(usize),
    /// A robot's topics that match the filter.
    Robot(String),
}

impl Topics {
    pub fn set(&mut self, mut rows: Vec<TopicRow>, now: Timestamp) {
        rows.truncate(MOST_TOPICS);
        rows.sort_by(|one, other| natural(&one.topic, &other.topic));
        self.rows = rows;
        let (rows, folded) = (&self.rows, &self.folded);
        // Sorted above.
        let is_there = |name: &String| {
            let robot = self::folded(name).is_some_and(|robot| folded.contains(robot));
            robot || rows.binary_search_by(|row| natural(&row.topic, name)).is_ok()
        };
        self.table.marks.retain(is_there);
        self.refresh(true);
        let keys = self.keys();
        self.table.settle(&keys);
        let missed = self.unsampled(now);
        if missed > 0 {
            self.sampled = now.0 / SAMPLE_EVERY;
            self.sample(missed - 1);
        }
    }

    /// Seconds without news repeat the previous rate.
    fn sample(&mut self, missed: usize) {
        let rows = &self.rows;
        self.history.retain(|topic, _| rows.binary_search_by(|row| row.topic.cmp(topic)).is_ok());
        for row in &self.rows {
            // Most are there already: no new copy of the name.
            let samples = match self.history.get_mut(&row.topic) {
                Some(samples) => samples,
                None => self.history.entry(row.topic.clone()).or_default(),
            };
            if let Some(before) = samples.back().copied() {
                samples.extend(std::iter::repeat_n(before, missed.min(KEPT_SAMPLES)));
            }
            samples.push_back(row.bytes_per_second.unwrap_or(0.0));
            drop(samples.drain(..samples.len().saturating_sub(KEPT_SAMPLES)));
        }
    }

    fn unsampled(&self, now: Timestamp) -> usize {
        usize::try_from((now.0 / SAMPLE_EVERY).saturating_sub(self.sampled)).unwrap_or(KEPT_SAMPLES)
    }

    /// Bytes a second in each second of a [`window`]; the last value holds until the next.
    pub fn samples(&self, topic: &str, seconds: usize, now: Timestamp) -> Vec<Option<Sample>> {
        let mut samples: Vec<f64> = match self.robot(topic) {
            None => self.history.get(topic).map(|samples| samples.iter().copied().collect()).unwrap_or_default(),
            Some(robot) => self.samples_of(robot),
        };
        if let Some(last) = samples.last().copied() {
            samples.extend(std::iter::repeat_n(last, self.unsampled(now).min(seconds)));
        }
        let over = now.0 / SAMPLE_EVERY + 1;
        let value = |second: u64| {
            let back = usize::try_from(over.checked_sub(second)?).ok()?;
            samples.get(samples.len().checked_sub(back)?).copied()
        };
        window(over, seconds).map(|second| value(second).map(Sample::level)).collect()
    }

    fn samples_of(&self, robot: &str) -> Vec<f64> {
        let mut sums = vec![0.0; KEPT_SAMPLES];
        let topics = self.rows.iter().filter(|row| robot_of(&row.topic) == Some(robot));
        for samples in topics.filter_map(|row| self.history.get(&row.topic)) {
            for (sum, sample) in sums.iter_mut().rev().zip(samples.iter().rev()) {
                *sum += sample;
            }
        }
        sums
    }

    /// Filtered and in order, folded robots in one row each.
    pub fn visible(&self) -> Vec<&TopicRow> {
        self.places.iter().filter_map(|place| self.at(place)).collect()
    }

    fn at(&self, place: &Place) -> Option<&TopicRow> {
        match place {
            Place::Topic(place) => self.rows.get(*place),
            Place::Robot(robot) => self.robots.get(robot),
        }
    }

    /// `None` = it is a topic, whatever its name.
    pub fn robot<'a>(&self, name: &'a str) -> Option<&'a str> {
        folded(name).filter(|robot| self.folded.contains(*robot))
    }

    /// How many of a folded robot's topics are watched, and how many it has.
    pub fn watched_of(&self, robot: &str) -> (usize, usize) {
        let rows = || self.rows.iter().filter(|row| robot_of(&row.topic) == Some(robot));
        (rows().filter(|row| row.watched).count(), rows().count())
    }

    /// False if the row has no robot.
    pub fn fold(&mut self) -> bool {
        let Some(name) = self.selected().map(|row| row.topic.clone()) else { return false };
        let Some(robot) = robot_of(&name).map(str::to_owned) else { return false };
        let unfolds = self.folded.remove(&robot);
        if !unfolds {
            self.folded.insert(robot.clone());
        }
        self.unmark_robots();
        self.refresh(true);
        // The cursor stays with the robot.
        let keys = self.keys();
        let is_of = |key: &String| robot_of(key) == Some(robot.as_str());
        if let Some(position) = keys.iter().position(is_of) {
            self.table.select(&keys, position);
        }
        true
    }

    /// A mark on an unfolded robot would refer to nothing.
    fn unmark_robots(&mut self) {
        let folded = &self.folded;
        let stays = |name: &String| self::folded(name).is_none_or(|robot| folded.contains(robot));
        self.table.marks.retain(stays);
    }

    /// Unfolds all if every robot is folded.
    pub fn fold_all(&mut self) {
        let all: BTreeSet<String> =
            self.rows.iter().filter_map(|row| robot_of(&row.topic).map(str::to_owned)).collect();
        self.folded = if all.is_subset(&self.folded) { BTreeSet::new() } else { all };
        self.unmark_robots();
        self.refresh(true);
        let keys = self.keys();
        self.table.select(&keys, 0);
    }

    fn found(&self) -> Vec<(usize, &TopicRow)> {
        let all = self.rows.iter().enumerate().collect();
        let mut rows = narrow(self.table.filter.text(), all, |(_, row)| {
            format!("{} {}", row.topic, row.type_name.as_deref().unwrap_or(""))
        });
        // Stable: equal rows stay ordered by name.
        rows.sort_by(|(_, one), (_, other)| order(self.table.sort, one, other));
        if self.table.reversed {
            rows.reverse();
        }
        rows
    }

    pub fn refresh(&mut self, rows_changed: bool) {
        let wanted = (self.table.filter.text().to_owned(), self.table.sort, self.table.reversed);
        if rows_changed || self.ordered != wanted {
            (self.places, self.robots) = self.arranged();
            self.ordered = wanted;
        }
    }

    /// Topics of a folded robot become one row, at the place of the first.
    fn arranged(&self) -> (Vec<Place>, BTreeMap<String, TopicRow>) {
        let (mut places, mut taken) = (Vec::new(), BTreeMap::<String, Vec<&TopicRow>>::new());
        for (place, row) in self.found() {
            match robot_of(&row.topic).filter(|robot| self.folded.contains(*robot)) {
                None => places.push(Place::Topic(place)),
                Some(robot) => {
                    let rows = taken.entry(robot.to_owned()).or_default();
                    if rows.is_empty() {
                        places.push(Place::Robot(robot.to_owned()));
                    }
                    rows.push(row);
                }
            }
        }
        let robots = taken.into_iter().map(|(robot, rows)| (robot.clone(), together(&robot, &rows))).collect();
        (places, robots)
    }

    pub fn any_visible(&self) -> bool {
        !self.places.is_empty()
    }

    pub fn keys(&self) -> Vec<String> {
        self.visible().into_iter().map(|row| row.topic.clone()).collect()
    }

    /// By Hz, then by name.
    pub fn busiest(&self, limit: usize) -> Vec<&TopicRow> {
        let mut rows: Vec<_> = self.rows.iter().collect();
        rows.sort_by(|one, other| descending(one.hz, other.hz));
        rows.truncate(limit);
        rows
    }

    /// When the youngest age on screen changes without news.
    pub fn older_at(&self, now: Timestamp) -> Option<Timestamp> {
        const SECOND: u64 = 1_000_000_000;
        let youngest = self.rows.iter().filter_map(|row| row.last_message).max()?;
        let step = match now.0.saturating_sub(youngest.0) / SECOND {
            0..60 => SECOND,
            60..3_600 => 60 * SECOND,
            _ => 3_600 * SECOND,
        };
        Some(Timestamp((now.0 / step + 1).saturating_mul(step)))
    }

    pub fn selected(&self) -> Option<&TopicRow> {
        self.table.chosen(self.visible(), |row| row.topic.as_str())
    }

    /// Marked topics, or else the selected one; a robot's row stands for its topics that match the filter.
    pub fn targets(&self) -> Vec<&TopicRow> {
        let chosen: Vec<&str> = match self.table.marks.is_empty() {
            true => self.selected().map(|row| row.topic.as_str()).into_iter().collect(),
            false => self.table.marks.iter().map(String::as_str).collect(),
        };
        let topics: BTreeSet<&str> = chosen.iter().copied().collect();
        let robots: BTreeSet<&str> = chosen.iter().filter_map(|name| self.robot(name)).collect();
        let shown: BTreeSet<&str> = self.found().into_iter().map(|(_, row)| row.topic.as_str()).collect();
        let is_meant = |row: &&TopicRow| {
            let robot = robot_of(&row.topic).filter(|_| shown.contains(row.topic.as_str()));
            topics.contains(row.topic.as_str()) || robot.is_some_and(|robot| robots.contains(robot))
        };
        self.rows.iter().filter(is_meant).collect()
    }

    pub fn watched_targets(&self) -> Vec<&TopicRow> {
        self.targets().into_iter().filter(|row| row.watched).collect()
    }
}

fn order(sort: usize, one: &TopicRow, other: &TopicRow) -> Ordering {
    match sort {
        1 => descending(one.hz, other.hz),
        2 => descending(one.bytes_per_second, other.bytes_per_second),
        3 => other.watched.cmp(&one.watched),
        _ => Ordering::Equal,
    }
}

/// Steps of a fifth keep rows from swapping at every small change.
fn descending(one: Option<f64>, other: Option<f64>) -> Ordering {
    let step = |rate: Option<f64>| rate.map_or(f64::NEG_INFINITY, |rate| (rate.max(0.01).log2() * 4.0).round());
    step(other).total_cmp(&step(one))
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
    publishers.sort_by(|one, other| natural(one, other));
    publishers.dedup();
    TopicRow {
        topic: name_of(robot),
        ros: rows.iter().map(|row| row.ros).min().unwrap_or(1),
        type_hash: None,
        qos: None,
        type_name: Some(counted(rows.len() as u64, "topic")),
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

#[cfg(test)]
mod tests {
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

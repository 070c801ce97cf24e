//! The Gateway screen: names with a transport key and the enrolled robots of the profile, in one list.

use crate::app::table::Table;
use crate::app::{palette, policies};
use crate::model::{Address, Timestamp};
use crate::service::reply::{GatewayStatusView, HeldUp, RobotRow, SenderView, TopicRow};

/// The sort columns, in the order of `s`.
pub const SORTS: [&str; 4] = ["connected", "name", "frames", "policy"];

/// Characters of a robot's device id that tell it apart from another one of its name.
const DEVICE: usize = 8;

/// The gateway of this site, and the robots of the profile.
#[derive(Debug, Default)]
pub struct Gateway {
    /// The site's report.
    pub view: Option<GatewayStatusView>,
    /// The enrolled robots of the profile; none while the keyring is locked.
    pub robots: Vec<RobotRow>,
    /// When they were reported.
    pub robots_at: Timestamp,
    /// Whether records came since then: what a robot says of its policy is one.
    pub robots_told: bool,
    /// The account of the profile, whose robots these are.
    owner: Option<Address>,
    /// Cursor, filter, order.
    pub table: Table,
}

/// A name with a transport key, an enrolled robot of the profile, or both.
#[derive(Debug, Clone, Copy)]
pub struct Member<'a> {
    /// What the gateway knows of it.
    pub sender: Option<&'a SenderView>,
    /// What its owner's site knows of it.
    pub robot: Option<&'a RobotRow>,
}

impl Member<'_> {
    /// Its name.
    pub fn name(&self) -> String {
        let sender = self.sender.map(|sender| &sender.name);
        sender.or(self.robot.map(|robot| &robot.name)).map(ToString::to_string).unwrap_or_default()
    }

    /// Whether it has a session at the gateway now.
    pub fn is_connected(&self) -> bool {
        self.sender.is_some_and(|sender| sender.sessions > 0)
    }

    /// When it was last heard of: its last frame, or else its newest record.
    pub fn last(&self) -> Option<Timestamp> {
        self.sender.and_then(|sender| sender.last).or(self.robot.and_then(|robot| robot.last_seen))
    }

    /// What its row is known by.
    pub fn key(&self) -> String {
        match (self.sender, self.robot) {
            (None, Some(robot)) => format!("{} {}", robot.name, beginning(&robot.device.to_hex(), DEVICE)),
            _ => self.name(),
        }
    }

    /// What the filter looks at.
    fn text(&self) -> String {
        let state = if self.is_connected() { "connected" } else { "away" };
        let account = self.sender.map(|sender| sender.account.to_string()).unwrap_or_default();
        let peer = self.sender.and_then(|sender| sender.peer.clone()).unwrap_or_default();
        let policy = self.robot.map(policies::searched).unwrap_or_default();
        format!("{} {account} {peer} {state} {policy}", self.name())
    }

    fn frames(&self) -> u64 {
        self.sender.map_or(0, |sender| sender.frames)
    }
}

/// The first characters of an id.
pub fn beginning(hex: &str, characters: usize) -> String {
    hex.trim_start_matches("0x").chars().take(characters).collect()
}

impl Gateway {
    /// Takes over the site's report.
    pub fn set(&mut self, view: GatewayStatusView) {
        self.view = Some(view);
        self.settle();
    }

    /// Takes over the robots of an owner.
    pub fn set_robots(&mut self, rows: Vec<RobotRow>, owner: Option<Address>, now: Timestamp) {
        (self.robots, self.owner, self.robots_at, self.robots_told) = (rows, owner, now, false);
        self.settle();
    }

    /// Binds the cursor to its row, once there is one.
    fn settle(&mut self) {
        let keys = self.keys();
        self.table.settle(&keys);
    }

    /// All names and robots.
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

    /// The names and robots to show, filtered and in order.
    pub fn shown(&self) -> Vec<Member<'_>> {
        let mut members = palette::narrow(self.table.filter.text(), self.all_members(), Member::text);
        match self.table.sort {
            1 => members.sort_by_key(Member::name),
            2 => members.sort_by_key(|row| std::cmp::Reverse(row.frames())),
            3 => members.sort_by_key(|row| row.robot.map_or((u8::MAX, 0), policies::urgency)),
            _ => members.sort_by_key(|row| !row.is_connected()),
        }
        if self.table.reversed {
            members.reverse();
        }
        members
    }

    /// The keys of all rows shown.
    pub fn keys(&self) -> Vec<String> {
        self.shown().iter().map(Member::key).collect()
    }

    /// The row under the cursor.
    pub fn selected(&self) -> Option<Member<'_>> {
        let members = self.shown();
        let keys: Vec<String> = members.iter().map(Member::key).collect();
        members.get(self.table.position(&keys)).copied()
    }
}

/// The robot of a topic: `/robot1` of `/robot1/odom`; none of `/tf`.
pub fn robot_of(topic: &str) -> Option<&str> {
    let end = topic.get(1..)?.find('/')? + 1;
    topic.get(..end)
}

/// The name of a folded robot's row. No topic name ends like this.
pub fn name_of(robot: &str) -> String {
    format!("{robot}/")
}

/// The robot of a folded robot's row.
pub fn folded(name: &str) -> Option<&str> {
    name.strip_suffix('/')
}

/// A robot's topics in one row: the sum of rates and counts, and the worst state of any.
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

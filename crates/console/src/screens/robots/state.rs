//! Robots and other devices of the gateway, and how they stand to their policies.

use crate::app::{matching::narrow, table::Table};
use crate::model::{Address, Timestamp, clean, natural};
use crate::service::reply::{GatewayStatusView, RobotRow, SenderView};

/// Characters of a device id that distinguish robots of one name.
const DEVICE: usize = 8;

/// A robot whose newest record is younger is active, nanoseconds.
const RECENT: u64 = 60_000_000_000;

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

    /// By its right and its sessions here, or else by the records that came.
    pub fn standing(&self, now: Timestamp) -> &'static str {
        match (self.sender, self.last()) {
            (Some(sender), _) if sender.revoked => "revoked",
            (Some(sender), _) if sender.sessions > 0 => "connected",
            (Some(_), _) => "away",
            (None, Some(at)) if now.0.saturating_sub(at.0) < RECENT => "active",
            (None, Some(_)) => "silent",
            (None, None) => "no record",
        }
    }

    fn text(&self, now: Timestamp) -> String {
        let state = self.standing(now);
        let account = self.sender.map(|sender| sender.account.to_string()).unwrap_or_default();
        let peer = self.sender.and_then(|sender| sender.peer.clone()).unwrap_or_default();
        let policy = self.robot.map(searched).unwrap_or_default();
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
        let mut members = narrow(self.table.filter.text(), self.all_members(), |row| row.text(self.robots_at));
        match self.table.sort {
            1 => members.sort_by(|one, other| natural(&one.name(), &other.name())),
            2 => members.sort_by_key(|row| std::cmp::Reverse(row.sender.map_or(0, |sender| sender.frames))),
            3 => members.sort_by_key(|row| row.robot.map_or((u8::MAX, 0), urgency)),
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

/// The site's word for a robot that has not taken its policy yet.
const WAITING: &str = "waiting";

pub const MOST_NAMES: usize = 5;

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Standing {
    /// Works by another policy, and will not change without help.
    Wrong,
    /// Does not work by it yet.
    Drifts,
    InForce,
    Unset,
}

impl Standing {
    pub fn of(row: &RobotRow) -> Self {
        match row {
            RobotRow { drift: true, .. } if row.standing == WAITING => Self::Drifts,
            RobotRow { drift: true, .. } => Self::Wrong,
            RobotRow { wanted: 0, .. } => Self::Unset,
            _ => Self::InForce,
        }
    }
}

/// The words of `robot show`.
pub fn words(row: &RobotRow) -> String {
    let standing = clean(&row.standing, 40);
    match (Standing::of(row), row.running.unwrap_or_default()) {
        (Standing::Unset, _) => "-".to_owned(),
        (Standing::Wrong, running) if running > row.wanted => format!("runs {running}, not known here"),
        (Standing::InForce, _) | (_, 0) => format!("policy {} {standing}", row.wanted),
        (_, running) => format!("policy {} {standing}, runs {running}", row.wanted),
    }
}

pub fn searched(row: &RobotRow) -> String {
    let drift = if row.drift { "outdated" } else { "" };
    format!("{} {} {drift} {}", words(row), row.standing, row.device.to_hex())
}

/// Wrong ones first, then waiting ones, older versions first.
pub fn urgency(row: &RobotRow) -> (u8, u64) {
    (Standing::of(row) as u8, row.wanted)
}

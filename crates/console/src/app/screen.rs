//! The nine screens and the data each of them shows; the first steps of a new profile.

use super::feed::Feed;
use super::state::State;

/// A screen; number keys 1 to 9 switch in this order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Screen {
    /// Health, record counts, alerts, busiest topics, first steps.
    Overview,
    /// Topics of the ROS graph.
    Topics,
    /// Own records.
    Uploads,
    /// Records shared with this profile.
    Shared,
    /// Grants given and received.
    Grants,
    /// Identity and keys.
    Keys,
    /// The chain.
    Chain,
    /// The gateway.
    Gateway,
    /// Notices and audit lines.
    Log,
}

impl Screen {
    /// All, in order.
    pub const ALL: [Self; 9] = [
        Self::Overview,
        Self::Topics,
        Self::Uploads,
        Self::Shared,
        Self::Grants,
        Self::Keys,
        Self::Chain,
        Self::Gateway,
        Self::Log,
    ];

    /// Its title.
    pub fn title(self) -> &'static str {
        match self {
            Self::Overview => "Overview",
            Self::Topics => "Topics",
            Self::Uploads => "Uploads",
            Self::Shared => "Shared",
            Self::Grants => "Grants",
            Self::Keys => "Keys",
            Self::Chain => "Chain",
            Self::Gateway => "Gateway",
            Self::Log => "Log",
        }
    }

    /// Its place, from 0.
    pub fn index(self) -> usize {
        self as usize
    }

    /// The screen this many places further, wrapping around.
    pub fn shifted(self, by: isize) -> Self {
        let count = Self::ALL.len().cast_signed();
        let place = (self.index().cast_signed() + by).rem_euclid(count);
        Self::ALL[place.cast_unsigned()]
    }

    /// The data it shows, besides what the header always shows.
    pub fn feeds(self) -> &'static [Feed] {
        match self {
            Self::Overview => &[Feed::Topics, Feed::Grants],
            Self::Topics => &[Feed::Topics],
            Self::Uploads => &[Feed::Topics, Feed::Uploads],
            Self::Shared => &[Feed::Topics, Feed::Shared, Feed::Grants],
            Self::Grants => &[Feed::Grants],
            Self::Keys => &[Feed::Keys],
            Self::Chain => &[Feed::Chain],
            Self::Gateway => &[Feed::Gateway],
            Self::Log => &[Feed::Audit],
        }
    }

    /// Whether it is a table with cursor, filter and sort.
    pub fn has_table(self) -> bool {
        matches!(self, Self::Topics | Self::Uploads | Self::Shared | Self::Grants | Self::Gateway | Self::Log)
    }

    /// Whether `s` can sort the lines of its table.
    pub fn sorts(self) -> bool {
        matches!(self, Self::Topics | Self::Uploads | Self::Shared | Self::Grants | Self::Gateway)
    }
}

/// One step.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FirstStep {
    /// Whether it is done.
    pub done: bool,
    /// Its name.
    pub name: &'static str,
    /// The key to press.
    pub key: &'static str,
    /// Its benefit.
    pub text: &'static str,
}

/// The steps while one that matters is open; empty once the profile is set up.
pub fn first_steps(state: &State) -> Vec<FirstStep> {
    let Some(identity) = &state.identity else { return Vec::new() };
    let set_up = identity.exists && identity.registered;
    let step = |done, name, key, text| FirstStep { done, name, key, text };
    let steps = vec![
        match identity.exists {
            true => step(set_up, "identity", "R", "register the identity on the chain"),
            false => step(set_up, "identity", "n", "make keys and register them on the chain"),
        },
        step(identity.exists, "keys", "L", "created with the identity; press L to load your own"),
        step(state.watches(), "topics", "w", "watch a topic: its messages are encrypted and anchored"),
        step(state.grants.any_given() || state.is_locked(), "grant", "g", "let another account read them"),
    ];
    if steps.iter().all(|step| step.done) { Vec::new() } else { steps }
}

//! The screens, in the order of their number keys.

use strum::IntoEnumIterator as _;
use strum::{EnumCount, EnumIter, IntoStaticStr};

use crate::app::feeds::Feed;

/// Number keys 1 to 9 follow this order.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, EnumCount, EnumIter, IntoStaticStr)]
pub enum Screen {
    #[default]
    Overview,
    Topics,
    Records,
    Received,
    Grants,
    Keys,
    Chain,
    Robots,
    Log,
}

impl Screen {
    pub fn all() -> impl Iterator<Item = Self> {
        Self::iter()
    }

    pub fn title(self) -> &'static str {
        self.into()
    }

    pub fn index(self) -> usize {
        self as usize
    }

    /// Wraps around.
    pub fn shifted(self, by: isize) -> Self {
        let place = (self.index().cast_signed() + by).rem_euclid(Self::COUNT.cast_signed());
        Self::iter().nth(place.cast_unsigned()).unwrap_or(self)
    }

    /// Besides those the header always shows.
    pub fn feeds(self) -> &'static [Feed] {
        match self {
            Self::Overview => &[Feed::Topics, Feed::Grants],
            Self::Topics => &[Feed::Topics],
            Self::Records => &[Feed::Topics, Feed::Records],
            Self::Received => &[Feed::Topics, Feed::Received, Feed::Grants],
            Self::Grants => &[Feed::Grants],
            Self::Keys => &[Feed::Keys],
            Self::Chain => &[Feed::Chain],
            Self::Robots => &[Feed::Gateway],
            Self::Log => &[Feed::Audit],
        }
    }

    /// In the order of `s`; empty without a table.
    pub fn orders(self) -> &'static [&'static str] {
        match self {
            Self::Topics => &["name", "Hz", "bytes/s", "watched"],
            Self::Records | Self::Received => &["newest first", "oldest first"],
            Self::Grants => &["newest", "account", "state"],
            Self::Robots => &["connected", "name", "frames", "policy"],
            Self::Log => &["newest first"],
            Self::Overview | Self::Keys | Self::Chain => &[],
        }
    }

    pub fn has_table(self) -> bool {
        !self.orders().is_empty()
    }

    pub fn sorts(self) -> bool {
        self.orders().len() > 1
    }
}

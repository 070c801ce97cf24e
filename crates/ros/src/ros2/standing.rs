//! The state of reading ROS 2, in words for people.

use crate::pipe::read::Counts;

/// The state of the program that reads.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Reading {
    /// It was started and has not reported yet, or has not had time for discovery.
    Looking,
    /// It reads.
    Up,
    /// It does not; it is restarted.
    Down {
        /// Why.
        reason: String,
    },
}

/// The state of reading.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Standing {
    /// The domain.
    pub domain: u16,
    /// Whether it is read.
    pub reading: Reading,
    /// The participants.
    pub counts: Counts,
    /// How often the program was restarted.
    pub restarts: u64,
    /// Whether the program can open no file and no local socket of this machine; `None` before it says so.
    pub confined: Option<bool>,
}

/// What cannot be seen from here, and how to be seen.
pub const INVISIBLE: &str = "not visible from here: robots with another ROS_DOMAIN_ID, on another network, or using \
                             Fast DDS over shared memory only or with LARGE_DATA (FASTDDS_BUILTIN_TRANSPORTS), a \
                             Discovery Server, SROS2 or rmw_zenoh (`authros bag follow DIR` seals what they record)";

/// Why a participant may show no topics.
const HIDDEN: &str = "they are hidden by Fast DDS with FASTDDS_BUILTIN_TRANSPORTS=LARGE_DATA (unset it, or write UDPv4) and by \
                      SROS2; `authros bag follow DIR` seals what such a robot records";

impl Standing {
    /// In one line.
    pub fn text(&self) -> String {
        let Counts { participants, writers, foreign } = self.counts;
        let place = format!("ROS 2 domain {}", self.domain);
        let some = |number: u32, what: &str| format!("{number} {what}{}", if number == 1 { "" } else { "s" });
        let there = some(participants, "participant");
        match &self.reading {
            Reading::Down { reason } => format!("{place} cannot be read: {reason}"),
            Reading::Looking if participants == 0 => format!("{place}: discovering"),
            _ if participants == 0 => format!("{place}: nobody there; {INVISIBLE}"),
            _ if writers == 0 && foreign > 0 => format!(
                "{place}: {there} and {} of non-ROS names, but none of ROS 2 topics",
                some(foreign, "publisher")
            ),
            _ if writers == 0 => format!("{place}: {there}, but no topics; {HIDDEN}"),
            _ => format!("{place}: {there}, {} of ROS 2 topics", some(writers, "publisher")),
        }
    }

    /// Whether there is still no participant or topic though there was time to look.
    pub fn is_empty(&self) -> bool {
        self.reading == Reading::Up && self.counts.writers == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nobody_no_topics_and_other_names_are_told_apart() {
        let text = |participants, writers, foreign| {
            let counts = Counts { participants, writers, foreign };
            Standing { domain: 3, reading: Reading::Up, counts, restarts: 0, confined: None }.text()
        };
        for hidden in ["LARGE_DATA", "shared memory", "Discovery Server", "SROS2", "ROS_DOMAIN_ID"] {
            assert!(text(0, 0, 0).contains(hidden), "{hidden}");
        }
        assert!(text(0, 0, 0).starts_with("ROS 2 domain 3: nobody there"));
        assert!(text(2, 0, 0).contains("2 participants, but no topics"));
        let hidden = text(1, 0, 0);
        assert!(hidden.contains("1 participant, but no topics") && hidden.contains("LARGE_DATA"), "{hidden}");
        assert!(text(2, 0, 1).contains("non-ROS names"));
        assert!(text(2, 5, 1).contains("5 publishers of ROS 2 topics"));
    }
}

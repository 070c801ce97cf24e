//! Messages between a child that reads topics and its site.

use serde::{Deserialize, Serialize};

/// In DDS's order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Liveliness {
    /// Its middleware shows it.
    #[default]
    Automatic,
    ManualByParticipant,
    ManualByTopic,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
pub struct Quality {
    pub reliable: bool,
    /// Messages are kept for late subscribers.
    pub latched: bool,
    /// The promised interval between messages, nanoseconds; `None` = no promise.
    pub deadline: Option<u64>,
    /// How long a message stays valid, nanoseconds; `None` = forever.
    pub lifespan: Option<u64>,
    pub liveliness: Liveliness,
    /// Interval at which it promises to show it, nanoseconds; `None` = no promise.
    pub lease: Option<u64>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Writer {
    /// 16 bytes as hex.
    pub id: String,
    pub topic: String,
    /// `package/msg/Type`
    pub type_name: String,
    /// `RIHS01_` and 64 hex characters, if announced.
    pub type_hash: Option<String>,
    pub quality: Quality,
    /// If announced.
    pub node: Option<String>,
    /// Whether its participant announces names of nodes, so that a missing one may still come.
    pub naming: bool,
    /// A short word such as `cyclonedds`.
    pub vendor: String,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Counts {
    /// Other participants.
    pub participants: u32,
    pub writers: u32,
    /// Writers whose topic or type is not a ROS 2 one.
    pub foreign: u32,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "told", rename_all = "snake_case")]
pub enum Told {
    /// Names its [`crate::VERSION`], and whether it can open no file and no local socket.
    Hello { version: u32, domain: u16, confined: bool },
    /// Its participants at each change, for a farewell: prefixes of ids, 12 bytes as hex.
    Joined { participants: Vec<String> },
    /// A publisher appeared or changed.
    WriterHere(Writer),
    /// The id of a publisher.
    WriterGone { id: String },
    /// The payload is the message with its encapsulation header. The publisher was announced before and counts its
    /// messages by `number`; times are nanoseconds since 1970.
    Sample { writer: String, number: i64, sent: Option<u64>, arrived: u64 },
    /// A topic cannot be read.
    Refused { topic: String, reason: String },
    /// The payload is the definition with all its types, as in MCAP's `ros2msg`, twice: `structured` bytes from the node's
    /// structured description, and the node's own text; either may be empty. The hash is that of the request.
    Described { node: String, type_name: String, type_hash: String, structured: u32, reason: Option<String> },
    /// Every half second, and at each change.
    Alive(Counts),
    /// The child is ending on its own.
    Failed { reason: String },
}

/// The end of the pipe tells the child to end.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "wish", rename_all = "snake_case")]
pub enum Wish {
    Watch { topic: String },
    Describe { node: String, type_name: String, type_hash: String },
    Unwatch { topic: String },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_words_on_the_pipe_are_these() {
        let text = |told: &Told| serde_json::to_string(told).expect("JSON");
        let sample = Told::Sample { writer: "0110".into(), number: 7, sent: None, arrived: 9 };
        assert_eq!(text(&sample), r#"{"told":"sample","writer":"0110","number":7,"sent":null,"arrived":9}"#);
        assert_eq!(
            text(&Told::Hello { version: 1, domain: 3, confined: true }),
            r#"{"told":"hello","version":1,"domain":3,"confined":true}"#
        );
        let alive = Told::Alive(Counts { participants: 1, writers: 2, foreign: 3 });
        assert_eq!(text(&alive), r#"{"told":"alive","participants":1,"writers":2,"foreign":3}"#);
        let wish = serde_json::from_str::<Wish>(r#"{"wish":"watch","topic":"/a"}"#).expect("a wish");
        assert_eq!(wish, Wish::Watch { topic: "/a".into() });
    }
}

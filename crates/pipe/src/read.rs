//! Messages between a child that reads topics and its site. Names and types are as the site uses them.

use serde::{Deserialize, Serialize};

/// How a publisher shows that it lives, in DDS's order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Liveliness {
    /// Its middleware does it.
    #[default]
    Automatic,
    /// Its node does it for all its publishers.
    ManualByParticipant,
    /// It does it itself.
    ManualByTopic,
}

/// What a publisher offers, as far as it was announced; missing parts are the defaults of DDS.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
pub struct Quality {
    /// Lost messages are repeated.
    pub reliable: bool,
    /// Messages are kept for those who subscribe later.
    pub latched: bool,
    /// The promised interval between messages, nanoseconds; `None` = no promise.
    pub deadline: Option<u64>,
    /// How long a message stays valid, nanoseconds; `None` = forever.
    pub lifespan: Option<u64>,
    /// How it shows that it lives.
    pub liveliness: Liveliness,
    /// How often it promises to show it, nanoseconds; `None` = no promise.
    pub lease: Option<u64>,
}

/// One publisher of one topic.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Writer {
    /// Its unique id in its domain: 16 bytes as hex.
    pub id: String,
    /// Topic name, `/robot1/odom`.
    pub topic: String,
    /// Type, `package/msg/Type`.
    pub type_name: String,
    /// `RIHS01_` and 64 hex characters, if announced.
    pub type_hash: Option<String>,
    pub quality: Quality,
    /// Node name, if announced.
    pub node: Option<String>,
    /// Whether its participant announces the names of its nodes, so that a missing one is still to come.
    pub naming: bool,
    /// The maker of its middleware, a short word such as `cyclonedds`.
    pub vendor: String,
}

/// Counts in the domain.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Counts {
    /// Other participants in the domain.
    pub participants: u32,
    /// Writers of ROS 2 topics.
    pub writers: u32,
    /// Writers whose topic or type is not a ROS 2 one.
    pub foreign: u32,
}

/// From the child to the site.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "told", rename_all = "snake_case")]
pub enum Told {
    Hello {
        /// [`crate::VERSION`].
        version: u32,
        /// The domain being read.
        domain: u16,
        /// Whether it can open no file and no local socket.
        confined: bool,
    },
    /// Its participants in the domain, at each change; if the child is killed, its supervisor announces that they are gone.
    Joined {
        /// The prefixes of their ids, 12 bytes as hex: one, and for a while the one that replaces it.
        participants: Vec<String>,
    },
    /// A publisher appeared, or changed its offer.
    WriterHere(Writer),
    /// A publisher is gone.
    WriterGone { id: String },
    /// A message; its bytes with their encapsulation header are the payload.
    Sample {
        /// The publisher's id; announced before.
        writer: String,
        /// The publisher's number for the message; each is one more than the previous one.
        number: i64,
        /// When it was published, nanoseconds since 1970, if announced.
        sent: Option<u64>,
        /// When it arrived, nanoseconds since 1970.
        arrived: u64,
    },
    /// A topic cannot be read.
    Refused { topic: String, reason: String },
    /// The answer to [`Wish::Describe`]. The payload is the definition with all its types, as in MCAP's `ros2msg`, twice: as written
    /// from the node's structured description, and the node's own text; either may be empty.
    Described {
        node: String,
        /// The type, `package/msg/Type`.
        type_name: String,
        /// The hash it was asked for by; not compared with the text.
        type_hash: String,
        /// How many bytes of the payload are from the structured description.
        structured: u32,
        /// Why there is no text.
        reason: Option<String>,
    },
    /// Every half second, and at each change.
    Alive(Counts),
    /// The child is ending on its own.
    Failed { reason: String },
}

/// From the site to the child. The end of the pipe tells the child to end.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "wish", rename_all = "snake_case")]
pub enum Wish {
    /// Start reading a topic.
    Watch { topic: String },
    /// Ask a node for the definition of a type that it publishes.
    Describe {
        /// Its name, `/namespace/name`.
        node: String,
        /// The type, `package/msg/Type`.
        type_name: String,
        /// `RIHS01_` and 64 hex characters.
        type_hash: String,
    },
    /// Stop reading a topic.
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

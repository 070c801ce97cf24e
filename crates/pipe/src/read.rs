//! What a child that reads topics for a site tells it, and what it is told. Names and types are as the site uses them.

use serde::{Deserialize, Serialize};

/// What a publisher offers, as far as it was told; missing parts are the defaults of DDS.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
pub struct Quality {
    /// Lost messages are repeated.
    pub reliable: bool,
    /// Messages are kept for those who subscribe later.
    pub latched: bool,
    /// A message is promised so often, in nanoseconds; `None` = no promise.
    pub deadline: Option<u64>,
    /// A message holds so long, in nanoseconds; `None` = for ever.
    pub lifespan: Option<u64>,
}

/// One publisher of one topic.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Writer {
    /// Its own in its domain: 16 bytes as hex.
    pub id: String,
    /// Topic name, `/robot1/odom`.
    pub topic: String,
    /// Type, `package/msg/Type`.
    pub type_name: String,
    /// `RIHS01_` and 64 hex characters, where it was told.
    pub type_hash: Option<String>,
    /// What it offers.
    pub quality: Quality,
    /// Node name, where one was told.
    pub node: Option<String>,
    /// Who made its middleware, a small word as `cyclonedds`.
    pub vendor: String,
}

/// How many there are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Counts {
    /// Other participants in the domain.
    pub participants: u32,
    /// Writers of ROS 2 topics.
    pub writers: u32,
    /// Writers whose topic or type is no ROS 2 one.
    pub foreign: u32,
}

/// From the child to the site.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "told", rename_all = "snake_case")]
pub enum Told {
    /// The first frame.
    Hello {
        /// [`crate::VERSION`].
        version: u32,
        /// The domain that is read.
        domain: u16,
    },
    /// A publisher is there, or offers something else than before.
    WriterHere(Writer),
    /// A publisher is gone.
    WriterGone {
        /// Its id.
        id: String,
    },
    /// A message; its bytes with their encapsulation header are the payload.
    Sample {
        /// The publisher's id; it was told of before.
        writer: String,
        /// The publisher's number of the message; each is one more than the one before.
        number: i64,
        /// When it was published, nanoseconds since 1970, where that was told.
        sent: Option<u64>,
        /// When it had arrived, nanoseconds since 1970.
        arrived: u64,
    },
    /// A topic cannot be read.
    Refused {
        /// Topic name.
        topic: String,
        /// Why.
        reason: String,
    },
    /// Once a half second, and whenever it changes.
    Alive(Counts),
    /// It ends by itself.
    Failed {
        /// Why.
        reason: String,
    },
}

/// From the site to the child. The end of the pipe means that the child is to end.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "wish", rename_all = "snake_case")]
pub enum Wish {
    /// A topic is to be read.
    Watch {
        /// Its name.
        topic: String,
    },
    /// A topic is no longer to be read.
    Unwatch {
        /// Its name.
        topic: String,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_words_on_the_pipe_are_these() {
        let text = |told: &Told| serde_json::to_string(told).expect("JSON");
        let sample = Told::Sample { writer: "0110".into(), number: 7, sent: None, arrived: 9 };
        assert_eq!(text(&sample), r#"{"told":"sample","writer":"0110","number":7,"sent":null,"arrived":9}"#);
        assert_eq!(text(&Told::Hello { version: 1, domain: 3 }), r#"{"told":"hello","version":1,"domain":3}"#);
        let alive = Told::Alive(Counts { participants: 1, writers: 2, foreign: 3 });
        assert_eq!(text(&alive), r#"{"told":"alive","participants":1,"writers":2,"foreign":3}"#);
        let wish = serde_json::from_str::<Wish>(r#"{"wish":"watch","topic":"/a"}"#).expect("a wish");
        assert_eq!(wish, Wish::Watch { topic: "/a".into() });
    }
}

//! Messages between a child that publishes topics, of ROS 2 or of ROS 1, and its site. Names and types are as the site
//! uses them.

use serde::{Deserialize, Serialize};

/// The most messages, and about how many bytes of them, that a site hands out before the child has confirmed some.
pub const MOST_UNCONFIRMED: usize = 256;
/// See [`MOST_UNCONFIRMED`].
pub const MOST_UNCONFIRMED_BYTES: usize = 16 << 20;

/// What a publisher offers its subscribers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Offer {
    /// Lost messages are repeated.
    pub reliable: bool,
    /// Messages are kept for those who subscribe later.
    pub latched: bool,
    /// How many messages are kept.
    pub depth: u32,
}

/// A topic as published.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Topic {
    /// Its name, `/robot1/odom`.
    pub name: String,
    /// Its type, `package/msg/Type`.
    pub type_name: String,
    /// The first two bytes of every message's encapsulation header, the first one high.
    pub encoding: u16,
    pub offer: Offer,
}

/// A topic of ROS 1 as published. The text of its type's definition is the payload of the order that announces it.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Described {
    /// Its name, `/robot1/odom`.
    pub name: String,
    /// Its type, `package/Type`.
    pub type_name: String,
    /// The type's md5sum, 32 hex characters.
    pub md5sum: String,
    /// Whether the last message is kept for those who subscribe later.
    pub latched: bool,
}

/// From the site to the child; `T` is how a topic is described in its ROS. The end of the pipe tells the child to end.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "order", rename_all = "snake_case")]
pub enum Order<T = Topic> {
    /// Announce a topic; answered by [`Report::Ready`] or [`Report::Refused`].
    Advertise {
        /// A number for it, not used before.
        writer: u32,
        topic: T,
        /// Bytes of its first message, a hint for how much room it needs.
        size: u32,
        /// Refuse if somebody else publishes it.
        alone: bool,
        /// Wait for the subscribers that are known, for a while.
        patient: bool,
    },
    /// Publish a message; its bytes, in ROS 2 with their encapsulation header, are the payload.
    Publish { writer: u32 },
    /// Take a topic back at once; what is queued for it is not published.
    Withdraw { writer: u32 },
    /// Wait no longer for subscribers that are behind now.
    Outrun,
    /// Nothing more will be published; answered by [`Report::Left`] when subscribers have everything.
    Leave,
}

/// From the child to the site.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "report", rename_all = "snake_case")]
pub enum Report {
    /// The first frame: the domain is joined, or the graph.
    Hello {
        /// [`crate::VERSION`].
        version: u32,
        /// The domain; 0 in a graph of ROS 1.
        domain: u16,
        /// Whether it can open no file and no local socket.
        confined: bool,
    },
    /// The domain of ROS 2 is joined; if the child is killed, its supervisor announces that this participant is gone.
    Joined {
        /// The prefix of its ids, 12 bytes as hex.
        participant: String,
    },
    /// A topic is announced.
    Ready {
        writer: u32,
    },
    /// A topic is not announced.
    Refused {
        writer: u32,
        reason: String,
        /// Whether it is that somebody else publishes it.
        occupied: bool,
    },
    /// The oldest messages that were not confirmed yet have left the queue; none, if only the other figures changed.
    Taken {
        messages: u32,
        /// Of these the ones that a subscriber did not get because it read too slowly.
        dropped: u32,
        /// Messages of all reports so far that were sent and that a subscriber has yet to acknowledge.
        unacknowledged: u32,
        /// Messages of all reports so far that were sent to subscribers that do not acknowledge.
        unconfirmed: u64,
    },
    Left,
    /// Every half second.
    Alive {
        /// Other participants in the domain; in a graph of ROS 1, connected subscribers.
        participants: u32,
    },
    /// The child is ending on its own.
    Failed {
        reason: String,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_words_on_the_pipe_are_these() {
        let offer = Offer { reliable: true, latched: false, depth: 5 };
        let topic = Topic { name: "/a".into(), type_name: "b/msg/C".into(), encoding: 1, offer };
        let order = Order::Advertise { writer: 3, topic, size: 9, alone: true, patient: false };
        assert_eq!(
            serde_json::to_string(&order).expect("JSON"),
            r#"{"order":"advertise","writer":3,"topic":{"name":"/a","type_name":"b/msg/C","encoding":1,"offer":{"reliable":true,"latched":false,"depth":5}},"size":9,"alone":true,"patient":false}"#
        );
        let taken = r#"{"report":"taken","messages":2,"dropped":1,"unacknowledged":3,"unconfirmed":4}"#;
        let report = serde_json::from_str::<Report>(taken).expect("a report");
        assert_eq!(report, Report::Taken { messages: 2, dropped: 1, unacknowledged: 3, unconfirmed: 4 });
        assert_eq!(serde_json::to_string(&Order::<Topic>::Leave).expect("JSON"), r#"{"order":"leave"}"#);
        let topic = Described { name: "/a".into(), type_name: "b/C".into(), md5sum: "9".into(), latched: true };
        let order = Order::Advertise { writer: 3, topic, size: 0, alone: false, patient: true };
        assert_eq!(
            serde_json::to_string(&order).expect("JSON"),
            r#"{"order":"advertise","writer":3,"topic":{"name":"/a","type_name":"b/C","md5sum":"9","latched":true},"size":0,"alone":false,"patient":true}"#
        );
    }
}

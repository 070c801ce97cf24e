//! Messages between a child that publishes topics of ROS 1 or ROS 2 and its site.

use std::io::Read;
use std::sync::mpsc::{Receiver, sync_channel};

use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::receive;

/// The most messages, and about how many of their bytes, that a site sends before the child confirms some.
pub const MOST_UNCONFIRMED: usize = 256;
pub const MOST_UNCONFIRMED_BYTES: usize = 16 << 20;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Offer {
    pub reliable: bool,
    /// Messages are kept for late subscribers.
    pub latched: bool,
    pub depth: u32,
}

#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Topic {
    pub name: String,
    pub type_name: String,
    /// First two bytes of every message's encapsulation header, the first one high.
    pub encoding: u16,
    pub offer: Offer,
}

/// The definition's text is the payload of the order that announces it.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Described {
    pub name: String,
    pub type_name: String,
    pub md5sum: String,
    /// Whether the last message is kept for late subscribers.
    pub latched: bool,
}

/// `T` describes a topic in its ROS. The end of the pipe tells the child to end.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "order", rename_all = "snake_case")]
pub enum Order<T = Topic> {
    /// Answered by [`Report::Ready`] or [`Report::Refused`]. The number is new; `size` is that of the first message;
    /// `alone` refuses if another node publishes it; `patient` waits a while for the known subscribers.
    Advertise { writer: u32, topic: T, size: u32, alone: bool, patient: bool },
    /// The payload is the message; in ROS 2 with its encapsulation header.
    Publish { writer: u32 },
    /// Drops the topic with its queue.
    Withdraw { writer: u32 },
    /// Stop waiting for subscribers that are behind now.
    Outrun,
    /// No more messages come; answered by [`Report::Left`] when subscribers have everything.
    Leave,
}

/// Orders with their payloads, read in a thread; the channel closes when no more will come.
pub fn orders<T: DeserializeOwned + Send + 'static>(
    mut from: impl Read + Send + 'static,
) -> std::io::Result<Receiver<(Order<T>, Vec<u8>)>> {
    let (sender, receiver) = sync_channel(4 * MOST_UNCONFIRMED);
    let read = move || {
        while let Ok(Some(order)) = receive(&mut from)
            && sender.send(order).is_ok()
        {}
    };
    std::thread::Builder::new().name("orders".into()).spawn(read)?;
    Ok(receiver)
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "report", rename_all = "snake_case")]
pub enum Report {
    /// The first frame: the domain (0 in a graph of ROS 1) is joined.
    Hello { version: u32, domain: u16, confined: bool },
    /// For a farewell if the child is killed: the prefix of its ids, 12 bytes as hex.
    Joined { participant: String },
    /// A topic is announced.
    Ready { writer: u32 },
    /// A topic is not announced; `occupied` if another node publishes it.
    Refused { writer: u32, reason: String, occupied: bool },
    /// How many of the oldest unconfirmed messages left the queue, and how many of these a slow subscriber missed. In all:
    /// sent and not yet acknowledged, and sent to subscribers that do not acknowledge.
    Taken { messages: u32, dropped: u32, unacknowledged: u32, unconfirmed: u64 },
    /// Subscribers have everything.
    Left,
    /// Every half second.
    Alive,
    /// The child is ending on its own.
    Failed { reason: String },
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

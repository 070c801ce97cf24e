//! One published topic, and the ear that counts what left rosrust's queue.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use rosrust::api::Ros;
use rosrust::{Publisher, RawMessage, RawMessageDescription};

use crate::ear::{self, Ear, LAST, Last, Served};
use crate::error::told;
use crate::pipe::write::Described;
use crate::queue;

/// Limits of the messages that rosrust holds of one topic; a single one may have more bytes.
const MOST_AHEAD: usize = 64;
const MOST_AHEAD_BYTES: usize = 4 << 20;
/// Limit of the ear's handshake.
const PATIENCE: Duration = Duration::from_secs(2);
const EAR: &str = "/ear";

pub struct Outlet {
    pub topic: String,
    publisher: Publisher<RawMessage>,
    served: Served,
    ear: Ear,
    handed: u64,
    /// Sizes of the messages that have not come back.
    ahead: VecDeque<usize>,
    ahead_bytes: usize,
    is_outrun: bool,
    has_failed: bool,
    last: Last,
}

impl Outlet {
    pub fn begin(ros: &Ros, topic: &Described, definition: String) -> Result<Self, String> {
        let description = RawMessageDescription {
            msg_definition: definition,
            md5sum: topic.md5sum.clone(),
            msg_type: topic.type_name.clone(),
        };
        // Without rosrust's own limit, which would drop the oldest.
        let publisher = ros.publish_with_description::<RawMessage>(&topic.name, 0, description);
        let mut publisher = publisher.map_err(|error| told(&error))?;
        publisher.set_latching(topic.latched);
        let served = ear::find(ros.uri(), &topic.name).map_err(|error| error.to_string())?;
        let ear = Ear::open(&served, EAR).map_err(|error| error.to_string())?;
        let begun = Instant::now();
        while !is_known(&publisher, EAR) {
            if begun.elapsed() >= PATIENCE {
                return Err("rosrust refuses the subscriber that counts its messages".to_owned());
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        let (topic, ahead) = (topic.name.clone(), VecDeque::new());
        let (handed, ahead_bytes, is_outrun, has_failed, last) = (0, 0, false, false, Last::default());
        Ok(Self { topic, publisher, served, ear, handed, ahead, ahead_bytes, is_outrun, has_failed, last })
    }

    pub fn subscribers(&self) -> Vec<String> {
        let mut names = self.publisher.subscriber_names();
        names.retain(|name| name != EAR && name != LAST);
        names
    }

    pub fn is_deaf(&self) -> bool {
        self.has_failed || self.ear.is_deaf()
    }

    /// Whether every subscriber has the last message: rosrust has let in one that came after it. False in doubt.
    pub fn is_sent(&mut self) -> bool {
        self.last.comes_in(&self.served) && is_known(&self.publisher, LAST)
    }

    /// Messages that came back leave room.
    fn make_room(&mut self) {
        let waiting = usize::try_from(self.handed.saturating_sub(self.ear.heard())).unwrap_or(usize::MAX);
        while self.ahead.len() > waiting {
            self.ahead_bytes -= self.ahead.pop_front().unwrap_or(0);
        }
    }
}

fn is_known(publisher: &Publisher<RawMessage>, name: &str) -> bool {
    publisher.subscriber_names().iter().any(|known| known == name)
}

impl queue::Outlet for Outlet {
    fn attempt(&mut self, message: Vec<u8>) -> Result<u64, Vec<u8>> {
        self.make_room();
        let size = message.len();
        let is_full = self.ahead.len() >= MOST_AHEAD || self.ahead_bytes + size > MOST_AHEAD_BYTES;
        if is_full && !self.ahead.is_empty() {
            return Err(message);
        }
        let message = RawMessage(message);
        // A message that cannot be sent never comes back.
        self.has_failed |= self.publisher.send(message).is_err();
        self.handed += 1;
        self.ahead.push_back(size);
        self.ahead_bytes += size;
        Ok(self.handed)
    }

    fn left(&self) -> u64 {
        self.ear.heard()
    }

    fn has_caught_up(&self) -> bool {
        self.ear.heard() >= self.handed
    }

    fn is_outrun(&self) -> bool {
        self.is_outrun
    }

    fn outrun(&mut self, is_outrun: bool) {
        self.is_outrun = is_outrun;
    }
}

//! Which captured messages are compressed before they are sealed. Each is compressed by itself; what is learnt
//! per topic is only whether it paid, so that topics of JPEGs cost one try in many.

use std::collections::HashMap;
use std::sync::Arc;

use crate::crypto::compression::{Packed, pack};
use crate::ros::{Definition, Message};

/// The longest pause between two tries on a topic where it does not pay, messages.
const LONGEST_PAUSE: u32 = 256;

/// Topics and definitions remembered at most.
const MOST_KNOWN: usize = 1024;

/// How compression went on one topic.
#[derive(Debug, Default)]
struct Habit {
    /// Messages that are let through before the next try.
    waits: u32,
    /// How many that were the last time.
    pause: u32,
}

/// What is known about the topics.
#[derive(Debug, Default)]
pub struct Packing {
    habits: HashMap<Arc<str>, Habit>,
    definitions: HashMap<Arc<str>, Option<Arc<Definition>>>,
}

impl Packing {
    /// The message compressed, where that pays.
    pub fn pack(&mut self, message: &Message) -> Option<Packed> {
        let habit = entry(&mut self.habits, &message.topic);
        if habit.waits > 0 {
            habit.waits -= 1;
            return None;
        }
        let parsed = || Definition::parse(&message.type_name, &message.definition).ok().map(Arc::new);
        let definition = known(&mut self.definitions, &message.definition, parsed);
        let matrix = definition.and_then(|definition| definition.matrix(&message.body));
        let packed = pack(&message.body, matrix.as_ref());
        let habit = entry(&mut self.habits, &message.topic);
        habit.pause = if packed.is_some() { 0 } else { (habit.pause * 2).clamp(1, LONGEST_PAUSE) };
        habit.waits = habit.pause;
        packed
    }
}

fn entry<'a>(habits: &'a mut HashMap<Arc<str>, Habit>, topic: &Arc<str>) -> &'a mut Habit {
    if habits.len() >= MOST_KNOWN && !habits.contains_key(topic) {
        habits.clear();
    }
    habits.entry(Arc::clone(topic)).or_default()
}

fn known(
    definitions: &mut HashMap<Arc<str>, Option<Arc<Definition>>>,
    text: &Arc<str>,
    parse: impl FnOnce() -> Option<Arc<Definition>>,
) -> Option<Arc<Definition>> {
    if definitions.len() >= MOST_KNOWN && !definitions.contains_key(text) {
        definitions.clear();
    }
    definitions.entry(Arc::clone(text)).or_insert_with(parse).clone()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Timestamp;
    use crate::ros::Origin;

    fn message(topic: &str, body: Vec<u8>) -> Message {
        Message {
            topic: topic.into(),
            type_name: "std_msgs/String".into(),
            md5sum: "992ce8a1687cec8c8bd883ec73ca41d1".into(),
            definition: "string data".into(),
            caller_id: "/a".into(),
            origin: Arc::new(Origin {
                number: 1,
                caller_id: "/a".into(),
                host: "robot".into(),
                uri: "http://robot:1/".into(),
                type_name: "std_msgs/String".into(),
                md5sum: "992ce8a1687cec8c8bd883ec73ca41d1".into(),
                listed_at: std::time::Instant::now(),
                rival: None,
            }),
            captured_at: Timestamp(1),
            header_seq: None,
            body,
        }
    }

    #[test]
    fn what_never_pays_is_tried_ever_more_rarely_and_what_pays_each_time() {
        let mut packing = Packing::default();
        let mut state = 7u32;
        let mut noise = || {
            state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
            state.to_le_bytes()[3]
        };
        let noise: Vec<u8> = (0..2000).map(|_| noise()).collect();
        for _ in 0..600 {
            assert_eq!(packing.pack(&message("/noise", noise.clone())), None);
            assert!(packing.pack(&message("/zeros", vec![0; 2000])).is_some_and(|packed| packed.bytes.len() < 100));
        }
        assert_eq!(packing.habits["/noise"].pause, LONGEST_PAUSE);
        // Once it pays again, the next try finds it.
        let found = (0..=LONGEST_PAUSE).filter(|_| packing.pack(&message("/noise", vec![0; 2000])).is_some()).count();
        assert!(found > 0);
    }
}

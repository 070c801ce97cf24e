//! Which captured messages are compressed before they are sealed. Learns per topic whether that pays, so that topics of
//! JPEGs cost only an occasional try.

use std::collections::HashMap;
use std::sync::Arc;

use crate::crypto::compression::{Packed, pack};
use crate::ros::{Definition, Message};

/// The longest pause between two tries on a topic where compression does not pay, messages.
const LONGEST_PAUSE: u32 = 256;

/// The most topics and definitions remembered.
const MOST_KNOWN: usize = 1024;

#[derive(Debug, Default)]
struct Habit {
    /// Messages to skip before the next try.
    waits: u32,
    /// How many were skipped the last time.
    pause: u32,
}

#[derive(Debug, Default)]
pub struct Packing {
    habits: HashMap<Arc<str>, Habit>,
    definitions: HashMap<Arc<str>, Option<Arc<Definition>>>,
}

#[derive(Debug)]
pub struct Try {
    definition: Option<Arc<Definition>>,
}

impl Try {
    pub fn pack(&self, message: &Message) -> Option<Packed> {
        let matrix = self.definition.as_ref().and_then(|definition| definition.matrix(&message.body));
        pack(&message.body, matrix.as_ref())
    }
}

impl Packing {
    /// Pass each outcome to [`Self::learn`], topic by topic in the order of messages.
    pub fn decide(&mut self, message: &Message) -> Option<Try> {
        let habit = entry(&mut self.habits, &message.topic);
        if habit.waits > 0 {
            habit.waits -= 1;
            return None;
        }
        if habit.pause > 0 {
            // Until the outcome is known, the last one is assumed: others of its round are not tried in vain.
            habit.waits = next_pause(habit.pause);
        }
        if self.definitions.len() >= MOST_KNOWN && !self.definitions.contains_key(&message.definition) {
            self.definitions.clear();
        }
        let parsed = || {
            let (name, text) = (&message.type_name, &message.definition);
            let parse = if name.contains("/msg/") { Definition::parse_ros2 } else { Definition::parse };
            parse(name, text).ok().map(Arc::new)
        };
        let definition = self.definitions.entry(Arc::clone(&message.definition)).or_insert_with(parsed).clone();
        Some(Try { definition })
    }

    pub fn learn(&mut self, topic: &Arc<str>, paid: bool) {
        let habit = entry(&mut self.habits, topic);
        habit.pause = if paid { 0 } else { next_pause(habit.pause) };
        habit.waits = habit.pause;
    }
}

fn next_pause(pause: u32) -> u32 {
    (pause * 2).clamp(1, LONGEST_PAUSE)
}

fn entry<'a>(habits: &'a mut HashMap<Arc<str>, Habit>, topic: &Arc<str>) -> &'a mut Habit {
    if habits.len() >= MOST_KNOWN && !habits.contains_key(topic) {
        habits.clear();
    }
    habits.entry(Arc::clone(topic)).or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Timestamp;
    use crate::pipeline::fixture;

    fn message(topic: &str, body: Vec<u8>) -> Message {
        fixture::message(topic, Timestamp(1), body)
    }

    #[test]
    fn what_never_pays_is_tried_ever_more_rarely_and_what_pays_each_time() {
        let mut packing = Packing::default();
        let mut pack = |message: Message| {
            let packed = packing.decide(&message).map(|tried| tried.pack(&message));
            packed.iter().for_each(|packed| packing.learn(&message.topic, packed.is_some()));
            packed.flatten()
        };
        let mut state = 7u32;
        let mut noise = || {
            state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
            state.to_le_bytes()[3]
        };
        let noise: Vec<u8> = (0..2000).map(|_| noise()).collect();
        for _ in 0..600 {
            assert_eq!(pack(message("/noise", noise.clone())), None);
            assert!(pack(message("/zeros", vec![0; 2000])).is_some_and(|packed| packed.bytes.len() < 100));
        }
        // Once it pays again, the next try finds it.
        let found = (0..=LONGEST_PAUSE).filter(|_| pack(message("/noise", vec![0; 2000])).is_some()).count();
        assert!(found > 0);
        assert!((0..100).all(|_| pack(message("/noise", vec![0; 2000])).is_some()), "from then on each time");
    }

    #[test]
    fn a_round_in_which_nothing_is_known_yet_tries_no_more_than_one_of_what_did_not_pay() {
        let mut packing = Packing::default();
        let one = message("/noise", vec![0; 200]);
        for round in 0..8 {
            let tried = (0..100).filter(|_| packing.decide(&one).is_some()).count();
            assert!(if round == 0 { tried == 100 } else { tried <= 2 }, "{tried} in round {round}");
            (0..tried).for_each(|_| packing.learn(&one.topic, false));
        }
        assert_eq!(packing.habits["/noise"].pause, LONGEST_PAUSE);
    }
}

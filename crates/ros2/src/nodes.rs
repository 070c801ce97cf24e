//! The node of each writer, as published by ROS 2 on a topic of its own. The message is `rmw_dds_common`'s
//! `ParticipantEntitiesInfo`; up to Humble an id takes 24 bytes, later 16.

use std::collections::HashMap;

use crate::cdr::Reader;

/// The most writers whose node is remembered.
const MOST: usize = 20_000;
/// The longest accepted node name, with its namespace.
const LONGEST: usize = 255;

/// An id, independent of the length in which it came.
type Id = [u8; 16];

/// Nodes by the ids of their writers.
#[derive(Default)]
pub struct Nodes {
    by_participant: HashMap<Id, Vec<(Id, String)>>,
    kept: usize,
}

impl Nodes {
    /// Takes a message of `sender`, with its header. Ignores what cannot be read, and what it says of another participant.
    pub fn take(&mut self, sender: &Id, message: &[u8]) {
        let Some((participant, writers)) = [16, 24].into_iter().find_map(|length| parse(message, length)) else {
            return;
        };
        if participant[..12] != sender[..12] {
            return;
        }
        self.forget(&participant);
        if self.kept + writers.len() <= MOST {
            self.kept += writers.len();
            self.by_participant.insert(participant, writers);
        }
    }

    fn forget(&mut self, participant: &Id) {
        self.kept -= self.by_participant.remove(participant).map_or(0, |writers| writers.len());
    }

    /// Keeps only participants that are still present; an id's first twelve bytes are its participant's.
    pub fn keep(&mut self, is_there: impl Fn(&[u8]) -> bool) {
        let gone: Vec<Id> = self.by_participant.keys().filter(|id| !is_there(&id[..12])).copied().collect();
        gone.iter().for_each(|id| self.forget(id));
    }

    /// The node of a writer, `/namespace/name`.
    pub fn of(&self, writer: &Id) -> Option<&str> {
        let lists = self.by_participant.iter().filter(|(id, _)| id[..12] == writer[..12]);
        lists.flat_map(|(_, writers)| writers).find(|(id, _)| id == writer).map(|(_, node)| node.as_str())
    }
}

/// The participant and its writers, if the message can be read to its end with ids of this length.
fn parse(message: &[u8], id: usize) -> Option<(Id, Vec<(Id, String)>)> {
    let mut reader = Reader::of(message)?;
    let participant = reader.id(id)?;
    let mut writers = Vec::new();
    // Each list is bounded by the bytes that are left.
    for _ in 0..reader.count(8)? {
        let (namespace, name) = (reader.text()?, reader.text()?);
        let node = match namespace {
            "/" | "" => format!("/{name}"),
            _ => format!("{namespace}/{name}"),
        };
        for _ in 0..reader.count(id)? {
            reader.id(id)?;
        }
        for _ in 0..reader.count(id)? {
            let writer = reader.id(id)?;
            let fits = node.len() <= LONGEST && !node.chars().any(char::is_control);
            writers.extend(fits.then(|| (writer, node.clone())));
        }
    }
    // Up to three bytes of padding.
    (reader.left() < 4).then_some((participant, writers))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As written by a node of Jazzy (16) or Humble (24).
    fn message(id: usize, namespace: &str, name: &str) -> Vec<u8> {
        let mut bytes = vec![0, 1, 0, 0];
        let put_text = |bytes: &mut Vec<u8>, text: &str| {
            while !(bytes.len() - 4).is_multiple_of(4) {
                bytes.push(0);
            }
            bytes.extend(u32::try_from(text.len() + 1).expect("short").to_le_bytes());
            bytes.extend(text.bytes().chain([0]));
        };
        let put_ids = |bytes: &mut Vec<u8>, ids: &[u8]| {
            while !(bytes.len() - 4).is_multiple_of(4) {
                bytes.push(0);
            }
            bytes.extend(u32::try_from(ids.len()).expect("few").to_le_bytes());
            for last in ids {
                let mut own = vec![7; 16];
                own[15] = *last;
                own.resize(id, 0);
                bytes.extend(own);
            }
        };
        let mut participant = vec![7; 16];
        participant.resize(id, 0);
        bytes.extend(participant);
        bytes.extend(1_u32.to_le_bytes());
        put_text(&mut bytes, namespace);
        put_text(&mut bytes, name);
        put_ids(&mut bytes, &[1]);
        put_ids(&mut bytes, &[2, 3]);
        bytes
    }

    #[test]
    fn writers_belong_to_nodes_in_both_lengths_of_ids() {
        for length in [16, 24] {
            let mut nodes = Nodes::default();
            nodes.take(&[7; 16], &message(length, "/robot1", "driver"));
            let mut id = [7; 16];
            for (last, node) in [(2, Some("/robot1/driver")), (3, Some("/robot1/driver")), (1, None), (9, None)] {
                id[15] = last;
                assert_eq!(nodes.of(&id), node, "{length} {last}");
            }
            nodes.keep(|prefix| prefix != [7; 12]);
            id[15] = 2;
            assert_eq!((nodes.of(&id), nodes.kept), (None, 0));
        }
        let mut nodes = Nodes::default();
        nodes.take(&[7; 16], &message(16, "/", "driver"));
        assert_eq!(nodes.of(&[[7; 15].as_slice(), &[2]].concat().try_into().expect("16")), Some("/driver"));
    }

    #[test]
    fn nobody_names_the_writers_of_another_participant() {
        let mut nodes = Nodes::default();
        nodes.take(&[8; 16], &message(16, "/", "driver"));
        assert_eq!(nodes.kept, 0);
    }

    #[test]
    fn hostile_messages_are_left_out() {
        let whole = message(16, "/", "x");
        let mut nodes = Nodes::default();
        for end in 0..whole.len() - 3 {
            nodes.take(&[7; 16], &whole[..end]);
        }
        let mut claim = whole.clone();
        claim[20..24].copy_from_slice(&u32::MAX.to_le_bytes());
        nodes.take(&[7; 16], &claim);
        nodes.take(&[7; 16], &message(16, "/", "x\u{1b}[2J"));
        assert_eq!(nodes.kept, 0);
    }
}

//! A topic with more definition records than are opened for one message: each message still gets the one that it names.

use super::keeping::{head, sealed_as};
use super::*;
use crate::crypto::SealedRecord;
use crate::model::{Address, Head};
use crate::pipeline::reader::{Opening, Reader};

/// More than twice as many as are opened at one attempt.
const MANY: u64 = 450;

fn text(number: u64) -> String {
    format!("string data # {number}")
}

/// A definition record and the message after it.
fn pair(line: &Line, number: u64) -> [SealedRecord; 2] {
    let text = text(number);
    let of_message = Head { definition: Digest(sm3(&[text.as_bytes()])), ..head(b"message") };
    let definition = (&head(text.as_bytes()), text.as_bytes());
    [
        sealed_as(RecordKind::Definition, &line.owner, 2 * number + 1, Vec::new(), definition, None),
        sealed_as(RecordKind::Data, &line.owner, 2 * number + 2, Vec::new(), (&of_message, b"message"), None),
    ]
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_first_of_many_definitions_is_found() {
    let line = Line::new().await;
    line.owner.prepare_epoch(line.network.domain, 1).expect("prepared");
    line.owner.seal_under(line.network.domain, 1).expect("seals");
    let mut messages = Vec::new();
    for number in 0..MANY {
        for sealed in pair(&line, number) {
            let digest = sealed.digest;
            let row = NewRecord::foreign(sealed, Address([8; 20]));
            line.plant.keep([row], |row| line.plant.ledger.records.append(row.into())).expect("taken");
            messages.push(digest);
        }
    }
    let reader = Reader { plant: &line.plant, network: &line.network, reader: &line.owner };
    for number in [0, 1, MANY / 2, MANY - 1] {
        let place = usize::try_from(2 * number + 1).expect("small");
        let row = line.plant.ledger.records.find(messages[place]).expect("read").expect("there");
        let opened = reader.own_contents(&row).expect("read").expect("opens");
        for by in [Opening::Own, Opening::Anchored] {
            assert_eq!(reader.definition_text(&row, &opened, by).await.expect("read"), Some(text(number)), "{by:?}");
        }
    }
}

const RIG: &str = "rig_msgs/msg/Grip";
const FORCE: &str = "float64 force\n";

/// A message of a type of ROS 2 with this hash that names a definition, and the definition's record before it.
fn pair_of_two(line: &Line, seq: u64, definition: &str, hash: &str) -> [SealedRecord; 2] {
    let tags = [("encoding", "cdr"), ("mcap.channel.topic_type_hash", hash)];
    let tags: std::collections::BTreeMap<_, _> = tags.map(|(key, value)| (key.to_owned(), value.to_owned())).into();
    let of = |body: &[u8]| Head { type_name: RIG.into(), md5sum: "*".into(), tags: tags.clone(), ..head(body) };
    let of_message = Head { definition: Digest(sm3(&[definition.as_bytes()])), ..of(b"message") };
    let text = (&of(definition.as_bytes()), definition.as_bytes());
    [
        sealed_as(RecordKind::Definition, &line.owner, seq, Vec::new(), text, None),
        sealed_as(RecordKind::Data, &line.owner, seq + 1, Vec::new(), (&of_message, b"message"), None),
    ]
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_definition_that_comes_later_serves_the_messages_before_it() {
    let line = Line::new().await;
    line.owner.prepare_epoch(line.network.domain, 1).expect("prepared");
    line.owner.seal_under(line.network.domain, 1).expect("seals");
    let own = crate::ros::message::type_hash(RIG, FORCE).expect("a definition");
    let other = crate::ros::message::type_hash(RIG, "float64 power\n").expect("a definition");
    let (before, foreign, after) =
        (pair_of_two(&line, 1, "", &own), pair_of_two(&line, 3, "", &other), pair_of_two(&line, 5, FORCE, &own));
    let messages = [&before, &foreign, &after].map(|[_, message]| message.digest);
    for sealed in [before, foreign, after].into_iter().flatten() {
        let row = NewRecord::foreign(sealed, Address([8; 20]));
        line.plant.keep([row], |row| line.plant.ledger.records.append(row.into())).expect("taken");
    }
    let reader = Reader { plant: &line.plant, network: &line.network, reader: &line.owner };
    for (digest, expected) in messages.into_iter().zip([FORCE, "", FORCE]) {
        let row = line.plant.ledger.records.find(digest).expect("read").expect("there");
        let opened = reader.own_contents(&row).expect("read").expect("opens");
        for by in [Opening::Own, Opening::Anchored] {
            let found = reader.definition_text(&row, &opened, by).await.expect("read");
            assert_eq!(found.as_deref(), Some(expected), "{by:?}");
        }
    }
}

//! Recordings: any bag or MCAP file is read to its end, and what was read is written and read again.

use std::io::Cursor;
use std::sync::Arc;

use authros::model::Timestamp;
use authros::ros::bag::{BagReader, BagWriter};
use authros::ros::mcap::{McapReader, McapWriter};
use authros::ros::recording::{
    Beside, Channel, ChunkCompression, Encoding, RecordedMessage, RecordingReader as _, Sent,
};

use crate::Sample;

/// No more is read: a few bytes may decompress to many messages.
const MOST: usize = 10_000;

/// The bytes as a bag.
pub fn bag(bytes: &[u8]) -> bool {
    let Ok(mut reader) = BagReader::open(Cursor::new(bytes)) else { return false };
    let messages = all(|| reader.next_message().expect("reading from memory"));
    let Some(compression) = rewrites(&messages, bytes, [ChunkCompression::None, ChunkCompression::Bz2]) else {
        return !messages.is_empty();
    };
    let mut writer = BagWriter::begin(Cursor::new(Vec::new()), compression).expect("begun");
    for message in &messages {
        writer.write(&message.channel, message.time, &message.body).expect("what a bag held, a bag holds");
    }
    let file = writer.finish().expect("finished").into_inner();
    let mut reader = BagReader::open(Cursor::new(&file)).expect("our own");
    assert!(all(|| reader.next_message().expect("reading from memory")) == messages && reader.findings().is_whole());
    true
}

/// The bytes as MCAP.
pub fn mcap(bytes: &[u8]) -> bool {
    let Ok(mut reader) = McapReader::open(Cursor::new(bytes)) else { return false };
    let messages = all(|| reader.next_message().expect("reading from memory"));
    let Some(compression) = rewrites(&messages, bytes, [ChunkCompression::Lz4, ChunkCompression::Zstd]) else {
        return !messages.is_empty();
    };
    let mut writer = McapWriter::begin(Cursor::new(Vec::new()), compression).expect("begun");
    for message in &messages {
        // Attachments have none.
        let sent = message.sent.unwrap_or(Sent { time: message.time, sequence: 0 });
        writer.write_sent(&message.channel, message.time, sent, &message.body).expect("what MCAP held, MCAP holds");
    }
    let file = writer.finish().expect("finished").into_inner();
    let mut reader = McapReader::open(Cursor::new(&file)).expect("our own");
    let again = all(|| reader.next_message().expect("reading from memory"));
    assert!(timed(again) == timed(messages) && reader.findings().is_whole());
    true
}

/// Without the times of metadata, which has none: they are those of the messages around it.
fn timed(mut messages: Vec<RecordedMessage>) -> Vec<RecordedMessage> {
    for message in messages.iter_mut().filter(|message| message.channel.encoding == Encoding::Beside(Beside::Metadata))
    {
        message.time = Timestamp(0);
    }
    messages
}

fn all(mut next: impl FnMut() -> Option<RecordedMessage>) -> Vec<RecordedMessage> {
    std::iter::from_fn(&mut next).take(MOST).collect()
}

/// How to write the messages again: not all, because that costs time; and nanoseconds beyond a second give another
/// time.
fn rewrites(messages: &[RecordedMessage], bytes: &[u8], ways: [ChunkCompression; 2]) -> Option<ChunkCompression> {
    let small = messages.iter().map(|message| message.body.len()).sum::<usize>() < 1 << 20;
    let plain = messages.iter().all(|message| u32::try_from(message.time.0 / 1_000_000_000).is_ok());
    // An IDL schema has two names, of which one is written; a schema's number 0 means none.
    (!messages.is_empty() && small && plain).then(|| ways[usize::from(bytes.last().is_some_and(|last| last & 1 == 1))])
}

fn samples_of(write: fn(&[RecordedMessage]) -> Vec<Sample>) -> Vec<Sample> {
    let channel = |topic: &str, caller_id: &str| {
        Arc::new(Channel {
            topic: topic.into(),
            type_name: "std_msgs/UInt32".into(),
            md5sum: "304a39449588c7f8ce2df6e8001c5fce".into(),
            definition: "uint32 data\n".into(),
            caller_id: caller_id.into(),
            latching: !caller_id.is_empty(),
            encoding: Encoding::Ros1,
            about: std::collections::BTreeMap::new(),
        })
    };
    let (one, other) = (channel("/count", "/counter"), channel("/sum", ""));
    let message = |channel: &Arc<Channel>, number: u8| RecordedMessage {
        channel: Arc::clone(channel),
        time: Timestamp(1_000_000_000 + u64::from(number)),
        sent: None,
        body: vec![number, 0, 0, 0],
    };
    write(&(0..6).flat_map(|number| [message(&one, number), message(&other, number)]).collect::<Vec<_>>())
}

/// Bags of every compression.
pub fn bags() -> Vec<Sample> {
    samples_of(|messages| {
        let ways = [("none", ChunkCompression::None), ("bz2", ChunkCompression::Bz2), ("lz4", ChunkCompression::Lz4)];
        ways.map(|(name, compression)| {
            let mut writer = BagWriter::begin(Cursor::new(Vec::new()), compression).expect("begun");
            for message in messages {
                writer.write(&message.channel, message.time, &message.body).expect("written");
            }
            (name, writer.finish().expect("finished").into_inner())
        })
        .into()
    })
}

/// MCAP files of every compression; those named `foreign` in the corpus were written by the format's Python library.
pub fn mcaps() -> Vec<Sample> {
    samples_of(|messages| {
        let ways = [("none", ChunkCompression::None), ("lz4", ChunkCompression::Lz4), ("zstd", ChunkCompression::Zstd)];
        ways.map(|(name, compression)| {
            let mut writer = McapWriter::begin(Cursor::new(Vec::new()), compression).expect("begun");
            for message in messages {
                writer.write(&message.channel, message.time, &message.body).expect("written");
            }
            (name, writer.finish().expect("finished").into_inner())
        })
        .into()
    })
}

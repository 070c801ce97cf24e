//! The guarantees of both formats: what was written is read, damage is skipped and reported, nothing panics.

use std::io::Cursor;
use std::sync::Arc;

use proptest::prelude::*;

use super::*;
use crate::ros::Result;
use crate::ros::bag::{BagReader, BagWriter};
use crate::ros::mcap::{McapReader, McapWriter};

const DEFINITION: &str = "uint32 data\n";

pub(super) fn channel(topic: &str, caller_id: &str) -> Arc<Channel> {
    Arc::new(Channel {
        topic: topic.into(),
        type_name: "std_msgs/UInt32".into(),
        md5sum: "304a39449588c7f8ce2df6e8001c5fce".into(),
        definition: DEFINITION.into(),
        caller_id: caller_id.into(),
        latching: caller_id.len() % 2 == 1,
        encoding: Encoding::Ros1,
        about: BTreeMap::new(),
    })
}

pub(super) fn message(channel: &Arc<Channel>, time: u64, body: &[u8]) -> RecordedMessage {
    RecordedMessage { channel: Arc::clone(channel), time: Timestamp(time), sent: None, body: body.to_vec() }
}

pub(super) fn write(format: RecordingFormat, compression: ChunkCompression, messages: &[RecordedMessage]) -> Vec<u8> {
    let out = Cursor::new(Vec::new());
    let each = |write: &mut dyn FnMut(&RecordedMessage) -> Result<()>| {
        messages.iter().for_each(|message| write(message).expect("written"));
    };
    match format {
        RecordingFormat::Bag => {
            let mut writer = BagWriter::begin(out, compression).expect("begun");
            each(&mut |message| writer.write(&message.channel, message.time, &message.body));
            writer.finish().expect("finished").into_inner()
        }
        RecordingFormat::Mcap | RecordingFormat::Rosbag2 => {
            let mut writer = McapWriter::begin(out, compression).expect("begun");
            each(&mut |message| writer.write(&message.channel, message.time, &message.body));
            writer.finish().expect("finished").into_inner()
        }
    }
}

pub(super) fn read(format: RecordingFormat, bytes: &[u8]) -> Result<(Vec<RecordedMessage>, Findings)> {
    let mut messages = Vec::new();
    let file = Cursor::new(bytes);
    match format {
        RecordingFormat::Bag => {
            let mut reader = BagReader::open(file)?;
            while let Some(message) = reader.next_message()? {
                messages.push(message);
            }
            Ok((messages, reader.findings().clone()))
        }
        RecordingFormat::Mcap | RecordingFormat::Rosbag2 => {
            let mut reader = McapReader::open(file)?;
            while let Some(message) = reader.next_message()? {
                messages.push(RecordedMessage { sent: None, ..message });
            }
            Ok((messages, reader.findings().clone()))
        }
    }
}

pub(super) const WAYS: [(RecordingFormat, ChunkCompression); 6] = [
    (RecordingFormat::Bag, ChunkCompression::None),
    (RecordingFormat::Bag, ChunkCompression::Bz2),
    (RecordingFormat::Bag, ChunkCompression::Lz4),
    (RecordingFormat::Mcap, ChunkCompression::None),
    (RecordingFormat::Mcap, ChunkCompression::Lz4),
    (RecordingFormat::Mcap, ChunkCompression::Zstd),
];

/// Three chunks and a bit, from two publishers.
fn several_chunks() -> Vec<RecordedMessage> {
    let (odometry, picture) = (channel("/odom", "/base"), channel("/camera", "/lens"));
    let large: Vec<u8> =
        (0..300_000_u32).map(|index| u8::try_from(index.wrapping_mul(index) % 251).expect("a byte")).collect();
    let mut messages = Vec::new();
    for number in 0..10_u8 {
        messages.push(message(&odometry, 1_000_000_007 + u64::from(number) * 50, &[number; 4]));
        messages.push(message(&picture, 1_000_000_011 + u64::from(number) * 50, &[&[number], &large[..]].concat()));
    }
    messages
}

#[test]
fn what_is_written_is_read_in_every_way() {
    let messages = several_chunks();
    for (format, compression) in WAYS {
        let bytes = write(format, compression, &messages);
        let (found, findings) = read(format, &bytes).expect("read");
        assert!(found == messages && findings.is_whole(), "{format:?} {compression} {findings:?}");
    }
    for (format, compression) in WAYS {
        assert_eq!(read(format, &write(format, compression, &[])).expect("empty").0, []);
    }
}

#[test]
fn a_bag_without_index_is_read_whole() {
    let messages = several_chunks();
    for (format, compression) in WAYS {
        let bytes = write(format, compression, &messages);
        // The end of the last chunk's indexes: what follows is the summary.
        let (found, findings) = read(format, &bytes[..bytes.len() - 300]).expect("read");
        assert!(found == messages, "{format:?} {compression} {findings:?}");
    }
    let mut bytes = write(RecordingFormat::Bag, ChunkCompression::Lz4, &messages);
    let place = bytes.windows(10).position(|at| at == b"index_pos=").expect("a header") + 10;
    bytes[place..place + 8].fill(0);
    assert!(read(RecordingFormat::Bag, &bytes).expect("read").0 == messages);
}

#[test]
fn a_damaged_chunk_is_skipped_and_told_and_the_others_are_read() {
    let messages = several_chunks();
    for (format, compression) in WAYS {
        let good = write(format, compression, &messages);
        let mut bytes = good.clone();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 0x10;
        let (found, findings) = read(format, &bytes).expect("read");
        if (format, compression) == (RecordingFormat::Bag, ChunkCompression::None) {
            // Nothing in the format shows it: there is no checksum.
            assert_eq!(found.len(), messages.len());
            continue;
        }
        assert_eq!(findings.damages.len(), 1, "{format:?} {compression} {findings:?}");
        assert!(found.len() >= 10 && found.len() < messages.len(), "{format:?} {compression}: {}", found.len());
        assert!(found.iter().all(|message| messages.contains(message)), "what is given out was written");
    }
}

#[test]
fn a_wrong_length_is_gone_around() {
    let messages = several_chunks();
    for compression in [ChunkCompression::None, ChunkCompression::Bz2, ChunkCompression::Lz4] {
        let mut bytes = write(RecordingFormat::Bag, compression, &messages);
        // The first chunk begins after the padded header; its data's length claims to be 1 GiB longer.
        let size = bytes.windows(5).position(|at| at == b"size=").expect("a chunk") + 5;
        bytes[size + 7] ^= 0x40;
        let (found, findings) = read(RecordingFormat::Bag, &bytes).expect("read");
        assert_eq!(findings.damages.len(), 1, "{findings:?}");
        assert!(found.len() >= 10 && found.iter().all(|message| messages.contains(message)), "{}", found.len());
    }
}

#[test]
fn the_recording_of_a_killed_recorder_is_read_to_its_end() {
    let messages = several_chunks();
    for compression in [ChunkCompression::None, ChunkCompression::Bz2, ChunkCompression::Lz4] {
        let mut bytes = write(RecordingFormat::Bag, compression, &messages[..4]);
        let size = bytes.windows(5).position(|at| at == b"size=").expect("a chunk") + 5;
        // Neither length of the only chunk had been written yet, and no index.
        let end = size
            + 8
            + usize::try_from(u32::from_le_bytes(bytes[size + 4..size + 8].try_into().expect("4"))).expect("usize");
        bytes.truncate(end);
        bytes[size..size + 8].fill(0);
        let (found, _) = read(RecordingFormat::Bag, &bytes).expect("read");
        assert!(found == messages[..4], "{compression}: {}", found.len());
    }
}

#[test]
fn cut_off_anywhere_the_beginning_is_read() {
    let channel = channel("/odom", "/base");
    let messages: Vec<_> = (0..20_u8).map(|number| message(&channel, u64::from(number), &[number; 30])).collect();
    for (format, compression) in WAYS {
        let bytes = write(format, compression, &messages);
        // The first 4 KiB of a bag are padding.
        for length in (0..bytes.len()).filter(|length| length % 64 == 0 || *length > 4000) {
            let Ok((found, _)) = read(format, &bytes[..length]) else { continue };
            assert!(found == messages[..found.len()], "{format:?} {compression} cut at {length}");
        }
    }
}

#[test]
fn a_chunk_that_is_cut_says_whether_anything_of_it_was_read() {
    let one = [several_chunks().remove(1)];
    for (compression, words) in
        [(ChunkCompression::None, "everything before that was read"), (ChunkCompression::Zstd, "were not read")]
    {
        let bytes = write(RecordingFormat::Mcap, compression, &one);
        // The chunk is followed by its index and the summary: a third of the file is inside the chunk.
        let (found, findings) = read(RecordingFormat::Mcap, &bytes[..bytes.len() / 3]).expect("read");
        assert!(found.is_empty(), "the only message is cut");
        assert!(findings.damages[0].text.contains(words), "{compression}: {findings:?}");
    }
}

#[test]
fn no_flipped_byte_is_taken_for_another_message_where_there_is_a_checksum() {
    let channel = channel("/odom", "/base");
    let messages: Vec<_> = (0..20_u8).map(|number| message(&channel, u64::from(number), &[number; 30])).collect();
    for (format, compression) in WAYS {
        let good = write(format, compression, &messages);
        for place in (0..good.len()).filter(|place| place % 64 == 0 || *place < 100 || *place > 4000) {
            let mut bytes = good.clone();
            bytes[place] ^= 0x55;
            let Ok((found, _)) = read(format, &bytes) else { continue };
            let same = |message: &RecordedMessage| {
                messages.iter().any(|known| known.body == message.body && known.time == message.time)
            };
            let unguarded = (format, compression) == (RecordingFormat::Bag, ChunkCompression::None);
            assert!(unguarded || found.iter().all(same), "{format:?} {compression} flipped at {place}");
        }
    }
}

#[test]
fn lies_about_lengths_cost_no_memory() {
    // A chunk that claims 4 GiB, one that decompresses to more than it says, a connection of 4 GiB.
    let mut bag = write(RecordingFormat::Bag, ChunkCompression::Lz4, &several_chunks());
    let size = bag.windows(5).position(|at| at == b"size=").expect("a chunk") + 5;
    bag[size..size + 4].copy_from_slice(&u32::MAX.to_le_bytes());
    assert_eq!(read(RecordingFormat::Bag, &bag).expect("read").1.damages.len(), 1);
    bag[size..size + 4].copy_from_slice(&10_u32.to_le_bytes());
    assert_eq!(read(RecordingFormat::Bag, &bag).expect("read").1.damages.len(), 1);
}

#[test]
fn ros_2_is_kept_as_cdr_and_goes_into_no_bag() {
    let cdr = Arc::new(Channel {
        type_name: "std_msgs/msg/UInt32".into(),
        md5sum: "*".into(),
        encoding: Encoding::Cdr { idl: false },
        ..(*channel("/count", "")).clone()
    });
    let messages = [message(&cdr, 5, &[0, 1, 0, 0, 7, 0, 0, 0])];
    let bytes = write(RecordingFormat::Mcap, ChunkCompression::Zstd, &messages);
    assert_eq!(read(RecordingFormat::Mcap, &bytes).expect("read").0, messages);
    let mut bag = BagWriter::begin(Cursor::new(Vec::new()), ChunkCompression::None).expect("begun");
    assert!(bag.write(&cdr, Timestamp(5), &[]).is_err());
}

#[test]
fn what_mcap_says_of_channels_and_of_publishing_comes_back() {
    let about: BTreeMap<Arc<str>, Arc<str>> =
        [("offered_qos_profiles", "- durability: transient_local\n"), ("topic_type_hash", "RIHS01_00"), ("x", "")]
            .map(|(key, value)| (key.into(), value.into()))
            .into();
    let channel = |about| Arc::new(Channel { about, ..(*channel("/tf_static", "")).clone() });
    let sent = Sent { time: Timestamp(3), sequence: 77 };
    let mut writer = McapWriter::begin(Cursor::new(Vec::new()), ChunkCompression::None).expect("begun");
    writer.write_sent(&channel(about.clone()), Timestamp(5), sent, &[1; 4]).expect("written");
    writer.write(&channel(about.clone()), Timestamp(6), &[2; 4]).expect("written");
    let too_long = BTreeMap::from([("y".into(), "y".repeat(10_000).into())]);
    writer.write(&channel(too_long), Timestamp(7), &[3; 4]).expect("written");
    let mut reader = McapReader::open(Cursor::new(writer.finish().expect("finished").into_inner())).expect("MCAP");
    let mut next = || reader.next_message().expect("readable").expect("a message");
    let (first, second, third) = (next(), next(), next());
    assert_eq!((first.time, first.sent, &first.channel.about), (Timestamp(5), Some(sent), &about));
    assert_eq!((second.sent, &second.channel), (Some(Sent { time: Timestamp(6), sequence: 2 }), &first.channel));
    assert!(third.channel.about.is_empty());
    assert!(reader.findings().damages[0].text.contains("too long to keep"), "{:?}", reader.findings());
}

fn any_messages() -> impl Strategy<Value = Vec<RecordedMessage>> {
    let any_channel = ("/[a-z]{1,6}", "(/[a-z]{1,6})?").prop_map(|(topic, caller)| channel(&topic, &caller));
    let channels = prop::collection::vec(any_channel, 1..4);
    let times = 0..u64::from(u32::MAX) * 1_000_000_000;
    let rest =
        prop::collection::vec((any::<prop::sample::Index>(), times, prop::collection::vec(any::<u8>(), 0..300)), 0..40);
    (channels, rest).prop_map(|(channels, rest)| {
        rest.into_iter().map(|(index, time, body)| message(index.get(&channels), time, &body)).collect()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn reader_of_writer_is_the_same(messages in any_messages(), way in 0..WAYS.len()) {
        let (format, compression) = WAYS[way];
        let (found, findings) = read(format, &write(format, compression, &messages)).expect("read");
        prop_assert_eq!(found, messages);
        prop_assert!(findings.is_whole());
    }

    #[test]
    fn noise_never_panics(noise in prop::collection::vec(any::<u8>(), 0..600), format in 0..2_u8) {
        let (format, magic) = if format == 0 {
            (RecordingFormat::Bag, &b"#ROSBAG V2.0\n"[..])
        } else {
            (RecordingFormat::Mcap, &b"\x89MCAP0\r\n"[..])
        };
        drop(read(format, &[magic, &noise].concat()));
    }
}

#[test]
fn a_decoders_own_words_are_in_no_notice() {
    for compression in [ChunkCompression::Bz2, ChunkCompression::Lz4, ChunkCompression::Zstd] {
        let mut packed = pack(compression, &[7; 10_000]).expect("packed");
        packed[0] ^= 0xff;
        let told = unpack(compression, packed.as_slice(), 20_000, &mut Vec::new());
        assert_eq!(told, Err(super::SPOILT.to_owned()), "{compression}");
    }
}

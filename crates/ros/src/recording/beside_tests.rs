//! What a recording holds beside its messages, and what it says of its channels: it comes out as it went in, or is told.

use std::io::Cursor;
use std::sync::Arc;

use super::tests::{channel, message, read, write};
use super::*;
use crate::ros::bag::{BagReader, BagWriter};
use crate::ros::mcap::{McapReader, McapWriter};

fn put_text(out: &mut Vec<u8>, text: &str) {
    out.extend_from_slice(&u32::try_from(text.len()).expect("short").to_le_bytes());
    out.extend_from_slice(text.as_bytes());
}

/// An attachment in MCAP's own bytes, logged at 9 ns; its checksum is computed unless it is given.
fn attachment(name: &str, data: &[u8], checksum: Option<u32>) -> Vec<u8> {
    let mut out = Vec::new();
    [9_u64, 3].iter().for_each(|time| out.extend_from_slice(&time.to_le_bytes()));
    put_text(&mut out, name);
    put_text(&mut out, "text/plain");
    out.extend_from_slice(&(data.len() as u64).to_le_bytes());
    out.extend_from_slice(data);
    let checksum = checksum.unwrap_or_else(|| crc32fast::hash(&out));
    out.extend_from_slice(&checksum.to_le_bytes());
    out
}

/// Metadata whose names are in no order, and one of them twice.
fn metadata() -> Vec<u8> {
    let (mut out, mut map) = (Vec::new(), Vec::new());
    put_text(&mut out, "rig");
    ["z", "1", "a", "2", "z", "3"].iter().for_each(|text| put_text(&mut map, text));
    out.extend_from_slice(&u32::try_from(map.len()).expect("short").to_le_bytes());
    out.extend_from_slice(&map);
    out
}

/// A file of these records and an end, without a summary.
fn file(records: &[(u8, &[u8])]) -> Vec<u8> {
    let mut bytes = b"\x89MCAP0\r\n".to_vec();
    let end: [(u8, &[u8]); 2] = [(15, &[0; 4]), (2, &[0; 20])];
    for (code, content) in records.iter().copied().chain(end) {
        bytes.push(code);
        bytes.extend_from_slice(&(content.len() as u64).to_le_bytes());
        bytes.extend_from_slice(content);
    }
    bytes.extend_from_slice(b"\x89MCAP0\r\n");
    bytes
}

fn told(bytes: &[u8]) -> (usize, Findings) {
    let (found, findings) = read(RecordingFormat::Mcap, bytes).expect("MCAP");
    (found.len(), findings)
}

#[test]
fn attachments_and_metadata_come_out_byte_for_byte_in_their_place() {
    let (calibration, facts) = (attachment("left.yaml", b"focal: 1", None), metadata());
    let word = message(&channel("/words", "/teller"), 100, b"word");
    let mut writer = McapWriter::begin(Cursor::new(Vec::new()), ChunkCompression::Lz4).expect("begun");
    let mut put = |kind: Beside, body: &[u8]| writer.write(&Arc::new(kind.channel()), Timestamp(0), body);
    put(Beside::Metadata, &facts).expect("written");
    assert!(put(Beside::Attachment, &facts).is_err(), "metadata is no attachment");
    writer.write(&word.channel, word.time, &word.body).expect("written");
    writer.write(&Arc::new(Beside::Attachment.channel()), Timestamp(0), &calibration).expect("written");
    writer.write(&word.channel, Timestamp(200), &word.body).expect("written");
    let bytes = writer.finish().expect("finished").into_inner();
    let mut reader = McapReader::open(Cursor::new(&bytes)).expect("MCAP");
    let mut found = Vec::new();
    while let Some(message) = reader.next_message().expect("readable") {
        found.push((message.channel.type_name.to_string(), message.time.0, message.body));
    }
    // Metadata has the time of the message before it; before the first, that of the first.
    let expected = [
        ("authros/Metadata", 100, facts),
        ("std_msgs/UInt32", 100, b"word".to_vec()),
        ("authros/Attachment", 9, calibration),
        ("std_msgs/UInt32", 200, b"word".to_vec()),
    ];
    assert_eq!(found, expected.map(|(name, time, body)| (name.to_owned(), time, body)));
    assert!(reader.findings().is_whole(), "{:?}", reader.findings());
    assert_eq!(reader.findings().unguarded, 1, "metadata has no checksum of its own");

    // The summary counts them: one that is gone is told.
    let place = bytes.windows(9).position(|at| at == b"left.yaml").expect("there") - 29;
    assert_eq!(bytes[place], 9, "the record's code");
    let mut gone = bytes.clone();
    gone[place] = 0x90;
    let text = &told(&gone).1.damages[0].text;
    assert!(text.contains("counts 2 attachments and metadata records, but 1"), "{text}");
}

#[test]
fn a_damaged_attachment_is_told_by_its_name_and_one_without_a_checksum_is_counted() {
    let (whole, unchecked) = (attachment("map", b"png", None), attachment("map", b"png", Some(0)));
    assert_eq!(told(&file(&[(9, &whole)])), (1, Findings::default()));
    let (found, findings) = told(&file(&[(9, &unchecked), (12, &metadata())]));
    assert_eq!((found, findings.is_whole(), findings.unguarded), (2, true, 2));
    let (found, findings) = told(&file(&[(9, &attachment("map", b"png", Some(1)))]));
    assert_eq!(found, 0);
    assert!(findings.damages[0].text.contains("the attachment 'map' was skipped: its checksum"), "{findings:?}");
    for (code, content, word) in [(9, &whole[..whole.len() - 1], "attachment"), (12, &metadata()[..20], "metadata")] {
        let (found, findings) = told(&file(&[(code, content)]));
        assert!(found == 0 && findings.damages[0].text.contains(word), "{findings:?}");
    }
}

#[test]
fn an_attachment_that_no_record_can_hold_is_left_out_by_its_name() {
    let big = attachment("all.pcd", &vec![7; LONGEST_MESSAGE], None);
    let (found, findings) = told(&file(&[(9, &big), (9, &attachment("map", b"png", None))]));
    assert_eq!((found, findings.unusable.len()), (1, 1));
    let row = &findings.unusable[0];
    assert!(row.topic == BESIDE && row.messages == 1, "{row:?}");
    assert!(row.why.contains("the attachment 'all.pcd'") && row.why.contains("too large"), "{row:?}");
}

#[test]
fn a_bag_that_describes_a_connection_twice_differently_contradicts_itself() {
    let (left, right) = (channel("/left", "/l"), channel("/righ", "/rr"));
    let messages = [message(&left, 1, b"left"), message(&right, 2, b"righ")];
    let mut bytes = write(RecordingFormat::Bag, ChunkCompression::None, &messages);
    assert!(read(RecordingFormat::Bag, &bytes).expect("read").1.is_whole());
    // In the chunk only: the index at the end still has the true name.
    let place = bytes.windows(5).position(|at| at == b"/left").expect("a name");
    bytes[place..place + 5].copy_from_slice(b"/righ");
    let (_, findings) = read(RecordingFormat::Bag, &bytes).expect("read");
    let text = &findings.damages[0].text;
    assert!(text.contains("connection 0 is '/left' before and '/righ' here"), "{findings:?}");
}

/// The damage reported for an altered bag of two publishers without checksums.
fn told_of_bag(change: impl FnOnce(&mut Vec<u8>)) -> Vec<String> {
    let (left, right) = (channel("/left", "/l"), channel("/righ", "/rr"));
    let messages = [message(&left, 1_000_000_007, b"left"), message(&right, 2_000_000_009, b"righ")];
    let mut bytes = write(RecordingFormat::Bag, ChunkCompression::None, &messages);
    change(&mut bytes);
    let (_, findings) = read(RecordingFormat::Bag, &bytes).expect("read");
    findings.damages.into_iter().map(|damage| damage.text).collect()
}

fn place_of(bytes: &[u8], what: &[u8]) -> usize {
    bytes.windows(what.len()).position(|at| at == what).expect("there")
}

#[test]
fn a_bags_index_must_be_of_its_messages_though_no_checksum_covers_them() {
    assert_eq!(told_of_bag(|_| ()), Vec::<String>::new());
    let altered = |told: &[String]| told.iter().any(|text| text.contains("is not of the messages before it"));
    let told = told_of_bag(|bytes| {
        let place = place_of(bytes, b"time=") + 5;
        bytes[place] ^= 4;
    });
    assert!(altered(&told), "another time: {told:?}");
    let told = told_of_bag(|bytes| {
        let place = place_of(bytes, b"op=\x02") + 4 + 4 + 5;
        assert_eq!(bytes[place..place + 4], [0; 4], "the first message's connection");
        bytes[place] = 1;
    });
    assert!(altered(&told), "another publisher: {told:?}");
    let told = told_of_bag(|bytes| {
        let place = place_of(bytes, b"op=\x04");
        bytes[place + 3] = 3;
    });
    assert!(told.iter().any(|text| text.contains("is missing behind its chunk")), "no index: {told:?}");
    let told = told_of_bag(|bytes| {
        let place = place_of(bytes, b"chunk_pos=") + 10;
        bytes[place] ^= 1;
    });
    assert!(told.iter().any(|text| text.contains("names a chunk at byte")), "no chunk there: {told:?}");
}

#[test]
fn a_message_that_no_record_can_hold_is_left_out_by_its_topic() {
    let words = channel("/words", "");
    let mut bytes = write(RecordingFormat::Mcap, ChunkCompression::None, &[message(&words, 1, b"word")]);
    // A message of the file's channel 0 outside of any chunk, behind all chunks.
    let end = place_of(&bytes, &[15, 4, 0, 0, 0, 0, 0, 0, 0]);
    let mut content = vec![0; 22];
    content.resize(22 + LONGEST_MESSAGE + 64, 7);
    let lead = [&[5][..], &(content.len() as u64).to_le_bytes()].concat();
    drop(bytes.splice(end..end, [lead, content].concat()));
    let (found, findings) = told(&bytes);
    assert_eq!((found, findings.messages_skipped()), (1, 1));
    assert!(findings.unusable[0].topic == "/words" && findings.unusable[0].why == TOO_LARGE, "{findings:?}");
}

#[test]
fn what_is_kept_of_a_channel_fits_into_the_head_of_a_record() {
    let long = |number: usize| (format!("k{number}").into(), "v".repeat(8000).into());
    let (kept, whole) = kept_about((0..12).map(long));
    assert!(!whole && kept.len() == 4, "{}", kept.len());
    assert!(kept_about((0..4).map(long)).1);
}

#[test]
fn a_bags_connection_header_comes_out_as_it_went_in() {
    let about = |entries: &[(&str, &str)]| -> BTreeMap<Arc<str>, Arc<str>> {
        entries.iter().map(|(key, value)| ((*key).into(), (*value).into())).collect()
    };
    let of = |latching, entries: &[(&str, &str)]| {
        Arc::new(Channel { latching, about: about(entries), ..(*channel("/words", "/teller")).clone() })
    };
    let channels = [
        of(false, &[]),
        of(true, &[]),
        of(false, &[("latching", "0")]),
        of(false, &[("latching", "0"), (BAG_TOPIC, ""), ("tcp_nodelay", "1")]),
        of(false, &[(BAG_TOPIC, "/before")]),
    ];
    let messages: Vec<_> = channels.iter().map(|channel| message(channel, 5, b"word")).collect();
    for format in [RecordingFormat::Bag, RecordingFormat::Mcap] {
        let bytes = write(format, ChunkCompression::None, &messages);
        let (found, findings) = read(format, &bytes).expect("read");
        assert!(found == messages && findings.is_whole(), "{format:?}: {findings:?}");
    }
    let bag = write(RecordingFormat::Bag, ChunkCompression::None, &messages[2..3]);
    assert!(bag.windows(10).any(|at| at == b"latching=0"));
    let bag = write(RecordingFormat::Bag, ChunkCompression::None, &messages[3..4]);
    assert!(!bag.windows(24).any(|at| at == b"\x0c\0\0\0topic=/words\x14\0\0\0type"), "no topic before the type");
}

#[test]
fn a_bag_whose_index_was_never_written_says_so() {
    let mut writer = BagWriter::begin(Cursor::new(Vec::new()), ChunkCompression::None).expect("begun");
    writer.write(&channel("/words", ""), Timestamp(1), b"word").expect("written");
    let mut bytes = writer.finish().expect("finished").into_inner();
    let unfinished = |bytes: &[u8]| BagReader::open(Cursor::new(bytes)).expect("a bag").findings().unfinished;
    assert!(!unfinished(&bytes));
    let place = bytes.windows(10).position(|at| at == b"index_pos=").expect("a header") + 10;
    bytes[place..place + 8].fill(0);
    assert!(unfinished(&bytes));
}

//! Recordings with single bits flipped: whatever is returned was written, or something reports the damage.

use proptest::prelude::*;

use super::tests::{WAYS, channel, message, read, write};
use super::*;

/// Offset of the checksum in the content of an MCAP chunk: after two times and a size.
const CHECKSUM: usize = 9 + 24;

/// The same file without the checksums of its chunks, as some writers leave them out.
fn without_checksums(mut bytes: Vec<u8>) -> Vec<u8> {
    let mut at = 8;
    while let Some(lead) = bytes.get(at..at + 9) {
        let length = usize::try_from(u64::from_le_bytes(lead[1..].try_into().expect("8"))).expect("usize");
        match lead[0] {
            6 => bytes[at + CHECKSUM..at + CHECKSUM + 4].fill(0),
            15 => bytes[at + 9..at + 13].fill(0),
            2 => break,
            _ => {}
        }
        at += 9 + length;
    }
    bytes
}

fn written() -> Vec<RecordedMessage> {
    let channels = [channel("/odom", "/base"), channel("/imu", "/driver")];
    let body = |number: u8| (0..90).map(|index: u8| index.wrapping_mul(number) ^ number).collect::<Vec<u8>>();
    (0..60_u8).map(|number| message(&channels[usize::from(number % 2)], u64::from(number), &body(number))).collect()
}

/// Every way of writing, with and without chunk checksums.
fn files() -> Vec<(String, RecordingFormat, Vec<u8>)> {
    let messages = written();
    let mut files = Vec::new();
    for (format, compression) in WAYS {
        let bytes = write(format, compression, &messages);
        if format == RecordingFormat::Mcap {
            files.push((format!("mcap {compression}, no CRC"), format, without_checksums(bytes.clone())));
        }
        files.push((format!("{} {compression}", format.word()), format, bytes));
    }
    files
}

/// Whether the file shows the damage: nothing altered and nothing missing, or a finding.
fn is_told(found: &[RecordedMessage], findings: &Findings, messages: &[RecordedMessage]) -> bool {
    findings.unguarded > 0 || !findings.is_whole() || found == messages
}

#[test]
fn which_messages_no_checksum_covers_is_counted() {
    for (name, format, bytes) in files() {
        let (found, findings) = read(format, &bytes).expect("read");
        assert!(found == written() && findings.is_whole(), "{name}: {findings:?}");
        let unguarded = if name == "bag none" || name == "mcap none, no CRC" { 60 } else { 0 };
        assert_eq!(findings.unguarded, unguarded, "{name}");
    }
}

#[test]
fn a_flipped_bit_in_a_zstd_chunk_without_a_crc_is_told_by_the_checksum_of_the_frame() {
    let file = files().into_iter().find(|(name, ..)| name == "mcap zstd, no CRC").expect("there");
    let (messages, mut told) = (written(), 0);
    let begin = file.2.windows(4).position(|at| at == [0x28, 0xb5, 0x2f, 0xfd]).expect("a zstd frame");
    for place in begin + 4..begin + 1000 {
        let mut bytes = file.2.clone();
        bytes[place] ^= 1 << (place % 8);
        let (found, findings) = read(file.1, &bytes).expect("read");
        assert!(found.iter().all(|message| messages.contains(message)), "altered at {place}: {findings:?}");
        assert!(is_told(&found, &findings, &messages), "{place}: {findings:?}");
        told += u64::from(!findings.is_whole());
    }
    assert!(told > 900, "{told}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn no_flipped_bit_passes_untold(place in any::<proptest::sample::Index>(), bit in 0..8_u32) {
        let messages = written();
        for (name, format, mut bytes) in files() {
            // The first 4 KiB of a bag are padding.
            let first = if format == RecordingFormat::Bag { 4100 } else { 0 };
            let place = first + place.index(bytes.len() - first);
            bytes[place] ^= 1 << bit;
            let Ok((found, findings)) = read(format, &bytes) else { continue };
            let same = |message: &RecordedMessage| messages.iter().any(|known| known.time == message.time && known.body == message.body);
            let altered = !found.iter().all(same) || found.len() < messages.len();
            prop_assert!(!altered || findings.unguarded > 0 || !findings.is_whole(), "{name}, byte {place}, bit {bit}: {findings:?}");
        }
    }
}

//! Backups: the header in clear, and the archive inside.

use std::io::{self, Read as _};

use authros::crypto::sealed_stream::{HEADER, StreamHeader};
use authros::store::archive;

use crate::{Sample, sample, way};

const WAYS: u8 = 2;

/// Any claimed backup, or its contents.
pub fn run(data: &[u8]) -> bool {
    match way(data, WAYS) {
        Some((0, bytes)) => header(bytes),
        Some((1, bytes)) => inside(bytes),
        _ => false,
    }
}

/// One encoding per header; nothing is derived from it here, because that is slow on purpose.
fn header(bytes: &[u8]) -> bool {
    let Ok(parsed) = StreamHeader::parse(bytes) else { return false };
    assert_eq!(parsed.encode(), bytes);
    true
}

/// Names do not lead outside, and no more comes out than went in.
fn inside(bytes: &[u8]) -> bool {
    let mut given = 0;
    let read = archive::read(&mut &bytes[..], |name, length, file| {
        assert!(archive::is_plain(name) && !name.starts_with('/') && name.split('/').all(|part| part != ".."));
        let mut content = Vec::new();
        given += file.read_to_end(&mut content)?;
        assert!(content.len() as u64 <= length);
        io::Result::Ok(())
    });
    let Ok(unpacked) = read else { return false };
    assert_eq!(unpacked.bytes, given as u64);
    let mut again = Vec::new();
    let mut rest = bytes;
    let packed =
        archive::read(&mut rest, |name, length, file| archive::put(&mut again, name, length, &mut file.take(length)));
    assert!(packed.is_ok());
    archive::end(&mut again).expect("memory");
    assert_eq!(again, bytes, "one encoding for one archive");
    true
}

/// Valid encodings of every kind.
pub fn samples() -> Vec<Sample> {
    let mut header = b"\x89AuthBak\x01\x11\0\0\0\x08\0\0\0\x01".to_vec();
    header.resize(HEADER, 7);
    let mut files = Vec::new();
    for (name, bytes) in [("ledger.db", &b"one"[..]), ("profiles/default/keyring", b"two"), ("empty", b"")] {
        archive::put(&mut files, name, bytes.len() as u64, &mut &bytes[..]).expect("memory");
    }
    archive::end(&mut files).expect("memory");
    vec![sample("header", 0, &header), sample("files", 1, &files), sample("nothing", 1, &[0])]
}

//! A ZIP archive in one form only: members stored uncompressed, `mimetype` first, the others by name, no dates, extra
//! fields or gaps. Reading writes it again and compares, so that nothing hides between members.

use std::collections::BTreeMap;

use crate::BundleError;

/// The first member.
pub const MIMETYPE: &str = "mimetype";
/// The most members.
pub const MOST_MEMBERS: usize = 60_000;
/// The longest name of a member, bytes.
pub const LONGEST_NAME: usize = 120;
/// The largest archive, bytes.
pub const LARGEST: u64 = 256 * 1024 * 1024;

const LOCAL: [u8; 4] = *b"PK\x03\x04";
const CENTRAL: [u8; 4] = *b"PK\x01\x02";
const END: [u8; 4] = *b"PK\x05\x06";
/// 1 January 1980: the earliest date in the format.
const FIRST_DAY: u16 = 0x21;
/// Version 1.0 of the format: a stored member needs no more.
const VERSION: u16 = 10;

/// Members by name.
pub type Members = BTreeMap<String, Vec<u8>>;

/// Whether a name may be a member's: plain ASCII, and no way out of the folder that it is unpacked into.
pub fn is_name(name: &str) -> bool {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'.' | b'_' | b'-' | b'/');
    !name.is_empty()
        && name.len() <= LONGEST_NAME
        && name.bytes().all(plain)
        && name.split('/').all(|part| !part.is_empty() && !part.starts_with('.'))
}

/// The archive of these members.
/// # Errors
/// [`BundleError`] if they are too many or too long, or a name is not valid.
pub fn write(members: &Members) -> Result<Vec<u8>, BundleError> {
    if members.len() > MOST_MEMBERS {
        return Err(BundleError::whole(&format!(
            "it would have more than {MOST_MEMBERS} members; choose fewer records"
        )));
    }
    let (mut out, mut central) = (Vec::new(), Vec::new());
    for (name, bytes) in ordered(members) {
        if !is_name(name) {
            return Err(BundleError::of(name, "is not a valid member name"));
        }
        let fields = fields(name, bytes)?;
        central.extend_from_slice(&CENTRAL);
        put(&mut central, &[VERSION]);
        central.extend_from_slice(&fields);
        // No comment, first disk, no attributes.
        central.extend_from_slice(&[0; 10]);
        central.extend_from_slice(&number(out.len())?.to_le_bytes());
        central.extend_from_slice(name.as_bytes());
        out.extend_from_slice(&LOCAL);
        out.extend_from_slice(&fields);
        out.extend_from_slice(name.as_bytes());
        out.extend_from_slice(bytes);
        number(out.len())?;
    }
    let (count, at, length) = (members.len(), number(out.len())?, number(central.len())?);
    let count = u16::try_from(count).map_err(|_| BundleError::whole("it has too many members"))?;
    out.extend_from_slice(&central);
    out.extend_from_slice(&END);
    put(&mut out, &[0, 0, count, count]);
    out.extend_from_slice(&length.to_le_bytes());
    out.extend_from_slice(&at.to_le_bytes());
    put(&mut out, &[0]);
    number(out.len())?;
    Ok(out)
}

/// The members of an archive of this form.
/// # Errors
/// [`BundleError`] if it has any other form.
pub fn read(bytes: &[u8]) -> Result<Members, BundleError> {
    number(bytes.len())?;
    let (mut members, mut rest) = (Members::new(), bytes);
    while let Some(after) = rest.strip_prefix(&LOCAL) {
        let broken = || BundleError::whole("it ends in the middle of a member; ask for the file again");
        let (head, after) = after.split_at_checked(26).ok_or_else(broken)?;
        let length = u32::from_le_bytes(head.get(14..18).and_then(|four| four.try_into().ok()).ok_or_else(broken)?);
        let named = u16::from_le_bytes(head.get(22..24).and_then(|two| two.try_into().ok()).ok_or_else(broken)?);
        let (name, after) = after.split_at_checked(usize::from(named)).ok_or_else(broken)?;
        let name = std::str::from_utf8(name).ok().filter(|name| is_name(name));
        let name = name.ok_or_else(|| BundleError::whole("a member has a name that does not belong in a bundle"))?;
        let length = usize::try_from(length).map_err(|_| broken())?;
        let (member, after) = after.split_at_checked(length).ok_or_else(broken)?;
        if members.len() >= MOST_MEMBERS || members.insert(name.to_owned(), member.to_vec()).is_some() {
            return Err(BundleError::of(name, "is a duplicate, or one too many"));
        }
        rest = after;
    }
    if members.is_empty() {
        return Err(BundleError::whole("it is not an evidence bundle"));
    }
    match write(&members) {
        Ok(same) if same == bytes => Ok(members),
        _ => Err(BundleError::whole(
            "it is a ZIP archive, but not in the exact form of a bundle: it was repacked or damaged, or there is data \
             between its members",
        )),
    }
}

/// `mimetype` first: programs that look at a file's first bytes recognise it by that.
fn ordered(members: &Members) -> impl Iterator<Item = (&String, &Vec<u8>)> {
    let is_first = |name: &&String| name.as_str() == MIMETYPE;
    let first = members.iter().filter(move |(name, _)| is_first(name));
    first.chain(members.iter().filter(move |(name, _)| !is_first(name)))
}

/// The fields common to local and central headers: needed version to length of the extra field.
fn fields(name: &str, bytes: &[u8]) -> Result<Vec<u8>, BundleError> {
    let length = number(bytes.len())?;
    let mut out = Vec::with_capacity(26);
    // No flags, stored, midnight.
    put(&mut out, &[VERSION, 0, 0, 0, FIRST_DAY]);
    for word in [crc32fast::hash(bytes), length, length] {
        out.extend_from_slice(&word.to_le_bytes());
    }
    put(&mut out, &[u16::try_from(name.len()).unwrap_or(u16::MAX), 0]);
    Ok(out)
}

fn put(out: &mut Vec<u8>, words: &[u16]) {
    words.iter().for_each(|word| out.extend_from_slice(&word.to_le_bytes()));
}

fn number(length: usize) -> Result<u32, BundleError> {
    u32::try_from(length).ok().filter(|length| u64::from(*length) <= LARGEST).ok_or_else(|| {
        BundleError::whole(&format!("it is longer than {} MiB; choose fewer records", LARGEST / (1024 * 1024)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sample() -> Members {
        let pairs: [(&str, &[u8]); 4] = [("a/b", b"one"), ("mimetype", b"x"), ("zz", b""), ("a/c", &[0; 300])];
        pairs.iter().map(|(name, bytes)| ((*name).to_owned(), bytes.to_vec())).collect()
    }

    #[test]
    fn names_that_lead_elsewhere_are_none() {
        for name in
            ["", "/a", "a/", "a//b", "../a", "a/..", ".hidden", "a/.b", "a\\b", "C:a", "\u{e4}", &"a".repeat(121)]
        {
            assert!(!is_name(name), "{name}");
        }
        assert!(is_name("records/00ff/record.bin") && is_name("trust.toml"));
    }

    #[test]
    fn every_flipped_byte_is_seen_or_is_the_members_own() {
        let archive = write(&sample()).expect("written");
        assert_eq!(read(&archive), Ok(sample()));
        assert!(archive.starts_with(b"PK\x03\x04") && archive.get(30..38) == Some(b"mimetype"));
        for at in 0..archive.len() {
            let mut changed = archive.clone();
            changed[at] ^= 0x20;
            assert!(read(&changed).is_err(), "byte {at}");
            assert!(read(&archive[..at]).is_err(), "cut at {at}");
        }
        assert!(read(&[&archive[..], b"more"].concat()).is_err());
    }

    #[test]
    fn a_plain_unzip_lists_and_tests_it() {
        let folder = tempfile::tempdir().expect("directory");
        let path = folder.path().join("sample.zip");
        std::fs::write(&path, write(&sample()).expect("written")).expect("written");
        let script = "import sys, zipfile\nz = zipfile.ZipFile(sys.argv[1])\nassert z.testzip() is None\n\
                      assert z.namelist() == ['mimetype', 'a/b', 'a/c', 'zz'], z.namelist()\n\
                      assert z.read('a/b') == b'one' and len(z.read('a/c')) == 300\n";
        match std::process::Command::new("python3").args(["-c", script]).arg(&path).status() {
            Ok(status) => assert!(status.success()),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                println!("SKIPPED a_plain_unzip_lists_and_tests_it: no python3");
            }
            Err(error) => panic!("python3: {error}"),
        }
    }

    proptest! {
        #[test]
        fn what_is_read_is_what_was_written(
            members in proptest::collection::btree_map("[a-z]{1,4}(/[a-z0-9][a-z0-9.]{0,3})?", proptest::collection::vec(any::<u8>(), 0..50), 1..8),
            noise in proptest::collection::vec(any::<u8>(), 0..200),
        ) {
            let archive = write(&members).expect("written");
            prop_assert_eq!(read(&archive), Ok(members));
            prop_assert!(read(&noise).is_err());
            prop_assert!(read(&[&archive[..archive.len() / 2], &noise[..]].concat()).is_err());
        }
    }
}

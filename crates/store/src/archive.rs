//! The files of a home, concatenated: kind (1 = a file, 0 = the end), length of the name (2), name, length (8), bytes.
//! Names are relative paths of plain parts. Treat the contents as untrusted until the end marker.

use std::collections::HashSet;
use std::fs::{DirBuilder, File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{DirBuilderExt as _, OpenOptionsExt as _};
use std::path::Path;

const LONGEST_NAME: usize = 512;
const MOST_FILES: usize = 100_000;
const FILE: u8 = 1;
const END: u8 = 0;

/// Parts of letters, digits, `-`, `_` and `.`, none of them `.` or `..`.
pub fn is_plain(name: &str) -> bool {
    let usable = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_' | b'.');
    let part = |part: &str| !part.is_empty() && part != "." && part != ".." && part.bytes().all(usable);
    name.len() <= LONGEST_NAME && name.split('/').all(part)
}

/// Writes one file: exactly `length` bytes of `bytes`.
pub fn put(archive: &mut impl Write, name: &str, length: u64, bytes: &mut impl Read) -> io::Result<()> {
    let refused = || io::Error::new(io::ErrorKind::InvalidInput, format!("'{name}' is not a plain file name"));
    let size = u16::try_from(name.len()).ok().filter(|_| is_plain(name)).ok_or_else(refused)?;
    archive.write_all(&[FILE])?;
    archive.write_all(&size.to_be_bytes())?;
    archive.write_all(name.as_bytes())?;
    archive.write_all(&length.to_be_bytes())?;
    let copied = io::copy(&mut bytes.take(length), archive)?;
    if copied == length { Ok(()) } else { Err(io::Error::other(format!("{name} became shorter while it was read"))) }
}

pub fn end(archive: &mut impl Write) -> io::Result<()> {
    archive.write_all(&[END])
}

fn damaged(what: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, what)
}

#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Unpacked {
    pub names: Vec<String>,
    pub bytes: u64,
}

/// Passes every file with name and length to `each`, which must read all of it.
pub fn read(
    archive: &mut impl Read,
    mut each: impl FnMut(&str, u64, &mut dyn Read) -> io::Result<()>,
) -> io::Result<Unpacked> {
    let mut unpacked = Unpacked::default();
    let mut seen = HashSet::new();
    loop {
        let [kind] = array(archive)?;
        match kind {
            END => break,
            FILE if unpacked.names.len() < MOST_FILES => {}
            _ => return Err(damaged("it contains something that is not a file")),
        }
        let size = usize::from(u16::from_be_bytes(array(archive)?));
        if size > LONGEST_NAME {
            return Err(damaged("a name in it is too long"));
        }
        let mut name = vec![0; size];
        archive.read_exact(&mut name)?;
        let name = String::from_utf8(name).ok().filter(|name| is_plain(name));
        let name = name.ok_or_else(|| damaged("a name in it points outside"))?;
        let length = u64::from_be_bytes(array(archive)?);
        let mut file = archive.take(length);
        each(&name, length, &mut file)?;
        if file.limit() != 0 {
            return Err(damaged("a file in it is cut short"));
        }
        unpacked.bytes = unpacked.bytes.saturating_add(length);
        if !seen.insert(name.clone()) {
            return Err(damaged("two files in it have one name"));
        }
        unpacked.names.push(name);
    }
    if archive.read(&mut [0; 1])? == 0 { Ok(unpacked) } else { Err(damaged("there is data after its end")) }
}

fn array<const N: usize>(archive: &mut impl Read) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    archive.read_exact(&mut bytes)?;
    Ok(bytes)
}

/// Directories 0700, files 0600, each fsynced, none overwriting another.
pub fn unpack(archive: &mut impl Read, directory: &Path) -> io::Result<Unpacked> {
    read(archive, |name, _, bytes| {
        let path = directory.join(name);
        let parent = path.parent().unwrap_or(directory);
        DirBuilder::new().recursive(true).mode(0o700).create(parent)?;
        let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&path)?;
        io::copy(bytes, &mut file)?;
        file.sync_all()?;
        File::open(parent)?.sync_all()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn archive(files: &[(&str, &[u8])]) -> Vec<u8> {
        let mut out = Vec::new();
        for (name, bytes) in files {
            put(&mut out, name, bytes.len() as u64, &mut &bytes[..]).expect("packed");
        }
        end(&mut out).expect("ended");
        out
    }

    #[test]
    fn files_come_out_as_they_went_in_and_private() {
        use std::os::unix::fs::PermissionsExt as _;
        let home = tempfile::tempdir().expect("directory");
        let packed = archive(&[("a", b"one"), ("profiles/x/keyring", b"two")]);
        let unpacked = unpack(&mut &packed[..], home.path()).expect("unpacked");
        assert_eq!((unpacked.names.len(), unpacked.bytes), (2, 6));
        let path = home.path().join("profiles/x/keyring");
        assert_eq!(std::fs::read(&path).expect("there"), b"two");
        assert_eq!(std::fs::metadata(&path).expect("there").permissions().mode() & 0o777, 0o600);
        assert!(unpack(&mut &packed[..], home.path()).is_err(), "never over what is there");
        for length in 0..packed.len() {
            assert!(read(&mut &packed[..length], |_, _, file| io::copy(file, &mut io::sink()).map(drop)).is_err());
        }
    }

    #[test]
    fn names_that_lead_elsewhere_are_refused() {
        for name in ["", "/etc/passwd", "../x", "a/../b", "a//b", "a/", ".", "a\0", "a b", "é"] {
            assert!(!is_plain(name), "{name:?}");
            let mut packed = vec![FILE, 0, u8::try_from(name.len()).expect("short")];
            packed.extend_from_slice(name.as_bytes());
            packed.extend_from_slice(&[0; 9]);
            assert!(read(&mut &packed[..], |_, _, _| Ok(())).is_err(), "{name:?}");
        }
        let doubled = archive(&[("a", b""), ("a", b"")]);
        assert!(read(&mut &doubled[..], |_, _, _| Ok(())).is_err());
    }
}

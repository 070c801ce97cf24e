//! A follower's statement about a recorder's file: its length, its digest, and those of its chunks, sealed as a record.
//! Its form is that of MCAP metadata, so that an exported recording contains it as such.

use std::{collections::BTreeMap, io::Read};

use authros_crypto::Sm3Hasher;
use authros_model::Digest;

/// The tag of a record that holds a statement, and its value: what a file says of itself has no such tag.
pub const TAG: (&str, &str) = ("recorded", "file");

const NAME: &str = "authros.recording";

/// What begins the name of a chunk's line; the rest is where it begins, decimal.
const CHUNK: &str = "chunk ";

const MOST_CHUNKS: usize = 1 << 19;

/// One chunk of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RecordedChunk {
    /// Where it begins, bytes.
    pub at: u64,
    /// Its length with its code and length fields, bytes.
    pub length: u64,
    /// SM3 of these bytes.
    pub digest: Digest,
}

/// What is stated of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecordedFile {
    /// Its name when it was read.
    pub name: String,
    /// Its length, bytes.
    pub length: u64,
    /// SM3 of all of it.
    pub digest: Digest,
    /// Whether its recorder had closed it.
    pub is_closed: bool,
    /// Its chunks, in file order; none of a file without.
    pub chunks: Vec<RecordedChunk>,
}

/// How a file compares with what was stated.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Compared {
    /// Whether length and digest of the whole are as stated.
    pub is_whole: bool,
    /// Its length, bytes.
    pub length: u64,
    /// How many chunks were stated.
    pub chunks: u64,
    /// Where the chunks begin that differ or are missing.
    pub differing: Vec<u64>,
}

fn put(out: &mut Vec<u8>, text: &str) {
    out.extend_from_slice(&u32::try_from(text.len()).unwrap_or(u32::MAX).to_le_bytes());
    out.extend_from_slice(text.as_bytes());
}

fn take<'a>(bytes: &mut &'a [u8]) -> Option<&'a [u8]> {
    let (length, rest) = bytes.split_first_chunk::<4>()?;
    let (text, rest) = rest.split_at_checked(usize::try_from(u32::from_le_bytes(*length)).ok()?)?;
    *bytes = rest;
    Some(text)
}

fn text(bytes: &mut &[u8]) -> Option<String> {
    take(bytes).and_then(|text| std::str::from_utf8(text).ok()).map(str::to_owned)
}

impl RecordedFile {
    /// The bytes of the record's message.
    pub fn to_bytes(&self) -> Vec<u8> {
        let closed = if self.is_closed { "yes" } else { "no" };
        let own = [("name", self.name.clone()), ("length", self.length.to_string()), ("sm3", self.digest.to_hex())];
        let mut map = Vec::new();
        for (name, value) in own.iter().map(|(name, value)| (*name, value.as_str())).chain([("closed", closed)]) {
            put(&mut map, name);
            put(&mut map, value);
        }
        for chunk in self.chunks.iter().take(MOST_CHUNKS) {
            put(&mut map, &format!("{CHUNK}{}", chunk.at));
            put(&mut map, &format!("{} {}", chunk.length, chunk.digest.to_hex()));
        }
        let mut out = Vec::with_capacity(map.len() + 64);
        put(&mut out, NAME);
        out.extend_from_slice(&u32::try_from(map.len()).unwrap_or(u32::MAX).to_le_bytes());
        out.extend_from_slice(&map);
        out
    }

    /// Parses the message of a record; `None` if it is no statement, or is not spelled as this one is.
    pub fn parse(bytes: &[u8]) -> Option<Self> {
        Self::read(bytes).filter(|stated| stated.to_bytes() == bytes)
    }

    fn read(mut bytes: &[u8]) -> Option<Self> {
        if text(&mut bytes)? != NAME {
            return None;
        }
        let mut map = take(&mut bytes).filter(|_| bytes.is_empty())?;
        let (mut own, mut chunks, mut after) = (BTreeMap::new(), Vec::new(), 0);
        while !map.is_empty() {
            let (name, value) = (text(&mut map)?, text(&mut map)?);
            match name.strip_prefix(CHUNK) {
                Some(at) if chunks.len() < MOST_CHUNKS => {
                    let (length, digest) = value.split_once(' ')?;
                    let (at, length): (u64, u64) = (at.parse().ok()?, length.parse().ok()?);
                    if at < after {
                        return None;
                    }
                    after = at.checked_add(length)?;
                    chunks.push(RecordedChunk { at, length, digest: digest.parse().ok()? });
                }
                Some(_) => return None,
                None => drop(own.insert(name, value)),
            }
        }
        let mut get = |name: &str| own.remove(name);
        Some(Self {
            name: get("name")?,
            length: get("length")?.parse().ok()?,
            digest: get("sm3")?.parse().ok()?,
            is_closed: get("closed")? == "yes",
            chunks,
        })
    }

    /// Reads a file to its end and compares it.
    /// # Errors
    /// If it cannot be read.
    pub fn compare(&self, mut file: impl Read) -> std::io::Result<Compared> {
        let (mut whole, mut length, mut differing) = (Sm3Hasher::new(), 0_u64, Vec::new());
        for chunk in &self.chunks {
            length += feed(&mut file, chunk.at.saturating_sub(length), &mut [&mut whole])?;
            let mut own = Sm3Hasher::new();
            let read = feed(&mut file, chunk.length, &mut [&mut whole, &mut own])?;
            length += read;
            if read != chunk.length || Digest(own.finish()) != chunk.digest {
                differing.push(chunk.at);
            }
        }
        length += feed(&mut file, u64::MAX, &mut [&mut whole])?;
        let is_whole = Digest(whole.finish()) == self.digest && length == self.length;
        Ok(Compared { is_whole, length, chunks: self.chunks.len() as u64, differing })
    }
}

/// Reads up to `most` bytes into the hashes; returns how many there were.
fn feed(file: &mut impl Read, most: u64, hashes: &mut [&mut Sm3Hasher]) -> std::io::Result<u64> {
    let (mut buffer, mut done) = (vec![0; 256 * 1024], 0_u64);
    while done < most {
        let wanted = usize::try_from(most - done).unwrap_or(usize::MAX).min(buffer.len());
        let read = match file.read(buffer.get_mut(..wanted).unwrap_or_default()) {
            Ok(read) => read,
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => continue,
            Err(error) => return Err(error),
        };
        let bytes = buffer.get(..read).unwrap_or_default();
        if bytes.is_empty() {
            break;
        }
        hashes.iter_mut().for_each(|hash| hash.update(bytes));
        done += read as u64;
    }
    Ok(done)
}

#[cfg(test)]
mod tests {
    use authros_crypto::sm3::sm3;

    use super::*;

    fn stated(bytes: &[u8]) -> RecordedFile {
        let chunk = |at: usize, length: usize| RecordedChunk {
            at: at as u64,
            length: length as u64,
            digest: Digest(sm3(&[&bytes[at..at + length]])),
        };
        RecordedFile {
            name: "run_0.mcap".to_owned(),
            length: bytes.len() as u64,
            digest: Digest(sm3(&[bytes])),
            is_closed: true,
            chunks: vec![chunk(10, 20), chunk(30, 5), chunk(50, 40)],
        }
    }

    #[test]
    fn a_statement_is_read_as_it_was_written_and_finds_what_was_altered() {
        let mut bytes: Vec<u8> = (0..100).collect();
        let file = stated(&bytes);
        assert_eq!(RecordedFile::parse(&file.to_bytes()), Some(file.clone()));
        let compared = file.compare(bytes.as_slice()).expect("read");
        assert_eq!((compared.is_whole, compared.length, compared.differing), (true, 100, Vec::new()));
        bytes[31] ^= 1;
        let compared = file.compare(bytes.as_slice()).expect("read");
        assert_eq!((compared.is_whole, compared.differing), (false, vec![30]));
        bytes[31] ^= 1;
        let compared = file.compare(&bytes[..60]).expect("read");
        assert_eq!((compared.is_whole, compared.differing), (false, vec![50]));
        bytes.push(0);
        let compared = file.compare(bytes.as_slice()).expect("read");
        assert_eq!((compared.is_whole, compared.differing.len()), (false, 0), "only behind the chunks");
    }

    #[test]
    fn what_is_no_statement_is_none() {
        let whole = stated(&[7; 100]).to_bytes();
        for end in 0..whole.len() {
            assert_eq!(RecordedFile::parse(&whole[..end]), None, "{end}");
        }
        let mut longer = whole.clone();
        longer.push(0);
        assert_eq!(RecordedFile::parse(&longer), None);
        for (one, other) in [(b"yes", b"YES"), (b"100", b"+10"), (b"100", b"0x9")] {
            let mut changed = whole.clone();
            let at = changed.windows(3).position(|found| found == one).expect("it is said");
            changed[at..at + 3].copy_from_slice(other);
            assert_eq!(RecordedFile::parse(&changed), None, "{other:?}");
        }
        let mut twice = stated(&[7; 100]);
        twice.chunks[1].at = 12;
        assert_eq!(RecordedFile::parse(&twice.to_bytes()), None, "chunks overlap");
    }
}

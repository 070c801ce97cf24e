//! A stream of any length sealed under a passphrase: SM4-GCM in chunks whose order is bound, the last one marked.
//! Header (106): magic (8) version (1) work (9) salt (32) save salt (24) commitment (32), then chunks: last (1), length
//! (4), ciphertext, tag (16); nonce = the stream's XOR the chunk's number, AAD = header, number, last, length.

use std::io::{self, Read, Write};

use zeroize::Zeroizing;

use crate::keystore::{FileKey, SaveKeys, SealedHead};
use crate::model::wire::{Reader, WireError};
use crate::{CryptoError, Passphrase, Provider, ProviderName, Result, provider};

const MAGIC: [u8; 8] = *b"\x89AuthBak";
const LABEL: &str = "AuthROS/backup/1";
/// Length of the header, bytes.
pub const HEADER: usize = SealedHead::LENGTH;
const CHUNK: usize = 1 << 20;
const TAG: usize = 16;

/// The header of a sealed stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StreamHeader(SealedHead);

impl StreamHeader {
    /// Its encoding.
    pub fn encode(&self) -> Vec<u8> {
        self.0.encode(&MAGIC)
    }

    /// From its encoding; each header has exactly one.
    /// # Errors
    /// [`WireError`] if it is malformed, or asks for an unreasonable amount of work.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(bytes);
        let head = SealedHead::read(&mut reader, &MAGIC)?;
        reader.end()?;
        Ok(Self(head))
    }
}

struct Line {
    header: Vec<u8>,
    keys: SaveKeys,
    number: u64,
}

impl Line {
    fn provider() -> &'static dyn Provider {
        provider(ProviderName::RustCrypto)
    }

    fn next(&mut self, last: bool, length: u32) -> ([u8; 12], Vec<u8>) {
        let mut nonce = self.keys.nonce;
        nonce[4..].iter_mut().zip(self.number.to_be_bytes()).for_each(|(byte, bits)| *byte ^= bits);
        let aad = [&self.header[..], &self.number.to_be_bytes(), &[u8::from(last)], &length.to_be_bytes()].concat();
        self.number += 1;
        (nonce, aad)
    }
}

fn other(error: CryptoError) -> io::Error {
    io::Error::other(error)
}

/// Seals what is written to it. Without [`SealedWriter::finish`] the stream has no end and does not open.
pub struct SealedWriter<W: Write> {
    inner: W,
    line: Line,
    waiting: Zeroizing<Vec<u8>>,
}

impl<W: Write> SealedWriter<W> {
    /// Begins a stream; derives the passphrase's key (about 0.3 s).
    /// # Errors
    /// Errors from writing the header or deriving the key.
    pub fn new(inner: W, passphrase: &Passphrase) -> io::Result<Self> {
        Self::with(inner, &FileKey::new(passphrase).map_err(other)?)
    }

    fn with(mut inner: W, key: &FileKey) -> io::Result<Self> {
        let (head, keys) = SealedHead::new(key, LABEL).map_err(other)?;
        let header = StreamHeader(head).encode();
        inner.write_all(&header)?;
        let waiting = Zeroizing::new(Vec::with_capacity(CHUNK));
        Ok(Self { inner, line: Line { header, keys, number: 0 }, waiting })
    }

    fn put(&mut self, last: bool) -> io::Result<()> {
        let length = u32::try_from(self.waiting.len()).map_err(io::Error::other)?;
        let (nonce, aad) = self.line.next(last, length);
        // Room for the tag, so that appending it does not move the plaintext and leave a copy behind.
        let mut sealed = Vec::with_capacity(self.waiting.len() + TAG);
        sealed.extend_from_slice(&self.waiting);
        Line::provider().gcm_seal(&self.line.keys.key, &nonce, &aad, &mut sealed).map_err(other)?;
        self.inner.write_all(&[u8::from(last)])?;
        self.inner.write_all(&length.to_be_bytes())?;
        self.inner.write_all(&sealed)?;
        self.waiting.clear();
        Ok(())
    }

    /// Writes the last chunk; returns the inner writer.
    /// # Errors
    /// Errors from writing.
    pub fn finish(mut self) -> io::Result<W> {
        self.put(true)?;
        self.inner.flush()?;
        Ok(self.inner)
    }
}

impl<W: Write> Write for SealedWriter<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.waiting.len() == CHUNK {
            self.put(false)?;
        }
        let taken = bytes.len().min(CHUNK - self.waiting.len());
        self.waiting.extend_from_slice(&bytes[..taken]);
        Ok(taken)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

/// Opens a sealed stream. What has been read is authentic so far; only its end proves that nothing is missing.
pub struct SealedReader<R: Read> {
    inner: R,
    line: Line,
    open: Zeroizing<Vec<u8>>,
    taken: usize,
    ended: bool,
}

fn damaged(what: &'static str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, what)
}

impl<R: Read> SealedReader<R> {
    /// Reads the header; derives the passphrase's key (about 0.3 s).
    /// # Errors
    /// `InvalidData` if it is none, `Unsupported` of another version, `PermissionDenied` for the passphrase.
    pub fn open(inner: R, passphrase: &Passphrase) -> io::Result<Self> {
        Self::with(inner, |header| FileKey::with(passphrase, header.0.work, header.0.salt))
    }

    fn with(mut inner: R, key: impl FnOnce(&StreamHeader) -> Result<FileKey>) -> io::Result<Self> {
        let mut header = vec![0; HEADER];
        inner.read_exact(&mut header).map_err(|error| match error.kind() {
            io::ErrorKind::UnexpectedEof => damaged("it is shorter than a header"),
            _ => error,
        })?;
        let parsed = StreamHeader::parse(&header).map_err(|error| match (error, header.get(MAGIC.len())) {
            (WireError::Value("version"), Some(found)) => another_version(*found),
            _ => damaged("it does not start like a backup"),
        })?;
        let key = key(&parsed).map_err(other)?;
        let wrong = || io::Error::new(io::ErrorKind::PermissionDenied, "wrong passphrase");
        let keys = parsed.0.keys(&key, LABEL).ok_or_else(wrong)?;
        let line = Line { header, keys, number: 0 };
        Ok(Self { inner, line, open: Zeroizing::default(), taken: 0, ended: false })
    }

    fn next(&mut self) -> io::Result<()> {
        let mut front = [0; 5];
        self.inner.read_exact(&mut front).map_err(cut)?;
        let [last, length @ ..] = front;
        let length = u32::from_be_bytes(length);
        let size = usize::try_from(length).unwrap_or(usize::MAX);
        if last > 1 || size > CHUNK {
            return Err(damaged("a chunk has an impossible length"));
        }
        let mut sealed = vec![0; size + TAG];
        self.inner.read_exact(&mut sealed).map_err(cut)?;
        let (nonce, aad) = self.line.next(last == 1, length);
        self.open = Line::provider()
            .gcm_open(&self.line.keys.key, &nonce, &aad, &sealed)
            .map_err(|_| damaged("a chunk was altered or moved"))?;
        self.taken = 0;
        if last == 1 {
            self.ended = true;
            if self.inner.read(&mut [0; 1])? != 0 {
                return Err(damaged("there is data after its end"));
            }
        } else if size == 0 {
            return Err(damaged("a chunk in the middle is empty"));
        }
        Ok(())
    }
}

fn another_version(found: u8) -> io::Error {
    let text = format!(
        "it is a backup of version {found}, but this program reads only version 1; use a newer authros, or the one that \
         wrote it"
    );
    io::Error::new(io::ErrorKind::Unsupported, text)
}

fn cut(error: io::Error) -> io::Error {
    if error.kind() == io::ErrorKind::UnexpectedEof { damaged("its end is missing") } else { error }
}

impl<R: Read> Read for SealedReader<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        while self.taken == self.open.len() && !self.ended {
            self.next()?;
        }
        let left = &self.open[self.taken..];
        let count = left.len().min(out.len());
        out[..count].copy_from_slice(&left[..count]);
        self.taken += count;
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::secret::Work;

    /// Cheap, because the tests derive it again and again.
    const WORK: Work = Work { log_n: 4, r: 8, p: 1 };

    fn key(passphrase: &str, salt: [u8; 32]) -> Result<FileKey> {
        FileKey::with(&Passphrase::new(passphrase.to_owned()).expect("long enough"), WORK, salt)
    }

    fn sealed(plain: &[u8]) -> Vec<u8> {
        let mut writer =
            SealedWriter::with(Vec::new(), &key("correct horse", [9; 32]).expect("a key")).expect("begins");
        writer.write_all(plain).expect("taken");
        writer.finish().expect("ends")
    }

    fn opened(bytes: &[u8]) -> io::Result<Vec<u8>> {
        let mut plain = Vec::new();
        SealedReader::with(bytes, |header| key("correct horse", header.0.salt))?.read_to_end(&mut plain)?;
        Ok(plain)
    }

    #[test]
    fn streams_of_any_length_round_trip_and_wrong_passphrases_are_told() {
        for length in [0, 1, CHUNK, CHUNK + 1] {
            let plain: Vec<u8> = (0..length).map(|at| u8::try_from(at % 251).expect("small")).collect();
            assert_eq!(opened(&sealed(&plain)).expect("opens"), plain);
        }
        let other = |header: &StreamHeader| key("another horse", header.0.salt);
        let refused = SealedReader::with(&sealed(b"x")[..], other).err().expect("refused");
        assert_eq!(refused.kind(), io::ErrorKind::PermissionDenied);
    }

    #[test]
    fn another_version_is_refused_by_its_number() {
        for version in [0, 2, 255] {
            let mut other = sealed(b"x");
            other[8] = version;
            let error = opened(&other).expect_err("another version");
            assert_eq!(error.kind(), io::ErrorKind::Unsupported, "{error}");
            assert!(error.to_string().contains(&format!("of version {version}, but")), "{error}");
        }
    }

    #[test]
    fn cut_swapped_doubled_and_altered_chunks_are_refused() {
        let plain = vec![7; 2 * CHUNK + 100];
        let whole = sealed(&plain);
        let size = 5 + CHUNK + TAG;
        let chunk = |number: usize| &whole[HEADER + number * size..HEADER + (number + 1) * size];
        let (first, second, end) = (chunk(0), chunk(1), &whole[HEADER + 2 * size..]);
        let header = &whole[..HEADER];
        let arranged = |parts: &[&[u8]]| opened(&[&[header], parts].concat().concat());
        assert_eq!(arranged(&[first, second, end]).expect("opens"), plain);
        for parts in [
            &[second, first, end][..],
            &[first, second],
            &[first, end],
            &[end],
            &[first, second, end, b"x"],
            &[first, second, second, end],
            &[first, &second[..size - 1]],
        ] {
            assert_eq!(arranged(parts).expect_err("refused").kind(), io::ErrorKind::InvalidData);
        }
        for at in [HEADER, HEADER + 1, HEADER + 4, HEADER + 100, whole.len() - 1] {
            let mut altered = whole.clone();
            altered[at] ^= 1;
            assert!(opened(&altered).is_err(), "byte {at}");
        }
        for length in [0, 5, HEADER - 1, HEADER] {
            assert!(opened(&whole[..length]).is_err(), "{length} bytes");
        }
    }
}

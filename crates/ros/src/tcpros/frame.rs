//! Reads frames (32-bit little-endian length, then that many bytes) from a stream whose reads may time out at any byte:
//! nothing that arrived is lost, and nothing is allocated on a mere claim.

use std::io::{BufRead, BufReader, ErrorKind, Read};

/// How much is read from the socket at a time, bytes.
const BUFFER: usize = 256 << 10;

/// The result of reading.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Poll {
    /// A complete frame.
    Frame(Vec<u8>),
    /// Nothing complete before the read timed out.
    Pending,
    /// The peer closed, between frames (`true`) or inside one.
    Closed(bool),
    /// The peer announced a frame of this length, beyond the cap; the stream is no longer usable.
    TooLong(u32),
}

/// Reads frames; keeps an incomplete frame between calls.
pub(crate) struct FrameReader<R> {
    reader: BufReader<R>,
    prefix: Vec<u8>,
    body: Vec<u8>,
}

impl<R: Read> FrameReader<R> {
    /// Over a stream, which needs a read timeout if waiting is to end.
    pub fn new(stream: R) -> Self {
        Self { reader: BufReader::with_capacity(BUFFER, stream), prefix: Vec::with_capacity(4), body: Vec::new() }
    }

    /// The next frame of at most `most` bytes.
    pub fn poll(&mut self, most: usize) -> std::io::Result<Poll> {
        loop {
            let Ok(prefix) = <[u8; 4]>::try_from(self.prefix.as_slice()) else {
                match fill(&mut self.reader, &mut self.prefix, 4)? {
                    Filled::Whole => continue,
                    Filled::TimedOut => return Ok(Poll::Pending),
                    Filled::Closed => return Ok(Poll::Closed(self.prefix.is_empty())),
                }
            };
            let claimed = u32::from_le_bytes(prefix);
            let Some(length) = usize::try_from(claimed).ok().filter(|length| *length <= most) else {
                return Ok(Poll::TooLong(claimed));
            };
            if self.body.capacity() == 0 {
                self.body.reserve_exact(length.min(BUFFER));
            }
            return match fill(&mut self.reader, &mut self.body, length)? {
                Filled::Whole => {
                    self.prefix.clear();
                    Ok(Poll::Frame(std::mem::take(&mut self.body)))
                }
                Filled::TimedOut => Ok(Poll::Pending),
                Filled::Closed => Ok(Poll::Closed(false)),
            };
        }
    }
}

enum Filled {
    Whole,
    TimedOut,
    Closed,
}

/// Reads until `into` holds `length` bytes.
fn fill(reader: &mut impl BufRead, into: &mut Vec<u8>, length: usize) -> std::io::Result<Filled> {
    while into.len() < length {
        let available = match reader.fill_buf() {
            Ok([]) => return Ok(Filled::Closed),
            Ok(bytes) => bytes,
            Err(error) => match error.kind() {
                ErrorKind::Interrupted => continue,
                ErrorKind::WouldBlock | ErrorKind::TimedOut => return Ok(Filled::TimedOut),
                _ => return Err(error),
            },
        };
        let taken = available.len().min(length - into.len());
        into.extend_from_slice(&available[..taken]);
        reader.consume(taken);
    }
    Ok(Filled::Whole)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::VecDeque;

    /// Returns its pieces one by one, with a timeout after each.
    struct Dripping(VecDeque<Vec<u8>>, bool);

    impl Read for Dripping {
        fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
            self.1 = !self.1;
            if self.1 {
                return Err(ErrorKind::WouldBlock.into());
            }
            let Some(mut piece) = self.0.pop_front() else { return Ok(0) };
            let taken = piece.len().min(out.len());
            out[..taken].copy_from_slice(&piece[..taken]);
            if taken < piece.len() {
                self.0.push_front(piece.split_off(taken));
            }
            Ok(taken)
        }
    }

    fn frame(body: &[u8]) -> Vec<u8> {
        [u32::try_from(body.len()).expect("short").to_le_bytes().as_slice(), body].concat()
    }

    fn read_all(pieces: Vec<Vec<u8>>, most: usize) -> (Vec<Vec<u8>>, Poll) {
        let mut reader = FrameReader::new(Dripping(pieces.into_iter().filter(|p| !p.is_empty()).collect(), false));
        let mut frames = Vec::new();
        loop {
            match reader.poll(most).expect("no error") {
                Poll::Frame(body) => frames.push(body),
                Poll::Pending => {}
                end => return (frames, end),
            }
        }
    }

    #[test]
    fn a_claim_beyond_the_cap_is_not_followed() {
        assert_eq!(read_all(vec![vec![255, 255, 255, 255, 0]], 1000), (Vec::new(), Poll::TooLong(u32::MAX)));
        assert_eq!(read_all(vec![frame(b"abcd")], 3), (Vec::new(), Poll::TooLong(4)));
    }

    #[test]
    fn a_long_claim_allocates_only_what_arrives() {
        let mut reader = FrameReader::new([0, 0, 0, 4, 1, 2, 3].as_slice());
        assert_eq!(reader.poll(64 << 20).expect("no error"), Poll::Closed(false));
        assert!(reader.body.capacity() <= BUFFER);
    }

    proptest! {
        #[test]
        fn frames_survive_any_cutting(
            bodies in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..50), 0..8),
            cuts in prop::collection::vec(0usize..300, 0..12),
            lost in 0usize..5,
        ) {
            let mut stream: Vec<u8> = bodies.iter().flat_map(|body| frame(body)).collect();
            let lost = lost.min(bodies.last().map_or(0, |body| body.len() + 3));
            stream.truncate(stream.len() - lost);
            let mut cuts: Vec<usize> = cuts.into_iter().map(|cut| cut.min(stream.len())).collect();
            cuts.sort_unstable();
            let mut pieces = Vec::new();
            let mut from = 0;
            for cut in cuts {
                pieces.push(stream[from..cut].to_vec());
                from = cut;
            }
            pieces.push(stream[from..].to_vec());
            let (frames, end) = read_all(pieces, 1000);
            let whole = if lost == 0 { bodies.len() } else { bodies.len() - 1 };
            prop_assert_eq!(frames.as_slice(), &bodies[..whole]);
            prop_assert_eq!(end, Poll::Closed(lost == 0));
        }
    }
}

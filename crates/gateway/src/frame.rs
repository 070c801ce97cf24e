//! Frames on the wire: length (4, big endian), kind (1), payload. The length counts kind and payload. The cap is
//! checked before anything is stored, and no buffer grows ahead of the bytes that arrived.

/// The cap until the peer is authenticated, bytes of kind and payload.
pub const CAP_BEFORE: usize = 4 * 1024;
/// The cap afterwards.
pub const CAP_AFTER: usize = 1024 * 1024;
/// A buffer larger than this is released when it is empty, bytes.
const KEPT: usize = 16 * 1024;
/// Size of the length field, bytes.
const PREFIX: usize = 4;

/// The kind of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum FrameKind {
    /// The client's first message.
    Hello = 1,
    /// The gateway's answer, signed.
    Answer = 2,
    /// N under the agreed key.
    Identify = 3,
    /// ND3.
    Transfer = 4,
    /// A code in clear, before the connection closes.
    Refusal = 5,
    /// Asks for the network, before the hello, from a client that does not know it yet.
    Inquiry = 6,
    /// The network, in clear; the hello that follows proves it.
    Network = 7,
}

impl FrameKind {
    const ALL: [Self; 7] =
        [Self::Hello, Self::Answer, Self::Identify, Self::Transfer, Self::Refusal, Self::Inquiry, Self::Network];

    /// The byte on the wire.
    pub fn code(self) -> u8 {
        self as u8
    }

    /// From the byte on the wire.
    pub fn from_code(code: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.code() == code)
    }
}

/// Why bytes are not a frame; the stream is of no further use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// Longer than the cap, or without a kind.
    #[error("a frame of {0} bytes")]
    Length(u32),
    /// An unknown kind.
    #[error("a frame of kind {0}")]
    Kind(u8),
}

/// Encodes one frame. Every reader refuses a payload over [`CAP_AFTER`].
pub fn encode(kind: FrameKind, payload: &[u8]) -> Vec<u8> {
    let length = u32::try_from(payload.len().saturating_add(1)).unwrap_or(u32::MAX);
    let mut out = Vec::with_capacity(PREFIX + 1 + payload.len());
    out.extend_from_slice(&length.to_be_bytes());
    out.push(kind.code());
    out.extend_from_slice(payload);
    out
}

/// Takes bytes as they arrive and returns frames.
#[derive(Debug)]
pub struct FrameDecoder {
    cap: usize,
    buffer: Vec<u8>,
    start: usize,
}

impl FrameDecoder {
    /// With the cap for an unauthenticated peer.
    pub fn new() -> Self {
        Self { cap: CAP_BEFORE, buffer: Vec::new(), start: 0 }
    }

    /// The peer is authenticated: allows larger frames from now on.
    pub fn raise_cap(&mut self) {
        self.cap = CAP_AFTER;
    }

    /// Where the next bytes are appended, with room for some; at most one cap of bytes is held unread.
    pub fn space(&mut self) -> &mut Vec<u8> {
        if self.start > 0 {
            self.buffer.drain(..self.start);
            self.start = 0;
        }
        let wanted = self.announced().map_or(KEPT, |length| (length + PREFIX).saturating_sub(self.buffer.len()));
        self.buffer.reserve(wanted.clamp(CAP_BEFORE, KEPT.max(self.buffer.len())).min(self.cap + PREFIX));
        &mut self.buffer
    }

    /// Whether a frame has begun that is not complete yet.
    pub fn is_partial(&self) -> bool {
        self.start < self.buffer.len()
    }

    /// Releases memory while nothing is expected.
    pub fn rest(&mut self) {
        if !self.is_partial() {
            self.buffer = Vec::new();
            self.start = 0;
        }
    }

    /// The length announced by the current frame, bytes of kind and payload, if it is not over the cap.
    pub fn announced_length(&self) -> Option<usize> {
        self.announced().filter(|length| *length <= self.cap)
    }

    fn announced(&self) -> Option<usize> {
        let prefix = self.buffer.get(self.start..)?.first_chunk::<PREFIX>()?;
        usize::try_from(u32::from_be_bytes(*prefix)).ok()
    }

    /// The next complete frame, `None` if more bytes are needed.
    ///
    /// # Errors
    /// [`FrameError`] as soon as the length or the kind is known to be wrong.
    pub fn next_frame(&mut self) -> Result<Option<(FrameKind, &[u8])>, FrameError> {
        let Some(length) = self.announced() else { return Ok(None) };
        if length == 0 || length > self.cap {
            return Err(FrameError::Length(u32::try_from(length).unwrap_or(u32::MAX)));
        }
        let begin = self.start + PREFIX;
        let Some(&code) = self.buffer.get(begin) else { return Ok(None) };
        let kind = FrameKind::from_code(code).ok_or(FrameError::Kind(code))?;
        if self.buffer.len() < begin + length {
            return Ok(None);
        }
        self.start = begin + length;
        Ok(Some((kind, &self.buffer[begin + 1..begin + length])))
    }
}

impl Default for FrameDecoder {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn feed(decoder: &mut FrameDecoder, bytes: &[u8]) {
        decoder.space().extend_from_slice(bytes);
    }

    #[test]
    fn the_cap_is_checked_before_the_bytes_arrive() {
        let mut decoder = FrameDecoder::new();
        feed(&mut decoder, &4097u32.to_be_bytes());
        assert_eq!(decoder.next_frame(), Err(FrameError::Length(4097)));
        let mut decoder = FrameDecoder::new();
        decoder.raise_cap();
        feed(&mut decoder, &u32::try_from(CAP_AFTER).expect("fits").to_be_bytes());
        assert_eq!(decoder.next_frame(), Ok(None));
        assert!(decoder.space().capacity() <= 64 * 1024, "a mere claim allocates little");
        for wrong in [0, u32::MAX, 1024 * 1024 + 1] {
            let mut decoder = FrameDecoder::new();
            decoder.raise_cap();
            feed(&mut decoder, &wrong.to_be_bytes());
            assert_eq!(decoder.next_frame(), Err(FrameError::Length(wrong)));
        }
    }

    #[test]
    fn an_unknown_kind_ends_the_stream_and_an_idle_buffer_is_given_back() {
        let mut decoder = FrameDecoder::new();
        feed(&mut decoder, &[0, 0, 0, 9, 77]);
        assert_eq!(decoder.next_frame(), Err(FrameError::Kind(77)));
        let mut decoder = FrameDecoder::new();
        feed(&mut decoder, &encode(FrameKind::Hello, b"x"));
        assert_eq!(decoder.next_frame(), Ok(Some((FrameKind::Hello, &b"x"[..]))));
        decoder.rest();
        assert_eq!(decoder.buffer.capacity(), 0);
    }

    proptest! {
        #[test]
        fn frames_come_out_as_they_went_in_however_they_are_cut(
            payloads in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..300), 0..12),
            cuts in proptest::collection::vec(1usize..200, 1..40),
        ) {
            let wire: Vec<u8> = payloads.iter().flat_map(|payload| encode(FrameKind::Transfer, payload)).collect();
            let mut decoder = FrameDecoder::new();
            let (mut seen, mut rest) = (Vec::new(), &wire[..]);
            for cut in cuts.iter().cycle() {
                let (now, later) = rest.split_at(rest.len().min(*cut));
                feed(&mut decoder, now);
                rest = later;
                while let Some((kind, payload)) = decoder.next_frame().expect("valid") {
                    prop_assert_eq!(kind, FrameKind::Transfer);
                    seen.push(payload.to_vec());
                }
                if rest.is_empty() { break; }
            }
            prop_assert_eq!(seen, payloads);
            prop_assert!(!decoder.is_partial());
        }

        #[test]
        fn garbage_never_panics(noise in proptest::collection::vec(any::<u8>(), 0..2000)) {
            let mut decoder = FrameDecoder::new();
            feed(&mut decoder, &noise);
            while let Ok(Some(_)) = decoder.next_frame() {}
        }
    }
}

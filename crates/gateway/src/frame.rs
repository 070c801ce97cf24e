//! Frames: length (4, big endian, of kind and payload), kind (1), payload. The cap is checked before anything is
//! stored, and no buffer grows ahead of the bytes that arrived.

use std::time::Duration;

use tokio::time::{Instant, timeout, timeout_at};
use tokio::{io::AsyncWriteExt as _, net::TcpStream};

use crate::command::{Command, Inner, LARGEST_MESSAGE, LARGEST_PART, Part};
use crate::error::{Code, Refusal, Result};
use crate::model::{Signature, Token};

/// Before authentication; bytes of kind and payload.
pub const CAP_BEFORE: usize = 4 * 1024;
pub const CAP_AFTER: usize = 1024 * 1024;
/// Larger buffers are released when empty; bytes.
const KEPT: usize = 16 * 1024;
const PREFIX: usize = 4;

numbered! {
    FrameKind {
        Hello = 1,
        /// Signed.
        Answer = 2,
        /// N under the agreed key.
        Identify = 3,
        Transfer = 4,
        /// A code in clear before the connection closes.
        Refusal = 5,
        /// From a client that does not know the network yet, before the hello.
        Inquiry = 6,
        /// In clear; the hello proves it.
        Network = 7,
    }
}

/// The stream is of no further use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// Over the cap, or without a kind.
    #[error("a frame of {0} bytes")]
    Length(u32),
    #[error("a frame of kind {0}")]
    Kind(u8),
}

/// Every reader refuses a payload over [`CAP_AFTER`].
pub fn encode(kind: FrameKind, payload: &[u8]) -> Vec<u8> {
    let length = u32::try_from(payload.len().saturating_add(1)).unwrap_or(u32::MAX);
    let mut out = Vec::with_capacity(PREFIX + 1 + payload.len());
    out.extend_from_slice(&length.to_be_bytes());
    out.push(kind.number());
    out.extend_from_slice(payload);
    out
}

#[derive(Debug)]
pub struct FrameDecoder {
    cap: usize,
    buffer: Vec<u8>,
    start: usize,
}

impl FrameDecoder {
    /// Call once the peer is authenticated.
    pub fn raise_cap(&mut self) {
        self.cap = CAP_AFTER;
    }

    /// Where to append, with room for some bytes; never holds more than one cap unread.
    pub fn space(&mut self) -> &mut Vec<u8> {
        if self.start > 0 {
            self.buffer.drain(..self.start);
            self.start = 0;
        }
        let wanted = self.announced().map_or(KEPT, |length| (length + PREFIX).saturating_sub(self.buffer.len()));
        self.buffer.reserve(wanted.clamp(CAP_BEFORE, KEPT.max(self.buffer.len())).min(self.cap + PREFIX));
        &mut self.buffer
    }

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

    /// The current frame's announced length, unless over the cap.
    pub fn announced_length(&self) -> Option<usize> {
        self.announced().filter(|length| *length <= self.cap)
    }

    fn announced(&self) -> Option<usize> {
        let prefix = self.buffer.get(self.start..)?.first_chunk::<PREFIX>()?;
        usize::try_from(u32::from_be_bytes(*prefix)).ok()
    }

    /// `None` while incomplete; an error as soon as length or kind is known to be wrong.
    pub fn next_frame(&mut self) -> Result<Option<(FrameKind, &[u8])>, FrameError> {
        let Some(length) = self.announced() else { return Ok(None) };
        if length == 0 || length > self.cap {
            return Err(FrameError::Length(u32::try_from(length).unwrap_or(u32::MAX)));
        }
        let begin = self.start + PREFIX;
        let Some(&code) = self.buffer.get(begin) else { return Ok(None) };
        let kind = FrameKind::from_number(code).ok_or(FrameError::Kind(code))?;
        if self.buffer.len() < begin + length {
            return Ok(None);
        }
        self.start = begin + length;
        Ok(Some((kind, &self.buffer[begin + 1..begin + length])))
    }
}

impl Default for FrameDecoder {
    /// With the cap for an unauthenticated peer.
    fn default() -> Self {
        Self { cap: CAP_BEFORE, buffer: Vec::new(), start: 0 }
    }
}

#[derive(Debug)]
pub struct Message<C> {
    pub command: Command,
    pub request: u32,
    pub token: Option<Token>,
    pub signature: Option<Signature>,
    pub counter: u64,
    pub body: Vec<u8>,
    /// Held as long as the message.
    pub charge: Option<C>,
}

struct Unfinished<C> {
    message: Message<C>,
    total: usize,
}

/// For one direction.
pub struct Assembler<C> {
    unfinished: Option<Unfinished<C>>,
}

impl<C> Assembler<C> {
    pub fn is_partial(&self) -> bool {
        self.unfinished.is_some()
    }

    /// Returns a complete message. Calls `charge` before it stores a message in parts. Refuses parts that do not follow
    /// one another with `Length` or `Malformed`.
    pub fn take(
        &mut self,
        inner: &Inner<'_>,
        counter: u64,
        charge: impl FnOnce(usize) -> Result<C>,
    ) -> Result<Option<Message<C>>> {
        if inner.body.len() > LARGEST_PART {
            return Err(Refusal::new(Code::Length, format_args!("a part of {} bytes", inner.body.len())));
        }
        match (inner.part, self.unfinished.is_some()) {
            (Part::Whole, false) => Ok(Some(message(inner, counter, inner.body.to_vec(), None))),
            (Part::First, false) => self.begin(inner, counter, charge).map(|()| None),
            (Part::Middle | Part::Last, true) => self.go_on(inner, counter),
            _ => Err(Refusal::new(Code::Malformed, "message parts out of order")),
        }
    }

    fn begin(&mut self, inner: &Inner<'_>, counter: u64, charge: impl FnOnce(usize) -> Result<C>) -> Result<()> {
        let (claim, body) = inner
            .body
            .split_first_chunk()
            .ok_or_else(|| Refusal::new(Code::Malformed, "a first part without a length"))?;
        let total = usize::try_from(u32::from_be_bytes(*claim)).unwrap_or(usize::MAX);
        // A message that fits into one frame is sent in one: every message has exactly one encoding.
        if total <= LARGEST_PART || total > LARGEST_MESSAGE || body.len() + claim.len() != LARGEST_PART {
            return Err(Refusal::new(Code::Length, format_args!("a message of {total} bytes in parts")));
        }
        let charge = charge(total)?;
        self.unfinished = Some(Unfinished { message: message(inner, counter, body.to_vec(), Some(charge)), total });
        Ok(())
    }

    fn go_on(&mut self, inner: &Inner<'_>, counter: u64) -> Result<Option<Message<C>>> {
        let Some(mut unfinished) = self.unfinished.take() else { return Ok(None) };
        let message = &mut unfinished.message;
        if (message.command, message.request) != (inner.command, inner.request) {
            return Err(Refusal::new(Code::Malformed, "a part of another message"));
        }
        let left = unfinished.total.saturating_sub(message.body.len());
        let expected = if left > LARGEST_PART { (Part::Middle, LARGEST_PART) } else { (Part::Last, left) };
        if (inner.part, inner.body.len()) != expected {
            return Err(Refusal::new(Code::Length, format_args!("a part of {} bytes", inner.body.len())));
        }
        message.body.extend_from_slice(inner.body);
        message.counter = counter;
        if inner.part == Part::Last {
            return Ok(Some(unfinished.message));
        }
        self.unfinished = Some(unfinished);
        Ok(None)
    }
}

impl<C> Default for Assembler<C> {
    fn default() -> Self {
        Self { unfinished: None }
    }
}

fn message<C>(inner: &Inner<'_>, counter: u64, body: Vec<u8>, charge: Option<C>) -> Message<C> {
    let Inner { command, request, token, signature, .. } = *inner;
    Message { command, request, token, signature, counter, body, charge }
}

/// Time and bytes to read after a refusal, so that the peer gets to read it.
const LAST_WORDS: (Duration, usize) = (Duration::from_millis(500), 256 * 1024);

#[derive(Debug)]
pub(super) enum LineError {
    /// Or the network broke.
    Closed(Option<std::io::Error>),
    Frame(FrameError),
    /// The peer does not read.
    TooSlow,
}

pub(super) struct Line {
    stream: TcpStream,
    pub decoder: FrameDecoder,
}

impl Line {
    pub fn new(stream: TcpStream) -> Self {
        // Without it only small answers are delayed.
        let _ = stream.set_nodelay(true);
        Self { stream, decoder: FrameDecoder::default() }
    }

    pub fn arrived(&mut self) -> Result<Option<(FrameKind, Vec<u8>)>, LineError> {
        let frame = self.decoder.next_frame().map_err(LineError::Frame)?;
        let frame = frame.map(|(kind, payload)| (kind, payload.to_vec()));
        if frame.is_none() {
            self.decoder.rest();
        }
        Ok(frame)
    }

    /// Cancel-safe.
    pub async fn fill(&mut self) -> Result<(), LineError> {
        loop {
            self.stream.readable().await.map_err(|error| LineError::Closed(Some(error)))?;
            match self.stream.try_read_buf(self.decoder.space()) {
                Ok(0) => return Err(LineError::Closed(None)),
                Ok(_) => return Ok(()),
                Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => self.decoder.rest(),
                Err(error) => return Err(LineError::Closed(Some(error))),
            }
        }
    }

    /// Cancel-safe.
    pub async fn frame(&mut self) -> Result<(FrameKind, Vec<u8>), LineError> {
        loop {
            if let Some(frame) = self.arrived()? {
                return Ok(frame);
            }
            self.fill().await?;
        }
    }

    pub async fn send(&mut self, kind: FrameKind, payload: &[u8], patience: Duration) -> Result<(), LineError> {
        match timeout(patience, self.stream.write_all(&encode(kind, payload))).await {
            Ok(Ok(())) => Ok(()),
            Ok(Err(error)) => Err(LineError::Closed(Some(error))),
            Err(_) => Err(LineError::TooSlow),
        }
    }

    /// Sends the reason in clear and reads on a little: unread bytes would reset the connection and lose the reason.
    pub async fn refuse(mut self, code: Code) {
        let sent = self.send(FrameKind::Refusal, &code.number().to_be_bytes(), LAST_WORDS.0).await;
        if sent.is_err() || self.stream.shutdown().await.is_err() {
            return;
        }
        let deadline = Instant::now() + LAST_WORDS.0;
        let (mut read, mut buffer) = (0, Vec::new());
        while read < LAST_WORDS.1 {
            buffer.clear();
            match timeout_at(deadline, tokio::io::AsyncReadExt::read_buf(&mut self.stream, &mut buffer)).await {
                Ok(Ok(count)) if count > 0 => read += count,
                _ => return,
            }
        }
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
        let mut decoder = FrameDecoder::default();
        feed(&mut decoder, &4097u32.to_be_bytes());
        assert_eq!(decoder.next_frame(), Err(FrameError::Length(4097)));
        let mut decoder = FrameDecoder::default();
        decoder.raise_cap();
        feed(&mut decoder, &u32::try_from(CAP_AFTER).expect("fits").to_be_bytes());
        assert_eq!(decoder.next_frame(), Ok(None));
        assert!(decoder.space().capacity() <= 64 * 1024, "a mere claim allocates little");
        for wrong in [0, u32::MAX, 1024 * 1024 + 1] {
            let mut decoder = FrameDecoder::default();
            decoder.raise_cap();
            feed(&mut decoder, &wrong.to_be_bytes());
            assert_eq!(decoder.next_frame(), Err(FrameError::Length(wrong)));
        }
    }

    #[test]
    fn an_unknown_kind_ends_the_stream_and_an_idle_buffer_is_given_back() {
        let mut decoder = FrameDecoder::default();
        feed(&mut decoder, &[0, 0, 0, 9, 77]);
        assert_eq!(decoder.next_frame(), Err(FrameError::Kind(77)));
        let mut decoder = FrameDecoder::default();
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
            let mut decoder = FrameDecoder::default();
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
            let mut decoder = FrameDecoder::default();
            feed(&mut decoder, &noise);
            while let Ok(Some(_)) = decoder.next_frame() {}
        }
    }
}

#[cfg(test)]
mod parts_tests {
    use super::*;
    use crate::command::{Speaker, split};
    use proptest::prelude::*;

    fn texts(length: usize) -> (Vec<u8>, Vec<Vec<u8>>) {
        let body: Vec<u8> = (0..length).map(|index| u8::try_from(index % 251).expect("small")).collect();
        let texts = split(Command::Upload, 9, Speaker::Client(Token([3; 32])), &body);
        (body, texts)
    }

    fn assemble(texts: &[Vec<u8>]) -> Result<Option<Message<usize>>> {
        let mut assembler = Assembler::default();
        let mut whole = None;
        for (counter, text) in (0..).zip(texts) {
            let inner = Inner::from_client(text)?;
            whole = assembler.take(&inner, counter, Ok)?;
        }
        Ok(whole)
    }

    #[test]
    fn parts_come_together_and_are_charged() {
        for length in [0, LARGEST_PART, LARGEST_PART + 1, 2 * LARGEST_PART - 4, 2 * LARGEST_PART, 3 * LARGEST_PART] {
            let (body, texts) = texts(length);
            let message = assemble(&texts).expect("assembles").expect("whole");
            assert_eq!((message.body.len(), message.request, message.token), (length, 9, Some(Token([3; 32]))));
            assert_eq!(message.body, body);
            assert_eq!(message.charge, (length > LARGEST_PART).then_some(length));
        }
    }

    #[test]
    fn missing_repeated_swapped_and_overlong_parts_are_refused() {
        let (_, all) = texts(3 * LARGEST_PART);
        assert_eq!(all.len(), 4);
        for wrong in [vec![1], vec![0, 0], vec![0, 3], vec![0, 1, 3], vec![0, 1, 2, 2], vec![3], vec![0, 1, 2, 3, 3]] {
            let texts: Vec<Vec<u8>> = wrong.iter().map(|index| all[*index].clone()).collect();
            assert!(assemble(&texts).is_err(), "{wrong:?}");
        }
        let mut claims_more = all[0].clone();
        claims_more[38..42].copy_from_slice(&u32::MAX.to_be_bytes());
        assert_eq!(assemble(&[claims_more]).expect_err("too long").code, Code::Length);
        let (_, other) = texts(10);
        assert!(assemble(&[all[0].clone(), other[0].clone()]).is_err(), "another message in between");
        let refused = Assembler::<()>::default()
            .take(&Inner::from_client(&all[0]).expect("parses"), 0, |_| Err(Refusal::new(Code::Quota, "full")));
        assert_eq!(refused.expect_err("refused").code, Code::Quota);
    }

    proptest! {
        #[test]
        fn garbage_never_panics(noise in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..100), 0..6)) {
            let _ = assemble(&noise);
        }
    }
}

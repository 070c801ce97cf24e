//! One TCP connection as a stream of frames. While nothing arrives it holds no buffer.

use std::time::Duration;

use tokio::io::AsyncWriteExt as _;
use tokio::net::TcpStream;
use tokio::time::{Instant, timeout, timeout_at};

use super::code::Code;
use super::frame::{FrameDecoder, FrameError, FrameKind, encode};

/// How long and how much is read after a refusal, so that the peer gets to read it.
const LAST_WORDS: (Duration, usize) = (Duration::from_millis(500), 256 * 1024);

/// Why a connection ended.
#[derive(Debug)]
pub(super) enum LineError {
    /// The peer closed, or the network broke.
    Closed(Option<std::io::Error>),
    /// Bytes that are not frames.
    Frame(FrameError),
    /// The peer did not accept what was sent.
    TooSlow,
}

pub(super) struct Line {
    stream: TcpStream,
    decoder: FrameDecoder,
}

impl Line {
    pub fn new(stream: TcpStream) -> Self {
        // Without it only small answers are delayed; nothing breaks.
        let _ = stream.set_nodelay(true);
        Self { stream, decoder: FrameDecoder::new() }
    }

    pub fn raise_cap(&mut self) {
        self.decoder.raise_cap();
    }

    /// Whether an incomplete frame has begun.
    pub fn is_partial(&self) -> bool {
        self.decoder.is_partial()
    }

    /// Length of the frame that has begun, if it announces an allowed one.
    pub fn announced(&self) -> Option<usize> {
        self.decoder.announced_length()
    }

    /// A complete frame that has already arrived.
    pub fn arrived(&mut self) -> Result<Option<(FrameKind, Vec<u8>)>, LineError> {
        let frame = self.decoder.next_frame().map_err(LineError::Frame)?;
        let frame = frame.map(|(kind, payload)| (kind, payload.to_vec()));
        if frame.is_none() {
            self.decoder.rest();
        }
        Ok(frame)
    }

    /// Waits for bytes and reads what is there. Can be cancelled at any point.
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

    /// The next frame. Can be cancelled at any point.
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

    /// Sends the reason in clear, then closes. Unread bytes would make the system reset the connection and the peer
    /// lose the reason, so some are read first.
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

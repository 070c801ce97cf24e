//! The pipe between a site and a child process that talks to the network. Neither side trusts the other. One frame is
//! the length of the head and of the payload (u32, little-endian each), the head, the payload.

pub mod read;
pub mod write;

use std::io::{Read, Write};

use serde::{Serialize, de::DeserializeOwned};

/// A child and a site of different versions part.
pub const VERSION: u32 = 1;

/// The side that meets it ends the child and restarts it.
#[derive(Debug, thiserror::Error)]
pub enum PipeError {
    #[error("the pipe to the other process broke ({0}); the site restarts it")]
    Broken(#[from] std::io::Error),
    #[error(
        "a frame on the pipe claims {found} bytes of {part}, but {most} are allowed; use the same release of both \
         programs"
    )]
    TooLong { part: &'static str, found: u64, most: u32 },
    #[error("the pipe closed in the middle of a frame; the other process was killed or crashed")]
    Cut,
    #[error("a frame on the pipe is malformed ({0}); use the same release of both programs")]
    Head(String),
}

pub const LONGEST_HEAD: u32 = 64 << 10;
pub const LONGEST_PAYLOAD: u32 = 64 << 20;

const LENGTHS: u32 = 8;

/// The caller flushes.
pub fn send<T: Serialize>(to: &mut impl Write, head: &T, payload: &[u8]) -> Result<(), PipeError> {
    let head = serde_json::to_vec(head).map_err(|error| PipeError::Head(error.to_string()))?;
    let mut lengths = [0; LENGTHS as usize];
    lengths[..4].copy_from_slice(&checked("head", head.len() as u64, LONGEST_HEAD)?.to_le_bytes());
    lengths[4..].copy_from_slice(&checked("payload", payload.len() as u64, LONGEST_PAYLOAD)?.to_le_bytes());
    to.write_all(&lengths)?;
    to.write_all(&head)?;
    to.write_all(payload)?;
    Ok(())
}

/// `None` if the pipe ended between two frames. Lengths are checked before memory is taken.
pub fn receive<T: DeserializeOwned>(from: &mut impl Read) -> Result<Option<(T, Vec<u8>)>, PipeError> {
    let begin = exactly(from, LENGTHS)?;
    if begin.is_empty() {
        return Ok(None);
    }
    let ([head, payload], []) = begin.as_chunks::<4>() else { return Err(PipeError::Cut) };
    let head = checked("head", u64::from(u32::from_le_bytes(*head)), LONGEST_HEAD)?;
    let payload = checked("payload", u64::from(u32::from_le_bytes(*payload)), LONGEST_PAYLOAD)?;
    let head = whole(from, head)?;
    let head = serde_json::from_slice(&head).map_err(|error| PipeError::Head(error.to_string()))?;
    Ok(Some((head, whole(from, payload)?)))
}

fn checked(part: &'static str, found: u64, most: u32) -> Result<u32, PipeError> {
    u32::try_from(found).ok().filter(|length| *length <= most).ok_or(PipeError::TooLong { part, found, most })
}

fn whole(from: &mut impl Read, length: u32) -> Result<Vec<u8>, PipeError> {
    let found = exactly(from, length)?;
    if found.len() as u64 == u64::from(length) { Ok(found) } else { Err(PipeError::Cut) }
}

/// Fewer bytes if the pipe ends. Memory grows with the bytes that arrive, not with the claimed length.
fn exactly(from: &mut impl Read, length: u32) -> Result<Vec<u8>, PipeError> {
    let mut found = Vec::with_capacity(length.min(64 << 10) as usize);
    from.take(u64::from(length)).read_to_end(&mut found)?;
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::io::Cursor;

    #[test]
    fn a_claim_is_refused_before_memory_is_taken() {
        for (head, payload) in [(LONGEST_HEAD + 1, 0), (u32::MAX, 0), (2, LONGEST_PAYLOAD + 1), (2, u32::MAX)] {
            let bytes = [head.to_le_bytes(), payload.to_le_bytes()].concat();
            let refused = receive::<String>(&mut Cursor::new(bytes));
            assert!(matches!(refused, Err(PipeError::TooLong { .. })), "{head} {payload}");
        }
        let mut sent = Vec::new();
        let refused = send(&mut sent, &"x".repeat(LONGEST_HEAD as usize), &[]);
        assert!(matches!(refused, Err(PipeError::TooLong { part: "head", .. })) && sent.is_empty());
        // The largest allowed claim, with nothing after it.
        let bytes = [LONGEST_HEAD.to_le_bytes(), LONGEST_PAYLOAD.to_le_bytes()].concat();
        assert!(matches!(receive::<String>(&mut Cursor::new(bytes)), Err(PipeError::Cut)));
    }

    proptest! {
        #[test]
        fn what_was_sent_arrives_in_order(frames in prop::collection::vec(
            (".{0,40}", prop::collection::vec(any::<u8>(), 0..3000)), 0..12,
        )) {
            let mut pipe = Vec::new();
            for (head, payload) in &frames {
                send(&mut pipe, head, payload).expect("sent");
            }
            let mut pipe = Cursor::new(pipe);
            for frame in frames {
                prop_assert_eq!(receive::<String>(&mut pipe).expect("received"), Some(frame));
            }
            prop_assert!(receive::<String>(&mut pipe).expect("an end").is_none());
        }

        #[test]
        fn a_cut_pipe_gives_whole_frames_and_then_says_so(
            payload in prop::collection::vec(any::<u8>(), 1..300), keep in 0.0..1.0_f64,
        ) {
            let mut pipe = Vec::new();
            send(&mut pipe, &"first", &[]).expect("sent");
            let first = pipe.len();
            send(&mut pipe, &"second", &payload).expect("sent");
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss)]
            let kept = first + 1 + ((pipe.len() - first - 1) as f64 * keep) as usize;
            pipe.truncate(kept);
            let mut pipe = Cursor::new(pipe);
            prop_assert_eq!(receive::<String>(&mut pipe).expect("whole").map(|frame| frame.0), Some("first".to_owned()));
            prop_assert!(matches!(receive::<String>(&mut pipe), Err(PipeError::Cut)));
        }

        #[test]
        fn any_bytes_end_without_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let mut pipe = Cursor::new(bytes);
            while let Ok(Some((_, payload))) = receive::<serde_json::Value>(&mut pipe) {
                prop_assert!(payload.len() <= 200);
            }
        }
    }
}

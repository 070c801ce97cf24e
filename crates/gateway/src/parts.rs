//! Messages assembled from their parts. Nothing is allocated on a claim: the buffer grows with the bytes that arrive,
//! and the claimed length is charged to the sender's quota first.

use crate::model::{Signature, Token};

use super::code::{Code, Refusal};
use super::command::{Command, Inner, LARGEST_MESSAGE, LARGEST_PART, Part};

/// A complete message.
#[derive(Debug)]
pub struct Message<C> {
    /// Its Command.
    pub command: Command,
    /// The client's number of the request.
    pub request: u32,
    /// From a client.
    pub token: Option<Token>,
    /// Of signed Commands.
    pub signature: Option<Signature>,
    /// The counter of its last frame.
    pub counter: u64,
    /// The whole body.
    pub body: Vec<u8>,
    /// Held as long as the message.
    pub charge: Option<C>,
}

struct Unfinished<C> {
    message: Message<C>,
    total: usize,
}

/// Assembles the parts of one direction.
pub struct Assembler<C> {
    unfinished: Option<Unfinished<C>>,
}

impl<C> Assembler<C> {
    /// With nothing begun.
    pub fn new() -> Self {
        Self { unfinished: None }
    }

    /// Whether an incomplete message has begun.
    pub fn is_partial(&self) -> bool {
        self.unfinished.is_some()
    }

    /// Takes the next ND2; returns the message once it is complete. `charge` is called before a message in parts is
    /// stored.
    ///
    /// # Errors
    /// [`Refusal`] with `Length` or `Malformed` if parts do not follow one another, or from `charge`.
    pub fn take(
        &mut self,
        inner: &Inner<'_>,
        counter: u64,
        charge: impl FnOnce(usize) -> Result<C, Refusal>,
    ) -> Result<Option<Message<C>>, Refusal> {
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

    fn begin(
        &mut self,
        inner: &Inner<'_>,
        counter: u64,
        charge: impl FnOnce(usize) -> Result<C, Refusal>,
    ) -> Result<(), Refusal> {
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

    fn go_on(&mut self, inner: &Inner<'_>, counter: u64) -> Result<Option<Message<C>>, Refusal> {
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
        Self::new()
    }
}

fn message<C>(inner: &Inner<'_>, counter: u64, body: Vec<u8>, charge: Option<C>) -> Message<C> {
    Message {
        command: inner.command,
        request: inner.request,
        token: inner.token,
        signature: inner.signature,
        counter,
        body,
        charge,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gateway::command::{Speaker, split};
    use proptest::prelude::*;

    fn texts(length: usize) -> (Vec<u8>, Vec<Vec<u8>>) {
        let body: Vec<u8> = (0..length).map(|index| u8::try_from(index % 251).expect("small")).collect();
        let texts = split(Command::Upload, 9, Speaker::Client(Token([3; 32])), &body);
        (body, texts)
    }

    fn assemble(texts: &[Vec<u8>]) -> Result<Option<Message<usize>>, Refusal> {
        let mut assembler = Assembler::new();
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
        let refused = Assembler::<()>::new()
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

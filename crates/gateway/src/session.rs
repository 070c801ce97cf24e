//! Session keys for both directions, and counters that never repeat. ND3 = session id (16) || counter (8) || CT2; CT2
//! is SM4-GCM with kind, id and counter as AAD.

use std::fmt;
use std::time::{Duration, Instant};

use zeroize::Zeroizing;

use crate::crypto::kdf::{Info, key_and_nonce};
use crate::error::{Code, Refusal, Result};
use crate::frame::{CAP_AFTER, FrameKind};
use crate::{crypto::Provider, model::bytes::hex, model::wire::Reader};

/// Of one direction.
pub const MOST_FRAMES: u64 = 1 << 24;
pub const LONGEST_LIFE: Duration = Duration::from_secs(3600);
/// Kind, session id, counter and tag around the plaintext.
pub const OVERHEAD: usize = 1 + 16 + 8 + 16;
/// Of one frame, bytes.
pub const LONGEST_TEXT: usize = CAP_AFTER - OVERHEAD;

/// Random, from the gateway.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct SessionId(pub [u8; 16]);

crate::model::layout!(SessionId(0));

impl fmt::Debug for SessionId {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "SessionId({})", hex(&self.0))
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    Client,
    Gateway,
}

pub struct DirectionKeys {
    key: Zeroizing<[u8; 16]>,
    iv: Zeroizing<[u8; 12]>,
}

impl DirectionKeys {
    fn derive(material: &[u8], salt: &[u8; 32], direction: u8) -> Self {
        let (key, iv) = key_and_nonce(material, salt, &Info::new("AuthROS/session/1").fixed(&[direction]));
        Self { key, iv: Zeroizing::new(iv) }
    }

    /// The iv with the counter XORed into its last eight bytes.
    fn nonce(&self, counter: u64) -> [u8; 12] {
        let mut nonce = *self.iv;
        nonce[4..].iter_mut().zip(counter.to_be_bytes()).for_each(|(byte, part)| *byte ^= part);
        nonce
    }
}

pub struct SessionKeys {
    from_client: DirectionKeys,
    from_gateway: DirectionKeys,
}

impl SessionKeys {
    /// HKDF-SM3(material, salt, label || direction): 1 from the client, 2 from the gateway.
    pub fn derive(material: &[u8], salt: &[u8; 32]) -> Self {
        Self {
            from_client: DirectionKeys::derive(material, salt, 1),
            from_gateway: DirectionKeys::derive(material, salt, 2),
        }
    }
}

fn aad(id: &SessionId, counter: u64) -> [u8; 25] {
    let mut aad = [0; 25];
    aad[0] = FrameKind::Transfer.number();
    aad[1..17].copy_from_slice(&id.0);
    aad[17..].copy_from_slice(&counter.to_be_bytes());
    aad
}

struct Direction {
    keys: DirectionKeys,
    counter: u64,
}

/// Opens nothing after a refusal by [`Self::open`].
pub struct Session {
    provider: &'static dyn Provider,
    id: SessionId,
    sending: Direction,
    receiving: Direction,
    begun: Instant,
    broken: bool,
}

impl Session {
    /// Begins now.
    pub fn new(provider: &'static dyn Provider, id: SessionId, side: Side, keys: SessionKeys) -> Self {
        let (sending, receiving) = match side {
            Side::Client => (keys.from_client, keys.from_gateway),
            Side::Gateway => (keys.from_gateway, keys.from_client),
        };
        let direction = |keys| Direction { keys, counter: 0 };
        let (sending, receiving) = (direction(sending), direction(receiving));
        Self { provider, id, sending, receiving, begun: Instant::now(), broken: false }
    }

    /// Of the next sealed frame.
    pub fn next_counter(&self) -> u64 {
        self.sending.counter
    }

    /// Must be replaced: too many frames, or too old.
    pub fn is_spent(&self, now: Instant) -> bool {
        let frames = self.sending.counter.max(self.receiving.counter);
        self.broken || frames >= MOST_FRAMES || now.saturating_duration_since(self.begun) >= LONGEST_LIFE
    }

    /// Seals an ND2. Refuses with `Session` after the last frame, `Length` over [`LONGEST_TEXT`].
    pub fn seal(&mut self, text: &[u8]) -> Result<Vec<u8>> {
        let counter = self.sending.counter;
        if self.broken || counter >= MOST_FRAMES {
            return Err(Refusal::new(Code::Session, "the session has used up its frames"));
        }
        if text.len() > LONGEST_TEXT {
            return Err(Refusal::new(Code::Length, format_args!("a text of {} bytes", text.len())));
        }
        let aad = aad(&self.id, counter);
        let mut sealed = Vec::with_capacity(text.len() + 16);
        sealed.extend_from_slice(text);
        let keys = &self.sending.keys;
        self.provider.gcm_seal(&keys.key, &keys.nonce(counter), &aad, &mut sealed).map_err(Refusal::internal)?;
        self.sending.counter = counter + 1;
        Ok([&aad[1..], &sealed].concat())
    }

    /// Returns a transfer frame's counter and ND2.
    pub fn open(&mut self, payload: &[u8]) -> Result<(u64, Zeroizing<Vec<u8>>)> {
        let opened = self.opened(payload);
        self.broken |= opened.is_err();
        opened
    }

    fn opened(&mut self, payload: &[u8]) -> Result<(u64, Zeroizing<Vec<u8>>)> {
        if payload.len() + 1 < OVERHEAD || payload.len() >= CAP_AFTER {
            return Err(Refusal::new(Code::Length, format_args!("a transfer frame of {} bytes", payload.len())));
        }
        let mut reader = Reader::new(payload);
        let id = SessionId(reader.array("session")?);
        let counter = reader.u64("counter")?;
        if id != self.id || self.broken {
            return Err(Refusal::new(Code::Session, "a frame of another session"));
        }
        let expected = self.receiving.counter;
        if counter != expected || counter >= MOST_FRAMES {
            return Err(Refusal::new(Code::Counter, format_args!("counter {counter}, expected {expected}")));
        }
        let keys = &self.receiving.keys;
        let opened = self.provider.gcm_open(&keys.key, &keys.nonce(counter), &aad(&id, counter), reader.rest());
        let text = opened.map_err(Refusal::because(Code::Tag))?;
        self.receiving.counter = counter + 1;
        Ok((counter, text))
    }
}

impl fmt::Debug for Session {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "Session({}, {} sent)", hex(&self.id.0), self.sending.counter)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crypto::{ProviderName, provider};
    use proptest::prelude::*;

    impl Session {
        /// Keys and ivs of a client's session, for test vectors.
        pub fn key_bytes(&self) -> Vec<(&'static str, Vec<u8>)> {
            let bytes = |keys: &DirectionKeys| [&keys.key[..], &keys.iv[..]].concat();
            vec![("client key and iv", bytes(&self.sending.keys)), ("gateway key and iv", bytes(&self.receiving.keys))]
        }

        pub fn id(&self) -> SessionId {
            self.id
        }

        /// Forgets that a frame was refused, for tests that try many.
        pub fn mend(&mut self) {
            self.broken = false;
        }
    }

    fn pair(material: &[u8]) -> (Session, Session) {
        let provider = provider(ProviderName::RustCrypto);
        let session = |side| Session::new(provider, SessionId([7; 16]), side, SessionKeys::derive(material, &[1; 32]));
        (session(Side::Client), session(Side::Gateway))
    }

    fn refused(session: &mut Session, payload: &[u8]) -> Code {
        session.open(payload).expect_err("refused").code
    }

    #[test]
    fn frames_pass_in_order_in_both_directions() {
        let (mut client, mut gateway) = pair(b"secret");
        for number in 0..5u64 {
            let payload = client.seal(&number.to_be_bytes()).expect("seals");
            let (counter, text) = gateway.open(&payload).expect("opens");
            assert_eq!((counter, &text[..]), (number, &number.to_be_bytes()[..]));
            let back = gateway.seal(b"").expect("seals");
            assert_eq!(back.len() + 1, OVERHEAD);
            client.open(&back).expect("opens");
            assert_ne!(payload[24..], back[24..], "directions have keys of their own");
        }
        assert!(!client.is_spent(Instant::now()));
        assert!(client.is_spent(Instant::now() + LONGEST_LIFE));
    }

    #[test]
    fn replayed_skipped_swapped_and_reflected_frames_end_the_session() {
        let (mut client, _) = pair(b"secret");
        let frames: Vec<Vec<u8>> = (0..3).map(|_| client.seal(b"text").expect("seals")).collect();
        let (_, mut gateway) = pair(b"secret");
        gateway.open(&frames[0]).expect("opens");
        assert_eq!(refused(&mut gateway, &frames[0]), Code::Counter);
        assert_eq!(refused(&mut gateway, &frames[1]), Code::Session, "nothing opens after a refusal");
        assert!(gateway.seal(b"x").is_err());
        let (_, mut gateway) = pair(b"secret");
        assert_eq!(refused(&mut gateway, &frames[1]), Code::Counter);
        assert_eq!(refused(&mut client, &frames[0]), Code::Tag, "its own frame sent back");
        let (_, mut gateway) = pair(b"other");
        assert_eq!(refused(&mut gateway, &frames[0]), Code::Tag, "another key");
        let (_, mut gateway) = pair(b"secret");
        gateway.id = SessionId([8; 16]);
        assert_eq!(refused(&mut gateway, &frames[0]), Code::Session);
    }

    #[test]
    fn after_the_last_frame_nothing_is_sealed_or_opened() {
        let (mut client, mut gateway) = pair(b"secret");
        client.sending.counter = MOST_FRAMES - 1;
        gateway.receiving.counter = MOST_FRAMES - 1;
        gateway.open(&client.seal(b"last").expect("seals")).expect("opens");
        assert_eq!(client.seal(b"x").expect_err("over").code, Code::Session);
        assert!(client.is_spent(Instant::now()) && gateway.is_spent(Instant::now()));
        assert_eq!(client.seal(&vec![0; LONGEST_TEXT + 1]).expect_err("over").code, Code::Session);
    }

    proptest! {
        #[test]
        fn every_flipped_bit_and_every_cut_is_refused(text in proptest::collection::vec(any::<u8>(), 0..200), at: usize, bit in 0u8..8) {
            let (mut client, mut gateway) = pair(b"secret");
            let payload = client.seal(&text).expect("seals");
            let at = at % payload.len();
            let mut altered = payload.clone();
            altered[at] ^= 1 << bit;
            let expected = match at { 0..16 => Code::Session, 16..24 => Code::Counter, _ => Code::Tag };
            prop_assert_eq!(refused(&mut gateway, &altered), expected);
            let (_, mut gateway) = pair(b"secret");
            prop_assert!(gateway.open(&payload[..at]).is_err());
            let (_, mut gateway) = pair(b"secret");
            let longer = [&payload[..], &[0]].concat();
            prop_assert_eq!(refused(&mut gateway, &longer), Code::Tag);
        }

        #[test]
        fn garbage_never_panics(noise in proptest::collection::vec(any::<u8>(), 0..200)) {
            prop_assert!(pair(b"secret").1.open(&noise).is_err());
        }
    }
}

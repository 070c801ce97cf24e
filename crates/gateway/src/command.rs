//! ND2: the request or answer in one frame. From the client: Command (1) || part (1) || request (4) || token (32) ||
//! signature (64, of signed Commands only) || body. From the gateway: Command + 128 (1) || part (1) || request (4) ||
//! body. Later parts of a message carry no token and no signature.

use crate::model::wire::{Reader, WireError};
use crate::model::{Digest, Domain, Signature, SignerId, Token};

use super::session::{LONGEST_TEXT, SessionId};

pub mod answer;
pub mod erased;
pub mod erasure;
pub mod query;
pub mod relay;
pub mod request;

pub use answer::{Answer, Fetched, Standing};
pub use erased::ErasedRecord;
pub use erasure::{ErasureNotice, ErasureOutcome};
pub use query::{Entry, Page, Query, Selection};
pub use relay::{RelayCall, Relayed};
pub use request::{DeviceNotice, GrantNotice, Registration, Request, RevokeNotice, Upload};

/// The largest message, in parts or whole, bytes of body: a record of 64 MiB with its head and header.
pub const LARGEST_MESSAGE: usize = 64 * 1024 * 1024 + 128 * 1024;
/// The largest body of one frame, bytes: the same in both directions and for every Command.
pub const LARGEST_PART: usize = LONGEST_TEXT - 128;
/// Added to a Command's number in messages from the gateway.
const FROM_GATEWAY: u8 = 128;

macro_rules! commands {
    ($($(#[$doc:meta])* $name:ident = $number:literal;)*) => {
        /// The operation field of a frame.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        #[repr(u8)]
        pub enum Command {
            $($(#[$doc])* $name = $number,)*
        }

        impl Command {
            /// Every Command.
            pub const ALL: &[Self] = &[$(Self::$name),*];
        }
    };
}

commands! {
    /// The list of system keys.
    SystemKeys = 1;
    /// K_T to the gateway, N bound to an account.
    KeyAllocation = 2;
    /// A signed transaction that registers an identity, for the chain.
    Register = 3;
    /// One record.
    Upload = 4;
    /// Several records.
    UploadMany = 5;
    /// List records by owner, topic, type, time, tag.
    Query = 6;
    /// The standings of records.
    Check = 7;
    /// One record with signature and proof.
    Fetch = 8;
    /// Records as they arrive.
    Subscribe = 9;
    /// End a subscription.
    Unsubscribe = 10;
    /// A grant was sent to the chain.
    GrantNotice = 11;
    /// A revoke was sent to the chain; it applies at once.
    RevokeNotice = 12;
    /// Nothing; the gateway answers with its time.
    Ping = 13;
    /// Only from the gateway: a record of a subscription.
    Event = 14;
    /// Only from the gateway: a subscription has ended.
    End = 15;
    /// Only from the gateway: a refusal.
    Refuse = 16;
    /// The public key of a device that its owner has lent on the chain, which knows only its hash: from now on the
    /// session's name is the device's.
    DeviceNotice = 17;
    /// A JSON-RPC request, passed on to the chain.
    Relay = 18;
    /// Records that the session's owner had erased at home, for the gateway to erase its copies.
    Erase = 19;
}

impl Command {
    /// The byte on the wire, from the client.
    pub fn number(self) -> u8 {
        self as u8
    }

    /// From that byte.
    pub fn from_number(number: u8) -> Option<Self> {
        Self::ALL.iter().copied().find(|command| command.number() == number)
    }

    /// Whether a client may send it.
    pub fn is_request(self) -> bool {
        !matches!(self, Self::Event | Self::End | Self::Refuse)
    }

    /// Whether it changes state and is signed by d_C. Uploads carry their records' signatures, an allocation has its
    /// own signatures, a registration is a signed transaction.
    pub fn is_signed(self) -> bool {
        matches!(self, Self::GrantNotice | Self::RevokeNotice | Self::DeviceNotice)
    }

    /// Whether a session without a transport key may use it.
    pub fn is_for_allocation(self) -> bool {
        matches!(self, Self::SystemKeys | Self::KeyAllocation | Self::Register | Self::Ping | Self::Relay)
    }
}

/// Whether a frame is a whole message or a part of one. Parts of one message follow one another.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Part {
    /// The whole message.
    Whole = 0,
    /// The first part: its body begins with the total length of all bodies (4).
    First = 1,
    /// A middle part.
    Middle = 2,
    /// The last part.
    Last = 3,
}

impl Part {
    fn from_code(code: u8) -> Option<Self> {
        [Self::Whole, Self::First, Self::Middle, Self::Last].into_iter().find(|part| *part as u8 == code)
    }

    fn begins(self) -> bool {
        matches!(self, Self::Whole | Self::First)
    }
}

/// A parsed ND2.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Inner<'a> {
    /// Its Command.
    pub command: Command,
    /// Whether it is complete.
    pub part: Part,
    /// The client's number of the request; answers and events repeat it.
    pub request: u32,
    /// From the client: token of the epoch; zeros before registration.
    pub token: Option<Token>,
    /// Of signed Commands.
    pub signature: Option<Signature>,
    /// The rest.
    pub body: &'a [u8],
}

impl<'a> Inner<'a> {
    /// From a client's plaintext.
    ///
    /// # Errors
    /// [`WireError`] if it is not a client's ND2.
    pub fn from_client(text: &'a [u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(text);
        let command = Command::from_number(reader.u8("command")?).filter(|command| command.is_request());
        let command = command.ok_or(WireError::Value("command"))?;
        let (part, request) = part_and_request(&mut reader)?;
        if command.is_signed() && part != Part::Whole {
            return Err(WireError::Value("part"));
        }
        let token = if part.begins() { Some(Token(reader.array("token")?)) } else { None };
        let signed = command.is_signed() && part.begins();
        let signature = if signed { Some(Signature(reader.array("signature")?)) } else { None };
        Ok(Self { command, part, request, token, signature, body: reader.rest() })
    }

    /// From a gateway's plaintext.
    ///
    /// # Errors
    /// [`WireError`] if it is not a gateway's ND2.
    pub fn from_gateway(text: &'a [u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(text);
        let command = reader.u8("command")?.checked_sub(FROM_GATEWAY).and_then(Command::from_number);
        let command = command.ok_or(WireError::Value("command"))?;
        let (part, request) = part_and_request(&mut reader)?;
        Ok(Self { command, part, request, token: None, signature: None, body: reader.rest() })
    }

    /// Its encoding, as a client or the gateway writes it.
    pub fn encode(&self, from_gateway: bool) -> Vec<u8> {
        let mut out = Vec::with_capacity(128 + self.body.len());
        out.push(self.command.number() + if from_gateway { FROM_GATEWAY } else { 0 });
        out.push(self.part as u8);
        out.extend_from_slice(&self.request.to_be_bytes());
        out.extend_from_slice(self.token.as_ref().map_or(&[][..], Token::as_bytes));
        out.extend_from_slice(self.signature.as_ref().map_or(&[][..], Signature::as_bytes));
        out.extend_from_slice(self.body);
        out
    }
}

fn part_and_request(reader: &mut Reader<'_>) -> Result<(Part, u32), WireError> {
    let part = Part::from_code(reader.u8("part")?).ok_or(WireError::Value("part"))?;
    Ok((part, reader.u32("request")?))
}

/// The sender, and the fields before the body.
#[derive(Debug, Clone, Copy)]
pub enum Speaker {
    /// A client, with its token.
    Client(Token),
    /// The gateway.
    Gateway,
}

/// The ND2s of an unsigned message, in the order to send them.
pub fn split(command: Command, request: u32, speaker: Speaker, body: &[u8]) -> Vec<Vec<u8>> {
    let (token, from_gateway) = match speaker {
        Speaker::Client(token) => (Some(token), false),
        Speaker::Gateway => (None, true),
    };
    let inner = |part, token, body| Inner { command, part, request, token, signature: None, body };
    if body.len() <= LARGEST_PART {
        return vec![inner(Part::Whole, token, body).encode(from_gateway)];
    }
    let total = u32::try_from(body.len()).unwrap_or(u32::MAX).to_be_bytes();
    let (first, rest) = body.split_at(LARGEST_PART - total.len());
    let first = [&total[..], first].concat();
    let mut out = vec![inner(Part::First, token, &first).encode(from_gateway)];
    let count = rest.len().div_ceil(LARGEST_PART);
    for (index, chunk) in rest.chunks(LARGEST_PART).enumerate() {
        let part = if index + 1 == count { Part::Last } else { Part::Middle };
        out.push(inner(part, None, chunk).encode(from_gateway));
    }
    out
}

/// The bytes d_C signs for a signed Command: label || domain || gateway || session || counter || Command || SM3(body).
pub fn signed_bytes(
    domain: &Domain,
    gateway: &SignerId,
    session: &SessionId,
    counter: u64,
    command: Command,
    body: &Digest,
) -> Vec<u8> {
    let counter = counter.to_be_bytes();
    let parts: [&[u8]; 7] =
        [b"AuthROS/command/1", &domain.0, &gateway.0, &session.0, &counter, &[command.number()], &body.0];
    parts.concat()
}

#[cfg(test)]
mod tests;

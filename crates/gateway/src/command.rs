//! ND2: what one frame asks or answers. From the client: Command (1) || part (1) || request (4) || token (32) ||
//! signature (64, of signed Commands only) || body. From the gateway: Command + 128 (1) || part (1) ||
//! request (4) || body. Later parts of a message carry no token and no signature.

use crate::model::wire::{Reader, WireError};
use crate::model::{Digest, Domain, Signature, SignerId, Token};

use super::session::{LONGEST_TEXT, SessionId};

pub mod answer;
pub mod query;
pub mod relay;
pub mod request;

pub use answer::{Answer, Fetched, Standing};
pub use query::{Entry, Page, Query, Selection};
pub use relay::{RelayCall, Relayed};
pub use request::{DeviceNotice, GrantNotice, Registration, Request, RevokeNotice, Upload};

/// The largest message, in parts or whole, bytes of body: a record of 64 MiB with its head and header.
pub const LARGEST_MESSAGE: usize = 64 * 1024 * 1024 + 128 * 1024;
/// The largest body of one frame, bytes: the same in both directions and for every Command.
pub const LARGEST_PART: usize = LONGEST_TEXT - 128;
/// Added to a Command's number in what the gateway sends.
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
    /// A signed transaction that registers an identity, to be passed to the chain.
    Register = 3;
    /// One record.
    Upload = 4;
    /// Several records.
    UploadMany = 5;
    /// List of records by owner, topic, type, time, tag.
    Query = 6;
    /// How digests stand.
    Check = 7;
    /// One record with signature and proof.
    Fetch = 8;
    /// Records as they come.
    Subscribe = 9;
    /// No more of them.
    Unsubscribe = 10;
    /// A grant was sent to the chain.
    GrantNotice = 11;
    /// A revoke was sent to the chain: to be obeyed at once.
    RevokeNotice = 12;
    /// Nothing; the gateway answers its time.
    Ping = 13;
    /// Only from the gateway: a record of a subscription.
    Event = 14;
    /// Only from the gateway: a subscription has ended.
    End = 15;
    /// Only from the gateway: a refusal.
    Refuse = 16;
    /// The public key of a device that its owner has lent on the chain, which knows only its hash: the session's name
    /// is the device's from now on.
    DeviceNotice = 17;
    /// A JSON-RPC request, passed on to the chain.
    Relay = 18;
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

    /// Whether it changes state and is signed by d_C. Uploads carry their records' signatures, an allocation
    /// has its own, a registration is a signed transaction.
    pub fn is_signed(self) -> bool {
        matches!(self, Self::GrantNotice | Self::RevokeNotice | Self::DeviceNotice)
    }

    /// Whether a session without a transport key may use it.
    pub fn is_for_allocation(self) -> bool {
        matches!(self, Self::SystemKeys | Self::KeyAllocation | Self::Register | Self::Ping | Self::Relay)
    }
}

/// Whether a frame is a whole message or a part of one. Parts of one message follow each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Part {
    /// All of it.
    Whole = 0,
    /// The first: its body begins with the length of all bodies together (4).
    First = 1,
    /// One in between.
    Middle = 2,
    /// The last.
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

/// An ND2, read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Inner<'a> {
    /// What it is.
    pub command: Command,
    /// Whether it is all.
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
    /// From a client's text.
    ///
    /// # Errors
    /// [`WireError`] where it is no ND2 of a client.
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

    /// From a gateway's text.
    ///
    /// # Errors
    /// [`WireError`] where it is no ND2 of a gateway.
    pub fn from_gateway(text: &'a [u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(text);
        let command = reader.u8("command")?.checked_sub(FROM_GATEWAY).and_then(Command::from_number);
        let command = command.ok_or(WireError::Value("command"))?;
        let (part, request) = part_and_request(&mut reader)?;
        Ok(Self { command, part, request, token: None, signature: None, body: reader.rest() })
    }

    /// Its bytes, as a client or the gateway writes them.
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

/// Who speaks, and what stands before the body.
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

/// What d_C signs of a signed Command: label || domain || gateway || session || counter || Command || SM3(body).
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

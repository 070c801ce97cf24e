//! ND2: the request or answer in one frame, laid out in PROTOCOL.md. Only the first part has token and signature.

pub mod messages;

pub use messages::{
    Answer, DeviceNotice, Fetched, Found, GrantNotice, Notice, RelayCall, Relayed, Request, RevokeNotice, Upload,
};

use crate::crypto::{AccountSignature, ErasedStatement};
use crate::model::wire::{Reader, Wire, WireError, put_list, read_list};
use crate::model::{Address, Digest, Domain, Header, Signature, SignerId, Token, layout};
use crate::session::{LONGEST_TEXT, SessionId};

/// In bytes of body, over all parts: a record of 64 MiB with head and header.
pub const LARGEST_MESSAGE: usize = 64 * 1024 * 1024 + 128 * 1024;
/// Of one frame, in bytes, for both directions and every Command.
pub const LARGEST_PART: usize = LONGEST_TEXT - 128;
const FROM_GATEWAY: u8 = 128;

numbered! {
    Command {
        SystemKeys = 1,
        /// K_T to the gateway; binds N to an account.
        KeyAllocation = 2,
        Upload = 4,
        UploadMany = 5,
        Feed = 6,
        Records = 7,
        GrantNotice = 11,
        /// Takes effect immediately.
        RevokeNotice = 12,
        /// Answered with the gateway's time.
        Ping = 13,
        /// Only from the gateway.
        Refuse = 16,
        /// Gives the session's name to a device lent on the chain, which has only the key's hash.
        DeviceNotice = 17,
        Relay = 18,
        /// Erases copies of records that the session's owner had erased.
        Erase = 19,
    }

    /// Parts of one message are consecutive.
    Part {
        Whole = 0,
        /// Its body begins with the total length of all bodies (4).
        First = 1,
        Middle = 2,
        Last = 3,
    }

    /// One byte.
    ErasureOutcome {
        /// No change; the owner may try again.
        Left = 0,
        /// Gone, or overwritten once no incident there holds it.
        Taken = 1,
        /// The notice does not hold.
        Refused = 2,
    }
}

layout!(ErasureOutcome by number, from_number);

impl Command {
    pub fn is_request(self) -> bool {
        !matches!(self, Self::Refuse)
    }

    /// By d_C. Uploads and allocations have signatures of their own.
    pub fn is_signed(self) -> bool {
        matches!(self, Self::GrantNotice | Self::RevokeNotice | Self::DeviceNotice)
    }

    /// Allowed without a transport key.
    pub fn is_for_allocation(self) -> bool {
        matches!(self, Self::SystemKeys | Self::KeyAllocation | Self::Ping | Self::Relay)
    }
}

impl Part {
    fn begins(self) -> bool {
        matches!(self, Self::Whole | Self::First)
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Inner<'a> {
    pub command: Command,
    pub part: Part,
    /// Answers repeat the client's number.
    pub request: u32,
    /// From the client: token of the epoch; zeros before registration.
    pub token: Option<Token>,
    pub signature: Option<Signature>,
    pub body: &'a [u8],
}

impl<'a> Inner<'a> {
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

    pub fn from_gateway(text: &'a [u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(text);
        let command = reader.u8("command")?.checked_sub(FROM_GATEWAY).and_then(Command::from_number);
        let command = command.ok_or(WireError::Value("command"))?;
        let (part, request) = part_and_request(&mut reader)?;
        Ok(Self { command, part, request, token: None, signature: None, body: reader.rest() })
    }

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
    let part = Part::from_number(reader.u8("part")?).ok_or(WireError::Value("part"))?;
    Ok((part, reader.u32("request")?))
}

#[derive(Debug, Clone, Copy)]
pub enum Speaker {
    Client(Token),
    Gateway,
}

/// The ND2s of an unsigned message, in order.
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

/// Signed by d_C: label || domain || gateway || session || counter || Command || SM3(body).
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

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ErasedRecord {
    /// Its blob is the public header alone.
    pub record: Fetched,
    pub statement: ErasedStatement,
}

impl ErasedRecord {
    /// The statement follows the header.
    pub(crate) fn into_fetched(self) -> Fetched {
        let Self { mut record, statement } = self;
        record.blob.extend_from_slice(&statement.encode());
        record
    }

    /// Checks only the form.
    pub(crate) fn from_fetched(mut record: Fetched) -> Result<Self, WireError> {
        let header = record.blob.len().checked_sub(ErasedStatement::LENGTH).ok_or(WireError::Short("statement"))?;
        let statement = ErasedStatement::parse(&record.blob.split_off(header))?;
        Ok(Self { record, statement })
    }
}

pub const MOST_ERASURES: usize = 64;
/// Bytes; header, statement and proof are far shorter.
const LONGEST_ERASURE: usize = 4096;

/// digest (32) || account's signature (65) || header, signature, proof, statement.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ErasureNotice {
    /// D, which nobody can compute any more.
    pub digest: Digest,
    /// EOA signature over what the statement signs.
    pub account_signature: AccountSignature,
    pub left: ErasedRecord,
}

impl ErasureNotice {
    pub fn is_of(&self, owner: Address) -> bool {
        Header::parse(&self.left.record.blob).is_ok_and(|(header, _)| header.owner == owner)
    }

    fn encode(&self) -> Vec<u8> {
        let left = self.left.clone().into_fetched().encode();
        [&self.digest.0[..], &self.account_signature.0, &left].concat()
    }

    fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        let digest = Digest(reader.array("digest")?);
        let account_signature = AccountSignature(reader.array("account's signature")?);
        let left = ErasedRecord::from_fetched(Fetched::read(reader)?)?;
        Ok(Self { digest, account_signature, left })
    }
}

/// Count (2) || each, at most `most`.
fn list(all: &[impl Wire], most: usize) -> Vec<u8> {
    let mut out = Vec::new();
    put_list::<u16>(&mut out, all, most);
    out
}

/// Count (2) || length (4) and erasure each.
fn encode_erasures(erasures: &[ErasureNotice]) -> Vec<u8> {
    list(&erasures.iter().map(ErasureNotice::encode).collect::<Vec<_>>(), MOST_ERASURES)
}

fn read_erasures(reader: &mut Reader<'_>) -> Result<Vec<ErasureNotice>, WireError> {
    let all: Vec<Vec<u8>> = read_list::<u16, _>(reader, 1..=MOST_ERASURES, ("erasure count", "erasure"))?;
    let one = |bytes: &Vec<u8>| {
        if bytes.len() > LONGEST_ERASURE {
            return Err(WireError::Value("erasure length"));
        }
        let mut one = Reader::new(bytes);
        let erasure = ErasureNotice::read(&mut one)?;
        one.end().map(|()| erasure)
    };
    all.iter().map(one).collect()
}

#[cfg(test)]
mod tests;

#[cfg(test)]
mod erased_tests {
    use super::*;
    use crate::model::{Digest, PublicKey, Signature, Timestamp};

    #[test]
    fn header_and_statement_come_apart_as_they_were_put_together() {
        let (signer, signature) = (PublicKey([1; 64]), Signature([2; 64]));
        let record = Fetched { signer, signature, proof: vec![3; 9], blob: vec![4; 300] };
        let statement = ErasedStatement { report: Digest([5; 32]), at: Timestamp(6), signer, signature };
        let erased = ErasedRecord { record, statement };
        let travelling = erased.clone().into_fetched();
        assert_eq!((&travelling.blob[..300], travelling.blob.len()), (&[4u8; 300][..], 300 + 168));
        assert_eq!(ErasedRecord::from_fetched(travelling.clone()), Ok(erased));
        let short = Fetched { blob: vec![4; 167], ..travelling };
        assert_eq!(ErasedRecord::from_fetched(short), Err(WireError::Short("statement")));
    }
}

#[cfg(test)]
mod erasure_tests {
    use super::*;
    use crate::crypto::ErasedStatement;
    use crate::model::{PublicKey, Signature, Timestamp};
    use crate::{Answer, Command, Request};

    fn erasure() -> ErasureNotice {
        let (signer, signature) = (PublicKey([1; 64]), Signature([2; 64]));
        let record = Fetched { signer, signature, proof: vec![3; 9], blob: vec![4; 300] };
        let statement = ErasedStatement { report: Digest([5; 32]), at: Timestamp(6), signer, signature };
        let account_signature = AccountSignature([7; 65]);
        ErasureNotice { digest: Digest([8; 32]), account_signature, left: ErasedRecord { record, statement } }
    }

    fn parse(body: &[u8]) -> Result<Request, WireError> {
        Request::parse(Command::Erase, body)
    }

    #[test]
    fn an_owner_tells_what_was_erased_and_hears_what_becomes_of_each() {
        let request = Request::Erase(vec![erasure(); 2]);
        let body = request.encode();
        assert_eq!((request.command(), parse(&body)), (Command::Erase, Ok(request)));
        // Byte by byte: the count, the length, the digest, the account's signature, then the record.
        let length = 32 + 65 + 64 + 64 + 4 + 9 + 300 + 168;
        assert_eq!(body[..6], [[0, 2].as_slice(), &u32::try_from(length).expect("short").to_be_bytes()].concat());
        assert_eq!((&body[6..38], &body[38..103], &body[103..167]), (&[8; 32][..], &[7; 65][..], &[1; 64][..]));
        assert_eq!(body.len(), 2 + 2 * (4 + length));
        assert!((0..body.len()).all(|cut| parse(&body[..cut]).is_err()));
        assert!(parse(&[&body[..], &[0]].concat()).is_err() && parse(&[0, 0]).is_err());

        let all = vec![ErasureOutcome::Left, ErasureOutcome::Taken, ErasureOutcome::Refused];
        let (answer, parse) = (Answer::Erasures(all), |body: &[u8]| Answer::parse(Command::Erase, body));
        assert_eq!(answer.encode(), [0, 3, 0, 1, 2]);
        assert_eq!(parse(&answer.encode()), Ok(answer));
        for lie in [&[0, 1, 3][..], &[0, 2, 1], &[0, 1, 1, 1], &[0, 65], &[0xff, 0xff]] {
            assert!(parse(lie).is_err(), "{lie:?}");
        }
    }

    #[test]
    fn counts_and_lengths_are_bounded_before_anything_is_kept() {
        let many = u16::try_from(MOST_ERASURES + 1).expect("few").to_be_bytes();
        assert!(parse(&[&many[..], &vec![0; 70_000]].concat()).is_err());
        for length in [u32::MAX, 4097, 0, 300] {
            assert!(parse(&[&[0, 1][..], &length.to_be_bytes(), &[0; 9000]].concat()).is_err(), "{length}");
        }
        let mut long = erasure();
        long.left.record.blob = vec![4; LONGEST_ERASURE];
        assert!(parse(&Request::Erase(vec![long]).encode()).is_err());
        assert!(parse(&[0xff; 60]).is_err());
    }
}

//! What gateways of one fleet tell each other of records that their owners had erased, and what an owner tells the gateways that
//! her home joins: what a reader would get of each, and the signature of the owner's account, without which nobody erases a
//! copy.

use crate::crypto::AccountSignature;
use crate::model::wire::{Reader, WireError};
use crate::model::{Address, Digest, Header, RecorderId};

use super::answer::Fetched;
use super::erased::ErasedRecord;

/// The most records told at a time.
pub const MOST_ERASURES: usize = 64;
/// The longest of them, bytes: header, statement and proof are far shorter.
const LONGEST_ERASURE: usize = 4096;
/// A bit in the count: the answer is about what was erased.
pub(super) const OF_ERASURES: u16 = 1 << 15;
/// Bits in the count: the answer is about what becomes of records that were told.
pub(super) const OF_OUTCOMES: u16 = 0b11 << 14;
/// Behind the place in a request for holdings: what was erased is asked for.
pub(super) const ERASED: u8 = 1;
/// Behind a place of zeros: what the sender had erased is told.
pub(super) const TELLS: u8 = 2;

/// A place among what was erased: ledger (16) || number (8). Numbers are a ledger's own, so a place of another ledger, as
/// before a restore, is no place; zeros are the beginning.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ErasurePlace {
    /// The id of the gateway's ledger.
    pub ledger: RecorderId,
    /// What was noted there after this number comes next.
    pub number: u64,
}

impl Default for ErasurePlace {
    fn default() -> Self {
        Self { ledger: RecorderId([0; 16]), number: 0 }
    }
}

impl ErasurePlace {
    pub(super) fn encode(&self) -> Vec<u8> {
        [&self.ledger.0[..], &self.number.to_be_bytes()].concat()
    }

    pub(super) fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        Ok(Self { ledger: RecorderId(reader.array("ledger")?), number: reader.u64("number")? })
    }
}

/// A record that its owner had erased everywhere: digest (32) || account's signature (65) || what is left of it, as an
/// answer to Fetch.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ToldErasure {
    /// D, which nobody can compute any more.
    pub digest: Digest,
    /// The owner's EOA signature over the same as the statement.
    pub account_signature: AccountSignature,
    /// Header, signature, proof, statement.
    pub left: ErasedRecord,
}

impl ToldErasure {
    /// Whether its header names this owner.
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

/// A part of what was erased: count (2, the highest bit set) || length (4) and record each || next place (24) || whether
/// there is more (1).
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Erasures {
    /// At most [`MOST_ERASURES`].
    pub told: Vec<ToldErasure>,
    /// Where the next part begins.
    pub next: ErasurePlace,
    /// Whether there is one now.
    pub more: bool,
}

impl Erasures {
    pub(super) fn encode(&self) -> Vec<u8> {
        let mut out = encode_told(&self.told, OF_ERASURES);
        out.extend_from_slice(&self.next.encode());
        out.push(u8::from(self.more));
        out
    }

    pub(super) fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        let told = read_told(reader, OF_ERASURES)?;
        let next = ErasurePlace::read(reader)?;
        let more = match reader.u8("more")? {
            0 => false,
            1 => true,
            _ => return Err(WireError::Value("more")),
        };
        Ok(Self { told, next, more })
    }
}

/// Count (2, with these bits set) || length (4) and record each; what is too much is cut.
pub(super) fn encode_told(told: &[ToldErasure], bits: u16) -> Vec<u8> {
    let told = &told[..told.len().min(MOST_ERASURES)];
    let count = u16::try_from(told.len()).unwrap_or(0) | bits;
    let mut out = count.to_be_bytes().to_vec();
    for one in told {
        let bytes = one.encode();
        out.extend_from_slice(&u32::try_from(bytes.len()).unwrap_or(u32::MAX).to_be_bytes());
        out.extend_from_slice(&bytes);
    }
    out
}

pub(super) fn read_told(reader: &mut Reader<'_>, bits: u16) -> Result<Vec<ToldErasure>, WireError> {
    let count = usize::from(reader.u16("erasure count")? & !bits);
    if count > MOST_ERASURES {
        return Err(WireError::Value("erasure count"));
    }
    let mut told = Vec::with_capacity(count);
    for _ in 0..count {
        let length = usize::try_from(reader.u32("erasure length")?).unwrap_or(usize::MAX);
        if length > LONGEST_ERASURE {
            return Err(WireError::Value("erasure length"));
        }
        let mut one = Reader::new(reader.take(length, "erasure")?);
        told.push(ToldErasure::read(&mut one)?);
        one.end()?;
    }
    Ok(told)
}

/// What becomes of a copy at a gateway at its owner's word (1).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum ErasureOutcome {
    /// Nothing now; it may be told again later.
    Left = 0,
    /// It is gone, or is being overwritten as soon as no incident of its owner there holds it.
    Taken = 1,
    /// Nothing: what was told does not hold.
    Refused = 2,
}

impl ErasureOutcome {
    fn from_code(code: u8) -> Option<Self> {
        [Self::Left, Self::Taken, Self::Refused].into_iter().find(|outcome| *outcome as u8 == code)
    }

    /// Count (2, the two highest bits set) || outcome (1) each.
    pub(super) fn encode_all(outcomes: &[Self]) -> Vec<u8> {
        let outcomes = &outcomes[..outcomes.len().min(MOST_ERASURES)];
        let count = u16::try_from(outcomes.len()).unwrap_or(0) | OF_OUTCOMES;
        count.to_be_bytes().into_iter().chain(outcomes.iter().map(|outcome| *outcome as u8)).collect()
    }

    pub(super) fn read_all(reader: &mut Reader<'_>) -> Result<Vec<Self>, WireError> {
        let count = usize::from(reader.u16("outcome count")? & !OF_OUTCOMES);
        if count > MOST_ERASURES {
            return Err(WireError::Value("outcome count"));
        }
        let codes = reader.take(count, "outcome")?;
        codes.iter().map(|code| Self::from_code(*code).ok_or(WireError::Value("outcome"))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crypto::ErasedStatement;
    use crate::gateway::{Answer, Command, HoldingPlace, Request};
    use crate::model::{PublicKey, Signature, Timestamp};

    fn told() -> ToldErasure {
        let (signer, signature) = (PublicKey([1; 64]), Signature([2; 64]));
        let record = Fetched { signer, signature, proof: vec![3; 9], blob: vec![4; 300] };
        let statement = ErasedStatement { report: Digest([5; 32]), at: Timestamp(6), signer, signature };
        let account_signature = AccountSignature([7; 65]);
        ToldErasure { digest: Digest([8; 32]), account_signature, left: ErasedRecord { record, statement } }
    }

    fn parse(body: &[u8]) -> Result<Answer, WireError> {
        Answer::parse(Command::Holdings, body)
    }

    #[test]
    fn what_was_erased_travels_as_an_answer_of_its_own() {
        let next = ErasurePlace { ledger: RecorderId([9; 16]), number: 10 };
        let answer = Answer::Erasures(Box::new(Erasures { told: vec![told(); 2], next, more: true }));
        let body = answer.encode();
        assert_eq!(parse(&body), Ok(answer));
        // Byte by byte: the count with its bit, the length, the digest, the account's signature, then the record.
        let length = 32 + 65 + 64 + 64 + 4 + 9 + 300 + 168;
        assert_eq!(body[..6], [[0x80, 2].as_slice(), &u32::try_from(length).expect("short").to_be_bytes()].concat());
        assert_eq!((&body[6..38], &body[38..103], &body[103..167]), (&[8; 32][..], &[7; 65][..], &[1; 64][..]));
        assert_eq!(body.len(), 2 + 2 * (4 + length) + 24 + 1);
        assert_eq!(body[body.len() - 25..], [&[9; 16][..], &10u64.to_be_bytes(), &[1]].concat());
        assert!((0..body.len()).all(|cut| parse(&body[..cut]).is_err()));
        let none = Answer::Erasures(Box::default());
        assert_eq!(parse(&none.encode()), Ok(none));
    }

    #[test]
    fn counts_and_lengths_are_bounded_before_anything_is_kept() {
        let many = (u16::try_from(MOST_ERASURES + 1).expect("few") | OF_ERASURES).to_be_bytes();
        assert!(parse(&[&many[..], &vec![0; 70_000]].concat()).is_err());
        let one = (1 | OF_ERASURES).to_be_bytes();
        for length in [u32::MAX, 4097, 0, 300] {
            assert!(parse(&[&one[..], &length.to_be_bytes(), &[0; 9000]].concat()).is_err(), "{length}");
        }
        let mut long = told();
        long.left.record.blob = vec![4; LONGEST_ERASURE];
        assert!(parse(&Erasures { told: vec![long], ..Erasures::default() }.encode()).is_err());
        assert!(parse(&[0xff; 60]).is_err());
    }

    #[test]
    fn an_earlier_gateway_takes_the_request_for_no_message() {
        let place = ErasurePlace { ledger: RecorderId([9; 16]), number: 10 };
        let request = Request::Erasures(place);
        let body = request.encode();
        assert_eq!((request.command(), body.len(), body[24]), (Command::Holdings, 25, 1));
        assert_eq!(Request::parse(Command::Holdings, &body), Ok(request));
        let holdings = Request::Holdings(HoldingPlace { block: 1, batch: 2, leaf: 3 });
        assert_eq!(Request::parse(Command::Holdings, &holdings.encode()), Ok(holdings));
        // What an earlier one does with it: it reads a place, and something is left.
        let mut reader = Reader::new(&body);
        HoldingPlace::read(&mut reader).expect("a place");
        assert!(reader.end().is_err());
        for lie in [&body[..24].iter().chain(&[2]).copied().collect::<Vec<u8>>(), &[body.clone(), vec![0]].concat()] {
            assert!(Request::parse(Command::Holdings, lie).is_err());
        }
    }

    #[test]
    fn an_owner_tells_in_the_same_form_and_hears_what_becomes_of_each() {
        let request = Request::TellErasures(vec![told(); 2]);
        let body = request.encode();
        assert_eq!((&body[..24], body[24], &body[25..27]), (&[0; 24][..], 2, &[0, 2][..]));
        let asked = Answer::Erasures(Box::new(Erasures { told: vec![told(); 2], ..Erasures::default() })).encode();
        assert_eq!(body[27..], asked[2..asked.len() - 25], "as an answer has it, without a place");
        assert_eq!(Request::parse(Command::Holdings, &body), Ok(request.clone()));
        assert_eq!(request.command(), Command::Holdings);
        assert!((25..body.len()).all(|cut| Request::parse(Command::Holdings, &body[..cut]).is_err()));
        let mut elsewhere = body.clone();
        elsewhere[3] = 1;
        let none = [&[0; 24][..], &[2, 0, 0]].concat();
        for lie in [elsewhere, [&body[..], &[0]].concat(), none] {
            assert!(Request::parse(Command::Holdings, &lie).is_err());
        }

        let all = vec![ErasureOutcome::Left, ErasureOutcome::Taken, ErasureOutcome::Refused];
        let answer = Answer::ErasuresTaken(all);
        assert_eq!(answer.encode(), [0xc0, 3, 0, 1, 2]);
        assert_eq!(parse(&answer.encode()), Ok(answer));
        for lie in [&[0xc0, 1, 3][..], &[0xc0, 2, 1], &[0xc0, 1, 1, 1], &[0xc0, 65], &[0xff, 0xff]] {
            assert!(parse(lie).is_err(), "{lie:?}");
        }
    }
}

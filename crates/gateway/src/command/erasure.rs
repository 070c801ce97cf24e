//! What an owner tells the gateway that her home joins of records that she had erased: what a reader would get of each, and
//! the signature of her account, without which no copy is erased.

use crate::crypto::AccountSignature;
use crate::model::wire::{Reader, WireError};
use crate::model::{Address, Digest, Header};

use super::answer::Fetched;
use super::erased::ErasedRecord;

/// The most records told at a time.
pub const MOST_ERASURES: usize = 64;
/// The longest of them, bytes: header, statement and proof are far shorter.
const LONGEST_ERASURE: usize = 4096;

/// A record that its owner had erased: digest (32) || account's signature (65) || what is left of it, as an answer to
/// Fetch.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ErasureNotice {
    /// D, which nobody can compute any more.
    pub digest: Digest,
    /// The owner's EOA signature over the same as the statement.
    pub account_signature: AccountSignature,
    /// Header, signature, proof, statement.
    pub left: ErasedRecord,
}

impl ErasureNotice {
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

/// Count (2) || length (4) and erasure each; what is too much is cut.
pub(super) fn encode_erasures(erasures: &[ErasureNotice]) -> Vec<u8> {
    let erasures = &erasures[..erasures.len().min(MOST_ERASURES)];
    let mut out = u16::try_from(erasures.len()).unwrap_or(0).to_be_bytes().to_vec();
    for one in erasures {
        let bytes = one.encode();
        out.extend_from_slice(&u32::try_from(bytes.len()).unwrap_or(u32::MAX).to_be_bytes());
        out.extend_from_slice(&bytes);
    }
    out
}

pub(super) fn read_erasures(reader: &mut Reader<'_>) -> Result<Vec<ErasureNotice>, WireError> {
    let count = usize::from(reader.u16("erasure count")?);
    if !(1..=MOST_ERASURES).contains(&count) {
        return Err(WireError::Value("erasure count"));
    }
    let mut erasures = Vec::with_capacity(count);
    for _ in 0..count {
        let length = usize::try_from(reader.u32("erasure length")?).unwrap_or(usize::MAX);
        if length > LONGEST_ERASURE {
            return Err(WireError::Value("erasure length"));
        }
        let mut one = Reader::new(reader.take(length, "erasure")?);
        erasures.push(ErasureNotice::read(&mut one)?);
        one.end()?;
    }
    Ok(erasures)
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

    /// Count (2) || outcome (1) each.
    pub(super) fn encode_all(outcomes: &[Self]) -> Vec<u8> {
        let outcomes = &outcomes[..outcomes.len().min(MOST_ERASURES)];
        let count = u16::try_from(outcomes.len()).unwrap_or(0);
        count.to_be_bytes().into_iter().chain(outcomes.iter().map(|outcome| *outcome as u8)).collect()
    }

    pub(super) fn read_all(reader: &mut Reader<'_>) -> Result<Vec<Self>, WireError> {
        let count = usize::from(reader.u16("outcome count")?);
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
    use crate::gateway::{Answer, Command, Request};
    use crate::model::{PublicKey, Signature, Timestamp};

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

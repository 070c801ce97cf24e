//! What a reader gets of a record that its owner had erased: all but its message, and the owner's word.

use crate::crypto::ErasedStatement;
use crate::model::wire::WireError;

use super::answer::Fetched;

/// A record as sent to a reader, with the public header in place of the record, and the owner's statement.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ErasedRecord {
    /// Signer, signature and proof as of any record; its blob is the public header alone.
    pub record: Fetched,
    /// What the owner states.
    pub statement: ErasedStatement,
}

impl ErasedRecord {
    /// As it travels: the statement behind the header.
    pub(crate) fn into_fetched(self) -> Fetched {
        let Self { mut record, statement } = self;
        record.blob.extend_from_slice(&statement.encode());
        record
    }

    /// From what travelled; only the form is checked.
    pub(crate) fn from_fetched(mut record: Fetched) -> Result<Self, WireError> {
        let header = record.blob.len().checked_sub(ErasedStatement::LENGTH).ok_or(WireError::Short("statement"))?;
        let statement = ErasedStatement::parse(&record.blob.split_off(header))?;
        Ok(Self { record, statement })
    }
}

#[cfg(test)]
mod tests {
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

//! An owner's statement that a record was erased. Signed by d_C, so no gateway can state it of a record that it
//! withholds; where others are to erase copies, the account signs, too: a thief with one of the keys destroys nothing.

use crate::model::{Digest, Header, PublicKey, Signature, Timestamp, body, layout};

use super::identity::check_account;
use super::{AccountSignature, CryptoError, EoaSecret, Provider, Result, SmKeyPair, TypedStructure, sign_hash};

const LABEL: &[u8] = b"AuthROS/erased/1";
/// The EIP-712 type that the account signs.
const TYPE: &str = "Erasure(address owner,bytes32 record,bytes32 header,bytes32 report,uint64 time)";
const WHAT: &str = "statement of an erased record";

/// `report (32) || time (8) || P_C (64) || signature (64)`, big endian. The signature is SM2 over
/// `"AuthROS/erased/1" || domain || owner || digest || SM3(public header) || report || time`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ErasedStatement {
    /// The digest of the retention record that names the record.
    pub report: Digest,
    /// When it was decided, by the owner's clock.
    pub at: Timestamp,
    /// The key that signed this. Whether it is the owner's is for a reader of the chain to see.
    pub signer: PublicKey,
    /// (r, s).
    pub signature: Signature,
}

layout!(ErasedStatement { report: "retention record", at: "time", signer: "signer", signature: "signature" });
body!(ErasedStatement);

impl ErasedStatement {
    /// Length of its encoding, bytes.
    pub const LENGTH: usize = 32 + 8 + 64 + 64;

    /// States that the record with this digest and public header was erased.
    /// # Errors
    /// [`CryptoError::DamagedRecord`] if the header is none, errors of signing.
    pub fn sign(
        provider: &dyn Provider,
        signing: &SmKeyPair,
        (digest, header): (&Digest, &[u8]),
        (report, at): (Digest, Timestamp),
    ) -> Result<Self> {
        let text = signed_text(provider, (digest, header), (&report, at))?;
        let signature = provider.sign(&signing.secret, &text)?;
        Ok(Self { report, at, signer: signing.public, signature })
    }

    /// Whether its key signed it for the record with this digest and public header.
    /// # Errors
    /// [`CryptoError::DamagedRecord`] or [`CryptoError::NotAccepted`].
    pub fn check(&self, provider: &dyn Provider, digest: &Digest, header: &[u8]) -> Result<()> {
        let text = signed_text(provider, (digest, header), (&self.report, self.at))?;
        let verified = provider.verify(&self.signer, &text, &self.signature);
        verified.map_err(|_| CryptoError::NotAccepted { what: WHAT, field: "signature" })
    }

    /// The same by the owner's account, for others with a copy. It names no SM2 key, so it outlasts a change of that.
    /// # Errors
    /// [`CryptoError::DamagedRecord`] if the header is none, [`CryptoError::Internal`].
    pub fn sign_by_account(
        &self,
        provider: &dyn Provider,
        account: &EoaSecret,
        about: (&Digest, &[u8]),
    ) -> Result<AccountSignature> {
        sign_hash(account, &self.account_hash(provider, about)?)
    }

    /// Whether the account of the header's owner signed it for the record with this digest and public header.
    /// # Errors
    /// [`CryptoError::DamagedRecord`] or [`CryptoError::NotAccepted`].
    pub fn check_account(
        &self,
        provider: &dyn Provider,
        signature: &AccountSignature,
        about: (&Digest, &[u8]),
    ) -> Result<()> {
        let (header, _) = Header::parse(about.1).map_err(CryptoError::DamagedRecord)?;
        check_account(&self.account_hash(provider, about)?, signature, &header.owner, WHAT)
    }

    fn account_hash(&self, provider: &dyn Provider, (digest, header): (&Digest, &[u8])) -> Result<[u8; 32]> {
        let (parsed, _) = Header::parse(header).map_err(CryptoError::DamagedRecord)?;
        let structure = TypedStructure::new(TYPE).address(&parsed.owner).word(&digest.0);
        let structure = structure.word(&provider.sm3(&[header])).word(&self.report.0).number(self.at.0);
        Ok(structure.signing_hash(&parsed.domain))
    }
}

fn signed_text(
    provider: &dyn Provider,
    (digest, header): (&Digest, &[u8]),
    (report, at): (&Digest, Timestamp),
) -> Result<Vec<u8>> {
    let (parsed, _) = Header::parse(header).map_err(CryptoError::DamagedRecord)?;
    let hashed = provider.sm3(&[header]);
    let time = at.0.to_be_bytes();
    let parts: [&[u8]; 7] = [LABEL, &parsed.domain.0, &parsed.owner.0, &digest.0, &hashed, &report.0, &time];
    Ok(parts.concat())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{Address, Commit, Domain, RecordKind, RecorderPrefix, Salt, SignerId, TopicId};
    use crate::{ProviderName, provider, recover_account};

    fn header(seq: u64) -> Vec<u8> {
        header_of(seq, Address([2; 20]), Domain([1; 32]))
    }

    fn header_of(seq: u64, owner: Address, domain: Domain) -> Vec<u8> {
        let header = Header {
            kind: RecordKind::Data,
            domain,
            owner,
            signer: SignerId([3; 32]),
            epoch: 1,
            recorder: RecorderPrefix::ledger([4; 7]).of_signer(&SignerId([3; 32])),
            seq,
            topic_id: TopicId([5; 16]),
            filters: Vec::new(),
            captured_at: Timestamp(6),
            head_length: 40,
            body_length: 30,
            salt: Salt([7; 24]),
            commit: Commit([8; 32]),
        };
        header.encode()
    }

    #[test]
    fn it_holds_for_one_record_as_its_owner_wrote_it_and_for_nothing_else() {
        let provider = provider(ProviderName::default());
        let pair = || SmKeyPair::generate(provider).expect("a pair");
        let (owner, other) = (pair(), pair());
        let (digest, header_of) = (Digest([9; 32]), header(1));
        let about = (&digest, header_of.as_slice());
        let stated = ErasedStatement::sign(provider, &owner, about, (Digest([10; 32]), Timestamp(11))).expect("signs");
        let bytes = stated.encode();
        assert_eq!((bytes.len(), ErasedStatement::parse(&bytes)), (ErasedStatement::LENGTH, Ok(stated)));
        assert!((0..bytes.len()).all(|cut| ErasedStatement::parse(&bytes[..cut]).is_err()));
        assert!(ErasedStatement::parse(&[bytes, vec![0]].concat()).is_err());
        stated.check(provider, &digest, &header_of).expect("it holds");
        // The text that is signed, put together by hand.
        let hashed = provider.sm3(&[&header_of]);
        let text =
            [&b"AuthROS/erased/1"[..], &[1; 32], &[2; 20], &[9; 32], &hashed, &[10; 32], &11u64.to_be_bytes()].concat();
        provider.verify(&owner.public, &text, &stated.signature).expect("signed");
        let lies = [
            stated.check(provider, &Digest([8; 32]), &header_of),
            stated.check(provider, &digest, &header(2)),
            ErasedStatement { at: Timestamp(12), ..stated }.check(provider, &digest, &header_of),
            ErasedStatement { report: Digest([1; 32]), ..stated }.check(provider, &digest, &header_of),
            ErasedStatement { signer: other.public, ..stated }.check(provider, &digest, &header_of),
        ];
        for lie in lies {
            assert!(matches!(lie, Err(CryptoError::NotAccepted { .. })), "{lie:?}");
        }
        assert!(matches!(stated.check(provider, &digest, b"none"), Err(CryptoError::DamagedRecord(_))));
    }

    #[test]
    fn only_the_owners_account_has_copies_erased_elsewhere() {
        let provider = provider(ProviderName::default());
        let (account, thief) = (EoaSecret::generate().expect("generates"), EoaSecret::generate().expect("generates"));
        let pair = SmKeyPair::generate(provider).expect("a pair");
        let of = |seq, domain| header_of(seq, account.address(), Domain([domain; 32]));
        let (digest, header, strangers) = (Digest([9; 32]), of(1, 1), header(1));
        let about = (&digest, header.as_slice());
        let stated = ErasedStatement::sign(provider, &pair, about, (Digest([10; 32]), Timestamp(11))).expect("signs");
        let signature = stated.sign_by_account(provider, &account, about).expect("signs");
        stated.check_account(provider, &signature, about).expect("it holds");
        // The hash that is signed, put together by hand.
        let structure =
            TypedStructure::new("Erasure(address owner,bytes32 record,bytes32 header,bytes32 report,uint64 time)");
        let structure = structure.address(&account.address()).word(&[9; 32]).word(&provider.sm3(&[&header]));
        let hash = structure.word(&[10; 32]).number(11).signing_hash(&Domain([1; 32]));
        assert_eq!(recover_account(&hash, &signature).ok(), Some(account.address()));
        let by_another_key = ErasedStatement { signer: PublicKey([1; 64]), ..stated };
        by_another_key.check_account(provider, &signature, about).expect("it outlasts a change of the SM2 key");

        let by_thief = stated.sign_by_account(provider, &thief, about).expect("signs");
        let other = Digest([8; 32]);
        let mut altered = signature;
        altered.0[40] ^= 1;
        let lies = [
            ("another account's", stated.check_account(provider, &by_thief, about)),
            ("of another record", stated.check_account(provider, &signature, (&other, &header))),
            ("of another header", stated.check_account(provider, &signature, (&digest, &of(2, 1)))),
            ("of another chain", stated.check_account(provider, &signature, (&digest, &of(1, 2)))),
            ("of another owner's", stated.check_account(provider, &signature, (&digest, &strangers))),
            (
                "of another time",
                ErasedStatement { at: Timestamp(12), ..stated }.check_account(provider, &signature, about),
            ),
            (
                "of another report",
                ErasedStatement { report: Digest([1; 32]), ..stated }.check_account(provider, &signature, about),
            ),
            ("altered", stated.check_account(provider, &altered, about)),
            ("nothing", stated.check_account(provider, &AccountSignature([0; 65]), about)),
        ];
        for (what, lie) in lies {
            assert!(matches!(lie, Err(CryptoError::NotAccepted { .. })), "{what}: {lie:?}");
        }
    }
}

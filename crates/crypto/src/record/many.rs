//! Checks several records at once: the digests of short ones side by side in the lanes of SM3, the signatures on
//! several cores. The results are those of [`check`](super::check) for each record.

use crate::crypto::kernel::LONG;
use crate::crypto::pool::{each, helpers_for};
use crate::crypto::{CryptoError, Provider};
use crate::model::{Digest, Header, PublicKey, Signature, Verdict};

use super::opening::{Anchor, checked};

/// One record to check.
#[derive(Debug, Clone, Copy)]
pub struct Unchecked<'a> {
    /// Its stored bytes.
    pub blob: &'a [u8],
    /// Its signature.
    pub signature: &'a Signature,
    /// Who should have signed it.
    pub signer: &'a PublicKey,
    /// What the chain says about it.
    pub anchor: Anchor,
}

/// The result of checking a record.
pub type Checked = Result<(Header, Digest, Verdict), CryptoError>;

/// Checks each record like [`check`](super::check), in order, on as many cores as is worthwhile.
pub fn check_many(provider: &dyn Provider, records: &[Unchecked<'_>]) -> Vec<Checked> {
    let bytes = records.iter().map(|record| record.blob.len()).sum();
    check_by(provider, records, helpers_for(records.len(), bytes))
}

/// Like [`check_many`], on the caller's core alone: for callers that already have a thread for each core.
pub fn check_alone(provider: &dyn Provider, records: &[Unchecked<'_>]) -> Vec<Checked> {
    check_by(provider, records, 0)
}

fn check_by(provider: &dyn Provider, records: &[Unchecked<'_>], helpers: usize) -> Vec<Checked> {
    let short: Vec<&[u8]> = records.iter().map(|record| record.blob).filter(|blob| blob.len() < LONG).collect();
    let mut digests = provider.sm3_many(&short).into_iter().map(Digest);
    let hashed: Vec<_> =
        records.iter().map(|record| (record, if record.blob.len() < LONG { digests.next() } else { None })).collect();
    each(&hashed, helpers, |(record, digest)| {
        let digest_of = |blob: &[u8]| digest.unwrap_or_else(|| Digest(provider.sm3(&[blob])));
        let Unchecked { blob, signature, signer, anchor } = **record;
        let (parts, digest, verdict) = checked(provider, blob, signature, signer, anchor, digest_of, &mut |_| ())?;
        Ok((parts.header, digest, verdict))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crypto::record::tests::Sample;
    use crate::crypto::record::{SealedRecord, check};
    use crate::crypto::{ProviderName, SmKeyPair, provider};

    /// Records of many lengths, with each kind of damage among them.
    fn records(name: ProviderName) -> Vec<SealedRecord> {
        let lengths = [0, 1, 100, 700, 1024, 3000, 9000, LONG - 1, LONG, 40_000, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];
        let mut records: Vec<_> = lengths.iter().map(|length| Sample::new(name, &vec![7; *length]).seal()).collect();
        records[2].blob[0] ^= 1;
        records[4].blob.truncate(50);
        records[6].signature.0[10] ^= 1;
        records[9].blob[30_000] ^= 1;
        let last = records[12].blob.len() - 1;
        records[12].blob[last] ^= 1;
        records[14].digest.0[0] ^= 1;
        records
    }

    #[test]
    fn many_are_checked_as_each_by_itself() {
        for name in ProviderName::ALL {
            let (provider, records) = (provider(name), records(name));
            let own = Sample::new(name, b"").request().signer.public;
            let other = SmKeyPair::generate(provider).expect("pair").public;
            let anchor =
                |at: usize, digest| if at.is_multiple_of(5) { Anchor::Unanchored } else { Anchor::Chain(digest) };
            let all: Vec<_> = records
                .iter()
                .enumerate()
                .map(|(at, SealedRecord { blob, digest, signature, .. })| {
                    let signer = if at == 16 { &other } else { &own };
                    Unchecked { blob, signature, signer, anchor: anchor(at, *digest) }
                })
                .collect();
            let by_itself = |one: &Unchecked<'_>| check(provider, one.blob, one.signature, one.signer, one.anchor);
            let told = |checked: Vec<Checked>| checked.iter().map(|one| format!("{one:?}")).collect::<Vec<_>>();
            let expected = told(all.iter().map(by_itself).collect());
            assert_eq!(expected.iter().filter(|one| one.starts_with("Err")).count(), 7, "{expected:#?}");
            for helpers in [0, 1, 3] {
                assert_eq!(told(check_by(provider, &all, helpers)), expected, "{helpers} helpers");
            }
            assert_eq!(
                (told(check_many(provider, &all[..1])), check_many(provider, &[]).len()),
                (vec![expected[0].clone()], 0)
            );
        }
    }
}

//! A signature other than the sealed one: `verified` must hold up in court, so every own record is verified in full,
//! whether its signer was seen before or not.

use super::keeping::head;
use super::*;
use crate::crypto::{Provider, SealRequest, TopicKey, seal};
use crate::pipeline::fixture::Notes;
use crate::pipeline::verifier::verify_round;

/// Bits of the signature: the first and last of r and of s, and some between them.
const BITS: [usize; 8] = [0, 7, 100, 255, 256, 300, 450, 511];

impl Line {
    /// Seals a record and stores it as the sealer does, but with this bit of its signature flipped.
    fn keep(&self, seq: u64, flipped: Option<usize>) {
        let body = seq.to_be_bytes();
        let head = head(&body);
        let request = SealRequest {
            domain: self.network.domain,
            owner: self.owner.address,
            signer: &self.owner.signing(),
            epoch: 1,
            topic_key: &TopicKey::new([6; 32]),
            recorder: self.plant.ledger.records.recorder(),
            seq,
            topic_id: TopicId([1; 16]),
            kind: RecordKind::Data,
            filters: Vec::new(),
            captured_at: Timestamp(seq),
            head: &head,
            body: &body,
        };
        let mut record = NewRecord::sealed(seal(self.plant.provider, &request).expect("sealed")).named(&head);
        if let Some(bit) = flipped {
            record.signature.0[bit / 8] ^= 0x80 >> (bit % 8);
        }
        self.plant.keep(vec![record], |records| self.plant.ledger.records.append(records)).expect("kept");
    }

    async fn verify(&self, all: u64) {
        self.drain(AnchorMode::Batch, all, || false).await;
        assert_eq!(verify_round(&self.plant, &self.network).map(|decided| decided as u64).expect("a round"), all);
    }

    fn in_state(&self, state: RecordState) -> Vec<u64> {
        let rows = self.plant.ledger.records.in_state(None, state, 100).expect("rows");
        rows.iter().map(|row| row.seq).collect()
    }
}

/// The same work for each provider; only the default one has tables of known signers.
async fn line_of(name: ProviderName) -> Line {
    let line = Line::new().await;
    let (provider, observer): (&'static dyn Provider, Arc<dyn Observer>) = (provider(name), Arc::new(Notes::default()));
    Line { plant: Plant { provider, observer, ..line.plant }, ..line }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_flipped_bit_of_a_strangers_signature_reads_tampered() {
    for name in [ProviderName::Authros, ProviderName::RustCrypto] {
        let line = line_of(name).await;
        // No valid signature of this signer was seen yet, so there is no table.
        BITS.iter().zip(1..).for_each(|(bit, seq)| line.keep(seq, Some(*bit)));
        line.verify(8).await;
        assert_eq!(line.in_state(RecordState::Tampered), (1..=8).collect::<Vec<_>>(), "{name}");
        assert_eq!(line.in_state(RecordState::Verified), Vec::<u64>::new(), "{name}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_flipped_bit_of_a_known_signers_signature_reads_tampered_and_its_neighbours_verified() {
    for name in [ProviderName::Authros, ProviderName::RustCrypto] {
        let line = line_of(name).await;
        (1..=8).for_each(|seq| line.keep(seq, None));
        line.verify(8).await;
        assert_eq!(line.in_state(RecordState::Verified).len(), 8, "{name}: eight valid signatures make the table");
        // Every second one.
        let flipped = |seq: u64| seq.is_multiple_of(2).then(|| BITS[usize::try_from(seq / 2 - 5).expect("small")]);
        (9..=24).for_each(|seq| line.keep(seq, flipped(seq)));
        line.verify(16).await;
        assert_eq!(line.in_state(RecordState::Tampered), (10..=24).step_by(2).collect::<Vec<_>>(), "{name}");
        let verified: Vec<u64> = (1..=8).chain((9..=24).step_by(2)).collect();
        assert_eq!(line.in_state(RecordState::Verified), verified, "{name}");
    }
}

//! What happens to records that a gateway took over.

use tokio::task::block_in_place;

use crate::chain::AnchorProof;
use crate::chain::merkle::Leaf;
use crate::gateway::standings::statement;
use crate::gateway::{Client, SignedStandings, Standing};
use crate::model::{Digest, Header, RecordState};
use crate::pipeline::PipelineError;
use crate::store::{KeptStanding, RecordRow};

use super::ForwardError;
use super::line::Line;

/// Records asked about at once; with their proofs they fit into one message.
const PAGE: usize = 256;

impl Line<'_> {
    /// Asks for the standings of the next page of records that the gateway signed for, and moves those that it has
    /// decided. Returns whether there were any.
    pub(super) async fn check(&mut self, client: &mut Client) -> Result<bool, ForwardError> {
        let after = self.cursor.take();
        let page = block_in_place(|| self.outbox.plant.ledger.forwarded(after, PAGE))?;
        if page.rows.is_empty() {
            return Ok(false);
        }
        let stood = self.standings(client, &page.rows).await?;
        let of = |wanted: Standing| -> Vec<Digest> {
            page.rows
                .iter()
                .zip(&stood.each)
                .filter(|(_, found)| **found == wanted)
                .map(|(row, _)| row.digest)
                .collect()
        };
        let (verified, unknown, tampered) = (of(Standing::Verified), of(Standing::Unknown), of(Standing::Tampered));
        self.cursor = page.next;
        self.moved |= !verified.is_empty();
        if let Some(proven) = stood.proven {
            let ledger = &self.outbox.plant.ledger;
            // Before its state changes: a verified record without it would be kept forever.
            block_in_place(|| ledger.keep_proven(proven)).map_err(PipelineError::from)?;
        }
        block_in_place(|| self.decide(&verified, &unknown, &tampered))?;
        Ok(true)
    }

    /// The standings of these records: signed, and verified only those whose proof is valid.
    async fn standings(&mut self, client: &mut Client, rows: &[RecordRow]) -> Result<Standings, ForwardError> {
        let digests: Vec<Digest> = rows.iter().map(|row| row.digest).collect();
        let signed = client.check(&digests).await?;
        Ok(block_in_place(|| self.proven(rows, &digests, signed)))
    }

    fn proven(&self, rows: &[RecordRow], digests: &[Digest], signed: SignedStandings) -> Standings {
        let (mut proofs, mut doubted) = (Vec::new(), 0usize);
        let each = rows.iter().zip(&signed.stood).map(|(row, stood)| {
            if stood.standing != Standing::Verified {
                return stood.standing;
            }
            if self.holds(row, &stood.proof) {
                proofs.push((row.digest, stood.proof.clone()));
                return Standing::Verified;
            }
            doubted += 1;
            Standing::Anchored
        });
        let each = each.collect();
        if doubted > 0 {
            let text = format!(
                "the gateway claims that {doubted} records are verified, but its proofs do not show them in an \
                 anchored batch; they are kept here as unverified"
            );
            self.outbox.plant.observer.alert(true, text);
        }
        let statement = statement(self.outbox.plant.provider, signed.time, digests, &signed.stood);
        let proven = KeptStanding { time: signed.time, statement, signature: signed.signature, proofs };
        Standings { each, proven: (!proven.proofs.is_empty()).then_some(proven) }
    }

    /// Whether a proof leads from the very bytes stored here to the root of an anchored batch.
    fn holds(&self, row: &RecordRow, proof: &[u8]) -> bool {
        let Ok(AnchorProof { inclusion: Some(inclusion), .. }) = AnchorProof::parse(proof) else { return false };
        let Ok(Some(blob)) = self.outbox.plant.vault.get(row.digest) else { return false };
        let Ok((header, _)) = Header::parse(&blob) else { return false };
        let digest = Digest(self.outbox.plant.provider.sm3(&[&blob]));
        digest == row.digest && inclusion.proves(&Leaf::of(&header, digest))
    }

    fn decide(&self, verified: &[Digest], unknown: &[Digest], tampered: &[Digest]) -> Result<(), PipelineError> {
        let (ledger, observer) = (&self.outbox.plant.ledger, &self.outbox.plant.observer);
        if !verified.is_empty() {
            ledger.settle_forwarded(verified, RecordState::Verified)?;
            observer.verified(verified);
        }
        if !unknown.is_empty() && ledger.settle_forwarded(unknown, RecordState::Stored)? > 0 {
            let count = unknown.len();
            observer.alert(
                true,
                format!(
                    "the gateway signed for {count} records but no longer has them; they are sent again, and its \
                     receipts are kept"
                ),
            );
        }
        if !tampered.is_empty() && ledger.settle_forwarded(tampered, RecordState::Tampered)? > 0 {
            observer.tampered(tampered);
            let count = tampered.len();
            observer.alert(
                true,
                format!(
                    "{count} records were altered at the gateway after it signed for them; the originals are kept here"
                ),
            );
        }
        if !(verified.is_empty() && unknown.is_empty() && tampered.is_empty()) {
            observer.records_changed();
        }
        Ok(())
    }
}

/// Standings, in order, with the evidence for the verified ones.
struct Standings {
    each: Vec<Standing>,
    proven: Option<KeptStanding>,
}

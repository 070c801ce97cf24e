//! Who signed several records: few keys, in few blocks, so the same question is asked once.

use std::collections::HashMap;

use super::signing::{NoRight, signer_of};
use crate::model::{Address, PublicKey, SignerId};
use crate::pipeline::{Network, PipelineError, Plant};
use crate::store::RecordRow;

/// What is known of the signers of some records that are looked at together.
pub struct Signers<'a> {
    plant: &'a Plant,
    network: &'a Network,
    known: HashMap<(Address, SignerId, Option<u64>), Result<PublicKey, NoRight>>,
}

impl<'a> Signers<'a> {
    /// Nothing is known yet.
    pub fn new(plant: &'a Plant, network: &'a Network) -> Self {
        Self { plant, network, known: HashMap::new() }
    }

    /// The key that signed a record, see [`signer_of`].
    ///
    /// # Errors
    /// Errors of chain and ledger; lack of a right is part of the answer.
    pub fn of(&mut self, row: &RecordRow) -> Result<Result<PublicKey, NoRight>, PipelineError> {
        let asked = (row.owner, row.signer, row.block);
        if let Some(known) = self.known.get(&asked) {
            return Ok(known.clone());
        }
        let signer = signer_of(self.plant, self.network, row)?;
        self.known.insert(asked, signer.clone());
        Ok(signer)
    }
}

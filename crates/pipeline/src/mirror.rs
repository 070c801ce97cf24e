//! Records that come through a gateway: every claim is compared with the chain, then they are stored in the
//! ledger as if they had been captured here. A gateway that lies gets nothing in.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use crate::authority::{self, Moment, SigningRight, may_sign};
use crate::chain::AnchorProof;
use crate::chain::merkle::Leaf;
use crate::crypto::{CryptoError, ErasedStatement, SealedRecord, check_deleted, signer_id};
use crate::equivocation::{self, Claim};
use crate::gateway::{Entry, ErasedRecord, Fetched, Standing};
use crate::model::{Address, Digest, Hash, Header, RecordState, Timestamp};
use crate::reader::Reader;
use crate::store::{NewRecord, RecordRow, RootSighting, Sighting, StoreError, TakenErased};
use crate::{Network, Owner, PipelineError, Plant, chain_proofs};

/// Length of the tag at the end of a sealed body, bytes.
const TAG: u64 = 16;
/// How long the watcher may lag behind the block of a proof.
const BEHIND: Duration = Duration::from_secs(30);
/// How often the watcher's position is checked.
const LOOK: Duration = Duration::from_millis(50);
/// A gateway's node may be so many blocks ahead of the one here.
const AHEAD: u64 = 256;
/// The most anchors cached.
const MOST_ANCHORS: usize = 4096;

/// Imports records for one reader.
pub struct Mirror<'a> {
    /// Store, provider.
    pub plant: &'a Plant,
    /// The chain.
    pub network: &'a Network,
    /// The reader.
    pub reader: &'a Owner,
    /// The gateway's account: it anchors what it keeps for others, so nobody here tries to.
    pub keeper: Address,
    /// Anchors that the chain confirmed.
    pub anchors: Anchors,
}

/// Anchors that the chain confirmed, by account, root, leaves and transaction: their blocks.
#[derive(Default)]
pub struct Anchors(Mutex<BTreeMap<AnchorKey, (u64, Hash)>>);

/// Account, root, number of leaves, transaction.
type AnchorKey = (Address, Hash, u64, Hash);

impl Anchors {
    /// Forgets what the chain said: it replaced blocks.
    pub fn forget(&self) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }

    /// Compares the proof with the chain; block and hash are then the chain's own.
    ///
    /// # Errors
    /// [`PipelineError::NotTakenIn`] if the chain does not confirm it, [`PipelineError::NotSeen`] if it may have its block
    /// later, otherwise errors of the chain.
    pub async fn confirm(
        &self,
        network: &Network,
        header: &Header,
        digest: Digest,
        proof: AnchorProof,
    ) -> Result<AnchorProof, PipelineError> {
        let refused = |why: &str| PipelineError::NotTakenIn { digest, why: why.to_owned() };
        let Some(inclusion) = &proof.inclusion else {
            let (block, block_hash) = block_of(network, digest, &proof).await?;
            let uploaded = network.chain.uploaded_at(header.owner, digest).await?;
            if proof.account != header.owner || uploaded != Some(block) {
                return Err(refused("the chain does not have its digest"));
            }
            return Ok(AnchorProof { block, block_hash, ..proof });
        };
        if !inclusion.proves(&Leaf::of(header, digest)) {
            return Err(refused("its path does not lead to its root"));
        }
        let key = (proof.account, inclusion.root, inclusion.count, proof.transaction);
        let known = self.0.lock().unwrap_or_else(PoisonError::into_inner).get(&key).copied();
        if let Some((block, block_hash)) = known {
            return Ok(AnchorProof { block, block_hash, ..proof });
        }
        // The block is the transaction's, and the root must be in that very block: the right is judged by it.
        let (block, block_hash) = block_of(network, digest, &proof).await?;
        let (account, root, count) = (proof.account, inclusion.root, inclusion.count);
        if !chain_proofs::is_root_in(&network.chain, account, root, count, block).await? {
            return Err(refused("the chain does not have its root"));
        }
        let mut anchors = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if anchors.len() >= MOST_ANCHORS {
            anchors.clear();
        }
        anchors.insert(key, (block, block_hash));
        Ok(AnchorProof { block, block_hash, ..proof })
    }
}

/// The block that has the proof's transaction.
async fn block_of(network: &Network, digest: Digest, proof: &AnchorProof) -> Result<(u64, Hash), PipelineError> {
    if let Some(found) = mined_in(network, proof).await? {
        return Ok(found);
    }
    // Two nodes do not have a block at the same moment, and the newest ones may be replaced.
    let (block, head) = (proof.block, network.chain.head().await?.number);
    if block.saturating_add(network.confirmations) > head && block <= head.saturating_add(AHEAD) {
        return Err(PipelineError::NotSeen { digest, block });
    }
    // The block may have come after the first question and before the second.
    mined_in(network, proof).await?.ok_or_else(|| PipelineError::NotTakenIn {
        digest,
        why: "the chain does not have its anchoring transaction".to_owned(),
    })
}

async fn mined_in(network: &Network, proof: &AnchorProof) -> Result<Option<(u64, Hash)>, PipelineError> {
    let receipt = network.chain.receipt(proof.transaction).await?.filter(|receipt| receipt.success);
    Ok(receipt.map(|receipt| (receipt.block, receipt.block_hash)))
}

/// Waits until the watcher here has read a block's events, for so long at most: rights follow from them.
async fn wait_for(plant: &Plant, block: u64, patience: Duration) -> Result<(), PipelineError> {
    let deadline = Instant::now() + patience;
    while block_in_place(|| plant.ledger.trail.cursor())?.is_none_or(|(read, _)| read < block) {
        if Instant::now() > deadline {
            return Err(PipelineError::Unsteady);
        }
        tokio::time::sleep(LOOK).await;
    }
    Ok(())
}

/// Whether the signer had the right at the anchoring block, which the watcher here has so long to read.
async fn check_right(
    plant: &Plant,
    network: &Network,
    (header, digest, fetched): (&Header, Digest, &Fetched),
    (block, patience): (u64, Duration),
) -> Result<(), PipelineError> {
    wait_for(plant, block, patience).await?;
    let at = Moment::of_block(block, network.ask_time(block).await?);
    let right = authority::may_sign(&network.directory, header.owner, header.signer, at);
    let right = right.map_err(|why| PipelineError::NotTakenIn { digest, why: why.to_string() })?;
    note_signer(plant, header, fetched, &right)
}

/// The key of a device is known from its records alone.
fn note_signer(plant: &Plant, header: &Header, fetched: &Fetched, right: &SigningRight) -> Result<(), PipelineError> {
    match right {
        SigningRight::Owner(_) => Ok(()),
        SigningRight::Device(_) => {
            Ok(block_in_place(|| plant.ledger.bindings.keep_signer(header.signer, fetched.signer))?)
        }
    }
}

/// The owners whose records a reader may have: itself, and everyone who currently shares with it; with the transaction of
/// the grant, which is another one when an owner shares anew. For the reader itself that is zero.
pub fn sources(network: &Network, reader: &Owner) -> BTreeMap<Address, Hash> {
    let grants = authority::shared_with(&network.directory, reader.address);
    let shared = grants.into_iter().map(|grant| (grant.terms.owner, grant.transaction));
    shared.chain([(reader.address, Hash([0; 32]))]).collect()
}

impl Mirror<'_> {
    fn opener(&self) -> Reader<'_> {
        Reader { plant: self.plant, network: self.network, reader: self.reader }
    }

    /// Whether a listed record is to be fetched: readable with the present keys, and either unknown here or without the
    /// proof that now exists.
    ///
    /// # Errors
    /// Errors of the ledger.
    pub fn wants(&self, entry: &Entry) -> Result<bool, PipelineError> {
        let anchored = matches!(entry.standing, Standing::Anchored | Standing::Verified);
        match block_in_place(|| self.plant.ledger.record(entry.digest))? {
            Some(row) => Ok(anchored && row.state == RecordState::Stored),
            None if matches!(entry.standing, Standing::Unknown | Standing::Tampered) => Ok(false),
            None => Ok(self.opener().topic_key(&row_of_entry(entry)).is_ok()),
        }
    }

    /// Records of others that wait here for their proofs.
    ///
    /// # Errors
    /// Errors of the ledger.
    pub fn unproven(&self, owner: Address, most: usize) -> Result<Vec<Digest>, PipelineError> {
        let rows = block_in_place(|| self.plant.ledger.in_state(Some(owner), RecordState::Stored, most))?;
        let here = self.plant.ledger.recorder();
        Ok(rows.iter().filter(|row| !here.has(&row.recorder)).map(|row| row.digest).collect())
    }

    /// Imports one record. Its digest and its signature by the key that came with it have been checked already. Returns
    /// whether anything changed.
    ///
    /// # Errors
    /// [`PipelineError::NotTakenIn`] if a claim is invalid, otherwise errors of store and chain.
    pub async fn take(&self, owner: Address, digest: Digest, fetched: Fetched) -> Result<bool, PipelineError> {
        let refused = |why: &str| PipelineError::NotTakenIn { digest, why: why.to_owned() };
        let (header, _) = Header::parse(&fetched.blob).map_err(|_| refused("it is not a record"))?;
        if header.owner != owner || header.domain != self.network.domain {
            return Err(refused("it does not belong to the requested owner or network"));
        }
        let proof = match fetched.proof.is_empty() {
            true => None,
            false => Some(AnchorProof::parse(&fetched.proof).map_err(|_| refused("its proof is malformed"))?),
        };
        if signer_id(&fetched.signer) != header.signer {
            return Err(refused("its header names a different key than the one that signed it"));
        }
        let proof = match proof {
            Some(proof) => match self.anchors.confirm(self.network, &header, digest, proof).await {
                // Until its block is here it counts as one without a proof.
                Err(PipelineError::NotSeen { .. }) => None,
                confirmed => Some(confirmed?),
            },
            None => None,
        };
        if !self.check_signer(&header, digest, &fetched, proof.as_ref()).await? {
            return Ok(false);
        }
        let known = block_in_place(|| self.plant.ledger.record(digest))?;
        let mut changed = false;
        if known.is_none() {
            let block = proof.as_ref().map(|proof| proof.block);
            self.keep(header, digest, fetched, block).await?;
            changed = true;
        }
        if let Some(proof) = proof {
            changed |= block_in_place(|| self.prove(owner, digest, proof))?;
        }
        Ok(changed)
    }

    /// Whether the signer had the right at the anchoring block, or has it now if there is none yet: then the right may
    /// come back, and nothing is wrong with the record.
    async fn check_signer(
        &self,
        header: &Header,
        digest: Digest,
        fetched: &Fetched,
        proof: Option<&AnchorProof>,
    ) -> Result<bool, PipelineError> {
        if let Some(proof) = proof {
            check_right(self.plant, self.network, (header, digest, fetched), (proof.block, BEHIND)).await?;
            return Ok(true);
        }
        let now = Moment::newest(self.network.directory.now());
        match authority::may_sign(&self.network.directory, header.owner, header.signer, now) {
            Ok(right) => note_signer(self.plant, header, fetched, &right).map(|()| true),
            Err(_) => Ok(false),
        }
    }

    async fn keep(
        &self,
        header: Header,
        digest: Digest,
        fetched: Fetched,
        block: Option<u64>,
    ) -> Result<(), PipelineError> {
        let asked = RecordRow { block, ..row_of(&header, digest, &fetched) };
        let opened = self.opener().open_bytes(&asked, &fetched.blob).await.map_err(|error| match error {
            PipelineError::Crypto(CryptoError::FalseName(what)) => {
                let why = format!("its signer wrote a false {what} into it");
                PipelineError::NotTakenIn { digest, why }
            }
            error => error,
        })?;
        let sealed = SealedRecord { header, blob: fetched.blob, digest, signature: fetched.signature };
        let row = NewRecord::foreign(sealed, self.keeper).named(&opened.head);
        let claim = Claim::of(&row);
        match block_in_place(|| self.plant.keep([row], |row| self.plant.ledger.append(row.into()))) {
            Err(StoreError::Conflict { .. }) => {
                if let Some(claim) = claim {
                    block_in_place(|| equivocation::tell(self.plant, &claim))?;
                }
                let why = "its number belongs to another record, or its topic has another name".to_owned();
                Err(PipelineError::NotTakenIn { digest, why })
            }
            done => Ok(done?),
        }
    }

    fn prove(&self, owner: Address, digest: Digest, proof: AnchorProof) -> Result<bool, PipelineError> {
        let AnchorProof { account, transaction, block, block_hash, inclusion } = proof;
        let ledger = &self.plant.ledger;
        if ledger.record(digest)?.is_none_or(|row| row.state != RecordState::Stored) {
            return Ok(false);
        }
        Ok(match inclusion {
            None => ledger.mined(&[Sighting { owner, digest, transaction, block, block_hash }])? > 0,
            Some(inclusion) => {
                let (root, count) = (inclusion.root, inclusion.count);
                let anchor = RootSighting { account, root, count, transaction, block, block_hash };
                match ledger.take_in(digest, inclusion, anchor) {
                    // It waits for its proof like one that is not anchored yet; the chain is asked again.
                    Err(StoreError::Replaced { .. }) => {
                        self.anchors.forget();
                        false
                    }
                    taken => taken?,
                }
            }
        })
    }
}

/// As a row that the ledger does not have yet: enough to find keys and open it.
fn row_of(header: &Header, digest: Digest, fetched: &Fetched) -> RecordRow {
    let entry = Entry {
        digest,
        owner: header.owner,
        recorder: header.recorder,
        seq: header.seq,
        topic_id: header.topic_id,
        epoch: header.epoch,
        captured_at: header.captured_at,
        length: header.body_length.saturating_sub(TAG),
        kind: header.kind,
        standing: Standing::Acknowledged,
    };
    RecordRow { signer: header.signer, signature: fetched.signature, ..row_of_entry(&entry) }
}

fn row_of_entry(entry: &Entry) -> RecordRow {
    RecordRow {
        id: entry.digest.to_hex().get(..16).unwrap_or_default().to_owned(),
        digest: entry.digest,
        owner: entry.owner,
        recorder: entry.recorder,
        topic_id: entry.topic_id,
        seq: entry.seq,
        epoch: entry.epoch,
        kind: entry.kind,
        signer: crate::model::SignerId([0; 32]),
        signature: crate::model::Signature([0; 64]),
        topic: RecordRow::unnamed(entry.topic_id),
        type_name: String::new(),
        bytes: entry.length,
        captured_at: entry.captured_at,
        acknowledged_at: Timestamp::now(),
        simulated: false,
        state: RecordState::Stored,
        transaction: None,
        block: None,
        block_hash: None,
        deleted_at: None,
    }
}

impl Mirror<'_> {
    /// Takes in what is left of a record that its owner had erased. Returns whether anything changed.
    ///
    /// # Errors
    /// [`PipelineError::NotTakenIn`] or an error of the signature if a claim is invalid, otherwise errors of chain and ledger.
    pub async fn take_erased(
        &self,
        owner: Address,
        digest: Digest,
        erased: ErasedRecord,
    ) -> Result<bool, PipelineError> {
        let refused = |why: &str| PipelineError::NotTakenIn { digest, why: why.to_owned() };
        let (header, _) = Header::parse(&erased.record.blob).map_err(|_| refused("its header is none"))?;
        if header.owner != owner {
            return Err(refused("it does not belong to the requested owner"));
        }
        let asked = row_of(&header, digest, &erased.record);
        block_in_place(|| self.opener().topic_key(&asked))?;
        let proven = prove_erased(self.plant, self.network, &self.anchors, (digest, &erased), BEHIND).await?;
        let Some((header, proof)) = proven else { return Ok(false) };
        let ErasedRecord { record, statement } = erased;
        let taken = taken_erased(record.blob, &statement);
        let sealed = SealedRecord { header, blob: Vec::new(), digest, signature: record.signature };
        block_in_place(|| Ok(self.note(sealed, taken)? && self.prove(owner, digest, proof)?))
    }

    fn note(&self, sealed: SealedRecord, taken: TakenErased) -> Result<bool, PipelineError> {
        let digest = sealed.digest;
        let row = NewRecord { blob: None, ..NewRecord::foreign(sealed, self.keeper) };
        self.plant.ledger.take_erased(row, taken).map_err(|error| match error {
            StoreError::Conflict { .. } => {
                PipelineError::NotTakenIn { digest, why: "its number belongs to another record".to_owned() }
            }
            error => error.into(),
        })
    }
}

/// What the ledger notes of an erased record.
pub fn taken_erased(header: Vec<u8>, statement: &ErasedStatement) -> TakenErased {
    TakenErased { header, report: statement.report, at: statement.at, statement: statement.encode() }
}

/// Holds what is left of an erased record against the chain: the record's signature, its owner's statement by the key of
/// now, the anchor, and the signer's right at that block, which the watcher has `patience` to read. `None` if the chain may have
/// the anchor's block later.
///
/// # Errors
/// [`PipelineError::NotTakenIn`] or [`PipelineError::Crypto`] if a claim is invalid, otherwise errors of chain and ledger.
pub async fn prove_erased(
    plant: &Plant,
    network: &Network,
    anchors: &Anchors,
    (digest, erased): (Digest, &ErasedRecord),
    patience: Duration,
) -> Result<Option<(Header, AnchorProof)>, PipelineError> {
    let refused = |why: &str| PipelineError::NotTakenIn { digest, why: why.to_owned() };
    let ErasedRecord { record, statement } = erased;
    let (_, length) = Header::parse(&record.blob).map_err(|_| refused("its header is none"))?;
    let header = check_deleted(plant.provider, &record.blob, digest, &record.signature, &record.signer)?;
    if length != record.blob.len() || !header.kind.is_content() {
        return Err(refused("what is left of it is not the header of a message or an attachment"));
    }
    if header.domain != network.domain {
        return Err(refused("it does not belong to the network"));
    }
    statement.check(plant.provider, &digest, &record.blob)?;
    let now = Moment::newest(network.directory.now());
    let right = may_sign(&network.directory, header.owner, signer_id(&statement.signer), now);
    if !matches!(right, Ok(SigningRight::Owner(_))) {
        return Err(refused("that it was erased is not stated with its owner's key"));
    }
    let proof = AnchorProof::parse(&record.proof).map_err(|_| refused("it has no proof"))?;
    let proof = match anchors.confirm(network, &header, digest, proof).await {
        Err(PipelineError::NotSeen { .. }) => return Ok(None),
        confirmed => confirmed?,
    };
    check_right(plant, network, (&header, digest, record), (proof.block, patience)).await?;
    Ok(Some((header, proof)))
}

#[cfg(test)]
mod block_tests;

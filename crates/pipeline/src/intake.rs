//! The one way in for records sealed elsewhere: a reader's, an owner's uploads, and what owners had erased. Every claim
//! of a proof is compared with the chain, by the same steps for each source.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use crate::authority::{self, Moment, NoRight, SigningRight, may_sign};
use crate::crypto::{CryptoError, ErasedStatement, SealedRecord, check_deleted, signer_id};
use crate::gateway::{ErasedRecord, FeedEntry, Fetched};
use crate::model::{
    Address, Digest, Fact, Hash, Header, PublicKey, RecordState, RecorderId, Signature, SignerId, Timestamp, TopicId,
};
use crate::store::{AuditEntry, NewRecord, RecordRow, RootSighting, Sighting, StoreError, TakenErased};
use crate::{Network, Owner, PipelineError, Plant, Result, chain::AnchorProof, chain_proofs, reader::Reader};
use crate::{chain::merkle::Leaf, gateway::desk::Received, store::notes::Equivocations};

/// Length of the tag at the end of a sealed body, bytes.
const TAG: u64 = 16;
/// How often the watcher's position is checked.
const LOOK: Duration = Duration::from_millis(50);
/// The most anchors cached.
const MOST_ANCHORS: usize = 4096;

#[derive(Debug, thiserror::Error)]
pub enum Reason {
    #[error("it is not a record")]
    NotARecord,
    #[error("it does not belong to the requested owner or network")]
    AnotherOwner,
    #[error("its header names a different key than the one that signed it")]
    AnotherSigner,
    #[error("it has no proof of its anchor")]
    NoProof,
    #[error("{0}")]
    NotAnchored(&'static str),
    #[error("{0}")]
    NoRight(Box<NoRight>),
    #[error("{0}")]
    Crypto(CryptoError),
    #[error("its signer wrote a false {0} into it")]
    FalseName(&'static str),
    #[error("its number belongs to another record, or its topic has another name")]
    Number,
    #[error("what is left of it is not the header of a message or an attachment")]
    NotErasable,
    #[error("its erasure is not signed with its owner's key")]
    NotStated,
    #[error("it claims to be numbered by this home, but is not")]
    NumberedHere,
    #[error("{0}")]
    Unopened(Box<PipelineError>),
}

#[derive(Debug, thiserror::Error)]
#[error("record {digest} from the gateway was rejected: {reason}; tell its owner and the gateway's operator")]
pub struct Refused {
    pub digest: Digest,
    pub reason: Reason,
}

#[derive(Debug)]
pub enum Accepted {
    /// It is here; whether anything changed.
    Held(bool),
    /// The chain here does not show enough yet to judge it.
    Later,
    Refused(Refused),
}

enum Stop {
    Later,
    Refused(Reason),
    Failed(PipelineError),
}

impl From<Reason> for Stop {
    fn from(reason: Reason) -> Self {
        Self::Refused(reason)
    }
}

impl<E> From<E> for Stop
where
    PipelineError: From<E>,
{
    fn from(error: E) -> Self {
        match PipelineError::from(error) {
            PipelineError::Crypto(CryptoError::FalseName(what)) => Self::Refused(Reason::FalseName(what)),
            PipelineError::Crypto(error) => Self::Refused(Reason::Crypto(error)),
            // A grant may have ended just now, and a key may follow.
            PipelineError::NotGranted { .. } | PipelineError::UnknownEpoch(_) | PipelineError::Refused(_) => {
                Self::Later
            }
            error @ (PipelineError::Store(_)
            | PipelineError::Chain(_)
            | PipelineError::Unsteady
            | PipelineError::NodeBehind { .. }) => Self::Failed(error),
            // Anything else follows from what came: it must not keep the others away.
            error => Self::Refused(Reason::Unopened(Box::new(error))),
        }
    }
}

fn outcome(digest: Digest, done: Result<bool, Stop>) -> Result<Accepted> {
    match done {
        Ok(changed) => Ok(Accepted::Held(changed)),
        Err(Stop::Later) => Ok(Accepted::Later),
        Err(Stop::Refused(reason)) => Ok(Accepted::Refused(Refused { digest, reason })),
        Err(Stop::Failed(error)) => Err(error),
    }
}

pub struct Intake<'a> {
    pub plant: &'a Plant,
    pub network: &'a Network,
    pub anchors: &'a Anchors,
    /// The gateway's account: it anchors what it keeps for others, so nobody here tries to.
    pub keeper: Address,
    /// How long the watcher here may lag behind the block of a proof before it is for later.
    pub patience: Duration,
}

type AnchorKey = (Address, Hash, u64, Hash);

/// Blocks of confirmed anchors, by account, root, number of leaves and transaction.
#[derive(Default)]
pub struct Anchors(Mutex<BTreeMap<AnchorKey, (u64, Hash)>>);

impl Anchors {
    /// Forgets what the chain said: it replaced blocks.
    pub fn forget(&self) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }

    /// Compares the proof with the chain; block and hash are then the chain's own.
    async fn confirm(
        &self,
        network: &Network,
        header: &Header,
        digest: Digest,
        proof: AnchorProof,
    ) -> Result<AnchorProof, Stop> {
        let Some(inclusion) = &proof.inclusion else {
            let (block, block_hash) = block_of(network, &proof).await?;
            let uploaded = network.chain.uploaded_at(header.owner, digest).await?;
            if proof.account != header.owner || uploaded != Some(block) {
                return Err(Reason::NotAnchored("the chain does not have its digest").into());
            }
            return Ok(AnchorProof { block, block_hash, ..proof });
        };
        if !inclusion.proves(&Leaf::of(header, digest)) {
            return Err(Reason::NotAnchored("its path does not lead to its root").into());
        }
        let key = (proof.account, inclusion.root, inclusion.count, proof.transaction);
        let known = self.0.lock().unwrap_or_else(PoisonError::into_inner).get(&key).copied();
        if let Some((block, block_hash)) = known {
            return Ok(AnchorProof { block, block_hash, ..proof });
        }
        // The block is the transaction's, and the root must be in that very block: the right is judged by it.
        let (block, block_hash) = block_of(network, &proof).await?;
        let (account, root, count) = (proof.account, inclusion.root, inclusion.count);
        if !chain_proofs::is_root_in(&network.chain, account, root, count, block).await? {
            return Err(Reason::NotAnchored("the chain does not have its root").into());
        }
        let mut anchors = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if anchors.len() >= MOST_ANCHORS {
            anchors.clear();
        }
        anchors.insert(key, (block, block_hash));
        Ok(AnchorProof { block, block_hash, ..proof })
    }
}

async fn block_of(network: &Network, proof: &AnchorProof) -> Result<(u64, Hash), Stop> {
    if let Some(found) = mined_in(network, proof).await? {
        return Ok(found);
    }
    // Two nodes do not have a block at the same moment, and the newest ones may be replaced.
    if proof.block.saturating_add(network.confirmations) > network.chain.head().await?.number {
        return Err(Stop::Later);
    }
    // The block may have come after the first question and before the second.
    let found = mined_in(network, proof).await?;
    found.ok_or_else(|| Reason::NotAnchored("the chain does not have its anchoring transaction").into())
}

async fn mined_in(network: &Network, proof: &AnchorProof) -> Result<Option<(u64, Hash)>> {
    let receipt = network.chain.receipt(proof.transaction).await?.filter(|receipt| receipt.success);
    Ok(receipt.map(|receipt| (receipt.block, receipt.block_hash)))
}

/// The owners whose records a reader may have, with the transaction of the grant, which changes when an owner shares
/// anew. It is zero for the reader itself.
pub fn sources(network: &Network, reader: &Owner) -> BTreeMap<Address, Hash> {
    let grants = authority::shared_with(&network.directory, reader.address);
    let shared = grants.into_iter().map(|grant| (grant.terms.owner, grant.transaction));
    shared.chain([(reader.address, Hash([0; 32]))]).collect()
}

impl Intake<'_> {
    /// The steps of every record: its network, its key, its anchor, and the signer's right at that block, which the
    /// watcher must have read. A device's key is known from its records alone, and is noted.
    async fn examine(
        &self,
        header: &Header,
        digest: Digest,
        (signer, proof): (&PublicKey, &[u8]),
    ) -> Result<AnchorProof, Stop> {
        if header.domain != self.network.domain {
            return Err(Reason::AnotherOwner.into());
        }
        if signer_id(signer) != header.signer {
            return Err(Reason::AnotherSigner.into());
        }
        if proof.is_empty() {
            // The chain has taken its block back since.
            return Err(Stop::Later);
        }
        let told = AnchorProof::parse(proof).map_err(|_| Reason::NoProof)?;
        let (mut proof, mut right) = self.judge(header, digest, told.clone()).await?;
        if right.is_err() {
            // The directory may be of blocks that the chain replaced, until it is built anew; so may the cached anchor.
            let read = self.plant.ledger.trail.cursor()?;
            if read.is_none_or(|(block, _)| block < self.network.directory.newest()) {
                return Err(Stop::Later);
            }
            self.anchors.forget();
            (proof, right) = self.judge(header, digest, told).await?;
        }
        if let SigningRight::Device(_) = right.map_err(|why| Reason::NoRight(Box::new(why)))? {
            self.plant.ledger.bindings.keep_signer(header.signer, *signer)?;
        }
        Ok(proof)
    }

    async fn judge(
        &self,
        header: &Header,
        digest: Digest,
        proof: AnchorProof,
    ) -> Result<(AnchorProof, Result<SigningRight, NoRight>), Stop> {
        let proof = self.anchors.confirm(self.network, header, digest, proof).await?;
        self.wait_for(proof.block).await?;
        let at = Moment::of_block(proof.block, self.network.ask_time(proof.block).await?);
        Ok((proof, may_sign(&self.network.directory, header.owner, header.signer, at)))
    }

    /// Waits until the watcher here has read a block's events: rights follow from them.
    async fn wait_for(&self, block: u64) -> Result<(), Stop> {
        let deadline = Instant::now() + self.patience;
        while self.plant.ledger.trail.cursor()?.is_none_or(|(read, _)| read < block) {
            if Instant::now() >= deadline {
                return Err(Stop::Later);
            }
            tokio::time::sleep(LOOK).await;
        }
        Ok(())
    }

    /// Its digest and its signature by the key that came with it must have been checked.
    pub async fn accept(&self, reader: &Owner, owner: Address, digest: Digest, record: Fetched) -> Result<Accepted> {
        outcome(digest, self.take(reader, owner, digest, record).await)
    }

    async fn take(&self, reader: &Owner, owner: Address, digest: Digest, record: Fetched) -> Result<bool, Stop> {
        let (header, _) = Header::parse(&record.blob).map_err(|_| Reason::NotARecord)?;
        if header.owner != owner {
            return Err(Reason::AnotherOwner.into());
        }
        let is_new = || self.plant.ledger.records.find(digest).map(|row| row.is_none());
        if owner != reader.address && self.plant.ledger.records.recorder().has(&header.recorder) && is_new()? {
            return Err(Reason::NumberedHere.into());
        }
        let proof = self.examine(&header, digest, (&record.signer, &record.proof)).await?;
        let is_new = is_new()?;
        if is_new {
            self.keep(reader, header, digest, record, proof.block).await?;
        }
        Ok(block_in_place(|| self.prove(owner, digest, proof))? || is_new)
    }

    async fn keep(
        &self,
        reader: &Owner,
        header: Header,
        digest: Digest,
        record: Fetched,
        block: u64,
    ) -> Result<(), Stop> {
        let asked = row_of(&header, digest, &record, block);
        let opener = Reader { plant: self.plant, network: self.network, reader };
        let opened = opener.open_bytes(&asked, &record.blob).await?;
        let sealed = SealedRecord { header, blob: record.blob, digest, signature: record.signature };
        let row = NewRecord::foreign(sealed, self.keeper).named(&opened.head);
        Ok(block_in_place(|| store(self.plant, vec![row]))??)
    }

    fn prove(&self, owner: Address, digest: Digest, proof: AnchorProof) -> Result<bool, Stop> {
        let AnchorProof { account, transaction, block, block_hash, inclusion } = proof;
        let ledger = &self.plant.ledger;
        if !is_wanted(ledger.records.find(digest)?.as_ref(), false) {
            return Ok(false);
        }
        let Some(inclusion) = inclusion else {
            return Ok(ledger.batches.mined(&[Sighting { owner, digest, transaction, block, block_hash }])? > 0);
        };
        let (root, count) = (inclusion.root, inclusion.count);
        match ledger.batches.take_in(
            digest,
            inclusion,
            RootSighting { account, root, count, transaction, block, block_hash },
        ) {
            // The chain replaced that block after it had answered; the next try asks anew.
            Err(StoreError::Replaced { .. }) => {
                self.anchors.forget();
                Err(Stop::Later)
            }
            taken => Ok(taken?),
        }
    }

    pub async fn accept_erased(
        &self,
        reader: &Owner,
        owner: Address,
        digest: Digest,
        erased: ErasedRecord,
    ) -> Result<Accepted> {
        outcome(digest, self.take_erased(reader, owner, digest, erased).await)
    }

    async fn take_erased(
        &self,
        reader: &Owner,
        owner: Address,
        digest: Digest,
        erased: ErasedRecord,
    ) -> Result<bool, Stop> {
        let (header, _) = Header::parse(&erased.record.blob).map_err(|_| Reason::NotARecord)?;
        if header.owner != owner {
            return Err(Reason::AnotherOwner.into());
        }
        let opener = Reader { plant: self.plant, network: self.network, reader };
        block_in_place(|| opener.opening_of(owner, header.epoch, header.topic_id))?;
        let (header, proof) = self.examine_erased(digest, &erased).await?;
        let ErasedRecord { record, statement } = erased;
        let taken = taken_erased(record.blob, &statement);
        let sealed = SealedRecord { header, blob: Vec::new(), digest, signature: record.signature };
        let row = NewRecord { blob: None, ..NewRecord::foreign(sealed, self.keeper) };
        block_in_place(|| match self.plant.ledger.erasures.take(row, taken) {
            Err(StoreError::Conflict { .. }) => Err(Reason::Number.into()),
            noted => Ok(noted? && self.prove(owner, digest, proof)?),
        })
    }

    /// Checks the record's signature, its owner's statement by the present key, and all that any record has to show.
    pub async fn judge_erased(
        &self,
        digest: Digest,
        erased: &ErasedRecord,
    ) -> Result<Result<(Header, AnchorProof), Accepted>> {
        match self.examine_erased(digest, erased).await {
            Ok(proven) => Ok(Ok(proven)),
            Err(stop) => outcome(digest, Err(stop)).map(Err),
        }
    }

    async fn examine_erased(&self, digest: Digest, erased: &ErasedRecord) -> Result<(Header, AnchorProof), Stop> {
        let (provider, ErasedRecord { record, statement }) = (self.plant.provider, erased);
        let (_, length) = Header::parse(&record.blob).map_err(|_| Reason::NotARecord)?;
        let header = check_deleted(provider, &record.blob, digest, &record.signature, &record.signer)?;
        if length != record.blob.len() || !header.kind.is_content() {
            return Err(Reason::NotErasable.into());
        }
        statement.check(provider, &digest, &record.blob)?;
        let now = Moment::newest(self.network.directory.now());
        let right = may_sign(&self.network.directory, header.owner, signer_id(&statement.signer), now);
        if !matches!(right, Ok(SigningRight::Owner(_))) {
            return Err(Reason::NotStated.into());
        }
        let proof = self.examine(&header, digest, (&record.signer, &record.proof)).await?;
        Ok((header, proof))
    }
}

/// All or none. Signatures and rights were checked when they came; `keeper` anchors the records.
pub fn accept_uploads(plant: &Plant, keeper: Address, uploads: Vec<Received>) -> Result<Result<(), Reason>> {
    store(plant, uploads.into_iter().map(|upload| NewRecord::foreign(upload.into(), keeper)).collect())
}

/// Where one has the number of another, none is stored, and both signatures are kept.
fn store(plant: &Plant, rows: Vec<NewRecord>) -> Result<Result<(), Reason>> {
    let claims: Vec<_> = rows.iter().filter_map(Claim::of).collect();
    match plant.keep(rows, |rows| plant.ledger.records.append(rows)) {
        Err(error @ StoreError::Conflict { .. }) => {
            let told: Vec<bool> = claims.iter().map(|claim| tell(plant, claim)).collect::<Result<_, _>>()?;
            if !told.contains(&true) {
                plant.observer.alert(true, format!("a sender's record contradicts another one: {error}"));
            }
            Ok(Err(Reason::Number))
        }
        done => Ok(Ok(done?)),
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wish {
    /// It asks for it: it is not here, or not with the proof that now exists.
    Ask,
    /// It is here, or nobody here has a key of it.
    Pass,
    /// Nobody here has a key of it yet.
    Later,
}

/// `newest` is the newest epoch of its owner that the reader has keys for: keys of a later one come after its records.
pub fn wish(reader: &Reader<'_>, entry: &FeedEntry, newest: u64) -> Result<Wish> {
    if entry.fact == Fact::Stored || entry.fact == Fact::Erased && !entry.kind.is_content() {
        return Ok(Wish::Pass);
    }
    Ok(match reader.plant.ledger.records.find(entry.digest)? {
        Some(row) if is_wanted(Some(&row), entry.fact == Fact::Erased) => Wish::Ask,
        Some(_) => Wish::Pass,
        None if block_in_place(|| reader.opening_of(entry.owner, entry.epoch, entry.topic_id)).is_ok() => Wish::Ask,
        None if entry.epoch > newest => Wish::Later,
        None => Wish::Pass,
    })
}

/// A record is wanted if it is not here, or if no block with its anchor is known here: after the chain replaced blocks
/// the gateway may have placed it in another batch.
pub fn is_wanted(row: Option<&RecordRow>, is_erased: bool) -> bool {
    use RecordState::{Batched, Stored, Submitted};
    row.is_none_or(|row| !is_erased && matches!(row.state, Stored | Batched | Submitted))
}

/// Enough of a row to open the record.
fn row_of(header: &Header, digest: Digest, record: &Fetched, block: u64) -> RecordRow {
    RecordRow {
        id: digest.to_hex().get(..16).unwrap_or_default().to_owned(),
        digest,
        owner: header.owner,
        recorder: header.recorder,
        topic_id: header.topic_id,
        seq: header.seq,
        epoch: header.epoch,
        kind: header.kind,
        signer: header.signer,
        signature: record.signature,
        topic: RecordRow::unnamed(header.topic_id),
        type_name: String::new(),
        bytes: header.body_length.saturating_sub(TAG),
        captured_at: header.captured_at,
        acknowledged_at: Timestamp::now(),
        simulated: false,
        state: RecordState::Stored,
        transaction: None,
        block: Some(block),
        block_hash: None,
        deleted_at: None,
    }
}

pub fn taken_erased(header: Vec<u8>, statement: &ErasedStatement) -> TakenErased {
    TakenErased { header, report: statement.report, at: statement.at, statement: statement.encode() }
}

// Two signed records with the same number: a key that used one twice either lied or ran twice. The first record stays;
// the other is refused, reported, and kept in the audit log with both signatures.

/// At most this many cases per recorder are reported; more prove nothing more.
const MOST: usize = 16;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Claim {
    pub owner: Address,
    /// SM3 of the key that signed it.
    pub signer: SignerId,
    pub recorder: RecorderId,
    pub topic: TopicId,
    pub number: u64,
    pub digest: Digest,
    pub signature: Signature,
}

impl Claim {
    /// `None` for a record numbered here.
    pub fn of(record: &NewRecord) -> Option<Self> {
        let recorder = record.foreign?.recorder;
        let (owner, signer, topic, number) = (record.owner, record.signer, record.topic_id, record.seq);
        Some(Self { owner, signer, recorder, topic, number, digest: record.digest, signature: record.signature })
    }
}

/// Reports a refused record whose number belongs to another one; both signatures must have been checked. Returns
/// whether this is such a case, reported before or not.
pub fn tell(plant: &Plant, claim: &Claim) -> Result<bool> {
    let held =
        plant.ledger.inspection.holder(claim.owner, (claim.signer, claim.recorder), claim.topic, claim.number)?;
    let Some(held) = held.filter(|held| *held != claim.digest) else { return Ok(false) };
    let Some(row) = plant.ledger.records.find(held)? else { return Ok(false) };
    let Claim { owner, signer, recorder, topic, number, digest, signature } = claim;
    let is_new = plant.ledger.notes.change(&Equivocations { recorder: *recorder }, |known| {
        let is_new = !known.contains(digest) && known.len() < MOST;
        if is_new {
            plant.ledger.audit.append(AuditEntry {
                at: Timestamp::now(),
                profile: owner.to_string(),
                action: "equivocation".to_owned(),
                subject: format!("number {number} of topic {topic}, recorder {recorder}, signer {signer}"),
                outcome: format!("{held} signed {}; {digest} signed {signature}", row.signature),
            })?;
            known.push(*digest);
        }
        Ok::<_, PipelineError>(is_new)
    })?;
    if !is_new {
        return Ok(true);
    }
    let text = format!(
        "equivocation: the key {signer} of {owner} signed two records with number {number} of topic {topic} (recorder \
         {recorder}): {held} is kept, {digest} refused; the audit log keeps both signatures. Either two copies of its \
         home are running, or it is cheating"
    );
    plant.observer.alert(true, text);
    Ok(true)
}

#[cfg(test)]
mod block_tests;

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::crypto::{ProviderName, provider};
    use crate::model::{RecordKind, RecordState};
    use crate::pipeline::fixture::Notes;
    use crate::store::{AuditQuery, Ciphertext, Foreign, Ledger};

    fn record(digest: u8, seq: u64) -> NewRecord {
        let foreign = Foreign { recorder: RecorderId([7; RecorderId::LENGTH]), keeper: Address([9; 20]) };
        NewRecord {
            digest: Digest([digest; 32]),
            owner: Address([1; 20]),
            topic_id: TopicId([2; TopicId::LENGTH]),
            seq,
            foreign: Some(foreign),
            epoch: 1,
            kind: RecordKind::Data,
            signer: SignerId([3; 32]),
            signature: Signature([digest; 64]),
            filters: Vec::new(),
            topic: String::new(),
            type_name: String::new(),
            bytes: 1,
            captured_at: Timestamp(1),
            simulated: false,
            state: RecordState::Stored,
            blob: None,
        }
    }

    #[test]
    fn two_records_of_one_number_are_told_once_with_both_signatures() {
        let home = tempfile::tempdir().expect("a folder");
        let notes = Arc::new(Notes::default());
        let ledger = Ledger::open(&home.path().join("ledger.db")).expect("a ledger");
        let plant = Plant {
            ciphertext: Ciphertext::of(&ledger),
            ledger,
            provider: provider(ProviderName::RustCrypto),
            observer: Arc::clone(&notes) as _,
        };
        plant.ledger.records.append(vec![record(1, 5)]).expect("taken");
        let claim = |digest, seq| Claim::of(&record(digest, seq)).expect("from elsewhere");
        assert!(plant.ledger.records.append(vec![record(2, 5)]).is_err(), "the number is taken");
        assert!(!tell(&plant, &claim(1, 5)).expect("asked"), "the same record is none");
        assert!(!tell(&plant, &claim(2, 6)).expect("asked"), "another number is none");
        for _ in 0..3 {
            assert!(tell(&plant, &claim(2, 5)).expect("asked"));
        }
        assert_eq!(notes.with("equivocation"), 1);
        let query = AuditQuery { action: Some("equivocation".to_owned()), limit: 9, ..AuditQuery::default() };
        let lines = plant.ledger.audit.list(&query).expect("listed");
        let [line] = lines.as_slice() else { panic!("one line: {lines:?}") };
        let both = [Signature([1; 64]), Signature([2; 64])].map(|signature| signature.to_string());
        assert!(both.iter().all(|signature| line.entry.outcome.contains(signature)), "{line:?}");
        for digest in 10..60 {
            assert!(tell(&plant, &claim(digest, 5)).expect("asked"));
        }
        assert_eq!(notes.with("equivocation"), MOST, "a flood of them is bounded");
    }
}

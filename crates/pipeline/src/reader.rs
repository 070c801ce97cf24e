//! Reading: who may, with which key, and the results of the checks. Stored bytes are compared with the chain
//! before anything else, and nothing is shown before the last check.

use std::collections::{BTreeSet, HashMap};
use std::sync::{Arc, PoisonError};

use tokio::task::block_in_place;

use crate::authority::{self, Policy, ReadRefused, ReadingRight, may_read};
use crate::crypto::{
    Anchor, CryptoError, Expected, GrantedKeys, IndexKey, Names, OpenedRecord, TopicKey, WrappedKeys, check,
    check_deleted, open, signer_id, topic_key, unwrap,
};
use crate::directory::{Granted, kept};
use crate::model::{
    Address, Digest, GrantTerms, Head, Header, PublicKey, RecordKind, RecordState, Scope, SignerId, Timestamp, TopicId,
    Verdict,
};
use crate::ros::message::{is_built_in, type_hash};
use crate::store::{KeptEnvelope, RecordQuery, RecordRow, Retained};
use crate::{Network, Owner, PipelineError, Plant, Result, chain_proofs, columns};
use crate::{crypto::sm3::sm3, retention::is_stated, ros::recording::TYPE_HASH, ros::recording::tags::CHANNEL};

/// Reads records for one owner: their own, and those granted to them.
pub struct Reader<'a> {
    pub plant: &'a Plant,
    pub network: &'a Network,
    pub reader: &'a Owner,
}

impl Reader<'_> {
    fn right(&self, owner: Address, topic: Option<TopicId>) -> Result<ReadingRight, ReadRefused> {
        may_read(&self.network.directory, self.reader.address, owner, topic, Policy::OwnSite)
    }

    pub fn authorise(&self, row: &RecordRow) -> Result<()> {
        let own = row.owner == self.reader.address;
        if !own && is_held(row) {
            return Err(PipelineError::NoRecord(row.id.clone()));
        }
        if crate::crypto::fault::is_off("authorise") {
            return Ok(());
        }
        match self.right(row.owner, Some(row.topic_id)) {
            Ok(_) => Ok(()),
            Err(ReadRefused::NotGranted { owner, reader } | ReadRefused::NotCovered { owner, reader }) => {
                Err(PipelineError::NotGranted { owner, reader, what: format!("record {}", row.id) })
            }
            Err(refused) => Err(PipelineError::Refused(format!("record {} is not shown: {refused}", row.id))),
        }
    }

    /// Checks a record without opening it (the paper's `Data_Check`); what is wrong with it is in the verdict.
    pub async fn check(&self, row: &RecordRow) -> Result<(Verdict, Digest)> {
        let checked = self.check_once(row).await?;
        if checked.0 != Verdict::Tampered {
            return Ok(checked);
        }
        // Its block may have been replaced since its row was read.
        match self.plant.ledger.records.find(row.digest)? {
            Some(now) if now != *row => self.check_once(&now).await,
            _ => Ok(checked),
        }
    }

    async fn check_once(&self, row: &RecordRow) -> Result<(Verdict, Digest)> {
        // Never from the cache: a check is of what is on the disk.
        let stored = block_in_place(|| match row.deleted_at {
            None => self.plant.ciphertext.get(row.digest),
            Some(_) => Ok(None),
        });
        let Some(blob) = stored? else {
            return Ok((self.check_gone(row).await?, row.digest));
        };
        let digest = Digest(self.plant.provider.sm3(&[&blob]));
        let anchor = self.anchor(row).await?;
        let signer = block_in_place(|| authority::key_of(self.plant, self.network, row))?;
        let checked = signer.and_then(|signer| check(self.plant.provider, &blob, &row.signature, &signer, anchor).ok());
        let sound = checked.filter(|(header, ..)| columns::header_difference(row, header).is_none());
        Ok((sound.map_or(Verdict::Tampered, |(_, _, verdict)| verdict), digest))
    }

    /// The verdict on a record whose bytes are gone: an alarm, unless a retention record on the chain names it.
    async fn check_gone(&self, row: &RecordRow) -> Result<Verdict> {
        let Some(retained) = self.given_up(row)? else {
            let text = format!("the ciphertext of record {} is missing, but no retention record names it", row.id);
            self.plant.observer.alert(true, text);
            return Ok(Verdict::Missing);
        };
        let signer = block_in_place(|| authority::key_of(self.plant, self.network, row))?;
        let signed = signer.is_some_and(|signer| {
            check_deleted(self.plant.provider, &retained.header, row.digest, &row.signature, &signer).is_ok()
        });
        Ok(match (signed, self.anchor(row).await?) {
            (true, Anchor::Chain(_)) => Verdict::Deleted,
            (true, Anchor::Remembered(_)) => Verdict::NotChecked,
            // Its anchor is not confirmed here yet, or not any more.
            (true, _) if row.state < RecordState::Confirmed => Verdict::Unanchored,
            (true | false, _) => Verdict::Tampered,
        })
    }

    fn given_up(&self, row: &RecordRow) -> Result<Option<Retained>> {
        let retained = self.plant.ledger.retention.find(row.digest)?;
        let stated = |retained: &Retained| is_stated(self.plant, Some(self.network), row.digest, retained);
        Ok(retained.filter(|retained| retained.anchored || stated(retained)))
    }

    async fn anchor(&self, row: &RecordRow) -> Result<Anchor> {
        let confirmed = matches!(row.state, RecordState::Confirmed | RecordState::Verified | RecordState::Tampered);
        let (anchored, digest) = match self.network.absent {
            _ if !confirmed => return Ok(Anchor::Unanchored),
            None => (chain_proofs::is_anchored(self.plant, self.network, row).await?, Anchor::Chain(row.digest)),
            Some(_) => (block_in_place(|| chain_proofs::was_sighted(self.plant, row))?, Anchor::Remembered(row.digest)),
        };
        Ok(if anchored { digest } else { Anchor::Unanchored })
    }

    /// `Tampered` if a check fails, `Refused` if no key of this reader opens it or its signer wrote a false name into
    /// it; a missing blob counts as tampering too.
    pub async fn open(&self, row: &RecordRow) -> Result<OpenedRecord> {
        self.authorise(row)?;
        let Some(blob) = block_in_place(|| self.plant.stored_bytes(row))? else {
            let given_up = self.given_up(row)?;
            let why = given_up.map(|retained| PipelineError::gone(&row.id, retained));
            return Err(why.unwrap_or_else(|| PipelineError::Missing(row.id.clone())));
        };
        self.open_bytes(row, &blob).await
    }

    /// Like [`Self::open`], for bytes that the store need not have.
    pub async fn open_bytes(&self, row: &RecordRow, blob: &[u8]) -> Result<OpenedRecord> {
        self.authorise(row)?;
        self.compare(row, blob)?;
        let anchor = self.anchor(row).await?;
        let signer = block_in_place(|| authority::signer_of(self.plant, self.network, row))?;
        let signer = signer.map_err(|why| PipelineError::NoRight { id: row.id.clone(), why: Box::new(why) })?;
        let (key, names) = block_in_place(|| self.opening_of(row.owner, row.epoch, row.topic_id))?;
        let expected = Expected {
            domain: self.network.domain,
            owner: row.owner,
            recorder: Some(row.recorder),
            epoch: Some(row.epoch),
            seq: Some(row.seq),
            topic_id: Some(row.topic_id),
            names,
        };
        let opened = open(self.plant.provider, blob, &row.signature, &signer, anchor, &key, &expected)?;
        let differs = |field| PipelineError::RowDiffers { id: row.id.clone(), field };
        // A record that is only about to be kept here has no place that it could contradict.
        let placed = self.plant.ledger.records.placed(row.digest)?;
        let here = self.plant.ledger.records.recorder();
        let found = columns::header_difference(row, &opened.header)
            .or_else(|| columns::head_difference(row, &opened.head, here))
            .or_else(|| placed.as_ref().and_then(columns::anchor_difference));
        found.map_or(Ok(opened), |field| Err(differs(field)))
    }

    /// Whether the row agrees with the header of the stored bytes; if these were altered, that is reported instead.
    fn compare(&self, row: &RecordRow, blob: &[u8]) -> Result<()> {
        let header = Header::parse(blob).map(|(header, _)| header);
        match header.ok().and_then(|header| columns::header_difference(row, &header)) {
            Some(field) if Digest(self.plant.provider.sm3(&[blob])) == row.digest => {
                Err(PipelineError::RowDiffers { id: row.id.clone(), field })
            }
            _ => Ok(()),
        }
    }

    pub fn topic_key(&self, row: &RecordRow) -> Result<TopicKey> {
        Ok(self.opening_of(row.owner, row.epoch, row.topic_id)?.0)
    }

    /// The key of a topic in an epoch, and what the names of its records are compared with: IK for an owner and for
    /// readers of all topics, otherwise the name that the owner gave with the key.
    pub(crate) fn opening_of(&self, owner: Address, epoch: u64, topic: TopicId) -> Result<(TopicKey, Names)> {
        if owner == self.reader.address {
            let epoch_key =
                self.reader.epoch_key(self.network.domain, epoch).ok_or(PipelineError::UnknownEpoch(epoch))?;
            return Ok((topic_key(&epoch_key, &topic), Names::Derived(self.reader.index())));
        }
        if let Ok(ReadingRight::Granted(grant)) = self.right(owner, None) {
            let envelopes = self.envelopes(&grant)?;
            if let Some(found) = envelopes.iter().find_map(|wrapped| find_opening(&wrapped.keys, epoch, topic)) {
                return Ok(found);
            }
        }
        Err(CryptoError::WrongKey.into())
    }

    pub fn epochs_of(&self, owner: Address) -> Result<BTreeSet<u64>> {
        if owner == self.reader.address {
            return Ok(self.reader.epochs(self.network.domain).into_iter().collect());
        }
        let Ok(ReadingRight::Granted(grant)) = self.right(owner, None) else { return Ok(BTreeSet::new()) };
        let mut epochs = BTreeSet::new();
        for wrapped in self.envelopes(&grant)? {
            match &wrapped.keys {
                GrantedKeys::All { epochs: keys, .. } => epochs.extend(keys.iter().map(|(epoch, _)| *epoch)),
                GrantedKeys::Topics { keys } => epochs.extend(keys.iter().map(|(epoch, ..)| *epoch)),
            }
        }
        Ok(epochs)
    }

    /// The contents of a grant's envelopes that this reader can open, the newest epoch first.
    pub fn envelopes(&self, grant: &Granted) -> Result<Vec<Arc<WrappedKeys>>> {
        let all = kept::envelopes(&self.plant.ledger.rights, grant)?;
        Ok(all.iter().filter_map(|envelope| self.open_one(grant, envelope).ok()).collect())
    }

    /// Opens a grant's envelope for an epoch: the newest that this reader has the key for.
    pub fn open_envelope(&self, grant: &Granted, epoch: u64) -> Result<Arc<WrappedKeys>> {
        let mut all = kept::envelopes(&self.plant.ledger.rights, grant)?;
        all.retain(|envelope| envelope.epoch == epoch);
        first_good(all.iter().map(|envelope| self.open_one(grant, envelope)))
            .unwrap_or_else(|| Err(CryptoError::WrongKey.into()))
    }

    /// Opens an envelope with the keys of its time: signed with the key its owner had registered then, encrypted to the
    /// one the reader had.
    fn open_one(&self, grant: &Granted, envelope: &KeptEnvelope) -> Result<Arc<WrappedKeys>> {
        let (epoch, bytes) = (envelope.epoch, &envelope.bytes);
        let digest = Digest(self.plant.provider.sm3(&[bytes]));
        if let Some(known) = self.reader.opened.lock().unwrap_or_else(PoisonError::into_inner).get(&digest) {
            return Ok(Arc::clone(known));
        }
        let terms = GrantTerms { epoch, ..grant.terms.clone() };
        let owner = self.network.directory.identities_at(grant.terms.owner, envelope.block);
        let secrets = self.reader.envelopes();
        let pairs = owner.iter().flat_map(|owner| secrets.iter().map(move |reader| (owner, reader)));
        let (provider, domain) = (self.plant.provider, &self.network.domain);
        let opened =
            pairs.map(|(owner, reader)| Ok(unwrap(provider, domain, bytes, &terms, &owner.signing, &reader.secret)?));
        let wrapped = first_good(opened).unwrap_or(Err(PipelineError::BadIdentity(grant.terms.owner)))?;
        let wrapped = Arc::new(wrapped);
        self.reader.opened.lock().unwrap_or_else(PoisonError::into_inner).insert(digest, Arc::clone(&wrapped));
        Ok(wrapped)
    }

    /// IK of an owner: the reader's own, or the one that a grant of all topics carries.
    pub fn index_of(&self, owner: Address) -> Option<IndexKey> {
        if owner == self.reader.address {
            return Some(self.reader.index());
        }
        let Ok(ReadingRight::Granted(grant)) = self.right(owner, None) else { return None };
        let index = |wrapped: Arc<WrappedKeys>| match &wrapped.keys {
            GrantedKeys::All { index_key, .. } => Some(index_key.clone()),
            GrantedKeys::Topics { .. } => None,
        };
        self.envelopes(&grant).unwrap_or_default().into_iter().find_map(index)
    }

    /// The topics that this reader may read now.
    pub fn scope(&self, owner: Address) -> Option<Scope> {
        self.right(owner, None).ok().map(|right| right.scope().clone())
    }

    /// `None` if the bytes are gone or do not open. Waits for the store.
    pub fn own_contents(&self, row: &RecordRow) -> Result<Option<OpenedRecord>> {
        Ok(self.own_bytes(row)?.map(|blob| self.open_own(row, &blob)).transpose()?.flatten())
    }

    /// Opened by what the home itself knows; without those that do not open.
    pub fn own_opened(&self, query: RecordQuery) -> impl Iterator<Item = Result<(RecordRow, OpenedRecord)>> {
        let query = RecordQuery { owner: Some(self.reader.address), ..query };
        self.plant.ledger.records.all(query).filter_map(|row| match row {
            Ok(row) => Some(self.own_contents(&row).transpose()?.map(|opened| (row, opened))),
            Err(error) => Some(Err(error.into())),
        })
    }

    pub fn own_bytes(&self, row: &RecordRow) -> Result<Option<Vec<u8>>> {
        Ok(self.plant.stored_bytes(row)?)
    }

    /// Opens an own record with the key of the owner or of a device; `None` if it does not open, or has a false name.
    pub fn open_own(&self, row: &RecordRow, blob: &[u8]) -> Result<Option<OpenedRecord>> {
        let Some(signer) = self.own_signer(row.signer)?.filter(|_| row.owner == self.reader.address) else {
            return Ok(None);
        };
        let Ok(key) = self.topic_key(row) else { return Ok(None) };
        let names = Names::Derived(self.reader.index());
        let expected = Expected::any_of(self.network.domain, row.owner, names);
        Ok(open(self.plant.provider, blob, &row.signature, &signer, Anchor::Unanchored, &key, &expected).ok())
    }

    fn own_signer(&self, signer: SignerId) -> Result<Option<PublicKey>> {
        match self.own_keys().into_iter().find(|key| signer_id(key) == signer) {
            Some(key) => Ok(Some(key)),
            None => Ok(self.plant.ledger.bindings.signer(signer)?),
        }
    }

    /// The signing keys that the reader's account has or ever registered.
    fn own_keys(&self) -> Vec<PublicKey> {
        let mut keys = vec![self.reader.signing().public];
        self.network.directory.with_account(self.reader.address, |account| {
            keys.extend(account.into_iter().flat_map(|account| &account.identities).map(|known| known.signing));
        });
        keys
    }

    /// Whether the key with this id is, or was, the reader's own signing key, and no device's.
    pub fn is_own_key(&self, signer: SignerId) -> bool {
        self.own_keys().iter().any(|key| signer_id(key) == signer)
    }
}

/// The first success; the first failure if there is none; `None` for an empty list.
fn first_good<T>(mut results: impl Iterator<Item = Result<T>>) -> Option<Result<T>> {
    let first = results.next()?;
    Some(first.or_else(|error| results.find_map(Result::ok).ok_or(error)))
}

impl columns::Keys for Reader<'_> {
    fn opening(&self, header: &Header) -> Option<(TopicKey, Names)> {
        self.opening_of(header.owner, header.epoch, header.topic_id).ok()
    }

    fn index_key(&self, row: &RecordRow) -> Option<IndexKey> {
        self.index_of(row.owner)
    }
}

/// Whether a record is for its owner only: quarantined, or discarded.
pub fn is_held(row: &RecordRow) -> bool {
    matches!(row.state, RecordState::Quarantined | RecordState::Dropped)
}

fn find_opening(keys: &GrantedKeys, epoch: u64, topic: TopicId) -> Option<(TopicKey, Names)> {
    match keys {
        GrantedKeys::All { epochs, index_key } => {
            let found = epochs.iter().find(|(number, _)| *number == epoch);
            found.map(|(_, key)| (topic_key(key, &topic), Names::Derived(index_key.clone())))
        }
        GrantedKeys::Topics { keys } => {
            let found = keys.iter().find(|(number, _, id, _)| (*number, *id) == (epoch, topic));
            found.map(|(_, name, _, key)| (key.clone(), Names::Given(name.clone())))
        }
    }
}

// The definition that a message names: its own recorder wrote it, shortly before it, one of perhaps thousands. A
// message of ROS 2 that names an empty one was captured before its definition was known; its type's hash then names
// it, so a later record, or another recorder's, serves as well.

/// The most definition records opened at each attempt.
const MOST_OPENED: usize = 200;
/// The most that each attempt lists from the ledger.
const MOST_LISTED: usize = 10_000;
/// The most texts that are kept.
const MOST_KEPT: usize = 1024;

/// What decides about a message's definition within an epoch: its owner, topic, digest, type and the type's hash.
type Key = (Address, TopicId, u64, Digest, String, Option<String>);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Opening {
    /// As every record that is read: with its anchor and its reader's rights.
    Anchored,
    /// As the owner's own, without the chain.
    Own,
}

/// Definitions found so far, so that opening many messages looks each one up once.
#[derive(Default)]
pub struct Definitions(HashMap<Key, Arc<str>>);

impl Definitions {
    pub async fn text(
        &mut self,
        reader: &Reader<'_>,
        row: &RecordRow,
        opened: &OpenedRecord,
        by: Opening,
    ) -> Result<Option<Arc<str>>> {
        let key = key(row, opened);
        match self.0.get(&key) {
            Some(known) => Ok(Some(Arc::clone(known))),
            None => Ok(reader.definition_text(row, opened, by).await?.map(|text| self.keep(key, text))),
        }
    }

    fn keep(&mut self, key: Key, text: String) -> Arc<str> {
        if self.0.len() >= MOST_KEPT {
            self.0.clear();
        }
        Arc::clone(self.0.entry(key).or_insert_with(|| text.into()))
    }
}

fn key(row: &RecordRow, opened: &OpenedRecord) -> Key {
    let head = &opened.head;
    (row.owner, row.topic_id, row.epoch, head.definition, head.type_name.clone(), hash_of(head))
}

/// The hash of a message's type, if its publisher or its recording gave it.
fn hash_of(head: &Head) -> Option<String> {
    head.tags.get(&format!("{CHANNEL}{TYPE_HASH}")).filter(|hash| !hash.is_empty()).cloned()
}

impl Reader<'_> {
    /// The text of the definition that an opened message names, from its owner's definition records, as its publisher
    /// gave it; for a message that names an empty one, a text that has its type's hash.
    pub async fn definition_text(&self, row: &RecordRow, opened: &OpenedRecord, by: Opening) -> Result<Option<String>> {
        let wanted = Wanted::of(opened);
        for query in wanted.attempts(row) {
            let listed = self.plant.ledger.records.list(&query)?.rows;
            let may_open = |candidate: &&RecordRow| by == Opening::Own || candidate.epoch == row.epoch;
            for candidate in listed.iter().filter(may_open).take(MOST_OPENED) {
                let found = match by {
                    Opening::Anchored => self.open(candidate).await.ok(),
                    Opening::Own => block_in_place(|| self.own_contents(candidate))?,
                };
                if let Some(found) = found.filter(|found| wanted.is_in(found)) {
                    return Ok(Some(String::from_utf8_lossy(&found.body).into_owned()));
                }
            }
        }
        Ok(wanted.otherwise())
    }
}

struct Wanted {
    /// `None` if the message names an empty one.
    digest: Option<Digest>,
    /// Type and hash, for a message that names an empty one and whose type is not built into this program.
    by_hash: Option<(String, String)>,
}

impl Wanted {
    fn of(opened: &OpenedRecord) -> Self {
        let head = &opened.head;
        let digest = (head.definition.0 != sm3(&[])).then_some(head.definition);
        let hash = hash_of(head).filter(|hash| digest.is_none() && !is_built_in(&head.type_name, hash));
        Self { digest, by_hash: hash.map(|hash| (head.type_name.clone(), hash)) }
    }

    /// By digest: the topic's definition records of the message's recorder from before it, all of that recorder, all
    /// there are; the newest first. By hash: those of the recorder from the message on, the oldest first, and then all.
    fn attempts(&self, row: &RecordRow) -> Vec<RecordQuery> {
        let all = RecordQuery {
            owner: Some(row.owner),
            topic_ids: Some(vec![row.topic_id]),
            kind: Some(RecordKind::Definition),
            limit: MOST_LISTED,
            newest_first: true,
            ..RecordQuery::default()
        };
        let of_recorder = RecordQuery { recorder: Some(row.recorder), ..all.clone() };
        if self.by_hash.is_some() {
            let after =
                RecordQuery { since: Some(row.captured_at), limit: MOST_OPENED, newest_first: false, ..of_recorder };
            return vec![after, all];
        }
        if self.digest.is_none() {
            return Vec::new();
        }
        let until = Timestamp(row.captured_at.0.saturating_add(1));
        let before = RecordQuery { until: Some(until), limit: MOST_OPENED, ..of_recorder.clone() };
        vec![before, of_recorder, all]
    }

    fn is_in(&self, found: &OpenedRecord) -> bool {
        let text = || std::str::from_utf8(&found.body).ok().filter(|text| !text.is_empty());
        match &self.by_hash {
            Some((type_name, hash)) => {
                found.head.type_name == *type_name
                    && text().is_some_and(|text| type_hash(type_name, text).is_ok_and(|found| found == *hash))
            }
            None => self.digest.is_some_and(|digest| sm3(&[&found.body]) == digest.0),
        }
    }

    fn otherwise(&self) -> Option<String> {
        self.digest.is_none().then(String::new)
    }
}

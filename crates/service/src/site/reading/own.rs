//! A profile's own records: lists, provenance, export for third parties to check.

use std::collections::HashMap;
use std::sync::Arc;

use tokio::task::block_in_place;

use crate::command::UploadQuery;
use crate::crypto::{CryptoError, IndexKey, Names, TopicKey, keyfile, record, topic_id, topic_key};
use crate::model::{
    Address, Digest, Header, ProfileName, RecordKind, RecordState, Timestamp, TopicId, TopicPattern, TopicPatterns,
    Verdict, clean, counted, hex, locked,
};
use crate::pipeline::columns::{self, Caveat, Comparison, Keys, Refusal, ShownState};
use crate::pipeline::retention::is_stated;
use crate::pipeline::{Network, Owner, PipelineError, Reader, Shown, authority, tag_choice};
use crate::reply::{ExportedFile, Failure, Provenance, RecordPage, RecordView, Result, input, internal};
use crate::site::Reading;
use crate::site::identity::Owners;
use crate::site::incidents::narrowed;
use crate::store::{self, BatchPlace, FilterChoice, PlacedRecord, RecordQuery, RecordRow};

impl Reading {
    /// Needs no passphrase.
    pub async fn list_own(&self, profile: &ProfileName, query: UploadQuery) -> Result<RecordPage> {
        let owner = self.parts.owners.address_of(profile)?;
        let index = self.parts.owners.get(profile).map(|owner| owner.index());
        self.name_asked(owner, index, query.topic.as_ref())?;
        self.learn_own_names(profile).await?;
        let filters = self.own_tag_filters(profile, &query.tags)?;
        let incident = query.incident.clone();
        let query = self.of_robot(&[owner], query)?;
        let query = RecordQuery { owner: Some(owner), filters: filters.clone(), ..query };
        let ledger = &self.parts.plant.ledger;
        let page = block_in_place(|| {
            let query = match incident {
                Some(name) => narrowed(&ledger.incidents, owner, &name, query)?,
                None => query,
            };
            Ok::<_, Failure>(ledger.records.list(&query)?)
        })?;
        self.page_of(page, &self.own_keys(), &filters, false)
    }

    /// Records of all profiles of the home; needs no passphrase.
    pub fn list_all(&self, query: UploadQuery) -> Result<RecordPage> {
        if query.incident.is_some() {
            return Err(input("an incident belongs to one profile: omit --all, or the incident".to_owned()));
        }
        let owners = self.parts.owners.accounts();
        let query = RecordQuery { owners: Some(owners.clone()), ..self.of_robot(&owners, query)? };
        let page = self.parts.plant.ledger.records.list(&query)?;
        self.page_of(page, &self.own_keys(), &[], true)
    }

    /// A page of the ledger as shown; `with_owner` for lists of other owners' records.
    pub(super) fn page_of(
        &self,
        page: store::RecordPage,
        keys: &dyn Keys,
        filters: &[FilterChoice],
        with_owner: bool,
    ) -> Result<RecordPage> {
        let mut page = record_page(&self.compared(page.rows, keys, filters)?, page.next, with_owner);
        self.note_erased(&mut page.records)?;
        if with_owner {
            let names = self.contacts.names()?;
            for record in &mut page.records {
                record.owner_name = record.owner.and_then(|owner| names.get(&owner).cloned());
            }
        }
        Ok(page)
    }

    /// Filter ids of a profile's own tags, derived from IK.
    fn own_tag_filters(&self, profile: &ProfileName, tags: &[(String, String)]) -> Result<Vec<FilterChoice>> {
        if tags.is_empty() {
            return Ok(Vec::new());
        }
        // IK stays in memory while the keyring is locked: records are sealed with it.
        let opened = self.parts.owners.get(profile);
        let index = opened.map_or_else(|| self.parts.owners.unlocked(profile), Ok)?.index();
        let topics = self.topics_of(self.parts.owners.address_of(profile)?)?;
        Ok(tags.iter().map(|(name, value)| tag_choice(&index, name, value, &topics)).collect())
    }

    /// Adds who had deleted records erased.
    pub(super) fn note_erased(&self, records: &mut [RecordView]) -> Result<()> {
        let gone = ShownState::Verified(Caveat::Deleted);
        for record in records.iter_mut().filter(|record| record.state == gone) {
            let retained = self.parts.plant.ledger.retention.find(record.digest)?;
            record.erased = retained.and_then(|retained| retained.erased).map(|erasure| erasure.to_string());
        }
        Ok(())
    }

    pub fn topics_of(&self, owner: Address) -> Result<Vec<TopicId>> {
        let counts = self.parts.plant.ledger.counts.by_state(Some(owner))?;
        Ok(counts.topics.iter().filter_map(|topic| topic.topic_id).collect())
    }

    /// A record of any owner.
    pub fn find_record(&self, id: &str) -> Result<RecordRow> {
        let row = self.parts.plant.ledger.records.by_id(id)?;
        Ok(row.ok_or_else(|| PipelineError::NoRecord(clean(id, 64)))?)
    }

    pub fn own_record(&self, profile: &ProfileName, id: &str) -> Result<RecordRow> {
        let row = self.find_record(id)?;
        match row.owner == self.parts.owners.address_of(profile)? {
            true => Ok(row),
            false => Err(PipelineError::NoRecord(row.id).into()),
        }
    }

    pub fn provenance(&self, profile: &ProfileName, id: &str) -> Result<Provenance> {
        let shown = self.compared_one(&self.own_record(profile, id)?, &self.own_keys())?;
        let row = &shown.row;
        let topic = clean(&row.topic, 255);
        let of = if row.is_named() { topic.as_str() } else { "a topic whose name is unknown here" };
        let mut steps = vec![
            step("message", format!("{} bytes of {of}, captured {}", row.bytes, row.captured_at.in_milliseconds())),
            step(
                "record",
                format!("epoch {}, seq {}, on disk {}", row.epoch, row.seq, row.acknowledged_at.in_milliseconds()),
            ),
            step("digest", format!("SM3 {}", row.digest)),
            step("signature", format!("SM2 by signer {}", row.signer)),
        ];
        if row.state >= RecordState::Stored {
            steps.push(step("store", "ciphertext stored with its row".to_owned()));
        }
        let ledger = &self.parts.plant.ledger;
        if let Some(placed) = ledger.records.placed(row.digest)? {
            let head = *self.parts.link.scans().borrow();
            steps.extend(anchor_steps(placed, head, self.parts.config.confirmations));
        }
        if let Some(retained) = ledger.retention.find(row.digest)? {
            let done = retained.deleted_at.map_or("to be deleted".to_owned(), |at| format!("ciphertext deleted {at}"));
            steps.push(step("retention", format!("{done}; named in retention record {}", retained.report)));
            steps.extend(retained.erased.map(|erasure| step("erased", erasure.to_string())));
        }
        steps.push(match (shown.differs, shown.state()) {
            (Some(field), state) => step(state.word(), altered(field)),
            (None, state @ ShownState::Refused(Refusal::FalseName)) => {
                step(state.word(), misnamed(shown.false_name.unwrap_or("name")))
            }
            (None, state @ ShownState::Verified(Caveat::Unread)) => {
                step(state.word(), "verified earlier; its bytes are not here to compare now".to_owned())
            }
            (None, state @ ShownState::Verified(Caveat::NamesUnchecked)) => step(state.word(), unchecked()),
            (None, ShownState::Verified(Caveat::Deleted) | ShownState::Kept(_)) => {
                step(row.state.word(), standing(row.state).to_owned())
            }
        });
        let mut record = record_view(&shown, false);
        self.note_erased(std::slice::from_mut(&mut record))?;
        Ok(Provenance { record, steps })
    }

    /// Files for checking a record with openssl and a node; `proof.json` redacts accounts unless `addresses`.
    pub async fn export_upload(&self, owner: &Owner, id: &str, addresses: bool) -> Result<Vec<ExportedFile>> {
        let row = self.own_record(&owner.profile, id)?;
        let network = self.network_or_kept().await?;
        let files = self.files_of(&network, &row, addresses);
        self.parts.log.deed(&owner.profile, "export record", &row.id, files).await
    }

    async fn files_of(&self, network: &Network, row: &RecordRow, addresses: bool) -> Result<Vec<ExportedFile>> {
        let (plant, digest) = (&self.parts.plant, row.digest);
        let blob = block_in_place(|| plant.stored_bytes(row))?;
        let placed = plant.ledger.records.placed(digest)?;
        // Block, transaction and path of one moment, whatever `row` was.
        let (row, place) = placed.map_or_else(|| (row.clone(), None), PlacedRecord::anchor);
        let row = &row;
        let gone = plant.ledger.retention.find(digest)?;
        let gone = gone.filter(|gone| gone.anchored || is_stated(plant, Some(network), digest, gone));
        let blob = blob.ok_or_else(|| match gone {
            Some(retained) => PipelineError::gone(&row.id, retained),
            None => PipelineError::Missing(row.id.clone()),
        })?;
        let header = crate::model::Header::parse(&blob).ok().map(|(header, _)| header);
        if let Some(field) = header.as_ref().and_then(|header| columns::header_difference(row, header)) {
            return Err(PipelineError::RowDiffers { id: row.id.clone(), field }.into());
        }
        let signer = block_in_place(|| authority::signer_of(plant, network, row))?;
        let signer = signer.map_err(|why| PipelineError::NoRight { id: row.id.clone(), why: Box::new(why) })?;
        let signed = record::signed_bytes(&network.domain, &row.digest);
        let pin = network.chain.pin();
        // The record's header and leaf must contain the owner: only the files beside them are redacted.
        let shown = |account: Address| if addresses { account.to_string() } else { account.redacted() };
        let mut anchor = anchor_json(row, place.as_ref(), &shown);
        let block = match row.block {
            Some(number) => network.chain.block(number).await.ok().flatten(),
            None => None,
        };
        if let Some(block) = block.filter(|block| row.block_hash == Some(block.hash)) {
            // By the sealers' clock: a verifier compares it with the chain's own.
            anchor["block_time"] = serde_json::json!(Timestamp::from_seconds(block.timestamp));
        }
        let proof = serde_json::json!({
            "format": "authros-proof/1",
            "digest": row.digest,
            "signed_message_hex": hex(&signed),
            "signature_id": "1234567812345678",
            "owner": shown(row.owner),
            "addresses": if addresses { "full" } else { "redacted" },
            "signer": row.signer,
            "signing_key": signer,
            "epoch": row.epoch,
            "recorder": row.recorder,
            "topic_id": row.topic_id,
            "seq": row.seq,
            "domain": network.domain,
            "chain_id": network.chain.chain_id(),
            "genesis": network.chain.genesis(),
            "contract": pin.map(|pin| pin.contract),
            "anchor": anchor,
            "state": row.state.word(),
        });
        let proof = serde_json::to_vec_pretty(&proof).map_err(|error| internal(error.to_string()))?;
        let file = |name: &str, bytes: Vec<u8>| ExportedFile { name: name.to_owned(), bytes };
        Ok(vec![
            file("record.bin", blob),
            file("signature.bin", crate::crypto::signature_der(&row.signature)),
            file("signer.pem", keyfile::sm2_public_pem(&signer)?.into_bytes()),
            file("message.bin", signed),
            file("proof.json", proof),
        ])
    }
}

/// A row and its record differ.
fn altered(field: &str) -> String {
    format!(
        "the ledger was altered: its row differs from the record in its {field}; the record's own value is shown, \
         `authros audit` lists every such row"
    )
}

fn step(word: &str, text: String) -> (String, String) {
    (word.to_owned(), text)
}

/// The one anchor that the record rests on: its batch's, or that of its own upload.
fn anchor_steps(placed: PlacedRecord, head: u64, wanted: u64) -> Vec<(String, String)> {
    let (row, place) = placed.anchor();
    let mut steps = Vec::new();
    if let Some(place) = &place {
        let inclusion = &place.inclusion;
        steps.push(step("batch", format!("root {}, closed {}", inclusion.root, place.closed_at.in_milliseconds())));
        let (index, count, hashes) =
            (inclusion.index + 1, inclusion.count, counted(inclusion.path.len() as u64, "hash"));
        steps.push(step("proof", format!("leaf {index} of {count}, {hashes} to the root")));
        steps.extend(place.account.map(|account| step("anchored by", account.to_string())));
    }
    steps.extend(row.transaction.map(|transaction| step("transaction", transaction.to_string())));
    if let (Some(block), Some(hash)) = (row.block, row.block_hash) {
        steps.push(step("block", format!("{block} {hash}")));
        // A run without a chain has seen no block.
        let deep = head + 1 - block.min(head + 1);
        steps.extend((head >= block).then(|| step("confirmations", format!("{deep}, of which {wanted} required"))));
    }
    steps
}

/// The signer wrote a false name into the record.
fn misnamed(what: &str) -> String {
    format!(
        "its bytes are as they were sealed and signed, but its signer wrote a false {what} into it, which does not \
         belong to the pseudonym it is filed under: what it says is not shown; if the signer is a device of yours, \
         revoke it"
    )
}

/// A verified record that no key here opens.
fn unchecked() -> String {
    format!(
        "{}; topic, type, length and SIMULATED mark are only the ledger's claim: they are sealed, and no keyring is \
         open here; check again while the console or `authros serve` has the keyring open",
        standing(RecordState::Verified)
    )
}

/// What a record's state means, for readers who wonder what is still to come.
fn standing(state: RecordState) -> &'static str {
    match state {
        RecordState::Captured => "in memory, not on the disk yet",
        RecordState::Stored => "in the store; waiting to be anchored",
        RecordState::Batched => "in a closed batch; its root is waiting to be sent",
        RecordState::Submitted => "its transaction was sent; waiting for a block",
        RecordState::Mined => "in a block; waiting for confirmations",
        RecordState::Confirmed => "confirmed; about to be read back from the store",
        RecordState::Verified => "read back from the store: digest matches the chain, signature valid",
        RecordState::Quarantined => "quarantined: sent by a node that is not the pinned publisher",
        RecordState::Dropped => "discarded and counted",
        RecordState::RightEnded => {
            "in the store; its signer may not sign for its owner now, so it is not anchored; it resumes when the owner \
             is restored or the device's authorisation is renewed"
        }
        RecordState::Tampered => "the stored bytes are not the ones anchored and signed",
    }
}

/// The digest's place on the chain, with the path to the root if it was batched.
fn anchor_json(row: &RecordRow, place: Option<&BatchPlace>, shown: &dyn Fn(Address) -> String) -> serde_json::Value {
    let (transaction, block, block_hash) = (row.transaction, row.block, row.block_hash);
    let Some(place) = place else {
        return serde_json::json!({
            "mode": "each", "transaction": transaction, "block": block, "block_hash": block_hash,
        });
    };
    let inclusion = &place.inclusion;
    serde_json::json!({
        "mode": "batch",
        "leaf": row.leaf().hash(),
        "index": inclusion.index,
        "count": inclusion.count,
        "path": inclusion.path,
        "root": inclusion.root,
        "account": place.account.map(shown),
        "transaction": transaction,
        "block": block,
        "block_hash": block_hash,
    })
}

/// Characters; ROS names are shorter.
const WIDEST: usize = 255;

/// Records of a stream opened to learn its names: among a stolen robot's, some are false.
const TRIES: usize = 8;
/// Records not opened again for their names.
const MOST_NAMELESS: usize = 8192;

pub(in crate::site) struct OwnKeys(HashMap<Address, Arc<Owner>>);

impl OwnKeys {
    pub fn of(owners: &Owners) -> Self {
        Self(owners.all().into_iter().map(|owner| (owner.address, owner)).collect())
    }
}

impl Keys for OwnKeys {
    fn opening(&self, header: &Header) -> Option<(TopicKey, Names)> {
        let owner = self.0.get(&header.owner)?;
        let key = owner.epoch_key(header.domain, header.epoch)?;
        Some((topic_key(&key, &header.topic_id), Names::Derived(owner.index())))
    }

    fn index_key(&self, row: &RecordRow) -> Option<IndexKey> {
        // IK stays in memory while a keyring is locked: records are sealed with it.
        self.0.get(&row.owner).map(|owner| owner.index())
    }
}

/// Why a record was not checked against the chain.
pub(super) fn reason_of(verdict: Verdict, network: &Network) -> Option<String> {
    network.absent.as_ref().filter(|_| verdict == Verdict::NotChecked).map(ToString::to_string)
}

impl Reading {
    /// Keys of the profiles opened since the site began.
    pub fn own_keys(&self) -> OwnKeys {
        OwnKeys::of(&self.parts.owners)
    }

    /// Rows ready to be shown; each must have the ids in `filters` by which it was found.
    pub fn compared(&self, rows: Vec<RecordRow>, keys: &dyn Keys, filters: &[FilterChoice]) -> Result<Vec<Shown>> {
        let comparison = Comparison { plant: &self.parts.plant, keys, heads: &self.heads, filters };
        Ok(block_in_place(|| comparison.of(rows))?)
    }

    pub fn compared_one(&self, row: &RecordRow, keys: &dyn Keys) -> Result<Shown> {
        let shown = self.compared(vec![row.clone()], keys, &[])?.into_iter().next();
        Ok(shown.unwrap_or_else(|| Shown::unread(row.clone())))
    }

    /// Learns the names of the profile's own topics: robots' records arrive without.
    pub async fn learn_own_names(&self, profile: &ProfileName) -> Result<()> {
        let owner = self.parts.owners.get(profile).filter(|owner| !owner.is_locked());
        let (Some(owner), Some(network)) = (owner, self.parts.link.network_now()) else { return Ok(()) };
        let reader = Reader { plant: &self.parts.plant, network: &network, reader: &owner };
        self.learn_names(&reader, owner.address).await
    }

    /// Opens a record of each unnamed stream of `owner`, as far as the reader may.
    pub async fn learn_names(&self, reader: &Reader<'_>, owner: Address) -> Result<()> {
        let unnamed = self.parts.plant.ledger.names.unnamed(owner, TRIES)?;
        for stream in unnamed {
            for digest in stream {
                if self.learn_from(reader, digest).await? {
                    break;
                }
            }
        }
        Ok(())
    }

    /// Names the requested topic, if it is here only as a pseudonym. IK derives that from the name, so no record is
    /// opened or believed.
    pub fn name_asked(&self, owner: Address, index: Option<IndexKey>, topic: Option<&TopicPattern>) -> Result<()> {
        let name = topic.filter(|topic| topic.is_plain()).map(ToString::to_string);
        let (Some(index), Some(name)) = (index, name) else { return Ok(()) };
        let id = topic_id(&index, &name);
        Ok(self.parts.plant.ledger.names.keep_topic(owner, id, name)?)
    }

    /// Returns whether there were names to learn.
    async fn learn_from(&self, reader: &Reader<'_>, digest: Digest) -> Result<bool> {
        let tried = (reader.reader.address, digest);
        if locked(&self.nameless).contains(&tried) {
            return Ok(false);
        }
        let row = self.parts.plant.ledger.records.find(digest)?;
        let Some(row) = row else { return Ok(false) };
        let opened = match reader.open(&row).await {
            Ok(opened) => opened,
            Err(error) => {
                if matches!(error, PipelineError::Crypto(CryptoError::FalseName(_))) {
                    self.pass_over(tried);
                }
                return Ok(false);
            }
        };
        let (topic, type_name) = (opened.head.topic, opened.head.type_name);
        let with_type = !row.type_name.is_empty() && row.type_name != type_name;
        // Without IK the owner of the type's pseudonym is unknown: its name stays with each record.
        let with_type = with_type && reader.index_key(&row).is_some();
        if !with_type {
            self.pass_over(tried);
        }
        block_in_place(|| {
            let names = &self.parts.plant.ledger.names;
            names.keep(row.owner, hex(&row.topic_id.0), topic)?;
            if with_type {
                names.keep(row.owner, row.type_name, type_name)?;
            }
            Ok(true)
        })
    }

    /// Opens a record no more for its names.
    fn pass_over(&self, tried: (Address, Digest)) {
        let mut nameless = locked(&self.nameless);
        if nameless.len() >= MOST_NAMELESS {
            nameless.clear();
        }
        nameless.insert(tried);
    }
}

/// `with_owner` for lists of other owners' records.
pub(in crate::site) fn record_view(shown: &Shown, with_owner: bool) -> RecordView {
    let row = &shown.row;
    RecordView {
        id: row.id.clone(),
        owner: with_owner.then_some(row.owner),
        owner_name: None,
        seq: row.seq,
        topic: clean(&row.topic, WIDEST),
        type_name: clean(&row.type_name, WIDEST),
        kind: row.kind,
        state: shown.state(),
        digest: row.digest,
        bytes: row.bytes,
        captured_at: row.captured_at,
        epoch: row.epoch,
        simulated: row.simulated,
        transaction: row.transaction,
        block: row.block,
        compared: shown.compared,
        differs: shown.differs.map(str::to_owned),
        erased: None,
    }
}

pub fn record_page(rows: &[Shown], next: Option<String>, with_owner: bool) -> RecordPage {
    let records = rows.iter().map(|row| record_view(row, with_owner)).collect();
    RecordPage { records, next, arriving: None }
}

/// Captured messages unless another kind is requested.
pub(in crate::site) fn record_query(query: UploadQuery) -> RecordQuery {
    RecordQuery {
        topics: query.topic.into_iter().map(|topic| TopicPatterns(vec![topic])).collect(),
        type_name: query.type_name.map(|name| name.to_string()),
        words: query.words,
        kind: Some(query.kind.unwrap_or(RecordKind::Data)),
        state: query.state,
        since: query.since,
        until: query.until,
        after: query.after,
        limit: query.limit.clamp(1, 1000),
        newest_first: query.newest_first,
        ..RecordQuery::default()
    }
}

#[cfg(test)]
mod tests;

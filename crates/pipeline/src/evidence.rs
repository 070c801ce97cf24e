//! What an evidence bundle is assembled from: records from the store, their places in batches, and the chain's proofs
//! of their anchors and their signers' keys.

pub use authros_evidence::MOST_RECORDS;

use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;

use authros_evidence::{
    AnchorClaim, Anchoring, BlockHeader, BundledRecord, Disclosure, Height, Nodes, Packing, PackingError,
    PinnedAuthority, PinnedChain, Slot, Trust, time::StampTree,
};
use tokio::task::block_in_place;

use crate::chain::{AnchorProof, Chain, ChainError, SealerKind};
use crate::chain_proofs::{self, Shown as Wanted, anchor_proof};
use crate::columns::{self, Keys};
use crate::crypto::record::{RecordSecret, open_revealed};
use crate::crypto::{CryptoError, signer_id};
use crate::model::{
    Address, Birth, Digest, ErrorKind, Hash, Header, Heads, Heights, PublicKey, RecordState, RecorderId, SignerId,
    TopicId,
};
use crate::reader::{Opening, Reader};
use crate::recorder_heads::{TOPIC, tree};
use crate::store::{RecordQuery, RecordRow, Retained};
use crate::{PipelineError, Plant, Result, authority, chain::merkle::Inclusion, directory::kept, retention::is_stated};

/// The most kept headers after a block that are included.
const MOST_FURTHER: u64 = 16;

#[derive(Debug, Default)]
pub struct Gathered {
    pub packing: Packing,
    pub records: u64,
    pub revealed: u64,
    /// What is missing, in words.
    pub notes: Vec<String>,
}

struct Asked {
    digest: Digest,
    owner: Address,
    signer: SignerId,
    block: u64,
    keys: u64,
    anchor: Anchoring,
    record: BundledRecord,
}

impl Asked {
    fn root(&self) -> Option<Hash> {
        match &self.anchor {
            Anchoring::Each {} => None,
            Anchoring::Batch { root, .. } => Some(*root),
        }
    }
}

fn refused(error: PackingError) -> PipelineError {
    PipelineError::Refused(error.to_string())
}

/// Collects these records, the reader's own, and discloses the named ones; the suggested trust file names
/// `authorities`.
pub async fn gather(
    reader: &Reader<'_>,
    rows: &[RecordRow],
    reveal: &BTreeSet<Digest>,
    authorities: Vec<PinnedAuthority>,
) -> Result<Gathered> {
    let (mut gathered, mut asked, mut secrets) = (Gathered::default(), Vec::new(), BTreeMap::new());
    let Shown { rows: statements, heights, notes } = heights_shown(reader, rows).await?;
    gathered.notes = notes;
    let stated = statements.iter().map(|row| row.digest).collect::<BTreeSet<_>>();
    let known: BTreeSet<Digest> = rows.iter().map(|row| row.digest).collect();
    for row in rows.iter().chain(statements.iter().filter(|row| !known.contains(&row.digest))) {
        let Some((header, key, record)) = block_in_place(|| stored(reader, row, &mut gathered.notes))? else {
            continue;
        };
        gathered.packing.key(&key).map_err(refused)?;
        if reveal.contains(&row.digest) || stated.contains(&row.digest) {
            let secret = secret(reader, row, &header, &record.record, &mut gathered).await?;
            secrets.insert(row.digest, secret);
        }
        gathered.records += 1;
        gathered.revealed += u64::from(reveal.contains(&row.digest));
        match block_in_place(|| anchoring(reader, row))? {
            Some((block, anchor)) => {
                let keys = chain_proofs::key_version(reader.network, row.owner, block);
                let (digest, owner, signer) = (row.digest, row.owner, row.signer);
                asked.push(Asked { digest, owner, signer, block, keys, anchor, record });
            }
            None => gathered.packing.record(row.digest, record).map_err(refused)?,
        }
    }
    if !secrets.is_empty() {
        let keys = reader.reader.signing();
        let signed = Disclosure::sign(secrets, &reader.network.domain, &keys, reader.plant.provider);
        gathered.packing.disclosure(&signed.map_err(refused)?);
    }
    if !heights.is_empty() {
        gathered.packing.heights(heights).map_err(refused)?;
    }
    let roots = asked.iter().filter_map(Asked::root).collect();
    block_in_place(|| add(reader.plant, &roots, &mut gathered))?;
    let live = match &reader.network.absent {
        None => Some(Sealers::of(&reader.network.chain).await?),
        Some(why) => {
            gathered.notes.push(format!("the chain was not queried, so the bundle has the proofs kept here: {why}"));
            None
        }
    };
    let further = live.as_ref().map_or(MOST_FURTHER, |sealers| sealers.addresses.len() as u64 / 2);
    let headers = show(reader, asked, further, &mut gathered).await?;
    let sealers = live.unwrap_or_else(|| Sealers::shown(headers.values()));
    for (number, header) in headers {
        gathered.packing.header(number, header);
    }
    suggest(reader, sealers, authorities, &mut gathered)?;
    Ok(gathered)
}

/// The record's bytes, compared with its row, and the key that signed it.
fn stored(
    reader: &Reader<'_>,
    row: &RecordRow,
    notes: &mut Vec<String>,
) -> Result<Option<(Header, PublicKey, BundledRecord)>> {
    let plant = reader.plant;
    let Some(record) = plant.stored_bytes(row)? else {
        let known = |gone: &Retained| gone.anchored || is_stated(plant, Some(reader.network), row.digest, gone);
        let gone: Option<Retained> = plant.ledger.retention.find(row.digest)?.filter(known);
        return match gone {
            // What somebody had erased is no hole in the evidence that nobody explains: the rest is still evidence.
            Some(Retained { erased: Some(erasure), report, .. }) => {
                let text = "has no bytes in the bundle: it was";
                notes.push(format!("record {} {text} {erasure}, as retention record {report} says", row.id));
                Ok(None)
            }
            Some(retained) => Err(PipelineError::gone(&row.id, retained)),
            None => Err(PipelineError::Missing(row.id.clone())),
        };
    };
    let (header, _) = Header::parse(&record).map_err(CryptoError::DamagedRecord)?;
    if let Some(field) = columns::header_difference(row, &header) {
        return Err(PipelineError::RowDiffers { id: row.id.clone(), field });
    }
    let own = reader.reader.signing().public;
    let known = [Some(own), plant.ledger.bindings.signer(row.signer)?, authority::key_of(plant, reader.network, row)?];
    let Some(key) = known.into_iter().flatten().find(|key| signer_id(key) == row.signer) else {
        notes.push(format!("the key that signed record {} is unknown here; the record is not in the bundle", row.id));
        return Ok(None);
    };
    let record = BundledRecord { record, signature: row.signature, anchor: None };
    Ok(Some((header, key, record)))
}

fn anchoring(reader: &Reader<'_>, row: &RecordRow) -> Result<Option<(u64, Anchoring)>> {
    let placed = reader.plant.ledger.records.placed(row.digest)?;
    let Some(AnchorProof { account, block, inclusion, .. }) = placed.and_then(anchor_proof) else { return Ok(None) };
    let anchoring = match inclusion {
        Some(Inclusion { index, count, path, root }) => Anchoring::Batch { account, root, index, count, path },
        None => Anchoring::Each {},
    };
    Ok(Some((block, anchoring)))
}

/// A record's secret; the text of its definition is included.
async fn secret(
    reader: &Reader<'_>,
    row: &RecordRow,
    header: &Header,
    record: &[u8],
    gathered: &mut Gathered,
) -> Result<RecordSecret> {
    let plant = reader.plant;
    let opened = reader.open(row).await.map_err(|error| match error {
        PipelineError::Crypto(CryptoError::FalseName(what)) => PipelineError::Refused(format!(
            "record {} is not disclosed: its signer wrote a false {what} into it; reveal others, or none",
            row.id
        )),
        error => error,
    })?;
    if let Some(definition) = reader.definition_text(row, &opened, Opening::Anchored).await? {
        gathered.packing.definition(&definition, plant.provider);
    }
    let (key, _) = Keys::opening(reader, header).ok_or(CryptoError::WrongKey)?;
    let secret = RecordSecret::of(&key, header);
    open_revealed(plant.provider, record, &secret)?;
    Ok(secret)
}

/// Gets the chain's proof of every anchor: of the state at its own block if that is kept or the node still has it,
/// otherwise of a late one. Returns the headers of the blocks that show something, and of those that confirm them.
async fn show(
    reader: &Reader<'_>,
    asked: Vec<Asked>,
    further: u64,
    gathered: &mut Gathered,
) -> Result<BTreeMap<u64, Vec<u8>>> {
    let network = reader.network;
    let mut blocks: BTreeMap<u64, Vec<Asked>> = BTreeMap::new();
    asked.into_iter().for_each(|one| blocks.entry(one.block).or_default().push(one));
    let head = match network.absent {
        None => Some(network.chain.head().await?.number),
        Some(_) => None,
    };
    let (mut nodes, mut headers, mut identities) = (Nodes::default(), BTreeMap::new(), BTreeSet::new());
    identities.insert((reader.reader.address, chain_proofs::key_version(network, reader.reader.address, u64::MAX)));
    for (block, all) in blocks {
        let slots = slots(&all);
        let shown_at = match shown(reader, (block, head, further), &slots).await? {
            Some((at, found)) => {
                nodes.extend(found);
                add_headers(reader, at..=at.saturating_add(further), &mut headers).await?;
                at
            }
            None => {
                let text = format!("no state of block {block} or later can be proven: level (c) is not proven");
                gathered.notes.push(text);
                block
            }
        };
        for one in all {
            identities.insert((one.owner, one.keys));
            let anchor = Some(AnchorClaim::new(one.block, shown_at, one.keys, one.anchor));
            gathered.packing.record(one.digest, BundledRecord { anchor, ..one.record }).map_err(refused)?;
        }
    }
    for (account, version) in identities {
        if let Some(identity) = block_in_place(|| kept::identity(&reader.plant.ledger.rights, account, version))? {
            gathered.packing.identity(&identity);
        }
    }
    if !nodes.is_empty() {
        gathered.packing.nodes(&nodes);
    }
    Ok(headers)
}

/// The nodes that show these slots, and after which block; `None` if nothing proves them. No head: no chain to ask.
async fn shown(
    reader: &Reader<'_>,
    (block, head, further): (u64, Option<u64>, u64),
    slots: &[Slot],
) -> Result<Option<(u64, Nodes)>> {
    if let Some(found) = chain_proofs::kept(reader.plant, reader.network, block, slots).await? {
        return Ok(Some((block, found)));
    }
    let Some(head) = head else { return Ok(None) };
    if let Some(found) = state_nodes(reader, block, slots).await? {
        return Ok(Some((block, found)));
    }
    let late = head.saturating_sub(further).max(block);
    Ok(state_nodes(reader, late, slots).await?.map(|found| (late, found)))
}

/// Adds the headers of these blocks, up to the first that is not there.
async fn add_headers(
    reader: &Reader<'_>,
    blocks: RangeInclusive<u64>,
    headers: &mut BTreeMap<u64, Vec<u8>>,
) -> Result<()> {
    for block in blocks {
        if headers.contains_key(&block) {
            continue;
        }
        let Some(header) = chain_proofs::header(reader.plant, reader.network, block).await? else { break };
        headers.insert(block, header);
    }
    Ok(())
}

fn slots(all: &[Asked]) -> Vec<Slot> {
    let wanted = all.iter().map(|Asked { digest, owner, signer, keys, anchor, .. }| {
        let anchor = match anchor {
            Anchoring::Each {} => Slot::uploaded(*owner, &digest.0),
            Anchoring::Batch { account, root, .. } => Slot::anchor(*account, *root),
        };
        Wanted { owner: *owner, signer: *signer, keys: *keys, anchor }
    });
    chain_proofs::slots(wanted)
}

/// `None` if the node no longer has that state, or cannot prove anything.
async fn state_nodes(reader: &Reader<'_>, block: u64, slots: &[Slot]) -> Result<Option<Nodes>> {
    match reader.network.chain.storage_nodes(block, slots).await {
        Ok(nodes) => Ok(Some(nodes.into_iter().collect())),
        Err(error @ ChainError::Unreachable { .. }) => Err(error.into()),
        Err(error) if error.kind() == ErrorKind::Tampered => Err(error.into()),
        Err(_) => Ok(None),
    }
}

struct Sealers {
    addresses: Vec<Address>,
    /// They are the exporter's own program.
    own: bool,
}

impl Sealers {
    async fn of(chain: &Chain) -> Result<Self> {
        let mut addresses = chain.sealing().await?.sealers;
        addresses.sort_unstable();
        Ok(Self { addresses, own: chain.sealed_by().await?.kind == SealerKind::Embedded })
    }

    /// As far as the kept headers show.
    fn shown<'a>(headers: impl Iterator<Item = &'a Vec<u8>>) -> Self {
        let headers: Vec<BlockHeader> = headers.filter_map(|header| BlockHeader::parse(header)).collect();
        let addresses: BTreeSet<Address> = headers.iter().filter_map(BlockHeader::sealer).collect();
        Self { addresses: addresses.into_iter().collect(), own: headers.iter().any(BlockHeader::is_ours) }
    }
}

fn suggest(
    reader: &Reader<'_>,
    sealers: Sealers,
    authorities: Vec<PinnedAuthority>,
    gathered: &mut Gathered,
) -> Result<()> {
    let Some(pin) = reader.network.chain.pin() else { return Ok(()) };
    let (id, genesis, contract, code_hash) = (pin.chain_id, pin.genesis, pin.contract, pin.code_hash);
    let Sealers { addresses: signers, own: sealed_by_exporter } = sealers;
    let pinned = PinnedChain { id, genesis, contract, code_hash, signers, quorum: None, sealed_by_exporter };
    gathered.packing.suggest(&Trust { chain: pinned, persons: Vec::new(), authorities }).map_err(refused)
}

/// Adds the stamps over these roots; if batches are stamped here at all, it reports how many of these are not yet.
pub(super) fn add(plant: &Plant, roots: &BTreeSet<Hash>, gathered: &mut Gathered) -> Result<()> {
    if plant.ledger.proofs.stamp_counts()?.newest.is_none() {
        return Ok(());
    }
    let (mut stamps, mut bare): (BTreeMap<u64, Vec<Hash>>, u64) = (BTreeMap::new(), 0);
    for root in roots {
        match plant.ledger.proofs.stamp_of(*root)? {
            Some(key) => stamps.entry(key).or_default().push(*root),
            None => bare += 1,
        }
    }
    for (key, wanted) in stamps {
        let stamp = plant.ledger.proofs.stamp(key)?.filter(|stamp| !stamp.tokens.is_empty());
        match stamp.and_then(|stamp| StampTree::new(stamp.roots).zip(Some(stamp.tokens))) {
            Some((tree, tokens)) => {
                gathered.packing.stamps(&tree, &wanted, &tokens).map_err(refused)?;
            }
            None => bare += wanted.len() as u64,
        }
    }
    if bare > 0 {
        let text = format!(
            "batches without a time stamp yet: {bare}; level (d) is absent there; `authros evidence timestamp` requests one"
        );
        gathered.notes.push(text);
    }
    Ok(())
}

/// The most statements of one type by one recorder that are searched.
const MOST_STATEMENTS: usize = 16;

#[derive(Debug, Default)]
pub(super) struct Shown {
    pub rows: Vec<RecordRow>,
    pub heights: Vec<Height>,
    pub notes: Vec<String>,
}

pub(super) async fn heights_shown(reader: &Reader<'_>, rows: &[RecordRow]) -> Result<Shown> {
    let mut topics: BTreeMap<RecorderId, BTreeSet<TopicId>> = BTreeMap::new();
    // The recorder of a ring states nothing: its id says that its numbers may be missing.
    for row in rows.iter().filter(|row| row.topic != TOPIC && !row.recorder.is_ring()) {
        topics.entry(row.recorder).or_default().insert(row.topic_id);
    }
    let mut shown = Shown::default();
    for (recorder, topics) in topics {
        if rows.len() + shown.rows.len() + 2 > MOST_RECORDS {
            let text = format!("statements of recorder {recorder} and later ones do not fit into the bundle");
            shown.notes.push(text);
            break;
        }
        one(reader, (recorder, &topics), &mut shown).await?;
    }
    Ok(shown)
}

async fn one(
    reader: &Reader<'_>,
    (recorder, topics): (RecorderId, &BTreeSet<TopicId>),
    shown: &mut Shown,
) -> Result<()> {
    let before = shown.rows.len();
    for row in statements(reader, recorder, Heads::TYPE)? {
        let Some(heights) = heights(reader, &row).await else { continue };
        shown.heights.extend(of_topics(row.digest, &heights, topics));
        shown.rows.push(row);
        break;
    }
    if shown.rows.len() == before {
        let text = format!("recorder {recorder} has no anchored heads record here: nothing says how far its topics go");
        shown.notes.push(text);
    }
    let before = shown.rows.len();
    for row in statements(reader, recorder, Birth::TYPE)? {
        if body(reader, &row).await.is_some() {
            shown.rows.push(row);
            break;
        }
    }
    if shown.rows.len() == before {
        let text =
            format!("recorder {recorder} has no anchored birth record here: nothing says which recorder it follows");
        shown.notes.push(text);
    }
    Ok(())
}

/// In search order: heads from the newest, births from the oldest.
fn statements(reader: &Reader<'_>, recorder: RecorderId, type_name: &str) -> Result<Vec<RecordRow>> {
    let query = RecordQuery {
        owner: Some(reader.reader.address),
        recorder: Some(recorder),
        topic: Some(TOPIC.to_owned()),
        type_name: Some(type_name.to_owned()),
        limit: MOST_STATEMENTS,
        newest_first: type_name == Heads::TYPE,
        ..RecordQuery::default()
    };
    let mut rows = reader.plant.ledger.records.list(&query)?.rows;
    rows.retain(|row| matches!(row.state, RecordState::Confirmed | RecordState::Verified));
    Ok(rows)
}

async fn body(reader: &Reader<'_>, row: &RecordRow) -> Option<Vec<u8>> {
    Some(reader.open(row).await.ok()?.body)
}

async fn heights(reader: &Reader<'_>, row: &RecordRow) -> Option<Heights> {
    let heads = Heads::parse(&body(reader, row).await?).ok()?;
    let listed = reader.plant.ledger.records.find(heads.heights).ok()??;
    let heights = Heights::parse(&body(reader, &listed).await?).ok()?;
    (tree(&heights)?.root() == heads.root).then_some(heights)
}

fn of_topics(heads: Digest, heights: &Heights, topics: &BTreeSet<TopicId>) -> Vec<Height> {
    let Some(tree) = tree(heights) else { return Vec::new() };
    let named = heights.topics.iter().enumerate().filter(|(_, (topic, _))| topics.contains(topic));
    let height = |(at, (topic, number)): (usize, &(TopicId, u64))| {
        let (topic, number, path) = (*topic, *number, tree.path(at));
        Height { heads, topic, number, index: at as u64, path }
    };
    named.map(height).collect()
}

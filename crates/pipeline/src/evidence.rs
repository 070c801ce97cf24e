//! What an evidence bundle is assembled from: records from the vault, their places in batches, and the chain's proofs
//! of their anchors and their signers' keys.

use std::collections::{BTreeMap, BTreeSet};

use authros_evidence::{
    AnchorClaim, Anchoring, BundledRecord, Disclosure, Nodes, Packing, PackingError, PinnedAuthority, PinnedChain,
    Slot, Trust, disclose,
};
use tokio::task::block_in_place;

use crate::chain::{ChainError, Event, SealerKind};
use crate::crypto::record::{RecordSecret, open_revealed};
use crate::crypto::signer_id;
use crate::model::{Address, Digest, ErrorKind, Hash, Header, Identity, PublicKey, SignerId};
use crate::store::{RecordRow, Retained};

use super::chain_proofs::{self, Anchor, Shown as Wanted};
use super::columns::{self, Keys as _};
use super::evidence_heights::{self, Shown};
use super::evidence_stamps;
use super::reader::Reader;
use super::retention::erasing::is_stated;
use super::{PipelineError, authority};

/// The most records in a bundle.
pub use authros_evidence::MOST_RECORDS;

/// A bundle being assembled, and what could not be included.
#[derive(Debug, Default)]
pub struct Gathered {
    /// The parts.
    pub packing: Packing,
    /// The number of records.
    pub records: u64,
    /// The number of them that are disclosed.
    pub revealed: u64,
    /// What is missing, in words.
    pub notes: Vec<String>,
}

/// What the chain has to prove for a record of the bundle.
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
    /// The root of its batch.
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

/// Collects these records, the reader's own, and discloses the named ones; the suggested trust file names these time
/// stamp authorities.
///
/// # Errors
/// Errors of ledger, vault and chain; a record whose bytes are gone.
pub async fn gather(
    reader: &Reader<'_>,
    rows: &[RecordRow],
    reveal: &BTreeSet<Digest>,
    authorities: Vec<PinnedAuthority>,
) -> Result<Gathered, PipelineError> {
    let (mut gathered, mut asked) = (Gathered::default(), Vec::new());
    let Shown { rows: statements, heights, notes } = evidence_heights::shown(reader, rows).await?;
    gathered.notes = notes;
    let stated = statements.iter().map(|row| row.digest).collect::<BTreeSet<_>>();
    let known: BTreeSet<Digest> = rows.iter().map(|row| row.digest).collect();
    for row in rows.iter().chain(statements.iter().filter(|row| !known.contains(&row.digest))) {
        let Some((header, key, record)) = block_in_place(|| stored(reader, row, &mut gathered.notes))? else {
            continue;
        };
        gathered.packing.key(&key).map_err(refused)?;
        let disclosure = match reveal.contains(&row.digest) || stated.contains(&row.digest) {
            true => Some(disclosed(reader, row, &header, &record.record, &mut gathered).await?),
            false => None,
        };
        gathered.records += 1;
        gathered.revealed += u64::from(reveal.contains(&row.digest));
        let record = BundledRecord { disclosure, ..record };
        match block_in_place(|| anchoring(reader, row))? {
            Some((block, anchor)) => {
                let keys = chain_proofs::key_version(reader.network, row.owner, block);
                let (digest, owner, signer) = (row.digest, row.owner, row.signer);
                asked.push(Asked { digest, owner, signer, block, keys, anchor, record });
            }
            None => gathered.packing.record(row.digest, record).map_err(refused)?,
        }
    }
    if !heights.is_empty() {
        gathered.packing.heights(heights).map_err(refused)?;
    }
    let roots = asked.iter().filter_map(Asked::root).collect();
    block_in_place(|| evidence_stamps::add(reader.plant, &roots, &mut gathered))?;
    show(reader, asked, &mut gathered).await?;
    suggest(reader, authorities, &mut gathered).await?;
    Ok(gathered)
}

/// The record's bytes, compared with its row, and the key that signed it.
fn stored(
    reader: &Reader<'_>,
    row: &RecordRow,
    notes: &mut Vec<String>,
) -> Result<Option<(Header, PublicKey, BundledRecord)>, PipelineError> {
    let plant = reader.plant;
    let Some(record) = plant.stored_bytes(row)? else {
        let known = |gone: &Retained| gone.anchored || is_stated(plant, Some(reader.network), row.digest, gone);
        let gone: Option<Retained> = plant.ledger.retained(row.digest)?.filter(known);
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
    let (header, _) = Header::parse(&record).map_err(crate::crypto::CryptoError::DamagedRecord)?;
    if let Some(field) = columns::header_difference(row, &header) {
        return Err(PipelineError::RowDiffers { id: row.id.clone(), field });
    }
    let own = reader.reader.signing().public;
    let known = [Some(own), plant.ledger.signer(row.signer)?, authority::key_of(plant, reader.network, row)?];
    let Some(key) = known.into_iter().flatten().find(|key| signer_id(key) == row.signer) else {
        notes.push(format!("the key that signed record {} is unknown here; the record is not in the bundle", row.id));
        return Ok(None);
    };
    let record = BundledRecord { record, signature: row.signature, anchor: None, disclosure: None };
    Ok(Some((header, key, record)))
}

/// The block of the record's anchor, and the kind of anchor.
fn anchoring(reader: &Reader<'_>, row: &RecordRow) -> Result<Option<(u64, Anchoring)>, PipelineError> {
    let Some(place) = reader.plant.ledger.batch_place(row.digest)? else {
        return Ok(row.block.map(|block| (block, Anchoring::Each {})));
    };
    let (Some(account), Some(block)) = (place.account, place.block) else { return Ok(None) };
    let crate::chain::merkle::Inclusion { index, count, path, root } = place.inclusion;
    Ok(Some((block, Anchoring::Batch { account, root, index, count, path })))
}

/// The owner's signed disclosure of a record; the text of its definition is included.
async fn disclosed(
    reader: &Reader<'_>,
    row: &RecordRow,
    header: &Header,
    record: &[u8],
    gathered: &mut Gathered,
) -> Result<Disclosure, PipelineError> {
    let (plant, network) = (reader.plant, reader.network);
    let opened = reader.open(row).await?;
    if let Some(definition) = reader.definition_text(row, &opened).await? {
        gathered.packing.definition(&definition, plant.provider);
    }
    let secrets = reader.topic_keys(row, header).into_iter().map(|key| RecordSecret::of(&key, header));
    let secret = { secrets }.find(|secret| open_revealed(plant.provider, record, secret).is_ok());
    let secret = secret.ok_or(crate::crypto::CryptoError::WrongKey)?;
    disclose(secret, (&network.domain, &row.digest), &reader.reader.signing(), plant.provider).map_err(refused)
}

/// Gets the chain's proof of every anchor, at its own block if the node still has that state, otherwise at a late one.
async fn show(reader: &Reader<'_>, asked: Vec<Asked>, gathered: &mut Gathered) -> Result<(), PipelineError> {
    let chain = &reader.network.chain;
    let mut blocks: BTreeMap<u64, Vec<Asked>> = BTreeMap::new();
    asked.into_iter().for_each(|one| blocks.entry(one.block).or_default().push(one));
    let head = chain.head().await?.number;
    let further = u64::try_from(chain.sealing().await?.sealers.len() / 2).unwrap_or(0);
    let (mut nodes, mut headers, mut identities) = (Nodes::default(), BTreeSet::new(), BTreeSet::new());
    identities.insert((reader.reader.address, chain_proofs::key_version(reader.network, reader.reader.address, head)));
    for (block, all) in blocks {
        let slots = slots(&all);
        let late = head.saturating_sub(further).max(block);
        let shown = match at_its_block(reader, block, &slots).await? {
            Some(found) => Some((block, found)),
            None => state_nodes(reader, late, &slots).await?.map(|found| (late, found)),
        };
        let shown_at = match shown {
            Some((at, found)) => {
                nodes.extend(found);
                headers.extend(at..=at.saturating_add(further).min(head));
                at
            }
            None => {
                let text = format!("the node proves no state of block {block} or later: level (c) is not proven");
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
    for number in headers {
        if let Some(header) = chain.header_rlp(number).await? {
            gathered.packing.header(number, header);
        }
    }
    for (account, version) in identities {
        if let Some(identity) = identity(reader, account, version).await? {
            gathered.packing.identity(&identity);
        }
    }
    if !nodes.is_empty() {
        gathered.packing.nodes(&nodes);
    }
    Ok(())
}

/// What has to be proven of the contract's storage for these records.
fn slots(all: &[Asked]) -> Vec<Slot> {
    let wanted = all.iter().map(|Asked { digest, owner, signer, keys, anchor, .. }| {
        let anchor = match anchor {
            Anchoring::Each {} => Anchor::Digest(*digest),
            Anchoring::Batch { account, root, .. } => Anchor::Root(*account, *root),
        };
        Wanted { owner: *owner, signer: *signer, keys: *keys, anchor }
    });
    chain_proofs::slots(wanted)
}

/// What is kept of the state after the block, otherwise what the node still has of it.
async fn at_its_block(reader: &Reader<'_>, block: u64, slots: &[Slot]) -> Result<Option<Nodes>, PipelineError> {
    match chain_proofs::kept(reader.plant, reader.network, block, slots).await? {
        Some(found) => Ok(Some(found)),
        None => state_nodes(reader, block, slots).await,
    }
}

/// `None` if the node no longer has that state, or cannot prove anything.
async fn state_nodes(reader: &Reader<'_>, block: u64, slots: &[Slot]) -> Result<Option<Nodes>, PipelineError> {
    match reader.network.chain.storage_nodes(block, slots).await {
        Ok(nodes) => Ok(Some(nodes.into_iter().collect())),
        Err(ChainError::Unreachable { url, reason }) => Err(ChainError::Unreachable { url, reason }.into()),
        Err(error) if error.kind() == ErrorKind::Tampered => Err(error.into()),
        Err(_) => Ok(None),
    }
}

/// An account's identity of a given version, as registered; the newest is read from the contract, older ones from the
/// block that registered them.
async fn identity(reader: &Reader<'_>, account: Address, version: u64) -> Result<Option<Identity>, PipelineError> {
    let chain = &reader.network.chain;
    let Some(state) = chain.account(account).await? else { return Ok(None) };
    if state.keys == version || version == 0 {
        return Ok(Some(state.identity));
    }
    let place = usize::try_from(version - 1).unwrap_or(usize::MAX);
    let block = reader.network.directory.with_account(account, |account| {
        account.and_then(|account| account.identities.get(place)).map(|identity| identity.block)
    });
    let Some(block) = block else { return Ok(None) };
    Ok(chain.changes(block, block).await?.into_iter().find_map(|at| match at.event {
        Event::Registered { owner, identity, .. } if owner == account && version == 1 => Some(identity),
        Event::KeysRotated { owner, keys, identity } if owner == account && keys == version => Some(identity),
        _ => None,
    }))
}

/// The trust file that the exporter would write.
async fn suggest(
    reader: &Reader<'_>,
    authorities: Vec<PinnedAuthority>,
    gathered: &mut Gathered,
) -> Result<(), PipelineError> {
    let chain = &reader.network.chain;
    let Some(pin) = chain.pin() else { return Ok(()) };
    let mut signers = chain.sealing().await?.sealers;
    signers.sort_unstable();
    let sealed_by_exporter = chain.sealed_by().await?.kind == SealerKind::Embedded;
    let (id, genesis, contract, code_hash) = (pin.chain_id, pin.genesis, pin.contract, pin.code_hash);
    let quorum = None;
    let pinned = PinnedChain { id, genesis, contract, code_hash, signers, quorum, sealed_by_exporter };
    gathered.packing.suggest(&Trust { chain: pinned, persons: Vec::new(), authorities }).map_err(refused)
}

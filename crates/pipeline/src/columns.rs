//! Compares a ledger's row with its record: what was captured is what the signed header says, and the sealed head if
//! its key is here. A row that differs is shown with the record's values, never as verified; names in a head that do
//! not belong to the pseudonyms in the header are not shown.

use std::sync::{Arc, Mutex, PoisonError};
use std::{borrow::Cow, collections::HashMap};

use serde::{Deserialize, Serialize};

use crate::crypto::{CryptoError, IndexKey, Names, TopicKey, filter_id, filter_key, topic_filter_id, topic_id};
use crate::model::{Digest, FilterId, Head, Header, RecordKind, RecordState, RecorderPrefix};
use crate::store::{FilterChoice, PlacedRecord, RecordRow, StoreError};
use crate::{Plant, chain_proofs};
use crate::{crypto::record::open_front, model::bytes::hex, model::head::SIMULATED, model::header::TAG_LENGTH};

/// First bytes of a record that are read for its header and, unless it is very long, its sealed head.
pub const FRONT: usize = 2048;
/// Heads cached in memory.
const MOST_HEADS: usize = 8192;

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Compared {
    /// Nothing: its bytes are not here.
    #[default]
    Nothing,
    /// The public header; names, length and the simulation mark are sealed.
    Header,
    /// The header, and names and mark by their pseudonyms.
    Names,
    /// Header and sealed head: everything.
    Head,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum ShownState {
    Kept(RecordState),
    Verified(Caveat),
    Refused(Refusal),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Refusal {
    /// Its signer wrote a name into it that belongs to another pseudonym.
    #[serde(rename = "false name")]
    FalseName,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Caveat {
    Deleted,
    /// Its bytes are not here now, so they cannot be compared.
    Unread,
    /// Names, length and simulation mark come only from the ledger.
    #[serde(rename = "verified, names unchecked")]
    NamesUnchecked,
}

impl ShownState {
    pub fn word(self) -> &'static str {
        match self {
            Self::Kept(state) => state.word(),
            Self::Verified(Caveat::Deleted) => "deleted",
            Self::Verified(Caveat::Unread) => "unread",
            Self::Verified(Caveat::NamesUnchecked) => "verified, names unchecked",
            Self::Refused(Refusal::FalseName) => "false name",
        }
    }

    pub fn from_word(word: &str) -> Option<Self> {
        let kept = RecordState::ALL.iter().copied().map(Self::Kept);
        let more = [Caveat::Deleted, Caveat::Unread, Caveat::NamesUnchecked].into_iter().map(Self::Verified);
        kept.chain(more).chain([Self::Refused(Refusal::FalseName)]).find(|state| state.word() == word)
    }
}

#[derive(Debug, Clone)]
pub struct Shown {
    /// The row; if it was compared, with the record's own values instead of the ledger's.
    pub row: RecordRow,
    pub compared: Compared,
    /// The field in which ledger and record differ.
    pub differs: Option<&'static str>,
    /// What its signer wrote a false name of; the names in the row are then the ledger's own.
    pub false_name: Option<&'static str>,
}

impl Shown {
    pub fn unread(row: RecordRow) -> Self {
        Self { row, compared: Compared::Nothing, differs: None, false_name: None }
    }

    /// As in the ledger, but never verified if not compared, and with a remark if names were not compared, or are
    /// false.
    pub fn state(&self) -> ShownState {
        match (self.differs, self.compared, self.row.state) {
            (Some(_), ..) => ShownState::Kept(RecordState::Tampered),
            _ if self.false_name.is_some() => ShownState::Refused(Refusal::FalseName),
            _ if self.row.deleted_at.is_some() => ShownState::Verified(Caveat::Deleted),
            (None, Compared::Nothing, RecordState::Verified) => ShownState::Verified(Caveat::Unread),
            (None, Compared::Header, RecordState::Verified) => ShownState::Verified(Caveat::NamesUnchecked),
            (None, _, state) => ShownState::Kept(state),
        }
    }
}

pub trait Keys {
    /// The key of the header's topic and epoch, if it is here, and what names in the head are compared with.
    fn opening(&self, header: &Header) -> Option<(TopicKey, Names)>;
    fn index_key(&self, row: &RecordRow) -> Option<IndexKey>;
}

/// Header and head of records whose seal was opened since the site started, for pages that are shown repeatedly.
#[derive(Default)]
pub struct Heads(Mutex<HashMap<Digest, Arc<(Header, Head)>>>);

impl Heads {
    fn of(&self, digest: Digest) -> Option<Arc<(Header, Head)>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).get(&digest).cloned()
    }

    fn keep(&self, digest: Digest, header: Header, head: Head) -> Arc<(Header, Head)> {
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.len() >= MOST_HEADS {
            kept.clear();
        }
        let opened = Arc::new((header, head));
        kept.insert(digest, Arc::clone(&opened));
        opened
    }

    pub fn forget(&self) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }
}

pub struct Comparison<'a> {
    pub plant: &'a Plant,
    pub keys: &'a dyn Keys,
    pub heads: &'a Heads,
    /// The filters by which the rows were found: each header must have them.
    pub filters: &'a [FilterChoice],
}

impl Comparison<'_> {
    /// Rows whose bytes cannot be read are shown as the ledger has them.
    pub fn of(&self, rows: Vec<RecordRow>) -> Result<Vec<Shown>, StoreError> {
        let unknown: Vec<Digest> =
            rows.iter().map(|row| row.digest).filter(|digest| self.heads.of(*digest).is_none()).collect();
        let digests: Vec<Digest> = rows.iter().map(|row| row.digest).collect();
        let placed = self.plant.ledger.records.placed_all(&digests)?;
        let mut fronts = self.fronts(&unknown);
        // A row may have moved since it was listed: what is compared with its place is of the place's own moment.
        let now = rows.into_iter().zip(placed).map(|(row, placed)| placed.unwrap_or(PlacedRecord { row, place: None }));
        now.map(|placed| self.one(placed, &mut fronts)).collect()
    }

    fn fronts(&self, digests: &[Digest]) -> HashMap<Digest, Vec<u8>> {
        let fronts = self.plant.ciphertext.fronts(digests, FRONT).unwrap_or_default();
        digests.iter().copied().zip(fronts).filter_map(|(digest, front)| Some((digest, front?))).collect()
    }

    fn one(&self, placed: PlacedRecord, fronts: &mut HashMap<Digest, Vec<u8>>) -> Result<Shown, StoreError> {
        let place = place_difference(&placed);
        let PlacedRecord { mut row, .. } = placed;
        let sight = match (self.heads.of(row.digest), fronts.remove(&row.digest)) {
            (Some(opened), _) => Sight::Head(opened),
            (None, Some(front)) => self.look(&row, &front, true),
            (None, None) if row.deleted_at.is_some() => match self.plant.ledger.retention.find(row.digest)? {
                Some(retained) => self.look(&row, &retained.header, false),
                None => Sight::Nothing,
            },
            (None, None) => Sight::Nothing,
        };
        let here = self.plant.ledger.records.recorder();
        let (compared, sealed) = match &sight {
            Sight::Nothing => return Ok(Shown { differs: place, ..Shown::unread(row) }),
            Sight::Broken(what) => return Ok(Shown { differs: Some(what), ..Shown::unread(row) }),
            Sight::FalseName(header, _) => {
                let index = self.keys.index_key(&row);
                (Compared::Head, index.and_then(|index| name_difference(&row, header, &index)))
            }
            Sight::Head(opened) => (Compared::Head, head_difference(&row, &opened.1, here)),
            Sight::Header(header) => match self.keys.index_key(&row) {
                Some(index) => (Compared::Names, name_difference(&row, header, &index)),
                None => (Compared::Header, None),
            },
        };
        let false_name = if let Sight::FalseName(_, what) = &sight { Some(*what) } else { None };
        let Some((header, head)) = sight.parts() else { return Ok(Shown { differs: place, ..Shown::unread(row) }) };
        let found = self.filters.iter().all(|choice| choice.is_in(header.topic_id, &header.filters));
        let differs = header_difference(&row, header).or(sealed).or(place).or((!found).then_some("tags"));
        take_over(&mut row, header, head);
        Ok(Shown { row, compared, differs, false_name })
    }

    /// `whole` if the head must be among the first bytes.
    fn look(&self, row: &RecordRow, front: &[u8], whole: bool) -> Sight {
        let Ok((header, length)) = Header::parse(front) else { return Sight::Broken("stored bytes") };
        let opening = if whole { self.keys.opening(&header) } else { None };
        let Some((key, names)) = opening else { return Sight::Header(Box::new(header)) };
        let front = with_head(self.plant, row.digest, front, &header, length);
        match open_front(self.plant.provider, &front, &key, &names) {
            Ok((header, head)) => Sight::Head(self.heads.keep(row.digest, header, head)),
            Err(CryptoError::WrongKey) => Sight::Header(Box::new(header)),
            Err(CryptoError::FalseName(what)) => Sight::FalseName(Box::new(header), what),
            Err(_) => Sight::Broken("stored bytes"),
        }
    }
}

/// The first bytes of a record including its sealed head, as far as the store has them; `length` is the header's.
fn with_head<'a>(plant: &Plant, digest: Digest, front: &'a [u8], header: &Header, length: usize) -> Cow<'a, [u8]> {
    let end = length.saturating_add(usize::try_from(header.head_length).unwrap_or(usize::MAX));
    if front.len() >= end {
        return Cow::Borrowed(front);
    }
    let longer = plant.ciphertext.fronts(&[digest], end).ok().and_then(|found| found.into_iter().next().flatten());
    longer.map_or(Cow::Borrowed(front), Cow::Owned)
}

/// What the signer of a record wrote a false name of; `front` is its first bytes.
pub(super) fn false_name(
    plant: &Plant,
    (key, names): &(TopicKey, Names),
    digest: Digest,
    front: &[u8],
) -> Option<&'static str> {
    let (header, length) = Header::parse(front).ok()?;
    let front = with_head(plant, digest, front, &header, length);
    match open_front(plant.provider, &front, key, names) {
        Err(CryptoError::FalseName(what)) => Some(what),
        _ => None,
    }
}

enum Sight {
    Nothing,
    Broken(&'static str),
    Header(Box<Header>),
    /// Its head opens, but names in it belong to other pseudonyms than the header's.
    FalseName(Box<Header>, &'static str),
    Head(Arc<(Header, Head)>),
}

impl Sight {
    fn parts(&self) -> Option<(&Header, Option<&Head>)> {
        match self {
            Self::Nothing | Self::Broken(_) => None,
            Self::Header(header) | Self::FalseName(header, _) => Some((header, None)),
            Self::Head(opened) => Some((&opened.0, Some(&opened.1))),
        }
    }
}

/// The field in which a row and the signed header of its record differ.
pub fn header_difference(row: &RecordRow, header: &Header) -> Option<&'static str> {
    let length = header.body_length.saturating_sub(TAG_LENGTH as u64);
    let fields = [
        ("owner", header.owner == row.owner),
        ("kind", header.kind == row.kind),
        ("signer", header.signer == row.signer),
        ("epoch", header.epoch == row.epoch),
        ("recorder", header.recorder == row.recorder),
        ("number", header.seq == row.seq),
        ("topic", header.topic_id == row.topic_id),
        ("time", header.captured_at == row.captured_at),
        ("length", is_length(length, row.bytes)),
    ];
    fields.iter().find(|(_, same)| !same).map(|(field, _)| *field)
}

/// Whether a message of `plain` bytes can be sealed in `sealed` bytes: as it is, or compressed, which is done only if
/// it saves an eighth.
fn is_length(sealed: u64, plain: u64) -> bool {
    sealed == plain || sealed <= plain - plain / 8
}

/// The field in which a row and the sealed head of its record differ; `here` is this ledger's prefix. A gateway that
/// could not open a record stores its pseudonyms, its sealed length and no simulation mark.
pub fn head_difference(row: &RecordRow, head: &Head, here: RecorderPrefix) -> Option<&'static str> {
    let simulated = head.is_simulated();
    let foreign = !here.has(&row.recorder);
    let fields = [
        ("topic", !row.is_named() || head.topic == row.topic),
        ("type", is_pseudonym(&row.type_name) || head.type_name == row.type_name),
        ("length", foreign || head.plain_length == row.bytes),
        ("mark of simulation", simulated == row.simulated || (foreign && !row.simulated)),
    ];
    fields.iter().find(|(_, same)| !same).map(|(field, _)| *field)
}

/// Like [`head_difference`], without a key for the head: names and mark by the pseudonyms in the header.
pub fn name_difference(row: &RecordRow, header: &Header, index: &IndexKey) -> Option<&'static str> {
    if row.is_named() && topic_id(index, &row.topic) != header.topic_id {
        return Some("topic");
    }
    // Only what was recorded has filters.
    if !header.kind.is_content() && header.kind != RecordKind::Definition {
        return None;
    }
    // Robots enrolled for some topics compute their ids with a key of the topic.
    let own = filter_key(index, &header.topic_id);
    let named = |id: &FilterId| {
        let known = [filter_id(index, "type", &row.type_name), topic_filter_id(&own, "type", &row.type_name)];
        known.contains(id) || hex(&id.0) == row.type_name || row.type_name.is_empty()
    };
    if !header.filters.first().is_none_or(named) {
        return Some("type");
    }
    let mark = format!("{}={}", SIMULATED.0, SIMULATED.1);
    let marks = [filter_id(index, "tag", &mark), topic_filter_id(&own, "tag", &mark)];
    let simulated = marks.iter().any(|mark| header.filters.contains(mark));
    (row.simulated && !simulated).then_some("mark of simulation")
}

/// Whether a type's name is not known here: its filter id, or nothing, takes its place.
fn is_pseudonym(type_name: &str) -> bool {
    type_name.is_empty() || (type_name.len() == 16 && type_name.bytes().all(|byte| byte.is_ascii_hexdigit()))
}

fn take_over(row: &mut RecordRow, header: &Header, head: Option<&Head>) {
    row.owner = header.owner;
    row.recorder = header.recorder;
    row.kind = header.kind;
    row.signer = header.signer;
    row.epoch = header.epoch;
    row.seq = header.seq;
    row.captured_at = header.captured_at;
    if row.topic_id != header.topic_id {
        row.topic_id = header.topic_id;
        row.topic = RecordRow::unnamed(header.topic_id);
    }
    if let Some(head) = head {
        row.topic.clone_from(&head.topic);
        row.type_name.clone_from(&head.type_name);
        row.bytes = head.plain_length;
        row.simulated = head.is_simulated();
    }
}

fn place_difference(placed: &PlacedRecord) -> Option<&'static str> {
    let row = &placed.row;
    let settled = matches!(row.state, RecordState::Mined | RecordState::Confirmed | RecordState::Verified);
    if (settled && row.block.is_none()) || (row.state.is_before_block() && row.block.is_some()) {
        return Some("state");
    }
    anchor_difference(placed)
}

pub(super) fn anchor_difference(PlacedRecord { row, place }: &PlacedRecord) -> Option<&'static str> {
    let place = place.as_ref()?;
    if !chain_proofs::is_included(place, row) {
        return Some("place in its batch");
    }
    if place.is_contradicted {
        return Some("block");
    }
    place.block?;
    // A transaction of its own that is in no block stands before the batch's only until the batch is in one.
    if row.block.is_none() {
        return Some("transaction");
    }
    let (same_block, same_transaction) = (row.block == place.block, row.transaction == place.transaction);
    match (same_block, same_transaction) {
        (true, false) => Some("transaction"),
        (false, true) => Some("block"),
        (true, true) if row.block_hash != place.block_hash => Some("block's hash"),
        _ => None,
    }
}

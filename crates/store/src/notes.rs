//! All notes beside the tables, each of one type under one key. A value of another type is reported as damage.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::PathBuf;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::StoreError;
use crate::ledger::{Erasure, Notes};
use crate::model::{
    Address, ContactName, Digest, Domain, Hash, ProfileName, PublicKey, RecorderId, RingSpan, SignerId, Timestamp,
    TopicId, WatchRules, clean,
};
use crate::sql::{Cell, Connection, Row};

pub trait Note {
    type Value: Serialize + DeserializeOwned;
    const NAME: &'static str;
    /// For people.
    const WHAT: &'static str;

    /// The rest of its key; empty for a single note.
    fn about(&self) -> String;
}

#[derive(Debug, Clone, Copy)]
pub struct Kind {
    pub name: &'static str,
    /// Reads and drops one.
    try_read: fn(&Connection, &str) -> Result<(), StoreError>,
}

impl Kind {
    const fn of<N: Note>() -> Self {
        Self { name: N::NAME, try_read: |connection, about| found::<N>(connection, about).map(drop) }
    }
}

macro_rules! notes {
    ($(
        $(#[$doc:meta])*
        $note:ident { $($part:ident: $of:ty),* } = $name:literal: $value:ty, $what:literal;
    )*) => {
        $(
            $(#[$doc])*
            #[derive(Debug, Clone, PartialEq, Eq, Hash)]
            #[allow(missing_docs, reason = "the parts of its key are named by what they are")]
            pub struct $note { $(pub $part: $of),* }

            impl Note for $note {
                type Value = $value;
                const NAME: &'static str = $name;
                const WHAT: &'static str = $what;

                fn about(&self) -> String {
                    let parts: &[String] = &[$(self.$part.to_string()),*];
                    parts.join(":")
                }
            }
        )*

        pub const KINDS: &[Kind] = &[$(Kind::of::<$note>()),*];
    };
}

notes! {
    /// Elsewhere the ledger is a copy.
    LastPlace {} = "place": String, "where this home was last opened";
    CopiedAt {} = "copied at": u64, "how far the chain was known to the backup that was restored";
    /// Its accounts' later anchors are its own.
    RestoredAt {} = "restored at": Timestamp, "when this home was restored";
    ForeignHistory {} = "foreign history": u64, "up to which block anchors of other copies are history";
    /// In a home with keys or an embedded chain.
    StoreWasGone {} = "store was gone": Timestamp, "when the store was missed";
    SeenForeign {} = "foreign anchors": ForeignAnchors, "the anchors that this home did not send";
    /// The last counted text of [`crate::WaitingFile`].
    LossesCounted {} = "losses counted": u64, "up to where losses are counted";
    ScrubbedUpTo {} = "scrubbed": u64, "up to where records were hashed again";

    /// Two accounts while another one is loaded.
    ProfileAccounts {} = "profile accounts": BTreeMap<ProfileName, Vec<Address>>, "which account each profile has";

    MissedFrom {} = "missed": u64, "from which block the chain is to be read again";
    UnsureBlocks {} = "unsure blocks": Vec<UnsureBlock>, "the blocks that are to be read again";
    NodeBehind {} = "node behind": AwaitedBlock, "since when the node is behind";
    DoubtedBlock {} = "doubted block": AwaitedBlock, "since when a block is doubted";

    Watched { profile: ProfileName } = "watched": WatchRules, "the watched topics";
    /// Per topic and epoch of an owner. A quarantined one does not count for readers who may never see it.
    StoredDefinition { domain: Domain, owner: Address, epoch: u64, topic: TopicId, digest: Digest, held: bool }
        = "definition": (), "which definitions are stored";
    AskedSpans {} = "asked spans": VecDeque<AskedSpan>, "the requested spans of the ring";
    /// By the file's SM3.
    Imported { owner: Address, file: Digest } = "imported": Standings, "what is sealed of an imported file";
    /// By the file's inode and first bytes.
    Followed { owner: Address, file: Digest } = "followed": FilePlace, "how far a followed file is sealed";

    /// `path`: SM3 of it.
    SealedUnderName { owner: Address, path: Digest } = "sealed under name": Digest, "which file had a name";

    StatedAuditHead { owner: Address } = "audit head": StatedHead, "the anchored head of the audit log";
    /// Another chain needs every statement again.
    StatedNumbers { recorder: RecorderId, owner: Address, domain: Domain } = "numbers": StatedRoot,
        "which numbers of a recorder are anchored";
    /// Records whose number belongs to another one.
    Equivocations { recorder: RecorderId } = "equivocations": Vec<Digest>, "which equivocations are reported";
    Erased { report: Digest } = "erased": Erasure, "who had records erased";

    AddressBook {} = "contacts": Vec<Contact>, "the address book";
    /// The key's fingerprint.
    WrappedFor { owner: Address, reader: Address } = "wrapped for": String,
        "for which key a reader's keys were wrapped";
    Revoking { owner: Address } = "revoking": Vec<Address>, "the revocations that the chain is owed";
    GrantedTopic { owner: Address, topic: TopicId } = "granted topic": String, "the name of a granted topic";
    GrantedFrom { transaction: Hash } = "granted from": u64, "from which epoch on a grant opens records";

    AdmittedOwners {} = "admitted": Vec<AdmittedOwner>, "the owners allowed at the gateway";
    /// Of a gateway on a server.
    SharedSystemKeys {} = "system keys": SealedSystemKeys, "the system keys of the gateway's workers";
    /// By name, without secrets.
    HoldersSettings {} = "settings of the holder": BTreeMap<String, String>, "the settings of the lease's holder";
    /// The epoch that the revocation will begin.
    AnnouncedRevoke { owner: Address, reader: Address } = "announced revoke": u64, "an announced revocation";

    /// Told up to this number of the ledger.
    ErasuresTold { domain: Domain, ledger: String, keeper: Address, owner: Address } = "erasures told": u64,
        "which erasures the gateway was notified of";
    TakenOfFeed { domain: Domain, keeper: Address, reader: Address } = "taken of feed": FeedTaken,
        "how far a gateway's feed was taken in";

    /// On a robot: id and number up to which its gateway's feed is dealt with.
    ProofsTaken { owner: Address } = "proofs taken": ([u8; 16], u64), "up to where a robot's gateway was read";
    EnrolledRobots { owner: Address } = "robots": Vec<Enrolled>, "the enrolled robots";
    WantedPolicy { owner: Address, device: SignerId } = "policy wanted": PolicyWanted, "the policy set for a robot";
    /// A summary without secrets.
    KeysTold { owner: Address, device: SignerId } = "keys told": String, "which keys were sent to a robot";
    /// Old and new.
    OwnerKeysTold { owner: Address, device: SignerId } = "owner keys told": (PublicKey, PublicKey),
        "which key of its owner was sent to a robot";
    /// The newest, by number.
    NoticesCarried { owner: Address, device: SignerId, gateway: SignerId, recorder: RecorderId } = "notices carried": u64,
        "which notices a robot's gateway has";
    /// On a robot: per enrolment.
    PolicyHere { owner: Address, device: SignerId } = "policy here": PolicyKept, "the policy of this robot";
    /// On a robot, hex.
    PolicyTold { owner: Address, device: SignerId } = "policy told": String, "what was reported to the owner about the \
        policy";
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ForeignAnchors {
    pub account: Address,
    /// Transactions sent elsewhere.
    pub count: u64,
    /// Of the last one.
    pub block: u64,
    pub transaction: Hash,
    pub seen: Timestamp,
    /// In the audit log.
    pub noted: Timestamp,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UnsureBlock {
    pub block: u64,
    pub hash: Hash,
    /// Events that were read.
    pub events: usize,
    /// Reads since.
    pub times: usize,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AwaitedBlock {
    /// Its number and hash.
    pub block: (u64, Hash),
    pub since: Timestamp,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AskedSpan {
    /// Of the notice.
    pub number: u64,
    pub span: RingSpan,
}

/// Of a topic in an imported file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Standing {
    /// Some messages may be sealed.
    Begun,
    /// All messages are sealed.
    Whole,
}

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Standings {
    pub topics: BTreeMap<String, Standing>,
    /// Tags `recording` of its records: a file is imported alone, with a folder, or followed.
    pub tags: BTreeSet<String>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FileStanding {
    #[default]
    Open,
    /// All messages and the statement are sealed.
    Stated,
    /// Its proof is written.
    Proven,
}

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FilePlace {
    pub name: String,
    /// Messages done with, in file order: stored, or not wanted.
    pub stored: u64,
    /// Messages up to this one may be stored too, after a crash.
    pub begun: u64,
    /// Bytes read by then.
    pub at: u64,
    /// SM3 of these bytes.
    pub digest: Option<Digest>,
    pub chunks: u64,
    /// By its recorder.
    pub closed: bool,
    pub standing: FileStanding,
    /// The time of the statement's record.
    pub stated_at: Option<Timestamp>,
    /// By this machine's clock.
    pub ended_at: Option<Timestamp>,
    /// SM3 of it.
    pub statement: Option<Digest>,
    /// A run chose among its topics, so messages done with need not be sealed.
    pub chosen: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StatedHead {
    pub line: u64,
    /// Of the last line.
    pub hash: Digest,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StatedRoot {
    /// The last check for changes.
    pub looked: Timestamp,
    /// Over the numbers.
    pub root: Hash,
    /// The statement, if any.
    pub heads: Option<Digest>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Contact {
    pub name: ContactName,
    pub address: Address,
    /// As a person reads it.
    pub fingerprint: Option<String>,
    /// Given or confirmed by a person.
    pub given: bool,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AdmittedOwner {
    pub owner: Address,
    pub since: Timestamp,
    pub by: String,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SealedSystemKeys {
    /// Number of the join key that the secrets are sealed under.
    pub join: u64,
    /// The signed list, hex.
    pub list: String,
    /// Hex.
    pub secrets: String,
}

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FeedTaken {
    /// Numbers belong to one feed.
    pub feed: [u8; 16],
    /// The last reading from the beginning.
    pub begun: Timestamp,
    pub owners: BTreeMap<Address, TakenOfOwner>,
}

/// Rows of an owner up to `place` are dealt with, wait, or are read again.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TakenOfOwner {
    pub known: FollowedOwner,
    /// `None` during the first reading.
    pub place: Option<u64>,
    /// Rows after it are read, perhaps again.
    pub back: Option<u64>,
    /// Reads again only what the gateway did not have before.
    pub is_again: bool,
    /// Records to process later, with whether each was erased.
    pub waits: BTreeMap<Digest, bool>,
    /// The lowest number without room in `waits`.
    pub beyond: Option<u64>,
    /// The lowest number of a record whose key was missing.
    pub locked: Option<u64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FollowedOwner {
    /// First bytes of the grant's transaction hash; 0 for the reader's own records.
    pub grant: u64,
    /// The newest epoch with keys.
    pub newest: u64,
    /// Epochs with keys up to it.
    pub count: u64,
}

/// Without secrets.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Enrolled {
    pub name: ProfileName,
    /// SM3 of its public key.
    pub device: SignerId,
    /// Empty = none.
    pub topics: Vec<String>,
    /// Recalled.
    pub ended: bool,
    pub key: PublicKey,
    pub gateway: Option<EnrolledGateway>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EnrolledGateway {
    /// Host:port, in the order tried.
    pub addresses: Vec<String>,
    /// SM3 of its identity key.
    pub key: SignerId,
}

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyWanted {
    /// 0 = never set.
    pub version: u64,
    /// Empty = the robot's own settings.
    pub text: String,
    pub set_at: Timestamp,
}

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyKept {
    /// In use; 0 = none.
    pub version: u64,
    pub text: String,
    /// The newest version received.
    pub heard: u64,
    /// Why it is not in use.
    pub refused: Option<String>,
}

impl Notes {
    /// `None` without a note.
    pub fn read<N: Note>(&self, note: &N) -> Result<Option<N::Value>, StoreError> {
        self.0.read(|connection| read_in(connection, note))
    }

    pub fn write<N: Note>(&self, note: &N, value: &N::Value) -> Result<(), StoreError> {
        let row = row(note, value)?;
        self.0.write(move |session| put(session.connection, &row))
    }

    /// Changes a note, or an empty value, under a lock: no concurrent change is lost. `change` must not change other
    /// notes; its error leaves the value unchanged.
    pub fn change<N: Note<Value: Default>, T, E: From<StoreError>>(
        &self,
        note: &N,
        change: impl FnOnce(&mut N::Value) -> Result<T, E>,
    ) -> Result<T, E> {
        let _one_at_a_time = self.0.one_at_a_time();
        let known = self.read(note)?;
        // Not every value can be cloned.
        let mut value = match &known {
            Some(known) => parsed::<N>(&note.about(), text(note, known)?.as_bytes())?,
            None => N::Value::default(),
        };
        let before = text(note, &value)?;
        let answer = change(&mut value)?;
        if text(note, &value)? != before && !self.replace(note, known.as_ref(), &value)? {
            return Err(StoreError::Raced { file: self.0.path().to_owned() }.into());
        }
        Ok(answer)
    }

    /// Only if its value is still `before`, `None` for no note: of several programs one succeeds.
    pub fn replace<N: Note>(&self, note: &N, before: Option<&N::Value>, value: &N::Value) -> Result<bool, StoreError> {
        let [kind, about, value] = row(note, value)?;
        let changed = match before {
            None => {
                self.0.changed("INSERT INTO notes VALUES (?1, ?2, ?3) ON CONFLICT DO NOTHING", [kind, about, value])?
            }
            Some(before) => {
                let sql = "UPDATE notes SET value = ?3 WHERE kind = ?1 AND about = ?2 AND value = ?4";
                self.0.changed(sql, [kind, about, value, text(note, before)?])?
            }
        };
        Ok(changed > 0)
    }

    /// Only if the value is the same.
    pub fn forget<N: Note>(&self, note: &N, value: &N::Value) -> Result<(), StoreError> {
        let row = row(note, value)?;
        let sql = "DELETE FROM notes WHERE kind = ?1 AND about = ?2 AND value = ?3";
        self.0.run(sql, row)
    }
}

/// Kind, about and value.
type NoteRow = [String; 3];

/// Returns how many it read.
pub(crate) fn check(connection: &Connection) -> Result<u64, StoreError> {
    let mut checked = 0;
    let rows = |row: &Row<'_>| Ok((row.get(0)?, row.get(1)?));
    for (name, about) in connection.list::<(String, String), Vec<_>>("SELECT kind, about FROM notes", [], rows)? {
        match KINDS.iter().find(|kind| kind.name == name) {
            Some(kind) => (kind.try_read)(connection, &about)?,
            None => return Err(damage("a matter that this program does not know", &name, "no note has this name")),
        }
        checked += 1;
    }
    Ok(checked)
}

pub(crate) fn read_in<N: Note>(connection: &Connection, note: &N) -> Result<Option<N::Value>, StoreError> {
    found::<N>(connection, &note.about())
}

pub(crate) fn write_in<N: Note>(connection: &Connection, note: &N, value: &N::Value) -> Result<(), StoreError> {
    put(connection, &row(note, value)?)
}

/// Whatever its value.
pub(crate) fn forget_in<N: Note>(connection: &Connection, note: &N) -> Result<(), StoreError> {
    connection.run("DELETE FROM notes WHERE kind = ?1 AND about = ?2", [N::NAME, &note.about()])
}

fn put(connection: &Connection, row: &NoteRow) -> Result<(), StoreError> {
    connection.run(
        "INSERT INTO notes VALUES (?1, ?2, ?3) ON CONFLICT (kind, about) DO UPDATE SET value = excluded.value",
        row,
    )
}

fn row<N: Note>(note: &N, value: &N::Value) -> Result<NoteRow, StoreError> {
    Ok([N::NAME.to_owned(), note.about(), text(note, value)?])
}

/// In a list of one, so that a number cut short is not another number.
fn text<N: Note>(note: &N, value: &N::Value) -> Result<String, StoreError> {
    serde_json::to_string(&(value,)).map_err(|error| damage(N::WHAT, &note.about(), &error.to_string()))
}

fn found<N: Note>(connection: &Connection, about: &str) -> Result<Option<N::Value>, StoreError> {
    let sql = "SELECT value FROM notes WHERE kind = ?1 AND about = ?2";
    let bytes = connection.find(sql, [N::NAME, about], |row| {
        Ok(match row.cell(0)? {
            Cell::Text(bytes) => Some(bytes.to_vec()),
            _ => None,
        })
    })?;
    let Some(bytes) = bytes else { return Ok(None) };
    let bytes = bytes.ok_or_else(|| damage(N::WHAT, about, "it is not a text"))?;
    parsed::<N>(about, &bytes).map(Some)
}

pub(crate) fn parsed<N: Note>(about: &str, text: &[u8]) -> Result<N::Value, StoreError> {
    let (value,) = serde_json::from_slice(text).map_err(|error| damage(N::WHAT, about, &error.to_string()))?;
    Ok(value)
}

fn damage(what: &'static str, about: &str, detail: &str) -> StoreError {
    let about = if about.is_empty() { String::new() } else { format!(" ({})", clean(about, 300)) };
    StoreError::Note { file: PathBuf::new(), what, about, detail: clean(detail, 200) }
}

#[cfg(test)]
mod tests;

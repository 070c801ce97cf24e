//! What a home notes beside its tables: small values, each of one type under one key. This file is the whole list. A
//! value that is not of its type is damage, and is reported; it is never taken for none.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::PathBuf;

use rusqlite::types::ValueRef;
use rusqlite::{Connection, Row};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::StoreError;
use crate::database::Statements as _;
use crate::ledger::{Erasure, Notes};
use crate::model::{
    Address, ContactName, Digest, Domain, Hash, ProfileName, PublicKey, RecorderId, RingSpan, SignerId, Timestamp,
    TopicId, TopicName, TypeName, clean,
};

/// A note: its key, and the type of what is kept there.
pub trait Note {
    type Value: Serialize + DeserializeOwned;
    /// Its name in the file.
    const NAME: &'static str;
    /// What it says, for people.
    const WHAT: &'static str;

    /// What distinguishes it from the others of its kind; empty if there is only one.
    fn about(&self) -> String;
}

/// One entry of the list of notes.
#[derive(Debug, Clone, Copy)]
pub struct Kind {
    /// Its name in the file.
    pub name: &'static str,
    /// Reads one, and drops what it says.
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

        /// Every note that there is.
        pub const KINDS: &[Kind] = &[$(Kind::of::<$note>()),*];
    };
}

notes! {
    // This home.

    /// Machine and file where the ledger was last opened: in another place it is a copy.
    LastPlace {} = "place": String, "where this home was last opened";
    /// The newest block that a restored ledger's backup knew.
    CopiedAt {} = "copied at": u64, "how far the chain was known to the backup that was restored";
    /// When this home was restored or copied the last time: what its accounts anchored later, it anchored itself.
    RestoredAt {} = "restored at": Timestamp, "when this home was restored";
    /// Up to which block a copied ledger's accounts may have anchored without it.
    ForeignHistory {} = "foreign history": u64, "up to which block anchors of other copies are history";
    /// When the store was first missed in a home that had keys or an embedded chain already.
    StoreWasGone {} = "store was gone": Timestamp, "when the store was missed";
    /// Anchors by this home's accounts that it did not send.
    SeenForeign {} = "foreign anchors": ForeignAnchors, "the anchors that this home did not send";
    /// Up to which text of [`crate::WaitingFile`] its losses are counted.
    LossesCounted {} = "losses counted": u64, "up to where losses are counted";
    /// Behind which record verified ones are hashed again.
    ScrubbedUpTo {} = "scrubbed": u64, "up to where records were hashed again";

    /// The account of each profile; two while another one is loaded.
    ProfileAccounts {} = "profile accounts": BTreeMap<ProfileName, Vec<Address>>, "which account each profile has";

    // Following the chain.

    /// The first block of which something was missed.
    MissedFrom {} = "missed": u64, "from which block on the chain is to be read again";
    /// Blocks that may have been read only in part.
    UnsureBlocks {} = "unsure blocks": Vec<UnsureBlock>, "the blocks that are to be read again";
    /// Since when the node is behind what was read of it.
    NodeBehind {} = "node behind": AwaitedBlock, "since when the node is behind";
    /// Since when a block is doubted.
    DoubtedBlock {} = "doubted block": AwaitedBlock, "since when a block is doubted";

    // Recording.

    /// The topics that a profile captures until it unwatches them.
    Watched { profile: ProfileName } = "watched": Vec<(TopicName, Option<TypeName>)>, "the watched topics";
    /// A definition that is stored: once for each topic and epoch of an owner. A quarantined one does not count for
    /// readers who may never see it.
    StoredDefinition { domain: Domain, owner: Address, epoch: u64, topic: TopicId, digest: Digest, held: bool }
        = "definition": (), "which definitions are stored";
    /// The spans of a robot's ring that its owner asks for.
    AskedSpans {} = "asked spans": VecDeque<AskedSpan>, "the spans of the ring that are asked for";
    /// What is sealed of an imported file, by its SM3.
    Imported { owner: Address, file: Digest } = "imported": Standings, "what is sealed of an imported file";
    /// How far a file of a followed folder is sealed, by its inode and its first bytes.
    Followed { owner: Address, file: Digest } = "followed": FilePlace, "how far a followed file is sealed";

    /// Which file of a folder was sealed to its end under a name; SM3 of its path.
    SealedUnderName { owner: Address, path: Digest } = "sealed under name": Digest, "which file had a name";

    // What is stated and reported.

    /// The head in an owner's newest record about the audit log.
    StatedAuditHead { owner: Address } = "audit head": StatedHead, "the anchored head of the audit log";
    /// The newest statement of a recorder's numbers. On another chain everything is stated again.
    StatedNumbers { recorder: RecorderId, owner: Address, domain: Domain } = "numbers": StatedRoot,
        "which numbers of a recorder are anchored";
    /// Records refused because their number belongs to another one, as far as they were reported.
    Equivocations { recorder: RecorderId } = "equivocations": Vec<Digest>, "which equivocations are reported";
    /// Whose erasure a retention record is.
    Erased { report: Digest } = "erased": Erasure, "who had records erased";

    // Granting and revoking.

    AddressBook {} = "contacts": Vec<Contact>, "the address book";
    /// The fingerprint of the key for which a reader's keys were wrapped.
    WrappedFor { owner: Address, reader: Address } = "wrapped for": String,
        "for which key a reader's keys were wrapped";
    /// Revocations that are not on the chain yet.
    Revoking { owner: Address } = "revoking": Vec<Address>, "the revocations that the chain is owed";
    /// The name of a topic that a grant covers.
    GrantedTopic { owner: Address, topic: TopicId } = "granted topic": String, "the name of a granted topic";
    /// Whether a grant that was given here opens earlier epochs.
    GrantedEarlier { transaction: Hash } = "granted earlier": bool, "whether a grant opens earlier epochs";

    // This home's gateway.

    /// Who may use it.
    AdmittedOwners {} = "admitted": Vec<AdmittedOwner>, "the owners admitted to the gateway";
    /// The epoch that a revocation will begin, which its owner announced.
    AnnouncedRevoke { owner: Address, reader: Address } = "announced revoke": u64, "an announced revocation";

    // A joined gateway.

    /// What an owner had erased before this number, the gateway was told. Numbers are the ledger's own.
    ErasuresTold { domain: Domain, ledger: String, keeper: Address, owner: Address } = "erasures told": u64,
        "which erasures the gateway was told of";
    /// How far a reader took in what a gateway's feed tells.
    TakenOfFeed { domain: Domain, keeper: Address, reader: Address } = "taken of feed": FeedTaken,
        "how far a gateway's feed was taken in";

    // Robots and their owners.

    /// On a robot: its place in its gateway's feed, the id and the number up to which all is dealt with.
    ProofsTaken { owner: Address } = "proofs taken": ([u8; 16], u64), "how far a robot's gateway was heard out";
    /// The robots that an owner enrolled.
    EnrolledRobots { owner: Address } = "robots": Vec<Enrolled>, "the enrolled robots";
    /// What an owner wants of a robot.
    WantedPolicy { owner: Address, device: SignerId } = "policy wanted": PolicyWanted, "the policy set for a robot";
    /// The newest keys that a robot was told of, in a summary without secrets.
    KeysTold { owner: Address, device: SignerId } = "keys told": String, "which keys a robot was told of";
    /// The owner's keys, old and new, that a robot was told of.
    OwnerKeysTold { owner: Address, device: SignerId } = "owner keys told": (PublicKey, PublicKey),
        "which key of its owner a robot was told of";
    /// The number of the newest notice, under a recorder, that a robot's gateway has.
    NoticesCarried { owner: Address, device: SignerId, gateway: SignerId, recorder: RecorderId } = "notices carried": u64,
        "which notices a robot's gateway has";
    /// On a robot: the policy that it runs. Another enrolment in the same home has its own.
    PolicyHere { owner: Address, device: SignerId } = "policy here": PolicyKept, "the policy of this robot";
    /// On a robot: what its owner was told last of its policy, hex.
    PolicyTold { owner: Address, device: SignerId } = "policy told": String, "what the owner was told of the policy";
}

/// Anchors by an account of this home that this home did not send.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ForeignAnchors {
    /// The account, one of this home's.
    pub account: Address,
    /// How many transactions elsewhere anchored for it.
    pub count: u64,
    /// The block of the last one.
    pub block: u64,
    pub transaction: Hash,
    /// When it was seen here.
    pub seen: Timestamp,
    /// When it was last written to the audit log.
    pub noted: Timestamp,
}

/// A block that may have been read only in part.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UnsureBlock {
    pub block: u64,
    pub hash: Hash,
    /// How many events were read of it.
    pub events: usize,
    /// How often it was read again.
    pub times: usize,
}

/// A block that is waited for.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AwaitedBlock {
    /// Its number and hash.
    pub block: (u64, Hash),
    pub since: Timestamp,
}

/// A span of a ring that its owner asks for.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AskedSpan {
    /// The number of the notice.
    pub number: u64,
    pub span: RingSpan,
}

/// The progress of a topic of an imported file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Standing {
    /// Some messages may be sealed.
    Begun,
    /// All messages are sealed.
    Whole,
}

/// What is sealed of an imported file.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Standings {
    /// Its topics, as far as they were begun.
    pub topics: BTreeMap<String, Standing>,
    /// What the tag `recording` of its records may say: a file is imported alone, with a folder, or followed.
    pub tags: BTreeSet<String>,
}

/// What becomes of a followed file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FileStanding {
    #[default]
    Open,
    /// All of it is sealed, and the statement of its digests.
    Stated,
    /// Its proof is written.
    Proven,
}

/// How far a followed file is sealed.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FilePlace {
    /// The name it had.
    pub name: String,
    /// So many of its messages, in file order, are done with: their records are stored, or they were not wanted.
    pub stored: u64,
    /// Records of messages up to this one may be stored, too: a crash came between.
    pub begun: u64,
    /// How many of its bytes had been read by then.
    pub at: u64,
    /// SM3 of these bytes.
    pub digest: Option<Digest>,
    pub chunks: u64,
    /// Whether its recorder closed it.
    pub closed: bool,
    /// What becomes of it.
    pub standing: FileStanding,
    /// When what the statement is about ended: the time of its record.
    pub stated_at: Option<Timestamp>,
    /// When it was stated, by this machine's clock.
    pub ended_at: Option<Timestamp>,
    /// SM3 of the statement.
    pub statement: Option<Digest>,
    /// Whether a run chose among its topics: what is done with need not be sealed then.
    pub chosen: bool,
}

/// A head of the audit log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StatedHead {
    /// How many lines it covers.
    pub line: u64,
    /// The hash of the last one.
    pub hash: Digest,
}

/// The last statement of a recorder's numbers, and when it was made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StatedRoot {
    /// When it was looked whether they changed.
    pub looked: Timestamp,
    /// The root of the tree over them.
    pub root: Hash,
    /// The statement; `None` before the first.
    pub heads: Option<Digest>,
}

/// One entry of the address book.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Contact {
    pub name: ContactName,
    pub address: Address,
    /// As a person reads it.
    pub fingerprint: Option<String>,
    /// A person gave it, or confirmed it.
    pub given: bool,
}

/// One owner who may use the gateway of this home.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AdmittedOwner {
    pub owner: Address,
    pub since: Timestamp,
    pub by: String,
}

/// How far a gateway's feed was taken in.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FeedTaken {
    /// The feed; numbers of another one say nothing of this one.
    pub feed: [u8; 16],
    /// When it was last begun to be read from the beginning.
    pub begun: Timestamp,
    pub owners: BTreeMap<Address, TakenOfOwner>,
}

/// How far an owner's rows in a gateway's feed were taken in: of those up to the place, each is dealt with, waits, or is read
/// again.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TakenOfOwner {
    /// What was known of the owner.
    pub known: FollowedOwner,
    /// Rows up to this number were told; none as long as they are read for the first time.
    pub place: Option<u64>,
    /// Rows after this number are read, or read again.
    pub back: Option<u64>,
    /// Whether they are read again only to see whether the gateway has what it did not have before.
    pub is_again: bool,
    /// Records that could not be taken in yet, and whether each was erased.
    pub waits: BTreeMap<Digest, bool>,
    /// The lowest number of a record that had no room among them.
    pub beyond: Option<u64>,
    /// The lowest number of a record whose key was not handed over yet.
    pub locked: Option<u64>,
}

/// What was known of an owner when their records were followed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FollowedOwner {
    /// The beginning of the hash of the grant's transaction; 0 for the reader's own records.
    pub grant: u64,
    /// The newest epoch that the reader had keys for.
    pub newest: u64,
    /// How many epochs there were keys for up to it.
    pub count: u64,
}

/// An enrolled device, as its owner's ledger stores it: no secret.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Enrolled {
    pub name: ProfileName,
    /// SM3 of its public key.
    pub device: SignerId,
    /// Its topics; empty = none.
    pub topics: Vec<String>,
    /// Whether it was recalled.
    pub ended: bool,
    pub key: PublicKey,
    /// Its gateway, and where it finds it.
    pub gateway: Option<EnrolledGateway>,
}

/// The gateway of an enrolled robot.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EnrolledGateway {
    /// Host:port each, in the order in which the robot tries them.
    pub addresses: Vec<String>,
    /// SM3 of its identity key.
    pub key: SignerId,
}

/// What an owner wants of a robot.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyWanted {
    /// 0 = nothing was ever set.
    pub version: u64,
    /// Empty = the robot's own settings.
    pub text: String,
    /// When it was set.
    pub set_at: Timestamp,
}

/// What a robot keeps of its policy.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyKept {
    /// The version taken up last; 0 = none yet.
    pub version: u64,
    pub text: String,
    /// The newest version heard of.
    pub heard: u64,
    /// Why the last one heard of was not taken up.
    pub refused: Option<String>,
}

impl Notes {
    /// What is noted; `None` if nothing is.
    pub fn read<N: Note>(&self, note: &N) -> Result<Option<N::Value>, StoreError> {
        self.0.read(|connection| read_in(connection, note))
    }

    /// Notes a value in place of the one before.
    pub fn write<N: Note>(&self, note: &N, value: &N::Value) -> Result<(), StoreError> {
        let row = row(note, value)?;
        self.0.write(move |session| put(session.connection, row))
    }

    /// Changes what is noted, beginning with an empty value if nothing is; what `change` returns is returned. The door
    /// for every note that more than one task reads, changes and writes: of several changes at once none is lost.
    /// `change` itself may read, but changes no other note.
    ///
    /// # Errors
    /// What `change` returns, or those of [`Self::read`] and [`Self::write`]; the value before is then unchanged.
    pub fn change<N: Note<Value: Default>, T, E: From<StoreError>>(
        &self,
        note: &N,
        change: impl FnOnce(&mut N::Value) -> Result<T, E>,
    ) -> Result<T, E> {
        let _one_at_a_time = self.0.one_at_a_time();
        let mut value = self.read(note)?.unwrap_or_default();
        let before = text(note, &value)?;
        let answer = change(&mut value)?;
        if text(note, &value)? != before {
            self.write(note, &value)?;
        }
        Ok(answer)
    }

    /// Drops a note if it still says this.
    pub fn forget<N: Note>(&self, note: &N, value: &N::Value) -> Result<(), StoreError> {
        let row = row(note, value)?;
        let sql = "DELETE FROM notes WHERE kind = ?1 AND about = ?2 AND value = ?3";
        self.0.run(sql, row)
    }
}

/// A row of the table: kind, what it is about, and the value.
type NoteRow = [String; 3];

/// Reads every note that there is, and says how many.
pub(crate) fn check(connection: &Connection) -> Result<u64, StoreError> {
    let mut checked = 0;
    let rows = |row: &Row<'_>| Ok((row.get(0)?, row.get(1)?));
    for (name, about) in connection.list::<(String, String), Vec<_>, _>("SELECT kind, about FROM notes", [], rows)? {
        match KINDS.iter().find(|kind| kind.name == name) {
            Some(kind) => (kind.try_read)(connection, &about)?,
            None => return Err(damage("a matter that this program does not know", &name, "no note has this name")),
        }
        checked += 1;
    }
    Ok(checked)
}

/// As [`Notes::read`], on a snapshot.
pub(crate) fn read_in<N: Note>(connection: &Connection, note: &N) -> Result<Option<N::Value>, StoreError> {
    found::<N>(connection, &note.about())
}

/// As [`Notes::write`], in a transaction.
pub(crate) fn write_in<N: Note>(connection: &Connection, note: &N, value: &N::Value) -> Result<(), StoreError> {
    put(connection, row(note, value)?)
}

/// Drops a note, whatever it says, in a transaction.
pub(crate) fn forget_in<N: Note>(connection: &Connection, note: &N) -> Result<(), StoreError> {
    connection.run("DELETE FROM notes WHERE kind = ?1 AND about = ?2", [N::NAME, &note.about()])?;
    Ok(())
}

fn put(connection: &Connection, row: NoteRow) -> Result<(), StoreError> {
    connection.run("REPLACE INTO notes VALUES (?1, ?2, ?3)", row)?;
    Ok(())
}

fn row<N: Note>(note: &N, value: &N::Value) -> Result<NoteRow, StoreError> {
    Ok([N::NAME.to_owned(), note.about(), text(note, value)?])
}

/// As it is kept, in a list of one: a number that was cut short is then not another number.
fn text<N: Note>(note: &N, value: &N::Value) -> Result<String, StoreError> {
    serde_json::to_string(&(value,)).map_err(|error| damage(N::WHAT, &note.about(), &error.to_string()))
}

fn found<N: Note>(connection: &Connection, about: &str) -> Result<Option<N::Value>, StoreError> {
    let sql = "SELECT value FROM notes WHERE kind = ?1 AND about = ?2";
    let bytes = connection.find(sql, [N::NAME, about], |row| {
        Ok(match row.get_ref(0)? {
            ValueRef::Text(bytes) => Some(bytes.to_vec()),
            _ => None,
        })
    })?;
    let Some(bytes) = bytes else { return Ok(None) };
    let bytes = bytes.ok_or_else(|| damage(N::WHAT, about, "it is not a text"))?;
    parsed::<N>(about, &bytes).map(Some)
}

/// What the text of a note says.
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

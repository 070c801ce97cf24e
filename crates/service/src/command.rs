//! The requests to a site.

#[macro_use]
mod ask;

pub mod filter;
mod wishes;

use std::fmt;
use std::ops::Deref;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use zeroize::{Zeroize, ZeroizeOnDrop};

pub use self::ask::Ask;
pub use self::filter::Term;
pub use self::wishes::*;
pub use crate::store::AuditQuery;

use crate::model::{
    Address, ContactName, IncidentName, OperatorRight, Party, ProfileName, Publisher, Sampling, SignerId, Timestamp,
    TopicName, TopicPattern, TypeName,
};
use crate::reply::{
    AdministrationView, AdmittedView, AlertTestView, AlertsView, AuditCheck, AuditView, BackupView, CaptureSummary,
    ChainView, CheckView, CompareView, ContactRow, CoverageView, DecidedView, DeployedView, DeviceAddressesView,
    DeviceRow, DeviceTopicsView, EnrolledView, ErasureView, EvidenceView, ExportView, ExportedFile, FollowView,
    GatewayStatusView, GatewayView, GrantForesight, GrantRow, IdentityView, ImportView, IncidentView, KeyChangeView,
    KeysView, OpenedView, PathView, PinsView, PlayedView, PolicyView, ProgressView, Provenance, QuarantineView,
    RecordAudit, RecordPage, Result, RingPullView, RobotRow, RobotView, ServedView, SiteView, StampView, TopicRow,
    TransactionView, refused,
};
use crate::ros::readable::Exported;

requests! {
    /// One request to the site, for one profile.
    #[serde(rename_all = "snake_case", tag = "command")]
    enum Command by std::convert::identity;
    /// Create a profile's keys and keyring.
    CreateIdentity { passphrase: SecretText } => IdentityView, PASSPHRASE, HERE;
    /// Show the profile's public identity; needs no passphrase.
    ShowIdentity => IdentityView, LOOK, HERE;
    /// Open the keyring for this session of the site.
    Unlock { passphrase: SecretText } => IdentityView, PASSPHRASE, HERE;
    /// Register the identity on the chain.
    Register => IdentityView, OWNER, HERE;
    /// Keys with fingerprints and epochs.
    ListKeys => KeysView, LOOK, HERE;
    /// Replace one key with one from a file.
    LoadKey {
        kind: KeyKind,
        /// Absolute, 0600; read by the site, which runs as the same user.
        path: std::path::PathBuf,
        /// Passphrase of a V3 keystore file.
        passphrase: Option<SecretText>,
    } => KeysView, PASSPHRASE, KEEPS_KEYS;
    /// Who is affected by a new key pair.
    ForeseeKeyChange { kind: PairKind } => KeyChangeView, LOOK, KEEPS_KEYS;
    /// Begin a new epoch.
    RotateKeys => TransactionView, OWNER, KEEPS_KEYS;
    /// Replace the envelope pair with a new one.
    RotateEnvelope => KeysView, OWNER, KEEPS_KEYS;
    /// Protect the keyring with another passphrase.
    ChangePassphrase { old: SecretText, new: SecretText } => (), PASSPHRASE, HERE;
    /// Export one key; the passphrase is for the V3 keystore of the EOA.
    ExportKey { kind: KeyKind, passphrase: Option<SecretText> } => SecretBytes, PASSPHRASE, HERE;
    /// All topics of the ROS graph.
    ListTopics => Vec<TopicRow>, LOOK, HERE;
    /// When there are own records of each topic, where some are missing, and what was quarantined; needs no passphrase.
    TopicCoverage {
        /// A topic's name also where it has no record; `None` = all.
        topic: Option<TopicPattern>,
        /// An enrolled robot, or the first part of its topics; `None` = all robots.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        robot: Option<String>,
        /// `None` = from the first record.
        since: Option<Timestamp>,
        /// `None` = until now.
        until: Option<Timestamp>,
        /// 1 to 1,000.
        parts: usize,
    } => Vec<CoverageView>, LOOK, HERE;
    /// Capture a topic, in this type if one is given, until it is unwatched; lasts across restarts. A pattern also
    /// covers topics that appear later. Of a topic that is watched already, it replaces what was said before.
    WatchTopic {
        topic: TopicPattern,
        type_name: Option<TypeName>,
        /// How many messages are kept; `None` = as the settings say.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        sampling: Option<Sampling>,
    } => (), CAPTURE, CAPTURES;
    /// Stop capturing what matches.
    UnwatchTopic { topic: TopicPattern } => (), CAPTURE, CAPTURES;
    /// Pinned publishers, and alarms about others.
    ListPins { topic: Option<TopicPattern> } => PinsView, LOOK, HERE;
    /// Accept publishers of a topic; empty = those being read now, of every topic that matches.
    PinTopic { topic: TopicPattern, publishers: Vec<Publisher> } => PinsView, CAPTURE, CAPTURES;
    /// No longer accept a node name on the topics that match.
    UnpinTopic { topic: TopicPattern, caller_id: String } => PinsView, CAPTURE, CAPTURES;
    /// Quarantined messages, oldest first; `limit` 1 to 1,000.
    ListQuarantine { topic: Option<TopicPattern>, limit: usize } => QuarantineView, LOOK, HERE;
    /// Release quarantined messages.
    ReleaseHeld { held: Held } => DecidedView, OWNER, CAPTURES;
    /// Delete quarantined messages.
    DiscardHeld { held: Held } => DecidedView, OWNER, CAPTURES;
    /// Capture topics until a count or time is reached; answered when everything captured is verified.
    Capture {
        /// Patterns stand for what the graph has when it begins.
        topics: Vec<TopicPattern>,
        /// Refuse other types.
        type_name: Option<TypeName>,
        count: Option<u64>,
        milliseconds: Option<u64>,
        /// Tags for the sealed head.
        tags: Vec<(String, String)>,
    } => CaptureSummary, CAPTURE, CAPTURES;
    /// End the running captures and imports of this profile now (their answers follow).
    StopCapture => (), CAPTURE, CAPTURES;
    /// The rule of each topic.
    ShowPolicy => PolicyView, LOOK, HERE;
    // The site reads and writes recordings as its user.
    /// Seal the messages of a recording; answered when all are verified.
    ImportRecording(wishes: ImportWishes) => ImportView, OWNER, CAPTURES;
    /// Seal what is recorded into a folder, until the recording is closed or this is stopped.
    FollowFolder(wishes: FollowWishes) => FollowView, OWNER, CAPTURES;
    /// Seal every message of another home (absolute, read as the site's user); answered when all are verified.
    ImportHome { home: PathBuf } => ImportView, OWNER, CAPTURES;
    /// Write records that this profile may read as a recording.
    ExportRecording(wishes: ExportWishes) => ExportView, OWNER, READS;
    /// Progress of the profile's imports, exports, audits and back-ups; needs no keyring.
    RecordingProgress => Vec<ProgressView>, LOOK, HERE;
    /// Own records.
    ListUploads(query: UploadQuery) => RecordPage, LOOK, HERE;
    /// One own record with its provenance, by its id or the beginning of its digest.
    ShowUpload { id: String } => Provenance, LOOK, HERE;
    /// One own record's files for third parties to check; accounts are redacted without `addresses`.
    ExportUpload { id: String, addresses: bool } => Vec<ExportedFile>, OWNER, OWNS;
    /// Own records with all their proofs, in one file; or what that file would disclose.
    ExportEvidence(wishes: EvidenceWishes) => EvidenceView, OWNER, OWNS;
    /// Request time stamps now for what the authorities have not stamped yet.
    StampEvidence => StampView, OWNER, HERE;
    /// Share with another account.
    Grant {
        grantee: Party,
        /// Only these topics and those of the robots; both empty = all. Patterns and robots stand for what is known when
        /// it is made.
        topics: Vec<TopicPattern>,
        /// Enrolled robots, or first parts of topics.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        robots: Vec<String>,
        from: GrantFrom,
        expires: Option<Timestamp>,
    } => TransactionView, GRANT, SHARES;
    /// What such a grant would open now, and what it costs; changes nothing.
    ForeseeGrant {
        grantee: Party,
        topics: Vec<TopicPattern>,
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        robots: Vec<String>,
        from: GrantFrom,
    } => GrantForesight, LOOK, SHARES;
    /// Extend an active grant.
    ExtendGrant { grantee: Party, expires: Option<Timestamp> } => TransactionView, GRANT, SHARES;
    /// Stop sharing with an account; begins a new epoch.
    Revoke { grantee: Party } => TransactionView, GRANT, SHARES;
    /// Grants given and received.
    ListGrants => Vec<GrantRow>, LOOK, HERE;
    /// Records others share with this profile.
    ListShared(query: UploadQuery) => RecordPage, LOOK, READS;
    /// The paper's Data_Check of one record: digest, signature, and the contract's answer about the right to read it.
    CheckShared { id: String } => CheckView, LOOK, READS;
    /// Check, decrypt and decode one record (shared or own).
    OpenShared { id: String } => Box<OpenedView>, OWNER, READS;
    /// Publish shared records in a ROS graph, each checked first; ends with the connection that requested it.
    Play(wishes: PlayWishes) => PlayedView, OWNER, READS;
    /// End this profile's playback (the answers follow).
    StopPlay => (), OWNER, READS;
    /// Let a device (SM3 of its public key) sign for the profile, until a whole second.
    LendDevice { device: SignerId, until: Option<Timestamp> } => TransactionView, OWNER, SHARES;
    /// Recall a device, by its id or the beginning of it.
    RecallDevice { device: String } => TransactionView, OWNER, SHARES;
    /// Give a robot the keys for more topics; `device` is its name, its device's id, or the beginning of that.
    AddDeviceTopics { device: String, topics: Vec<TopicName> } => DeviceTopicsView, OWNER, SHARES;
    /// Give a robot a further address of its gateway; `device` is its name, its device's id, or the beginning of that.
    AddDeviceAddress { device: String, address: String } => DeviceAddressesView, OWNER, SHARES;
    /// Make a robot a device of the profile, known to its gateway.
    EnrolDevice(wishes: super::site::EnrolWishes) => EnrolledView, PASSPHRASE, SHARES;
    /// Devices lent and recalled.
    ListDevices => Vec<DeviceRow>, LOOK, HERE;
    /// Compare a fingerprint with that of an account's registered key; `None` = this profile's own.
    CompareFingerprint { fingerprint: String, account: Option<Party> } => CompareView, LOOK, HERE;
    /// The address book of this home.
    ListContacts => Vec<ContactRow>, LOOK, HERE;
    /// Add an account to the address book, with its SM2 fingerprint as passed on by a person.
    AddContact { name: ContactName, address: Address, fingerprint: Option<String> } => Vec<ContactRow>, OWNER, KEEPS_NAMES;
    /// Remove an account from the address book.
    RemoveContact { name: ContactName } => Vec<ContactRow>, OWNER, KEEPS_NAMES;
    /// Accept the key that an account has registered now, if it has the given fingerprint.
    ConfirmContact { name: ContactName, fingerprint: Option<String> } => Vec<ContactRow>, OWNER, KEEPS_NAMES;
    /// An act of the contract's administrator.
    Administer(act: Administration) => TransactionView, OWNER, HERE;
    /// Name who may stop a succession of the profile's account; `None` = nobody.
    NameRecovery { recovery: Option<Party> } => TransactionView, OWNER, HERE;
    /// The chain as seen by this profile.
    ChainStatus => Box<ChainView>, LOOK, HERE;
    /// Pending and completed successions, and the profile's recovery account.
    ListSuccessions => Box<AdministrationView>, LOOK, HERE;
    /// Deploy the contract and pin it, unless one is pinned; delay of a succession in seconds [default: a week].
    DeployContract { delay: Option<u64> } => DeployedView, OWNER, HERE;
    /// Cancel a transaction that is in no block: an empty one takes its nonce. `None` = the profile's own account.
    CancelTransaction { nonce: u64, account: Option<Address> } => TransactionView, OWNER, HERE;
    /// Answer other tools' JSON-RPC for the embedded chain on loopback, until the connection that requested it ends.
    ServeChain { address: std::net::SocketAddr } => ServedView, OWNER, HERE;
    /// Serve robots and operators that run no chain client, until this connection ends; the profile's account anchors.
    ServeGateway {
        address: std::net::SocketAddr,
        /// Admit every owner, whatever the settings say.
        open: bool,
    } => GatewayView, OWNER, HERE;
    /// Health, counts and alerts of the whole site.
    SiteStatus => SiteView, LOOK, HERE;
    /// The newest matching audit lines.
    ListAudit(query: AuditQuery) => Vec<AuditView>, LOOK, HERE;
    /// Recompute the whole audit log; with `heads`, which needs the keyring, compare it with the anchored heads.
    VerifyAudit { heads: bool } => AuditCheck, LOOK, HERE;
    /// The whole audit log as a file for third parties; accounts are redacted without `addresses`.
    ExportAudit { addresses: bool } => Vec<ExportedFile>, OWNER, HERE;
    /// Claims the profile for a console until the connection ends; refused if one is open already.
    OpenConsole => (), LOOK, HERE;
    /// One record, checked and opened, as a file; without `kind` a picture's own bytes, else the message's.
    ViewFile { id: String, kind: Option<Exported> } => Box<OpenedView>, OWNER, READS;
    /// The robot's positions from the records of a topic up to this one; `records` 2 to [`LONGEST_PATH`].
    ViewPath { id: String, records: usize } => PathView, OWNER, READS;
    /// Compare all records with their proofs and the chain; with `deep`, also every stored byte and signature.
    AuditRecords { deep: bool, since: Option<Timestamp> } => Box<RecordAudit>, LOOK, HERE;
    // Other profiles' records are not for this profile's operators.
    /// Records of all profiles of the home.
    ListAllUploads(query: UploadQuery) => RecordPage, OWNER, HERE;
    /// Write keyrings, store and chain, settings and pins into one new encrypted file (absolute).
    BackUp { file: PathBuf, passphrase: SecretText } => BackupView, PASSPHRASE, BACKS_UP;
    /// Show which records would be erased, or erase them; needs the keyring.
    EraseRecords(wishes: ErasureWishes) => ErasureView, OWNER, OWNS;
    /// Wipe the keys for reading, granting and revoking; capture and anchoring go on. `Unlock` restores them.
    Lock => IdentityView, OWNER, HERE;
    /// Pause the capture of all watched topics, or resume it; watched topics stay watched.
    HoldCapture { hold: bool } => (), CAPTURE, CAPTURES;
    /// The profile's keyring as stored on disk, under its passphrase.
    BackUpKeys => SecretBytes, OWNER, HERE;
    /// Bring a saved keyring (absolute) into a profile that has none, and open it.
    RestoreKeys { path: PathBuf, passphrase: SecretText } => IdentityView, PASSPHRASE, HERE;
    /// Active alerts.
    ListAlerts => AlertsView, LOOK, HERE;
    /// Send a test alert, marked as such, and return the reply.
    TestAlert => AlertTestView, OWNER, HERE;
    /// Who is connected to the gateway of this site, its system keys, and its refusals.
    GatewayStatus => GatewayStatusView, LOOK, HERE;
    /// The file that makes another machine a worker of this gateway, sealed; with `renew` under a new join key.
    MakeJoinFile { passphrase: SecretText, renew: bool } => SecretBytes, PASSPHRASE, HERE;
    /// Let an owner use the gateway of this home.
    Admit { owner: Party } => Vec<AdmittedView>, OWNER, HERE;
    /// No longer let an owner use it.
    Dismiss { owner: Party } => Vec<AdmittedView>, OWNER, HERE;
    /// The admitted owners.
    ListAdmitted => Vec<AdmittedView>, LOOK, HERE;
    groups {
        /// Incidents: spans of own records, kept together.
        OfIncident(IncidentCommand);
        /// Robots.
        OfRobot(RobotCommand);
    }
}

#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Request {
    pub profile: ProfileName,
    pub command: Command,
}

/// What is to be erased, and why.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ErasureWishes {
    /// Messages of the topics that match.
    pub topic: Option<TopicPattern>,
    /// Messages of an enrolled robot, or of the topics under its name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot: Option<String>,
    pub since: Option<Timestamp>,
    pub until: Option<Timestamp>,
    /// Beginnings of digests; nothing else then decides.
    pub records: Vec<String>,
    /// Tag of the import that sealed them, 16 hexadecimal digits.
    pub recording: Option<String>,
    /// Kept with who and when.
    pub reason: String,
    /// Erase; otherwise only show.
    pub sure: bool,
    /// How many would go, as shown before: no other number is erased.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shown: Option<u64>,
}

/// Own records for a bundle; all if nothing narrows it.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct EvidenceWishes {
    /// Absolute; must not exist. Written by the site, which runs as the same user.
    pub file: PathBuf,
    pub records: Vec<String>,
    /// Empty = all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub topics: Vec<TopicPattern>,
    /// An enrolled robot, or the first part of its topics.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot: Option<String>,
    /// Those in this incident.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub incident: Option<IncidentName>,
    pub since: Option<Timestamp>,
    pub until: Option<Timestamp>,
    /// Ids of records to disclose.
    pub reveal: Vec<String>,
    /// Disclose the messages of these topics, as far as they are chosen.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub reveal_topics: Vec<TopicPattern>,
    /// Disclose every chosen message.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub reveal_all: bool,
    /// Write the file; otherwise only show what it would disclose.
    pub sure: bool,
}

requests! {
    /// Needs no keyring.
    #[serde(rename_all = "snake_case", tag = "incident")]
    enum IncidentCommand by Command::OfIncident;
    /// Keep a span together: retention does not delete its records.
    OpenIncident {
        name: IncidentName,
        /// Captured at this time or later.
        since: Timestamp,
        /// Captured before; `None` = until it is closed.
        until: Option<Timestamp>,
        /// Empty = all. Patterns also cover topics that appear later.
        topics: Vec<TopicPattern>,
        note: Option<String>,
        /// Robots whose rings are searched for it; needs the keyring.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        robots: Vec<String>,
    } => IncidentView, OWNER, HOLDS;
    /// All incidents of the profile, each with what it holds.
    ListIncidents => Vec<IncidentView>, LOOK, HERE;
    /// One incident.
    ShowIncident { name: IncidentName } => IncidentView, LOOK, HERE;
    /// Add a note.
    NoteIncident { name: IncidentName, text: String } => IncidentView, OWNER, HOLDS;
    /// End its span now; its records stay held.
    CloseIncident { name: IncidentName } => IncidentView, OWNER, HOLDS;
    /// Remove it: its records are subject to retention again.
    RemoveIncident { name: IncidentName } => Vec<IncidentView>, OWNER, HOLDS;
}

/// The longest policy of a robot, bytes.
pub const LONGEST_POLICY: usize = crate::crypto::LONGEST_POLICY;

requests! {
    /// Needs the keyring.
    #[serde(rename_all = "snake_case", tag = "robot")]
    enum RobotCommand by Command::OfRobot;
    /// Request a span of a robot's ring; the robot sends it like other records.
    PullRing {
        /// Name, or the beginning of the device's id.
        name: String,
        /// `None` = since the incident begins.
        since: Option<Timestamp>,
        /// `None` = until the incident ends, or until now.
        until: Option<Timestamp>,
        /// Empty = those of the incident, or all.
        topics: Vec<TopicPattern>,
        /// Supplies what is not given here.
        incident: Option<IncidentName>,
    } => RingPullView, OWNER, SHARES;
    /// The enrolled robots, each with the policy wanted and the one it works by.
    ListRobots => Vec<RobotRow>, LOOK, HERE;
    /// One robot with its policy, topics and losses, by its name or the beginning of its device's id.
    ShowRobot { name: String } => RobotView, LOOK, HERE;
    // The account signs what a robot obeys.
    /// Set the policy of a robot, as TOML; empty = its own settings alone.
    SetRobotPolicy { name: String, text: String } => RobotView, OWNER, SHARES;
}

/// The most records of a path.
pub const LONGEST_PATH: usize = 1_000;

/// A secret on its way to or from the site of the same user. Never in Debug.
#[derive(Clone, Serialize, Deserialize, Zeroize, ZeroizeOnDrop)]
#[serde(transparent)]
pub struct Secret<T: Zeroize>(T);

/// A passphrase.
pub type SecretText = Secret<String>;
/// A key file.
pub type SecretBytes = Secret<Vec<u8>>;

impl<T: Zeroize + Deref> Secret<T> {
    pub fn new(secret: T) -> Self {
        Self(secret)
    }

    pub fn expose(&self) -> &T::Target {
        &self.0
    }
}

impl<T: Zeroize> fmt::Debug for Secret<T> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("Secret(…)")
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Needed {
    /// An operator with this right, or the owner.
    Right(OperatorRight),
    Owner,
    /// The owner alone: it carries a passphrase.
    Passphrase,
}

pub(super) const LOOK: Needed = Needed::Right(OperatorRight::Look);
pub(super) const CAPTURE: Needed = Needed::Right(OperatorRight::Capture);
pub(super) const GRANT: Needed = Needed::Right(OperatorRight::Grant);
pub(super) const OWNER: Needed = Needed::Owner;
pub(super) const PASSPHRASE: Needed = Needed::Passphrase;

impl Needed {
    /// A constant word, for counting refusals.
    pub fn word(self) -> &'static str {
        match self {
            Self::Right(right) => right.word(),
            Self::Owner => "owner",
            Self::Passphrase => "passphrase",
        }
    }
}

/// A request's tags, read without the rest of it.
#[derive(Debug, Deserialize)]
pub struct Kind {
    command: String,
}

impl Kind {
    pub fn carries_passphrase(&self) -> bool {
        let with = [
            "create_identity",
            "unlock",
            "load_key",
            "change_passphrase",
            "export_key",
            "enrol_device",
            "back_up",
            "restore_keys",
            "make_join_file",
        ];
        with.contains(&self.command.as_str())
    }
}

/// Why a gateway's home on a server leaves a request to another home: it has no tables for it, or no use.
pub(super) type Elsewhere = Option<&'static str>;

pub(super) const HERE: Elsewhere = None;
pub(super) const CAPTURES: Elsewhere =
    Some("it captures and imports nothing; do that in a home that joins this gateway (--site)");
pub(super) const READS: Elsewhere = Some("it opens no records; read them in a home that joins this gateway (--site)");
pub(super) const OWNS: Elsewhere =
    Some("it has no records of its own; do that in the home of the owner of the records");
pub(super) const SHARES: Elsewhere =
    Some("it grants nothing and authorises no robots; do that in the home of the owner of the records");
pub(super) const KEEPS_KEYS: Elsewhere = Some(
    "its robots and its database know it by its keys, so they stay; a gateway with other keys begins in a new home",
);
pub(super) const KEEPS_NAMES: Elsewhere =
    Some("it keeps no address book; name accounts by their address (0x and 40 hex digits)");
pub(super) const HOLDS: Elsewhere = Some("it holds no incidents; open them in the home of the owner of the records");
pub(super) const BACKS_UP: Elsewhere = Some(
    "its records are in PostgreSQL, whose own tools back them up (pg_basebackup, pg_dump); save its keyring with \
     `authros keys backup`",
);

impl Command {
    /// Whether it changes neither home nor chain; a read-only home allows nothing else.
    pub fn only_reads(&self) -> bool {
        let shows = matches!(
            self,
            Self::Unlock { .. }
                | Self::ExportUpload { .. }
                | Self::ExportEvidence(_)
                | Self::OpenShared { .. }
                | Self::ViewFile { .. }
                | Self::ViewPath { .. }
                | Self::ExportAudit { .. }
                | Self::ListAllUploads(_)
                | Self::ExportRecording(_)
        );
        shows || self.needs() == LOOK
    }

    /// Refuses what a home with its store on a server does not do.
    pub fn check_on_server(&self) -> Result<()> {
        let Some(elsewhere) = self.elsewhere() else { return Ok(()) };
        Err(refused(format!("this is the home of a gateway on a server (store.url): {elsewhere}")))
    }
}

#[cfg(test)]
mod right_tests;

//! What can be asked of a site.

#[macro_use]
mod ask;
mod administration;
mod check;
mod choices;
mod evidence;
pub mod filter;
mod incidents;
mod operate;
mod playing;
mod recordings;
mod secret;
mod viewing;

use serde::{Deserialize, Serialize};

pub use self::administration::Administration;
pub use self::ask::Ask;
pub use self::check::{AuditRecords, BackUp, ListAllUploads, StoreCommand};
pub use self::choices::{Epochs, Held, KeyKind, PairKind, UploadQuery};
pub use self::evidence::EvidenceWishes;
pub use self::filter::Term;
pub use self::incidents::{
    CloseIncident, IncidentCommand, ListIncidents, NoteIncident, OpenIncident, RemoveIncident, ShowIncident,
};
pub use self::operate::{
    Admit, BackUpKeys, Dismiss, GatewayStatus, HoldCapture, ListAdmitted, ListAlerts, ListWatches, Lock, Operation,
    TestAlert,
};
pub use self::playing::{Pace, PlayWishes, Remap};
pub use self::recordings::{ExportWishes, ImportWishes, PolicyCommand, RecordingCommand, RecordingProgress};
pub use self::secret::{SecretBytes, SecretText};
pub use self::viewing::{LONGEST_PATH, ViewFile, ViewPath, Viewing};
use crate::chain::Revision;
use crate::model::{Address, ContactName, Party, ProfileName, Publisher, SignerId, Timestamp, TopicName, TypeName};
use crate::service::reply::{
    AdministrationView, AuditCheck, AuditView, CaptureSummary, ChainView, CheckView, CompareView, ContactRow,
    CoverageView, DecidedView, DeployedView, DeviceRow, DeviceTopicsView, EnrolledView, EvidenceView, ExportedFile,
    GatewayView, GrantRow, IdentityView, KeyChangeView, KeysView, OpenedView, PinsView, PlayedView, PolicyView,
    Provenance, QuarantineView, RecordPage, ServedView, SiteView, StampView, TopicRow, TransactionView,
};
pub use crate::store::AuditQuery;

requests! {
    /// One thing asked of the site, for one profile.
    #[serde(rename_all = "snake_case", tag = "command")]
    enum Command by std::convert::identity;
    /// Make a profile's keys and keyring.
    CreateIdentity {
        /// Protects the keyring.
        passphrase: SecretText,
    } => IdentityView;
    /// Show the profile's public identity; needs no passphrase.
    ShowIdentity => IdentityView;
    /// Open the keyring for this session of the site.
    Unlock {
        /// The keyring's.
        passphrase: SecretText,
    } => IdentityView;
    /// Put the identity on the chain.
    Register => IdentityView;
    /// Keys with fingerprints and epochs.
    ListKeys => KeysView;
    /// Replace one key by a loaded one.
    LoadKey {
        /// Which key.
        kind: KeyKind,
        /// The file, absolute; 0600. Read by the site, which is of the same user.
        path: std::path::PathBuf,
        /// Passphrase of a V3 keystore file.
        passphrase: Option<SecretText>,
    } => KeysView;
    /// Begin a new epoch.
    RotateKeys => TransactionView;
    /// Replace the envelope pair by a new one.
    RotateEnvelope => KeysView;
    /// Whom another SM2 pair touches; changes nothing.
    ForeseeKeyChange {
        /// Which pair.
        kind: PairKind,
    } => KeyChangeView;
    /// Protect the keyring by another passphrase.
    ChangePassphrase {
        /// The present one.
        old: SecretText,
        /// The one from then on.
        new: SecretText,
    } => ();
    /// Hand one key out.
    ExportKey {
        /// Which key.
        kind: KeyKind,
        /// Passphrase for the V3 keystore written (EOA only).
        passphrase: Option<SecretText>,
    } => SecretBytes;
    /// All topics of the ROS graph.
    ListTopics => Vec<TopicRow>;
    /// When there are own records of a topic, where something is missing, and what was held back; needs no passphrase.
    TopicCoverage {
        /// The topic.
        topic: TopicName,
        /// From then on; `None` = from its first record on.
        since: Option<Timestamp>,
        /// Before then; `None` = until now.
        until: Option<Timestamp>,
        /// Into so many parts, 1 to 1,000.
        parts: usize,
    } => CoverageView;
    /// Capture a topic until it is unwatched, over restarts.
    WatchTopic {
        /// The topic.
        topic: TopicName,
        /// Refuse other types.
        type_name: Option<TypeName>,
    } => ();
    /// Stop capturing a topic.
    UnwatchTopic {
        /// The topic.
        topic: TopicName,
    } => ();
    /// Pinned publishers, and alarms about others.
    ListPins {
        /// Only of this topic.
        topic: Option<TopicName>,
    } => PinsView;
    /// Accept publishers of a topic.
    PinTopic {
        /// The topic.
        topic: TopicName,
        /// Who; empty = those that are being read now.
        publishers: Vec<Publisher>,
    } => PinsView;
    /// No longer accept a caller id on a topic.
    UnpinTopic {
        /// The topic.
        topic: TopicName,
        /// The node name.
        caller_id: String,
    } => PinsView;
    /// No longer accept one publisher of a topic; others of its caller id stay.
    UnpinPublisher {
        /// The topic.
        topic: TopicName,
        /// Who.
        publisher: Publisher,
    } => PinsView;
    /// Messages that are held back, oldest first.
    ListQuarantine {
        /// Only of this topic.
        topic: Option<TopicName>,
        /// At most so many, 1 to 1,000.
        limit: usize,
    } => QuarantineView;
    /// Let quarantined messages go on.
    ReleaseHeld {
        /// Which.
        held: Held,
    } => DecidedView;
    /// Delete quarantined messages.
    DiscardHeld {
        /// Which.
        held: Held,
    } => DecidedView;
    /// Capture topics until a count or time is reached; answers when all captured is verified.
    Capture {
        /// The topics.
        topics: Vec<TopicName>,
        /// Refuse other types.
        type_name: Option<TypeName>,
        /// So many messages of each topic.
        count: Option<u64>,
        /// So many milliseconds.
        milliseconds: Option<u64>,
        /// Tags for the sealed head.
        tags: Vec<(String, String)>,
    } => CaptureSummary;
    /// End the running captures and imports of this profile now (their answers follow).
    StopCapture => ();
    /// Rules for topics.
    Policy {
        /// What with them.
        with: PolicyCommand,
    } => PolicyView;
    /// Own records.
    ListUploads(query: UploadQuery) => RecordPage;
    /// One own record with its provenance.
    ShowUpload {
        /// Its id, or the beginning of its digest.
        id: String,
    } => Provenance;
    /// One own record's files for others to check.
    ExportUpload {
        /// Its id.
        id: String,
        /// With addresses in full.
        #[serde(default)]
        addresses: bool,
    } => Vec<ExportedFile>;
    /// Own records with all that proves them, in one file.
    ExportEvidence(wishes: EvidenceWishes) => EvidenceView;
    /// What is not stamped by the time stamp authorities yet, now.
    StampEvidence => StampView;
    /// Share with another account.
    Grant {
        /// Who may read.
        grantee: Party,
        /// Only these topics; empty = all.
        topics: Vec<TopicName>,
        /// Which epochs.
        epochs: Epochs,
        /// When the grant ends.
        expires: Option<Timestamp>,
    } => TransactionView;
    /// Let an active grant end later.
    ExtendGrant {
        /// Whose.
        grantee: Party,
        /// Its new end; `None` = no end.
        expires: Option<Timestamp>,
    } => TransactionView;
    /// Stop sharing with an account; begins a new epoch.
    Revoke {
        /// Who may no longer read.
        grantee: Party,
    } => TransactionView;
    /// Grants given and received.
    ListGrants => Vec<GrantRow>;
    /// Records others share with this profile.
    ListShared(query: UploadQuery) => RecordPage;
    /// The paper's Data_Check of one record: digest against the chain, signature.
    CheckShared {
        /// Its id.
        id: String,
    } => CheckView;
    /// Check, decrypt and decode one record (shared or own).
    OpenShared {
        /// Its id.
        id: String,
    } => Box<OpenedView>;
    /// Publish shared records in a ROS graph, each checked first; ends with the connection that asks for it at the latest.
    Play(wishes: PlayWishes) => PlayedView;
    /// End what this profile plays (its answers follow).
    StopPlay => ();
    /// Let a device sign for the profile.
    LendDevice {
        /// SM3 of its public key.
        device: SignerId,
        /// When the loan ends, whole seconds.
        until: Option<Timestamp>,
    } => TransactionView;
    /// Take a loan back.
    RecallDevice {
        /// The device's id, or the beginning of it.
        device: String,
    } => TransactionView;
    /// Give an enrolled robot the keys of more topics.
    AddDeviceTopics {
        /// Its name, the device's id, or the beginning of it.
        device: String,
        /// The topics.
        topics: Vec<TopicName>,
    } => DeviceTopicsView;
    /// Make a robot a device of the profile, known to a gateway.
    EnrolDevice(wishes: super::site::EnrolWishes) => EnrolledView;
    /// Devices lent and recalled.
    ListDevices => Vec<DeviceRow>;
    /// A fingerprint beside that of an account's registered key.
    CompareFingerprint {
        /// As a person was told it.
        fingerprint: String,
        /// Whose; `None` = this profile's own.
        account: Option<Party>,
    } => CompareView;
    /// The address book of this home.
    ListContacts => Vec<ContactRow>;
    /// Enter an account.
    AddContact {
        /// Its name here.
        name: ContactName,
        /// Its address.
        address: Address,
        /// Of its SM2 key, as a person was told it.
        fingerprint: Option<String>,
    } => Vec<ContactRow>;
    /// Take an account out.
    RemoveContact {
        /// Its name.
        name: ContactName,
    } => Vec<ContactRow>;
    /// Take the key that an account has registered now for the right one.
    ConfirmContact {
        /// Its name.
        name: ContactName,
        /// Only where it has this fingerprint.
        fingerprint: Option<String>,
    } => Vec<ContactRow>;
    /// An act of the contract's administrator.
    Administer(act: Administration) => TransactionView;
    /// Name who may stop a succession of the profile's account; `None` = nobody.
    NameRecovery {
        /// Who.
        recovery: Option<Party>,
    } => TransactionView;
    /// The chain as seen by this profile.
    ChainStatus => Box<ChainView>;
    /// Successions that wait and that came about, and the profile's recovery account.
    ListSuccessions => Box<AdministrationView>;
    /// Go on with the chain that is there now instead of the pinned one.
    AdoptChain => TransactionView;
    /// Put the contract on the chain and pin it; refused where one is pinned already.
    DeployContract {
        /// How long a succession waits, seconds [default: a week].
        #[serde(default)]
        delay: Option<u64>,
        /// Which revision [default: the newest].
        #[serde(default)]
        revision: Option<Revision>,
    } => DeployedView;
    /// Answer other tools' JSON-RPC over the embedded chain, until the connection that asks for it ends.
    ServeChain {
        /// Where, on loopback.
        address: std::net::SocketAddr,
    } => ServedView;
    /// Serve robots and operators that run no chain client, until the connection that asks for it ends. The
    /// profile's account anchors what they send.
    ServeGateway {
        /// Where.
        address: std::net::SocketAddr,
        /// Also for owners whom nobody admitted, whatever the settings say.
        #[serde(default)]
        open: bool,
    } => GatewayView;
    /// Health, counts and alerts of the whole site.
    SiteStatus => SiteView;
    /// The newest audit lines that match.
    ListAudit(query: AuditQuery) => Vec<AuditView>;
    /// Recompute the whole audit log; compare it with the heads that this profile anchored.
    VerifyAudit {
        /// Also the anchored heads: needs the keyring open.
        heads: bool,
    } => AuditCheck;
    /// The whole audit log as a file for others.
    ExportAudit {
        /// With addresses in full.
        addresses: bool,
    } => Vec<ExportedFile>;
    /// Claims the profile for a console, until the connection ends; refused where one is open already.
    OpenConsole => ();
    groups {
        /// Recordings: bags and MCAP.
        Recording {
            /// What with them.
            with: RecordingCommand,
        },
        /// Look at opened records: as files, as a path.
        View(Viewing),
        /// About the whole store.
        OfStore(StoreCommand),
        /// What an operator asks of the site itself.
        Operate(Operation),
        /// Incidents: spans of own records, kept together.
        OfIncident(IncidentCommand),
    }
}

/// A command with the profile it is for.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Request {
    /// Whose keys and records.
    pub profile: ProfileName,
    /// What to do.
    pub command: Command,
}

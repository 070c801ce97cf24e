//! A site's answers: the very structures that `--json` prints.

mod chain;
mod identity;
mod records;
mod site;
mod topics;

pub use self::chain::{
    BackupView, ChainView, CheckStatus, DecidedView, DeployedView, DoctorCheck, DoctorView, ErasureView, FindingKind,
    GasView, GatewayView, HeldView, PinView, PinsView, PricesView, QuarantineView, RecordAudit, RecordFinding,
    ServedView, WaitingView,
};
pub use self::identity::{
    AdministrationView, CompareView, ContactRow, DeviceAddressesView, DeviceRow, DeviceTopicsView, Direction,
    EnrolledView, EpochRecords, EpochView, GrantRow, GrantState, IdentityView, KeyChangeView, KeysView, ProposalView,
    RecoveryView, RobotGatewayView, SuccessionView, TransactionView,
};
pub use self::records::{
    Caveat, CheckView, ContractAnswer, EvidenceView, ExportedFile, OpenedView, Provenance, RecordPage, RecordView,
    Refusal, ShownState, StampView, StampedView,
};
pub use self::site::{HealthLevel, LifeLine, PartHealth, QueueView, SiteView};
pub use self::topics::{
    CaptureSummary, CoverageView, ExportView, ExportedTopic, FollowView, FollowedFile, HeldUp, ImportView,
    ImportedTopic, PlayEnd, PlayedView, PolicyRow, PolicyView, ProgressView, Refused, TopicRow, TopicSummary,
};
pub use crate::ros::graph::Unreached as UnreachedView;
pub use crate::ros::recording::Unusable as LeftOut;
pub use crate::store::{
    AlarmRow as AlarmView, CoveragePart, IncidentNote as IncidentNoteView, SpanCoverage as SpanCoverageView,
};

use serde::{Deserialize, Serialize};

use crate::command::SecretBytes;
use crate::model::{Address, ErrorKind, IncidentName, ProfileName, SignerId, Timestamp};
use crate::ros::readable::Plot;

/// Why a command failed, in words for people.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[error("{message}")]
pub struct Failure {
    /// Decides the exit code.
    pub kind: ErrorKind,
    /// What happened, to what, and what to do next. Cleaned.
    pub message: String,
}

impl Failure {
    /// A failure of `kind`.
    pub fn new(kind: ErrorKind, message: impl Into<String>) -> Self {
        Self { kind, message: message.into() }
    }

    /// The failure of a site that gave the answer to another question.
    pub fn of_another_version() -> Self {
        Self::new(ErrorKind::Internal, "the site's answer does not match the request; it may be another version")
    }
}

/// A possible answer to a request: it goes over the wire as one variant of [`Reply`].
pub trait Answer: Sized {
    /// Its form on the wire.
    fn into_reply(self) -> Reply;

    /// The answer from what came over the wire; `None` if that is another answer.
    fn from_reply(reply: Reply) -> Option<Self>;
}

/// Generates the enum of answers, and makes each variant's type an [`Answer`].
macro_rules! replies {
    ($($(#[$doc:meta])+ $name:ident($view:ty);)+) => {
        /// The answer to a command.
        #[derive(Debug, Clone, Serialize, Deserialize)]
        #[serde(rename_all = "snake_case", tag = "reply", content = "with")]
        pub enum Reply {
            /// Done, nothing to report.
            Done,
            $($(#[$doc])+ $name($view),)+
        }

        $(
            impl Answer for $view {
                fn into_reply(self) -> Reply {
                    Reply::$name(self)
                }

                fn from_reply(reply: Reply) -> Option<Self> {
                    if let Reply::$name(view) = reply { Some(view) } else { None }
                }
            }
        )+
    };
}

impl Answer for () {
    fn into_reply(self) -> Reply {
        Reply::Done
    }

    fn from_reply(reply: Reply) -> Option<Self> {
        matches!(reply, Reply::Done).then_some(())
    }
}

replies! {
    /// To identity commands.
    Identity(IdentityView);
    /// To `ListKeys`, `LoadKey` and `RotateEnvelope`.
    Keys(KeysView);
    /// To `ForeseeKeyChange`.
    KeyChange(KeyChangeView);
    /// To `ExportKey`.
    Key(SecretBytes);
    /// To `ListTopics`.
    Topics(Vec<TopicRow>);
    /// To `TopicCoverage`.
    Coverage(CoverageView);
    /// To `Capture`.
    Captured(CaptureSummary);
    /// To `ImportRecording` and `ImportHome`.
    Imported(ImportView);
    /// To `FollowFolder`.
    Followed(FollowView);
    /// To `ExportRecording`.
    Exported(ExportView);
    /// To `RecordingProgress`.
    Progress(Vec<ProgressView>);
    /// To `ShowPolicy` and `LearnPolicy`.
    Policy(PolicyView);
    /// To lists of records.
    Records(RecordPage);
    /// To `ShowUpload`.
    Provenance(Provenance);
    /// To `ExportUpload` and `ExportAudit`.
    Files(Vec<ExportedFile>);
    /// To `ExportEvidence`.
    Evidence(EvidenceView);
    /// To `StampEvidence`.
    Stamped(StampView);
    /// To `Play`.
    Played(PlayedView);
    /// To commands that send a transaction.
    Transaction(TransactionView);
    /// To `ListGrants`.
    Grants(Vec<GrantRow>);
    /// To `ListDevices`.
    Devices(Vec<DeviceRow>);
    /// To `AddDeviceTopics`.
    DeviceTopics(DeviceTopicsView);
    /// To `AddDeviceAddress`.
    DeviceAddresses(DeviceAddressesView);
    /// To `EnrolDevice`.
    Enrolled(EnrolledView);
    /// To `CompareFingerprint`.
    Compared(CompareView);
    /// To commands of the address book.
    Contacts(Vec<ContactRow>);
    /// To `CheckShared`.
    Check(CheckView);
    /// To `OpenShared`.
    Opened(Box<OpenedView>);
    /// To `ViewPath`.
    Path(PathView);
    /// To commands about pins.
    Pins(PinsView);
    /// To `ListQuarantine`.
    Quarantine(QuarantineView);
    /// To `ReleaseHeld` and `DiscardHeld`.
    Decided(DecidedView);
    /// To `ChainStatus`.
    Chain(Box<ChainView>);
    /// To `ListSuccessions`.
    Administration(Box<AdministrationView>);
    /// To `DeployContract`.
    Deployed(DeployedView);
    /// To `ServeChain`.
    Served(ServedView);
    /// To `ServeGateway`.
    Gateway(GatewayView);
    /// To `GatewayStatus`.
    GatewayStatus(GatewayStatusView);
    /// To `Admit`, `Dismiss` and `ListAdmitted`.
    Admitted(Vec<AdmittedView>);
    /// To `ListAlerts`.
    Alerts(AlertsView);
    /// To `TestAlert`.
    AlertTested(AlertTestView);
    /// To `SiteStatus`.
    Site(SiteView);
    /// To `ListAudit`.
    Audit(Vec<AuditView>);
    /// To `AuditRecords`.
    RecordsAudited(Box<RecordAudit>);
    /// To `BackUp`.
    BackedUp(BackupView);
    /// To `EraseRecords`.
    Erased(ErasureView);
    /// To `VerifyAudit`.
    AuditChecked(AuditCheck);
    /// To `OpenIncident`, `ShowIncident`, `NoteIncident` and `CloseIncident`.
    Incident(IncidentView);
    /// To `ListIncidents` and `RemoveIncident`.
    Incidents(Vec<IncidentView>);
    /// To `PullRing`.
    RingPull(RingPullView);
    /// To `ListRobots`.
    Robots(Vec<RobotRow>);
    /// To `ShowRobot` and `SetRobotPolicy`.
    Robot(RobotView);
}

/// The severity of an alert.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// Somebody should look at it today.
    Warning,
    /// Somebody should look at it now.
    Critical,
}

impl Severity {
    /// In one word.
    pub fn word(self) -> &'static str {
        self.into()
    }
}

/// An alert, active or ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlertView {
    /// The rule, and its subject if there can be several: `disk`, `robot_silent/1f2e3d4c`.
    pub key: String,
    /// Its severity.
    pub severity: Severity,
    /// What happened and what to do, without topics, names and keys.
    pub text: String,
    /// The beginning of the address of one of the site's accounts.
    pub site: String,
    /// Active since.
    pub begun: Timestamp,
}

/// An alert that has ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct EndedAlert {
    /// Its last state.
    #[serde(flatten)]
    pub alert: AlertView,
    /// When it ended.
    pub ended: Timestamp,
}

/// All active alerts, and those that ended recently.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlertsView {
    /// The active ones, by their keys.
    pub alerts: Vec<AlertView>,
    /// Those that ended in the last 15 minutes, newest first; of one process, at most 20.
    pub over: Vec<EndedAlert>,
    /// The destination of alerts, or that there is none.
    pub told: String,
    /// Deliveries that wait.
    pub waiting: u64,
    /// Deliveries dropped for want of room; the next one reports how many.
    pub dropped: u64,
}

/// The result of a test alert.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlertTestView {
    /// Where it was sent.
    pub place: String,
    /// The reply, cleaned.
    pub text: String,
}

/// One line of the audit log.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AuditView {
    /// Its number.
    pub line: u64,
    /// Its time.
    pub at: Timestamp,
    /// The profile.
    pub profile: String,
    /// The operator who did it, if it was not the profile's owner.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub operator: Option<String>,
    /// The deed.
    pub action: String,
    /// Its object, cleaned.
    pub subject: String,
    /// Its outcome.
    pub outcome: String,
}

impl AuditView {
    /// Who did it: the profile, or `profile/operator`.
    pub fn by(&self) -> String {
        match &self.operator {
            Some(operator) => format!("{}/{operator}", self.profile),
            None => self.profile.clone(),
        }
    }
}

/// The result of a check of the audit log.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AuditCheck {
    /// Whether nothing is wrong.
    pub ok: bool,
    /// Lines in the unbroken hash chain; 0 if it is broken.
    pub lines: u64,
    /// Heads of this profile that were compared.
    pub heads: u64,
    /// Of these, confirmed on the chain.
    pub anchored: u64,
    /// Lines below the newest of these heads.
    pub covered: u64,
    /// The first line that is wrong.
    pub broken_line: Option<u64>,
    /// The reason.
    pub text: Option<String>,
    /// Records of heads that fail their own checks, with the reasons.
    pub unusable: Vec<String>,
}

/// An incident and its records.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct IncidentView {
    /// Its name.
    pub name: IncidentName,
    /// Whether it is still open.
    pub open: bool,
    /// Holds records captured at this time or later.
    pub since: Timestamp,
    /// And before this time; `None` = it is still open.
    pub until: Option<Timestamp>,
    /// When it was opened.
    pub opened_at: Timestamp,
    /// When it was closed.
    pub closed_at: Option<Timestamp>,
    /// Its topics; empty = all. Cleaned.
    pub topics: Vec<String>,
    /// Oldest first.
    pub notes: Vec<IncidentNoteView>,
    /// Its records, of all topics.
    pub records: u64,
    /// Bytes of their messages.
    pub bytes: u64,
    /// Its records by topic.
    pub coverage: Vec<SpanCoverageView>,
}

/// A name known to the gateway, and its session if it has one.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SenderView {
    /// N, the name.
    pub name: ProfileName,
    /// The account it belongs to.
    pub account: Address,
    /// Its current sessions.
    pub sessions: u64,
    /// The remote address of the newest.
    pub peer: Option<String>,
    /// Connected since.
    pub since: Option<Timestamp>,
    /// When its last frame arrived.
    pub last: Option<Timestamp>,
    /// Frames of its sessions.
    pub frames: u64,
    /// Bytes of these frames.
    pub bytes: u64,
}

/// One system key (P_S) of the published list.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct SystemKeyView {
    /// SM3 of P_S.
    pub id: SignerId,
    /// In use from this time.
    pub not_before: Timestamp,
    /// In use until this time.
    pub not_after: Timestamp,
    /// Whether it is in use now.
    pub current: bool,
}

/// Refusals for one reason since the gateway was started.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RefusedView {
    /// The reason's number in the protocol.
    pub code: u16,
    /// The reason in words, and what the peer should do.
    pub text: String,
    /// How often.
    pub count: u64,
}

/// An owner who may use the gateway of this home.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AdmittedView {
    /// The owner.
    pub owner: Address,
    /// Its name in the address book.
    pub name: Option<String>,
    /// Admitted since.
    pub since: Timestamp,
    /// The profile that admitted it, or why it is listed.
    pub by: String,
}

/// The gateway of this site at a glance.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GatewayStatusView {
    /// The gateway served here; `None` = no gateway runs here.
    pub served: Option<GatewayView>,
    /// The gateway through which this site joins a remote one.
    pub through: Option<String>,
    /// Connections, including those in their handshake.
    pub connections: u64,
    /// Names with a transport key, connected ones first.
    pub senders: Vec<SenderView>,
    /// The published list of system keys.
    pub keys: Vec<SystemKeyView>,
    /// Its version.
    pub list_version: u64,
    /// When it expires.
    pub list_expires: Option<Timestamp>,
    /// Refusals, the most frequent reason first.
    pub refused: Vec<RefusedView>,
}

/// The state of a background task.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TaskState {
    /// At work.
    Running,
    /// It failed, and is restarted after a pause.
    Resting,
}

/// One background task of the site.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskView {
    /// Its name, followed by the profile's if each profile has one: `verifier`, `anchorer default`.
    pub name: String,
    /// Its state.
    pub state: TaskState,
    /// The number of restarts.
    pub restarts: u64,
    /// During the pause: whole seconds until it is restarted.
    pub next_try: Option<u64>,
    /// Why it ended the last time, cleaned.
    pub reason: Option<String>,
}

/// A path over the records of a topic.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PathView {
    /// The record it leads to.
    pub id: String,
    /// Its topic, cleaned.
    pub topic: String,
    /// Records that contained a position.
    pub records: usize,
    /// Records that could not be opened or decoded.
    pub unread: usize,
    /// The path; `None` if no record contained a position.
    pub plot: Option<Plot>,
}

/// What a robot was asked for of its ring.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RingPullView {
    /// N.
    pub robot: ProfileName,
    /// SM3 of its public key.
    pub device: SignerId,
    /// What was captured at this time or later,
    pub since: Timestamp,
    /// and before this time.
    pub until: Timestamp,
    /// Of topics that match one of these; empty = of all. Cleaned.
    pub topics: Vec<String>,
}

/// An enrolled robot.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RobotRow {
    /// N.
    pub name: ProfileName,
    /// SM3 of its public key.
    pub device: SignerId,
    /// The capture of its newest record that is here, by its clock.
    pub last_seen: Option<Timestamp>,
    /// The first address of its gateway, host:port. Cleaned.
    pub address: Option<String>,
    /// Its records that are here and not verified yet.
    pub waiting: u64,
    /// The version of the policy that it is to work by; 0 = none was ever set.
    pub wanted: u64,
    /// The version that it says it works by; `None` = it never told, 0 = its own settings alone.
    pub running: Option<u64>,
    /// How it stands to what is wanted, in words.
    pub standing: String,
    /// Whether it works by another version than the wanted one.
    pub drift: bool,
    /// Since when.
    pub drift_since: Option<Timestamp>,
}

/// What a robot recorded of a topic, as far as it is here.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RobotTopicRow {
    /// The topic. Cleaned.
    pub topic: String,
    /// Messages.
    pub records: u64,
    /// Of these verified.
    pub verified: u64,
    /// Of these not verified yet.
    pub waiting: u64,
    /// Messages that the robot lost, by its newest reports.
    pub lost: u64,
}

/// One robot in full.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RobotView {
    /// As in the list.
    #[serde(flatten)]
    pub row: RobotRow,
    /// Its gateway.
    pub gateway: Option<RobotGatewayView>,
    /// The topics it has keys for; empty = all.
    pub enrolled: Vec<String>,
    /// What it recorded, by topic.
    pub topics: Vec<RobotTopicRow>,
    /// Why it did not take up the last policy that it heard of. Cleaned.
    pub refused: Option<String>,
    /// Where its own settings say something else, and the policy counts. Cleaned.
    pub overruled: Vec<String>,
    /// The policy that it is to work by, as TOML; empty = its own settings alone.
    pub policy: String,
    /// When that was set.
    pub set_at: Option<Timestamp>,
}

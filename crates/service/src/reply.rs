//! A site's answers, exactly as `--json` prints them.

mod chain;
mod identity;
mod topics;

use std::time::Duration;

use serde::{Deserialize, Serialize};

pub use self::chain::*;
pub use self::identity::*;
pub use self::topics::*;
pub use crate::ros::graph::Unreached as UnreachedView;
pub use crate::ros::recording::Unusable as LeftOut;
pub use crate::store::{
    AlarmRow as AlarmView, CoveragePart, IncidentNote as IncidentNoteView, SpanCoverage as SpanCoverageView,
};

use crate::chain::ChainError;
use crate::command::SecretBytes;
use crate::config::ConfigError;
use crate::crypto::CryptoError;
use crate::gateway::GatewayError;
use crate::model::{Address, ErrorKind, IncidentName, ProfileName, SignerId, Timestamp, clean, coarse};
use crate::pipeline::PipelineError;
use crate::ros::RosError;
use crate::ros::readable::Plot;
use crate::store::StoreError;

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[error("{message}")]
pub struct Failure {
    /// Determines the exit code.
    pub kind: ErrorKind,
    /// What happened, to what, and what to do next; cleaned.
    pub message: String,
}

impl Failure {
    pub fn new(kind: ErrorKind, message: impl Into<String>) -> Self {
        Self { kind, message: message.into() }
    }

    /// The site answered another question.
    pub fn of_another_version() -> Self {
        Self::new(ErrorKind::Internal, "the site's answer does not match the request; it may be another version")
    }
}

macro_rules! failure_from {
    ($($error:ty),*) => {$(
        impl From<$error> for Failure {
            fn from(error: $error) -> Self {
                Self::new(error.kind(), clean(&error.to_string(), 600))
            }
        }
    )*};
}
failure_from!(ChainError, ConfigError, CryptoError, GatewayError, RosError);

/// Ends the text about a full disk: a refused request must be repeated.
pub const AGAIN: &str = ", then do it again";

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Self {
        let again = if matches!(error, StoreError::DiskFull { .. }) { AGAIN } else { "" };
        Self::new(error.kind(), clean(&format!("{error}{again}"), 600))
    }
}

impl From<PipelineError> for Failure {
    fn from(error: PipelineError) -> Self {
        match error {
            PipelineError::Store(error) => error.into(),
            error => Self::new(error.kind(), clean(&error.to_string(), 600)),
        }
    }
}

pub fn refused(message: impl Into<String>) -> Failure {
    Failure::new(ErrorKind::Refused, message)
}

pub fn input(message: impl Into<String>) -> Failure {
    Failure::new(ErrorKind::Input, message)
}

/// For what no act of an operator can cause.
pub fn internal(message: impl Into<String>) -> Failure {
    Failure::new(ErrorKind::Internal, message)
}

pub type Result<T, E = Failure> = std::result::Result<T, E>;

/// An answer: one variant of [`Reply`] on the wire.
pub trait Answer: Sized {
    fn into_reply(self) -> Reply;

    /// `None` if the reply is another answer.
    fn from_reply(reply: Reply) -> Option<Self>;
}

/// Generates the enum of answers and makes each variant's type an [`Answer`].
macro_rules! replies {
    ($($name:ident($view:ty);)+) => {
        #[derive(Debug, Clone, Serialize, Deserialize)]
        #[serde(rename_all = "snake_case", tag = "reply", content = "with")]
        pub enum Reply {
            Done,
            $($name($view),)+
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
    Identity(IdentityView);
    Keys(KeysView);
    KeyChange(KeyChangeView);
    Key(SecretBytes);
    Topics(Vec<TopicRow>);
    Coverage(Vec<CoverageView>);
    Captured(CaptureSummary);
    Imported(ImportView);
    Followed(FollowView);
    Exported(ExportView);
    Progress(Vec<ProgressView>);
    Policy(PolicyView);
    Records(RecordPage);
    Provenance(Provenance);
    Files(Vec<ExportedFile>);
    Evidence(EvidenceView);
    Stamped(StampView);
    Played(PlayedView);
    Transaction(TransactionView);
    Grants(Vec<GrantRow>);
    GrantForeseen(GrantForesight);
    Devices(Vec<DeviceRow>);
    DeviceTopics(DeviceTopicsView);
    DeviceAddresses(DeviceAddressesView);
    Enrolled(EnrolledView);
    Compared(CompareView);
    Contacts(Vec<ContactRow>);
    Check(CheckView);
    Opened(Box<OpenedView>);
    Path(PathView);
    Pins(PinsView);
    Quarantine(QuarantineView);
    Decided(DecidedView);
    Chain(Box<ChainView>);
    Administration(Box<AdministrationView>);
    Deployed(DeployedView);
    Served(ServedView);
    Gateway(GatewayView);
    GatewayStatus(GatewayStatusView);
    Admitted(Vec<AdmittedView>);
    Alerts(AlertsView);
    AlertTested(AlertTestView);
    Site(SiteView);
    Audit(Vec<AuditView>);
    RecordsAudited(Box<RecordAudit>);
    BackedUp(BackupView);
    Erased(ErasureView);
    AuditChecked(AuditCheck);
    Incident(IncidentView);
    Incidents(Vec<IncidentView>);
    RingPull(RingPullView);
    Robots(Vec<RobotRow>);
    Robot(RobotView);
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    Warning,
    Critical,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlertView {
    /// Rule, and its subject if there can be several: `disk`, `robot_silent/1f2e3d4c`.
    pub key: String,
    pub severity: Severity,
    /// What happened and what to do, without topics, names and keys.
    pub text: String,
    /// Beginning of the address of one of the site's accounts.
    pub site: String,
    pub begun: Timestamp,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct EndedAlert {
    #[serde(flatten)]
    pub alert: AlertView,
    pub ended: Timestamp,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlertsView {
    pub alerts: Vec<AlertView>,
    /// Ended in the last 15 minutes, newest first, at most 20.
    pub over: Vec<EndedAlert>,
    /// Destination of alerts, or that there is none.
    pub told: String,
    pub waiting: u64,
    /// Dropped for want of room; the next delivery reports how many.
    pub dropped: u64,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlertTestView {
    pub place: String,
    /// Cleaned.
    pub text: String,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AuditView {
    pub line: u64,
    pub at: Timestamp,
    pub profile: String,
    /// Operator who did it, if not the profile's owner.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub operator: Option<String>,
    pub action: String,
    /// Cleaned.
    pub subject: String,
    pub outcome: String,
}

impl AuditView {
    /// The profile, or `profile/operator`.
    pub fn by(&self) -> String {
        match &self.operator {
            Some(operator) => format!("{}/{operator}", self.profile),
            None => self.profile.clone(),
        }
    }
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AuditCheck {
    pub ok: bool,
    /// Lines in the unbroken hash chain; 0 if it is broken.
    pub lines: u64,
    /// Heads of this profile that were compared.
    pub heads: u64,
    /// Of these, confirmed on the chain.
    pub anchored: u64,
    /// Lines below the newest of these heads.
    pub covered: u64,
    pub broken_line: Option<u64>,
    pub text: Option<String>,
    /// Records of heads that fail their own checks, with reasons.
    pub unusable: Vec<String>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct IncidentView {
    pub name: IncidentName,
    pub open: bool,
    /// Captured at this time or later.
    pub since: Timestamp,
    /// Captured before; `None` = it is still open.
    pub until: Option<Timestamp>,
    pub opened_at: Timestamp,
    pub closed_at: Option<Timestamp>,
    /// Empty = all; cleaned.
    pub topics: Vec<String>,
    pub notes: Vec<IncidentNoteView>,
    pub records: u64,
    /// Of their messages.
    pub bytes: u64,
    pub coverage: Vec<SpanCoverageView>,
}

/// A name known to the gateway, with the sum of its sessions.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SenderView {
    /// N.
    pub name: ProfileName,
    pub account: Address,
    /// Its owner revoked the device: it can no longer connect.
    pub revoked: bool,
    /// Current sessions.
    pub sessions: u64,
    /// Remote address of the newest.
    pub peer: Option<String>,
    pub since: Option<Timestamp>,
    /// Arrival of the last frame.
    pub last: Option<Timestamp>,
    /// Of all its sessions.
    pub frames: u64,
    pub bytes: u64,
}

/// A system key (P_S) of the published list.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct SystemKeyView {
    /// SM3 of P_S.
    pub id: SignerId,
    pub not_before: Timestamp,
    pub not_after: Timestamp,
    pub current: bool,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RefusedView {
    /// Number of the reason in the protocol.
    pub code: u16,
    /// The reason, and what the peer should do.
    pub text: String,
    pub count: u64,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AdmittedView {
    pub owner: Address,
    pub name: Option<String>,
    pub since: Timestamp,
    /// The profile that admitted it, or why it is listed.
    pub by: String,
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GatewayStatusView {
    pub served: Option<GatewayView>,
    /// The gateway through which this site joins another.
    pub through: Option<String>,
    pub connections: u64,
    /// Names with a transport key, connected ones first.
    pub senders: Vec<SenderView>,
    /// The published system keys.
    pub keys: Vec<SystemKeyView>,
    pub list_version: u64,
    pub list_expires: Option<Timestamp>,
    pub refused: Vec<RefusedView>,
    /// Where several workers may share the store.
    pub lease: Option<LeaseView>,
}

/// Which worker does for all what one does alone.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeaseView {
    /// How often it was taken so far.
    pub number: u64,
    pub holder: Option<WorkerView>,
    pub since: Option<Timestamp>,
    /// Those that gave a sign of life lately.
    pub workers: Vec<WorkerView>,
    /// Settings of this worker that differ from the holder's.
    pub unlike: Vec<String>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct WorkerView {
    /// Its machine, the address that its gateway listens on, and the beginning of a random id; cleaned.
    pub name: String,
    pub is_own: bool,
    /// Seconds since its last sign of life.
    pub silent: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TaskState {
    Running,
    /// Failed, and restarted after a pause.
    Resting,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskView {
    /// With the profile's name if each profile has one: `verifier`, `anchorer default`.
    pub name: String,
    pub state: TaskState,
    pub restarts: u64,
    /// Whole seconds until the restart, during the pause.
    pub next_try: Option<u64>,
    /// Why it ended last; cleaned.
    pub reason: Option<String>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PathView {
    pub id: String,
    pub topic: String,
    /// Records with a position.
    pub records: usize,
    /// Records that could not be opened or decoded.
    pub unread: usize,
    /// `None` if no record has a position.
    pub plot: Option<Plot>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RingPullView {
    /// N.
    pub robot: ProfileName,
    /// SM3 of its public key.
    pub device: SignerId,
    /// Captured at this time or later.
    pub since: Timestamp,
    /// Captured before.
    pub until: Timestamp,
    /// Patterns; empty = all. Cleaned.
    pub topics: Vec<String>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RobotRow {
    /// N.
    pub name: ProfileName,
    /// SM3 of its public key.
    pub device: SignerId,
    /// Arrival of its newest record here, by this site's clock.
    pub last_seen: Option<Timestamp>,
    /// First address of its gateway, host:port; cleaned.
    pub address: Option<String>,
    /// Records here that are not verified yet.
    pub waiting: u64,
    /// Messages it lost, by its newest reports here.
    pub lost: u64,
    /// Version of the policy set for it; 0 = none.
    pub wanted: u64,
    /// Version it reports; `None` = never reported, 0 = its own settings alone.
    pub running: Option<u64>,
    /// How it compares with the wanted version, in words.
    pub standing: String,
    /// Whether it runs another version than the wanted one.
    pub drift: bool,
    pub drift_since: Option<Timestamp>,
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RobotTopicRow {
    /// Cleaned.
    pub topic: String,
    pub records: u64,
    pub verified: u64,
    /// Not verified yet.
    pub waiting: u64,
    /// Messages lost by the robot, by its newest reports.
    pub lost: u64,
    /// Capture of its first record.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub first: Option<Timestamp>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub last: Option<Timestamp>,
    /// A sign for each part of [`RobotView::covered`], as in [`CoverageView::strip`]; the robot's own losses have none.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub strip: String,
}

/// The time from the first record of any topic until now.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct CoveredSpan {
    pub since: Timestamp,
    pub until: Timestamp,
}

impl CoveredSpan {
    /// In how many parts a robot's strips show it.
    pub const PARTS: usize = 32;

    /// `4 min`, of one part.
    pub fn part(self) -> String {
        let length = Duration::from_nanos(self.until.0.saturating_sub(self.since.0) / Self::PARTS as u64);
        if length.as_secs() == 0 { "less than 1 s".to_owned() } else { coarse(length) }
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RobotView {
    #[serde(flatten)]
    pub row: RobotRow,
    pub gateway: Option<RobotGatewayView>,
    pub enrolled: Vec<String>,
    pub topics: Vec<RobotTopicRow>,
    /// `None` = there is no record yet.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub covered: Option<CoveredSpan>,
    /// Why it rejected the newest policy; cleaned.
    pub refused: Option<String>,
    /// Own settings that the policy overrides; cleaned.
    pub overruled: Vec<String>,
    /// TOML; empty = its own settings alone.
    pub policy: String,
    pub set_at: Option<Timestamp>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Part {
    /// Topics, their rates or their watching (`ListTopics`).
    Topics,
    /// Records or their states (`ListUploads`, `SiteStatus`).
    Uploads,
    /// Grants given or received (`ListGrants`, `ListShared`).
    Grants,
    /// The chain (`ChainStatus`).
    Chain,
    /// Health of a part (`SiteStatus`).
    Health,
    /// Keys, registration (`ShowIdentity`, `ListKeys`).
    Identity,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
#[serde(rename_all = "snake_case")]
pub enum NoticeLevel {
    /// Shown for 3 s.
    Info,
    Warning,
    Error,
}

crate::model::words!(Severity, NoticeLevel);

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "event")]
pub enum Event {
    /// Pull this part again; at most four times a second per part.
    Changed { part: Part },
    /// Something an operator should know; cleaned.
    Notice {
        at: Timestamp,
        level: NoticeLevel,
        /// What happened, to what, and what to do.
        text: String,
        /// Subject: a later notice about it replaces this one; an informational one clears it.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        about: Option<String>,
    },
}

//! A site's answers: the very structures that `--json` prints.

mod alerts;
mod audit;
mod chain;
mod check;
mod forging;
mod identity;
mod incidents;
mod operate;
mod parties;
mod playing;
mod recordings;
mod records;
mod robots;
mod site;
mod tasks;
mod topics;
mod viewing;

use serde::{Deserialize, Serialize};

pub use self::alerts::{AlertTestView, AlertView, AlertsView, EndedAlert, Severity};
pub use self::audit::{AuditCheck, AuditView};
pub use self::chain::{ChainView, DeployedView, GasView, GatewayView, PricesView, ServedView, WaitingView};
pub use self::check::{
    BackupView, CheckStatus, DoctorCheck, DoctorView, ErasureView, FindingKind, RecordAudit, RecordFinding,
};
pub use self::forging::{AlarmView, DecidedView, HeldView, PinView, PinsView, QuarantineView};
pub use self::identity::{
    DeviceAddressesView, DeviceTopicsView, EnrolledView, EpochRecords, EpochView, IdentityView, KeyChangeView,
    KeysView, RobotGatewayView, TransactionView,
};
pub use self::incidents::{IncidentNoteView, IncidentView, SpanCoverageView};
pub use self::operate::{AdmittedView, GatewayStatusView, RefusedView, SenderView, SystemKeyView};
pub use self::parties::{
    AdministrationView, CompareView, ContactRow, DeviceRow, Direction, GrantRow, GrantState, ProposalView,
    RecoveryView, SuccessionView,
};
pub use self::playing::{PlayEnd, PlayedView};
pub use self::recordings::{
    ExportView, ExportedTopic, FollowView, FollowedFile, ImportView, ImportedTopic, LeftOut, PolicyRow, PolicyView,
    ProgressView, RecordingReply, Refused,
};
pub use self::records::{
    Caveat, CheckView, ContractAnswer, EvidenceView, ExportedFile, OpenedView, Provenance, RecordPage, RecordView,
    Refusal, ShownState, StampView, StampedView,
};
pub use self::robots::{RingPullView, RobotRow, RobotTopicRow, RobotView};
pub use self::site::{HealthLevel, LifeLine, PartHealth, QueueView, SiteView};
pub use self::tasks::{TaskState, TaskView};
pub use self::topics::{CaptureSummary, CoveragePart, CoverageView, HeldUp, TopicRow, TopicSummary, UnreachedView};
pub use self::viewing::PathView;
use super::command::SecretBytes;
use crate::model::ErrorKind;

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
    /// To `Recording`.
    Recording(RecordingReply);
    /// To `Policy`.
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
    /// To `Viewing::Path`.
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
    /// To `Operation::GatewayStatus`.
    GatewayStatus(GatewayStatusView);
    /// To `Operation::Admit`, `Operation::Dismiss` and `Operation::ListAdmitted`.
    Admitted(Vec<AdmittedView>);
    /// To `Operation::ListAlerts`.
    Alerts(AlertsView);
    /// To `Operation::TestAlert`.
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

//! Which right a request needs, in one place. An operator's connection may do what its rights say; all else is the owner's.
//! Looking is what decrypts no message, changes nothing and hands out no file: opening records is not looking.

#![deny(clippy::wildcard_enum_match_arm)]

use serde::Deserialize;

use super::{
    Command, IncidentCommand, Operation, PolicyCommand, RecordingCommand, RobotCommand, StoreCommand, Viewing,
};
use crate::model::OperatorRight;

/// Who may make a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Needed {
    /// An operator with this right, and the owner.
    Right(OperatorRight),
    /// The owner alone.
    Owner,
    /// The owner alone, for it carries a passphrase.
    Passphrase,
}

const LOOK: Needed = Needed::Right(OperatorRight::Look);
const CAPTURE: Needed = Needed::Right(OperatorRight::Capture);
const GRANT: Needed = Needed::Right(OperatorRight::Grant);

impl Needed {
    /// Its word, a constant: what is counted where it is refused.
    pub fn word(self) -> &'static str {
        match self {
            Self::Right(right) => right.word(),
            Self::Owner => "owner",
            Self::Passphrase => "passphrase",
        }
    }
}

/// A request by its tags, read without the rest of it.
#[derive(Debug, Deserialize)]
pub struct Kind {
    command: String,
    of_store: Option<String>,
}

impl Kind {
    /// Whether such requests need [`Needed::Passphrase`].
    pub fn carries_passphrase(&self) -> bool {
        let with = ["create_identity", "unlock", "load_key", "change_passphrase", "export_key", "enrol_device"];
        with.contains(&self.command.as_str()) || self.of_store.as_deref() == Some("back_up")
    }
}

impl Command {
    /// Whether it leaves home and chain as they are; all that a home is asked that cannot be written.
    pub fn only_reads(&self) -> bool {
        let shows = matches!(
            self,
            Self::Unlock { .. }
                | Self::ExportUpload { .. }
                | Self::ExportEvidence(_)
                | Self::OpenShared { .. }
                | Self::View(_)
                | Self::ExportAudit { .. }
                | Self::OfStore(StoreCommand::ListAllUploads(_))
                | Self::Recording { with: RecordingCommand::Export(_) }
        );
        shows || self.needs() == LOOK
    }

    /// What this request needs.
    #[allow(clippy::too_many_lines, reason = "an arm for each request")]
    pub fn needs(&self) -> Needed {
        match self {
            Self::ShowIdentity
            | Self::ListKeys
            | Self::ForeseeKeyChange { .. }
            | Self::ListTopics
            | Self::TopicCoverage { .. }
            | Self::ListPins { .. }
            | Self::ListQuarantine { .. }
            | Self::ListUploads(_)
            | Self::ShowUpload { .. }
            | Self::ListGrants
            | Self::ListShared(_)
            | Self::CheckShared { .. }
            | Self::ListDevices
            | Self::CompareFingerprint { .. }
            | Self::ListContacts
            | Self::ChainStatus
            | Self::ListSuccessions
            | Self::SiteStatus
            | Self::ListAudit(_)
            | Self::VerifyAudit { .. }
            | Self::OpenConsole => LOOK,
            Self::WatchTopic { .. }
            | Self::UnwatchTopic { .. }
            | Self::PinTopic { .. }
            | Self::UnpinTopic { .. }
            | Self::Capture { .. }
            | Self::StopCapture => CAPTURE,
            Self::Grant { .. } | Self::ExtendGrant { .. } | Self::Revoke { .. } => GRANT,
            Self::CreateIdentity { .. }
            | Self::Unlock { .. }
            | Self::LoadKey { .. }
            | Self::ChangePassphrase { .. }
            | Self::ExportKey { .. }
            | Self::EnrolDevice(_) => Needed::Passphrase,
            Self::Register
            | Self::RotateKeys
            | Self::RotateEnvelope
            | Self::ReleaseHeld { .. }
            | Self::DiscardHeld { .. }
            | Self::ExportUpload { .. }
            | Self::ExportEvidence(_)
            | Self::StampEvidence
            | Self::OpenShared { .. }
            | Self::View(Viewing::ViewFile { .. } | Viewing::ViewPath { .. })
            | Self::Play(_)
            | Self::StopPlay
            | Self::LendDevice { .. }
            | Self::RecallDevice { .. }
            | Self::AddDeviceTopics { .. }
            | Self::AddDeviceAddress { .. }
            | Self::AddContact { .. }
            | Self::RemoveContact { .. }
            | Self::ConfirmContact { .. }
            | Self::Administer(_)
            | Self::NameRecovery { .. }
            | Self::DeployContract { .. }
            | Self::CancelTransaction { .. }
            | Self::ServeChain { .. }
            | Self::ServeGateway { .. }
            | Self::ExportAudit { .. } => Needed::Owner,
            Self::Policy { with } => of_policy(with),
            Self::Recording { with } => of_recording(with),
            Self::OfStore(command) => of_store(command),
            Self::Operate(operation) => of_operation(operation),
            Self::OfIncident(command) => of_incident(command),
            Self::OfRobot(command) => of_robot(command),
        }
    }
}

/// Learning looks at the graph only, for rules to be written.
fn of_policy(command: &PolicyCommand) -> Needed {
    match command {
        PolicyCommand::Show => LOOK,
        PolicyCommand::Learn { .. } => CAPTURE,
    }
}

fn of_recording(command: &RecordingCommand) -> Needed {
    match command {
        RecordingCommand::Progress => LOOK,
        // They read and write files as the site's user.
        RecordingCommand::Import(_)
        | RecordingCommand::Follow(_)
        | RecordingCommand::ImportHome(_)
        | RecordingCommand::Export(_) => Needed::Owner,
    }
}

fn of_store(command: &StoreCommand) -> Needed {
    match command {
        StoreCommand::AuditRecords { .. } => LOOK,
        // Records of other profiles are not this owner's to show.
        StoreCommand::ListAllUploads(_) | StoreCommand::EraseRecords(_) => Needed::Owner,
        StoreCommand::BackUp { .. } => Needed::Passphrase,
    }
}

fn of_operation(operation: &Operation) -> Needed {
    match operation {
        Operation::ListAlerts | Operation::GatewayStatus | Operation::ListAdmitted => LOOK,
        Operation::HoldCapture { .. } => CAPTURE,
        Operation::Lock
        | Operation::BackUpKeys
        | Operation::TestAlert
        | Operation::Admit { .. }
        | Operation::Dismiss { .. } => Needed::Owner,
    }
}

fn of_incident(command: &IncidentCommand) -> Needed {
    match command {
        IncidentCommand::ListIncidents | IncidentCommand::ShowIncident { .. } => LOOK,
        IncidentCommand::OpenIncident { .. }
        | IncidentCommand::NoteIncident { .. }
        | IncidentCommand::CloseIncident { .. }
        | IncidentCommand::RemoveIncident { .. } => Needed::Owner,
    }
}

fn of_robot(command: &RobotCommand) -> Needed {
    match command {
        RobotCommand::ListRobots | RobotCommand::ShowRobot { .. } => LOOK,
        // The account signs what a robot obeys.
        RobotCommand::PullRing { .. } | RobotCommand::SetRobotPolicy { .. } => Needed::Owner,
    }
}

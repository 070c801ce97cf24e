//! What a gateway's home on a server answers, and what it leaves to other homes: it has no tables for it, or no use.

#![deny(clippy::wildcard_enum_match_arm)]

use super::{Command, IncidentCommand, RobotCommand};
use crate::service::failure::refused;
use crate::service::reply::Result;

const CAPTURE: &str = "it captures and imports nothing; do that in a home that joins this gateway (--site)";
const READ: &str = "it opens no records; read them in a home that joins this gateway (--site)";
const OWN: &str = "it has no records of its own; do that in the home of the owner of the records";
const SHARE: &str = "it grants nothing and authorises no robots; do that in the home of the owner of the records";
const KEYS: &str =
    "its robots and its database know it by its keys, so they stay; a gateway with other keys begins in a new home";
const BOOK: &str = "it keeps no address book; name accounts by their address (0x and 40 hex digits)";
const INCIDENTS: &str = "it holds no incidents; open them in the home of the owner of the records";
const BACK_UP: &str = "its records are in PostgreSQL, whose own tools back them up (pg_basebackup, pg_dump); save its keyring with \
     `authros keys backup`";

impl Command {
    /// Refuses what a home with its store on a server does not do.
    pub fn check_on_server(&self) -> Result<()> {
        let Some(elsewhere) = self.elsewhere() else { return Ok(()) };
        Err(refused(format!("this is the home of a gateway on a server (store.url): {elsewhere}")))
    }

    /// Why another home does it.
    #[allow(clippy::too_many_lines, reason = "each request by its name")]
    fn elsewhere(&self) -> Option<&'static str> {
        match self {
            Self::WatchTopic { .. }
            | Self::UnwatchTopic { .. }
            | Self::PinTopic { .. }
            | Self::UnpinTopic { .. }
            | Self::ReleaseHeld { .. }
            | Self::DiscardHeld { .. }
            | Self::Capture { .. }
            | Self::StopCapture
            | Self::HoldCapture { .. }
            | Self::LearnPolicy { .. }
            | Self::ImportRecording(_)
            | Self::FollowFolder(_)
            | Self::ImportHome { .. } => Some(CAPTURE),
            Self::ListShared(_)
            | Self::CheckShared { .. }
            | Self::OpenShared { .. }
            | Self::ViewFile { .. }
            | Self::ViewPath { .. }
            | Self::Play(_)
            | Self::StopPlay
            | Self::ExportRecording(_) => Some(READ),
            Self::ExportUpload { .. } | Self::ExportEvidence(_) | Self::EraseRecords(_) => Some(OWN),
            Self::Grant { .. }
            | Self::ForeseeGrant { .. }
            | Self::ExtendGrant { .. }
            | Self::Revoke { .. }
            | Self::LendDevice { .. }
            | Self::RecallDevice { .. }
            | Self::AddDeviceTopics { .. }
            | Self::AddDeviceAddress { .. }
            | Self::EnrolDevice(_)
            | Self::OfRobot(RobotCommand::PullRing { .. } | RobotCommand::SetRobotPolicy { .. }) => Some(SHARE),
            Self::LoadKey { .. } | Self::RotateKeys | Self::RotateEnvelope | Self::ForeseeKeyChange { .. } => {
                Some(KEYS)
            }
            Self::AddContact { .. } | Self::RemoveContact { .. } | Self::ConfirmContact { .. } => Some(BOOK),
            Self::OfIncident(
                IncidentCommand::OpenIncident { .. }
                | IncidentCommand::NoteIncident { .. }
                | IncidentCommand::CloseIncident { .. }
                | IncidentCommand::RemoveIncident { .. },
            ) => Some(INCIDENTS),
            Self::BackUp { .. } => Some(BACK_UP),
            Self::CreateIdentity { .. }
            | Self::ShowIdentity
            | Self::Unlock { .. }
            | Self::Register
            | Self::ListKeys
            | Self::ChangePassphrase { .. }
            | Self::ExportKey { .. }
            | Self::ListTopics
            | Self::TopicCoverage { .. }
            | Self::ListPins { .. }
            | Self::ListQuarantine { .. }
            | Self::ShowPolicy
            | Self::RecordingProgress
            | Self::ListUploads(_)
            | Self::ShowUpload { .. }
            | Self::StampEvidence
            | Self::ListGrants
            | Self::ListDevices
            | Self::OfRobot(RobotCommand::ListRobots | RobotCommand::ShowRobot { .. })
            | Self::OfIncident(IncidentCommand::ListIncidents | IncidentCommand::ShowIncident { .. })
            | Self::CompareFingerprint { .. }
            | Self::ListContacts
            | Self::Administer(_)
            | Self::NameRecovery { .. }
            | Self::ChainStatus
            | Self::ListSuccessions
            | Self::DeployContract { .. }
            | Self::CancelTransaction { .. }
            | Self::ServeChain { .. }
            | Self::ServeGateway { .. }
            | Self::SiteStatus
            | Self::ListAudit(_)
            | Self::VerifyAudit { .. }
            | Self::ExportAudit { .. }
            | Self::OpenConsole
            | Self::AuditRecords { .. }
            | Self::ListAllUploads(_)
            | Self::Lock
            | Self::BackUpKeys
            | Self::RestoreKeys { .. }
            | Self::ListAlerts
            | Self::TestAlert
            | Self::GatewayStatus
            | Self::MakeJoinFile { .. }
            | Self::Admit { .. }
            | Self::Dismiss { .. }
            | Self::ListAdmitted => None,
        }
    }
}

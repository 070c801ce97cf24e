//! Rights that requests need. Looking decrypts no message, changes nothing and gives out no file; opening records is
//! not looking.

use serde::Deserialize;

use super::Command;
use crate::model::OperatorRight;

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
}

//! The rights that the list of requests names beside each request. An operator's connection may do what its rights say;
//! all else is the owner's. Looking is what decrypts no message, changes nothing and hands out no file: opening records
//! is not looking.

use serde::Deserialize;

use super::Command;
use crate::model::OperatorRight;

/// Who may make a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Needed {
    /// An operator with this right, and the owner.
    Right(OperatorRight),
    Owner,
    /// The owner alone, for it carries a passphrase.
    Passphrase,
}

pub(super) const LOOK: Needed = Needed::Right(OperatorRight::Look);
pub(super) const CAPTURE: Needed = Needed::Right(OperatorRight::Capture);
pub(super) const GRANT: Needed = Needed::Right(OperatorRight::Grant);
pub(super) const OWNER: Needed = Needed::Owner;
pub(super) const PASSPHRASE: Needed = Needed::Passphrase;

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
}

impl Kind {
    /// Whether such requests need [`Needed::Passphrase`].
    pub fn carries_passphrase(&self) -> bool {
        let with =
            ["create_identity", "unlock", "load_key", "change_passphrase", "export_key", "enrol_device", "back_up"];
        with.contains(&self.command.as_str())
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
                | Self::ViewFile { .. }
                | Self::ViewPath { .. }
                | Self::ExportAudit { .. }
                | Self::ListAllUploads(_)
                | Self::ExportRecording(_)
        );
        shows || self.needs() == LOOK
    }
}

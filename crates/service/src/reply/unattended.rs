//! Answers about capture while the profile is locked.

use serde::{Deserialize, Serialize};

use crate::model::{Address, ProfileName, SignerId, Timestamp};
use crate::service::command::SecretBytes;

/// How unattended capture stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum UnattendedState {
    /// A credential was made; this site does not use it.
    Prepared,
    /// This site captures with it.
    Capturing,
    /// This site cannot capture with it any more.
    Ended,
    /// The profile was unlocked; its own keys capture.
    Attended,
}

/// Capture while the profile is locked.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct UnattendedView {
    /// How it stands.
    pub state: UnattendedState,
    /// The profile.
    pub profile: ProfileName,
    /// The lent device that signs.
    pub device: SignerId,
    /// The account that anchors.
    pub account: Address,
    /// The topics that it has keys for. Cleaned.
    pub topics: Vec<String>,
    /// Until when capture can go on without the owner.
    pub until: Option<Timestamp>,
    /// Why until then, or why it ended.
    pub why: Option<String>,
}

/// A credential that was made.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct UnattendedFile {
    /// The lent device that signs.
    pub device: SignerId,
    /// The account that anchors.
    pub account: Address,
    /// The topics that it has keys for.
    pub topics: Vec<String>,
    /// When the loan ends.
    pub until: Timestamp,
    /// The file: secret, and not encrypted.
    pub file: SecretBytes,
}

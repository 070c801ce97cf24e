//! What a site reports without being asked: small notes; the data is then pulled with a command.

use serde::{Deserialize, Serialize};

use crate::model::Timestamp;

/// Which part of the site's data changed.
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

/// How urgent a notice is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NoticeLevel {
    /// Shown for 3 s.
    Info,
    /// Something is waiting or was counted.
    Warning,
    Error,
}

impl NoticeLevel {
    /// Its word in logs.
    pub fn word(self) -> &'static str {
        match self {
            Self::Info => "info",
            Self::Warning => "warning",
            Self::Error => "error",
        }
    }
}

/// Sent to every console and follower of the site.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "event")]
pub enum Event {
    /// Pull this part again. Sent at most four times a second per part.
    Changed { part: Part },
    /// Something an operator should know; the text is cleaned.
    Notice {
        at: Timestamp,
        level: NoticeLevel,
        /// What happened, to what, what to do.
        text: String,
        /// The subject, if a later notice about the same replaces this one (`chain`); one that is only information
        /// clears it.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        about: Option<String>,
    },
}

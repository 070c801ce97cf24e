//! Notes that a site sends on its own; a command then pulls the data.

use serde::{Deserialize, Serialize};

use crate::model::Timestamp;

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

impl NoticeLevel {
    pub fn word(self) -> &'static str {
        self.into()
    }
}

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

//! Commands about capture while the profile is locked.

use serde::{Deserialize, Serialize};

use super::{Ask, Command};
use crate::model::{Timestamp, TopicName};
use crate::service::reply::{TransactionView, UnattendedFile};

requests! {
    /// One of these; needs the keyring.
    #[serde(rename_all = "snake_case", tag = "unattended")]
    enum UnattendedCommand by Command::OfUnattended;
    /// Make a credential with which a site captures while the profile is locked.
    PrepareUnattended {
        /// Of these watched topics; empty = of all that the profile watches.
        topics: Vec<TopicName>,
        /// When the loan of its device ends.
        until: Timestamp,
    } => UnattendedFile;
    /// Recall the device of the credential; a new epoch begins.
    EndUnattended {
        /// At once, also if records that the device signed are in no block yet: they stay stored and wait for its right.
        #[serde(default)]
        force: bool,
    } => TransactionView;
}

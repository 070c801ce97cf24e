//! Answers about a running gateway.

use serde::{Deserialize, Serialize};

use super::GatewayView;
use crate::model::{Address, ProfileName, SignerId, Timestamp};

/// A name known to the gateway, and its session if it has one.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SenderView {
    /// N, the name.
    pub name: ProfileName,
    /// The account it belongs to.
    pub account: Address,
    /// Its current sessions.
    pub sessions: u64,
    /// The remote address of the newest.
    pub peer: Option<String>,
    /// Connected since.
    pub since: Option<Timestamp>,
    /// When its last frame arrived.
    pub last: Option<Timestamp>,
    /// Frames of its sessions.
    pub frames: u64,
    /// Bytes of these frames.
    pub bytes: u64,
}

/// One system key (P_S) of the published list.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct SystemKeyView {
    /// SM3 of P_S.
    pub id: SignerId,
    /// In use from this time.
    pub not_before: Timestamp,
    /// In use until this time.
    pub not_after: Timestamp,
    /// Whether it is in use now.
    pub current: bool,
}

/// Refusals for one reason since the gateway was started.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RefusedView {
    /// The reason's number in the protocol.
    pub code: u16,
    /// The reason in words, and what the peer should do.
    pub text: String,
    /// How often.
    pub count: u64,
}

/// An owner who may use the gateway of this home.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AdmittedView {
    /// The owner.
    pub owner: Address,
    /// Its name in the address book.
    pub name: Option<String>,
    /// Admitted since.
    pub since: Timestamp,
    /// The profile that admitted it, or why it is listed.
    pub by: String,
}

/// The gateway of this site at a glance.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GatewayStatusView {
    /// The gateway served here; `None` = no gateway runs here.
    pub served: Option<GatewayView>,
    /// The gateway through which this site joins a remote one.
    pub through: Option<String>,
    /// Connections, including those in their handshake.
    pub connections: u64,
    /// Names with a transport key, connected ones first.
    pub senders: Vec<SenderView>,
    /// The published list of system keys.
    pub keys: Vec<SystemKeyView>,
    /// Its version.
    pub list_version: u64,
    /// When it expires.
    pub list_expires: Option<Timestamp>,
    /// Refusals, the most frequent reason first.
    pub refused: Vec<RefusedView>,
}

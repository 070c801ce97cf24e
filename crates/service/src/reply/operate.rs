//! What is told of a gateway at work.

use serde::{Deserialize, Serialize};

use super::GatewayView;
use crate::model::{Address, ProfileName, SignerId, Timestamp};

/// A name that the gateway knows, and its session where it has one.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SenderView {
    /// N.
    pub name: ProfileName,
    /// The account that it belongs to.
    pub account: Address,
    /// Sessions of it now.
    pub sessions: u64,
    /// Where the newest comes from.
    pub peer: Option<String>,
    /// Since when it is connected.
    pub since: Option<Timestamp>,
    /// When its last frame came.
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
    /// In use from then on.
    pub not_before: Timestamp,
    /// In use until then.
    pub not_after: Timestamp,
    /// Whether it is in use now.
    pub current: bool,
}

/// What was refused for one reason since the gateway was started.
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
    /// Who.
    pub owner: Address,
    /// Its name in the address book.
    pub name: Option<String>,
    /// Since when.
    pub since: Timestamp,
    /// Which profile admitted it, or why it is here.
    pub by: String,
}

/// The gateway of this site at a glance.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GatewayStatusView {
    /// What is served; `None` = no gateway runs here.
    pub served: Option<GatewayView>,
    /// The gateway that this site joins a remote one through.
    pub through: Option<String>,
    /// Connections, those in their handshake included.
    pub connections: u64,
    /// Names with a transport key: those connected first.
    pub senders: Vec<SenderView>,
    /// The published list of system keys.
    pub keys: Vec<SystemKeyView>,
    /// Its version.
    pub list_version: u64,
    /// When it is of no use any more.
    pub list_expires: Option<Timestamp>,
    /// What was refused, the most frequent reason first.
    pub refused: Vec<RefusedView>,
}

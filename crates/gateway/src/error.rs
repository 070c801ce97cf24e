//! What can go wrong at the client's end; each message says what to do next.

use crate::crypto::CryptoError;
use crate::model::wire::WireError;
use crate::model::{ErrorKind, SignerId};

use super::code::{Code, Refusal};
use super::command::ErasedRecord;

/// Why a client gave up.
#[derive(Debug, thiserror::Error)]
pub enum GatewayError {
    /// Nobody listens, or the connection broke.
    #[error("the gateway at {address} does not answer ({source}); check the address and that the gateway is running")]
    Unreachable {
        /// The address tried.
        address: String,
        /// The system's reason.
        source: std::io::Error,
    },
    /// None of its addresses leads to the gateway.
    #[error("none of the gateway's addresses can be used: {}", each(.0))]
    Nowhere(Vec<(String, GatewayError)>),
    /// The gateway closed the connection.
    #[error("the gateway closed the connection; connect again, and see its log for the reason")]
    Closed,
    /// The gateway did not answer in time.
    #[error("the gateway did not answer in time; try again")]
    TimedOut,
    /// The gateway refused.
    #[error("the gateway refused: {0}")]
    Refused(Code),
    /// A refusal in clear: anyone on the network can forge one, so it means no more than a closed connection.
    #[error("the gateway closed the connection with an unauthenticated message: {0}")]
    RefusedInClear(Code),
    /// No fingerprint is pinned, and trust on first use was not requested.
    #[error(
        "no gateway is pinned, and this one presents {0}; confirm it with its operator and pin it, or allow trust on \
         first use"
    )]
    NotPinned(SignerId),
    /// A gateway other than the pinned one.
    #[error(
        "this is not the pinned gateway: {found} instead of {pinned}; someone may be intercepting the connection, do \
         not continue"
    )]
    NotTheGateway {
        /// The pinned fingerprint.
        pinned: SignerId,
        /// The fingerprint it showed.
        found: SignerId,
    },
    /// An older system-key list than one seen before.
    #[error(
        "the gateway presents version {found} of its system keys, but version {seen} was seen before; do not continue"
    )]
    RolledBack {
        /// The highest version seen so far.
        seen: u64,
        /// The version shown.
        found: u64,
    },
    /// Two lists with the same version.
    #[error(
        "the gateway presents two lists of system keys under version {0}; do not continue, ask its operator to explain"
    )]
    TwoLists(u64),
    /// A system-key list that is not the gateway's, or no longer valid.
    #[error("the list of system keys was rejected: {0}; fetch it again, or ask the gateway's operator")]
    List(&'static str),
    /// A record that its owner had erased: its proof and the owner's statement remain.
    #[error("the record was erased by its owner; its proof remains")]
    Erased(Box<ErasedRecord>),
    /// Malformed bytes.
    #[error("the gateway's {what} is malformed ({why}); use the same version on both sides")]
    Malformed {
        /// The message.
        what: &'static str,
        /// What is wrong with it.
        why: WireError,
    },
    /// An answer to another request.
    #[error("the gateway's answer does not match the request ({0}); connect again")]
    Unexpected(&'static str),
    /// A receipt that does not cover what was sent.
    #[error("the gateway's receipt does not cover {0}; keep the records and send them again")]
    Receipt(&'static str),
    /// A frame that could not be sealed or opened.
    #[error("the session with the gateway broke: {0}; connect again")]
    Session(Refusal),
    /// A message larger than the protocol carries.
    #[error("the message has {0} bytes, more than a gateway accepts; send less at a time")]
    TooLarge(usize),
    /// A key or signature.
    #[error(transparent)]
    Crypto(#[from] CryptoError),
}

impl GatewayError {
    /// The kind of failure.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Unreachable { .. } | Self::Closed | Self::RefusedInClear(_) | Self::TimedOut => {
                ErrorKind::Unreachable
            }
            Self::Nowhere(failed) => match failed.first() {
                Some((_, first)) if failed.iter().all(|(_, error)| error.kind() != ErrorKind::Unreachable) => {
                    first.kind()
                }
                _ => ErrorKind::Unreachable,
            },
            Self::Refused(code) => code.kind(),
            Self::Erased(_) => Code::NotFound.kind(),
            Self::NotPinned(_)
            | Self::NotTheGateway { .. }
            | Self::RolledBack { .. }
            | Self::TwoLists(_)
            | Self::List(_)
            | Self::Malformed { .. }
            | Self::Unexpected(_)
            | Self::Receipt(_)
            | Self::Session(_) => ErrorKind::Refused,
            Self::TooLarge(_) => ErrorKind::Input,
            Self::Crypto(error) => error.kind(),
        }
    }

    /// Why each address of a gateway failed.
    pub(super) fn of_addresses(failed: Vec<(String, Self)>) -> Self {
        match <[_; 1]>::try_from(failed) {
            Ok([(_, only)]) => only,
            Err(failed) => Self::Nowhere(failed),
        }
    }

    pub(super) fn malformed(what: &'static str) -> impl Fn(WireError) -> Self {
        move |why| Self::Malformed { what, why }
    }
}

fn each(failed: &[(String, GatewayError)]) -> String {
    failed.iter().map(|(address, error)| format!("{address}: {error}")).collect::<Vec<_>>().join("; ")
}

impl From<Refusal> for GatewayError {
    fn from(refusal: Refusal) -> Self {
        Self::Session(refusal)
    }
}

//! Refusals by code, and a client's errors; each message says what to do next.

use std::fmt;

use crate::model::{Address, ErrorKind, SignerId, Timestamp};
use crate::{command::ErasedRecord, crypto::CryptoError, model::wire::WireError};

#[derive(Debug, thiserror::Error)]
pub enum GatewayError {
    #[error("the gateway at {address} does not answer ({source}); check the address and that the gateway is running")]
    Unreachable { address: String, source: std::io::Error },
    #[error("none of the gateway's addresses can be used: {}", each(.0))]
    Nowhere(Vec<(String, GatewayError)>),
    #[error("the gateway closed the connection; connect again, and see its log for the reason")]
    Closed,
    #[error("the gateway did not answer in time; try again")]
    TimedOut,
    #[error("the gateway refused: {0}")]
    Refused(Code),
    /// In the session of a device that proved its transport key: when the chain recalled it.
    #[error("this robot's owner revoked it at {0}; ask the owner to enrol it again (`authros robot enrol`)")]
    Recalled(Timestamp),
    /// Anyone on the network can forge it: it means no more than a closed connection.
    #[error(
        "the connection was ended by an unauthenticated message, which the gateway or anyone on the network between can send: \
         {0}; if this persists, ask the gateway's operator whether it is true"
    )]
    RefusedInClear(Code),
    #[error(
        "no gateway is pinned, and this one presents {0}; confirm it with its operator and pin it, or allow trust on \
         first use"
    )]
    NotPinned(SignerId),
    #[error(
        "this is not the pinned gateway: {found} instead of {pinned}; someone may be intercepting the connection, do \
         not continue"
    )]
    NotTheGateway { pinned: SignerId, found: SignerId },
    #[error(
        "the gateway presents version {found} of its system keys, but version {seen} was seen before; do not continue"
    )]
    RolledBack { seen: u64, found: u64 },
    #[error(
        "the gateway presents two lists of system keys under version {0}; do not continue, ask its operator to explain"
    )]
    TwoLists(u64),
    #[error("the list of system keys was rejected: {0}; fetch it again, or ask the gateway's operator")]
    List(&'static str),
    /// What a gateway's workers share cannot be read or written.
    #[error("{text}")]
    Shelf { kind: ErrorKind, text: String },
    #[error("the record was erased by its owner; its proof remains")]
    Erased(Box<ErasedRecord>),
    #[error("the gateway's {what} is malformed ({why}); use the same version on both sides")]
    Malformed { what: &'static str, why: WireError },
    #[error("the gateway's answer does not match the request ({0}); connect again")]
    Unexpected(&'static str),
    #[error("the gateway's receipt does not cover {0}; keep the records and send them again")]
    Receipt(&'static str),
    #[error("the session with the gateway broke: {0}; connect again")]
    Session(Refusal),
    #[error("the message has {0} bytes, more than a gateway accepts; send less at a time")]
    TooLarge(usize),
    #[error(transparent)]
    Crypto(#[from] CryptoError),
}

impl GatewayError {
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
            Self::Recalled(_) => Code::Recalled.kind(),
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
            Self::Shelf { kind, .. } => *kind,
            Self::Crypto(error) => error.kind(),
        }
    }

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

macro_rules! codes {
    ($($(#[$doc:meta])* $name:ident = $number:literal $kind:ident $text:literal;)*) => {
        /// The same for every peer, so that it reveals nothing about others.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[repr(u16)]
        pub enum Code {
            $($(#[$doc])* $name = $number,)*
        }

        impl Code {
            pub const ALL: &[Self] = &[$(Self::$name),*];

            pub fn text(self) -> &'static str {
                match self {
                    $(Self::$name => $text,)*
                }
            }

            pub fn kind(self) -> ErrorKind {
                match self {
                    $(Self::$name => ErrorKind::$kind,)*
                }
            }
        }
    };
}

codes! {
    Length = 1 Refused "a frame has an invalid length; connect again";
    Session = 2 Refused "the session has ended; connect again";
    Counter = 3 Refused "a frame came out of order; connect again";
    Tag = 4 Refused "a frame was altered or sealed under another key; connect again, and enrol a robot again if it persists";
    Token = 5 Refused "the token does not belong to this account; register or rotate first";
    Signature = 6 Refused "the SM2 signature was rejected; sign with the registered key or that of an authorised device";
    Account = 7 Refused "the account's signature was rejected; sign with the key of the registered account";
    Malformed = 8 Refused "the gateway cannot read the message; use the same version on both sides";
    Version = 9 Refused "the gateway uses another version of the protocol; use the same version on both sides";
    Network = 10 Refused "the gateway serves another network; check chain and contract on both sides";
    SystemKey = 11 Refused "the system key is not in use; fetch the list again";
    NameBound = 12 Refused "this name belongs to another account; choose another name";
    NotRegistered = 13 Refused "the chain knows no such identity; register it, or wait for its confirmation";
    Suspended = 14 Refused "the account is suspended; ask the administrator";
    NotAuthorised = 15 Refused "no grant covers this; ask the owner for one, or to renew the authorisation of a robot";
    NotFound = 16 Refused "the gateway has no such record; check the digest";
    Tampered = 17 Tampered "the stored record is not the one anchored; fetch it from elsewhere";
    Quota = 18 Refused "too many simultaneous requests; send fewer and try again";
    Busy = 19 Unreachable "all places of the gateway are taken; try again in a minute, or unlock a profile that has used it \
                           before (those have places of their own); its operator sees who is connected in `authros \
                           gateway status`";
    NotHere = 20 Refused "this command is not accepted in this session; connect with a transport key";
    /// The chain's current state is unknown, so authority cannot be determined.
    Stale = 21 Unreachable "the gateway does not know the chain's newest block now, so it cannot tell who may do this; \
                            it answers again as soon as it does, so try again in a few seconds";
    Closing = 22 Unreachable "the gateway is stopping; try again later";
    Internal = 23 Unreachable "the gateway cannot use its own store or keys; its operator finds the reason in the gateway's \
                               log, so tell them, and try again later";
    TooSlow = 24 Unreachable "the connection was too slow or idle; connect again";
    /// Of a network or owner other than the session's.
    NotYours = 25 Refused "the record belongs to another account or network; send your own";
    Method = 26 Refused "the gateway does not forward this request to the chain; use a node for it";
    NotAdmitted = 27 Refused "this gateway does not allow the account; ask the gateway's operator to run `authros \
                              gateway allow ACCOUNT`";
    /// Answered only to a device that proved its transport key, with the time.
    Recalled = 28 Refused "the owner revoked this robot; ask the owner to enrol it again";
}

crate::model::layout!(Code by number, from_number);

impl Code {
    pub fn number(self) -> u16 {
        self as u16
    }

    pub fn from_number(number: u16) -> Option<Self> {
        Self::ALL.iter().copied().find(|code| code.number() == number)
    }

    /// Later frames could not be trusted.
    pub fn ends_session(self) -> bool {
        matches!(
            self,
            Self::Length
                | Self::Session
                | Self::Counter
                | Self::Tag
                | Self::Version
                | Self::Network
                | Self::Busy
                | Self::Closing
                | Self::TooSlow
        )
    }
}

impl fmt::Display for Code {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.text())
    }
}

pub(crate) type Result<T, E = Refusal> = std::result::Result<T, E>;

/// The code goes to the peer, the detail only to the log.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{code} ({detail})")]
pub struct Refusal {
    pub code: Code,
    /// No secret; text from peers only cleaned.
    pub detail: String,
    /// That the gateway's operator may allow.
    pub account: Option<Address>,
}

impl Refusal {
    pub fn new(code: Code, detail: impl fmt::Display) -> Self {
        Self { code, detail: detail.to_string(), account: None }
    }

    /// For `map_err`: keeps the cause for the log.
    pub fn internal(cause: impl fmt::Display) -> Self {
        Self::new(Code::Internal, cause)
    }

    /// For `map_err`: keeps the cause for the log.
    pub fn because<E: fmt::Display>(code: Code) -> impl Fn(E) -> Self {
        move |cause| Self::new(code, cause)
    }
}

#[cfg(test)]
mod code_tests {
    use super::*;

    #[test]
    fn codes_are_constant_and_round_trip() {
        for (index, code) in Code::ALL.iter().enumerate() {
            assert_eq!(usize::from(code.number()), index + 1);
            assert_eq!(Code::from_number(code.number()), Some(*code));
            assert!(code.to_string().contains("; "), "{code:?} says what to do next");
        }
        assert_eq!(Code::from_number(0), None);
        assert_eq!(Code::from_number(29), None);
    }
}

//! The gateway's protocol, version 1 (every byte is in PROTOCOL.md): state machines without I/O, then server and
//! client.

#[cfg(test)]
use crate as gateway;
use authros_crypto as crypto;
use authros_model as model;
// Fixtures shared with other crates' tests refer to this crate by the name those use.
#[cfg(test)]
extern crate self as authros_gateway;

/// Enums by their byte on the wire.
macro_rules! numbered {
    ($($(#[$meta:meta])* $name:ident { $($(#[$doc:meta])* $variant:ident = $number:literal,)* })*) => {$(
        $(#[$meta])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        #[repr(u8)]
        pub enum $name {
            $($(#[$doc])* $variant = $number,)*
        }

        impl $name {
            pub const ALL: &[Self] = &[$(Self::$variant),*];

            pub fn number(self) -> u8 {
                self as u8
            }

            pub fn from_number(number: u8) -> Option<Self> {
                Self::ALL.iter().copied().find(|one| one.number() == number)
            }
        }
    )*};
}

pub mod allocation;
mod chain_line;
pub mod client;
pub mod command;
mod connection;
pub mod desk;
pub mod error;
pub mod feed;
pub mod frame;
pub mod hello;
pub mod limits;
pub mod receipt;
pub mod server;
pub mod session;
pub mod system_keys;
pub mod trust;

pub use self::chain_line::ChainLine;
pub use self::error::{Code, Refusal};
pub use self::system_keys::{Cabinet, Kept, Schedule, Shelf};
pub use allocation::Applicant;
pub use client::{Client, Credentials, Endpoint};
pub use command::{
    Answer, Command, DeviceNotice, ErasedRecord, ErasureNotice, ErasureOutcome, Fetched, Found, GrantNotice, Notice,
    RelayCall, Relayed, Request, RevokeNotice, Upload,
};
pub use desk::{Account, Binding, BoundDevice, Caller, Desk, Received};
pub use error::GatewayError;
pub use feed::{Feed, FeedEntry, FeedPage, Place};
pub use hello::{Context, NetworkName};
pub use limits::Limits;
pub use receipt::Receipt;
pub use server::{Server, ServerWatch};
pub use trust::{KeptTrust, Trust};

#[cfg(test)]
pub(crate) mod tests;

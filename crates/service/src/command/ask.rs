//! Requests that name their answers. One list generates the enum that goes over the wire, a type for each request, and
//! the link between the request and its answer.

use super::Command;
use crate::service::reply::{Answer, Failure, Reply};

/// A request with the type of its answer.
pub trait Ask: Into<Command> {
    type Answer: Answer;

    /// Its answer as it goes over the wire.
    fn told(answer: Self::Answer) -> Reply {
        answer.into_reply()
    }

    /// Its answer, from what came over the wire.
    ///
    /// # Errors
    /// The site's failure, or that it is of another version and answered something else.
    fn heard(reply: Result<Reply, Failure>) -> Result<Self::Answer, Failure> {
        Self::Answer::from_reply(reply?).ok_or_else(Failure::of_another_version)
    }
}

/// Generates `enum $wire` with a variant for each request, which names its answer and the right that it needs, and a type
/// of the same name and fields that implements [`Ask`]. The entries under `groups` are further variants: lists of their
/// own.
macro_rules! requests {
    (
        $(#[$outer:meta])*
        enum $wire:ident by $whole:expr;
        $(
            $(#[doc = $doc:literal])+ $(#[serde($($serde:tt)+)])?
            $name:ident $({ $(
                $(#[doc = $field_doc:literal])+ $(#[serde($($field_serde:tt)+)])?
                $field:ident: $kind:ty,
            )+ })? $(($one:ident: $inner:ty))? => $answer:ty, $needed:expr;
        )+
        $(groups { $($(#[doc = $group_doc:literal])+ $group:ident($members:ty);)+ })?
    ) => {
        #[derive(Debug, Clone, Serialize, Deserialize)]
        $(#[$outer])*
        pub enum $wire {
            $(
                $(#[doc = $doc])+ $(#[serde($($serde)+)])?
                $name $({ $(
                    $(#[doc = $field_doc])+ $(#[serde($($field_serde)+)])?
                    $field: $kind,
                )+ })? $(($inner))?,
            )+
            $($($(#[doc = $group_doc])+ $group($members),)+)?
        }

        impl $wire {
            /// What this request needs.
            pub fn needs(&self) -> Needed {
                match self {
                    $(Self::$name { .. } => $needed,)+
                    $($(Self::$group(member) => member.needs(),)+)?
                }
            }
        }

        $(
            request!($(#[doc = $doc])+ $name $({ $($(#[doc = $field_doc])+ $field: $kind,)+ })? $(($inner))?);

            impl From<$name> for Command {
                fn from(ask: $name) -> Self {
                    let $name $({ $($field),+ })? $(($one))? = ask;
                    ($whole)($wire::$name $({ $($field),+ })? $(($one))?)
                }
            }

            impl Ask for $name {
                type Answer = $answer;
            }
        )+
    };
}

/// The type of one request.
macro_rules! request {
    ($(#[$doc:meta])+ $name:ident) => {
        $(#[$doc])+
        #[derive(Debug, Clone, Copy)]
        pub struct $name;
    };
    ($(#[$doc:meta])+ $name:ident ($inner:ty)) => {
        $(#[$doc])+
        #[derive(Debug, Clone)]
        pub struct $name(
            /// The request, in full.
            pub $inner,
        );
    };
    ($(#[$doc:meta])+ $name:ident { $($(#[$field_doc:meta])+ $field:ident: $kind:ty,)+ }) => {
        $(#[$doc])+
        #[derive(Debug, Clone)]
        pub struct $name {
            $($(#[$field_doc])+ pub $field: $kind,)+
        }
    };
}

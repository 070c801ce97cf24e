//! Requests that name their answers. One list generates the wire enum, a type for each request, and its answer.

use super::Command;
use crate::reply::{Answer, Failure, Reply, Result};

pub trait Ask: Into<Command> {
    type Answer: Answer;

    /// The answer as it goes over the wire.
    fn told(answer: Self::Answer) -> Reply {
        answer.into_reply()
    }

    /// The answer from what came over the wire, or the failure of a site of another version.
    fn heard(reply: Result<Reply>) -> Result<Self::Answer> {
        Self::Answer::from_reply(reply?).ok_or_else(Failure::of_another_version)
    }
}

/// Generates `enum $wire`, the right that each variant needs, why a gateway on a server leaves it to another home, and a
/// type per variant that implements [`Ask`]. Entries under `groups` are variants that hold further lists.
macro_rules! requests {
    (
        $(#[$outer:meta])*
        enum $wire:ident by $whole:expr;
        $(
            $(#[doc = $doc:literal])+ $(#[serde($($serde:tt)+)])?
            $name:ident $({ $(
                $(#[doc = $field_doc:literal])* $(#[serde($($field_serde:tt)+)])?
                $field:ident: $kind:ty
            ),+ $(,)? })? $(($one:ident: $inner:ty))? => $answer:ty, $needed:expr, $elsewhere:expr;
        )+
        $(groups { $($(#[doc = $group_doc:literal])+ $group:ident($members:ty);)+ })?
    ) => {
        #[derive(Debug, Clone, Serialize, Deserialize)]
        $(#[$outer])*
        pub enum $wire {
            $(
                $(#[doc = $doc])+ $(#[serde($($serde)+)])?
                $name $({ $(
                    $(#[doc = $field_doc])* $(#[serde($($field_serde)+)])?
                    $field: $kind,
                )+ })? $(($inner))?,
            )+
            $($($(#[doc = $group_doc])+ $group($members),)+)?
        }

        impl $wire {
            pub fn needs(&self) -> Needed {
                match self {
                    $(Self::$name { .. } => $needed,)+
                    $($(Self::$group(member) => member.needs(),)+)?
                }
            }

            fn elsewhere(&self) -> Elsewhere {
                match self {
                    $(Self::$name { .. } => $elsewhere,)+
                    $($(Self::$group(member) => member.elsewhere(),)+)?
                }
            }
        }

        $(
            request!($(#[doc = $doc])+ $name $({ $($(#[doc = $field_doc])* $field: $kind,)+ })? $(($inner))?);

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
            pub $inner,
        );
    };
    ($(#[$doc:meta])+ $name:ident { $($(#[$field_doc:meta])* $field:ident: $kind:ty,)+ }) => {
        $(#[$doc])+
        #[derive(Debug, Clone)]
        pub struct $name {
            $($(#[$field_doc])* pub $field: $kind,)+
        }
    };
}

//! The one place where the rooms' errors become what a person reads.

use super::reply::Failure;
use crate::chain::ChainError;
use crate::config::ConfigError;
use crate::crypto::CryptoError;
use crate::gateway::GatewayError;
use crate::model::{ErrorKind, clean_lines};
use crate::pipeline::PipelineError;
use crate::ros::RosError;
use crate::store::StoreError;

macro_rules! failure_from {
    ($($error:ty),*) => {$(
        impl From<$error> for Failure {
            fn from(error: $error) -> Self {
                Self::new(error.kind(), clean_lines(&error.to_string(), 600))
            }
        }
    )*};
}
failure_from!(ChainError, ConfigError, CryptoError, GatewayError, PipelineError, RosError, StoreError);

/// A failure of kind `Refused`.
pub fn refused(message: impl Into<String>) -> Failure {
    Failure::new(ErrorKind::Refused, message)
}

/// A failure of kind `Input`.
pub fn input(message: impl Into<String>) -> Failure {
    Failure::new(ErrorKind::Input, message)
}

/// A failure of kind `Internal`, for what cannot happen by an operator's doing.
pub fn internal(message: impl Into<String>) -> Failure {
    Failure::new(ErrorKind::Internal, message)
}

//! The one place where the crates' errors become text for people.

use super::reply::Failure;
use crate::chain::ChainError;
use crate::config::ConfigError;
use crate::crypto::CryptoError;
use crate::gateway::GatewayError;
use crate::model::{ErrorKind, clean};
use crate::pipeline::PipelineError;
use crate::ros::RosError;
use crate::store::StoreError;

macro_rules! failure_from {
    ($($error:ty),*) => {$(
        impl From<$error> for Failure {
            fn from(error: $error) -> Self {
                Self::new(error.kind(), clean(&error.to_string(), 600))
            }
        }
    )*};
}
failure_from!(ChainError, ConfigError, CryptoError, GatewayError, RosError);

/// Ends the text about a full disk: a refused request must be repeated.
pub const AGAIN: &str = ", then do it again";

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Self {
        let again = if matches!(error, StoreError::DiskFull { .. }) { AGAIN } else { "" };
        Self::new(error.kind(), clean(&format!("{error}{again}"), 600))
    }
}

impl From<PipelineError> for Failure {
    fn from(error: PipelineError) -> Self {
        match error {
            PipelineError::Store(error) => error.into(),
            error => Self::new(error.kind(), clean(&error.to_string(), 600)),
        }
    }
}

pub fn refused(message: impl Into<String>) -> Failure {
    Failure::new(ErrorKind::Refused, message)
}

pub fn input(message: impl Into<String>) -> Failure {
    Failure::new(ErrorKind::Input, message)
}

/// For what no act of an operator can cause.
pub fn internal(message: impl Into<String>) -> Failure {
    Failure::new(ErrorKind::Internal, message)
}

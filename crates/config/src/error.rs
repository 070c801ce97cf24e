//! Why settings cannot be used.

use crate::model::ErrorKind;

/// Why the settings cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the variants and their messages name the fields")]
pub enum ConfigError {
    /// The file is not TOML.
    #[error("{file} is not valid TOML: {what}; correct it, or move it away to use the defaults")]
    Syntax { file: String, what: String },
    /// A key that is not a setting; lines count from 1.
    #[error("{file} line {line}: unknown setting '{name}'; `authros config show` lists all settings")]
    Unknown { file: String, line: usize, name: String },
    /// An invalid `[[topic]]` or `[[watch]]` table, or a key that does not belong in this file.
    #[error("{file} line {line}: {what}")]
    Entry { file: String, line: usize, what: String },
    /// A value that its setting does not accept.
    #[error("{name} = '{value}' (from {source_name}) is invalid: {what}")]
    Value { name: &'static str, value: String, source_name: String, what: String },
}

impl ConfigError {
    /// Determines the exit code.
    pub fn kind(&self) -> ErrorKind {
        ErrorKind::Input
    }
}

//! Why settings cannot be used.

use crate::model::ErrorKind;

/// Why the settings cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ConfigError {
    /// The file is not TOML.
    #[error("{file} is not valid TOML: {what}; correct it, or move it away to use the defaults")]
    Syntax {
        /// The file.
        file: String,
        /// The parser's message, with the line.
        what: String,
    },
    /// A key that is not a setting.
    #[error("{file} line {line}: unknown setting '{name}'; `authros config show` lists all settings")]
    Unknown {
        /// The file.
        file: String,
        /// Line, from 1.
        line: usize,
        /// The key.
        name: String,
    },
    /// An invalid `[[topic]]` or `[[watch]]` table, or a key that does not belong in this file.
    #[error("{file} line {line}: {what}")]
    Entry {
        /// The file.
        file: String,
        /// Line, from 1.
        line: usize,
        /// What is wrong and how to write it.
        what: String,
    },
    /// A value that its setting does not accept.
    #[error("{name} = '{value}' (from {source_name}) is invalid: {what}")]
    Value {
        /// The setting.
        name: &'static str,
        /// The value given.
        value: String,
        /// Where it was given.
        source_name: String,
        /// What is expected.
        what: String,
    },
}

impl ConfigError {
    /// Determines the exit code.
    pub fn kind(&self) -> ErrorKind {
        ErrorKind::Input
    }
}

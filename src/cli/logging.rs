//! `--log json`: what a process that stays says, for journals and containers. Also a panic is one line then.

use clap::ValueEnum;

use crate::model::Timestamp;
use crate::service::NoticeLevel;
use authros_output::{Log, log_line};

/// How lines beside the result are written.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum LogForm {
    /// For people
    #[default]
    Text,
    /// One JSON object a line: time, level, source, message
    Json,
}

impl From<LogForm> for Log {
    fn from(form: LogForm) -> Self {
        match form {
            LogForm::Text => Self::Text,
            LogForm::Json => Self::Json,
        }
    }
}

/// A panic of a task is told in the same form as everything else.
pub fn panics_too() {
    std::panic::set_hook(Box::new(|about| {
        use std::io::Write as _;
        let line = log_line(Timestamp::now(), NoticeLevel::Error, "panic", &about.to_string());
        // Nobody is left to tell where that fails.
        drop(writeln!(std::io::stderr().lock(), "{line}"));
    }));
}

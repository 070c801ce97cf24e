//! `--log json`: the messages of a long-running process, for journals and containers. A panic is one line too.

use clap::ValueEnum;

use crate::{model::Timestamp, service::NoticeLevel};
use authros_output::{Log, log_line};

/// How lines beside the result are written.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum LogForm {
    /// For people
    #[default]
    Text,
    /// One JSON object per line: time, level, source, message
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

pub fn panics_too() {
    std::panic::set_hook(Box::new(|about| {
        use std::io::Write as _;
        let line = log_line(Timestamp::now(), NoticeLevel::Error, "panic", &about.to_string());
        // If that fails there is nobody to inform.
        drop(writeln!(std::io::stderr().lock(), "{line}"));
    }));
}

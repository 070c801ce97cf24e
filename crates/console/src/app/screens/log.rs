//! The Log screen: notices of this session and lines of the audit log, newest first.

use std::collections::VecDeque;

use crate::app::fuzzy;
use crate::app::table::Table;
use crate::model::{Timestamp, clean};
use crate::service::NoticeLevel;
use crate::service::reply::AuditView;

/// The most notices kept.
const MOST_NOTICES: usize = 500;
/// The most audit lines asked for.
pub const MOST_AUDIT: usize = 300;
/// Columns kept of a text.
const WIDEST: usize = 400;

/// One line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LogLine {
    /// When.
    pub at: Timestamp,
    /// How urgent.
    pub level: NoticeLevel,
    /// Where from: `notice`, or the number of the audit line.
    pub source: String,
    /// What.
    pub text: String,
    /// What it is about, where a later notice about the same takes its place.
    pub about: Option<String>,
}

/// Notices and audit lines.
#[derive(Debug)]
pub struct Log {
    notices: VecDeque<LogLine>,
    audit: Vec<LogLine>,
    /// Cursor and filter.
    pub table: Table,
    /// The least urgent level shown.
    pub least: NoticeLevel,
    told: u64,
}

impl Default for Log {
    fn default() -> Self {
        let table = Table::following();
        Self { notices: VecDeque::new(), audit: Vec::new(), table, least: NoticeLevel::Info, told: 0 }
    }
}

impl Log {
    /// Keeps a notice.
    pub fn notice(&mut self, at: Timestamp, level: NoticeLevel, text: &str) {
        self.notice_about(at, level, text, None);
    }

    /// Keeps a notice about something that lasts.
    pub fn notice_about(&mut self, at: Timestamp, level: NoticeLevel, text: &str, about: Option<String>) {
        self.told += 1;
        let source = format!("notice {}", self.told);
        self.notices.push_front(LogLine { at, level, source, text: clean(text, WIDEST), about });
        self.notices.truncate(MOST_NOTICES);
    }

    /// Takes audit lines over.
    pub fn set_audit(&mut self, lines: Vec<AuditView>) {
        self.audit = lines.into_iter().take(MOST_AUDIT).map(audit_line).collect();
    }

    /// The lines to show, newest first.
    pub fn visible(&self) -> Vec<&LogLine> {
        let urgent = self.notices.iter().chain(&self.audit).filter(|line| line.level >= self.least).collect();
        let mut lines = fuzzy::narrow(self.table.filter.text(), urgent, |line: &&LogLine| line.text.clone());
        lines.sort_by_key(|line| std::cmp::Reverse(line.at));
        lines
    }

    /// How many lines there are.
    pub fn count(&self) -> usize {
        self.notices.len() + self.audit.len()
    }

    /// The keys of the lines shown.
    pub fn keys(&self) -> Vec<String> {
        self.visible().into_iter().map(|line| line.source.clone()).collect()
    }

    /// The newest warnings and errors of this session.
    pub fn urgent(&self, limit: usize) -> Vec<&LogLine> {
        // What lasts is told by the health of its part, as it is now.
        let is_alert = |line: &&LogLine| line.level > NoticeLevel::Info && line.about.is_none();
        self.notices.iter().filter(is_alert).take(limit).collect()
    }

    /// Shows only more urgent lines, then all again.
    pub fn next_level(&mut self) {
        self.least = match self.least {
            NoticeLevel::Info => NoticeLevel::Warning,
            NoticeLevel::Warning => NoticeLevel::Error,
            NoticeLevel::Error => NoticeLevel::Info,
        };
    }
}

/// A level in one word.
pub fn level_word(level: NoticeLevel) -> &'static str {
    match level {
        NoticeLevel::Info => "info",
        NoticeLevel::Warning => "warning",
        NoticeLevel::Error => "error",
    }
}

fn audit_line(view: AuditView) -> LogLine {
    let good = ["ok", "done", "begun"].contains(&view.outcome.as_str());
    let level = if good { NoticeLevel::Info } else { NoticeLevel::Warning };
    let text = format!("{} {} {}: {}", view.profile, view.action, view.subject, view.outcome);
    LogLine { at: view.at, level, source: format!("audit {}", view.line), text: clean(&text, WIDEST), about: None }
}

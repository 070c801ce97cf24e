//! The Log screen: notices of this session and lines of the audit log, newest first.

use std::collections::VecDeque;

use crate::app::palette;
use crate::app::table::Table;
use crate::model::{Timestamp, clean};
use crate::service::NoticeLevel;
use crate::service::reply::AuditView;

/// The most notices kept.
const MOST_NOTICES: usize = 500;
/// The most audit lines requested.
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
    /// Its key.
    pub key: String,
    /// Its source.
    pub source: Source,
    /// Its text.
    pub text: String,
    /// Its subject, if a later notice about the same replaces it.
    pub about: Option<String>,
    /// Whether the operator has seen it.
    pub seen: bool,
}

impl LogLine {
    /// All of it in one line.
    pub fn whole(&self) -> String {
        format!("{} {} {}: {}", self.at, level_word(self.level), self.key, self.text)
    }
}

/// The source of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// This console: the operator's commands and how they ended.
    Console,
    /// The site, unasked.
    Site,
    /// The audit log.
    Audit,
}

impl Source {
    /// All, in the filter's order.
    pub const ALL: [Self; 3] = [Self::Console, Self::Site, Self::Audit];

    /// In a word.
    pub fn word(self) -> &'static str {
        match self {
            Self::Console => "console",
            Self::Site => "site",
            Self::Audit => "audit",
        }
    }
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
    /// Lines from this source only; `None` = from all.
    pub source: Option<Source>,
    told: u64,
}

impl Default for Log {
    fn default() -> Self {
        let table = Table::following();
        Self { notices: VecDeque::new(), audit: Vec::new(), table, least: NoticeLevel::Info, source: None, told: 0 }
    }
}

impl Log {
    /// Records what this console did or refused.
    pub fn notice(&mut self, at: Timestamp, level: NoticeLevel, text: &str) {
        self.keep(at, level, text, Source::Console, None);
    }

    /// Records what the site reports, and its subject if it lasts.
    pub fn notice_about(&mut self, at: Timestamp, level: NoticeLevel, text: &str, about: Option<String>) {
        self.keep(at, level, text, Source::Site, about);
    }

    fn keep(&mut self, at: Timestamp, level: NoticeLevel, text: &str, source: Source, about: Option<String>) {
        self.told += 1;
        let (key, text) = (format!("notice {}", self.told), clean(text, WIDEST));
        self.notices.push_front(LogLine { at, level, key, source, text, about, seen: false });
        self.notices.truncate(MOST_NOTICES);
    }

    /// The operator has seen this message.
    pub fn saw(&mut self, text: &str) {
        let text = clean(text, WIDEST);
        self.notices.iter_mut().filter(|line| line.text == text).for_each(|line| line.seen = true);
    }

    /// Takes over audit lines.
    pub fn set_audit(&mut self, lines: Vec<AuditView>) {
        self.audit = lines.into_iter().take(MOST_AUDIT).map(audit_line).collect();
    }

    /// The lines to show, newest first.
    pub fn visible(&self) -> Vec<&LogLine> {
        let wanted = |line: &&LogLine| line.level >= self.least && self.source.is_none_or(|from| line.source == from);
        let wanted = self.notices.iter().chain(&self.audit).filter(wanted).collect();
        let mut lines = palette::narrow(self.table.filter.text(), wanted, |line: &&LogLine| line.text.clone());
        lines.sort_by_key(|line| std::cmp::Reverse(line.at));
        lines
    }

    /// How many lines there are.
    pub fn count(&self) -> usize {
        self.notices.len() + self.audit.len()
    }

    /// The keys of the lines shown.
    pub fn keys(&self) -> Vec<String> {
        self.visible().into_iter().map(|line| line.key.clone()).collect()
    }

    /// The line under the cursor.
    pub fn selected(&self) -> Option<&LogLine> {
        let lines = self.visible();
        let keys: Vec<&str> = lines.iter().map(|line| line.key.as_str()).collect();
        lines.get(self.table.position(&keys)).copied()
    }

    /// The newest warnings and errors that the site reported unasked and nobody has seen.
    pub fn urgent(&self, limit: usize) -> Vec<&LogLine> {
        // What lasts is shown by the present health of its part; an operator's own mistake is not an alert.
        let is_news = |line: &LogLine| line.source == Source::Site && line.about.is_none() && !line.seen;
        let is_alert = |line: &&LogLine| line.level > NoticeLevel::Info && is_news(line);
        self.notices.iter().filter(is_alert).take(limit).collect()
    }

    /// Shows lines of only one source, then of the next, then all again.
    pub fn next_source(&mut self) {
        let place = self.source.map_or(0, |source| source as usize + 1);
        self.source = Source::ALL.get(place).copied();
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
    let text = format!("{} {} {}: {}", view.by(), view.action, view.subject, view.outcome);
    let (key, text) = (format!("audit {}", view.line), clean(&text, WIDEST));
    LogLine { at: view.at, level, key, source: Source::Audit, text, about: None, seen: true }
}

//! Notices and audit lines.

use std::collections::VecDeque;
use strum::IntoStaticStr;

use crate::app::{matching::narrow, table::Table};
use crate::model::{Timestamp, clean};
use crate::service::{NoticeLevel, reply::AuditView};

const MOST_NOTICES: usize = 500;
pub const MOST_AUDIT: usize = 300;

/// Columns kept of a text.
const WIDEST: usize = 400;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LogLine {
    pub at: Timestamp,
    pub level: NoticeLevel,
    pub key: String,
    pub source: Source,
    pub text: String,
    /// The subject, if a later notice about it replaces this one.
    pub about: Option<String>,
    pub seen: bool,
}

impl LogLine {
    pub fn whole(&self) -> String {
        format!("{} {} {}: {}", self.at, self.level.word(), self.key, self.text)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, IntoStaticStr)]
#[strum(serialize_all = "lowercase")]
pub enum Source {
    /// The operator's commands and how they ended.
    Console,
    Site,
    Audit,
}

impl Source {
    pub const ALL: [Self; 3] = [Self::Console, Self::Site, Self::Audit];

    pub fn word(self) -> &'static str {
        self.into()
    }
}

#[derive(Debug)]
pub struct Log {
    notices: VecDeque<LogLine>,
    audit: Vec<LogLine>,
    pub table: Table,
    /// The least urgent level shown.
    pub least: NoticeLevel,
    /// `None` = all.
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
    pub fn notice(&mut self, at: Timestamp, level: NoticeLevel, text: &str) {
        self.keep(at, level, text, Source::Console, None);
    }

    pub fn keep(&mut self, at: Timestamp, level: NoticeLevel, text: &str, source: Source, about: Option<String>) {
        self.told += 1;
        let (key, text) = (format!("notice {}", self.told), clean(text, WIDEST));
        self.notices.push_front(LogLine { at, level, key, source, text, about, seen: false });
        self.notices.truncate(MOST_NOTICES);
    }

    pub fn saw(&mut self, text: &str) {
        let text = clean(text, WIDEST);
        self.notices.iter_mut().filter(|line| line.text == text).for_each(|line| line.seen = true);
    }

    pub fn set_audit(&mut self, lines: Vec<AuditView>) {
        self.audit = lines.into_iter().take(MOST_AUDIT).map(audit_line).collect();
    }

    /// Newest first.
    pub fn visible(&self) -> Vec<&LogLine> {
        let wanted = |line: &&LogLine| line.level >= self.least && self.source.is_none_or(|from| line.source == from);
        let wanted = self.notices.iter().chain(&self.audit).filter(wanted).collect();
        let mut lines = narrow(self.table.filter.text(), wanted, |line: &&LogLine| line.text.clone());
        lines.sort_by_key(|line| std::cmp::Reverse(line.at));
        lines
    }

    pub fn count(&self) -> usize {
        self.notices.len() + self.audit.len()
    }

    pub fn keys(&self) -> Vec<String> {
        self.visible().into_iter().map(|line| line.key.clone()).collect()
    }

    pub fn selected(&self) -> Option<&LogLine> {
        self.table.chosen(self.visible(), |line| line.key.as_str())
    }

    /// Newest unseen warnings and errors that the site reported unasked.
    pub fn urgent(&self, limit: usize) -> Vec<&LogLine> {
        // Lasting problems show as the health of their part; an operator's own mistake is no alert.
        let is_news = |line: &LogLine| line.source == Source::Site && line.about.is_none() && !line.seen;
        let is_alert = |line: &&LogLine| line.level > NoticeLevel::Info && is_news(line);
        self.notices.iter().filter(is_alert).take(limit).collect()
    }

    pub fn next_source(&mut self) {
        let place = self.source.map_or(0, |source| source as usize + 1);
        self.source = Source::ALL.get(place).copied();
    }

    pub fn next_level(&mut self) {
        self.least = match self.least {
            NoticeLevel::Info => NoticeLevel::Warning,
            NoticeLevel::Warning => NoticeLevel::Error,
            NoticeLevel::Error => NoticeLevel::Info,
        };
    }
}

fn audit_line(view: AuditView) -> LogLine {
    let good = ["ok", "done", "begun", "serving"].contains(&view.outcome.as_str());
    let level = if good { NoticeLevel::Info } else { NoticeLevel::Warning };
    let text = format!("{} {} {}: {}", view.by(), view.action, view.subject, view.outcome);
    let (key, text) = (format!("audit {}", view.line), clean(&text, WIDEST));
    LogLine { at: view.at, level, key, source: Source::Audit, text, about: None, seen: true }
}

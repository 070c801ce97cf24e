//! Messages to the operator: information for 3 s, warnings and errors until seen.

use std::collections::VecDeque;

use crate::model::Timestamp;
use crate::service::NoticeLevel;

/// How long information is shown, nanoseconds.
const SHOWN_FOR: u64 = 3_000_000_000;
/// The most messages waiting to be seen.
const MOST: usize = 50;

/// One message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Toast {
    /// How urgent.
    pub level: NoticeLevel,
    /// What happened.
    pub text: String,
    /// When it disappears.
    pub until: Option<Timestamp>,
    /// Its subject, if a later message about the same replaces it.
    pub about: Option<String>,
}

/// The messages not yet gone, oldest first.
#[derive(Debug, Default)]
pub struct Toasts(VecDeque<Toast>);

impl Toasts {
    /// Adds a message; the same text twice in a row is shown once.
    pub fn push(&mut self, level: NoticeLevel, text: String, now: Timestamp) {
        self.push_about(level, text, now, None);
    }

    /// Adds a message about something that lasts.
    pub fn push_about(&mut self, level: NoticeLevel, text: String, now: Timestamp, about: Option<String>) {
        let until = (level == NoticeLevel::Info).then(|| Timestamp(now.0.saturating_add(SHOWN_FOR)));
        self.0.retain(|toast| toast.text != text && (toast.until.is_none() || until.is_none()));
        self.0.push_back(Toast { level, text, until, about });
        if self.0.len() > MOST {
            self.0.pop_front();
        }
    }

    /// What was said about it before no longer holds.
    pub fn supersede(&mut self, about: &str) {
        self.0.retain(|toast| toast.about.as_deref() != Some(about));
    }

    /// What to show now: the newest result of a command, or else the newest of the worst that nobody has seen.
    pub fn shown(&self) -> Option<&Toast> {
        let newest = self.0.back().filter(|toast| toast.until.is_some());
        newest.or_else(|| self.0.iter().max_by_key(|toast| toast.level))
    }

    /// How many wait to be seen.
    pub fn unseen(&self) -> usize {
        self.0.iter().filter(|toast| toast.until.is_none()).count()
    }

    /// The one shown was seen.
    pub fn dismiss(&mut self) -> Option<Toast> {
        let shown = self.shown().cloned();
        let place = self.0.iter().position(|toast| Some(toast) == shown.as_ref());
        place.and_then(|place| self.0.remove(place))
    }

    /// Drops what has been shown long enough.
    pub fn expire(&mut self, now: Timestamp) {
        self.0.retain(|toast| toast.until.is_none_or(|until| until > now));
    }

    /// When the next one disappears.
    pub fn next_expiry(&self) -> Option<Timestamp> {
        self.0.iter().filter_map(|toast| toast.until).min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn information_goes_after_three_seconds_and_an_error_stays_until_seen() {
        let mut toasts = Toasts::default();
        toasts.push(NoticeLevel::Error, "node gone".into(), Timestamp(0));
        toasts.push(NoticeLevel::Info, "copied".into(), Timestamp(0));
        toasts.expire(Timestamp(2_999_999_999));
        assert!(toasts.next_expiry().is_some());
        toasts.expire(Timestamp(3_000_000_000));
        assert_eq!(toasts.next_expiry(), None);
        assert_eq!(toasts.shown().map(|toast| toast.text.as_str()), Some("node gone"));
        assert!(toasts.dismiss().is_some());
        assert!(toasts.dismiss().is_none());
    }

    #[test]
    fn an_alert_about_something_that_lasts_is_one_and_goes_when_that_is_over() {
        let mut toasts = Toasts::default();
        let about = || Some("vault".to_owned());
        toasts.push(NoticeLevel::Error, "node gone".into(), Timestamp(0));
        for text in ["down", "still down"] {
            toasts.supersede("vault");
            toasts.push_about(NoticeLevel::Error, text.into(), Timestamp(0), about());
        }
        assert_eq!(toasts.unseen(), 2);
        toasts.supersede("vault");
        toasts.push_about(NoticeLevel::Info, "back".into(), Timestamp(0), about());
        assert_eq!(toasts.unseen(), 1);
        assert_eq!(toasts.shown().map(|toast| toast.text.as_str()), Some("back"), "the newest result is on top");
        toasts.expire(Timestamp(3_000_000_000));
        assert_eq!(toasts.shown().map(|toast| toast.text.as_str()), Some("node gone"));
    }
}

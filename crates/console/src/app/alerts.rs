//! What an operator should look at: since when, how often, what ended recently; and short messages.

use std::collections::VecDeque;

use crate::model::Timestamp;
use crate::service::{NoticeLevel, reply::HealthLevel, reply::PartHealth};

/// How long ended alerts stay, nanoseconds.
const KEPT: u64 = 15 * 60 * 1_000_000_000;

/// Ended alerts shorter than this are dropped if they need no operator, nanoseconds.
const BRIEF: u64 = 5_000_000_000;

const MOST_OVER: usize = 20;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Alert {
    /// The subject, stable while the text changes.
    pub about: String,
    pub level: NoticeLevel,
    pub text: String,
    pub since: Timestamp,
    pub count: usize,
    pub resolved: Option<Timestamp>,
    /// Whether its end is worth reporting.
    pub lasts: bool,
}

impl Alert {
    pub fn new(about: &str, level: NoticeLevel, text: String, since: Timestamp) -> Self {
        Self { about: about.to_owned(), level, text, since, count: 1, resolved: None, lasts: false }
    }

    /// Alerts that begin and end on their own within seconds, as at every start, are not news.
    fn is_worth_knowing(&self) -> bool {
        let lasted = self.resolved.map_or(0, |at| at.0.saturating_sub(self.since.0));
        self.lasts && (lasted >= BRIEF || self.level == NoticeLevel::Error)
    }
}

#[derive(Debug, Default)]
pub struct AlertBook(Vec<Alert>);

impl AlertBook {
    /// Notes new findings with their time and ends missing ones; the site may report some as ended already.
    pub fn refresh(&mut self, found: Vec<Alert>, now: Timestamp) {
        let (over, found): (Vec<Alert>, Vec<Alert>) = found.into_iter().partition(|alert| alert.resolved.is_some());
        for alert in &mut self.0 {
            if alert.resolved.is_none() && !found.iter().any(|other| other.about == alert.about) {
                let told = over.iter().find(|other| other.about == alert.about);
                alert.resolved = told.map_or(Some(now), |other| other.resolved);
            }
        }
        for alert in over {
            if !self.0.iter().chain(&found).any(|known| known.about == alert.about) {
                self.0.push(alert);
            }
        }
        self.0.retain(|alert| alert.resolved.is_none() || alert.is_worth_knowing());
        found.into_iter().for_each(|alert| self.take(alert));
        self.0.retain(|alert| alert.resolved.is_none_or(|at| now.0.saturating_sub(at.0) < KEPT));
        let over = self.0.iter().filter(|alert| alert.resolved.is_some()).count();
        let mut surplus = over.saturating_sub(MOST_OVER);
        self.0.retain(|alert| {
            let goes = alert.resolved.is_some() && surplus > 0;
            surplus -= usize::from(goes);
            !goes
        });
    }

    fn take(&mut self, alert: Alert) {
        let Some(known) = self.0.iter_mut().find(|known| known.about == alert.about) else {
            return self.0.push(alert);
        };
        let again = known.resolved.take().is_some();
        if again {
            known.since = alert.since;
        }
        (known.level, known.text) = (alert.level, alert.text);
        known.count = alert.count.max(known.count + usize::from(again));
    }

    /// Active ones, worst first, then recently ended ones, newest first.
    pub fn shown(&self) -> Vec<&Alert> {
        let mut shown: Vec<&Alert> = self.0.iter().collect();
        shown.sort_by_key(|alert| (alert.resolved.map(std::cmp::Reverse), std::cmp::Reverse(alert.level)));
        shown
    }

    pub fn forgotten_at(&self) -> Option<Timestamp> {
        let over = self.0.iter().filter_map(|alert| alert.resolved).min()?;
        Some(Timestamp(over.0.saturating_add(KEPT)))
    }
}

pub fn health(part: &PartHealth) -> Option<(NoticeLevel, String)> {
    let text = format!("{}: {}", part.part, part.text);
    match part.level {
        HealthLevel::Ok | HealthLevel::Absent => None,
        HealthLevel::Waiting => Some((NoticeLevel::Warning, text)),
        HealthLevel::Failed => Some((NoticeLevel::Error, text)),
    }
}

/// How long information is shown, nanoseconds.
const SHOWN_FOR: u64 = 3_000_000_000;

/// The most messages waiting to be seen.
const MOST: usize = 50;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Toast {
    pub level: NoticeLevel,
    pub text: String,
    pub until: Option<Timestamp>,
    /// The subject, if a later message about it replaces this one.
    pub about: Option<String>,
}

#[derive(Debug, Default)]
pub struct Toasts(VecDeque<Toast>);

impl Toasts {
    /// A text repeated in a row is shown once.
    pub fn push(&mut self, level: NoticeLevel, text: String, now: Timestamp, about: Option<String>) {
        let until = (level == NoticeLevel::Info).then(|| Timestamp(now.0.saturating_add(SHOWN_FOR)));
        self.0.retain(|toast| toast.text != text && (toast.until.is_none() || until.is_none()));
        self.0.push_back(Toast { level, text, until, about });
        if self.0.len() > MOST {
            self.0.pop_front();
        }
    }

    pub fn supersede(&mut self, about: &str) {
        self.0.retain(|toast| toast.about.as_deref() != Some(about));
    }

    /// A part that is well again needs no message that it is not.
    pub fn end(&mut self, health: &[PartHealth]) {
        let is_well = |about: &str| health.iter().any(|part| part.part == about && self::health(part).is_none());
        self.0.retain(|toast| toast.until.is_some() || !toast.about.as_deref().is_some_and(is_well));
    }

    /// The newest result of a command, or else the newest unseen one of the worst level.
    pub fn shown(&self) -> Option<&Toast> {
        let newest = self.0.back().filter(|toast| toast.until.is_some());
        newest.or_else(|| self.0.iter().max_by_key(|toast| toast.level))
    }

    pub fn unseen(&self) -> usize {
        self.0.iter().filter(|toast| toast.until.is_none()).count()
    }

    pub fn dismiss(&mut self) -> Option<Toast> {
        let shown = self.shown().cloned();
        let place = self.0.iter().position(|toast| Some(toast) == shown.as_ref());
        place.and_then(|place| self.0.remove(place))
    }

    pub fn expire(&mut self, now: Timestamp) {
        self.0.retain(|toast| toast.until.is_none_or(|until| until > now));
    }

    pub fn next_expiry(&self) -> Option<Timestamp> {
        self.0.iter().filter_map(|toast| toast.until).min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn alert(about: &str, at: u64) -> Alert {
        let since = Timestamp::from_seconds(at);
        let (level, text) = (NoticeLevel::Error, about.to_owned());
        Alert { about: about.into(), level, text, since, count: 1, resolved: None, lasts: true }
    }

    #[test]
    fn an_alert_says_since_when_how_often_and_that_it_is_over() {
        let at = Timestamp::from_seconds;
        let mut book = AlertBook::default();
        book.refresh(vec![alert("store", 10)], at(10));
        book.refresh(vec![alert("store", 20)], at(20));
        assert_eq!((book.shown()[0].since, book.shown()[0].count), (at(10), 1));
        book.refresh(vec![], at(30));
        assert_eq!(book.shown()[0].resolved, Some(at(30)));
        book.refresh(vec![alert("store", 40), alert("chain", 40)], at(40));
        let store = book.shown().into_iter().find(|alert| alert.about == "store").cloned().expect("it is back");
        assert_eq!((store.since, store.count, store.resolved), (at(40), 2, None));
        book.refresh(vec![alert("chain", 50)], at(50));
        assert_eq!(book.shown().iter().map(|alert| alert.about.as_str()).collect::<Vec<_>>(), ["chain", "store"]);
        assert_eq!(book.forgotten_at(), Some(at(50 + 15 * 60)));
        book.refresh(vec![alert("chain", 50)], at(50 + 15 * 60));
        assert_eq!(book.shown().len(), 1);
    }

    #[test]
    fn what_passes_within_seconds_leaves_no_trace() {
        let at = Timestamp::from_seconds;
        let mut book = AlertBook::default();
        book.refresh(vec![Alert { level: NoticeLevel::Warning, ..alert("chain", 10) }], at(10));
        book.refresh(vec![], at(12));
        assert!(book.shown().is_empty());
        book.refresh(vec![Alert { lasts: false, ..alert("locked", 10) }], at(10));
        book.refresh(vec![], at(60));
        assert!(book.shown().is_empty());
    }
}

#[cfg(test)]
mod toast_tests {
    use super::*;

    #[test]
    fn information_goes_after_three_seconds_and_an_error_stays_until_seen() {
        let mut toasts = Toasts::default();
        toasts.push(NoticeLevel::Error, "node gone".into(), Timestamp(0), None);
        toasts.push(NoticeLevel::Info, "copied".into(), Timestamp(0), None);
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
        let about = || Some("store".to_owned());
        toasts.push(NoticeLevel::Error, "node gone".into(), Timestamp(0), None);
        for text in ["down", "still down"] {
            toasts.supersede("store");
            toasts.push(NoticeLevel::Error, text.into(), Timestamp(0), about());
        }
        assert_eq!(toasts.unseen(), 2);
        toasts.supersede("store");
        toasts.push(NoticeLevel::Info, "back".into(), Timestamp(0), about());
        assert_eq!(toasts.unseen(), 1);
        assert_eq!(toasts.shown().map(|toast| toast.text.as_str()), Some("back"), "the newest result is on top");
        toasts.expire(Timestamp(3_000_000_000));
        assert_eq!(toasts.shown().map(|toast| toast.text.as_str()), Some("node gone"));
    }
}

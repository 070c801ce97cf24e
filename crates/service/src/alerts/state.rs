//! The active alerts: each begins once, may change its text, and ends once.

use std::collections::{BTreeMap, BTreeSet};

use super::rules::{Judged, Level};
use crate::model::Timestamp;
use crate::service::reply::AlertView;

/// Consecutive looks that must find nothing wrong before an alert ends.
const CALM_LOOKS: u8 = 2;

/// The active alerts, by their keys.
#[derive(Debug, Default)]
pub struct Standing {
    alerts: BTreeMap<String, Stands>,
}

#[derive(Debug)]
struct Stands {
    alert: AlertView,
    /// Consecutive looks that found nothing wrong.
    calm: u8,
}

/// What a look changed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Change {
    /// It begins.
    Begun(AlertView),
    /// It ended at that time.
    Resolved(AlertView, Timestamp),
}

impl Standing {
    /// Those that were active when the previous process ended.
    pub fn of(alerts: impl IntoIterator<Item = AlertView>) -> Self {
        let stands = |alert: AlertView| (alert.key.clone(), Stands { alert, calm: 0 });
        Self { alerts: alerts.into_iter().map(stands).collect() }
    }

    /// All, by their keys.
    pub fn all(&self) -> Vec<AlertView> {
        self.alerts.values().map(|stands| stands.alert.clone()).collect()
    }

    /// The changes from what was found at `now`. What is no longer among it is well.
    pub fn look(&mut self, now: Timestamp, site: &str, judged: Vec<Judged>) -> Vec<Change> {
        let mut well: BTreeSet<String> = self.alerts.keys().cloned().collect();
        let mut changes = Vec::new();
        for Judged { key, severity, level, text } in judged {
            if level != Level::Clear {
                well.remove(&key);
            }
            match (self.alerts.get_mut(&key), level) {
                (Some(stands), Level::Firing) => {
                    stands.calm = 0;
                    stands.alert.text = text;
                }
                (Some(stands), Level::Between) => stands.calm = 0,
                (None, Level::Firing) => {
                    let alert = AlertView { key: key.clone(), severity, text, site: site.to_owned(), begun: now };
                    changes.push(Change::Begun(alert.clone()));
                    self.alerts.insert(key, Stands { alert, calm: 0 });
                }
                (None, Level::Between) | (_, Level::Clear) => {}
            }
        }
        changes.extend(well.iter().filter_map(|key| self.calmed(key)).map(|alert| Change::Resolved(alert, now)));
        changes
    }

    /// Notes that a look found nothing wrong; returns the alert if this ends it.
    fn calmed(&mut self, key: &str) -> Option<AlertView> {
        let stands = self.alerts.get_mut(key)?;
        stands.calm += 1;
        if stands.calm < CALM_LOOKS {
            return None;
        }
        self.alerts.remove(key).map(|stands| stands.alert)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::service::alerts::{Delivery, News};
    use crate::service::reply::Severity;

    pub fn alert(key: &str) -> AlertView {
        let (severity, site) = (Severity::Critical, "0a0b0c0d".to_owned());
        let begun = Timestamp::from_seconds(1_700_000_000);
        AlertView { key: key.to_owned(), severity, text: "t".to_owned(), site, begun }
    }

    pub fn delivery(number: u64) -> Delivery {
        Delivery { number, state: News::Begun, alert: alert("disk"), ended: None }
    }

    fn judged(level: Level, text: &str) -> Vec<Judged> {
        vec![Judged { key: "disk".to_owned(), severity: Severity::Critical, level, text: text.to_owned() }]
    }

    #[test]
    fn an_alert_begins_once_changes_its_words_and_ends_once() {
        let mut standing = Standing::default();
        let mut look = |second, level| {
            let changes = standing.look(Timestamp::from_seconds(second), "s", judged(level, &second.to_string()));
            (changes, standing.all())
        };
        assert!(look(1, Level::Between).0.is_empty(), "what hovers does not begin");
        let (begun, _) = look(2, Level::Firing);
        assert!(matches!(&begun[..], [Change::Begun(alert)] if alert.begun.seconds() == 2 && alert.text == "2"));
        let (again, all) = look(3, Level::Firing);
        assert!(again.is_empty() && all[0].text == "3" && all[0].begun.seconds() == 2);
        // Calm for a moment, then close to the limit: the alert continues.
        for (second, level) in [(4, Level::Clear), (5, Level::Between), (6, Level::Clear), (7, Level::Firing)] {
            assert!(look(second, level).0.is_empty(), "{second}");
        }
        assert!(look(8, Level::Clear).0.is_empty());
        let (over, all) = look(9, Level::Clear);
        assert!(matches!(&over[..], [Change::Resolved(alert, at)] if alert.begun.seconds() == 2 && at.seconds() == 9));
        assert!(all.is_empty() && look(10, Level::Clear).0.is_empty());
    }

    #[test]
    fn what_stood_before_a_restart_does_not_begin_again_and_ends_where_its_rule_is_gone() {
        let mut standing = Standing::of([alert("disk"), alert("robot_silent/1")]);
        let now = Timestamp::from_seconds(1_700_000_100);
        assert!(standing.look(now, "s", judged(Level::Firing, "t")).is_empty());
        let over = standing.look(now, "s", judged(Level::Firing, "t"));
        assert_eq!(over, [Change::Resolved(alert("robot_silent/1"), now)]);
    }
}

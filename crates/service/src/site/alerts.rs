//! Judges the site's figures and delivers alerts, in separate tasks: a dead webhook or a slow disk delays only alerts.

use std::collections::VecDeque;
use std::collections::hash_map::RandomState;
use std::hash::{BuildHasher as _, Hasher as _};
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use tokio::sync::Notify;

use crate::alerts::{Carrier, Change, Delivery, Judge, News, Queue, RULES, Standing, Undelivered, place_name, rule_of};
use crate::config::{AlertForm, AlertPlace, AlertSettings};
use crate::figures::{Figures, short};
use crate::hub::Hub;
use crate::model::{Timestamp, locked};
use crate::reply::{
    AlertTestView, AlertView, AlertsView, EndedAlert, Failure, NoticeLevel, Part, Result, Severity, input,
};
use crate::site::{Parts, Site, blocking};

const PAUSES: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(300));
/// Refusals of the first delivery after which it is dropped: the others wait behind it.
const MOST_JUDGED: u32 = 5;
/// Alertmanager considers an alert over after five minutes without a reminder.
const REMIND: Duration = Duration::from_secs(60);
const DELIVERY: &str = "alert delivery";
/// How long ended alerts are shown, nanoseconds, and how many.
const KEPT: u64 = 15 * 60 * 1_000_000_000;
const MOST_OVER: usize = 20;

pub(super) struct Alerts {
    settings: AlertSettings,
    path: PathBuf,
    hub: Arc<Hub>,
    known: Mutex<Option<Known>>,
    /// Result of the last look. A separate lock: readers never wait for a disk.
    shown: Mutex<Shown>,
    added: Notify,
}

#[derive(Default)]
struct Shown {
    alerts: Vec<AlertView>,
    over: VecDeque<EndedAlert>,
    /// Waiting, and dropped for want of room.
    deliveries: (u64, u64),
}

impl Shown {
    fn refresh(&mut self, now: Timestamp, alerts: Vec<AlertView>, changes: &[Change]) {
        self.alerts = alerts;
        for change in changes {
            match change {
                Change::Begun(alert) => self.over.retain(|over| over.alert.key != alert.key),
                Change::Resolved(alert, ended) => {
                    self.over.push_front(EndedAlert { alert: alert.clone(), ended: *ended });
                }
            }
        }
        self.over.retain(|over| now.0.saturating_sub(over.ended.0) < KEPT);
        self.over.truncate(MOST_OVER);
    }
}

struct Known {
    judge: Judge,
    standing: Standing,
    queue: Queue,
    reminded: Instant,
}

impl Alerts {
    pub fn new(parts: &Parts) -> Self {
        let (settings, path, hub) = (parts.config.alerts.clone(), parts.home.alerts(), Arc::clone(&parts.hub));
        Self { settings, path, hub, known: Mutex::default(), shown: Mutex::default(), added: Notify::new() }
    }

    pub fn shown(&self) -> (Vec<AlertView>, Vec<EndedAlert>) {
        let shown = locked(&self.shown);
        (shown.alerts.clone(), shown.over.iter().cloned().collect())
    }

    pub fn by_rule(&self) -> Vec<(&'static str, u64)> {
        let shown = locked(&self.shown);
        let count = |rule: &str| shown.alerts.iter().filter(|alert| rule_of(&alert.key) == rule).count();
        RULES.iter().map(|rule| (*rule, u64::try_from(count(rule)).unwrap_or(u64::MAX))).collect()
    }

    pub fn deliveries(&self) -> (u64, u64) {
        locked(&self.shown).deliveries
    }

    fn with<Told>(&self, work: impl FnOnce(&mut Known) -> Told) -> Told {
        let mut known = locked(&self.known);
        let known = known.get_or_insert_with(|| {
            let (queue, lost) = Queue::open(&self.path);
            if let Some(text) = lost {
                self.hub.warn(&text);
            }
            let (judge, standing) = (Judge::new(self.settings.limits.clone()), Standing::of(queue.standing()));
            Known { judge, standing, queue, reminded: Instant::now() }
        });
        let told = work(known);
        locked(&self.shown).deliveries = known.queue.counts();
        told
    }

    fn place(&self) -> Result<&AlertPlace> {
        let nobody = "alerts are only shown, not sent; set alerts.webhook or alerts.command";
        self.settings.place.as_ref().ok_or_else(|| input(nobody))
    }

    /// Changes caused by these figures; queues their deliveries.
    fn look(&self, figures: &Figures) -> Vec<Change> {
        let site = figures.owners.first().map_or("", |owner| owner.owner.as_str());
        let forgets = matches!(self.settings.place, Some(AlertPlace::Webhook { form: AlertForm::Alertmanager, .. }));
        let told = self.settings.place.is_some();
        let (changes, standing) = self.with(|known| {
            let mut judged = known.judge.judge(figures);
            judged.extend(known.judge.not_known(&known.standing.all()));
            let changes = known.standing.look(figures.now, site, judged);
            // Without a destination nothing is stored: if one is set later, the alerts begin for it then.
            for change in changes.iter().filter(|_| told) {
                known.queue.add(change.clone());
            }
            if forgets && known.reminded.elapsed() >= REMIND && known.queue.first().is_none() {
                known.reminded = Instant::now();
                known.queue.remind();
            }
            (changes, known.standing.all())
        });
        locked(&self.shown).refresh(figures.now, standing, &changes);
        self.added.notify_one();
        changes
    }

    fn view(&self) -> AlertsView {
        let nobody = || "nobody; set alerts.webhook or alerts.command".to_owned();
        let told = self.settings.place.as_ref().map_or_else(nobody, place_name);
        let (alerts, (waiting, dropped)) = self.with(|known| (known.standing.all(), known.queue.counts()));
        AlertsView { alerts, over: self.shown().1, told, waiting, dropped }
    }
}

impl Site {
    pub(super) fn watch_for_alerts(self: &Arc<Self>) {
        drop(self.parts.supervisor.keep("alerts", self, Self::judge_alerts));
        if self.alerts.settings.place.is_some() {
            drop(self.parts.supervisor.keep("alert delivery", self, Self::deliver_alerts));
        }
    }

    async fn judge_alerts(self: Arc<Self>) {
        while self.parts.life.beat(self.alerts.settings.every).await {
            // Unreadable figures are read the next time.
            let looked = blocking(&self, |site| Ok(site.alerts.look(&site.figures()?))).await.unwrap_or_default();
            if !looked.is_empty() {
                self.parts.hub.changed(Part::Health);
            }
            // Without a destination the parts' own notices suffice.
            for change in looked.iter().filter(|_| self.alerts.settings.place.is_some()) {
                self.tell_of(change);
            }
        }
    }

    fn tell_of(&self, change: &Change) {
        let (alert, level, text) = match change {
            Change::Begun(alert) => {
                let level = match alert.severity {
                    Severity::Warning => NoticeLevel::Warning,
                    Severity::Critical => NoticeLevel::Error,
                };
                (alert, level, format!("alert {}: {}", alert.key, alert.text))
            }
            Change::Resolved(alert, _) => (alert, NoticeLevel::Info, format!("alert {} is over", alert.key)),
        };
        self.parts.hub.notice_about(&format!("alert {}", alert.key), level, &text);
    }

    async fn deliver_alerts(self: Arc<Self>) {
        let (mut failures, mut judged) = (0, 0);
        while !self.parts.life.is_stopping() {
            let carried = tokio::select! {
                carried = self.deliver_next() => carried,
                () = self.stopped() => return,
            };
            let Err(Undelivered { failure, is_judged }) = carried else {
                if failures > 0 {
                    self.parts.hub.notice_about(DELIVERY, NoticeLevel::Info, "alert delivery works again");
                }
                (failures, judged) = (0, 0);
                continue;
            };
            if failures == 0 {
                let text = format!("an alert could not be delivered and will be retried: {failure}");
                self.parts.hub.notice_about(DELIVERY, NoticeLevel::Warning, &text);
            }
            failures += 1;
            judged = if is_judged { judged + 1 } else { 0 };
            if judged >= MOST_JUDGED {
                self.give_up_delivery(&failure).await;
                (failures, judged) = (1, 0);
            }
            self.parts.life.rest(pause(failures, RandomState::new().build_hasher().finish())).await;
        }
    }

    /// Drops the first delivery, which is always refused, so that the others are sent.
    async fn give_up_delivery(self: &Arc<Self>, failure: &Failure) {
        let given_up = blocking(self, |site| Ok(site.alerts.with(|known| known.queue.give_up()))).await;
        let Some(key) = given_up.ok().flatten() else { return };
        let text = format!("an alert was refused {MOST_JUDGED} times and is not sent again ({key}): {failure}");
        self.parts.hub.notice_about(DELIVERY, NoticeLevel::Error, &text);
    }

    /// Waits for a delivery and sends it.
    async fn deliver_next(self: &Arc<Self>) -> Result<(), Undelivered> {
        let first = blocking(self, |site| Ok(site.alerts.with(|known| known.queue.first()))).await?;
        let Some((delivery, dropped)) = first else {
            self.alerts.added.notified().await;
            return Ok(());
        };
        // Rebuilt each time: a secret may have been replaced.
        Carrier::of(self.alerts.place()?)?.carry(&delivery, dropped).await?;
        let number = delivery.number;
        blocking(self, move |site| {
            site.alerts.with(|known| known.queue.done(number, dropped));
            Ok(())
        })
        .await?;
        Ok(())
    }

    pub(super) async fn alerts_view(self: &Arc<Self>) -> Result<AlertsView> {
        blocking(self, |site| Ok(site.alerts.view())).await
    }

    pub(super) async fn test_alert(self: &Arc<Self>) -> Result<AlertTestView> {
        let place = self.alerts.place()?;
        let owner = self.parts.owners.all().first().map(|owner| short(&owner.address.to_string()));
        let alert = AlertView {
            key: "test".to_owned(),
            severity: Severity::Warning,
            text: "This is a test alert from `authros alerts test`. Nothing is wrong.".to_owned(),
            site: owner.unwrap_or_default(),
            begun: Timestamp::now(),
        };
        let number = blocking(self, |site| Ok(site.alerts.with(|known| known.queue.next_number()))).await?;
        let delivery = Delivery { number, state: News::Test, alert, ended: None };
        let carried = Carrier::of(place)?.carry(&delivery, 0).await;
        let text = carried.map_err(|undelivered| undelivered.failure)?;
        Ok(AlertTestView { place: place_name(place), text })
    }
}

/// Doubles with each failure in a row; half of it is random, so that sites do not retry in step.
fn pause(failures: u32, chance: u64) -> Duration {
    let doubled = PAUSES.0.saturating_mul(1 << failures.saturating_sub(1).min(16)).min(PAUSES.1);
    let half = doubled / 2;
    let nanos = u64::try_from(half.as_nanos()).unwrap_or(u64::MAX);
    half + Duration::from_nanos(chance % nanos.max(1))
}

#[cfg(test)]
mod at_alertmanager;
#[cfg(test)]
mod over_http;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reply::Event;

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn what_stands_and_was_over_is_known_where_nobody_is_told_and_nothing_is_written_for_nobody() {
        use crate::alerts::troubles::{before, well};
        let settings = [("alerts.disk", "1000MiB"), ("alerts.grant_ends", "1h")];
        let needs = super::super::Needs { ros: false, chain: false };
        let (site, folder) = super::super::testing::site_of(&settings, needs);
        let keys = |alerts: &[AlertView]| alerts.iter().map(|alert| alert.key.clone()).collect::<Vec<_>>();
        let full = |second| Figures { disk: Some((1, 1)), ..well(second) };
        assert_eq!(site.alerts.look(&full(0)).len(), 1);
        assert!(site.alerts.look(&full(10)).is_empty(), "the same is told once");
        assert_eq!(keys(&site.alerts.shown().0), ["disk"]);
        assert_eq!(
            site.alerts.by_rule().into_iter().filter(|(_, count)| *count > 0).collect::<Vec<_>>(),
            [("disk", 1)]
        );
        (2..5).for_each(|look| drop(site.alerts.look(&well(look * 10))));
        let view = site.alerts.view();
        assert_eq!((keys(&view.alerts).len(), view.over.len(), view.waiting), (0, 1, 0), "{view:?}");
        assert_eq!((view.over[0].alert.begun, view.over[0].ended), (well(0).now, well(30).now));
        assert!(view.told.starts_with("nobody"), "{}", view.told);
        site.alerts.look(&well(30 + 15 * 60));
        assert!(site.alerts.shown().1.is_empty(), "a quarter of an hour later it is forgotten");
        assert!(!folder.path().join("home/alerts.queue").exists());
        let mut silent = well(2000);
        silent.robots[0].last_seen = before(&silent, 700);
        assert_eq!(site.alerts.look(&silent).len(), 1);
        site.stop().await;
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn a_queue_that_cannot_be_read_is_told_of() {
        let ground = super::super::testing::Ground::with(&[]);
        std::fs::write(ground.home().alerts(), "damaged").expect("written");
        let (alerts, mut events) = (Alerts::new(&ground.parts), ground.parts.hub.events().subscribe());
        assert_eq!((alerts.view().waiting, alerts.view().waiting), (0, 0));
        let Ok(Event::Notice { level, text, .. }) = events.try_recv() else { panic!("it is told") };
        assert!(level == NoticeLevel::Warning && text.starts_with("look into "), "{text}");
        assert!(events.try_recv().is_err(), "once");
    }

    #[test]
    fn pauses_double_up_to_five_minutes_and_half_of_each_is_chance() {
        let milliseconds = |failures, chance| pause(failures, chance).as_millis();
        assert_eq!([1, 2, 3, 4].map(|failures| milliseconds(failures, 0)), [250, 500, 1000, 2000]);
        assert_eq!((milliseconds(30, 0), milliseconds(u32::MAX, 0)), (150_000, 150_000));
        for chance in [1, u64::MAX, 0x1234_5678_9abc_def0] {
            assert!((150_000..300_000).contains(&milliseconds(30, chance)), "{chance}");
        }
    }
}

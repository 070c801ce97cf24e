//! Figures in Prometheus's text format, with labels from a bounded set.

use super::{BOUNDS, Figures, Latency, LifeLine, OwnerFigures, TopicFigures, short};
use crate::model::Timestamp;
use crate::pipeline::sender::LaneState;
use crate::reply::{HealthLevel, TaskState};
use crate::store::LeaseState;

pub const CONTENT_TYPE: &str = "text/plain; version=0.0.4; charset=utf-8";

type Labels<'a> = &'a [(&'a str, &'a str)];

#[derive(Default)]
struct Text(String);

impl Text {
    fn begin(&mut self, name: &str, kind: &str, help: &str) {
        self.0.push_str(&format!("# HELP {name} {help}\n# TYPE {name} {kind}\n"));
    }

    fn value(&mut self, name: &str, labels: Labels<'_>, value: impl std::fmt::Display) {
        self.0.push_str(name);
        for (index, (label, text)) in labels.iter().enumerate() {
            let before = if index == 0 { '{' } else { ',' };
            self.0.push_str(&format!("{before}{label}=\"{}\"", escaped(text)));
        }
        let behind = if labels.is_empty() { "" } else { "}" };
        self.0.push_str(&format!("{behind} {value}\n"));
    }

    fn single(&mut self, name: &str, kind: &str, help: &str, value: impl std::fmt::Display) {
        self.begin(name, kind, help);
        self.value(name, &[], value);
    }

    fn family<'r, Row, Value: std::fmt::Display, const LABELS: usize>(
        &mut self,
        name: &str,
        kind: &str,
        help: &str,
        rows: &'r [Row],
        each: impl Fn(&'r Row) -> ([(&'static str, &'r str); LABELS], Value),
    ) {
        if !rows.is_empty() {
            self.begin(name, kind, help);
        }
        for (labels, value) in rows.iter().map(each) {
            self.value(name, &labels, value);
        }
    }
}

fn escaped(text: &str) -> String {
    text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

pub fn text(figures: &Figures) -> String {
    let mut text = Text::default();
    text.begin("authros_build_info", "gauge", "The program's version; always 1.");
    text.value("authros_build_info", &[("version", env!("CARGO_PKG_VERSION"))], 1);
    records(&mut text, figures);
    topics(&mut text, figures);
    ages(&mut text, figures);
    line(&mut text, figures);
    chain(&mut text, figures);
    health(&mut text, figures);
    if !figures.latencies.is_empty() {
        let help = "Time from capture to a milestone; the sum is at most 1/16 too high.";
        text.begin("authros_latency_seconds", "histogram", help);
    }
    figures.latencies.iter().for_each(|latency| histogram(&mut text, latency));
    text.0
}

fn states(life: &LifeLine) -> [(&'static str, u64); 6] {
    [
        ("verified", life.verified),
        ("pending", life.pending),
        ("right_ended", life.right_ended),
        ("quarantined", life.quarantined),
        ("dropped", life.dropped),
        ("tampered", life.tampered),
    ]
}

fn losses(life: &LifeLine) -> [(&'static str, u64); 2] {
    [("transport", life.lost_in_transport), ("recorder", life.lost_in_recorder)]
}

fn records(text: &mut Text, figures: &Figures) {
    fn by(row: &OwnerFigures) -> [(&'static str, &str); 1] {
        [("owner", &row.owner)]
    }
    fn split<const TERMS: usize>(
        owners: &[OwnerFigures],
        terms: fn(&LifeLine) -> [(&'static str, u64); TERMS],
    ) -> Vec<(&str, &'static str, u64)> {
        owners.iter().flat_map(|row| terms(&row.life).map(|(term, count)| (&*row.owner, term, count))).collect()
    }
    let owners = &figures.owners;
    let help = "Messages captured, including those dropped later.";
    text.family("authros_records_captured_total", "counter", help, owners, |row| (by(row), row.life.captured));
    let help = "Data records by state; their sum is authros_records_captured_total.";
    text.family("authros_records", "gauge", help, &split(owners, states), |(owner, state, count)| {
        ([("owner", owner), ("state", state)], count)
    });
    let help = "1 if captured equals the sum of all states, overall and per topic; otherwise 0.";
    text.family("authros_records_conserved", "gauge", help, owners, |row| (by(row), u64::from(row.life.conserved)));
    let help = "Messages that did not become records: transport (never arrived), recorder (no room or no key).";
    text.family("authros_losses_total", "counter", help, &split(owners, losses), |(owner, place, count)| {
        ([("owner", owner), ("place", place)], count)
    });
    let help = "Quarantined records that the operator discarded.";
    text.family("authros_records_discarded_total", "counter", help, owners, |row| (by(row), row.life.discarded));
}

fn topics(text: &mut Text, figures: &Figures) {
    fn by<'a>((owner, topic): &(&'a str, &'a TopicFigures)) -> [(&'static str, &'a str); 2] {
        [("owner", owner), ("topic", &topic.topic)]
    }
    let owners = figures.owners.iter();
    let rows: Vec<_> = owners.flat_map(|row| row.topics.iter().map(move |topic| (&*row.owner, topic))).collect();
    let help = "Messages of a topic that were captured.";
    text.family("authros_topic_captured_total", "counter", help, &rows, |row| (by(row), row.1.captured));
    let help = "Records of a topic that are verified.";
    text.family("authros_topic_verified_records", "gauge", help, &rows, |row| (by(row), row.1.verified));
    let help = "Messages of a topic that never arrived.";
    text.family("authros_topic_missed_total", "counter", help, &rows, |row| (by(row), row.1.missed));
}

fn ages(text: &mut Text, figures: &Figures) {
    let age = |moment: Option<Timestamp>| moment.map_or(0.0, |moment| figures.age(moment));
    let help = "Age of the oldest record not yet in a block; 0 if all are.";
    text.family("authros_oldest_unanchored_age_seconds", "gauge", help, &figures.owners, |row| {
        ([("owner", &row.owner)], age(row.oldest_unanchored))
    });
    let help = "Time since a robot's newest record arrived here.";
    text.family("authros_robot_last_seen_age_seconds", "gauge", help, &figures.robots, |row| {
        ([("robot", &row.robot)], figures.age(row.last_seen))
    });
    let help = "Time until a grant ends; the first 64 to end of those given, and of those received from contacts.";
    let grants = figures.grants.as_deref().unwrap_or_default();
    text.family("authros_grant_ends_seconds", "gauge", help, grants, |row| {
        ([("owner", &row.owner), ("reader", &row.reader)], figures.until(row.ends))
    });
    let uncovered = figures.owners.iter().filter_map(|owner| owner.audit_unanchored).min();
    let help = "Age of the oldest audit log line not covered by an anchored head; 0 if all are covered.";
    text.single("authros_audit_unanchored_age_seconds", "gauge", help, age(uncovered));
    text.single("authros_audit_lines_total", "counter", "Lines of the audit log.", figures.audit_lines);
}

fn line(text: &mut Text, figures: &Figures) {
    let queue = &figures.queue;
    text.single("authros_queue_messages", "gauge", "Messages in memory waiting to be sealed.", queue.messages);
    text.single("authros_queue_bytes", "gauge", "Bytes of messages waiting to be sealed.", queue.bytes);
    let help = "Limit for bytes of messages waiting to be sealed.";
    text.single("authros_queue_capacity_bytes", "gauge", help, queue.capacity);
    cache(text, figures);
    text.single("authros_gaps_untold", "gauge", "Losses not yet reported in a gap record.", figures.untold_gaps);
    if let Some((free, reserve)) = figures.disk {
        text.single("authros_disk_free_bytes", "gauge", "Free space on the disk of the home.", free);
        let help = "Free space below which no record is acknowledged.";
        text.single("authros_disk_reserve_bytes", "gauge", help, reserve);
    }
    let help = "Time that a pipeline stage spent working.";
    text.family("authros_stage_busy_seconds_total", "counter", help, &figures.busy, |(stage, seconds)| {
        ([("stage", stage)], seconds)
    });
}

fn cache(text: &mut Text, figures: &Figures) {
    let Some(cache) = &figures.cache else { return };
    let away = cache.away.as_ref().map_or(0.0, |away| figures.age(away.since));
    for (name, help, count) in [
        ("authros_cache_hits_total", "Records that the cache had.", cache.hits),
        ("authros_cache_misses_total", "Records that the cache did not have.", cache.misses),
        ("authros_cache_wrong_total", "Answers of the cache that were not the record asked for.", cache.wrong),
        ("authros_cache_skipped_total", "Records not written to the cache.", cache.skipped),
    ] {
        text.single(name, "counter", help, count);
    }
    let help = "Time since the cache, or a part of it, stopped answering; 0 if it answers.";
    text.single("authros_cache_away_seconds", "gauge", help, away);
}

fn chain(text: &mut Text, figures: &Figures) {
    fn by<'a>((account, _): &'a (String, &LaneState)) -> [(&'static str, &'a str); 1] {
        [("account", account)]
    }
    if let Some((number, time)) = figures.block {
        text.single("authros_chain_block_height", "gauge", "Height of the newest block.", number);
        let help = "Time since the newest block, by that block's own time.";
        text.single("authros_last_block_age_seconds", "gauge", help, figures.age(time));
    }
    let lanes: Vec<_> = figures.lanes.iter().map(|lane| (short(&lane.account.to_string()), lane)).collect();
    let (lanes, age) = (&lanes, |oldest| figures.age(oldest));
    let help = "Transactions of a lane that are not in a block yet.";
    text.family("authros_lane_open_transactions", "gauge", help, lanes, |row| (by(row), row.1.open));
    let help = "Age of a lane's oldest open transaction; 0 if there is none.";
    text.family("authros_lane_oldest_age_seconds", "gauge", help, lanes, |row| {
        (by(row), row.1.oldest.map_or(0.0, age))
    });
    let help = "1 if a lane is stuck until somebody intervenes; otherwise 0.";
    text.family("authros_lane_paused", "gauge", help, lanes, |row| (by(row), u8::from(row.1.paused.is_some())));
}

fn health(text: &mut Text, figures: &Figures) {
    let help = "1 if a part of the site works; 0 if it is starting, retrying, or has failed.";
    text.family("authros_part_up", "gauge", help, &figures.parts, |row| {
        ([("part", &row.part)], u8::from(row.level == HealthLevel::Ok))
    });
    let help = "Seconds by which the machine's clock is ahead of the time used for grants and device authorisations; \
                negative if it is behind.";
    text.single("authros_clock_ahead_seconds", "gauge", help, figures.clock_ahead);
    text.begin("authros_tasks", "gauge", "Background tasks by state.");
    let resting = figures.tasks.iter().filter(|task| task.state == TaskState::Resting).count();
    text.value("authros_tasks", &[("state", "running")], figures.tasks.len() - resting);
    text.value("authros_tasks", &[("state", "resting")], resting);
    if let Some(gateway) = &figures.gateway {
        text.single("authros_gateway_connections", "gauge", "Open connections of the gateway.", gateway.connections);
        let help = "Frames and connections that the gateway refused, by the protocol's code.";
        let refused: Vec<_> = gateway.refused.iter().map(|(code, count)| (code.to_string(), count)).collect();
        text.family("authros_gateway_refused_total", "counter", help, &refused, |(code, count)| {
            ([("code", code)], count)
        });
    }
    figures.lease.iter().for_each(|lease| leases(text, lease));
    let help = "Active alerts of the site itself, by rule.";
    text.family("authros_alerts", "gauge", help, &figures.alerts, |(rule, count)| ([("rule", rule)], count));
    let (waiting, dropped) = figures.deliveries;
    text.single("authros_alert_deliveries_waiting", "gauge", "Alert deliveries that are queued.", waiting);
    let help = "Alert deliveries dropped because the queue was full, and not yet reported by another delivery.";
    text.single("authros_alert_deliveries_dropped", "gauge", help, dropped);
}

fn leases(text: &mut Text, lease: &LeaseState) {
    let (is_held, is_own) = (lease.holder.is_some(), lease.holder.as_ref().is_some_and(|holder| holder.is_own));
    let help = "1 = a worker holds the lease of the database.";
    text.single("authros_lease_held", "gauge", help, u8::from(is_held));
    text.single("authros_lease_held_here", "gauge", "1 = this worker holds it.", u8::from(is_own));
    let help = "How often the lease was taken, by any worker.";
    text.single("authros_lease_taken_total", "counter", help, lease.number);
    let help = "Workers that gave a sign of life in the database within 10 s.";
    text.single("authros_workers", "gauge", help, lease.workers.len());
}

fn histogram(text: &mut Text, latency: &Latency) {
    let milestone = ("milestone", latency.milestone);
    for (power, within) in BOUNDS.iter().zip(&latency.within) {
        let bound = std::time::Duration::from_micros(1 << power).as_secs_f64().to_string();
        text.value("authros_latency_seconds_bucket", &[milestone, ("le", &bound)], within);
    }
    text.value("authros_latency_seconds_bucket", &[milestone, ("le", "+Inf")], latency.count);
    text.value("authros_latency_seconds_sum", &[milestone], latency.seconds);
    text.value("authros_latency_seconds_count", &[milestone], latency.count);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::figures::RobotFigures;

    fn figures() -> Figures {
        let life = LifeLine {
            captured: 21,
            verified: 6,
            pending: 5,
            right_ended: 4,
            quarantined: 3,
            dropped: 2,
            ..LifeLine::default()
        };
        let life = LifeLine { tampered: 1, conserved: true, ..life };
        let owner = OwnerFigures { owner: "0a0b0c0d".to_owned(), life, ..OwnerFigures::default() };
        let oldest_unanchored = Some(Timestamp::from_seconds(90));
        Figures {
            now: Timestamp::from_seconds(100),
            owners: vec![OwnerFigures { oldest_unanchored, ..owner }],
            robots: vec![RobotFigures { robot: "12345678".to_owned(), last_seen: Timestamp::from_seconds(140) }],
            latencies: vec![Latency { milestone: "durable", within: vec![1; 12], count: 2, seconds: 0.5 }],
            ..Figures::default()
        }
    }

    #[test]
    fn the_terms_of_the_law_stand_beside_what_was_captured() {
        let text = text(&figures());
        for line in [
            "authros_records_captured_total{owner=\"0a0b0c0d\"} 21",
            "authros_records{owner=\"0a0b0c0d\",state=\"verified\"} 6",
            "authros_records{owner=\"0a0b0c0d\",state=\"tampered\"} 1",
            "authros_records_conserved{owner=\"0a0b0c0d\"} 1",
            "authros_oldest_unanchored_age_seconds{owner=\"0a0b0c0d\"} 10",
            "authros_robot_last_seen_age_seconds{robot=\"12345678\"} 0",
            "authros_latency_seconds_bucket{milestone=\"durable\",le=\"0.001024\"} 1",
            "authros_latency_seconds_bucket{milestone=\"durable\",le=\"+Inf\"} 2",
        ] {
            assert!(text.lines().any(|other| other == line), "{line} is not in\n{text}");
        }
        assert!(!text.contains("authros_topic"), "no topic unless asked for");
    }

    #[test]
    fn a_topic_with_quotes_cannot_leave_its_label() {
        let mut figures = figures();
        let topic = "/a\"} 1\nauthros_records{state=\"\\".to_owned();
        figures.owners[0].topics.push(TopicFigures { topic, captured: 9, ..TopicFigures::default() });
        let text = text(&figures);
        let line =
            "authros_topic_captured_total{owner=\"0a0b0c0d\",topic=\"/a\\\"} 1\\nauthros_records{state=\\\"\\\\\"} 9";
        assert!(text.lines().any(|other| other == line), "{text}");
    }

    #[test]
    fn a_family_is_begun_once_and_before_its_values() {
        let text = text(&figures());
        let names: Vec<_> = text.lines().filter_map(|line| line.strip_prefix("# TYPE ")).collect();
        let distinct: std::collections::BTreeSet<_> = names.iter().collect();
        assert_eq!(names.len(), distinct.len(), "{names:?}");
    }
}

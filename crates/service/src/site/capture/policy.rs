//! Rules for topics, and measured rates to draft them from.

use super::Capture;
use std::time::Duration;

use crate::model::{ProfileName, TopicRule};
use crate::service::failure::input;
use crate::service::reply::{Failure, PolicyRow, PolicyView};

const LONGEST: u64 = 600_000;

impl Capture {
    pub async fn learn_policy(&self, profile: &ProfileName, milliseconds: u64) -> Result<PolicyView, Failure> {
        if !(1000..=LONGEST).contains(&milliseconds) {
            return Err(input("observe the topics for 1 second to 10 minutes, as with `--for 5s`"));
        }
        self.ros.any().await?;
        let learning = self.ros.learn();
        self.ros.wishes_changed();
        tokio::select! {
            () = tokio::time::sleep(Duration::from_millis(milliseconds)) => {}
            () = self.parts.life.stopped() => {}
        }
        let view = self.policy_view(profile, true).await;
        drop(learning);
        self.ros.wishes_changed();
        view
    }

    pub async fn policy_view(&self, profile: &ProfileName, learned: bool) -> Result<PolicyView, Failure> {
        let rules = &self.parts.config.topic_rules;
        let row = |row: crate::service::reply::TopicRow| PolicyRow {
            rule: rules.of(&row.topic).map(|rule| TopicRule::clone(rule)),
            left_out: row.left_out,
            largest: self.recorder.meter().largest(&row.topic),
            hz: row.hz,
            bytes_per_second: row.bytes_per_second,
            watched: row.watched,
            type_name: row.type_name,
            topic: row.topic,
        };
        let topics: Vec<PolicyRow> = self.topics(profile).await?.into_iter().map(row).collect();
        let followed = |rule: &TopicRule| topics.iter().any(|row| row.rule.as_ref() == Some(rule));
        let idle = rules.0.iter().filter(|rule| !followed(rule)).map(|rule| TopicRule::clone(rule)).collect();
        Ok(PolicyView { topics, idle, learned })
    }
}

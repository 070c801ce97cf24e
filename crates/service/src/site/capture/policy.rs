//! Rules for topics: which rule applies to which topic, and the topics' rates, so that rules can be drafted.

use super::Capture;
use std::time::Duration;

use crate::model::{ProfileName, TopicRule};
use crate::service::command::PolicyCommand;
use crate::service::failure::input;
use crate::service::reply::{Failure, PolicyRow, PolicyView};

/// The longest look at the graph.
const LONGEST: u64 = 600_000;

impl Capture {
    /// Answers a command about rules.
    pub async fn policy(&self, profile: &ProfileName, command: PolicyCommand) -> Result<PolicyView, Failure> {
        match command {
            PolicyCommand::Show => self.policy_view(profile, false).await,
            PolicyCommand::Learn { milliseconds } => {
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
        }
    }

    async fn policy_view(&self, profile: &ProfileName, learned: bool) -> Result<PolicyView, Failure> {
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

//! Alerts, judged by the figures: each problem is delivered when it begins and when it ends.

mod queue;
mod rules;
#[cfg(test)]
pub(crate) mod troubles;
mod webhook;

use std::sync::Arc;

use serde::{Deserialize, Serialize};

pub use self::queue::{Change, Queue, Standing};
pub use self::rules::{Judge, RULES, rule_of};
use self::webhook::Webhook;
use crate::config::AlertPlace;
use crate::model::{Timestamp, clean};
use crate::service::failure::internal;
use crate::service::reply::{AlertView, Failure, Result};

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum News {
    Begun,
    Resolved,
    Test,
}

/// Sent at least once.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Delivery {
    /// Rises within a home: the same number is the same delivery.
    pub number: u64,
    pub state: News,
    pub alert: AlertView,
    pub ended: Option<Timestamp>,
}

#[derive(Serialize)]
struct Told<'a> {
    authros_alert: u8,
    #[serde(flatten)]
    delivery: &'a Delivery,
    dropped: u64,
}

impl Delivery {
    /// `dropped` = earlier deliveries for which there was no room.
    fn body(&self, dropped: u64) -> Vec<u8> {
        serde_json::to_vec(&Told { authros_alert: 1, delivery: self, dropped }).unwrap_or_default()
    }
}

pub enum Carrier {
    Webhook(Webhook),
    Command(Vec<String>),
}

#[derive(Debug)]
pub struct Undelivered {
    pub failure: Failure,
    /// The answer concerns this delivery: a retry gets the same.
    pub is_judged: bool,
}

impl From<Failure> for Undelivered {
    fn from(failure: Failure) -> Self {
        Self { failure, is_judged: false }
    }
}

struct Waiting(Arc<webhook::Wanted>);

impl Drop for Waiting {
    fn drop(&mut self) {
        self.0.end();
    }
}

impl Carrier {
    pub fn of(place: &AlertPlace) -> Result<Self> {
        Ok(match place {
            AlertPlace::Webhook { url, form, secret, roots } => {
                Self::Webhook(Webhook::new(url, *form, secret.as_deref(), roots.as_deref())?)
            }
            AlertPlace::Command(words) => Self::Command(words.clone()),
        })
    }

    pub async fn carry(&self, delivery: &Delivery, dropped: u64) -> Result<String, Undelivered> {
        let words = match self {
            Self::Webhook(webhook) => return webhook.carry(delivery, dropped).await,
            Self::Command(words) => words.clone(),
        };
        let (body, wanted) = (delivery.body(dropped), Arc::new(webhook::Wanted::default()));
        let _waiting = Waiting(Arc::clone(&wanted));
        let run = move || webhook::run(&words, &body, webhook::COMMAND_PATIENCE, &wanted);
        let ran = tokio::task::spawn_blocking(run).await;
        Ok(ran.unwrap_or_else(|_| Err(internal("the task that runs alerts.command failed; retrying")))?)
    }
}

/// Omits a URL's passwords and paths.
pub fn place_name(place: &AlertPlace) -> String {
    match place {
        AlertPlace::Webhook { url, .. } => {
            let rest = url.split_once("://").map_or(url.as_str(), |(_, rest)| rest);
            let host = rest.split(['/', '?', '#']).next().unwrap_or_default();
            format!("webhook {}", clean(host.rsplit('@').next().unwrap_or(host), 100))
        }
        AlertPlace::Command(words) => format!("command {}", clean(words.first().map_or("", String::as_str), 100)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::AlertForm;

    #[test]
    fn a_place_is_named_without_what_is_secret_in_it() {
        let url = "http://me:word@host:8080/hook/T0K3N?key=1".to_owned();
        let place = AlertPlace::Webhook { url, form: AlertForm::Authros, secret: None, roots: None };
        assert_eq!(place_name(&place), "webhook host:8080");
    }

    #[test]
    fn the_form_of_a_delivery_is_the_documented_one() {
        let told: serde_json::Value = serde_json::from_slice(&queue::state_tests::delivery(7).body(2)).expect("JSON");
        let wanted = serde_json::json!({
            "authros_alert": 1, "number": 7, "state": "begun", "ended": null, "dropped": 2,
            "alert": {"key": "disk", "severity": "critical", "text": "t", "site": "0a0b0c0d",
                      "begun": "2023-11-14T22:13:20Z"},
        });
        assert_eq!(told, wanted);
    }
}

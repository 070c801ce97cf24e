//! Deliveries over HTTP: JSON with a signature over time and body, or in Alertmanager's format.

use std::path::Path;
use std::time::Duration;

use hmac::{Hmac, KeyInit as _, Mac as _};
use serde_json::json;
use sha2::Sha256;
use zeroize::Zeroizing;

use super::{Delivery, News, Undelivered};
use crate::chain::web;
use crate::config::AlertForm;
use crate::crypto::private_file;
use crate::model::{ErrorKind, Timestamp, clean};
use crate::service::failure::{input, refused};
use crate::service::reply::Failure;

/// How long a delivery may take from connecting to the answer.
const PATIENCE: Duration = Duration::from_secs(10);
/// The most bytes of an answer that are read.
const MOST_READ: usize = 512;
/// Answers about the delivery itself, not about the address or the moment: it is malformed, too large, not to be processed.
const JUDGED: [u16; 3] = [400, 413, 422];
/// The longest secret file, bytes.
const LONGEST_SECRET: usize = 4096;

/// A server that accepts deliveries.
pub struct Webhook {
    client: reqwest::Client,
    url: reqwest::Url,
    form: AlertForm,
    secret: Option<Zeroizing<Vec<u8>>>,
}

impl Webhook {
    /// At this URL; `secret` is the file with the signing secret.
    ///
    /// # Errors
    /// A URL or a secret that cannot be used.
    pub fn new(url: &str, form: AlertForm, secret: Option<&Path>, roots: Option<&Path>) -> Result<Self, Failure> {
        let unusable = || input("alerts.webhook is not a server address; use http:// or https://HOST:PORT/PATH");
        let mut url = reqwest::Url::parse(url).map_err(|_| unusable())?;
        if form == AlertForm::Alertmanager && !url.path().ends_with("/api/v2/alerts") {
            url.path_segments_mut().map_err(|()| unusable())?.pop_if_empty().extend(["api", "v2", "alerts"]);
        }
        // Redirects are not followed: only the named server gets the alert.
        let client = reqwest::Client::builder().no_proxy().redirect(reqwest::redirect::Policy::none());
        let client = if url.scheme() == "https" {
            let tls = web::tls(roots).map_err(|why| input(format!("{why}; check alerts.roots")))?;
            client.use_preconfigured_tls(tls)
        } else {
            client.tls_built_in_root_certs(false)
        };
        let client = client.timeout(PATIENCE).build().map_err(|_| unusable())?;
        let read = |path| private_file::read_private(path, LONGEST_SECRET);
        let secret = secret.map(read).transpose()?.map(|bytes| Zeroizing::new(bytes.trim_ascii().to_vec()));
        Ok(Self { client, url, form, secret })
    }

    /// Delivers, and returns the reply.
    ///
    /// # Errors
    /// Kind `Unreachable` if nothing answered, `Refused` if the answer is not a success.
    pub async fn carry(&self, delivery: &Delivery, dropped: u64) -> Result<String, Undelivered> {
        let body = match self.form {
            AlertForm::Authros => delivery.body(dropped),
            AlertForm::Alertmanager => alertmanager(delivery, dropped),
        };
        let time = Timestamp::now().seconds().to_string();
        let mut request = self.client.post(self.url.clone()).header("Content-Type", "application/json");
        if let Some(secret) = &self.secret {
            request = request.header("X-AuthROS-Signature", signature(secret, &time, &body));
        }
        let sent = request.header("X-AuthROS-Time", time).body(body).send().await;
        let answer = sent.map_err(|error| self.unreachable(&error))?;
        let status = answer.status();
        let place = redirect(&self.url, &answer);
        let text = beginning(answer).await;
        let told = format!("{}{}{text}", status.as_u16(), if text.is_empty() { "" } else { ": " });
        if status.is_success() {
            return Ok(told);
        }
        let host = self.host();
        let failure = refused(match (place, status.as_u16()) {
            (Some(place), code) => format!(
                "the webhook at {host} answered {code} and points at {place}, which is not followed; set alerts.webhook \
                 to that address"
            ),
            (None, 401) => {
                format!("the webhook at {host} wants a user name and password ({told}); check alerts.webhook")
            }
            (None, 404) => format!("the webhook at {host} has nothing at this path ({told}); check alerts.webhook"),
            (None, 413) => format!("the webhook at {host} finds the delivery too large ({told}); raise its limit"),
            (None, 429) => {
                format!(
                    "the webhook at {host} limits how often it accepts alerts ({told}); this one is sent again later"
                )
            }
            (None, 502..=504) => {
                format!("the server at {host} does not reach its webhook ({told}); check that it is running")
            }
            (None, _) => format!("the webhook at {host} answered {told}; check its log and alerts.secret"),
        });
        Err(Undelivered { failure, is_judged: JUDGED.contains(&status.as_u16()) })
    }

    fn host(&self) -> String {
        let port = self.url.port_or_known_default().unwrap_or(80);
        clean(&format!("{}:{port}", self.url.host_str().unwrap_or_default()), 100)
    }

    fn unreachable(&self, error: &reqwest::Error) -> Failure {
        let host = self.host();
        let why = if error.is_timeout() { "no answer within 10 s".to_owned() } else { web::innermost(error) };
        let text = match web::tls_fault(error, "alerts.roots") {
            Some(fault) => format!("the webhook at {host} {}; {}", fault.reason, fault.advice),
            None => {
                format!("the webhook at {host} cannot be reached: {why}; check that it is running, and alerts.webhook")
            }
        };
        Failure::new(ErrorKind::Unreachable, text)
    }
}

/// The place that a redirect names.
fn redirect(asked: &reqwest::Url, answer: &reqwest::Response) -> Option<String> {
    let location = answer.headers().get(reqwest::header::LOCATION).and_then(|place| place.to_str().ok());
    let is_redirect = matches!(answer.status().as_u16(), 301..=303 | 307 | 308);
    is_redirect.then(|| web::redirected(asked, location))
}

/// The beginning of an answer, for people; a server cannot hold us up with a long one.
async fn beginning(mut answer: reqwest::Response) -> String {
    let mut bytes = Vec::new();
    while bytes.len() < MOST_READ {
        let Ok(Some(chunk)) = answer.chunk().await else { break };
        bytes.extend(chunk.iter().take(MOST_READ - bytes.len()));
    }
    clean(String::from_utf8_lossy(&bytes).trim(), 200)
}

/// HMAC-SHA256 over time, a dot and the body.
fn signature(secret: &[u8], time: &str, body: &[u8]) -> String {
    // HMAC takes keys of any length.
    let Ok(mut mac) = Hmac::<Sha256>::new_from_slice(secret) else { return String::new() };
    for part in [time.as_bytes(), b".", body] {
        mac.update(part);
    }
    let digest = mac.finalize().into_bytes();
    format!("sha256={}", digest.iter().map(|byte| format!("{byte:02x}")).collect::<String>())
}

/// The body of `POST /api/v2/alerts`: no end means that the alert is active.
fn alertmanager(delivery: &Delivery, dropped: u64) -> Vec<u8> {
    let alert = &delivery.alert;
    let (rule, subject) = alert.key.split_once('/').unwrap_or((&alert.key, ""));
    let mut one = json!({
        "labels": {
            "alertname": format!("authros_{rule}"),
            "severity": alert.severity.word(),
            "site": alert.site,
            "subject": subject,
        },
        "annotations": { "summary": alert.text, "dropped": dropped.to_string() },
        "startsAt": alert.begun,
    });
    // A test alert ends at once. None may end before it began, as it seems where the clock was set back.
    let ended = delivery.ended.map(|ended| ended.max(alert.begun));
    let ended = ended.or((delivery.state == News::Test).then_some(alert.begun));
    if let (Some(ended), Some(fields)) = (ended, one.as_object_mut()) {
        fields.insert("endsAt".to_owned(), json!(ended));
    }
    serde_json::to_vec(&[one]).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::alerts::state::tests::delivery;

    #[test]
    fn the_signature_is_that_of_another_implementation() {
        // python3: hmac.new(b"0123456789abcdef", b'1700000000.{"authros_alert":1}', hashlib.sha256).hexdigest()
        let known = "sha256=af11d0bb506d61e26dadb13cb37e9e3551f8fcb448ec9035a3c870180046e24d";
        assert_eq!(signature(b"0123456789abcdef", "1700000000", br#"{"authros_alert":1}"#), known);
    }

    #[test]
    fn an_alertmanager_is_told_by_labels_that_stay_the_same_from_begin_to_end() {
        let told = |delivery: &Delivery| -> serde_json::Value {
            serde_json::from_slice(&alertmanager(delivery, 0)).expect("JSON")
        };
        let begun = told(&delivery(1));
        let ended = Some(Timestamp::from_seconds(1_700_000_060));
        let over = told(&Delivery { state: News::Resolved, ended, ..delivery(2) });
        let labels = json!({"alertname": "authros_disk", "severity": "critical", "site": "0a0b0c0d", "subject": ""});
        assert_eq!((&begun[0]["labels"], &over[0]["labels"]), (&labels, &labels));
        assert_eq!((&begun[0]["startsAt"], &begun[0]["endsAt"]), (&json!("2023-11-14T22:13:20Z"), &json!(null)));
        assert_eq!(over[0]["endsAt"], "2023-11-14T22:14:20Z");
    }

    #[test]
    fn an_alertmanager_is_never_told_of_an_end_before_the_beginning() {
        let set_back = Some(Timestamp::from_seconds(1_600_000_000));
        let over = Delivery { state: News::Resolved, ended: set_back, ..delivery(2) };
        let told: serde_json::Value = serde_json::from_slice(&alertmanager(&over, 0)).expect("JSON");
        assert_eq!((&told[0]["startsAt"], &told[0]["endsAt"]), (&json!("2023-11-14T22:13:20Z"), &told[0]["startsAt"]));
    }

    #[test]
    fn the_address_of_an_alertmanager_is_its_own_or_that_of_its_interface() {
        let address = |url: &str, form| Webhook::new(url, form, None, None).expect("usable").url.to_string();
        for url in ["http://h:9093", "http://h:9093/", "http://h:9093/api/v2/alerts"] {
            assert_eq!(address(url, AlertForm::Alertmanager), "http://h:9093/api/v2/alerts");
        }
        assert_eq!(address("http://h:1/a?b=c", AlertForm::Authros), "http://h:1/a?b=c");
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_refusal_is_named_and_a_redirect_says_where_to() {
        use std::io::{Read as _, Write as _};
        for (lines, said) in [
            (
                "307 Temporary Redirect\r\nLocation: https://new.example/T0K3N",
                ["https://new.example/…", "answered 307"],
            ),
            ("308 Permanent Redirect\r\nLocation: /hook/", ["a slash at its end", "alerts.webhook"]),
            ("401 Unauthorized", ["user name and password", "401"]),
            ("404 Not Found", ["nothing at this path", "404"]),
            ("429 Too Many Requests", ["how often", "429"]),
            ("502 Bad Gateway", ["does not reach its webhook", "502"]),
            ("500 Internal Server Error", ["answered 500", "alerts.secret"]),
        ] {
            let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("binds");
            let port = listener.local_addr().expect("an address").port();
            let server = std::thread::spawn(move || {
                let (mut stream, _) = listener.accept().expect("a delivery");
                drop(stream.read(&mut [0; 4096]));
                drop(stream.write_all(format!("HTTP/1.1 {lines}\r\nContent-Length: 0\r\n\r\n").as_bytes()));
                drop(stream.read(&mut [0; 4096]));
            });
            let webhook = Webhook::new(&format!("http://127.0.0.1:{port}/hook"), AlertForm::Authros, None, None);
            let refused = webhook.expect("usable").carry(&delivery(1), 0).await.expect_err("refused");
            let text = refused.failure.message;
            assert!(said.iter().all(|part| text.contains(part)) && !text.contains("T0K3N"), "{lines}: {text}");
            server.join().expect("ends");
        }
    }
}

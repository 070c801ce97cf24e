//! Deliveries over HTTP: JSON with a signature over time and body, or in Alertmanager's format.

use std::path::{Path, PathBuf};
use std::time::Duration;

use hmac::{Hmac, KeyInit as _, Mac as _};
use reqwest_tls as reqwest;
use serde_json::json;
use sha2::Sha256;
use zeroize::Zeroizing;

use super::{Delivery, News, Undelivered};
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
/// Where distributions keep their trusted authorities.
const TRUSTED: [&str; 3] =
    ["/etc/ssl/certs/ca-certificates.crt", "/etc/pki/tls/certs/ca-bundle.crt", "/etc/ssl/cert.pem"];
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
        let client = client.tls_built_in_root_certs(false);
        let trusted = if url.scheme() == "https" { authorities(roots, "check alerts.roots")? } else { Vec::new() };
        let client = trusted.into_iter().fold(client, reqwest::ClientBuilder::add_root_certificate);
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
        let advice = advice(status, answer.headers().get(reqwest::header::LOCATION));
        let text = beginning(answer).await;
        let told = format!("{}{}{text}", status.as_u16(), if text.is_empty() { "" } else { ": " });
        if status.is_success() {
            return Ok(told);
        }
        let failure = refused(format!("the webhook at {} answered {told}; {advice}", self.host()));
        Err(Undelivered { failure, is_judged: JUDGED.contains(&status.as_u16()) })
    }

    fn host(&self) -> String {
        let port = self.url.port_or_known_default().unwrap_or(80);
        clean(&format!("{}:{port}", self.url.host_str().unwrap_or_default()), 100)
    }

    fn unreachable(&self, error: &reqwest::Error) -> Failure {
        let why = if error.is_timeout() { "no answer within 10 s".to_owned() } else { innermost(error) };
        let (host, help) = (self.host(), "check that it is running, and alerts.webhook");
        Failure::new(ErrorKind::Unreachable, format!("the webhook at {host} cannot be reached: {why}; {help}"))
    }
}

/// What to do about an answer that is no success; `place` is where it sends the alert instead.
fn advice(status: reqwest::StatusCode, place: Option<&reqwest::header::HeaderValue>) -> String {
    // Of the place only the host: what follows may be a secret.
    let host = place.and_then(|place| reqwest::Url::parse(place.to_str().ok()?).ok());
    let host = host.and_then(|url| url.host_str().map(|host| clean(host, 100)));
    match (status.as_u16(), host) {
        (300..=399, Some(host)) => {
            format!("it names another place at {host}, which is not followed; set alerts.webhook to it if it is right")
        }
        (300..=399, None) => "it names another place, which is not followed; correct alerts.webhook".to_owned(),
        (401 | 403, _) => "check alerts.secret".to_owned(),
        (404 | 405 | 410, _) => "check the path of alerts.webhook".to_owned(),
        (429, _) => "it accepts no more for now; the alert is sent again".to_owned(),
        _ => "check its log and alerts.secret".to_owned(),
    }
}

/// The authorities that this machine trusts.
pub(crate) fn trusted() -> Result<Vec<reqwest::Certificate>, Failure> {
    authorities(None, "check this machine's ca-certificates")
}

/// The trusted authorities: those in a file, or else those that this machine trusts.
fn authorities(file: Option<&Path>, help: &str) -> Result<Vec<reqwest::Certificate>, Failure> {
    let named = std::env::var_os("SSL_CERT_FILE").map(PathBuf::from);
    let of_machine = || named.or_else(|| TRUSTED.iter().map(PathBuf::from).find(|path| path.is_file()));
    let path = file.map(Path::to_owned).or_else(of_machine).ok_or_else(|| {
        input(format!("this machine has no certificate authorities for https; install ca-certificates; {help}"))
    })?;
    let shown = clean(&path.display().to_string(), 200);
    let unusable = |why: String| input(format!("{shown} cannot be used for https: {why}; {help}"));
    let bytes = std::fs::read(&path).map_err(|error| unusable(error.to_string()))?;
    let found = reqwest::Certificate::from_pem_bundle(&bytes).map_err(|error| unusable(innermost(&error)))?;
    if found.is_empty() { Err(unusable("it contains no PEM certificate".to_owned())) } else { Ok(found) }
}

/// The root cause; it does not contain the URL.
pub(crate) fn innermost(error: &dyn std::error::Error) -> String {
    let mut cause = error;
    while let Some(deeper) = cause.source() {
        cause = deeper;
    }
    clean(&cause.to_string(), 160)
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
    fn each_answer_has_advice_of_its_own() {
        let of = |status: u16, place: Option<&str>| {
            let place = place.map(|place| place.parse().expect("a header"));
            advice(reqwest::StatusCode::from_u16(status).expect("a status"), place.as_ref())
        };
        let moved = of(307, Some("https://other.example.org/hook/SECRET"));
        assert!(moved.contains("other.example.org") && !moved.contains("SECRET"), "{moved}");
        assert!(of(307, Some("/there")).contains("not followed") && of(302, None).contains("not followed"));
        assert!(of(404, None).contains("path") && of(429, None).contains("again") && of(401, None).contains("secret"));
        assert!(of(500, None).contains("log"));
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
}

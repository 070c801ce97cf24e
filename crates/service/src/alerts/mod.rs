//! Alerts, judged by the figures: each problem is delivered when it begins and when it ends.

mod command;
mod rules;
#[cfg(test)]
pub(crate) mod troubles;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fs::File;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

use hmac::{Hmac, KeyInit as _, Mac as _};
use serde::{Deserialize, Serialize};
use serde_json::json;
use sha2::Sha256;
use zeroize::Zeroizing;

pub use self::rules::{Judge, RULES, rule_of};

use self::rules::{Judged, Level};
use crate::config::{AlertForm, AlertPlace};
use crate::crypto::private_file;
use crate::model::{ErrorKind, Timestamp, clean, hex};
use crate::reply::{AlertView, Failure, Result, input, refused};
use crate::store::files::atomic_write;

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

pub enum Carrier {
    Webhook(Webhook),
    Command(Vec<String>),
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

    pub async fn carry(self, delivery: &Delivery, dropped: u64) -> Result<String, Undelivered> {
        match self {
            Self::Webhook(webhook) => webhook.carry(delivery, dropped).await,
            Self::Command(words) => Ok(command::carry(words, delivery.body(dropped)).await?),
        }
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

const PATIENCE: Duration = Duration::from_secs(10);
const MOST_READ: usize = 512;
/// Malformed, too large, unprocessable: about the delivery, not the address or the moment.
const JUDGED: [u16; 3] = [400, 413, 422];
const LONGEST_SECRET: usize = 4096;

pub struct Webhook {
    client: reqwest::Client,
    url: reqwest::Url,
    form: AlertForm,
    secret: Option<Zeroizing<Vec<u8>>>,
}

impl Webhook {
    fn new(url: &str, form: AlertForm, secret: Option<&Path>, roots: Option<&Path>) -> Result<Self> {
        let unusable = || input("alerts.webhook is not a server address; use http:// or https://HOST:PORT/PATH");
        let mut url = reqwest::Url::parse(url).map_err(|_| unusable())?;
        if form == AlertForm::Alertmanager && !url.path().ends_with("/api/v2/alerts") {
            url.path_segments_mut().map_err(|()| unusable())?.pop_if_empty().extend(["api", "v2", "alerts"]);
        }
        // No redirects: only the named server gets the alert.
        let client = reqwest::Client::builder().no_proxy().redirect(reqwest::redirect::Policy::none());
        let client = if url.scheme() == "https" {
            let tls = authros_tls::tls(roots).map_err(|why| input(format!("{why}; check alerts.roots")))?;
            client.use_preconfigured_tls(tls)
        } else {
            client.tls_built_in_root_certs(false)
        };
        let client = client.timeout(PATIENCE).build().map_err(|_| unusable())?;
        let read = |path| private_file::read_private(path, LONGEST_SECRET);
        let secret = secret.map(read).transpose()?.map(|bytes| Zeroizing::new(bytes.trim_ascii().to_vec()));
        Ok(Self { client, url, form, secret })
    }

    async fn carry(&self, delivery: &Delivery, dropped: u64) -> Result<String, Undelivered> {
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
        let at = |who: &str, what: &str, advice: &str| format!("the {who} at {host} {what} ({told}); {advice}");
        let failure = refused(match (place, status.as_u16()) {
            (Some(place), code) => format!(
                "the webhook at {host} answered {code} and redirects to {place}, which is not followed; set \
                 alerts.webhook to that address"
            ),
            (None, 401) => at("webhook", "requires a user name and password", "check alerts.webhook"),
            (None, 404) => at("webhook", "serves nothing at this path", "check alerts.webhook"),
            (None, 413) => at("webhook", "rejects the delivery as too large", "raise its limit"),
            (None, 429) => at("webhook", "limits the rate of alerts", "this one is sent again later"),
            (None, 502..=504) => at("server", "does not reach its webhook", "check that it is running"),
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
        let why = if error.is_timeout() { "no answer within 10 s".to_owned() } else { authros_tls::innermost(error) };
        let text = match authros_tls::tls_fault(error, "alerts.roots") {
            Some(fault) => format!("the webhook at {host} {}; {}", fault.reason, fault.advice),
            None => {
                format!("the webhook at {host} cannot be reached: {why}; check that it is running, and alerts.webhook")
            }
        };
        Failure::new(ErrorKind::Unreachable, text)
    }
}

fn redirect(asked: &reqwest::Url, answer: &reqwest::Response) -> Option<String> {
    let location = answer.headers().get(reqwest::header::LOCATION).and_then(|place| place.to_str().ok());
    let is_redirect = matches!(answer.status().as_u16(), 301..=303 | 307 | 308);
    is_redirect.then(|| authros_tls::redirected(asked, location))
}

/// Bounded: a long answer must not block.
async fn beginning(mut answer: reqwest::Response) -> String {
    let mut bytes = Vec::new();
    while bytes.len() < MOST_READ {
        let Ok(Some(chunk)) = answer.chunk().await else { break };
        bytes.extend(chunk.iter().take(MOST_READ - bytes.len()));
    }
    clean(String::from_utf8_lossy(&bytes).trim(), 200)
}

fn signature(secret: &[u8], time: &str, body: &[u8]) -> String {
    // HMAC takes keys of any length.
    let Ok(mut mac) = Hmac::<Sha256>::new_from_slice(secret) else { return String::new() };
    for part in [time.as_bytes(), b".", body] {
        mac.update(part);
    }
    format!("sha256={}", hex(&mac.finalize().into_bytes()))
}

/// Alertmanager's `POST /api/v2/alerts`: no end = active.
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
    // A test ends when it begins. A clock set back must not end an alert before its beginning.
    let ended = delivery.ended.map(|ended| ended.max(alert.begun));
    let ended = ended.or((delivery.state == News::Test).then_some(alert.begun));
    if let (Some(ended), Some(fields)) = (ended, one.as_object_mut()) {
        fields.insert("endsAt".to_owned(), json!(ended));
    }
    serde_json::to_vec(&[one]).unwrap_or_default()
}

/// Beyond this the oldest are dropped and counted.
const MOST_WAITING: usize = 200;
/// Bytes, many times what the limit above needs.
const LONGEST: u64 = 16 << 20;

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Kept {
    numbered: u64,
    standing: BTreeMap<String, AlertView>,
    waiting: VecDeque<Delivery>,
    dropped: u64,
}

impl Kept {
    fn read(path: &Path) -> io::Result<Self> {
        let file = match File::open(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Self::default()),
            opened => opened?,
        };
        let mut bytes = Vec::new();
        if file.take(LONGEST + 1).read_to_end(&mut bytes)? as u64 > LONGEST {
            return Err(io::ErrorKind::FileTooLarge.into());
        }
        Ok(serde_json::from_slice(&bytes)?)
    }
}

/// Renames a file that cannot be read, so that the next change does not write over it, and says so.
fn set_aside(path: &Path, error: &io::Error, now: Timestamp) -> String {
    let (aside, why) =
        (path.with_extension(format!("queue.unreadable-{}", now.seconds())), clean(&error.to_string(), 100));
    let renamed = std::fs::rename(path, &aside);
    let (path, place) = (path.display(), aside.display());
    match renamed {
        Ok(()) => format!(
            "look into {place} for alerts that waited, and check the disk: {path} could not be read ({why}), so they are \
             not sent"
        ),
        Err(error) => format!(
            "move {path} away and look into it for alerts that waited: it can be neither read ({why}) nor renamed ({error})"
        ),
    }
}

#[derive(Debug)]
pub struct Queue {
    path: PathBuf,
    kept: Kept,
}

impl Queue {
    /// Also a text, if the file could not be read.
    pub fn open(path: &Path) -> (Self, Option<String>) {
        let (kept, lost) = match Kept::read(path) {
            Ok(kept) => (kept, None),
            Err(error) => {
                let now = Timestamp::now();
                // Above all numbers given before: a receiver drops one that it knows.
                (Kept { numbered: now.seconds(), ..Kept::default() }, Some(set_aside(path, &error, now)))
            }
        };
        (Self { path: path.to_owned(), kept }, lost)
    }

    pub fn standing(&self) -> Vec<AlertView> {
        self.kept.standing.values().cloned().collect()
    }

    pub fn counts(&self) -> (u64, u64) {
        (u64::try_from(self.kept.waiting.len()).unwrap_or(u64::MAX), self.kept.dropped)
    }

    pub fn first(&self) -> Option<(Delivery, u64)> {
        Some((self.kept.waiting.front()?.clone(), self.kept.dropped))
    }

    pub fn add(&mut self, change: Change) {
        match change {
            Change::Begun(alert) => {
                self.kept.standing.insert(alert.key.clone(), alert.clone());
                self.wait(News::Begun, alert, None);
            }
            Change::Resolved(alert, at) => {
                self.kept.standing.remove(&alert.key);
                self.wait(News::Resolved, alert, Some(at));
            }
        }
        self.save();
    }

    /// For a destination that forgets alerts unless reminded.
    pub fn remind(&mut self) {
        for alert in self.standing() {
            self.wait(News::Begun, alert, None);
        }
        self.save();
    }

    pub fn next_number(&mut self) -> u64 {
        self.kept.numbered += 1;
        self.save();
        self.kept.numbered
    }

    fn wait(&mut self, state: News, alert: AlertView, ended: Option<Timestamp>) {
        // The first may be in flight.
        if self.kept.waiting.len() >= MOST_WAITING && self.kept.waiting.remove(1).is_some() {
            self.kept.dropped += 1;
        }
        self.kept.numbered += 1;
        self.kept.waiting.push_back(Delivery { number: self.kept.numbered, state, alert, ended });
    }

    pub fn done(&mut self, number: u64, told: u64) {
        self.kept.waiting.retain(|delivery| delivery.number != number);
        self.kept.dropped = self.kept.dropped.saturating_sub(told);
        self.save();
    }

    pub fn give_up(&mut self) -> Option<String> {
        let first = self.kept.waiting.pop_front()?;
        self.kept.dropped += 1;
        self.save();
        Some(first.alert.key)
    }

    /// On a failed write, delivery continues; the next change writes all of it.
    fn save(&self) {
        drop(atomic_write(&self.path, &serde_json::to_vec(&self.kept).unwrap_or_default()));
    }
}

/// Quiet looks before an alert ends.
const CALM_LOOKS: u8 = 2;

#[derive(Debug, Default)]
pub struct Standing {
    alerts: BTreeMap<String, Stands>,
}

#[derive(Debug)]
struct Stands {
    alert: AlertView,
    calm: u8,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Change {
    Begun(AlertView),
    Resolved(AlertView, Timestamp),
}

impl Standing {
    pub fn of(alerts: impl IntoIterator<Item = AlertView>) -> Self {
        let stands = |alert: AlertView| (alert.key.clone(), Stands { alert, calm: 0 });
        Self { alerts: alerts.into_iter().map(stands).collect() }
    }

    pub fn all(&self) -> Vec<AlertView> {
        self.alerts.values().map(|stands| stands.alert.clone()).collect()
    }

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
        let told: serde_json::Value = serde_json::from_slice(&state_tests::delivery(7).body(2)).expect("JSON");
        let wanted = serde_json::json!({
            "authros_alert": 1, "number": 7, "state": "begun", "ended": null, "dropped": 2,
            "alert": {"key": "disk", "severity": "critical", "text": "t", "site": "0a0b0c0d",
                      "begun": "2023-11-14T22:13:20Z"},
        });
        assert_eq!(told, wanted);
    }
}

#[cfg(test)]
mod webhook_tests {
    use super::state_tests::delivery;
    use super::*;

    fn at(url: &str, form: AlertForm) -> Webhook {
        Webhook::new(url, form, None, None).expect("usable")
    }

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
        let address = |url: &str, form| at(url, form).url.to_string();
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
            ("429 Too Many Requests", ["limits the rate", "429"]),
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
            let webhook = at(&format!("http://127.0.0.1:{port}/hook"), AlertForm::Authros);
            let refused = webhook.carry(&delivery(1), 0).await.expect_err("refused");
            // Its connection ends, which the server waits for.
            drop(webhook);
            let text = refused.failure.message;
            assert!(said.iter().all(|part| text.contains(part)) && !text.contains("T0K3N"), "{lines}: {text}");
            server.join().expect("ends");
        }
    }
}

#[cfg(test)]
mod queue_tests {
    use std::os::unix::fs::PermissionsExt as _;

    use super::state_tests::alert;
    use super::*;

    fn at(second: u64) -> Timestamp {
        Timestamp::from_seconds(1_700_000_000 + second)
    }

    fn file() -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("alerts.queue");
        (folder, path)
    }

    fn opened(path: &Path) -> Queue {
        let (queue, lost) = Queue::open(path);
        assert_eq!(lost, None);
        queue
    }

    #[test]
    fn a_test_takes_a_number_that_no_delivery_gets_again() {
        let (_folder, path) = file();
        let mut queue = opened(&path);
        assert_eq!((queue.next_number(), queue.next_number()), (1, 2));
        let mut queue = opened(&path);
        queue.add(Change::Begun(alert("disk")));
        assert_eq!(queue.first().map(|(delivery, _)| delivery.number), Some(3));
    }

    #[test]
    fn each_change_is_in_the_file_at_once() {
        let (_folder, path) = file();
        let mut queue = opened(&path);
        let mut step = |work: &dyn Fn(&mut Queue)| {
            work(&mut queue);
            assert_eq!(opened(&path).kept, queue.kept);
        };
        step(&|queue| queue.add(Change::Begun(alert("disk"))));
        step(&|queue| queue.add(Change::Begun(alert("store"))));
        step(&|queue| queue.done(1, 0));
        step(&|queue| queue.add(Change::Resolved(alert("disk"), at(9))));
        step(&|queue| assert_eq!(queue.give_up().as_deref(), Some("store")));
        step(&|queue| queue.done(3, 1));
        step(&Queue::remind);
        assert_eq!(std::fs::metadata(&path).expect("it").permissions().mode() & 0o777, 0o600);
        assert_eq!((queue.standing(), queue.counts()), (vec![alert("store")], (1, 0)));
    }

    #[test]
    fn a_file_that_cannot_be_read_is_told_of_and_kept_and_no_number_is_given_again() {
        let (folder, path) = file();
        opened(&path).add(Change::Begun(alert("disk")));
        let whole = std::fs::read(&path).expect("the file");
        let cut = (0..whole.len()).step_by(9).map(|cut| whole[..cut].to_vec());
        let newer = [&br#"{"newer":1,"#[..], &whole[1..]].concat();
        let foreign = [b"{}".to_vec(), vec![0xff; 9], [&b"["[..], &whole, b"]"].concat(), newer];
        for bytes in cut.chain(foreign) {
            std::fs::write(&path, &bytes).expect("written");
            let (mut queue, lost) = Queue::open(&path);
            let lost = lost.expect("it is told");
            let files = std::fs::read_dir(folder.path()).expect("read").map(|entry| entry.expect("one").path());
            let files: Vec<PathBuf> = files.collect();
            assert_eq!(files.len(), 1, "only the one set aside is there: {files:?}");
            assert!(lost.starts_with(&format!("look into {} for", files[0].display())), "{lost}");
            assert_eq!(std::fs::read(&files[0]).expect("read"), bytes);
            queue.add(Change::Begun(alert("clock")));
            assert!(queue.first().is_some_and(|(first, _)| first.number > 1_700_000_000));
            assert_eq!(opened(&path).kept, queue.kept);
            std::fs::remove_file(&files[0]).expect("removed");
        }
    }

    #[test]
    fn what_is_no_file_or_too_long_is_set_aside_as_well() {
        let (_folder, path) = file();
        std::fs::create_dir(&path).expect("made");
        assert!(Queue::open(&path).1.is_some() && !path.exists());
        let (_folder, path) = file();
        opened(&path).add(Change::Begun(alert("disk")));
        let mut whole = std::fs::read(&path).expect("the file");
        whole.resize(usize::try_from(LONGEST).expect("it fits"), b' ');
        std::fs::write(&path, &whole).expect("written");
        assert_eq!(opened(&path).standing(), [alert("disk")]);
        whole.push(b' ');
        std::fs::write(&path, &whole).expect("written");
        assert!(Queue::open(&path).1.is_some() && !path.exists());
    }

    #[test]
    fn it_is_bounded_and_what_was_given_up_is_told_with_the_next_that_is_taken() {
        let (_folder, path) = file();
        let mut queue = opened(&path);
        for number in 0..MOST_WAITING + 3 {
            queue.add(Change::Begun(alert(&format!("robot_silent/{number}"))));
        }
        assert_eq!(queue.counts(), (200, 3));
        let (first, dropped) = queue.first().expect("one");
        assert_eq!((first.number, dropped), (1, 3), "the first may be on its way; the oldest behind it went");
        queue.done(first.number, dropped);
        let again = opened(&path);
        assert_eq!((again.counts(), again.first().map(|(next, _)| next.number)), ((199, 0), Some(5)));
        assert_eq!(again.standing().len(), MOST_WAITING + 3, "what stands is known all the same");
    }

    #[test]
    fn what_cannot_be_written_is_delivered_all_the_same_and_written_once_it_can_be() {
        let (folder, _) = file();
        let place = folder.path().join("not there yet");
        let mut queue = opened(&place.join("alerts.queue"));
        queue.add(Change::Begun(alert("disk")));
        assert!(queue.first().is_some());
        std::fs::create_dir(&place).expect("now it is");
        queue.done(1, 0);
        assert_eq!(opened(&place.join("alerts.queue")).standing(), [alert("disk")]);
    }
}

#[cfg(test)]
pub(super) mod state_tests {
    use super::*;
    use crate::reply::Severity;

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

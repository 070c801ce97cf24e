//! Deliveries by HTTP, signed JSON or Alertmanager's format, or by a command.

use std::io::Write as _;
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use hmac::{Hmac, KeyInit as _, Mac as _};
use rustix::process::{Pid, Signal, kill_process_group};
use serde_json::json;
use sha2::Sha256;
use zeroize::Zeroizing;

use super::{Delivery, News, Undelivered};
use crate::config::AlertForm;
use crate::crypto::private_file;
use crate::failure::{input, refused};
use crate::model::{ErrorKind, Timestamp, clean};
use crate::reply::{Failure, Result};

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
    pub fn new(url: &str, form: AlertForm, secret: Option<&Path>, roots: Option<&Path>) -> Result<Self> {
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
    let digest = mac.finalize().into_bytes();
    format!("sha256={}", digest.iter().map(|byte| format!("{byte:02x}")).collect::<String>())
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

pub const COMMAND_PATIENCE: Duration = Duration::from_secs(30);
const LOOK: Duration = Duration::from_millis(20);
/// The environment variables that the command inherits.
const ENVIRONMENT: [&str; 3] = ["PATH", "HOME", "LANG"];

/// Killed by the caller that stops waiting: an ending process may leave its supervising thread no time.
#[derive(Debug, Default)]
pub struct Wanted(Mutex<State>);

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum State {
    #[default]
    Waits,
    Runs(Pid),
    Over,
}

impl Wanted {
    pub fn end(&self) {
        end(&mut self.state());
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn end(state: &mut State) {
    if let State::Runs(group) = std::mem::replace(state, State::Over) {
        // It may have ended already.
        let _ = kill_process_group(group, Signal::KILL);
    }
}

pub fn run(words: &[String], body: &[u8], patience: Duration, wanted: &Wanted) -> Result<String> {
    let Some((program, arguments)) = words.split_first() else { return Err(refused("alerts.command is empty")) };
    let shown = clean(program, 100);
    let mut command = Command::new(program);
    command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null()).env_clear();
    command.envs(ENVIRONMENT.iter().filter_map(|name| Some((name, std::env::var_os(name)?))));
    // Its own process group, so that its children end with it.
    command.process_group(0).current_dir("/");
    let mut child = begun(&mut command, wanted, &shown)?;
    // The pipe holds the whole body; a program may ignore its input.
    if let Some(mut stdin) = child.stdin.take() {
        drop(stdin.write_all(body));
    }
    match ended(&mut child, patience, wanted) {
        Some(status) if status.success() => Ok(format!("{shown} succeeded")),
        Some(status) => Err(refused(format!("{shown} failed with {status}; run it by hand with the same arguments"))),
        None => Err(refused(format!("{shown} did not finish within {} s and was killed", patience.as_secs()))),
    }
}

fn begun(command: &mut Command, wanted: &Wanted, shown: &str) -> Result<Child> {
    let mut state = wanted.state();
    if *state == State::Over {
        return Err(refused(format!("{shown} was not started: nothing is waiting for it any more")));
    }
    let child = command.spawn().map_err(|error| {
        let text = format!("{shown} cannot be started: {error}; check alerts.command");
        Failure::new(ErrorKind::Unreachable, text)
    })?;
    *state = State::Runs(Pid::from_child(&child));
    Ok(child)
}

fn ended(child: &mut Child, patience: Duration, wanted: &Wanted) -> Option<ExitStatus> {
    let begun = Instant::now();
    while begun.elapsed() < patience {
        let mut state = wanted.state();
        match child.try_wait() {
            Ok(Some(status)) => {
                // Another process may reuse its number.
                let killed = std::mem::replace(&mut *state, State::Over) == State::Over;
                return Some(status).filter(|_| !killed);
            }
            Ok(None) => {}
            Err(_) => break,
        }
        drop(state);
        std::thread::sleep(LOOK);
    }
    wanted.end();
    drop(child.wait());
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alerts::queue::state_tests::delivery;

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
            let webhook = Webhook::new(&format!("http://127.0.0.1:{port}/hook"), AlertForm::Authros, None, None);
            let refused = webhook.expect("usable").carry(&delivery(1), 0).await.expect_err("refused");
            let text = refused.failure.message;
            assert!(said.iter().all(|part| text.contains(part)) && !text.contains("T0K3N"), "{lines}: {text}");
            server.join().expect("ends");
        }
    }
}

#[cfg(test)]
mod command_tests {
    use super::*;

    fn words(words: &[&str]) -> Vec<String> {
        words.iter().map(|word| (*word).to_owned()).collect()
    }

    fn ran(given: &[&str], body: &[u8], patience: Duration) -> Result<String> {
        run(&words(given), body, patience, &Wanted::default())
    }

    #[test]
    fn words_reach_the_program_as_they_are_and_the_body_its_input() {
        let folder = tempfile::tempdir().expect("a folder");
        let out = folder.path().join("a b; $HOME");
        // dd opens the file named in its arguments, and copies its input there.
        let of = format!("of={}", out.display());
        ran(&["/bin/dd", &of], br#"{"authros_alert":1}"#, COMMAND_PATIENCE).expect("it runs");
        assert_eq!(std::fs::read(&out).expect("written"), br#"{"authros_alert":1}"#);
    }

    #[test]
    fn one_that_fails_is_missing_or_never_ends_is_told_apart() {
        assert_eq!(ran(&["/bin/false"], b"", COMMAND_PATIENCE).expect_err("fails").kind, ErrorKind::Refused);
        assert_eq!(ran(&["/not/there"], b"", COMMAND_PATIENCE).expect_err("missing").kind, ErrorKind::Unreachable);
        let killed = ran(&["/bin/sleep", "1000"], b"", Duration::from_millis(200)).expect_err("killed");
        assert!(killed.message.contains("was killed"), "{killed}");
        let wanted = Wanted::default();
        wanted.end();
        assert!(
            run(&words(&["/bin/sleep", "1000"]), b"", COMMAND_PATIENCE, &wanted).is_err(),
            "nobody waits for it any more"
        );
        let wanted = std::sync::Arc::new(Wanted::default());
        let other = std::sync::Arc::clone(&wanted);
        let running = std::thread::spawn(move || run(&words(&["/bin/sleep", "1000"]), b"", COMMAND_PATIENCE, &other));
        while !matches!(*wanted.state(), State::Runs(_)) {
            std::thread::sleep(LOOK);
        }
        wanted.end();
        assert!(running.join().expect("ends").is_err(), "killed by who waited");
    }
}

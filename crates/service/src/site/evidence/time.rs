//! External time: each hour, the configured authorities stamp the roots of new batches; nothing waits for them.

#[cfg(test)]
mod tests;

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use authros_evidence::PinnedAuthority;
use authros_evidence::time::{
    Certificate, LONGEST_ANSWER, MOST_ROOTS, REQUEST_TYPE, Request, StampTree, check_token, token_of,
};
use sha2::{Digest as _, Sha256};
use tokio::task::block_in_place;

use crate::config::TimeAuthority;
use crate::crypto::random_bytes;
use crate::model::{ErrorKind, Hash, Timestamp, clean, counted, grouped, locked};
use crate::reply::{Failure, NoticeLevel, PartHealth, Result, StampView, StampedView, input, internal, refused};
use crate::site::Parts;
use crate::site::evidence::waiting_part;
use crate::store::KeptStamp;

const PATIENCE: Duration = Duration::from_secs(15);
const PERIOD: Duration = Duration::from_secs(3600);
const LOOK: Duration = Duration::from_secs(60);
/// First and longest pause after a failure.
const PAUSES: (Duration, Duration) = (LOOK, PERIOD);
const AT_ONCE: usize = 64;
const LONGEST_CERTIFICATE: u64 = 64 * 1024;
const ABOUT: &str = "time stamps";

/// The machine's clock, and one that does not jump.
#[derive(Debug, Clone, Copy)]
struct Moment {
    wall: Timestamp,
    steady: Instant,
}

impl Moment {
    fn now() -> Self {
        Self { wall: Timestamp::now(), steady: Instant::now() }
    }
}

#[derive(Default)]
struct Last {
    trouble: Option<(Timestamp, String)>,
    again: Option<Instant>,
    pause: Duration,
}

pub(in crate::site) struct TimeStamps {
    parts: Parts,
    failures: AtomicU64,
    last: Mutex<Last>,
    turn: tokio::sync::Mutex<()>,
}

impl TimeStamps {
    pub fn new(parts: &Parts) -> Self {
        let (failures, last, turn) = (AtomicU64::new(0), Mutex::default(), tokio::sync::Mutex::default());
        Self { parts: parts.clone(), failures, last, turn }
    }

    pub fn is_wanted(&self) -> bool {
        !self.parts.config.time_authorities.is_empty()
    }

    fn with<Told>(&self, work: impl FnOnce(&mut Last) -> Told) -> Told {
        work(&mut locked(&self.last))
    }

    pub async fn keep(self: Arc<Self>) {
        while self.parts.life.beat(LOOK).await {
            self.look(Moment::now()).await;
        }
    }

    async fn look(&self, now: Moment) {
        if self.with(|last| last.again.is_some_and(|again| again > now.steady)) {
            return;
        }
        let _turn = self.turn.lock().await;
        match block_in_place(|| self.begin(false, now.wall)) {
            Ok(_) => drop(self.ask_all(now).await),
            Err(failure) => self.failed(&failure, now),
        }
    }

    fn begin(&self, at_once: bool, now: Timestamp) -> Result<u64> {
        let newest = self.parts.plant.ledger.proofs.stamp_counts()?.newest;
        let due = newest.is_none_or(|newest| Duration::from_nanos(now.0.saturating_sub(newest.0)) >= PERIOD);
        if !at_once && !due {
            return Ok(0);
        }
        let mut roots = 0;
        loop {
            let more = self.parts.plant.ledger.proofs.begin_stamp(MOST_ROOTS, now)?;
            roots += more;
            if more < MOST_ROOTS as u64 {
                return Ok(roots);
            }
        }
    }

    pub async fn stamp(&self) -> Result<StampView> {
        if !self.is_wanted() {
            return Err(input("no time stamp authority is configured; set time.authorities (see docs/reader.md)"));
        }
        let _turn = self.turn.lock().await;
        let now = Moment::now();
        let roots = block_in_place(|| self.begin(true, now.wall))?;
        let (tokens, problem) = self.ask_all(now).await;
        let waiting = self.parts.plant.ledger.proofs.stamp_counts()?.waiting;
        match problem {
            Some(failure) if tokens.is_empty() => Err(failure),
            problem => Ok(StampView { roots, tokens, waiting, problem: problem.map(|failure| failure.message) }),
        }
    }

    async fn ask_all(&self, now: Moment) -> (Vec<StampedView>, Option<Failure>) {
        let (mut tokens, mut problem) = (Vec::new(), None);
        for authority in &self.parts.config.time_authorities {
            if let Err(failure) = self.ask(authority, &mut tokens).await {
                self.failed(&failure, now);
                problem.get_or_insert(failure);
            }
        }
        if problem.is_none() && self.with(|last| std::mem::take(last).trouble.is_some()) {
            self.parts.hub.notice_about(ABOUT, NoticeLevel::Info, "time stamping works again");
        }
        (tokens, problem)
    }

    fn failed(&self, failure: &Failure, now: Moment) {
        self.failures.fetch_add(1, Ordering::AcqRel);
        let is_new = self.with(|last| {
            let is_new = last.trouble.is_none();
            let since = last.trouble.as_ref().map_or(now.wall, |(since, _)| *since);
            last.trouble = Some((since, failure.message.clone()));
            last.pause = (last.pause * 2).clamp(PAUSES.0, PAUSES.1);
            last.again = Some(now.steady + last.pause);
            is_new
        });
        if is_new {
            let text = format!("batches are waiting for time stamps; retrying: {}", failure.message);
            self.parts.hub.notice_about(ABOUT, NoticeLevel::Warning, &text);
        }
    }

    async fn ask(&self, authority: &TimeAuthority, tokens: &mut Vec<StampedView>) -> Result<()> {
        let certificate = read(authority)?;
        let id = Hash(Sha256::digest(certificate.der()).into());
        let proofs = &self.parts.plant.ledger.proofs;
        let waiting = block_in_place(|| proofs.waiting_stamps(id, AT_ONCE))?;
        if waiting.is_empty() {
            return Ok(());
        }
        let client = client(authority)?;
        for KeptStamp { key, roots, .. } in waiting {
            let count = roots.len() as u64;
            let tree = StampTree::new(roots).ok_or_else(|| internal("a stamp has no roots; please report this"))?;
            let nonce = random_bytes()?;
            let request = Request { imprint: tree.imprint(), nonce };
            let answer = fetch(&client, authority, request.encode()).await?;
            let told = |error| refused(format!("the time stamp authority '{}': {error}", clean(&authority.name, 80)));
            let token = token_of(&answer).map_err(told)?;
            let pinned = std::slice::from_ref(&certificate);
            let stamped = check_token(token, &request.imprint, Some(&request), pinned).map_err(told)?;
            stamped.by_pinned().map_err(told)?;
            let (token, before) = (token.to_vec(), stamped.before);
            block_in_place(|| proofs.keep_token(key, id, before, token))?;
            tokens.push(StampedView { authority: clean(&authority.name, 80), before, roots: count });
        }
        Ok(())
    }

    pub fn health(&self) -> Result<Option<PartHealth>> {
        if !self.is_wanted() {
            return Ok(None);
        }
        let counts = self.parts.plant.ledger.proofs.stamp_counts()?;
        let newest =
            counts.before.map_or_else(|| "no stamps yet".to_owned(), |before| format!("newest before {before}"));
        let told = format!("{}, {newest}; waiting: {}", counted(counts.stamped, "stamp"), grouped(counts.waiting));
        let failures = counted(self.failures.load(Ordering::Acquire), "request");
        let trouble = self.with(|last| last.trouble.clone());
        let trouble = trouble.map(|(since, why)| (since, format!("{failures} failed: {why}")));
        Ok(Some(waiting_part("time", &told, trouble)))
    }

    pub fn suggested(&self) -> Vec<PinnedAuthority> {
        let pin = |authority: &TimeAuthority| {
            read(authority).ok()?;
            let certificate = std::fs::read_to_string(&authority.certificate).ok()?;
            Some(PinnedAuthority { name: authority.name.clone(), certificate })
        };
        self.parts.config.time_authorities.iter().filter_map(pin).collect()
    }
}

/// Read each time: it may have been replaced.
fn read(authority: &TimeAuthority) -> Result<Certificate> {
    let path = clean(&authority.certificate.display().to_string(), 200);
    let failed = |why: String| input(format!("{path}: {why}; set time.authorities to a PEM certificate"));
    let length = std::fs::metadata(&authority.certificate).map_err(|error| failed(error.to_string()))?.len();
    if length > LONGEST_CERTIFICATE {
        return Err(failed("it is too long for a certificate".to_owned()));
    }
    let text = std::fs::read_to_string(&authority.certificate).map_err(|error| failed(error.to_string()))?;
    Certificate::from_pem(&text).map_err(|error| failed(error.to_string()))
}

fn client(authority: &TimeAuthority) -> Result<reqwest::Client> {
    let client = reqwest::Client::builder().no_proxy().redirect(reqwest::redirect::Policy::none());
    let client = if authority.url.starts_with("https://") {
        let tls =
            authros_tls::tls(None).map_err(|why| input(format!("{why}; check this machine's ca-certificates")))?;
        client.use_preconfigured_tls(tls)
    } else {
        client.tls_built_in_root_certs(false)
    };
    client.timeout(PATIENCE).build().map_err(|error| internal(authros_tls::innermost(&error)))
}

async fn fetch(client: &reqwest::Client, authority: &TimeAuthority, request: Vec<u8>) -> Result<Vec<u8>> {
    let name = clean(&authority.name, 80);
    let unreachable = |error: reqwest::Error| {
        let why = if error.is_timeout() { "no answer in time".to_owned() } else { authros_tls::innermost(&error) };
        let text = match authros_tls::tls_fault(&error, "SSL_CERT_FILE") {
            Some(fault) => format!("the time stamp authority '{name}' {}; {}", fault.reason, fault.advice),
            None => format!("the time stamp authority '{name}' cannot be reached: {why}; check time.authorities"),
        };
        Failure::new(ErrorKind::Unreachable, text)
    };
    let sent = client.post(&authority.url).header("Content-Type", REQUEST_TYPE).body(request).send().await;
    let mut answer = sent.map_err(unreachable)?;
    if !answer.status().is_success() {
        return Err(refused(format!("the time stamp authority '{name}' answered {}", answer.status().as_u16())));
    }
    let mut bytes = Vec::new();
    while let Some(chunk) = answer.chunk().await.map_err(unreachable)? {
        bytes.extend_from_slice(&chunk);
        if bytes.len() > LONGEST_ANSWER {
            return Err(refused(format!(
                "the time stamp authority '{name}' sent more data than a time stamp can have"
            )));
        }
    }
    Ok(bytes)
}

//! The chain through several gateways. Each line is bound to one network, so another gateway cannot be another chain; but its
//! node may be cut off and show an old one. So all are asked for their newest block now and then, the newest is followed,
//! and nothing leads back behind what was seen, unless all gateways say so.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::Duration;

use async_trait::async_trait;
use serde_json::{Value, json};
use tokio::sync::Mutex;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep, timeout, timeout_at};

use crate::chain::relay::{NEWEST, block_number};
use crate::chain::{Relay, RelayError};

/// How long what gateways say of their newest blocks decides which one is followed.
const PERIOD: Duration = Duration::from_secs(2);
/// How long a look waits for the others once one has answered, and how long one that is behind may take to catch up.
const WAIT: Duration = Duration::from_secs(2);
/// Before those that are behind are asked again.
const AGAIN: Duration = Duration::from_millis(200);
/// One that takes longer does not answer.
const PATIENCE: Duration = Duration::from_secs(10);

/// The newest block of a gateway's chain.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Tip {
    number: u64,
    /// Whether the gateway knows that its chain is fresh.
    is_fresh: bool,
}

/// What all gateways said.
#[derive(Debug, Default)]
struct Looks {
    /// Those that are being asked.
    asked: BTreeSet<usize>,
    answers: JoinSet<(usize, Option<Tip>)>,
    /// The last answer of each; `None` if it does not answer.
    tips: BTreeMap<usize, Option<Tip>>,
    /// When it was decided whom to follow.
    decided: Option<Instant>,
}

/// Lines to the gateways of a fleet, in order.
pub struct ChainLines {
    lines: Vec<Arc<dyn Relay>>,
    /// The place of the one that is followed.
    used: AtomicUsize,
    /// The newest block that any answer showed.
    seen: AtomicU64,
    looks: Mutex<Looks>,
    period: Duration,
    wait: Duration,
}

impl ChainLines {
    /// Over these lines, beginning with the one at `used`.
    pub fn new(lines: Vec<Arc<dyn Relay>>, used: usize) -> Self {
        let (used, seen, looks) = (AtomicUsize::new(used), AtomicU64::new(0), Mutex::default());
        Self { lines, used, seen, looks, period: PERIOD, wait: WAIT }
    }

    /// The gateway to follow, without those that `failed` meanwhile.
    async fn choose(&self, failed: &[usize]) -> Result<usize, RelayError> {
        let used = self.used.load(Ordering::Acquire);
        if self.lines.len() == 1 && failed.is_empty() {
            return Ok(used);
        }
        let mut looks = self.looks.lock().await;
        if failed.is_empty() && looks.decided.is_some_and(|decided| decided.elapsed() < self.period) {
            return Ok(self.used.load(Ordering::Acquire));
        }
        looks.decided = None;
        let begun = Instant::now();
        loop {
            self.look(&mut looks).await;
            let seen = self.seen.load(Ordering::Acquire);
            let open = looks.tips.iter().filter_map(|(place, tip)| Some((*place, (*tip)?)));
            let best = open.filter(|(place, _)| !failed.contains(place)).max_by_key(|(place, tip)| {
                (tip.number >= seen, tip.is_fresh, tip.number, *place == used, usize::MAX - place)
            });
            let Some((place, Tip { number, is_fresh })) = best else {
                return Err(RelayError::Silent("none of the gateways answers".to_owned()));
            };
            // Whoever is away may know more, and so may the chain of a gateway that is not fresh.
            let all_say_so = is_fresh && failed.is_empty() && looks.tips.values().all(Option::is_some);
            if number >= seen || all_say_so {
                self.seen.store(number, Ordering::Release);
                self.used.store(place, Ordering::Release);
                looks.decided = Some(Instant::now());
                return Ok(place);
            }
            if begun.elapsed() >= self.wait {
                return Err(RelayError::Silent(format!(
                    "the gateways that answer know the chain up to block {number}, and block {seen} was seen before"
                )));
            }
            sleep(AGAIN.min(self.wait / 4)).await;
        }
    }

    /// Asks everybody for their newest block. One that did not answer the time before is not waited for. May be cancelled.
    async fn look(&self, looks: &mut Looks) {
        let Looks { asked, answers, tips, .. } = looks;
        let somebody = tips.values().any(Option::is_some);
        let is_awaited = |place: &usize| !somebody || tips.get(place).is_none_or(Option::is_some);
        let mut awaited: BTreeSet<usize> = (0..self.lines.len()).filter(is_awaited).collect();
        for (place, line) in self.lines.iter().enumerate().filter(|(place, _)| !asked.contains(place)) {
            let line = Arc::clone(line);
            answers.spawn(async move { (place, timeout(PATIENCE, newest(&*line)).await.ok().flatten()) });
        }
        asked.extend(0..self.lines.len());
        let (begun, mut answered) = (Instant::now(), false);
        while !awaited.is_empty() {
            let longest = if answered { self.wait } else { PATIENCE };
            match timeout_at(begun + longest, answers.join_next()).await {
                Ok(Some(Ok((place, answer)))) => {
                    asked.remove(&place);
                    awaited.remove(&place);
                    answered |= answer.is_some();
                    tips.insert(place, answer);
                }
                // It cannot be told whose it was.
                Ok(Some(Err(_))) => asked.clear(),
                Ok(None) | Err(_) => break,
            }
        }
        tips.extend(awaited.into_iter().map(|place| (place, None)));
    }

    /// Notes the newest block that an answer showed.
    fn note(&self, method: &str, result: &Value) {
        if let Some(number) = block_number(method, result) {
            self.seen.fetch_max(number, Ordering::AcqRel);
        }
    }
}

/// The newest block of a gateway's chain.
async fn newest(line: &dyn Relay) -> Option<Tip> {
    match line.ask(NEWEST, json!([])).await {
        Ok(block) => Some(Tip { number: block_number(NEWEST, &block)?, is_fresh: true }),
        Err(RelayError::Silent(_)) => {
            let method = "eth_getBlockByNumber";
            let block = line.ask(method, json!(["latest", false])).await.ok()?;
            Some(Tip { number: block_number(method, &block)?, is_fresh: false })
        }
        Err(RelayError::NotAllowed | RelayError::Answered { .. }) => None,
    }
}

#[async_trait]
impl Relay for ChainLines {
    async fn ask(&self, method: &str, parameters: Value) -> Result<Value, RelayError> {
        let (mut failed, mut silent) = (Vec::new(), None);
        while failed.len() < self.lines.len() {
            let place = match self.choose(&failed).await {
                Ok(place) => place,
                Err(error) => return Err(silent.unwrap_or(error)),
            };
            let Some(line) = self.lines.get(place) else { break };
            match line.ask(method, parameters.clone()).await {
                Err(error @ RelayError::Silent(_)) => {
                    failed.push(place);
                    silent = Some(error);
                }
                answered => {
                    if let Ok(result) = &answered {
                        self.note(method, result);
                    }
                    return answered;
                }
            }
        }
        Err(silent.unwrap_or_else(|| RelayError::Silent("no gateway is named".to_owned())))
    }

    fn place(&self) -> String {
        match self.lines.get(self.used.load(Ordering::Acquire)) {
            Some(line) => line.place(),
            None => "no gateway".to_owned(),
        }
    }
}

#[cfg(test)]
#[path = "chain_lines_tests.rs"]
mod tests;

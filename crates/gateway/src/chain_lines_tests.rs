//! Gateways that show a chain up to a block, as far as each knows it.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use std::sync::PoisonError;
use std::sync::atomic::AtomicBool;

use super::*;

/// A gateway that shows a chain up to a block.
struct Gate {
    number: AtomicU64,
    /// Whether it knows that its chain is fresh.
    is_fresh: bool,
    /// It does not answer.
    away: AtomicBool,
    /// It does not even refuse.
    mute: AtomicBool,
    asked: std::sync::Mutex<Vec<String>>,
}

impl Gate {
    fn at(number: u64, is_fresh: bool) -> Arc<Self> {
        let (away, mute) = (AtomicBool::new(false), AtomicBool::new(false));
        Arc::new(Self { number: AtomicU64::new(number), is_fresh, away, mute, asked: std::sync::Mutex::default() })
    }

    fn reaches(&self, number: u64) {
        self.number.store(number, Ordering::SeqCst);
    }

    fn is_away(&self, away: bool) {
        self.away.store(away, Ordering::SeqCst);
    }

    fn asked(&self, method: &str) -> usize {
        let asked = self.asked.lock().unwrap_or_else(PoisonError::into_inner);
        asked.iter().filter(|known| *known == method).count()
    }
}

#[async_trait]
impl Relay for Gate {
    async fn ask(&self, method: &str, _: Value) -> Result<Value, RelayError> {
        self.asked.lock().unwrap_or_else(PoisonError::into_inner).push(method.to_owned());
        if self.mute.load(Ordering::SeqCst) {
            std::future::pending::<()>().await;
        }
        if self.away.load(Ordering::SeqCst) {
            return Err(RelayError::Silent("connection refused".to_owned()));
        }
        let number = format!("{:#x}", self.number.load(Ordering::SeqCst));
        match (method, self.is_fresh) {
            (NEWEST, false) => Err(RelayError::Silent("the chain is not fresh".to_owned())),
            ("eth_blockNumber", _) => Ok(json!(number)),
            _ => Ok(json!({ "number": number })),
        }
    }

    fn place(&self) -> String {
        "a gateway".to_owned()
    }
}

/// Lines that look at each request, and wait a moment only.
fn over(gates: &[&Arc<Gate>]) -> ChainLines {
    let lines = gates.iter().map(|gate| Arc::clone(gate) as Arc<dyn Relay>).collect();
    let mut lines = ChainLines::new(lines, 0);
    (lines.period, lines.wait) = (Duration::ZERO, Duration::from_millis(300));
    lines
}

async fn head(lines: &ChainLines) -> Result<u64, String> {
    let result = lines.ask("eth_blockNumber", json!([])).await.map_err(|error| error.to_string())?;
    Ok(block_number("eth_blockNumber", &result).expect("a number"))
}

#[tokio::test]
async fn an_old_chain_is_never_followed_beside_a_new_one_nor_after_it() {
    // Cut off behind a node that answers: it does not know it, or says so.
    for word in [true, false] {
        let (stale, fresh) = (Gate::at(5, word), Gate::at(9, true));
        let lines = over(&[&stale, &fresh]);
        assert_eq!(head(&lines).await, Ok(9), "{word:?}");
        assert_eq!(stale.asked("eth_blockNumber"), 0, "{word:?}: it was only asked for its newest block");
        fresh.is_away(true);
        let refused = head(&lines).await.expect_err("an old chain");
        assert!(refused.contains("block 9 was seen") || refused.contains("refused"), "{word:?}: {refused}");
        assert_eq!(stale.asked("eth_blockNumber"), 0, "{word:?}");
        fresh.is_away(false);
        assert_eq!(head(&lines).await, Ok(9), "{word:?}");
        // Healed, it serves.
        stale.reaches(11);
        fresh.is_away(true);
        assert_eq!(head(&lines).await, Ok(11), "{word:?}");
    }
}

#[tokio::test]
async fn what_one_answer_showed_is_not_taken_back_by_another_gateway() {
    let (first, second) = (Gate::at(9, true), Gate::at(9, true));
    let mut lines = over(&[&first, &second]);
    lines.period = Duration::from_secs(3600);
    assert_eq!(head(&lines).await, Ok(9));
    // Between two looks.
    first.reaches(12);
    assert_eq!(head(&lines).await, Ok(12));
    first.is_away(true);
    assert!(head(&lines).await.is_err(), "the second one is behind");
    second.reaches(12);
    assert_eq!(head(&lines).await, Ok(12), "it has caught up");
    assert_eq!(second.asked("eth_blockNumber"), 1);
}

#[tokio::test]
async fn all_gateways_together_may_go_back() {
    let (first, second) = (Gate::at(9, true), Gate::at(9, true));
    let lines = over(&[&first, &second]);
    assert_eq!(head(&lines).await, Ok(9));
    first.reaches(7);
    assert_eq!(head(&lines).await, Ok(9), "one of them alone is behind");
    second.reaches(6);
    assert_eq!(head(&lines).await, Ok(7), "a reorganisation");
    let (behind, both) = (Gate::at(2, false), Gate::at(8, false));
    let lines = over(&[&behind, &both]);
    assert_eq!(head(&lines).await, Ok(8), "nobody else is there");
    both.reaches(3);
    assert!(head(&lines).await.is_err(), "those that catch up say nothing about a reorganisation");
}

#[tokio::test]
async fn one_that_says_that_it_is_not_fresh_serves_where_nobody_else_does() {
    let (stale, fresh) = (Gate::at(9, false), Gate::at(9, true));
    let both = over(&[&stale, &fresh]);
    assert_eq!(head(&both).await, Ok(9));
    assert_eq!((stale.asked("eth_blockNumber"), fresh.asked("eth_blockNumber")), (0, 1), "at the same height");
    fresh.is_away(true);
    assert_eq!(head(&both).await, Ok(9), "it knows all that was seen");
    // Who has one gateway takes its chain as it is, and asks it nothing else.
    let alone = over(&[&stale]);
    assert_eq!(head(&alone).await, Ok(9));
    stale.reaches(4);
    assert_eq!(head(&alone).await, Ok(4));
    assert_eq!(stale.asked("eth_blockNumber"), 3);
    let before = stale.asked(NEWEST);
    head(&alone).await.expect("answers");
    assert_eq!(stale.asked(NEWEST), before);
}

#[tokio::test]
async fn one_that_swallows_requests_is_waited_for_once() {
    let (mute, fresh) = (Gate::at(9, true), Gate::at(9, true));
    let lines = over(&[&mute, &fresh]);
    mute.mute.store(true, Ordering::SeqCst);
    let begun = Instant::now();
    assert_eq!(head(&lines).await, Ok(9));
    assert!(begun.elapsed() >= lines.wait, "it might have known more");
    for _ in 0..50 {
        assert_eq!(head(&lines).await, Ok(9));
    }
    assert_eq!(mute.asked(NEWEST), 1, "the first question is still open, nobody asks another one and waits for it");
    assert_eq!((mute.asked("eth_blockNumber"), fresh.asked("eth_blockNumber")), (0, 51));
}

#[tokio::test]
async fn looks_are_far_apart_and_requests_are_not() {
    let (first, second) = (Gate::at(9, true), Gate::at(9, true));
    let mut lines = over(&[&first, &second]);
    lines.period = Duration::from_secs(3600);
    for _ in 0..20 {
        assert_eq!(head(&lines).await, Ok(9));
    }
    assert_eq!((first.asked("eth_blockNumber"), first.asked(NEWEST), second.asked(NEWEST)), (20, 1, 1));
    assert_eq!(second.asked("eth_blockNumber"), 0, "the first of equals");
}

//! When a view of the chain is fresh; time is given, nobody waits.

use super::*;
use crate::model::Hash;

/// A chain with a block every five seconds, as it is seen here.
struct Seen {
    freshness: Freshness,
    begun: Instant,
    /// How far the clock here is ahead, seconds.
    ahead: u64,
}

const PERIOD: u64 = 5;
const BEGINNING: u64 = 1_700_000_000;

fn seconds(seconds: f64) -> Duration {
    Duration::from_secs_f64(seconds)
}

impl Seen {
    fn new(due: Option<u64>) -> Self {
        let mut freshness = Freshness::default();
        freshness.measured(due.map(Duration::from_secs));
        Self { freshness, begun: Instant::now() + Duration::from_secs(3600), ahead: 0 }
    }

    fn head(number: u64) -> BlockRef {
        let hash = Hash([u8::try_from(number % 251).unwrap_or(0); 32]);
        BlockRef { number, hash, timestamp: BEGINNING + number * PERIOD }
    }

    /// Block `number` is read, this number of seconds after the beginning.
    fn read(&mut self, number: u64, at: f64) {
        let asked = self.begun + seconds(at);
        let clock = BEGINNING + self.ahead + asked.duration_since(self.begun).as_secs();
        self.freshness.read(Self::head(number), asked, clock);
    }

    fn judge(&self, at: f64) -> Result<u64, NotFresh> {
        self.freshness.judge(self.begun + seconds(at)).map(|head| head.number)
    }
}

#[test]
fn a_node_that_is_away_is_noticed_within_two_seconds() {
    let mut seen = Seen::new(None);
    assert_eq!(seen.judge(0.0), Err(NotFresh::Unread));
    seen.read(1, 5.0);
    assert_eq!((seen.judge(7.0), seen.judge(7.1)), (Ok(1), Err(NotFresh::Silent(2))));
    // It names the same block again, and then one that was not read here.
    assert!(seen.freshness.is_named(&Seen::head(1), seen.begun + seconds(8.0)));
    assert_eq!((seen.judge(10.0), seen.judge(10.5)), (Ok(1), Err(NotFresh::Silent(2))));
    assert!(!seen.freshness.is_named(&Seen::head(2), seen.begun + seconds(11.0)));
    assert_eq!(seen.judge(11.0), Err(NotFresh::Silent(3)));
}

#[test]
fn a_chain_that_seals_only_what_is_sent_may_be_old() {
    let mut seen = Seen::new(None);
    for at in [5.0, 900.0, 90_000.0] {
        seen.read(1, at);
        assert_eq!(seen.judge(at + 1.0), Ok(1));
    }
}

#[test]
fn a_node_that_answers_and_is_cut_off_is_refused_until_blocks_come_as_they_are_sealed() {
    let mut seen = Seen::new(Some(PERIOD));
    for number in 1..=20_u32 {
        seen.read(number.into(), f64::from(number) * 5.0 + 0.3);
        assert_eq!(seen.judge(f64::from(number) * 5.0 + 1.0), Ok(number.into()), "healthy");
    }
    seen.read(20, 107.0);
    assert_eq!(seen.judge(107.2), Ok(20), "block 21 is due at 105, and two seconds are its own");
    seen.read(20, 108.0);
    assert_eq!(seen.judge(108.0), Err(NotFresh::Late { block: 20, age: 7, due: 5 }));
    // After a minute the others' blocks come again: first some, then the rest, and then it is in time.
    seen.read(26, 165.0);
    assert_eq!(seen.judge(165.1), Err(NotFresh::Behind { block: 26 }), "33 is sealed by now");
    seen.read(30, 166.0);
    assert_eq!(seen.judge(166.1), Err(NotFresh::Behind { block: 30 }));
    seen.read(33, 167.0);
    assert_eq!(seen.judge(167.1), Ok(33));
}

#[test]
fn a_clock_that_is_wrong_costs_a_block_and_no_more() {
    let mut seen = Seen { ahead: 7200, ..Seen::new(Some(PERIOD)) };
    seen.read(1, 5.2);
    assert_eq!(seen.judge(5.3), Err(NotFresh::Behind { block: 1 }), "nobody knows better yet");
    for number in 2..=40_u32 {
        let at = f64::from(number) * 5.0 + 0.2;
        seen.read(number.into(), at);
        assert_eq!(seen.judge(at), Ok(number.into()));
    }
}

#[test]
fn a_node_that_begins_far_behind_is_refused_while_it_reads_old_blocks() {
    let mut seen = Seen::new(Some(PERIOD));
    for (number, at) in [(1, 500.0), (20, 501.0), (60, 502.0), (90, 503.0)] {
        seen.read(number, at);
        assert_eq!(seen.judge(at), Err(NotFresh::Behind { block: number }));
    }
    seen.read(100, 504.0);
    assert_eq!(seen.judge(504.0), Ok(100));
}

#[test]
fn how_often_blocks_come_is_measured_anew_now_and_then_and_after_a_late_one() {
    let mut seen = Seen::new(None);
    assert!(!seen.freshness.is_to_measure(), "nothing was read");
    seen.read(1, 5.0);
    assert!(seen.freshness.is_to_measure());
    seen.freshness.measured(Some(Duration::from_secs(PERIOD)));
    for number in 2..=16_u32 {
        seen.read(number.into(), f64::from(number) * 5.0);
        assert!(!seen.freshness.is_to_measure(), "{number}");
    }
    seen.read(1 + MEASURED, 85.0);
    assert!(seen.freshness.is_to_measure());
    // Too busy to show a pause: the one known before counts.
    seen.freshness.measured(None);
    seen.read(1 + MEASURED, 95.0);
    assert!(matches!(seen.judge(95.0), Err(NotFresh::Late { due: 5, .. })), "{:?}", seen.judge(95.0));
    // One came late, and still no pause is seen: the chain seals only what is sent by now.
    seen.read(2 + MEASURED, 110.0);
    assert!(seen.freshness.is_to_measure());
    seen.freshness.measured(None);
    seen.read(2 + MEASURED, 900.0);
    assert_eq!(seen.judge(900.0), Ok(2 + MEASURED));
}

//! Transactions that take much of a block. Gas costs nothing on this chain, and every user of the machine may send some: a
//! number of them at once, then one now and then. The contract's usual calls are not among them.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use ethers::utils::rlp::Rlp;
use serde_json::Value;

use crate::model::bytes::unhex;

/// A transaction that may use more gas is heavy: several times what an anchor, a registration or a grant uses.
const HEAVY: u64 = 1_000_000;
/// How many are taken at once, from all callers together.
const AT_ONCE: u32 = 40;
/// Time until one more is taken.
const PAUSE: Duration = Duration::from_secs(10);

/// How many heavy transactions are still taken.
#[derive(Debug)]
pub struct Heavy {
    /// How many, and as of when.
    left: Mutex<(u32, Instant)>,
}

impl Heavy {
    /// All of them.
    pub fn new(now: Instant) -> Self {
        Self { left: Mutex::new((AT_ONCE, now)) }
    }

    /// Counts a transaction, signed and in hex, if it is heavy.
    ///
    /// # Errors
    /// How long to wait for the next one, if no more are taken now.
    pub fn count(&self, raw: Option<&Value>, now: Instant) -> Result<(), Duration> {
        let raw = raw.and_then(Value::as_str).and_then(unhex).unwrap_or_default();
        // What is no transaction is refused by the chain.
        let gas = Rlp::new(&raw).val_at::<u64>(2).unwrap_or(0);
        if gas <= HEAVY { Ok(()) } else { self.take(now) }
    }

    fn take(&self, now: Instant) -> Result<(), Duration> {
        let mut left = self.left.lock().unwrap_or_else(PoisonError::into_inner);
        let (mut number, mut since) = *left;
        while number < AT_ONCE && now.saturating_duration_since(since) >= PAUSE {
            (number, since) = (number + 1, since + PAUSE);
        }
        if number == AT_ONCE {
            since = now;
        }
        let taken = number.checked_sub(1);
        *left = (taken.unwrap_or(0), since);
        taken.map(drop).ok_or_else(|| PAUSE.saturating_sub(now.saturating_duration_since(since)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::bytes::hex;

    /// A transaction that may use this much gas; nobody signed it.
    fn raw(gas: u64) -> Value {
        let mut list = ethers::utils::rlp::RlpStream::new_list(9);
        list.append(&1u64).append(&0u64).append(&gas);
        (0..6).for_each(|_| {
            list.append_empty_data();
        });
        Value::String(format!("0x{}", hex(&list.out())))
    }

    #[test]
    fn heavy_ones_are_few_and_the_usual_ones_are_not_counted() {
        let begun = Instant::now();
        let heavy = Heavy::new(begun);
        let count = |gas: u64, after: Duration| heavy.count(Some(&raw(gas)), begun + after);
        for _ in 0..AT_ONCE {
            assert_eq!(count(HEAVY + 1, Duration::ZERO), Ok(()));
        }
        assert_eq!(count(10_000_000, Duration::from_secs(3)), Err(Duration::from_secs(7)));
        assert_eq!(count(HEAVY, Duration::ZERO), Ok(()), "a usual one");
        assert_eq!(heavy.count(Some(&Value::Null), begun), Ok(()), "the chain refuses it");
        assert_eq!(heavy.count(None, begun), Ok(()));
        assert_eq!(count(HEAVY + 1, PAUSE), Ok(()));
        assert!(count(HEAVY + 1, PAUSE).is_err(), "one in ten seconds");
        let later = PAUSE * (2 * AT_ONCE);
        assert_eq!((0..2 * AT_ONCE).filter(|_| count(HEAVY + 1, later).is_ok()).count(), 40);
    }
}

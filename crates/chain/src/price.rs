//! What transactions may cost: the operator's floor and cap, and when a waiting one is worth a higher price.

use std::time::{Duration, Instant};

use super::Market;
use crate::model::{Address, Wei};

/// Blocks that skip the first waiting transaction before it counts as passed by.
const PASSED_BY: u64 = 6;
/// The shortest wait before it counts as passed by.
pub const STARVING: Duration = Duration::from_secs(10);

/// The operator's limits, wei per gas.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Policy {
    /// The most; `None` = no cap.
    pub cap: Option<u128>,
    /// The least, whatever the node quotes.
    pub floor: u128,
}

/// A price, or a refusal because of the cap.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Priced {
    /// Wei per gas.
    At(u128),
    /// The price would have to exceed the cap.
    Capped {
        /// Wei per gas.
        needed: u128,
        /// Wei per gas.
        cap: u128,
    },
}

impl Policy {
    /// The same limits with a higher floor, as far as the cap allows.
    pub fn with_floor(self, floor: u128) -> Self {
        let floor = self.cap.map_or(floor, |cap| floor.min(cap));
        Self { floor: self.floor.max(floor), ..self }
    }

    /// The price of a new transaction: the market's price, raised to the floor, lowered to the cap if that can still be
    /// mined.
    pub fn fresh(&self, market: &Market) -> Priced {
        let needed = market.base.unwrap_or_else(|| market.quoted.min(market.offer()));
        self.within(market.offer().max(self.floor), needed.max(self.floor))
    }

    /// The price of a transaction that replaces one signed at `signed`: the market's price or the floor, but at least an
    /// eighth more (nodes refuse replacements below a tenth).
    pub fn replacement(&self, signed: u128, market: &Market) -> Priced {
        let least = signed.saturating_add((signed / 8).saturating_add(1)).max(self.floor);
        self.within(market.offer().max(least), least.max(market.base.unwrap_or(0)))
    }

    /// Whether a transaction that blocks pass by is offered at a higher price although the quote did not move. Not
    /// where gas costs nothing: such networks refuse any other price.
    pub fn raises(&self, market: &Market) -> bool {
        market.offer().max(self.floor) > 0
    }

    /// `wanted`, or the cap if that is at least `needed`.
    fn within(&self, wanted: u128, needed: u128) -> Priced {
        match self.cap {
            Some(cap) if wanted > cap && needed > cap => Priced::Capped { needed, cap },
            Some(cap) => Priced::At(wanted.min(cap)),
            None => Priced::At(wanted),
        }
    }
}

/// Whether a block made now cannot include a transaction signed at this price.
pub fn is_outbid(signed: u128, market: &Market) -> bool {
    market.base.is_some_and(|base| base > signed)
}

/// How long a transaction has been the next one to be mined, and since when at its present price.
#[derive(Debug, Clone, Copy)]
pub struct Wait {
    patience: Duration,
    since: (u64, Instant),
    raised: Option<(u64, Instant)>,
}

impl Wait {
    /// From this block on; nothing counts as passed by sooner than after `patience`.
    pub fn from(block: u64, patience: Duration) -> Self {
        Self { patience, since: (block, Instant::now()), raised: None }
    }

    /// It was just offered at a higher price.
    pub fn raise(&mut self, block: u64) {
        self.raised = Some((block, Instant::now()));
    }

    /// How long it has waited.
    pub fn length(&self) -> Duration {
        self.since.1.elapsed()
    }

    /// Whether it was offered at a higher price because blocks passed it by.
    pub fn is_raised(&self) -> bool {
        self.raised.is_some()
    }

    /// How many blocks have passed it by, if that is too many.
    pub fn passed_by(&self, block: u64) -> Option<u64> {
        self.is_long(self.since, block).then(|| block.saturating_sub(self.since.0))
    }

    /// Whether too many blocks have passed it by at its present price.
    pub fn is_due(&self, block: u64) -> bool {
        self.is_long(self.raised.unwrap_or(self.since), block)
    }

    fn is_long(&self, (since, at): (u64, Instant), block: u64) -> bool {
        block.saturating_sub(since) >= PASSED_BY && at.elapsed() >= self.patience
    }
}

/// What an account holds, and what it needs for its next transaction.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Shortfall {
    /// The account.
    pub account: Address,
    /// Its ether.
    pub held: Wei,
    /// The most that the transaction may cost.
    pub needed: Wei,
}

impl std::fmt::Display for Shortfall {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { account, held, needed } = self;
        write!(
            f,
            "{account} has too little ether to pay for gas: it has {held} and needs {needed}; send it some on this chain"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chain::BlockRef;
    use crate::model::Hash;
    use proptest::prelude::*;

    fn market(base: Option<u128>, quoted: u128) -> Market {
        Market { head: BlockRef { number: 1, hash: Hash([0; 32]), timestamp: 0 }, base, quoted }
    }

    #[test]
    fn a_cap_is_never_passed_and_used_where_it_can_be_mined() {
        let policy = Policy { cap: Some(100), floor: 0 };
        assert_eq!(policy.fresh(&market(Some(60), 60)), Priced::At(100), "twice 60 is too much, 100 is mined");
        assert_eq!(policy.fresh(&market(Some(101), 101)), Priced::Capped { needed: 101, cap: 100 });
        assert_eq!(policy.fresh(&market(None, 90)), Priced::At(90));
        assert_eq!(policy.fresh(&market(None, 101)), Priced::Capped { needed: 101, cap: 100 });
        assert_eq!(policy.replacement(96, &market(Some(97), 97)), Priced::Capped { needed: 109, cap: 100 });
        assert_eq!(policy.replacement(80, &market(Some(97), 97)), Priced::At(100));
        assert_eq!(Policy::default().replacement(0, &market(None, 0)), Priced::At(1));
    }

    #[test]
    fn a_floor_is_offered_whatever_the_node_quotes() {
        let policy = Policy { cap: Some(100), floor: 50 };
        assert_eq!(policy.fresh(&market(None, 0)), Priced::At(50));
        assert_eq!(policy.fresh(&market(None, 70)), Priced::At(70));
        assert_eq!(policy.fresh(&market(Some(10), 12)), Priced::At(50));
        assert_eq!(policy.replacement(8, &market(None, 8)), Priced::At(50));
        assert_eq!(policy.replacement(48, &market(None, 8)), Priced::At(55), "an eighth more all the same");
        assert_eq!(Policy { cap: Some(40), floor: 50 }.fresh(&market(None, 1)), Priced::Capped { needed: 50, cap: 40 });
        assert_eq!(policy.with_floor(90).fresh(&market(None, 1)), Priced::At(90));
        assert_eq!(policy.with_floor(900).fresh(&market(None, 1)), Priced::At(100), "no higher than the cap");
        assert_eq!(policy.with_floor(9), policy);
    }

    #[test]
    fn only_where_gas_has_a_price_is_it_raised() {
        assert!(Policy::default().raises(&market(None, 1)));
        assert!(!Policy::default().raises(&market(None, 0)));
        assert!(Policy { cap: None, floor: 1 }.raises(&market(None, 0)));
    }

    #[test]
    fn a_transaction_is_passed_by_after_blocks_and_time() {
        let mut wait = Wait::from(10, STARVING);
        assert_eq!((wait.passed_by(16), wait.is_due(16)), (None, false), "too soon");
        let Some(begun) = Instant::now().checked_sub(2 * STARVING) else { return };
        wait.since.1 = begun;
        assert_eq!((wait.passed_by(15), wait.passed_by(16), wait.is_due(16)), (None, Some(6), true));
        wait.raise(16);
        assert_eq!((wait.passed_by(30), wait.is_due(30), wait.is_raised()), (Some(20), false, true));
        wait.raised = Some((16, begun));
        assert!(wait.is_due(22) && !wait.is_due(21) && !wait.is_due(3), "a node that fell behind is no reason");
    }

    #[test]
    fn only_the_base_fee_outbids() {
        assert!(is_outbid(99, &market(Some(100), 0)));
        assert!(!is_outbid(100, &market(Some(100), 500)));
        assert!(!is_outbid(0, &market(None, 500)));
    }

    proptest! {
        #[test]
        fn replacements_are_an_eighth_more_and_within_the_limits(signed in 0u128..1 << 90, base: Option<u64>, quoted: u64, cap: Option<u64>, floor: u64) {
            let policy = Policy { cap: cap.map(u128::from), floor: u128::from(floor) };
            match policy.replacement(signed, &market(base.map(u128::from), u128::from(quoted))) {
                Priced::At(price) => {
                    prop_assert!(price > signed && (price - signed) * 8 >= signed);
                    prop_assert!(policy.cap.is_none_or(|cap| price <= cap) && price >= policy.floor);
                    prop_assert!(base.is_none_or(|base| price >= u128::from(base)));
                }
                Priced::Capped { needed, cap } => prop_assert!(needed > cap),
            }
        }
    }
}

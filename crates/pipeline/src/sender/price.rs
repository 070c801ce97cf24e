//! What transactions may cost: the operator's cap, and when a waiting one is worth a higher price.

use crate::chain::Market;

/// The operator's limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Policy {
    /// The most wei per gas; `None` = no cap.
    pub cap: Option<u128>,
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
    /// The price of a new transaction: the market's price, lowered to the cap if that can still be mined.
    pub fn fresh(&self, market: &Market) -> Priced {
        self.within(market.offer(), market.base.unwrap_or_else(|| market.quoted.min(market.offer())))
    }

    /// The price of a transaction that replaces one signed at `signed`: the market's price, but at least an eighth more
    /// (nodes refuse replacements below a tenth).
    pub fn replacement(&self, signed: u128, market: &Market) -> Priced {
        let least = signed.saturating_add((signed / 8).saturating_add(1));
        self.within(market.offer().max(least), least.max(market.base.unwrap_or(0)))
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
        let policy = Policy { cap: Some(100) };
        assert_eq!(policy.fresh(&market(Some(60), 60)), Priced::At(100), "twice 60 is too much, 100 is mined");
        assert_eq!(policy.fresh(&market(Some(101), 101)), Priced::Capped { needed: 101, cap: 100 });
        assert_eq!(policy.fresh(&market(None, 90)), Priced::At(90));
        assert_eq!(policy.fresh(&market(None, 101)), Priced::Capped { needed: 101, cap: 100 });
        assert_eq!(policy.replacement(96, &market(Some(97), 97)), Priced::Capped { needed: 109, cap: 100 });
        assert_eq!(policy.replacement(80, &market(Some(97), 97)), Priced::At(100));
        assert_eq!(Policy { cap: None }.replacement(0, &market(None, 0)), Priced::At(1));
    }

    #[test]
    fn only_the_base_fee_outbids() {
        assert!(is_outbid(99, &market(Some(100), 0)));
        assert!(!is_outbid(100, &market(Some(100), 500)));
        assert!(!is_outbid(0, &market(None, 500)));
    }

    proptest! {
        #[test]
        fn replacements_are_an_eighth_more_and_within_the_cap(signed in 0u128..1 << 90, base: Option<u64>, quoted: u64, cap: Option<u64>) {
            let policy = Policy { cap: cap.map(u128::from) };
            match policy.replacement(signed, &market(base.map(u128::from), u128::from(quoted))) {
                Priced::At(price) => {
                    prop_assert!(price > signed && (price - signed) * 8 >= signed);
                    prop_assert!(policy.cap.is_none_or(|cap| price <= cap));
                    prop_assert!(base.is_none_or(|base| price >= u128::from(base)));
                }
                Priced::Capped { needed, cap } => prop_assert!(needed > cap),
            }
        }
    }
}

//! Gas prices, and re-signing transactions: the same call at another price or nonce.

use std::sync::PoisonError;
use std::time::{Duration, Instant};

use ethers::types::U256;
use serde_json::json;

use crate::model::{Address, Wei};
use crate::transaction::{Signed, Transaction, Unsigned};
use crate::{BlockRef, Call, Chain, ChainError, call::artefact, crypto::EoaSecret};

/// Highest tip on top of the base fee, wei.
const LARGEST_TIP: u128 = 1_000_000_000;
/// Gas of a plain transfer (Yellow Paper, appendix G).
const TRANSFER_GAS: u64 = 21_000;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Market {
    pub head: BlockRef,
    /// Wei; `None` without a base fee.
    pub base: Option<u128>,
    /// The node's suggestion, wei.
    pub quoted: u128,
}

impl Market {
    /// Legacy gas price, wei: twice the base fee and a tip of at most 1 gwei. Without a base fee, the node's price
    /// without a margin, which would feed on itself: nodes quote what was paid last.
    pub fn offer(&self) -> u128 {
        match self.base {
            Some(base) => base.saturating_mul(2) + self.quoted.saturating_sub(base).min(LARGEST_TIP),
            None => self.quoted,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Offered {
    pub price: u128,
    pub gas: u64,
    /// Wei.
    pub value: u128,
}

impl Offered {
    /// Wei at most, what it sends included.
    pub fn cost_at(&self, price: u128) -> u128 {
        price.saturating_mul(u128::from(self.gas)).saturating_add(self.value)
    }
}

impl Chain {
    pub async fn market(&self) -> Result<Market, ChainError> {
        let block = self.newest().await?;
        *self.inner.block_room.lock().unwrap_or_else(PoisonError::into_inner) = block.room();
        let quoted: U256 = self.rpc("eth_gasPrice", json!([])).await?;
        let base = block.base_fee_per_gas.filter(|base| !base.is_zero());
        let base = base.map(|base| self.small("eth_getBlockByNumber", base)).transpose()?;
        Ok(Market { head: block.reference(), base, quoted: self.small("eth_gasPrice", quoted)? })
    }

    fn small(&self, method: &str, value: U256) -> Result<u128, ChainError> {
        u128::try_from(value).map_err(|_| self.misunderstood(method, "it is too large"))
    }

    /// Wei, saturating.
    pub async fn wealth(&self, account: Address) -> Result<u128, ChainError> {
        Ok(u128::try_from(self.balance(account).await?).unwrap_or(u128::MAX))
    }

    /// The node's own estimate may be higher.
    pub async fn shortfall(&self, account: Address, call: &Call, price: u128) -> Result<Shortfall, ChainError> {
        let gas = known_cost(call.name(), &call.encode()?);
        let needed = Wei(price.saturating_mul(u128::from(gas)));
        Ok(Shortfall { account, held: Wei(self.wealth(account).await?), needed })
    }

    pub async fn sign_at(&self, eoa: &EoaSecret, nonce: u64, call: &Call, price: u128) -> Signed {
        let contract = self.contract()?;
        let input = call.encode()?;
        let gas_limit = self.gas(eoa.address(), contract, call, &input).await?;
        let (to, value) = (Some(contract), alloy_primitives::U256::ZERO);
        Unsigned { nonce, gas_price: price, gas_limit, to, value, input }.sign(eoa, self.chain_id())
    }

    pub fn sign_transfer(&self, eoa: &EoaSecret, nonce: u64, to: Address, wei: u128, price: u128) -> Signed {
        let (to, value) = (Some(to), alloy_primitives::U256::from(wei));
        let terms = Unsigned { nonce, gas_price: price, gas_limit: TRANSFER_GAS, to, value, input: Vec::new() };
        terms.sign(eoa, self.chain_id())
    }

    /// Signs the call again with another nonce or price, and with a new estimate of its gas: the old one may keep it
    /// out of blocks.
    pub async fn resign(&self, eoa: &EoaSecret, raw: &[u8], nonce: u64, price: u128) -> Signed {
        let terms = decode(raw)?;
        let gas_limit = match function_of(&terms.input) {
            Some(function) => {
                // It may fail because an earlier transaction of the lane is in no block yet.
                let estimate = self.estimate(eoa.address(), Some(self.contract()?), &terms.input).await.unwrap_or(0);
                limit(estimate, known_cost(function, &terms.input), self.room())?
            }
            None => TRANSFER_GAS,
        };
        Unsigned { nonce, gas_price: price, gas_limit, ..terms }.sign(eoa, self.chain_id())
    }
}

fn function_of(data: &[u8]) -> Option<&'static str> {
    let selector = data.get(..4)?;
    let mut functions = artefact().ok()?.abi.functions();
    functions.find(|function| function.short_signature() == selector).map(|function| function.name.as_str())
}

pub fn offered(raw: &[u8]) -> Result<Offered, ChainError> {
    let terms = decode(raw)?;
    Ok(Offered { price: terms.gas_price, gas: terms.gas_limit, value: terms.value.saturating_to() })
}

/// Ignores nonce and price.
pub fn is_same_call(one: &[u8], other: &[u8]) -> bool {
    let call = |raw| decode(raw).ok().map(|terms| (terms.to, terms.value, terms.input));
    call(one).is_some_and(|found| call(other) == Some(found))
}

pub fn call_data(raw: &[u8]) -> Result<Vec<u8>, ChainError> {
    Ok(decode(raw)?.input)
}

fn decode(raw: &[u8]) -> Result<Unsigned, ChainError> {
    let what = "the stored bytes are not a legacy transaction; check the ledger with `authros audit`";
    Transaction::parse(raw).map(|parsed| parsed.unsigned).map_err(|_| ChainError::Input(what.into()))
}

// What transactions may cost: the operator's floor and cap, and when a waiting one is worth a higher price.

/// Blocks that skip the first waiting transaction before it counts as passed by.
const PASSED_BY: u64 = 6;
/// Shortest wait before it counts as passed by.
pub const STARVING: Duration = Duration::from_secs(10);

/// The operator's limits, wei per gas.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Policy {
    pub cap: Option<u128>,
    /// Applies whatever the node quotes.
    pub floor: u128,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Priced {
    At(u128),
    /// Both in wei per gas.
    Capped {
        needed: u128,
        cap: u128,
    },
}

impl Policy {
    /// Raises the floor, at most to the cap.
    pub fn with_floor(self, floor: u128) -> Self {
        let floor = self.cap.map_or(floor, |cap| floor.min(cap));
        Self { floor: self.floor.max(floor), ..self }
    }

    /// The market's price, within floor and cap; `Capped` if the cap cannot be mined.
    pub fn fresh(&self, market: &Market) -> Priced {
        let needed = market.base.unwrap_or_else(|| market.quoted.min(market.offer()));
        self.within(market.offer().max(self.floor), needed.max(self.floor))
    }

    /// At least an eighth above `signed`: nodes refuse replacements below a tenth.
    pub fn replacement(&self, signed: u128, market: &Market) -> Priced {
        let least = signed.saturating_add((signed / 8).saturating_add(1)).max(self.floor);
        self.within(market.offer().max(least), least.max(market.base.unwrap_or(0)))
    }

    /// Networks where gas costs nothing refuse any other price.
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

/// No block made now can include this price.
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
    /// Nothing counts as passed by before `patience`.
    pub fn from(block: u64, patience: Duration) -> Self {
        Self { patience, since: (block, Instant::now()), raised: None }
    }

    pub fn raise(&mut self, block: u64) {
        self.raised = Some((block, Instant::now()));
    }

    pub fn length(&self) -> Duration {
        self.since.1.elapsed()
    }

    pub fn is_raised(&self) -> bool {
        self.raised.is_some()
    }

    /// `None` if not too many blocks passed it by.
    pub fn passed_by(&self, block: u64) -> Option<u64> {
        self.is_long(self.since, block).then(|| block.saturating_sub(self.since.0))
    }

    /// At its present price.
    pub fn is_due(&self, block: u64) -> bool {
        self.is_long(self.raised.unwrap_or(self.since), block)
    }

    fn is_long(&self, (since, at): (u64, Instant), block: u64) -> bool {
        block.saturating_sub(since) >= PASSED_BY && at.elapsed() >= self.patience
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize, thiserror::Error)]
#[error("{account} has too little ether to pay for gas: it has {held} and needs {needed}; send it some on this chain")]
pub struct Shortfall {
    pub account: Address,
    pub held: Wei,
    pub needed: Wei,
}

// Known costs, and trust in estimates. Unused gas is not paid, so a high limit is harmless; one that no block can hold
// blocks its lane for ever.

/// Gas per byte of data in the dearest rules known (EIP-7623), and its copy in an event.
const PER_BYTE: u64 = 70;
/// Multiple of the known cost above which an estimate is not believed.
const BELIEVED: u64 = 4;

/// Gas with a quarter to spare: measured under both rule sets (`contracts/gas.txt`), proportional to the data.
pub(super) fn known_cost(function: &str, data: &[u8]) -> u64 {
    let fixed: u64 = match function {
        "register" => 345_000,
        "rotateKeys" => 121_000,
        "dataUpload" => 83_000,
        "authorityGrant" => 75_000,
        "authorityRevoke" => 66_000,
        "nameRecovery" => 76_000,
        "proposeSuccession" => 63_000,
        "wrap" => 30_000,
        _ => 60_000,
    };
    let bytes = data.len() as u64 * PER_BYTE;
    fixed.saturating_add(bytes).saturating_mul(5) / 4
}

/// The known cost, or the node's estimate with a margin where it is higher: at most [`BELIEVED`] known costs, and never
/// more than a block holds.
pub(super) fn limit(estimate: u64, known: u64, block: Option<u64>) -> Result<u64, ChainError> {
    let block = block.filter(|limit| *limit > 0).unwrap_or(u64::MAX);
    if block < known {
        return Err(ChainError::BlockTooSmall { needed: known, limit: block });
    }
    Ok(with_margin(estimate).clamp(known, known.saturating_mul(BELIEVED)).min(block))
}

/// A quarter to spare: the state may change until the transaction is mined.
pub(super) fn with_margin(estimate: u64) -> u64 {
    estimate.saturating_add(estimate / 4)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Hash;

    fn market(base: Option<u128>, quoted: u128) -> Market {
        Market { head: BlockRef { number: 1, hash: Hash([0; 32]), timestamp: 0 }, base, quoted }
    }

    #[test]
    fn offers() {
        assert_eq!(market(None, 7).offer(), 7);
        assert_eq!(market(Some(100), 130).offer(), 230);
        assert_eq!(market(Some(100), 90).offer(), 200);
        assert_eq!(market(Some(1), 5_000_000_000).offer(), 1_000_000_002, "the tip is bounded");
    }

    #[test]
    fn signed_again_only_price_nonce_and_hash_differ() {
        let eoa = EoaSecret::from_slice(&[7; 32]).expect("key");
        let (to, input) = (Some(Address([5; 20])), vec![1, 2, 3]);
        let terms = Unsigned { nonce: 3, gas_limit: 50_000, gas_price: 9, to, input, ..Unsigned::default() };
        let first = terms.clone().sign(&eoa, 31_337).expect("signs");
        let again = Unsigned { nonce: 4, gas_price: 11, ..decode(&first.raw).expect("decodes") };
        let again = again.sign(&eoa, 31_337).expect("signs");
        assert_ne!(first.hash, again.hash);
        assert_eq!(offered(&again.raw), Ok(Offered { price: 11, gas: 50_000, value: 0 }));
        assert_eq!((again.nonce, again.gas_limit, again.gas_price), (4, 50_000, 11));
        assert!(is_same_call(&first.raw, &again.raw));
        assert_eq!(call_data(&again.raw), Ok(vec![1, 2, 3]));
        let other = Unsigned { input: vec![1, 2], ..terms }.sign(&eoa, 31_337).expect("signs");
        assert!(!is_same_call(&first.raw, &other.raw));
        assert!(!is_same_call(&[1], &[1]) && offered(&[0xc0]).is_err() && call_data(&[]).is_err());
        assert_eq!(offered(&first.raw).map(|offered| offered.cost_at(2)), Ok(100_000));
    }
}

#[cfg(test)]
mod price_tests {
    use super::*;
    use crate::BlockRef;
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

#[cfg(test)]
mod gas_tests {
    use super::*;
    use proptest::prelude::*;

    /// Each row of `contracts/gas.txt`: a call, and its gas under both rule sets.
    fn measured() -> Vec<(String, u64)> {
        let text = include_str!("../../../contracts/gas.txt");
        let rows =
            text.lines().skip_while(|line| !line.starts_with("Per call")).skip(1).take_while(|line| !line.is_empty());
        let row = |line: &str| {
            let mut words: Vec<&str> = line.split_whitespace().collect();
            let osaka: u64 = words.pop()?.parse().ok()?;
            let istanbul: u64 = words.pop()?.parse().ok()?;
            Some((words.join(" "), istanbul.max(osaka)))
        };
        rows.filter(|line| !line.starts_with("prototype")).map(|line| row(line).expect("a row")).collect()
    }

    #[test]
    fn every_measured_call_is_covered_and_none_is_exaggerated() {
        let rows = measured();
        assert!(rows.len() > 25, "{rows:?}");
        for (call, gas) in rows {
            let function = call.split([' ', ',']).next().expect("a name");
            // Data of the shape that the row describes.
            let bytes = match call.as_str() {
                "authorityGrant, 32 topics, envelope of 2000 bytes" => 2000 + 32 * 32,
                "authorityGrant, all topics, envelope of 400 bytes" => 400,
                "register" | "rotateKeys" | "rotate" | "authorityRevoke" => 400,
                "wrap for 1 grantee" => 512,
                "wrap for 32 grantees" => 32 * 512,
                _ => 0,
            };
            let known = known_cost(function, &vec![1; bytes]);
            assert!(known >= gas, "{call}: {known} < {gas}");
            assert!(known <= 5 * gas.max(40_000), "{call}: {known} is far above {gas}");
        }
    }

    #[test]
    fn wrong_numbers_do_no_harm() {
        let known = known_cost("anchor", &[0; 100]);
        for lie in [0, 1, 21_000, 1 << 32, 5_284_823_450, u64::MAX] {
            let gas = limit(lie, known, Some(4_294_967_295)).expect("a limit");
            assert!((known..=4 * known).contains(&gas), "{lie}: {gas}");
        }
        assert_eq!(limit(80_000, 72_000, None).ok(), Some(100_000), "an honest higher estimate counts");
        assert_eq!(limit(80_000, 72_000, Some(0)).ok(), Some(100_000), "no block has no room at all");
        assert!(matches!(limit(80_000, 72_000, Some(71_999)), Err(ChainError::BlockTooSmall { .. })));
    }

    proptest! {
        #[test]
        fn a_limit_fits_into_a_block_and_covers_the_call(estimate: u64, known in 21_000_u64..20_000_000, block: Option<u64>) {
            if let Ok(gas) = limit(estimate, known, block) {
                prop_assert!(gas >= known && gas <= 4 * known);
                prop_assert!(block.is_none_or(|block| block == 0 || gas <= block));
            }
        }
    }
}

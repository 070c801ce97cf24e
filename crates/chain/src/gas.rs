//! What each call is known to cost, and how far a node's estimate is believed. Gas that a transaction does not use is not
//! paid, so a limit above the cost is harmless; one that no block can hold blocks its account's lane for ever.

use super::{Call, ChainError};

/// Gas for each byte of a call's data, in the dearest rules known (EIP-7623), and its copy in an event.
const PER_BYTE: u64 = 70;
/// An estimate above this multiple of the known cost is not believed.
const BELIEVED: u64 = 4;

/// The most gas that a call of the contract uses, with a quarter to spare: measured under both rule sets
/// (`contracts/gas.txt`), and proportional to its data.
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

/// The gas limit of a transaction: what the call is known to cost, or the node's estimate with a quarter to spare where
/// that is higher, up to four times the known cost and never more than a block holds.
///
/// # Errors
/// [`ChainError::BlockTooSmall`] if a block holds less than the call is known to cost.
pub(super) fn limit(estimate: u64, known: u64, block: Option<u64>) -> Result<u64, ChainError> {
    let block = block.filter(|limit| *limit > 0).unwrap_or(u64::MAX);
    if block < known {
        return Err(ChainError::BlockTooSmall { needed: known, limit: block });
    }
    Ok(with_margin(estimate).clamp(known, known.saturating_mul(BELIEVED)).min(block))
}

/// An estimate with a quarter to spare: the state may change until the transaction is mined.
pub(super) fn with_margin(estimate: u64) -> u64 {
    estimate.saturating_add(estimate / 4)
}

impl Call {
    /// The most gas that this call uses, as far as is known.
    pub(super) fn known_cost(&self, data: &[u8]) -> u64 {
        known_cost(self.name(), data)
    }
}

#[cfg(test)]
mod tests {
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

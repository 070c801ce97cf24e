//! By when a chain owes its next block, measured on its newest ones. A chain that seals only what somebody sends owes
//! nothing, however old its head is.

use std::time::Duration;

use ethers::types::U64;
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::{Chain, ChainError};

/// Blocks that are measured, and after how many new ones it is time to measure again.
pub const MEASURED: u64 = 16;
/// The fewest pauses from which a mean is taken.
const LEAST: usize = 8;
/// Under proof of work a pause longer than so many mean ones comes once in 22,000 blocks (e^-10).
const LUCK: u32 = 10;
/// Under proof of stake a proposer may miss its turn.
const MISSED: u32 = 2;

/// A block as it is measured.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
struct RawSealed {
    timestamp: U64,
    gas_used: U64,
}

impl Chain {
    /// How long after a block the next one is due; `None` if nothing is due, or if the newest blocks do not show it.
    ///
    /// # Errors
    /// Errors of the node.
    pub async fn due_within(&self) -> Result<Option<Duration>, ChainError> {
        // Where one program is the whole chain, its answer is the chain's word: there is nobody to be cut off from.
        let is_alone = self.transport().embedded().is_some() || self.inner.client.starts_with("AuthROS/");
        if is_alone || self.inner.consensus == "dev" {
            return Ok(None);
        }
        let head = self.head().await?.number;
        let mut sealed = Vec::new();
        // The genesis block's time is anybody's choice.
        for number in head.saturating_sub(MEASURED).max(1)..=head {
            let asked = json!([format!("{number:#x}"), false]);
            let Some(block) = self.rpc::<Option<RawSealed>>("eth_getBlockByNumber", asked).await? else {
                return Ok(None);
            };
            sealed.push((block.timestamp.as_u64(), block.gas_used.is_zero()));
        }
        Ok(due(self.inner.consensus, &sealed))
    }
}

/// By the times of successive blocks, seconds, and whether each is empty. Only what came before an empty block shows how
/// long a chain waits although nobody sends anything; proof of work does not wait for transactions at all.
fn due(consensus: &str, sealed: &[(u64, bool)]) -> Option<Duration> {
    let pauses = sealed.iter().zip(sealed.iter().skip(1));
    let pauses = pauses.map(|((before, _), (time, empty))| (Duration::from_secs(time.saturating_sub(*before)), *empty));
    if consensus == "pow" {
        let all: Vec<Duration> = pauses.map(|(pause, _)| pause).collect();
        let count = u32::try_from(all.len()).ok().filter(|_| all.len() >= LEAST)?;
        return Some((all.iter().sum::<Duration>() * LUCK / count).max(Duration::from_secs(1)));
    }
    let longest = pauses.filter(|(_, empty)| *empty).map(|(pause, _)| pause).max()?;
    let turns = if consensus == "poa" { 1 } else { MISSED };
    Some((longest * turns).max(Duration::from_secs(1)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Blocks with these pauses, each empty or not.
    fn blocks(pauses: &[(u64, bool)]) -> Vec<(u64, bool)> {
        let mut time = 1_700_000_000;
        let mut sealed = vec![(time, true)];
        for (pause, empty) in pauses {
            time += pause;
            sealed.push((time, *empty));
        }
        sealed
    }

    fn seconds(consensus: &str, pauses: &[(u64, bool)]) -> Option<u64> {
        due(consensus, &blocks(pauses)).map(|due| due.as_secs())
    }

    #[test]
    fn what_a_chain_owes_shows_in_its_empty_blocks() {
        assert_eq!(seconds("poa", &[(5, true), (5, false), (5, true)]), Some(5));
        assert_eq!(seconds("poa", &[(1, false), (1, false), (60, true), (1, false)]), Some(60), "empty ones come late");
        assert_eq!(seconds("pos", &[(12, true), (12, false)]), Some(24), "one turn may be missed");
        assert_eq!(seconds("poa", &[(0, true), (0, true)]), Some(1));
        // Busy, or sealing only what is sent: that cannot be told apart, so nothing is due.
        assert_eq!(seconds("poa", &[(1, false), (1, false), (900, false)]), None);
        assert_eq!(seconds("poa", &[]), None);
    }

    #[test]
    fn proof_of_work_is_given_ten_mean_pauses_whatever_is_in_its_blocks() {
        assert_eq!(seconds("pow", &[(12, false); 8]), Some(120));
        assert_eq!(
            seconds(
                "pow",
                &[(3, false), (45, true), (1, false), (7, true), (2, true), (30, true), (4, false), (4, true)]
            ),
            Some(120)
        );
        assert_eq!(seconds("pow", &[(12, true); 7]), None, "too few to tell");
    }
}

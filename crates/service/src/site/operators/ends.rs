//! The ends of operators' times: once one was passed by a clock that is believed, it is noted, and setting the clock back
//! brings nobody back.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::task::block_in_place;

use super::Operators;
use crate::crypto::{OperatorTerms, signer_id};
use crate::model::ProfileName;
use crate::model::steady_clock::{Reading, SETTLING};
use crate::store::{Ledger, StoreError};

/// Interval between looks: shorter than the time after which a clock that was set back is believed.
const LOOK: Duration = Duration::from_secs(SETTLING.as_secs() / 2);

/// Which operators' times were seen to be over.
pub(super) struct Ends {
    ledger: Ledger,
    /// Those that the ledger has.
    noted: Mutex<BTreeSet<String>>,
}

/// The setting that says that the time of an operator is over. Whoever is added again has another beginning.
fn place(profile: &ProfileName, terms: &OperatorTerms) -> String {
    format!("operator over:{profile}:{}:{}:{}", terms.name, signer_id(&terms.key), terms.from.0)
}

impl Ends {
    /// From this ledger.
    pub fn new(ledger: Ledger) -> Self {
        Self { ledger, noted: Mutex::default() }
    }

    /// Whether the time of an operator is over, now or at any look before. Waits for the ledger.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn is_over(&self, profile: &ProfileName, terms: &OperatorTerms, clock: &Reading) -> Result<bool, StoreError> {
        let Some(until) = terms.until else { return Ok(false) };
        let place = place(profile, terms);
        if self.noted.lock().unwrap_or_else(PoisonError::into_inner).contains(&place) {
            return Ok(true);
        }
        if self.ledger.setting(&place)?.is_none() {
            if clock.steady < until {
                return Ok(clock.machine >= until);
            }
            self.ledger.put_setting(&place, &clock.steady.0.to_string())?;
        }
        self.noted.lock().unwrap_or_else(PoisonError::into_inner).insert(place);
        Ok(true)
    }
}

impl Operators {
    /// Notes ends until the site ends, also those of operators who ask for nothing.
    pub(in crate::site) async fn keep_ends(self: Arc<Self>) {
        loop {
            let has_operators = |profile: &ProfileName| self.file(profile).exists();
            let profiles =
                block_in_place(|| self.home.profiles().into_iter().filter(has_operators).collect::<Vec<_>>());
            for profile in profiles {
                // What cannot be read or noted is said to whoever asks as an operator.
                drop(self.rows(&profile).await);
            }
            if !self.life.beat(LOOK).await {
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crypto::OperatorKey;
    use crate::model::Timestamp;
    use crate::site::testing::profile;

    #[test]
    fn an_end_that_was_seen_stands_when_the_clock_is_set_back_and_one_that_was_not_believed_does_not() {
        let folder = tempfile::tempdir().expect("a folder");
        let open = || Ends::new(Ledger::open(&folder.path().join("ledger")).expect("a ledger"));
        let provider = crate::crypto::provider(crate::crypto::ProviderName::default());
        let key = OperatorKey::generate(provider, "bob".parse().expect("a name")).expect("a key");
        let at = |steady, machine| Reading {
            steady: Timestamp::from_seconds(steady),
            machine: Timestamp::from_seconds(machine),
        };
        let terms = OperatorTerms {
            name: key.name.clone(),
            key: key.pair.public,
            rights: "look".parse().expect("a right"),
            from: Timestamp::from_seconds(10),
            until: Some(Timestamp::from_seconds(100)),
        };
        let (ends, alice) = (open(), profile("alice"));
        let over = |ends: &Ends, clock: Reading| ends.is_over(&alice, &terms, &clock).expect("the ledger answers");
        assert!(!over(&ends, at(99, 99)));
        assert!(over(&ends, at(50, 200)), "by the machine's clock");
        assert!(!over(&ends, at(51, 51)), "which was wrong for a moment");
        assert!(over(&ends, at(100, 60)), "the machine's clock alone was set back");
        assert!(over(&ends, at(60, 60)), "and is believed by now");
        drop(ends);
        let ends = open();
        assert!(over(&ends, at(60, 60)), "after a restart too");
        assert!(!ends.is_over(&profile("carol"), &terms, &at(60, 60)).expect("the ledger answers"), "hers is another");
        let again = OperatorTerms { from: Timestamp::from_seconds(60), ..terms.clone() };
        assert!(!ends.is_over(&alice, &again, &at(61, 61)).expect("the ledger answers"), "added anew");
    }
}

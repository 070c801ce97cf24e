//! Keys of epochs that a keyring lacks, because it is older than the chain: fetched from there, and otherwise told.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use tokio::task::block_in_place;

use super::Sharing;
use crate::crypto::signer_id;
use crate::model::ProfileName;
use crate::pipeline::epoch::EpochKeys;
use crate::pipeline::{Network, Owner, recovery};
use crate::service::event::{NoticeLevel, Part};
use crate::service::reply::Failure;

/// The most epochs that are named.
const MOST_NAMED: usize = 8;

/// What open profiles lack.
#[derive(Default)]
pub(super) struct Missing {
    epochs: Mutex<BTreeMap<ProfileName, Lack>>,
    /// Why newer SM2 pairs of the chain are not in the keyring, or those of the keyring not on the chain.
    pairs: Mutex<BTreeMap<ProfileName, String>>,
    /// That the chain has an earlier epoch than it had before.
    back: Mutex<BTreeMap<ProfileName, String>>,
}

/// What one profile lacks.
struct Lack {
    /// The epochs.
    epochs: Vec<u64>,
    /// Whether the current one is among them: nothing is sealed then.
    current: bool,
    /// The newest event of the chain when this was found out.
    seen: u64,
}

impl Lack {
    fn text(&self, profile: &ProfileName) -> String {
        let named: Vec<String> = self.epochs.iter().take(MOST_NAMED).map(ToString::to_string).collect();
        let more = if self.epochs.len() > MOST_NAMED { ", ..." } else { "" };
        let sealed = if self.current { " and nothing new is sealed" } else { "" };
        let rotate = if self.current { ", or seal under a new epoch with `authros keys rotate`" } else { "" };
        format!(
            "the keyring of '{profile}' lacks the keys of epochs {}{more}: their records cannot be opened here{sealed}; \
             the chain does not return them to these keys, so restore a newer backup of the keyring{rotate}",
            named.join(", ")
        )
    }
}

impl Missing {
    fn all(&self) -> MutexGuard<'_, BTreeMap<ProfileName, Lack>> {
        self.epochs.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn pairs(&self) -> MutexGuard<'_, BTreeMap<ProfileName, String>> {
        self.pairs.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn back(&self) -> MutexGuard<'_, BTreeMap<ProfileName, String>> {
        self.back.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Sharing {
    /// Brings keyring and recorder to the chain's epochs: keys that the keyring lacks are fetched from there, and records
    /// are sealed under the current epoch, or one that was begun and never reached the chain. Without the key of the
    /// current epoch nothing is sealed: nobody knows who reads under an earlier one. The caller holds the owner's changes.
    pub(in crate::site) fn take_up_epoch(&self, owner: &Owner, network: &Network) -> Result<(), Failure> {
        if owner.is_locked() {
            return Ok(());
        }
        self.fetch_missing(owner, network)?;
        if !recovery::holds_current(network, owner) {
            owner.author.rest();
            self.hub.changed(Part::Identity);
            return Ok(());
        }
        let (domain, on_chain) = (network.domain, network.directory.epoch(owner.address));
        owner.confirm_epoch(domain, on_chain)?;
        let newest = owner.epochs(domain).last().copied().unwrap_or(on_chain).max(on_chain);
        let signer = signer_id(&owner.public_keys().0);
        let stale = |keys: &EpochKeys| {
            let other = owner.token(domain, keys.epoch) != Some(keys.token);
            keys.domain != domain || keys.epoch < newest || keys.signer != signer || other
        };
        if owner.sealing().is_none_or(|keys| stale(&keys)) {
            owner.seal_under(domain, newest)?;
        }
        self.foresee_expiry(owner, network, None)?;
        self.hub.changed(Part::Identity);
        Ok(())
    }

    /// Whether the chain may have keys that an open profile lacks, and was not asked for them since its newest event.
    pub(in crate::site) fn has_news(&self, owner: &Owner, network: &Network) -> bool {
        if network.directory.epoch(owner.address) == 0 {
            return false;
        }
        match self.missing.all().get(&owner.profile) {
            Some(lack) => lack.seen != network.directory.newest(),
            None => !recovery::holds_current(network, owner),
        }
    }

    fn fetch_missing(&self, owner: &Owner, network: &Network) -> Result<(), Failure> {
        let lacking = block_in_place(|| recovery::lacking(&self.plant, network, owner))?;
        if !lacking.is_empty() {
            let still = block_in_place(|| recovery::recover_epochs(&self.plant, network, owner, &lacking))?;
            let fetched = lacking.len() - still.len();
            if fetched > 0 {
                let profile = &owner.profile;
                let text =
                    format!("the chain returned the keys of {fetched} epochs that the keyring of '{profile}' lacked");
                self.hub.notice(NoticeLevel::Info, &text);
            }
        }
        self.note_missing(owner, network)
    }

    /// Notes what the keyring lacks now, and tells it once.
    pub(super) fn note_missing(&self, owner: &Owner, network: &Network) -> Result<(), Failure> {
        // Read before: an event that comes meanwhile is news.
        let seen = network.directory.newest();
        let epochs = block_in_place(|| recovery::lacking(&self.plant, network, owner))?;
        let mut all = self.missing.all();
        if epochs.is_empty() {
            all.remove(&owner.profile);
            return Ok(());
        }
        let lack = Lack { current: !recovery::holds_current(network, owner), epochs, seen };
        let text = lack.text(&owner.profile);
        let before = all.insert(owner.profile.clone(), lack);
        drop(all);
        if before.is_none_or(|before| before.text(&owner.profile) != text) {
            self.hub.notice(NoticeLevel::Error, &text);
            self.hub.changed(Part::Health);
        }
        Ok(())
    }

    /// Notes why a profile lacks newer SM2 pairs that the chain has; `None` if it has them.
    pub(in crate::site) fn note_pairs(&self, owner: &Owner, why: Option<String>) {
        let mut pairs = self.missing.pairs();
        match why {
            Some(why) => {
                self.hub.notice(NoticeLevel::Error, &why);
                pairs.insert(owner.profile.clone(), why);
            }
            None => drop(pairs.remove(&owner.profile)),
        }
    }

    /// Whether the chain has an earlier epoch than it had before, as an older copy or a node that is behind does. A reader
    /// revoked since may stand in it again, so nothing is wrapped for anyone until the owner has looked.
    pub(in crate::site) fn went_back(&self, owner: &Owner, network: &Network) -> bool {
        let (chain, seen) = (network.directory.epoch(owner.address), owner.confirmed_epoch(network.domain));
        let mut back = self.missing.back();
        if chain >= seen {
            if back.remove(&owner.profile).is_some() {
                self.hub.changed(Part::Health);
            }
            return false;
        }
        let text = format!(
            "the chain has epoch {chain} of '{}' and had epoch {seen} before: it is an older copy, in which a reader \
             revoked since may have a grant again; look at `authros grants list`, revoke as before, then run \
             `authros keys rotate`",
            owner.profile
        );
        if back.insert(owner.profile.clone(), text.clone()).is_none() {
            self.hub.notice(NoticeLevel::Error, &text);
            self.hub.changed(Part::Health);
        }
        true
    }

    /// What open profiles lack, in words; `None` if they have all keys.
    pub(in crate::site) fn missing_text(&self) -> Option<String> {
        let mut texts: Vec<String> = self.missing.pairs().values().cloned().collect();
        texts.extend(self.missing.back().values().cloned());
        texts.extend(self.missing.all().iter().map(|(profile, lack)| lack.text(profile)));
        (!texts.is_empty()).then(|| texts.join("; "))
    }
}

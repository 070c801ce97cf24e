//! The gateways of the site that this one joins, in order: the chain comes through the one that knows the newest block, the
//! records from all of them.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use tokio::task::JoinSet;
use tokio::time::{Instant, timeout_at};

use super::Joined;
use super::remote::{Progress, Remote};
use crate::chain::{Chain, ChainOptions, Endpoint, Pin, Relay, RelayLine};
use crate::config::RemoteSite;
use crate::crypto::Provider;
use crate::gateway::{ChainLine, ChainLines, GatewayError, GrantNotice, KeptTrust, NetworkName, RevokeNotice};
use crate::model::{Address, ErrorKind, ProfileName, clean};
use crate::paths::Home;
use crate::pipeline::{Network, Owner};
use crate::service::event::NoticeLevel;
use crate::service::failure::refused;
use crate::service::reply::Failure;
use crate::site::chain::connection::Lost;

/// How long a command waits until the gateways' records are here.
pub(super) const FIRST_ROUND: Duration = Duration::from_secs(90);

/// How long it waits for the others' once those of one are.
const OTHERS: Duration = Duration::from_secs(30);

/// The gateways that this site joins; at least one.
pub(crate) struct Remotes(Vec<Arc<Remote>>);

impl Remotes {
    /// As named in the settings; nothing is sent yet.
    pub fn new(site: &RemoteSite, home: &Home, provider: &'static dyn Provider) -> Result<Self, Failure> {
        let trust = KeptTrust::open(home.gateway_trust(), site.gateway_key, site.trust_first)?;
        let mut all = vec![Arc::new(Remote::new(&site.address, None, trust, provider))];
        for further in &site.also {
            let trust = KeptTrust::open(home.gateway_trust_of(&further.key), Some(further.key), false)?;
            all.push(Arc::new(Remote::new(&further.address, Some(further.key), trust, provider)));
        }
        Ok(Self(all))
    }

    /// The gateways, in order.
    pub fn all(&self) -> &[Arc<Remote>] {
        &self.0
    }

    /// Their addresses, for people.
    pub(super) fn addresses(&self) -> String {
        let addresses: Vec<&str> = self.0.iter().map(|remote| remote.address()).collect();
        addresses.join(", ")
    }

    /// Where the chain comes from, in words.
    pub fn chain_text(&self) -> String {
        match self.0.len() {
            1 => format!("as reported by the gateway {}, not by your own node", self.addresses()),
            _ => format!("as reported by one of the gateways {}, not by your own node", self.addresses()),
        }
    }

    /// The network of the first gateway that says it.
    async fn inquire(&self) -> Result<NetworkName, GatewayError> {
        let mut failed = GatewayError::Closed;
        for remote in &self.0 {
            match remote.inquire().await {
                Ok(named) => return Ok(named),
                Err(error) => failed = error,
            }
        }
        Err(failed)
    }

    /// The place of the first gateway that answers.
    async fn meet(lines: &[Arc<ChainLine>]) -> Result<usize, GatewayError> {
        let mut failed = None;
        for (place, line) in lines.iter().enumerate() {
            match line.meet().await {
                Ok(_) => return Ok(place),
                Err(error) => failed = failed.or(Some(error)),
            }
        }
        Err(failed.unwrap_or(GatewayError::Closed))
    }

    /// The chain behind the gateways; it must be the pinned one if there is a pin.
    ///
    /// # Errors
    /// If no gateway answers, or its chain does not, or is a different one.
    pub async fn chain(
        &self,
        pinned: Option<Pin>,
        contract: Option<Address>,
        confirmations: u64,
    ) -> Result<Chain, Lost> {
        let named = match &pinned {
            Some(pin) => NetworkName { chain_id: pin.chain_id, genesis: pin.genesis, contract: pin.contract },
            None => self.inquire().await.map_err(Failure::from)?,
        };
        let lines = self.0.iter().map(|remote| remote.line(named.domain())).collect::<Result<Vec<_>, _>>()?;
        let place = Self::meet(&lines).await.map_err(Failure::from)?;
        let contract = Some(contract.unwrap_or(named.contract));
        let lines = lines.into_iter().map(|line| line as Arc<dyn Relay>).collect();
        let endpoint = Endpoint::Relay(RelayLine(Arc::new(ChainLines::new(lines, place))));
        let chain = Chain::connect(ChainOptions { endpoint, contract, pinned, confirmations }).await?;
        if (chain.chain_id(), chain.genesis()) != (named.chain_id, named.genesis) {
            let what = "forwards a different chain than its own; do not continue, ask its operator to explain";
            let address = self.0.get(place).map_or_else(String::new, |remote| remote.address().to_owned());
            return Err(refused(format!("the gateway {address} {what}")).into());
        }
        Ok(chain)
    }

    /// Waits until the mirror of one gateway has caught up for a profile, or failed; nothing if it has been behind for too
    /// long.
    pub(super) async fn settled(remote: &Remote, profile: &ProfileName) -> Option<Result<(), Failure>> {
        let mut progress = remote.follow();
        let begun = progress.borrow().get(profile).cloned().unwrap_or_default();
        let patience = FIRST_ROUND.saturating_sub(begun.behind_since.map_or(Duration::ZERO, |since| since.elapsed()));
        let is_settled =
            |one: &Progress| one.settled > begun.settled || (one.settled > 0 && one.behind_since.is_none());
        let settled = progress.wait_for(|all| all.get(profile).is_some_and(is_settled));
        let all = tokio::time::timeout(patience, settled).await.ok()?.ok()?;
        all.get(profile)?.last.clone()
    }
}

impl Joined {
    /// Waits until the gateways' records for a profile are here; returns at once if this site joins none. Of several
    /// gateways one that answers is enough: the others' records come when those are back. The addresses of those whose
    /// records are still arriving: whoever never comes to an end does not keep the others' records back.
    ///
    /// # Errors
    /// Why the last attempt failed, or that none is at its end.
    pub(in crate::site) async fn caught_up(&self, profile: &ProfileName) -> Result<Vec<String>, Failure> {
        self.waited_for(profile, OTHERS).await
    }

    /// How long the others are waited for once one has caught up is said by `others`.
    async fn waited_for(&self, profile: &ProfileName, others: Duration) -> Result<Vec<String>, Failure> {
        let Some(remotes) = &self.remotes else { return Ok(Vec::new()) };
        self.link.network().await?;
        let mut waits = JoinSet::new();
        for (place, remote) in remotes.all().iter().enumerate() {
            let (remote, profile) = (Arc::clone(remote), profile.clone());
            waits.spawn(async move { (place, Remotes::settled(&remote, &profile).await) });
        }
        let (mut caught, mut failed, mut until) = (false, None, Instant::now() + FIRST_ROUND);
        let mut settled = BTreeSet::new();
        while let Ok(Some(Ok((place, end)))) = timeout_at(until, waits.join_next()).await {
            match end {
                Some(Ok(())) => {
                    caught = true;
                    until = until.min(Instant::now() + others);
                }
                Some(Err(failure)) => failed = failed.or(Some(failure)),
                None => continue,
            }
            settled.insert(place);
        }
        let of = remotes.all().iter().enumerate().filter(|(place, _)| !settled.contains(place));
        let arriving: Vec<String> = of.map(|(_, remote)| clean(remote.address(), 255)).collect();
        match (caught, arriving.first()) {
            (true, _) => Ok(arriving),
            (false, Some(address)) => Err(still_arriving(address)),
            (false, None) => failed.map_or(Ok(arriving), Err),
        }
    }

    /// Like [`Self::caught_up`], for what has to be whole.
    ///
    /// # Errors
    /// See there; and if records of any gateway are still arriving.
    pub(in crate::site) async fn all_caught_up(&self, profile: &ProfileName) -> Result<(), Failure> {
        let arriving = self.waited_for(profile, FIRST_ROUND).await?;
        arriving.first().map_or(Ok(()), |address| Err(still_arriving(address)))
    }

    /// Tells the gateways of a grant, so that they need not wait for the chain.
    pub(in crate::site) async fn tell_of_grant(&self, owner: &Owner, network: &Network, notice: GrantNotice) {
        for remote in self.remotes.iter().flat_map(|remotes| remotes.all()) {
            let told =
                async { remote.connect(&self.home, owner, network).await?.grant(&owner.signing(), notice).await };
            self.warn_untold(told.await.err());
        }
    }

    /// Tells the gateways of a revoke, so that they obey at once.
    pub(in crate::site) async fn tell_of_revoke(&self, owner: &Owner, network: &Network, notice: RevokeNotice) {
        for remote in self.remotes.iter().flat_map(|remotes| remotes.all()) {
            let told =
                async { remote.connect(&self.home, owner, network).await?.revoke(&owner.signing(), notice).await };
            self.warn_untold(told.await.err());
        }
    }

    fn warn_untold(&self, error: Option<GatewayError>) {
        if let Some(error) = error {
            let text = format!("a gateway could not be told and will learn of it from the chain: {error}");
            self.hub.notice(NoticeLevel::Warning, &text);
        }
    }
}

/// Not all that a gateway has is here.
fn still_arriving(address: &str) -> Failure {
    let text = format!(
        "the records of the gateway {address} are still arriving; try again in a moment, or take it out of the gateways \
         that this home joins"
    );
    Failure::new(ErrorKind::Incomplete, text)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used, reason = "a test fails by panicking")]

    use std::time::Instant;

    use super::super::remote::Mirrored;
    use super::*;
    use crate::crypto::{ProviderName, provider};

    fn remote(folder: &tempfile::TempDir) -> Remote {
        let trust = KeptTrust::open(folder.path().join("trust"), None, true).expect("a note");
        Remote::new("127.0.0.1:1", None, trust, provider(ProviderName::RustCrypto))
    }

    #[tokio::test]
    async fn a_gateway_that_lets_a_mirror_catch_up_for_moments_only_keeps_nobody_waiting() {
        let folder = tempfile::tempdir().expect("a folder");
        let (remote, profile) = (Arc::new(remote(&folder)), "bob".parse::<ProfileName>().expect("a name"));
        remote.note(&profile, Mirrored::Behind);
        let waiting = {
            let (remote, profile) = (Arc::clone(&remote), profile.clone());
            tokio::spawn(async move { Remotes::settled(&remote, &profile).await })
        };
        tokio::task::yield_now().await;
        // The one who waits is on one thread with this, and sees only what is last.
        remote.note(&profile, Mirrored::Caught);
        remote.note(&profile, Mirrored::Behind);
        assert_eq!(waiting.await.expect("no panic"), Some(Ok(())));

        remote.note(&profile, Mirrored::Failed(refused("no")));
        let failed = Remotes::settled(&remote, &profile).await;
        assert!(matches!(failed, Some(Err(failure)) if failure.message == "no"), "as it stands");
    }

    #[tokio::test]
    async fn a_gateway_that_never_comes_to_an_end_is_waited_for_once() {
        let folder = tempfile::tempdir().expect("a folder");
        let (remote, profile) = (remote(&folder), "bob".parse::<ProfileName>().expect("a name"));
        remote.note(&profile, Mirrored::Caught);
        remote.note(&profile, Mirrored::Behind);
        remote.note(&profile, Mirrored::Behind);
        let begun = Instant::now();
        let short = tokio::time::timeout(Duration::from_millis(50), Remotes::settled(&remote, &profile)).await;
        assert!(short.is_err(), "it may come to its end yet");
        remote.set_behind_since(&profile, begun.checked_sub(FIRST_ROUND).expect("a machine up for longer"));
        assert_eq!(Remotes::settled(&remote, &profile).await, None);
    }
}

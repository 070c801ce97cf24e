//! The gateway of the site that this one joins: source of records, and of the chain, on that operator's word.
//! Signatures and digests are still checked here.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use tokio::sync::watch;
use tokio::task::block_in_place;

use crate::chain::{Chain, ChainOptions, Endpoint, Pin, Relay, RelayLine};
use crate::config::RemoteSite;
use crate::crypto::transport_file::{TransportUse, load_transport_key, save_transport_key};
use crate::crypto::{Provider, TransportKey};
use crate::gateway::{
    Applicant, ChainLine, Client, Code, Context, Credentials, Endpoint as GatewayEndpoint, GatewayError, GrantNotice,
    KeptTrust, NetworkName, RevokeNotice,
};
use crate::model::{Address, Domain, ErrorKind, ProfileName, SignerId, clean, locked};
use crate::paths::Home;
use crate::pipeline::{Network, Owner};
use crate::reply::{Failure, Result, internal, refused};
use crate::site::Joined;
use crate::site::chain::connection::Lost;
use crate::site::identity::Owners;

const PATIENCE: Duration = Duration::from_secs(20);
/// Longest wait of a command for the gateway's records.
pub(in crate::site) const FIRST_ROUND: Duration = Duration::from_secs(90);
/// Longest wait of a list that can show a part.
pub(in crate::site) const LISTING: Duration = Duration::from_millis(1_500);

/// Where visitors have no room: how long a home with a transport key waits to be unlocked, and how often it checks.
const UNLOCKING: Duration = Duration::from_secs(10);
const LOOKING: Duration = Duration::from_millis(100);

/// A mirror lacks records that the gateway lists and does not give.
#[derive(Debug, Clone)]
pub(in crate::site) enum Mirrored {
    Behind,
    Caught { lacks: bool },
    Failed(Failure),
}

#[derive(Debug, Clone, Default)]
struct Progress {
    /// `None` once it has caught up or failed.
    behind_since: Option<Instant>,
    /// Times it caught up or failed: a gateway that never ends lets it catch up for moments.
    settled: u64,
    /// End of the last attempt; `true` if records are listed but not given.
    last: Option<Result<bool>>,
}

impl Progress {
    fn note(&mut self, mirrored: Mirrored) {
        let ended = match mirrored {
            Mirrored::Behind => {
                self.behind_since.get_or_insert_with(Instant::now);
                return;
            }
            Mirrored::Caught { lacks } => Ok(lacks),
            Mirrored::Failed(failure) => Err(failure),
        };
        *self = Self { behind_since: None, settled: self.settled + 1, last: Some(ended) };
    }
}

pub(crate) struct Remote {
    addresses: Vec<String>,
    provider: &'static dyn Provider,
    trust: Arc<KeptTrust>,
    line: Mutex<Option<Arc<ChainLine>>>,
    mirrored: watch::Sender<BTreeMap<ProfileName, Progress>>,
}

impl Remote {
    /// As set; sends nothing yet.
    pub fn new(site: &RemoteSite, home: &Home, provider: &'static dyn Provider) -> Result<Self> {
        let trust = KeptTrust::open(home.gateway_trust(), site.gateway_key, site.trust_first)?;
        Ok(Self::trusting(site.addresses.clone(), trust, provider))
    }

    fn trusting(addresses: Vec<String>, trust: KeptTrust, provider: &'static dyn Provider) -> Self {
        let (trust, mirrored) = (Arc::new(trust), watch::channel(BTreeMap::new()).0);
        Self { addresses, provider, trust, line: Mutex::default(), mirrored }
    }

    /// For people.
    pub fn address(&self) -> String {
        clean(&self.addresses.join(", "), 600)
    }

    /// For people.
    pub fn chain_text(&self) -> String {
        format!("as reported by the gateway {}, not by your own node", self.address())
    }

    fn endpoint(&self, domain: Domain) -> GatewayEndpoint {
        let context = Context { provider: self.provider, domain };
        GatewayEndpoint { addresses: self.addresses.clone(), context, patience: PATIENCE, source: None }
    }

    fn line(&self, domain: Domain) -> Result<Arc<ChainLine>> {
        let mut slot = locked(&self.line);
        if let Some(line) = slot.as_ref().filter(|line| line.endpoint().context.domain == domain) {
            return Ok(Arc::clone(line));
        }
        let visitor = "visitor".parse().map_err(|_| internal("the name of visitors"))?;
        let line = Arc::new(ChainLine::new(self.endpoint(domain), Arc::clone(&self.trust), visitor));
        *slot = Some(Arc::clone(&line));
        Ok(line)
    }

    /// The chain behind the gateway, which must be the pinned one, if any.
    pub async fn chain(
        &self,
        (home, owners): (&Home, &Owners),
        pinned: Option<Pin>,
        contract: Option<Address>,
    ) -> Result<Chain, Lost> {
        let named = match &pinned {
            Some(pin) => NetworkName { chain_id: pin.chain_id, genesis: pin.genesis, contract: pin.contract },
            None => Client::inquire(&self.addresses, PATIENCE).await.map_err(Failure::from)?,
        };
        let line = self.line(named.domain())?;
        self.meet(&line, home, owners).await.map_err(Failure::from)?;
        let contract = Some(contract.unwrap_or(named.contract));
        let endpoint = Endpoint::Relay(RelayLine(line as Arc<dyn Relay>));
        let chain = Chain::connect(ChainOptions { endpoint, contract, pinned }).await?;
        if (chain.chain_id(), chain.genesis()) != (named.chain_id, named.genesis) {
            let what = "forwards a different chain than its own; do not continue, ask its operator to explain";
            return Err(refused(format!("the gateway {} {what}", self.address())).into());
        }
        Ok(chain)
    }

    /// Begins with the transport key of an unlocked profile. If profiles have one but none is unlocked, a visit will
    /// do; if visitors have no room, waits for the owner.
    async fn meet(&self, line: &ChainLine, home: &Home, owners: &Owners) -> Result<(), GatewayError> {
        let domain = line.endpoint().context.domain;
        let prove = || {
            let known = block_in_place(|| owners.all().iter().find_map(|owner| self.kept(home, owner, domain)));
            known.map(|credentials| line.prove_by(credentials)).is_some()
        };
        let proven = prove();
        line.meet().await?;
        let has_key = || home.profiles().iter().any(|profile| home.transport_key(profile).exists());
        if proven || !has_key() {
            return Ok(());
        }
        let full = |error: &GatewayError| {
            matches!(error, GatewayError::Refused(Code::Busy) | GatewayError::RefusedInClear(Code::Busy))
        };
        // The next request to the chain reports any other failure.
        if line.probe().await.is_err_and(|error| full(&error)) {
            let begun = Instant::now();
            while begun.elapsed() < UNLOCKING && !prove() {
                tokio::time::sleep(LOOKING).await;
            }
        }
        Ok(())
    }

    /// A profile's credentials as kept here; `None` if it is locked or has none for this gateway.
    fn kept(&self, home: &Home, owner: &Owner, domain: Domain) -> Option<Credentials> {
        if owner.is_locked() {
            return None;
        }
        let (gateway, token) = (self.trust.current().pinned?, owner.current_token(domain)?);
        let usage = TransportUse { domain: &domain, gateway: &gateway, name: &owner.profile };
        let secret = owner.envelope().secret;
        let kept = load_transport_key(&home.transport_key(&owner.profile), self.provider, &secret, usage);
        // `connect` reports an unreadable key.
        let key = kept.ok().flatten()?;
        Some(Credentials { name: owner.profile.clone(), key, token })
    }

    /// The account that registered the gateway's identity key.
    pub fn keeper(&self, network: &Network) -> Result<Address> {
        let gateway = self.gateway()?;
        network.directory.registered_as(gateway).ok_or_else(|| {
            refused(format!(
                "the gateway {} is not registered on the chain it presents: no account has its key {gateway}; ask its \
                 operator, and compare the fingerprint",
                self.address()
            ))
        })
    }

    fn gateway(&self) -> Result<SignerId> {
        let pinned = self.trust.current().pinned;
        pinned.ok_or_else(|| Failure::new(ErrorKind::Unreachable, "no gateway has been contacted yet"))
    }

    /// A session in the owner's name; allocates a transport key if none is accepted.
    pub async fn connect(&self, home: &Home, owner: &Owner, network: &Network) -> Result<Client, GatewayError> {
        let (path, gateway) = (home.transport_key(&owner.profile), self.trust.current().pinned);
        let endpoint = self.endpoint(network.domain);
        let unmet = GatewayError::Unexpected("no gateway has been contacted yet");
        let usage = TransportUse { domain: &network.domain, gateway: &gateway.ok_or(unmet)?, name: &owner.profile };
        let secret = owner.envelope().secret;
        let known = block_in_place(|| load_transport_key(&path, self.provider, &secret, usage))?;
        // The chain's word, not the keyring's: a session needs no epoch key.
        let token = network.directory.account(owner.address).and_then(|account| account.token);
        let token = token.ok_or(GatewayError::Unexpected("no token of the epoch"))?;
        let credentials = |key| Credentials { name: owner.profile.clone(), key, token };
        if let Some(key) = known {
            match self.open(&endpoint, credentials(key)).await {
                // In clear: there is no common key. The allocation proves itself.
                Err(GatewayError::RefusedInClear(Code::Tag)) => {}
                opened => return opened,
            }
        }
        let key = self.allocate(&endpoint, owner).await?;
        block_in_place(|| save_transport_key(&path, self.provider, &secret, usage, &key))?;
        self.open(&endpoint, credentials(key)).await
    }

    async fn open(&self, endpoint: &GatewayEndpoint, credentials: Credentials) -> Result<Client, GatewayError> {
        let mut trust = self.trust.current();
        let client = Client::connect(endpoint, &mut trust, &credentials).await?;
        self.trust.learn(&trust)?;
        if let Some(line) = locked(&self.line).as_ref() {
            line.prove_by(credentials);
        }
        Ok(client)
    }

    async fn allocate(&self, endpoint: &GatewayEndpoint, owner: &Owner) -> Result<TransportKey, GatewayError> {
        let (signing, account) = (owner.signing(), owner.eoa());
        let (_, envelope) = owner.public_keys();
        let applicant = Applicant { name: &owner.profile, signing: &signing, envelope, account: &account };
        let mut trust = self.trust.current();
        let (key, _) = Client::allocate(endpoint, &mut trust, &applicant).await?;
        self.trust.learn(&trust)?;
        Ok(key)
    }

    /// The gateway is not asked for a profile now, so the wait does not count against it.
    pub fn not_asked(&self, profile: &ProfileName) {
        self.mirrored.send_if_modified(|all| {
            if let Some(since) = all.get_mut(profile).and_then(|one| one.behind_since.as_mut()) {
                *since = Instant::now();
            }
            false
        });
    }

    fn still_arriving(&self) -> String {
        format!("the records of the gateway {} are still arriving", self.address())
    }

    pub fn note(&self, profile: &ProfileName, mirrored: Mirrored) {
        self.mirrored.send_modify(|all| {
            all.entry(profile.clone()).or_default().note(mirrored);
        });
    }

    /// Waits until a profile's mirror has caught up or failed; `None` after `most`, or if it has been behind for too
    /// long.
    async fn settled(&self, profile: &ProfileName, most: Duration) -> Option<Result<bool>> {
        let mut progress = self.mirrored.subscribe();
        let begun = progress.borrow().get(profile).cloned().unwrap_or_default();
        let patience = FIRST_ROUND.saturating_sub(begun.behind_since.map_or(Duration::ZERO, |since| since.elapsed()));
        let patience = patience.min(most);
        let is_settled =
            |one: &Progress| one.settled > begun.settled || (one.settled > 0 && one.behind_since.is_none());
        let settled = progress.wait_for(|all| all.get(profile).is_some_and(is_settled));
        let all = tokio::time::timeout(patience, settled).await.ok()?.ok()?;
        all.get(profile)?.last.clone()
    }
}

impl Joined {
    /// Waits until the gateway's records for a profile are here; returns immediately if this site joins none.
    pub async fn caught_up(&self, profile: &ProfileName) -> Result<()> {
        match self.settled(profile, FIRST_ROUND).await? {
            Ok(_) => Ok(()),
            Err(text) => Err(Failure::new(ErrorKind::Incomplete, format!("{text}; try again in a few seconds"))),
        }
    }

    /// Whether the gateway lists records that it does not give; if more is still arriving after this long, a text.
    async fn settled(&self, profile: &ProfileName, most: Duration) -> Result<Result<bool, String>> {
        let Some(remote) = self.remote.as_ref().filter(|_| self.parts.home.original().is_none()) else {
            return Ok(Ok(false));
        };
        self.parts.link.network().await?;
        remote.settled(profile, most).await.transpose().map(|lacks| lacks.ok_or_else(|| remote.still_arriving()))
    }

    /// The same for a list, which shows what is here: what is missing, in words.
    pub async fn arriving(&self, profile: &ProfileName, most: Duration) -> Result<Option<String>> {
        Ok(match self.settled(profile, most).await? {
            Ok(lacks) => lacks.then(|| {
                "the gateway lists records that it does not return yet, or whose keys are not here yet; they are \
                 fetched automatically once available"
                    .to_owned()
            }),
            Err(text) => Some(text),
        })
    }

    /// Words for an incomplete list; `None` if this site joins no gateway.
    pub fn still_arriving(&self) -> Option<String> {
        self.remote.as_ref().map(|remote| remote.still_arriving())
    }

    /// Reports a grant to the gateway before the chain does.
    pub async fn tell_of_grant(&self, owner: &Owner, network: &Network, notice: GrantNotice) {
        if let Some(remote) = &self.remote {
            let told =
                async { remote.connect(&self.parts.home, owner, network).await?.grant(&owner.signing(), notice).await };
            self.warn_untold(told.await.err());
        }
    }

    /// Reports a revoke to the gateway, which obeys immediately.
    pub async fn tell_of_revoke(&self, owner: &Owner, network: &Network, notice: RevokeNotice) {
        if let Some(remote) = &self.remote {
            let told = async {
                remote.connect(&self.parts.home, owner, network).await?.revoke(&owner.signing(), notice).await
            };
            self.warn_untold(told.await.err());
        }
    }

    fn warn_untold(&self, error: Option<GatewayError>) {
        if let Some(error) = error {
            self.parts.hub.warn(&format!(
                "the gateway could not be notified; it will learn of it from the chain: \
                                          {error}"
            ));
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used, reason = "a test fails by panicking")]

    use super::*;
    use crate::crypto::{ProviderName, provider};

    fn remote(folder: &tempfile::TempDir) -> Remote {
        let trust = KeptTrust::open(folder.path().join("trust"), None, true).expect("a note");
        Remote::trusting(vec!["127.0.0.1:1".to_owned()], trust, provider(ProviderName::RustCrypto))
    }

    #[tokio::test]
    async fn a_gateway_that_lets_a_mirror_catch_up_for_moments_only_keeps_nobody_waiting() {
        let folder = tempfile::tempdir().expect("a folder");
        let (remote, profile) = (Arc::new(remote(&folder)), "bob".parse::<ProfileName>().expect("a name"));
        remote.note(&profile, Mirrored::Behind);
        let waiting = {
            let (remote, profile) = (Arc::clone(&remote), profile.clone());
            tokio::spawn(async move { remote.settled(&profile, FIRST_ROUND).await })
        };
        tokio::task::yield_now().await;
        // The one who waits is on one thread with this, and sees only what is last.
        remote.note(&profile, Mirrored::Caught { lacks: false });
        remote.note(&profile, Mirrored::Behind);
        assert_eq!(waiting.await.expect("no panic"), Some(Ok(false)));

        remote.note(&profile, Mirrored::Failed(refused("no")));
        let failed = remote.settled(&profile, FIRST_ROUND).await;
        assert!(matches!(failed, Some(Err(failure)) if failure.message == "no"), "as it stands");
    }

    #[tokio::test]
    async fn a_gateway_that_never_comes_to_an_end_is_waited_for_once() {
        let folder = tempfile::tempdir().expect("a folder");
        let (remote, profile) = (remote(&folder), "bob".parse::<ProfileName>().expect("a name"));
        remote.note(&profile, Mirrored::Caught { lacks: false });
        remote.note(&profile, Mirrored::Behind);
        remote.note(&profile, Mirrored::Behind);
        let begun = Instant::now();
        assert_eq!(
            remote.settled(&profile, Duration::from_millis(20)).await,
            None,
            "a list waits for as long as it says"
        );
        let short = tokio::time::timeout(Duration::from_millis(50), remote.settled(&profile, FIRST_ROUND)).await;
        assert!(short.is_err(), "it may come to its end yet");
        let long_ago = begun.checked_sub(FIRST_ROUND).expect("a machine up for longer");
        remote.mirrored.send_modify(|all| all.entry(profile.clone()).or_default().behind_since = Some(long_ago));
        assert_eq!(remote.settled(&profile, FIRST_ROUND).await, None);
    }
}

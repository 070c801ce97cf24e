//! A site that joins another one through its gateway: the chain and the records come from there, and that operator's
//! word has to be trusted for the chain. What follows from signatures and digests is still checked here.

use super::Joined;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::watch;
use tokio::task::block_in_place;

use crate::chain::{Chain, ChainOptions, Endpoint, Pin, RelayLine};
use crate::config::RemoteSite;
use crate::crypto::transport_file::{TransportUse, load_transport_key, save_transport_key};
use crate::crypto::{Provider, TransportKey};
use crate::gateway::{
    Applicant, ChainLine, Client, Context, Credentials, Endpoint as GatewayEndpoint, GatewayError, GrantNotice,
    KeptTrust, NetworkName, RevokeNotice,
};
use crate::model::{Address, Domain, ErrorKind, ProfileName, SignerId};
use crate::paths::Home;
use crate::pipeline::{Network, Owner};
use crate::service::event::NoticeLevel;
use crate::service::failure::{internal, refused};
use crate::service::reply::Failure;
use crate::site::chain::connection::Lost;

/// How long a gateway may take to answer.
const PATIENCE: Duration = Duration::from_secs(20);
/// How long a command waits until the gateway's records are here.
const FIRST_ROUND: Duration = Duration::from_secs(90);

/// The progress of a profile's mirror.
#[derive(Debug, Clone)]
pub(in crate::site) enum Mirrored {
    /// It has not caught up yet.
    Behind,
    /// It has everything that the gateway gives it.
    Caught,
    /// The last attempt failed; another follows.
    Failed(Failure),
}

/// The link to the gateway.
pub(crate) struct Remote {
    address: String,
    provider: &'static dyn Provider,
    trust: Arc<KeptTrust>,
    line: Mutex<Option<Arc<ChainLine>>>,
    mirrored: watch::Sender<BTreeMap<ProfileName, Mirrored>>,
}

impl Remote {
    /// As named in the settings; nothing is sent yet.
    pub fn new(site: &RemoteSite, home: &Home, provider: &'static dyn Provider) -> Result<Self, Failure> {
        let trust = KeptTrust::open(home.gateway_trust(), site.gateway_key, site.trust_first)?;
        Ok(Self {
            address: site.address.clone(),
            provider,
            trust: Arc::new(trust),
            line: Mutex::default(),
            mirrored: watch::channel(BTreeMap::new()).0,
        })
    }

    /// Where the chain comes from, in words.
    pub fn chain_text(&self) -> String {
        format!("as reported by the gateway {}, not by your own node", self.address)
    }

    fn endpoint(&self, domain: Domain) -> GatewayEndpoint {
        let context = Context { provider: self.provider, domain };
        GatewayEndpoint { address: self.address.clone(), context, patience: PATIENCE }
    }

    fn line(&self, domain: Domain) -> Result<Arc<ChainLine>, Failure> {
        let mut slot = self.line.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(line) = slot.as_ref().filter(|line| line.endpoint().context.domain == domain) {
            return Ok(Arc::clone(line));
        }
        let visitor = "visitor".parse().map_err(|_| internal("the name of visitors"))?;
        let line = Arc::new(ChainLine::new(self.endpoint(domain), Arc::clone(&self.trust), visitor));
        *slot = Some(Arc::clone(&line));
        Ok(line)
    }

    /// The chain behind the gateway; it must be the pinned one if there is a pin.
    ///
    /// # Errors
    /// If the gateway or its chain does not answer, or is a different one.
    pub async fn chain(
        &self,
        pinned: Option<Pin>,
        contract: Option<Address>,
        confirmations: u64,
    ) -> Result<Chain, Lost> {
        let named = match &pinned {
            Some(pin) => NetworkName { chain_id: pin.chain_id, genesis: pin.genesis, contract: pin.contract },
            None => Client::inquire(&self.address, PATIENCE).await.map_err(Failure::from)?,
        };
        let line = self.line(named.domain())?;
        line.meet().await.map_err(Failure::from)?;
        let contract = Some(contract.unwrap_or(named.contract));
        let endpoint = Endpoint::Relay(RelayLine(line));
        let chain = Chain::connect(ChainOptions { endpoint, contract, pinned, confirmations }).await?;
        if (chain.chain_id(), chain.genesis()) != (named.chain_id, named.genesis) {
            let what = "forwards a different chain than its own; do not continue, ask its operator to explain";
            return Err(refused(format!("the gateway {} {what}", self.address)).into());
        }
        Ok(chain)
    }

    /// The account that registered the gateway's identity key.
    pub fn keeper(&self, network: &Network) -> Result<Address, Failure> {
        let gateway = self.gateway()?;
        network.directory.registered_as(gateway).ok_or_else(|| {
            refused(format!(
                "the gateway {} is not registered on the chain it presents: no account has its key {gateway}; ask its \
                 operator, and compare the fingerprint",
                self.address
            ))
        })
    }

    fn gateway(&self) -> Result<SignerId, Failure> {
        let pinned = self.trust.current().pinned;
        pinned.ok_or_else(|| Failure::new(ErrorKind::Unreachable, "no gateway has been contacted yet"))
    }

    fn token(owner: &Owner, network: &Network) -> Result<crate::model::Token, Failure> {
        let epoch = network.directory.epoch(owner.address);
        owner.token(network.domain, epoch).ok_or_else(|| refused("the keyring lacks the key of the current epoch"))
    }

    /// A session in the owner's name; allocates the transport key if there is none, or none that is accepted.
    pub async fn connect(&self, home: &Home, owner: &Owner, network: &Network) -> Result<Client, GatewayError> {
        let (path, gateway) = (home.transport_key(&owner.profile), self.trust.current().pinned);
        let endpoint = self.endpoint(network.domain);
        let unmet = GatewayError::Unexpected("no gateway has been contacted yet");
        let usage = TransportUse { domain: &network.domain, gateway: &gateway.ok_or(unmet)?, name: &owner.profile };
        let secret = owner.envelope().secret;
        let known = block_in_place(|| load_transport_key(&path, self.provider, &secret, usage))?;
        let token = Self::token(owner, network).map_err(|_| GatewayError::Unexpected("no token of the epoch"))?;
        let credentials = |key| Credentials { name: owner.profile.clone(), key, token };
        if let Some(key) = known {
            match self.open(&endpoint, credentials(key)).await {
                // Sent in clear: without a common key there is no other way. The allocation proves itself.
                Err(GatewayError::RefusedInClear(crate::gateway::Code::Tag)) => {}
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
        if let Some(line) = self.line.lock().unwrap_or_else(PoisonError::into_inner).as_ref() {
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

    /// Notes the progress of a profile's mirror.
    pub fn note(&self, profile: &ProfileName, mirrored: Mirrored) {
        self.mirrored.send_modify(|all| {
            all.insert(profile.clone(), mirrored);
        });
    }
}

impl Joined {
    /// Waits until the gateway's records for a profile are here; returns at once if this site joins none.
    ///
    /// # Errors
    /// Why the last attempt failed.
    pub(in crate::site) async fn caught_up(&self, profile: &ProfileName) -> Result<(), Failure> {
        let Some(remote) = &self.remote else { return Ok(()) };
        self.link.network().await?;
        let mut mirrored = remote.mirrored.subscribe();
        let settled = mirrored.wait_for(|all| matches!(all.get(profile), Some(Mirrored::Caught | Mirrored::Failed(_))));
        match tokio::time::timeout(FIRST_ROUND, settled).await {
            Ok(Ok(all)) => match all.get(profile) {
                Some(Mirrored::Failed(failure)) => Err(failure.clone()),
                _ => Ok(()),
            },
            _ => Err(Failure::new(
                ErrorKind::Incomplete,
                format!("the records of the gateway {} are still being fetched; try again in a while", remote.address),
            )),
        }
    }

    /// Tells the gateway of a grant, so that it need not wait for the chain.
    pub(in crate::site) async fn tell_of_grant(&self, owner: &Owner, network: &Network, notice: GrantNotice) {
        let Some(remote) = &self.remote else { return };
        let told = async { remote.connect(&self.home, owner, network).await?.grant(&owner.signing(), notice).await };
        self.warn_untold(told.await.err());
    }

    /// Tells the gateway of a revoke, so that it obeys at once.
    pub(in crate::site) async fn tell_of_revoke(&self, owner: &Owner, network: &Network, notice: RevokeNotice) {
        let Some(remote) = &self.remote else { return };
        let told = async { remote.connect(&self.home, owner, network).await?.revoke(&owner.signing(), notice).await };
        self.warn_untold(told.await.err());
    }

    fn warn_untold(&self, error: Option<GatewayError>) {
        if let Some(error) = error {
            let text = format!("the gateway could not be notified and will learn of it from the chain: {error}");
            self.hub.notice(NoticeLevel::Warning, &text);
        }
    }
}

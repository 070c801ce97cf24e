//! One gateway of the site that this one joins: records come from there, and the chain may, for which that operator's
//! word has to be trusted. What follows from signatures and digests is still checked here.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::watch;
use tokio::task::block_in_place;

use crate::crypto::transport_file::{TransportUse, load_transport_key, save_transport_key};
use crate::crypto::{Provider, TransportKey};
use crate::gateway::{
    Applicant, ChainLine, Client, Context, Credentials, Endpoint as GatewayEndpoint, GatewayError, KeptTrust,
    NetworkName,
};
use crate::model::{Address, Domain, ErrorKind, ProfileName, SignerId};
use crate::paths::Home;
use crate::pipeline::{Network, Owner};
use crate::service::failure::{internal, refused};
use crate::service::reply::Failure;

/// How long a gateway may take to answer.
const PATIENCE: Duration = Duration::from_secs(20);
/// What a profile's mirror has come to.
#[derive(Debug, Clone)]
pub(in crate::site) enum Mirrored {
    /// It has not caught up yet.
    Behind,
    /// It has everything that the gateway gives it.
    Caught,
    /// The last attempt failed; another follows.
    Failed(Failure),
}

/// The progress of a profile's mirror.
#[derive(Debug, Clone, Default)]
pub(in crate::site) struct Progress {
    /// Since when it has neither caught up nor failed; nothing if that is how it stands.
    pub behind_since: Option<Instant>,
    /// How often it has caught up or failed. A gateway that ends each subscription at once lets it catch up for moments.
    pub settled: u64,
    /// The end of the last attempt.
    pub last: Option<Result<(), Failure>>,
}

impl Progress {
    fn note(&mut self, mirrored: Mirrored) {
        let ended = match mirrored {
            Mirrored::Behind => {
                self.behind_since.get_or_insert_with(Instant::now);
                return;
            }
            Mirrored::Caught => Ok(()),
            Mirrored::Failed(failure) => Err(failure),
        };
        *self = Self { behind_since: None, settled: self.settled + 1, last: Some(ended) };
    }
}

/// The link to the gateway.
pub(crate) struct Remote {
    address: String,
    /// Its key, if it is not the first gateway: what is kept of it has a name of its own.
    named: Option<SignerId>,
    provider: &'static dyn Provider,
    trust: Arc<KeptTrust>,
    line: Mutex<Option<Arc<ChainLine>>>,
    mirrored: watch::Sender<BTreeMap<ProfileName, Progress>>,
}

impl Remote {
    /// The gateway at `address`, trusted according to the note in a file; nothing is sent yet.
    pub fn new(address: &str, named: Option<SignerId>, trust: KeptTrust, provider: &'static dyn Provider) -> Self {
        Self {
            address: address.to_owned(),
            named,
            provider,
            trust: Arc::new(trust),
            line: Mutex::default(),
            mirrored: watch::channel(BTreeMap::new()).0,
        }
    }

    /// Host and port.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// Where a profile's transport key for this gateway is kept.
    pub fn transport_key(&self, home: &Home, profile: &ProfileName) -> PathBuf {
        match &self.named {
            None => home.transport_key(profile),
            Some(gateway) => home.transport_key_at(profile, gateway),
        }
    }

    /// The progress of each profile's mirror, from now on.
    pub fn follow(&self) -> watch::Receiver<BTreeMap<ProfileName, Progress>> {
        self.mirrored.subscribe()
    }

    /// The network that the gateway says it is on; nothing is proven yet.
    ///
    /// # Errors
    /// If it does not answer.
    pub async fn inquire(&self) -> Result<NetworkName, GatewayError> {
        Client::inquire(&self.address, PATIENCE).await
    }

    fn endpoint(&self, domain: Domain) -> GatewayEndpoint {
        let context = Context { provider: self.provider, domain };
        GatewayEndpoint { address: self.address.clone(), context, patience: PATIENCE }
    }

    /// The line to the chain behind it.
    pub fn line(&self, domain: Domain) -> Result<Arc<ChainLine>, Failure> {
        let mut slot = self.line.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(line) = slot.as_ref().filter(|line| line.endpoint().context.domain == domain) {
            return Ok(Arc::clone(line));
        }
        let visitor = "visitor".parse().map_err(|_| internal("the name of visitors"))?;
        let line = Arc::new(ChainLine::new(self.endpoint(domain), Arc::clone(&self.trust), visitor));
        *slot = Some(Arc::clone(&line));
        Ok(line)
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

    /// Its key, once it is pinned.
    pub fn key(&self) -> Option<SignerId> {
        self.trust.current().pinned
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
        let (path, gateway) = (self.transport_key(home, &owner.profile), self.trust.current().pinned);
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

    /// Nothing is asked of the gateway for a profile now; it is not the gateway that keeps it waiting.
    pub fn not_asked(&self, profile: &ProfileName) {
        self.mirrored.send_if_modified(|all| {
            if let Some(since) = all.get_mut(profile).and_then(|one| one.behind_since.as_mut()) {
                *since = Instant::now();
            }
            false
        });
    }

    /// As if it had been behind since then.
    #[cfg(test)]
    pub(super) fn set_behind_since(&self, profile: &ProfileName, since: Instant) {
        self.mirrored.send_modify(|all| all.entry(profile.clone()).or_default().behind_since = Some(since));
    }

    /// Notes the progress of a profile's mirror.
    pub fn note(&self, profile: &ProfileName, mirrored: Mirrored) {
        self.mirrored.send_modify(|all| {
            all.entry(profile.clone()).or_default().note(mirrored);
        });
    }
}

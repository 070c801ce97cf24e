//! A site of this process, in a home of its own: the one that holds the chain, and the gateways. A gateway can be stopped
//! and begun again at the same home and address.

use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use authros_config::Config;
use authros_config::paths::Home;
use authros_crypto::random_bytes;
use authros_model::bytes::hex;
use authros_model::{ErrorKind, RecordState, SignerId};
use authros_pipeline::Network;
use authros_service::command::{
    AddFellow, Admit, CreateIdentity, DeployContract, FleetStatus, Register, ServeChain, ServeGateway, Unlock,
};
use authros_service::failure::internal;
use authros_service::{Client, Failure, Needs, SecretText, Site};
use authros_store::{SiteLock, files};
use tokio::task::block_in_place;

/// How long a part of a site that ended may still hold its home or its port.
const PATIENCE: Duration = Duration::from_secs(20);
/// How often it is tried in between.
const PAUSE: Duration = Duration::from_millis(50);

/// Settings by name; nothing else is heeded, neither files nor environment.
pub(super) type Settings = Vec<(&'static str, String)>;

/// A running site, and a client of its only profile; what was begun through the client ends with it.
struct Running {
    site: Arc<Site>,
    client: Client,
}

impl Running {
    async fn begin(home: &Home, settings: &Settings) -> Result<Self, Failure> {
        let of = |name: &str| settings.iter().find(|(known, _)| *known == name).map(|(_, value)| value.clone());
        let config = Config::resolve(&of, &|_| None, None)?;
        files::private_directory(home.root())?;
        let begun = Instant::now();
        let lock = loop {
            if let Some(lock) = SiteLock::acquire(&home.site_lock())? {
                break lock;
            }
            if begun.elapsed() > PATIENCE {
                return Err(internal("a gateway that was stopped still holds its home; please report this"));
            }
            tokio::time::sleep(PAUSE).await;
        };
        let site = Site::start(home.clone(), config, lock, Needs { ros: false, chain: true })?;
        let client = site.client(crate::read("keeper")?);
        Ok(Self { site, client })
    }

    async fn stop(self) {
        let Self { site, client } = self;
        drop(client);
        site.stop().await;
    }
}

fn passphrase() -> Result<SecretText, Failure> {
    Ok(SecretText::new(hex(&random_bytes::<16>()?)))
}

/// The chain, served to the gateways.
pub(super) struct Ground {
    running: Running,
    /// Chain and contract.
    pub network: Network,
    /// Where it is served.
    pub url: String,
}

impl Ground {
    /// A new chain with a contract, in `directory`.
    ///
    /// # Errors
    /// If it cannot be made or served.
    pub async fn open(directory: &Path, settings: &Settings) -> Result<Self, Failure> {
        let running = Running::begin(&Home::new(directory.join("chain")), settings).await?;
        let client = &running.client;
        client.ask(CreateIdentity { passphrase: passphrase()? }).await?;
        client.ask(DeployContract { delay: None }).await?;
        let address = SocketAddr::from(([127, 0, 0, 1], 0));
        let url = client.ask(ServeChain { address }).await?.url;
        let network = running.site.network().await?;
        Ok(Self { running, network, url })
    }

    /// Ends it.
    pub async fn close(self) {
        self.running.stop().await;
    }
}

/// A gateway.
pub(super) struct Station {
    home: Home,
    settings: Settings,
    passphrase: SecretText,
    running: Option<Running>,
    /// Where it listens, also after it was begun again.
    pub address: SocketAddr,
    /// SM3 of its identity key.
    pub key: SignerId,
}

impl Station {
    /// A new one, registered and listening.
    ///
    /// # Errors
    /// If it cannot be made, or its chain does not answer.
    pub async fn open(directory: &Path, settings: Settings) -> Result<Self, Failure> {
        let (home, passphrase) = (Home::new(directory.to_owned()), passphrase()?);
        let running = Running::begin(&home, &settings).await?;
        running.client.ask(CreateIdentity { passphrase: passphrase.clone() }).await?;
        running.client.ask(Register).await?;
        let address = SocketAddr::from(([127, 0, 0, 1], 0));
        let view = running.client.ask(ServeGateway { address, open: false }).await?;
        let address = view.address.parse().map_err(|_| internal("a gateway listens at no address"))?;
        Ok(Self { home, settings, passphrase, running: Some(running), address, key: view.gateway })
    }

    fn client(&self) -> Result<&Client, Failure> {
        let running = self.running.as_ref();
        running.map(|running| &running.client).ok_or_else(|| Failure::new(ErrorKind::Internal, "a gateway is stopped"))
    }

    /// Lets an owner use it.
    ///
    /// # Errors
    /// Errors of the site.
    pub async fn admit(&self, owner: authros_model::Address) -> Result<(), Failure> {
        self.client()?.ask(Admit { owner: owner.into() }).await.map(drop)
    }

    /// Names another gateway of the fleet.
    ///
    /// # Errors
    /// Errors of the site.
    pub async fn name(&self, address: String, key: SignerId) -> Result<(), Failure> {
        self.client()?.ask(AddFellow { address, key }).await.map(drop)
    }

    /// Data records verified here, and those on their way to it.
    ///
    /// # Errors
    /// If it is stopped, or its ledger cannot be read.
    pub fn verified(&self) -> Result<(u64, u64), Failure> {
        let running = self.running.as_ref().ok_or_else(|| internal("a gateway is stopped"))?;
        let data = block_in_place(|| running.site.plant.ledger.data_by_state())?;
        let pending = data.iter().filter(|(state, _)| state.is_pending()).map(|(_, count)| count).sum();
        Ok((data.get(&RecordState::Verified).copied().unwrap_or(0), pending))
    }

    /// Records that this gateway and another one anchored, both, since it was begun.
    ///
    /// # Errors
    /// If it is stopped.
    pub async fn anchored_twice(&self) -> Result<u64, Failure> {
        let view = self.client()?.ask(FleetStatus).await?;
        Ok(view.fellows.iter().map(|fellow| fellow.anchored_twice).sum())
    }

    /// Why something does not come from other gateways now.
    ///
    /// # Errors
    /// If it is stopped.
    pub async fn problems(&self) -> Result<Vec<String>, Failure> {
        let view = self.client()?.ask(FleetStatus).await?;
        Ok(view.fellows.into_iter().filter_map(|fellow| fellow.problem).collect())
    }

    /// Stops it: its connections end, its home is closed.
    pub async fn stop(&mut self) {
        if let Some(running) = self.running.take() {
            running.stop().await;
        }
    }

    /// Begins it again where it was.
    ///
    /// # Errors
    /// If its home or its address is not free in time.
    pub async fn begin_again(&mut self) -> Result<(), Failure> {
        let running = Running::begin(&self.home, &self.settings).await?;
        running.client.ask(Unlock { passphrase: self.passphrase.clone() }).await?;
        let begun = Instant::now();
        while let Err(failure) = running.client.ask(ServeGateway { address: self.address, open: false }).await {
            if begun.elapsed() > PATIENCE {
                return Err(failure);
            }
            tokio::time::sleep(PAUSE).await;
        }
        self.running = Some(running);
        Ok(())
    }
}

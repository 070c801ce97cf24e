//! A throw-away site with one registered profile, in a directory removed with it.

use std::sync::Arc;

use tokio::task::block_in_place;

use super::before::{fill, fsync_times};
use crate::Lab;
use crate::network::Directory;
use crate::spread::Spread;
use authros_config::Config;
use authros_config::paths::Home;
use authros_crypto::random_bytes;
use authros_model::bytes::hex;
use authros_model::{ErrorKind, ProfileName};
use authros_pipeline::stages::Stages;
use authros_service::command::{CreateIdentity, Register, SiteStatus};
use authros_service::reply::SiteView;
use authros_service::reply::internal;
use authros_service::{Client, Failure, Needs, SecretText, Site};
use authros_store::{SiteLock, files};

/// The site.
pub struct Host {
    /// A client for its only profile.
    pub client: Client,
    /// Duration of an fsync on its home's disk, milliseconds.
    pub fsync: Spread,
    /// Another owner's records that were in the store before.
    pub before: u64,
    site: Arc<Site>,
    _directory: Directory,
}

impl Host {
    /// Opens it with default settings, without robots, and registers its profile. If records are to be there before, they
    /// are put into the store first, and no scrubber checks them.
    ///
    /// # Errors
    /// If nothing can be written.
    pub async fn open(lab: &Lab, before: u64) -> Result<Self, Failure> {
        let directory = Directory::new()?;
        let home = Home::new(directory.path().join("home"));
        let provider = lab.name.to_string();
        let settings = |name: &str| match name {
            "robots" => Some("0".to_owned()),
            "crypto.provider" => Some(provider.clone()),
            "audit.scrub" if before > 0 => Some("0".to_owned()),
            _ => None,
        };
        let config = Config::resolve(&settings, &|_| None, None)?;
        files::private_directory(home.root())?;
        let lock = SiteLock::acquire(&home.site_lock())?
            .ok_or_else(|| Failure::new(ErrorKind::Home, "the benchmark's own directory is in use; run it again"))?;
        let fsync = block_in_place(|| fsync_times(home.root()))?;
        if before > 0 {
            block_in_place(|| fill(&home, before))?;
        }
        let site = Site::start(home, config, lock, Needs { ros: true, chain: true })?;
        let profile: ProfileName = "bench".parse().map_err(|_| internal("a name"))?;
        let client = site.client(profile);
        let host = Self { client, fsync, before, site, _directory: directory };
        if let Err(failure) = host.register().await {
            host.close().await;
            return Err(failure);
        }
        Ok(host)
    }

    async fn register(&self) -> Result<(), Failure> {
        let passphrase = SecretText::new(hex(&random_bytes::<16>()?));
        self.client.ask(CreateIdentity { passphrase }).await?;
        self.client.ask(Register).await.map(drop)
    }

    /// The ROS master in use.
    ///
    /// # Errors
    /// If it does not answer.
    pub async fn master(&self) -> Result<String, Failure> {
        self.site.ros_uri().await
    }

    /// The line's timings.
    pub fn stages(&self) -> &Stages {
        self.site.stages()
    }

    /// Health and counts.
    ///
    /// # Errors
    /// Errors of the site.
    pub async fn status(&self) -> Result<SiteView, Failure> {
        self.client.ask(SiteStatus).await
    }

    /// Ends the site.
    pub async fn close(self) {
        self.site.stop().await;
    }
}

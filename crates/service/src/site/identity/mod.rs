//! Profiles of the home: making, opening and showing them.

mod foreseeing;
mod keys;
mod locking;
pub(super) mod owners;
mod pairs;
mod registration;
#[cfg(test)]
mod tests;

use crate::config::Config;
use crate::paths::Home;
use crate::pipeline::Plant;
use crate::pipeline::Recorder;
use crate::pipeline::Sender;
use crate::service::hub::Hub;
use crate::site::audit::Log;
use crate::site::capture::watches::Watches;
use crate::site::chain::connection::Connection;
use crate::site::chain::link::Link;
use crate::site::devices::enrolled::Enrolments;
use crate::site::gateway::Gateway;
use crate::site::identity::owners::Owners;
use crate::site::parts::Parts;
use crate::site::pins::Pinning;
use crate::site::reading::Reading;
use crate::site::sharing::Sharing;
use std::sync::Arc;
use std::time::Duration;

use super::blocking;
use crate::crypto::{Fingerprint, Keyring, Passphrase, UnlockedKeyring, read_public};
use crate::model::ProfileName;
use crate::pipeline::Owner;
use crate::service::command::SecretText;
use crate::service::event::{NoticeLevel, Part};
use crate::service::failure::refused;
use crate::service::reply::{EpochRecords, Failure, IdentityView};

/// The longest wait for the chain to tell of the identity of a locked keyring.
const LOCKED: Duration = Duration::from_secs(3);

/// The profiles of a home and their keys.
pub(in crate::site) struct Profiles {
    home: Home,
    config: Arc<Config>,
    plant: Plant,
    hub: Arc<Hub>,
    log: Arc<Log>,
    owners: Arc<Owners>,
    link: Arc<Link>,
    sender: Arc<Sender>,
    connection: Arc<Connection>,
    sharing: Arc<Sharing>,
    enrolments: Arc<Enrolments>,
    gateway: Arc<Gateway>,
    reading: Arc<Reading>,
    pins: Arc<Pinning>,
    recorder: Arc<Recorder>,
    watches: Arc<Watches>,
}

/// The parts used by profiles.
pub(in crate::site) struct Asked<'a> {
    pub connection: &'a Arc<Connection>,
    pub sharing: &'a Arc<Sharing>,
    pub enrolments: &'a Arc<Enrolments>,
    pub gateway: &'a Arc<Gateway>,
    pub reading: &'a Arc<Reading>,
    pub pins: &'a Arc<Pinning>,
    pub recorder: &'a Arc<Recorder>,
    pub watches: &'a Arc<Watches>,
}

impl Profiles {
    /// From the shared parts.
    pub fn new(parts: &Parts, asked: &Asked<'_>) -> Self {
        let Asked { connection, sharing, enrolments, gateway, reading, pins, recorder, watches } = asked;
        let Parts { home, config, plant, hub, log, owners, link, sender, .. } = parts.clone();
        Self {
            home,
            config,
            plant,
            hub,
            log,
            owners,
            link,
            sender,
            connection: Arc::clone(connection),
            sharing: Arc::clone(sharing),
            enrolments: Arc::clone(enrolments),
            gateway: Arc::clone(gateway),
            reading: Arc::clone(reading),
            pins: Arc::clone(pins),
            recorder: Arc::clone(recorder),
            watches: Arc::clone(watches),
        }
    }
}

impl Profiles {
    /// Makes keys and a keyring for a new profile, and opens it.
    pub(super) async fn create(
        self: &Arc<Self>,
        profile: ProfileName,
        secret: SecretText,
    ) -> Result<IdentityView, Failure> {
        let path = self.home.keyring(&profile);
        let _one_at_a_time = self.owners.opening(&profile).await;
        if path.exists() {
            return Err(refused(format!(
                "profile '{profile}' already exists; `authros --profile {profile} identity show` shows it"
            )));
        }
        let passphrase = Passphrase::new(secret.expose().to_owned())?;
        let unlocked = blocking(self, move |profiles| {
            let keyring = Keyring::generate(profiles.plant.provider)?;
            Ok(UnlockedKeyring::create(keyring, &path, &passphrase)?)
        })
        .await?;
        self.open(profile.clone(), unlocked);
        self.log.write(&profile, "create identity", "keys", "done").await?;
        self.view(&profile).await
    }

    /// Opens the keyring of a profile for this site.
    pub(super) async fn unlock(
        self: &Arc<Self>,
        profile: ProfileName,
        secret: SecretText,
    ) -> Result<IdentityView, Failure> {
        if self.owners.get(&profile).is_none_or(|owner| owner.is_locked()) {
            let _one_at_a_time = self.owners.opening(&profile).await;
            let path = self.home.keyring(&profile);
            let passphrase = Passphrase::new(secret.expose().to_owned())?;
            let opened = blocking(self, move |_| Ok(UnlockedKeyring::open(&path, &passphrase)?)).await;
            let outcome = if opened.is_ok() { "done" } else { "refused" };
            self.log.write(&profile, "unlock", "keyring", outcome).await?;
            // Opened by another request meanwhile, the owner keeps the keys it has.
            match self.owners.get(&profile) {
                Some(owner) => owner.unlock(opened?),
                None => drop(self.open(profile.clone(), opened?)),
            }
            self.hub.changed(Part::Identity);
        }
        if let (Some(owner), Some(_)) = (self.owners.get(&profile), self.link.network_now()) {
            self.resume(&owner).await?;
        }
        self.view(&profile).await
    }

    /// Protects a keyring with another passphrase. The file is replaced in one step: it opens with one or the other.
    pub(super) async fn change_passphrase(
        self: &Arc<Self>,
        profile: &ProfileName,
        old: SecretText,
        new: SecretText,
    ) -> Result<(), Failure> {
        let path = self.home.keyring(profile);
        if !path.exists() {
            return Err(refused(format!(
                "profile '{profile}' has no identity yet, so there is no passphrase to change"
            )));
        }
        let (old, new) = (Passphrase::new(old.expose().to_owned())?, Passphrase::new(new.expose().to_owned())?);
        self.log.write(profile, "change passphrase", "keyring", "begun").await?;
        // Nor is it opened with the old passphrase meanwhile: what was read before could never be saved again.
        let not_opened = self.owners.opening(profile).await;
        let owner = self.owners.get(profile).filter(|owner| !owner.is_locked());
        // No save of the keyring under the old passphrase may come after it.
        let _one_at_a_time = match &owner {
            Some(owner) => Some(owner.changes.lock().await),
            None => None,
        };
        let open = owner.clone();
        let changed = blocking(self, move |_| {
            let _until_written = not_opened;
            // Also for an open keyring: the caller has to know the current one.
            let mut kept = UnlockedKeyring::open(&path, &old)?;
            match &open {
                Some(owner) => owner.keyring().change_passphrase(&new)?,
                None => kept.change_passphrase(&new)?,
            }
            Ok(())
        });
        let changed = changed.await;
        self.log.ended(profile, "change passphrase", "keyring", changed).await
    }

    /// Puts an open keyring into the site. The caller holds [`Owners::opening`] and has seen that none is open.
    pub(super) fn open(self: &Arc<Self>, profile: ProfileName, keyring: UnlockedKeyring) -> Arc<Owner> {
        self.put_in_place(Owner::new(profile, keyring))
    }

    /// Puts an owner into the site, replacing the profile's previous one, which has the same keyring.
    pub(super) fn put_in_place(self: &Arc<Self>, owner: Owner) -> Arc<Owner> {
        let owner = Arc::new(owner);
        self.pins.introduce(&owner);
        self.owners.insert(&owner);
        self.seal_as_before(&owner);
        self.watches.restore(&owner);
        self.hub.changed(Part::Identity);
        owner
    }

    /// Seals under the newest epoch of the keyring until the chain's state is known, so that a start loses no message
    /// and capture needs no chain; only if the chain is known to have an epoch of this owner.
    fn seal_as_before(&self, owner: &Owner) {
        let Ok(Some(pin)) = self.connection.pin() else { return };
        let domain = pin.domain();
        let newest = owner.epochs(domain).last().copied().filter(|_| owner.has_registered_epoch(domain));
        if let Some(Err(error)) = newest.map(|epoch| owner.seal_under(domain, epoch)) {
            self.hub.notice(NoticeLevel::Warning, &error.to_string());
        }
    }

    /// Refuses to go on with an owner whose account was replaced while it was waited for.
    pub(super) fn is_current(&self, owner: &Arc<Owner>) -> Result<(), Failure> {
        if self.owners.is_open(owner) {
            return Ok(());
        }
        Err(refused(format!(
            "the account of profile '{}' was replaced meanwhile, so nothing was done; run the command again",
            owner.profile
        )))
    }

    /// The public side of a profile; needs no passphrase.
    pub(super) async fn view(self: &Arc<Self>, profile: &ProfileName) -> Result<IdentityView, Failure> {
        let path = self.home.keyring(profile);
        let owner = self.owners.get(profile);
        let mut view = IdentityView {
            profile: profile.clone(),
            exists: path.exists(),
            unlocked: owner.is_some_and(|owner| !owner.is_locked()),
            registered: false,
            address: None,
            epoch: None,
            epoch_records: None,
            signing_key: None,
            fingerprint: None,
            envelope_key: None,
        };
        if !view.exists {
            return Ok(view);
        }
        let public = blocking(self, move |_| Ok(read_public(&path)?)).await?;
        view.address = Some(public.address);
        view.signing_key = Some(public.signing);
        view.envelope_key = Some(public.envelope);
        view.fingerprint = Some(Fingerprint::of(&public.signing).to_string());
        // A gateway that has no room for visitors may let the site in once the keyring is open: who is about to open it asks
        // first whether it is.
        let patience = if view.unlocked { Duration::MAX } else { LOCKED };
        if let Ok(Ok(network)) = tokio::time::timeout(patience, self.link.network()).await {
            view.registered =
                network.directory.identity(public.address).is_ok_and(|identity| identity.signing == public.signing);
            view.epoch = Some(network.directory.epoch(public.address)).filter(|epoch| *epoch > 0);
        }
        if let Some(epoch) = view.epoch {
            let sealed =
                move |profiles: &Self| Ok(profiles.plant.ledger.sealed_in_epoch(public.address, epoch, None)?);
            let (records, since) = blocking(self, sealed).await?;
            view.epoch_records = Some(EpochRecords { records, since });
        }
        Ok(view)
    }
}

//! Profiles of the home: created, opened, locked, registered and shown; who is open.

mod foreseeing;
mod keys;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::Duration;

use tokio::sync::mpsc;
use tokio::task::block_in_place;

use super::storage::check_unused;
use crate::chain::Call;
use crate::command::{SecretBytes, SecretText};
use crate::crypto::{Fingerprint, Keyring, Passphrase, UnlockedKeyring, prove, read_public};
use crate::model::{Address, ProfileName, Timestamp, clean, locked};
use crate::paths::Home;
use crate::pipeline::{Network, Owner, Recorder, recovery};
use crate::reply::{Failure, IdentityView, Opens, Part, Result, input, internal, refused};
use crate::site::{Connection, Enrolments, Gateway, Parts, Pinning, Reading, Sharing, Watches, blocking};
use crate::store::notes::ProfileAccounts;
use crate::store::{SealedQuery, StoreError};

/// Longest wait for the chain's word about a locked keyring's identity.
const LOCKED: Duration = Duration::from_secs(3);

type Accounts = BTreeMap<ProfileName, Vec<Address>>;
/// Pause before retrying to anchor what a former key signed.
const DRAIN_AGAIN: Duration = Duration::from_secs(10);
/// How long a running change may delay the locking.
const PATIENCE: Duration = Duration::from_secs(10);

pub struct Profiles {
    pub parts: Parts,
    pub connection: Arc<Connection>,
    pub sharing: Arc<Sharing>,
    pub enrolments: Arc<Enrolments>,
    pub gateway: Arc<Gateway>,
    pub reading: Arc<Reading>,
    pub pins: Arc<Pinning>,
    pub recorder: Arc<Recorder>,
    pub watches: Arc<Watches>,
}

impl Profiles {
    /// Makes keys and a keyring for a new profile, and opens it.
    pub async fn create(self: &Arc<Self>, profile: ProfileName, secret: SecretText) -> Result<IdentityView> {
        let path = self.parts.home.keyring(&profile);
        let _one_at_a_time = self.parts.owners.opening(&profile).await;
        block_in_place(|| check_unused(&self.parts))?;
        self.check_account(&profile)?;
        if path.exists() {
            return Err(refused(format!(
                "profile '{profile}' already exists; `authros --profile {profile} identity show` shows it"
            )));
        }
        let passphrase = Passphrase::new(secret.expose().to_owned())?;
        let unlocked = blocking(self, move |profiles| {
            let keyring = Keyring::generate(profiles.parts.plant.provider)?;
            Ok(UnlockedKeyring::create(keyring, &path, &passphrase)?)
        })
        .await?;
        self.open(profile.clone(), unlocked);
        self.parts.log.write(&profile, "create identity", "keys", "done").await?;
        self.view(&profile).await
    }

    /// Brings a saved keyring into a profile that has none, and opens it.
    pub async fn restore(
        self: &Arc<Self>,
        profile: ProfileName,
        saved: PathBuf,
        secret: SecretText,
    ) -> Result<IdentityView> {
        let path = self.parts.home.keyring(&profile);
        let _one_at_a_time = self.parts.owners.opening(&profile).await;
        // A site that has it open would go on with the keys of the file that was there.
        if path.exists() || self.parts.owners.get(&profile).is_some() {
            return Err(refused(format!(
                "profile '{profile}' has a keyring, and none is overwritten; stop the site and move {} away first, or \
                 restore into another --profile",
                path.display()
            )));
        }
        let mut others = self.known_accounts()?;
        let known = others.remove(&profile);
        others.retain(|other, _| !self.parts.home.keyring(other).exists());
        let passphrase = Passphrase::new(secret.expose().to_owned())?;
        let opened = blocking(self, {
            let profile = profile.clone();
            move |_| {
                UnlockedKeyring::restore(&saved, &path, &passphrase, |public| match known {
                    Some(accounts) if !accounts.contains(&public.address) => {
                        Err(refused(foreign_keyring(&saved, public.address, &profile, &accounts)))
                    }
                    _ => check_missing(&others, public.address, &saved),
                })
            }
        });
        let opened = opened.await;
        let outcome = if opened.is_ok() { "done" } else { "refused" };
        self.parts.log.write(&profile, "restore keyring", "keyring", outcome).await?;
        let owner = self.open(profile.clone(), opened?);
        if self.parts.link.network_now().is_some() {
            self.resume(&owner).await?;
        }
        self.view(&profile).await
    }

    pub async fn unlock(self: &Arc<Self>, profile: ProfileName, secret: SecretText) -> Result<IdentityView> {
        if self.parts.owners.get(&profile).is_none_or(|owner| owner.is_locked()) {
            let _one_at_a_time = self.parts.owners.opening(&profile).await;
            self.check_account(&profile)?;
            let path = self.parts.home.keyring(&profile);
            let passphrase = Passphrase::new(secret.expose().to_owned())?;
            let opened = blocking(self, move |_| Ok(UnlockedKeyring::open(&path, &passphrase)?)).await;
            let outcome = if opened.is_ok() { "done" } else { "refused" };
            self.parts.log.write(&profile, "unlock", "keyring", outcome).await?;
            // If another request opened it meanwhile, the owner keeps its keys.
            match self.parts.owners.get(&profile) {
                Some(owner) => owner.unlock(opened?),
                None => drop(self.open(profile.clone(), opened?)),
            }
            self.parts.hub.changed(Part::Identity);
        }
        if let (Some(owner), Some(_)) = (self.parts.owners.get(&profile), self.parts.link.network_now()) {
            self.resume(&owner).await?;
        }
        self.view(&profile).await
    }

    /// Replaces the keyring's file in one step: it opens with either the old or the new passphrase.
    pub async fn change_passphrase(
        self: &Arc<Self>,
        profile: &ProfileName,
        old: SecretText,
        new: SecretText,
    ) -> Result<()> {
        let path = self.parts.home.keyring(profile);
        if !path.exists() {
            let text = format!("profile '{profile}' has no identity yet, so there is no passphrase to change");
            return Err(refused(text));
        }
        let (old, new) = (Passphrase::new(old.expose().to_owned())?, Passphrase::new(new.expose().to_owned())?);
        self.parts.log.write(profile, "change passphrase", "keyring", "begun").await?;
        // Nor may it be opened with the old passphrase meanwhile: that copy could never be saved again.
        let not_opened = self.parts.owners.opening(profile).await;
        let owner = self.parts.owners.get(profile).filter(|owner| !owner.is_locked());
        // No save under the old passphrase may come after this.
        let _one_at_a_time = match &owner {
            Some(owner) => Some(owner.changes.lock().await),
            None => None,
        };
        let open = owner.clone();
        let changed = blocking(self, move |_| {
            let _until_written = not_opened;
            // Also for an open keyring: the caller must know the current passphrase.
            let mut kept = UnlockedKeyring::open(&path, &old)?;
            match &open {
                Some(owner) => owner.keyring().change_passphrase(&new)?,
                None => kept.change_passphrase(&new)?,
            }
            Ok(())
        });
        let changed = changed.await;
        self.parts.log.ended(profile, "change passphrase", "keyring", changed).await
    }

    /// Puts an open keyring into the site. The caller holds [`Owners::opening`] and has seen that none is open.
    pub fn open(&self, profile: ProfileName, keyring: UnlockedKeyring) -> Arc<Owner> {
        self.put_in_place(Owner::new(profile, keyring))
    }

    /// Puts an owner into the site, replacing the profile's previous one, which has the same keyring.
    pub fn put_in_place(&self, owner: Owner) -> Arc<Owner> {
        let owner = Arc::new(owner);
        let known = |accounts: &mut Accounts| {
            accounts.insert(owner.profile.clone(), vec![owner.address]);
            Ok::<(), StoreError>(())
        };
        if let Err(error) = self.parts.plant.ledger.notes.change(&ProfileAccounts {}, known) {
            self.parts.hub.warn(&error.to_string());
        }
        self.pins.introduce(&owner);
        self.parts.owners.insert(&owner);
        self.seal_as_before(&owner);
        if let Err(failure) = self.watches.restore(&owner) {
            self.parts.hub.alarm(&format!("what '{}' watches is not captured: {}", owner.profile, failure.message));
        }
        self.parts.hub.changed(Part::Identity);
        owner
    }

    /// Refuses a profile whose keyring is gone or another account's: its earlier records would have no owner.
    fn check_account(&self, profile: &ProfileName) -> Result<()> {
        let known = self.known_accounts()?;
        let fault = known.get(profile).and_then(|accounts| keyring_fault(&self.parts.home, profile, accounts));
        fault.map_or(Ok(()), |text| Err(refused(text)))
    }

    pub fn keyring_faults(&self) -> Result<Vec<(ProfileName, String)>> {
        Ok(keyring_faults(&self.parts.home, self.known_accounts()?))
    }

    pub fn known_accounts(&self) -> Result<Accounts> {
        Ok(self.parts.plant.ledger.notes.read(&ProfileAccounts {})?.unwrap_or_default())
    }

    /// Seals under the keyring's newest epoch until the chain's state is known, so that a start loses no message; only
    /// if the chain once had an epoch of this owner.
    fn seal_as_before(&self, owner: &Owner) {
        let Ok(Some(pin)) = self.connection.pin() else { return };
        let domain = pin.domain();
        let newest = owner.epochs(domain).last().copied().filter(|_| owner.has_registered_epoch(domain));
        if let Some(Err(error)) = newest.map(|epoch| owner.seal_under(domain, epoch)) {
            self.parts.hub.warn(&error.to_string());
        }
    }

    /// Refuses to continue with an owner whose account was replaced meanwhile.
    pub fn is_current(&self, owner: &Arc<Owner>) -> Result<()> {
        if self.parts.owners.is_open(owner) {
            return Ok(());
        }
        Err(refused(format!(
            "the account of profile '{}' was replaced meanwhile, so nothing was done; run the command again",
            owner.profile
        )))
    }

    /// The public side of a profile; needs no passphrase.
    pub async fn view(self: &Arc<Self>, profile: &ProfileName) -> Result<IdentityView> {
        let path = self.parts.home.keyring(profile);
        let owner = self.parts.owners.get(profile);
        let mut view = IdentityView {
            profile: profile.clone(),
            exists: path.exists(),
            unlocked: owner.is_some_and(|owner| !owner.is_locked()),
            ..IdentityView::default()
        };
        if !view.exists {
            return Ok(view);
        }
        let stored = self.parts.home.passphrase(profile);
        view.passphrase_file = stored.exists().then(|| clean(&stored.display().to_string(), 500));
        let public = blocking(self, move |_| Ok(read_public(&path)?)).await?;
        view.address = Some(public.address);
        view.signing_key = Some(public.signing);
        view.envelope_key = Some(public.envelope);
        view.fingerprint = Some(Fingerprint::of(&public.signing).to_string());
        // Without room for visitors, a gateway admits the site only once a keyring is open, so a locked view does not
        // wait for it.
        let patience = if view.unlocked { Duration::MAX } else { LOCKED };
        if let Ok(Ok(network)) = tokio::time::timeout(patience, self.parts.link.network()).await {
            view.registered =
                network.directory.identity(public.address).is_ok_and(|identity| identity.signing == public.signing);
            view.epoch = Some(network.directory.epoch(public.address)).filter(|epoch| *epoch > 0);
        }
        if let Some(epoch) = view.epoch {
            let opens = move |profiles: &Self| {
                let opened = |epochs| {
                    let query = SealedQuery { owner: public.address, topic: None, epochs, since: Timestamp::default() };
                    let (records, since) = profiles.parts.plant.ledger.counts.opened_by(&query)?;
                    Ok::<_, Failure>(Some(Opens { records, since, of_robots: false }))
                };
                Ok((opened(epoch..=epoch)?, opened(1..=epoch)?))
            };
            (view.epoch_records, view.all_records) = blocking(self, opens).await?;
        }
        Ok(view)
    }

    /// Wipes the keys for reading, granting and revoking. Waits a moment for a running change of epochs or grants,
    /// which needs them.
    pub async fn lock(self: &Arc<Self>, profile: &ProfileName) -> Result<IdentityView> {
        let _not_opened = self.parts.owners.opening(profile).await;
        if let Some(owner) = self.parts.owners.get(profile).filter(|owner| !owner.is_locked()) {
            {
                // A hanging change is cut off and resumes at the next unlock.
                let _one_at_a_time = tokio::time::timeout(PATIENCE, owner.changes.lock()).await.ok();
                if let Some(network) = self.parts.link.network_now() {
                    block_in_place(|| self.sharing.foresee_locked(&owner, &network))?;
                }
                owner.lock(self.parts.plant.provider)?;
                self.reading.forget();
            }
            self.parts.hub.changed(Part::Identity);
            self.parts.log.write(profile, "lock", "keyring", "done").await?;
        }
        self.view(profile).await
    }

    pub async fn back_up_keys(self: &Arc<Self>, profile: &ProfileName) -> Result<SecretBytes> {
        let path = self.parts.home.keyring(profile);
        if !path.exists() {
            return Err(input(format!("profile '{profile}' has no identity yet, so there is nothing to back up")));
        }
        let read = move |_: &Self| {
            std::fs::read(&path).map_err(|error| internal(format!("the keyring cannot be read: {error}")))
        };
        let bytes = self.parts.log.deed(profile, "back up keys", "keyring", blocking(self, read)).await?;
        Ok(SecretBytes::new(bytes))
    }

    /// Registers the owner's identity; sends nothing if the chain has it.
    pub async fn register(self: &Arc<Self>, owner: &Arc<Owner>) -> Result<IdentityView> {
        let network = self.connection.network_or_deploy(owner).await?;
        if network.directory.identity(owner.address).is_ok() {
            self.drain_former(owner, &network).await?;
        }
        let _one_at_a_time = owner.changes.lock().await;
        self.is_current(owner)?;
        if network.directory.identity(owner.address).is_err() {
            self.connection.fund(&network.chain, owner).await?;
            self.send_registration(owner, &network).await?;
        }
        self.take_up(owner, &network).await?;
        self.settle_pairs(owner, &network).await?;
        if owner.sealing().is_none() {
            let missing = self.sharing.missing_text();
            return Err(refused(missing.unwrap_or_else(|| "no epoch has started; run the command again".to_owned())));
        }
        self.view(&owner.profile).await
    }

    async fn send_registration(&self, owner: &Owner, network: &Network) -> Result<()> {
        let token = owner.prepare_epoch(network.domain, 1)?;
        let (signing, envelope) = (owner.signing(), owner.envelope());
        let identity =
            prove(self.parts.plant.provider, &network.domain, &owner.address, &signing, &envelope.public, token)?;
        let envelope = recovery::own_envelope(&self.parts.plant, network, owner, 1)?;
        let call = Call::Register { identity, envelope };
        let sent = self.parts.sender.send(&network.chain, &owner.eoa(), call, "register").await;
        let outcome = if sent.is_ok() { "done" } else { "failed" };
        self.parts.log.write(&owner.profile, "register", &owner.address.to_string(), outcome).await?;
        let (_, receipt) = sent?;
        self.parts.link.scanned(receipt.block).await;
        self.parts.hub.changed(Part::Identity);
        Ok(())
    }

    /// Brings the owner to the chain's state: fetches missing keys, seals under the current epoch or finishes one that
    /// never reached the chain, and re-wraps what readers lack.
    pub async fn resume(self: &Arc<Self>, owner: &Arc<Owner>) -> Result<()> {
        if self.parts.home.original().is_some() {
            return Ok(());
        }
        let network = self.parts.link.network().await?;
        // A locked keyring keeps sealing as before.
        if owner.is_locked() || network.directory.identity(owner.address).is_err() {
            return Ok(());
        }
        {
            let _one_at_a_time = owner.changes.lock().await;
            self.take_up(owner, &network).await?;
        }
        let profiles = Arc::clone(self);
        let owner = Arc::clone(owner);
        tokio::spawn(async move {
            // The site's health says what is wrong.
            while profiles.drain_former(&owner, &network).await.is_err() {
                tokio::time::sleep(DRAIN_AGAIN).await;
                if !profiles.parts.owners.is_open(&owner) {
                    return;
                }
            }
            let pairs = async {
                let network = profiles.parts.link.network().await?;
                let _one_at_a_time = owner.changes.lock().await;
                profiles.settle_pairs(&owner, &network).await
            };
            if let Err(failure) = pairs.await {
                profiles.parts.hub.alarm(&format!("the change of an SM2 key: {}", failure.message));
            }
            if let Err(failure) = profiles.sharing.finish_epoch(&owner).await {
                profiles.parts.hub.alarm(&failure.message);
            }
        });
        Ok(())
    }

    /// Brings the keyring to the chain's pairs and epochs of this owner. The caller holds the owner's changes.
    async fn take_up(&self, owner: &Owner, network: &Network) -> Result<()> {
        let newer = block_in_place(|| recovery::recover_pairs(&self.parts.plant, network, owner));
        self.sharing.note_pairs(owner, newer.as_ref().err().map(ToString::to_string));
        let newer = newer.unwrap_or(false);
        self.sharing.take_up_epoch(owner, network)?;
        if newer {
            self.finish_pairs(owner, network).await?;
            let text = format!("the keyring of '{}' received newer SM2 keys from the chain", owner.profile);
            self.parts.hub.inform(&text);
        }
        Ok(())
    }
}

/// Of the profiles that the store knows, and of those that have a keyring here.
pub(crate) fn keyring_faults(home: &Home, mut known: Accounts) -> Vec<(ProfileName, String)> {
    for profile in home.profiles() {
        known.entry(profile).or_default();
    }
    let fault = |(profile, accounts): (ProfileName, Vec<Address>)| {
        let fault = keyring_fault(home, &profile, &accounts)?;
        Some((profile, fault))
    };
    known.into_iter().filter_map(fault).collect()
}

fn either(accounts: &[Address]) -> String {
    let named: Vec<String> = accounts.iter().map(ToString::to_string).collect();
    named.join(" or ")
}

fn foreign_keyring(path: &Path, found: Address, profile: &ProfileName, accounts: &[Address]) -> String {
    format!(
        "{} is the keyring of account {found}, and profile '{profile}' of this home has account {}; put its own keyring \
         back, or use another --profile for the other account",
        path.display(),
        either(accounts)
    )
}

/// Refuses the keyring of another profile whose keyring is gone: that profile could not be opened afterwards.
fn check_missing(others: &Accounts, account: Address, saved: &Path) -> Result<()> {
    let Some((other, _)) = others.iter().find(|(_, accounts)| accounts.contains(&account)) else { return Ok(()) };
    let file = saved.display();
    Err(refused(format!(
        "{file} is the keyring of profile '{other}' of this home, account {account}: run `authros --profile {other} keys \
         restore {file}`"
    )))
}

fn keyring_fault(home: &Home, profile: &ProfileName, accounts: &[Address]) -> Option<String> {
    let account = either(accounts);
    let path = home.keyring(profile);
    if !path.exists() {
        return Some(format!(
            "the keyring of profile '{profile}', account {account}, is gone, and its records open with nothing else; bring \
             a copy back (`authros --profile {profile} keys restore FILE`), restore a backup (`authros backup restore FILE`), \
             or use another --profile for another account"
        ));
    }
    match read_public(&path) {
        Ok(public) if accounts.is_empty() || accounts.contains(&public.address) => None,
        Ok(public) => Some(foreign_keyring(&path, public.address, profile, accounts)),
        Err(error) => Some(format!("the keyring of profile '{profile}': {error}")),
    }
}

pub struct Owners {
    home: Home,
    open: RwLock<BTreeMap<ProfileName, Arc<Owner>>>,
    /// Profiles being opened, locked or given another passphrase.
    opening: Mutex<BTreeMap<ProfileName, Arc<tokio::sync::Mutex<()>>>>,
    opened: mpsc::UnboundedSender<Arc<Owner>>,
}

impl Owners {
    /// `opened` receives each owner that is opened.
    pub fn new(home: Home, opened: mpsc::UnboundedSender<Arc<Owner>>) -> Self {
        Self { home, open: RwLock::default(), opening: Mutex::default(), opened }
    }

    /// Waits until nobody else opens, locks or re-protects a profile's keyring, and excludes others while held: of two
    /// copies of a keyring, one is outdated after the first change.
    pub async fn opening(&self, profile: &ProfileName) -> tokio::sync::OwnedMutexGuard<()> {
        let lock = {
            let mut opening = locked(&self.opening);
            opening.retain(|_, lock| Arc::strong_count(lock) > 1);
            Arc::clone(opening.entry(profile.clone()).or_default())
        };
        lock.lock_owned().await
    }

    /// Adds an opened owner, replacing the profile's previous one.
    pub fn insert(&self, owner: &Arc<Owner>) {
        let mut open = self.open.write().unwrap_or_else(PoisonError::into_inner);
        open.insert(owner.profile.clone(), Arc::clone(owner));
        drop(open);
        // Nobody listens once the site ends.
        drop(self.opened.send(Arc::clone(owner)));
    }

    /// The owner of an opened keyring; it may be locked by now.
    pub fn get(&self, profile: &ProfileName) -> Option<Arc<Owner>> {
        self.open.read().unwrap_or_else(PoisonError::into_inner).get(profile).cloned()
    }

    pub fn all(&self) -> Vec<Arc<Owner>> {
        self.open.read().unwrap_or_else(PoisonError::into_inner).values().cloned().collect()
    }

    pub fn is_open(&self, owner: &Arc<Owner>) -> bool {
        self.get(&owner.profile).is_some_and(|other| Arc::ptr_eq(&other, owner))
    }

    pub fn unlocked(&self, profile: &ProfileName) -> Result<Arc<Owner>> {
        let owner = self.get(profile).filter(|owner| !owner.is_locked());
        owner.ok_or_else(|| match self.home.keyring(profile).exists() {
            true => refused(format!(
                "the keyring of profile '{profile}' is locked; unlock it at a terminal, or with --passphrase-file, \
                 --passphrase-fd or --passphrase-command"
            )),
            false => without_identity(profile),
        })
    }

    pub fn address_of(&self, profile: &ProfileName) -> Result<Address> {
        if let Some(owner) = self.get(profile) {
            return Ok(owner.address);
        }
        let path = self.home.keyring(profile);
        if !path.exists() {
            return Err(without_identity(profile));
        }
        Ok(block_in_place(|| read_public(&path))?.address)
    }

    /// An unreadable keyring has no account.
    pub fn accounts(&self) -> Vec<Address> {
        let profiles = self.home.profiles();
        profiles.iter().filter_map(|profile| Some(read_public(&self.home.keyring(profile)).ok()?.address)).collect()
    }
}

fn without_identity(profile: &ProfileName) -> Failure {
    input(format!(
        "profile '{profile}' has no identity yet; create one with `authros --profile {profile} identity create`"
    ))
}

#[cfg(test)]
mod tests;

//! The profiles of the home, and the owners behind those whose keyrings were opened here.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError, RwLock};

use tokio::sync::mpsc;
use tokio::task::block_in_place;

use crate::crypto::read_public;
use crate::model::{Address, ProfileName};
use crate::paths::Home;
use crate::pipeline::Owner;
use crate::service::failure::{input, refused};
use crate::service::reply::Failure;

/// The owners of a site.
pub(in crate::site) struct Owners {
    home: Home,
    open: RwLock<BTreeMap<ProfileName, Arc<Owner>>>,
    /// Profiles that are being opened, locked or given another passphrase.
    opening: Mutex<BTreeMap<ProfileName, Arc<tokio::sync::Mutex<()>>>>,
    /// Receives each owner as it is opened.
    opened: mpsc::UnboundedSender<Arc<Owner>>,
}

impl Owners {
    /// Nobody yet; `opened` receives each owner that is opened.
    pub fn new(home: Home, opened: mpsc::UnboundedSender<Arc<Owner>>) -> Self {
        Self { home, open: RwLock::default(), opening: Mutex::default(), opened }
    }

    /// Waits until nobody else opens, locks or newly protects the keyring of a profile, and keeps others from it while
    /// held: a keyring that is read twice has two copies, of which one is out of date with the first change.
    pub async fn opening(&self, profile: &ProfileName) -> tokio::sync::OwnedMutexGuard<()> {
        let lock = {
            let mut opening = self.opening.lock().unwrap_or_else(PoisonError::into_inner);
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

    /// The owner behind a profile, if its keyring was opened; it may be locked by now.
    pub fn get(&self, profile: &ProfileName) -> Option<Arc<Owner>> {
        self.open.read().unwrap_or_else(PoisonError::into_inner).get(profile).cloned()
    }

    /// All that were opened.
    pub fn all(&self) -> Vec<Arc<Owner>> {
        self.open.read().unwrap_or_else(PoisonError::into_inner).values().cloned().collect()
    }

    /// Whether this is still the owner behind its profile.
    pub fn is_open(&self, owner: &Arc<Owner>) -> bool {
        self.get(&owner.profile).is_some_and(|other| Arc::ptr_eq(&other, owner))
    }

    /// The owner behind a profile that is unlocked here.
    ///
    /// # Errors
    /// It is locked or does not exist.
    pub fn unlocked(&self, profile: &ProfileName) -> Result<Arc<Owner>, Failure> {
        let owner = self.get(profile).filter(|owner| !owner.is_locked());
        owner.ok_or_else(|| match self.home.keyring(profile).exists() {
            true => refused(format!(
                "the keyring of profile '{profile}' is locked; unlock it with --passphrase-file or --passphrase-fd"
            )),
            false => without_identity(profile),
        })
    }

    /// The account of a profile; needs no passphrase.
    ///
    /// # Errors
    /// There is none, or its keyring cannot be read.
    pub fn address_of(&self, profile: &ProfileName) -> Result<Address, Failure> {
        if let Some(owner) = self.get(profile) {
            return Ok(owner.address);
        }
        let path = self.home.keyring(profile);
        if !path.exists() {
            return Err(without_identity(profile));
        }
        Ok(block_in_place(|| read_public(&path))?.address)
    }

    /// The accounts of all profiles of the home; a keyring that cannot be read has none.
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

//! One console per profile. A keyring opened by a console is locked when it leaves, after the chain's dues are sent;
//! one opened by `serve` or another command stays open.

use std::collections::HashSet;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::sync::oneshot;

use crate::model::{ErrorKind, ProfileName, locked};
use crate::reply::{Failure, Result};
use crate::site::{Asker, Site};

/// Longest wait for a profile's dues to the chain before its keyring is locked.
const PATIENCE: Duration = Duration::from_secs(30);
const LOOK_EVERY: Duration = Duration::from_millis(200);

/// A connection: who asks through it, and what it holds while it lasts.
#[derive(Default)]
pub struct Connected {
    pub(crate) asker: Asker,
    held: Mutex<Held>,
}

#[derive(Default)]
struct Held {
    consoles: HashSet<ProfileName>,
    /// Keyrings opened through it.
    opened: HashSet<ProfileName>,
    /// Each ends a server of the chain when dropped.
    servers: Vec<oneshot::Sender<()>>,
}

pub type Claims = Arc<Connected>;

pub(crate) fn joiner(asker: Asker) -> Claims {
    Arc::new(Connected { asker, held: Mutex::default() })
}

#[derive(Debug, Default)]
pub(super) struct Consoles {
    open: HashSet<ProfileName>,
    /// Profiles whose keyrings were opened by consoles that have left, or left to the next one.
    to_lock: HashSet<ProfileName>,
}

pub(super) fn opened_by(claims: &Claims, profile: ProfileName) {
    locked(&claims.held).opened.insert(profile);
}

/// Ends when what the connection holds is released.
pub(super) fn until_released(claims: &Claims) -> oneshot::Receiver<()> {
    let (end, ended) = oneshot::channel();
    locked(&claims.held).servers.push(end);
    ended
}

impl Site {
    pub(super) fn claim(&self, profile: ProfileName, claims: &Claims) -> Result<()> {
        let mut consoles = locked(&self.consoles);
        let own = locked(&claims.held).consoles.contains(&profile);
        if !consoles.open.insert(profile.clone()) && !own {
            let advice = "close it, or open another profile with --profile";
            let text = format!("a console of profile '{profile}' is already open; {advice}");
            return Err(Failure::new(ErrorKind::Home, text));
        }
        locked(&claims.held).consoles.insert(profile);
        Ok(())
    }

    /// Frees a connection's consoles, locks what they opened, and ends the servers it requested.
    pub(super) fn release(self: &Arc<Self>, claims: &Claims) {
        let left = std::mem::take(&mut *locked(&claims.held));
        let mut consoles = locked(&self.consoles);
        for profile in left.consoles {
            consoles.open.remove(&profile);
            if left.opened.contains(&profile) {
                consoles.to_lock.insert(profile.clone());
            }
            if consoles.to_lock.contains(&profile) && !self.parts.life.is_ending() {
                tokio::spawn(Arc::clone(self).lock_behind(profile));
            }
        }
    }

    /// Locks a profile whose console left, unless the next console is there: that one locks it when it leaves.
    async fn lock_behind(self: Arc<Self>, profile: ProfileName) {
        // What cannot be sent now is resumed at the next unlock.
        drop(tokio::time::timeout(PATIENCE, self.owes_nothing(&profile)).await);
        {
            let mut consoles = locked(&self.consoles);
            if consoles.open.contains(&profile) || !consoles.to_lock.remove(&profile) {
                return;
            }
        }
        if let Err(failure) = self.profiles.lock(&profile).await {
            let text =
                format!("the keyring of '{profile}' stays open although its console has closed: {}", failure.message);
            self.parts.hub.warn(&text);
        }
    }

    /// Waits until everything that needs the profile's keys is sent.
    async fn owes_nothing(&self, profile: &ProfileName) {
        while let (Ok(owner), Some(network)) = (self.parts.owners.unlocked(profile), self.parts.link.network_now())
            && tokio::task::block_in_place(|| self.sharing.owes(&owner, &network)).unwrap_or(false)
        {
            tokio::time::sleep(LOOK_EVERY).await;
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used, reason = "a test fails by panicking")]

    use super::*;
    use crate::Client;
    use crate::command::{OpenConsole, SecretText, Unlock};
    use crate::site::testing::{PASSPHRASE, profile, registered, site_with_chain};

    fn unlock() -> Unlock {
        Unlock { passphrase: SecretText::new(PASSPHRASE.to_owned()) }
    }

    /// The decisions made at once when a console leaves.
    async fn left(site: &Arc<Site>, console: Client) {
        drop(console);
        loop {
            let gone = locked(&site.consoles).open.is_empty();
            if gone {
                return;
            }
            tokio::task::yield_now().await;
        }
    }

    fn is_to_lock(site: &Site) -> bool {
        !locked(&site.consoles).to_lock.is_empty()
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn what_a_console_opened_is_locked_when_it_leaves_and_what_serve_opened_stays_open() {
        let (site, _folder) = site_with_chain();
        let owner = registered(&site, "alice").await;
        site.profiles.lock(&profile("alice")).await.expect("locked");

        let console = site.client(profile("alice"));
        console.ask(OpenConsole).await.expect("claimed");
        console.ask(unlock()).await.expect("opened");
        assert!(!owner.is_locked());
        left(&site, console).await;
        while !owner.is_locked() {
            tokio::task::yield_now().await;
        }
        assert!(!is_to_lock(&site));

        let serve = site.client(profile("alice"));
        serve.ask(unlock()).await.expect("opened");
        let console = site.client(profile("alice"));
        console.ask(OpenConsole).await.expect("claimed");
        console.ask(unlock()).await.expect("open already");
        left(&site, console).await;
        assert!(!is_to_lock(&site) && !owner.is_locked());
        drop(serve);
        site.stop().await;
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn the_next_console_takes_over_and_leaves_it_locked() {
        let (site, _folder) = site_with_chain();
        let owner = registered(&site, "alice").await;
        // The first console's keyring waits to be locked, and the next one arrives before that is done.
        site.consoles.lock().expect("whole").to_lock.insert(profile("alice"));
        let console = site.client(profile("alice"));
        console.ask(OpenConsole).await.expect("claimed");
        Arc::clone(&site).lock_behind(profile("alice")).await;
        assert!(!owner.is_locked(), "a console is at work");
        left(&site, console).await;
        while !owner.is_locked() {
            tokio::task::yield_now().await;
        }
        site.stop().await;
    }
}

//! Unattended capture: a site whose profile is locked works as a device of its owner, with a lent key, the keys of its
//! topics and an account that only anchors, until that loan or that epoch ends, or until somebody unlocks the profile.

mod preparing;
mod settling;
pub(super) mod standing;
#[cfg(test)]
mod tests;
mod working;

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};

use serde::{Deserialize, Serialize};
use tokio::task::block_in_place;

pub(crate) use preparing::NOTED;
pub(in crate::site) use preparing::noted;
use standing::{Reach, Standing};

use super::Site;
use super::audit::Log;
use super::capture::ros::RosSide;
use super::capture::watches::Watches;
use super::chain::connection::Connection;
use super::chain::link::Link;
use super::devices::Devices;
use super::devices::enrolled::Enrolments;
use super::identity::owners::Owners;
use super::lifetime::Lifetime;
use super::parts::Parts;
use super::pins::Pinning;
use super::supervision::Supervisor;
use crate::config::Config;
use crate::crypto::{EoaSecret, UnattendedCredential};
use crate::model::{Address, Domain, ProfileName, SignerId, Timestamp};
use crate::paths::Home;
use crate::pipeline::{Author, Plant, Recorder, Sender, adoption, notices};
use crate::service::event::NoticeLevel;
use crate::service::failure::{input, refused};
use crate::service::hub::Hub;
use crate::service::reply::{Failure, HealthLevel, PartHealth, UnattendedState, UnattendedView};

/// What a home notes of a credential that it prepared: no secret.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Noted {
    /// The lent device.
    pub device: SignerId,
    /// The account that anchors.
    pub account: Address,
    /// The network.
    pub domain: Domain,
    /// Its topics.
    pub topics: Vec<String>,
    /// When the loan ends, as of that day.
    pub until: Timestamp,
    /// Whether it was ended.
    #[serde(default)]
    pub ended: bool,
}

/// What captures now.
struct Working {
    standing: Arc<Standing>,
    /// The network that the credential is for.
    domain: Domain,
    /// When the loan ends, where the chain does not say.
    until: Timestamp,
    witness: EoaSecret,
}

/// Unattended capture of a site.
pub(in crate::site) struct Unattended {
    home: Home,
    config: Arc<Config>,
    plant: Plant,
    hub: Arc<Hub>,
    log: Arc<Log>,
    owners: Arc<Owners>,
    link: Arc<Link>,
    life: Arc<Lifetime>,
    sender: Arc<Sender>,
    supervisor: Arc<Supervisor>,
    connection: Arc<Connection>,
    devices: Arc<Devices>,
    enrolments: Arc<Enrolments>,
    recorder: Arc<Recorder>,
    watches: Arc<Watches>,
    ros: Arc<RosSide>,
    pins: Arc<Pinning>,
    working: Mutex<Option<Arc<Working>>>,
    /// The topics followed now.
    followed: Mutex<BTreeSet<String>>,
    /// What is noted is changed one change at a time.
    noting: Mutex<()>,
}

impl Unattended {
    /// From the shared parts, and those that lend, that capture, and that judge publishers.
    pub fn new(
        of: &Parts,
        (connection, devices, enrolments): (&Arc<Connection>, &Arc<Devices>, &Arc<Enrolments>),
        (recorder, watches, ros): (&Arc<Recorder>, &Arc<Watches>, &Arc<RosSide>),
        pins: &Arc<Pinning>,
    ) -> Self {
        let Parts { home, config, plant, hub, log, owners, link, life, sender, supervisor, .. } = of.clone();
        Self {
            home,
            config,
            plant,
            hub,
            log,
            owners,
            link,
            life,
            sender,
            supervisor,
            connection: Arc::clone(connection),
            devices: Arc::clone(devices),
            enrolments: Arc::clone(enrolments),
            recorder: Arc::clone(recorder),
            watches: Arc::clone(watches),
            ros: Arc::clone(ros),
            pins: Arc::clone(pins),
            working: Mutex::default(),
            followed: Mutex::default(),
            noting: Mutex::default(),
        }
    }

    fn working(&self) -> Option<Arc<Working>> {
        self.working.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Begins to capture what the profile watches, with what the credential holds.
    ///
    /// # Errors
    /// If the credential is of another profile, account or chain.
    pub(in crate::site) async fn begin(
        self: &Arc<Self>,
        profile: &ProfileName,
        mut credential: UnattendedCredential,
    ) -> Result<UnattendedView, Failure> {
        self.check(profile, &credential)?;
        let enrolment = &mut credential.enrolment;
        block_in_place(|| notices::catch_up(&self.plant, enrolment))?;
        let (device, account) = (enrolment.device_id(), credential.witness.address());
        let started = async { self.start(profile, credential, device, account) };
        self.log.deed(profile, "unattended", &device.to_string(), started).await
    }

    fn start(
        self: &Arc<Self>,
        profile: &ProfileName,
        credential: UnattendedCredential,
        device: SignerId,
        account: Address,
    ) -> Result<UnattendedView, Failure> {
        let enrolment = &credential.enrolment;
        block_in_place(|| self.plant.ledger.keep_signer(device, enrolment.device.public))?;
        let author = Arc::new(Author::new(enrolment.owner));
        author.obey(enrolment);
        let topics = enrolment.keys.now.key.topics().unwrap_or_default();
        // Those of its own statements are no topics that anybody watches.
        let topics = topics.into_iter().filter(|topic| topic.starts_with('/')).collect();
        let reach = Reach::Until(credential.until, working::LOAN);
        let standing = Standing::new((profile.clone(), author), device, account, topics, reach);
        let standing = Arc::new(standing);
        let working = Working {
            standing: Arc::clone(&standing),
            domain: enrolment.domain,
            until: credential.until,
            witness: credential.witness.clone(),
        };
        self.pins.introduce_account(standing.author.address, profile);
        self.owners.stand_in(&standing)?;
        *self.working.lock().unwrap_or_else(PoisonError::into_inner) = Some(Arc::new(working));
        if self.home.passphrase(profile).exists() {
            let text = "the passphrase of this profile is stored beside its keyring, so anyone who reads the home has all its keys: \
                        unattended capture protects nothing until that file is moved away";
            self.hub.notice(NoticeLevel::Warning, text);
        }
        block_in_place(|| self.look())?;
        self.work();
        self.view(profile)?.ok_or_else(|| refused("unattended capture did not begin"))
    }

    fn check(&self, profile: &ProfileName, credential: &UnattendedCredential) -> Result<(), Failure> {
        let enrolment = &credential.enrolment;
        if enrolment.name != *profile {
            return Err(input(format!(
                "the credential is for profile '{}', not for '{profile}'; choose that one with --profile",
                enrolment.name
            )));
        }
        let address = self.owners.address_of(profile)?;
        if enrolment.owner != address {
            return Err(refused(format!(
                "the credential is for the account {}, but profile '{profile}' is {address}; write another one with \
                 `authros unattended prepare`",
                enrolment.owner
            )));
        }
        let pinned = self.connection.pin()?.map(|pin| adoption::domain_of(&pin));
        if pinned.is_some_and(|domain| domain != enrolment.domain) {
            return Err(refused(
                "the credential is for another chain or contract than this home's; write another one with `authros \
                 unattended prepare`",
            ));
        }
        Ok(())
    }

    /// Whether the owner has come, and captures with the profile's own keys.
    fn is_taken_over(&self, standing: &Standing) -> bool {
        self.owners.get(&standing.profile).is_some()
    }

    /// How unattended capture of a profile stands: what works here now, or what was prepared.
    pub(in crate::site) fn view(&self, profile: &ProfileName) -> Result<Option<UnattendedView>, Failure> {
        if let Some(working) = self.working().filter(|working| working.standing.profile == *profile) {
            return Ok(Some(self.view_of(&working.standing)));
        }
        let Ok(owner) = self.owners.address_of(profile) else { return Ok(None) };
        let noted = block_in_place(|| self.noted(owner))?;
        Ok(noted.into_iter().rfind(|noted| !noted.ended).map(|noted| UnattendedView {
            state: UnattendedState::Prepared,
            profile: profile.clone(),
            device: noted.device,
            account: noted.account,
            topics: noted.topics.iter().map(|topic| crate::model::clean(topic, 255)).collect(),
            until: Some(noted.until),
            why: None,
        }))
    }

    fn view_of(&self, standing: &Standing) -> UnattendedView {
        let (state, until, why) = match standing.reach() {
            _ if self.is_taken_over(standing) => (UnattendedState::Attended, None, None),
            Reach::Until(until, why) => (UnattendedState::Capturing, Some(until), Some(why.to_owned())),
            Reach::Ended(why) => (UnattendedState::Ended, None, Some(crate::model::clean(&why, 300))),
        };
        UnattendedView {
            state,
            profile: standing.profile.clone(),
            device: standing.device,
            account: standing.account,
            topics: standing.topics.iter().map(|topic| crate::model::clean(topic, 255)).collect(),
            until,
            why,
        }
    }

    /// Whether this anchors an account's records at present, so that the owner's own anchoring waits.
    pub(in crate::site) fn anchors_for(&self, owner: Address) -> bool {
        let working = self.working();
        working.is_some_and(|working| working.standing.author.address == owner && working.standing.anchors())
    }

    /// Until when capture goes on, if nobody comes: nothing if this site does not capture unattended.
    pub(in crate::site) fn reach(&self) -> Option<(Address, Reach)> {
        let standing = Arc::clone(&self.working()?.standing);
        if self.is_taken_over(&standing) { None } else { Some((standing.author.address, standing.reach())) }
    }

    /// Its part in the site's health.
    pub(in crate::site) fn health(&self) -> Result<Option<PartHealth>, Failure> {
        let Some(working) = self.working() else { return Ok(None) };
        let standing = &working.standing;
        let (level, text) = if self.is_taken_over(standing) {
            (HealthLevel::Ok, format!("profile '{}' was unlocked; its own keys capture and anchor", standing.profile))
        } else if let Some(reason) = self.sender.state_of(standing.account)?.paused {
            (HealthLevel::Failed, format!("nothing is anchored unattended: {}", reason.text(standing.account)))
        } else {
            match standing.reach() {
                Reach::Until(until, why) => (
                    HealthLevel::Ok,
                    format!("unattended until {until} ({why}); profile '{}' is locked", standing.profile),
                ),
                Reach::Ended(_) => (HealthLevel::Failed, standing.text()),
            }
        };
        let text = crate::model::clean(&text, 300);
        Ok(Some(PartHealth { part: "capture".to_owned(), level, text, since: None, retry: None }))
    }
    /// Every device that ever captured unattended for this home's accounts: they are no robots that fall silent.
    pub(in crate::site) fn devices(&self) -> Result<Vec<SignerId>, Failure> {
        let mut devices = Vec::new();
        for account in self.owners.accounts() {
            devices.extend(self.noted(account)?.into_iter().map(|noted| noted.device));
        }
        Ok(devices)
    }
}

impl Site {
    /// Captures for a locked profile with what a credential holds, until that ends or somebody unlocks the profile.
    ///
    /// # Errors
    /// If the credential is of another profile, account or chain, or the ledger cannot be written.
    pub async fn capture_unattended(
        self: &Arc<Self>,
        profile: &ProfileName,
        credential: UnattendedCredential,
    ) -> Result<UnattendedView, Failure> {
        self.unattended.begin(profile, credential).await
    }
}

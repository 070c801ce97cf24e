//! The robots enrolled by an owner, and what each is to seal under.

use crate::pipeline::Plant;
use crate::service::hub::Hub;
use crate::site::parts::Parts;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::watch;
use tokio::task::block_in_place;

use crate::crypto::{EpochIssue, IssuedKeys, IssuedTopic, SealingKey, filter_key, topic_id, topic_key};
use crate::model::{Address, ProfileName, PublicKey, SignerId, clean};
use crate::pipeline::{Network, Owner, quarantine, recorder_heads};
use crate::service::failure::refused;
use crate::service::reply::{Failure, RobotGatewayView};
use crate::site::sharing::overdue::earliest_expiry;
use crate::store::Ledger;

/// An enrolled device, as its owner's ledger stores it: no secret.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Enrolled {
    /// N.
    pub name: ProfileName,
    /// SM3 of its public key.
    pub device: SignerId,
    /// Its topics; empty = none.
    pub topics: Vec<String>,
    /// Whether it was recalled.
    pub ended: bool,
    /// Its public key.
    pub key: PublicKey,
    /// Its gateway, and where it finds it.
    pub gateway: Option<EnrolledGateway>,
}

/// The gateway of an enrolled robot.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct EnrolledGateway {
    /// Host:port each, in the order in which the robot tries them.
    pub addresses: Vec<String>,
    /// SM3 of its identity key.
    pub key: SignerId,
}

impl From<EnrolledGateway> for RobotGatewayView {
    fn from(gateway: EnrolledGateway) -> Self {
        let EnrolledGateway { addresses, key } = gateway;
        Self { addresses: addresses.iter().map(|address| clean(address, 255)).collect(), key }
    }
}

/// The enrolled robots, and what they have been told.
pub(in crate::site) struct Enrolments {
    pub(super) plant: Plant,
    pub(super) hub: Arc<Hub>,
    /// Changes whenever a notice was sealed.
    pub(super) sealed: watch::Sender<()>,
    /// Notices are numbered one at a time.
    pub(super) sealing: Mutex<()>,
    /// Robots that lack a notice, and why.
    untold: Mutex<BTreeMap<(Address, SignerId, Step), Untold>>,
}

/// A step of a notice on its way to a robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Step {
    /// Sealing and storing it here.
    Seal,
    /// Bringing it to a gateway elsewhere.
    Carry,
}

/// A robot that a notice cannot reach.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::site) struct Untold {
    /// N.
    pub name: ProfileName,
    /// Why.
    pub why: String,
}

impl Enrolments {
    /// From the shared parts.
    pub fn new(parts: &Parts) -> Self {
        let Parts { plant, hub, .. } = parts.clone();
        Self { plant, hub, sealed: watch::channel(()).0, sealing: Mutex::default(), untold: Mutex::default() }
    }
}

impl Enrolments {
    /// What a device is to seal under, as the owner's own recorder does.
    pub(super) fn issue(&self, owner: &Owner, network: &Network, to: &Enrolled) -> Result<IssuedKeys, Failure> {
        let sealing = owner.sealing().filter(|keys| keys.domain == network.domain);
        let sealing = sealing
            .ok_or_else(|| refused("no epoch has started that this keyring has the key of; run `authros register`"))?;
        let now = self.issue_of(owner, network, to, sealing.epoch)?;
        let next = match owner.author.next().filter(|(_, keys)| keys.epoch > sealing.epoch) {
            Some((moment, keys)) => Some((moment, self.issue_of(owner, network, to, keys.epoch)?)),
            None => None,
        };
        Ok(IssuedKeys { now, next })
    }

    fn issue_of(&self, owner: &Owner, network: &Network, to: &Enrolled, epoch: u64) -> Result<EpochIssue, Failure> {
        let lacking = || refused(format!("the keyring has no key of epoch {epoch}"));
        let key = owner.epoch_key(network.domain, epoch).ok_or_else(lacking)?;
        let token = owner.token(network.domain, epoch).ok_or_else(lacking)?;
        let index = owner.index();
        let of = |topic: &String| {
            let id = topic_id(&index, topic);
            (topic.clone(), IssuedTopic { id, filters: filter_key(&index, &id), key: topic_key(&key, &id) })
        };
        // Its quarantine counts have a topic name of their own, and so has the statement of how high its topics'
        // numbers are.
        let statements = [quarantine::TOPIC, recorder_heads::TOPIC].map(ToOwned::to_owned);
        let keys = to.topics.iter().chain(&statements).map(of).collect();
        let key = if to.topics.is_empty() { SealingKey::Epoch(key) } else { SealingKey::Topics(keys) };
        Ok(EpochIssue { epoch, token, ends: earliest_expiry(owner, network, epoch), key })
    }

    /// The robots enrolled by this owner, oldest first.
    pub(in crate::site) fn of(&self, owner: &Owner) -> Result<Vec<Enrolled>, Failure> {
        block_in_place(|| of_account(&self.plant.ledger, owner.address))
    }

    /// Notes another device.
    pub(super) fn add(&self, owner: &Owner, enrolled: Enrolled) -> Result<(), Failure> {
        self.change_all(owner, |all| all.push(enrolled))
    }

    /// Notes why a step of a robot's notices fails; `None` once it works or is not needed.
    pub(super) fn note_untold(&self, owner: Address, robot: &Enrolled, step: Step, why: Option<String>) {
        let mut untold = self.untold.lock().unwrap_or_else(PoisonError::into_inner);
        let place = (owner, robot.device, step);
        match why {
            Some(why) => drop(untold.insert(place, Untold { name: robot.name.clone(), why })),
            None => drop(untold.remove(&place)),
        }
    }

    /// The robots that lack a notice, of one owner or of all.
    pub(in crate::site) fn untold(&self, owner: Option<Address>) -> Vec<Untold> {
        let untold = self.untold.lock().unwrap_or_else(PoisonError::into_inner);
        let of = |whose: &Address| owner.is_none_or(|owner| owner == *whose);
        untold.iter().filter(|((whose, ..), _)| of(whose)).map(|(_, untold)| untold.clone()).collect()
    }

    /// Notes that a device was recalled.
    pub(super) fn note_recalled(&self, owner: &Owner, device: SignerId) -> Result<(), Failure> {
        let mut untold = self.untold.lock().unwrap_or_else(PoisonError::into_inner);
        untold.retain(|(whose, of, _), _| (*whose, *of) != (owner.address, device));
        drop(untold);
        self.change(owner, device, |enrolled| enrolled.ended = true)
    }

    /// Changes what is noted of a device.
    pub(super) fn change(
        &self,
        owner: &Owner,
        device: SignerId,
        change: impl Fn(&mut Enrolled),
    ) -> Result<(), Failure> {
        self.change_all(owner, |all| all.iter_mut().filter(|enrolled| enrolled.device == device).for_each(change))
    }

    fn change_all(&self, owner: &Owner, change: impl FnOnce(&mut Vec<Enrolled>)) -> Result<(), Failure> {
        let changed = |text: Option<&str>| {
            let mut all = read(text);
            change(&mut all);
            Ok((serde_json::to_string(&all).unwrap_or_default(), ()))
        };
        block_in_place(|| self.plant.ledger.change_setting(&place(owner.address), changed))
    }
}

/// Which robots cannot be told what, in words.
pub(in crate::site) fn words(untold: &[Untold]) -> String {
    let each: Vec<String> =
        untold.iter().map(|robot| format!("'{}' ({})", robot.name, clean(&robot.why, 300))).collect();
    format!("FAILED to tell {}", each.join(", "))
}

/// The robots enrolled by an account, oldest first. Waits for the disk.
///
/// # Errors
/// Errors of the ledger.
pub(in crate::site) fn of_account(ledger: &Ledger, owner: Address) -> Result<Vec<Enrolled>, Failure> {
    Ok(read(ledger.setting(&place(owner))?.as_deref()))
}

fn read(text: Option<&str>) -> Vec<Enrolled> {
    text.and_then(|text| serde_json::from_str(text).ok()).unwrap_or_default()
}

fn place(owner: Address) -> String {
    format!("enrolled:{owner}")
}

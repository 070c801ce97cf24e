//! An owner's enrolled robots, and the keys each seals under.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex};

use serde::{Deserialize, Serialize};
use tokio::sync::watch;
use tokio::task::block_in_place;

use super::Seat;
use crate::command::{SecretBytes, SecretText};
use crate::crypto::enrolment::{LONGEST_ADDRESS, MOST_ADDRESSES};
use crate::crypto::{
    Enrolment, EpochIssue, IssuedKeys, IssuedTopic, Passphrase, SealedEnrolment, SealingKey, SmKeyPair, filter_key,
    notice_key, notice_topic, signer_id, topic_id, topic_key,
};
use crate::gateway::{Context, DeviceNotice};
use crate::model::{Address, ErrorKind, ProfileName, SignerId, Timestamp, TopicName, clean, locked, natural};
use crate::pipeline::authority::{Moment, may_sign};
use crate::pipeline::{Network, Owner, quarantine, recorder_heads};
use crate::reply::{DeviceTopicsView, EnrolledView, Failure, Result, RobotGatewayView, input, refused};
use crate::site::gateway::desk::is_reserved;
use crate::site::sharing::earliest_expiry;
use crate::site::{Devices, Parts};
use crate::store::Notes;
use crate::store::notes::{Enrolled, EnrolledGateway, EnrolledRobots};

impl From<EnrolledGateway> for RobotGatewayView {
    fn from(gateway: EnrolledGateway) -> Self {
        let EnrolledGateway { addresses, key } = gateway;
        Self { addresses: addresses.iter().map(|address| clean(address, 255)).collect(), key }
    }
}

pub struct Enrolments {
    pub(super) parts: Parts,
    pub(super) sealed: watch::Sender<()>,
    /// Serialises the numbering of notices.
    pub(super) sealing: Mutex<()>,
    untold: Mutex<BTreeMap<(Address, SignerId, Step), String>>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Step {
    Seal,
    Carry,
}

impl Enrolments {
    pub fn new(parts: &Parts) -> Self {
        let sealed = watch::channel(()).0;
        Self { parts: parts.clone(), sealed, sealing: Mutex::default(), untold: Mutex::default() }
    }

    pub fn issue(&self, owner: &Owner, network: &Network, to: &Enrolled) -> Result<IssuedKeys> {
        let sealing = owner.sealing().filter(|keys| keys.domain == network.domain);
        let sealing = sealing.ok_or_else(|| {
            refused("this keyring has the key of no epoch that has started; run `authros identity register`")
        })?;
        let now = self.issue_of(owner, network, to, sealing.epoch)?;
        let next = owner.author.next().filter(|(_, keys)| keys.epoch > sealing.epoch);
        let next = next.map(|(from, keys)| Ok::<_, Failure>((from, self.issue_of(owner, network, to, keys.epoch)?)));
        Ok(IssuedKeys { now, next: next.transpose()? })
    }

    fn issue_of(&self, owner: &Owner, network: &Network, to: &Enrolled, epoch: u64) -> Result<EpochIssue> {
        let lacking = || refused(format!("the keyring has no key of epoch {epoch}"));
        let key = owner.epoch_key(network.domain, epoch).ok_or_else(lacking)?;
        let token = owner.token(network.domain, epoch).ok_or_else(lacking)?;
        let index = owner.index();
        let of = |topic: &String| {
            let id = topic_id(&index, topic);
            (topic.clone(), IssuedTopic { id, filters: filter_key(&index, &id), key: topic_key(&key, &id) })
        };
        // A robot's own statements have topic names too.
        let statements = [quarantine::TOPIC, recorder_heads::TOPIC].map(ToOwned::to_owned);
        let keys = to.topics.iter().chain(&statements).map(of).collect();
        let key = if to.topics.is_empty() { SealingKey::Epoch(key) } else { SealingKey::Topics(keys) };
        Ok(EpochIssue { epoch, token, ends: earliest_expiry(owner, network, epoch), key })
    }

    pub fn of(&self, owner: &Owner) -> Result<Vec<Enrolled>> {
        block_in_place(|| of_account(&self.parts.plant.ledger.notes, owner.address))
    }

    /// Whether robots record for this account.
    pub fn has_any(&self, owner: Address) -> Result<bool> {
        Ok(of_account(&self.parts.plant.ledger.notes, owner)?.iter().any(|robot| !robot.ended))
    }

    pub fn lent(&self, owner: &Owner, network: &Network) -> Result<Vec<Enrolled>> {
        Ok(self.of(owner)?.into_iter().filter(|robot| is_lent(owner, network, robot)).collect())
    }

    pub fn add(&self, owner: &Owner, enrolled: Enrolled) -> Result<()> {
        self.change_all(owner, |all| all.push(enrolled))
    }

    pub fn note_untold(&self, owner: Address, robot: &Enrolled, step: Step, why: Option<String>) {
        let mut untold = locked(&self.untold);
        let place = (owner, robot.device, step);
        match why {
            Some(why) => drop(untold.insert(place, format!("'{}' ({})", robot.name, clean(&why, 300)))),
            None => drop(untold.remove(&place)),
        }
    }

    /// The robots of an owner, or of any, that lack a notice, in words; `None` if there are none.
    pub fn untold(&self, owner: Option<Address>) -> Option<String> {
        let untold = locked(&self.untold);
        let lacking = untold.iter().filter(|((of, ..), _)| owner.is_none_or(|owner| owner == *of));
        let lacking: Vec<&str> = lacking.map(|(_, robot)| robot.as_str()).collect();
        (!lacking.is_empty()).then(|| format!("FAILED to notify {}", lacking.join(", ")))
    }

    pub fn note_recalled(&self, owner: &Owner, device: SignerId) -> Result<()> {
        let mut untold = locked(&self.untold);
        untold.retain(|(whose, of, _), _| (*whose, *of) != (owner.address, device));
        drop(untold);
        self.change(owner, device, |enrolled| enrolled.ended = true)
    }

    pub fn change(&self, owner: &Owner, device: SignerId, change: impl Fn(&mut Enrolled)) -> Result<()> {
        self.change_all(owner, |all| all.iter_mut().filter(|enrolled| enrolled.device == device).for_each(change))
    }

    fn change_all(&self, owner: &Owner, change: impl FnOnce(&mut Vec<Enrolled>)) -> Result<()> {
        self.parts.plant.ledger.notes.change(&EnrolledRobots { owner: owner.address }, |all: &mut Vec<Enrolled>| {
            change(all);
            Ok(())
        })
    }
}

pub(super) fn is_lent(owner: &Owner, network: &Network, robot: &Enrolled) -> bool {
    let now = Moment::newest(network.directory.now());
    !robot.ended && may_sign(&network.directory, owner.address, robot.device, now).is_ok()
}

pub fn of_account(notes: &Notes, owner: Address) -> Result<Vec<Enrolled>> {
    Ok(notes.read(&EnrolledRobots { owner })?.unwrap_or_default())
}

/// One place is reserved for the robot's own statements.
const MOST_NAMED: usize = crate::crypto::enrolment::MOST_TOPICS - 1;
const TOO_MANY: &str = "a robot can be limited to at most 1,023 topics; use --all-topics to cover everything";

#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct EnrolWishes {
    /// host:port each, in the order in which the robot tries them.
    pub addresses: Vec<String>,
    /// SM3 of the gateway's identity key; `None` trusts any.
    pub fingerprint: Option<SignerId>,
    pub name: ProfileName,
    pub topics: Vec<TopicName>,
    pub all_topics: bool,
    pub until: Option<Timestamp>,
    pub passphrase: SecretText,
}

impl Devices {
    pub async fn enrol(&self, owner: &Owner, wishes: EnrolWishes) -> Result<EnrolledView> {
        if self.parts.is_joined() && wishes.fingerprint.is_none() {
            return Err(refused(
                "a site that has joined another site can enrol robots only at a gateway whose key you confirmed: get \
                 the key from its operator and pass it as --gateway-key",
            ));
        }
        let network = self.parts.link.network().await?;
        network.directory.identity(owner.address)?;
        let passphrase = Passphrase::new(wishes.passphrase.expose().to_owned())?;
        let topics = covered(&wishes)?;
        check_addresses(&wishes.addresses)?;
        self.check_name(&network, owner, &wishes.name)?;
        let device = SmKeyPair::generate(self.parts.plant.provider)?;
        let id = signer_id(&device.public);
        let subject = format!("{} {id}", wishes.name);
        let enrolled = async {
            let context = Context { provider: self.parts.plant.provider, domain: network.domain };
            let at = (wishes.addresses, wishes.fingerprint);
            let mut seat = Seat::allocate(owner, context, at, &wishes.name).await?;
            self.lend(owner, id, wishes.until).await?;
            let notice_id = owner.topic_id(&notice_topic(&id));
            let notice = DeviceNotice { key: device.public, notices: notice_id };
            let token = self.known_token(owner, &network)?;
            if let Err(failure) = seat.tell(owner, (&wishes.name, token), notice).await {
                // Nobody will use the device; if this fails too, `robot devices` shows it.
                drop(self.unlend_device(owner, id).await);
                return Err(failure);
            }
            let (key, name, ended) = (device.public, wishes.name.clone(), false);
            let enrolled = Enrolled { name, device: id, topics, ended, key, gateway: Some(seat.noted()) };
            let keys = self.enrolments.issue(owner, &network, &enrolled)?;
            let enrolment = Enrolment {
                domain: network.domain,
                chain_id: network.chain.chain_id(),
                gateway: seat.access(),
                name: wishes.name,
                owner: owner.address,
                owner_key: owner.public_keys().0,
                device,
                // IK alone turns topic names into pseudonyms.
                index: wishes.all_topics.then(|| owner.index()),
                notice_id,
                notice_key: notice_key(&owner.eoa(), &network.domain, &id),
                token,
                last_notice: None,
                keys,
            };
            block_in_place(|| self.enrolments.note_told(owner, &enrolled, &enrolment.keys))?;
            self.enrolments.add(owner, enrolled.clone())?;
            let file = block_in_place(|| SealedEnrolment::new(enrolment, &passphrase)?.seal())?;
            Ok(EnrolledView {
                name: enrolled.name,
                device: id,
                gateway: seat.noted().into(),
                file: SecretBytes::new(file),
            })
        };
        self.parts.log.deed(&owner.profile, "enrol robot", &subject, enrolled).await
    }

    /// A recall by name must not leave another robot able to read.
    fn check_name(&self, network: &Network, owner: &Owner, name: &ProfileName) -> Result<()> {
        if is_reserved(name) {
            return Err(input(format!("'{name}' is reserved for sites; give the robot another name")));
        }
        match self.called(network, owner, name.as_str())?.into_iter().find(|(_, lent)| *lent) {
            Some((device, _)) => Err(refused(format!(
                "a robot called '{name}' is enrolled already, as device {device}; revoke it with `authros robot \
                 revoke {name}`, or give this robot another name"
            ))),
            None => Ok(()),
        }
    }

    pub fn known_token(&self, owner: &Owner, network: &Network) -> Result<crate::model::Token> {
        let account = network.directory.account(owner.address);
        let token = account.and_then(|account| account.token);
        token.ok_or_else(|| refused("the chain has no token of this account; run `authros identity register` first"))
    }

    pub async fn add_topics(&self, owner: &Arc<Owner>, device: &str, topics: &[TopicName]) -> Result<DeviceTopicsView> {
        let network = self.parts.link.network().await?;
        let device = self.lent_device(&network, owner, device)?;
        let found = self.enrolments.of(owner)?.into_iter().rfind(|enrolled| enrolled.device == device);
        let mut enrolled = found.ok_or_else(|| {
            refused(format!("device {device} was not enrolled from this home, so its topics are not known here"))
        })?;
        if enrolled.topics.is_empty() {
            return Err(refused(format!("'{}' already covers all topics", enrolled.name)));
        }
        let names = topics.iter().map(ToString::to_string);
        let added: BTreeSet<String> = names.filter(|topic| !enrolled.topics.contains(topic)).collect();
        let added = Vec::from_iter(added);
        if added.is_empty() {
            return Err(refused(format!("'{}' already covers these topics", enrolled.name)));
        }
        enrolled.topics.extend(added.iter().cloned());
        enrolled.topics.sort_by(|one, other| natural(one, other));
        if enrolled.topics.len() > MOST_NAMED {
            return Err(input(TOO_MANY));
        }
        let told = async {
            self.enrolments.change(owner, device, |noted| noted.topics.clone_from(&enrolled.topics))?;
            block_in_place(|| self.enrolments.tell_devices(owner, &network))
        };
        let subject = format!("{device}: {}", added.join(" "));
        self.parts.log.deed(&owner.profile, "robot topics", &subject, told).await?;
        Ok(DeviceTopicsView { name: enrolled.name, device, added, topics: enrolled.topics })
    }
}

pub fn check_addresses(addresses: &[String]) -> Result<()> {
    if addresses.iter().any(|address| address.is_empty() || address.len() > LONGEST_ADDRESS) {
        return Err(input("an address of a gateway has 1 to 255 characters"));
    }
    if !(1..=MOST_ADDRESSES).contains(&addresses.len()) {
        return Err(input("give a robot one to eight addresses of its gateway"));
    }
    Ok(())
}

fn covered(wishes: &EnrolWishes) -> Result<Vec<String>> {
    if wishes.all_topics != wishes.topics.is_empty() {
        return Err(Failure::new(
            ErrorKind::Usage,
            "choose what the robot may record: --topic /robot/odom (repeatable) for some topics, or --all-topics, \
             which gives it the epoch's key and the index key, so that anyone who steals it can read all it could",
        ));
    }
    let topics: BTreeSet<String> = wishes.topics.iter().map(ToString::to_string).collect();
    if topics.len() > MOST_NAMED { Err(input(TOO_MANY)) } else { Ok(topics.into_iter().collect()) }
}

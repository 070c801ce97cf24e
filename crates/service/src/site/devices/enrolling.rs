//! Making a robot a device of its owner: a pair of its own, K_T for its name at a gateway, the loan on the chain,
//! its public key to the gateway, and the file with all that the robot works with.

use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use tokio::task::block_in_place;

use crate::crypto::{
    Enrolment, EpochIssue, GatewayAccess, IssuedKeys, IssuedTopic, Passphrase, Pseudonyms, SealedEnrolment, SealingKey,
    SmKeyPair, TransportKey, filter_key, notice_key, notice_topic, signer_id, topic_id, topic_key,
};
use crate::gateway::{Applicant, Client, Code, Context, Credentials, DeviceNotice, Endpoint, GatewayError, Trust};
use crate::model::{ErrorKind, ProfileName, SignerId, Timestamp, TopicName, clean};
use crate::pipeline::{Network, Owner, quarantine};
use crate::service::command::{SecretBytes, SecretText};
use crate::service::failure::{input, refused};
use crate::service::reply::{DeviceTopicsView, EnrolledView, Failure};
use crate::site::Site;

/// How long a gateway may take to answer.
const PATIENCE: Duration = Duration::from_secs(20);
/// How often the gateway is told of a device before its chain has the loan.
const ATTEMPTS: u32 = 20;

/// The most topics that a robot can be limited to; one place is for what it states itself.
const MOST_NAMED: usize = crate::crypto::enrolment::MOST_TOPICS - 1;
const TOO_MANY: &str = "a robot can be limited to at most 1,023 topics; use --all-topics to cover all";

/// What an owner asks for when enrolling a robot.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct EnrolWishes {
    /// The gateway, host:port.
    pub gateway: String,
    /// SM3 of its identity key; `None` to trust whatever answers.
    pub fingerprint: Option<SignerId>,
    /// N.
    pub name: ProfileName,
    /// Only these topics.
    pub topics: Vec<TopicName>,
    /// All topics, those to come included: then no topic is named.
    #[serde(default)]
    pub all_topics: bool,
    /// When the loan ends.
    pub until: Option<Timestamp>,
    /// Protects the file.
    pub passphrase: SecretText,
}

/// A device that was enrolled, as its owner's ledger keeps it: no secret.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Enrolled {
    /// N.
    pub name: ProfileName,
    /// SM3 of its public key.
    pub device: SignerId,
    /// What it is limited to; empty = nothing.
    pub topics: Vec<String>,
    /// Version of its enrolment.
    #[serde(default = "first")]
    pub version: u8,
    /// Whether it was recalled.
    #[serde(default)]
    pub ended: bool,
}

fn first() -> u8 {
    1
}

impl Site {
    /// Enrols a robot; the answer holds the sealed file.
    pub(in crate::site) async fn enrol_device(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        wishes: EnrolWishes,
    ) -> Result<EnrolledView, Failure> {
        if self.remote.is_some() && wishes.fingerprint.is_none() {
            return Err(refused(
                "a site that joins another one enrols robots only at a gateway whose fingerprint was compared: have its \
                 keeper tell it, and give it as --gateway-key",
            ));
        }
        let network = self.link.network().await?;
        network.directory.identity(owner.address)?;
        let passphrase = Passphrase::new(wishes.passphrase.expose().to_owned())?;
        let topics = covered(&wishes)?;
        if wishes.gateway.len() > crate::crypto::enrolment::LONGEST_GATEWAY {
            return Err(input("a gateway's address has at most 255 characters"));
        }
        let device = SmKeyPair::generate(self.plant.provider)?;
        let id = signer_id(&device.public);
        self.log.begin(owner, "enrol device", &format!("{} {id}", wishes.name)).await?;
        let context = Context { provider: self.plant.provider, domain: network.domain };
        let endpoint = Endpoint { address: wishes.gateway.clone(), context, patience: PATIENCE };
        let mut trust = wishes.fingerprint.map_or_else(Trust::on_first_use, Trust::pinned);
        let transport = allocate(owner, &endpoint, &mut trust, &wishes.name).await?;
        self.lend_device(owner, id, wishes.until).await?;
        let notice_id = owner.topic_id(&notice_topic(&id));
        let notice = DeviceNotice { key: device.public, notices: Some(notice_id) };
        let told = self.tell_gateway(owner, &network, &endpoint, &mut trust, (&wishes.name, &transport), notice);
        if let Err(failure) = told.await {
            // A device that nobody will ever use should not stay lent; where this fails too, `devices list` shows it.
            drop(self.unlend_device(owner, id).await);
            return Err(failure);
        }
        let version = Enrolment::NEWEST;
        let enrolled = Enrolled { name: wishes.name.clone(), device: id, topics, version, ended: false };
        let keys = self.issue(owner, &network, &enrolled)?;
        let fingerprint = trust.pinned.ok_or_else(|| refused("the gateway did not show who it is"))?;
        let enrolment = Enrolment {
            domain: network.domain,
            chain_id: network.chain.chain_id(),
            gateways: vec![GatewayAccess { address: wishes.gateway, fingerprint, transport }],
            name: wishes.name,
            owner: owner.address,
            owner_key: owner.public_keys().0,
            device,
            // Names of any topic become pseudonyms by IK alone.
            index: wishes.all_topics.then(|| owner.index()),
            notice_id,
            notice_key: notice_key(&owner.eoa(), &network.domain, &id),
            token: self.known_token(owner, &network)?,
            noticed: None,
            keys,
            version,
        };
        block_in_place(|| self.note_told(owner, &enrolled, &enrolment.keys))?;
        self.note_enrolled(owner, enrolled)?;
        let file = block_in_place(|| SealedEnrolment::new(enrolment, &passphrase).and_then(|sealed| sealed.seal()))?;
        self.enrolled_view(&endpoint, fingerprint, id, owner, SecretBytes::new(file))
    }

    fn enrolled_view(
        &self,
        endpoint: &Endpoint,
        gateway_key: SignerId,
        device: SignerId,
        owner: &Owner,
        file: SecretBytes,
    ) -> Result<EnrolledView, Failure> {
        let enrolled = self.enrolled_devices(owner)?;
        let name = enrolled.iter().find(|other| other.device == device).map(|other| other.name.clone());
        let name = name.ok_or_else(|| refused("the device was not noted"))?;
        Ok(EnrolledView { name, device, gateway: clean(&endpoint.address, 255), gateway_key, file })
    }

    /// A token of the owner that the chain has.
    fn known_token(&self, owner: &Owner, network: &Network) -> Result<crate::model::Token, Failure> {
        let account = network.directory.account(owner.address);
        let token = account.and_then(|account| account.token);
        token.ok_or_else(|| refused("the chain has no token of this account; run `authros register` first"))
    }

    async fn tell_gateway(
        &self,
        owner: &Owner,
        network: &Network,
        endpoint: &Endpoint,
        trust: &mut Trust,
        (name, key): (&ProfileName, &TransportKey),
        mut notice: DeviceNotice,
    ) -> Result<(), Failure> {
        let token = self.known_token(owner, network)?;
        let credentials = Credentials { name: name.clone(), key: key.clone(), token };
        let mut client = Client::connect(endpoint, trust, &credentials).await?;
        for attempt in 1.. {
            match client.device(&owner.signing(), notice).await {
                // A gateway of an earlier version is told the key alone.
                Err(GatewayError::Refused(Code::Malformed)) if notice.notices.is_some() => notice.notices = None,
                // Its node may be behind ours.
                Err(GatewayError::Refused(Code::Signature | Code::NotRegistered | Code::Stale))
                    if attempt < ATTEMPTS =>
                {
                    tokio::time::sleep(Duration::from_secs(1)).await;
                }
                told => return Ok(told.map(|_| ())?),
            }
        }
        Ok(())
    }

    /// What a device is to seal under, as the owner's own recorder does.
    pub(in crate::site) fn issue(
        &self,
        owner: &Owner,
        network: &Network,
        to: &Enrolled,
    ) -> Result<IssuedKeys, Failure> {
        let sealing = owner.sealing().filter(|keys| keys.domain == network.domain);
        let sealing = sealing.ok_or_else(|| refused("no epoch has begun; run `authros register` first"))?;
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
            let pseudonyms = (to.version > 1).then(|| Pseudonyms { id, filters: filter_key(&index, &id) });
            (topic.clone(), IssuedTopic { key: topic_key(&key, &id), pseudonyms })
        };
        // What it holds back of its topics is counted under a name of its own.
        let statements = (to.version > 1).then(|| quarantine::TOPIC.to_owned());
        let keys = to.topics.iter().chain(&statements).map(of).collect();
        let key = if to.topics.is_empty() { SealingKey::Epoch(key) } else { SealingKey::Topics(keys) };
        Ok(EpochIssue { epoch, token, ends: self.earliest_expiry(owner, network, epoch), key })
    }

    /// Gives an enrolled robot the keys of more topics; its next notice tells it.
    pub(in crate::site) async fn add_device_topics(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        device: &str,
        topics: &[TopicName],
    ) -> Result<DeviceTopicsView, Failure> {
        let network = self.link.network().await?;
        let device = self.lent_device(&network, owner, device)?;
        let mut all = self.enrolled_devices(owner)?;
        let enrolled = all.iter_mut().rfind(|enrolled| enrolled.device == device);
        let enrolled = enrolled.ok_or_else(|| {
            refused(format!("device {device} was not enrolled from this home, so its topics are not known here"))
        })?;
        if enrolled.topics.is_empty() {
            return Err(refused(format!("'{}' covers all topics already", enrolled.name)));
        }
        let names = topics.iter().map(ToString::to_string);
        let mut added: Vec<String> = names.filter(|topic| !enrolled.topics.contains(topic)).collect();
        added.sort();
        added.dedup();
        if added.is_empty() {
            return Err(refused(format!("'{}' covers these topics already", enrolled.name)));
        }
        enrolled.topics.extend(added.iter().cloned());
        enrolled.topics.sort();
        if enrolled.topics.len() > MOST_NAMED {
            return Err(input(TOO_MANY));
        }
        let enrolled = enrolled.clone();
        self.log.begin(owner, "device topics", &format!("{device}: {}", added.join(" "))).await?;
        self.write_enrolled(owner, &all)?;
        block_in_place(|| self.tell_devices(owner, &network))?;
        Ok(DeviceTopicsView { name: enrolled.name, device, added, topics: enrolled.topics })
    }

    /// The robots that this owner has enrolled, oldest first.
    pub(in crate::site) fn enrolled_devices(&self, owner: &Owner) -> Result<Vec<Enrolled>, Failure> {
        let text = block_in_place(|| self.plant.ledger.setting(&place(owner)))?;
        Ok(text.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default())
    }

    fn note_enrolled(&self, owner: &Owner, enrolled: Enrolled) -> Result<(), Failure> {
        let mut all = self.enrolled_devices(owner)?;
        all.push(enrolled);
        self.write_enrolled(owner, &all)
    }

    /// Notes that a device was recalled.
    pub(in crate::site) fn note_recalled(&self, owner: &Owner, device: SignerId) -> Result<(), Failure> {
        let mut all = self.enrolled_devices(owner)?;
        all.iter_mut().filter(|enrolled| enrolled.device == device).for_each(|enrolled| enrolled.ended = true);
        self.write_enrolled(owner, &all)
    }

    fn write_enrolled(&self, owner: &Owner, all: &[Enrolled]) -> Result<(), Failure> {
        let text = serde_json::to_string(all).unwrap_or_default();
        Ok(block_in_place(|| self.plant.ledger.put_setting(&place(owner), &text))?)
    }
}

/// The topics that are wished for, in order; none for all.
fn covered(wishes: &EnrolWishes) -> Result<Vec<String>, Failure> {
    if wishes.all_topics != wishes.topics.is_empty() {
        return Err(Failure::new(
            ErrorKind::Usage,
            "say what the robot may record: --topic /robot/odom (may be repeated) for some topics, or --all-topics for \
             all, which hands it the epoch's key and the index key: whoever steals it reads what it could",
        ));
    }
    let mut topics: Vec<String> = wishes.topics.iter().map(ToString::to_string).collect();
    topics.sort();
    topics.dedup();
    if topics.len() > MOST_NAMED { Err(input(TOO_MANY)) } else { Ok(topics) }
}

fn place(owner: &Owner) -> String {
    format!("enrolled:{}", owner.address)
}

async fn allocate(
    owner: &Owner,
    endpoint: &Endpoint,
    trust: &mut Trust,
    name: &ProfileName,
) -> Result<TransportKey, Failure> {
    let (signing, account) = (owner.signing(), owner.eoa());
    let applicant = Applicant { name, signing: &signing, envelope: owner.envelope().public, account: &account };
    Ok(Client::allocate(endpoint, trust, &applicant).await?.0)
}

//! Making a robot a device of its owner: its own key pair, K_T for its name at a gateway, the loan on the chain, its
//! public key sent to the gateway, and the file with everything the robot needs.

use super::Devices;
use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use tokio::task::block_in_place;

use super::enrolled::Enrolled;
use crate::crypto::{
    Enrolment, GatewayAccess, Passphrase, SealedEnrolment, SmKeyPair, TransportKey, notice_key, notice_topic, signer_id,
};
use crate::gateway::{Applicant, Client, Code, Context, Credentials, DeviceNotice, Endpoint, GatewayError, Trust};
use crate::model::{ErrorKind, ProfileName, SignerId, Timestamp, TopicName, clean};
use crate::pipeline::{Network, Owner};
use crate::service::command::{SecretBytes, SecretText};
use crate::service::failure::{input, refused};
use crate::service::reply::{DeviceTopicsView, EnrolledView, Failure};

/// How long a gateway may take to answer.
const PATIENCE: Duration = Duration::from_secs(20);
/// How often the gateway is told of a device before the loan is on its chain.
const ATTEMPTS: u32 = 20;

/// The most topics that a robot can be limited to; one place is reserved for its own statements.
const MOST_NAMED: usize = crate::crypto::enrolment::MOST_TOPICS - 1;
const TOO_MANY: &str = "a robot can be limited to at most 1,023 topics; use --all-topics to cover everything";

/// An owner's request to enrol a robot.
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
    /// All topics, including future ones: then no topic is named.
    #[serde(default)]
    pub all_topics: bool,
    /// When the loan ends.
    pub until: Option<Timestamp>,
    /// Protects the file.
    pub passphrase: SecretText,
}

impl Devices {
    /// Enrols a robot; the answer contains the sealed file.
    pub(in crate::site) async fn enrol(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        wishes: EnrolWishes,
    ) -> Result<EnrolledView, Failure> {
        if self.is_joined && wishes.fingerprint.is_none() {
            return Err(refused(
                "a site that has joined another one can only enrol robots at a gateway whose key you confirmed: ask \
                 its operator for it and pass it as --gateway-key",
            ));
        }
        let network = self.link.network().await?;
        network.directory.identity(owner.address)?;
        let passphrase = Passphrase::new(wishes.passphrase.expose().to_owned())?;
        let topics = covered(&wishes)?;
        if wishes.gateway.len() > crate::crypto::enrolment::LONGEST_GATEWAY {
            return Err(input("a gateway's address can have at most 255 characters"));
        }
        let device = SmKeyPair::generate(self.plant.provider)?;
        let id = signer_id(&device.public);
        self.log.begin(owner, "enrol device", &format!("{} {id}", wishes.name)).await?;
        let context = Context { provider: self.plant.provider, domain: network.domain };
        let endpoint = Endpoint { address: wishes.gateway.clone(), context, patience: PATIENCE };
        let mut trust = wishes.fingerprint.map_or_else(Trust::on_first_use, Trust::pinned);
        let transport = allocate(owner, &endpoint, &mut trust, &wishes.name).await?;
        self.lend(owner, id, wishes.until).await?;
        let notice_id = owner.topic_id(&notice_topic(&id));
        let notice = DeviceNotice { key: device.public, notices: Some(notice_id) };
        let told = self.tell_gateway(owner, &network, &endpoint, &mut trust, (&wishes.name, &transport), notice);
        if let Err(failure) = told.await {
            // A device that nobody will ever use should not stay lent; if this fails too, `devices list` shows it.
            drop(self.unlend_device(owner, id).await);
            return Err(failure);
        }
        let version = Enrolment::NEWEST;
        let enrolled = Enrolled { name: wishes.name.clone(), device: id, topics, version, ended: false };
        let keys = self.enrolments.issue(owner, &network, &enrolled)?;
        let fingerprint = trust.pinned.ok_or_else(|| refused("the gateway did not identify itself"))?;
        let enrolment = Enrolment {
            domain: network.domain,
            chain_id: network.chain.chain_id(),
            gateways: vec![GatewayAccess { address: wishes.gateway, fingerprint, transport }],
            name: wishes.name,
            owner: owner.address,
            owner_key: owner.public_keys().0,
            device,
            // IK alone turns the names of any topic into pseudonyms.
            index: wishes.all_topics.then(|| owner.index()),
            notice_id,
            notice_key: notice_key(&owner.eoa(), &network.domain, &id),
            token: self.known_token(owner, &network)?,
            noticed: None,
            keys,
            version,
        };
        block_in_place(|| self.enrolments.note_told(owner, &enrolled, &enrolment.keys))?;
        self.enrolments.add(owner, enrolled)?;
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
        let enrolled = self.enrolments.of(owner)?;
        let name = enrolled.iter().find(|other| other.device == device).map(|other| other.name.clone());
        let name = name.ok_or_else(|| refused("the device was not stored"))?;
        Ok(EnrolledView { name, device, gateway: clean(&endpoint.address, 255), gateway_key, file })
    }

    /// A token of the owner that is on the chain.
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
                // A gateway of an earlier version is told only the key.
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

    /// Gives an enrolled robot the keys for more topics; its next notice tells it.
    pub(in crate::site) async fn add_topics(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        device: &str,
        topics: &[TopicName],
    ) -> Result<DeviceTopicsView, Failure> {
        let network = self.link.network().await?;
        let device = self.lent_device(&network, owner, device)?;
        let mut all = self.enrolments.of(owner)?;
        let enrolled = all.iter_mut().rfind(|enrolled| enrolled.device == device);
        let enrolled = enrolled.ok_or_else(|| {
            refused(format!("device {device} was not enrolled from this home, so its topics are not known here"))
        })?;
        if enrolled.topics.is_empty() {
            return Err(refused(format!("'{}' already covers all topics", enrolled.name)));
        }
        let names = topics.iter().map(ToString::to_string);
        let mut added: Vec<String> = names.filter(|topic| !enrolled.topics.contains(topic)).collect();
        added.sort();
        added.dedup();
        if added.is_empty() {
            return Err(refused(format!("'{}' already covers these topics", enrolled.name)));
        }
        enrolled.topics.extend(added.iter().cloned());
        enrolled.topics.sort();
        if enrolled.topics.len() > MOST_NAMED {
            return Err(input(TOO_MANY));
        }
        let enrolled = enrolled.clone();
        self.log.begin(owner, "device topics", &format!("{device}: {}", added.join(" "))).await?;
        self.enrolments.write(owner, &all)?;
        block_in_place(|| self.enrolments.tell_devices(owner, &network))?;
        Ok(DeviceTopicsView { name: enrolled.name, device, added, topics: enrolled.topics })
    }
}

/// The requested topics, in order; none for all.
fn covered(wishes: &EnrolWishes) -> Result<Vec<String>, Failure> {
    if wishes.all_topics != wishes.topics.is_empty() {
        return Err(Failure::new(
            ErrorKind::Usage,
            "choose what the robot may record: --topic /robot/odom (repeatable) for some topics, or --all-topics, \
             which gives it the epoch's key and the index key, so that anyone who steals it can read all it could",
        ));
    }
    let mut topics: Vec<String> = wishes.topics.iter().map(ToString::to_string).collect();
    topics.sort();
    topics.dedup();
    if topics.len() > MOST_NAMED { Err(input(TOO_MANY)) } else { Ok(topics) }
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

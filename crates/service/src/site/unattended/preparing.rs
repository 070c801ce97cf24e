//! The owner's side of unattended capture: the credential is made, and ended.

use std::sync::Arc;
use std::time::Duration;

use tokio::task::block_in_place;

use super::{Noted, Unattended, settling};
use crate::crypto::{
    GatewayAccess, TransportKey,
    Enrolment, SmKeyPair, UnattendedCredential, notice_key, notice_topic, signer_id, unattended_secret,
};
use crate::model::{Address, ErrorKind, ProfileName, SignerId, Timestamp, TopicName};
use crate::pipeline::authority::{Moment, may_sign};
use crate::pipeline::{Network, Owner, witness};
use crate::service::command::{self as ask, Ask as _, SecretBytes, UnattendedCommand};
use crate::service::failure::{input, internal, refused};
use crate::service::reply::{Failure, Reply, TransactionView, UnattendedFile};
use crate::site::devices::enrolled::Enrolled;

/// The setting that notes the credentials of an account, before its address.
pub(crate) const NOTED: &str = "unattended:";
/// The name of the device in `devices list` and among the robots.
const NAME: &str = "unattended";
/// The most credentials noted; older ones have nothing on its way any more.
const MOST_NOTED: usize = 16;
/// How often to look whether the account is registered, and how many times.
const LOOK: Duration = Duration::from_millis(250);
const LOOKS: usize = 480;

impl Unattended {
    /// Answers a request of an owner.
    pub(in crate::site) async fn answer(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        command: UnattendedCommand,
    ) -> Result<Reply, Failure> {
        match command {
            UnattendedCommand::PrepareUnattended { topics, until } => {
                self.prepare(owner, &topics, until).await.map(ask::PrepareUnattended::told)
            }
            UnattendedCommand::EndUnattended { force } => self.end(owner, force).await.map(ask::EndUnattended::told),
        }
    }

    /// Makes a credential: a device of its own on loan, keys of these watched topics, an account that anchors.
    async fn prepare(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        topics: &[TopicName],
        until: Timestamp,
    ) -> Result<UnattendedFile, Failure> {
        if self.config.site.is_some() {
            return Err(refused(
                "a site that has joined another one captures and anchors nothing itself; prepare it where the gateway is",
            ));
        }
        let network = self.link.network().await?;
        network.directory.identity(owner.address)?;
        if let Some(noted) =
            block_in_place(|| self.noted(owner.address))?.iter().rfind(|noted| is_open(&network, owner, noted))
        {
            return Err(refused(format!(
                "device {} is on loan for unattended capture until {}; end that first with `authros unattended end`",
                noted.device, noted.until
            )));
        }
        let topics = self.covered(&owner.profile, topics)?;
        let device = SmKeyPair::generate(self.plant.provider)?;
        let id = signer_id(&device.public);
        let made = self.make(owner, &network, (device, id), topics, until);
        self.log.deed(&owner.profile, "prepare unattended", &id.to_string(), made).await
    }

    /// The credential of this new device.
    async fn make(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        network: &Network,
        (device, id): (SmKeyPair, SignerId),
        topics: Vec<String>,
        until: Timestamp,
    ) -> Result<UnattendedFile, Failure> {
        let witness = unattended_secret(&owner.eoa(), &network.domain, &id)?;
        let (domain, account) = (network.domain, witness.address());
        let until = Timestamp::from_seconds(until.seconds());
        // Before anything is sent from that account: its transactions are found again. It stands once all is done.
        let noted = Noted { device: id, account, domain, topics: topics.clone(), until, ended: true };
        block_in_place(|| self.note(owner.address, |all| all.push(noted)))?;
        self.register_account(owner, network, &witness).await?;
        self.devices.lend(owner, id, Some(until)).await?;
        block_in_place(|| self.plant.ledger.keep_signer(id, device.public))?;
        let name: ProfileName = NAME.parse().map_err(|_| internal("the name of the device"))?;
        let enrolled = Enrolled {
            name,
            device: id,
            topics: topics.clone(),
            version: Enrolment::NEWEST,
            ended: false,
            key: Some(device.public),
            gateway: None,
        };
        let keys = self.enrolments.issue(owner, network, &enrolled)?;
        let enrolment = Enrolment {
            domain,
            chain_id: network.chain.chain_id(),
            gateway: GatewayAccess {
                addresses: Vec::new(),
                fingerprint: SignerId([0; 32]),
                transport: TransportKey::new([0; 32]),
            },
            name: owner.profile.clone(),
            owner: owner.address,
            owner_key: owner.public_keys().0,
            device,
            index: None,
            notice_id: owner.topic_id(&notice_topic(&id)),
            notice_key: notice_key(&owner.eoa(), &domain, &id),
            token: keys.now.token,
            noticed: None,
            keys,
            version: Enrolment::NEWEST,
        };
        block_in_place(|| self.enrolments.note_told(owner, &enrolled, &enrolment.keys))?;
        self.enrolments.add(owner, enrolled)?;
        let stands = |noted: &mut Noted| noted.ended &= noted.device != id;
        block_in_place(|| self.note(owner.address, |all| all.iter_mut().for_each(stands)))?;
        let credential = UnattendedCredential { enrolment, until, witness };
        let file = SecretBytes::new(credential.encode().to_vec());
        Ok(UnattendedFile { device: id, account, topics, until, file })
    }

    /// The requested topics, in order, or all that the profile watches.
    fn covered(&self, profile: &ProfileName, asked: &[TopicName]) -> Result<Vec<String>, Failure> {
        let watched: Vec<String> =
            block_in_place(|| self.watches.of(profile))?.into_iter().map(|(topic, _)| topic.to_string()).collect();
        if let Some(strange) = asked.iter().find(|topic| !watched.iter().any(|name| name == topic.as_str())) {
            return Err(input(format!(
                "topic {strange} is not watched, and unattended capture follows the watch list; run `authros topics watch \
                 {strange}` first"
            )));
        }
        let mut topics = if asked.is_empty() { watched } else { asked.iter().map(ToString::to_string).collect() };
        topics.sort();
        topics.dedup();
        if topics.is_empty() {
            let text = "no topic is watched, so there is nothing to capture; run `authros topics watch TOPIC` first";
            return Err(Failure::new(ErrorKind::Usage, text));
        }
        // Two further places are for its own statements.
        if topics.len() + 2 > crate::crypto::enrolment::MOST_TOPICS {
            return Err(input("a credential holds the keys of at most 1,022 topics; name fewer with --topic"));
        }
        Ok(topics)
    }

    /// Makes the account able to anchor: registered, and with ether where the chain asks for it.
    async fn register_account(
        &self,
        owner: &Owner,
        network: &Network,
        account: &crate::crypto::EoaSecret,
    ) -> Result<(), Failure> {
        for _ in 0..LOOKS {
            if witness::ensure_ready(&self.plant, network, &self.sender, owner, account).await? {
                return Ok(());
            }
            self.sender.tend(&network.chain, account).await?;
            tokio::time::sleep(LOOK).await;
        }
        Err(Failure::new(
            ErrorKind::Unreachable,
            format!(
                "the account {} is not registered on the contract yet; look at `authros chain status` and try again",
                account.address()
            ),
        ))
    }

    /// Ends the newest credential: once its records are anchored its device is recalled, and a new epoch begins.
    async fn end(self: &Arc<Self>, owner: &Arc<Owner>, force: bool) -> Result<TransactionView, Failure> {
        let network = self.link.network().await?;
        let noted = block_in_place(|| self.noted(owner.address))?;
        let Some(noted) = noted.iter().rfind(|noted| is_lent(&network, owner, noted)) else {
            block_in_place(|| self.note(owner.address, |all| all.iter_mut().for_each(|noted| noted.ended = true)))?;
            return Err(refused(format!(
                "nothing is on loan for unattended capture of '{}'; `authros unattended prepare` begins it",
                owner.profile
            )));
        };
        let stranded = match force {
            true => block_in_place(|| {
                let ledger = &self.plant.ledger;
                let on_their_way = ledger.on_their_way(owner.address, noted.device)?;
                Ok::<_, Failure>(on_their_way + ledger.quarantined_of(owner.address, noted.device)?)
            })?,
            false => self.anchored_all(owner.address, noted.device, settling::WAIT).await.map(|()| 0)?,
        };
        let ended = self.devices.recall(owner, &noted.device.to_string()).await?;
        block_in_place(|| self.note(owner.address, |all| all.iter_mut().for_each(|noted| noted.ended = true)))?;
        Ok(match stranded {
            0 => ended,
            count => TransactionView { text: format!("{}; {}", ended.text, settling::stranded(count)), ..ended },
        })
    }

    /// What was prepared for an account, oldest first.
    pub(super) fn noted(&self, owner: Address) -> Result<Vec<Noted>, Failure> {
        noted(&self.plant.ledger, owner)
    }

    fn note(&self, owner: Address, change: impl FnOnce(&mut Vec<Noted>)) -> Result<(), Failure> {
        let _one_at_a_time = self.noting.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let mut all = self.noted(owner)?;
        change(&mut all);
        let surplus = all.len().saturating_sub(MOST_NOTED);
        all.drain(..surplus);
        let text = serde_json::to_string(&all).unwrap_or_default();
        Ok(self.plant.ledger.put_setting(&place(owner), &text)?)
    }
}

/// What was prepared for an account, oldest first.
pub(in crate::site) fn noted(ledger: &crate::store::Ledger, owner: Address) -> Result<Vec<Noted>, Failure> {
    let text = ledger.setting(&place(owner))?;
    Ok(text.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default())
}

fn place(owner: Address) -> String {
    format!("{NOTED}{owner}")
}

/// Whether its device is lent now.
fn is_lent(network: &Network, owner: &Owner, noted: &Noted) -> bool {
    let now = Moment::newest(network.directory.now());
    may_sign(&network.directory, owner.address, noted.device, now).is_ok()
}

fn is_open(network: &Network, owner: &Owner, noted: &Noted) -> bool {
    !noted.ended && is_lent(network, owner, noted)
}

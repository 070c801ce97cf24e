//! Devices that may sign for their owner: lent and recalled on the chain.

mod courier;
pub(super) mod enrolled;
mod policies;

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use tokio::task::block_in_place;

use crate::chain::Call;
use crate::command::{self as ask, Ask as _, RobotCommand};
use crate::crypto::{Fingerprint, GatewayAccess, Notice, TransportKey};
use crate::gateway::{Applicant, Client, Code, Context, Credentials, DeviceNotice, Endpoint, GatewayError, Trust};
use crate::model::{ProfileName, RingSpan, SignerId, Timestamp, Token, TopicPattern, TopicPatterns, clean, hex};
use crate::pipeline::directory::Lending;
use crate::pipeline::{Network, Owner, authority};
use crate::reply::{DeviceRow, Failure, Part, Reply, Result, RingPullView, TransactionView, input, refused};
use crate::site::{Enrolments, Parts, Sharing, incidents};
use crate::store::notes::{Enrolled, EnrolledGateway};

const SHORTEST: usize = 8;

pub struct Devices {
    pub parts: Parts,
    pub sharing: Arc<Sharing>,
    pub enrolments: Arc<Enrolments>,
    losses: policies::Losses,
}

impl Devices {
    pub fn new(parts: Parts, sharing: Arc<Sharing>, enrolments: Arc<Enrolments>) -> Self {
        Self { parts, sharing, enrolments, losses: policies::Losses::default() }
    }

    pub async fn lend(&self, owner: &Owner, device: SignerId, until: Option<Timestamp>) -> Result<TransactionView> {
        let (network, _one_at_a_time) = (self.parts.link.network().await?, owner.changes.lock().await);
        network.directory.identity(owner.address)?;
        if until.is_some_and(|until| until <= network.directory.now()) {
            return Err(input("the authorisation would end before it starts; give a later --until"));
        }
        let until = until.map(|until| Timestamp::from_seconds(until.seconds()));
        let is_same = |lending: &Lending| (lending.device, lending.until) == (device, until);
        let is_lent = |lending: &Lending| is_same(lending) && authority::is_lent(&network.directory, lending);
        if self.lendings(&network, owner).iter().any(is_lent) {
            return Err(refused(format!(
                "device {device} is already authorised; `authros robot devices` shows until when"
            )));
        }
        let end = until.map_or_else(|| "it is revoked".to_owned(), |until| until.to_string());
        let text = format!("device {device} may sign for {} until {end}", owner.address);
        let lent = self.change_devices(owner, &network, Call::Lend { device, until }, "authorise device", text);
        self.parts.log.deed(&owner.profile, "authorise device", &device.to_string(), lent).await
    }

    /// A new epoch locks the device out of records sealed from now on; gateways end its session.
    pub async fn recall(&self, owner: &Owner, device: &str) -> Result<TransactionView> {
        let (network, _one_at_a_time) = (self.parts.link.network().await?, owner.changes.lock().await);
        let device = self.lent_device(&network, owner, device)?;
        let recalled = async {
            // Saved in the keyring before anything is sent: the next start resumes an interruption.
            owner.prepare_epoch(network.domain, network.directory.epoch(owner.address) + 1)?;
            let call = Call::Recall { device };
            let recalled = self.change_devices(owner, &network, call, "revoke device", String::new()).await?;
            self.enrolments.note_recalled(owner, device)?;
            let rotated = self.sharing.next_epoch(owner, &network, "revoke device").await.map_err(|failure| {
                let what = "is revoked, but the new epoch is not on the chain yet and its keys still open new records; \
                            `authros keys rotate` starts it";
                Failure { message: format!("device {device} {what}: {}", failure.message), ..failure }
            })?;
            let text = format!(
                "device {device} can no longer sign or read for {}: gateways end its session, and new records are \
                 sealed under epoch {}; what it signed before stays valid, what it has read cannot be taken back",
                owner.address, rotated.epoch
            );
            Ok(TransactionView { epoch: rotated.epoch, text, ..recalled })
        };
        self.parts.log.deed(&owner.profile, "revoke device", &device.to_string(), recalled).await
    }

    pub async fn unlend_device(&self, owner: &Owner, device: SignerId) -> Result<()> {
        let (network, _one_at_a_time) = (self.parts.link.network().await?, owner.changes.lock().await);
        let recalled = self.change_devices(owner, &network, Call::Recall { device }, "revoke device", String::new());
        self.parts.log.deed(&owner.profile, "revoke device", &device.to_string(), recalled).await.map(drop)
    }

    async fn change_devices(
        &self,
        owner: &Owner,
        network: &Network,
        call: Call,
        purpose: &str,
        text: String,
    ) -> Result<TransactionView> {
        let (transaction, receipt) = self.parts.sender.send(&network.chain, &owner.eoa(), call, purpose).await?;
        self.parts.link.scanned(receipt.block).await;
        self.parts.hub.changed(Part::Identity);
        let epoch = network.directory.epoch(owner.address);
        Ok(TransactionView::mined(transaction, receipt.block, epoch, text))
    }

    pub async fn rows(&self, owner: &Owner) -> Result<Vec<DeviceRow>> {
        let network = self.parts.link.network().await?;
        let state = |lending: &Lending| match lending.recalled {
            Some(_) => "revoked",
            None if authority::is_lent(&network.directory, lending) => "authorised",
            None => "expired",
        };
        let row = |lending: &Lending| DeviceRow {
            device: lending.device,
            fingerprint: Fingerprint::of_signer(&lending.device).to_string(),
            state: state(lending).to_owned(),
            from: lending.from,
            until: lending.until,
            recalled: lending.recalled,
        };
        Ok(self.lendings(&network, owner).iter().rev().map(row).collect())
    }

    pub fn lent_device(&self, network: &Network, owner: &Owner, text: &str) -> Result<SignerId> {
        let called = self.called(network, owner, text)?;
        let lent: Vec<SignerId> = called.iter().filter(|(_, lent)| *lent).map(|(device, _)| *device).collect();
        match (lent.as_slice(), called.last()) {
            ([device], _) => Ok(*device),
            ([], Some((ended, _))) => Ok(*ended),
            ([], None) => find(&self.lendings(network, owner), text),
            (several, _) => {
                let ids: Vec<String> = several.iter().map(ToString::to_string).collect();
                let (name, ids) = (clean(text, 64), ids.join(", "));
                Err(input(format!("several robots are called '{name}'; name the one by its device's id: {ids}")))
            }
        }
    }

    pub fn called(&self, network: &Network, owner: &Owner, name: &str) -> Result<Vec<(SignerId, bool)>> {
        let lendings = self.lendings(network, owner);
        let state = |device: SignerId| {
            let open: Vec<_> =
                lendings.iter().filter(|loan| loan.device == device && loan.recalled.is_none()).collect();
            let lent = open.iter().any(|loan| authority::is_lent(&network.directory, loan));
            (!open.is_empty()).then_some((device, lent))
        };
        let enrolled = self.enrolments.of(owner)?;
        let named = enrolled.into_iter().filter(|robot| robot.name.as_str() == name && !robot.ended);
        Ok(named.filter_map(|robot| state(robot.device)).collect())
    }

    fn lendings(&self, network: &Network, owner: &Owner) -> Vec<Lending> {
        network.directory.account(owner.address).map(|account| account.devices).unwrap_or_default()
    }
}

/// By the beginning of an id; a fingerprint is one.
fn find(lendings: &[Lending], text: &str) -> Result<SignerId> {
    let wanted: String = text.chars().filter(|character| !character.is_whitespace()).collect::<String>().to_lowercase();
    let wanted = wanted.trim_start_matches("0x");
    if wanted.len() < SHORTEST || !wanted.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        return Err(input(format!(
            "no robot of this profile has that name; give the name that it was enrolled under, or at least {SHORTEST} hex \
             characters of the id that `authros robot devices` shows"
        )));
    }
    let open = lendings.iter().filter(|lending| lending.recalled.is_none());
    let found = open.map(|lending| lending.device).filter(|device| hex(&device.0).starts_with(wanted));
    let found: BTreeSet<SignerId> = found.collect();
    match (found.first(), found.len()) {
        (Some(device), 1) => Ok(*device),
        (None, _) => Err(refused("no such device is authorised; `authros robot devices` shows those that are")),
        _ => Err(input("several authorised devices start like this; give more of the id")),
    }
}

const PATIENCE: Duration = Duration::from_secs(20);
/// Attempts to announce a device before its loan reaches the gateway's chain.
const ATTEMPTS: u32 = 20;

struct Seat {
    endpoint: Endpoint,
    trust: Trust,
    gateway: SignerId,
    transport: TransportKey,
}

impl Seat {
    /// Allocates K_T at the first address that answers.
    pub async fn allocate(
        owner: &Owner,
        context: Context,
        (addresses, fingerprint): (Vec<String>, Option<SignerId>),
        name: &ProfileName,
    ) -> Result<Self> {
        let endpoint = Endpoint { addresses, context, patience: PATIENCE, source: None };
        let mut trust = fingerprint.map_or_else(Trust::on_first_use, Trust::pinned);
        let (signing, account) = (owner.signing(), owner.eoa());
        let applicant = Applicant { name, signing: &signing, envelope: owner.envelope().public, account: &account };
        let (transport, _) = Client::allocate(&endpoint, &mut trust, &applicant).await?;
        let gateway = trust.pinned.ok_or_else(|| refused("the gateway did not identify itself"))?;
        Ok(Self { endpoint, trust, gateway, transport })
    }

    pub async fn connect(&mut self, name: &ProfileName, token: Token) -> Result<Client> {
        let credentials = Credentials { name: name.clone(), key: self.transport.clone(), token };
        Ok(Client::connect(&self.endpoint, &mut self.trust, &credentials).await?)
    }

    async fn tell(&mut self, owner: &Owner, (name, token): (&ProfileName, Token), notice: DeviceNotice) -> Result<()> {
        let mut client = self.connect(name, token).await?;
        for attempt in 1.. {
            match client.device(&owner.signing(), notice).await {
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

    pub fn noted(&self) -> EnrolledGateway {
        EnrolledGateway { addresses: self.endpoint.addresses.clone(), key: self.gateway }
    }

    pub fn access(&self) -> GatewayAccess {
        let (addresses, fingerprint) = (self.endpoint.addresses.clone(), self.gateway);
        GatewayAccess { addresses, fingerprint, transport: self.transport.clone() }
    }
}

const WIDEST: usize = 255;

impl Devices {
    pub async fn answer(&self, owner: &Owner, command: RobotCommand) -> Result<Reply> {
        match command {
            RobotCommand::PullRing { name, since, until, topics, incident } => {
                let incident = incident.map(|incident| {
                    block_in_place(|| incidents::view(&self.parts.plant.ledger.incidents, owner.address, &incident))
                });
                let incident = incident.transpose()?;
                let of_incident = incident.as_ref();
                let since = since.or(of_incident.map(|incident| incident.since));
                let since = since.ok_or_else(|| input("give a start: --since 10m, or --incident NAME"))?;
                let until = until.or(of_incident.and_then(|incident| incident.until));
                // A name that is no pattern matches no robot's topic.
                let of_all = of_incident.into_iter().flat_map(|incident| &incident.topics);
                let of_all = of_all.filter_map(|topic| topic.parse().ok());
                let topics = if topics.is_empty() { of_all.collect() } else { topics };
                let span = span(since, until, topics)?;
                self.pull(owner, &name, &span).await.map(ask::PullRing::told)
            }
            RobotCommand::ListRobots => self.robot_rows(owner).await.map(ask::ListRobots::told),
            RobotCommand::ShowRobot { name } => self.robot_view(owner, &name).await.map(ask::ShowRobot::told),
            RobotCommand::SetRobotPolicy { name, text } => {
                self.set_policy(owner, &name, text).await.map(ask::SetRobotPolicy::told)
            }
        }
    }

    pub async fn pull(&self, owner: &Owner, name: &str, span: &RingSpan) -> Result<RingPullView> {
        let network = self.parts.link.network().await?;
        let robot = self.robot(&network, owner, name)?;
        let RingSpan { since, until, topics } = span;
        let told = if topics.0.is_empty() { "all topics".to_owned() } else { topics.to_string() };
        let subject = clean(&format!("{}: {since} to {until}, {told}", robot.device), 400);
        let notice = Notice::Pull(span.clone());
        let asked = async { block_in_place(|| self.enrolments.send(owner, &network, &robot, &notice)) };
        self.parts.log.deed(&owner.profile, "pull ring", &subject, asked).await?;
        let topics = topics.0.iter().map(|topic| clean(topic.as_str(), WIDEST)).collect();
        Ok(RingPullView { robot: robot.name, device: robot.device, since: *since, until: *until, topics })
    }

    pub async fn check_robots(&self, owner: &Owner, names: &[String]) -> Result<()> {
        let network = self.parts.link.network().await?;
        names.iter().try_for_each(|name| self.robot(&network, owner, name).map(drop))
    }

    pub fn robot(&self, network: &Network, owner: &Owner, name: &str) -> Result<Enrolled> {
        let device = self.lent_device(network, owner, name)?;
        let known = self.enrolments.of(owner)?.into_iter().rfind(|robot| robot.device == device);
        known.ok_or_else(|| {
            refused(format!(
                "device {device} was not enrolled from this home; `authros robot devices` shows those that were"
            ))
        })
    }
}

/// A ring holds only the past.
pub fn span(since: Timestamp, until: Option<Timestamp>, topics: Vec<TopicPattern>) -> Result<RingSpan> {
    let until = until.unwrap_or_else(Timestamp::now).min(Timestamp::now());
    if since >= until {
        return Err(input(format!(
            "the span would end at {until}, before it begins; a ring holds only the past, so give an earlier --since"
        )));
    }
    if topics.len() > TopicPatterns::MOST {
        return Err(input(format!("request at most {most} topics per call", most = TopicPatterns::MOST)));
    }
    Ok(RingSpan { since, until, topics: TopicPatterns(topics) })
}

#[cfg(test)]
mod loan_tests;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn devices_are_found_by_the_beginning_of_their_id() {
        let lending = |first: u8, recalled| {
            let mut id = [0xaa; 32];
            id[0] = first;
            Lending { device: SignerId(id), from: 1, recalled, until: None }
        };
        let lendings = [lending(1, None), lending(2, None), lending(2, Some(5)), lending(3, Some(6))];
        assert_eq!(find(&lendings, "0x01aa AAaa AAAA").map(|device| device.0[0]).ok(), Some(1));
        assert_eq!(find(&lendings, "02aaaaaa").map(|device| device.0[0]).ok(), Some(2));
        for bad in ["01aa", "03aaaaaaaa", "zzzzzzzzzz", ""] {
            assert!(find(&lendings, bad).is_err(), "{bad}");
        }
        let twins = [lending(1, None), Lending { device: SignerId([1; 32]), ..lending(1, None) }];
        assert!(find(&twins, "01010101").is_ok() && find(&twins, "01aaaaaa").is_ok());
    }
}

//! What robots of several gateways need from their owner: a place at each gateway of their list, also at one that was
//! away or was added later, and their notices at every gateway where they may ask for them. A function of the ledger:
//! run again, it does what is left.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use tokio::task::block_in_place;

use super::Devices;
use super::enrolled::{Enrolled, EnrolledGateway};
use super::seat::Seat;
use crate::crypto::enrolment::{LONGEST_GATEWAY, MOST_GATEWAYS};
use crate::crypto::{GatewayList, ListedGateway, Notice, notice_topic};
use crate::gateway::{Cabinet, Client, Context, Credentials, DeviceNotice, Upload};
use crate::model::{ProfileName, RecordKind, SignerId, clean};
use crate::pipeline::authority::{Moment, may_sign};
use crate::pipeline::{Network, Owner};
use crate::service::event::NoticeLevel;
use crate::service::failure::{input, internal, refused};
use crate::service::reply::{DeviceGatewaysView, Failure};
use crate::site::gateway::reserved::courier_of;
use crate::store::{RecordQuery, RecordRow};

/// The pauses between two rounds: while something is left, and otherwise.
const PAUSES: (Duration, Duration) = (Duration::from_secs(5), Duration::from_secs(60));
/// The most notices of a robot that are looked at.
const MOST_NOTICES: usize = 10_000;
/// Notices in one upload.
const WINDOW: usize = 64;

impl Devices {
    /// Gives an enrolled robot a further gateway. If that is away, the robot is told when it is back.
    pub(in crate::site) async fn add_gateway(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        device: &str,
        (address, key): (String, SignerId),
    ) -> Result<DeviceGatewaysView, Failure> {
        let network = self.link.network().await?;
        let device = self.lent_device(&network, owner, device)?;
        if address.is_empty() || address.len() > LONGEST_GATEWAY {
            return Err(input("a gateway's address has 1 to 255 characters"));
        }
        let found = self.enrolments.of(owner)?.into_iter().rfind(|enrolled| enrolled.device == device);
        let unknown = || refused(format!("device {device} was not enrolled from this home; enrol the robot again"));
        let enrolled = found.ok_or_else(unknown)?;
        if enrolled.gateways.iter().any(|gateway| gateway.key == key) {
            return Err(refused(format!("'{}' has this gateway already", enrolled.name)));
        }
        if enrolled.gateways.len() >= MOST_GATEWAYS {
            return Err(input("a robot has at most eight gateways"));
        }
        let subject = format!("{device}: {}", clean(&address, 255));
        let added = EnrolledGateway { address, key, known: false };
        let change = |enrolled: &mut Enrolled| enrolled.gateways.push(added.clone());
        let changed = async { self.enrolments.change(owner, device, change) };
        self.log.deed(&owner.profile, "device gateways", &subject, changed).await?;
        if let Err(failure) = self.attend(owner, &network).await {
            self.hub.notice(NoticeLevel::Warning, &failure.message);
        }
        let known = self.enrolments.of(owner)?.into_iter().rfind(|enrolled| enrolled.device == device);
        let Enrolled { name, gateways, .. } = known.ok_or_else(|| internal("the device was not stored"))?;
        Ok(DeviceGatewaysView { name, device, gateways: gateways.into_iter().map(Into::into).collect() })
    }

    /// Attends to an owner's robots until the owner is closed or the site ends.
    pub(in crate::site) async fn keep_attending(self: Arc<Self>, owner: Arc<Owner>) {
        let mut sealed = self.enrolments.sealed.subscribe();
        while !self.life.is_stopping() && self.owners.is_open(&owner) {
            sealed.mark_unchanged();
            let mut left = true;
            if let Some(network) = self.link.network_now().filter(|_| !owner.is_locked()) {
                left = match self.attend(&owner, &network).await {
                    Ok(left) => left,
                    Err(failure) => {
                        self.hub.notice(NoticeLevel::Warning, &failure.message);
                        true
                    }
                };
            }
            let pause = if left { PAUSES.0 } else { PAUSES.1 };
            tokio::select! {
                () = tokio::time::sleep(pause) => {}
                // An error cannot be: the sender is in the enrolments.
                _ = sealed.changed() => {}
                () = self.life.stopped() => return,
            }
        }
    }

    /// One round; returns whether anything is left because a gateway is away.
    async fn attend(&self, owner: &Arc<Owner>, network: &Network) -> Result<bool, Failure> {
        let _one_at_a_time = self.attending.lock().await;
        let now = Moment::newest(network.directory.now());
        let is_lent = |enrolled: &&Enrolled| {
            !enrolled.ended && may_sign(&network.directory, owner.address, enrolled.device, now).is_ok()
        };
        let (mut left, mut away) = (false, BTreeSet::new());
        for enrolled in self.enrolments.of(owner)?.iter().filter(is_lent) {
            for gateway in enrolled.gateways.iter().filter(|gateway| !gateway.known) {
                let placed = !away.contains(&gateway.key) && self.place(owner, network, enrolled, gateway).await?;
                if !placed {
                    away.insert(gateway.key);
                    left = true;
                }
            }
        }
        let here = block_in_place(|| Cabinet::founded_in(&self.home.gateway()));
        for enrolled in self.enrolments.of(owner)?.iter().filter(is_lent) {
            for gateway in enrolled.gateways.iter().filter(|gateway| gateway.known && Some(gateway.key) != here) {
                let carried = !away.contains(&gateway.key) && self.carry(owner, network, enrolled, gateway).await?;
                if !carried {
                    away.insert(gateway.key);
                    left = true;
                }
            }
        }
        Ok(left)
    }

    /// Gives a robot its place at a gateway, and seals the notice that tells it. Returns whether the gateway was there.
    async fn place(
        &self,
        owner: &Arc<Owner>,
        network: &Network,
        enrolled: &Enrolled,
        gateway: &EnrolledGateway,
    ) -> Result<bool, Failure> {
        // Until a new key is in place there is nobody whom robots would believe.
        if owner.keyring().keyring.further.next_signing.is_some() {
            return Ok(false);
        }
        let context = Context { provider: self.plant.provider, domain: network.domain };
        let at = (gateway.address.as_str(), Some(gateway.key));
        let placed = async {
            let mut seat = Seat::allocate(owner, context, at, &enrolled.name).await?;
            let notices = owner.topic_id(&notice_topic(&enrolled.device));
            let token = self.known_token(owner, network)?;
            seat.tell(owner, (&enrolled.name, token), DeviceNotice { key: enrolled.key, notices }).await?;
            Ok::<_, Failure>(seat)
        };
        let seat = match placed.await {
            Ok(seat) => seat,
            Err(failure) => {
                self.tell_of_absence(enrolled, gateway, &failure);
                return Ok(false);
            }
        };
        let listed = |other: &EnrolledGateway| ListedGateway {
            address: other.address.clone(),
            fingerprint: other.key,
            transport: seat.transport.clone().filter(|_| other.key == gateway.key),
        };
        let is_listed = |other: &&EnrolledGateway| other.known || other.key == gateway.key;
        let known = self.enrolments.of(owner)?.into_iter().rfind(|known| known.device == enrolled.device);
        let gateways = known.map_or_else(Vec::new, |known| known.gateways);
        let list: Vec<ListedGateway> = gateways.iter().filter(is_listed).map(listed).collect();
        let list = GatewayList::sign(&network.domain, &owner.eoa(), enrolled.device, list)?;
        let epoch = network.directory.epoch(owner.address);
        block_in_place(|| self.enrolments.seal_notice(owner, network, enrolled, epoch, &Notice::Gateways(list)))?;
        // After the notice: if this is interrupted in between, another one replaces it.
        self.enrolments.change(owner, enrolled.device, |known| {
            known.gateways.iter_mut().filter(|other| other.key == gateway.key).for_each(|other| other.known = true);
        })?;
        self.hub.stored.notify_waiters();
        let text = format!("'{}' is told of the gateway {}", enrolled.name, clean(&gateway.address, 255));
        self.hub.notice(NoticeLevel::Info, &text);
        Ok(true)
    }

    /// Brings a robot's notices to a gateway, oldest first. Returns whether it has all of them.
    async fn carry(
        &self,
        owner: &Arc<Owner>,
        network: &Network,
        enrolled: &Enrolled,
        gateway: &EnrolledGateway,
    ) -> Result<bool, Failure> {
        // Numbers begin anew under the recorder of a home that was restored.
        let recorder = self.plant.ledger.recorder();
        let place = format!("carried:{}:{}:{}:{recorder}", owner.address, enrolled.device, gateway.key);
        let newest: u64 =
            block_in_place(|| self.plant.ledger.setting(&place))?.and_then(|text| text.parse().ok()).unwrap_or(0);
        let waiting = block_in_place(|| self.notices_behind(owner, enrolled, newest))?;
        if waiting.is_empty() {
            return Ok(true);
        }
        let context = Context { provider: self.plant.provider, domain: network.domain };
        let brought = async {
            let name = courier(owner)?;
            let mut seat = Seat::allocate(owner, context, (&gateway.address, Some(gateway.key)), &name).await?;
            let key = seat.transport.clone().ok_or_else(|| internal("no transport key was allocated"))?;
            let credentials = Credentials { name, key, token: self.known_token(owner, network)? };
            let mut client = Client::connect(&seat.endpoint, &mut seat.trust, &credentials).await?;
            for window in waiting.chunks(WINDOW) {
                let uploads = block_in_place(|| self.uploads(window))?;
                client.upload(uploads).await?;
                let last = window.last().map_or(newest, |row| row.seq);
                block_in_place(|| self.plant.ledger.put_setting(&place, &last.to_string()))?;
            }
            Ok::<_, Failure>(())
        };
        match brought.await {
            Ok(()) => Ok(true),
            Err(failure) => {
                self.tell_of_absence(enrolled, gateway, &failure);
                Ok(false)
            }
        }
    }

    /// The owner's notices to a robot with a higher number, in order.
    fn notices_behind(&self, owner: &Owner, enrolled: &Enrolled, newest: u64) -> Result<Vec<RecordRow>, Failure> {
        let ledger = &self.plant.ledger;
        let query = RecordQuery {
            owner: Some(owner.address),
            topic_ids: Some(vec![owner.topic_id(&notice_topic(&enrolled.device))]),
            recorder: Some(ledger.recorder()),
            kind: Some(RecordKind::Key),
            limit: MOST_NOTICES,
            newest_first: true,
            ..RecordQuery::default()
        };
        let mut rows = ledger.list(&query)?.rows;
        rows.retain(|row| row.seq > newest);
        rows.sort_unstable_by_key(|row| row.seq);
        Ok(rows)
    }

    fn uploads(&self, rows: &[RecordRow]) -> Result<Vec<Upload>, Failure> {
        let mut uploads = Vec::with_capacity(rows.len());
        for row in rows {
            let blob = self.plant.vault.get(row.digest)?;
            let gone = || refused(format!("the notice {} is not in the vault any more", row.id));
            uploads.push(Upload { signature: row.signature, blob: blob.ok_or_else(gone)? });
        }
        Ok(uploads)
    }

    fn tell_of_absence(&self, enrolled: &Enrolled, gateway: &EnrolledGateway, failure: &Failure) {
        let address = clean(&gateway.address, 255);
        let text = format!("'{}' cannot be served at the gateway {address} now: {}", enrolled.name, failure.message);
        self.hub.notice(NoticeLevel::Warning, &text);
    }
}

/// The name under which an owner's site brings notices to gateways: its own, whatever profiles there are called.
fn courier(owner: &Owner) -> Result<ProfileName, Failure> {
    courier_of(&owner.address).parse().map_err(|_| internal("the name of couriers"))
}

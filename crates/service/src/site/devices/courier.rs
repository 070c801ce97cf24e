//! Notices from owners to robots. A function of the ledger: each run does what is left.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use super::Seat;
use super::enrolled::{Step, is_lent};
use crate::crypto::enrolment::MOST_ADDRESSES;
use crate::crypto::{GatewayAddresses, IssuedKeys, Notice, OwnerKeyChange, notice_key, notice_topic};
use crate::gateway::{Cabinet, Context, Upload};
use crate::model::{ErrorKind, PublicKey, RecordKind, RecorderId, Timestamp, clean, locked};
use crate::pipeline::statement::{self, Speaker, Statement};
use crate::pipeline::{Network, Owner};
use crate::reply::{DeviceAddressesView, Failure, Result, TransactionView, input, internal, refused};
use crate::site::gateway::desk::courier_of;
use crate::site::{Devices, Enrolments};
use crate::store::notes::{Enrolled, EnrolledGateway, KeysTold, NoticesCarried, OwnerKeysTold};
use crate::store::{NewestRecord, RecordQuery, RecordRow};

/// Pauses between rounds: with notices left, and without.
const PAUSES: (Duration, Duration) = (Duration::from_secs(5), Duration::from_secs(60));
const MOST_NOTICES: usize = 10_000;
const WINDOW: usize = 64;

impl Devices {
    pub async fn add_address(&self, owner: &Owner, device: &str, address: String) -> Result<DeviceAddressesView> {
        let network = self.parts.link.network().await?;
        super::enrolled::check_addresses(std::slice::from_ref(&address))?;
        let _one_at_a_time = owner.changes.lock().await;
        let enrolled = self.robot(&network, owner, device)?;
        let device = enrolled.device;
        let unknown = || refused(format!("the gateway of '{}' is not known here; enrol it again", enrolled.name));
        let mut gateway = enrolled.gateway.clone().ok_or_else(unknown)?;
        if gateway.addresses.contains(&address) {
            return Err(refused(format!("'{}' has this address already", enrolled.name)));
        }
        if gateway.addresses.len() >= MOST_ADDRESSES {
            return Err(input("a robot has at most eight addresses of its gateway"));
        }
        // Until a new key is in place, robots would believe nobody.
        if owner.keyring().keys().further.next_signing.is_some() {
            return Err(refused("the owner's key is being changed; try again when that is done"));
        }
        let subject = format!("{device}: {}", clean(&address, 255));
        gateway.addresses.push(address);
        let told = async {
            let listed = (gateway.key, gateway.addresses.clone());
            let list = GatewayAddresses::sign(&network.domain, &owner.eoa(), device, listed)?;
            let (epoch, notice) = (network.directory.epoch(owner.address), Notice::Addresses(list));
            block_in_place(|| self.enrolments.seal(owner, &network, &enrolled, epoch, &notice))?;
            // After the notice: an interruption in between repeats it.
            self.enrolments.change(owner, device, |known| known.gateway = Some(gateway.clone()))
        };
        self.parts.log.deed(&owner.profile, "robot addresses", &subject, told).await?;
        Ok(DeviceAddressesView { name: enrolled.name, device, gateway: gateway.into() })
    }

    pub async fn keep_attending(self: Arc<Self>, owner: Arc<Owner>) {
        let mut sealed = self.enrolments.sealed.subscribe();
        while !self.parts.life.is_stopping() && self.parts.owners.is_open(&owner) {
            sealed.mark_unchanged();
            let mut left = true;
            if let Some(network) = self.parts.link.network_now().filter(|_| !owner.is_locked()) {
                left = self.attend(&owner, &network).await.unwrap_or_else(|failure| {
                    self.parts.hub.warn(&failure.message);
                    true
                });
            }
            let pause = if left { PAUSES.0 } else { PAUSES.1 };
            tokio::select! {
                () = tokio::time::sleep(pause) => {}
                // No error is possible: `self` has the sender.
                _ = sealed.changed() => {}
                () = self.parts.life.stopped() => return,
            }
        }
    }

    async fn attend(&self, owner: &Owner, network: &Network) -> Result<bool> {
        let here = block_in_place(|| Cabinet::founded_in(&self.parts.home.gateway()));
        let mut away = Vec::new();
        for enrolled in &self.enrolments.lent(owner, network)? {
            let Some(gateway) = enrolled.gateway.as_ref().filter(|gateway| Some(gateway.key) != here) else { continue };
            let waiting = block_in_place(|| self.notices_behind(owner, enrolled, gateway))?;
            let why = match away.contains(&gateway.key) {
                _ if waiting.is_empty() => None,
                true => Some("its gateway cannot be reached now".to_owned()),
                false => self.carry(owner, network, (enrolled, gateway), &waiting).await.err(),
            };
            if why.is_some() {
                away.push(gateway.key);
            }
            self.enrolments.note_untold(owner.address, enrolled, Step::Carry, why);
        }
        Ok(!away.is_empty())
    }

    async fn carry(
        &self,
        owner: &Owner,
        network: &Network,
        (enrolled, gateway): (&Enrolled, &EnrolledGateway),
        waiting: &[RecordRow],
    ) -> Result<(), String> {
        let context = Context { provider: self.parts.plant.provider, domain: network.domain };
        let brought = async {
            // A name of its own, whatever profiles there are called.
            let name = courier_of(&owner.address).parse().map_err(|_| internal("the name of couriers"))?;
            let token = self.known_token(owner, network)?;
            let at = (gateway.addresses.clone(), Some(gateway.key));
            let mut client = Seat::allocate(owner, context, at, &name).await?.connect(&name, token).await?;
            for window in waiting.chunks(WINDOW) {
                let uploads = || window.iter().map(|row| self.upload(row)).collect::<Result<_, _>>();
                client.upload(block_in_place(uploads)?).await?;
                for row in window {
                    let note = carried(owner, enrolled, gateway, row.recorder);
                    self.parts.plant.ledger.notes.write(&note, &row.seq)?;
                }
            }
            Ok::<_, Failure>(())
        };
        let Err(failure) = brought.await else { return Ok(()) };
        let addresses = clean(&gateway.addresses.join(", "), 600);
        let text = format!("'{}' cannot be served at the gateway {addresses} now: {}", enrolled.name, failure.message);
        self.parts.hub.warn(&text);
        Err(format!("its gateway {addresses}: {}", failure.message))
    }

    /// Numbers restart under the recorder of a restored home and of a new key.
    fn notices_behind(&self, owner: &Owner, enrolled: &Enrolled, gateway: &EnrolledGateway) -> Result<Vec<RecordRow>> {
        let ledger = &self.parts.plant.ledger;
        let query = RecordQuery {
            owner: Some(owner.address),
            topic_ids: Some(vec![owner.topic_id(&notice_topic(&enrolled.device))]),
            kind: Some(RecordKind::Key),
            limit: MOST_NOTICES,
            newest_first: true,
            ..RecordQuery::default()
        };
        let mut rows = ledger.records.list(&query)?.rows;
        rows.retain(|row| ledger.records.recorder().has(&row.recorder));
        let mut newest = BTreeMap::new();
        for recorder in rows.iter().map(|row| row.recorder).collect::<BTreeSet<_>>() {
            let carried = ledger.notes.read(&carried(owner, enrolled, gateway, recorder))?;
            newest.insert(recorder, carried.unwrap_or(0));
        }
        rows.retain(|row| newest.get(&row.recorder).is_none_or(|newest| row.seq > *newest));
        rows.sort_unstable_by_key(|row| (row.acknowledged_at, row.seq));
        Ok(rows)
    }

    fn upload(&self, row: &RecordRow) -> Result<Upload> {
        let gone = || refused(format!("the notice {} is not in the store any more", row.id));
        let blob = self.parts.plant.ciphertext.get(row.digest)?.ok_or_else(gone)?;
        Ok(Upload { signature: row.signature, blob })
    }
}

fn carried(owner: &Owner, enrolled: &Enrolled, gateway: &EnrolledGateway, recorder: RecorderId) -> NoticesCarried {
    NoticesCarried { owner: owner.address, device: enrolled.device, gateway: gateway.key, recorder }
}

const TYPE: &str = "authros/Keys";

impl Enrolments {
    /// One failure does not stop the others; returns the first error, with the names of all.
    pub fn tell_devices(&self, owner: &Owner, network: &Network) -> Result<()> {
        let sealing = owner.sealing().is_some_and(|keys| keys.domain == network.domain);
        // Until a new key is in place, robots would believe nobody.
        if !sealing || owner.keyring().keys().further.next_signing.is_some() {
            return Ok(());
        }
        let mut first = None;
        for device in &self.of(owner)? {
            if !is_lent(owner, network, device) {
                self.note_untold(owner.address, device, Step::Seal, None);
                self.note_untold(owner.address, device, Step::Carry, None);
                continue;
            }
            let failure = self.tell_device(owner, network, device).err();
            let why = failure.as_ref().map(|failure| failure.message.clone());
            self.note_untold(owner.address, device, Step::Seal, why);
            first = first.or(failure);
        }
        match first {
            Some(failure) => {
                let message = self.untold(Some(owner.address)).unwrap_or_default();
                Err(Failure { message, ..failure })
            }
            None => Ok(()),
        }
    }

    fn tell_device(&self, owner: &Owner, network: &Network, device: &Enrolled) -> Result<()> {
        let keys = self.issue(owner, network, device)?;
        let told = self.parts.plant.ledger.notes.read(&keys_told(owner, device))?;
        if told.as_deref() != Some(summary(&keys).as_str()) {
            self.seal(owner, network, device, keys.now.epoch, &Notice::Keys(keys.clone()))?;
            self.note_told(owner, device, &keys)?;
        }
        Ok(())
    }

    /// The current key signs the notice, and the account signs its content.
    pub fn tell_owner_key(&self, owner: &Owner, network: &Network, new: &PublicKey) -> Result<()> {
        let old = owner.signing().public;
        let change = OwnerKeyChange::sign(&network.domain, &owner.eoa(), old, *new)?;
        let (epoch, told) = (network.directory.epoch(owner.address), (old, *new));
        for device in self.lent(owner, network)? {
            let note = OwnerKeysTold { owner: owner.address, device: device.device };
            if self.parts.plant.ledger.notes.read(&note)? == Some(told) {
                continue;
            }
            self.seal(owner, network, &device, epoch, &Notice::OwnerKey(change))?;
            self.parts.plant.ledger.notes.write(&note, &told)?;
        }
        Ok(())
    }

    pub fn send(&self, owner: &Owner, network: &Network, device: &Enrolled, notice: &Notice) -> Result<()> {
        // A robot accepts notices of its own epoch or later.
        let known = network.directory.epoch(owner.address);
        let epoch = owner.sealing().map_or(known, |keys| keys.epoch.max(known));
        self.seal(owner, network, device, epoch, notice)
    }

    pub fn note_told(&self, owner: &Owner, device: &Enrolled, keys: &IssuedKeys) -> Result<()> {
        Ok(self.parts.plant.ledger.notes.write(&keys_told(owner, device), &summary(keys))?)
    }

    fn seal(&self, owner: &Owner, network: &Network, device: &Enrolled, epoch: u64, notice: &Notice) -> Result<()> {
        let _alone = locked(&self.sealing);
        let (name, body) = (notice_topic(&device.device), notice.encode());
        let speaker = Speaker {
            domain: network.domain,
            owner: owner.address,
            signing: &owner.signing(),
            epoch,
            topic_id: owner.topic_id(&name),
            topic_key: &notice_key(&owner.eoa(), &network.domain, &device.device),
            filters: Vec::new(),
        };
        let statement = Statement { kind: RecordKind::Key, topic: &name, type_name: TYPE, body: &body };
        let plant = &self.parts.plant;
        statement::append(plant, &speaker, statement)?;
        self.sealed.send_replace(());
        self.parts.hub.stored.notify_waiters();
        Ok(())
    }
}

fn keys_told(owner: &Owner, device: &Enrolled) -> KeysTold {
    KeysTold { owner: owner.address, device: device.device }
}

/// Not secret. A number stands for the topics, because they are only added.
fn summary(keys: &IssuedKeys) -> String {
    let moment = |time: Option<Timestamp>| time.map_or(0, |time| time.0);
    let next = keys.next.as_ref().map_or((0, 0), |(moment, next)| (moment.0, next.epoch));
    let topics = keys.now.key.topics().map_or(String::new(), |topics| format!("/{}", topics.len()));
    format!("{}/{}/{}/{}{topics}", keys.now.epoch, moment(keys.now.ends), next.0, next.1)
}

/// How long a working robot may stay in an older epoch.
const BOUND: Duration = Duration::from_secs(12);
/// How long to wait for a robot that fell silent.
const SILENCE: Duration = Duration::from_secs(3);
const LOOK: Duration = Duration::from_millis(200);
/// Nanoseconds; a robot whose newest record is older is not at work.
const AT_WORK: u64 = 10_000_000_000;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Pace {
    Settled,
    Silent,
    Behind,
}

impl Pace {
    /// `begun` is when the owner told the robot of `epoch`.
    fn of(newest: Option<NewestRecord>, epoch: u64, begun: Timestamp) -> Self {
        let Some(newest) = newest.filter(|newest| newest.epoch < epoch) else { return Self::Settled };
        let heard = newest.acknowledged_at;
        if newest.captured_at > begun && heard > begun && heard.0.saturating_add(AT_WORK / 2) > Timestamp::now().0 {
            return Self::Behind;
        }
        let earliest = begun.0.saturating_sub(AT_WORK);
        if newest.captured_at.0 > earliest && heard.0 > earliest { Self::Silent } else { Self::Settled }
    }
}

impl Devices {
    /// Announces the epoch of `deed`, and fails as [`ErrorKind::Incomplete`] if a working robot stays in an older one.
    pub async fn lead(&self, owner: &Owner, deed: TransactionView) -> Result<TransactionView> {
        let (begun, from) = (Timestamp::now(), Instant::now());
        let incomplete = |text: String| Failure::new(ErrorKind::Incomplete, format!("{}; but {text}", deed.text));
        let network = self.parts.link.network().await?;
        block_in_place(|| self.enrolments.tell_devices(owner, &network))
            .map_err(|failure| incomplete(failure.message))?;
        let robots = self.enrolments.lent(owner, &network)?;
        let pace = |robot: &Enrolled| {
            let newest = self.parts.plant.ledger.counts.newest_of(owner.address, robot.device)?;
            Ok((robot.name.to_string(), Pace::of(newest, deed.epoch, begun)))
        };
        loop {
            let paces = block_in_place(|| robots.iter().map(pace).collect::<Result<Vec<_>>>())?;
            let behind: Vec<String> =
                paces.iter().filter(|(_, pace)| *pace == Pace::Behind).map(|(name, _)| format!("'{name}'")).collect();
            let waits = paces.iter().any(|(_, pace)| *pace == Pace::Silent) && from.elapsed() < SILENCE;
            if behind.is_empty() && (!waits || self.parts.life.is_stopping()) {
                break;
            }
            if from.elapsed() >= BOUND || self.parts.life.is_stopping() {
                let names = behind.join(", ");
                return Err(incomplete(format!(
                    "FAILED: {names} still seals under an older epoch {} s later; check `authros status` here and the \
                     robot's own log, or revoke it too",
                    from.elapsed().as_secs()
                )));
            }
            tokio::time::sleep(LOOK).await;
        }
        let Some(untold) = self.enrolments.untold(Some(owner.address)) else { return Ok(deed) };
        let text = format!("{}; {untold}; they are notified as soon as their gateway can be reached", deed.text);
        Ok(TransactionView { text, ..deed })
    }

    pub fn untold_text(&self) -> Option<String> {
        self.enrolments.untold(None)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_is_behind_only_with_what_it_captured_since() {
        let now = Timestamp::now();
        let before = |seconds: u64| Timestamp(now.0 - seconds * 1_000_000_000);
        let newest = |epoch, captured_at, acknowledged_at| Some(NewestRecord { epoch, captured_at, acknowledged_at });
        let begun = before(4);
        for (record, pace) in [
            (None, Pace::Settled),
            (newest(5, now, now), Pace::Settled),
            (newest(4, now, now), Pace::Behind),
            // Captured before, however late it came: an outbox is being emptied.
            (newest(4, before(5), now), Pace::Silent),
            (newest(4, before(3_600), now), Pace::Settled),
            (newest(4, before(6), before(6)), Pace::Silent),
            (newest(4, before(3_600), before(3_600)), Pace::Settled),
            // Its clock is ahead, and it has been silent for long.
            (newest(4, now, before(60)), Pace::Settled),
        ] {
            assert_eq!(Pace::of(record, 5, begun), pace, "{record:?}");
        }
    }
}

//! Devices that may sign for their owner: lent and recalled on the chain.

mod courier;
pub(super) mod enrolled;
pub(super) mod enrolling;
mod following;
#[cfg(test)]
mod loan_tests;
mod policies;
pub(super) mod pulling;
mod seat;
mod telling;

use crate::paths::Home;
use crate::pipeline::Plant;
use crate::pipeline::Sender;
use crate::service::hub::Hub;
use crate::site::audit::Log;
use crate::site::chain::link::Link;
use crate::site::devices::enrolled::Enrolments;
use crate::site::identity::owners::Owners;
use crate::site::lifetime::Lifetime;
use crate::site::parts::Parts;
use crate::site::sharing::Sharing;
use std::sync::Arc;

use crate::chain::Call;
use crate::crypto::Fingerprint;
use crate::model::{SignerId, Timestamp, bytes::hex, clean};
use crate::pipeline::directory::Lending;
use crate::pipeline::{Network, Owner, authority};
use crate::service::event::Part;
use crate::service::failure::{input, refused};
use crate::service::reply::{DeviceRow, Failure, TransactionView};

/// The fewest characters of a device's id that identify it.
const SHORTEST: usize = 8;

/// Devices that sign for their owners.
pub(in crate::site) struct Devices {
    plant: Plant,
    hub: Arc<Hub>,
    log: Arc<Log>,
    link: Arc<Link>,
    sender: Arc<Sender>,
    sharing: Arc<Sharing>,
    enrolments: Arc<Enrolments>,
    home: Home,
    owners: Arc<Owners>,
    life: Arc<Lifetime>,
    /// Whether the chain is known only from a gateway's word.
    is_joined: bool,
}

impl Devices {
    /// From the shared parts.
    pub fn new(parts: &Parts, sharing: &Arc<Sharing>, enrolments: &Arc<Enrolments>) -> Self {
        let Parts { home, plant, hub, log, owners, link, life, sender, .. } = parts.clone();
        Self {
            plant,
            hub,
            log,
            link,
            sender,
            sharing: Arc::clone(sharing),
            enrolments: Arc::clone(enrolments),
            home,
            owners,
            life,
            is_joined: parts.config.site.is_some(),
        }
    }
}

impl Devices {
    /// Lets a device sign for the owner.
    pub(super) async fn lend(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        device: SignerId,
        until: Option<Timestamp>,
    ) -> Result<TransactionView, Failure> {
        let network = self.link.network().await?;
        let _one_at_a_time = owner.changes.lock().await;
        network.directory.identity(owner.address)?;
        if until.is_some_and(|until| until <= network.directory.now()) {
            return Err(input("the loan would end before it starts; give a later --until"));
        }
        let until = until.map(|until| Timestamp::from_seconds(until.seconds()));
        let known = self.lendings(&network, owner);
        if known.iter().any(|lending| {
            lending.device == device && lending.until == until && authority::is_lent(&network.directory, lending)
        }) {
            return Err(refused(format!(
                "device {device} is already on loan; `authros devices list` shows until when"
            )));
        }
        let text = match until {
            Some(until) => format!("device {device} may sign for {} until {until}", owner.address),
            None => format!("device {device} may sign for {} until it is recalled", owner.address),
        };
        let lent = self.change_devices(owner, &network, Call::Lend { device, until }, "lend", text);
        self.log.deed(&owner.profile, "lend device", &device.to_string(), lent).await
    }

    /// Recalls a device and begins a new epoch, so that what the device holds opens nothing sealed from now on.
    /// Gateways follow the chain: the device's name ends, its subscriptions are cut, its next Command is refused.
    pub(super) async fn recall(self: &Arc<Self>, owner: &Arc<Owner>, device: &str) -> Result<TransactionView, Failure> {
        let network = self.link.network().await?;
        let _one_at_a_time = owner.changes.lock().await;
        let device = self.lent_device(&network, owner, device)?;
        let recalled = self.recall_device(owner, &network, device);
        self.log.deed(&owner.profile, "recall device", &device.to_string(), recalled).await
    }

    async fn recall_device(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        network: &Network,
        device: SignerId,
    ) -> Result<TransactionView, Failure> {
        // In the keyring before anything is sent: if interrupted in between, it is resumed at the next start.
        owner.prepare_epoch(network.domain, network.directory.epoch(owner.address) + 1)?;
        let recalled = self.send_recall(owner, network, device).await?;
        self.enrolments.note_recalled(owner, device)?;
        let rotated = self.sharing.next_epoch(owner, network, "recall").await.map_err(|failure| {
            let what = "is recalled, but the new epoch is not on the chain yet and its keys still open new records; \
                        `authros keys rotate` starts it";
            Failure { message: format!("device {device} {what}: {}", failure.message), ..failure }
        })?;
        let text = format!(
            "device {device} can no longer sign or read for {}: gateways end its session, and new records are sealed \
             under epoch {}; what it signed before stays valid, what it has read cannot be recalled",
            owner.address, rotated.epoch
        );
        Ok(TransactionView { epoch: rotated.epoch, text, ..recalled })
    }

    /// Recalls a device that nobody has used.
    pub(super) async fn unlend_device(self: &Arc<Self>, owner: &Arc<Owner>, device: SignerId) -> Result<(), Failure> {
        let network = self.link.network().await?;
        let _one_at_a_time = owner.changes.lock().await;
        let recalled = self.send_recall(owner, &network, device);
        self.log.deed(&owner.profile, "recall device", &device.to_string(), recalled).await.map(drop)
    }

    async fn send_recall(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        network: &Network,
        device: SignerId,
    ) -> Result<TransactionView, Failure> {
        self.change_devices(owner, network, Call::Recall { device }, "recall", String::new()).await
    }

    async fn change_devices(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        network: &Network,
        call: Call,
        purpose: &str,
        text: String,
    ) -> Result<TransactionView, Failure> {
        let (transaction, receipt) = self.sender.send(&network.chain, &owner.eoa(), call, purpose).await?;
        self.link.scanned(receipt.block).await;
        self.hub.changed(Part::Identity);
        let epoch = network.directory.epoch(owner.address);
        Ok(TransactionView { transaction: Some(transaction), block: Some(receipt.block), epoch, text })
    }

    /// Every device ever lent, newest first.
    pub(super) async fn rows(self: &Arc<Self>, owner: &Arc<Owner>) -> Result<Vec<DeviceRow>, Failure> {
        let network = self.link.network().await?;
        let row = |lending: &Lending| DeviceRow {
            device: lending.device,
            fingerprint: Fingerprint::of_signer(&lending.device).to_string(),
            state: match (lending.recalled, authority::is_lent(&network.directory, lending)) {
                (Some(_), _) => "recalled",
                (None, true) => "lent",
                (None, false) => "expired",
            }
            .to_owned(),
            from: lending.from,
            until: lending.until,
            recalled: lending.recalled,
        };
        Ok(self.lendings(&network, owner).iter().rev().map(row).collect())
    }

    /// The lent device identified by a person: a robot's name, or the beginning of a device's id.
    pub(super) fn lent_device(&self, network: &Network, owner: &Owner, text: &str) -> Result<SignerId, Failure> {
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

    /// The enrolled robots of this name that were not recalled, oldest first, and whether their loan still runs.
    pub(super) fn called(
        &self,
        network: &Network,
        owner: &Owner,
        name: &str,
    ) -> Result<Vec<(SignerId, bool)>, Failure> {
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

/// The lent device whose id begins with this; a fingerprint is such a beginning.
fn find(lendings: &[Lending], text: &str) -> Result<SignerId, Failure> {
    let wanted: String = text.chars().filter(|character| !character.is_whitespace()).collect::<String>().to_lowercase();
    let wanted = wanted.trim_start_matches("0x");
    if wanted.len() < SHORTEST || !wanted.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        return Err(input(format!(
            "no robot of this profile has that name; give the name that it was enrolled under, or at least {SHORTEST} hex \
             characters of the id that `authros devices list` shows"
        )));
    }
    let open = lendings.iter().filter(|lending| lending.recalled.is_none());
    let mut found: Vec<SignerId> =
        open.map(|lending| lending.device).filter(|device| hex(&device.0).starts_with(wanted)).collect();
    found.sort();
    found.dedup();
    match found.as_slice() {
        [device] => Ok(*device),
        [] => Err(refused("no such device is on loan; `authros devices list` shows those that are")),
        _ => Err(input("several devices on loan start like this; give more of the id")),
    }
}

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

//! The owner's side of notices: when what an enrolled robot should seal under has changed, it gets a record of its own.

use std::sync::PoisonError;

use super::enrolled::{Enrolled, Enrolments, Step, words};
use crate::crypto::{IssuedKeys, Notice, OwnerKeyChange, notice_key, notice_topic};
use crate::model::{PublicKey, RecordKind, RingSpan, Timestamp};
use crate::pipeline::authority::{Moment, may_sign};
use crate::pipeline::statement::{self, Speaker, Statement};
use crate::pipeline::{Network, Owner};
use crate::service::reply::Failure;

/// The type in the head of a notice.
const TYPE: &str = "authros/Keys";

impl Enrolments {
    /// Seals a notice for each lent robot that does not know what it should seal under, whatever happens to the others. A
    /// function of ledger and keyring: called again, it does what is left.
    ///
    /// # Errors
    /// If some cannot be told: the first one's error, with the names of all.
    pub(in crate::site) fn tell_devices(&self, owner: &Owner, network: &Network) -> Result<(), Failure> {
        let sealing = owner.sealing().is_some_and(|keys| keys.domain == network.domain);
        // Until a new key is in place there is nobody whom robots would believe.
        if !sealing || owner.keyring().keys().further.next_signing.is_some() {
            return Ok(());
        }
        let mut first = None;
        for device in &self.of(owner)? {
            let now = Moment::newest(network.directory.now());
            if device.ended || may_sign(&network.directory, owner.address, device.device, now).is_err() {
                self.note_untold(owner.address, device, Step::Seal, None);
                self.note_untold(owner.address, device, Step::Carry, None);
                continue;
            }
            let told = self.tell_device(owner, network, device);
            self.note_untold(
                owner.address,
                device,
                Step::Seal,
                told.as_ref().err().map(|failure| failure.message.clone()),
            );
            first = first.or(told.err());
        }
        match first {
            Some(failure) => Err(Failure { message: words(&self.untold(Some(owner.address))), ..failure }),
            None => Ok(()),
        }
    }

    fn tell_device(&self, owner: &Owner, network: &Network, device: &Enrolled) -> Result<(), Failure> {
        let keys = self.issue(owner, network, device)?;
        let told = self.plant.ledger.setting(&place(owner, device))?;
        if told.as_deref() != Some(summary(&keys).as_str()) {
            let epoch = keys.now.epoch;
            self.seal_notice(owner, network, device, epoch, &Notice::Keys(keys.clone()))?;
            self.note_told(owner, device, &keys)?;
            self.hub.stored.notify_waiters();
        }
        Ok(())
    }

    /// Seals a notice for each lent robot that is to know its owner by `new` from now on: signed by the current key,
    /// and within it by the account. Called again, it does what is left.
    ///
    /// # Errors
    /// Errors of ledger and vault.
    pub(in crate::site) fn tell_owner_key(
        &self,
        owner: &Owner,
        network: &Network,
        new: &PublicKey,
    ) -> Result<(), Failure> {
        let old = owner.signing().public;
        let change = OwnerKeyChange::sign(&network.domain, &owner.eoa(), old, *new)?;
        let (epoch, told) = (network.directory.epoch(owner.address), format!("{old} {new}"));
        for device in self.of(owner)? {
            let place = format!("rekeyed:{}:{}", owner.address, device.device);
            let now = Moment::newest(network.directory.now());
            let lent = may_sign(&network.directory, owner.address, device.device, now).is_ok();
            if !lent || self.plant.ledger.setting(&place)?.as_deref() == Some(&told) {
                continue;
            }
            self.seal_notice(owner, network, &device, epoch, &Notice::OwnerKey(change))?;
            self.plant.ledger.put_setting(&place, &told)?;
            self.hub.stored.notify_waiters();
        }
        Ok(())
    }

    /// Seals a notice that asks a robot for a span of its ring.
    ///
    /// # Errors
    /// Errors of ledger and vault.
    pub(super) fn ask_for_ring(
        &self,
        owner: &Owner,
        network: &Network,
        device: &Enrolled,
        span: &RingSpan,
    ) -> Result<(), Failure> {
        // A robot hears only notices of the epoch it seals under, or of a later one.
        let known = network.directory.epoch(owner.address);
        let epoch = owner.sealing().map_or(known, |keys| keys.epoch.max(known));
        self.seal_notice(owner, network, device, epoch, &Notice::Pull(span.clone()))?;
        self.hub.stored.notify_waiters();
        Ok(())
    }

    /// The device knows these keys.
    pub(super) fn note_told(&self, owner: &Owner, device: &Enrolled, keys: &IssuedKeys) -> Result<(), Failure> {
        Ok(self.plant.ledger.put_setting(&place(owner, device), &summary(keys))?)
    }

    pub(super) fn seal_notice(
        &self,
        owner: &Owner,
        network: &Network,
        device: &Enrolled,
        epoch: u64,
        notice: &Notice,
    ) -> Result<(), Failure> {
        let _alone = self.sealing.lock().unwrap_or_else(PoisonError::into_inner);
        let (name, body) = (notice_topic(&device.device), notice.encode());
        let speaker = Speaker {
            domain: network.domain,
            owner: owner.address,
            signing: &owner.signing(),
            epoch,
            topic_id: owner.topic_id(&name),
            topic_key: &notice_key(&owner.eoa(), &network.domain, &device.device),
        };
        let statement = Statement { kind: RecordKind::Key, topic: &name, type_name: TYPE, body: &body };
        statement::put(&self.plant, &speaker, statement, |row| self.plant.ledger.append(vec![row]))?;
        self.sealed.send_replace(());
        Ok(())
    }
}

fn place(owner: &Owner, device: &Enrolled) -> String {
    format!("told:{}:{}", owner.address, device.device)
}

/// Distinguishes one issue from another; not secret. Topics are represented by their number: they are only ever added.
fn summary(keys: &IssuedKeys) -> String {
    let moment = |time: Option<Timestamp>| time.map_or(0, |time| time.0);
    let next = keys.next.as_ref().map_or((0, 0), |(moment, next)| (moment.0, next.epoch));
    let topics = keys.now.key.topics().map_or(String::new(), |topics| format!("/{}", topics.len()));
    format!("{}/{}/{}/{}{topics}", keys.now.epoch, moment(keys.now.ends), next.0, next.1)
}

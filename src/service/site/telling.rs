//! The owner's end of notices: whenever what an enrolled robot should seal under has changed, a record for it alone.

use super::Site;
use super::enrolling::Enrolled;
use crate::crypto::{IssuedKeys, notice_key, notice_topic};
use crate::model::{RecordKind, Timestamp};
use crate::pipeline::statement::{self, Speaker, Statement};
use crate::pipeline::{Network, Owner};
use crate::service::reply::Failure;

/// What the head of a notice says its type is.
const TYPE: &str = "authros/Keys";

impl Site {
    /// Seals a notice for each lent robot that does not know what it should seal under. A function of ledger and
    /// keyring: called again, it does what is left.
    ///
    /// # Errors
    /// Of ledger and vault.
    pub(super) fn tell_devices(&self, owner: &Owner, network: &Network) -> Result<(), Failure> {
        let sealing = owner.sealing().is_some_and(|keys| keys.domain == network.domain);
        for device in self.enrolled_devices(owner)?.iter().filter(|_| sealing) {
            if !network.directory.is_lent(owner.address, device.device, None, Timestamp::now()) {
                continue;
            }
            let keys = self.issue(owner, network, device)?;
            let told = self.plant.ledger.setting(&place(owner, device))?;
            if told.as_deref() != Some(summary(&keys).as_str()) {
                self.seal_notice(owner, network, device, &keys)?;
                self.note_told(owner, device, &keys)?;
                self.hub.stored.notify_waiters();
            }
        }
        Ok(())
    }

    /// The device knows these keys.
    pub(super) fn note_told(&self, owner: &Owner, device: &Enrolled, keys: &IssuedKeys) -> Result<(), Failure> {
        Ok(self.plant.ledger.put_setting(&place(owner, device), &summary(keys))?)
    }

    fn seal_notice(
        &self,
        owner: &Owner,
        network: &Network,
        device: &Enrolled,
        keys: &IssuedKeys,
    ) -> Result<(), Failure> {
        let (name, body) = (notice_topic(&device.device), keys.encode());
        let speaker = Speaker {
            domain: network.domain,
            owner: owner.address,
            signing: &owner.signing(),
            epoch: keys.now.epoch,
            topic_id: owner.topic_id(&name),
            topic_key: &notice_key(&owner.eoa(), &network.domain, &device.device),
        };
        let statement = Statement { kind: RecordKind::Key, topic: &name, type_name: TYPE, body: &body };
        let row = statement::put(&self.plant, &speaker, statement)?;
        self.plant.ledger.append(vec![row])?;
        Ok(())
    }
}

fn place(owner: &Owner, device: &Enrolled) -> String {
    format!("told:{}:{}", owner.address, device.device)
}

/// What tells two issues apart; no secret.
fn summary(keys: &IssuedKeys) -> String {
    let moment = |time: Option<Timestamp>| time.map_or(0, |time| time.0);
    let next = keys.next.as_ref().map_or((0, 0), |(moment, next)| (moment.0, next.epoch));
    format!("{}/{}/{}/{}", keys.now.epoch, moment(keys.now.ends), next.0, next.1)
}

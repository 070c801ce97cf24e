//! The owner's end of notices: whenever what an enrolled robot should seal under has changed, a record for it alone.

use super::Site;
use super::enrolling::Enrolled;
use crate::crypto::{IssuedKeys, SealRequest, notice_key, notice_topic, seal};
use crate::model::head::Compression;
use crate::model::{Digest, Head, RecordKind, RecordState, Timestamp};
use crate::pipeline::directory::Lending;
use crate::pipeline::{Network, Owner};
use crate::service::reply::Failure;
use crate::store::NewRecord;

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
            if !is_lent(owner, network, device) {
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
        let (plant, name, body) = (&self.plant, notice_topic(&device.device), keys.encode());
        let head = Head {
            topic: name.clone(),
            type_name: TYPE.to_owned(),
            md5sum: String::new(),
            definition: Digest([0; 32]),
            caller_id: String::new(),
            boot_id: [0; 16],
            compression: Compression::None,
            plain_length: body.len() as u64,
            tags: std::collections::BTreeMap::new(),
        };
        let (signing, topic_id, captured_at) = (owner.signing(), owner.topic_id(&name), Timestamp::now());
        let seq = plant.ledger.next_seq(owner.address, topic_id)?;
        let request = SealRequest {
            domain: network.domain,
            owner: owner.address,
            signer: &signing,
            epoch: keys.now.epoch,
            topic_key: &notice_key(&owner.eoa(), &network.domain, &device.device),
            recorder: plant.ledger.recorder(),
            seq,
            topic_id,
            kind: RecordKind::Key,
            filters: Vec::new(),
            captured_at,
            head: &head,
            body: &body,
        };
        let sealed = seal(plant.provider, &request)?;
        let durable = plant.vault.durable();
        if durable {
            plant.vault.put(&[(sealed.digest, &sealed.blob)])?;
        }
        plant.ledger.append(vec![NewRecord {
            digest: sealed.digest,
            owner: owner.address,
            topic_id,
            seq,
            foreign: None,
            epoch: keys.now.epoch,
            kind: RecordKind::Key,
            signer: crate::crypto::signer_id(&signing.public),
            signature: sealed.signature,
            filters: Vec::new(),
            topic: name,
            type_name: TYPE.to_owned(),
            bytes: body.len() as u64,
            captured_at,
            simulated: false,
            state: if durable { RecordState::Stored } else { RecordState::Sealed },
            local_copy: (!durable).then_some(sealed.blob),
        }])?;
        Ok(())
    }
}

fn is_lent(owner: &Owner, network: &Network, device: &Enrolled) -> bool {
    let open = |lending: &Lending| {
        let ended = lending.until.is_some_and(|until| until <= Timestamp::now());
        lending.device == device.device && lending.recalled.is_none() && !ended
    };
    network.directory.account(owner.address).is_some_and(|account| account.devices.iter().any(open))
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

//! Which part of the site answers which command.

use std::collections::HashSet;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::oneshot;

use super::Site;
use crate::model::{ErrorKind, ProfileName};
use crate::pipeline::Owner;
use crate::service::command::{Command, Request, StoreCommand};
use crate::service::reply::{Failure, Reply};

/// What a connection holds as long as it lasts.
#[derive(Default)]
pub struct Held {
    consoles: HashSet<ProfileName>,
    /// Each ends a server of the chain when it is dropped.
    servers: Vec<oneshot::Sender<()>>,
}

/// What a connection holds, shared by its requests.
pub type Claims = Arc<Mutex<Held>>;

fn unknown() -> Failure {
    crate::service::failure::internal("this command is not known to the site")
}

impl Site {
    /// Answers one request.
    ///
    /// # Errors
    /// What the command's part says.
    pub async fn handle(self: &Arc<Self>, request: Request, claims: &Claims) -> Result<Reply, Failure> {
        let Request { profile, command } = request;
        match command {
            Command::OpenConsole => self.claim(profile, claims),
            Command::CreateIdentity { passphrase } => {
                self.create_identity(profile, passphrase).await.map(Reply::Identity)
            }
            Command::ShowIdentity => self.identity_view(&profile).await.map(Reply::Identity),
            Command::Unlock { passphrase } => self.unlock(profile, passphrase).await.map(Reply::Identity),
            Command::ChangePassphrase { old, new } => {
                self.change_passphrase(&profile, old, new).await.map(|()| Reply::Done)
            }
            Command::ListTopics => Ok(Reply::Topics(self.topic_rows(&profile).await?)),
            Command::WatchTopic { topic, type_name } => self.watch_topic(&profile, topic, type_name).await,
            Command::UnwatchTopic { topic } => self.unwatch_topic(&profile, &topic).await,
            Command::ListPins { topic } => self.pins_view(&profile, topic.as_ref()).await.map(Reply::Pins),
            Command::PinTopic { topic, publishers } => {
                self.pin_topic(&profile, &topic, publishers).await.map(Reply::Pins)
            }
            Command::UnpinTopic { topic, caller_id } => {
                self.unpin_topic(&profile, &topic, &caller_id).await.map(Reply::Pins)
            }
            Command::ListQuarantine { topic, limit } => {
                self.quarantine_view(&profile, topic, limit).await.map(Reply::Quarantine)
            }
            Command::Policy { with } => self.policy(&profile, with).await.map(Reply::Policy),
            Command::StopCapture => Ok(self.stop_captures(&profile)),
            Command::ServeChain { address } => {
                let (end, ended) = oneshot::channel();
                let served = self.serve_chain(&profile, address, ended).await?;
                claims.lock().unwrap_or_else(PoisonError::into_inner).servers.push(end);
                Ok(Reply::Served(served))
            }
            Command::Operate(operation) => self.operate(&profile, operation).await,
            Command::ChainStatus => self.chain_view(&profile).await.map(Box::new).map(Reply::Chain),
            Command::ListSuccessions => {
                let view = self.chain_view(&profile).await?;
                Ok(Reply::Administration(Box::new(view.administration)))
            }
            Command::SiteStatus => self.site_view(&profile).await.map(Reply::Site),
            Command::ListAudit(query) => self.audit_lines(query).await.map(Reply::Audit),
            Command::VerifyAudit { heads } => {
                let owner = if heads { Some(self.unlocked(&profile)?) } else { None };
                self.verify_audit(owner).await.map(Reply::AuditChecked)
            }
            Command::OfStore(command) => self.handle_store(&profile, command).await,
            Command::CompareFingerprint { fingerprint, account } => {
                self.compare_fingerprint(&profile, &fingerprint, account).await.map(Reply::Compared)
            }
            Command::ListContacts => self.contact_rows().await.map(Reply::Contacts),
            Command::AddContact { name, address, fingerprint } => {
                self.add_contact(&profile, name, address, fingerprint).await.map(Reply::Contacts)
            }
            Command::RemoveContact { name } => self.remove_contact(&profile, &name).await.map(Reply::Contacts),
            Command::ConfirmContact { name, fingerprint } => {
                self.confirm_contact(&profile, &name, fingerprint).await.map(Reply::Contacts)
            }
            Command::ListUploads(query) => self.list_uploads(&profile, query).await.map(Reply::Records),
            Command::ShowUpload { id } => self.provenance(&profile, &id).await.map(Reply::Provenance),
            other => self.handle_unlocked(&profile, other, claims).await,
        }
    }

    async fn handle_store(self: &Arc<Self>, profile: &ProfileName, command: StoreCommand) -> Result<Reply, Failure> {
        match command {
            StoreCommand::AuditRecords { deep, since } => {
                self.audit_records(deep, since).await.map(|audit| Reply::RecordsAudited(Box::new(audit)))
            }
            StoreCommand::ListUploads(query) => self.list_all_uploads(query).await.map(Reply::Records),
            StoreCommand::BackUp { file, passphrase } => {
                self.back_up(profile, file, passphrase).await.map(Reply::BackedUp)
            }
        }
    }

    async fn handle_unlocked(
        self: &Arc<Self>,
        profile: &ProfileName,
        command: Command,
        claims: &Claims,
    ) -> Result<Reply, Failure> {
        let owner = self.unlocked(profile)?;
        match command {
            Command::Register => self.register(&owner).await.map(Reply::Identity),
            Command::DeployContract { delay, revision } => {
                self.deploy_contract(&owner, delay, revision).await.map(Reply::Deployed)
            }
            Command::ListKeys => self.keys_view(&owner).await.map(Reply::Keys),
            Command::LoadKey { kind, path, passphrase } => {
                self.load_key(&owner, kind, path, passphrase).await.map(Reply::Keys)
            }
            Command::RotateEnvelope => self.rotate_envelope(&owner).await.map(Reply::Keys),
            Command::ForeseeKeyChange { kind } => self.foresee_key_change(&owner, kind).await.map(Reply::KeyChange),
            Command::RotateKeys => self.rotate(&owner, "asked for").await.map(Reply::Transaction),
            Command::ExportKey { kind, passphrase } => self.export_key(&owner, kind, passphrase).await.map(Reply::Key),
            Command::Capture { topics, type_name, count, milliseconds, tags } => {
                self.capture(&owner, &topics, type_name, count, milliseconds, tags).await.map(Reply::Captured)
            }
            Command::Recording { with } => self.recording(&owner, with).await.map(Reply::Recording),
            Command::ReleaseHeld { held } => self.release_held(&owner, held).await.map(Reply::Decided),
            Command::DiscardHeld { held } => self.discard_held(&owner, held).await.map(Reply::Decided),
            Command::ExportUpload { id, addresses } => {
                self.export_upload(&owner, &id, addresses).await.map(Reply::Files)
            }
            Command::ExportAudit { addresses } => self.export_audit(&owner, addresses).await.map(Reply::Files),
            Command::Grant { grantee, topics, epochs, expires } => {
                self.grant(&owner, &grantee, &topics, epochs, expires).await.map(Reply::Transaction)
            }
            Command::ExtendGrant { grantee, expires } => {
                self.extend(&owner, &grantee, expires).await.map(Reply::Transaction)
            }
            Command::NameRecovery { recovery } => {
                self.name_recovery(&owner, recovery.as_ref()).await.map(Reply::Transaction)
            }
            Command::Revoke { grantee } => self.revoke(&owner, self.resolve(&grantee)?).await.map(Reply::Transaction),
            Command::ServeGateway { address, open } => {
                let (end, ended) = oneshot::channel();
                let served = self.serve_gateway(&owner, address, open, ended).await?;
                claims.lock().unwrap_or_else(PoisonError::into_inner).servers.push(end);
                Ok(Reply::Gateway(served))
            }
            Command::LendDevice { device, until } => {
                self.lend_device(&owner, device, until).await.map(Reply::Transaction)
            }
            Command::RecallDevice { device } => self.recall_device(&owner, &device).await.map(Reply::Transaction),
            Command::AddDeviceTopics { device, topics } => {
                self.add_device_topics(&owner, &device, &topics).await.map(Reply::DeviceTopics)
            }
            Command::EnrolDevice(wishes) => self.enrol_device(&owner, wishes).await.map(Reply::Enrolled),
            Command::ListDevices => self.device_rows(&owner).await.map(Reply::Devices),
            Command::Administer(act) => self.administer(&owner, &act).await.map(Reply::Transaction),
            Command::AdoptChain => self.adopt_chain(&owner).await.map(Reply::Transaction),
            Command::ListShared(_) | Command::CheckShared { .. } | Command::OpenShared { .. } | Command::View(_) => {
                self.caught_up(profile).await?;
                self.handle_shared(&owner, command).await
            }
            Command::ListGrants => self.grant_rows(&owner).await.map(Reply::Grants),
            _ => Err(unknown()),
        }
    }

    async fn handle_shared(self: &Arc<Self>, owner: &Arc<Owner>, command: Command) -> Result<Reply, Failure> {
        match command {
            Command::ListShared(query) => self.list_shared(owner, query).await.map(Reply::Records),
            Command::CheckShared { id } => self.check_record(owner, &id).await.map(Reply::Check),
            Command::View(viewing) => self.handle_viewing(owner, viewing).await,
            Command::OpenShared { id } => self.open_record(owner, &id).await.map(|view| Reply::Opened(Box::new(view))),
            _ => Err(unknown()),
        }
    }

    fn claim(&self, profile: ProfileName, claims: &Claims) -> Result<Reply, Failure> {
        let mut consoles = self.consoles.lock().unwrap_or_else(PoisonError::into_inner);
        let own = claims.lock().unwrap_or_else(PoisonError::into_inner).consoles.contains(&profile);
        if !consoles.insert(profile.clone()) && !own {
            return Err(Failure::new(
                ErrorKind::Home,
                format!(
                    "a console of profile '{profile}' is open already; close it, or open another profile with --profile"
                ),
            ));
        }
        claims.lock().unwrap_or_else(PoisonError::into_inner).consoles.insert(profile);
        Ok(Reply::Done)
    }

    /// Frees the consoles that a connection held, and ends the servers it asked for.
    pub(super) fn release(&self, claims: &Claims) {
        let mut consoles = self.consoles.lock().unwrap_or_else(PoisonError::into_inner);
        let held = std::mem::take(&mut *claims.lock().unwrap_or_else(PoisonError::into_inner));
        for profile in held.consoles {
            consoles.remove(&profile);
        }
    }
}

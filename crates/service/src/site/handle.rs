//! Which part of the site answers which command.

#![deny(clippy::wildcard_enum_match_arm)]

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

use super::Site;
use super::audit::is_operator;
use super::consoles::{Claims, opened_by, until_released};
use crate::model::{ErrorKind, ProfileName, TopicName, TopicPattern, clean};
use crate::pipeline::Owner;
use crate::service::command::{self as ask, Ask, Command, IncidentCommand, Request, UploadQuery};
use crate::service::failure::input;
use crate::service::reply::{Failure, RecordPage, Reply};
use crate::site::devices::pulling::span;
use crate::site::mirror::remote::{FIRST_ROUND, LISTING};

impl Site {
    /// One arm for each request, so that an unanswered one does not compile.
    #[allow(clippy::too_many_lines, reason = "an arm for each request")]
    pub async fn handle(self: &Arc<Self>, request: Request, claims: &Claims) -> Result<Reply, Failure> {
        let Request { profile, command } = request;
        let owner = || self.parts.owners.unlocked(&profile);
        if let Some(original) = self.home().original().filter(|_| !command.only_reads()) {
            return Err(read_only(original));
        }
        match command {
            // An operator's console takes nothing from the owner's.
            Command::OpenConsole if is_operator() => Ok(ask::OpenConsole::told(())),
            Command::OpenConsole => self.claim(profile, claims).map(ask::OpenConsole::told),
            Command::CreateIdentity { passphrase } => {
                let made = self.profiles.create(profile.clone(), passphrase).await?;
                opened_by(claims, profile);
                Ok(ask::CreateIdentity::told(made))
            }
            Command::ShowIdentity => self.profiles.view(&profile).await.map(ask::ShowIdentity::told),
            Command::Unlock { passphrase } => {
                let was_open = owner().is_ok();
                let view = self.profiles.unlock(profile.clone(), passphrase).await?;
                if !was_open {
                    opened_by(claims, profile);
                }
                Ok(ask::Unlock::told(view))
            }
            Command::ChangePassphrase { old, new } => {
                self.profiles.change_passphrase(&profile, old, new).await.map(ask::ChangePassphrase::told)
            }
            Command::Register => self.profiles.register(&owner()?).await.map(ask::Register::told),
            Command::ListKeys => self.profiles.keys(&owner()?).await.map(ask::ListKeys::told),
            Command::LoadKey { kind, path, passphrase } => {
                self.profiles.load_key(&owner()?, kind, path, passphrase).await.map(ask::LoadKey::told)
            }
            Command::RotateEnvelope => self.profiles.rotate_envelope(&owner()?).await.map(ask::RotateEnvelope::told),
            Command::ForeseeKeyChange { kind } => {
                self.profiles.foresee_key_change(&owner()?, kind).await.map(ask::ForeseeKeyChange::told)
            }
            Command::RotateKeys => self.sharing.rotate(&owner()?, "requested").await.map(ask::RotateKeys::told),
            Command::ExportKey { kind, passphrase } => {
                self.profiles.export_key(&owner()?, kind, passphrase).await.map(ask::ExportKey::told)
            }
            Command::TopicCoverage { topic, robot, since, until, parts } => {
                let view = self.reading.coverage(&profile, (topic, robot), (since, until), parts).await;
                view.map(ask::TopicCoverage::told)
            }
            Command::ListTopics => self.capture.topics(&profile).await.map(ask::ListTopics::told),
            Command::WatchTopic { topic, type_name, sampling } => {
                self.capture.watch(&profile, topic, type_name, sampling).await.map(ask::WatchTopic::told)
            }
            Command::UnwatchTopic { topic } => {
                self.capture.unwatch(&profile, &topic).await.map(ask::UnwatchTopic::told)
            }
            Command::ListPins { topic } => self.pins.view(&profile, topic.as_ref()).await.map(ask::ListPins::told),
            Command::PinTopic { topic, publishers } => {
                self.pins.pin(&profile, &topic, publishers).await.map(ask::PinTopic::told)
            }
            Command::UnpinTopic { topic, caller_id } => {
                self.pins.unpin(&profile, &topic, &caller_id).await.map(ask::UnpinTopic::told)
            }
            Command::ListQuarantine { topic, limit } => {
                self.quarantine.view(&profile, topic, limit).await.map(ask::ListQuarantine::told)
            }
            Command::ReleaseHeld { held } => self.quarantine.release(&owner()?, held).await.map(ask::ReleaseHeld::told),
            Command::DiscardHeld { held } => self.quarantine.discard(&owner()?, held).await.map(ask::DiscardHeld::told),
            Command::ShowPolicy => self.capture.policy_view(&profile, false).await.map(ask::ShowPolicy::told),
            Command::LearnPolicy { milliseconds } => {
                self.capture.learn_policy(&profile, milliseconds).await.map(ask::LearnPolicy::told)
            }
            Command::Capture { topics, type_name, count, milliseconds, tags } => {
                let topics = self.capture.named(&profile, &topics, false).await?;
                let captured = self.capture.capture(&owner()?, &topics, type_name, count, milliseconds, tags).await;
                captured.map(ask::Capture::told)
            }
            Command::StopCapture => {
                self.capture.stop(&profile);
                Ok(ask::StopCapture::told(()))
            }
            Command::ImportRecording(wishes) => {
                self.recordings.import_recording(&owner()?, wishes).await.map(ask::ImportRecording::told)
            }
            Command::FollowFolder(wishes) => {
                let followed = self.recordings.follow(&owner()?, wishes, until_released(claims)).await;
                followed.map(ask::FollowFolder::told)
            }
            Command::ImportHome { home } => {
                self.recordings.import_home(&owner()?, home).await.map(ask::ImportHome::told)
            }
            Command::ExportRecording(wishes) => {
                let owner = self.caught_up_owner(&profile).await?;
                self.recordings.export_recording(&owner, wishes).await.map(ask::ExportRecording::told)
            }
            Command::RecordingProgress => Ok(ask::RecordingProgress::told(self.parts.runs.of(&profile))),
            Command::ListUploads(query) => self.reading.list_own(&profile, query).await.map(ask::ListUploads::told),
            Command::ShowUpload { id } => self.reading.provenance(&profile, &id).map(ask::ShowUpload::told),
            Command::ExportUpload { id, addresses } => {
                self.reading.export_upload(&owner()?, &id, addresses).await.map(ask::ExportUpload::told)
            }
            Command::ExportEvidence(wishes) => {
                self.evidence.export(&owner()?, wishes).await.map(ask::ExportEvidence::told)
            }
            Command::StampEvidence => self.stamps.stamp().await.map(ask::StampEvidence::told),
            Command::ListShared(query) => self.list_shared(&owner()?, query).await.map(ask::ListShared::told),
            Command::CheckShared { id } => {
                let owner = self.owner_with(&profile, &id).await?;
                self.reading.check_record(&owner, &id).await.map(ask::CheckShared::told)
            }
            Command::OpenShared { id } => {
                let owner = self.owner_with(&profile, &id).await?;
                self.reading.open_record(&owner, &id).await.map(Box::new).map(ask::OpenShared::told)
            }
            Command::ViewFile { id, kind } => {
                let owner = self.caught_up_owner(&profile).await?;
                self.reading.file_of(&owner, &id, kind).await.map(Box::new).map(ask::ViewFile::told)
            }
            Command::ViewPath { id, records } => {
                let owner = self.caught_up_owner(&profile).await?;
                self.reading.path_to(&owner, &id, records).await.map(ask::ViewPath::told)
            }
            Command::Play(wishes) => {
                let owner = self.caught_up_owner(&profile).await?;
                self.bridge.play(&owner, wishes, until_released(claims)).await.map(ask::Play::told)
            }
            Command::StopPlay => {
                self.bridge.stop(&profile);
                Ok(ask::StopPlay::told(()))
            }
            Command::Grant { grantee, topics, robots, from, expires } => {
                let topics = self.granted(&profile, &topics, &robots).await?;
                self.sharing.grant(&owner()?, &grantee, &topics, from, expires).await.map(ask::Grant::told)
            }
            Command::ForeseeGrant { grantee, topics, robots, from } => {
                let topics = self.granted(&profile, &topics, &robots).await?;
                self.sharing.foresee_grant(&owner()?, &grantee, &topics, from).await.map(ask::ForeseeGrant::told)
            }
            Command::ExtendGrant { grantee, expires } => {
                self.sharing.extend(&owner()?, &grantee, expires).await.map(ask::ExtendGrant::told)
            }
            Command::Revoke { grantee } => {
                let owner = owner()?;
                let revoked = self.sharing.revoke(&owner, self.contacts.resolve(&grantee)?).await?;
                self.devices.lead(&owner, revoked).await.map(ask::Revoke::told)
            }
            Command::ListGrants => self.sharing.rows(&owner()?).await.map(ask::ListGrants::told),
            Command::LendDevice { device, until } => {
                self.devices.lend(&owner()?, device, until).await.map(ask::LendDevice::told)
            }
            Command::RecallDevice { device } => {
                let owner = owner()?;
                let recalled = self.devices.recall(&owner, &device).await?;
                self.devices.lead(&owner, recalled).await.map(ask::RecallDevice::told)
            }
            Command::AddDeviceTopics { device, topics } => {
                self.devices.add_topics(&owner()?, &device, &topics).await.map(ask::AddDeviceTopics::told)
            }
            Command::AddDeviceAddress { device, address } => {
                let added = self.devices.add_address(&owner()?, &device, address).await;
                added.map(ask::AddDeviceAddress::told)
            }
            Command::EnrolDevice(wishes) => self.devices.enrol(&owner()?, wishes).await.map(ask::EnrolDevice::told),
            Command::ListDevices => self.devices.rows(&owner()?).await.map(ask::ListDevices::told),
            Command::CompareFingerprint { fingerprint, account } => {
                let compared = self.contacts.compare(&profile, &fingerprint, account).await;
                compared.map(ask::CompareFingerprint::told)
            }
            Command::ListContacts => self.contacts.rows().await.map(ask::ListContacts::told),
            Command::AddContact { name, address, fingerprint } => {
                self.contacts.add(&profile, name, address, fingerprint).await.map(ask::AddContact::told)
            }
            Command::RemoveContact { name } => {
                self.contacts.remove(&profile, &name).await.map(ask::RemoveContact::told)
            }
            Command::ConfirmContact { name, fingerprint } => {
                self.contacts.confirm(&profile, &name, fingerprint).await.map(ask::ConfirmContact::told)
            }
            Command::Administer(act) => self.administering.administer(&owner()?, &act).await.map(ask::Administer::told),
            Command::NameRecovery { recovery } => {
                self.administering.name_recovery(&owner()?, recovery.as_ref()).await.map(ask::NameRecovery::told)
            }
            Command::ListSuccessions => {
                self.chain_view(&profile).await.map(|view| ask::ListSuccessions::told(Box::new(view.administration)))
            }
            Command::ChainStatus => self.chain_view(&profile).await.map(Box::new).map(ask::ChainStatus::told),
            Command::DeployContract { delay } => {
                self.connection.deploy_contract(&owner()?, delay).await.map(ask::DeployContract::told)
            }
            Command::CancelTransaction { nonce, account } => {
                let (owner, network) = (owner()?, self.parts.link.network().await?);
                let key = self.lanes.key(&owner, &network, account)?;
                self.administering.cancel(&owner, &key, nonce).await.map(ask::CancelTransaction::told)
            }
            Command::ServeChain { address } => {
                let served = self.connection.serve_chain(&profile, address, until_released(claims)).await;
                served.map(ask::ServeChain::told)
            }
            Command::ServeGateway { address, open } => {
                let served = self.gateway.serve(&owner()?, address, open, until_released(claims)).await;
                served.map(ask::ServeGateway::told)
            }
            Command::SiteStatus => self.site_view(&profile).await.map(ask::SiteStatus::told),
            Command::ListAudit(query) => self.parts.log.list(query).await.map(ask::ListAudit::told),
            Command::VerifyAudit { heads } => {
                self.audit.verify(heads.then(owner).transpose()?).await.map(ask::VerifyAudit::told)
            }
            Command::ExportAudit { addresses } => {
                self.parts.log.export(&owner()?, addresses).await.map(ask::ExportAudit::told)
            }
            Command::AuditRecords { deep, since } => {
                let is_pinned = self.connection.pin()?.is_some();
                let audited = self.audit.records(&profile, is_pinned, deep, since).await;
                audited.map(Box::new).map(ask::AuditRecords::told)
            }
            Command::ListAllUploads(query) => self.reading.list_all(query).map(ask::ListAllUploads::told),
            Command::EraseRecords(wishes) => {
                let owner = owner()?;
                self.reading.learn_own_names(&profile).await?;
                let view = self.storage.erase(&owner, wishes).await?;
                Ok(ask::EraseRecords::told(self.joined.names_who_is_told(view)))
            }
            Command::BackUp { file, passphrase } => {
                self.backup.back_up(&profile, file, passphrase).await.map(ask::BackUp::told)
            }
            Command::Lock => self.profiles.lock(&profile).await.map(ask::Lock::told),
            Command::HoldCapture { hold } => self.capture.hold(&profile, hold).map(ask::HoldCapture::told),
            Command::BackUpKeys => self.profiles.back_up_keys(&profile).await.map(ask::BackUpKeys::told),
            Command::RestoreKeys { path, passphrase } => {
                self.profiles.restore(profile, path, passphrase).await.map(ask::RestoreKeys::told)
            }
            Command::ListAlerts => self.alerts_view().await.map(ask::ListAlerts::told),
            Command::TestAlert => self.test_alert().await.map(ask::TestAlert::told),
            Command::GatewayStatus => self.gateway.status().map(ask::GatewayStatus::told),
            Command::Admit { owner } => self.admissions.admit(&profile, &owner).await.map(ask::Admit::told),
            Command::Dismiss { owner } => self.admissions.dismiss(&profile, &owner).await.map(ask::Dismiss::told),
            Command::ListAdmitted => self.admissions.rows().map(ask::ListAdmitted::told),
            Command::OfIncident(command) => self.of_incident(&profile, command).await,
            Command::OfRobot(command) => {
                // Robots' records arrive without topic names.
                self.reading.learn_own_names(&profile).await?;
                self.devices.answer(&owner()?, command).await
            }
        }
    }

    /// The topics of a grant: those named, those known that match a pattern, and those of robots.
    async fn granted(
        &self,
        profile: &ProfileName,
        topics: &[TopicPattern],
        robots: &[String],
    ) -> Result<Vec<TopicName>, Failure> {
        if !robots.is_empty() || topics.iter().any(|topic| !topic.is_plain()) {
            // Robots' records arrive without topic names.
            self.reading.learn_own_names(profile).await?;
        }
        let mut names = self.capture.named(profile, topics, true).await?;
        for robot in robots {
            let of_robot = self.topics_of(profile, robot).await?;
            names.extend(of_robot.into_iter().filter(|name| !names.contains(name)).collect::<Vec<_>>());
        }
        Ok(names)
    }

    /// What an enrolled robot of this name may record or has recorded, and the topics under its name.
    async fn topics_of(&self, profile: &ProfileName, robot: &str) -> Result<BTreeSet<TopicName>, Failure> {
        let enrolled = self.reading.topics_of_robot(self.parts.owners.address_of(profile)?, robot);
        let mut names: BTreeSet<TopicName> = match TopicPattern::of_robot(robot) {
            Ok(under) => {
                let known = self.capture.known(profile, true).await?.into_iter();
                known.filter(|name| under.matches(name.as_str())).collect()
            }
            // No part of a topic's name can be called so.
            Err(_) => BTreeSet::new(),
        };
        match enrolled {
            Ok(topics) => names.extend(topics.iter().filter_map(|topic| topic.parse().ok())),
            Err(unknown) if names.is_empty() => return Err(unknown),
            Err(_) => {}
        }
        if names.is_empty() {
            let robot = clean(robot, 64);
            return Err(input(format!(
                "robot '{robot}' has recorded nothing yet; name its topics, or wait for a record"
            )));
        }
        Ok(names)
    }

    /// Answers a request about incidents; robots' rings are requested once the incident exists.
    async fn of_incident(&self, profile: &ProfileName, command: IncidentCommand) -> Result<Reply, Failure> {
        let asked = if let IncidentCommand::OpenIncident { since, until, topics, robots, .. } = &command
            && !robots.is_empty()
        {
            Some((self.parts.owners.unlocked(profile)?, robots.clone(), span(*since, *until, topics.clone())?))
        } else {
            None
        };
        if let Some((owner, robots, _)) = &asked {
            self.devices.check_robots(owner, robots).await?;
        }
        // Records are counted by topic name.
        self.reading.learn_own_names(profile).await?;
        let told = self.incidents.answer(profile, command).await?;
        if let Some((owner, robots, span)) = &asked {
            for robot in robots {
                self.devices.pull(owner, robot, span).await?;
            }
        }
        Ok(told)
    }

    /// Records shared with a profile, as far as they are here. A large gateway's first list is slow and a gateway may
    /// be away, so the page says why it may be incomplete.
    async fn list_shared(&self, owner: &Arc<Owner>, query: UploadQuery) -> Result<RecordPage, Failure> {
        let arriving = match self.joined.arriving(&owner.profile, LISTING).await {
            Ok(None) => return self.reading.list_shared(owner, query).await,
            Ok(Some(arriving)) => arriving,
            Err(failure) if failure.kind == ErrorKind::Unreachable => {
                let page = self.reading.list_shared(owner, query).await?;
                let arriving = self.joined.still_arriving().filter(|_| !page.records.is_empty());
                let arriving = arriving.ok_or_else(|| failure.clone())?;
                return Ok(RecordPage { arriving: Some(format!("{arriving}: {}", failure.message)), ..page });
            }
            Err(failure) => return Err(failure),
        };
        let page = self.reading.list_shared(owner, query.clone()).await?;
        if !page.records.is_empty() || self.joined.arriving(&owner.profile, FIRST_ROUND).await?.is_some() {
            return Ok(RecordPage { arriving: Some(arriving), ..page });
        }
        self.reading.list_shared(owner, query).await
    }

    /// The profile's owner, once this record is here; does not wait for others.
    async fn owner_with(&self, profile: &ProfileName, id: &str) -> Result<Arc<Owner>, Failure> {
        let owner = self.parts.owners.unlocked(profile)?;
        let more = self.joined.arriving(profile, LISTING).await?.is_some();
        if more && self.reading.find_record(id).is_err() {
            self.joined.caught_up(profile).await?;
        }
        Ok(owner)
    }

    /// The profile's owner, once the records shared with it are up to date.
    async fn caught_up_owner(&self, profile: &ProfileName) -> Result<Arc<Owner>, Failure> {
        let owner = self.parts.owners.unlocked(profile)?;
        self.joined.caught_up(profile).await?;
        Ok(owner)
    }
}

fn read_only(original: &Path) -> Failure {
    let root = original.display();
    let text = format!(
        "{root} is read-only, so only status, audit, evidence export, and listing, opening and exporting records work; \
         make it writable for everything else"
    );
    Failure::new(ErrorKind::Home, text)
}

//! Which part of the site answers which command.

#![deny(clippy::wildcard_enum_match_arm)]

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

use super::audit::is_operator;
use super::consoles::{opened_by, until_released};
use crate::command::{self as ask, Ask, Command, IncidentCommand, Request, UploadQuery};
use crate::model::{ErrorKind, ProfileName, TopicName, TopicPattern, clean};
use crate::pipeline::Owner;
use crate::reply::{Failure, RecordPage, Reply, Result, input};
use crate::site::devices::span;
use crate::site::mirror::remote::{FIRST_ROUND, LISTING};
use crate::site::{Claims, Site};

/// A match with an arm for each request, whose answer is of the type that the request names.
macro_rules! answers {
    (
        $command:expr;
        groups { $($group:ident($members:ident) => $reply:expr;)+ }
        $($name:ident $({ $($field:ident),+ })? $(($one:ident))? => $answer:expr;)+
    ) => {
        match $command {
            $(Command::$name $({ $($field),+ })? $(($one))? => ($answer).map(ask::$name::told),)+
            $(Command::$group($members) => $reply,)+
        }
    };
}

impl Site {
    /// One arm for each request, so that an unanswered one does not compile.
    #[allow(clippy::too_many_lines, reason = "an arm for each request")]
    pub async fn handle(self: &Arc<Self>, request: Request, claims: &Claims) -> Result<Reply> {
        let Request { profile, command } = request;
        let owner = || self.parts.owners.unlocked(&profile);
        if let Some(original) = self.home().original().filter(|_| !command.only_reads()) {
            return Err(read_only(original));
        }
        if self.parts.is_on_server() {
            command.check_on_server()?;
        }
        answers! { command;
            groups {
                OfIncident(command) => self.of_incident(&profile, command).await;
                OfRobot(command) => {
                    // Robots' records arrive without topic names.
                    self.reading.learn_own_names(&profile).await?;
                    self.devices.answer(&*owner()?, command).await
                };
            }
            // An operator's console takes nothing from the owner's.
            OpenConsole => if is_operator() { Ok(()) } else { self.claim(profile, claims) };
            CreateIdentity { passphrase } => {
                let made = self.profiles.create(profile.clone(), passphrase).await?;
                opened_by(claims, profile);
                Ok(made)
            };
            ShowIdentity => self.profiles.view(&profile).await;
            Unlock { passphrase } => {
                let was_open = owner().is_ok();
                let view = self.profiles.unlock(profile.clone(), passphrase).await?;
                if !was_open {
                    opened_by(claims, profile);
                }
                Ok(view)
            };
            ChangePassphrase { old, new } => self.profiles.change_passphrase(&profile, old, new).await;
            Register => self.profiles.register(&owner()?).await;
            ListKeys => self.profiles.keys(&*owner()?).await;
            LoadKey { kind, path, passphrase } => self.profiles.load_key(&owner()?, kind, path, passphrase).await;
            ForeseeKeyChange { kind } => self.profiles.foresee_key_change(&*owner()?, kind).await;
            RotateEnvelope => self.profiles.rotate_envelope(&*owner()?).await;
            RotateKeys => self.sharing.rotate(&*owner()?, "requested").await;
            ExportKey { kind, passphrase } => self.profiles.export_key(&*owner()?, kind, passphrase).await;
            TopicCoverage { topic, robot, since, until, parts } => {
                self.reading.coverage(&profile, (topic, robot), (since, until), parts).await
            };
            ListTopics => self.capture.topics(&profile).await;
            WatchTopic { topic, type_name, sampling } => {
                self.capture.watch(&profile, topic, type_name, sampling).await
            };
            UnwatchTopic { topic } => self.capture.unwatch(&profile, &topic).await;
            ListPins { topic } => self.pins.view(&profile, topic.as_ref()).await;
            PinTopic { topic, publishers } => self.pins.pin(&profile, &topic, publishers).await;
            UnpinTopic { topic, caller_id } => self.pins.unpin(&profile, &topic, &caller_id).await;
            ListQuarantine { topic, limit } => self.quarantine.view(&profile, topic, limit);
            ReleaseHeld { held } => self.quarantine.release(&*owner()?, held).await;
            DiscardHeld { held } => self.quarantine.discard(&*owner()?, held).await;
            ShowPolicy => self.capture.policy_view(&profile).await;
            Capture { topics, type_name, count, milliseconds, tags } => {
                let topics = self.capture.named(&profile, &topics, false).await?;
                self.capture.capture(&owner()?, &topics, type_name, count, milliseconds, tags).await
            };
            StopCapture => {
                self.capture.stop(&profile);
                Ok(())
            };
            ImportRecording(wishes) => self.recordings.import_recording(&owner()?, wishes).await;
            FollowFolder(wishes) => self.recordings.follow(&owner()?, wishes, until_released(claims)).await;
            ImportHome { home } => self.recordings.import_home(&owner()?, home).await;
            ExportRecording(wishes) => {
                self.recordings.export_recording(&*self.caught_up_owner(&profile).await?, wishes).await
            };
            RecordingProgress => Ok(self.parts.runs.of(&profile));
            ListUploads(query) => self.reading.list_own(&profile, query).await;
            ShowUpload { id } => self.reading.provenance(&profile, &id);
            ExportUpload { id, addresses } => self.reading.export_upload(&*owner()?, &id, addresses).await;
            ExportEvidence(wishes) => self.evidence.export(&*owner()?, wishes).await;
            StampEvidence => self.stamps.stamp().await;
            ListShared(query) => self.list_shared(&*owner()?, query).await;
            CheckShared { id } => self.reading.check_record(&*self.owner_with(&profile, &id).await?, &id).await;
            OpenShared { id } => {
                let owner = self.owner_with(&profile, &id).await?;
                self.reading.open_record(&owner, &id).await.map(Box::new)
            };
            ViewFile { id, kind } => {
                let owner = self.caught_up_owner(&profile).await?;
                self.reading.file_of(&owner, &id, kind).await.map(Box::new)
            };
            ViewPath { id, records } => {
                self.reading.path_to(&*self.caught_up_owner(&profile).await?, &id, records).await
            };
            Play(wishes) => {
                let owner = self.caught_up_owner(&profile).await?;
                self.bridge.play(&owner, wishes, until_released(claims)).await
            };
            StopPlay => {
                self.bridge.stop(&profile);
                Ok(())
            };
            Grant { grantee, topics, robots, from, expires } => {
                let topics = self.given(&profile, &topics, &robots).await?;
                self.sharing.grant(&*owner()?, &grantee, &topics, from, expires).await
            };
            ForeseeGrant { grantee, topics, robots, from } => {
                let topics = self.given(&profile, &topics, &robots).await?;
                self.sharing.foresee_grant(&*owner()?, &grantee, &topics, from).await
            };
            ExtendGrant { grantee, expires } => self.sharing.extend(&*owner()?, &grantee, expires).await;
            Revoke { grantee } => {
                let owner = owner()?;
                let revoked = self.sharing.revoke(&owner, self.contacts.resolve(&grantee)?).await?;
                self.devices.lead(&owner, revoked).await
            };
            ListGrants => self.sharing.rows(&owner()?).await;
            LendDevice { device, until } => self.devices.lend(&*owner()?, device, until).await;
            RecallDevice { device } => {
                let owner = owner()?;
                let recalled = self.devices.recall(&owner, &device).await?;
                self.devices.lead(&owner, recalled).await
            };
            AddDeviceTopics { device, topics } => self.devices.add_topics(&owner()?, &device, &topics).await;
            AddDeviceAddress { device, address } => self.devices.add_address(&*owner()?, &device, address).await;
            EnrolDevice(wishes) => self.devices.enrol(&*owner()?, wishes).await;
            ListDevices => self.devices.rows(&*owner()?).await;
            CompareFingerprint { fingerprint, account } => {
                self.contacts.compare(&profile, &fingerprint, account).await
            };
            ListContacts => self.contacts.rows().await;
            AddContact { name, address, fingerprint } => {
                self.contacts.add(&profile, name, address, fingerprint).await
            };
            RemoveContact { name } => self.contacts.remove(&profile, &name).await;
            ConfirmContact { name, fingerprint } => self.contacts.confirm(&profile, &name, fingerprint).await;
            Administer(act) => self.administering.administer(&*owner()?, &act).await;
            NameRecovery { recovery } => self.administering.name_recovery(&*owner()?, recovery.as_ref()).await;
            ListSuccessions => self.chain_view(&profile).await.map(|view| Box::new(view.administration));
            ChainStatus => self.chain_view(&profile).await.map(Box::new);
            DeployContract { delay } => self.connection.deploy_contract(&*owner()?, delay).await;
            CancelTransaction { nonce, account } => {
                let (owner, network) = (owner()?, self.parts.link.network().await?);
                let key = self.lanes.key(&owner, &network, account)?;
                self.administering.cancel(&owner, &key, nonce).await
            };
            ServeChain { address } => self.connection.serve_chain(&profile, address, until_released(claims)).await;
            ServeGateway { address, open } => {
                self.gateway.serve(&owner()?, address, open, until_released(claims)).await
            };
            SiteStatus => self.site_view(&profile).await;
            ListAudit(query) => self.parts.log.list(query).await;
            VerifyAudit { heads } => self.audit.verify(heads.then(owner).transpose()?).await;
            ExportAudit { addresses } => self.parts.log.export(&*owner()?, addresses).await;
            AuditRecords { deep, since } => {
                let is_pinned = self.connection.pin()?.is_some();
                self.audit.records(&profile, is_pinned, deep, since).await.map(Box::new)
            };
            ListAllUploads(query) => self.reading.list_all(query);
            EraseRecords(wishes) => {
                let owner = owner()?;
                self.reading.learn_own_names(&profile).await?;
                self.storage.erase(&owner, wishes).await.map(|view| self.joined.names_who_is_told(view))
            };
            BackUp { file, passphrase } => self.backup.back_up(&profile, file, passphrase).await;
            Lock => self.profiles.lock(&profile).await;
            HoldCapture { hold } => self.capture.hold(&profile, hold);
            BackUpKeys => self.profiles.back_up_keys(&profile).await;
            RestoreKeys { path, passphrase } => self.profiles.restore(profile, path, passphrase).await;
            ListAlerts => self.alerts_view().await;
            TestAlert => self.test_alert().await;
            GatewayStatus => self.gateway.status();
            MakeJoinFile { passphrase, renew } => self.gateway.join_file(&profile, &passphrase, renew).await;
            Admit { owner } => self.admissions.admit(&profile, &owner).await;
            Dismiss { owner } => self.admissions.dismiss(&profile, &owner).await;
            ListAdmitted => self.admissions.rows();
        }
    }

    /// The topics of a grant: those named, those known that match a pattern, and those of robots.
    async fn given(&self, profile: &ProfileName, topics: &[TopicPattern], robots: &[String]) -> Result<Vec<TopicName>> {
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
    async fn of_incident(&self, profile: &ProfileName, command: IncidentCommand) -> Result<Reply> {
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
    async fn list_shared(&self, owner: &Owner, query: UploadQuery) -> Result<RecordPage> {
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
    async fn owner_with(&self, profile: &ProfileName, id: &str) -> Result<Arc<Owner>> {
        let owner = self.parts.owners.unlocked(profile)?;
        let more = self.joined.arriving(profile, LISTING).await?.is_some();
        if more && self.reading.find_record(id).is_err() {
            self.joined.caught_up(profile).await?;
        }
        Ok(owner)
    }

    /// The profile's owner, once the records shared with it are up to date.
    async fn caught_up_owner(&self, profile: &ProfileName) -> Result<Arc<Owner>> {
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

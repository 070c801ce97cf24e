//! Recordings and other homes: imported as records, exported from records; and their progress.

mod choosing;
mod claims;
mod export;
mod follow;
mod from_home;
mod import;
mod sealed_before;
mod standings;
mod writing;

use self::claims::Claims;
pub(in crate::site) use self::import::RECORDING;
use crate::config::Config;
use crate::paths::Home;
use crate::pipeline::Plant;
use crate::pipeline::recorder::CapturedMessage;
use crate::pipeline::ring::Rings;
use crate::service::hub::Hub;
use crate::site::audit::Log;
use crate::site::capture::Capture;
use crate::site::capture::sealer_thread::SealerThread;
use crate::site::chain::link::Link;
use crate::site::contacts::Contacts;
use crate::site::evidence::Evidence;
use crate::site::identity::Profiles;
use crate::site::lifetime::Lifetime;
use crate::site::mirror::Joined;
use crate::site::parts::Parts;
use crate::site::progress::{Run, Running, Runs};
use crate::site::reading::Reading;
use std::path::Path;
use std::sync::Arc;

use tokio::sync::oneshot;

use crate::model::ProfileName;
use crate::pipeline::Owner;
use crate::service::command::{
    Ask, ExportWishes, FollowWishes, HomeWishes, ImportWishes, RecordingCommand, RecordingProgress,
};
use crate::service::reply::{Failure, Reply};

/// Imports and exports of recordings.
pub(in crate::site) struct Recordings {
    home: Home,
    config: Arc<Config>,
    plant: Plant,
    hub: Arc<Hub>,
    log: Arc<Log>,
    link: Arc<Link>,
    life: Arc<Lifetime>,
    contacts: Arc<Contacts>,
    reading: Arc<Reading>,
    capture: Arc<Capture>,
    profiles: Arc<Profiles>,
    joined: Arc<Joined>,
    sealer: Arc<SealerThread>,
    rings: Arc<Rings<CapturedMessage>>,
    evidence: Arc<Evidence>,
    claims: Arc<Claims>,
    runs: Runs,
}

/// The parts used by recordings.
pub(in crate::site) struct Asked<'a> {
    pub contacts: &'a Arc<Contacts>,
    pub reading: &'a Arc<Reading>,
    pub capture: &'a Arc<Capture>,
    pub profiles: &'a Arc<Profiles>,
    pub joined: &'a Arc<Joined>,
    pub sealer: &'a Arc<SealerThread>,
    pub rings: &'a Arc<Rings<CapturedMessage>>,
    pub evidence: &'a Arc<Evidence>,
}

impl Recordings {
    /// From the shared parts.
    pub fn new(parts: &Parts, asked: &Asked<'_>) -> Self {
        let Asked { contacts, reading, capture, profiles, joined, sealer, rings, evidence } = asked;
        let Parts { home, config, plant, hub, log, link, life, runs, .. } = parts.clone();
        Self {
            home,
            config,
            plant,
            hub,
            log,
            link,
            life,
            contacts: Arc::clone(contacts),
            reading: Arc::clone(reading),
            capture: Arc::clone(capture),
            profiles: Arc::clone(profiles),
            joined: Arc::clone(joined),
            sealer: Arc::clone(sealer),
            rings: Arc::clone(rings),
            evidence: Arc::clone(evidence),
            claims: Arc::default(),
            runs,
        }
    }
}

impl Recordings {
    fn begin_run(&self, profile: &ProfileName, path: &Path, step: &'static str) -> Running {
        self.runs.begin(profile, &path.display().to_string(), step, "messages")
    }

    /// Answers a command about recordings.
    pub(super) async fn answer(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        command: RecordingCommand,
        gone: oneshot::Receiver<()>,
    ) -> Result<Reply, Failure> {
        match command {
            RecordingCommand::Import(wishes) => self.import_recording(owner, wishes).await.map(ImportWishes::told),
            RecordingCommand::Follow(wishes) => self.follow(owner, wishes, gone).await.map(FollowWishes::told),
            RecordingCommand::ImportHome(wishes) => self.import_home(owner, wishes).await.map(HomeWishes::told),
            RecordingCommand::Export(wishes) => {
                self.joined.caught_up(&owner.profile).await?;
                self.export_recording(owner, wishes).await.map(ExportWishes::told)
            }
            RecordingCommand::Progress => Ok(RecordingProgress::told(self.runs.of(&owner.profile))),
        }
    }
}

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
use crate::site::parts::Parts;
use crate::site::progress::{Run, Running, Runs};
use crate::site::reading::Reading;
use std::path::Path;
use std::sync::Arc;

use crate::model::ProfileName;

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
    pub sealer: &'a Arc<SealerThread>,
    pub rings: &'a Arc<Rings<CapturedMessage>>,
    pub evidence: &'a Arc<Evidence>,
}

impl Recordings {
    /// From the shared parts.
    pub fn new(parts: &Parts, asked: &Asked<'_>) -> Self {
        let Asked { contacts, reading, capture, profiles, sealer, rings, evidence } = asked;
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
}

//! Recordings and other homes: imported as records, exported from records; and their progress.

mod claims;
mod export;
mod follow;
mod from_home;
mod import;
mod standings;

use self::claims::Claims;
pub(in crate::site) use self::import::RECORDING;
use crate::pipeline::recorder::CapturedMessage;
use crate::pipeline::ring::Rings;
use crate::site::capture::Capture;
use crate::site::capture::sealer_thread::SealerThread;
use crate::site::contacts::Contacts;
use crate::site::evidence::Evidence;
use crate::site::identity::Profiles;
use crate::site::parts::Parts;
use crate::site::progress::{Run, Running};
use crate::site::reading::Reading;
use std::path::Path;
use std::sync::Arc;

use crate::model::ProfileName;

pub(in crate::site) struct Recordings {
    pub parts: Parts,
    pub contacts: Arc<Contacts>,
    pub reading: Arc<Reading>,
    pub capture: Arc<Capture>,
    pub profiles: Arc<Profiles>,
    pub sealer: Arc<SealerThread>,
    pub rings: Arc<Rings<CapturedMessage>>,
    pub evidence: Arc<Evidence>,
    pub claims: Arc<Claims>,
}

impl Recordings {
    fn begin_run(&self, profile: &ProfileName, path: &Path, step: &'static str) -> Running {
        self.parts.runs.begin(profile, &path.display().to_string(), step, "messages")
    }
}

//! Recordings: imported as records, exported from records; and their progress.

mod export;
mod import;
mod sealed_before;
mod writing;

use crate::config::Config;
use crate::pipeline::Plant;
use crate::pipeline::recorder::CapturedMessage;
use crate::pipeline::ring::Rings;
use crate::service::hub::Hub;
use crate::site::audit::Log;
use crate::site::capture::Capture;
use crate::site::capture::sealer_thread::SealerThread;
use crate::site::chain::link::Link;
use crate::site::contacts::Contacts;
use crate::site::identity::Profiles;
use crate::site::lifetime::Lifetime;
use crate::site::mirror::Joined;
use crate::site::parts::Parts;
use crate::site::reading::Reading;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use crate::model::{ProfileName, clean};
use crate::pipeline::Owner;
use crate::service::command::{Ask, ExportWishes, ImportWishes, RecordingCommand, RecordingProgress};
use crate::service::reply::{Failure, ProgressView, Reply};

/// A running import or export.
pub(super) struct Run {
    profile: ProfileName,
    file: String,
    step: Mutex<&'static str>,
    done: AtomicU64,
    of: AtomicU64,
    messages: AtomicU64,
}

impl Run {
    fn step(&self, word: &'static str) {
        *self.step.lock().unwrap_or_else(PoisonError::into_inner) = word;
    }

    fn at(&self, done: u64, of: u64, messages: u64) {
        self.done.store(done, Ordering::Relaxed);
        self.of.store(of, Ordering::Relaxed);
        self.messages.store(messages, Ordering::Relaxed);
    }

    fn view(&self) -> ProgressView {
        ProgressView {
            step: (*self.step.lock().unwrap_or_else(PoisonError::into_inner)).to_owned(),
            file: self.file.clone(),
            done: self.done.load(Ordering::Relaxed),
            of: self.of.load(Ordering::Relaxed),
            messages: self.messages.load(Ordering::Relaxed),
        }
    }
}

/// All runs at present.
pub(super) type Runs = Mutex<Vec<Arc<Run>>>;

/// Removes a run from the list when it ends, however it ends.
struct Running<'a> {
    recordings: &'a Recordings,
    run: Arc<Run>,
}

impl Drop for Running<'_> {
    fn drop(&mut self) {
        let mut runs = self.recordings.runs.lock().unwrap_or_else(PoisonError::into_inner);
        runs.retain(|run| !Arc::ptr_eq(run, &self.run));
    }
}

/// Imports and exports of recordings.
pub(in crate::site) struct Recordings {
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
}

impl Recordings {
    /// From the shared parts.
    pub fn new(parts: &Parts, asked: &Asked<'_>) -> Self {
        let Asked { contacts, reading, capture, profiles, joined, sealer, rings } = asked;
        let Parts { config, plant, hub, log, link, life, .. } = parts.clone();
        Self {
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
            runs: Runs::default(),
        }
    }
}

impl Recordings {
    fn begin_run(&self, profile: &ProfileName, path: &Path, step: &'static str) -> Running<'_> {
        let run = Arc::new(Run {
            profile: profile.clone(),
            file: clean(&path.display().to_string(), 300),
            step: Mutex::new(step),
            done: AtomicU64::new(0),
            of: AtomicU64::new(0),
            messages: AtomicU64::new(0),
        });
        self.runs.lock().unwrap_or_else(PoisonError::into_inner).push(Arc::clone(&run));
        Running { recordings: self, run }
    }

    /// Whether this file is being read or written for the profile.
    fn is_running(&self, profile: &ProfileName, file: &str) -> bool {
        let runs = self.runs.lock().unwrap_or_else(PoisonError::into_inner);
        runs.iter().any(|run| run.profile == *profile && run.file == file)
    }

    /// Answers a command about recordings.
    pub(super) async fn answer(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        command: RecordingCommand,
    ) -> Result<Reply, Failure> {
        match command {
            RecordingCommand::Import(wishes) => self.import_recording(owner, wishes).await.map(ImportWishes::told),
            RecordingCommand::Export(wishes) => {
                self.joined.caught_up(&owner.profile).await?;
                self.export_recording(owner, wishes).await.map(ExportWishes::told)
            }
            RecordingCommand::Progress => {
                let runs = self.runs.lock().unwrap_or_else(PoisonError::into_inner);
                let own = runs.iter().filter(|run| run.profile == owner.profile);
                Ok(RecordingProgress::told(own.map(|run| run.view()).collect()))
            }
        }
    }
}

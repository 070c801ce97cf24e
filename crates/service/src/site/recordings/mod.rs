//! Recordings: taken in as records, written from records; and how far that is.

mod export;
mod import;
mod sealed_before;
mod writing;

use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use super::Site;
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

/// All that run now.
pub(super) type Runs = Mutex<Vec<Arc<Run>>>;

/// Takes a run off the list when it ends, however it ends.
struct Running<'a> {
    site: &'a Site,
    run: Arc<Run>,
}

impl Drop for Running<'_> {
    fn drop(&mut self) {
        let mut runs = self.site.recordings.lock().unwrap_or_else(PoisonError::into_inner);
        runs.retain(|run| !Arc::ptr_eq(run, &self.run));
    }
}

impl Site {
    fn begin_run(&self, profile: &ProfileName, path: &Path, step: &'static str) -> Running<'_> {
        let run = Arc::new(Run {
            profile: profile.clone(),
            file: clean(&path.display().to_string(), 300),
            step: Mutex::new(step),
            done: AtomicU64::new(0),
            of: AtomicU64::new(0),
            messages: AtomicU64::new(0),
        });
        self.recordings.lock().unwrap_or_else(PoisonError::into_inner).push(Arc::clone(&run));
        Running { site: self, run }
    }

    /// Whether this file is being read or written for the profile.
    fn is_running(&self, profile: &ProfileName, file: &str) -> bool {
        let runs = self.recordings.lock().unwrap_or_else(PoisonError::into_inner);
        runs.iter().any(|run| run.profile == *profile && run.file == file)
    }

    /// Answers a command about recordings.
    pub(super) async fn recording(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        command: RecordingCommand,
    ) -> Result<Reply, Failure> {
        match command {
            RecordingCommand::Import(wishes) => self.import_recording(owner, wishes).await.map(ImportWishes::told),
            RecordingCommand::Export(wishes) => {
                self.caught_up(&owner.profile).await?;
                self.export_recording(owner, wishes).await.map(ExportWishes::told)
            }
            RecordingCommand::Progress => {
                let runs = self.recordings.lock().unwrap_or_else(PoisonError::into_inner);
                let own = runs.iter().filter(|run| run.profile == owner.profile);
                Ok(RecordingProgress::told(own.map(|run| run.view()).collect()))
            }
        }
    }
}

//! The thread that seals captured and imported messages, started on first use.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use crate::model::counted;
use crate::pipeline::Losses;
use crate::pipeline::disk_ring::SharedRing;
use crate::pipeline::recorder::CapturedMessage;
use crate::pipeline::ring::Rings;
use crate::pipeline::sealer::Sealer;
use crate::service::reply::Result;
use crate::site::parts::Parts;

pub(in crate::site) struct SealerThread {
    parts: Parts,
    rings: Arc<Rings<CapturedMessage>>,
    losses: Arc<Losses>,
    ring: Arc<OnceLock<SharedRing>>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl SealerThread {
    pub fn new(parts: &Parts, rings: &Arc<Rings<CapturedMessage>>, losses: &Arc<Losses>) -> Self {
        let (parts, rings, losses) = (parts.clone(), Arc::clone(rings), Arc::clone(losses));
        Self { parts, rings, losses, ring: Arc::default(), thread: Mutex::default() }
    }

    pub fn fill(&self, ring: &SharedRing) {
        drop(self.ring.set(Arc::clone(ring)));
    }

    /// A run that captures nothing may still import.
    pub fn begin(&self) -> Result<()> {
        let mut thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner);
        if thread.is_some() || self.rings.is_closed() {
            return Ok(());
        }
        self.take_over();
        let (plant, hub, losses) = (self.parts.plant.clone(), Arc::clone(&self.parts.hub), Arc::clone(&self.losses));
        let (rings, ring, compression) =
            (Arc::clone(&self.rings), Arc::clone(&self.ring), self.parts.config.compression);
        *thread = Some(self.parts.supervisor.keep_thread("sealer", move || {
            let sealer = Sealer::new(plant.clone(), Arc::clone(&hub.sessions), Arc::clone(&losses));
            let sealer = sealer.with_ring(Arc::clone(&ring));
            let mut sealer = if compression { sealer } else { sealer.without_compression() };
            sealer.run(&rings, &|| hub.stored.notify_waiters());
        })?);
        Ok(())
    }

    /// Counts messages that died in memory with the previous process, while its disk was full.
    fn take_over(&self) {
        let text = match self.losses.keep_in(&self.parts.home.waiting(), &self.parts.plant) {
            Ok(0) => return,
            Ok(count) => format!(
                "{} waited in memory for a full disk when this site last ended: lost, as gap records report",
                counted(count, "message")
            ),
            Err(error) => format!("what waits in memory for a full disk will not be counted after a crash: {error}"),
        };
        self.parts.hub.warn(&text);
    }

    pub async fn finish(&self, patience: Duration) -> bool {
        self.rings.close();
        let thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner).take();
        let Some(thread) = thread else { return true };
        let joined = tokio::task::spawn_blocking(move || thread.join());
        tokio::time::timeout(patience, joined).await.is_ok()
    }
}

//! Connections that stay open between requests. Each carries one request at a time, so an answer is always that of the
//! last question; one on which something went wrong is closed.

use std::pin::Pin;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use tokio::sync::Semaphore;
use tokio_tungstenite::tungstenite::Bytes;

use super::{IDLE, Limits, TOGETHER, TransportError, WIDE_TOGETHER};

/// A connection.
pub(super) trait Link: Send + Sized {
    /// Sends a request and reads its answer, of at most `most` bytes.
    fn exchange(&mut self, request: &str, most: usize) -> impl Future<Output = Result<Bytes, TransportError>> + Send;
}

/// Opens a connection whose answers have at most that many bytes.
pub(super) type Opener<L> =
    Box<dyn Fn(usize) -> Pin<Box<dyn Future<Output = Result<L, TransportError>> + Send>> + Send + Sync>;

/// The connections to one node.
pub(super) struct Kept<L> {
    open: Opener<L>,
    usual: Pool<L>,
    wide: Pool<L>,
}

struct Pool<L> {
    places: Semaphore,
    /// Idle connections and since when; the newest is last.
    idle: Mutex<Vec<(L, Instant)>>,
}

impl<L> Pool<L> {
    fn new(places: usize) -> Self {
        Self { places: Semaphore::new(places), idle: Mutex::default() }
    }

    /// The newest idle connection, unless the node may be about to close it.
    fn take(&self) -> Option<L> {
        let mut idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        idle.retain(|(_, since)| since.elapsed() < IDLE);
        idle.pop().map(|(link, _)| link)
    }

    fn give_back(&self, link: L) {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner).push((link, Instant::now()));
    }
}

impl<L: Link> Kept<L> {
    /// Not connected yet.
    pub(super) fn new(open: Opener<L>) -> Self {
        Self { open, usual: Pool::new(TOGETHER), wide: Pool::new(WIDE_TOGETHER) }
    }

    /// Makes a request and returns its answer.
    ///
    /// # Errors
    /// [`TransportError`].
    pub(super) async fn ask(&self, request: &str, limits: Limits) -> Result<Bytes, TransportError> {
        let pool = if limits.is_wide() { &self.wide } else { &self.usual };
        // It is never closed.
        let _place = pool.places.acquire().await.map_err(|error| TransportError::Broken(error.to_string()))?;
        let mut link = match pool.take() {
            Some(link) => link,
            None => (self.open)(limits.bytes).await?,
        };
        let answer = link.exchange(request, limits.bytes).await?;
        pool.give_back(link);
        Ok(answer)
    }
}

//! Passes stored records on to a gateway and follows them until they are verified there: the durable outbox of a robot.
//! A function of the ledger: `stored` waits to be sent, `submitted` has the gateway's signed receipt, `verified` is
//! verified there, and only then is the local ciphertext deleted. After a lost connection or receipt, or a restart,
//! records without a receipt are sent again.

use std::collections::HashSet;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::{Notify, watch};
use tokio::task::block_in_place;
use tokio::time::{sleep, timeout};

use crate::crypto::CryptoError;
use crate::gateway::{Client, Code, Credentials, Endpoint, GatewayError, Trust, Upload};
use crate::model::{Digest, ErrorKind, RecordState};
use crate::store::{KeptReceipt, RecordQuery};

use super::{PipelineError, Plant};

mod standing;
#[cfg(test)]
mod tests;

/// The most records in one upload.
const WINDOW: usize = 256;
/// The most bytes in one upload, unless a single record is larger.
const WINDOW_BYTES: usize = 4 * 1024 * 1024;
/// The longest pause before a record refused for its own sake is sent again.
const LONGEST_RETRY: Duration = Duration::from_secs(3600);

/// How long the robot keeps ciphertext that its gateway also holds.
#[derive(Debug, Clone)]
pub struct CopyKeeping {
    /// After the inclusion proof was checked and the gateway has signed that the record is verified.
    pub time: Duration,
    /// With less room than this on the disk, such copies are deleted early, oldest first.
    pub reserve: u64,
}

impl Default for CopyKeeping {
    fn default() -> Self {
        Self { time: Duration::from_secs(7 * 24 * 3600), reserve: 0 }
    }
}

/// The timing of a forwarder.
#[derive(Debug, Clone, Copy)]
pub struct Pace {
    /// The first pause after a failure; it doubles.
    pub first_pause: Duration,
    /// The longest pause after a failure.
    pub longest_pause: Duration,
    /// The time between two checks of the records' standings at the gateway.
    pub check: Duration,
    /// The time between two searches for copies that may be deleted.
    pub tidy: Duration,
    /// Before a record refused for its own sake is sent again; it doubles, up to [`LONGEST_RETRY`].
    pub retry: Duration,
}

impl Default for Pace {
    fn default() -> Self {
        Self {
            first_pause: Duration::from_millis(250),
            longest_pause: Duration::from_secs(5),
            check: Duration::from_secs(1),
            tidy: Duration::from_secs(10),
            retry: Duration::from_secs(60),
        }
    }
}

/// The state of the connection to the gateway.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Link {
    /// Not reached yet.
    Connecting,
    /// Connected.
    Up,
    /// It does not answer; meanwhile the outbox grows.
    Away(String),
    /// It answers but refuses this robot as such; it is asked again at long intervals.
    Refused(String),
}

/// What a session does besides uploads and checks, periodically.
#[async_trait::async_trait]
pub trait Errand: Send {
    /// A session has begun.
    async fn begin(&mut self, client: &mut Client) -> Result<(), ForwardError>;

    /// Does what is due.
    async fn run(&mut self, client: &mut Client) -> Result<(), ForwardError>;
}

/// Why a session with the gateway ended.
#[derive(Debug, thiserror::Error)]
pub enum ForwardError {
    /// The gateway or the connection to it.
    #[error(transparent)]
    Gateway(#[from] GatewayError),
    /// The ledger or vault of this robot.
    #[error(transparent)]
    Here(#[from] PipelineError),
}

impl From<crate::store::StoreError> for ForwardError {
    fn from(error: crate::store::StoreError) -> Self {
        Self::Here(error.into())
    }
}

impl ForwardError {
    /// The state of the connection afterwards.
    fn link(&self) -> Link {
        let text = self.to_string();
        match self {
            Self::Gateway(error) if error.kind() == ErrorKind::Refused => Link::Refused(text),
            _ => Link::Away(text),
        }
    }
}

/// Sends records of an outbox, oldest first.
pub struct Forwarder {
    plant: Plant,
    endpoint: Endpoint,
    credentials: Credentials,
    trust: Trust,
    /// The file that records what was seen of the gateway.
    trust_file: PathBuf,
    pace: Pace,
    link: watch::Sender<Link>,
    errand: Option<Box<dyn Errand>>,
    /// Records that the gateway refuses for their own sake: sent again after a pause, and at the next start.
    refused: Arc<Mutex<HashSet<Digest>>>,
    /// Since when the first of them has been waiting.
    refused_at: Option<Instant>,
    /// How many of the next uploads are sent one by one, because one of them is refused.
    singly: usize,
    /// Where the next check of standings begins.
    cursor: Option<String>,
    checked: Option<Instant>,
    /// Whether the present session achieved anything.
    moved: bool,
    /// What happens to ciphertext that the gateway also has.
    keeping: CopyKeeping,
    /// When copies were last searched.
    tidied: Option<Instant>,
    /// Whether the gateway signs standings; earlier versions do not.
    signs: bool,
}

impl Forwarder {
    /// A forwarder to one gateway.
    pub fn new(plant: Plant, endpoint: Endpoint, credentials: Credentials, trust: Trust, trust_file: PathBuf) -> Self {
        Self {
            plant,
            endpoint,
            credentials,
            trust,
            trust_file,
            pace: Pace::default(),
            link: watch::channel(Link::Connecting).0,
            errand: None,
            refused: Arc::default(),
            refused_at: None,
            singly: 0,
            cursor: None,
            checked: None,
            moved: false,
            keeping: CopyKeeping::default(),
            tidied: None,
            signs: true,
        }
    }

    /// The same with other timing.
    #[must_use]
    pub fn paced(self, pace: Pace) -> Self {
        Self { pace, ..self }
    }

    /// The same with other rules for its copies.
    #[must_use]
    pub fn keeping(self, keeping: CopyKeeping) -> Self {
        Self { keeping, ..self }
    }

    /// The same with additional work.
    #[must_use]
    pub fn with_errand(self, errand: Box<dyn Errand>) -> Self {
        Self { errand: Some(errand), ..self }
    }

    /// The state of the connection to the gateway, from now on.
    pub fn link(&self) -> watch::Receiver<Link> {
        self.link.subscribe()
    }

    /// Records that the gateway refuses for their own sake, as they become known.
    pub fn refused(&self) -> Arc<Mutex<HashSet<Digest>>> {
        Arc::clone(&self.refused)
    }

    /// Works until it is dropped; `stored` signals when records wait. Can be cancelled at any point.
    pub async fn run(&mut self, stored: &Notify) {
        let mut pause = self.pace.first_pause;
        loop {
            self.moved = false;
            if let Err(error) = self.session(stored).await {
                self.tell(&error);
            }
            if self.moved {
                pause = self.pace.first_pause;
            }
            sleep(pause).await;
            pause = (pause * 2).min(self.pace.longest_pause);
        }
    }

    fn tell(&self, error: &ForwardError) {
        let link = error.link();
        let urgent = matches!(link, Link::Refused(_));
        let text = match &link {
            Link::Refused(text) => format!(
                "records wait in the outbox: {text}; if the owner recalled this robot or its loan has ended, the owner \
                 must enrol it again"
            ),
            _ => format!("records wait in the outbox until the gateway is back: {error}"),
        };
        self.link.send_replace(link);
        self.plant.observer.alert(urgent, text);
    }

    /// One session: connects, then sends and checks until the connection breaks or the session is used up.
    async fn session(&mut self, stored: &Notify) -> Result<(), ForwardError> {
        let mut client = Client::connect(&self.endpoint, &mut self.trust, &self.credentials).await?;
        // It may have been upgraded meanwhile.
        self.signs = true;
        block_in_place(|| self.trust.save(&self.trust_file)).map_err(PipelineError::from)?;
        if let Some(errand) = &mut self.errand {
            errand.begin(&mut client).await?;
        }
        while !client.is_spent() {
            let ringing = stored.notified();
            tokio::pin!(ringing);
            ringing.as_mut().enable();
            if let Some(errand) = &mut self.errand {
                errand.run(&mut client).await?;
            }
            self.retry_refused();
            let sent = self.upload(&mut client).await?;
            self.link.send_if_modified(|link| std::mem::replace(link, Link::Up) != Link::Up);
            let due = self.checked.is_none_or(|at| at.elapsed() >= self.pace.check);
            if due {
                self.check(&mut client).await?;
                self.checked = Some(Instant::now());
            }
            if self.tidied.is_none_or(|at| at.elapsed() >= self.pace.tidy) {
                block_in_place(|| self.tidy())?;
                self.tidied = Some(Instant::now());
            }
            if sent == 0 {
                // Both outcomes mean: check again.
                drop(timeout(self.pace.check, ringing).await);
            }
        }
        Ok(())
    }

    /// Sends the oldest waiting records; returns how many the gateway took over, or refused for their own sake.
    async fn upload(&mut self, client: &mut Client) -> Result<usize, ForwardError> {
        let window = block_in_place(|| self.window())?;
        let (digests, uploads): (Vec<Digest>, Vec<Upload>) = window.into_iter().unzip();
        if uploads.is_empty() {
            return Ok(0);
        }
        self.singly = self.singly.saturating_sub(1);
        match client.upload(uploads).await {
            Ok(receipt) => {
                let kept = KeptReceipt { time: receipt.time, digests: receipt.digests, signature: receipt.signature };
                let ledger = &self.plant.ledger;
                block_in_place(|| ledger.accept(kept))?;
                self.moved = true;
                self.plant.observer.records_changed();
                Ok(digests.len())
            }
            Err(error) if is_about_a_record(&error) => {
                self.set_aside(&digests, &error);
                Ok(digests.len())
            }
            Err(error) => Err(error.into()),
        }
    }

    /// One of these records is refused: if it is the only one it is set aside, otherwise it is searched for.
    fn set_aside(&mut self, digests: &[Digest], error: &GatewayError) {
        let [digest] = digests else {
            self.singly = digests.len();
            return;
        };
        self.refused.lock().unwrap_or_else(PoisonError::into_inner).insert(*digest);
        self.refused_at.get_or_insert_with(Instant::now);
        self.plant.observer.alert(true, format!("record {digest} stays in the outbox: {error}"));
    }

    /// Records refused for their own sake are sent again when their pause is over: gateways get repaired, and settings
    /// change.
    fn retry_refused(&mut self) {
        if self.refused_at.is_some_and(|at| at.elapsed() >= self.pace.retry) {
            self.refused.lock().unwrap_or_else(PoisonError::into_inner).clear();
            self.refused_at = None;
            self.pace.retry = (self.pace.retry * 2).min(LONGEST_RETRY);
        }
    }

    /// The next records to send, their bytes compared with their digests.
    fn window(&self) -> Result<Vec<(Digest, Upload)>, PipelineError> {
        let refused = self.refused.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let most = if self.singly > 0 { 1 } else { WINDOW };
        let limit = most + refused.len();
        let query = RecordQuery { state: Some(RecordState::Stored), limit, ..RecordQuery::default() };
        let rows = self.plant.ledger.list(&query)?.rows;
        let (mut window, mut bytes, mut spoilt) = (Vec::new(), 0, Vec::new());
        for row in rows.into_iter().filter(|row| !refused.contains(&row.digest)).take(most) {
            let blob = self.plant.vault.get(row.digest)?;
            let Some(blob) = blob.filter(|blob| self.plant.provider.sm3(&[blob]) == row.digest.0) else {
                spoilt.push(row.digest);
                continue;
            };
            if !window.is_empty() && bytes + blob.len() > WINDOW_BYTES {
                break;
            }
            bytes += blob.len();
            window.push((row.digest, Upload { signature: row.signature, blob }));
        }
        if !spoilt.is_empty() {
            self.plant.ledger.advance(&spoilt, RecordState::Stored, RecordState::Tampered)?;
            self.plant.observer.tampered(&spoilt);
            let count = spoilt.len();
            self.plant
                .observer
                .alert(true, format!("{count} records in the outbox are damaged or missing; they were not sent"));
        }
        Ok(window)
    }
}

/// Whether a refusal concerns the record itself, so that others may pass.
fn is_about_a_record(error: &GatewayError) -> bool {
    matches!(
        error,
        GatewayError::TooLarge(_) | GatewayError::Refused(Code::Malformed | Code::NotYours | Code::Tampered)
    )
}

/// What is known of the gateway from earlier runs, or only its fingerprint.
///
/// # Errors
/// Errors of the file; [`CryptoError::NotAKey`] if it belongs to another gateway.
pub fn trust_in(file: &std::path::Path, fingerprint: crate::model::SignerId) -> Result<Trust, CryptoError> {
    if !file.exists() {
        return Ok(Trust::pinned(fingerprint));
    }
    let trust = Trust::load(file)?;
    if trust.pinned == Some(fingerprint) {
        return Ok(trust);
    }
    let found = "it names a different gateway than the enrolment; use another --home for this enrolment".to_owned();
    Err(CryptoError::NotAKey { path: crate::crypto::error::shown(file), wanted: "the note of this gateway", found })
}

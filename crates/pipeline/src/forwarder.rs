//! Passes stored records on to a gateway and follows them until they are verified there: the durable outbox of a robot.
//! A function of the ledger: `stored` waits to be sent, `submitted` has a gateway's signed receipt, `verified` is
//! verified there, and only then is the local ciphertext deleted. Of several gateways the first that answers takes the
//! records; what stays without a proof goes to the next. Each has a line of its own.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::sync::{Notify, watch};
use tokio::task::{JoinSet, block_in_place};

use crate::crypto::{CryptoError, GatewayAccess};
use crate::gateway::{Client, Code, Context, Credentials, Endpoint, GatewayError, Trust};
use crate::model::bytes::hex;
use crate::model::{Digest, ErrorKind, ProfileName, SignerId, Timestamp, Token};

use super::{PipelineError, Plant};

mod line;
mod outbox;
mod resend;
mod roster;
mod standing;
#[cfg(test)]
mod tests;

use line::Line;
use outbox::{Aside, Outbox};
use roster::Roster;

/// The longest pause before a record refused for its own sake is sent again.
const LONGEST_RETRY: Duration = Duration::from_secs(3600);
/// How long a record with a receipt may be without a proof before another gateway gets it too, unless set.
const RESEND_AFTER: Duration = Duration::from_secs(600);
/// How long one of several gateways may take to answer: robots turn to the next within ten seconds.
pub const PATIENCE_OF_SEVERAL: Duration = Duration::from_secs(5);

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
    /// Connected to a gateway that is not the first of the list: which, and in place of which.
    InPlace(String),
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

/// A gateway, and what this robot knows of it.
#[derive(Clone)]
struct Gate {
    /// SM3 of its identity key.
    fingerprint: SignerId,
    endpoint: Endpoint,
    /// The robot's name and K_T there.
    credentials: Credentials,
    trust: Trust,
    /// The file that records what was seen of it.
    trust_file: PathBuf,
}

/// A robot, as it presents itself to its gateways.
#[derive(Clone)]
pub struct Robot {
    /// The network, and the crypto provider.
    pub context: Context,
    /// N.
    pub name: ProfileName,
    /// A token of its owner.
    pub token: Token,
    /// How long a gateway may take to answer; one of several gets at most [`PATIENCE_OF_SEVERAL`].
    pub patience: Duration,
    /// Its directory, with its notes of gateways.
    pub home: PathBuf,
}

impl Robot {
    fn gates(&self, list: &[GatewayAccess]) -> Result<Vec<Gate>, CryptoError> {
        // A robot of one gateway has always had one note; the others have their own.
        let first = self.home.join("gateway.json");
        let noted = if first.exists() { Trust::load(&first)?.pinned } else { None };
        let place = list.iter().position(|access| Some(access.fingerprint) == noted).unwrap_or(0);
        let patience = if list.len() > 1 { self.patience.min(PATIENCE_OF_SEVERAL) } else { self.patience };
        let gate = |(number, access): (usize, &GatewayAccess)| {
            let fingerprint = access.fingerprint;
            let trust_file = if number == place { first.clone() } else { self.note_of(&fingerprint) };
            let (trust, address) = (trust_in(&trust_file, fingerprint)?, access.address.clone());
            let credentials = Credentials { name: self.name.clone(), key: access.transport.clone(), token: self.token };
            let endpoint = Endpoint { address, context: self.context, patience };
            Ok(Gate { fingerprint, endpoint, credentials, trust, trust_file })
        };
        list.iter().enumerate().map(gate).collect()
    }

    fn note_of(&self, gateway: &SignerId) -> PathBuf {
        self.home.join(format!("gateway-{}.json", hex(gateway.0.get(..8).unwrap_or_default())))
    }
}

/// Sends records of an outbox, oldest first.
pub struct Forwarder {
    plant: Plant,
    robot: Robot,
    /// In the order in which they are used.
    gates: Vec<Gate>,
    pace: Pace,
    link: watch::Sender<Link>,
    errand: Arc<tokio::sync::Mutex<Option<Box<dyn Errand>>>>,
    /// Records that a gateway refuses for their own sake: sent again after a pause, and at the next start.
    refused: Arc<Mutex<HashSet<Digest>>>,
    /// What happens to ciphertext that a gateway also has.
    keeping: CopyKeeping,
    /// How long a record may be without a proof before the next gateway gets it too.
    resend_after: Duration,
    /// The owner's newest list of gateways.
    told: Option<watch::Receiver<Vec<GatewayAccess>>>,
}

impl Forwarder {
    /// A forwarder of a robot to these gateways, the first that answers before the others.
    ///
    /// # Errors
    /// Errors of the notes of gateways; [`CryptoError::NotAKey`] if the home is another robot's.
    pub fn new(plant: Plant, robot: Robot, list: &[GatewayAccess]) -> Result<Self, CryptoError> {
        Ok(Self {
            plant,
            gates: robot.gates(list)?,
            robot,
            pace: Pace::default(),
            link: watch::channel(Link::Connecting).0,
            errand: Arc::default(),
            refused: Arc::default(),
            keeping: CopyKeeping::default(),
            resend_after: RESEND_AFTER,
            told: None,
        })
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

    /// The same with another time after which a record without a proof goes to the next gateway.
    #[must_use]
    pub fn resending_after(self, resend_after: Duration) -> Self {
        Self { resend_after, ..self }
    }

    /// The same with additional work.
    #[must_use]
    pub fn with_errand(self, errand: Box<dyn Errand>) -> Self {
        Self { errand: Arc::new(tokio::sync::Mutex::new(Some(errand))), ..self }
    }

    /// The same, taking up each list of gateways that the owner sends.
    #[must_use]
    pub fn following(self, told: watch::Receiver<Vec<GatewayAccess>>) -> Self {
        Self { told: Some(told), ..self }
    }

    /// The state of the connection to the gateways, from now on.
    pub fn link(&self) -> watch::Receiver<Link> {
        self.link.subscribe()
    }

    /// Records that a gateway refuses for their own sake, as they become known.
    pub fn refused(&self) -> Arc<Mutex<HashSet<Digest>>> {
        Arc::clone(&self.refused)
    }

    fn outbox(&self) -> Outbox {
        Outbox {
            plant: self.plant.clone(),
            home: self.robot.home.clone(),
            pace: self.pace,
            link: self.link.clone(),
            errand: Arc::clone(&self.errand),
            refused: Arc::clone(&self.refused),
            aside: Mutex::new(Aside::new(self.pace.retry)),
            tidied: Mutex::default(),
            keeping: self.keeping.clone(),
            resend_after: self.resend_after,
        }
    }

    /// Deletes ciphertext whose proof was checked and signed long enough ago; on a full disk the oldest of it early.
    /// Whatever no gateway has signed for stays.
    ///
    /// # Errors
    /// Errors of ledger and vault.
    pub fn tidy(&self) -> Result<(), PipelineError> {
        self.outbox().tidy()
    }

    /// Works until it is dropped; `stored` signals when records wait. Can be cancelled at any point.
    pub async fn run(&mut self, stored: &Notify) {
        let ring = Arc::new(Notify::new());
        let ringing = stored.notified();
        tokio::pin!(ringing);
        ringing.as_mut().enable();
        loop {
            let mut lines = self.begin(&ring);
            loop {
                tokio::select! {
                    () = ringing.as_mut() => {
                        ringing.set(stored.notified());
                        ringing.as_mut().enable();
                        ring.notify_waiters();
                    }
                    () = changed(&mut self.told) => break,
                    Some(ended) = lines.join_next() => if let Err(error) = ended
                        && let Ok(panic) = error.try_into_panic()
                    {
                        // For the supervisor to report and to recover from.
                        std::panic::resume_unwind(panic);
                    },
                }
            }
            lines.shutdown().await;
            self.take_up();
        }
    }

    /// Starts a line to each gateway.
    fn begin(&self, ring: &Arc<Notify>) -> JoinSet<()> {
        let outbox = Arc::new(self.outbox());
        let names = self.gates.iter().map(|gate| (gate.fingerprint, gate.endpoint.address.clone())).collect();
        let roster = Arc::new(Roster::new(names));
        if let Some(first) = self.gates.first() {
            let (ledger, now) = (&self.plant.ledger, Timestamp::now());
            if let Err(error) = block_in_place(|| ledger.place_unplaced(first.fingerprint, now)) {
                self.plant.observer.alert(true, format!("receipts of earlier runs cannot be assigned: {error}"));
            }
        }
        let mut lines = JoinSet::new();
        for (place, gate) in self.gates.iter().enumerate() {
            let line = Line::new(Arc::clone(&outbox), Arc::clone(&roster), Arc::clone(ring), place, gate.clone());
            lines.spawn(line.run());
        }
        lines
    }

    /// Takes the owner's newest list of gateways up.
    fn take_up(&mut self) {
        let Some(told) = &mut self.told else { return };
        let list = told.borrow_and_update().clone();
        match self.robot.gates(&list) {
            Ok(gates) if gates.is_empty() => {}
            Ok(gates) => self.gates = gates,
            Err(error) => {
                let text = format!("the owner's list of gateways cannot be used, the one before stays: {error}");
                self.plant.observer.alert(true, text);
            }
        }
    }
}

/// Waits until the owner has sent another list of gateways.
async fn changed(told: &mut Option<watch::Receiver<Vec<GatewayAccess>>>) {
    if let Some(told) = told
        && told.changed().await.is_ok()
    {
        return;
    }
    std::future::pending().await
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
fn trust_in(file: &Path, fingerprint: crate::model::SignerId) -> Result<Trust, CryptoError> {
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

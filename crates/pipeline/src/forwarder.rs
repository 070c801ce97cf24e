//! Passes stored records on to a gateway and follows them until they are verified there: the durable outbox of a robot.
//! A function of the ledger: `stored` waits to be sent, `submitted` has a gateway's signed receipt, `verified` is
//! verified there, and only then is the local ciphertext deleted.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::sync::{Notify, watch};

use crate::crypto::{CryptoError, GatewayAccess};
use crate::gateway::{Client, Code, Context, Credentials, Endpoint, GatewayError, Trust};
use crate::model::{Digest, ErrorKind, ProfileName, Token};

use super::{PipelineError, Plant};

mod line;
mod outbox;
mod standing;
#[cfg(test)]
mod tests;

use line::Line;
use outbox::Outbox;

/// The longest pause before a record refused for its own sake is sent again.
const LONGEST_RETRY: Duration = Duration::from_secs(3600);
/// How long a gateway with several addresses may take to answer at one: robots turn to the next within ten seconds.
const PATIENCE_OF_SEVERAL: Duration = Duration::from_secs(5);

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
    /// Connected at an address that is not the first: which, and in place of which.
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

/// The gateway, and what this robot knows of it.
#[derive(Clone)]
struct Gate {
    endpoint: Endpoint,
    /// The robot's name and K_T there.
    credentials: Credentials,
    trust: Trust,
    /// The file that records what was seen of it.
    trust_file: PathBuf,
}

/// A robot, as it presents itself to its gateway.
#[derive(Clone)]
pub struct Robot {
    /// The network, and the crypto provider.
    pub context: Context,
    /// N.
    pub name: ProfileName,
    /// A token of its owner.
    pub token: Token,
    /// How long the gateway may take to answer; with several addresses it gets at most five seconds at each.
    pub patience: Duration,
    /// Its directory, with its note of the gateway.
    pub home: PathBuf,
}

impl Robot {
    fn gate(&self, access: &GatewayAccess) -> Result<Gate, CryptoError> {
        let (trust_file, addresses) = (self.home.join("gateway.json"), access.addresses.clone());
        let trust = trust_in(&trust_file, access.fingerprint)?;
        let credentials = Credentials { name: self.name.clone(), key: access.transport.clone(), token: self.token };
        let patience = if addresses.len() > 1 { self.patience.min(PATIENCE_OF_SEVERAL) } else { self.patience };
        let endpoint = Endpoint { addresses, context: self.context, patience };
        Ok(Gate { endpoint, credentials, trust, trust_file })
    }
}

/// Sends records of an outbox, oldest first.
pub struct Forwarder {
    plant: Plant,
    robot: Robot,
    gate: Gate,
    pace: Pace,
    link: watch::Sender<Link>,
    errand: Option<Box<dyn Errand>>,
    /// Records that the gateway refuses for their own sake: sent again after a pause, and at the next start.
    refused: Arc<Mutex<HashSet<Digest>>>,
    /// What happens to ciphertext that the gateway also has.
    keeping: CopyKeeping,
    /// The gateway with the addresses that the owner named last.
    named: Option<watch::Receiver<GatewayAccess>>,
}

impl Forwarder {
    /// A forwarder of a robot to its gateway.
    ///
    /// # Errors
    /// Errors of the note of the gateway; [`CryptoError::NotAKey`] if the home is another robot's.
    pub fn new(plant: Plant, robot: Robot, access: &GatewayAccess) -> Result<Self, CryptoError> {
        Ok(Self {
            plant,
            gate: robot.gate(access)?,
            robot,
            pace: Pace::default(),
            link: watch::channel(Link::Connecting).0,
            errand: None,
            refused: Arc::default(),
            keeping: CopyKeeping::default(),
            named: None,
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

    /// The same with additional work.
    #[must_use]
    pub fn with_errand(self, errand: Box<dyn Errand>) -> Self {
        Self { errand: Some(errand), ..self }
    }

    /// The same, using the gateway's addresses that the owner sends.
    #[must_use]
    pub fn following(self, named: watch::Receiver<GatewayAccess>) -> Self {
        Self { named: Some(named), ..self }
    }

    /// The state of the connection to the gateway, from now on.
    pub fn link(&self) -> watch::Receiver<Link> {
        self.link.subscribe()
    }

    /// Records that the gateway refuses for their own sake, as they become known.
    pub fn refused(&self) -> Arc<Mutex<HashSet<Digest>>> {
        Arc::clone(&self.refused)
    }

    fn outbox(&self) -> Outbox {
        Outbox::new(
            self.plant.clone(),
            self.robot.home.clone(),
            self.keeping.clone(),
            Arc::clone(&self.refused),
            self.pace,
        )
    }

    /// Deletes ciphertext whose proof was checked and signed long enough ago; on a full disk the oldest of it early.
    /// Whatever the gateway has not signed for stays.
    ///
    /// # Errors
    /// Errors of ledger and vault.
    pub fn tidy(&self) -> Result<(), PipelineError> {
        self.outbox().tidy()
    }

    /// Works until it is dropped; `stored` signals when records wait. Can be cancelled at any point.
    pub async fn run(&mut self, stored: &Notify) {
        loop {
            let mut line = Line::new(self.outbox(), self.gate.clone(), self.link.clone(), &mut self.errand);
            tokio::select! {
                never = line.run(stored) => match never {},
                () = changed(&mut self.named) => {}
            }
            self.apply_addresses();
        }
    }

    /// Applies the addresses that the owner named last.
    fn apply_addresses(&mut self) {
        let Some(named) = &mut self.named else { return };
        let access = named.borrow_and_update().clone();
        match self.robot.gate(&access) {
            Ok(gate) => self.gate = gate,
            Err(error) => {
                let text = format!("the gateway's new addresses cannot be used, the old ones stay: {error}");
                self.plant.observer.alert(true, text);
            }
        }
    }
}

/// Waits until the owner has named other addresses.
async fn changed(named: &mut Option<watch::Receiver<GatewayAccess>>) {
    if let Some(named) = named
        && named.changed().await.is_ok()
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

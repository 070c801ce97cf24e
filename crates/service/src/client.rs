//! The handle through which console and command line speak with a site, near or far.

use tokio::sync::{broadcast, mpsc, oneshot};

use super::command::{Ask, Command, Request};
use super::event::Event;
use super::reply::{Failure, Reply};
use crate::model::{ErrorKind, ProfileName};

/// One request with the place its answer goes.
#[derive(Debug)]
pub struct Call {
    /// What is asked.
    pub request: Request,
    /// Where the answer goes.
    pub answer: oneshot::Sender<Result<Reply, Failure>>,
}

/// Speaks with a site for one profile. Cheap to clone.
#[derive(Debug, Clone)]
pub struct Client {
    profile: ProfileName,
    calls: mpsc::UnboundedSender<Call>,
    events: broadcast::Sender<Event>,
}

impl Client {
    /// A client whose calls are taken from the other end of `calls`.
    pub fn new(profile: ProfileName, calls: mpsc::UnboundedSender<Call>, events: broadcast::Sender<Event>) -> Self {
        Self { profile, calls, events }
    }

    /// The profile it speaks for.
    pub fn profile(&self) -> &ProfileName {
        &self.profile
    }

    /// The same site, for another profile.
    pub fn for_profile(&self, profile: ProfileName) -> Self {
        Self { profile, ..self.clone() }
    }

    /// Sends a command without waiting; the answer arrives in the receiver.
    pub fn send(&self, command: Command) -> oneshot::Receiver<Result<Reply, Failure>> {
        let (answer, receiver) = oneshot::channel();
        let call = Call { request: Request { profile: self.profile.clone(), command }, answer };
        // A site that is gone drops the sender, and the receiver reports it.
        drop(self.calls.send(call));
        receiver
    }

    /// Sends a command that was chosen as the program runs, and waits for its answer.
    ///
    /// # Errors
    /// The site's [`Failure`], or one of kind `Unreachable` where the site is gone.
    pub async fn request(&self, command: Command) -> Result<Reply, Failure> {
        self.send(command).await.unwrap_or_else(|_| Err(site_gone()))
    }

    /// Sends a request and waits for the answer that it names.
    ///
    /// # Errors
    /// The site's [`Failure`], or one of kind `Unreachable` where the site is gone.
    pub async fn ask<A: Ask>(&self, ask: A) -> Result<A::Answer, Failure> {
        A::heard(self.request(ask.into()).await)
    }

    /// From now on, everything the site tells.
    pub fn events(&self) -> broadcast::Receiver<Event> {
        self.events.subscribe()
    }
}

/// The failure of a call whose site ended.
pub fn site_gone() -> Failure {
    Failure::new(ErrorKind::Unreachable, "the site ended before it answered; start it again and repeat the command")
}

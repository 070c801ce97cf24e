//! Handle through which console and command line talk to a site.

use tokio::sync::{broadcast, mpsc, oneshot};

use crate::command::{Ask, Command, Request};
use crate::model::{ErrorKind, ProfileName};
use crate::reply::{Event, Failure, Reply, Result};

#[derive(Debug)]
pub struct Call {
    pub request: Request,
    pub answer: oneshot::Sender<Result<Reply>>,
}

/// Talks to a site, local or remote, on behalf of one profile. Cheap to clone.
#[derive(Debug, Clone)]
pub struct Client {
    profile: ProfileName,
    calls: mpsc::UnboundedSender<Call>,
    events: broadcast::Sender<Event>,
}

impl Client {
    pub fn new(profile: ProfileName, calls: mpsc::UnboundedSender<Call>, events: broadcast::Sender<Event>) -> Self {
        Self { profile, calls, events }
    }

    pub fn profile(&self) -> &ProfileName {
        &self.profile
    }

    pub fn for_profile(&self, profile: ProfileName) -> Self {
        Self { profile, ..self.clone() }
    }

    /// Sends a command without waiting; the receiver gets the answer.
    pub fn send(&self, command: Command) -> oneshot::Receiver<Result<Reply>> {
        let (answer, receiver) = oneshot::channel();
        let call = Call { request: Request { profile: self.profile.clone(), command }, answer };
        // If the site has ended, the sender is dropped and the receiver reports it.
        drop(self.calls.send(call));
        receiver
    }

    /// Sends a command chosen at run time and waits; `Unreachable` if the site has ended.
    pub async fn request(&self, command: Command) -> Result<Reply> {
        self.send(command).await.unwrap_or_else(|_| Err(site_gone()))
    }

    /// Sends a request and waits; `Unreachable` if the site has ended.
    pub async fn ask<A: Ask>(&self, ask: A) -> Result<A::Answer> {
        A::heard(self.request(ask.into()).await)
    }

    /// All events from now on.
    pub fn events(&self) -> broadcast::Receiver<Event> {
        self.events.subscribe()
    }
}

pub fn site_gone() -> Failure {
    Failure::new(ErrorKind::Unreachable, "the site ended before it answered; start it again and repeat the command")
}

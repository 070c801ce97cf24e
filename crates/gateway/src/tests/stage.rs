//! A gateway's server over the loopback, with a desk in memory.

use std::sync::Arc;
use std::time::Duration;

use authros_gateway::{
    Cabinet, Client, Code, Credentials, Desk, Endpoint, GatewayError, Limits, Schedule, Server, Trust,
};
use authros_model::Timestamp;

use super::fixtures::{Member, context, pair};
use super::memory_desk::MemoryDesk;

pub(crate) struct Stage {
    pub desk: Arc<MemoryDesk>,
    pub server: Server,
    pub endpoint: Endpoint,
    limits: Limits,
    /// What its identity key is made of.
    identity: u8,
    home: tempfile::TempDir,
}

impl Stage {
    pub async fn with(limits: Limits) -> Self {
        Self::known_by(0x21, limits).await
    }

    /// A gateway with an identity key of its own.
    pub async fn known_by(identity: u8, limits: Limits) -> Self {
        let home = tempfile::tempdir().expect("directory");
        let desk = Arc::new(MemoryDesk::default());
        let server = serve(home.path(), &desk, limits, identity).await;
        let address = server.address().to_string();
        let endpoint =
            Endpoint { addresses: vec![address], context: context(), patience: Duration::from_secs(30), source: None };
        Self { desk, server, endpoint, limits, identity, home }
    }

    /// Stops the server, then starts it again on another port with the same keys and desk.
    pub async fn restart(&mut self) {
        let server = serve(self.home.path(), &self.desk, self.limits, self.identity).await;
        std::mem::replace(&mut self.server, server).stop(Duration::from_secs(5)).await;
        self.endpoint.addresses = vec![self.server.address().to_string()];
    }

    pub async fn new() -> Self {
        Self::with(Limits::default()).await
    }

    pub fn trust(&self) -> Trust {
        Trust::pinned(self.server.id())
    }

    /// Registers on the chain and allocates a transport key.
    pub async fn enrol(&self, member: &Member) -> Credentials {
        self.desk.admit(member);
        let allocated = Client::allocate(&self.endpoint, &mut self.trust(), &member.applicant()).await;
        let (key, receipt) = allocated.expect("allocates");
        assert_eq!(receipt.digests.len(), 1);
        Credentials { name: member.name.clone(), key, token: member.token }
    }

    pub async fn connect(&self, credentials: &Credentials) -> Result<Client, GatewayError> {
        Client::connect(&self.endpoint, &mut self.trust(), credentials).await
    }

    pub async fn code(&self, credentials: &Credentials) -> Option<Code> {
        refusal(self.connect(credentials).await)
    }
}

async fn serve(home: &std::path::Path, desk: &Arc<MemoryDesk>, limits: Limits, identity: u8) -> Server {
    let (path, context, schedule) = (home.join("gateway"), context(), Schedule::default());
    let cabinet = Cabinet::open(&path, context, pair(identity), schedule, Timestamp::now());
    let desk = Arc::clone(desk) as Arc<dyn Desk>;
    Server::start("127.0.0.1:0", desk, context, cabinet.expect("opens"), limits).await.expect("listens")
}

pub(crate) fn refusal<T>(outcome: Result<T, GatewayError>) -> Option<Code> {
    match outcome {
        Err(GatewayError::Refused(code) | GatewayError::RefusedInClear(code)) => Some(code),
        Err(other) => panic!("another error: {other}"),
        Ok(_) => None,
    }
}

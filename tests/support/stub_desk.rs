//! A gateway that is not ours: the protocol's server over a desk that knows one caller and takes nothing; what it answers a
//! reader is the test's.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::{Arc, Mutex};

use async_trait::async_trait;
use authros::chain::RelayError;
use authros::crypto::{SmKeyPair, signer_id};
use authros::gateway::{
    Account, Binding, Cabinet, Caller, Code, Context, Desk, Feed, FeedPage, Found, Limits, NetworkName, Notice,
    Received, Refusal, Schedule, Server,
};
use authros::model::{Address, Digest, ProfileName, PublicKey, SignerId, Timestamp, Token};
use serde_json::Value;
use tokio::sync::watch;

use super::member::Member;

/// What such a gateway answers.
#[async_trait]
pub trait Tells: Send + Sync {
    /// What the chain answers through it; `None` = it passes nothing on.
    async fn relayed(&self, _: &str, _: &Value) -> Option<Value> {
        None
    }

    /// What it tells a reader; `None` = it refuses.
    fn told(&self, _: &Feed) -> Option<FeedPage> {
        None
    }
}

struct StubDesk {
    caller: Account,
    bindings: Mutex<HashMap<ProfileName, Binding>>,
    tells: Arc<dyn Tells>,
}

/// Serves for the one account whose keys these are, under an identity key of its own; returns the fingerprint too.
pub async fn serve(
    context: Context,
    caller: &Member,
    identity: SmKeyPair,
    folder: &Path,
    tells: Arc<dyn Tells>,
) -> (Server, String) {
    let keys = &caller.keyring;
    let caller = Account { signing: keys.signing.public, envelope: keys.envelope.public };
    let key = signer_id(&identity.public).to_string();
    let (schedule, now) = (Schedule::default(), Timestamp::now());
    let cabinet = Cabinet::open(folder, context, identity, schedule, now).expect("opens");
    let desk = Arc::new(StubDesk { caller, bindings: Mutex::default(), tells });
    let server = Server::start("127.0.0.1:0", desk as Arc<dyn Desk>, context, cabinet, Limits::default()).await;
    (server.expect("listens"), key)
}

fn not_here<Done>() -> Result<Done, Refusal> {
    Err(Refusal::new(Code::NotHere, "a gateway that takes nothing"))
}

#[async_trait]
impl Desk for StubDesk {
    async fn account(&self, _: &Address, _: Option<&SignerId>) -> Result<Account, Refusal> {
        Ok(self.caller)
    }

    async fn admits(&self, _: &Address, _: Option<&Token>) -> Result<(), Refusal> {
        Ok(())
    }

    async fn signer(&self, _: &Address, _: &SignerId) -> Result<Option<PublicKey>, Refusal> {
        Ok(None)
    }

    async fn binding(&self, name: &ProfileName) -> Result<Option<Binding>, Refusal> {
        Ok(self.bindings.lock().expect("not poisoned").get(name).cloned())
    }

    async fn recalled(&self, _: &Binding) -> Result<Option<Timestamp>, Refusal> {
        Ok(None)
    }

    async fn successor(&self, _: &Address) -> Result<Option<Address>, Refusal> {
        Ok(None)
    }

    async fn bind(&self, name: &ProfileName, _: Option<Address>, binding: Binding) -> Result<(), Refusal> {
        self.bindings.lock().expect("not poisoned").insert(name.clone(), binding);
        Ok(())
    }

    async fn store(&self, _: &Caller, _: Vec<Received>) -> Result<Timestamp, Refusal> {
        not_here()
    }

    async fn feed(&self, _: &Caller, asked: &Feed, _: bool) -> Result<FeedPage, Refusal> {
        self.tells.told(asked).map_or_else(not_here, Ok)
    }

    fn changes(&self) -> watch::Receiver<u64> {
        watch::channel(0).1
    }

    async fn records(&self, _: &Caller, _: &[Digest], _: bool) -> Result<Vec<Found>, Refusal> {
        not_here()
    }

    async fn notice(&self, _: &Caller, _: &Notice) -> Result<(), Refusal> {
        not_here()
    }

    async fn network_name(&self) -> Result<NetworkName, Refusal> {
        not_here()
    }

    async fn relay(&self, _: Option<&Caller>, method: &str, parameters: &Value) -> Result<Value, RelayError> {
        self.tells.relayed(method, parameters).await.ok_or(RelayError::NotAllowed)
    }

    fn refused(&self, _: SocketAddr, _: &Refusal) {}
}

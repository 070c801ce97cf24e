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
    Account, Binding, Cabinet, Caller, Code, Context, Desk, DeviceNotice, Entry, Fetched, GrantNotice, Limits,
    NetworkName, Page, Query, Received, Refusal, Registration, RevokeNotice, Schedule, Selection, Server, Stood,
};
use authros::model::{Address, Digest, Hash, ProfileName, PublicKey, SignerId, Timestamp, Token};
use serde_json::Value;
use tokio::sync::mpsc;

use super::member::Member;

/// What such a gateway answers.
#[async_trait]
pub trait Tells: Send + Sync {
    /// What the chain answers through it; `None` = it passes nothing on.
    async fn relayed(&self, _: &str, _: &Value) -> Option<Value> {
        None
    }

    /// What it lists for a reader; `None` = it refuses.
    fn listed(&self, _: &Query) -> Option<Page> {
        None
    }

    /// Why it gives a reader no subscription; `None` = it gives one, which ends at once.
    fn refuses_subscriptions(&self) -> Option<Code> {
        Some(Code::NotHere)
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
    let cabinet = Cabinet::open(folder, context.provider, context.domain, identity, schedule, now).expect("opens");
    let desk = Arc::new(StubDesk { caller, bindings: Mutex::default(), tells });
    let server = Server::start("127.0.0.1:0", desk as Arc<dyn Desk>, context, cabinet, Limits::default()).await;
    (server.expect("listens"), key)
}

fn not_here<Done>() -> Result<Done, Refusal> {
    Err(Refusal::new(Code::NotHere, "a gateway that takes nothing"))
}

#[async_trait]
impl Desk for StubDesk {
    async fn account(&self, _: &Address) -> Result<Account, Refusal> {
        Ok(self.caller)
    }

    async fn admits(&self, _: &Address) -> Result<(), Refusal> {
        Ok(())
    }

    async fn is_token(&self, _: &Address, _: &Token) -> Result<bool, Refusal> {
        Ok(true)
    }

    async fn is_lent(&self, _: &Address, _: &SignerId) -> Result<bool, Refusal> {
        Ok(false)
    }

    async fn signer(&self, _: &Address, _: &SignerId) -> Result<Option<PublicKey>, Refusal> {
        Ok(None)
    }

    async fn binding(&self, name: &ProfileName) -> Result<Option<Binding>, Refusal> {
        Ok(self.bindings.lock().expect("not poisoned").get(name).cloned())
    }

    async fn successor(&self, _: &Address) -> Result<Option<Address>, Refusal> {
        Ok(None)
    }

    async fn bind(&self, name: &ProfileName, binding: Binding) -> Result<(), Refusal> {
        self.bindings.lock().expect("not poisoned").insert(name.clone(), binding);
        Ok(())
    }

    async fn register(&self, _: &Registration) -> Result<Hash, Refusal> {
        not_here()
    }

    async fn store(&self, _: &Caller, _: Vec<Received>) -> Result<Timestamp, Refusal> {
        not_here()
    }

    async fn query(&self, _: &Caller, query: &Query) -> Result<Page, Refusal> {
        self.tells.listed(query).map_or_else(not_here, Ok)
    }

    async fn check(&self, _: &Caller, _: &[Digest]) -> Result<Vec<Stood>, Refusal> {
        not_here()
    }

    async fn fetch(&self, _: &Caller, _: &Digest) -> Result<Fetched, Refusal> {
        not_here()
    }

    async fn subscribe(&self, _: &Caller, _: &Selection) -> Result<mpsc::Receiver<Entry>, Refusal> {
        match self.tells.refuses_subscriptions() {
            Some(code) => Err(Refusal::new(code, "a gateway that gives nothing")),
            None => Ok(mpsc::channel(1).1),
        }
    }

    async fn grant(&self, _: &Caller, _: &GrantNotice) -> Result<(), Refusal> {
        not_here()
    }

    async fn revoke(&self, _: &Caller, _: &RevokeNotice) -> Result<(), Refusal> {
        not_here()
    }

    async fn network_name(&self) -> Result<NetworkName, Refusal> {
        not_here()
    }

    async fn relay(&self, _: Option<&Caller>, method: &str, parameters: &Value) -> Result<Value, RelayError> {
        self.tells.relayed(method, parameters).await.ok_or(RelayError::NotAllowed)
    }

    async fn device(&self, _: &Caller, _: &DeviceNotice) -> Result<(), Refusal> {
        not_here()
    }

    fn refused(&self, _: SocketAddr, _: &Refusal) {}
}

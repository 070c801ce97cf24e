//! A gateway of the fleet that its neighbour trusts by fingerprint and that turned hostile: it speaks the protocol as it
//! should, admits its victim, and tells it what a test wants it to hear.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use async_trait::async_trait;
use authros::chain::RelayError;
use authros::crypto::{SmKeyPair, signer_id};
use authros::gateway::{
    Account, Binding, Cabinet, Caller, Code, Desk, DeviceNotice, Entry, ErasurePlace, Erasures, Fetched, GrantNotice,
    HandedOver, HoldingPlace, Holdings, Limits, NetworkName, Page, Query, Received, Refusal, Registration,
    RevokeNotice, Schedule, Selection, Server, Standing, Stood, Wanted,
};
use authros::model::{Address, Digest, Hash, ProfileName, PublicKey, SignerId, Timestamp, Token};
use serde_json::Value;
use tokio::sync::mpsc;

use super::support::gate::Gate;
use super::support::member::Member;
use super::support::{Home, list};

type Told<Asked, Answer> = Box<dyn Fn(&Asked) -> Answer + Send + Sync>;

/// The hostile gateway's desk.
pub struct HostileFellow {
    pub victim: Account,
    pub bindings: Mutex<HashMap<ProfileName, Binding>>,
    /// What it says it holds, hands over, and has erased.
    pub holdings: Told<HoldingPlace, Holdings>,
    pub hand_over: Told<Wanted, HandedOver>,
    pub erasures: Told<ErasurePlace, Erasures>,
    /// How often it was asked for each.
    pub told: AtomicUsize,
    pub handed: AtomicUsize,
    pub erased: AtomicUsize,
}

impl HostileFellow {
    /// One that admits the keeper of this gateway, and tells nothing yet.
    pub fn of(gate: &Gate) -> Self {
        let victim = Member::of(&gate.home, "gateway", gate.gateway.domain).keyring;
        Self {
            victim: Account { signing: victim.signing.public, envelope: victim.envelope.public },
            bindings: Mutex::default(),
            holdings: Box::new(|after| Holdings { next: *after, ..Holdings::default() }),
            hand_over: Box::new(|_| HandedOver::default()),
            erasures: Box::new(|after| Erasures { next: *after, ..Erasures::default() }),
            told: AtomicUsize::new(0),
            handed: AtomicUsize::new(0),
            erased: AtomicUsize::new(0),
        }
    }

    /// Serves it under somebody's key, and has the victim's keeper name it.
    pub async fn serve(self, gate: &Gate, away: &Home, identity: SmKeyPair) -> (Arc<Self>, Server) {
        let context = gate.gateway.endpoint().context;
        let (folder, now) = (away.root().join("hostile"), Timestamp::now());
        let key = signer_id(&identity.public).to_string();
        let cabinet = Cabinet::open(&folder, context.provider, context.domain, identity, Schedule::default(), now);
        let fellow = Arc::new(self);
        let desk = Arc::clone(&fellow) as Arc<dyn Desk>;
        let server = Server::start("127.0.0.1:0", desk, context, cabinet.expect("opens"), Limits::default()).await;
        let server = server.expect("listens");
        gate.home.profile("gateway").json(&["fleet", "add", &server.address().to_string(), "--gateway-key", &key]);
        (fellow, server)
    }

    /// How often it was asked: about holdings, for records, about what was erased.
    pub fn asked(&self) -> [usize; 3] {
        [&self.told, &self.handed, &self.erased].map(|count| count.load(Ordering::Acquire))
    }
}

/// What the victim's keeper sees of it.
pub fn seen(gate: &Gate) -> Value {
    list(&gate.home.profile("gateway").json(&["fleet", "status"]), "fellows").remove(0)
}

fn not_here<Done>() -> Result<Done, Refusal> {
    Err(Refusal::new(Code::NotHere, "a hostile gateway"))
}

#[async_trait]
impl Desk for HostileFellow {
    async fn account(&self, _: &Address) -> Result<Account, Refusal> {
        Ok(self.victim)
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

    async fn query(&self, _: &Caller, _: &Query) -> Result<Page, Refusal> {
        not_here()
    }

    async fn check(&self, _: &Caller, _: &[Digest]) -> Result<Vec<Standing>, Refusal> {
        not_here()
    }

    async fn prove(&self, _: &Caller, _: &[Digest]) -> Result<Vec<Stood>, Refusal> {
        not_here()
    }

    async fn fetch(&self, _: &Caller, _: &Digest) -> Result<Fetched, Refusal> {
        not_here()
    }

    async fn subscribe(&self, _: &Caller, _: &Selection) -> Result<mpsc::Receiver<Entry>, Refusal> {
        not_here()
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

    async fn relay(&self, _: Option<&Caller>, _: &str, _: &Value) -> Result<Value, RelayError> {
        Err(RelayError::NotAllowed)
    }

    async fn device(&self, _: &Caller, _: &DeviceNotice) -> Result<(), Refusal> {
        not_here()
    }

    async fn holdings(&self, _: &Caller, after: &HoldingPlace) -> Result<Holdings, Refusal> {
        self.told.fetch_add(1, Ordering::AcqRel);
        Ok((self.holdings)(after))
    }

    async fn hand_over(&self, _: &Caller, wanted: &Wanted) -> Result<HandedOver, Refusal> {
        self.handed.fetch_add(1, Ordering::AcqRel);
        Ok((self.hand_over)(wanted))
    }

    async fn erasures(&self, _: &Caller, after: &ErasurePlace) -> Result<Erasures, Refusal> {
        self.erased.fetch_add(1, Ordering::AcqRel);
        Ok((self.erasures)(after))
    }

    fn refused(&self, _: SocketAddr, _: &Refusal) {}
}

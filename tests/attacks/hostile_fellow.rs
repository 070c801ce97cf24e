//! A gateway of the fleet that its neighbour trusts by fingerprint and that turned hostile: it speaks the protocol as it
//! should, admits its victim, and tells it what a test wants it to hear.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use authros::crypto::SmKeyPair;
use authros::gateway::{ErasurePlace, Erasures, HandedOver, HoldingPlace, Holdings, Server, Wanted};
use serde_json::Value;

use super::support::gate::Gate;
use super::support::member::Member;
use super::support::stub_desk::{self, Tells};
use super::support::{Home, list};

type Told<Asked, Answer> = Box<dyn Fn(&Asked) -> Answer + Send + Sync>;

/// What the hostile gateway tells.
pub struct HostileFellow {
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
    /// One that tells nothing yet.
    pub fn silent() -> Self {
        Self {
            holdings: Box::new(|after| Holdings { next: *after, ..Holdings::default() }),
            hand_over: Box::new(|_| HandedOver::default()),
            erasures: Box::new(|after| Erasures { next: *after, ..Erasures::default() }),
            told: AtomicUsize::new(0),
            handed: AtomicUsize::new(0),
            erased: AtomicUsize::new(0),
        }
    }

    /// Serves it under somebody's key for the keeper of this gateway, who names it.
    pub async fn serve(self, gate: &Gate, away: &Home, identity: SmKeyPair) -> (Arc<Self>, Server) {
        let (context, victim) =
            (gate.gateway.endpoint().context, Member::of(&gate.home, "gateway", gate.gateway.domain));
        let fellow = Arc::new(self);
        let (folder, tells) = (away.root().join("hostile"), Arc::clone(&fellow) as Arc<dyn Tells>);
        let (server, key) = stub_desk::serve(context, &victim, identity, &folder, tells).await;
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

impl Tells for HostileFellow {
    fn holdings(&self, after: &HoldingPlace) -> Option<Holdings> {
        self.told.fetch_add(1, Ordering::AcqRel);
        Some((self.holdings)(after))
    }

    fn hand_over(&self, wanted: &Wanted) -> HandedOver {
        self.handed.fetch_add(1, Ordering::AcqRel);
        (self.hand_over)(wanted)
    }

    fn erasures(&self, after: &ErasurePlace) -> Option<Erasures> {
        self.erased.fetch_add(1, Ordering::AcqRel);
        Some((self.erasures)(after))
    }
}

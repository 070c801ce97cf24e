//! A lying gateway takes records over, reports them as verified, proves nothing, and has the robot delete them.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use async_trait::async_trait;
use authros::chain::RelayError;
use authros::crypto::{ProviderName, SmKeyPair, provider, signer_id};
use authros::gateway::{
    Account, Binding, Cabinet, Caller, Code, Context, Desk, DeviceNotice, Entry, Fetched, GrantNotice, Limits,
    NetworkName, Page, Query, Received, Refusal, Registration, RevokeNotice, Schedule, Selection, Server, Standing,
    Stood,
};
use authros::model::{Address, Digest, Hash, ProfileName, PublicKey, SignerId, Timestamp, Token};
use authros::store::{Ciphertext, Ledger};
use serde_json::Value;
use tokio::sync::mpsc;

use crate::enrolled_robot::{Robot, Scene};
use crate::support::member::Member;
use crate::support::{count, wait_until};
use crate::{Outcome, judge};

/// Discards what it is given.
struct Liar {
    binding: Binding,
    device: SmKeyPair,
    asked: AtomicU64,
}

fn no<T>() -> Result<T, Refusal> {
    Err(Refusal::new(Code::NotHere, "a liar's gateway"))
}

#[async_trait]
impl Desk for Liar {
    async fn account(&self, _: &Address) -> Result<Account, Refusal> {
        Ok(Account { signing: self.binding.signing, envelope: self.binding.envelope })
    }

    async fn admits(&self, _: &Address) -> Result<(), Refusal> {
        Ok(())
    }

    async fn is_token(&self, _: &Address, _: &Token) -> Result<bool, Refusal> {
        Ok(true)
    }

    async fn is_lent(&self, _: &Address, _: &SignerId) -> Result<bool, Refusal> {
        Ok(true)
    }

    async fn signer(&self, _: &Address, _: &SignerId) -> Result<Option<PublicKey>, Refusal> {
        Ok(Some(self.device.public))
    }

    async fn binding(&self, _: &ProfileName) -> Result<Option<Binding>, Refusal> {
        Ok(Some(self.binding.clone()))
    }

    async fn successor(&self, _: &Address) -> Result<Option<Address>, Refusal> {
        Ok(None)
    }

    async fn bind(&self, _: &ProfileName, _: Binding) -> Result<(), Refusal> {
        no()
    }

    async fn register(&self, _: &Registration) -> Result<Hash, Refusal> {
        no()
    }

    async fn store(&self, _: &Caller, _: Vec<Received>) -> Result<Timestamp, Refusal> {
        Ok(Timestamp::now())
    }

    async fn query(&self, _: &Caller, _: &Query) -> Result<Page, Refusal> {
        Ok(Page { entries: Vec::new(), next: None })
    }

    async fn check(&self, _: &Caller, digests: &[Digest]) -> Result<Vec<Stood>, Refusal> {
        self.asked.fetch_add(1, Ordering::AcqRel);
        Ok(vec![Stood { standing: Standing::Verified, proof: Vec::new() }; digests.len()])
    }

    async fn fetch(&self, _: &Caller, _: &Digest) -> Result<Fetched, Refusal> {
        no()
    }

    async fn subscribe(&self, _: &Caller, _: &Selection) -> Result<mpsc::Receiver<Entry>, Refusal> {
        let (sender, receiver) = mpsc::channel(1);
        // Open for as long as the test runs.
        std::mem::forget(sender);
        Ok(receiver)
    }

    async fn grant(&self, _: &Caller, _: &GrantNotice) -> Result<(), Refusal> {
        no()
    }

    async fn revoke(&self, _: &Caller, _: &RevokeNotice) -> Result<(), Refusal> {
        no()
    }

    async fn network_name(&self) -> Result<NetworkName, Refusal> {
        no()
    }

    async fn relay(&self, _: Option<&Caller>, _: &str, _: &Value) -> Result<Value, RelayError> {
        Err(RelayError::Silent("a liar's gateway".to_owned()))
    }

    async fn device(&self, _: &Caller, _: &DeviceNotice) -> Result<(), Refusal> {
        no()
    }

    fn refused(&self, _: SocketAddr, _: &Refusal) {}
}

#[tokio::test(flavor = "multi_thread")]
async fn take_the_robots_only_copy() {
    let scene = Scene::new();
    let robot = Robot::enrol(&scene, "scout", &["/robot1/odom"]);
    let stolen = robot.stolen();
    let keeper = Member::of(&scene.home, "keeper", stolen.domain);
    let alice = Member::of(&scene.home, "alice", stolen.domain);
    scene.site.stop("TERM", 20);
    // The keeper of the gateway is the attacker: his key and his names serve another program at the same address.
    let provider = provider(ProviderName::RustCrypto);
    let directory = tempfile::tempdir().expect("a directory");
    let identity = SmKeyPair { secret: keeper.keyring.signing.secret.clone(), public: keeper.keyring.signing.public };
    let cabinet = Cabinet::open(
        &directory.path().join("gateway"),
        provider,
        stolen.domain,
        identity,
        Schedule::default(),
        Timestamp::now(),
    );
    let (signing, envelope) = (alice.keyring.signing.public, alice.keyring.envelope.public);
    let key = stolen.gateway.transport.clone();
    let binding = Binding { account: stolen.owner, key, signing, envelope, device: None };
    let liar = Arc::new(Liar { binding, device: stolen.device.clone(), asked: AtomicU64::new(0) });
    assert_eq!(signer_id(&liar.device.public), stolen.device_id());
    let (context, address) =
        (Context { provider, domain: stolen.domain }, SocketAddr::from(([127, 0, 0, 1], scene.port)));
    let desk = Arc::clone(&liar) as Arc<dyn Desk>;
    let server =
        Server::start(address, desk, context, cabinet.expect("opens"), Limits::default()).await.expect("serves");

    let agent = robot.spawn(&["--topic", "/robot1/odom"]);
    let figures = |agent: &crate::support::Running| {
        agent.stdout().lines().rev().find_map(|line| serde_json::from_str::<Value>(line).ok())
    };
    wait_until(120, "the liar takes records and is asked about them", || {
        let asked = liar.asked.load(Ordering::Acquire) >= 3;
        figures(&agent).filter(|figures| asked && count(figures, "accepted") >= 5)
    });
    let outcome = agent.stop("TERM", 20);
    let last: Value = serde_json::from_str(outcome.stdout.lines().last().expect("a document")).expect("JSON");
    drop(server);
    let store = Ciphertext::of(&Ledger::open(&robot.home.path().join("ledger.db")).expect("opens"));
    let (captured, kept) = (count(&last, "captured"), store.usage().expect("reads").entries);
    let told =
        format!("{captured} records captured, {} said to be verified, {kept} kept by the robot", last["verified"]);
    let doubted = outcome.stderr.lines().find(|line| line.contains("its proofs do not show them")).map(str::to_owned);
    let outcome = match doubted {
        _ if kept < captured => Outcome::Succeeded(told),
        Some(words) => Outcome::Refused(format!("{told}; {words}")),
        None => Outcome::Otherwise(format!("{told}, and nothing was said of the lie: {outcome}")),
    };
    judge("take_the_robots_only_copy", outcome);
}

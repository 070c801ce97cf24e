//! A lying gateway takes records over, reports them as verified, proves nothing, and has the robot delete them.

use std::net::SocketAddr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use async_trait::async_trait;
use authros::chain::RelayError;
use authros::crypto::{ProviderName, SmKeyPair, provider, signer_id};
use authros::gateway::{
    Account, Binding, Cabinet, Caller, Code, Context, Desk, Feed, FeedEntry, FeedPage, Found, Limits, NetworkName,
    Notice, Received, Refusal, Schedule, Server,
};
use authros::model::{Address, Digest, Fact, Header, ProfileName, PublicKey, SignerId, Timestamp, Token};
use authros::store::{Ciphertext, Ledger};
use serde_json::Value;
use tokio::sync::watch;

use crate::enrolled_robot::{Robot, Scene};
use crate::support::member::Member;
use crate::support::{count, wait_until};
use crate::{Outcome, judge};

/// Discards what it is given.
struct Liar {
    binding: Binding,
    device: SmKeyPair,
    asked: AtomicU64,
    /// What it took, and says that it has.
    taken: Mutex<Vec<(Digest, Header)>>,
}

fn no<T>() -> Result<T, Refusal> {
    Err(Refusal::new(Code::NotHere, "a liar's gateway"))
}

#[async_trait]
impl Desk for Liar {
    async fn account(&self, _: &Address, _: Option<&SignerId>) -> Result<Account, Refusal> {
        Ok(Account { signing: self.binding.signing, envelope: self.binding.envelope })
    }

    async fn admits(&self, _: &Address, _: Option<&Token>) -> Result<(), Refusal> {
        Ok(())
    }

    async fn signer(&self, _: &Address, _: &SignerId) -> Result<Option<PublicKey>, Refusal> {
        Ok(Some(self.device.public))
    }

    async fn binding(&self, _: &ProfileName) -> Result<Option<Binding>, Refusal> {
        Ok(Some(self.binding.clone()))
    }

    async fn recalled(&self, _: &Binding) -> Result<Option<Timestamp>, Refusal> {
        Ok(None)
    }

    async fn successor(&self, _: &Address) -> Result<Option<Address>, Refusal> {
        Ok(None)
    }

    async fn bind(&self, _: &ProfileName, _: Option<Address>, _: Binding) -> Result<(), Refusal> {
        no()
    }

    async fn store(&self, _: &Caller, records: Vec<Received>) -> Result<Timestamp, Refusal> {
        let mut taken = self.taken.lock().expect("not poisoned");
        taken.extend(records.into_iter().map(|record| (record.digest, record.header)));
        Ok(Timestamp::now())
    }

    async fn feed(&self, _: &Caller, asked: &Feed, _: bool) -> Result<FeedPage, Refusal> {
        self.asked.fetch_add(1, Ordering::AcqRel);
        let taken = self.taken.lock().expect("not poisoned").clone();
        let told = (1..).zip(taken).map(|(number, (digest, header))| FeedEntry {
            number,
            fact: Fact::Verified,
            digest,
            owner: header.owner,
            recorder: header.recorder,
            seq: header.seq,
            topic_id: header.topic_id,
            epoch: header.epoch,
            captured_at: header.captured_at,
            length: 1,
            kind: header.kind,
            proof: Vec::new(),
        });
        let told: Vec<FeedEntry> = told.filter(|_| !asked.recorders.is_empty()).take(256).collect();
        let upto = told.last().map_or(0, |last| last.number);
        Ok(FeedPage::new([7; 16], (upto, upto), Vec::new(), told))
    }

    fn changes(&self) -> watch::Receiver<u64> {
        watch::channel(0).1
    }

    async fn records(&self, _: &Caller, digests: &[Digest], _: bool) -> Result<Vec<Found>, Refusal> {
        Ok(vec![Found::Here; digests.len()])
    }

    async fn notice(&self, _: &Caller, _: &Notice) -> Result<(), Refusal> {
        no()
    }

    async fn network_name(&self) -> Result<NetworkName, Refusal> {
        no()
    }

    async fn relay(&self, _: Option<&Caller>, _: &str, _: &Value) -> Result<Value, RelayError> {
        Err(RelayError::Silent("a liar's gateway".to_owned()))
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
    let (context, schedule) = (Context { provider, domain: stolen.domain }, Schedule::default());
    let cabinet = Cabinet::open(&directory.path().join("gateway"), context, identity, schedule, Timestamp::now());
    let (signing, envelope) = (alice.keyring.signing.public, alice.keyring.envelope.public);
    let key = stolen.gateway.transport.clone();
    let binding = Binding { account: stolen.owner, key, signing, envelope, device: None };
    let liar =
        Arc::new(Liar { binding, device: stolen.device.clone(), asked: AtomicU64::new(0), taken: Mutex::default() });
    assert_eq!(signer_id(&liar.device.public), stolen.device_id());
    let address = SocketAddr::from(([127, 0, 0, 1], scene.port));
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
    let doubted =
        outcome.stderr.lines().find(|line| line.contains("its proofs show in no anchored batch")).map(str::to_owned);
    let outcome = match doubted {
        _ if kept < captured => Outcome::Succeeded(told),
        Some(words) => Outcome::Refused(format!("{told}; {words}")),
        None => Outcome::Otherwise(format!("{told}, and nothing was said of the lie: {outcome}")),
    };
    judge("take_the_robots_only_copy", outcome);
}

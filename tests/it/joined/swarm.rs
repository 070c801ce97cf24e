//! Light clients: each a session of the gateway's protocol with a name, a topic and a network address of its own, all in
//! the test's process. Each goes on with a record until the gateway has signed for it.

use std::collections::BTreeSet;
use std::net::{IpAddr, Ipv4Addr};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use authros::gateway::{Applicant, Client, Context, Credentials, Endpoint, Feed, GatewayError, Trust, Upload};
use authros::model::{Digest, SignerId};
use tokio::runtime::Runtime;
use tokio::sync::Semaphore;
use tokio::task::JoinHandle;

use super::Gateway;
use super::support::member::{Member as Keys, told};
use super::support::wait_until;

/// How long the gateway may take to answer.
const PATIENCE: Duration = Duration::from_secs(5);
/// Before it is tried again; the pause doubles up to the longest, as robots' pauses do.
const PAUSES: [Duration; 2] = [Duration::from_millis(50), Duration::from_secs(2)];
/// How many clients are enrolled at once.
const ENROLLING: usize = 16;
/// How long the last records may take.
const REST: Duration = Duration::from_secs(120);

/// What a client knows of a gateway.
#[derive(Clone)]
struct Place {
    endpoint: Endpoint,
    key: SignerId,
}

/// What is shared by all clients.
struct Scene {
    keys: Keys,
    place: Place,
    ending: AtomicBool,
    acknowledged: AtomicU64,
    /// Turns for those that are enrolled at once.
    enrolling: Semaphore,
}

/// What came of one client, or of all.
#[derive(Debug, Default)]
pub(super) struct Brought {
    /// Records with a receipt.
    pub acknowledged: BTreeSet<Digest>,
    /// From a request that failed to the receipt.
    pub outages: Vec<Duration>,
}

/// How much each client brings at a time, and the time between.
#[derive(Debug, Clone, Copy)]
pub(super) struct Load {
    pub clients: u16,
    pub records: u64,
    pub every: Duration,
    pub bytes: usize,
}

/// A gateway's list.
pub(super) type List = BTreeSet<Digest>;

/// Clients of one owner that bring records until they are told to end.
pub(super) struct Swarm {
    scene: Arc<Scene>,
    clients: Vec<JoinHandle<Brought>>,
    // Last: what runs in it is gone by then.
    runtime: Runtime,
}

impl Place {
    fn of(workers: &[&Gateway], keys: &Keys) -> Self {
        let context = Context { provider: keys.provider(), domain: keys.domain };
        let addresses = workers.iter().map(|worker| worker.address()).collect();
        let endpoint = Endpoint { addresses, context, patience: PATIENCE, source: None };
        Self { endpoint, key: workers[0].key.parse().expect("a key") }
    }

    /// The same, with each address first for some.
    fn turned(&self, number: u16) -> Self {
        let mut turned = self.clone();
        let addresses = &mut turned.endpoint.addresses;
        let count = addresses.len();
        addresses.rotate_left(usize::from(number) % count);
        turned
    }

    fn endpoint_of(&self, source: IpAddr) -> Endpoint {
        Endpoint { source: Some(source), ..self.endpoint.clone() }
    }

    async fn allocate(&self, keys: &Keys, name: &str, source: IpAddr) -> Result<Credentials, GatewayError> {
        let (name, keyring) = (name.parse().expect("a name"), &keys.keyring);
        let envelope = keyring.envelope.public;
        let applicant = Applicant { name: &name, signing: &keyring.signing, envelope, account: &keyring.eoa };
        let mut trust = Trust::pinned(self.key);
        let (key, _) = Client::allocate(&self.endpoint_of(source), &mut trust, &applicant).await?;
        Ok(Credentials { name, key, token: keys.token() })
    }

    async fn connect(&self, credentials: &Credentials, source: IpAddr) -> Result<Client, GatewayError> {
        Client::connect(&self.endpoint_of(source), &mut Trust::pinned(self.key), credentials).await
    }
}

/// A gateway limits each address by itself.
fn source(number: u16) -> IpAddr {
    let [high, low] = number.to_be_bytes();
    IpAddr::V4(Ipv4Addr::new(127, 1, high, low))
}

impl Swarm {
    /// Clients that the gateway knows.
    pub fn start(keys: Keys, gateway: &Gateway, load: Load) -> Self {
        Self::among(keys, &[gateway], load)
    }

    /// Clients that know the addresses of all of its workers.
    pub fn among(keys: Keys, workers: &[&Gateway], load: Load) -> Self {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
        let runtime = runtime.expect("a runtime");
        let place = Place::of(workers, &keys);
        let (ending, acknowledged) = (AtomicBool::new(false), AtomicU64::new(0));
        let enrolling = Semaphore::new(ENROLLING);
        let scene = Arc::new(Scene { keys, place, ending, acknowledged, enrolling });
        let clients = (1..=load.clients).map(|number| runtime.spawn(client(Arc::clone(&scene), number, load)));
        let clients = clients.collect();
        Self { scene, clients, runtime }
    }

    /// Records with a receipt so far.
    pub fn acknowledged(&self) -> u64 {
        self.scene.acknowledged.load(Ordering::Relaxed)
    }

    /// No further records; returns when each has a receipt.
    pub fn stop(&mut self) -> Brought {
        self.scene.ending.store(true, Ordering::Relaxed);
        let mut all = Brought::default();
        for client in self.clients.drain(..) {
            let brought = self.runtime.block_on(client).expect("the client went on");
            all.acknowledged.extend(brought.acknowledged);
            all.outages.extend(brought.outages);
        }
        all.outages.sort();
        all
    }

    /// Waits until the gateway has all of these.
    pub fn holds(&self, seconds: u64, digests: &BTreeSet<Digest>) {
        let digests: Vec<Digest> = digests.iter().copied().collect();
        wait_until(seconds, "what has a receipt is held", || {
            let missing = self.runtime.block_on(missing(&self.scene.place, &self.scene.keys, &digests));
            if !matches!(missing, Ok(0)) {
                std::thread::sleep(Duration::from_secs(1));
            }
            matches!(missing, Ok(0)).then_some(())
        });
    }

    /// What the gateway tells the owner of, once that passes the test. The same record twice, or two with
    /// one number, fail it immediately.
    pub fn listed(&self, seconds: u64, what: &str, test: impl Fn(&List) -> bool) -> List {
        wait_until(seconds, what, || {
            let listed =
                self.runtime.block_on(list(&self.scene.place, &self.scene.keys)).ok().filter(|list| test(list));
            if listed.is_none() {
                // Each look is two handshakes, of which a gateway allows ten a second.
                std::thread::sleep(Duration::from_secs(1));
            }
            listed
        })
    }
}

async fn missing(place: &Place, keys: &Keys, digests: &[Digest]) -> Result<usize, GatewayError> {
    let credentials = place.allocate(keys, "lister", source(u16::MAX)).await?;
    let mut client = place.connect(&credentials, source(u16::MAX)).await?;
    Ok(client.missing(digests).await?.len())
}

async fn client(scene: Arc<Scene>, number: u16, load: Load) -> Brought {
    let (name, topic) = (format!("light-{number}"), format!("/robot{number}/odom"));
    let from = source(number);
    let (known, place) = (enrolled(&scene, &name, from).await, scene.place.turned(number));
    let (mut brought, mut next, mut session) = (Brought::default(), 1, None);
    // Not all of them at once.
    tokio::time::sleep(load.every * u32::from(number) / u32::from(load.clients)).await;
    let mut due = Instant::now();
    while !scene.ending.load(Ordering::Relaxed) {
        let body = vec![0x5a; load.bytes];
        let seal = |seq| scene.keys.record(&scene.keys.keyring.signing, &topic, seq, &body);
        let uploads: Vec<Upload> = (next..next + load.records).map(seal).collect();
        next += load.records;
        let digests = uploads.iter().map(|upload| Digest(scene.keys.provider().sm3(&[&upload.blob])));
        let (digests, mut broken, begun) = (digests.collect::<Vec<_>>(), None, Instant::now());
        let mut pause = PAUSES[0];
        loop {
            let tried = Instant::now();
            let done = attempt(&place, &known, from, &mut session, &uploads).await;
            let Err(error) = done else { break };
            assert!(begun.elapsed() < REST, "{name}: the gateway does not take its records: {error}");
            session = None;
            broken.get_or_insert(tried);
            // Not together with all others.
            tokio::time::sleep(pause / 2 + pause / 2 * u32::from(number % 8) / 8).await;
            pause = (pause * 2).min(PAUSES[1]);
        }
        brought.outages.extend(broken.map(|broken: Instant| broken.elapsed()));
        brought.acknowledged.extend(digests);
        scene.acknowledged.fetch_add(load.records, Ordering::Relaxed);
        // One that is behind does not wait, and does not try to make up for more than one.
        due = (due + load.every).max(Instant::now().checked_sub(load.every).unwrap_or(due));
        tokio::time::sleep_until(due.into()).await;
    }
    brought
}

/// Robots are not enrolled all at the same moment, and a gateway may have no room for a handshake just then.
async fn enrolled(scene: &Scene, name: &str, from: IpAddr) -> Credentials {
    let _turn = scene.enrolling.acquire().await.expect("never closed");
    let begun = Instant::now();
    loop {
        match scene.place.allocate(&scene.keys, name, from).await {
            Ok(credentials) => return credentials,
            Err(error) => assert!(begun.elapsed() < REST, "{name}: {error}"),
        }
        tokio::time::sleep(PAUSES[1]).await;
    }
}

async fn attempt(
    place: &Place,
    credentials: &Credentials,
    source: IpAddr,
    session: &mut Option<Client>,
    uploads: &[Upload],
) -> Result<(), GatewayError> {
    if session.as_ref().is_none_or(Client::is_spent) {
        *session = Some(place.connect(credentials, source).await?);
    }
    let client = session.as_mut().expect("connected");
    client.upload(uploads.to_vec()).await.map(drop)
}

async fn list(place: &Place, keys: &Keys) -> Result<List, GatewayError> {
    let credentials = place.allocate(keys, "lister", source(u16::MAX)).await?;
    let mut client = place.connect(&credentials, source(u16::MAX)).await?;
    let (mut found, mut numbers) = (BTreeSet::new(), BTreeSet::new());
    for entry in told(&mut client, &Feed::of(keys.address())).await? {
        let number = (entry.recorder.0, entry.topic_id.0, entry.seq);
        assert!(numbers.insert(number), "told twice, or two records with one number: {entry:?}");
        assert!(found.insert(entry.digest), "told twice: {entry:?}");
    }
    Ok(found)
}

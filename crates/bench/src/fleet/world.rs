//! A fleet in one process: a chain, gateways over it, owners, and robots that take turns.

use std::collections::{BTreeMap, VecDeque};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use tokio::sync::Mutex;
use tokio::task::{JoinSet, block_in_place};

use super::chance::Chance;
use super::owner::Owner;
use super::relay::Relay;
use super::robot::{Brought, Pace, Robot, Scene, Sealed, source};
use super::station::{Ground, Settings, Station};
use crate::network::Directory;
use crate::progress::Progress;
use crate::usage::processor_seconds;
use authros_crypto::Provider;
use authros_gateway::Context;
use authros_service::Failure;
use authros_service::failure::internal;

/// Robots of one owner.
const OF_OWNER: usize = 100;
/// How often the ledgers are asked whether everything is verified.
const LOOK: Duration = Duration::from_secs(1);
/// After so many looks without a further copy there is none to come.
const QUIET: u32 = 5;
/// Gateways are asked what they say against each other at one look in so many.
const PROBLEMS: u32 = 5;

/// What all fleets of a run have in common.
pub(super) struct Plan {
    /// Robots.
    pub robots: usize,
    /// Records of each part, of all robots together.
    pub records: u64,
    /// Bytes of a message.
    pub bytes: usize,
    /// Robots that are connected at once.
    pub connected: usize,
    /// Settings of every site.
    pub settings: Settings,
    /// The provider of the robots.
    pub provider: &'static dyn Provider,
    /// When the run is to be over.
    pub deadline: Instant,
}

/// What became of records.
pub(super) struct Settled {
    /// Whether all were verified in time.
    pub in_time: bool,
    /// How many verified copies there are, of all records so far.
    pub copies: u64,
    /// What gateways said against each other meanwhile, and how often it was found.
    pub problems: BTreeMap<String, u64>,
    /// When the last of it was verified, and the processor time of this process until then, seconds.
    pub end: (Instant, f64),
}

/// A fleet.
pub(super) struct World {
    /// Each by itself, because one may be stopped and begun again while robots are busy.
    pub stations: Arc<Vec<Mutex<Station>>>,
    /// What robots know.
    pub scene: Arc<Scene>,
    /// The owners.
    pub owners: Vec<Arc<Owner>>,
    ground: Ground,
    relays: Vec<Relay>,
    robots: Vec<Robot>,
    _directory: Directory,
}

impl World {
    /// A fleet of this many gateways that do not know each other yet; all robots are known to theirs.
    ///
    /// # Errors
    /// If a part cannot be begun.
    pub async fn open(plan: &Plan, gateways: usize) -> Result<Self, Failure> {
        let directory = Directory::new()?;
        let ground = Ground::open(directory.path(), &plan.settings).await?;
        let stations = stations(plan, &ground, directory.path(), gateways).await?;
        let places = stations.iter().map(|station| (station.address.to_string(), station.key)).collect();
        let context = Context { provider: plan.provider, domain: ground.network.domain };
        let scene = Arc::new(Scene { context, places });
        let (mut owners, mut robots) = (Vec::new(), Vec::with_capacity(plan.robots));
        for (number, first) in (0..).zip((0..plan.robots).step_by(OF_OWNER)) {
            let owner = Arc::new(Owner::registered(&scene, &ground.network.chain, source(120, number)).await?);
            for station in &stations {
                station.admit(owner.address).await?;
            }
            let last = (first + OF_OWNER).min(plan.robots);
            let numbers = (first..last).map(|number| u32::try_from(number).unwrap_or(u32::MAX));
            let own: Result<Vec<Robot>, Failure> =
                block_in_place(|| numbers.map(|number| Robot::new(&scene, Arc::clone(&owner), number)).collect());
            let own = own?;
            owner.lend(&ground.network.chain, &own.iter().map(Robot::device).collect::<Vec<_>>()).await?;
            robots.extend(own);
            owners.push(owner);
        }
        let robots = introduce(plan, &scene, robots).await?;
        let stations = Arc::new(stations.into_iter().map(Mutex::new).collect());
        Ok(Self { stations, scene, owners, ground, relays: Vec::new(), robots, _directory: directory })
    }

    /// Every gateway names all others, by lines on which bytes are counted.
    ///
    /// # Errors
    /// If a line or a name is refused.
    pub async fn name_each_other(&mut self) -> Result<(), Failure> {
        let mut lines = Vec::new();
        for station in self.stations.iter() {
            let station = station.lock().await;
            let relay = Relay::open(station.address).await?;
            lines.push((relay.address.clone(), station.key));
            self.relays.push(relay);
        }
        for station in self.stations.iter() {
            let station = station.lock().await;
            for (address, key) in lines.iter().filter(|(_, key)| *key != station.key) {
                station.name(address.clone(), *key).await?;
            }
        }
        Ok(())
    }

    /// Bytes between gateways so far.
    pub fn between(&self) -> u64 {
        self.relays.iter().map(Relay::bytes).sum()
    }

    /// All robots seal the records of the next part.
    ///
    /// # Errors
    /// Errors of the random source.
    pub fn seal(&mut self, plan: &Plan) -> Result<Vec<Vec<Sealed>>, Failure> {
        let each = (plan.records / plan.robots as u64).max(1);
        let scene = Arc::clone(&self.scene);
        block_in_place(|| self.robots.iter_mut().map(|robot| robot.seal(&scene, each, plan.bytes)).collect())
    }

    /// All robots bring what they sealed, some at once, each in its turn.
    ///
    /// # Errors
    /// If a task of the bench fails.
    pub async fn bring(
        &mut self,
        plan: &Plan,
        sealed: Vec<Vec<Sealed>>,
        pace: &Arc<Pace>,
        what: &str,
    ) -> Result<Brought, Failure> {
        let robots = std::mem::take(&mut self.robots);
        let all = robots.len();
        let waiting: Waiting = Arc::new(Mutex::new(robots.into_iter().zip(sealed).collect()));
        let mut turns = JoinSet::new();
        for _ in 0..plan.connected.min(all) {
            let (waiting, scene, pace) = (Arc::clone(&waiting), Arc::clone(&self.scene), Arc::clone(pace));
            turns.spawn(async move {
                let (mut done, mut brought) = (Vec::new(), Brought::default());
                loop {
                    let next = waiting.lock().await.pop_front();
                    let Some((mut robot, sealed)) = next else { return (done, brought) };
                    brought.add(robot.bring(&scene, &sealed, &pace).await);
                    done.push(robot);
                }
            });
        }
        let (mut together, mut progress) = (Brought::default(), Progress::new(what));
        while let Some(done) = turns.join_next().await {
            let (robots, brought) = done.map_err(|error| internal(error.to_string()))?;
            self.robots.extend(robots);
            together.add(brought);
            progress.at(self.robots.len(), all);
        }
        Ok(together)
    }

    /// Waits until so many records are verified by `copies` gateways each, and nothing is on its way. Where not all keep
    /// all, it is also waited until no further copies come.
    ///
    /// # Errors
    /// If a ledger cannot be read.
    pub async fn settle(&self, wanted: u64, copies: usize, deadline: Instant) -> Result<Settled, Failure> {
        let all = self.stations.len();
        let (mut before, mut quiet, mut problems, mut looks) = (0, 0, BTreeMap::new(), 0u32);
        let mut end = (Instant::now(), processor_seconds());
        loop {
            let (mut sum, mut least, mut pending) = (0, u64::MAX, 0);
            for station in self.stations.iter() {
                let (verified, waiting) = station.lock().await.verified()?;
                (sum, least, pending) = (sum + verified, least.min(verified), pending + waiting);
            }
            quiet = if sum == before && pending == 0 { quiet + 1 } else { 0 };
            if quiet == 0 {
                end = (Instant::now(), processor_seconds());
            }
            before = sum;
            let there = if copies == all { least >= wanted } else { sum >= wanted * copies as u64 };
            let over = copies == all || copies == 1 || quiet >= QUIET;
            if there && over && pending == 0 {
                return Ok(Settled { in_time: true, copies: sum, problems, end });
            }
            if Instant::now() > deadline {
                return Ok(Settled { in_time: false, copies: sum, problems, end });
            }
            looks += 1;
            if looks.is_multiple_of(PROBLEMS) {
                for station in self.stations.iter() {
                    let found = station.lock().await.problems().await?;
                    found.into_iter().for_each(|problem| *problems.entry(problem).or_default() += 1);
                }
            }
            tokio::time::sleep(LOOK).await;
        }
    }

    /// Stops gateways and begins them again, one after the other, at random; then robots need not wait any more.
    ///
    /// # Errors
    /// If one cannot be begun again.
    pub async fn disturb(stations: &[Mutex<Station>], times: u32, seed: u64, pace: &Pace) -> Result<(), Failure> {
        let mut chance = Chance::new(seed);
        for _ in 0..times {
            tokio::time::sleep(Duration::from_millis(500 + chance.below(2000))).await;
            let which = usize::try_from(chance.below(stations.len() as u64)).unwrap_or(0);
            let Some(station) = stations.get(which) else { continue };
            let mut station = station.lock().await;
            station.stop().await;
            tokio::time::sleep(Duration::from_millis(1000 + chance.below(3000))).await;
            station.begin_again().await?;
        }
        pace.hurry.store(true, Ordering::Relaxed);
        Ok(())
    }

    /// Records that two gateways anchored, as each of them saw it since it was begun.
    ///
    /// # Errors
    /// Errors of the sites.
    pub async fn anchored_twice(&self) -> Result<u64, Failure> {
        let mut sum = 0;
        for station in self.stations.iter() {
            sum += station.lock().await.anchored_twice().await?;
        }
        Ok(sum)
    }

    /// Ends everything.
    pub async fn close(self) {
        drop(self.relays);
        for station in self.stations.iter() {
            station.lock().await.stop().await;
        }
        self.ground.close().await;
    }
}

/// Robots whose turn is still to come, with what they sealed.
type Waiting = Arc<Mutex<VecDeque<(Robot, Vec<Sealed>)>>>;

async fn stations(plan: &Plan, ground: &Ground, directory: &Path, gateways: usize) -> Result<Vec<Station>, Failure> {
    let (mut stations, mut progress) = (Vec::with_capacity(gateways), Progress::new("gateways"));
    for number in 0..gateways {
        let mut settings = plan.settings.clone();
        let contract = ground.network.chain.pin().ok_or_else(|| internal("the chain has no contract"))?.contract;
        settings.push(("chain.url", ground.url.clone()));
        settings.push(("chain.contract", contract.to_string()));
        stations.push(Station::open(&directory.join(format!("gateway-{}", number + 1)), settings).await?);
        progress.at(number + 1, gateways);
    }
    Ok(stations)
}

/// Makes every robot known to its home, the gateways in turn, and to the next one.
async fn introduce(plan: &Plan, scene: &Arc<Scene>, robots: Vec<Robot>) -> Result<Vec<Robot>, Failure> {
    let (gateways, all) = (scene.places.len(), robots.len());
    let waiting: VecDeque<(usize, Robot)> = robots.into_iter().enumerate().collect();
    let (waiting, mut turns) = (Arc::new(Mutex::new(waiting)), JoinSet::new());
    for _ in 0..plan.connected.min(all) {
        let (waiting, scene) = (Arc::clone(&waiting), Arc::clone(scene));
        turns.spawn(async move {
            let mut done = Vec::new();
            loop {
                let next = waiting.lock().await.pop_front();
                let Some((number, mut robot)) = next else { return Ok::<_, Failure>(done) };
                let mut places = vec![number % gateways];
                places.extend(Some((number + 1) % gateways).filter(|next| *next != number % gateways));
                robot.introduce(&scene, &places).await?;
                done.push(robot);
            }
        });
    }
    let (mut known, mut progress) = (Vec::with_capacity(all), Progress::new("robots"));
    while let Some(done) = turns.join_next().await {
        known.extend(done.map_err(|error| internal(error.to_string()))??);
        progress.at(known.len(), all);
    }
    Ok(known)
}

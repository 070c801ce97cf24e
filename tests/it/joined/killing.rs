//! Many robots over the embedded chain and over anvil while their gateway is killed again and again. Every record with a
//! receipt is held after the last return, anchored, and in every list once. `AUTHROS_JOINED_ROBOTS` names how many robots there
//! are, say 1000.

use authros::model::Digest;

use super::swarm::{Load, Swarm};
use super::*;
use support::member::Member as Keys;
use support::{length, skipped};

/// How long the gateway is killed: in every run, and in the long one.
const KILLING: [Duration; 2] = [Duration::from_secs(8), Duration::from_secs(600)];
/// Robots: in every run, and in the long one.
const ROBOTS: [u16; 2] = [12, 60];
/// Records a second at most, however many robots there are: what is tested is what is held, not how many go.
const RECORDS: u32 = 60;
/// How soon what has a receipt is listed, seconds: asked for by the product, not a guess at a machine.
const HELD: u64 = 30;

/// Numbers that are the same at every run.
struct Chance(u64);

impl Chance {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % limit
    }
}

/// Kills the gateway until the time is over; returns how often.
fn kill_at_random(gateway: &mut Gateway, swarm: &Swarm, time: Duration) -> u32 {
    let (begun, mut killed, mut chance) = (Instant::now(), 0, Chance(22));
    while begun.elapsed() < time {
        // Robots bring something between two deaths.
        let before = swarm.acknowledged();
        wait_until(120, "records are acknowledged", || (swarm.acknowledged() > before).then_some(()));
        std::thread::sleep(Duration::from_millis(chance.below(3000)));
        gateway.kill();
        killed += 1;
        std::thread::sleep(Duration::from_millis(500 + chance.below(3000)));
        gateway.start();
    }
    killed
}

/// The gateway has every record of these, then tells of each as verified, and of nothing else.
#[allow(clippy::print_stdout, reason = "figures for who reads the run")]
fn all_is_held(swarm: &Swarm, acknowledged: &BTreeSet<Digest>) {
    let returned = Instant::now();
    swarm.holds(HELD, acknowledged);
    println!("{} records are all held {:?} after the last return", acknowledged.len(), returned.elapsed());
    let held = swarm.listed(600, "all of them are verified", |list| list.is_superset(acknowledged));
    println!("all of them are verified {:?} after the last return", returned.elapsed());
    assert_eq!(&held, acknowledged, "0 lost, and nothing that nobody brought");
}

fn robots() -> u16 {
    let asked = std::env::var("AUTHROS_JOINED_ROBOTS").ok();
    asked.map_or(ROBOTS[usize::from(support::long())], |text| text.parse().expect("a number of robots"))
}

#[test]
fn a_gateway_is_killed_again_and_again_under_many_robots_and_each_record_is_held_once() {
    let _alone = heavy();
    each_record_is_held_once(&Ground::new());
}

#[test]
fn a_gateway_is_killed_again_and_again_over_anvil_and_each_record_is_held_once() {
    let _alone = heavy();
    let Some(ground) = Ground::on_anvil() else { skipped!("no anvil; tests/run installs it into target/peers") };
    each_record_is_held_once(&ground);
}

#[allow(clippy::print_stdout, reason = "figures for who reads the run")]
fn each_record_is_held_once(ground: &Ground) {
    let mut gateway = Gateway::new(ground);
    let member = |name| Member::at(Some(ground), name, (&gateway, &[&gateway.address()]));
    let [alice, bob] = ["alice", "bob"].map(member);
    alice.grant(&bob);
    let keys = Keys::of(&alice.home, "alice", gateway.domain.parse().expect("a domain"));
    let clients = robots();
    let every = Duration::from_secs(1) * u32::from(clients).div_ceil(RECORDS);
    let load = Load { clients, records: 1, every, bytes: 256 };
    let mut swarm = Swarm::start(keys, &gateway, load);
    wait_until(900, "robots are at work", || (swarm.acknowledged() > u64::from(clients)).then_some(()));
    let time = length(KILLING[0], KILLING[1]);
    let killed = kill_at_random(&mut gateway, &swarm, time);
    let brought = swarm.stop();
    let middle = brought.outages.get(brought.outages.len() / 2);
    println!(
        "{clients} robots, a gateway killed {killed} times in {} s: {} records acknowledged, {} of them late, p50 {middle:?}, \
         max {:?}",
        time.as_secs(),
        brought.acknowledged.len(),
        brought.outages.len(),
        brought.outages.last()
    );
    assert!(killed > 0 && !brought.outages.is_empty(), "somebody had to wait for it");
    all_is_held(&swarm, &brought.acknowledged);
    alice.shares_all_with(&bob, brought.acknowledged.len() as u64);
}

//! Three gateways that reconcile, and many robots, over the embedded chain and over anvil; gateways are killed at random,
//! sometimes two at once. Every record with a receipt is held soon after the last return, anchored, and in every list once.
//! `AUTHROS_FLEET_ROBOTS` names how many robots there are, say 1000.

use authros::model::Digest;

use super::swarm::{Load, Swarm, all_verified};
use super::*;
use support::member::Member as Keys;
use support::{length, skipped};

/// How long gateways are killed: in every run, and in the long one.
const KILLING: [Duration; 2] = [Duration::from_secs(8), Duration::from_secs(600)];
/// Robots: in every run, and in the long one.
const ROBOTS: [u16; 2] = [12, 60];
/// So many records a second at most, however many robots there are: what is tested is who holds them, not how many go.
const RECORDS: u32 = 60;
/// How soon what has a receipt is held by somebody who lives, seconds: asked for by the product, not a guess at a machine.
const HELD: u64 = 30;

/// Kills gateways, one after the other or two at once, until the time is over; returns how many were killed.
fn kill_at_random(gateways: &mut [Gateway; 3], swarm: &Swarm, time: Duration, chance: &mut Chance) -> u32 {
    let (begun, mut killed) = (Instant::now(), 0);
    while begun.elapsed() < time {
        // Robots bring something between two deaths.
        let before = swarm.acknowledged();
        wait_until(120, "records are acknowledged", || (swarm.acknowledged() > before).then_some(()));
        std::thread::sleep(Duration::from_millis(chance.below(3000)));
        let one = usize::try_from(chance.below(3)).expect("small");
        let both = chance.below(4) == 0;
        let dying: Vec<usize> = if both { vec![one, (one + 1) % 3] } else { vec![one] };
        for number in &dying {
            gateways[*number].kill();
        }
        killed += u32::try_from(dying.len()).expect("few");
        std::thread::sleep(Duration::from_millis(500 + chance.below(3000)));
        for number in dying {
            gateways[number].start();
        }
    }
    killed
}

/// Every record of these is held by some gateway, then verified by each; none of them has anything else.
#[allow(clippy::print_stdout, reason = "figures for who reads the run")]
fn all_is_held(swarm: &Swarm, acknowledged: &BTreeSet<Digest>) {
    let returned = Instant::now();
    swarm.listed(HELD, "what has a receipt is held by a living gateway", |lists| {
        acknowledged.iter().all(|digest| lists.iter().any(|list| list.contains_key(digest)))
    });
    println!(
        "{} records are all held by some gateway {:?} after the last return",
        acknowledged.len(),
        returned.elapsed()
    );
    let lists = swarm.listed(600, "every gateway has verified all of them", |lists| all_verified(lists, acknowledged));
    println!("each gateway has verified all of them {:?} after the last return", returned.elapsed());
    for list in lists {
        let held: BTreeSet<Digest> = list.into_keys().collect();
        assert_eq!(&held, acknowledged, "0 lost, and nothing that nobody brought");
    }
}

fn robots() -> u16 {
    let asked = std::env::var("AUTHROS_FLEET_ROBOTS").ok();
    asked.map_or(ROBOTS[usize::from(support::long())], |text| text.parse().expect("a number of robots"))
}

#[test]
fn gateways_are_killed_in_turn_under_many_robots_and_each_record_is_held_once() {
    let _alone = heavy();
    each_record_is_held_once(&Ground::new());
}

#[test]
fn gateways_are_killed_in_turn_over_anvil_and_each_record_is_held_once() {
    let _alone = heavy();
    let Some(ground) = Ground::on_anvil() else { skipped!("no anvil; tests/run installs it into target/peers") };
    each_record_is_held_once(&ground);
}

#[allow(clippy::print_stdout, reason = "figures for who reads the run")]
fn each_record_is_held_once(ground: &Ground) {
    let mut gateways = [Gateway::new(ground), Gateway::new(ground), Gateway::new(ground)];
    let all = [&gateways[0], &gateways[1], &gateways[2]];
    let (alice, bob) = (Member::on(Some(ground), "alice", &all), Member::on(Some(ground), "bob", &all));
    alice.grant(&bob);
    name_each_other(&all);
    let keys = Keys::of(&alice.home, "alice", gateways[0].domain.parse().expect("a domain"));
    let clients = robots();
    let every = Duration::from_secs(1) * u32::from(clients).div_ceil(RECORDS);
    let load = Load { clients, records: 1, every, bytes: 256 };
    let mut swarm = Swarm::start(keys, &all, load);
    wait_until(900, "robots are at work", || (swarm.acknowledged() > u64::from(clients)).then_some(()));
    let time = length(KILLING[0], KILLING[1]);
    let killed = kill_at_random(&mut gateways, &swarm, time, &mut Chance(22));
    let brought = swarm.stop();
    let middle = brought.failovers.get(brought.failovers.len() / 2);
    println!(
        "{clients} robots, {killed} gateways killed in {} s: {} records acknowledged, {} fail-overs, p50 {middle:?}, max {:?}",
        time.as_secs(),
        brought.acknowledged.len(),
        brought.failovers.len(),
        brought.failovers.last()
    );
    assert!(killed > 0 && !brought.failovers.is_empty(), "somebody had to turn to another gateway");
    all_is_held(&swarm, &brought.acknowledged);
    let wanted = brought.acknowledged.len() as u64;
    let own = alice.verified(&["uploads", "list"], wanted);
    assert_eq!(
        bob.verified(&["shared", "list", "--owner", &alice.address], wanted),
        own,
        "each once in every reader's list"
    );
}

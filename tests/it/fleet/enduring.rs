//! Two gateways under a lasting load, one of them killed now and then: memory minute by minute, the law of conservation at
//! every look, nothing lost. Only in the long run; `AUTHROS_TEST_BINARY` names a release build for figures that mean something.

use authros::model::Digest;

use crate::fleet_metrics::law;
use crate::metrics::figures;

use super::swarm::{Load, Swarm, all_verified};
use super::*;
use support::member::Member as Keys;
use support::process::own_memory;
use support::{Conservation, length};

/// How long it goes on.
const LENGTH: Duration = Duration::from_secs(1800);
/// How often one of the gateways is killed; in a shorter run, at each quarter of it.
const KILLED: Duration = Duration::from_secs(300);
const MINUTE: Duration = Duration::from_secs(60);
/// 20 robots with 25 records each half second: 1,000 records a second.
const LOAD: Load = Load { clients: 20, records: 25, every: Duration::from_millis(500), bytes: 128 };

/// What the processes of the gateways hold by themselves, KiB.
fn memory(gateways: &[Gateway; 2]) -> Vec<u64> {
    gateways.iter().map(|gateway| own_memory(gateway.site.as_ref().expect("running").id())).collect()
}

/// At each gateway that answers: captured is the sum of all states. Returns how many did.
fn look(gateways: &[Gateway; 2], owner: &str) -> u64 {
    let mut looks = 0;
    for gateway in gateways {
        let told = figures(gateway.figures.expect("it shows figures"));
        // A gateway that has just begun knows of no owner yet.
        let Some(told) = told.filter(|told| told.contains(&format!("captured_total{{owner=\"{owner}\"}}"))) else {
            continue;
        };
        let (captured, terms) = law(&told, owner);
        assert!(
            (captured - terms).abs() < 0.5,
            "{}: {captured} captured, and {terms} accounted for",
            gateway.address()
        );
        looks += 1;
    }
    looks
}

/// Kills the second gateway now and then; the first one's memory is never begun anew.
#[allow(clippy::print_stdout, reason = "figures for who runs the long form")]
fn endure(gateways: &mut [Gateway; 2], swarm: &Swarm, (owner, time): (&str, Duration)) -> u32 {
    let (begun, mut killed, mut minutes, mut looks) = (Instant::now(), 0, 0, 0);
    let between = KILLED.min(time / 4);
    println!("minute 0: {:?} KiB", memory(gateways));
    while begun.elapsed() < time {
        std::thread::sleep(Duration::from_secs(1));
        looks += look(gateways, owner);
        if begun.elapsed() >= between * (killed + 1) {
            gateways[1].kill();
            std::thread::sleep(Duration::from_secs(5));
            gateways[1].start();
            killed += 1;
        }
        if begun.elapsed() >= MINUTE * (minutes + 1) {
            minutes += 1;
            println!("minute {minutes}: {:?} KiB, {} records acknowledged", memory(gateways), swarm.acknowledged());
        }
    }
    println!("at the end: {:?} KiB; the law held at {looks} looks", memory(gateways));
    assert!(looks > 0, "nobody ever looked");
    killed
}

#[test]
fn two_gateways_endure_a_lasting_load_while_one_is_killed_now_and_then() {
    if !support::long() {
        return;
    }
    let _alone = heavy();
    let ground = Ground::new();
    let mut gateways = [Gateway::with_figures(&ground), Gateway::with_figures(&ground)];
    let both = [&gateways[0], &gateways[1]];
    let alice = Member::new("alice", &both);
    name_each_other(&both);
    // She reads from both.
    let hers = Conservation::watch(&alice.home.path(), "alice");
    let short: String = alice.address.trim_start_matches("0x").chars().take(8).collect();
    let keys = Keys::of(&alice.home, "alice", gateways[0].domain.parse().expect("a domain"));
    let mut swarm = Swarm::start(keys, &both, LOAD);
    wait_until(120, "robots are at work", || (swarm.acknowledged() > 0).then_some(()));
    let (time, before, begun) = (length(LENGTH, LENGTH), swarm.acknowledged(), Instant::now());
    let killed = endure(&mut gateways, &swarm, (&short, time));
    let rate = (swarm.acknowledged() - before) / begun.elapsed().as_secs().max(1);
    let brought = swarm.stop();
    let middle = brought.failovers.get(brought.failovers.len() / 2);
    println!(
        "{} records in {} s, {rate} a second; {killed} kills, {} fail-overs, p50 {middle:?}, max {:?}",
        brought.acknowledged.len(),
        time.as_secs(),
        brought.failovers.len(),
        brought.failovers.last()
    );
    assert!(killed > 0, "one was killed");
    let all = &brought.acknowledged;
    let lists = swarm.listed(3600, "both gateways have verified everything", |lists| all_verified(lists, all));
    for list in lists {
        let held: BTreeSet<Digest> = list.into_keys().collect();
        assert!(&held == all, "{} held, {} acknowledged", held.len(), all.len());
    }
    let seen = hers.finish();
    println!("the law held at {} looks of the owner, at the end {:?}", seen.looks, seen.life);
}

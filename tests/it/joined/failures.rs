//! Random failures of every program of a set-up: gateway, owner's and reader's site, robot and chain node are killed, held
//! and cut off. Afterwards nothing is missing, and no audit anywhere finds anything: a false alarm is a fault of the same
//! weight as a missed one. `AUTHROS_FAILURE_SEED` repeats a run.

use std::time::SystemTime;

use super::*;
use support::long;

/// Runs: in every run of the tests, and in the long one.
const RUNS: [u64; 2] = [3, 30];
/// Failures of a run, likewise.
const FAILURES: [u64; 2] = [4, 8];

/// Numbers that follow from a seed.
struct Chance(u64);

impl Chance {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % limit
    }
}

struct Scene {
    ground: Ground,
    /// Between gateway and node.
    line: Cable,
    gateway: Gateway,
    alice: Member,
    bob: Member,
    robot: Robot,
    agent: Option<Running>,
}

impl Scene {
    fn new() -> Self {
        let ground = Ground::new();
        let line = Cable::to(ground.port);
        let gateway = Gateway::over(&ground, &line);
        let (alice, bob) = (Member::new("alice", &gateway), Member::new("bob", &gateway));
        alice.grant(&bob);
        let robot = Robot::enrol(&alice, "scout", &gateway);
        Self { ground, line, gateway, alice, bob, robot, agent: None }
    }

    /// One failure, and its end; returns what it was.
    fn fail(&mut self, chance: &mut Chance) -> &'static str {
        let pause = Duration::from_millis(200 + chance.below(3_000));
        match chance.below(9) {
            0 => {
                self.gateway.kill();
                std::thread::sleep(pause);
                self.gateway.start();
                "gateway killed"
            }
            1 => restarted(&mut self.alice, pause, "owner killed"),
            2 => restarted(&mut self.bob, pause, "reader killed"),
            3 => {
                self.agent.take().expect("running").stop("KILL", 10);
                std::thread::sleep(pause);
                self.agent = Some(self.robot.run(&[]));
                "robot killed"
            }
            4 => {
                self.ground.kill_node();
                std::thread::sleep(pause);
                self.ground.start_node();
                "node killed"
            }
            5 => held(self.gateway.site.as_ref(), pause, "gateway held"),
            6 => held(self.bob.site.as_ref(), pause, "reader held"),
            7 => {
                self.line.cut();
                std::thread::sleep(pause * 2);
                self.line.mend();
                "node cut off"
            }
            _ => {
                self.line.mute();
                std::thread::sleep(pause * 2);
                self.line.mend();
                "node silent"
            }
        }
    }

    /// All that the robot captured is verified everywhere, once, and no audit finds anything.
    fn is_whole(&mut self, what: &str) {
        self.agent.take().expect("running").stop("TERM", 30);
        let all = self.robot.bring("3");
        let own = self.alice.verified(&["records", "list", "--oldest"], all);
        let shared = ["received", "list", "--oldest", "--owner", &self.alice.address];
        assert_eq!(self.bob.verified(&shared, all), own, "{what}");
        let everybody =
            [("owner", &self.alice.authros), ("reader", &self.bob.authros), ("gateway", &self.gateway.keeper())];
        for (name, authros) in everybody {
            for audit in [&["audit"][..], &["audit", "--deep"]] {
                let outcome = authros.run(audit);
                assert_eq!(outcome.code, Some(0), "{what}: {audit:?} at the {name}: {outcome}");
            }
        }
    }
}

fn restarted(member: &mut Member, pause: Duration, what: &'static str) -> &'static str {
    member.site.take().expect("running").stop("KILL", 10);
    std::thread::sleep(pause);
    member.site = Some(member.authros.serve(&member.home));
    what
}

fn held(site: Option<&Running>, pause: Duration, what: &'static str) -> &'static str {
    let site = site.expect("running");
    site.signal("STOP");
    std::thread::sleep(pause * 2);
    site.signal("CONT");
    what
}

#[test]
#[allow(clippy::print_stdout, reason = "the seed is needed to repeat a run")]
fn no_audit_of_anybody_finds_anything_after_random_failures() {
    let _alone = heavy();
    let given = std::env::var("AUTHROS_FAILURE_SEED").ok().map(|seed| seed.parse::<u64>().expect("a number"));
    let now = || SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).expect("after 1970").as_secs();
    let first = given.unwrap_or_else(now);
    let runs = if given.is_some() { 1 } else { RUNS[usize::from(long())] };
    for seed in first..first + runs {
        let (mut scene, mut chance) = (Scene::new(), Chance(seed));
        scene.agent = Some(scene.robot.run(&[]));
        let mut what = format!("AUTHROS_FAILURE_SEED={seed}:");
        for _ in 0..FAILURES[usize::from(long())] {
            std::thread::sleep(Duration::from_millis(chance.below(2_000)));
            let failed = scene.fail(&mut chance);
            what.push_str(&format!(" {failed},"));
        }
        println!("{what}");
        scene.is_whole(&what);
    }
}

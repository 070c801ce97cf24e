//! A robot as its owner sees it in a pseudo-terminal of 80x24: it drifts until it works by its policy.

use super::*;
use support::{Console, Terminal};

/// Seconds allowed for anything on a busy machine.
const PATIENCE: u64 = 90;

/// Somebody at a terminal.
struct Operator(Console);

impl Operator {
    fn opens(authros: &Authros) -> Self {
        Self(Console::open_in(&Terminal::of(80, 24), authros, &[]))
    }

    fn presses(&mut self, keys: &str) -> &mut Self {
        self.0.press(keys);
        self
    }

    fn sees(&mut self, text: &str) -> &mut Self {
        self.0.wait_for(text, PATIENCE);
        self
    }

    /// Leaves; what goes on is asked about.
    fn leaves(&mut self) {
        self.presses("\u{3}");
        let gone = |operator: &mut Self| {
            operator.0.has_ended() || operator.0.shown().contains("Quit?") && operator.presses("y").0.has_ended()
        };
        wait_until(PATIENCE, "the console to end", || Some(()).filter(|()| gone(self)));
        self.0.expect_restored();
    }
}

#[test]
fn an_owner_sets_a_policy_by_form_and_sees_its_robot_drift_until_it_works_by_it() {
    let _alone = heavy();
    let ground = Ground::new();
    let gateway = Gateway::new(&ground);
    let alice = Member::new("alice", &gateway);
    let robot = Robot::enrol(&alice, "scout", &gateway);
    alice.home.file("scout.toml", format!("[[topic]]\nmatch = \"{TOPIC}\"\nevery = 2\n"), 0o600);
    alice.home.file("wrong.toml", "vault.url = \"redis://elsewhere\"\n", 0o600);

    let mut owner = Operator::opens(&alice.authros);
    owner.presses("8").sees("joined another one").sees("Robots").sees("scout");
    owner.presses("p").sees("Set a robot's policy").presses("~/wro\t").sees("~/wrong.toml").presses("\r");
    owner.sees("vault.url").presses("\u{15}~/sco\t").sees("~/scout.toml").presses("\r").sees("Set this policy?");
    owner.sees("1 rule").presses("y").sees("policy 1 waiting").sees("1 in drift");
    owner.presses("1").sees("robot scout drifts: policy 1 waiting");
    owner.presses("8").sees("waiting").presses("\r").sees("Robot scout").sees("drift").sees("every = 2").presses("q");

    let agent = robot.run(&[]);
    owner.sees("policy 1 in force").presses("\r").sees("it works by version 1").sees("every = 2").presses("q");
    owner.presses("1").sees("resolved");
    agent.stop("TERM", 30);
    // Cleared by an empty line; the robot is away and drifts again.
    owner
        .presses("8")
        .sees("in force")
        .presses("p")
        .sees("Set a robot's policy")
        .presses("\r")
        .sees("Clear the policy?");
    owner.presses("y").sees("policy 2 waiting, runs 1").leaves();
    // An operator who may look sees how it stands, and is refused in the form.
    let words = alice.home.file("bob.words", "bob's own words", 0o600);
    alice.authros.json(&["operators", "add", "bob", "--rights", "look", "--operator-passphrase-file", &words]);
    let key = alice.home.root().join("bob.operator").to_str().expect("UTF-8").to_owned();
    let mut bob = Operator::opens(&alice.authros.with(&["--operator", &key, "--passphrase-file", &words]));
    bob.presses("8").sees("OPERATOR bob").sees("policy 2 waiting, runs 1").presses("p").sees("Set a robot's policy");
    bob.presses("\r").sees("Clear the policy?").presses("y").sees("only the owner").presses("\u{1b}").leaves();
    let shown = alice.authros.json(&["robots", "show", "scout"]);
    assert_eq!((count(&shown, "wanted"), &shown["drift"]), (2, &Value::Bool(true)), "{shown}");
}

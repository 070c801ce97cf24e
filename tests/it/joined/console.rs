//! A robot as its owner sees it in a pseudo-terminal of 80x24: it drifts until it works by its policy.

use super::*;
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt as _;
use support::{Accounts, Console, Terminal, skipped};

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
    alice.home.file("wrong.toml", "cache.url = \"redis://elsewhere\"\n", 0o600);

    let mut owner = Operator::opens(&alice.authros);
    owner.presses("8").sees("joined another one").sees("Robots").sees("scout");
    owner.presses("p").sees("Set a robot's policy").presses("~/wro\t").sees("~/wrong.toml").presses("\r");
    owner.sees("cache.url").presses("\u{15}~/sco\t").sees("~/scout.toml").presses("\r").sees("Set this policy?");
    owner.sees("1 rule").presses("y").sees("policy 1 waiting").sees("1 out of date");
    owner.presses("1").sees("robot scout is out of date: policy 1 waiting");
    owner
        .presses("8")
        .sees("waiting")
        .presses("\r")
        .sees("Robot scout")
        .sees("outdated")
        .sees("every = 2")
        .presses("q");

    let agent = robot.run(&[]);
    owner.sees("policy 1 in force").presses("\r").sees("it runs version 1").sees("every = 2").presses("q");
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
    let shown = alice.authros.json(&["robot", "show", "scout"]);
    assert_eq!((count(&shown, "wanted"), &shown["drift"]), (2, &Value::Bool(true)), "{shown}");
    operator_is_refused(alice);
}

/// An operator who may look sees how the robot stands, and is refused in the form.
fn operator_is_refused(mut alice: Member) {
    let accounts = match Accounts::make(&["bob", "mallory"]) {
        Ok(accounts) => accounts,
        Err(reason) => skipped!(reason),
    };
    let bob = accounts.name("bob");
    let socket = accounts.folder("run", "root", 0o755).join("operators.sock");
    let given = socket.to_str().expect("UTF-8");
    let site = alice.site.take().expect("it runs");
    site.stop("INT", 30).expect_code(0);
    let serving = alice
        .authros
        .with_variable("AUTHROS_OPERATORS_SOCKET", given)
        .with_variable("AUTHROS_OPERATORS_RIGHTS", &format!("{{ {bob} = [\"look\"] }}"));
    let site = serving.serve(&alice.home);
    wait_until(60, "the operators' socket", || socket.exists().then_some(()));
    fs::set_permissions(&socket, Permissions::from_mode(0o666)).expect("its mode is set");
    let bobs = accounts.authros("bob").with(&["--site-socket", given, "--profile", "alice"]);
    let mut operator = Operator::opens(&bobs);
    operator.presses("8").sees("OPERATOR").sees("policy 2 waiting, runs 1").presses("p").sees("Set a robot's policy");
    operator.presses("\r").sees("Clear the policy?").presses("y").sees("only the owner").presses("\u{1b}").leaves();
    let shown = alice.authros.json(&["robot", "show", "scout"]);
    assert_eq!((count(&shown, "wanted"), &shown["drift"]), (2, &Value::Bool(true)), "{shown}");
    site.stop("INT", 30).expect_code(0);
}

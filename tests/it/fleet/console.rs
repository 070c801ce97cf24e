//! The fleet and the robots as their people see them, in a pseudo-terminal of 80x24: another gateway in trouble, lacking
//! and reconciled, named and removed by form; a robot that drifts until it works by its policy.

use super::reconciling::bring;
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

    fn no_longer_sees(&mut self, text: &str) -> &mut Self {
        wait_until(PATIENCE, &format!("'{text}' to go"), || Some(()).filter(|()| !self.0.shown().contains(text)));
        self
    }

    /// The row of the screen that names this, once it does.
    fn row(&mut self, text: &str) -> String {
        let shown = self.0.wait_for(text, PATIENCE);
        shown.lines().find(|line| line.contains(text)).expect("it is shown").to_owned()
    }

    /// The row of the screen that names this, once it says that, too: heads of columns may have the same word.
    fn row_with(&mut self, text: &str, wanted: &str) -> String {
        wait_until(PATIENCE, &format!("'{text}' with '{wanted}'"), || {
            let shown = self.0.shown();
            shown.lines().find(|line| line.contains(text) && line.contains(wanted)).map(str::to_owned)
        })
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

/// Serves everybody, within a quota that no record fits into.
fn without_room(gateway: &mut Gateway) {
    gateway.kill();
    let keeper = gateway.keeper().with(&["--json"]).with_variable("AUTHROS_GATEWAY_ADMISSION", "open");
    let keeper = keeper.with_variable("AUTHROS_GATEWAY_QUOTA_BYTES", "1");
    let mut site = keeper.spawn(&["gateway", "serve", "--listen", &gateway.address()]);
    site.wait_for_text("\"gateway\"", 120);
    gateway.site = Some(site);
}

#[test]
fn a_keeper_sees_another_gateway_in_trouble_lacking_and_reconciled_and_names_and_removes_it_by_form() {
    let _alone = heavy();
    let ground = Ground::new();
    let (first, mut second) = (Gateway::new(&ground), Gateway::new(&ground));
    without_room(&mut second);
    let alice = Member::new("alice", &[&first]);
    let robot = Robot::enrol(&alice, "scout", &[&first]);
    let brought = bring(&robot, "5");
    let (address, begins) = (first.address(), first.key.chars().take(8).collect::<String>());

    let mut keeper = Operator::opens(&second.keeper());
    keeper.presses("8").sees("Senders").sees("add gateway");
    assert!(!keeper.0.shown().contains("Fleet"), "nothing is said of a fleet where there is none");
    // What cannot be is said in the form, which then takes the right one.
    keeper.presses("a").sees("Add a gateway").presses("nowhere\r").presses(&first.key).presses("\r");
    keeper.sees("HOST:PORT").presses("\u{15}").presses(&address).presses("\r\r").sees("Add this gateway to the fleet?");
    keeper.sees("authros fleet add").presses("y").sees("Fleet");
    // Its keeper has not named this one yet.
    keeper.sees("trouble").sees("its keeper has not named");
    keeper.presses("1").sees("fleet").sees("its keeper has not named").presses("8").sees("trouble");
    first.keeper().json(&["fleet", "add", &second.address(), "--gateway-key", &second.key]);
    // There is no room for what it holds.
    let row = keeper.row_with(&begins, "lacking");
    assert!(row.contains(&address), "{row}");
    keeper.presses("\u{1b}[H\r").sees(&format!("Gateway {address}")).sees(&first.key).sees("refused").presses("q");
    keeper.presses("1").sees("records lacking").presses("8");

    // Whoever is admitted has no quota. Named anew, all of it is asked for again.
    second.admit(&alice.address);
    keeper.presses("\u{1b}[Hx").sees(&format!("Remove gateway {address}?")).presses("y");
    // The question covers a part of the heading, and what is told of the end may soon be overtaken by other news.
    wait_until(PATIENCE, "it is removed", || {
        second.keeper().json(&["fleet", "list"])["fleet"].as_array()?.is_empty().then_some(())
    });
    keeper.no_longer_sees("Remove gateway").no_longer_sees("Fleet");
    keeper.presses("a").sees("Add a gateway").presses(&address).presses("\r").presses(&first.key).presses("\r");
    keeper.sees("Add this gateway").presses("y").sees("● reconciled");
    wait_until(PATIENCE, "its records are here", || {
        let row = keeper.row(&begins);
        let taken = row.split_whitespace().filter_map(|word| word.parse::<u64>().ok()).max()?;
        (taken >= brought).then_some(())
    });
    // Undo removes it, and what is removed is no longer followed.
    keeper.presses("U").no_longer_sees("Fleet").leaves();
    assert_eq!(second.keeper().json(&["fleet", "list"])["fleet"], serde_json::json!([]));
}

#[test]
fn an_owner_sets_a_policy_by_form_and_sees_its_robot_drift_until_it_works_by_it() {
    let _alone = heavy();
    let ground = Ground::new();
    let first = Gateway::new(&ground);
    let alice = Member::new("alice", &[&first]);
    let robot = Robot::enrol(&alice, "scout", &[&first]);
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
    let shown = alice.authros.json(&["robots", "show", "scout"]);
    assert_eq!((count(&shown, "wanted"), &shown["drift"]), (2, &Value::Bool(true)), "{shown}");
}

//! Robot users at the console, in a pseudo-terminal of 80x24: one script for each behaviour, from the operator's point
//! of view.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use support::{Authros, Console, Home, Terminal, heavy, poll, text, wait_until};

const ODOMETRY: &str = "/robot1/odom";
const CAMERA: &str = "/robot1/camera/compressed";
const PASSPHRASE: &str = "an operator's passphrase";
/// Seconds allowed for anything on a busy machine.
const PATIENCE: u64 = 60;

fn one_robot(authros: Authros) -> Authros {
    authros.with(&["--robots", "1"])
}

/// An operator at a terminal of 80x24.
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

    fn sees_so_often(&mut self, text: &str, times: usize) -> &mut Self {
        let shown = || self.0.shown().matches(text).count() >= times;
        wait_until(PATIENCE, &format!("'{text}' {times} times"), || Some(()).filter(|()| shown()));
        self
    }

    /// Presses keys that are for a row until their effect is seen: they are given up after some seconds without rows.
    fn presses_until(&mut self, keys: &str, text: &str) -> &mut Self {
        wait_until(PATIENCE, &format!("'{text}' after {keys:?}"), || {
            self.0.press(keys);
            poll(5, || self.0.shown().contains(text).then_some(()))
        });
        self
    }

    /// Takes the filter away: a message on the screen goes first.
    fn clears_the_filter(&mut self) -> &mut Self {
        wait_until(PATIENCE, "the filter to go", || {
            self.0.press("\u{1b}");
            poll(1, || (!self.0.shown().contains("filter:")).then_some(()))
        });
        self
    }

    /// Quits, even while records are pending.
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
fn from_nothing_to_verified_records_of_two_topics() {
    let _alone = heavy();
    let home = Home::new();
    let key = home.file("k_c", "00112233445566778899aabbccddeeff", 0o600);
    let mut operator = Operator::opens(&one_robot(home.authros()));
    operator.sees("First steps").sees(ODOMETRY);

    operator.presses("n").sees("Repeat").presses(PASSPHRASE).presses("\r").presses(PASSPHRASE).presses("\r");
    assert!(!operator.0.shown().contains(PASSPHRASE), "a passphrase is never shown");
    operator.sees("done 1 identity");

    operator.presses("6").sees("registered").presses("L").sees("Load a key file");
    operator.presses("\r").presses(&key).presses("\r\r").sees("Replace the SM4 key?");
    operator.presses("L").no_longer_sees("Replace the SM4 key?").presses("\r").sees("Replace the SM4 key?");
    operator.presses("y").sees("SM4 key loaded");

    operator.presses("2").sees(CAMERA).presses("/robot1/\r").presses("a").sees("marked").presses("w");
    operator.sees_so_often("watched", 2);
    operator.presses("3").sees("verified").sees("/robot1/");
    operator.presses("f").sees("FROZEN").presses("/verified\r").presses("\u{1b}[H");
    operator.presses("f").no_longer_sees("FROZEN").presses_until("\r", "SM3 ");
    operator.presses("\u{1b}[6~").sees(" to the root").presses("q");
    operator.presses("1").sees(" = ").sees("balanced");
    operator.leaves();
}

/// Alice has verified records; Bob is registered.
fn alice_and_bob(home: &Home) -> (Authros, Authros, String) {
    let (alice, bob) = (one_robot(home.profile("alice")), one_robot(home.profile("bob")));
    alice.enrol();
    let address = bob.enrol();
    alice.run(&["capture", "--count", "3", "--topic", ODOMETRY, "--tag", "mission=harbour"]).expect_code(0);
    (alice, bob, address)
}

#[test]
fn a_grant_reaches_a_second_console_that_opens_a_record_and_a_revoke_ends_it() {
    let _alone = heavy();
    let home = Home::new();
    let (alice, bob, address) = alice_and_bob(&home);
    let mut alice = Operator::opens(&alice);
    alice.sees(ODOMETRY).presses("5").sees("No grants given");
    alice.presses("g").sees("Lets another account").presses(&address).presses("\rall\r\repoch\r");
    alice.sees("Current readers:").presses("g").no_longer_sees("Current readers:");
    alice.presses("\r").sees("Current readers:").presses("y").sees("1 can read new records now");
    alice.presses("i").sees("Revoking does not undo reads").presses("q");

    let mut bob = Operator::opens(&bob);
    bob.presses("4")
        .sees(ODOMETRY)
        .presses("b")
        .sees("All records")
        .sees("shares all topics")
        .presses("\u{1b}[B\r")
        .sees("filter: owner:0x");
    bob.presses("/").presses(" tag:mission=elsewhere\r").no_longer_sees(ODOMETRY);
    bob.clears_the_filter()
        .sees(ODOMETRY)
        .presses("/tag:mission=harbour type:nav_msgs/Odometry\r")
        .sees("filter: tag:mission");
    bob.presses_until("\r", "digest matches the chain").sees("nav_msgs/Odometry").presses("q");

    alice.presses("x").sees("cannot be taken back").presses("x").no_longer_sees("cannot be taken back");
    alice.presses("x").sees("cannot be taken back").presses("y").sees("0 can read new records now");
    bob.no_longer_sees(ODOMETRY);
    bob.leaves();
    alice.leaves();
}

#[test]
fn filter_order_and_screen_are_there_again_at_the_next_start() {
    let home = Home::new();
    let authros = one_robot(home.authros());
    let mut operator = Operator::opens(&authros);
    operator.presses("2").sees(CAMERA).presses("s").sees("by Hz").presses("/odom\r").no_longer_sees(CAMERA);
    operator.presses("t").sees("Tasks").presses("q").presses("f").sees("FROZEN").presses("f").no_longer_sees("FROZEN");
    operator.leaves();
    let mut again = Operator::opens(&authros);
    again.sees("by Hz").sees("filter: odom").sees(ODOMETRY);
    assert!(!again.0.shown().contains(CAMERA), "the filter holds");
    again.clears_the_filter().sees(CAMERA);
    again.leaves();
}

#[test]
fn a_locked_console_captures_on_and_opens_nothing_until_it_is_unlocked() {
    let _alone = heavy();
    let home = Home::new();
    let authros = one_robot(home.authros());
    let passphrase = home.file("passphrase", PASSPHRASE, 0o600);
    authros.with(&["--passphrase-file", &passphrase]).enrol();
    let mut operator = Operator::opens(&authros);
    operator.sees("Unlock the keyring").sees("LOCKED").presses(PASSPHRASE).presses("\r").no_longer_sees("LOCKED");
    authros.run(&["topics", "watch", ODOMETRY]).expect_code(0);
    operator.presses("3").sees("verified");

    // The message about it may soon be overtaken by other news; the Keys screen says it as long as it holds.
    operator.presses(":lock\r");
    operator.presses("6").sees("locked (u unlocks it)");
    let verified = || {
        let records = authros.records(&["records", "list", "--oldest", "--state", "verified"]);
        records.len()
    };
    let before = verified();
    wait_until(PATIENCE, "records are verified while the keyring is locked", || {
        Some(()).filter(|()| verified() > before + 3)
    });
    let id = text(&authros.records(&["records", "list", "--oldest"])[0], "id");
    let refused = authros.fails(5, &["records", "open", &id]);
    assert!(refused.contains("locked"), "{refused}");

    operator.presses("u").sees("Unlock").presses("not the passphrase\r").sees("wrong passphrase");
    operator.presses("\u{15}").presses(PASSPHRASE).presses("\r");
    wait_until(PATIENCE, "the keyring to be open again", || {
        Some(()).filter(|()| authros.json(&["identity", "show"])["unlocked"] == true)
    });
    authros.run(&["topics", "unwatch", ODOMETRY]).expect_code(0);
    let opened = authros.json(&["records", "open", &id]);
    assert_eq!(opened["topic"], ODOMETRY);
    let audit = authros.json(&["audit", "list"])["audit"].to_string();
    assert!(audit.contains("\"lock\"") && audit.contains("\"unlock\"") && audit.contains("refused"), "{audit}");
    operator.leaves();
}

/// A profile with a keyring that only its operator can open.
fn locked_profile(home: &Home) -> Authros {
    let authros = one_robot(home.authros());
    let passphrase = home.file("passphrase", PASSPHRASE, 0o600);
    authros.with(&["--passphrase-file", &passphrase]).enrol();
    authros
}

#[test]
fn after_a_restart_nothing_is_silently_off_and_leaving_says_what_stops() {
    let _alone = heavy();
    let home = Home::new();
    let authros = locked_profile(&home);
    let mut operator = Operator::opens(&authros);
    operator.sees("Unlock the keyring").sees("LOCKED").presses(PASSPHRASE).presses("\r").no_longer_sees("LOCKED");
    operator.presses("2").sees(CAMERA).presses("/odom\r").no_longer_sees(CAMERA).presses("w").sees("watched");
    operator.sees("HOST").presses("q").sees("Quitting stops the capture of /robot1/odom.");
    operator.presses("d");
    wait_until(PATIENCE, "all to be verified and the console to end", || Some(()).filter(|()| operator.0.has_ended()));

    let mut operator = Operator::opens(&authros);
    operator.sees("Unlock the keyring").presses("\u{1b}").no_longer_sees("Unlock the keyring");
    operator.sees("LOCKED").sees("waits for key").presses("1").sees("capture of 1 topic waits for the key");
    operator.presses("u").sees("Unlock the keyring").presses(PASSPHRASE).presses("\r").no_longer_sees("LOCKED");
    operator.presses("2").sees("watched");
    operator.leaves();
}

#[test]
fn a_console_that_joined_a_site_says_that_capture_continues_there() {
    let _alone = heavy();
    let home = Home::new();
    let authros = one_robot(home.authros());
    authros.enrol();
    authros.run(&["topics", "watch", ODOMETRY]).expect_code(0);
    let mut site = authros.serve(&home);
    wait_until(PATIENCE, "the site to listen", || home.socket());
    let mut operator = Operator::opens(&authros);
    operator.sees(&format!("JOINED {}", site.id())).presses("2").sees("watched");
    operator.presses("q");
    let asked = |operator: &mut Operator| operator.0.has_ended() || operator.0.shown().contains("Quit?");
    wait_until(PATIENCE, "the console to leave or to ask", || Some(()).filter(|()| asked(&mut operator)));
    if !operator.0.has_ended() {
        operator.sees("The capture of /robot1/odom continues in the site").presses("y");
    }
    wait_until(PATIENCE, "the console to end", || Some(()).filter(|()| operator.0.has_ended()));
    assert!(site.is_running(), "the site goes on");
}

#[test]
fn a_moving_record_is_aimed_at_opened_searched_for_and_left_while_others_come() {
    let _alone = heavy();
    let home = Home::new();
    let authros = one_robot(home.authros());
    authros.enrol();
    authros.run(&["topics", "watch", ODOMETRY]).expect_code(0);
    authros.run(&["topics", "watch", CAMERA]).expect_code(0);
    for (columns, rows) in [(80, 24), (200, 50)] {
        let mut operator = Operator(Console::open_in(&Terminal::of(columns, rows), &authros, &[]));
        operator.presses("3").sees_so_often("verified", 3).presses("\u{1b}[B\u{1b}[B").sees("as of");
        // The screen may be seen after the first of the two keys, or while a frame is still being written.
        let third =
            |shown: &str| shown.lines().skip_while(|line| !line.contains("Topic ")).nth(3).map(is_at_the_cursor);
        wait_until(PATIENCE, "the cursor to be at the third row", || {
            Some(()).filter(|()| third(&operator.0.shown()) == Some(true))
        });
        let aimed = selected(&operator.0.shown());
        let newest = || authros.records(&["records", "list"]);
        let before = text(&newest()[0], "id");
        wait_until(PATIENCE, "others to come", || Some(()).filter(|()| text(&newest()[0], "id") != before));
        assert_eq!(selected(&operator.0.shown()), aimed, "the record stays under the cursor");
        operator
            .presses("\r")
            .sees("┌ Provenance")
            .presses("n")
            .presses("p")
            .presses("q")
            .no_longer_sees("┌ Provenance");
        operator.presses("\u{1b}[H").no_longer_sees("as of");
        operator.presses("/camera\r").no_longer_sees(ODOMETRY).sees(CAMERA).presses("/\u{15}\r").sees(ODOMETRY);
        operator.presses("f").sees("FROZEN").presses("\u{1b}[6~").sees("as of").presses("f").no_longer_sees("FROZEN");
        operator.leaves();
    }
}

fn is_at_the_cursor(row: &str) -> bool {
    row.starts_with('▌')
}

/// Topic, sequence number, size and time of the row at the cursor: the part that does not change.
fn selected(shown: &str) -> Vec<String> {
    let row = shown.lines().find(|line| is_at_the_cursor(line)).expect("a row with the cursor");
    // On a wide terminal the pane is beside the list.
    let row = row.split('│').next().unwrap_or_default();
    let mut words: Vec<String> =
        row.split_whitespace().skip_while(|word| !word.starts_with('/')).map(str::to_owned).collect();
    let time = words.iter().position(|word| word.contains(':')).expect("a time");
    words.truncate(time + 1);
    words
}

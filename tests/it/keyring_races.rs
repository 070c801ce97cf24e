//! Requests that come while a keyring is being opened, and kills while it is saved: no epoch loses its key. A lost key
//! shows as an epoch of the chain that the keyring lacks, and as records that no longer open.

use std::time::{Duration, Instant};

use crate::support::{Authros, Home, Running, count, faulty, length, long, poll, skipped, wait_until};
use authros::crypto::{Keyring, Passphrase};

const TOPIC: &str = "/robot1/odom";

/// A registered profile that captures a topic with each start of its site.
struct Field {
    home: Home,
    alice: Authros,
}

impl Field {
    fn new() -> Self {
        let home = Home::new();
        let alice = home.profile("alice").with(&["--robots", "1"]);
        let site = alice.serve(&home);
        alice.json(&["topics", "watch", TOPIC]);
        site.stop("TERM", 30).expect_code(0);
        Self { home, alice }
    }

    /// A site that starts, and two commands that unlock the keyring at the same moment as the site does.
    fn start_with_two(&self, program: &Authros, pause: Duration) -> [Running; 3] {
        let mut site = program.spawn(&["serve"]);
        // One that is to end while it saves may end before.
        wait_until(60, "a socket", || (self.home.socket().is_some() || !site.is_running()).then_some(()));
        let looks = self.alice.spawn(&["grant", "list"]);
        std::thread::sleep(pause);
        [site, looks, self.alice.spawn(&["keys", "rotate"])]
    }

    fn epochs_of_the_keyring(&self) -> Vec<u64> {
        let directory = self.home.path().join("profiles/alice");
        let passphrase = std::fs::read_to_string(directory.join("passphrase")).expect("a passphrase");
        let passphrase = Passphrase::new(passphrase.trim_end().to_owned()).expect("long enough");
        let keyring = Keyring::load(&directory.join("keyring"), &passphrase).expect("the keyring opens");
        keyring.networks.values().flat_map(|network| network.epochs.keys().copied()).collect()
    }

    /// The chain's epoch, of which and of all before it the keyring has the keys; it may have begun one more.
    fn epoch_with_all_keys(&self) -> u64 {
        let on_chain = count(&self.alice.json(&["identity", "show"]), "epoch");
        let in_keyring = self.epochs_of_the_keyring();
        let missing: Vec<u64> = (1..=on_chain).filter(|epoch| !in_keyring.contains(epoch)).collect();
        assert!(missing.is_empty(), "chain {on_chain}, keyring {in_keyring:?}: the keys of {missing:?} are lost");
        on_chain
    }

    /// Ends with an error if one record cannot be opened.
    fn every_record_opens(&self) {
        let file = self.home.root().join("all.mcap");
        self.alice.json(&["bag", "export", "--unanchored", "--mcap", file.to_str().expect("UTF-8")]);
    }
}

#[test]
fn two_commands_at_the_start_of_a_site_lose_no_epochs_key() {
    let field = Field::new();
    let (end, mut epochs) = (Instant::now() + Duration::from_secs(60), vec![1]);
    for cycle in 0..20 {
        if Instant::now() > end {
            break;
        }
        let [site, looks, rotates] = field.start_with_two(&field.alice, Duration::from_millis(cycle * 37 % 120));
        looks.wait(60).expect_code(0);
        rotates.wait(60).expect_code(0);
        epochs.push(field.epoch_with_all_keys());
        field.alice.json(&["keys", "rotate"]);
        epochs.push(field.epoch_with_all_keys());
        assert_eq!(field.epochs_of_the_keyring().len() as u64, epochs[epochs.len() - 1], "and no others");
        site.stop("TERM", 30).expect_code(0);
    }
    let expected: Vec<u64> = (1..).take(epochs.len()).collect();
    assert_eq!(epochs, expected, "each rotation is one epoch");
    field.every_record_opens();
}

#[test]
fn kills_while_a_keyring_is_saved_lose_no_epochs_key() {
    let Some(program) = faulty() else { skipped!("no authros-faulty (cargo test builds it with the examples)") };
    let field = Field::new();
    let end = Instant::now() + length(Duration::from_secs(45), Duration::from_secs(3600));
    let (mut epoch, cycles) = (1, if long() { 400 } else { 12 });
    for cycle in 0..cycles {
        if Instant::now() > end {
            break;
        }
        // The first save is the note of a new epoch, the second that the chain has it.
        let place = ["keyring-compared:1", "keyring-written:1", "keyring-compared:2", "keyring-written:2", "none"];
        let faulty = field.alice.with_program(&program).with_variable("AUTHROS_FAIL_POINT", place[cycle % place.len()]);
        let pause = Duration::from_millis(u64::try_from(cycle * 37 % 120).expect("small"));
        let [mut site, looks, rotates] = field.start_with_two(&faulty, pause);
        // A site that does not reach the place is killed at some moment of the rotation.
        let patience = if place[cycle % place.len()] == "none" { cycle * 53 % 900 } else { 3_000 };
        let patience = Instant::now() + Duration::from_millis(u64::try_from(patience).expect("small"));
        poll(5, || (!site.is_running() || Instant::now() > patience).then_some(()));
        site.signal("KILL");
        drop(site);
        // Without the site they may fail, or start one of their own; both is fine.
        drop((looks.wait(60), rotates.wait(60)));

        let site = field.alice.serve(&field.home);
        let now = field.epoch_with_all_keys();
        assert!(now >= epoch, "epochs never go back");
        field.alice.json(&["keys", "rotate"]);
        epoch = field.epoch_with_all_keys();
        assert!(epoch > now, "it goes on");
        site.stop("KILL", 10);
    }
    field.every_record_opens();
}

#[test]
fn an_older_keyring_gets_what_it_lacks_from_the_chain() {
    let field = Field::new();
    let site = field.alice.serve(&field.home);
    let old = field.home.root().join("old.keyring");
    field.alice.run(&["keys", "backup", "--out", old.to_str().expect("UTF-8")]).expect_code(0);
    let captured = || field.alice.records(&["records", "list", "--oldest", "--topic", TOPIC]).len();
    for _ in 0..3 {
        field.alice.json(&["keys", "rotate"]);
        let before = captured();
        wait_until(60, "records of this epoch", || (captured() >= before + 3).then_some(()));
    }
    field.alice.json(&["keys", "rotate", "--envelope"]);
    field.alice.json(&["keys", "rotate"]);
    field.alice.json(&["keys", "rotate", "--envelope"]);
    let newest = field.alice.json(&["keys", "list"]);
    site.stop("TERM", 30).expect_code(0);

    let place = field.home.path().join("profiles/alice/keyring");
    std::fs::copy(&old, &place).expect("put back");
    assert_eq!(field.epochs_of_the_keyring(), [1], "it knows the first epoch alone");
    // Without the keys on the chain this site ends at once, and so does each command that unlocks.
    let site = field.alice.serve(&field.home);
    wait_until(60, "the chain returns the keys", || (field.epochs_of_the_keyring().len() == 5).then_some(()));
    assert_eq!(field.epoch_with_all_keys(), 5);
    let now = field.alice.json(&["keys", "list"]);
    assert_eq!((&now["envelope_key"], &now["epochs"]), (&newest["envelope_key"], &newest["epochs"]));
    field.every_record_opens();
    let before = captured();
    wait_until(60, "capture goes on", || (captured() >= before + 3).then_some(()));
    field.alice.json(&["keys", "rotate"]);
    assert_eq!(field.epoch_with_all_keys(), 6);
    site.stop("TERM", 30).expect_code(0);
}

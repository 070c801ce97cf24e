//! A machine that captures at boot without its owner's keys, as boot.md has it: an agent and a gateway with a home of its own,
//! both started by systemd. Its power is cut, it boots again, nobody logs in.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;

use authros::crypto::{EoaSecret, Keyring, Passphrase, SealedEnrolment};
use authros::model::Timestamp;
use serde_json::Value;
use support::authros::files_below;
use support::machine::Machine;
use support::memory::{found_in, memory_of, secrets_below};
use support::{
    Authros, Home, Running, count, free_port, heavy, hex, holds, is_verified, list, skipped, text, wait_until,
};

const TOPIC: &str = "/robot1/odom";
const WORDS_OF_GATEWAY: &str = "words that the gateway's home opens with";
/// Records verified before the power is cut, and after the machine has come back.
const ENOUGH: u64 = 20;

/// Nodes of ROS 1 elsewhere in the machine's network.
fn robots(home: &Home) -> (Running, String) {
    let mut nodes = home.authros().with(&["--robots", "1", "--json"]).spawn(&["serve"]);
    let said = nodes.wait_for_text("ros_master", 120);
    let line = said.lines().find(|line| line.contains("ros_master")).expect("a document");
    let ready: Value = serde_json::from_str(line).expect("JSON");
    (nodes, text(&ready, "ros_master"))
}

/// A machine with a gateway and an agent, and its owner elsewhere.
struct Scene {
    machine: Machine,
    owner_home: Home,
    owner: Authros,
    enrolment: SealedEnrolment,
    words_of_robot: String,
}

impl Scene {
    /// Every step of boot.md.
    fn new(mut machine: Machine, ros_master: &str) -> Self {
        let address = format!("127.0.0.1:{}", free_port());
        machine.boot();
        machine.encrypt_passphrase("authros-gateway", WORDS_OF_GATEWAY, "/etc/authros/gateway.credential");
        machine.write("etc/authros/gateway.env", &format!("GATEWAY_LISTEN={address}\n"));
        machine.root(&["systemctl", "enable", "--now", "authros-gateway"]).expect_code(0);
        let key = key_of(&machine.log("authros-gateway"));

        let owner_home = Home::new();
        let owner = owner_home.profile("alice").with(&["--site", &address]).with_variable("AUTHROS_GATEWAY_KEY", &key);
        let account = owner.enrol();
        machine.authros("authros-gateway", &["gateway", "allow", &account]).expect_code(0);
        let out = owner_home.root().join("scout-1.enrolment");
        let file = out.to_str().expect("UTF-8");
        let enrol =
            ["robot", "enrol", "--gateway", &address, "--gateway-key", &key, "--name", "scout-1", "--topic", TOPIC];
        owner.json(&[&enrol[..], &["--out", file]].concat());

        let words_of_robot = fs::read_to_string(format!("{file}.passphrase")).expect("written").trim_end().to_owned();
        let passphrase = Passphrase::new(words_of_robot.clone()).expect("long enough");
        let enrolment = SealedEnrolment::open(&out, &passphrase).expect("opens");
        fs::copy(&out, machine.disk().join("etc/authros/robot.enrolment")).expect("brought");
        machine.encrypt_passphrase("authros-agent", &words_of_robot, "/etc/authros/robot.credential");
        machine.write("etc/authros/agent.env", &format!("ROS_MASTER_URI={ros_master}\n"));
        machine.root(&["systemctl", "enable", "--now", "authros-agent"]).expect_code(0);
        Self { machine, owner_home, owner, enrolment, words_of_robot }
    }

    /// The newest figures that the agent printed.
    fn figures(&self) -> Option<Value> {
        let log = self.machine.log("authros-agent");
        log.lines().rev().find_map(|line| serde_json::from_str(line).ok())
    }

    /// Waits until the agent has the proofs of this many records.
    fn proven(&self, least: u64) -> u64 {
        wait_until(180, "records are captured, anchored and verified", || {
            let figures = self.figures()?;
            assert_eq!((count(&figures, "lost"), count(&figures, "tampered")), (0, 0), "{figures}");
            Some(count(&figures, "verified")).filter(|verified| *verified >= least)
        })
    }
}

/// `gateway at ADDRESS, key HEX (fingerprint ...)`
fn key_of(log: &str) -> String {
    let after = log.split(", key ").nth(1).unwrap_or_else(|| panic!("no key in {log}"));
    after.split_whitespace().next().expect("the key").to_owned()
}

#[test]
fn a_machine_that_rebooted_captures_anchors_and_verifies_and_holds_nothing_of_its_owner() {
    let _alone = heavy();
    let machine = match Machine::new() {
        Ok(machine) => machine,
        Err(reason) => skipped!(reason),
    };
    let elsewhere = Home::new();
    let (_nodes, ros_master) = robots(&elsewhere);
    let mut scene = Scene::new(machine, &ros_master);
    scene.proven(ENOUGH);

    // A process that dies is started again.
    scene.machine.root(&["systemctl", "kill", "--signal=KILL", "authros-gateway", "authros-agent"]).expect_code(0);
    for unit in ["authros-gateway", "authros-agent"] {
        wait_until(60, "the unit is started again", || {
            let shown = scene.machine.root(&["systemctl", "show", "--property=ActiveState,NRestarts", unit]).stdout;
            (shown.contains("ActiveState=active") && !shown.contains("NRestarts=0")).then_some(())
        });
    }
    scene.machine.cut_power();
    let before = scene.figures().map(|figures| count(&figures, "verified")).expect("figures");

    // From here to the end of the wait nobody does anything at the machine.
    let booted = Timestamp::now();
    scene.machine.boot();
    scene.proven(before + ENOUGH);

    let audit = scene.machine.authros("authros-gateway", &["audit", "--deep"]).expect_code(0).document();
    assert_eq!(audit["findings"], serde_json::json!([]), "{audit}");
    expect_readable(&scene, booted);

    let secrets = secrets_of_owner(&scene);
    expect_none_in_memory(&scene, &secrets);
    scene.machine.cut_power();
    expect_none_on_disk(&scene, &secrets);
}

/// Passphrase and keys of the owner, as bytes and as text.
fn secrets_of_owner(scene: &Scene) -> Vec<(String, Vec<u8>)> {
    let secrets = secrets_below(&scene.owner_home.path());
    let names: BTreeSet<&str> = secrets.iter().filter_map(|(name, _)| name.split(" of ").next()).collect();
    assert!(names.len() >= 7, "passphrase, five keys, that of an epoch: {names:?}");
    let as_text = secrets.iter().map(|(name, secret)| (format!("{name}, as text"), hex(secret).into_bytes()));
    as_text.chain(secrets.iter().cloned()).collect()
}

fn expect_none_in_memory(scene: &Scene, secrets: &[(String, Vec<u8>)]) {
    let lent = ("lent key".to_owned(), scene.enrolment.enrolment.device.secret.expose().to_vec());
    let own = ("account of the gateway".to_owned(), account_of_gateway(&scene.machine).expose().to_vec());
    let mut held = BTreeSet::new();
    let processes = scene.machine.processes();
    assert_eq!(processes.len(), 2, "{processes:?}");
    for process in processes {
        let memory = memory_of(&process).expect("of a process of ours");
        assert_eq!(found_in(&memory, secrets), Vec::<&str>::new(), "keys of the owner");
        held.extend(found_in(&memory, &[lent.clone(), own.clone()]).into_iter().map(str::to_owned));
    }
    assert_eq!(held, BTreeSet::from([lent.0, own.0]), "the search finds what is there");
}

fn expect_none_on_disk(scene: &Scene, secrets: &[(String, Vec<u8>)]) {
    let mut met = false;
    let is_file = |path: &PathBuf| fs::symlink_metadata(path).is_ok_and(|about| about.is_file());
    for path in files_below(&scene.machine.disk()).into_iter().filter(is_file) {
        let bytes = fs::read(&path).expect("a file");
        assert_eq!(found_in(&bytes, secrets), Vec::<&str>::new(), "{}", path.display());
        for words in [WORDS_OF_GATEWAY, &scene.words_of_robot] {
            assert!(!holds(&bytes, words.as_bytes()), "{}: credentials are encrypted", path.display());
        }
        met |= holds(&bytes, b"GATEWAY_LISTEN=127.0.0.1");
    }
    assert!(met, "the search finds what is there");
}

fn account_of_gateway(machine: &Machine) -> EoaSecret {
    let keyring = machine.disk().join("var/lib/authros-gateway/profiles/default/keyring");
    let passphrase = Passphrase::new(WORDS_OF_GATEWAY.to_owned()).expect("long enough");
    Keyring::load(&keyring, &passphrase).expect("it opens").eoa
}

/// The owner has records of before the power cut and of after it, signed by the agent and anchored by the gateway, and
/// opens them.
fn expect_readable(scene: &Scene, booted: Timestamp) {
    let _site = scene.owner.serve(&scene.owner_home);
    let is_after = |record: &Value| {
        let captured: Timestamp = serde_json::from_value(record["captured_at"].clone()).expect("a time");
        captured > booted
    };
    let (before, after) = wait_until(120, "the owner has the records", || {
        let records =
            scene.owner.records_so_far(&["records", "list", "--oldest", "--topic", TOPIC, "--kind", "data"])?;
        let (after, before): (Vec<Value>, Vec<Value>) = records.into_iter().filter(is_verified).partition(is_after);
        let enough = [before.len(), after.len()].into_iter().all(|count| count as u64 >= ENOUGH);
        enough.then_some((before, after))
    });
    let signer = scene.enrolment.enrolment.device_id().to_string();
    let account = account_of_gateway(&scene.machine).address().to_string();
    for record in [before.first(), before.last(), after.first(), after.last()].into_iter().flatten() {
        let id = text(record, "id");
        let opened = scene.owner.json(&["records", "open", &id]);
        assert_eq!((&opened["verdict"], &opened["topic"]), (&"verified".into(), &TOPIC.into()), "{opened}");
        let steps = list(&scene.owner.json(&["records", "show", &id]), "steps");
        for word in [&signer, &account] {
            assert!(steps.iter().any(|step| step.to_string().contains(word)), "no {word} in {steps:?}");
        }
    }
}

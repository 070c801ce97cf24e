//! Every request there is, from the names that the reader of its lines lists, with the right it needs.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use std::collections::{BTreeMap, BTreeSet};

use super::{Command, Kind, Needed};
use crate::model::OperatorRight;
use crate::wire_tests::REQUESTS;

/// Requests that the list of lines has no example of.
const FURTHER: &[&str] = &[
    r#"{"command":"enrol_device","addresses":["h:1"],"fingerprint":null,"name":"scout","topics":[],"all_topics":true,"until":null,"passphrase":"p"}"#,
    r#"{"command":"add_device_address","device":"scout","address":"h:1"}"#,
    r#"{"command":"play","owner":null,"topics":[],"since":null,"until":null,"pace":"at_once","clock":false,"prefix":null,"remaps":[],"master":null}"#,
    r#"{"command":"stop_play"}"#,
    r#"{"command":"erase_records","topic":"/odom","robot":"scout","since":null,"until":null,"records":[],"recording":null,"reason":"asked","sure":true,"shown":7}"#,
    r#"{"command":"of_robot","robot":"list_robots"}"#,
    r#"{"command":"of_robot","robot":"show_robot","name":"scout"}"#,
    r#"{"command":"of_robot","robot":"set_robot_policy","name":"scout","text":""}"#,
];

/// Groups of requests, and the key that tells their members apart.
const GROUPS: &[(&str, &str)] = &[("of_incident", "incident"), ("of_robot", "robot")];

const LOOK: &[&str] = &[
    "show_identity",
    "list_keys",
    "foresee_key_change",
    "foresee_grant",
    "list_topics",
    "topic_coverage",
    "list_pins",
    "list_quarantine",
    "show_policy",
    "recording_progress",
    "list_uploads",
    "show_upload",
    "list_grants",
    "list_shared",
    "check_shared",
    "list_devices",
    "compare_fingerprint",
    "list_contacts",
    "chain_status",
    "list_successions",
    "site_status",
    "list_audit",
    "verify_audit",
    "open_console",
    "audit_records",
    "list_alerts",
    "gateway_status",
    "list_admitted",
    "of_incident list_incidents",
    "of_incident show_incident",
    "of_robot list_robots",
    "of_robot show_robot",
];
const CAPTURE: &[&str] =
    &["watch_topic", "unwatch_topic", "pin_topic", "unpin_topic", "capture", "stop_capture", "hold_capture"];
const GRANT: &[&str] = &["grant", "extend_grant", "revoke"];
const PASSPHRASE: &[&str] = &[
    "create_identity",
    "unlock",
    "load_key",
    "change_passphrase",
    "export_key",
    "enrol_device",
    "back_up",
    "restore_keys",
    "make_join_file",
];

/// What a gateway's home on a server leaves to other homes.
const ELSEWHERE: &[&str] = &[
    "add_contact",
    "add_device_address",
    "add_device_topics",
    "back_up",
    "capture",
    "check_shared",
    "confirm_contact",
    "discard_held",
    "enrol_device",
    "erase_records",
    "export_evidence",
    "export_recording",
    "export_upload",
    "extend_grant",
    "follow_folder",
    "foresee_grant",
    "foresee_key_change",
    "grant",
    "hold_capture",
    "import_home",
    "import_recording",
    "lend_device",
    "list_shared",
    "load_key",
    "of_incident close_incident",
    "of_incident note_incident",
    "of_incident open_incident",
    "of_incident remove_incident",
    "of_robot pull_ring",
    "of_robot set_robot_policy",
    "open_shared",
    "pin_topic",
    "play",
    "recall_device",
    "release_held",
    "remove_contact",
    "revoke",
    "rotate_envelope",
    "rotate_keys",
    "stop_capture",
    "stop_play",
    "unpin_topic",
    "unwatch_topic",
    "view_file",
    "view_path",
    "watch_topic",
];

/// What may stand at a place of a line, as its reader lists it when it finds something else.
fn listed(line: &str) -> Vec<String> {
    let error = serde_json::from_str::<Command>(line).expect_err("there is no such request").to_string();
    let (_, names) = error.split_once("expected").unwrap_or_else(|| panic!("a list of names: {error}"));
    names.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}

/// The names of all requests.
fn all() -> BTreeSet<String> {
    let grouped = |name: &String| GROUPS.iter().any(|(group, _)| group == name);
    let mut names: BTreeSet<String> = listed(r#"{"command":"?"}"#).into_iter().filter(|name| !grouped(name)).collect();
    for (group, key) in GROUPS {
        let members = listed(&format!(r#"{{"command":"{group}","{key}":"?"}}"#));
        assert!(!members.is_empty(), "{group}");
        names.extend(members.iter().map(|member| format!("{group} {member}")));
    }
    names
}

fn name(line: &str) -> String {
    let read: serde_json::Value = serde_json::from_str(line).expect("JSON");
    let command = read["command"].as_str().expect("a command");
    let key = GROUPS.iter().find(|(group, _)| *group == command).map(|(_, key)| *key);
    let member = key.and_then(|key| read[key].as_str());
    member.map_or_else(|| command.to_owned(), |member| format!("{command} {member}"))
}

#[test]
fn each_request_needs_the_right_that_the_pages_say() {
    let right = Needed::Right;
    let lists = [
        (LOOK, right(OperatorRight::Look)),
        (CAPTURE, right(OperatorRight::Capture)),
        (GRANT, right(OperatorRight::Grant)),
        (PASSPHRASE, Needed::Passphrase),
    ];
    let mut found = BTreeMap::new();
    for line in REQUESTS.iter().chain(FURTHER) {
        let command: Command = serde_json::from_str(line).unwrap_or_else(|error| panic!("{line}: {error}"));
        found.insert(name(line), command.needs());
    }
    let seen: BTreeSet<String> = found.keys().cloned().collect();
    assert_eq!(seen, all(), "an example of each request");
    for (list, _) in lists {
        assert!(list.iter().all(|name| seen.contains(*name)), "{list:?}");
    }
    for (name, needs) in found {
        let expected = lists.iter().find(|(list, _)| list.contains(&name.as_str()));
        assert_eq!(needs, expected.map_or(Needed::Owner, |(_, needs)| *needs), "{name}");
    }
}

#[test]
fn a_gateway_on_a_server_leaves_to_other_homes_what_it_has_no_tables_for() {
    let lines = REQUESTS.iter().chain(FURTHER);
    let refused: BTreeSet<String> = lines
        .filter(|line| {
            let command: Command = serde_json::from_str(line).expect("a request");
            let refused = command.check_on_server().err();
            let is_told = |failure: &crate::Failure| {
                failure.kind == crate::model::ErrorKind::Refused && failure.message.contains("store.url")
            };
            assert!(refused.as_ref().is_none_or(is_told), "{refused:?}");
            refused.is_some()
        })
        .map(|line| name(line))
        .collect();
    assert_eq!(refused, ELSEWHERE.iter().map(|name| (*name).to_owned()).collect());
}

#[test]
fn a_request_with_a_passphrase_is_known_by_its_kind_alone() {
    for line in REQUESTS.iter().chain(FURTHER) {
        let kind: Kind = serde_json::from_str(line).expect("tags");
        let command: Command = serde_json::from_str(line).expect("a request");
        assert_eq!(kind.carries_passphrase(), command.needs() == Needed::Passphrase, "{line}");
        let has_one = line.contains(r#""passphrase":"#) || line.contains(r#""old":"#);
        assert!(kind.carries_passphrase() || !has_one, "{line}");
    }
    let twice = r#"{"command":"list_grants","command":"unlock","passphrase":"p"}"#;
    assert!(serde_json::from_str::<Kind>(twice).is_err(), "one kind only");
}

//! The lines of site.sock, to the letter: a process of another build joins the same site. Each is read and written
//! again, so a request or an answer whose form changes is noticed here.

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::{Command, Reply};

pub(crate) const REQUESTS: &[&str] = &[
    r#"{"command":"create_identity","passphrase":"p"}"#,
    r#"{"command":"show_identity"}"#,
    r#"{"command":"unlock","passphrase":"p"}"#,
    r#"{"command":"register"}"#,
    r#"{"command":"list_keys"}"#,
    r#"{"command":"load_key","kind":"sm2","path":"/k.pem","passphrase":null}"#,
    r#"{"command":"rotate_keys"}"#,
    r#"{"command":"rotate_envelope"}"#,
    r#"{"command":"foresee_key_change","kind":"envelope"}"#,
    r#"{"command":"change_passphrase","old":"p","new":"q"}"#,
    r#"{"command":"export_key","kind":"eoa","passphrase":"p"}"#,
    r#"{"command":"list_topics"}"#,
    r#"{"command":"topic_coverage","topic":"/robot*/odom","since":null,"until":"2026-01-01T00:00:00Z","parts":60}"#,
    r#"{"command":"topic_coverage","topic":null,"robot":"scout-1","since":null,"until":null,"parts":60}"#,
    r#"{"command":"watch_topic","topic":"/odom","type_name":"nav_msgs/Odometry"}"#,
    r#"{"command":"unwatch_topic","topic":"/odom"}"#,
    r#"{"command":"list_pins","topic":null}"#,
    r#"{"command":"pin_topic","topic":"/odom","publishers":[]}"#,
    r#"{"command":"unpin_topic","topic":"/odom","caller_id":"/node"}"#,
    r#"{"command":"list_quarantine","topic":"/odom","limit":100}"#,
    r#"{"command":"release_held","held":{"topic":"/odom","ids":[]}}"#,
    r#"{"command":"discard_held","held":{"topic":null,"ids":["0a"]}}"#,
    r#"{"command":"capture","topics":["/odom"],"type_name":null,"count":3,"milliseconds":null,"tags":[["a","b"]]}"#,
    r#"{"command":"stop_capture"}"#,
    r#"{"command":"import_recording","path":"/a.bag","topics":[],"tags":[],"again":false}"#,
    r#"{"command":"follow_folder","folder":"/a","topics":[],"tags":[],"until_closed":true}"#,
    r#"{"command":"import_home","home":"/h"}"#,
    r#"{"command":"export_recording","path":"/a.mcap","format":"mcap","compression":"none","owner":null,"topics":[],"since":null,"until":null,"unanchored":false}"#,
    r#"{"command":"recording_progress"}"#,
    r#"{"command":"show_policy"}"#,
    r#"{"command":"list_uploads","owner":null,"topic":"/odom","kind":"data","type_name":null,"tags":[],"state":"verified","since":null,"until":null,"after":null,"limit":10,"newest_first":true}"#,
    r#"{"command":"list_shared","owner":"bob","topic":null,"kind":null,"type_name":null,"tags":[],"state":null,"since":null,"until":null,"after":"x","limit":10,"newest_first":false}"#,
    r#"{"command":"show_upload","id":"0a"}"#,
    r#"{"command":"export_upload","id":"0a","addresses":true}"#,
    r#"{"command":"export_evidence","file":"/a.authros","records":["0a"],"since":null,"until":null,"reveal":[],"sure":true}"#,
    r#"{"command":"export_evidence","file":"/a.authros","records":[],"incident":"crash","since":null,"until":null,"reveal":[],"reveal_topics":["/odom"],"reveal_all":true,"sure":false}"#,
    r#"{"command":"stamp_evidence"}"#,
    r#"{"command":"grant","grantee":"bob","topics":["/odom"],"from":"now","expires":null}"#,
    r#"{"command":"grant","grantee":"bob","topics":[],"from":{"time":"2026-01-01T00:00:00Z"},"expires":null}"#,
    r#"{"command":"foresee_grant","grantee":"bob","topics":[],"from":{"epoch":1}}"#,
    r#"{"command":"extend_grant","grantee":"bob","expires":null}"#,
    r#"{"command":"revoke","grantee":"bob"}"#,
    r#"{"command":"list_grants"}"#,
    r#"{"command":"check_shared","id":"0a"}"#,
    r#"{"command":"open_shared","id":"0a"}"#,
    r#"{"command":"view_file","id":"0a","kind":null}"#,
    r#"{"command":"view_path","id":"0a","records":20}"#,
    r#"{"command":"lend_device","device":"0707070707070707070707070707070707070707070707070707070707070707","until":null}"#,
    r#"{"command":"recall_device","device":"0a"}"#,
    r#"{"command":"add_device_topics","device":"robot","topics":["/odom"]}"#,
    r#"{"command":"list_devices"}"#,
    r#"{"command":"compare_fingerprint","fingerprint":"f","account":null}"#,
    r#"{"command":"list_contacts"}"#,
    r#"{"command":"add_contact","name":"bob","address":"0x0707070707070707070707070707070707070707","fingerprint":null}"#,
    r#"{"command":"remove_contact","name":"bob"}"#,
    r#"{"command":"confirm_contact","name":"bob","fingerprint":"f"}"#,
    r#"{"command":"administer","act":"admit","account":"bob"}"#,
    r#"{"command":"administer","act":"accept"}"#,
    r#"{"command":"name_recovery","recovery":null}"#,
    r#"{"command":"chain_status"}"#,
    r#"{"command":"list_successions"}"#,
    r#"{"command":"deploy_contract","delay":7}"#,
    r#"{"command":"cancel_transaction","nonce":7,"account":null}"#,
    r#"{"command":"serve_chain","address":"127.0.0.1:8545"}"#,
    r#"{"command":"serve_gateway","address":"127.0.0.1:7000","open":false}"#,
    r#"{"command":"site_status"}"#,
    r#"{"command":"list_audit","since":null,"action":null,"profile":null,"before":null,"limit":5}"#,
    r#"{"command":"verify_audit","heads":true}"#,
    r#"{"command":"export_audit","addresses":false}"#,
    r#"{"command":"audit_records","deep":true,"since":null}"#,
    r#"{"command":"list_all_uploads","owner":null,"topic":null,"kind":null,"type_name":null,"tags":[],"state":null,"since":null,"until":null,"after":null,"limit":10,"newest_first":true}"#,
    r#"{"command":"back_up","file":"/b","passphrase":"p"}"#,
    r#"{"command":"lock"}"#,
    r#"{"command":"hold_capture","hold":true}"#,
    r#"{"command":"back_up_keys"}"#,
    r#"{"command":"make_join_file","passphrase":"p","renew":true}"#,
    r#"{"command":"restore_keys","path":"/k.keyring","passphrase":"p"}"#,
    r#"{"command":"list_alerts"}"#,
    r#"{"command":"test_alert"}"#,
    r#"{"command":"gateway_status"}"#,
    r#"{"command":"admit","owner":"bob"}"#,
    r#"{"command":"dismiss","owner":"bob"}"#,
    r#"{"command":"list_admitted"}"#,
    r#"{"command":"of_incident","incident":"open_incident","name":"crash","since":"2026-01-01T00:00:00Z","until":null,"topics":["/odom"],"note":"n"}"#,
    r#"{"command":"of_incident","incident":"open_incident","name":"crash","since":"2026-01-01T00:00:00Z","until":null,"topics":[],"note":null,"robots":["scout"]}"#,
    r#"{"command":"of_incident","incident":"list_incidents"}"#,
    r#"{"command":"of_robot","robot":"pull_ring","name":"scout","since":"2026-01-01T00:00:00Z","until":null,"topics":["/camera/**"],"incident":"crash"}"#,
    r#"{"command":"of_incident","incident":"show_incident","name":"crash"}"#,
    r#"{"command":"of_incident","incident":"note_incident","name":"crash","text":"n"}"#,
    r#"{"command":"of_incident","incident":"close_incident","name":"crash"}"#,
    r#"{"command":"of_incident","incident":"remove_incident","name":"crash"}"#,
    r#"{"command":"open_console"}"#,
];

const REPLIES: &[&str] = &[
    r#"{"reply":"done"}"#,
    r#"{"reply":"identity","with":{"profile":"default","exists":false,"unlocked":false,"registered":false,"address":null,"epoch":null,"signing_key":null,"fingerprint":null,"envelope_key":null}}"#,
    r#"{"reply":"key","with":[1,2]}"#,
    r#"{"reply":"coverage","with":[{"topic":"/odom","robot":"scout-1","robots":["scout-1"],"since":"2026-01-01T00:00:00Z","until":"2026-01-01T00:01:00Z","first":null,"last":null,"parts":[]}]}"#,
    r#"{"reply":"coverage","with":[{"topic":"/odom","since":"2026-01-01T00:00:00Z","until":"2026-01-01T00:01:00Z","first":null,"last":null,"parts":[{"at":"2026-01-01T00:00:00Z","data":true,"quarantined":false,"tampered":false,"lost":2}]}]}"#,
    r#"{"reply":"captured","with":{"captured":1,"verified":1,"quarantined":0,"lost":0,"skipped":0,"topics":[]}}"#,
    r#"{"reply":"progress","with":[{"step":"hashing","file":"a","done":1,"of":2,"messages":3,"unit":"messages"}]}"#,
    r#"{"reply":"policy","with":{"topics":[],"idle":[]}}"#,
    r#"{"reply":"records","with":{"records":[{"id":"0a","seq":1,"topic":"/odom","type":"nav_msgs/Odometry","kind":"data","state":"verified, names unchecked","digest":"0707070707070707070707070707070707070707070707070707070707070707","bytes":5,"captured_at":"2026-01-01T00:00:00Z","epoch":0,"simulated":true,"transaction":null,"block":null,"compared":"header"}],"next":null}}"#,
    r#"{"reply":"records","with":{"records":[{"id":"0a","seq":1,"topic":"/odom","type":"nav_msgs/Odometry","kind":"quarantine","state":"unread","digest":"0707070707070707070707070707070707070707070707070707070707070707","bytes":5,"captured_at":"2026-01-01T00:00:00Z","epoch":0,"simulated":true,"transaction":null,"block":7,"compared":"nothing"}],"next":"x"}}"#,
    r#"{"reply":"records","with":{"records":[{"id":"0a","seq":1,"topic":"/odom","type":"nav_msgs/Odometry","kind":"gap","state":"waits: unauthorised","digest":"0707070707070707070707070707070707070707070707070707070707070707","bytes":5,"captured_at":"2026-01-01T00:00:00Z","epoch":0,"simulated":true,"transaction":null,"block":7,"compared":"head"}],"next":"x"}}"#,
    r#"{"reply":"records","with":{"records":[{"id":"0a","seq":1,"topic":"/odom","type":"nav_msgs/Odometry","kind":"data","state":"deleted","digest":"0707070707070707070707070707070707070707070707070707070707070707","bytes":5,"captured_at":"2026-01-01T00:00:00Z","epoch":0,"simulated":true,"transaction":null,"block":7,"compared":"head"}],"next":"x"}}"#,
    r#"{"reply":"files","with":[{"name":"a","bytes":[1]}]}"#,
    r#"{"reply":"evidence","with":{"file":"/a.authros","bytes":1,"records":1,"revealed":3,"topics":[{"topic":"/odom","records":3}],"written":true,"notes":["n"]}}"#,
    r#"{"reply":"stamped","with":{"roots":2,"tokens":[{"authority":"h","before":"2023-11-14T22:13:20Z","roots":2}],"waiting":1,"problem":"p"}}"#,
    r#"{"reply":"transaction","with":{"transaction":null,"block":null,"epoch":1,"text":"done"}}"#,
    r#"{"reply":"grants","with":[{"direction":"given","owner":"0x0707070707070707070707070707070707070707","grantee":"0x0707070707070707070707070707070707070707","epoch":0,"from":1,"opens":{"records":2,"since":"2026-01-01T00:00:00Z"},"expires":null,"topics":[],"state":"active","block":3,"transaction":"0x0707070707070707070707070707070707070707070707070707070707070707","name":null,"fingerprint":null},{"direction":"received","owner":"0x0707070707070707070707070707070707070707","grantee":"0x0707070707070707070707070707070707070707","epoch":0,"from":null,"opens":null,"expires":null,"topics":["/odom"],"state":"revoked","block":3,"transaction":"0x0707070707070707070707070707070707070707070707070707070707070707","name":"bob","fingerprint":"f"}]}"#,
    r#"{"reply":"grant_foreseen","with":{"epoch":3,"epochs":1,"nothing_older":true,"opens":{"records":0,"since":null},"readers":2,"robots":["scout"],"transactions":3}}"#,
    r#"{"reply":"devices","with":[]}"#,
    r#"{"reply":"contacts","with":[]}"#,
    r#"{"reply":"check","with":{"id":"0a","verdict":"verified","digest":"0707070707070707070707070707070707070707070707070707070707070707","transaction":null,"block":4,"contract":null}}"#,
    r#"{"reply":"check","with":{"id":"0a","verdict":"verified","digest":"0707070707070707070707070707070707070707070707070707070707070707","transaction":null,"block":4,"contract":{"reader":"0x0707070707070707070707070707070707070707","owner":"0x0707070707070707070707070707070707070707","authorised":true,"epoch":1,"count":1,"last":"0707070707070707070707070707070707070707070707070707070707070707"}}}"#,
    r#"{"reply":"pins","with":{"mode":"first","pins":[],"alarms":[]}}"#,
    r#"{"reply":"quarantine","with":{"messages":0,"records":[]}}"#,
    r#"{"reply":"decided","with":{"decision":"released","messages":2,"text":"t"}}"#,
    r#"{"reply":"admitted","with":[]}"#,
    r#"{"reply":"alerts","with":{"alerts":[{"key":"disk","severity":"critical","text":"t","site":"0a","begun":"2023-11-14T22:13:20Z"}],"over":[],"told":"webhook h","waiting":1,"dropped":2}}"#,
    r#"{"reply":"alert_tested","with":{"place":"webhook h","text":"204"}}"#,
    r#"{"reply":"audit","with":[]}"#,
    r#"{"reply":"audit_checked","with":{"ok":true,"lines":1,"heads":1,"anchored":1,"covered":1,"broken_line":null,"text":null,"unusable":[]}}"#,
    r#"{"reply":"backed_up","with":{"file":"/b","files":1,"bytes":2,"profiles":[],"notes":[]}}"#,
    r#"{"reply":"incident","with":{"name":"crash","open":true,"since":"2026-01-01T00:00:00Z","until":null,"opened_at":"2026-01-01T00:00:00Z","closed_at":null,"topics":["/odom"],"notes":[{"at":"2026-01-01T00:00:00Z","text":"n"}],"records":1,"bytes":2,"coverage":[{"topic":"/odom","records":1,"bytes":2,"first":null,"last":null,"deleted":0,"quarantined":0,"lost":0}]}}"#,
    r#"{"reply":"incidents","with":[]}"#,
    r#"{"reply":"robot","with":{"name":"scout","device":"0707070707070707070707070707070707070707070707070707070707070707","last_seen":null,"address":"h:1","waiting":0,"lost":0,"wanted":1,"running":null,"standing":"waiting","drift":true,"drift_since":"2026-01-01T00:00:00Z","gateway":{"addresses":["h:1"],"key":"0707070707070707070707070707070707070707070707070707070707070707"},"enrolled":[],"topics":[],"refused":null,"overruled":[],"policy":"every = 2","set_at":"2026-01-01T00:00:00Z"}}"#,
    r#"{"reply":"ring_pull","with":{"robot":"scout","device":"0707070707070707070707070707070707070707070707070707070707070707","since":"2026-01-01T00:00:00Z","until":"2026-01-01T00:05:00Z","topics":["/camera/**"]}}"#,
    r#"{"reply":"audit","with":[{"line":1,"at":"2026-01-01T00:00:00Z","profile":"default","operator":"bob","action":"watch","subject":"/odom","outcome":"done"}]}"#,
];

fn changed<T: Serialize + DeserializeOwned>(lines: &[&str]) -> Vec<String> {
    let again =
        |line: &str| -> Result<String, serde_json::Error> { serde_json::to_string(&serde_json::from_str::<T>(line)?) };
    let differs = |line: &&str| match again(line) {
        Ok(written) if written == *line => None,
        other => Some(format!("{line}\n{other:?}")),
    };
    lines.iter().filter_map(differs).collect()
}

#[test]
fn requests_and_answers_keep_their_form_on_the_wire() {
    let changed = [changed::<Command>(REQUESTS), changed::<Reply>(REPLIES)].concat();
    assert!(changed.is_empty(), "{}", changed.join("\n\n"));
}

#[test]
fn fields_of_a_newer_process_are_passed_over() {
    let known: Result<Command, _> = serde_json::from_str(r#"{"command":"list_keys","newer":1}"#);
    assert!(known.is_ok(), "{known:?}");
    let known: Result<Command, _> = serde_json::from_str(r#"{"command":"lock","newer":1}"#);
    assert!(known.is_ok(), "{known:?}");
}

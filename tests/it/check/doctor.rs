//! `authros doctor`: what is as it should be, what is not, and what to do about it.

use std::fs;
use std::os::unix::fs::PermissionsExt;

use authros::ros::EmbeddedMaster;
use serde_json::Value;

use super::{INCOMPLETE, UNREACHABLE, damaged};
use crate::support::{Anvil, Authros, Home, Redis, free_port, list, skipped, text, wait_until};

fn examined(authros: &Authros, code: i32) -> Value {
    let found = authros.with(&["--json"]).run(&["doctor"]).expect_code(code).document();
    assert_eq!(found["ok"], code == 0, "{found}");
    for check in list(&found, "checks") {
        assert!(!text(&check, "name").is_empty() && !text(&check, "detail").is_empty(), "{check}");
        assert_eq!(check["status"] == "ok", text(&check, "advice").is_empty(), "advice where it is needed: {check}");
    }
    found
}

fn status(found: &Value, name: &str) -> String {
    let of = |check: &Value| check["name"] == name;
    let check = list(found, "checks").into_iter().find(of).unwrap_or_else(|| panic!("no check '{name}': {found}"));
    text(&check, "status")
}

#[test]
fn the_doctor_looks_at_a_home_without_a_passphrase_and_names_what_is_wrong() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]);
    authros.run(&["topics", "watch", "/robot1/odom"]).expect_code(0);
    let fresh = examined(&authros, 0);
    assert_eq!((status(&fresh, "chain"), status(&fresh, "keys")), ("ok".into(), "warn".into()), "{fresh}");
    authros.enrol();
    fs::rename(home.path().join("profiles/default/passphrase"), home.root().join("kept")).expect("moved");
    let found = examined(&authros, 0);
    for name in ["home", "keys default", "store", "chain", "contract", "clock", "ros", "site"] {
        assert_eq!(status(&found, name), "ok", "{name}: {found}");
    }
    assert_ne!(status(&found, "disk"), "");

    let keyring = home.path().join("profiles/default/keyring");
    fs::set_permissions(&keyring, fs::Permissions::from_mode(0o644)).expect("opened");
    let found = examined(&authros, INCOMPLETE);
    assert_eq!((status(&found, "home"), status(&found, "keys default")), ("fail".into(), "fail".into()), "{found}");
    assert!(found.to_string().contains("chmod"), "{found}");
    fs::set_permissions(&keyring, fs::Permissions::from_mode(0o600)).expect("closed");

    let nowhere = format!("http://127.0.0.1:{}", free_port());
    let found = examined(&authros.with(&["--ros-master", &nowhere]), UNREACHABLE);
    assert_eq!((status(&found, "ros"), status(&found, "chain")), ("fail".into(), "ok".into()), "{found}");
    let found = examined(&authros.with(&["--chain", &nowhere]), UNREACHABLE);
    assert_eq!(status(&found, "chain"), "fail", "{found}");

    let tear = |ledger: &rusqlite::Connection| {
        let page: i64 = ledger
            .query_row("SELECT rootpage FROM sqlite_schema WHERE name = 'records'", [], |row| row.get(0))
            .expect("a page");
        let size: i64 = ledger.query_row("PRAGMA page_size", [], |row| row.get(0)).expect("a size");
        let path = ledger.path().expect("a file").to_owned();
        let mut bytes = fs::read(&path).expect("read");
        let at = usize::try_from((page - 1) * size).expect("small");
        bytes[at..at + 100].fill(0xa5);
        fs::write(&path, bytes).expect("torn");
    };
    let found = damaged(&home, "ledger.db", tear, || examined(&authros, INCOMPLETE));
    assert_eq!(status(&found, "store"), "fail", "{found}");

    fs::rename(home.root().join("kept"), home.path().join("profiles/default/passphrase")).expect("moved back");
    let site = authros.serve(&home);
    let found = wait_until(60, "all parts are up", || {
        let found = authros.with(&["--json"]).run(&["doctor"]);
        (found.code == Some(0)).then(|| found.document())
    });
    assert_eq!(status(&found, "site"), "ok", "{found}");
    site.stop("INT", 30).expect_code(0);
}

/// The site has another chain than the settings of the caller, and then none.
#[test]
fn the_doctor_tells_of_the_chain_that_the_running_site_has_and_ends_as_status_does() {
    let Some(node) = Anvil::start(&[]) else { skipped!("no anvil") };
    let home = Home::new();
    let with_node = home.authros().with(&["--robots", "1", "--chain", &node.http()]);
    with_node.enrol();
    let site = with_node.serve(&home);
    // The settings of this command line name no chain.
    let bare = home.authros();
    let found = wait_until(60, "all parts are up", || {
        let found = bare.with(&["--json"]).run(&["doctor"]);
        (found.code == Some(0)).then(|| found.document())
    });
    let of = |found: &Value, name: &str| list(found, "checks").into_iter().find(|check| check["name"] == name);
    let sealers = of(&found, "sealers").expect("who seals");
    assert!(text(&sealers, "detail").contains("a development node (anvil"), "{sealers}");
    assert!(text(&of(&found, "site chain").expect("its chain"), "detail").contains(&node.http()), "{found}");
    assert!(!found.to_string().contains("embedded AuthROS chain"), "{found}");
    drop(node);
    let (found, code) = wait_until(60, "the chain's absence is noticed", || {
        let status = bare.run(&["status"]).code.filter(|code| *code != 0)?;
        let found = bare.with(&["--json"]).run(&["doctor"]);
        (found.code == Some(status)).then(|| (found.document(), status))
    });
    assert_eq!((code, &found["ok"]), (UNREACHABLE, &Value::from(false)), "{found}");
    let chain = of(&found, "site chain").expect("its chain");
    assert!(chain["status"] != "ok" && !text(&chain, "advice").is_empty(), "what to do: {chain}");
    site.stop("INT", 30).expect_code(0);
}

#[test]
fn host_names_that_lead_nowhere_are_told() {
    let home = Home::new();
    let master = EmbeddedMaster::start().expect("a master");
    let authros = home.authros().with(&["--ros-master", master.uri()]);
    let good = examined(&authros, 0);
    assert_eq!((status(&good, "ros"), status(&good, "ros host")), ("ok".into(), "ok".into()), "{good}");
    for name in ["nowhere.invalid", "192.0.2.7"] {
        let found = examined(&authros.with_variable("ROS_HOSTNAME", name), UNREACHABLE);
        assert_eq!((status(&found, "ros"), status(&found, "ros host")), ("ok".into(), "fail".into()), "{found}");
        assert!(found.to_string().contains("ROS_HOSTNAME"), "{found}");
    }
}

#[test]
fn a_cache_that_answers_is_well_and_one_that_does_not_is_a_warning() {
    let Some(mut redis) = Redis::start(&[]) else { skipped!("no redis-server") };
    let home = Home::new();
    let authros = home.authros().with(&["--cache", &redis.url()]);
    assert_eq!(status(&examined(&authros, 0), "cache"), "ok");
    redis.kill();
    let found = examined(&authros, 0);
    assert_eq!(status(&found, "cache"), "warn", "{found}");
    assert!(found.to_string().contains("read from the store meanwhile"), "{found}");
    // A URL that cannot be one.
    home.authros().with(&["--robots", "0"]).run(&["identity", "create"]).expect_code(0);
    for url in ["http://me:s3cret@127.0.0.1:6379", "redis+cluster://me:s3cret@host"] {
        let outcome = home.authros().with(&["--cache", url]).run(&["status"]);
        let words = format!("{}{}", outcome.stdout, outcome.stderr);
        assert!(outcome.code == Some(3) && words.contains("cache.url") && !words.contains("s3cret"), "{outcome}");
    }
}

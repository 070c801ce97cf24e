//! `status` without a running site: its exit code, and what it says about store, cache, chain, master and profile.

use serde_json::Value;

use crate::support::{Anvil, Authros, Home, Redis, count, free_port, skipped, text};

const UNREACHABLE: i32 = 4;
const INPUT: i32 = 3;

/// Exit code, and the state of a part.
fn part(authros: &Authros, name: &str) -> (Option<i32>, String, String) {
    let outcome = authros.with(&["--json"]).run(&["status"]);
    let parts = outcome.document()["health"].as_array().cloned().unwrap_or_default();
    let found = parts.into_iter().find(|part| part["part"] == name).unwrap_or_else(|| panic!("no {name}: {outcome}"));
    (outcome.code, text(&found, "level"), text(&found, "text"))
}

#[test]
fn a_home_at_rest_is_well_and_says_that_no_site_runs() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]);
    authros.enrol();
    authros.capture(&["/robot1/odom"], 2);
    let (code, level, words) = part(&authros, "site");
    assert_eq!((code, level.as_str()), (Some(0), "absent"), "{words}");
    assert!(words.contains("no site is running") && words.contains("authros serve"), "{words}");
    assert_eq!(part(&authros, "chain").1, "ok");
    assert_eq!(part(&authros, "store").1, "ok");
    let shown = authros.run(&["status"]).expect_code(0).stdout;
    assert!(shown.contains("captured 2 = verified 2 + pending 0") && shown.contains(": balanced"), "{shown}");
}

#[test]
fn peers_that_are_away_are_told_without_a_site_too() {
    let home = Home::new();
    home.authros().with(&["--robots", "0"]).enrol();
    let port = free_port().to_string();
    for (name, flag, url) in [
        ("chain", "--chain", format!("http://127.0.0.1:{port}")),
        ("ros", "--ros-master", format!("http://127.0.0.1:{port}")),
    ] {
        let away = home.authros().with(&[flag, &url]);
        let (code, level, words) = part(&away, name);
        assert_eq!((code, level.as_str()), (Some(UNREACHABLE), "failed"), "{name}: {words}");
        assert!(words.contains(&port), "it names {url}: {words}");
        let shown = away.run(&["status"]).expect_code(UNREACHABLE).stdout;
        assert!(shown.lines().any(|line| line.starts_with(name) && line.contains("failed")), "{shown}");
    }
    // A cache that is away costs time alone.
    let away = home.authros().with(&["--cache", &format!("redis://127.0.0.1:{port}")]);
    assert_eq!(part(&away, "store").1, "ok");
    away.run(&["status"]).expect_code(0);
}

#[test]
fn peers_that_answer_are_well_without_a_site_too() {
    let (Some(node), Some(redis)) = (Anvil::start(&[]), Redis::start(&[])) else {
        skipped!("no anvil or no redis-server")
    };
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1", "--chain", &node.http(), "--cache", &redis.url()]);
    authros.enrol();
    authros.capture(&["/robot1/odom"], 2);
    for name in ["chain", "store", "cache"] {
        let (code, level, words) = part(&authros, name);
        assert_eq!((code, level.as_str()), (Some(0), "ok"), "{name}: {words}");
    }
    let life: Value = authros.json(&["status"])["life"].clone();
    assert_eq!((count(&life, "verified"), count(&life, "captured")), (2, 2), "{life}");
}

#[test]
fn a_profile_that_there_is_not_is_told_and_not_made() {
    let home = Home::new();
    for command in [&["status"][..], &["records", "list", "--oldest"], &["audit"]] {
        let message = home.authros().fails(INPUT, command);
        assert!(message.contains(&format!("no home at {}", home.path().display())), "{message}");
        assert!(!home.path().exists(), "{command:?} made one");
    }
    // The doctor also looks at a machine before there is a home on it.
    let doctor = home.authros().with(&["--json"]).run(&["doctor"]).expect_code(0).document();
    let said = doctor["checks"][0]["detail"].as_str().expect("a detail");
    assert!(said.contains(&format!("{} does not exist yet", home.path().display())), "{said}");
    assert!(!home.path().exists(), "the doctor made one");
    // A home without a profile yet: nothing is wrong.
    home.authros().run(&["topics", "watch", "/odom"]).expect_code(0);
    home.authros().run(&["status"]).expect_code(0);
    home.profile("alice").with(&["--robots", "0"]).enrol();
    for named in [home.profile("bob"), home.authros()] {
        let message = named.fails(INPUT, &["status"]);
        assert!(message.contains("has no profile") && message.contains("it has alice"), "{message}");
        assert!(message.contains("--profile"), "what to do: {message}");
    }
    assert!(!home.path().join("profiles/bob").exists(), "none was made");
    // The same with a site.
    let _site = home.profile("alice").with(&["--robots", "0"]).serve(&home);
    let message = home.profile("bob").fails(INPUT, &["status"]);
    assert!(message.contains("has no profile 'bob'"), "{message}");
    home.profile("alice").run(&["status"]).expect_code(0);
}

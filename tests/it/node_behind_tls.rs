//! A node behind nginx, as operators have it: TLS, a user name and a password, a path; and each of these wrong.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use std::fs;

use crate::support;

use support::authros::files_below;
use support::nginx::{Certificate, ESCAPED, KEY, PASSWORD, USER};
use support::{Anvil, Authros, Home, Nginx, is_verified, skipped, text};

const NO_NODE: &str = "no anvil; tests/run installs it into target/peers";
const TOPIC: &str = "/robot1/odom";

/// Commands that use the node at this URL and trust nginx's authority.
fn at(home: &Home, nginx: &Nginx, url: &str) -> Authros {
    let roots = nginx.roots().display().to_string();
    home.authros()
        .with(&["--robots", "1"])
        .with_variable("AUTHROS_CHAIN", url)
        .with_variable("AUTHROS_CHAIN_ROOTS", &roots)
}

/// That nothing of this text is a secret of the URL.
fn expect_no_secret(text: &str) {
    for secret in [PASSWORD, ESCAPED, KEY] {
        assert!(!text.contains(secret), "{secret} is shown: {text}");
    }
}

#[test]
fn a_mission_over_https_with_a_password_and_a_path() {
    let Some(node) = Anvil::start(&["--block-time", "1"]) else { skipped!(NO_NODE) };
    let nginx = match Nginx::start(node.port()) {
        Ok(nginx) => nginx,
        Err(reason) => skipped!(reason),
    };
    let home = Home::new();
    let authros = at(&home, &nginx, &nginx.url());
    node.fund(&text(&authros.json(&["identity", "create"]), "address"));
    assert_eq!(authros.json(&["identity", "register"])["registered"], true);
    authros.capture(&[TOPIC], 5);
    let records = authros.records(&["records", "list", "--oldest"]);
    assert!(records.len() == 5 && records.iter().all(is_verified), "{records:?}");
    assert_eq!(authros.json(&["records", "check", &text(&records[0], "id")])["verdict"], "verified");
    authros.run(&["audit", "--deep"]).expect_code(0);
    for shown in [&["chain", "status"][..], &["status"], &["config", "show"], &["doctor"]] {
        let outcome = authros.run(shown);
        expect_no_secret(&format!("{}{}", outcome.stdout, outcome.stderr));
    }
    let settings = authros.run(&["config", "show"]).expect_code(0);
    assert!(settings.stdout.contains("://…@127.0.0.1:"), "the rest of the URL is shown: {settings}");
    for file in files_below(home.root()) {
        let bytes = fs::read(&file).unwrap_or_default();
        assert!(!support::holds(&bytes, KEY.as_bytes()), "{} has the path", file.display());
        assert!(!support::holds(&bytes, PASSWORD.as_bytes()), "{} has the password", file.display());
    }
}

#[test]
fn what_keeps_us_from_the_node_is_named_with_what_to_do() {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let nginx = match Nginx::start(node.port()) {
        Ok(nginx) => nginx,
        Err(reason) => skipped!(reason),
    };
    let home = Home::new();
    home.authros().json(&["identity", "create"]);
    let (good, own) = (nginx.at(Certificate::Good), nginx.at(Certificate::SelfSigned));
    let (expired, other) = (nginx.at(Certificate::Expired), nginx.at(Certificate::OtherName));
    for (url, said) in [
        (format!("https://{good}/{KEY}/"), ["requires a user name and password (HTTP 401)", "USER:PASSWORD@"]),
        (format!("https://{USER}:wrong@{good}/{KEY}/"), ["does not accept the user name", "HTTP 401"]),
        (format!("https://{USER}:{ESCAPED}@{good}/elsewhere/"), ["serves nothing at this path", "HTTP 404"]),
        (format!("http://{USER}:{ESCAPED}@{good}/{KEY}/"), ["speaks TLS at this port", "use https://"]),
        (format!("https://{USER}:{ESCAPED}@{own}/{KEY}/"), ["a certificate of an authority as its own", "chain.roots"]),
        (format!("https://{USER}:{ESCAPED}@{expired}/{KEY}/"), ["expired at 2020-01-0", "renewed"]),
        (format!("https://{USER}:{ESCAPED}@{other}/{KEY}/"), ["for another name", "get a certificate for this name"]),
    ] {
        let message = at(&home, &nginx, &url).fails(4, &["identity", "register"]);
        assert!(said.iter().all(|part| message.contains(part)), "{url}: {message}");
        expect_no_secret(&message);
    }
    // Without the setting nobody here knows the authority.
    let stranger = home.authros().with_variable("AUTHROS_CHAIN", &nginx.url());
    let message = stranger.fails(4, &["identity", "register"]);
    assert!(message.contains("an authority that is not trusted") && message.contains("chain.roots"), "{message}");
}

#[test]
fn a_refused_address_of_a_node_is_not_repeated() {
    let home = Home::new();
    for url in [
        format!("ftp://node.example/v3/{KEY}"),
        format!("node.example/v3/{KEY}"),
        format!("https://me:{KEY}@"),
        format!("wss://me:{KEY}@node.example:port/"),
    ] {
        let message = home.authros().with_variable("AUTHROS_CHAIN", &url).fails(3, &["identity", "register"]);
        assert!(message.contains("http://"), "{message}");
        expect_no_secret(&message);
    }
    let missing =
        home.authros().with_variable("AUTHROS_CHAIN_ROOTS", "/nowhere/ca.pem").fails(3, &["identity", "register"]);
    assert!(missing.contains("chain.roots") && missing.contains("/nowhere/ca.pem"), "{missing}");
}

//! A gateway whose records are in a PostgreSQL database: its dump is loaded into a server of today and served.

use super::{expected, profile, sample, unpacked};
use crate::support::{Authros, Home, Postgres, Running, free_port, list, skipped, text};
use serde_json::Value;

/// The chain of the sample, served.
fn chain(site: &Home) -> (Running, String) {
    let url = format!("127.0.0.1:{}", free_port());
    let mut chain = profile(site, "alice").spawn(&["chain", "serve", "--listen", &url]);
    chain.wait_for_text(&url, 60);
    (chain, format!("http://{url}"))
}

/// The gateway of the sample, with this database.
fn keeper(desk: &Home, url: &str, chain: &str) -> Authros {
    let contract = text(&expected(), "contract");
    let options = ["--chain", chain, "--contract", &contract, "--confirmations", "1"];
    profile(desk, "keeper").with(&options).with_variable("AUTHROS_STORE", url)
}

#[test]
fn a_dump_of_a_database_is_loaded_and_its_gateway_goes_on() {
    let server = match Postgres::start() {
        Ok(server) => server,
        Err(reason) => skipped!(reason),
    };
    let url = server.database("fleet");
    server.load("fleet", &sample("desk.sql"));
    let (site, desk) = (unpacked("site"), unpacked("desk"));
    let (chain, chain_url) = chain(&site);
    let keeper = keeper(&desk, &url, &chain_url);
    let mut gateway = keeper.with(&["--json"]).spawn(&["gateway", "serve", "--listen", "127.0.0.1:0"]);
    gateway.wait_for_text("\"gateway\"", 120);
    let audit = keeper.json(&["audit", "--deep"]);
    let wanted: Vec<Value> = list(&expected(), "desk");
    assert_eq!((&audit["ok"], &audit["missing"]), (&true.into(), &0.into()), "{audit}");
    assert!(audit["records"].as_u64() >= Some(wanted.len() as u64), "{audit}");
    let digests = server.sql("fleet", "SELECT encode(digest, 'hex') FROM records ORDER BY n");
    let known: Vec<&str> = digests.lines().collect();
    assert!(wanted.iter().all(|digest| known.contains(&digest.as_str().expect("text"))), "{known:?}");
    gateway.stop("TERM", 20).expect_code(0);

    // Of a later version it is refused, and nothing is written.
    server.sql("fleet", "UPDATE about SET version = 2");
    let said = keeper.fails(super::later::INPUT, &["gateway", "serve", "--listen", "127.0.0.1:0"]);
    assert!(said.contains("schema 2") && said.contains("use a newer authros"), "{said}");
    chain.stop("TERM", 20).expect_code(0);
}

//! A gateway whose records are in a PostgreSQL database: what it does there, what it leaves to other homes, and what it
//! refuses to begin on.

use super::*;
use support::postgres::{PASSWORD, Postgres};
use support::{Outcome, clock, skipped};

const INPUT: i32 = 3;
const UNREACHABLE: i32 = 4;

/// What a program said, with no password in it; what it was told has one.
fn said(outcome: &Outcome) -> String {
    without_password(&[&*outcome.stdout, &outcome.stderr].concat()).to_owned()
}

fn without_password(said: &str) -> &str {
    assert!(!said.contains(PASSWORD), "the password is shown: {said}");
    said
}

/// What `status` says of the store, and its level.
fn store_health(keeper: &Authros) -> (String, String) {
    let status = keeper.json(&["status"]);
    without_password(&status.to_string());
    let part = support::list(&status, "health").into_iter().find(|part| part["part"] == "store").expect("a store");
    (text(&part, "level"), text(&part, "text"))
}

/// What `doctor` says of one thing, with its advice.
fn examined(keeper: &Authros, name: &str) -> Vec<(String, String)> {
    let outcome = keeper.with(&["--json"]).run(&["doctor"]);
    said(&outcome);
    let checks = support::list(&outcome.document(), "checks").into_iter().filter(|check| check["name"] == name);
    checks.map(|check| (text(&check, "status"), format!("{}; {}", check["detail"], check["advice"]))).collect()
}

#[test]
fn what_a_robot_brings_to_a_gateway_on_postgresql_its_owner_and_a_reader_have() {
    let _alone = heavy();
    let server = match Postgres::start() {
        Ok(server) => server,
        Err(reason) => skipped!(reason),
    };
    let (ground, url) = (Ground::new(), server.database("fleet"));
    let mut gateway = Gateway::on_server(&ground, &url);
    let (alice, bob) = (Member::new("alice", &gateway), Member::new("bob", &gateway));
    alice.grant(&bob);
    let robot = Robot::enrol(&alice, "scout", &gateway);
    let own = ["records", "list", "--oldest"];
    let shared = ["received", "list", "--oldest", "--owner", &alice.address];
    let first = robot.bring("5");
    assert_eq!(bob.verified(&shared, first), alice.verified(&own, first), "the reader has the same");

    // Whatever was acknowledged is there after a kill, and the rest follows.
    gateway.kill();
    gateway.start();
    let all = robot.bring("5");
    assert!(all > first, "{all}");
    assert_eq!(bob.verified(&shared, all), alice.verified(&own, all), "none lost and none twice");
    let opened = bob.authros.json(&["records", "open", bob.verified(&shared, all).first().expect("some")]);
    assert_eq!(opened["verdict"], "verified", "{opened}");
    let rows = server.sql("fleet", "SELECT count(*) FROM records JOIN ciphertext ON record = n");
    assert!(rows.parse::<u64>().expect("a number") >= all, "{rows}");
    assert!(!gateway.home.path().join("ledger.db").exists(), "nothing of it is in a file");

    let keeper = gateway.keeper();
    let audit = keeper.json(&["audit", "--deep"]);
    assert_eq!((&audit["ok"], count(&audit, "missing")), (&Value::Bool(true), 0), "{audit}");
    leaves_to_other_homes(&gateway);
    says_what_an_acknowledgement_is_worth(&server, &keeper);
    said(&keeper.run(&["config", "show"]).expect_code(0));
    let ended = gateway.site.take().expect("running").stop("TERM", 20).expect_code(0);
    said(&ended);
}

/// Each act is refused with its reason, not with a fault of the store.
fn leaves_to_other_homes(gateway: &Gateway) {
    let (keeper, account) = (gateway.keeper(), format!("0x{}", "ab".repeat(20)));
    let secret = gateway.home.file("secret", "a passphrase of its own\n", 0o600);
    let file = gateway.home.root().join("never.backup").to_str().expect("UTF-8").to_owned();
    let acts: [(&[&str], &str); 11] = [
        (&["capture", "--topic", TOPIC, "--count", "1"], "captures and imports nothing"),
        (&["topics", "watch", TOPIC], "captures and imports nothing"),
        (&["bag", "import", &secret], "captures and imports nothing"),
        (&["received", "list"], "opens no records"),
        (&["grant", "add", "--to", &account], "grants nothing"),
        (&["robot", "authorise", &"ab".repeat(32)], "authorises no robots"),
        (&["keys", "rotate"], "they stay"),
        (&["keys", "rotate", "--envelope"], "they stay"),
        (&["contacts", "add", "carol", &account], "no address book"),
        (&["incident", "open", "crash", "--since", "1h"], "no incidents"),
        (&["backup", "create", &file, "--passphrase-file", &secret], "pg_basebackup"),
    ];
    for (act, reason) in acts {
        let said = keeper.fails(REFUSED, act);
        assert!(said.contains(reason) && said.contains("store.url"), "{act:?}: {said}");
    }
    // What only looks is answered.
    for look in
        [&["grant", "list"][..], &["contacts", "list"], &["robot", "list"], &["topics", "pins"], &["incident", "list"]]
    {
        keeper.json(look);
    }
}

fn says_what_an_acknowledgement_is_worth(server: &Postgres, keeper: &Authros) {
    let (level, told) = store_health(keeper);
    assert!(level == "ok" && told.contains("on its disk, on no standby's"), "{level} {told}");
    let found = examined(keeper, "store");
    assert!(matches!(&found[..], [(status, told)] if status == "ok" && told.contains("primary")), "{found:?}");

    let standby = server.standby();
    server.sql("postgres", "ALTER SYSTEM SET synchronous_standby_names = '*'");
    server.sql("postgres", "GRANT pg_monitor TO authros");
    server.sql("postgres", "SELECT pg_reload_conf()");
    wait_until(60, "it is said that a standby has what is acknowledged", || {
        let (level, told) = store_health(keeper);
        (level == "ok" && told.contains("1 standby (synchronous_standby_names *; 1 connected)")).then_some(())
    });
    drop(standby);
    wait_until(60, "it is said that nothing is acknowledged without it", || {
        let (level, told) = store_health(keeper);
        (level == "failed" && told.contains("start a standby")).then_some(())
    });
    let found = examined(keeper, "store");
    assert!(
        matches!(&found[..], [(status, told)] if status == "fail" && told.contains("nothing is acknowledged")),
        "{found:?}"
    );
    server.sql("postgres", "ALTER SYSTEM RESET synchronous_standby_names");
    server.sql("postgres", "SELECT pg_reload_conf()");
    wait_until(60, "it is acknowledged again", || (store_health(keeper).0 == "ok").then_some(()));
}

/// A gateway's home, not begun yet, with this database.
fn home_on(home: &Home, url: &str) -> Authros {
    home.profile("keeper").with(&["--robots", "0"]).with_variable("AUTHROS_STORE", url)
}

/// Refused with this code and these words, by the gateway and by the doctor, without the password.
fn is_refused_on(url: &str, code: i32, words: &[&str]) {
    let home = Home::new();
    let keeper = home_on(&home, url);
    let said = keeper.fails(code, &["gateway", "serve", "--listen", "127.0.0.1:0"]);
    assert!(words.iter().all(|word| said.contains(word)), "{words:?}: {said}");
    without_password(&said);
    let found = examined(&keeper, "store");
    let is_told = |(status, told): &(String, String)| status == "fail" && words.iter().all(|word| told.contains(word));
    assert!(found.iter().any(is_told), "{words:?}: {found:?}");
}

#[test]
fn a_database_that_cannot_be_used_is_refused_with_its_reason_and_what_to_do() {
    let server = match Postgres::start() {
        Ok(server) => server,
        Err(reason) => skipped!(reason),
    };
    let good = server.database("fleet");
    let wrong = good.replace(PASSWORD, "not-this-one");
    let (away, nowhere) = (free_port().to_string(), server.url("nowhere"));
    let port = good.rsplit(':').next().and_then(|rest| rest.split('/').next()).expect("a port");
    is_refused_on(&good.replace(port, &away), UNREACHABLE, &["cannot be reached", "start it, or correct store.url"]);
    is_refused_on(&wrong, REFUSED, &["password authentication failed", "correct user and password"]);
    is_refused_on(&nowhere, REFUSED, &["does not exist", "create the database"]);

    server.sql("fleet", "CREATE TABLE about (colour TEXT)");
    is_refused_on(&good, REFUSED, &["another program's", "a database of its own"]);
    server.sql("fleet", "DROP TABLE about");
    server.sql("postgres", "ALTER ROLE authros CONNECTION LIMIT 0");
    is_refused_on(&good, UNREACHABLE, &["no connection left", "max_connections"]);
    server.sql("postgres", "ALTER ROLE authros CONNECTION LIMIT -1");
    server.sql("postgres", "ALTER ROLE authros SET default_transaction_read_only = on");
    is_refused_on(&good, REFUSED, &["may only read", "name the primary"]);
    server.sql("postgres", "ALTER ROLE authros RESET default_transaction_read_only");
    let standby = server.standby();
    is_refused_on(&standby.url("fleet"), REFUSED, &["it is a standby", "name the primary"]);
    drop(standby);

    let home = Home::new();
    for url in [format!("mysql://authros:{PASSWORD}@h/x"), format!("host=h password={PASSWORD}")] {
        let said = home_on(&home, &url).fails(INPUT, &["gateway", "serve"]);
        assert!(without_password(&said).contains("store.url") && said.contains("postgres://"), "{said}");
    }
    if let Some(ahead) = clock::shifted(&home_on(&home, &good), "+1h") {
        let said = ahead.fails(REFUSED, &["gateway", "serve", "--listen", "127.0.0.1:0"]);
        assert!(said.contains("60 min behind this machine's") && said.contains("timedatectl"), "{said}");
    }
    assert_eq!(
        server.sql("fleet", "SELECT count(*) FROM pg_tables WHERE schemaname = 'public'"),
        "0",
        "nothing was made"
    );
}

#[test]
fn a_database_belongs_to_one_gateway_and_one_form() {
    let server = match Postgres::start() {
        Ok(server) => server,
        Err(reason) => skipped!(reason),
    };
    let (ground, url) = (Ground::new(), server.database("fleet"));
    let mut gateway = Gateway::on_server(&ground, &url);
    let account = text(&gateway.keeper().json(&["identity", "show"]), "address");
    gateway.site.take().expect("running").stop("TERM", 20).expect_code(0);

    // One that has no keys yet, and one that had them for a database of its own.
    let (new, other) = (Home::new(), Home::new());
    let other_url = server.database("other");
    home_on(&other, &other_url).json(&["identity", "create"]);
    for home in [&new, &other] {
        let said = home_on(home, &url).fails(REFUSED, &["gateway", "serve", "--listen", "127.0.0.1:0"]);
        assert!(without_password(&said).contains(&account) && said.contains("a database of its own"), "{said}");
    }
    assert!(!new.path().join("profiles/keeper/keyring").exists(), "no keys were made for it");
    let found = examined(&home_on(&other, &url), "database");
    assert!(matches!(&found[..], [(status, told)] if status == "fail" && told.contains(&account)), "{found:?}");

    // A home with a file of its own.
    let filed = Home::new();
    filed.profile("keeper").with(&["--robots", "0"]).json(&["identity", "create"]);
    let said = home_on(&filed, &url).fails(REFUSED, &["identity", "show"]);
    assert!(said.contains("begins in a new home"), "{said}");

    // Its user may not write any more: as long as it looks, that is said before the first record.
    server
        .sql("fleet", "REASSIGN OWNED BY authros TO postgres; GRANT SELECT ON ALL TABLES IN SCHEMA public TO authros");
    let said = gateway.keeper().fails(REFUSED, &["gateway", "serve", "--listen", "127.0.0.1:0"]);
    assert!(said.contains("may not write") && said.contains("the owner of its database"), "{said}");
    let store = || examined(&gateway.keeper(), "store");
    let found = store();
    assert!(matches!(&found[..], [(status, told)] if status == "fail" && told.contains("may not write")), "{found:?}");
    server.sql("fleet", "GRANT ALL ON ALL TABLES IN SCHEMA public TO authros");

    server.sql("fleet", "UPDATE about SET version = version + 1");
    let said = gateway.keeper().fails(INPUT, &["gateway", "serve", "--listen", "127.0.0.1:0"]);
    assert!(without_password(&said).contains("schema 2") && said.contains("use a newer authros"), "{said}");
    let found = store();
    assert!(matches!(&found[..], [(status, told)] if status == "fail" && told.contains("use a newer")), "{found:?}");

    // What it has seen elsewhere is not in an empty one.
    let keeper = gateway.keeper().with_variable("AUTHROS_STORE", &server.database("empty"));
    for act in [&["gateway", "serve", "--listen", "127.0.0.1:0"][..], &["gateway", "status"]] {
        let said = keeper.fails(REFUSED, act);
        assert!(said.contains("is empty, but this home has seen commit") && said.contains("its backup"), "{said}");
    }
    assert!(examined(&keeper, "store").iter().any(|(status, told)| status == "fail" && told.contains("is empty")));
    let tables = "SELECT count(*) FROM pg_tables WHERE schemaname = 'public'";
    assert_eq!(server.sql("empty", tables), "0", "nothing was made");
}

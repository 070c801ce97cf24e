//! Further workers of a gateway on PostgreSQL: a join file makes a home that serves as the first one does, and no other file,
//! database or home is taken for it.

use std::fs;
use std::os::unix::fs::PermissionsExt as _;

use super::*;
use support::postgres::{PASSWORD, Postgres};
use support::{clock, skipped};

const INPUT: i32 = 3;
const UNREACHABLE: i32 = 4;
const NOWHERE: [&str; 4] = ["gateway", "serve", "--listen", "127.0.0.1:0"];

/// A gateway on a server, with the file of a passphrase for its join files.
struct Scene {
    server: Postgres,
    _ground: Ground,
    gateway: Gateway,
    secret: String,
}

impl Scene {
    fn new() -> Result<Self, &'static str> {
        let server = Postgres::start()?;
        let ground = Ground::new();
        let gateway = Gateway::on_server(&ground, &server.database("fleet"));
        let secret = gateway.home.file("join-secret", "a passphrase of its own\n", 0o600);
        Ok(Self { server, _ground: ground, gateway, secret })
    }

    fn join_file(&self, name: &str, more: &[&str]) -> String {
        let file = self.gateway.home.root().join(name).to_str().expect("UTF-8").to_owned();
        let make = ["gateway", "join-file", "--out", &file, "--passphrase-file", &self.secret];
        self.gateway.keeper().json(&[&make[..], more].concat());
        file
    }

    fn stop(&mut self) {
        self.gateway.site.take().expect("running").stop("TERM", 20).expect_code(0);
    }

    /// What another machine runs, with a password of the database as PostgreSQL's own programs have it.
    fn machine(home: &Home) -> Authros {
        home.profile("keeper").with_variable("PGPASSWORD", PASSWORD)
    }

    fn join(&self, home: &Home, file: &str) -> Value {
        let joined = Self::machine(home).json(&["gateway", "join", file, "--passphrase-file", &self.secret]);
        assert!(!joined.to_string().contains(PASSWORD), "{joined}");
        joined
    }

    fn refuses(&self, machine: &Authros, code: i32, file: &str, words: &[&str]) {
        let said = machine.fails(code, &["gateway", "join", file, "--passphrase-file", &self.secret]);
        assert!(!said.contains(PASSWORD) && words.iter().all(|word| said.contains(word)), "{words:?}: {said}");
    }
}

/// The passphrase of the keyring goes there by hand.
fn bring_passphrase(from: &Home, to: &Home) {
    let stored = "profiles/keeper/passphrase";
    fs::copy(from.path().join(stored), to.path().join(stored)).expect("copied");
}

/// Ids of the system keys, and the version of their list.
fn system_keys(keeper: &Authros) -> (Vec<String>, u64) {
    let status = keeper.json(&["gateway", "status"]);
    (support::list(&status, "keys").iter().map(|key| text(key, "id")).collect(), count(&status, "list_version"))
}

#[test]
fn a_join_file_makes_a_worker_that_serves_as_the_first_one_does() {
    let _alone = heavy();
    let mut scene = match Scene::new() {
        Ok(scene) => scene,
        Err(reason) => skipped!(reason),
    };
    let alice = Member::new("alice", &scene.gateway);
    let robot = Robot::enrol(&alice, "scout", &scene.gateway);
    let own = ["records", "list", "--oldest"];
    robot.bring("3");
    let file = scene.join_file("gate.join", &[]);
    let bytes = fs::read(&file).expect("written");
    assert!(bytes.len() < 4_096 && !bytes.windows(8).any(|part| part == &PASSWORD.as_bytes()[..8]), "{}", bytes.len());
    assert_eq!(fs::metadata(&file).expect("written").permissions().mode() & 0o777, 0o600);
    let over = scene.gateway.keeper().fails(INPUT, &["gateway", "join-file", "--out", &file, "--random"]);
    assert!(over.contains("never overwritten"), "{over}");
    let (keys, version) = system_keys(&scene.gateway.keeper());
    scene.stop();

    let home = Home::new();
    let joined = scene.join(&home, &file);
    assert_eq!((text(&joined, "standing"), text(&joined, "gateway")), ("joined".to_owned(), scene.gateway.key.clone()));
    let settings = home.path().join("config.toml");
    let written = fs::read_to_string(&settings).expect("written");
    assert!(written.contains("store.url") && !written.contains(PASSWORD), "{written}");
    assert_eq!(fs::metadata(&settings).expect("written").permissions().mode() & 0o777, 0o600);
    assert_eq!(text(&scene.join(&home, &file), "standing"), "unchanged", "it is safe to repeat");
    bring_passphrase(&scene.gateway.home, &home);

    // With what the file brought alone, at the address that robot and owner know.
    let worker = Scene::machine(&home).with(&["--robots", "0"]);
    let mut site = worker.with(&["--json"]).spawn(&["gateway", "serve", "--listen", &scene.gateway.address()]);
    let said = site.wait_for_text("\"gateway\"", 120);
    assert!(said.contains(&scene.gateway.key) && said.contains(&scene.gateway.domain), "{said}");
    let all = robot.bring("3");
    alice.verified(&own, all);
    let (same, newer) = system_keys(&worker);
    assert_eq!(same, keys, "the same system keys");
    assert!(newer > version, "{version} {newer}");
    let ended = site.stop("TERM", 20).expect_code(0);
    assert!(![ended.stdout, ended.stderr].concat().contains(PASSWORD));

    // And the first one again: no client sees an older list.
    scene.gateway.start();
    let (same, newest) = system_keys(&scene.gateway.keeper());
    assert!(same == keys && newest > newer, "{newer} {newest}");
    // What the other one would do otherwise is named there.
    let unlike = |worker: &Authros| support::list(&worker.json(&["gateway", "status"])["lease"], "unlike");
    let other = worker.with_variable("AUTHROS_GATEWAY_ADMISSION", "open");
    wait_until(30, "the holder says how it is set", || (unlike(&other) == ["gateway.admission"]).then_some(()));
    assert_eq!(unlike(&worker), [""; 0]);
    let told = other.run(&["doctor"]).stdout;
    assert!(told.contains("that held the lease last: gateway.admission"), "{told}");
    let all = robot.bring("3");
    alice.verified(&own, all);
    scene.stop();
}

#[test]
fn a_new_join_key_shuts_out_older_files_and_workers() {
    let mut scene = match Scene::new() {
        Ok(scene) => scene,
        Err(reason) => skipped!(reason),
    };
    let (first, home) = (scene.join_file("first.join", &[]), Home::new());
    scene.join(&home, &first);
    bring_passphrase(&scene.gateway.home, &home);
    let second = scene.join_file("second.join", &["--renew"]);
    let words = ["has join key 1", "have join key 2", "authros gateway join-file"];
    scene.refuses(&Scene::machine(&Home::new()), REFUSED, &first, &words);

    // The gateway that renewed it goes on, also after a restart.
    scene.gateway.admit(&format!("0x{}", "ab".repeat(20)));
    scene.stop();
    scene.gateway.start();
    scene.stop();
    let worker = Scene::machine(&home).with(&["--robots", "0"]);
    let said = worker.fails(REFUSED, &NOWHERE);
    assert!(said.contains("have join key 2") && said.contains("authros gateway join FILE"), "{said}");
    let checks = worker.with(&["--json"]).run(&["doctor"]).document();
    let checks = support::list(&checks, "checks");
    assert!(checks.iter().any(|check| check["name"] == "join key" && check["status"] == "fail"), "{checks:?}");
    assert_eq!(text(&scene.join(&home, &second), "standing"), "renewed");
    let mut site = worker.spawn(&NOWHERE);
    site.wait_for_text(&scene.gateway.key, 120);
    site.stop("TERM", 20).expect_code(0);
}

#[test]
fn what_is_no_join_file_of_this_database_makes_no_worker() {
    let mut scene = match Scene::new() {
        Ok(scene) => scene,
        Err(reason) => skipped!(reason),
    };
    let (file, new) = (scene.join_file("gate.join", &[]), Home::new());
    let machine = Scene::machine(&new);
    let wrong = new.file("wrong", "another passphrase\n", 0o600);
    let said = machine.fails(REFUSED, &["gateway", "join", &file, "--passphrase-file", &wrong]);
    assert!(said.contains("wrong passphrase"), "{said}");
    let mut bytes = fs::read(&file).expect("reads");
    *bytes.last_mut().expect("some") ^= 1;
    let altered = new.file("altered.join", bytes, 0o600);
    scene.refuses(&machine, INPUT, &altered, &["is not an intact join file", "authros gateway join-file"]);

    // A home that is not empty, and one of somebody else.
    let taken = Home::new();
    fs::create_dir(taken.path()).expect("made");
    fs::write(taken.path().join("notes.txt"), "mine").expect("written");
    scene.refuses(&Scene::machine(&taken), REFUSED, &file, &["is not empty", "another --home"]);
    assert_eq!(fs::read_dir(taken.path()).expect("lists").count(), 1, "nothing was added");

    // Databases: without a password, another gateway's, an empty one, a standby, one that has no connection left.
    scene.refuses(&new.profile("keeper"), REFUSED, &file, &["password missing", "PGPASSFILE"]);
    let other_url = scene.server.database("other");
    let other = Home::new();
    let other = other.profile("keeper").with(&["--robots", "0"]).with_variable("AUTHROS_STORE", &other_url);
    other.json(&["identity", "create"]);
    let on = |url: &str| machine.with_variable("AUTHROS_STORE", url);
    scene.refuses(&on(&other_url), REFUSED, &file, &["the database of another gateway", "AUTHROS_STORE"]);
    let empty = scene.server.database("empty");
    scene.refuses(&on(&empty), REFUSED, &file, &["no gateway's tables", "AUTHROS_STORE"]);
    let tables = "SELECT count(*) FROM pg_tables WHERE schemaname = 'public'";
    assert_eq!(scene.server.sql("empty", tables), "0", "nothing was made");
    let standby = scene.server.standby();
    scene.refuses(&on(&standby.url("fleet")), REFUSED, &file, &["it is a standby", "name the primary"]);
    drop(standby);
    scene.stop();
    scene.server.sql("postgres", "ALTER ROLE authros CONNECTION LIMIT 0");
    scene.refuses(&machine, UNREACHABLE, &file, &["no connection left", "max_connections"]);
    scene.server.sql("postgres", "ALTER ROLE authros CONNECTION LIMIT -1");
    if let Some(ahead) = clock::shifted(&machine, "+1h") {
        scene.refuses(&ahead, REFUSED, &file, &["60 min behind this machine's", "timedatectl"]);
    }

    // Its own database, of which another network was made.
    let pinned = scene.server.sql("fleet", "SELECT pin FROM contract");
    scene.server.sql("fleet", "UPDATE contract SET pin = replace(pin, '\"chain_id\":', '\"chain_id\":1')");
    scene.refuses(&machine, REFUSED, &file, &["of another network", "authros gateway join-file"]);
    scene.server.sql("fleet", &format!("UPDATE contract SET pin = '{pinned}'"));
    assert!(!new.path().exists(), "no home was begun");

    // A password from a file; then it joins.
    let line = new.file("pgpass", format!("127.0.0.1:*:fleet:authros:{PASSWORD}\n"), 0o600);
    let by_file = new.profile("keeper").with_variable("PGPASSFILE", &line);
    let joined = by_file.json(&["gateway", "join", &file, "--passphrase-file", &scene.secret]);
    assert_eq!(text(&joined, "standing"), "joined");
}

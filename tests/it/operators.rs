//! Operators are Unix users: three accounts and their group at one site, each with the rights of the settings, named in the
//! audit log. Accounts are made for the test, so it runs as root.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs::{self, Permissions};
use std::os::unix::fs::{PermissionsExt as _, chown};
use std::path::PathBuf;

use serde_json::{Value, json};
use support::{Accounts, Authros, Console, Home, Running, Terminal, list, skipped, system_program, text, wait_until};

const USAGE: i32 = 2;
const INPUT: i32 = 3;
const UNREACHABLE: i32 = 4;
const REFUSED: i32 = 5;
const TOPIC: &str = "/robot1/odom";
const PATIENCE: u64 = 120;

/// The site of an account, which serves operators outside its home.
struct Yard {
    site: Option<Running>,
    owner: Authros,
    /// The account of another profile.
    reader: String,
    socket: PathBuf,
    home: PathBuf,
}

impl Yard {
    /// `keeper` gives rights to the group of all accounts and to two of them.
    fn open(accounts: &Accounts) -> Self {
        let home = accounts.home("keeper").join("site");
        let socket = accounts.folder("run", &accounts.name("keeper"), 0o750).join("operators.sock");
        let settings = format!(
            "[operators]\nsocket = \"{}\"\n\n[operators.rights]\n\"@{}\" = [\"look\"]\n{} = [\"grant\"]\n{} = [\"capture\"]\n",
            socket.display(),
            accounts.group,
            accounts.name("eve"),
            accounts.name("rob"),
        );
        let given = home.to_str().expect("UTF-8").to_owned();
        let keeper = accounts.authros("keeper").with(&["--home", &given, "--robots", "1"]);
        let owner = keeper.with(&["--profile", "yard"]);
        owner.enrol();
        let config = home.join("config.toml");
        fs::write(&config, settings).expect("written");
        let about = fs::metadata(&home).expect("a home");
        chown(&config, Some(std::os::unix::fs::MetadataExt::uid(&about)), None).expect("its owner is set");
        let mut site = owner.spawn(&["serve"]);
        site.wait_for_text("serving", 60);
        wait_until(60, "the operators' socket", || socket.exists().then_some(()));
        let reader = keeper.with(&["--profile", "carol"]).enrol();
        Self { site: Some(site), owner, reader, socket, home }
    }

    /// An account at the operators' socket.
    fn operator(&self, accounts: &Accounts, name: &str) -> Authros {
        self.operator_of(accounts, name, "yard")
    }

    fn operator_of(&self, accounts: &Accounts, name: &str, profile: &str) -> Authros {
        let socket = self.socket.to_str().expect("UTF-8");
        accounts.authros(name).with(&["--site-socket", socket, "--profile", profile])
    }

    fn audited(&self, filter: &[&str]) -> Vec<Value> {
        list(&self.owner.json(&[&["audit", "list", "--limit", "1000"], filter].concat()), "audit")
    }

    fn stop(&mut self) {
        if let Some(site) = self.site.take() {
            site.stop("INT", 30).expect_code(0);
        }
    }
}

#[test]
fn each_account_does_what_the_settings_say_and_the_log_names_it() {
    let accounts = match Accounts::make(&["keeper", "bob", "eve", "rob", "mallory"]) {
        Ok(accounts) => accounts,
        Err(reason) => skipped!(reason),
    };
    let mut yard = Yard::open(&accounts);
    let reader = yard.reader.clone();
    let [bob, eve, rob] = ["bob", "eve", "rob"].map(|name| yard.operator(&accounts, name));

    // The group looks; rights of user and group add up.
    for operator in [&bob, &eve, &rob] {
        assert!(list(&operator.json(&["records", "list", "--oldest"]), "records").len() < 1000);
    }
    let needs = |operator: &Authros, right: &str, arguments: &[&str]| {
        let refusal = operator.fails(REFUSED, arguments);
        assert!(refusal.contains(&format!("needs the right '{right}'")), "{refusal}");
    };
    needs(&bob, "capture", &["topics", "watch", TOPIC]);
    needs(&bob, "grant", &["grant", "add", &reader]);
    needs(&eve, "capture", &["topics", "watch", TOPIC]);
    needs(&rob, "grant", &["grant", "add", &reader]);
    assert!(rob.fails(REFUSED, &["keys", "rotate"]).contains("only the owner"));
    rob.capture(&[TOPIC], 2);
    rob.run(&["topics", "watch", TOPIC]).expect_code(0);
    yard.owner.run(&["topics", "unwatch", TOPIC]).expect_code(0);
    eve.json(&["grant", "add", &reader]);
    let address = text(&yard.owner.json(&["identity", "show"]), "address");
    assert_eq!(text(&eve.json(&["identity", "show"]), "address"), address, "she acts for the owner");
    assert_eq!(list(&bob.json(&["grant", "list"]), "grants").len(), 1);

    // Neither another profile nor somebody who is only in the kernel's group.
    let other = yard.operator_of(&accounts, "bob", "default");
    assert!(other.fails(REFUSED, &["records", "list", "--oldest"]).contains("no profile 'default'"));
    let mallory = yard.operator(&accounts, "mallory");
    assert!(
        mallory.fails(REFUSED, &["records", "list", "--oldest"]).contains("you may not use"),
        "the socket is its group's"
    );
    let mut line = accounts.line(&accounts.name("mallory"), &yard.socket);
    let refusal = line.next().expect("a refusal");
    assert!(text(&refusal["refused"], "message").contains("has no right at this site"), "{refusal}");

    let deeds = |name: &str| {
        let name = accounts.name(name);
        let lines = yard.audited(&["--by-operator", &name]);
        assert!(lines.iter().all(|line| line["profile"] == "yard" && line["operator"] == *name), "{lines:?}");
        let deeds = lines.iter().rev().map(|line| text(line, "action")).filter(|deed| deed != "refused");
        deeds.collect::<Vec<_>>()
    };
    assert!(deeds("bob").is_empty());
    assert_eq!(deeds("eve"), ["grant", "grant"]);
    assert_eq!(deeds("rob"), ["capture start", "capture start", "capture stop", "watch", "watch"], "begun and done");
    let own = yard.audited(&["--by", "yard", "--action", "unwatch"]);
    assert!(own.len() == 2 && own.iter().all(|line| line.get("operator").is_none()), "the owner's own: {own:?}");
    let by = format!("yard/{}", accounts.name("rob"));
    assert_eq!(yard.audited(&["--by", &by, "--action", "watch"]).len(), 2);

    yard.stop();
    assert!(
        bob.fails(UNREACHABLE, &["records", "list", "--oldest"]).contains("authros serve"),
        "an operator opens no home"
    );
    let refused = yard.audited(&["--action", "refused"]);
    let counted = |by: &str, code: &str| {
        refused.iter().any(|line| {
            let operator = line["operator"].as_str().map_or_else(String::new, |name| format!("/{name}"));
            text(line, "profile") + &operator == by && line["subject"] == code
        })
    };
    assert!(counted(&format!("yard/{}", accounts.name("bob")), "needs capture"), "{refused:?}");
    assert!(counted(&format!("yard/{}", accounts.name("bob")), "needs grant"), "{refused:?}");
    assert!(counted(&by, "needs owner"), "{refused:?}");
    assert_eq!(yard.owner.json(&["audit", "verify"])["ok"], true);
}

#[test]
fn the_homes_socket_is_its_owners_and_an_operator_gives_no_passphrase() {
    let accounts = match Accounts::make(&["keeper", "bob", "eve", "rob", "mallory"]) {
        Ok(accounts) => accounts,
        Err(reason) => skipped!(reason),
    };
    let mut yard = Yard::open(&accounts);
    // Root, too, who can open every file, and would be told before anything is sent.
    let roots = Home::new();
    let root = Authros::bare(roots.root()).with(&["--home", yard.home.to_str().expect("UTF-8"), "--profile", "yard"]);
    let refusal = root.fails(REFUSED, &["records", "list", "--oldest"]);
    assert!(refusal.contains("belongs to user") && refusal.contains("run this as that user"), "{refusal}");
    // Even if every door to it stood open.
    let own = yard.home.join("site.sock");
    let keeper = accounts.home("keeper");
    for (path, mode) in [(&keeper, 0o755), (&yard.home, 0o755), (&own, 0o666)] {
        assert_ne!(fs::metadata(path).expect("there").permissions().mode() & 0o777, mode);
        fs::set_permissions(path, Permissions::from_mode(mode)).expect("its mode is set");
    }
    let mut line = accounts.line(&accounts.name("bob"), &own);
    let refusal = line.next().expect("a refusal");
    assert!(text(&refusal["refused"], "message").contains("only that user may use its socket"), "{refusal}");
    for (path, mode) in [(&own, 0o600), (&yard.home, 0o700), (&keeper, 0o700)] {
        fs::set_permissions(path, Permissions::from_mode(mode)).expect("its mode is set");
    }

    // A passphrase is refused at every step: by the arguments, before one is asked for, and by the site.
    let bob = yard.operator(&accounts, "bob");
    let words = accounts.home("bob").join("words");
    bob.with(&["--passphrase-file", words.to_str().expect("UTF-8")])
        .run(&["records", "list", "--oldest"])
        .expect_code(USAGE);
    for arguments in [&["keys", "passphrase"][..], &["identity", "create"]] {
        assert!(bob.fails(REFUSED, arguments).contains("gives no passphrase"), "{arguments:?}");
    }
    let mut line = accounts.line(&accounts.name("bob"), &yard.socket);
    for command in [
        json!({ "command": "unlock", "passphrase": "a guess" }),
        json!({ "command": "unlock", "passphrase": ["not", "a", "text"] }),
        json!({ "command": "back_up", "file": "/tmp/x", "passphrase": "a guess" }),
    ] {
        let answer = line.ask("yard", &command);
        assert!(text(&answer["Err"], "message").contains("reads none here"), "{command}: {answer}");
    }
    assert!(line.ask("yard", &json!({ "command": "list_grants" }))["Ok"].is_object(), "the connection goes on");
    drop(line);

    // The console says who asks, and asks for nothing.
    yard.owner.run(&["keys", "lock"]).expect_code(0);
    let mut console = Console::open_in(&Terminal::of(120, 30), &bob, &[]);
    console.wait_for(&format!("OPERATOR {}", accounts.name("bob")), PATIENCE);
    console.press("2");
    console.wait_for(TOPIC, PATIENCE);
    console.press("w");
    console.wait_for("only the owner of this site", PATIENCE);
    console.press("u");
    console.wait_for("only for the owner", PATIENCE);
    assert!(!console.shown().contains("Passphrase"), "{}", console.shown());
    drop(console);
    yard.stop();
}

#[test]
fn a_user_without_a_name_and_one_of_another_namespace_are_refused() {
    let accounts = match Accounts::make(&["bob", "mallory"]) {
        Ok(accounts) => accounts,
        Err(reason) => skipped!(reason),
    };
    let Some(unshare) = system_program("unshare") else { skipped!("no unshare") };
    let inside: Vec<&str> = vec!["--user", "--map-root-user", "--"];
    if !std::process::Command::new(&unshare).args(&inside).arg("true").status().is_ok_and(|ended| ended.success()) {
        skipped!("user namespaces are switched off");
    }
    let home = Home::new();
    fs::set_permissions(home.root(), Permissions::from_mode(0o755)).expect("its mode is set");
    let site = home.authros().with(&["--robots", "0"]);
    site.enrol();
    let run = home.root().join("run");
    fs::create_dir(&run).expect("a folder");
    let socket = run.join("operators.sock");
    let rights = format!(
        "{{ {} = [\"look\"], nobody = [\"look\"], \"@{}\" = [\"look\"] }}",
        accounts.name("bob"),
        accounts.group
    );
    let site = site
        .with_variable("AUTHROS_OPERATORS_SOCKET", socket.to_str().expect("UTF-8"))
        .with_variable("AUTHROS_OPERATORS_RIGHTS", &rights);
    let heard = |user: &str| {
        wait_until(60, "the operators' socket", || socket.exists().then_some(()));
        // In place of a group that both are in.
        fs::set_permissions(&socket, Permissions::from_mode(0o666)).expect("its mode is set");
        accounts.line(user, &socket).next().expect("a line")
    };
    let refusal = |said: &Value| text(&said["refused"], "message");

    let running = site.serve(&home);
    let said = heard("59999");
    assert!(refusal(&said).contains("no name for user 59999"), "{said}");
    let said = heard("65534");
    assert!(refusal(&said).contains("another user namespace"), "{said}");
    assert!(heard(&accounts.name("bob"))["greeting"].is_object(), "bob is known here");
    // The program itself does not know as whom it would ask.
    let nameless = accounts.authros_as(home.root(), &accounts.claims_the_group("59999"));
    let given = ["--site-socket", socket.to_str().expect("UTF-8")];
    assert!(nameless.with(&given).fails(REFUSED, &["records", "list", "--oldest"]).contains("no name for user"));
    running.stop("INT", 30).expect_code(0);

    // The same bob, seen from a namespace that has root alone.
    fs::remove_file(&socket).expect("removed");
    let program = site.program().to_str().expect("UTF-8").to_owned();
    let contained = site.with_program(&unshare).with_prefix(&[&inside[..], &[program.as_str()]].concat());
    let running = contained.serve(&home);
    let said = heard(&accounts.name("bob"));
    assert!(refusal(&said).contains("user 65534 belongs to another user namespace"), "{said}");
    running.stop("INT", 30).expect_code(0);
}

#[test]
fn names_and_rights_that_do_not_exist_are_told_with_file_and_line() {
    let home = Home::new();
    let authros = home.authros();
    let check = |rights: &str| {
        fs::create_dir_all(home.path()).expect("a home");
        fs::set_permissions(home.path(), Permissions::from_mode(0o700)).expect("its mode is set");
        let text = format!(
            "[operators]\nsocket = \"/run/authros/operators.sock\"\n[operators.rights]\nroot = [\"look\"]\n{rights}\n"
        );
        fs::write(home.path().join("config.toml"), text).expect("written");
        authros.with(&["--json"]).run(&["config", "check"])
    };
    check("\"@root\" = [\"look\", \"capture\"]").expect_code(0);
    for (rights, words) in [
        ("nobody-is-here = [\"look\"]", "no user 'nobody-is-here'"),
        ("\"@nobody-is-here\" = [\"look\"]", "no group 'nobody-is-here'"),
        ("daemon = [\"read\"]", "look, capture, grant"),
        ("\"alice/bob\" = [\"look\"]", "not a usable name"),
    ] {
        let outcome = check(rights).expect_code(INPUT);
        let message = text(&outcome.document()["error"], "message");
        assert!(message.contains("config.toml line 5") && message.contains(words), "{rights}: {message}");
    }
}

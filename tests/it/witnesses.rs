//! Two sites of two parties, each the other's witness through its gateway; what a third one sees of that in a bundle, and
//! what the witness says once one of them has another chain.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::evidence::{expect_agreement, expect_same_levels, unzipped, verified};
use crate::support;

use std::fs;
use std::path::{Path, PathBuf};

use authros::crypto::{ProviderName, provider};
use authros::evidence::witness::{check_countersignature, check_position};
use authros::model::{Countersignature, SignedPosition};
use serde_json::Value;
use support::member::Gateway;
use support::{Authros, Home, Running, count, list, system_program, text, unhex};

const TOPIC: &str = "/robot1/odom";
const INPUT: i32 = 3;
const UNREACHABLE: i32 = 4;
const REFUSED: i32 = 5;
const TAMPERED: i32 = 6;

/// A home whose site and gateway run, with a few anchored records.
struct Party {
    home: Home,
    authros: Authros,
    gateway: Gateway,
    served: Running,
    site: Running,
}

impl Party {
    fn new() -> Self {
        let home = Home::new();
        let authros = home.authros().with(&["--robots", "1"]);
        let site = authros.serve(&home);
        authros.enrol();
        let mut served = authros.with(&["--json"]).spawn(&["gateway", "serve", "--listen", "127.0.0.1:0"]);
        let told = served.wait_for_text("\"joined\"", 60);
        let line = told.lines().find(|line| line.contains("\"joined\"")).expect("one line");
        let gateway = Gateway::of(&serde_json::from_str(line).expect("JSON"));
        authros.capture(&[TOPIC], 3);
        Self { home, authros, gateway, served, site }
    }

    /// The other party, as its operator told this one's: account and key.
    fn adds(&self, other: &Self, name: &str) -> Vec<Value> {
        let (key, Gateway { address, account, .. }) = (other.gateway.id.to_string(), &other.gateway);
        let words = ["witness", "add", address, "--account", account, "--key", &key, "--name", name, "--serve"];
        list(&self.authros.json(&words), "witnesses")
    }

    fn end(self) -> Home {
        self.served.stop("INT", 30).expect_code(0);
        self.site.stop("INT", 30).expect_code(0);
        self.home
    }
}

fn place(home: &Home, name: &str) -> (PathBuf, String) {
    let path = home.root().join(name);
    let text = path.to_str().expect("UTF-8").to_owned();
    (path, text)
}

/// Level (g) of each chosen record.
fn witnessed(bundle: &Path, trust: &Path) -> Vec<(String, String)> {
    let report = verified(bundle, Some(trust)).expect_code(8).document();
    let levels = list(&report, "records").into_iter().map(|record| record["witnessed"].clone());
    levels.map(|level| (text(&level, "standing"), text(&level, "text"))).collect()
}

#[test]
fn sites_are_each_others_witnesses_and_one_that_writes_its_chain_anew_is_exposed() {
    let (fleet, harbour) = (Party::new(), Party::new());
    let own = fleet.authros.json(&["witness", "status"]);
    assert_eq!(
        (text(&own, "account"), text(&own, "key")),
        (fleet.gateway.account.clone(), fleet.gateway.id.to_string())
    );
    assert!(fleet.authros.fails(INPUT, &["witness", "ask"]).contains("witness add HOST:PORT"));
    let rows = fleet.adds(&harbour, "The harbour");
    assert_eq!((rows.len(), count(&rows[0], "given")), (1, 0), "{rows:?}");
    // The other side has to want it, too.
    let message = fleet.authros.fails(REFUSED, &["witness", "ask"]);
    assert!(message.contains("does not serve this profile") && message.contains("--serve"), "{message}");
    harbour.adds(&fleet, "The fleet");
    for party in [&fleet, &harbour] {
        let answers = party.authros.json(&["witness", "ask"]);
        let given = list(&answers, "given");
        assert!(given.len() == 1 && count(&given[0], "batches") >= 1 && answers["problem"].is_null(), "{answers}");
    }
    assert!(list(&fleet.authros.json(&["witness", "ask"]), "given").is_empty(), "nothing new");

    let (backup, secret) =
        (place(&fleet.home, "old.backup").1, fleet.home.file("secret", "a passphrase of it\n", 0o600));
    let (then, name) = place(&fleet.home, "then.authros");
    fleet.authros.json(&["evidence", "export", &name, "--topic", TOPIC]);
    fleet.authros.json(&["backup", &backup, "--passphrase-file", &secret]);
    fleet.authros.capture(&[TOPIC], 2);
    let newest = list(&fleet.authros.json(&["witness", "ask"]), "given");
    assert_eq!(newest.len(), 1, "{newest:?}");
    seen_offline(&fleet);

    // The home as it was then, on another machine, goes on with the same keys.
    let fleet_home = fleet.end();
    let other = Home::new();
    let restored = other.authros().with(&["--robots", "1"]);
    restored.json(&["restore", &backup, "--passphrase-file", &secret]);
    let (bundle, name) = place(&other, "old.authros");
    restored.json(&["evidence", "export", &name, "--topic", TOPIC]);
    let levels = witnessed(&bundle, &fleet_home.root().join("trust.toml"));
    assert!(!levels.is_empty() && levels.iter().all(|(standing, _)| standing == "proven"), "{levels:?}");
    expect_same_levels(&then, &bundle, &fleet_home.root().join("trust.toml"));
    restored.capture(&[TOPIC], 3);
    let message = restored.fails(TAMPERED, &["witness", "ask"]);
    assert!(message.contains("The harbour") && message.contains("contradicts"), "{message}");
    exposed(&harbour, &newest[0]);

    // A witness that is not there holds nothing up.
    harbour.end();
    let message = restored.fails(UNREACHABLE, &["witness", "ask"]);
    assert!(message.contains("The harbour"), "{message}");
    assert!(list(&restored.json(&["witness", "remove", "The harbour"]), "witnesses").is_empty());
}

/// A reader who has a bundle, and pinned the harbour.
fn seen_offline(fleet: &Party) {
    let (bundle, name) = place(&fleet.home, "case.authros");
    fleet.authros.json(&["evidence", "export", &name, "--topic", TOPIC]);
    let trust = fleet.home.root().join("trust.toml");
    let suggested = String::from_utf8(unzipped(&bundle, "trust.toml")).expect("text");
    fs::write(&trust, &suggested).expect("written");
    let levels = witnessed(&bundle, &trust);
    let told = |text: &str| {
        text.contains("on the clock of The harbour whom you pinned") && text.contains("the one that is here")
    };
    assert!(levels.len() >= 5, "{levels:?}");
    assert!(levels.iter().all(|(standing, text)| standing == "proven" && told(text)), "{levels:?}");
    if system_program("python3").is_some() {
        expect_agreement(&bundle, Some(&trust));
    }
    let arguments = ["verify", &name, "--trust", trust.to_str().expect("UTF-8"), "--verbose"];
    let people = fleet.authros.run(&arguments).expect_code(8).stdout;
    assert!(people.contains("(g)") && people.contains("The harbour"), "{people}");
    let (pins, _) = suggested.split_once("[[witness]]").expect("a witness is suggested");
    let bare = fleet.home.root().join("bare.toml");
    fs::write(&bare, pins).expect("written");
    let levels = witnessed(&bundle, &bare);
    assert!(levels.iter().all(|(standing, text)| standing == "unproven" && text.contains("did not pin")), "{levels:?}");
}

/// The witness shows both statements, each signed by the fleet; anybody can check them.
fn exposed(harbour: &Party, newest: &Value) {
    let status = harbour.authros.json(&["witness", "status"]);
    let found = list(&status, "contradictions");
    assert_eq!((found.len(), text(&found[0], "name").as_str()), (1, "The fleet"), "{status}");
    let kept = Countersignature::parse(&unhex(&text(&found[0], "kept"))).expect("a countersignature");
    let later = SignedPosition::parse(&unhex(&text(&found[0], "later"))).expect("a statement");
    let second = provider(ProviderName::RustCrypto);
    check_countersignature(&kept, second).expect("both signatures hold");
    check_position(&later, second).expect("its signature holds");
    let (one, two) = (kept.stated.position, later.position);
    assert_eq!((one.key, one.owner, one.chain_id, one.genesis), (two.key, two.owner, two.chain_id, two.genesis));
    assert_eq!(one.block, count(newest, "block"), "what was countersigned last");
    let blocks = two.earlier.into_iter().chain([(two.block, two.block_hash)]);
    let differs = |(block, hash)| block == one.block && hash != one.block_hash;
    assert!(blocks.into_iter().any(differs), "{one:?} {two:?}");
    let health = harbour.authros.json(&["status"]);
    let part = list(&health, "health").into_iter().find(|part| part["part"] == "witnesses").expect("a part");
    assert!(part["level"] == "failed" && text(&part, "text").contains("two histories"), "{part}");
    let audit = harbour.authros.json(&["audit", "list", "--action", "equivocation"]);
    let lines = list(&audit, "audit");
    let kept_signature = kept.stated.signature.to_string();
    let shows = text(&lines[0], "outcome").starts_with(&kept_signature);
    assert!(lines.len() == 1 && kept_signature.len() == 128 && shows, "{audit}");
    let doctor = harbour.authros.with(&["--json"]).run(&["doctor"]).stdout;
    assert!(doctor.contains("site witnesses"), "{doctor}");
}

//! Somebody was lent the right to look. With it he grants to himself, begins an epoch, reads, makes himself a better
//! operator, and sends again what another operator's connection began with; then he asks until the log should be full.

use std::io::{BufRead as _, BufReader, Write as _};
use std::os::unix::net::UnixStream;
use std::path::Path;

use authros::crypto::{OperatorKey, Passphrase, ProviderName, provider};
use authros::model::Address;
use serde_json::{Value, json};

use crate::judge;
use crate::parts::Parts;
use crate::support::{Authros, Home, list, text};

const TOPIC: &str = "/robot1/odom";
const REFUSED: i32 = 5;
const TRIES: usize = 200;

/// A connection to the socket, line by line.
struct Line {
    stream: UnixStream,
    answers: BufReader<UnixStream>,
    number: u64,
}

impl Line {
    fn new(home: &Home) -> Self {
        let stream = UnixStream::connect(home.socket().expect("a site")).expect("connects");
        let answers = BufReader::new(stream.try_clone().expect("two ends"));
        Self { stream, answers, number: 0 }
    }

    /// The answer to one request of alice's profile.
    fn ask(&mut self, command: &Value) -> Value {
        self.ask_at("alice", command)
    }

    fn ask_at(&mut self, profile: &str, command: &Value) -> Value {
        self.number += 1;
        let request = json!({ "number": self.number, "profile": profile, "command": command });
        self.stream.write_all(format!("{request}\n").as_bytes()).expect("sent");
        loop {
            let mut line = String::new();
            assert!(self.answers.read_line(&mut line).expect("read") > 0, "the site hung up");
            let message: Value = serde_json::from_str(&line).expect("JSON");
            if message["answer"]["number"] == self.number {
                return message["answer"]["with"].clone();
            }
        }
    }

    fn challenge(&mut self) -> Value {
        self.ask(&json!({ "command": "of_operator", "operator": "challenge_operator" }))["Ok"]["with"].clone()
    }
}

/// The first thing an operator says, for the challenge of a connection.
fn introduction(key: &OperatorKey, asked: &Value) -> Value {
    let challenge =
        authros::model::Digest::from_slice(&crate::support::unhex(&text(asked, "challenge"))).expect("32 bytes");
    let account: Address = text(asked, "account").parse().expect("an account");
    let proof = key.prove(provider(ProviderName::Authros), (&challenge.0, &account, "alice")).expect("signs");
    json!({ "command": "of_operator", "operator": "act_as_operator", "name": key.name, "proof": proof })
}

fn add(alice: &Authros, home: &Home, name: &str, rights: &str) -> (String, String) {
    let passphrase = home.file(&format!("{name}.secret"), format!("{name}'s own words\n"), 0o600);
    let file = home.root().join(format!("{name}.operator")).to_str().expect("UTF-8").to_owned();
    let arguments =
        ["operators", "add", name, "--rights", rights, "--out", &file, "--operator-passphrase-file", &passphrase];
    alice.json(&arguments);
    (file, passphrase)
}

fn opened((file, passphrase): &(String, String)) -> OperatorKey {
    let words = std::fs::read_to_string(passphrase).expect("words");
    let passphrase = Passphrase::new(words).expect("long enough");
    OperatorKey::open(provider(ProviderName::Authros), Path::new(file), &passphrase).expect("opens")
}

#[test]
fn work_beyond_an_operators_rights() {
    let home = Home::new();
    let alice = home.profile("alice");
    let site = alice.with(&["--robots", "1"]).serve(&home);
    let reader = home.profile("carol").enrol();
    alice.capture(&[TOPIC], 1);
    let id = text(&alice.records(&["uploads", "list"])[0], "id");
    let (of_bob, of_eve) = (add(&alice, &home, "bob", "look"), add(&alice, &home, "eve", "look,grant"));
    let bob = alice.with(&["--operator", &of_bob.0, "--passphrase-file", &of_bob.1]);
    assert_eq!(list(&bob.json(&["uploads", "list"]), "records").len(), 1, "looking is his");

    let mut parts = Parts::default();
    let out = |name: &str| home.root().join(name).to_str().expect("UTF-8").to_owned();
    let (bundle, stronger) = (out("bundle.authros"), out("stronger.operator"));
    for (words, arguments) in [
        ("needs the right 'grant'", &["grant", &reader][..]),
        ("needs the right 'capture'", &["topics", "watch", TOPIC]),
        ("only the owner", &["keys", "rotate"]),
        ("only the owner", &["evidence", "export", &bundle, "--reveal", &id]),
        ("only the owner", &["shared", "open", &id]),
        (
            "only the owner",
            &[
                "operators",
                "add",
                "rob",
                "--rights",
                "grant",
                "--out",
                &stronger,
                "--operator-passphrase-file",
                &of_bob.1,
            ],
        ),
    ] {
        parts.refused(&arguments.join(" "), &bob.fails(REFUSED, arguments), words);
    }
    assert!(!Path::new(&bundle).exists() && !Path::new(&stronger).exists(), "nothing was written");

    // Eve's connection, to the letter; her first words again on bob's.
    let (eve, mut hers) = (opened(&of_eve), Line::new(&home));
    let asked = hers.challenge();
    let her_words = introduction(&eve, &asked);
    assert!(hers.ask(&her_words)["Ok"].is_object(), "she is who she says");
    let mut his = Line::new(&home);
    his.challenge();
    match his.ask(&her_words) {
        answer if answer["Ok"].is_object() => parts.reached("the connection of another operator".to_owned()),
        answer => parts.refused("replay", &text(&answer["Err"], "message"), "the signature is of another connection"),
    }
    // Without what he heard he acts as himself, and asks for what is not his.
    let mut flood = Line::new(&home);
    let own = opened(&of_bob);
    let asked = flood.challenge();
    assert!(flood.ask(&introduction(&own, &asked))["Ok"].is_object());
    let elsewhere = flood.ask_at("carol", &json!({ "command": "list_grants" }));
    parts.refused("another profile", &text(&elsewhere["Err"], "message"), "an operator of profile 'alice'");
    let grant = json!({ "command": "grant", "grantee": reader, "topics": [], "epochs": "all", "expires": null });
    for _ in 0..TRIES {
        let answer = flood.ask(&grant);
        if answer["Err"]["kind"] != "refused" {
            parts.reached(format!("a grant: {answer}"));
        }
    }
    drop((hers, his, flood));
    site.stop("INT", 30).expect_code(0);

    let lines = list(&alice.json(&["audit", "list", "--limit", "1000", "--by-operator", "bob"]), "audit");
    let tried = |line: &&Value| line["action"] == "refused" && line["subject"] == "needs grant";
    let told = lines.iter().filter(tried).count();
    // One line a minute, however often he asked; the whole takes a few minutes at most.
    if !(1..=10).contains(&told) {
        parts.otherwise(format!("{TRIES} refused grants left {told} lines"));
    }
    assert!(lines.iter().all(|line| line["profile"] == "alice" && line["operator"] == "bob"), "{lines:?}");
    assert!(list(&alice.json(&["grants", "list"]), "grants").is_empty(), "nobody reads");
    judge("work_beyond_an_operators_rights", parts.outcome());
}

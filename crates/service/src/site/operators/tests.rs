//! Operators without processes of their own: some with rights that are not looked up, and this user at the real socket.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::io::{AsyncBufReadExt as _, AsyncWriteExt as _, BufReader};
use tokio::net::UnixStream;
use tokio::sync::{broadcast, mpsc};

use super::Operator;
use crate::accounts::Account;
use crate::command::{Ask, CreateIdentity, ListAlerts, RotateKeys, SecretText, Unlock, UnwatchTopic, WatchTopic};
use crate::model::{ErrorKind, OperatorName, OperatorRight, OperatorRights};
use crate::site::testing::{PASSPHRASE, profile, site_of};
use crate::site::{Asker, Heard, Needs, Site, joiner};
use crate::store::AuditQuery;
use crate::{Client, Event, NoticeLevel, socket};

const NONE: Needs = Needs { ros: false, chain: false };
/// No account of any machine.
const NOBODY: u32 = 4_000_000_000;

fn name(text: &str) -> OperatorName {
    text.parse().expect("a name")
}

/// A user whose rights count from some time on, and are then looked up.
fn operator(who: &str, right: OperatorRight, from: Instant) -> Asker {
    let rights: OperatorRights = [right].into_iter().collect();
    Asker::Operator(Arc::new(Operator {
        uid: NOBODY,
        name: name(who),
        standing: tokio::sync::Mutex::new((from, rights)),
    }))
}

fn later() -> Instant {
    Instant::now() + Duration::from_secs(3600)
}

fn joined(site: &Arc<Site>, asker: Asker) -> Client {
    let (calls, receiver) = mpsc::unbounded_channel();
    tokio::spawn(Arc::clone(site).serve(receiver, joiner(asker)));
    Client::new(profile("alice"), calls, site.parts.hub.events().clone())
}

async fn made(site: &Arc<Site>, name: &str) -> Client {
    let owner = site.client(profile(name));
    let passphrase = SecretText::new(PASSPHRASE.to_owned());
    owner.ask(CreateIdentity { passphrase }).await.expect("an identity");
    owner
}

async fn refused<A: Ask>(client: &Client, ask: A, words: &str) {
    let failure = client.ask(ask).await.err().expect("refused");
    assert!(failure.kind == ErrorKind::Refused && failure.message.contains(words), "{failure:?}");
}

fn watch() -> WatchTopic {
    WatchTopic { topic: "/odom".parse().expect("a topic"), type_name: None, sampling: None }
}

fn unlock() -> Unlock {
    Unlock { passphrase: SecretText::new(PASSPHRASE.to_owned()) }
}

/// Who did it, what, and to what, of all lines of an operator.
fn lines_of(site: &Site, operator: &str) -> Vec<(String, String, String)> {
    let query = AuditQuery { operator: Some(operator.to_owned()), limit: 100, ..AuditQuery::default() };
    let lines = site.parts.log.lines().list(&query).expect("lines");
    lines.into_iter().map(|line| (line.entry.profile, line.entry.action, line.entry.subject)).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn each_does_what_its_rights_say_and_the_log_names_it() {
    let (site, _folder) = site_of(&[], NONE);
    let owner = made(&site, "alice").await;
    let looks = joined(&site, operator("bob", OperatorRight::Look, later()));
    looks.ask(ListAlerts).await.expect("looking");
    refused(&looks, watch(), "needs the right 'capture'").await;
    refused(&looks, RotateKeys, "only the owner").await;
    refused(&looks, unlock(), "only the owner").await;
    refused(&looks.for_profile(profile("carol")), ListAlerts, "no profile 'carol'").await;

    let captures = joined(&site, operator("eve", OperatorRight::Capture, later()));
    refused(&captures, ListAlerts, "needs the right 'look'").await;
    captures.ask(watch()).await.expect("capturing");
    owner.ask(UnwatchTopic { topic: "/odom".parse().expect("a topic") }).await.expect("the owner's own");
    let own = |action: &str, subject: &str| ("alice/eve".to_owned(), action.to_owned(), subject.to_owned());
    assert_eq!(lines_of(&site, "eve"), [own("watch", "/odom"), own("watch", "/odom")], "begun and done");

    site.parts.log.write_counted(None).await;
    let mut tried: Vec<(String, String)> =
        lines_of(&site, "bob").into_iter().map(|(who, action, code)| (who + " " + &action, code)).collect();
    tried.dedup();
    let expected = ["needs capture", "needs owner", "needs passphrase"];
    assert_eq!(tried, expected.map(|code| ("alice/bob refused".to_owned(), code.to_owned())));
    assert!(site.parts.log.lines().verify().is_ok());
    site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_is_nobody_any_more_may_nothing_and_hears_no_more_although_it_asks_nothing() {
    let (site, _folder) = site_of(&[], NONE);
    made(&site, "alice").await;
    let hears = operator("bob", OperatorRight::Look, Instant::now());
    let asks = joined(&site, hears.clone());
    let (heard, mut told) = mpsc::unbounded_channel();
    tokio::spawn(Arc::clone(&site).tell_events(joiner(hears), move |what| heard.send(what).is_ok()));
    asks.ask(ListAlerts).await.expect("looking");
    site.parts.hub.notice(NoticeLevel::Info, "for those who may look");
    let first = told.recv().await.expect("an event");
    assert!(matches!(first, Heard::Event(Event::Notice { text, .. }) if text == "for those who may look"));
    let ended = loop {
        match told.recv().await.expect("an end") {
            Heard::Event(_) => {}
            Heard::Ended(refusal) => break refusal,
        }
    };
    assert!(ended.message.contains("no name for user 4000000000"), "{ended:?}");
    site.parts.hub.notice(NoticeLevel::Info, "a secret of those who stay");
    assert!(told.recv().await.is_none(), "the last was the last");
    refused(&asks, ListAlerts, "no name for user").await;

    let captures = joiner(operator("eve", OperatorRight::Capture, later()));
    let (heard, mut told) = mpsc::unbounded_channel();
    tokio::spawn(Arc::clone(&site).tell_events(captures, move |what| heard.send(what).is_ok()));
    let first = told.recv().await.expect("an end");
    assert!(matches!(first, Heard::Ended(refusal) if refusal.message.contains("needs the right 'look'")));
    site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn without_rights_or_a_name_nobody_is_let_in_and_the_homes_socket_is_its_owners() {
    let (site, _folder) = site_of(&[("operators.rights", "{ nobody-is-here = [\"look\"] }")], NONE);
    let failure = site.admit_operator(NOBODY).await.err().expect("refused");
    assert!(failure.message.contains("no name"), "{failure:?}");
    let own = rustix::process::geteuid().as_raw();
    assert_eq!(site.check_owner(own), Ok(()));
    let other = site.check_owner(own + 1).expect_err("another user");
    assert!(other.kind == ErrorKind::Refused && other.message.contains("--site-socket"), "{other:?}");
    if Account::own().is_ok() {
        let failure = site.admit_operator(own).await.err().expect("refused");
        assert!(failure.message.contains("has no right at this site"), "{failure:?}");
    }
    site.parts.log.write_counted(None).await;
    let query = AuditQuery { action: Some("refused".to_owned()), limit: 9, ..AuditQuery::default() };
    let lines = site.parts.log.lines().list(&query).expect("lines");
    let counted: Vec<(String, String)> =
        lines.into_iter().map(|line| (line.entry.profile, line.entry.subject)).collect();
    assert!(counted.contains(&(format!("user {NOBODY}"), "no user name".to_owned())), "{counted:?}");
    assert!(counted.contains(&(format!("user {}", own + 1), "not the owner".to_owned())), "{counted:?}");
    site.stop().await;
}

/// All notices up to the one with these words.
async fn until(heard: &mut broadcast::Receiver<Event>, words: &str) {
    loop {
        if let Event::Notice { text, .. } = heard.recv().await.expect("the connection stands")
            && text.contains(words)
        {
            return;
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn this_user_is_an_operator_at_the_other_socket_and_no_passphrase_passes_it() {
    // A container may run tests as a number without a name.
    let Ok(Account { name, .. }) = Account::own() else { return };
    let place = tempfile::tempdir().expect("a folder");
    let path = place.path().join("operators.sock");
    let rights = format!("{{ \"{name}\" = [\"look\"] }}");
    let given = [("operators.socket", path.to_str().expect("UTF-8")), ("operators.rights", &rights)];
    let (site, _folder) = site_of(&given, NONE);
    socket::listen(&site).expect("listens");
    let owner = made(&site, "alice").await;
    site.oversee();
    // The file is there before anybody listens.
    while UnixStream::connect(&path).await.is_err() {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    let looks = socket::join_as_operator(&path, profile("alice")).await.expect("joins");
    let mut heard = looks.events();
    looks.ask(ListAlerts).await.expect("looking");
    refused(&looks, watch(), "needs the right 'capture'").await;
    refused(&looks, unlock(), "sends no passphrase").await;
    site.parts.hub.notice(NoticeLevel::Info, "for those who may look");
    until(&mut heard, "for those who may look").await;
    // At the home's own socket the same user is the owner.
    let (own, greeting) = socket::join(site.home(), profile("alice")).await.expect("joins").expect("a site");
    assert!(!greeting.settings.is_empty());
    own.ask(watch()).await.expect("the owner");
    drop(owner);

    // By hand: refused by its kind, so that not even its form is looked at.
    let (reader, mut writer) = UnixStream::connect(&path).await.expect("connects").into_split();
    let mut lines = BufReader::new(reader).lines();
    let greeting = lines.next_line().await.expect("reads").expect("a greeting");
    assert!(greeting.contains(r#""settings":[]"#), "{greeting}");
    let line = r#"{"number":7,"profile":"alice","command":{"passphrase":["not","a","text"],"command":"unlock"}}"#;
    writer.write_all(format!("{line}\n").as_bytes()).await.expect("sent");
    let answer = loop {
        let line = lines.next_line().await.expect("reads").expect("an answer");
        if line.contains(r#""number":7"#) {
            break line;
        }
    };
    assert!(answer.contains("reads none here"), "{answer}");
    site.stop().await;
}

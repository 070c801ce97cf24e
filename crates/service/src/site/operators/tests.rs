//! Operators without processes: each connection is another process as the socket would make it.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use std::sync::Arc;

use tokio::sync::{broadcast, mpsc};

use crate::crypto::{OperatorKey, ProviderName, provider};
use crate::model::{ErrorKind, OperatorName, Signature, Timestamp};
use crate::service::command::{
    ActAsOperator, AddOperator, Ask, ChallengeOperator, CreateIdentity, ListAlerts, ListOperators, RemoveOperator,
    RotateKeys, SecretText, Unlock, UnwatchTopic, WatchTopic,
};
use crate::service::reply::{Failure, OperatorState, OperatorView};
use crate::service::{Client, Event, NoticeLevel, socket};
use crate::site::testing::{PASSPHRASE, profile, site_of};
use crate::site::{Needs, Site, joiner};
use crate::store::AuditQuery;

const NONE: Needs = Needs { ros: false, chain: false };

/// Another process.
fn joined(site: &Arc<Site>, name: &str) -> Client {
    let (calls, receiver) = mpsc::unbounded_channel();
    tokio::spawn(Arc::clone(site).serve(receiver, joiner()));
    Client::new(profile(name), calls, site.parts.hub.events().clone())
}

fn key(name: &str) -> OperatorKey {
    OperatorKey::generate(provider(ProviderName::RustCrypto), name.parse().expect("a name")).expect("a key")
}

async fn made(site: &Arc<Site>, name: &str) -> Client {
    let owner = site.client(profile(name));
    let passphrase = SecretText::new(PASSPHRASE.to_owned());
    owner.ask(CreateIdentity { passphrase }).await.expect("an identity");
    owner
}

async fn add(owner: &Client, key: &OperatorKey, rights: &str) -> Result<Vec<OperatorView>, Failure> {
    let (name, rights) = (key.name.clone(), rights.parse().expect("rights"));
    owner.ask(AddOperator { name, key: key.pair.public, rights, until: None }).await
}

/// The operator's signature over the challenge of this connection, not yet given.
async fn proof(client: &Client, key: &OperatorKey) -> Signature {
    let asked = client.ask(ChallengeOperator).await.expect("a challenge");
    let what = (&asked.challenge.0, &asked.account, client.profile().as_str());
    key.prove(provider(ProviderName::RustCrypto), what).expect("signs")
}

async fn act(client: &Client, key: &OperatorKey) -> Result<OperatorView, Failure> {
    let proof = proof(client, key).await;
    client.ask(ActAsOperator { name: key.name.clone(), proof }).await
}

async fn refused<A: Ask>(client: &Client, ask: A, words: &str) {
    let failure = client.ask(ask).await.err().expect("refused");
    assert!(failure.kind == ErrorKind::Refused && failure.message.contains(words), "{failure:?}");
}

fn watch() -> WatchTopic {
    WatchTopic { topic: "/odom".parse().expect("a topic"), type_name: None }
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
    let (owner, _carol) = (made(&site, "alice").await, made(&site, "carol").await);
    let (bob, eve) = (key("bob"), key("eve"));
    add(&owner, &bob, "look").await.expect("added");
    add(&owner, &eve, "capture").await.expect("added");
    refused(
        &owner,
        AddOperator {
            name: bob.name.clone(),
            key: key("bob").pair.public,
            rights: "look".parse().expect("a right"),
            until: None,
        },
        "already",
    )
    .await;

    let looks = joined(&site, "alice");
    let view = act(&looks, &bob).await.expect("its own key");
    assert_eq!((view.state, view.rights.to_string()), (OperatorState::Stands, "look".to_owned()));
    looks.ask(ListAlerts).await.expect("looking");
    refused(&looks, watch(), "needs the right 'capture'").await;
    refused(&looks, RotateKeys, "only the owner").await;
    refused(&looks, RemoveOperator { name: eve.name.clone() }, "only the owner").await;
    refused(&looks.for_profile(profile("carol")), ListAlerts, "operator of profile 'alice'").await;

    let captures = joined(&site, "alice");
    act(&captures, &eve).await.expect("its own key");
    refused(&captures, ListAlerts, "needs the right 'look'").await;
    captures.ask(watch()).await.expect("capturing");
    owner.ask(UnwatchTopic { topic: "/odom".parse().expect("a topic") }).await.expect("the owner's own");
    let own = |action: &str, subject: &str| ("alice/eve".to_owned(), action.to_owned(), subject.to_owned());
    assert_eq!(lines_of(&site, "eve"), [own("watch", "/odom"), own("watch", "/odom")], "begun and done");

    site.parts.log.write_counted(None).await;
    let tried: Vec<_> =
        lines_of(&site, "bob").into_iter().map(|(who, action, code)| (who + " " + &action, code)).collect();
    let mut tried: Vec<_> = tried.iter().map(|(who, code)| (who.as_str(), code.as_str())).collect();
    tried.dedup();
    assert_eq!(tried, [("alice/bob refused", "needs capture"), ("alice/bob refused", "needs owner")]);
    assert!(site.parts.log.lines().verify().is_ok());
    site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_proof_serves_one_connection_and_an_end_is_heeded_at_once() {
    let (site, _folder) = site_of(&[], NONE);
    let owner = made(&site, "alice").await;
    let (bob, eve) = (key("bob"), key("eve"));
    add(&owner, &bob, "look,capture").await.expect("added");
    let first = joined(&site, "alice");
    let heard = proof(&first, &bob).await;
    let name = |key: &OperatorKey| -> OperatorName { key.name.clone() };
    let other = joined(&site, "alice");
    refused(&other, ActAsOperator { name: name(&bob), proof: heard }, "no operator").await;
    other.ask(ChallengeOperator).await.expect("a challenge of its own");
    refused(&other, ActAsOperator { name: name(&bob), proof: heard }, "no operator").await;
    refused(&other, ActAsOperator { name: name(&eve), proof: heard }, "no operator").await;
    first.ask(ActAsOperator { name: name(&bob), proof: heard }).await.expect("where it was made for");
    refused(&first, ActAsOperator { name: name(&bob), proof: heard }, "no operator").await;
    assert_eq!(act(&first, &bob).await.expect_err("once").kind, ErrorKind::Refused);

    first.ask(watch()).await.expect("capturing");
    owner.ask(RemoveOperator { name: name(&bob) }).await.expect("ended");
    refused(&first, watch(), "was removed").await;
    let query = AuditQuery { action: Some("remove operator".to_owned()), limit: 9, ..AuditQuery::default() };
    let lines = site.parts.log.lines().list(&query).expect("lines");
    assert_eq!(lines.iter().map(|line| line.entry.outcome.as_str()).collect::<Vec<_>>(), ["begun", "done"]);
    // A new key under the old name is another operator.
    add(&owner, &OperatorKey { name: name(&bob), ..eve.clone() }, "capture").await.expect("added");
    refused(&first, watch(), "was removed").await;
    let until = Some(Timestamp(1));
    let asked = AddOperator {
        name: "late".parse().expect("a name"),
        key: key("late").pair.public,
        rights: "look".parse().expect("a right"),
        until,
    };
    assert_eq!(owner.ask(asked).await.expect_err("over already").kind, ErrorKind::Input);
    site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_list_that_the_owner_did_not_sign_makes_nobody_an_operator() {
    let (site, folder) = site_of(&[], NONE);
    let owner = made(&site, "alice").await;
    let (bob, mallory) = (key("bob"), made(&site, "mallory").await);
    add(&mallory, &bob, "look,capture,grant").await.expect("hers");
    let profiles = folder.path().join("home").join("profiles");
    std::fs::copy(profiles.join("mallory").join("operators"), profiles.join("alice").join("operators"))
        .expect("put in");
    let rows = owner.ask(ListOperators).await.expect("rows");
    assert_eq!(rows.iter().map(|row| row.state).collect::<Vec<_>>(), [OperatorState::NotSigned]);
    assert_eq!(act(&joined(&site, "alice"), &bob).await.expect_err("not alice's").kind, ErrorKind::Refused);
    site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn where_operators_are_required_others_give_the_passphrase() {
    let (site, _folder) = site_of(&[("operators.required", "yes")], NONE);
    let owner = made(&site, "alice").await;
    let bob = key("bob");
    add(&owner, &bob, "look").await.expect("the site's own process is the owner's");
    let stranger = joined(&site, "alice");
    refused(&stranger, ListAlerts, "operators.required").await;
    refused(&stranger, watch(), "operators.required").await;
    let unlock = |passphrase: &str| Unlock { passphrase: SecretText::new(passphrase.to_owned()) };
    // The keyring is open: still it has to be the right one.
    refused(&stranger, unlock("not the passphrase"), "wrong passphrase").await;
    refused(&stranger, ListAlerts, "operators.required").await;
    stranger.ask(unlock(PASSPHRASE)).await.expect("the owner");
    stranger.ask(watch()).await.expect("the owner");
    refused(&stranger.for_profile(profile("carol")), ListAlerts, "operators.required").await;
    let looks = joined(&site, "alice");
    act(&looks, &bob).await.expect("an operator");
    looks.ask(ListAlerts).await.expect("looking");
    site.stop().await;
}

/// Another process, through the real socket, and what it hears from now on.
async fn through_the_socket(site: &Site) -> (Client, broadcast::Receiver<Event>) {
    let (client, _) = socket::join(site.home(), profile("alice")).await.expect("joins").expect("a site");
    let heard = client.events();
    (client, heard)
}

/// All notices up to the one with these words.
async fn until(heard: &mut broadcast::Receiver<Event>, words: &str) -> Vec<String> {
    let mut texts = Vec::new();
    loop {
        if let Event::Notice { text, .. } = heard.recv().await.expect("the connection stands") {
            let is_it = text.contains(words);
            texts.push(text);
            if is_it {
                return texts;
            }
        }
    }
}

fn tell(site: &Site, text: &str) {
    site.parts.hub.notice(NoticeLevel::Info, text);
}

/// Whatever was to come has come once its request is answered and the other one, who hears all, has heard what was told.
async fn hears_no_more(client: &Client, heard: &mut broadcast::Receiver<Event>, refusal: &str) {
    refused(client, ListAlerts, refusal).await;
    while let Ok(event) = heard.try_recv() {
        assert!(!matches!(&event, Event::Notice { text, .. } if text.contains("secret")), "{event:?}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_is_no_operator_any_more_hears_no_more_although_it_asks_nothing() {
    let (site, _folder) = site_of(&[], NONE);
    socket::listen(&site).expect("listens");
    let owner = made(&site, "alice").await;
    let (bob, late, eve) = (key("bob"), key("late"), key("eve"));
    add(&owner, &bob, "look").await.expect("added");
    add(&owner, &eve, "capture").await.expect("added");
    let end = Timestamp(Timestamp::now().0 + 2_000_000_000);
    let (name, rights) = (late.name.clone(), "look".parse().expect("a right"));
    owner.ask(AddOperator { name, key: late.pair.public, rights, until: Some(end) }).await.expect("added");

    let (removed, mut of_removed) = through_the_socket(&site).await;
    let (expired, mut of_expired) = through_the_socket(&site).await;
    let (captures, mut of_captures) = through_the_socket(&site).await;
    let (_stays, mut of_owner) = through_the_socket(&site).await;
    act(&removed, &bob).await.expect("its own key");
    act(&expired, &late).await.expect("its own key");
    act(&captures, &eve).await.expect("its own key");
    until(&mut of_captures, "needs the right 'look'").await;
    tell(&site, "for those who may look");
    until(&mut of_removed, "for those who may look").await;
    until(&mut of_expired, "for those who may look").await;

    // Its time is over, and nothing else happens.
    until(&mut of_expired, "may not act now (expired)").await;
    owner.ask(RemoveOperator { name: bob.name.clone() }).await.expect("ended");
    until(&mut of_removed, "operator 'bob' was removed").await;
    tell(&site, "a secret of those who stay");
    until(&mut of_owner, "a secret of those who stay").await;
    hears_no_more(&removed, &mut of_removed, "was removed").await;
    hears_no_more(&expired, &mut of_expired, "may not act now").await;
    hears_no_more(&captures, &mut of_captures, "needs the right 'look'").await;
    site.stop().await;
}

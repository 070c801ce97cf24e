//! A grantee who kept every key he ever had, and every record and envelope there is, tries to open what was sealed
//! after his grant had ended. He asks no program for permission: he decrypts on his own.

use authros::chain::{Chain, ChainOptions, Endpoint, Event, EventAt, Pin};
use authros::crypto::{
    Anchor, EpochKey, Expected, GrantedKeys, Keyring, Names, Passphrase, Provider, ProviderName, domain, open,
    provider, topic_key, unwrap,
};
use authros::model::{Domain, GrantTerms, Identity, ProfileName, RecordKind, Scope, Timestamp};
use authros::store::{Ciphertext, Ledger, RecordQuery, RecordRow, Rights};

use super::NO_NODE;
use super::field::TOPIC;
use crate::support::{Anvil, Authros, Home, Proxy, Running, Spoil, is_verified, list, skipped, text, wait_until};

/// Two profiles of one site.
struct Two {
    home: Home,
    site: Running,
    alice: Authros,
    bob_address: String,
}

/// On the embedded chain, or on a node; alice's first records are captured.
fn two_profiles(url: Option<&str>) -> Two {
    let home = Home::new();
    let chain: Vec<&str> = url.iter().flat_map(|url| ["--chain", url]).collect();
    let site = home.authros().with(&["--robots", "1"]).with(&chain).serve(&home);
    let (alice, bob) = (home.profile("alice"), home.profile("bob"));
    alice.enrol();
    let bob_address = bob.enrol();
    alice.run(&["topics", "watch", TOPIC]).expect_code(0);
    let two = Two { home, site, alice, bob_address };
    two.take(5);
    two
}

impl Two {
    fn taken(&self) -> usize {
        self.alice.records(&["records", "list", "--oldest"]).len()
    }

    /// Waits until this many more records of the watched topic are captured.
    fn take(&self, more: usize) {
        let before = self.taken();
        wait_until(60, "records arrive", || (self.taken() >= before + more).then_some(()));
    }

    /// Ends the site, once everything is verified.
    fn end(self) -> Home {
        self.alice.run(&["topics", "unwatch", TOPIC]).expect_code(0);
        wait_until(90, "all is verified", || {
            let records = self.alice.records(&["records", "list", "--oldest"]);
            records.iter().all(is_verified).then_some(())
        });
        self.site.stop("TERM", 30).expect_code(0);
        self.home
    }
}

/// What the grantee has: his keyring, the chain's events, and a copy of the store.
struct Kept {
    provider: &'static dyn Provider,
    domain: Domain,
    owner: Identity,
    keys: Vec<EpochKey>,
    ledger: Ledger,
    ciphertext: Ciphertext,
}

fn keyring(paths: &authros::paths::Home, name: &str) -> Keyring {
    let profile: ProfileName = name.parse().expect("a name");
    let words = std::fs::read_to_string(paths.passphrase(&profile)).expect("the passphrase of headless use");
    let passphrase = Passphrase::new(words.lines().next().expect("a line").to_owned()).expect("a passphrase");
    Keyring::load(&paths.keyring(&profile), &passphrase).expect("the keyring opens")
}

async fn events(paths: &authros::paths::Home, node: Option<&Anvil>) -> (Pin, Vec<EventAt>) {
    let text = Rights::contract_pin_in(&paths.ledger()).expect("a ledger").expect("a pin");
    let pin: Pin = serde_json::from_str(&text).expect("JSON");
    let endpoint = match node {
        Some(node) => Endpoint::Node { url: node.http(), roots: None },
        None => Endpoint::Embedded { directory: paths.chain(), consensus: None },
    };
    let options = ChainOptions { endpoint, contract: None, pinned: Some(pin.clone()) };
    let chain = Chain::connect(options).await.expect("the chain opens");
    (pin, chain.events(0, u64::MAX).await.expect("its events"))
}

/// Opens every envelope ever sent to `bob`, by grant or by wrap.
async fn keep_everything(home: &Home, node: Option<&Anvil>) -> Kept {
    let paths = authros::paths::Home::new(home.path());
    let provider = provider(ProviderName::RustCrypto);
    let (alice, bob) = (keyring(&paths, "alice").public(), keyring(&paths, "bob"));
    let (pin, events) = events(&paths, node).await;
    let domain = domain(pin.chain_id, &pin.genesis, &pin.contract);
    let owner = events.iter().find_map(|at| match &at.event {
        Event::Registered { owner, identity, .. } if *owner == alice.address => Some(*identity),
        _ => None,
    });
    let owner = owner.expect("alice is registered");
    let mut last: Option<GrantTerms> = None;
    let mut keys = Vec::new();
    for at in &events {
        let (terms, envelope) = match &at.event {
            Event::Granted { terms, envelope } => (terms.clone(), envelope),
            // What others keep for themselves is on the chain for everybody to try.
            Event::Wrapped { owner: keeper, grantee, epoch, envelope } if keeper == grantee => {
                let (owner, grantee, scope) = (*keeper, *grantee, Scope::All);
                let own = GrantTerms { owner, grantee, epoch: *epoch, expiry: None, scope };
                let signer = if *keeper == alice.address { alice.signing } else { bob.signing.public };
                let opened = unwrap(provider, &domain, envelope, &own, &signer, &bob.envelope.secret);
                assert_eq!(opened.is_ok(), *keeper == bob.eoa.address(), "only its owner opens it");
                continue;
            }
            Event::Wrapped { grantee, epoch, envelope, .. } if *grantee == bob.eoa.address() => {
                (GrantTerms { epoch: *epoch, ..last.clone().expect("a grant before") }, envelope)
            }
            _ => continue,
        };
        assert_eq!(terms.grantee, bob.eoa.address(), "there is no other grantee");
        let wrapped = unwrap(provider, &domain, envelope, &terms, &owner.signing, &bob.envelope.secret);
        let GrantedKeys::All { epochs, .. } = wrapped.expect("his envelope opens").keys else { panic!("all topics") };
        keys.extend(epochs.into_iter().map(|(_, key)| key));
        last = Some(terms);
    }
    // His own keys are worth a try too.
    let own: Vec<EpochKey> =
        bob.networks[&domain].epochs.keys().map(|&epoch| bob.epoch_key(&domain, epoch).expect("his")).collect();
    keys.extend(own);
    let ledger = Ledger::open(&paths.ledger()).expect("the ledger opens");
    let ciphertext = Ciphertext::of(&ledger);
    Kept { provider, domain, owner, keys, ledger, ciphertext }
}

impl Kept {
    fn records(&self) -> Vec<RecordRow> {
        let all = |kind| {
            let query = RecordQuery {
                topic: Some(TOPIC.to_owned()),
                kind: Some(kind),
                limit: 10_000,
                ..RecordQuery::default()
            };
            self.ledger.records.list(&query).expect("listed").rows
        };
        [RecordKind::Data, RecordKind::Definition].into_iter().flat_map(all).collect()
    }

    fn opens(&self, row: &RecordRow) -> bool {
        let blob = self.ciphertext.get(row.digest).expect("the store answers").expect("it is there");
        let expected = Expected::any_of(self.domain, row.owner, Names::Given(TOPIC.to_owned()));
        let anchor = Anchor::Chain(row.digest);
        self.keys.iter().any(|key| {
            let key = topic_key(key, &row.topic_id);
            open(self.provider, &blob, &row.signature, &self.owner.signing, anchor, &key, &expected).is_ok()
        })
    }

    /// Fails unless the keys open all records up to `granted_until` captured since `granted_from`, and none from
    /// `ended` on.
    fn expect_shut_out(&self, granted_from: Timestamp, granted_until: Timestamp, ended: Timestamp) {
        let records = self.records();
        let between = |row: &&RecordRow| row.captured_at >= granted_from && row.captured_at < granted_until;
        let (granted, after): (Vec<&RecordRow>, Vec<&RecordRow>) =
            (records.iter().filter(between).collect(), records.iter().filter(|row| row.captured_at >= ended).collect());
        assert!(granted.len() >= 10 && after.len() >= 10, "{} while granted, {} after", granted.len(), after.len());
        assert!(granted.iter().all(|row| self.opens(row)), "his keys are the right ones");
        let opened: Vec<&str> = after.iter().filter(|row| self.opens(row)).map(|row| row.id.as_str()).collect();
        assert_eq!(opened, Vec::<&str>::new(), "opened of {} records sealed after the end", after.len());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_grantee_who_kept_every_key_opens_nothing_sealed_after_the_revoke() {
    let two = two_profiles(None);
    two.alice.json(&["grant", "add", &two.bob_address]);
    let granted = Timestamp::now();
    two.take(20);
    let revoking = Timestamp::now();
    two.alice.json(&["grant", "end", &two.bob_address]);
    let revoked = Timestamp::now();
    two.take(20);
    let home = two.end();
    let kept = keep_everything(&home, None).await;
    kept.expect_shut_out(granted, revoking, revoked);
}

/// Captures across the end of a short grant; returns its start and end.
fn outlast_a_grant(two: &Two, meanwhile: impl FnOnce()) -> (Timestamp, Timestamp) {
    two.alice.json(&["grant", "add", &two.bob_address, "--expires", "15s"]);
    let granted = Timestamp::now();
    meanwhile();
    let grant = || list(&two.alice.json(&["grant", "list"]), "grants").remove(0);
    let expiry: Timestamp = serde_json::from_value(grant()["expires"].clone()).expect("a time");
    wait_until(60, "the grant runs out", || (Timestamp::now() > expiry).then_some(()));
    two.take(40);
    assert_eq!(text(&grant(), "state"), "expired");
    (granted, expiry)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_grantee_who_kept_every_key_opens_nothing_sealed_after_the_expiry() {
    let two = two_profiles(None);
    let (granted, expiry) = outlast_a_grant(&two, || {});
    let home = two.end();
    let kept = keep_everything(&home, None).await;
    kept.expect_shut_out(granted, just_before(expiry), expiry);
}

/// What is captured in the last seconds may be sealed after the end.
fn just_before(expiry: Timestamp) -> Timestamp {
    Timestamp(expiry.0 - 4_000_000_000)
}

/// The next epoch cannot reach the chain when the grant expires; it begins all the same.
#[tokio::test(flavor = "multi_thread")]
async fn a_grant_runs_out_on_a_chain_that_makes_no_blocks() {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let two = two_profiles(Some(&node.http()));
    let (granted, expiry) = outlast_a_grant(&two, || node.set_interval(0));
    node.set_interval(1);
    let home = two.end();
    let kept = keep_everything(&home, Some(&node)).await;
    kept.expect_shut_out(granted, just_before(expiry), expiry);
}

/// The revoke cannot be sent; it is not forgotten, and no rotation in its place gives him the next key.
#[tokio::test(flavor = "multi_thread")]
async fn a_revoke_that_did_not_reach_the_node_is_sent_again_and_nothing_is_wrapped_for_him() {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let proxy = Proxy::before(node.port());
    let two = two_profiles(Some(&proxy.http()));
    two.alice.json(&["grant", "add", &two.bob_address]);
    let granted = Timestamp::now();
    two.take(20);
    let revoking = Timestamp::now();
    proxy.spoil("eth_call", Spoil::Refuse, 1_000_000);
    let outcome = two.alice.run(&["grant", "end", &two.bob_address]).expect_code(4);
    assert!(outcome.stderr.contains("resent until the chain has it"), "{outcome}");
    let asked = Timestamp::now();
    two.take(20);
    proxy.calm();
    wait_until(60, "the revoke reaches the chain", || {
        let grant = list(&two.alice.json(&["grant", "list"]), "grants").remove(0);
        (text(&grant, "state") == "revoked").then_some(())
    });
    two.take(5);
    let home = two.end();
    let kept = keep_everything(&home, Some(&node)).await;
    kept.expect_shut_out(granted, revoking, asked);
}

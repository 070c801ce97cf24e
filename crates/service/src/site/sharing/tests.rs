//! Grants and their end, on an embedded chain.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use super::*;
use crate::crypto::Fingerprint;
use crate::model::{Digest, ErrorKind, RecordKind, RecordState, Signature, SignerId};
use crate::pipeline::{GrantState, recovery};
use crate::reply::Opens;
use crate::site::testing::{made, profile, registered, site_of_two, site_with_chain};
use crate::store::NewRecord;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_grant_is_given_once_to_a_known_key_and_its_end_begins_an_epoch() {
    let (site, _folder, alice, bob) = site_of_two().await;
    let sharing = &site.sharing;
    let to_bob = Party::Address(bob.address);
    let itself = sharing.grant(&alice, &Party::Address(alice.address), &[], GrantFrom::Current, None).await;
    assert!(itself.expect_err("to itself").message.contains("without a grant"));
    let stranger = Party::Address(Address([9; 20]));
    assert!(sharing.grant(&alice, &stranger, &[], GrantFrom::Current, None).await.is_err(), "not registered");

    let given = sharing.grant(&alice, &to_bob, &[], GrantFrom::Current, None).await.expect("given");
    assert_eq!(given.epoch, 1);
    let again = sharing.grant(&alice, &to_bob, &[], GrantFrom::Current, None).await.expect_err("active already");
    assert_eq!(again.kind, ErrorKind::Refused);
    let rows = sharing.rows(&bob).await.expect("rows");
    assert!(
        matches!(rows.as_slice(), [row] if row.direction == Direction::Received && row.state == GrantState::Active)
    );

    let ended = sharing.revoke(&alice, bob.address).await.expect("revoked");
    assert_eq!(ended.epoch, 2, "what is sealed from now on has another key");
    assert_eq!(alice.sealing().map(|keys| keys.epoch), Some(2));
    let network = site.network().await.expect("a network");
    assert!(sharing.active_grant(&network, alice.address, bob.address).is_none());
    assert!(sharing.owed_revocations(&alice, &network).expect("owed").is_empty());
    let twice = sharing.revoke(&alice, bob.address).await.expect_err("nothing to revoke");
    assert!(twice.message.contains("no active grant"), "{}", twice.message);
    site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_epoch_whose_keys_did_not_reach_a_reader_before_the_next_began_is_given_afterwards() {
    let (site, _folder, alice, bob) = site_of_two().await;
    let sharing = &site.sharing;
    // No grant covers this one.
    sharing.rotate(&alice, "before the grant").await.expect("rotates");
    let to_bob = Party::Address(bob.address);
    let given = sharing.grant(&alice, &to_bob, &[], GrantFrom::Current, None).await.expect("given");
    assert_eq!(given.epoch, 2);

    // As if the site had ended between the epoch and its envelopes.
    let network = site.network().await.expect("a network");
    let new_token = alice.prepare_epoch(network.domain, 3).expect("prepared");
    alice.seal_under(network.domain, 3).expect("sealed under it");
    let call = crate::chain::Call::Rotate { new_token, envelope: Vec::new() };
    let (_, receipt) =
        sharing.parts.sender.send(&network.chain, &alice.eoa(), call, "rotate").await.expect("on the chain");
    sharing.parts.link.scanned(receipt.block).await;
    alice.confirm_epoch(network.domain, 3).expect("confirmed");
    let readable = || {
        let reader = crate::pipeline::reader::Reader { plant: &sharing.parts.plant, network: &network, reader: &bob };
        let grant = sharing.active_grant(&network, alice.address, bob.address).expect("stands");
        let envelopes = reader.envelopes(&grant).expect("read");
        let mut epochs: Vec<u64> = envelopes.iter().map(|envelope| envelope.terms.epoch).collect();
        epochs.sort_unstable();
        epochs
    };
    let owed = || sharing.lacking(&alice, &network).expect("owed").into_keys().collect::<Vec<_>>();
    assert_eq!((readable(), owed()), (vec![2], vec![3]));

    sharing.rotate(&alice, "the one after").await.expect("rotates");
    assert_eq!((readable(), owed()), (vec![2, 3, 4], vec![]));
    site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nothing_is_granted_to_a_contact_with_another_key_until_it_is_confirmed() {
    let (site, _folder) = site_with_chain();
    let (alice, bob) = (registered(&site, "alice").await, made(&site, "bob").await);
    let name: crate::model::ContactName = "bobby".parse().expect("a name");
    let other = Fingerprint::of_signer(&SignerId([7; 32])).to_string();
    let own = profile("alice");
    let add =
        |name: &crate::model::ContactName| site.contacts.add(&own, name.clone(), bob.address, Some(other.clone()));
    add(&name).await.expect("nothing is registered yet that could differ");
    site.profiles.register(&bob).await.expect("registers");
    let refused = add(&"second".parse().expect("a name")).await.expect_err("another key is registered");
    assert!(refused.kind == ErrorKind::Refused && refused.message.contains(&other), "{}", refused.message);
    let rows = site.contacts.rows().await.expect("rows");
    assert_eq!(rows.iter().map(|row| row.state.clone()).collect::<Vec<_>>(), ["differs"]);
    let to_bob = Party::Contact(name.clone());
    let refused = site.sharing.grant(&alice, &to_bob, &[], GrantFrom::Current, None).await.expect_err("another key");
    assert_eq!(refused.kind, ErrorKind::Refused);
    assert!(
        refused.message.contains(&other) && refused.message.contains("contacts confirm bobby"),
        "{}",
        refused.message
    );
    assert!(site.sharing.rows(&alice).await.expect("rows").is_empty());

    let wrong = site.contacts.confirm(&profile("alice"), &name, Some(other)).await.expect_err("still another one");
    assert_eq!(wrong.kind, ErrorKind::Refused);
    site.contacts.confirm(&profile("alice"), &name, None).await.expect("confirmed");
    site.sharing.grant(&alice, &to_bob, &[], GrantFrom::Current, None).await.expect("given");
    site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn without_the_current_key_nothing_is_sealed_it_is_told_and_a_rotation_goes_on() {
    let (site, _folder) = site_with_chain();
    let alice = registered(&site, "alice").await;
    let (sharing, network) = (&site.sharing, site.network().await.expect("a network"));
    // An epoch of which no envelope opens, as if another program had begun it.
    let call = crate::chain::Call::Rotate { new_token: crate::model::Token([7; 32]), envelope: vec![7; 360] };
    let (_, receipt) =
        sharing.parts.sender.send(&network.chain, &alice.eoa(), call, "rotate").await.expect("on the chain");
    sharing.parts.link.scanned(receipt.block).await;
    // Refused before: the site ended at its start, and so did each command that unlocks.
    site.profiles.resume(&alice).await.expect("it goes on with what there is");
    assert!(alice.sealing().is_none(), "nobody knows who reads under the first epoch now");
    assert_eq!(alice.epochs(network.domain), [1], "what it has still opens");
    let told = sharing.missing_text().expect("told");
    assert!(told.contains("keys of epochs 2:") && told.contains("authros keys rotate"), "{told}");
    let refused = site.profiles.register(&alice).await.expect_err("nothing can be captured");
    assert!(refused.message.contains("authros keys rotate"), "{}", refused.message);

    let rotated = sharing.rotate(&alice, "asked for").await.expect("needs no key of the epoch that ends");
    assert_eq!((rotated.epoch, alice.sealing().map(|keys| keys.epoch)), (3, Some(3)));
    let told = sharing.missing_text().expect("still told");
    assert!(told.contains("keys of epochs 2:") && !told.contains("nothing new is sealed"), "{told}");
    site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_key_from_the_chain_is_believed_only_if_the_token_commits_to_it() {
    let (site, _folder) = site_with_chain();
    let alice = registered(&site, "alice").await;
    let (sharing, network) = (&site.sharing, site.network().await.expect("a network"));
    let token = alice.prepare_epoch(network.domain, 2).expect("prepared");
    let envelope = recovery::own_envelope(&sharing.parts.plant, &network, &alice, 2).expect("wrapped");
    // The envelope is the owner's, and so is its signature, but the epoch has another key.
    let other = crate::model::Token([9; 32]);
    for (number, new_token) in [(2, other), (3, token)] {
        let call = crate::chain::Call::Rotate { new_token, envelope: envelope.clone() };
        let (_, receipt) = sharing.parts.sender.send(&network.chain, &alice.eoa(), call, "rotate").await.expect("sent");
        sharing.parts.link.scanned(receipt.block).await;
        assert_eq!(network.directory.epoch(alice.address), number);
    }
    let lacking = recovery::lacking(&sharing.parts.plant, &network, &alice).expect("compared");
    assert_eq!(lacking, [2, 3]);
    let still = recovery::recover_epochs(&sharing.parts.plant, &network, &alice, &lacking).expect("read");
    assert_eq!(still, [2, 3], "nothing is believed");
    site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn pairs_that_nobody_handed_over_are_told_and_those_handed_over_are_taken() {
    let (site, _folder) = site_with_chain();
    let alice = registered(&site, "alice").await;
    let (sharing, network) = (&site.sharing, site.network().await.expect("a network"));
    let sm2 = sharing.parts.plant.provider;
    let token = alice.token(network.domain, 1).expect("its token");
    // As another machine of the same owner does, whose keyring this one is an older copy of.
    let elsewhere = async |pair: &crate::crypto::SmKeyPair, envelope: Vec<u8>| {
        let signing = alice.signing();
        let proven = crate::crypto::prove(sm2, &network.domain, &alice.address, &signing, &pair.public, token);
        let call = crate::chain::Call::RotateKeys { identity: proven.expect("proven"), envelope };
        let sent = sharing.parts.sender.send(&network.chain, &alice.eoa(), call, "rotateKeys").await;
        sharing.parts.link.scanned(sent.expect("on the chain").1.block).await;
    };
    let (first, second) = (
        crate::crypto::SmKeyPair::generate(sm2).expect("a pair"),
        crate::crypto::SmKeyPair::generate(sm2).expect("a pair"),
    );
    let former = alice.envelope();
    let handed = |pair: &crate::crypto::SmKeyPair, to: &crate::crypto::SmKeyPair| {
        let signing = alice.signing();
        crate::crypto::hand_over(sm2, &network.domain, &alice.eoa(), (&signing, pair), &to.public).expect("wrapped")
    };
    // A change whose envelope nobody can open.
    elsewhere(&first, vec![1; 200]).await;
    site.profiles.resume(&alice).await.expect("it goes on");
    let told = sharing.missing_text().expect("told");
    assert!(told.contains("newer SM2 keys"), "{told}");
    assert_eq!(alice.envelope(), former);

    elsewhere(&first, handed(&first, &former)).await;
    elsewhere(&second, handed(&second, &first)).await;
    site.profiles.resume(&alice).await.expect("it takes them");
    assert_eq!((alice.envelope(), sharing.missing_text()), (second, None));
    assert!(alice.envelopes().contains(&former) && alice.envelopes().contains(&first), "what was opens still");
    site.stop().await;
}

/// A message of `/odom` in the owner's ledger, as if it had been sealed then.
fn sealed(sharing: &Sharing, owner: &Owner, epoch: u64, seq: u64, captured_at: Timestamp) {
    sealed_on(sharing, owner, "/odom", epoch, seq, captured_at);
}

fn sealed_on(sharing: &Sharing, owner: &Owner, topic: &str, epoch: u64, seq: u64, captured_at: Timestamp) {
    let record = NewRecord {
        digest: Digest([u8::try_from(seq).expect("few"); 32]),
        owner: owner.address,
        topic_id: owner.topic_id(topic),
        seq,
        foreign: None,
        epoch,
        kind: RecordKind::Data,
        signer: SignerId([9; 32]),
        signature: Signature([9; 64]),
        filters: Vec::new(),
        topic: topic.to_owned(),
        type_name: "nav_msgs/Odometry".to_owned(),
        bytes: 1,
        captured_at,
        simulated: false,
        state: RecordState::Stored,
        blob: None,
    };
    sharing.parts.plant.ledger.records.append(vec![record]).expect("in the ledger");
}

/// The epochs that this reader has keys of.
fn opened(sharing: &Sharing, network: &Network, owner: &Owner, reader: &Owner) -> Vec<u64> {
    let reader = Reader { plant: &sharing.parts.plant, network, reader };
    reader.epochs_of(owner.address).expect("read").into_iter().collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn from_now_on_begins_an_epoch_that_the_reader_has_alone_with_those_who_read_before() {
    let (site, _folder, alice, bob) = site_of_two().await;
    let carol = registered(&site, "carol").await;
    let (sharing, network) = (&site.sharing, site.network().await.expect("a network"));
    let (to_bob, to_carol) = (Party::Address(bob.address), Party::Address(carol.address));
    sealed(sharing, &alice, 1, 1, Timestamp::now());
    sharing.grant(&alice, &to_bob, &[], GrantFrom::Current, None).await.expect("given");

    let foreseen = sharing.foresee_grant(&alice, &to_carol, &[], GrantFrom::Now).await.expect("foreseen");
    assert_eq!((foreseen.epoch, foreseen.epochs, foreseen.nothing_older), (2, 1, true));
    // The epoch, Bob's envelope, the grant.
    assert_eq!((foreseen.readers, foreseen.transactions, foreseen.opens), (1, 3, Opens::default()));
    let given = sharing.grant(&alice, &to_carol, &[], GrantFrom::Now, None).await.expect("given");
    assert!(given.text.contains("from now on, nothing older; epoch 2 has begun"), "{}", given.text);
    assert_eq!((given.epoch, alice.sealing().map(|keys| keys.epoch)), (2, Some(2)));
    assert_eq!(opened(sharing, &network, &alice, &carol), [2], "nothing older");
    assert_eq!(opened(sharing, &network, &alice, &bob), [1, 2], "nothing is lost to the other reader");
    let rows = sharing.rows(&alice).await.expect("rows");
    assert_eq!(rows.iter().map(|row| row.from).collect::<Vec<_>>(), [Some(1), Some(2)]);
    assert_eq!(rows.iter().map(|row| row.opens.expect("active").records).collect::<Vec<_>>(), [1, 0]);
    site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn grants_from_now_on_share_an_epoch_that_nothing_was_sealed_in() {
    let (site, _folder, alice, bob) = site_of_two().await;
    let carol = registered(&site, "carol").await;
    let (sharing, counts) = (&site.sharing, &site.sharing.parts.plant.ledger.counts);
    sealed(sharing, &alice, 1, 1, Timestamp::now());
    let mut epochs = Vec::new();
    for reader in [&bob, &carol] {
        let given = sharing.grant(&alice, &Party::Address(reader.address), &[], GrantFrom::Now, None).await;
        epochs.push(given.expect("given").epoch);
    }
    // The site's own statements, such as the head of its audit log, are sealed as well.
    let stated = counts.is_epoch_used(alice.address, 2).expect("looked");
    assert_eq!(epochs[0], 2);
    assert!(epochs[1] == 2 || stated, "{epochs:?}");
    site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_grant_from_a_moment_opens_whole_epochs_and_says_what_they_hold() {
    let (site, _folder, alice, bob) = site_of_two().await;
    let (sharing, network) = (&site.sharing, site.network().await.expect("a network"));
    let at = |minutes: u64| Timestamp(Timestamp::now().0 - minutes * 60_000_000_000);
    sealed(sharing, &alice, 1, 1, at(50));
    sharing.rotate(&alice, "a test").await.expect("rotates");
    let first = at(40);
    sealed(sharing, &alice, 2, 2, first);
    sealed(sharing, &alice, 2, 3, at(30));
    sharing.rotate(&alice, "a test").await.expect("rotates");
    sealed(sharing, &alice, 3, 4, at(20));
    let to_bob = Party::Address(bob.address);
    let foresee = async |from| {
        let foreseen = sharing.foresee_grant(&alice, &to_bob, &[], from).await.expect("foreseen");
        (foreseen.epoch, foreseen.epochs, foreseen.opens.records)
    };
    assert_eq!(foresee(GrantFrom::Current).await, (3, 0, 1));
    assert_eq!(foresee(GrantFrom::Time(at(25))).await, (3, 0, 1));
    assert_eq!(foresee(GrantFrom::Time(at(35))).await, (2, 0, 3));
    assert_eq!(foresee(GrantFrom::Epoch(1)).await, (1, 0, 4));
    assert_eq!(foresee(GrantFrom::Time(at(1))).await, (4, 1, 0), "nothing since: that is from now on");
    for wrong in [GrantFrom::Epoch(0), GrantFrom::Epoch(4), GrantFrom::Time(Timestamp(u64::MAX / 2))] {
        let refused = sharing.grant(&alice, &to_bob, &[], wrong, None).await.expect_err("no such moment");
        assert_eq!(refused.kind, ErrorKind::Input, "{wrong:?}: {}", refused.message);
    }
    assert_eq!(network.directory.epoch(alice.address), 3, "a refused grant begins nothing");

    let odom: [TopicName; 1] = ["/odom".parse().expect("a topic")];
    let given = sharing.grant(&alice, &to_bob, &odom, GrantFrom::Time(at(35)), None).await.expect("given");
    assert!(given.text.contains(&format!("since {}, 3 records", first.in_utc())), "{}", given.text);
    assert_eq!(opened(sharing, &network, &alice, &bob), [2, 3]);
    let rows = sharing.rows(&bob).await.expect("rows");
    let told: Vec<_> = rows.iter().map(|row| (row.from, row.opens)).collect();
    assert_eq!(told, [(Some(2), Some(Opens { records: 3, since: Some(first), of_robots: false }))]);
    site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_epoch_that_began_for_a_grant_which_never_came_gives_nobody_anything() {
    let (site, _folder, alice, bob) = site_of_two().await;
    let (sharing, network) = (&site.sharing, site.network().await.expect("a network"));
    sealed(sharing, &alice, 1, 1, Timestamp::now());
    // As if the site had ended between the two transactions.
    {
        let _one_at_a_time = alice.changes.lock().await;
        assert_eq!(sharing.first_for(&alice, &network, &Scope::All, GrantFrom::Now).await.expect("begun"), (2, true));
    }
    assert!(opened(sharing, &network, &alice, &bob).is_empty());
    sealed(sharing, &alice, 2, 2, Timestamp::now());
    let to_bob = Party::Address(bob.address);
    let given = sharing.grant(&alice, &to_bob, &[], GrantFrom::Now, None).await.expect("the command repeated");
    assert_eq!((given.epoch, opened(sharing, &network, &alice, &bob)), (3, vec![3]), "not what was sealed meanwhile");
    site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn neither_a_clock_ahead_nor_another_topic_widens_a_grant_from_a_moment() {
    let (site, _folder, alice, bob) = site_of_two().await;
    let sharing = &site.sharing;
    let tomorrow = Timestamp(Timestamp::now().0 + 86_400_000_000_000);
    sealed(sharing, &alice, 1, 1, tomorrow);
    let before = Timestamp::now();
    // A robot out of reach still seals another topic under the keys of the first epoch.
    sharing.rotate(&alice, "a test").await.expect("rotates");
    sealed_on(sharing, &alice, "/scan", 1, 2, Timestamp::now());
    sealed(sharing, &alice, 2, 3, Timestamp::now());
    let to_bob = Party::Address(bob.address);
    let foresee = async |topics: &[TopicName]| {
        let foreseen = sharing.foresee_grant(&alice, &to_bob, topics, GrantFrom::Time(before)).await.expect("foreseen");
        (foreseen.epoch, foreseen.opens.records)
    };
    let odom: [TopicName; 1] = ["/odom".parse().expect("a topic")];
    assert_eq!(foresee(&odom).await, (2, 1));
    assert_eq!(foresee(&[]).await, (1, 3), "all topics: the one of the robot too");
    site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_grant_from_a_moment_reaches_into_an_epoch_that_is_not_on_the_chain_yet() {
    let (site, _folder, alice, bob) = site_of_two().await;
    let (sharing, network) = (&site.sharing, site.network().await.expect("a network"));
    sealed(sharing, &alice, 1, 1, Timestamp(Timestamp::now().0 - 3_600_000_000_000));
    let moment = Timestamp::now();
    // As after the end of a grant: sealed under the next keys before the chain has them.
    let given = async {
        let _one_at_a_time = alice.changes.lock().await;
        alice.prepare_epoch(network.domain, 2).expect("prepared");
        alice.seal_under(network.domain, 2).expect("sealed under it");
        sealed(sharing, &alice, 2, 2, Timestamp::now());
        let to_bob = Party::Address(bob.address);
        let foreseen = sharing.foresee_grant(&alice, &to_bob, &[], GrantFrom::Time(moment)).await.expect("foreseen");
        let seen = (foreseen.epoch, foreseen.epochs, foreseen.nothing_older, foreseen.opens.records);
        assert_eq!(seen, (2, 1, false, 1));
        to_bob
    };
    let to_bob = given.await;
    let given = sharing.grant(&alice, &to_bob, &[], GrantFrom::Time(moment), None).await.expect("given");
    assert!(given.text.contains(", 1 record"), "{}", given.text);
    assert_eq!((given.epoch, opened(sharing, &network, &alice, &bob)), (2, vec![2]));
    site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_list_names_the_first_epoch_whose_key_was_given() {
    let (site, _folder, alice, bob) = site_of_two().await;
    let (sharing, network) = (&site.sharing, site.network().await.expect("a network"));
    // An epoch of which no envelope opens, as if another program had begun it.
    let call = crate::chain::Call::Rotate { new_token: crate::model::Token([7; 32]), envelope: vec![7; 360] };
    let (_, receipt) =
        sharing.parts.sender.send(&network.chain, &alice.eoa(), call, "rotate").await.expect("on the chain");
    sharing.parts.link.scanned(receipt.block).await;
    site.profiles.resume(&alice).await.expect("it goes on with what there is");
    sharing.rotate(&alice, "a test").await.expect("rotates");
    assert_eq!(alice.epochs(network.domain), [1, 3]);
    let to_bob = Party::Address(bob.address);
    sharing.grant(&alice, &to_bob, &[], GrantFrom::Epoch(2), None).await.expect("given");
    let rows = sharing.rows(&alice).await.expect("rows");
    assert_eq!((rows[0].from, opened(sharing, &network, &alice, &bob)), (Some(3), vec![3]));
    site.stop().await;
}

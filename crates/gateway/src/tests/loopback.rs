//! Server and client over loopback, with a desk in memory.

use std::collections::VecDeque;
use std::time::Duration;

use super::stage::{Stage, refusal};
use super::*;
use crate::model::{Address, Digest, Hash, Token};

fn alice() -> Member {
    Member::new("alice", 0x11)
}

fn bob() -> Member {
    Member::new("bob", 0x31)
}

#[tokio::test]
async fn a_robot_enrols_uploads_and_reads_back() {
    let stage = Stage::new().await;
    let alice = alice();
    let credentials = stage.enrol(&alice).await;
    let mut client = stage.connect(&credentials).await.expect("connects");
    let small = alice.record(&alice.signing, 1, b"position");
    let receipt = client.upload(vec![small.clone()]).await.expect("receipt");
    let again = client.upload(vec![small.clone()]).await.expect("acknowledged again");
    assert_eq!((stage.desk.record_count(), &receipt.digests), (1, &again.digests));

    // In parts: larger than one frame, and several at once.
    let image = alice.record(&alice.signing, 2, &vec![0x5a; 3 << 20]);
    let many: Vec<Upload> = (3..40).map(|seq| alice.record(&alice.signing, seq, &seq.to_be_bytes())).collect();
    client.upload(vec![image.clone()]).await.expect("in parts");
    assert_eq!(client.upload(many).await.expect("many").digests.len(), 37);
    assert_eq!(stage.desk.record_count(), 39);

    let digest = Digest(context().provider.sm3(&[&image.blob]));
    let fetched = client.fetch(&digest).await.expect("fetches");
    assert_eq!((fetched.blob, fetched.signature), (image.blob, image.signature));
    let missing = client.missing(&[digest, Digest([0; 32])]).await.expect("asked");
    assert_eq!(missing, [(Digest([0; 32]), Code::NotFound)]);

    stage.desk.state().verify();
    let (mut feed, mut seen) = (Feed::of(alice.account()), Vec::new());
    loop {
        let page = client.feed(&feed).await.expect("a page");
        seen.extend(page.entries.iter().map(|entry| entry.seq));
        feed.after(&page);
        if page.upto == page.head {
            break;
        }
    }
    assert_eq!(seen, (1..40).collect::<Vec<u64>>());
    assert_eq!(refusal(client.fetch(&Digest([0; 32])).await), Some(Code::NotFound));
    client.ping().await.expect("a refusal does not end the session");
    stage.server.stop(Duration::from_secs(5)).await;
    assert_eq!(refusal(client.ping().await), Some(Code::Closing));
}

#[tokio::test]
async fn only_the_pinned_gateway_is_named_to() {
    let stage = Stage::new().await;
    let alice = alice();
    stage.desk.admit(&alice);
    let allocate = async |trust: &mut Trust| Client::allocate(&stage.endpoint, trust, &alice.applicant()).await;
    let mut nobody = Trust::default();
    assert!(matches!(allocate(&mut nobody).await, Err(GatewayError::NotPinned(found)) if found == stage.server.id()));
    let mut other = Trust::pinned(crate::crypto::signer_id(&pair(0x77).public));
    assert!(matches!(allocate(&mut other).await, Err(GatewayError::NotTheGateway { .. })));
    let mut newer = stage.trust();
    newer.seen = Some(hello::ListSummary { version: u64::MAX, digest: Digest([0; 32]) });
    assert!(matches!(allocate(&mut newer).await, Err(GatewayError::RolledBack { .. })));
    assert_eq!(stage.desk.state().changes, 0);
    let mut first = Trust::on_first_use();
    allocate(&mut first).await.expect("by explicit wish");
    assert_eq!(first.pinned, Some(stage.server.id()));
}

#[tokio::test]
async fn a_bound_name_is_rebound_by_its_account_alone() {
    let stage = Stage::new().await;
    let alice = alice();
    let first = stage.enrol(&alice).await;
    let mut thief = Member::new("alice", 0x31);
    stage.desk.admit(&thief);
    let allocate =
        async |member: &Member| Client::allocate(&stage.endpoint, &mut stage.trust(), &member.applicant()).await;
    assert_eq!(refusal(allocate(&thief).await), Some(Code::NameBound));
    assert_eq!(stage.desk.state().changes, 1);
    stage.connect(&first).await.expect("the first binding stands");
    let (key, _) = allocate(&alice).await.expect("its own account");
    assert_eq!(stage.code(&first).await, Some(Code::Tag), "the old key is of no use");
    stage.connect(&Credentials { key, ..first }).await.expect("the new one is");

    // Keys that differ from the account's on the chain, and no account at all.
    thief.name = "mallory".parse().expect("a name");
    thief.signing = pair(0x44);
    assert_eq!(refusal(allocate(&thief).await), Some(Code::NotRegistered));
    assert_eq!(refusal(allocate(&Member::new("carol", 0x51)).await), Some(Code::NotRegistered));
    assert_eq!(stage.desk.state().changes, 2);
}

#[tokio::test]
async fn wrong_keys_unknown_names_and_tokens_are_refused_alike() {
    let stage = Stage::new().await;
    let credentials = stage.enrol(&alice()).await;
    let wrong = Credentials { key: crate::crypto::TransportKey::new([1; 32]), ..credentials.clone() };
    assert_eq!(stage.code(&wrong).await, Some(Code::Tag));
    let unknown = Credentials { name: "nobody".parse().expect("a name"), ..credentials.clone() };
    assert_eq!(stage.code(&unknown).await, Some(Code::Tag), "names cannot be probed");
    let token = Credentials { token: Token([0; 32]), ..credentials };
    assert_eq!(stage.code(&token).await, Some(Code::Token));
    assert_eq!(stage.desk.state().changes, 1);
}

#[tokio::test]
async fn a_recalled_device_hears_when_it_was_recalled_and_who_lacks_its_key_hears_nothing() {
    let stage = Stage::new().await;
    let (alice, device) = (alice(), pair(0x66));
    let credentials = stage.enrol(&alice).await;
    let mut client = stage.connect(&credentials).await.expect("connects");
    stage.desk.lend(&alice, &device);
    client.device(&alice.signing, notice_of(&device)).await.expect("noted");
    stage.desk.recall(&alice, &device);
    let recalled = stage.connect(&credentials).await.err().expect("recalled");
    assert!(recalled.to_string().contains("revoked it at 2023-11-14T22:13:20Z"), "{recalled}");
    assert_eq!(recalled.kind(), crate::model::ErrorKind::Refused);
    let wrong = Credentials { key: crate::crypto::TransportKey::new([1; 32]), ..credentials.clone() };
    assert_eq!(stage.code(&wrong).await, Some(Code::Tag), "names cannot be probed");
    assert_eq!(stage.desk.state().refusals, [Code::Recalled, Code::Tag]);
    stage.desk.state().silent = true;
    assert_eq!(stage.code(&wrong).await, Some(Code::Tag), "nor while the chain is silent");
    assert_eq!(stage.code(&credentials).await, Some(Code::Stale), "who has the key is told");
    stage.desk.state().silent = false;
    stage.desk.state().sealed.insert(credentials.name.clone());
    assert_eq!(stage.code(&wrong).await, Some(Code::Tag), "nor while the gateway cannot open the key");
    stage.desk.state().sealed.clear();
    // The name is free again, also for another account.
    let other = Member { name: credentials.name.clone(), ..bob() };
    let fresh = stage.enrol(&other).await;
    stage.connect(&fresh).await.expect("it has the name now");
    assert_eq!(stage.code(&credentials).await, Some(Code::Tag));
}

#[tokio::test]
async fn records_of_others_and_of_recalled_devices_are_refused() {
    let stage = Stage::new().await;
    let (alice, bob) = (alice(), bob());
    let credentials = stage.enrol(&alice).await;
    stage.enrol(&bob).await;
    let mut client = stage.connect(&credentials).await.expect("connects");
    let before = stage.desk.state().changes;
    let mut refused = async |upload: Upload| refusal(client.upload(vec![upload]).await);

    assert_eq!(refused(bob.record(&bob.signing, 1, b"x")).await, Some(Code::NotYours));
    assert_eq!(refused(alice.record(&bob.signing, 1, b"x")).await, Some(Code::Signature), "bob may not sign");
    let (one, two) = (alice.record(&alice.signing, 1, b"x"), alice.record(&alice.signing, 2, b"x"));
    assert_eq!(refused(Upload { signature: two.signature, ..one.clone() }).await, Some(Code::Signature));
    for at in [12, 200, one.blob.len() - 1] {
        let mut altered = one.clone();
        altered.blob[at] ^= 1;
        assert!(refused(altered).await.is_some(), "byte {at}");
    }
    assert_eq!(refused(Upload { blob: one.blob[..100].to_vec(), ..one.clone() }).await, Some(Code::Malformed));

    let device = pair(0x66);
    let sealed = |seq| alice.record(&device, seq, b"from a lent device");
    assert_eq!(refused(sealed(5)).await, Some(Code::Signature), "not lent yet");
    stage.desk.lend(&alice, &device);
    assert_eq!(refused(sealed(5)).await, Some(Code::Signature), "lent, but its key was not told");
    assert_eq!(
        refusal(client.device(&bob.signing, notice_of(&device)).await),
        Some(Code::Signature),
        "not told by alice"
    );
    assert_eq!(refusal(client.device(&alice.signing, notice_of(&pair(0x67))).await), Some(Code::Signature), "not lent");
    let no_point = DeviceNotice { key: crate::model::PublicKey([1; 64]), ..notice_of(&device) };
    let nothing = client.device(&alice.signing, no_point).await;
    assert_eq!(refusal(nothing), Some(Code::Malformed), "no point");
    client.device(&alice.signing, notice_of(&device)).await.expect("told");
    assert_eq!(refusal(client.upload(vec![sealed(5)]).await), None);
    stage.desk.recall(&alice, &device);
    assert_eq!(refusal(client.upload(vec![sealed(6)]).await), Some(Code::Signature), "recalled");
    assert_eq!(stage.desk.state().changes, before + 2);
    // One bad record among many: none is stored.
    assert_eq!(refusal(client.upload(vec![one, sealed(7), two]).await), Some(Code::Signature));
    assert_eq!(stage.desk.state().changes, before + 2);
}

#[tokio::test]
async fn a_suspended_or_rotated_account_is_refused_within_its_session() {
    let stage = Stage::new().await;
    let alice = alice();
    let credentials = stage.enrol(&alice).await;
    let mut client = stage.connect(&credentials).await.expect("connects");
    stage.desk.state().accounts.clear();
    let upload = alice.record(&alice.signing, 1, b"x");
    assert_eq!(refusal(client.upload(vec![upload]).await), Some(Code::NotRegistered));
    assert_eq!(refusal(client.missing(&[Digest([0; 32])]).await), Some(Code::NotRegistered));
    assert_eq!(stage.desk.record_count(), 0);
}

fn grant_to(reader: &Member) -> GrantNotice {
    GrantNotice { grantee: reader.account(), epoch: 1, expiry: 0, transaction: Hash([1; 32]) }
}

fn revoke_of(reader: &Member) -> RevokeNotice {
    RevokeNotice { grantee: reader.account(), epoch: 2, token: Token([2; 32]), transaction: Hash([2; 32]) }
}

/// A follower that gets one record after the other, as they come.
struct Live {
    feed: Feed,
    told: VecDeque<FeedEntry>,
}

impl Live {
    fn of(owner: Address) -> Self {
        Self { feed: Feed::of(owner), told: VecDeque::new() }
    }

    /// The next record; nothing if none comes within `patience`.
    async fn next(&mut self, client: &mut Client, patience: Duration) -> Result<Option<FeedEntry>, GatewayError> {
        if self.told.is_empty() {
            self.feed.wait = patience;
            let page = client.feed(&self.feed).await?;
            self.feed.after(&page);
            self.told.extend(page.entries);
        }
        Ok(self.told.pop_front())
    }
}

const LONG: Duration = Duration::from_secs(30);

async fn connected(stage: &Stage, member: &Member) -> Client {
    let credentials = stage.enrol(member).await;
    stage.connect(&credentials).await.expect("connects")
}

#[tokio::test]
async fn a_follower_gets_records_until_the_revoke_and_none_after() {
    let stage = Stage::new().await;
    stage.desk.state().verify();
    let (alice, bob) = (alice(), bob());
    let (mut owner, mut reader) = (connected(&stage, &alice).await, connected(&stage, &bob).await);
    let mut live = Live::of(alice.account());
    assert_eq!(refusal(live.next(&mut reader, LONG).await), Some(Code::NotAuthorised), "at once");
    let receipt = owner.grant(&alice.signing, grant_to(&bob)).await.expect("noted");
    assert_eq!(receipt.digests.len(), 1);
    for seq in 1..4 {
        let upload = async {
            tokio::time::sleep(Duration::from_millis(50)).await;
            owner.upload(vec![alice.record(&alice.signing, seq, b"live")]).await.expect("receipt");
        };
        let begun = std::time::Instant::now();
        let (told, ()) = tokio::join!(live.next(&mut reader, LONG), upload);
        let entry = told.expect("a page").expect("a record");
        assert_eq!((entry.seq, begun.elapsed() < LONG / 2), (seq, true), "as it comes");
        assert!(!reader.fetch(&entry.digest).await.expect("a record").blob.is_empty());
    }
    // What waits is cut the moment the revocation is seen.
    let revoke = async {
        tokio::time::sleep(Duration::from_millis(50)).await;
        owner.revoke(&alice.signing, revoke_of(&bob)).await.expect("obeyed");
    };
    let (told, ()) = tokio::join!(live.next(&mut reader, LONG), revoke);
    assert_eq!(refusal(told), Some(Code::NotAuthorised));
    owner.upload(vec![alice.record(&alice.signing, 4, b"not for bob")]).await.expect("receipt");
    assert_eq!(refusal(live.next(&mut reader, LONG).await), Some(Code::NotAuthorised));
    reader.ping().await.expect("the session goes on");
}

#[tokio::test]
async fn one_owner_who_gives_nothing_keeps_no_other_away() {
    let stage = Stage::new().await;
    stage.desk.state().verify();
    let (alice, bob) = (alice(), bob());
    let (mut owner, mut reader) = (connected(&stage, &alice).await, connected(&stage, &bob).await);
    reader.upload(vec![bob.record(&bob.signing, 1, b"his own")]).await.expect("receipt");
    owner.upload(vec![alice.record(&alice.signing, 1, b"hers")]).await.expect("receipt");
    let mut both = Feed::of(bob.account());
    both.places.extend(Feed::of(alice.account()).places);
    let mut live = Live { feed: Feed { wait: LONG, ..both }, told: VecDeque::new() };
    let page = reader.feed(&live.feed).await.expect("a page");
    live.feed.after(&page);
    assert_eq!(page.refused, [(alice.account(), Code::NotAuthorised)]);
    assert_eq!(page.entries.iter().map(|told| told.owner).collect::<Vec<_>>(), [bob.account()]);
    owner.grant(&alice.signing, grant_to(&bob)).await.expect("noted");
    let told = loop {
        if let Some(told) = live.next(&mut reader, LONG).await.expect("a page") {
            break told;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    };
    assert_eq!(told.owner, alice.account(), "asked about again, from the beginning");
}

/// Waits until somebody was refused twice because the chain is silent.
async fn asked_again(stage: &Stage) {
    stage.desk.state().asked_in_vain = 0;
    while stage.desk.state().asked_in_vain < 2 {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

#[tokio::test]
async fn who_follows_waits_while_the_chain_is_silent_and_goes_on_or_ends_by_what_it_says_then() {
    let stage = Stage::new().await;
    stage.desk.state().verify();
    let (alice, bob) = (alice(), bob());
    let (mut owner, mut reader) = (connected(&stage, &alice).await, connected(&stage, &bob).await);
    owner.grant(&alice.signing, grant_to(&bob)).await.expect("noted");
    let mut live = Live::of(alice.account());
    stage.desk.state().silent = true;
    assert_eq!(refusal(live.next(&mut reader, Duration::ZERO).await), Some(Code::Stale), "who does not wait is told");
    for seq in 1..3 {
        owner.upload(vec![alice.record(&alice.signing, seq, b"live")]).await.expect("receipt");
    }
    let speak = async {
        asked_again(&stage).await;
        stage.desk.state().silent = false;
    };
    let (told, ()) = tokio::join!(live.next(&mut reader, LONG), speak);
    assert_eq!(told.expect("a page").expect("a record").seq, 1);
    assert_eq!(live.next(&mut reader, LONG).await.expect("a page").expect("a record").seq, 2);
    stage.desk.state().silent = true;
    owner.upload(vec![alice.record(&alice.signing, 3, b"not for bob")]).await.expect("receipt");
    let revoke = async {
        asked_again(&stage).await;
        owner.revoke(&alice.signing, revoke_of(&bob)).await.expect("obeyed");
        stage.desk.state().silent = false;
    };
    let (told, ()) = tokio::join!(live.next(&mut reader, LONG), revoke);
    assert_eq!(refusal(told), Some(Code::NotAuthorised));
}

#[tokio::test]
async fn who_follows_under_replaced_keys_gets_nothing_more() {
    let stage = Stage::new().await;
    stage.desk.state().verify();
    let (alice, bob) = (alice(), bob());
    let (mut owner, mut reader) = (connected(&stage, &alice).await, connected(&stage, &bob).await);
    owner.grant(&alice.signing, grant_to(&bob)).await.expect("noted");
    let mut live = Live::of(alice.account());
    owner.upload(vec![alice.record(&alice.signing, 1, b"live")]).await.expect("receipt");
    live.next(&mut reader, LONG).await.expect("a page").expect("a record");
    let replace = async {
        tokio::time::sleep(Duration::from_millis(50)).await;
        // The chain has another signing key for the reader; the grant stands.
        let other = Account { signing: pair(0x44).public, envelope: bob.envelope.public };
        stage.desk.state().accounts.insert(bob.account(), other);
        owner.upload(vec![alice.record(&alice.signing, 2, b"not under the old keys")]).await.expect("receipt");
    };
    let (told, ()) = tokio::join!(live.next(&mut reader, LONG), replace);
    assert_eq!(refusal(told), Some(Code::NotRegistered));
    assert_eq!(refusal(live.next(&mut reader, LONG).await), Some(Code::NotRegistered));
}

#[tokio::test]
async fn a_request_that_waits_holds_up_no_other_and_ends_with_its_time() {
    let stage = Stage::new().await;
    let alice = alice();
    let mut client = stage.connect(&stage.enrol(&alice).await).await.expect("connects");
    let first = client.feed(&Feed::of(alice.account())).await.expect("a page");
    let wait = Duration::from_millis(700);
    let asked = Feed { id: first.id, wait, ..Feed::of(alice.account()) };
    let begun = std::time::Instant::now();
    let waiting = client.send(&Request::Feed(asked.clone())).await.expect("sends");
    let second = client.send(&Request::Feed(asked)).await.expect("sends");
    let ping = client.send(&Request::Ping).await.expect("sends");
    let (number, refused) = client.receive(LONG).await.expect("answers");
    assert_eq!((number, refused), (second, Answer::Refused(Code::Quota)), "one at a time");
    let (number, pong) = client.receive(LONG).await.expect("answers");
    assert!(number == ping && matches!(pong, Answer::Time(_)) && begun.elapsed() < wait, "{pong:?}");
    let (number, page) = client.receive(LONG).await.expect("answers");
    assert!(number == waiting && begun.elapsed() >= wait, "{page:?}");
    assert!(matches!(page, Answer::Feed(page) if page.entries.is_empty() && page.upto == page.head));
}

#[tokio::test]
async fn notices_signed_by_another_key_change_nothing() {
    let stage = Stage::new().await;
    let (alice, bob) = (alice(), bob());
    let mut client = stage.connect(&stage.enrol(&alice).await).await.expect("connects");
    let before = stage.desk.state().changes;
    assert_eq!(refusal(client.grant(&bob.signing, grant_to(&bob)).await), Some(Code::Signature));
    assert_eq!(refusal(client.revoke(&alice.envelope, revoke_of(&bob)).await), Some(Code::Signature));
    assert_eq!(stage.desk.state().changes, before);
    client.grant(&alice.signing, grant_to(&bob)).await.expect("noted");
    assert_eq!(stage.desk.state().changes, before + 1);
}

/// Resident memory of this process, KiB.
fn resident() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").expect("Linux");
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).expect("a line of resident memory");
    line.trim().trim_end_matches(" kB").parse().expect("a number")
}

/// Repetitions: the figure only means something over a long run, by itself.
fn often(short: u32, long: u32) -> u32 {
    if std::env::var_os("AUTHROS_LONG").is_some() { long } else { short }
}

/// For the figure: `AUTHROS_LONG=1 cargo test --release --lib -- --nocapture idle_sessions`
#[tokio::test(flavor = "multi_thread")]
async fn many_idle_sessions_are_kept_and_served() {
    let count = often(200, 5_000) as usize;
    let generous = Limits { connections_of_peer: count + 10, handshake_burst: 10_000.0, ..Limits::default() };
    let stage = Stage::with(generous).await;
    let alice = alice();
    let credentials = stage.enrol(&alice).await;
    let (mut clients, before) = (Vec::with_capacity(count), resident());
    for _ in 0..count {
        clients.push(stage.connect(&credentials).await.expect("connects"));
    }
    assert_eq!(stage.server.watch().connections(), count);
    let used = resident().saturating_sub(before);
    println!("{count} idle sessions, both ends in this process: {used} KiB");
    let last = clients.last_mut().expect("connected");
    last.upload(vec![alice.record(&alice.signing, 1, b"still served")]).await.expect("receipt");
}

/// For the figure: `AUTHROS_LONG=1 cargo test --release --lib -- --nocapture uploads_in_windows`
#[tokio::test(flavor = "multi_thread")]
async fn uploads_in_windows_are_receipted_in_order() {
    let stage = Stage::new().await;
    let alice = alice();
    let mut client = stage.connect(&stage.enrol(&alice).await).await.expect("connects");
    for (size, count) in [(1024, often(100, 4_000)), (58 * 1024, often(20, 800))] {
        let record = |seq| alice.record(&alice.signing, seq, &vec![7; size]);
        let records: Vec<Upload> = (1..=u64::from(count)).map(record).collect();
        let begun = std::time::Instant::now();
        for record in &records {
            let domain = context().domain;
            let digest = Digest(context().provider.sm3(&[&record.blob]));
            let signed = crate::crypto::record::signed_bytes(&domain, &digest);
            context().provider.verify(&alice.signing.public, &signed, &record.signature).expect("valid");
        }
        let bound = begun.elapsed();
        let begun = std::time::Instant::now();
        for window in records.chunks(32) {
            let mut sent = Vec::new();
            for record in window {
                sent.push(client.send(&Request::Upload(record.clone())).await.expect("sends"));
            }
            for number in sent {
                let (answered, answer) = client.receive(Duration::from_secs(30)).await.expect("answers");
                assert!(answered == number && matches!(answer, Answer::Receipt(..)));
            }
        }
        let taken = begun.elapsed();
        let rate = |time: Duration| f64::from(count) / time.as_secs_f64();
        println!("{size} bytes: {:.0}/s accepted, SM3 and SM2 verification alone {:.0}/s", rate(taken), rate(bound));
    }
}

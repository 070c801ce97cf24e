//! A gateway of the fleet that its neighbour trusts by fingerprint turns hostile: it tells endless holdings and hands over
//! forged records, replayed ones, those of other owners, and proofs of anchors that never were.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use async_trait::async_trait;
use authros::chain::merkle::{Inclusion, Leaf};
use authros::chain::{AnchorProof, RelayError};
use authros::crypto::{ProviderName, SmKeyPair, provider, signer_id};
use authros::gateway::{
    Account, Binding, Cabinet, Caller, Code, Desk, DeviceNotice, Entry, Fetched, GrantNotice, HandedOver, Held,
    HoldingPlace, Holdings, Limits, NetworkName, Page, Query, Received, Refusal, Registration, RevokeNotice, Schedule,
    Selection, Server, Standing, Stood, Upload, Wanted,
};
use authros::model::{
    Address, Digest, Hash, Header, ProfileName, PublicKey, Ranges, RecorderId, Signature, SignerId, Timestamp, Token,
    TopicId,
};
use serde_json::Value;
use tokio::sync::mpsc;

use super::support::gate::Gate;
use super::support::member::{Member, connect};
use super::support::{Home, count, list, wait_until};
use super::{Outcome, judge};

/// Numbers told at a time.
const TOLD: u64 = 8192;

/// The hostile gateway's desk: it admits its victim and lies to it.
struct Liar {
    victim: Account,
    bindings: Mutex<HashMap<ProfileName, Binding>>,
    lies: Vec<Fetched>,
    owner: Address,
    stranger: Address,
    place: (RecorderId, TopicId),
    told: AtomicUsize,
    handed: AtomicUsize,
}

fn not_here<Done>() -> Result<Done, Refusal> {
    Err(Refusal::new(Code::NotHere, "a hostile gateway"))
}

#[async_trait]
impl Desk for Liar {
    async fn account(&self, _: &Address) -> Result<Account, Refusal> {
        Ok(self.victim)
    }

    async fn admits(&self, _: &Address) -> Result<(), Refusal> {
        Ok(())
    }

    async fn is_token(&self, _: &Address, _: &Token) -> Result<bool, Refusal> {
        Ok(true)
    }

    async fn is_lent(&self, _: &Address, _: &SignerId) -> Result<bool, Refusal> {
        Ok(false)
    }

    async fn signer(&self, _: &Address, _: &SignerId) -> Result<Option<PublicKey>, Refusal> {
        Ok(None)
    }

    async fn binding(&self, name: &ProfileName) -> Result<Option<Binding>, Refusal> {
        Ok(self.bindings.lock().expect("not poisoned").get(name).cloned())
    }

    async fn successor(&self, _: &Address) -> Result<Option<Address>, Refusal> {
        Ok(None)
    }

    async fn bind(&self, name: &ProfileName, binding: Binding) -> Result<(), Refusal> {
        self.bindings.lock().expect("not poisoned").insert(name.clone(), binding);
        Ok(())
    }

    async fn register(&self, _: &Registration) -> Result<Hash, Refusal> {
        not_here()
    }

    async fn store(&self, _: &Caller, _: Vec<Received>) -> Result<Timestamp, Refusal> {
        not_here()
    }

    async fn query(&self, _: &Caller, _: &Query) -> Result<Page, Refusal> {
        not_here()
    }

    async fn check(&self, _: &Caller, _: &[Digest]) -> Result<Vec<Standing>, Refusal> {
        not_here()
    }

    async fn prove(&self, _: &Caller, _: &[Digest]) -> Result<Vec<Stood>, Refusal> {
        not_here()
    }

    async fn fetch(&self, _: &Caller, _: &Digest) -> Result<Fetched, Refusal> {
        not_here()
    }

    async fn subscribe(&self, _: &Caller, _: &Selection) -> Result<mpsc::Receiver<Entry>, Refusal> {
        not_here()
    }

    async fn grant(&self, _: &Caller, _: &GrantNotice) -> Result<(), Refusal> {
        not_here()
    }

    async fn revoke(&self, _: &Caller, _: &RevokeNotice) -> Result<(), Refusal> {
        not_here()
    }

    async fn network_name(&self) -> Result<NetworkName, Refusal> {
        not_here()
    }

    async fn relay(&self, _: Option<&Caller>, _: &str, _: &Value) -> Result<Value, RelayError> {
        Err(RelayError::NotAllowed)
    }

    async fn device(&self, _: &Caller, _: &DeviceNotice) -> Result<(), Refusal> {
        not_here()
    }

    /// Without an end: each part is of one owner who is admitted there, and one who is not.
    async fn holdings(&self, _: &Caller, after: &HoldingPlace) -> Result<Holdings, Refusal> {
        self.told.fetch_add(1, Ordering::AcqRel);
        let (recorder, topic_id) = self.place;
        let first = after.block * TOLD + 1;
        let ranges = Ranges::of((first..first + TOLD - 1).collect());
        let of = |owner, ranges| Held { owner, recorder, topic_id, ranges };
        let held = vec![of(self.stranger, Ranges::of(vec![1])), of(self.owner, ranges)];
        Ok(Holdings { held, next: HoldingPlace { block: after.block + 1, ..*after }, more: true })
    }

    async fn hand_over(&self, _: &Caller, wanted: &Wanted) -> Result<HandedOver, Refusal> {
        self.handed.fetch_add(1, Ordering::AcqRel);
        Ok(HandedOver { records: self.lies.clone(), next: Some(wanted.first + 1) })
    }

    fn refused(&self, _: SocketAddr, _: &Refusal) {}
}

/// A record with an anchor that has the right form and is on no chain.
fn with_proof(upload: &Upload, signer: PublicKey) -> Fetched {
    let (header, _) = Header::parse(&upload.blob).expect("a record");
    let digest = Digest(provider(ProviderName::RustCrypto).sm3(&[&upload.blob]));
    let Header { owner, recorder, topic_id, seq, .. } = header;
    let root = Leaf { owner, recorder, topic_id, seq, digest }.hash();
    let inclusion = Some(Inclusion { index: 0, count: 1, path: Vec::new(), root });
    let (transaction, block_hash) = (Hash([1; 32]), Hash([2; 32]));
    let proof = AnchorProof { account: owner, transaction, block: 1, block_hash, inclusion }.encode();
    Fetched { signer, signature: upload.signature, proof, blob: upload.blob.clone() }
}

/// What is handed over: carol signed the first of these, which was never sent anywhere, and nothing else.
fn lies(carol: &Member, mallory: &Member) -> Vec<Fetched> {
    let (hers, his) = (carol.keyring.signing.clone(), mallory.keyring.signing.clone());
    let of = |member: &Member, signer: &SmKeyPair, seq| {
        with_proof(&member.record(signer, "/odom", seq, b"a message"), signer.public)
    };
    let genuine = of(carol, &hers, 1);
    vec![
        // No anchor, and one that the chain does not have.
        Fetched { proof: Vec::new(), ..genuine.clone() },
        genuine.clone(),
        // Signed by somebody without a right, by nobody, and said to be signed by another key.
        of(carol, &his, 1),
        Fetched { signature: Signature([7; 64]), ..genuine.clone() },
        Fetched { signer: his.public, ..genuine.clone() },
        // Another number than asked for, another owner's, another byte, no record.
        of(carol, &hers, 9_000_000),
        of(mallory, &his, 1),
        Fetched { blob: [&genuine.blob[..], &[0]].concat(), ..genuine.clone() },
        Fetched { blob: b"nothing".to_vec(), ..genuine },
    ]
}

fn fellow(gate: &Gate) -> Value {
    list(&gate.home.profile("gateway").json(&["fleet", "status"]), "fellows").remove(0)
}

#[tokio::test(flavor = "multi_thread")]
async fn feed_a_fleet_with_lies() {
    let (gate, away) = (Gate::new(), Home::new());
    let member = |name: &str| {
        away.profile(name).with(&gate.options()).enrol();
        Member::of(&away, name, gate.gateway.domain)
    };
    let (carol, mallory) = (member("carol"), member("mallory"));
    let keeper = gate.home.profile("gateway");
    keeper.json(&["gateway", "admit", &carol.address().to_string()]);
    let victim = Member::of(&gate.home, "gateway", gate.gateway.domain).keyring;
    let (topic_id, _) = carol.topic("/odom");
    let liar = Arc::new(Liar {
        victim: Account { signing: victim.signing.public, envelope: victim.envelope.public },
        bindings: Mutex::default(),
        lies: lies(&carol, &mallory),
        owner: carol.address(),
        stranger: mallory.address(),
        place: (carol.recorder, topic_id),
        told: AtomicUsize::new(0),
        handed: AtomicUsize::new(0),
    });
    let (context, identity) = (gate.gateway.endpoint().context, mallory.keyring.signing.clone());
    let (folder, now) = (away.root().join("hostile"), Timestamp::now());
    let key = signer_id(&identity.public).to_string();
    let cabinet = Cabinet::open(&folder, context.provider, context.domain, identity, Schedule::default(), now);
    let desk = Arc::clone(&liar) as Arc<dyn Desk>;
    let server = Server::start("127.0.0.1:0", desk, context, cabinet.expect("opens"), Limits::default()).await;
    let server = server.expect("listens");
    keeper.json(&["fleet", "add", &server.address().to_string(), "--gateway-key", &key]);

    let told = tokio::task::block_in_place(|| {
        wait_until(60, "the lies are noticed", || {
            let fellow = fellow(&gate);
            fellow["problem"].is_string().then_some(fellow)
        })
    });
    let asked = (liar.told.load(Ordering::Acquire), liar.handed.load(Ordering::Acquire));
    // It is left alone now: it is not asked any more for half a minute at least, shortened at random.
    tokio::time::sleep(Duration::from_secs(3)).await;
    let later = (liar.told.load(Ordering::Acquire), liar.handed.load(Ordering::Acquire));
    let refused: u64 = list(&told, "refused").iter().map(|row| count(row, "count")).sum();
    let parts = list(&keeper.json(&["status"]), "health");
    let part = parts.into_iter().find(|part| part["part"] == "fleet").expect("a part");

    let credentials = carol.allocate(&gate.gateway, "scout-1").await.expect("admitted");
    let mut client = connect(&gate.gateway, &credentials).await;
    let (selection, limit) = (Selection::all(carol.address()), 500);
    let query = Query { selection, from: Timestamp(0), until: Timestamp(u64::MAX), cursor: 0, limit };
    let page = client.query(&query).await.expect("her own");
    server.stop(Duration::from_secs(2)).await;
    println!("asked {asked:?} times, then {later:?}: {told}");
    let outcome = if !page.entries.is_empty() || count(&told, "taken") > 0 {
        Outcome::Succeeded(format!("{} records taken: {told}", page.entries.len()))
    } else if asked != later || asked.0 > 4 || asked.1 > 4 {
        Outcome::Succeeded(format!("it goes on asking: {asked:?}, {later:?}"))
    } else if refused < 9 || part["level"] != "failed" || count(&told, "passed_over") != 1 {
        Outcome::Otherwise(format!("it is not told: {told} {part}"))
    } else {
        Outcome::Refused(super::support::text(&told, "problem"))
    };
    judge("feed_a_fleet_with_lies", outcome);
}

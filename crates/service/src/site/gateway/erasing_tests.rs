//! What an owner says was erased, judged on a chain: copies go at their owner's word alone, given with both keys.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use std::collections::BTreeMap;
use std::sync::Arc;

use super::*;
use crate::chain::merkle::{Inclusion, Leaf};
use crate::chain::{AnchorProof, Call};
use crate::crypto::{
    AccountSignature, EoaSecret, ProviderName, SealRequest, SmKeyPair, TopicKey, prove, provider, seal,
};
use crate::gateway::{ErasedRecord, Fetched};
use crate::model::head::Compression;
use crate::model::{Domain, Hash, Head, RecordKind, RecordState, RecorderPrefix, Signature, Timestamp, Token, TopicId};
use crate::pipeline::Owner;
use crate::site::gateway::GatewayDesk;
use crate::site::testing::{registered, site_of};
use crate::site::{Needs, Site};
use crate::store::IncidentSpan;

pub(in crate::site::gateway) const TOPIC: TopicId = TopicId([8; 16]);
const REPORT: Digest = Digest([0x77; 32]);
const AT: Timestamp = Timestamp(1_700_000_000_000_000_000);

/// A site with a gateway, an owner of that home, and the chain; its folder is removed with the value.
pub(in crate::site::gateway) struct Ground {
    pub site: Arc<Site>,
    _folder: tempfile::TempDir,
    _running: tokio::sync::oneshot::Sender<()>,
    pub alice: Arc<Owner>,
    pub network: Network,
    pub desk: GatewayDesk,
    /// Somebody else on this chain, who anchors.
    other: EoaSecret,
}

impl Ground {
    async fn new() -> Self {
        Self::with(&[]).await
    }

    /// The same with settings.
    pub async fn with(settings: &[(&str, &str)]) -> Self {
        let (site, folder) = site_of(settings, Needs { ros: false, chain: true });
        let (keeper, alice) = (registered(&site, "keeper").await, registered(&site, "alice").await);
        let (running, ended) = tokio::sync::oneshot::channel();
        site.gateway.serve(&keeper, "127.0.0.1:0".parse().expect("an address"), false, ended).await.expect("serves");
        let network = site.network().await.expect("a chain");
        let (desk, other) = (site.gateway.desk_of(&keeper, network.domain), stranger(&network).await);
        Self { site, _folder: folder, _running: running, alice, network, desk, other }
    }

    /// A record of alice with its proof, as another ledger has it.
    async fn elsewhere(&self, seq: u64) -> (SealedRecord, Fetched) {
        let own = self.alice.signing();
        let sealed = record(&self.network, &self.alice, &own, seq);
        let fetched = anchored(&self.network, &self.other, &sealed, &own).await;
        (sealed, fetched)
    }

    /// The same, here too and verified.
    pub async fn here(&self, seq: u64) -> (SealedRecord, Fetched) {
        let (sealed, fetched) = self.elsewhere(seq).await;
        self.bring(&sealed);
        let AnchorProof { account, transaction, block, block_hash, inclusion } =
            AnchorProof::parse(&fetched.proof).expect("a proof");
        let inclusion = inclusion.expect("in a batch");
        let (root, count) = (inclusion.root, inclusion.count);
        let anchor = RootSighting { account, root, count, transaction, block, block_hash };
        let ledger = &self.site.plant.ledger;
        until("anchored", || ledger.batches.take_in(sealed.digest, inclusion.clone(), anchor) == Ok(true)).await;
        until("verified", || {
            ledger.records.find(sealed.digest).expect("read").is_some_and(|row| row.state == RecordState::Verified)
        })
        .await;
        (sealed, fetched)
    }

    /// Stores a record whose anchor others make.
    fn bring(&self, sealed: &SealedRecord) {
        let plant = &self.site.plant;
        let row = NewRecord::foreign(sealed.clone(), self.other.address());
        plant.keep([row], |rows| plant.ledger.records.append(rows.into())).expect("kept");
    }

    /// As its owner tells it.
    fn told(&self, sealed: &SealedRecord, fetched: &Fetched) -> ErasureNotice {
        self.stated(sealed, fetched, (&self.alice.signing(), &self.alice.eoa()))
    }

    fn stated(
        &self,
        sealed: &SealedRecord,
        fetched: &Fetched,
        (signing, account): (&SmKeyPair, &EoaSecret),
    ) -> ErasureNotice {
        let header = sealed.header.encode();
        let (provider, about) = (self.site.plant.provider, (&sealed.digest, header.as_slice()));
        let statement = ErasedStatement::sign(provider, signing, about, (REPORT, AT)).expect("signs");
        let account_signature = statement.sign_by_account(provider, account, about).expect("signs");
        let record = Fetched { blob: header, ..fetched.clone() };
        ErasureNotice { digest: sealed.digest, account_signature, left: ErasedRecord { record, statement } }
    }

    fn caller(&self, owner: &Owner) -> Caller {
        let (account, signing, name) = (owner.address, owner.signing().public, "away".parse().expect("a name"));
        Caller { name, account, signing, device: None, peer: "127.0.0.1:1".parse().expect("an address") }
    }

    async fn tell(&self, notices: Vec<ErasureNotice>) -> Result<Vec<ErasureOutcome>, Code> {
        let told = self.desk.erase_for(&self.caller(&self.alice), notices).await;
        told.map_err(|refusal| refusal.code)
    }

    fn bytes(&self, sealed: &SealedRecord) -> Option<Vec<u8>> {
        self.site.plant.ciphertext.get(sealed.digest).expect("read")
    }

    async fn gone(&self, sealed: &SealedRecord) {
        let ledger = &self.site.plant.ledger;
        until("overwritten", || {
            ledger.records.find(sealed.digest).expect("read").is_some_and(|row| row.deleted_at.is_some())
        })
        .await;
        assert_eq!(self.bytes(sealed), None);
    }
}

/// A message of an owner, by a recorder that is not this home's.
fn record(network: &Network, owner: &Owner, signer: &SmKeyPair, seq: u64) -> SealedRecord {
    let body = b"a face";
    let head = Head {
        topic: "/odom".into(),
        type_name: "nav_msgs/Odometry".into(),
        md5sum: "cd5e73d190d741a2f92e81eda573aca7".into(),
        definition: Digest([4; 32]),
        caller_id: "/robot1".into(),
        boot_id: [5; 16],
        compression: Compression::None,
        plain_length: body.len() as u64,
        tags: BTreeMap::new(),
    };
    let request = SealRequest {
        domain: network.domain,
        owner: owner.address,
        signer,
        epoch: 1,
        topic_key: &TopicKey::new([6; 32]),
        recorder: RecorderPrefix::ledger([4; 7]),
        seq,
        topic_id: TOPIC,
        kind: RecordKind::Data,
        filters: Vec::new(),
        captured_at: Timestamp(seq),
        head: &head,
        body,
    };
    seal(provider(ProviderName::RustCrypto), &request).expect("sealed")
}

/// Sends a transaction of an account that is not of this home, and waits for its block.
async fn by_hand(network: &Network, eoa: &EoaSecret, call: &Call) -> (Hash, u64, Hash) {
    let chain = &network.chain;
    let nonce = chain.nonce(eoa.address(), true).await.expect("a nonce");
    let signed = chain.sign(eoa, nonce, call).await.expect("signed");
    chain.broadcast(&signed.raw).await.expect("sent");
    loop {
        if let Some(receipt) = chain.receipt(signed.hash).await.expect("answered") {
            assert!(receipt.success, "{call:?}");
            return (signed.hash, receipt.block, receipt.block_hash);
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// The record with the proof of its anchor, alone in its batch.
async fn anchored(network: &Network, by: &EoaSecret, sealed: &SealedRecord, signer: &SmKeyPair) -> Fetched {
    let root = Leaf::of(&sealed.header, sealed.digest).hash();
    let previous = network.chain.anchor_head(by.address()).await.expect("answered");
    let (transaction, block, block_hash) = by_hand(network, by, &Call::Anchor { root, count: 1, previous }).await;
    let inclusion = Some(Inclusion { index: 0, count: 1, path: Vec::new(), root });
    let proof = AnchorProof { account: by.address(), transaction, block, block_hash, inclusion }.encode();
    Fetched { signer: signer.public, signature: sealed.signature, proof, blob: sealed.blob.clone() }
}

/// A registered account that is not of this home.
async fn stranger(network: &Network) -> EoaSecret {
    let (eoa, provider) = (EoaSecret::generate().expect("a key"), provider(ProviderName::RustCrypto));
    let [signing, envelope] = [(); 2].map(|()| SmKeyPair::generate(provider).expect("a pair"));
    let identity = prove(provider, &network.domain, &eoa.address(), &signing, &envelope.public, Token([3; 32]));
    by_hand(network, &eoa, &Call::Register { identity: identity.expect("proven"), envelope: Vec::new() }).await;
    eoa
}

pub(in crate::site::gateway) async fn until(what: &str, is_so: impl Fn() -> bool) {
    for _ in 0..600 {
        if is_so() {
            return;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    assert!(is_so(), "never {what}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn what_its_owner_had_erased_elsewhere_is_overwritten_here_and_stays_away() {
    use ErasureOutcome::Taken;
    let ground = Ground::new().await;
    let ledger = &ground.site.plant.ledger;
    let (copy, handed) = ground.here(1).await;
    let (absent, proof) = ground.elsewhere(2).await;
    assert_eq!(ground.bytes(&copy), Some(copy.blob.clone()));
    let told = [ground.told(&copy, &handed), ground.told(&absent, &proof)];
    assert_eq!(ground.tell(told.to_vec()).await, Ok(vec![Taken; 2]));
    ground.gone(&copy).await;
    for sealed in [&copy, &absent] {
        let retained = ledger.retention.find(sealed.digest).expect("read").expect("accounted for");
        let words = retained.erased.expect("erased").to_string();
        assert_eq!(words, "erased 2023-11-14T22:13:20Z by its owner, its proof remains");
        assert_eq!(retained.header, sealed.header.encode());
        until("verified", || {
            ledger.records.find(sealed.digest).expect("read").is_some_and(|row| row.state == RecordState::Verified)
        })
        .await;
    }
    assert_eq!(ledger.retention.given_up(ground.alice.address), Ok(2));

    // Nobody brings the bytes again, and the log has one line.
    assert_eq!(ground.tell(told.to_vec()).await, Ok(vec![Taken; 2]), "twice is once");
    for sealed in [&copy, &absent] {
        ground.bring(sealed);
    }
    until("overwritten again", || ground.bytes(&copy).is_none() && ground.bytes(&absent).is_none()).await;
    ground.site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn nothing_is_erased_at_the_word_of_anybody_but_its_owner() {
    let ground = Ground::new().await;
    let provider = ground.site.plant.provider;
    let mallory = registered(&ground.site, "mallory").await;
    let (copy, handed) = ground.here(1).await;
    let (second, proof) = ground.here(2).await;
    let (genuine, other) = (ground.told(&copy, &handed), ground.told(&second, &proof));
    let (thief_signing, thief_account) = (SmKeyPair::generate(provider).expect("a pair"), &ground.other);
    let (own, account) = (ground.alice.signing(), ground.alice.eoa());
    let by = |signing: &SmKeyPair, account: &EoaSecret| ground.stated(&copy, &handed, (signing, account));
    let with = |record: Fetched| {
        let left = ErasedRecord { record, ..genuine.left.clone() };
        ErasureNotice { left, ..genuine.clone() }
    };
    // The same record as mallory's own, in a batch of mallory's.
    let mut header = copy.header.clone();
    (header.owner, header.signer) = (mallory.address, signer_id(&mallory.signing().public));
    header.recorder = header.recorder.prefix().of_signer(&header.signer);
    let text = [b"AuthROS/signature/1".as_slice(), &header.domain.0, &copy.digest.0].concat();
    let signature = provider.sign(&mallory.signing().secret, &text).expect("signs");
    let stolen = SealedRecord { header, blob: Vec::new(), digest: copy.digest, signature };
    let stolen_proof = anchored(&ground.network, &ground.other, &stolen, &mallory.signing()).await;
    let mut elsewhere = copy.clone();
    elsewhere.header.domain = Domain([9; 32]);
    let nothing = AccountSignature([0; 65]);
    let lies = [
        ("d_C alone", by(&own, thief_account)),
        ("d_C and no account", ErasureNotice { account_signature: nothing, ..genuine.clone() }),
        ("the account alone", by(&thief_signing, &account)),
        ("a thief of neither", by(&thief_signing, thief_account)),
        ("another owner's keys", by(&mallory.signing(), &mallory.eoa())),
        ("another record's signatures", ErasureNotice { digest: copy.digest, ..other.clone() }),
        (
            "another record's account signature",
            ErasureNotice { account_signature: other.account_signature, ..genuine.clone() },
        ),
        ("another record's statement", {
            let left = ErasedRecord { statement: other.left.statement, ..genuine.left.clone() };
            ErasureNotice { left, ..genuine.clone() }
        }),
        ("another record's proof", with(Fetched { proof: proof.proof.clone(), ..genuine.left.record.clone() })),
        ("no proof", with(Fetched { proof: vec![9], ..genuine.left.record.clone() })),
        ("another signature", with(Fetched { signature: Signature([7; 64]), ..genuine.left.record.clone() })),
        ("the whole record", with(Fetched { blob: copy.blob.clone(), ..genuine.left.record.clone() })),
        ("no header", with(Fetched { blob: b"nothing".to_vec(), ..genuine.left.record.clone() })),
        ("of another chain", ground.stated(&elsewhere, &handed, (&own, &account))),
    ];
    for (what, lie) in lies {
        let told = ground.tell(vec![lie]).await;
        assert!(told == Ok(vec![ErasureOutcome::Refused]) || told == Err(Code::NotAuthorised), "{what}: {told:?}");
    }
    let as_his_own = ground.stated(&stolen, &stolen_proof, (&mallory.signing(), &mallory.eoa()));
    let told = ground.desk.erase_for(&ground.caller(&mallory), vec![as_his_own]).await.expect("asked");
    assert_eq!(told, [ErasureOutcome::Refused], "in his own session");
    // One that is on no chain: its owner signed everything, and nobody anchored it.
    let unanchored = record(&ground.network, &ground.alice, &own, 9);
    let unproven = Fetched { signature: unanchored.signature, ..handed.clone() };
    let told = ground.tell(vec![ground.stated(&unanchored, &unproven, (&own, &account))]).await;
    assert_eq!(told, Ok(vec![ErasureOutcome::Refused]));
    assert_eq!(ground.site.plant.ledger.records.find(unanchored.digest), Ok(None));
    for sealed in [&copy, &second] {
        assert_eq!(ground.bytes(sealed), Some(sealed.blob.clone()));
        assert_eq!(ground.site.plant.ledger.retention.find(sealed.digest), Ok(None));
    }
    assert_eq!(ground.tell(vec![genuine]).await, Ok(vec![ErasureOutcome::Taken]), "and at her own word it is");
    ground.site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn what_an_incident_of_its_owner_holds_here_stays_until_that_is_removed() {
    let ground = Ground::new().await;
    let ledger = &ground.site.plant.ledger;
    let (copy, handed) = ground.here(1).await;
    let name = "crash".parse().expect("a name");
    ledger.incidents.open(ground.alice.address, &name, &IncidentSpan::default(), None).expect("opened");
    let mut events = ground.site.parts.hub.events().subscribe();
    assert_eq!(ground.tell(vec![ground.told(&copy, &handed)]).await, Ok(vec![ErasureOutcome::Taken]));
    until("held", || ledger.erasures.held_although_erased() == Ok(1)).await;
    let mut notices = 0;
    for _ in 0..60 {
        tokio::time::sleep(Duration::from_millis(50)).await;
        let told = std::iter::from_fn(|| events.try_recv().ok());
        notices += told.filter(|event| format!("{event:?}").contains("held here by an incident")).count();
    }
    assert_eq!((notices, ground.bytes(&copy)), (1, Some(copy.blob.clone())), "told once");
    ledger.incidents.remove(ground.alice.address, &name).expect("removed");
    ground.gone(&copy).await;
    assert_eq!(ledger.erasures.held_although_erased(), Ok(0));
    ground.site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn an_owner_who_is_away_has_her_own_erased_and_nobody_elses() {
    use ErasureOutcome::{Refused, Taken};
    let ground = Ground::new().await;
    let mallory = registered(&ground.site, "mallory").await;
    let (copy, handed) = ground.here(1).await;
    let (second, proof) = ground.here(2).await;
    let (first, other) = (ground.told(&copy, &handed), ground.told(&second, &proof));
    let (alice, thief) = (ground.caller(&ground.alice), ground.caller(&mallory));
    // Not in another's session, whatever signatures she has; nor one among others.
    let by_thief = ground.desk.erase_for(&thief, vec![first.clone()]).await;
    assert_eq!(by_thief.map_err(|refusal| refusal.code), Err(Code::NotAuthorised));
    // A thief of d_C and K_T alone, in her name.
    let stolen = ground.stated(&copy, &handed, (&ground.alice.signing(), &mallory.eoa()));
    assert_eq!(ground.desk.erase_for(&alice, vec![stolen]).await.expect("asked"), [Refused]);
    assert_eq!(ground.bytes(&copy), Some(copy.blob.clone()));

    let nothing = ErasureNotice { account_signature: AccountSignature([0; 65]), ..other.clone() };
    let told = vec![nothing, first.clone()];
    assert_eq!(ground.desk.erase_for(&alice, told).await.expect("asked"), [Refused, Taken]);
    ground.gone(&copy).await;
    assert_eq!(ground.bytes(&second), Some(second.blob.clone()));
    assert_eq!(
        ground.desk.erase_for(&alice, vec![first, other]).await.expect("asked"),
        [Taken, Taken],
        "again, and more"
    );
    ground.gone(&second).await;
    ground.site.stop().await;
}

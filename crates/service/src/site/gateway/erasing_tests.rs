//! What a gateway of the fleet says was erased, judged on a chain: copies go at their owner's word alone, given with both keys.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use super::*;
use crate::crypto::{AccountSignature, EoaSecret, SmKeyPair};
use crate::gateway::{ErasedRecord, Fetched, Wanted};
use crate::model::{Domain, Ranges, Signature, Timestamp};
use crate::pipeline::Owner;
use crate::pipeline::mirror::Anchors;
use crate::site::gateway::GatewayDesk;
use crate::site::gateway::copies::Copies;
use crate::site::gateway::round::Took;
use crate::site::gateway::taking::tests::{RECORDER, TOPIC, anchored, codes, handed, numbers, record, stranger};
use crate::site::testing::{registered, site_of};
use crate::site::{Needs, Site};
use crate::store::IncidentSpan;

const REPORT: Digest = Digest([0x77; 32]);
const AT: Timestamp = Timestamp(1_700_000_000_000_000_000);

/// A site with a gateway, an owner of that home, and the chain; its folder is removed with the value.
pub(in crate::site::gateway) struct Ground {
    pub site: std::sync::Arc<Site>,
    _folder: tempfile::TempDir,
    _running: tokio::sync::oneshot::Sender<()>,
    pub alice: std::sync::Arc<Owner>,
    pub network: Network,
    pub desk: GatewayDesk,
    /// Who keeps the other gateway.
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
        let (desk, other) = (site.gateway.served_desk().expect("serves"), stranger(&network).await);
        Self { site, _folder: folder, _running: running, alice, network, desk, other }
    }

    /// A record of alice with its proof, as the other gateway has it.
    async fn elsewhere(&self, seq: u64) -> (SealedRecord, Fetched) {
        let own = self.alice.signing();
        let sealed = record(&self.network, &self.alice, &own, (seq, b"a face"));
        let fetched = anchored(&self.network, &self.other, &sealed, &own).await;
        (sealed, fetched)
    }

    /// The same, handed over and verified here.
    pub async fn here(&self, seq: u64) -> (SealedRecord, Fetched) {
        let (sealed, fetched) = self.elsewhere(seq).await;
        assert_eq!(numbers(self.hand_over(seq, &fetched).await.taken), [seq]);
        let ledger = &self.site.plant.ledger;
        until("verified", || {
            ledger.record(sealed.digest).expect("read").is_some_and(|row| row.state == RecordState::Verified)
        })
        .await;
        (sealed, fetched)
    }

    async fn hand_over(&self, seq: u64, fetched: &Fetched) -> Took {
        let wanted = Wanted { owner: self.alice.address, recorder: RECORDER, topic_id: TOPIC, first: seq, last: seq };
        let anchors = Anchors::default();
        let here = Taking { desk: &self.desk, anchors: &anchors, copies: Copies::All };
        here.take(handed(wanted, vec![fetched.clone()])).await.expect("asked")
    }

    /// As an honest gateway tells it.
    fn told(&self, sealed: &SealedRecord, fetched: &Fetched) -> ToldErasure {
        self.stated(sealed, fetched, (&self.alice.signing(), &self.alice.eoa()))
    }

    fn stated(
        &self,
        sealed: &SealedRecord,
        fetched: &Fetched,
        (signing, account): (&SmKeyPair, &EoaSecret),
    ) -> ToldErasure {
        let header = sealed.header.encode();
        let (provider, about) = (self.site.plant.provider, (&sealed.digest, header.as_slice()));
        let statement = ErasedStatement::sign(provider, signing, about, (REPORT, AT)).expect("signs");
        let account_signature = statement.sign_by_account(provider, account, about).expect("signs");
        let record = Fetched { blob: header, ..fetched.clone() };
        ToldErasure { digest: sealed.digest, account_signature, left: ErasedRecord { record, statement } }
    }

    async fn tell(&self, told: Vec<ToldErasure>) -> (TookErased, u64) {
        let (anchors, mut round) = (Anchors::default(), Round::default());
        let here = Taking { desk: &self.desk, anchors: &anchors, copies: Copies::All };
        let took = here.erase_told(told, true, &mut round).await.expect("asked");
        (took, round.erased.values().sum())
    }

    fn bytes(&self, sealed: &SealedRecord) -> Option<Vec<u8>> {
        self.site.plant.vault.get(sealed.digest).expect("read")
    }

    async fn gone(&self, sealed: &SealedRecord) {
        let ledger = &self.site.plant.ledger;
        until("overwritten", || {
            ledger.record(sealed.digest).expect("read").is_some_and(|row| row.deleted_at.is_some())
        })
        .await;
        assert_eq!(self.bytes(sealed), None);
    }
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
    let ground = Ground::new().await;
    let ledger = &ground.site.plant.ledger;
    let (copy, handed) = ground.here(1).await;
    let (absent, proof) = ground.elsewhere(2).await;
    assert_eq!(ground.bytes(&copy), Some(copy.blob.clone()));
    let told = [ground.told(&copy, &handed), ground.told(&absent, &proof)];
    let (took, taken) = ground.tell(told.to_vec()).await;
    assert_eq!((taken, took.left, took.waits, codes(&took.refused)), (2, 0, false, Vec::new()), "{took:?}");
    ground.gone(&copy).await;
    for sealed in [&copy, &absent] {
        let retained = ledger.retained(sealed.digest).expect("read").expect("accounted for");
        let words = retained.erased.expect("erased").to_string();
        assert_eq!(words, "erased 2023-11-14T22:13:20Z by its owner, its proof remains");
        assert_eq!(retained.header, sealed.header.encode());
        until("verified", || {
            ledger.record(sealed.digest).expect("read").is_some_and(|row| row.state == RecordState::Verified)
        })
        .await;
    }
    assert_eq!(ledger.given_up(ground.alice.address), Ok(2));

    // Nobody brings the bytes again: no gateway, and no robot, whose records take the same way in.
    assert_eq!(ground.tell(told.to_vec()).await.1, 0, "twice is once");
    for (seq, fetched) in [(1, &handed), (2, &proof)] {
        let took = ground.hand_over(seq, fetched).await;
        assert!(took.refused.is_empty(), "{took:?}");
    }
    assert_eq!((ground.bytes(&copy), ground.bytes(&absent)), (None, None));
    assert_eq!(ledger.local_copy(copy.digest), Ok(None));
    let all = Ranges::of(vec![1, 2]);
    let lacking = ledger.lacking((ground.alice.address, RECORDER, TOPIC), &all).expect("read");
    assert!(lacking.numbers.is_empty(), "nor is it asked for: {lacking:?}");

    // Both are passed on, with both signatures.
    let page = ledger.erasures(0, 9).expect("read");
    let mut passed: Vec<Digest> = page.erasures.iter().map(|(digest, ..)| *digest).collect();
    passed.sort();
    let mut expected = vec![copy.digest, absent.digest];
    expected.sort();
    assert_eq!(passed, expected);
    assert_eq!(page.erasures[0].2.len(), 65);
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
        ToldErasure { left, ..genuine.clone() }
    };
    // The same record as mallory's own, in a batch of mallory's.
    let mut header = copy.header.clone();
    (header.owner, header.signer) = (mallory.address, signer_id(&mallory.signing().public));
    let text = [b"AuthROS/signature/1".as_slice(), &header.domain.0, &copy.digest.0].concat();
    let signature = provider.sign(&mallory.signing().secret, &text).expect("signs");
    let stolen = SealedRecord { header, blob: Vec::new(), digest: copy.digest, signature };
    let stolen_proof = anchored(&ground.network, &ground.other, &stolen, &mallory.signing()).await;
    let mut elsewhere = copy.clone();
    elsewhere.header.domain = Domain([9; 32]);
    let nothing = AccountSignature([0; 65]);
    let lies = [
        ("d_C alone", by(&own, thief_account)),
        ("d_C and no account", ToldErasure { account_signature: nothing, ..genuine.clone() }),
        ("the account alone", by(&thief_signing, &account)),
        ("a thief of neither", by(&thief_signing, thief_account)),
        ("another owner's keys", by(&mallory.signing(), &mallory.eoa())),
        ("another record's signatures", ToldErasure { digest: copy.digest, ..other.clone() }),
        (
            "another record's account signature",
            ToldErasure { account_signature: other.account_signature, ..genuine.clone() },
        ),
        ("another record's statement", {
            let left = ErasedRecord { statement: other.left.statement, ..genuine.left.clone() };
            ToldErasure { left, ..genuine.clone() }
        }),
        ("as another owner's", ground.stated(&stolen, &stolen_proof, (&mallory.signing(), &mallory.eoa()))),
        ("another record's proof", with(Fetched { proof: proof.proof.clone(), ..genuine.left.record.clone() })),
        ("no proof", with(Fetched { proof: Vec::new(), ..genuine.left.record.clone() })),
        ("another signature", with(Fetched { signature: Signature([7; 64]), ..genuine.left.record.clone() })),
        ("the whole record", with(Fetched { blob: copy.blob.clone(), ..genuine.left.record.clone() })),
        ("no header", with(Fetched { blob: b"nothing".to_vec(), ..genuine.left.record.clone() })),
        ("of another chain", ground.stated(&elsewhere, &handed, (&own, &account))),
    ];
    for (what, lie) in lies {
        let (took, taken) = ground.tell(vec![lie]).await;
        assert_eq!((taken, took.refused.len(), took.left), (0, 1, 0), "{what}: {took:?}");
    }
    // One that is on no chain: its owner signed everything, and nobody anchored it.
    let unanchored = record(&ground.network, &ground.alice, &own, (9, b"a face"));
    let unproven = Fetched { signature: unanchored.signature, ..handed.clone() };
    let (took, taken) = ground.tell(vec![ground.stated(&unanchored, &unproven, (&own, &account))]).await;
    assert_eq!((taken, codes(&took.refused)), (0, vec![Code::Tampered]), "{took:?}");
    assert_eq!(ground.site.plant.ledger.record(unanchored.digest), Ok(None));
    for sealed in [&copy, &second] {
        assert_eq!(ground.bytes(sealed), Some(sealed.blob.clone()));
        assert_eq!(ground.site.plant.ledger.retained(sealed.digest), Ok(None));
    }
    assert_eq!(ground.tell(vec![genuine]).await.1, 1, "and at her own word it is");
    ground.site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn what_an_incident_of_its_owner_holds_here_stays_until_that_is_removed() {
    let ground = Ground::new().await;
    let ledger = &ground.site.plant.ledger;
    let (copy, handed) = ground.here(1).await;
    let name = "crash".parse().expect("a name");
    ledger.open_incident(ground.alice.address, &name, &IncidentSpan::default(), None).expect("opened");
    let mut events = ground.site.parts.hub.events().subscribe();
    assert_eq!(ground.tell(vec![ground.told(&copy, &handed)]).await.1, 1);
    until("held", || ledger.held_although_erased() == Ok(1)).await;
    let mut notices = 0;
    for _ in 0..60 {
        tokio::time::sleep(Duration::from_millis(50)).await;
        let told = std::iter::from_fn(|| events.try_recv().ok());
        notices += told.filter(|event| format!("{event:?}").contains("an incident holds them")).count();
    }
    assert_eq!((notices, ground.bytes(&copy)), (1, Some(copy.blob.clone())), "told once");
    ledger.remove_incident(ground.alice.address, &name).expect("removed");
    ground.gone(&copy).await;
    assert_eq!(ledger.held_although_erased(), Ok(0));
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
    let peer = "127.0.0.1:1".parse().expect("an address");
    let caller = |owner: &Owner| {
        let (account, signing, name) = (owner.address, owner.signing().public, "away".parse().expect("a name"));
        Caller { name, account, signing, device: None, peer }
    };
    let (alice, thief) = (caller(&ground.alice), caller(&mallory));
    // Not in another's session, whatever signatures she has; nor one among others.
    let by_thief = ground.desk.erase_for(&thief, vec![first.clone()]).await;
    assert_eq!(by_thief.map_err(|refusal| refusal.code), Err(Code::NotAuthorised));
    // A thief of d_C and K_T alone, in her name.
    let stolen = ground.stated(&copy, &handed, (&ground.alice.signing(), &mallory.eoa()));
    assert_eq!(ground.desk.erase_for(&alice, vec![stolen]).await.expect("asked"), [Refused]);
    assert_eq!(ground.bytes(&copy), Some(copy.blob.clone()));

    let nothing = ToldErasure { account_signature: AccountSignature([0; 65]), ..other.clone() };
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

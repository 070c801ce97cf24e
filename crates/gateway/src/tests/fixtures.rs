//! Keys, sessions and messages that the gateway's tests share.

use std::collections::BTreeMap;
use std::time::Duration;

use authros_crypto::{
    AccountSignature, EoaSecret, ErasedStatement, IndexKey, ProviderName, SealRequest, SmKeyPair, SmSecret, TopicKey,
    TransportKey, notice_topic, provider, seal, signer_id, topic_id,
};
use authros_gateway::allocation::{AllocationRequest, Applicant};
use authros_gateway::command::{
    Answer, Command, DeviceNotice, ErasedRecord, ErasureNotice, ErasureOutcome, Fetched, GrantNotice, Notice,
    RelayCall, Relayed, Request, RevokeNotice, Upload,
};
use authros_gateway::hello::{ClientHello, Context, GatewayHello, ListSummary, NetworkName};
use authros_gateway::session::Session;
use authros_gateway::{Code, Feed, FeedEntry, FeedPage, Found, Place, Receipt};
use authros_model::head::Compression;
use authros_model::{
    Address, Digest, Domain, Fact, Hash, Head, ProfileName, PublicKey, RecordKind, RecorderId, RecorderPrefix,
    Signature, SignerId, Timestamp, Token, TopicId,
};

pub(crate) fn context() -> Context {
    Context { provider: provider(ProviderName::RustCrypto), domain: Domain([0x11; 32]) }
}

/// The memory desk's network; not that of [`context`], which has no chain id.
pub(crate) fn network() -> NetworkName {
    NetworkName { chain_id: 7, genesis: Hash([0x61; 32]), contract: Address([0x62; 20]) }
}

/// The pair of a given secret.
pub(crate) fn pair(byte: u8) -> SmKeyPair {
    let secret = SmSecret::from_slice(&[byte; 32]).expect("in range");
    SmKeyPair::from_secret(context().provider, secret).expect("pair")
}

/// A profile with all its keys.
pub(crate) struct Member {
    pub name: ProfileName,
    pub signing: SmKeyPair,
    pub envelope: SmKeyPair,
    pub eoa: EoaSecret,
    pub token: Token,
}

impl Member {
    /// Different seeds give different keys.
    pub fn new(name: &str, seed: u8) -> Self {
        Self {
            name: name.parse().expect("a name"),
            signing: pair(seed),
            envelope: pair(seed + 1),
            eoa: EoaSecret::from_slice(&[seed + 2; 32]).expect("in range"),
            token: Token([seed; 32]),
        }
    }

    pub fn applicant(&self) -> Applicant<'_> {
        Applicant { name: &self.name, signing: &self.signing, envelope: self.envelope.public, account: &self.eoa }
    }

    pub fn account(&self) -> Address {
        self.eoa.address()
    }

    /// A record of this owner.
    pub fn record(&self, signer: &SmKeyPair, seq: u64, body: &[u8]) -> Upload {
        let head = Head {
            topic: "/robot1/odom".into(),
            type_name: "nav_msgs/Odometry".into(),
            md5sum: "cd5e73d190d741a2f92e81eda573aca7".into(),
            definition: Digest([4; 32]),
            caller_id: "/robot1".into(),
            boot_id: [5; 16],
            compression: Compression::None,
            plain_length: u64::try_from(body.len()).expect("fits"),
            tags: BTreeMap::new(),
        };
        let request = SealRequest {
            domain: context().domain,
            owner: self.account(),
            signer,
            epoch: 1,
            topic_key: &TopicKey::new([6; 32]),
            recorder: RecorderPrefix::ledger([4; 7]),
            seq,
            topic_id: TopicId([8; 16]),
            kind: RecordKind::Data,
            filters: Vec::new(),
            captured_at: Timestamp(seq),
            head: &head,
            body,
        };
        Upload::from(&seal(context().provider, &request).expect("seals"))
    }
}

pub(crate) fn summary() -> ListSummary {
    ListSummary { version: 3, digest: Digest([3; 32]) }
}

/// A hello between a client and the gateway of `pair(0x21)`.
pub(crate) fn greet() -> (ClientHello, Vec<u8>, GatewayHello) {
    let client = ClientHello::begin(context()).expect("begins");
    let (answer, gateway) = GatewayHello::answer(context(), &pair(0x21), summary(), &client.encode()).expect("answers");
    (client, answer, gateway)
}

/// Both ends of a session under a transport key.
pub(crate) fn sessions(key: &TransportKey) -> (Session, Session) {
    let (client, answer, gateway) = greet();
    let client = client.agree(&answer).expect("agrees");
    let (identify, client) = client.identify(&"robot-1".parse().expect("a name"), Some(key)).expect("seals");
    (client, gateway.identified(&identify).expect("opens").session(Some(key)))
}

fn receipt() -> Receipt {
    Receipt { time: Timestamp(9), digests: vec![Digest([1; 32]), Digest([2; 32])], signature: Signature([3; 64]) }
}

/// One request of each Command and shape.
pub(crate) fn sample_requests() -> Vec<Request> {
    let upload = |length| Upload { signature: Signature([7; 64]), blob: vec![8; length] };
    let allocation = AllocationRequest {
        system_key: SignerId([1; 32]),
        ciphertext: vec![2; 300],
        signature: Signature([3; 64]),
        account_signature: AccountSignature([4; 65]),
    };
    let (grantee, transaction) = (Address([5; 20]), Hash([6; 32]));
    vec![
        Request::SystemKeys,
        Request::KeyAllocation(allocation),
        Request::Upload(upload(300)),
        Request::UploadMany(vec![upload(0), upload(10), upload(200)]),
        Request::Notice(Notice::Grant(GrantNotice { grantee, epoch: 2, expiry: 3, transaction })),
        Request::Notice(Notice::Revoke(RevokeNotice { grantee, epoch: 2, token: Token([7; 32]), transaction })),
        Request::Notice(Notice::Device(notice_of(&pair(0x66)))),
        Request::Ping,
        Request::Relay(RelayCall { method: "eth_call".into(), parameters: "[{},\"latest\"]".into() }),
        Request::Erase(vec![erasure(); 2]),
        Request::Feed(feed()),
        Request::Feed(Feed::of(Address([1; 20]))),
        Request::Records(true, vec![Digest([1; 32]), Digest([2; 32])]),
        Request::Records(false, vec![Digest([3; 32])]),
    ]
}

/// A request for the feed with everything in it.
fn feed() -> Feed {
    Feed {
        id: [1; 16],
        wait: Duration::from_millis(1_500),
        kind: Some(RecordKind::Key),
        topics: vec![TopicId([2; 16]); 2],
        recorders: vec![RecorderId([3; 16]); 3],
        places: vec![
            Place { owner: Address([4; 20]), after: 5, grant: 7 },
            Place { owner: Address([6; 20]), after: u64::MAX, grant: 0 },
        ],
    }
}

/// A row of a feed.
pub(crate) fn entry(number: u64, fact: Fact, proof: Vec<u8>) -> FeedEntry {
    FeedEntry {
        number,
        fact,
        digest: Digest([1; 32]),
        owner: Address([2; 20]),
        recorder: RecorderId([3; 16]),
        seq: 4,
        topic_id: TopicId([5; 16]),
        epoch: 6,
        captured_at: Timestamp(7),
        length: 8,
        kind: RecordKind::Gap,
        proof,
    }
}

fn page() -> FeedPage {
    let entries = vec![entry(3, Fact::Stored, Vec::new()), entry(7, Fact::Verified, vec![3; 40])];
    let refused = vec![(Address([8; 20]), Code::NotAuthorised)];
    FeedPage::new([9; 16], (12, 8), refused, entries)
}

/// A notice that names a device.
pub(crate) fn notice_of(device: &SmKeyPair) -> DeviceNotice {
    let notices = topic_id(&IndexKey::new([3; 32]), &notice_topic(&signer_id(&device.public)));
    DeviceNotice { key: device.public, notices }
}

/// A record that was erased.
pub(crate) fn erasure() -> ErasureNotice {
    let (signer, signature) = (PublicKey([1; 64]), Signature([2; 64]));
    let record = Fetched { signer, signature, proof: vec![3; 40], blob: vec![4; 99] };
    let statement = ErasedStatement { report: Digest([5; 32]), at: Timestamp(6), signer, signature };
    let left = ErasedRecord { record, statement };
    ErasureNotice { digest: Digest([7; 32]), account_signature: AccountSignature([8; 65]), left }
}

/// One answer of each shape.
pub(crate) fn sample_answers() -> Vec<Answer> {
    let record =
        Fetched { signer: PublicKey([1; 64]), signature: Signature([2; 64]), proof: vec![3; 40], blob: vec![4; 99] };
    vec![
        Answer::SystemKeys(vec![1; 300]),
        Answer::Receipt(Command::KeyAllocation, receipt()),
        Answer::Receipt(Command::UploadMany, receipt()),
        Answer::Receipt(Command::DeviceNotice, receipt()),
        Answer::Time(Timestamp(5)),
        Answer::Relayed(Relayed::Result("\"0x7\"".into())),
        Answer::Relayed(Relayed::Fault { code: -32000, words: "reverted".into(), data: "\"0x08\"".into() }),
        Answer::Feed(Box::new(page())),
        Answer::Records(vec![
            Found::Missing(Code::NotFound),
            Found::Here,
            Found::Held(record),
            Found::Erased(erasure().left),
        ]),
        Answer::Erasures(vec![ErasureOutcome::Taken, ErasureOutcome::Left, ErasureOutcome::Refused]),
        Answer::Refused(Code::Token),
        Answer::Recalled(Timestamp(7)),
    ]
}

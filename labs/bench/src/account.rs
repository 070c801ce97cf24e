//! A throw-away profile: a registered account with its own keys and a nonce lane shared by many uploaders. Its keys
//! never leave memory.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};

use authros_chain::merkle::Leaf;
use authros_chain::{Call, Chain};
use authros_crypto::{
    EoaSecret, IndexKey, Provider, SealRequest, SealedRecord, Sm4Key, SmKeyPair, TopicKey, domain, epoch_key, prove,
    random_bytes, seal, token, topic_id, topic_key,
};
use authros_model::head::Compression;
use authros_model::{Address, Digest, Domain, Head, RecordKind, RecorderPrefix, Timestamp, Token, TopicId};
use authros_service::Failure;
use authros_service::reply::internal;

/// The topic of all records.
const TOPIC: &str = "/robot1/odom";

/// One account.
pub struct Account {
    /// Its EOA.
    pub eoa: EoaSecret,
    /// The EOA's address.
    pub address: Address,
    /// The token of its only epoch.
    pub token: Token,
    provider: &'static dyn Provider,
    domain: Domain,
    signing: SmKeyPair,
    envelope: SmKeyPair,
    key: TopicKey,
    topic_id: TopicId,
    recorder: RecorderPrefix,
    seq: AtomicU64,
    nonce: AtomicU64,
}

/// A record sealed but not stored yet.
pub struct Sealed {
    /// Its leaf in a batch.
    pub leaf: Leaf,
    /// When its message was captured.
    pub captured_at: Timestamp,
    /// Its bytes.
    pub blob: Vec<u8>,
}

impl Account {
    /// Fresh keys for an account on the chain's contract; nothing is sent.
    ///
    /// # Errors
    /// If no contract is in use, or the random source fails.
    pub fn new(chain: &Chain, eoa: EoaSecret, nonce: u64, provider: &'static dyn Provider) -> Result<Self, Failure> {
        let pin = chain.pin().ok_or_else(|| internal("the contract is not deployed"))?;
        let domain = domain(pin.chain_id, &pin.genesis, &pin.contract);
        let address = eoa.address();
        let topic_id = topic_id(&IndexKey::generate()?, TOPIC);
        let epoch = epoch_key(&Sm4Key::generate()?, &random_bytes()?, &domain, &address, 1);
        Ok(Self {
            token: token(&domain, &address, 1, &epoch),
            eoa,
            address,
            provider,
            domain,
            signing: SmKeyPair::generate(provider)?,
            envelope: SmKeyPair::generate(provider)?,
            key: topic_key(&epoch, &topic_id),
            topic_id,
            recorder: RecorderPrefix::ledger(random_bytes()?),
            seq: AtomicU64::new(1),
            nonce: AtomicU64::new(nonce),
        })
    }

    /// The call that registers it, with its proof signed.
    ///
    /// # Errors
    /// Errors of the random source.
    pub fn registration(&self) -> Result<Call, Failure> {
        let envelope = &self.envelope.public;
        let identity = prove(self.provider, &self.domain, &self.address, &self.signing, envelope, self.token)?;
        Ok(Call::Register { identity, envelope: Vec::new() })
    }

    /// Starts its lane at the nonce that the chain expects next.
    pub fn begin_lane(&self, nonce: u64) {
        self.nonce.store(nonce, Ordering::Relaxed);
    }

    /// Takes the next nonce of its lane.
    pub fn next_nonce(&self) -> u64 {
        self.nonce.fetch_add(1, Ordering::Relaxed)
    }

    /// Seals a message captured now as the next record.
    ///
    /// # Errors
    /// Errors of the random source.
    pub fn seal(&self, body: &[u8]) -> Result<Sealed, Failure> {
        let (seq, captured_at) = (self.seq.fetch_add(1, Ordering::Relaxed), Timestamp::now());
        let head = head(body.len());
        let request = SealRequest {
            domain: self.domain,
            owner: self.address,
            signer: &self.signing,
            epoch: 1,
            topic_key: &self.key,
            recorder: self.recorder,
            seq,
            topic_id: self.topic_id,
            kind: RecordKind::Data,
            filters: Vec::new(),
            captured_at,
            head: &head,
            body,
        };
        let SealedRecord { header, blob, digest, .. } = seal(self.provider, &request)?;
        let leaf = Leaf::of(&header, digest);
        Ok(Sealed { leaf, captured_at, blob })
    }
}

/// The head of a message of that length.
pub fn head(length: usize) -> Head {
    Head {
        topic: TOPIC.to_owned(),
        type_name: "nav_msgs/Odometry".to_owned(),
        md5sum: "cd5e73d190d741a2f92e81eda573aca7".to_owned(),
        definition: Digest([0; 32]),
        caller_id: "/bench".to_owned(),
        boot_id: [0; 16],
        compression: Compression::None,
        plain_length: length as u64,
        tags: BTreeMap::from([("simulated".to_owned(), "true".to_owned())]),
    }
}

/// A message of random bytes, so that none is cheaper than another.
///
/// # Errors
/// Errors of the random source.
pub fn message(length: usize) -> Result<Vec<u8>, Failure> {
    let mut message = Vec::with_capacity(length);
    while message.len() < length {
        let more = random_bytes::<1024>()?;
        message.extend_from_slice(more.get(..length - message.len()).unwrap_or(&more));
    }
    Ok(message)
}

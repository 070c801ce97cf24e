//! The sender to the measured gateway: throw-away keys, and records sealed in advance.

use crate::account::head;
use authros_crypto::{EoaSecret, Provider, SealRequest, SmKeyPair, TopicKey, random_bytes, seal};
use authros_gateway::Upload;
use authros_model::{Address, Domain, RecordKind, RecorderPrefix, Timestamp, Token, TopicId};
use authros_service::Failure;

/// The sender, and the gateway's identity.
pub(super) struct Sender {
    pub provider: &'static dyn Provider,
    pub domain: Domain,
    pub address: Address,
    pub token: Token,
    pub signing: SmKeyPair,
    pub envelope: SmKeyPair,
    pub gateway: SmKeyPair,
    key: TopicKey,
}

impl Sender {
    pub fn new(provider: &'static dyn Provider) -> Result<Self, Failure> {
        Ok(Self {
            provider,
            domain: Domain(random_bytes()?),
            address: EoaSecret::generate()?.address(),
            token: Token(random_bytes()?),
            signing: SmKeyPair::generate(provider)?,
            envelope: SmKeyPair::generate(provider)?,
            gateway: SmKeyPair::generate(provider)?,
            key: TopicKey::generate()?,
        })
    }

    /// This many records of this many bytes of message.
    pub fn seal_all(&self, count: usize, bytes: usize) -> Result<Vec<Upload>, Failure> {
        let (recorder, topic_id) = (RecorderPrefix::ledger(random_bytes()?), TopicId(random_bytes()?));
        let (head, body) = (head(bytes), vec![0x5a; bytes]);
        let one = |seq: u64| {
            let request = SealRequest {
                domain: self.domain,
                owner: self.address,
                signer: &self.signing,
                epoch: 1,
                topic_key: &self.key,
                recorder,
                seq,
                topic_id,
                kind: RecordKind::Data,
                filters: Vec::new(),
                captured_at: Timestamp::now(),
                head: &head,
                body: &body,
            };
            Ok(Upload::from(&seal(self.provider, &request)?))
        };
        (1..=count as u64).map(one).collect()
    }
}

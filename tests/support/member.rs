//! A profile's keys in the test's own hands, as a second client of the gateway's protocol would have them.

use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};

use authros::crypto::{
    EpochKey, IndexKey, Keyring, Passphrase, Provider, ProviderName, SealRequest, SmKeyPair, TopicKey, filter_id,
    provider, random_bytes, seal, token, topic_id, topic_key,
};
use authros::gateway::{
    Applicant, Client, Code, Context, Credentials, Endpoint, Feed, FeedEntry, Fetched, GatewayError, Trust, Upload,
};
use authros::model::head::Compression;
use authros::model::{
    Address, Digest, Domain, Head, ProfileName, RecordKind, RecorderPrefix, SignerId, Timestamp, Token, TopicId,
};
use serde_json::Value;

use super::{Home, text};

/// A gateway started by a test, as described in its JSON.
#[derive(Debug, Clone)]
pub struct Gateway {
    pub address: String,
    pub id: SignerId,
    pub domain: Domain,
    pub account: String,
}

impl Gateway {
    /// From the first line of `gateway serve --json`.
    pub fn of(told: &Value) -> Self {
        let view = &told["gateway"];
        Self {
            address: text(view, "address"),
            id: text(view, "gateway").parse().expect("an id"),
            domain: text(view, "domain").parse().expect("a domain"),
            account: text(view, "account"),
        }
    }

    pub fn endpoint(&self) -> Endpoint {
        let context = Context { provider: provider(ProviderName::RustCrypto), domain: self.domain };
        Endpoint { addresses: vec![self.address.clone()], context, patience: Duration::from_secs(20), source: None }
    }

    pub fn trust(&self) -> Trust {
        Trust::pinned(self.id)
    }
}

/// A registered profile with its keys.
pub struct Member {
    pub keyring: Keyring,
    pub domain: Domain,
    pub recorder: RecorderPrefix,
    pub epoch: u64,
}

impl Member {
    /// For a profile whose passphrase is stored beside its keyring.
    pub fn of(home: &Home, profile: &str, domain: Domain) -> Self {
        let directory = home.path().join("profiles").join(profile);
        let passphrase = std::fs::read_to_string(directory.join("passphrase")).expect("a passphrase");
        let passphrase = Passphrase::new(passphrase.trim_end().to_owned()).expect("a passphrase");
        let keyring = Keyring::load(&directory.join("keyring"), &passphrase).expect("opens");
        let epoch = keyring.networks.get(&domain).expect("registered").current;
        Self { keyring, domain, recorder: RecorderPrefix::ledger(random_bytes().expect("random")), epoch }
    }

    pub fn provider(&self) -> &'static dyn Provider {
        provider(ProviderName::RustCrypto)
    }

    pub fn address(&self) -> Address {
        self.keyring.eoa.address()
    }

    pub fn epoch_key(&self) -> EpochKey {
        self.keyring.networks[&self.domain].epochs[&self.epoch].key.clone()
    }

    pub fn token(&self) -> Token {
        token(&self.domain, &self.address(), self.epoch, &self.epoch_key())
    }

    pub fn topic(&self, name: &str) -> (TopicId, TopicKey) {
        let id = topic_id(&self.keyring.index, name);
        (id, topic_key(&self.epoch_key(), &id))
    }

    pub fn index(&self) -> &IndexKey {
        &self.keyring.index
    }

    /// A sealed record of `std_msgs/String`, as a robot sends it.
    pub fn record(&self, signer: &SmKeyPair, topic: &str, seq: u64, body: &[u8]) -> Upload {
        self.record_of(signer, topic, seq, body, Timestamp::now())
    }

    /// The same, with another stated capture time.
    pub fn record_of(&self, signer: &SmKeyPair, topic: &str, seq: u64, body: &[u8], captured_at: Timestamp) -> Upload {
        let (id, key) = self.topic(topic);
        let head = Head {
            topic: topic.to_owned(),
            type_name: "std_msgs/String".to_owned(),
            md5sum: "992ce8a1687cec8c8bd883ec73ca41d1".to_owned(),
            definition: Digest(self.provider().sm3(&[b"string data\n"])),
            caller_id: "/robot".to_owned(),
            boot_id: [1; 16],
            compression: Compression::None,
            plain_length: body.len() as u64,
            tags: BTreeMap::new(),
        };
        let request = SealRequest {
            domain: self.domain,
            owner: self.address(),
            signer,
            epoch: self.epoch,
            topic_key: &key,
            recorder: self.recorder,
            seq,
            topic_id: id,
            kind: RecordKind::Data,
            filters: vec![filter_id(self.index(), "type", "std_msgs/String")],
            captured_at,
            head: &head,
            body,
        };
        Upload::from(&seal(self.provider(), &request).expect("seals"))
    }

    /// Allocates a transport key for a name.
    pub async fn allocate(&self, gateway: &Gateway, name: &str) -> Result<Credentials, GatewayError> {
        let name: ProfileName = name.parse().expect("a name");
        let keys = &self.keyring;
        let applicant =
            Applicant { name: &name, signing: &keys.signing, envelope: keys.envelope.public, account: &keys.eoa };
        let (key, _) = Client::allocate(&gateway.endpoint(), &mut gateway.trust(), &applicant).await?;
        Ok(Credentials { name, key, token: self.token() })
    }
}

/// A session; a gateway that was just started gets a moment.
pub async fn connect(gateway: &Gateway, credentials: &Credentials) -> Client {
    Client::connect(&gateway.endpoint(), &mut gateway.trust(), credentials).await.expect("connects")
}

/// How long a gateway may take to know its newest block.
const PATIENCE: Duration = Duration::from_secs(5);

/// Everything that a gateway tells of this, from the beginning.
///
/// # Errors
/// The gateway's refusal.
pub async fn told(client: &mut Client, feed: &Feed) -> Result<Vec<FeedEntry>, GatewayError> {
    let (mut feed, mut told) = (Feed { wait: PATIENCE, ..feed.clone() }, Vec::new());
    // A busy gateway may not know its newest block in this very moment.
    loop {
        let page = client.feed(&feed).await?;
        if let (Some((_, code)), true) = (page.refused.first(), page.entries.is_empty()) {
            return Err(GatewayError::Refused(*code));
        }
        feed.after(&page);
        told.extend(page.entries.iter().cloned());
        if page.upto == page.head {
            break;
        }
    }
    Ok(told)
}

/// Waits until all of these are told of there.
pub async fn until_verified(client: &mut Client, feed: Feed, digests: &[Digest]) {
    let (mut feed, end) = (Feed { wait: Duration::from_secs(1), ..feed }, Instant::now() + Duration::from_secs(60));
    let mut left: Vec<Digest> = digests.to_vec();
    while !left.is_empty() {
        assert!(Instant::now() < end, "not verified in time: {left:?}");
        let page = client.feed(&feed).await.expect("her own");
        feed.after(&page);
        left.retain(|digest| !page.entries.iter().any(|entry| entry.digest == *digest));
    }
}

/// A follower who gets one record after the other, as they come.
pub struct Live {
    feed: Feed,
    told: VecDeque<FeedEntry>,
}

impl Live {
    /// From now on.
    ///
    /// # Errors
    /// The gateway's refusal.
    pub async fn begin(client: &mut Client, feed: Feed) -> Result<Self, GatewayError> {
        let mut feed = Feed { wait: PATIENCE, ..feed };
        loop {
            let page = client.feed(&feed).await?;
            feed.after(&page);
            if page.upto == page.head {
                break;
            }
        }
        Ok(Self { feed, told: VecDeque::new() })
    }

    /// The next record.
    ///
    /// # Errors
    /// [`GatewayError::TimedOut`] if none comes within this time, or the gateway's refusal.
    pub async fn next(
        &mut self,
        client: &mut Client,
        patience: Duration,
    ) -> Result<(FeedEntry, Fetched), GatewayError> {
        let end = Instant::now() + patience;
        loop {
            if let Some(entry) = self.told.pop_front() {
                match client.fetch(&entry.digest).await {
                    Err(GatewayError::Refused(Code::Stale)) if Instant::now() < end => {
                        self.told.push_front(entry);
                        tokio::time::sleep(Duration::from_millis(100)).await;
                        continue;
                    }
                    record => return Ok((entry, record?)),
                }
            }
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err(GatewayError::TimedOut);
            }
            self.feed.wait = left.min(Duration::from_secs(20));
            let page = client.feed(&self.feed).await?;
            self.feed.after(&page);
            self.told.extend(page.entries);
        }
    }
}

//! One record sealed, or checked, proven and opened, by a provider that measures another.

use std::hint::black_box;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use zeroize::Zeroizing;

use crate::account::{head, message};
use authros_chain::merkle::{Inclusion, Leaf, Tree};
use authros_crypto::compression::pack;
use authros_crypto::{
    Anchor, CryptoError, Expected, Names, Provider, SealRequest, SealedRecord, SmKeyPair, SmSecret, TopicKey, open,
    seal,
};
use authros_model::{
    Address, Domain, FilterId, Head, PublicKey, RecordKind, RecorderPrefix, Signature, Timestamp, TopicId,
};
use authros_service::Failure;
use authros_service::reply::internal;

/// Records in the batch of the proof.
const BATCH: u64 = 256;
const DOMAIN: Domain = Domain([1; 32]);
const OWNER: Address = Address([2; 20]);
const TOPIC: TopicId = TopicId([4; 16]);

/// Microseconds of each step, in the order in which they were first done.
pub type Lap = Vec<(&'static str, f64)>;

fn add(lap: &mut Lap, step: &'static str, begun: Instant) {
    let time = begun.elapsed().as_secs_f64() * 1e6;
    match lap.iter_mut().find(|(known, _)| *known == step) {
        Some((_, sum)) => *sum += time,
        None => lap.push((step, time)),
    }
}

/// A provider that measures another.
struct Timed {
    provider: &'static dyn Provider,
    lap: Mutex<Lap>,
    begun: Instant,
}

impl Timed {
    fn new(provider: &'static dyn Provider) -> Self {
        Self { provider, lap: Mutex::default(), begun: Instant::now() }
    }

    fn time<Done>(&self, step: &'static str, work: impl FnOnce() -> Done) -> Done {
        let begun = Instant::now();
        let done = work();
        add(&mut self.lap.lock().unwrap_or_else(PoisonError::into_inner), step, begun);
        done
    }

    /// What no step has is the rest.
    fn finish(self) -> Lap {
        let whole = self.begun.elapsed().as_secs_f64() * 1e6;
        let mut lap = self.lap.into_inner().unwrap_or_else(PoisonError::into_inner);
        let steps: f64 = lap.iter().map(|(_, time)| time).sum();
        lap.push(("rest", whole - steps));
        lap
    }
}

impl Provider for Timed {
    fn name(&self) -> &'static str {
        self.provider.name()
    }

    fn sm3(&self, parts: &[&[u8]]) -> [u8; 32] {
        self.time("SM3", || self.provider.sm3(parts))
    }

    fn gcm_seal_in_place(
        &self,
        key: &[u8; 16],
        nonce: &[u8; 12],
        aad: &[u8],
        text: &mut [u8],
    ) -> Result<[u8; 16], CryptoError> {
        self.time("SM4-GCM", || self.provider.gcm_seal_in_place(key, nonce, aad, text))
    }

    fn gcm_open(
        &self,
        key: &[u8; 16],
        nonce: &[u8; 12],
        aad: &[u8],
        sealed: &[u8],
    ) -> Result<Zeroizing<Vec<u8>>, CryptoError> {
        self.time("SM4-GCM", || self.provider.gcm_open(key, nonce, aad, sealed))
    }

    fn sign(&self, secret: &SmSecret, message: &[u8]) -> Result<Signature, CryptoError> {
        self.time("SM2", || self.provider.sign(secret, message))
    }

    fn verify(&self, public: &PublicKey, message: &[u8], signature: &Signature) -> Result<(), CryptoError> {
        self.time("SM2", || self.provider.verify(public, message, signature))
    }

    fn encrypt(&self, public: &PublicKey, plain: &[u8]) -> Result<Vec<u8>, CryptoError> {
        self.provider.encrypt(public, plain)
    }

    fn decrypt(&self, secret: &SmSecret, der: &[u8]) -> Result<Zeroizing<Vec<u8>>, CryptoError> {
        self.provider.decrypt(secret, der)
    }

    fn public_key(&self, secret: &SmSecret) -> Result<PublicKey, CryptoError> {
        self.provider.public_key(secret)
    }

    fn check_public_key(&self, public: &PublicKey) -> Result<(), CryptoError> {
        self.provider.check_public_key(public)
    }
}

/// Keys and a message.
pub struct Kit {
    provider: &'static dyn Provider,
    signer: SmKeyPair,
    key: TopicKey,
    head: Head,
    body: Vec<u8>,
}

impl Kit {
    /// A message of `size` random bytes.
    pub fn new(provider: &'static dyn Provider, size: usize) -> Result<Self, Failure> {
        let (head, body) = (head(size), message(size)?);
        let kit = Self { provider, signer: SmKeyPair::generate(provider)?, key: TopicKey::new([5; 32]), head, body };
        // Tables and caches are filled before the first run.
        let (sealed, _) = kit.seal()?;
        kit.open(&sealed)?;
        Ok(kit)
    }

    /// Tries to compress, and seals.
    pub fn seal(&self) -> Result<(SealedRecord, Lap), Failure> {
        let timed = Timed::new(self.provider);
        let packed = timed.time("compress", || black_box(pack(&self.body, None)));
        let request = SealRequest {
            domain: DOMAIN,
            owner: OWNER,
            signer: &self.signer,
            epoch: 1,
            topic_key: &self.key,
            recorder: RecorderPrefix::ledger([3; 7]),
            seq: 1,
            topic_id: TOPIC,
            kind: RecordKind::Data,
            filters: vec![FilterId([8; 8])],
            captured_at: Timestamp(1),
            head: &self.head,
            body: &self.body,
        };
        let sealed = seal(&timed, &request)?;
        match packed {
            None => Ok((sealed, timed.finish())),
            Some(_) => Err(internal("random bytes were compressed")),
        }
    }

    /// Checks, proves and opens.
    pub fn open(&self, sealed: &SealedRecord) -> Result<Lap, Failure> {
        let leaf = Leaf::of(&sealed.header, sealed.digest);
        let inclusion = inclusion(&leaf)?;
        let SealedRecord { blob, digest, signature, .. } = sealed;
        let expected = Expected::any_of(DOMAIN, OWNER, Names::Given(self.head.topic.clone()));
        let timed = Timed::new(self.provider);
        let proven = timed.time("proof", || black_box(inclusion.proves(black_box(&leaf))));
        let (signer, anchor) = (&self.signer.public, Anchor::Chain(*digest));
        let opened = open(&timed, blob, signature, signer, anchor, &self.key, &expected)?;
        let lap = timed.finish();
        let same = proven && opened.body == self.body;
        if same { Ok(lap) } else { Err(internal("a record did not open to what was sealed")) }
    }
}

/// The leaf's path in a batch.
fn inclusion(leaf: &Leaf) -> Result<Inclusion, Failure> {
    let leaves: Vec<Leaf> = (0..BATCH).map(|more| Leaf { seq: leaf.seq + more, ..*leaf }).collect();
    let tree = Tree::new(Leaf::hashes(&leaves)).ok_or_else(|| internal("a batch"))?;
    Ok(Inclusion { index: 0, count: BATCH, path: tree.path(0), root: tree.root() })
}

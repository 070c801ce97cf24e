//! One record sealed, or checked, proven and opened, with the clock read after each step.

use std::hint::black_box;
use std::time::Instant;

use crate::account::{head, message};
use authros_chain::merkle::{Inclusion, Leaf, Tree};
use authros_crypto::compression::pack;
use authros_crypto::record::{Step, open_in_steps, seal_in_steps};
use authros_crypto::{Anchor, Expected, Names, Provider, SealRequest, SealedRecord, SmKeyPair, TopicKey};
use authros_model::{Address, Domain, FilterId, Head, RecordKind, RecorderPrefix, Timestamp, TopicId};
use authros_service::Failure;
use authros_service::failure::internal;

/// Records in the batch of the proof.
const BATCH: u64 = 256;
const DOMAIN: Domain = Domain([1; 32]);
const OWNER: Address = Address([2; 20]);
const TOPIC: TopicId = TopicId([4; 16]);

/// Microseconds of each step, in the order in which they were first done.
pub type Lap = Vec<(&'static str, f64)>;

/// A clock that is read after each step.
struct Clock {
    last: Instant,
    lap: Lap,
}

impl Clock {
    fn start() -> Self {
        Self { lap: Vec::with_capacity(8), last: Instant::now() }
    }

    fn done(&mut self, step: &'static str) {
        let now = Instant::now();
        let time = (now - self.last).as_secs_f64() * 1e6;
        match self.lap.iter_mut().find(|(known, _)| *known == step) {
            Some((_, sum)) => *sum += time,
            None => self.lap.push((step, time)),
        }
        // The clock's own time is charged to no step.
        self.last = Instant::now();
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
        let mut clock = Clock::start();
        let packed = black_box(pack(&self.body, None));
        clock.done("compress");
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
        let sealed = seal_in_steps(self.provider, &request, &mut |step| clock.done(word(step)))?;
        match packed {
            None => Ok((sealed, clock.lap)),
            Some(_) => Err(internal("random bytes were compressed")),
        }
    }

    /// Checks, proves and opens.
    pub fn open(&self, sealed: &SealedRecord) -> Result<Lap, Failure> {
        let leaf = Leaf::of(&sealed.header, sealed.digest);
        let inclusion = inclusion(&leaf)?;
        let SealedRecord { blob, digest, signature, .. } = sealed;
        let names = Names::Given(self.head.topic.clone());
        let (record, expected) = ((&blob[..], signature, &self.signer.public), Expected::any_of(DOMAIN, OWNER, names));
        let mut clock = Clock::start();
        let proven = black_box(inclusion.proves(black_box(&leaf)));
        clock.done("proof");
        let mut done = |step: Step| clock.done(word(step));
        let opened = open_in_steps(self.provider, record, Anchor::Chain(*digest), &self.key, &expected, &mut done)?;
        let same = proven && opened.body == self.body;
        if same { Ok(clock.lap) } else { Err(internal("a record did not open to what was sealed")) }
    }
}

fn word(step: Step) -> &'static str {
    match step {
        Step::Fields => "fields",
        Step::Keys => "keys",
        Step::Cipher => "SM4-GCM",
        Step::Digest => "SM3",
        Step::Signature => "SM2",
        Step::Restore => "restore",
    }
}

/// The leaf's path in a batch.
fn inclusion(leaf: &Leaf) -> Result<Inclusion, Failure> {
    let leaves: Vec<Leaf> = (0..BATCH).map(|more| Leaf { seq: leaf.seq + more, ..*leaf }).collect();
    let tree = Tree::new(Leaf::hashes(&leaves)).ok_or_else(|| internal("a batch"))?;
    Ok(Inclusion { index: 0, count: BATCH, path: tree.path(0), root: tree.root() })
}

//! The feed: what a gateway has for a reader, in the order of the gateway's own numbers. A place is a feed's id and a
//! number for each owner: nothing ever appears behind it.

use std::time::Duration;

use crate::crypto::{CryptoError, Provider, SmKeyPair};
use crate::model::wire::{Reader, Wire as _, WireError, put_list, read_list};
use crate::model::{
    Address, Digest, Domain, Fact, Hash, PublicKey, RecordKind, RecorderId, Signature, Timestamp, TopicId, layout,
};
use crate::{command::messages::LONGEST_PROOF, error::Code};

/// With their proofs they fit into one frame.
pub const MOST_ENTRIES: usize = 256;
pub const MOST_OWNERS: usize = 1024;
pub const MOST_NAMED: usize = 32;
/// Of a waiting request.
pub const LONGEST_WAIT: Duration = Duration::from_secs(30);

/// Zeros if unknown.
pub type FeedId = [u8; 16];

/// owner (20) || number (8) || grant (8).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Place {
    pub owner: Address,
    /// Rows up to this number are done.
    pub after: u64,
    /// [`Self::grant_of`] the grant for these rows; under another grant the gateway sends none. 0 = any grant, or own
    /// records.
    pub grant: u64,
}

layout!(Place { owner: "owner", after: "number", grant: "grant" });

impl Place {
    /// The beginning of the transaction's hash.
    pub fn grant_of(transaction: &Hash) -> u64 {
        transaction.0.first_chunk().map_or(0, |first| u64::from_be_bytes(*first))
    }
}

/// feed id (16) || wait (2, milliseconds) || kind (1, 0 for any) || topics (1), 16 each || recorders (1), 16 each ||
/// owners (2), each a [`Place`].
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Feed {
    pub id: FeedId,
    /// Without news, at most [`LONGEST_WAIT`].
    pub wait: Duration,
    pub kind: Option<RecordKind>,
    /// Empty for all.
    pub topics: Vec<TopicId>,
    /// Empty for any. Devices name their own recorder, which nobody else knows.
    pub recorders: Vec<RecorderId>,
    pub places: Vec<Place>,
}

impl Feed {
    /// From the beginning.
    pub fn of(owner: Address) -> Self {
        Self { places: vec![Place { owner, after: 0, grant: 0 }], ..Self::default() }
    }

    /// Moves on past a page. Returns whether the feed starts over.
    pub fn after(&mut self, page: &FeedPage) -> bool {
        for place in &mut self.places {
            let told = if page.is_anew { 0 } else { place.after };
            let is_refused = page.refused.iter().any(|(owner, _)| *owner == place.owner);
            place.after = if is_refused { told } else { told.max(page.upto) };
        }
        self.id = page.id;
        page.is_anew
    }

    pub(crate) fn encode(&self) -> Vec<u8> {
        let wait = u16::try_from(self.wait.as_millis()).unwrap_or(u16::MAX);
        let mut out = [&self.id[..], &wait.to_be_bytes(), &[self.kind.map_or(0, RecordKind::code)]].concat();
        put_list::<u8>(&mut out, &self.topics, MOST_NAMED);
        put_list::<u8>(&mut out, &self.recorders, MOST_NAMED);
        put_list::<u16>(&mut out, &self.places, MOST_OWNERS);
        out
    }

    pub(crate) fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        let (id, wait) = (reader.array("feed id")?, Duration::from_millis(reader.u16("wait")?.into()));
        let kind = match reader.u8("kind")? {
            0 => None,
            code => Some(RecordKind::from_code(code).ok_or(WireError::Value("kind"))?),
        };
        if wait > LONGEST_WAIT {
            return Err(WireError::Value("wait"));
        }
        let topics = read_list::<u8, _>(reader, 0..=MOST_NAMED, ("topic count", "topic id"))?;
        let recorders = read_list::<u8, _>(reader, 0..=MOST_NAMED, ("recorder count", "recorder"))?;
        let places = read_list::<u16, _>(reader, 1..=MOST_OWNERS, ("owner count", "owner"))?;
        Ok(Self { id, wait, kind, topics, recorders, places })
    }
}

/// number (8) || fact (1) || digest (32) || owner (20) || recorder (16) || seq (8) || topic id (16) || epoch (8) ||
/// capture time (8) || length (8) || kind (1) || length (4) and proof of its anchor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FeedEntry {
    pub number: u64,
    pub fact: Fact,
    pub digest: Digest,
    pub owner: Address,
    pub recorder: RecorderId,
    pub seq: u64,
    /// Pseudonym.
    pub topic_id: TopicId,
    /// Its key seals the record.
    pub epoch: u64,
    pub captured_at: Timestamp,
    /// Bytes of the message.
    pub length: u64,
    pub kind: RecordKind,
    /// In the chain crate's form; empty until there is one.
    pub proof: Vec<u8>,
}

layout!(FeedEntry {
    number: "number",
    fact: "fact",
    digest: "digest",
    owner: "owner",
    recorder: "recorder",
    seq: "seq",
    topic_id: "topic id",
    epoch: "epoch",
    captured_at: "capture time",
    length: "length",
    kind: "kind",
    proof: "proof",
});

/// Length (4) || proof.
pub(crate) fn read_proof(reader: &mut Reader<'_>) -> Result<Vec<u8>, WireError> {
    let length = usize::try_from(reader.u32("proof length")?).unwrap_or(usize::MAX);
    if length > LONGEST_PROOF {
        return Err(WireError::Value("proof length"));
    }
    Ok(reader.take(length, "proof")?.to_vec())
}

/// feed id (16) || anew (1) || head (8) || upto (8) || refused owners (2), each: owner (20) || code (2) || entries (2),
/// each as above || time (8) || signature (64).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FeedPage {
    pub id: FeedId,
    /// The places are of another feed: the page starts at the beginning.
    pub is_anew: bool,
    /// The highest number so far.
    pub head: u64,
    /// All wanted rows up to this number are on this page or before it.
    pub upto: u64,
    /// Owners whose rows this caller may not have.
    pub refused: Vec<(Address, Code)>,
    pub entries: Vec<FeedEntry>,
    pub time: Timestamp,
    /// A robot's evidence; zeros without entries.
    pub signature: Signature,
}

impl FeedPage {
    pub fn new(id: FeedId, (head, upto): (u64, u64), refused: Vec<(Address, Code)>, entries: Vec<FeedEntry>) -> Self {
        Self { id, is_anew: false, head, upto, refused, entries, time: Timestamp::now(), signature: Signature([0; 64]) }
    }

    /// Worth an answer before the wait ends.
    pub(crate) fn tells(&self, asked: &Feed) -> bool {
        let is_behind = self.upto < self.head;
        !self.entries.is_empty() || !self.refused.is_empty() || self.is_anew || self.id != asked.id || is_behind
    }

    /// Signed after the domain: time (8) || count (2) || per entry: digest (32) || fact (1) || SM3 of its proof (32,
    /// else zeros).
    pub fn statement(&self, provider: &dyn Provider) -> Vec<u8> {
        let mut out = self.time.0.to_be_bytes().to_vec();
        out.extend_from_slice(&u16::try_from(self.entries.len()).unwrap_or(u16::MAX).to_be_bytes());
        for entry in &self.entries {
            out.extend_from_slice(&entry.digest.0);
            out.push(entry.fact.code());
            let proof = if entry.proof.is_empty() { [0; 32] } else { provider.sm3(&[&entry.proof]) };
            out.extend_from_slice(&proof);
        }
        out
    }

    /// Only with entries.
    pub fn sign(mut self, provider: &dyn Provider, domain: &Domain, identity: &SmKeyPair) -> Result<Self, CryptoError> {
        if !self.entries.is_empty() {
            let signed = signed_bytes(domain, &self.statement(provider));
            self.signature = provider.sign(&identity.secret, &signed)?;
        }
        Ok(self)
    }

    pub fn verify(&self, provider: &dyn Provider, domain: &Domain, gateway: &PublicKey) -> Result<(), CryptoError> {
        if self.entries.is_empty() {
            return Ok(());
        }
        provider.verify(gateway, &signed_bytes(domain, &self.statement(provider)), &self.signature)
    }

    pub(crate) fn encode(&self) -> Vec<u8> {
        let mut out = self.id.to_vec();
        self.is_anew.put(&mut out);
        (self.head, self.upto).put(&mut out);
        put_list::<u16>(&mut out, &self.refused, MOST_OWNERS);
        put_list::<u16>(&mut out, &self.entries, MOST_ENTRIES);
        (self.time, self.signature).put(&mut out);
        out
    }

    pub(crate) fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        let (id, is_anew) = (reader.array("feed id")?, bool::read(reader, "anew")?);
        let (head, upto) = (reader.u64("head")?, reader.u64("upto")?);
        let refused = read_list::<u16, _>(reader, 0..=MOST_OWNERS, ("refused count", "refused owner"))?;
        let entries: Vec<FeedEntry> = read_list::<u16, _>(reader, 0..=MOST_ENTRIES, ("entry count", "entry"))?;
        if entries.iter().any(|entry| entry.proof.len() > LONGEST_PROOF) {
            return Err(WireError::Value("proof length"));
        }
        // A follower goes by these numbers: they rise, and are within the page's bounds.
        let rise = entries.is_sorted_by(|one, next| one.number < next.number);
        if !rise || upto > head || entries.last().is_some_and(|last| last.number > upto) {
            return Err(WireError::Value("number"));
        }
        let (time, signature) = (Timestamp::read(reader, "time")?, Signature::read(reader, "signature")?);
        Ok(Self { id, is_anew, head, upto, refused, entries, time, signature })
    }
}

fn signed_bytes(domain: &Domain, statement: &[u8]) -> Vec<u8> {
    [&b"AuthROS/feed/1"[..], &domain.0, statement].concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crypto::{ProviderName, provider};
    use crate::tests::fixtures;

    fn entry(number: u64, proof: u8) -> FeedEntry {
        let digest = Digest([u8::try_from(number).expect("small"); 32]);
        FeedEntry { digest, kind: RecordKind::Data, ..fixtures::entry(number, Fact::Verified, vec![proof; 40]) }
    }

    fn page(entries: Vec<FeedEntry>) -> FeedPage {
        let upto = entries.last().map_or(0, |last| last.number);
        FeedPage::new([9; 16], (50, upto), Vec::new(), entries)
    }

    #[test]
    fn a_signature_binds_digests_facts_proofs_time_and_network() {
        let provider = provider(ProviderName::RustCrypto);
        let (identity, domain) = (SmKeyPair::generate(provider).expect("pair"), Domain([4; 32]));
        let signed = page(vec![entry(1, 7), entry(2, 7)]).sign(provider, &domain, &identity).expect("signs");
        let holds = |page: &FeedPage, domain: &Domain| page.verify(provider, domain, &identity.public).is_ok();
        assert!(holds(&signed, &domain) && !holds(&signed, &Domain([5; 32])));
        let mut lies = vec![signed.clone(); 5];
        lies[0].time.0 += 1;
        lies[1].entries.swap(0, 1);
        lies[2].entries[0].fact = Fact::Erased;
        lies[3].entries[1].proof = vec![8; 40];
        lies[4].entries.pop();
        assert!(lies.iter().all(|lie| !holds(lie, &domain)));
        let nothing = page(Vec::new()).sign(provider, &domain, &identity).expect("nothing to sign");
        assert!(holds(&nothing, &domain));
    }

    #[test]
    fn numbers_that_a_follower_could_not_go_by_are_malformed() {
        let parse = |page: &FeedPage| FeedPage::read(&mut Reader::new(&page.encode())).map(|read| read == *page);
        assert_eq!(parse(&page(vec![entry(1, 1), entry(5, 1)])), Ok(true));
        for lie in [
            page(vec![entry(5, 1), entry(1, 1)]),
            page(vec![entry(5, 1), entry(5, 1)]),
            FeedPage { upto: 4, ..page(vec![entry(5, 1)]) },
            FeedPage { upto: 51, ..page(vec![entry(5, 1)]) },
        ] {
            assert_eq!(parse(&lie), Err(WireError::Value("number")));
        }
    }

    #[test]
    fn a_place_moves_on_and_begins_anew_with_another_feed_or_a_head_before_it() {
        let (one, other) = (Address([1; 20]), Address([2; 20]));
        let mut feed = Feed::of(one);
        feed.places.push(Place { owner: other, after: 0, grant: 7 });
        let numbers = |feed: &Feed| feed.places.iter().map(|place| place.after).collect::<Vec<_>>();
        assert!(
            feed.after(&FeedPage { is_anew: true, ..page(vec![entry(7, 1)]) }),
            "the first page is of a feed that was not known"
        );
        assert_eq!((feed.id, numbers(&feed)), ([9; 16], vec![7, 7]));
        let refused = vec![(other, Code::NotAuthorised)];
        assert!(!feed.after(&FeedPage { upto: 20, refused, ..page(Vec::new()) }));
        assert_eq!(numbers(&feed), [20, 7], "nothing was told of who is refused");
        // The gateway was started again.
        assert!(!feed.after(&FeedPage { id: [8; 16], upto: 21, ..page(Vec::new()) }));
        assert_eq!((feed.id, numbers(&feed)), ([8; 16], vec![21, 21]));
        // Restored from a backup.
        assert!(feed.after(&FeedPage { id: [7; 16], is_anew: true, ..page(vec![entry(3, 1)]) }));
        assert_eq!(numbers(&feed), [3, 3]);
    }
}

//! A chain with one record: its trie, its headers and its seals are built from the Yellow Paper and EIP-225.

use std::collections::BTreeMap;

use authros_crypto::merkle::{Leaf, Tree};
use authros_crypto::record::{RecordSecret, SealRequest, SealedRecord, seal};
use authros_crypto::{
    EoaSecret, Provider, ProviderName, SmKeyPair, TopicKey, domain, keccak256, prove, provider, sign_hash,
};
use authros_model::head::Compression;
use authros_model::{
    Address, Digest, Domain, Hash, Head, Identity, RecordKind, RecorderPrefix, Timestamp, Token, TopicId,
};
use rlp::RlpStream;

use super::committed::Commit;
use crate::archive::Members;
use crate::{
    AnchorClaim, Anchoring, Bundle, BundledRecord, ClaimedChain, Disclosure, Nodes, Packing, PinnedChain, Report, Slot,
    Standing, Trust, pack, verify,
};

/// The anchoring block.
pub const BLOCK: u64 = 40;
/// Its time, seconds.
pub const TIME: u64 = 1_700_000_100;
pub const CONTRACT: Address = Address([0xc0; 20]);
pub const CODE: Hash = Hash([0xcc; 32]);
/// A gateway's account, which anchors for others.
pub const GATEWAY: Address = Address([0x6a; 20]);

pub fn ours() -> &'static dyn Provider {
    provider(ProviderName::default())
}

pub fn genesis() -> ClaimedChain {
    ClaimedChain { id: 7, genesis: Hash([9; 32]), contract: CONTRACT }
}

pub fn bound() -> Domain {
    domain(7, &Hash([9; 32]), &CONTRACT)
}

/// The root of a trie over these keys; its nodes go into `nodes` (Yellow Paper, appendix D).
pub fn trie(pairs: &[(Vec<u8>, Vec<u8>)], nodes: &mut Vec<Vec<u8>>) -> Hash {
    let all: Vec<(Vec<u8>, &Vec<u8>)> = pairs
        .iter()
        .map(|(key, value)| (keccak256(&[key]).iter().flat_map(|byte| [byte >> 4, byte & 15]).collect(), value))
        .collect();
    let node = built(&all, 0, nodes);
    nodes.push(node.clone());
    Hash(keccak256(&[&node]))
}

pub fn built(pairs: &[(Vec<u8>, &Vec<u8>)], depth: usize, nodes: &mut Vec<Vec<u8>>) -> Vec<u8> {
    let path = |nibbles: &[u8], leaf: u8| {
        let odd = nibbles.len() % 2;
        let mut all = vec![leaf * 2 + u8::try_from(odd).expect("0 or 1")];
        all.extend(std::iter::repeat_n(0, 1 - odd));
        all.extend(nibbles);
        all.chunks(2).map(|pair| pair[0] << 4 | pair[1]).collect::<Vec<u8>>()
    };
    let mut list = RlpStream::new();
    if let [(key, value)] = pairs {
        list.begin_list(2).append(&path(&key[depth..], 1)).append(*value);
        return list.out().to_vec();
    }
    let common = (depth..64).take_while(|at| pairs.iter().all(|(key, _)| key[*at] == pairs[0].0[*at])).count();
    if common > 0 {
        let below = built(pairs, depth + common, nodes);
        list.begin_list(2).append(&path(&pairs[0].0[depth..depth + common], 0));
        child(&mut list, below, nodes);
        return list.out().to_vec();
    }
    list.begin_list(17);
    for nibble in 0..16 {
        let some: Vec<_> = pairs.iter().filter(|(key, _)| key[depth] == nibble).cloned().collect();
        match some.is_empty() {
            true => {
                list.append_empty_data();
            }
            false => {
                let below = built(&some, depth + 1, nodes);
                child(&mut list, below, nodes);
            }
        }
    }
    list.append_empty_data();
    list.out().to_vec()
}

pub fn child(list: &mut RlpStream, node: Vec<u8>, nodes: &mut Vec<Vec<u8>>) {
    if node.len() < 32 {
        list.append_raw(&node, 1);
        return;
    }
    list.append(&&keccak256(&[&node])[..]);
    nodes.push(node);
}

pub fn account(secret: u8) -> (EoaSecret, Address) {
    let secret = EoaSecret::from_slice(&[secret; 32]).expect("in range");
    let signature = sign_hash(&secret, &[1; 32]).expect("signs");
    let address = authros_crypto::recover_account(&[1; 32], &signature).expect("recovers");
    (secret, address)
}

/// A Clique header, sealed by nobody if `sealer` is 0.
pub fn header(number: u64, parent: Hash, state: Hash, vanity: [u8; 32], sealer: u8) -> Vec<u8> {
    let encode = |extra: &[u8]| {
        let mut list = RlpStream::new_list(15);
        list.append(&&parent.0[..]).append(&&[1u8; 32][..]).append(&&[0u8; 20][..]).append(&&state.0[..]);
        list.append(&&[2u8; 32][..]).append(&&[3u8; 32][..]).append(&&[0u8; 256][..]).append(&2u64).append(&number);
        list.append(&1000u64).append(&0u64).append(&(TIME + number - BLOCK)).append(&extra);
        list.append(&&[0u8; 32][..]).append(&&[0u8; 8][..]);
        list.out().to_vec()
    };
    if sealer == 0 {
        return encode(&vanity);
    }
    let seal = sign_hash(&account(sealer).0, &keccak256(&[&encode(&vanity)])).expect("signs");
    let mut extra = [&vanity[..], &seal.0].concat();
    *extra.last_mut().expect("a seal") -= 27;
    encode(&extra)
}

/// Fields of a word of storage, from the low end.
pub fn word(fields: &[u64]) -> [u8; 32] {
    let mut word = [0; 32];
    for (at, field) in fields.iter().enumerate() {
        word[24 - 8 * at..32 - 8 * at].copy_from_slice(&field.to_be_bytes());
    }
    word
}

/// Everything that can be a lie.
pub struct World {
    pub owner: Address,
    pub keys: SmKeyPair,
    pub signer: SmKeyPair,
    pub identity: Identity,
    pub slots: BTreeMap<[u8; 32], [u8; 32]>,
    pub record: SealedRecord,
    pub topic_key: TopicKey,
    pub reveal: Option<Disclosure>,
    pub claim: AnchorClaim,
    pub vanity: [u8; 32],
    pub sealers: Vec<u8>,
    pub shown_at: u64,
    /// QBFT or IBFT 2.0 in place of Clique.
    pub commit: Option<Commit>,
    /// RLP of a part of the state in other bytes.
    pub respell: Respell,
}

type Respell = Box<dyn Fn(Part, Vec<u8>) -> Vec<u8>>;

/// What of the state can be written in other bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Its root node.
    Root,
    /// The contract's account.
    Account,
    /// Each word of the contract's storage.
    Word,
}

impl World {
    pub fn new() -> Self {
        let (keys, other) = (pair(), pair());
        let owner = Address([0x0e; 20]);
        let identity = prove(ours(), &bound(), &owner, &keys, &other.public, Token([5; 32])).expect("proves");
        Self::of(owner, keys.clone(), keys, identity, owner)
    }

    pub fn of(owner: Address, keys: SmKeyPair, signer: SmKeyPair, identity: Identity, anchorer: Address) -> Self {
        let topic_key = TopicKey::new([6; 32]);
        let record = sealed(owner, &signer, &topic_key, 3, b"the message");
        let others = (0..4).map(|number| Hash([number; 32]));
        let leaf = Leaf::of(&record.header, record.digest);
        let tree = Tree::new(others.chain([leaf.hash()]).collect()).expect("a tree");
        let (root, path) = (tree.root(), tree.path(4));
        let anchor = Anchoring::Batch { account: anchorer, root, index: 4, count: 5, path };
        let claim = AnchorClaim::new(BLOCK, BLOCK, 1, anchor);
        let mut world = Self {
            owner,
            keys,
            signer,
            identity,
            slots: BTreeMap::new(),
            record,
            topic_key,
            reveal: None,
            claim,
            vanity: [0; 32],
            sealers: vec![1, 2],
            shown_at: BLOCK,
            commit: None,
            respell: Box::new(|_, bytes| bytes),
        };
        world.put(Slot::anchor(anchorer, root), word(&[BLOCK, 5, TIME, 1]));
        world.put(Slot::account(owner), word(&[1, 0, 1]));
        world.put(Slot::keys(owner, 1), keccak256(&[&identity.encode()]));
        world.put(Slot::keys(owner, 1).next(1), word(&[10, TIME - 50]));
        world
    }

    pub fn put(&mut self, slot: Slot, word: [u8; 32]) {
        self.slots.insert(slot.0, word);
    }

    pub fn members(&self) -> Members {
        self.packing().sign(genesis(), self.owner, &self.keys, ours()).expect("packs")
    }

    pub fn packing(&self) -> Packing {
        let mut nodes = Vec::new();
        let storage: Vec<(Vec<u8>, Vec<u8>)> = self
            .slots
            .iter()
            .filter(|(_, value)| **value != [0; 32])
            .map(|(slot, value)| {
                let value: Vec<u8> = value.iter().copied().skip_while(|byte| *byte == 0).collect();
                (slot.to_vec(), (self.respell)(Part::Word, rlp::encode(&value).to_vec()))
            })
            .collect();
        let storage = trie(&storage, &mut nodes);
        let mut account = RlpStream::new_list(4);
        account.append(&1u64).append(&0u64).append(&&storage.0[..]).append(&&CODE.0[..]);
        let stranger = (vec![7u8; 20], rlp::encode(&vec![1u8; 40]).to_vec());
        let account = (self.respell)(Part::Account, account.out().to_vec());
        trie(&[(CONTRACT.0.to_vec(), account), stranger], &mut nodes);
        let root = (self.respell)(Part::Root, nodes.last().expect("a root").clone());
        let state = Hash(keccak256(&[&root]));
        nodes.push(root);
        let mut packing = Packing::default();
        let mut parent = Hash([8; 32]);
        for (number, sealer) in (self.shown_at..).zip(&self.sealers) {
            let bytes = match &self.commit {
                Some(commit) => commit.header(number, parent, state),
                None => header(number, parent, state, self.vanity, *sealer),
            };
            parent = Hash(keccak256(&[&bytes]));
            packing.header(number, bytes);
        }
        packing.nodes(&nodes.into_iter().collect::<Nodes>());
        packing.key(&self.signer.public).expect("a point");
        packing.identity(&self.identity);
        let anchor = Some(AnchorClaim { shown_at: self.shown_at, ..self.claim.clone() });
        let (record, signature) = (self.record.blob.clone(), self.record.signature);
        packing.record(self.record.digest, BundledRecord { record, signature, anchor }).expect("added");
        if let Some(reveal) = &self.reveal {
            packing.disclosure(reveal);
        }
        packing
    }

    pub fn trust() -> Trust {
        let signers = [1, 2, 3].map(|secret| account(secret).1).to_vec();
        let (id, genesis, contract, code_hash) = (7, Hash([9; 32]), CONTRACT, CODE);
        let chain = PinnedChain { id, genesis, contract, code_hash, signers, quorum: None, sealed_by_exporter: false };
        Trust { chain, persons: Vec::new(), authorities: Vec::new() }
    }

    pub fn report(&self) -> Report {
        self.report_by(&Self::trust())
    }

    pub fn report_by(&self, trust: &Trust) -> Report {
        let file = pack(&self.members()).expect("packs");
        verify(&Bundle::parse(&file, ours()).expect("reads"), Some(trust), ours())
    }

    /// The results of (a), (b), (c), (e), and the text of the requested one.
    pub fn judged(&self, letter: char) -> (Vec<Standing>, String) {
        let report = self.report();
        let record = report.records.first().expect("a record");
        let text = record.levels().iter().find(|(found, _)| *found == letter).expect("a level").1.text.clone();
        (record.levels().iter().filter(|(found, _)| *found != 'd').map(|(_, level)| level.standing).collect(), text)
    }

    pub fn expect(&self, letter: char, standing: Standing, text: &str) {
        let (standings, found) = self.judged(letter);
        let at = "abce".find(letter).expect("a letter");
        assert_eq!(standings[at], standing, "({letter}) {found}");
        assert!(found.contains(text), "({letter}) '{found}' does not say '{text}'");
    }

    pub fn disclose(&mut self, by: &SmKeyPair, secret: RecordSecret) {
        let secrets = BTreeMap::from([(self.record.digest, secret)]);
        self.reveal = Some(Disclosure::sign(secrets, &bound(), by, ours()).expect("signs"));
    }

    /// What its owner discloses if these records are added.
    pub fn disclosing<'a>(&self, records: impl IntoIterator<Item = &'a SealedRecord>) -> Disclosure {
        let secret = |one: &SealedRecord| (one.digest, RecordSecret::of(&self.topic_key, &one.header));
        let own = self.reveal.iter().flat_map(|reveal| reveal.secrets.clone());
        let secrets = own.chain(records.into_iter().map(secret)).collect();
        Disclosure::sign(secrets, &bound(), &self.keys, ours()).expect("signs")
    }
}

pub fn pair() -> SmKeyPair {
    SmKeyPair::generate(ours()).expect("pair")
}

pub fn sealed(owner: Address, signer: &SmKeyPair, topic_key: &TopicKey, seq: u64, body: &[u8]) -> SealedRecord {
    sealed_as(owner, signer, topic_key, seq, (body, body.len() as u64, Compression::None))
}

/// A record whose body is sealed as given, with what its head says about it.
pub fn sealed_as(
    owner: Address,
    signer: &SmKeyPair,
    topic_key: &TopicKey,
    seq: u64,
    body: (&[u8], u64, Compression),
) -> SealedRecord {
    sealed_by(RecorderPrefix::ledger([4; 7]), (owner, signer, topic_key), seq, body)
}

/// The same, numbered by this recorder.
pub fn sealed_by(
    recorder: RecorderPrefix,
    (owner, signer, topic_key): (Address, &SmKeyPair, &TopicKey),
    seq: u64,
    (body, plain_length, compression): (&[u8], u64, Compression),
) -> SealedRecord {
    let head = Head {
        topic: "/robot1/odom".into(),
        type_name: "std_msgs/String".into(),
        md5sum: "0".repeat(32),
        definition: Digest([4; 32]),
        caller_id: "/robot1".into(),
        boot_id: [5; 16],
        compression,
        plain_length,
        tags: BTreeMap::new(),
    };
    let request = SealRequest {
        domain: bound(),
        owner,
        signer,
        epoch: 1,
        topic_key,
        recorder,
        seq,
        topic_id: TopicId([8; 16]),
        kind: RecordKind::Data,
        filters: Vec::new(),
        captured_at: Timestamp::from_seconds(TIME - 7),
        head: &head,
        body,
    };
    seal(ours(), &request).expect("seals")
}

//! QBFT and IBFT 2.0: headers of real networks of Besu, and headers made here from what Besu's documentation says of
//! their extra data, with every lie in turn.

use std::collections::BTreeMap;

use authros_crypto::{keccak256, sign_hash};
use authros_model::bytes::unhex;
use authros_model::{Address, Hash};
use rlp::RlpStream;
use serde_json::Value;

use super::second::agree;
use super::world::{BLOCK, TIME, World, account};
use crate::{BlockHeader, Flaw, LONGEST_HEADER, Outcome, Protocol, Seals, Standing, Trust, seals};

use Standing::{OwnChain, Proven, Refused, Unproven};

/// A header under QBFT, or IBFT 2.0, whose validators have the keys of `account`.
#[derive(Clone)]
pub struct Commit {
    pub ibft2: bool,
    /// Whom the header names.
    pub named: Vec<u8>,
    /// Who seal it.
    pub sealers: Vec<u8>,
    /// The round that it names.
    pub round: u32,
    /// The round in which it was sealed.
    pub sealed: u32,
    /// Whom somebody voted in.
    pub vote: Option<Address>,
    /// The time it says more than it had when it was sealed.
    pub later: u64,
}

impl Commit {
    pub fn by(sealers: &[u8]) -> Self {
        let (named, sealers) = (vec![1, 2, 3, 4], sealers.to_vec());
        Self { ibft2: false, named, sealers, round: 0, sealed: 0, vote: None, later: 0 }
    }

    fn extra(&self, round: u32, seals: Option<&[[u8; 65]]>) -> Vec<u8> {
        let mut list = RlpStream::new_list(if self.ibft2 && seals.is_none() { 4 } else { 5 });
        list.append(&&[7u8; 32][..]).begin_list(self.named.len());
        for named in &self.named {
            list.append(&&account(*named).1.0[..]);
        }
        match (&self.vote, self.ibft2) {
            (Some(vote), _) => {
                list.begin_list(2).append(&&vote.0[..]).append(&0xffu8);
            }
            (None, true) => {
                list.append_empty_data();
            }
            (None, false) => {
                list.begin_list(0);
            }
        }
        if self.ibft2 {
            list.append(&&round.to_be_bytes()[..]);
        } else {
            list.append(&round);
        }
        if let Some(seals) = seals.or((!self.ibft2).then_some(&[][..])) {
            list.begin_list(seals.len());
            for seal in seals {
                list.append(&&seal[..]);
            }
        }
        list.out().to_vec()
    }

    pub fn header(&self, number: u64, parent: Hash, state: Hash) -> Vec<u8> {
        let encode = |extra: &[u8], time: u64| {
            let mut list = RlpStream::new_list(16);
            list.append(&&parent.0[..]).append(&&[1u8; 32][..]).append(&&[4u8; 20][..]).append(&&state.0[..]);
            list.append(&&[2u8; 32][..]).append(&&[3u8; 32][..]).append(&&[0u8; 256][..]).append(&1u64).append(&number);
            list.append(&1000u64).append(&0u64).append(&time).append(&extra);
            list.append(&&b"ctical byzantine fault tolerance"[..]).append(&&[0u8; 8][..]).append(&0u64);
            list.out().to_vec()
        };
        let time = TIME + number - BLOCK;
        let signed = keccak256(&[&encode(&self.extra(self.sealed, None), time)]);
        let seal = |sealer: &u8| {
            let mut seal = sign_hash(&account(*sealer).0, &signed).expect("signs").0;
            seal[64] -= 27;
            seal
        };
        let seals: Vec<[u8; 65]> = self.sealers.iter().map(seal).collect();
        encode(&self.extra(self.round, Some(&seals)), time + self.later)
    }

    fn world(self) -> World {
        World { commit: Some(self), sealers: vec![0], ..World::new() }
    }

    fn judged(&self, pinned: &[u8]) -> Seals {
        let header = self.header(BLOCK, Hash([8; 32]), Hash([2; 32]));
        judged(&header, &pinned.iter().map(|secret| account(*secret).1).collect::<Vec<_>>())
    }
}

fn judged(header: &[u8], pinned: &[Address]) -> Seals {
    let header = BlockHeader::parse(header).expect("a header");
    let number = header.number;
    seals(&BTreeMap::from([(number, header)]), number, pinned)
}

fn trust(quorum: Option<usize>) -> Trust {
    let mut trust = World::trust();
    (trust.chain.signers, trust.chain.quorum) = ([1, 2, 3, 4].map(|secret| account(secret).1).to_vec(), quorum);
    trust
}

fn expect(commit: Commit, standing: Standing, told: &str) {
    let outcome = match standing {
        Proven => Outcome::Holds,
        Refused => Outcome::Refused,
        _ => Outcome::Incomplete,
    };
    let is_ibft2 = commit.ibft2;
    let world = commit.world();
    let report = world.report_by(&trust(None));
    let anchor = &report.records[0].anchor;
    assert_eq!((anchor.standing, report.outcome), (standing, outcome), "{}", anchor.text);
    assert!(anchor.text.contains(told), "'{}' does not say '{told}'", anchor.text);
    // Both forms are one code in the second verifier but for their encoding.
    if !is_ibft2 || standing == Proven {
        agree(&world.members(), &trust(None), outcome);
    }
}

fn bytes(text: &Value) -> Vec<u8> {
    let digits = text.as_str().expect("text").trim_start_matches("0x");
    unhex(&format!("{}{digits}", "0".repeat(digits.len() % 2))).expect("hex")
}

/// A header from what a node answers for its block.
fn of_node(block: &Value) -> Vec<u8> {
    let names = "parentHash sha3Uncles miner stateRoot transactionsRoot receiptsRoot logsBloom difficulty number gasLimit \
                 gasUsed timestamp extraData mixHash nonce baseFeePerGas";
    let present: Vec<&str> = names.split(' ').filter(|name| block.get(name).is_some()).collect();
    let mut list = RlpStream::new_list(present.len());
    for (at, name) in present.into_iter().enumerate() {
        let all = bytes(&block[name]);
        let number = (7..12).contains(&at) || at == 15;
        let zeros = all.iter().take_while(|byte| number && **byte == 0).count();
        list.append(&&all[zeros..]);
    }
    list.out().to_vec()
}

/// Three networks of Besu: the node's own hash of its block, and seals of validators that it names.
#[test]
fn blocks_of_real_networks_have_their_hash_and_the_seals_of_their_validators() {
    let blocks: Value = serde_json::from_str(include_str!("besu.json")).expect("JSON");
    for (name, protocol, round, validators, sealers) in
        [("ibft2", Protocol::Ibft2, 1, 4, 3), ("qbft", Protocol::Qbft, 0, 1, 1)]
    {
        let header = BlockHeader::parse(&of_node(&blocks[name])).expect("a header");
        assert_eq!(header.hash, Hash::from_slice(&bytes(&blocks[name]["hash"])).expect("a hash"));
        let committed = header.committed().expect("has seals");
        assert_eq!((committed.protocol, committed.round, committed.validators.len()), (protocol, round, validators));
        let pinned = committed.validators.clone();
        let found = judged(&of_node(&blocks[name]), &pinned);
        assert_eq!((found.pinned.len(), found.stranger, found.flaw), (sealers, None, None));
    }
    let four = bytes(&blocks["four"]["rlp"]);
    let header = BlockHeader::parse(&four).expect("a header");
    let committed = header.committed().expect("has seals");
    assert_eq!((committed.protocol, committed.round, header.number), (Protocol::Qbft, 1, 7528));
    assert_eq!(committed.signed().expect("hashed").to_vec(), bytes(&blocks["four"]["signed"]));
    let found = judged(&four, &committed.validators);
    assert_eq!((found.pinned.len(), found.flaw), (3, None));
    // The one bit of its time that was altered.
    let mut altered = four.clone();
    let at = four.windows(4).position(|four| four == [0x66, 0x40, 0x61, 0x8b]).expect("its time");
    altered[at + 3] ^= 1;
    assert_eq!(judged(&altered, &committed.validators).flaw, Some(Flaw::Altered));
}

/// Each consensus has its validators elsewhere in the extra data.
#[test]
fn validators_are_read_from_the_extra_data() {
    let blocks: Value = serde_json::from_str(include_str!("besu.json")).expect("JSON");
    for (name, count) in [("ibft2", 4), ("qbft", 1)] {
        let extra = bytes(&blocks[name]["extraData"]);
        let named = crate::validators_in(&extra);
        let header = BlockHeader::parse(&of_node(&blocks[name])).expect("a header");
        assert_eq!((named.len(), Some(&named)), (count, header.committed().map(|committed| &committed.validators)));
        assert!((0..extra.len()).all(|end| crate::validators_in(&extra[..end]).is_empty()), "{name}, cut");
    }
    let of = |secret: u8| account(secret).1;
    let mut first = RlpStream::new_list(3);
    first.begin_list(2).append(&&of(1).0[..]).append(&&of(2).0[..]);
    first.append(&&[0u8; 65][..]).begin_list(0);
    let first = [&[0; 32][..], &first.out()].concat();
    assert_eq!(crate::validators_in(&first), [of(1), of(2)]);
    let clique = [&[1; 32][..], &[7; 20], &[8; 20], &[0; 65]].concat();
    assert!(crate::validators_in(&clique).is_empty() && crate::validators_in(&[]).is_empty());
}

/// Nobody is pinned, so nothing is contradicted: it is not proven, in both verifiers.
#[test]
fn a_trust_file_that_pins_no_signers_proves_nothing_and_refuses_nothing() {
    let mut nobody = trust(None);
    nobody.chain.signers.clear();
    let worlds = [Commit::by(&[1, 2, 3]).world(), Commit { named: vec![], ..Commit::by(&[1]) }.world(), World::new()];
    for world in worlds {
        let report = world.report_by(&nobody);
        let anchor = &report.records[0].anchor;
        assert_eq!((anchor.standing, report.outcome), (Unproven, Outcome::Incomplete), "{}", anchor.text);
        assert!(anchor.text.contains("the trust file pins no signers"), "{}", anchor.text);
        agree(&world.members(), &nobody, Outcome::Incomplete);
    }
    // What a header says against itself needs no pin.
    assert_eq!(Commit::by(&[1, 2]).world().report_by(&nobody).outcome, Outcome::Refused);
}

#[test]
fn a_quorum_in_one_header_is_enough() {
    for ibft2 in [false, true] {
        let of = |sealers: &[u8]| Commit { ibft2, ..Commit::by(sealers) };
        let how = if ibft2 { "in its own header (IBFT 2.0)" } else { "in its own header (QBFT)" };
        expect(of(&[4, 1, 2]), Proven, &format!("sealed by 3 of 4 pinned signers {how}"));
        expect(of(&[4, 1, 2, 3]), Proven, "sealed by 4 of 4");
        let voted = Commit { vote: Some(Address([9; 20])), round: 300, sealed: 300, ..of(&[1, 3, 4]) };
        expect(voted, Proven, "sealed by 3 of 4");
    }
    // A contract of the network keeps its validators.
    expect(Commit { named: vec![], ..Commit::by(&[1, 2, 3]) }, Proven, "sealed by 3 of 4");
    let own = {
        let mut trust = trust(None);
        trust.chain.sealed_by_exporter = true;
        Commit::by(&[1, 2, 3]).world().report_by(&trust)
    };
    assert_eq!(own.records[0].anchor.standing, OwnChain);
    let unpinned = Commit::by(&[1, 2, 3]).world();
    let file = crate::pack(&unpinned.members()).expect("packs");
    let bundle = crate::Bundle::parse(&file, super::world::ours()).expect("reads");
    let report = crate::verify(&bundle, None, super::world::ours());
    assert!(report.records[0].anchor.text.contains("sealed by 3 validators (QBFT): you pinned no signers"));
}

#[test]
fn each_flaw_of_seals_in_a_header_has_its_own_reason() {
    let a = |secret: u8| account(secret).1;
    for ibft2 in [false, true] {
        let of = |sealers: &[u8]| Commit { ibft2, ..Commit::by(sealers) };
        expect(of(&[1, 2]), Refused, "has the seals of 2 of the 4 validators that it names, and 3 are needed");
        expect(of(&[]), Refused, "has the seals of 0 of the 4");
        expect(of(&[1, 2, 3, 2]), Refused, &format!("{} has sealed its header twice", a(2)));
        expect(Commit { round: 1, ..of(&[1, 2, 3]) }, Refused, "its seals are of round 0, and its header says round 1");
        expect(Commit { sealed: 2, ..of(&[1, 2, 3]) }, Refused, "are of round 2, and its header says round 0");
        expect(Commit { later: 60, ..of(&[1, 2, 3]) }, Refused, "altered after it was sealed");
        expect(of(&[1, 2, 9]), Refused, "of no validator that it names");
        let strange = Commit { named: vec![7, 8, 9], ..of(&[7, 8, 9]) };
        expect(strange, Refused, "who is not a signer you pinned");
    }
    // Half of its validators are pinned: they are not enough of the pinned, and nothing contradicts them.
    let mixed = Commit { named: vec![1, 2, 8, 9], ..Commit::by(&[1, 8, 9]) };
    expect(mixed, Unproven, "sealed by 1 of 4 pinned signers in its own header (QBFT); 3 are required");
    let few = Commit { named: vec![1, 2], ..Commit::by(&[1, 2]) };
    expect(few, Unproven, "sealed by 2 of 4 pinned signers in its own header (QBFT); 3 are required");
    // Two thirds of all that it names, though of the pinned there are enough.
    let seven = Commit { named: (1..=7).collect(), ..Commit::by(&[1, 2, 3, 4]) };
    expect(seven, Refused, "the seals of 4 of the 7 validators that it names, and 5 are needed");
    let contract = |sealers: &[u8]| Commit { named: vec![], ..Commit::by(sealers) };
    expect(contract(&[1, 2]), Unproven, "sealed by 2 of 4");
    expect(contract(&[7, 8, 9]), Refused, "who is not a signer you pinned");
    expect(Commit { round: 1, ..contract(&[1, 2, 3]) }, Refused, "are of round 0, and its header says round 1");
}

#[test]
fn a_pinned_quorum_counts_for_seals_in_a_header_too() {
    let world = Commit::by(&[1, 2, 3]).world();
    for (quorum, outcome) in [(3, Outcome::Holds), (4, Outcome::Incomplete)] {
        agree(&world.members(), &trust(Some(quorum)), outcome);
    }
    // Two thirds of five are four; more than half would be three.
    let mut five = trust(None);
    five.chain.signers.push(account(5).1);
    assert_eq!((five.quorum(), five.commit_quorum()), (3, 4));
    agree(&world.members(), &five, Outcome::Incomplete);
}

#[test]
fn a_hash_of_a_block_covers_neither_its_seals_nor_its_round() {
    let hash = |commit: &Commit| {
        BlockHeader::parse(&commit.header(BLOCK, Hash([8; 32]), Hash([2; 32]))).expect("a header").hash
    };
    for ibft2 in [false, true] {
        let one = Commit { ibft2, ..Commit::by(&[1, 2, 3]) };
        let other = Commit { round: 5, sealed: 5, sealers: vec![4, 3, 2], ..one.clone() };
        assert_eq!(hash(&one), hash(&other));
        assert_ne!(hash(&one), hash(&Commit { later: 1, ..one.clone() }));
        assert_eq!(other.judged(&[1, 2, 3, 4]).pinned.len(), 3);
    }
    // The genesis block is hashed as it is.
    let genesis = Commit::by(&[]).header(BLOCK, Hash([0; 32]), Hash([2; 32]));
    let mut list = RlpStream::new_list(16);
    for at in 0..16 {
        match at {
            8 => list.append(&0u64),
            _ => list.append_raw(rlp::Rlp::new(&genesis).at(at).expect("a field").as_raw(), 1),
        };
    }
    let genesis = list.out();
    assert_eq!(BlockHeader::parse(&genesis).expect("a header").hash, Hash(keccak256(&[&genesis])));
}

/// Every byte of a sealed header: it is no header any more, or too few of the pinned have sealed it. What is not signed is
/// in the seals themselves, which then recover nobody who is named.
#[test]
fn every_flipped_byte_of_a_sealed_header_is_noticed() {
    let genuine = Commit::by(&[1, 2, 3]).header(BLOCK, Hash([8; 32]), Hash([2; 32]));
    let pinned = [1, 2, 3, 4].map(|secret| account(secret).1);
    assert_eq!(judged(&genuine, &pinned).pinned.len(), 3);
    for at in 0..genuine.len() {
        for bit in [1, 0x80] {
            let mut altered = genuine.clone();
            altered[at] ^= bit;
            let Some(header) = BlockHeader::parse(&altered) else { continue };
            let found = seals(&BTreeMap::from([(header.number, header.clone())]), header.number, &pinned);
            assert!(found.pinned.len() < 3, "byte {at}: {found:?}");
            assert!(found.flaw.is_some() || found.unsigned, "byte {at}: {found:?}");
        }
    }
}

/// A hundred validators fit in a header.
#[test]
fn headers_of_large_networks_are_read() {
    let named: Vec<u8> = (1..=100).collect();
    let commit = Commit { named: named.clone(), ..Commit::by(&named[..67]) };
    let header = commit.header(BLOCK, Hash([8; 32]), Hash([2; 32]));
    assert!(header.len() > 4096 && header.len() <= LONGEST_HEADER, "{}", header.len());
    assert_eq!(commit.judged(&named).pinned.len(), 67);
}

/// Any extra data under that mix hash.
pub fn noise(noise: &[u8], at: usize) {
    let mut header = Commit::by(&[1]).header(BLOCK, Hash([8; 32]), Hash([2; 32]));
    let place = at % header.len();
    for (to, from) in header[place..].iter_mut().zip(noise) {
        *to ^= from;
    }
    let Some(header) = BlockHeader::parse(&header) else { return };
    let number = header.number;
    drop(seals(&BTreeMap::from([(number, header)]), number, &[account(1).1]));
}

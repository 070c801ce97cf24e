//! Level (g): countersignatures of witnesses, true ones and each lie about them.

use authros_crypto::{SmKeyPair, signer_id};
use authros_model::{Address, Countersignature, Hash, Position, PublicKey, RecorderId, SignedPosition, Timestamp};

use super::committed::Commit;
use super::second::agree;
use super::world::{BLOCK, CONTRACT, World, genesis, header, ours, pair};
use crate::archive::Members;
use crate::header::BlockHeader;
use crate::time::StampTree;
use crate::trust::PinnedWitness;
use crate::witness::{check_countersignature, countersign, state};
use crate::{Bundle, Outcome, Packing, Report, Standing, Trust, verify};

const WITNESS: Address = Address([0xb0; 20]);
const SEEN: Timestamp = Timestamp(1_700_000_200_000_000_000);

/// What the owner states of its batch, between two others, at block 60.
fn position(world: &World) -> Position {
    let tree = tree(world);
    Position {
        chain_id: 7,
        genesis: Hash([9; 32]),
        contract: CONTRACT,
        owner: world.owner,
        key: PublicKey([0; 64]),
        recorder: RecorderId([4; 16]),
        block: 60,
        block_hash: block_hash(),
        earlier: None,
        top: tree.top(),
        count: tree.count(),
        head: None,
    }
}

fn tree(world: &World) -> StampTree {
    StampTree::new(vec![Hash([1; 32]), root(world), Hash([2; 32])]).expect("a tree")
}

fn root(world: &World) -> Hash {
    world.claim.inclusion().expect("a batch").root
}

fn block() -> Vec<u8> {
    header(60, Hash([8; 32]), Hash([7; 32]), [0; 32], 1)
}

fn block_hash() -> Hash {
    Hash(authros_crypto::keccak256(&[&block()]))
}

fn stated(world: &World, position: &Position) -> SignedPosition {
    state(*position, &world.keys, ours()).expect("signs")
}

fn seen(stated: &SignedPosition, witness: &SmKeyPair) -> Countersignature {
    countersign(*stated, SEEN, (WITNESS, witness), ours()).expect("signs")
}

fn with(world: &World, found: &[Countersignature]) -> Members {
    let mut packing = world.packing();
    for one in found {
        packing.countersignature(one, &tree(world), &[root(world)], ours()).expect("added");
    }
    packing.header(60, block());
    packing.sign(genesis(), world.owner, &world.keys, ours()).expect("packs")
}

fn trust(witness: &SmKeyPair) -> Trust {
    let pin = PinnedWitness { account: WITNESS, key: signer_id(&witness.public), name: "The harbour".to_owned() };
    let trust = Trust { witnesses: vec![pin], ..World::trust() };
    Trust::parse(trust.to_text().expect("written").as_bytes()).expect("read again")
}

fn judged(members: &Members, trust: &Trust) -> Report {
    verify(&Bundle::of_members(members, ours()).expect("reads"), Some(trust), ours())
}

fn expect(members: &Members, trust: &Trust, standing: Standing, words: &str) {
    let report = judged(members, trust);
    let level = &report.records[0].witnessed;
    assert_eq!(level.standing, standing, "{}", level.text);
    assert!(level.text.contains(words), "'{}' does not say '{words}'", level.text);
    let outcome = if standing == Standing::Refused { Outcome::Refused } else { Outcome::Holds };
    assert_eq!(report.outcome, outcome, "(g) is not needed, and refuses");
    agree(members, trust, outcome);
}

#[test]
fn a_pinned_witness_saw_what_the_owner_stated() {
    let (world, witness) = (World::new(), pair());
    let (members, trust) = (with(&world, &[seen(&stated(&world, &position(&world)), &witness)]), trust(&witness));
    let words = format!("by {SEEN}, on the clock of The harbour whom you pinned");
    expect(&members, &trust, Standing::Proven, &words);
    expect(&members, &trust, Standing::Proven, "block 60 of the chain, the one that is here");
    assert_eq!(judged(&members, &trust).records[0].witnessed_at, Some(SEEN));
    expect(&members, &World::trust(), Standing::Unproven, "whom you did not pin");
    expect(&world.members(), &trust, Standing::Absent, "no witness's countersignature");
    // The owner as his own witness, under another account.
    let own = self::trust(&world.keys);
    let members = with(&world, &[seen(&stated(&world, &position(&world)), &world.keys)]);
    expect(&members, &own, Standing::Unproven, "by its owner himself");
}

/// Its hash covers neither seals nor round: whoever hashes the bytes that are here takes it for another block.
#[test]
fn a_stated_block_of_qbft_or_ibft_is_known_by_its_own_hash() {
    let (world, witness) = (World::new(), pair());
    for ibft2 in [false, true] {
        let commit = Commit { ibft2, ..Commit::by(&[1, 2, 3]) };
        let block = commit.header(60, Hash([8; 32]), Hash([7; 32]));
        let block_hash = BlockHeader::parse(&block).expect("a header").hash;
        assert_ne!(block_hash, Hash(authros_crypto::keccak256(&[&block])));
        let found = seen(&stated(&world, &Position { block_hash, ..position(&world) }), &witness);
        let mut packing = world.packing();
        packing.countersignature(&found, &tree(&world), &[root(&world)], ours()).expect("added");
        packing.header(60, block);
        let members = packing.sign(genesis(), world.owner, &world.keys, ours()).expect("packs");
        expect(&members, &trust(&witness), Standing::Proven, "block 60 of the chain, the one that is here");
    }
}

#[test]
fn each_lie_about_a_witness_is_refused_for_its_own_reason() {
    let (world, witness) = (World::new(), pair());
    let trust = trust(&witness);
    let good = seen(&stated(&world, &position(&world)), &witness);
    let refused = |found: Countersignature, words: &str| {
        expect(&with(&world, &[found]), &trust, Standing::Refused, words);
    };
    // Forged: by another key in the witness's name; with no signature of anybody.
    refused(seen(&good.stated, &pair()), "not the one you pinned");
    refused(Countersignature { key: pair().public, ..good }, "not signed by the key");
    // Altered: another time, another block.
    refused(Countersignature { at: Timestamp(1), ..good }, "not signed by the key");
    let mut altered = good;
    altered.stated.position.block = 61;
    refused(altered, "not signed by the key");
    let mut unsigned = good.stated;
    unsigned.position.block = 61;
    refused(seen(&unsigned, &witness), "the statement is not signed by the key");
    // Replayed for another owner, and from another chain.
    let other = stated(&world, &Position { owner: Address([0xee; 20]), ..position(&world) });
    refused(seen(&other, &witness), "who neither owns the record nor anchored it");
    let elsewhere = stated(&world, &Position { chain_id: 8, ..position(&world) });
    refused(seen(&elsewhere, &witness), "another chain or contract");
    // A batch that the statement does not cover.
    let bare = stated(&world, &Position { top: Hash([5; 32]), ..position(&world) });
    refused(seen(&bare, &witness), "does not lead to what was countersigned");
    // A chain that was written anew.
    let rewritten = stated(&world, &Position { block_hash: Hash([5; 32]), ..position(&world) });
    refused(seen(&rewritten, &witness), "block 60 is another one than its owner stated");
    let before = stated(&world, &Position { earlier: Some((BLOCK, Hash([5; 32]))), ..position(&world) });
    refused(seen(&before, &witness), "block 40 is another one");
    let early = Position { block: BLOCK - 1, block_hash: Hash([5; 32]), ..position(&world) };
    refused(seen(&stated(&world, &early), &witness), "its owner stated to");
    // Two histories, each countersigned.
    let one = stated(&world, &Position { block: 70, block_hash: Hash([5; 32]), ..position(&world) });
    let two = stated(&world, &Position { block: 70, block_hash: Hash([6; 32]), ..position(&world) });
    let both = with(&world, &[seen(&one, &witness), seen(&two, &witness)]);
    expect(&both, &trust, Standing::Refused, "TWO histories of one owner are countersigned: block 70");
}

#[test]
fn countersignatures_that_are_not_of_their_form_are_no_bundle() {
    let (world, witness) = (World::new(), pair());
    let members = with(&world, &[seen(&stated(&world, &position(&world)), &witness)]);
    let name = |part: &str| {
        members.keys().find(|name| name.starts_with("witnesses/") && name.ends_with(part)).expect(part).clone()
    };
    let (bytes, roots) = (name("countersignature.bin"), name("roots.json"));
    let changed = |change: &dyn Fn(&mut Members)| {
        let mut members = members.clone();
        change(&mut members);
        let members = Packing::from(members).sign(genesis(), world.owner, &world.keys, ours()).expect("packs");
        Bundle::of_members(&members, ours()).expect_err("refused").why
    };
    let edit = |name: &str, edit: fn(&mut Vec<u8>)| {
        changed(&|members: &mut Members| edit(members.get_mut(name).expect("there")))
    };
    assert!(edit(&bytes, |bytes| bytes.push(0)).contains("1 bytes are left over"), "oversized");
    assert!(edit(&bytes, |bytes| bytes.truncate(540)).contains("ends before the countersignature"));
    assert!(edit(&bytes, |bytes| bytes[0] = 2).contains("version"));
    assert!(edit(&bytes, |bytes| bytes[540] ^= 1).contains("filed under another"));
    assert!(edit(&roots, |text| *text = b"{}".to_vec()).contains("missing field"));
    assert!(edit(&roots, |text| *text = text.repeat(2)).contains("trailing"));
    assert!(changed(&|members: &mut Members| drop(members.remove(&roots))).contains("is missing"));
    assert!(changed(&|members: &mut Members| drop(members.remove(&bytes))).contains("is missing"));
    let stranger = bytes.replace("countersignature.bin", "other.bin");
    assert!(
        changed(&|members: &mut Members| drop(members.insert(stranger.clone(), vec![1])))
            .contains("does not belong to a countersignature")
    );
}

#[test]
fn every_flipped_bit_of_a_countersignature_is_refused() {
    let (world, witness) = (World::new(), pair());
    let good = seen(&stated(&world, &position(&world)), &witness);
    check_countersignature(&good, ours()).expect("both signatures hold");
    let bytes = good.encode();
    for at in 0..bytes.len() {
        let mut changed = bytes.clone();
        changed[at] ^= 1 << (at % 8);
        let refused =
            Countersignature::parse(&changed).map_or(true, |found| check_countersignature(&found, ours()).is_err());
        assert!(refused, "byte {at}");
    }
}

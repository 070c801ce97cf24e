//! Bundles by a stranger who wants to exhaust a reader's time or memory, or to deceive.

use std::collections::BTreeMap;

use authros_crypto::record::RecordSecret;
use authros_crypto::{SmKeyPair, compression, keccak256, signer_id};
use authros_model::head::Compression;
use authros_model::{Address, Hash};

use super::world::{BLOCK, World, account, genesis, header, ours, pair, sealed, sealed_as};
use crate::manifest::{MANIFEST, Manifest};
use crate::{BlockHeader, Bundle, BundledRecord, Nodes, Outcome, Packing, Report, Standing, seals, verify};

fn checked(packing: Packing, world: &World, by: &SmKeyPair) -> Report {
    let members = packing.sign(genesis(), world.owner, by, ours()).expect("packs");
    verify(&Bundle::of_members(&members, ours()).expect("reads"), Some(&World::trust()), ours())
}

pub fn unanchored(one: authros_crypto::record::SealedRecord) -> BundledRecord {
    BundledRecord { record: one.blob, signature: one.signature, anchor: None }
}

/// Five messages of 64 MiB of zeros, less than 300 KiB each when sealed.
#[test]
fn no_more_messages_are_opened_than_one_file_may_have() {
    let world = World::new();
    let zeros = vec![0; 64 * 1024 * 1024];
    let packed = compression::pack(&zeros, None).expect("packs").bytes;
    let mut packing = world.packing();
    packing.identity(&world.identity);
    let mut all = Vec::new();
    for seq in 10..15 {
        let body = (&packed[..], zeros.len() as u64, Compression::Lz4);
        let one = sealed_as(world.owner, &world.keys, &world.topic_key, seq, body);
        packing.record(one.digest, unanchored(one.clone())).expect("added");
        all.push(one);
    }
    packing.disclosure(&world.disclosing(&all));
    let report = checked(packing, &world, &world.keys);
    let told = "its message is not opened: too much is disclosed in a single file";
    let shut = report.records.iter().filter(|record| record.opened.text == told).count();
    assert_eq!((report.messages.len(), shut), (4, 1));
    assert!(report.messages.values().all(|message| message.body == zeros));
}

/// The signer is checked first: a message that nobody vouches for is not produced.
#[test]
fn what_its_owner_did_not_sign_is_not_opened() {
    let mut world = World::new();
    let other = sealed(world.owner, &world.keys, &world.topic_key, 4, b"another");
    let wrong = RecordSecret::of(&world.topic_key, &other.header);
    world.disclose(&pair(), wrong);
    world.expect('e', Standing::Refused, "not signed by its owner");
    assert!(world.report().messages.is_empty());
}

#[test]
fn a_node_is_no_longer_than_nodes_are() {
    let with = |length: usize| [vec![7; length]].into_iter().collect::<Nodes>().encode();
    assert!(Nodes::parse(&with(1024)).is_some() && Nodes::parse(&with(1025)).is_none());
}

/// 3 pinned signers: 28 headers are examined, and none after the third signer has been found.
#[test]
fn seals_are_counted_over_a_bounded_way() {
    let pinned = [1, 2, 3].map(|secret| account(secret).1);
    let chain = |sealers: &[u8]| {
        let mut parent = Hash([8; 32]);
        let mut headers = BTreeMap::new();
        for (number, sealer) in (BLOCK..).zip(sealers) {
            let bytes = header(number, parent, Hash([2; 32]), [0; 32], *sealer);
            parent = Hash(keccak256(&[&bytes]));
            headers.insert(number, BlockHeader::parse(&bytes).expect("a header"));
        }
        seals(&headers, BLOCK, &pinned)
    };
    let long = |ones: usize| [vec![1; ones], vec![2]].concat();
    assert_eq!((chain(&long(27)).pinned.len(), chain(&long(28)).pinned.len()), (2, 1));
    assert_eq!(chain(&[1, 2, 3, 9]).stranger, None);
    assert_eq!(chain(&[1, 2, 9, 3]).stranger, Some(account(9).1));
}

/// The mix hash of QBFT, and extra data without whole addresses.
#[test]
fn seals_of_another_consensus_are_none_that_are_checked() {
    let clique = header(BLOCK, Hash([8; 32]), Hash([2; 32]), [0; 32], 9);
    assert_eq!(BlockHeader::parse(&clique).expect("a header").sealer(), Some(account(9).1));
    let mut mixed = clique.clone();
    let at = mixed.len() - 10;
    mixed[at] = 0x63;
    let parsed = BlockHeader::parse(&mixed).expect("a header");
    assert_eq!((parsed.hash, parsed.sealer()), (Hash(keccak256(&[&mixed])), None));
    for (between, is_sealed) in [(0, true), (20, true), (40, true), (1, false), (19, false), (21, false)] {
        let list = rlp::Rlp::new(&clique);
        let mut other = rlp::RlpStream::new_list(15);
        for at in 0..15 {
            let seal = &list.at(12).expect("extra data").data().expect("bytes")[32..];
            match at {
                12 => other.append(&[&[0u8; 32][..], &vec![5; between], seal].concat()),
                _ => other.append_raw(list.at(at).expect("a field").as_raw(), 1),
            };
        }
        let parsed = BlockHeader::parse(&other.out()).expect("a header");
        assert_eq!(parsed.sealer().is_some(), is_sealed, "{between} bytes between");
    }
}

/// Records in the owner's name by a stranger, who registered nothing.
#[test]
fn a_stranger_neither_fills_gaps_nor_tells_two_histories_for_another() {
    let world = World::new();
    let (thief, mut packing) = (pair(), world.packing());
    packing.key(&thief.public).expect("a point");
    for seq in [3, 4, 9] {
        let one = sealed(world.owner, &thief, &world.topic_key, seq, b"a lie");
        packing.record(one.digest, unanchored(one)).expect("added");
    }
    let report = checked(packing, &world, &thief);
    let of = |key: &SmKeyPair| {
        let signer = signer_id(&key.public);
        report.complete.iter().find(|stretch| stretch.signer == signer).expect("its stretch")
    };
    let (own, strange) = (of(&world.signer), of(&thief));
    assert_eq!((own.twice.len(), own.standing, own.uncounted), (0, Standing::Proven, 0));
    assert_eq!((own.first, own.last), (Some(3), Some(3)));
    assert_eq!((strange.twice.len(), strange.standing, strange.uncounted), (0, Standing::Unproven, 3));
    let text = "nothing can be claimed: the signers of its 3 records are not proven";
    assert_eq!((strange.first, strange.text.as_str()), (None, text));
    assert_eq!(report.outcome, Outcome::Incomplete);
    assert!(report.records.iter().all(|record| record.is_believed() == (record.digest == world.record.digest)));

    let unsealed = World { sealers: vec![1], ..World::new() };
    let stretch = &unsealed.report().complete[0];
    assert_eq!((stretch.first, stretch.standing), (None, Standing::Unproven));
    assert!(stretch.text.starts_with("nothing can be claimed"), "{}", stretch.text);
}

#[test]
fn a_record_is_filed_under_one_spelling_of_its_digest() {
    let world = World::new();
    let name = world.record.digest.to_hex();
    for other in [format!("0x{name}"), name.to_uppercase(), format!("0X{name}")] {
        let mut members = world.members();
        let record = members.get(&format!("records/{name}/record.bin")).expect("there").clone();
        members.insert(format!("records/{other}/record.bin"), record);
        let manifest = Manifest::read(&world.members(), ours()).expect("reads");
        let manifest = Manifest::of(&members, manifest.chain, manifest.exporter, ours());
        members.insert(MANIFEST.to_owned(), serde_json::to_vec(&manifest).expect("JSON"));
        let told = Bundle::of_members(&members, ours()).expect_err("refused").to_string();
        assert!(told.contains("filed under a name that is not a digest"), "{told}");
    }
}

#[test]
fn the_exporter_is_tied_by_what_others_sealed_or_is_said_not_to_be() {
    let world = World::new();
    let report = world.report();
    assert!(report.exporter.text.ends_with("'s at block 40"), "{}", report.exporter.text);
    let mut trust = World::trust();
    let key = authros_crypto::signer_id(&world.keys.public);
    trust.persons.push(crate::Person { account: world.owner, name: "Robot fleet".into(), key: Some(key) });
    let report = world.report_by(&trust);
    assert_eq!(report.exporter.standing, Standing::Proven);
    assert!(report.exporter.text.contains("the key you pinned") && report.exporter.text.ends_with("(Robot fleet)"));
    assert_eq!(report.records[0].person.as_deref(), Some("Robot fleet"));
    let unsealed = World { sealers: vec![1], ..World::new() };
    let mut trust = World::trust();
    trust.persons.push(crate::Person { account: Address([0x0e; 20]), name: "Robot fleet".into(), key: None });
    assert_eq!(unsealed.report_by(&trust).records[0].person, None, "nothing shows that the key is his");
}

//! Bundles over a chain made here, so that every lie can be told in turn.

mod authority;
mod committed;
mod complete;
mod foreign;
pub(crate) mod hostile;
mod mutants;
mod page;
mod parallel;
mod refusals;
mod second;
mod stamps;
mod verifiers;
pub(crate) mod world;

use authros_crypto::record::RecordSecret;
use authros_crypto::{keccak256, prove, signer_id};
use authros_model::{Address, Hash, Token};

use self::world::{BLOCK, GATEWAY, TIME, World, account, bound, genesis, header, ours, pair, sealed, word};
use crate::{AnchorClaim, Anchoring, Bundle, BundledRecord, Nodes, Outcome, Slot, Standing, Trust, pack, verify};

use Standing::{Absent, OwnChain, Proven, Refused, Unproven};

#[test]
fn a_true_bundle_holds_level_by_level() {
    let mut world = World::new();
    assert_eq!(world.judged('c').0, [Proven, Proven, Proven, Absent]);
    world.expect('c', Proven, "anchored in block 40 at 2023-11-14T22:15:00");
    world.expect('c', Proven, "sealed by 2 of 3 pinned signers");
    let report = world.report();
    assert_eq!((report.outcome, report.exporter.standing), (Outcome::Holds, Proven));
    assert_eq!(report.records[0].seconds_to_anchor, Some(7));
    assert_eq!((report.complete[0].first, report.complete[0].last), (Some(3), Some(3)));
    assert_eq!((report.complete[0].standing, report.complete[0].uncounted), (Proven, 0));
    // Two headers on top of a later state show it too, and the anchoring account was the owner.
    world.shown_at = BLOCK + 9;
    assert_eq!(world.judged('c').0, [Proven, Proven, Proven, Absent]);
    world.expect('c', Proven, "as block 49 has it");
}

#[test]
fn without_pins_nothing_about_the_chain_is_proven() {
    let file = pack(&World::new().members()).expect("packs");
    let report = verify(&Bundle::parse(&file, ours()).expect("reads"), None, ours());
    let record = &report.records[0];
    assert_eq!(
        (record.bytes.standing, record.anchor.standing, report.outcome),
        (Proven, Unproven, Outcome::Incomplete)
    );
    assert!(report.warnings[0].contains("--trust"), "{:?}", report.warnings);
}

#[test]
fn lies_about_the_chain_are_refused_each_for_its_own_reason() {
    let mut cleared = World::new();
    cleared.shown_at = BLOCK + 9;
    cleared.put(Slot::anchor(cleared.owner, root(&cleared.claim)), [0; 32]);
    cleared.expect('c', Refused, "the state after block 49 does not contain its anchor");

    let mut counted = World::new();
    counted.put(Slot::anchor(counted.owner, root(&counted.claim)), word(&[BLOCK, 6, TIME, 1]));
    counted.expect('c', Refused, "a different number of leaves");

    let mut moved = World::new();
    moved.put(Slot::anchor(moved.owner, root(&moved.claim)), word(&[BLOCK - 1, 5, TIME, 1]));
    moved.expect('c', Refused, "the chain has it in block 39, the bundle says 40");

    let mut path = World::new();
    if let Anchoring::Batch { index, .. } = &mut path.claim.anchor {
        *index = 3;
    }
    path.expect('c', Refused, "its path does not lead");

    let mut trust = World::trust();
    trust.chain.code_hash = Hash([1; 32]);
    assert!(World::new().report_by(&trust).records[0].anchor.text.contains("code"));
    let mut trust = World::trust();
    trust.chain.genesis = Hash([1; 32]);
    assert!(World::new().report_by(&trust).records[0].bytes.text.contains("a different chain"));
}

fn root(claim: &AnchorClaim) -> Hash {
    claim.inclusion().expect("a batch").root
}

#[test]
fn seals_that_are_not_enough_are_counted() {
    let with = |sealers: &[u8]| World { sealers: sealers.to_vec(), ..World::new() };
    with(&[1]).expect('c', Unproven, "sealed by 1 of 3 pinned signers; 2 are required");
    with(&[1, 1]).expect('c', Unproven, "sealed by 1 of 3");
    with(&[1, 9]).expect('c', Unproven, "sealed by 1 of 3");
    with(&[9, 9]).expect('c', Refused, "who is not a signer you pinned");
    with(&[0]).expect('c', Unproven, "no seal that this version can check");
    with(&[3, 1, 2]).expect('c', Proven, "sealed by 3 of 3");
    assert_eq!(with(&[1]).report().outcome, Outcome::Incomplete);
}

#[test]
fn the_exporters_own_chain_proves_nothing_against_him() {
    let mut vanity = [0; 32];
    vanity[..28].copy_from_slice(b"AuthROS chain file version 1");
    let ours = World { vanity, ..World::new() };
    ours.expect('c', OwnChain, "proves nothing against the exporter");
    let told = "your trust file says that others seal this chain, but its headers say that a single program does";
    assert!(ours.report().warnings.iter().any(|warning| warning == told));
    let mut trust = World::trust();
    trust.chain.sealed_by_exporter = true;
    let report = World::new().report_by(&trust);
    assert_eq!(report.records[0].anchor.standing, OwnChain);
    assert!(report.warnings.iter().any(|warning| warning.contains("it proves nothing against the exporter")));
    assert!(!report.warnings.iter().any(|warning| warning.contains("others seal this chain")));
    assert_eq!((report.outcome, report.exporter.standing), (Outcome::Incomplete, OwnChain));
    assert_eq!(report.complete[0].standing, OwnChain);
    let told = "NOT FULLY PROVEN: only the exporter's own chain supports the file, and that proves nothing against the \
                exporter.";
    assert_eq!(report.verdict[0], told);
}

fn anchored_by_the_gateway() -> World {
    let World { owner, keys, identity, .. } = World::new();
    World::of(owner, keys.clone(), keys, identity, GATEWAY)
}

#[test]
fn suspension_is_judged_at_the_anchoring_block_alone() {
    let mut world = anchored_by_the_gateway();
    world.expect('b', Proven, "was not suspended");
    let mut flags = word(&[1, 0, 1]);
    flags[7] = 1;
    let free = word(&[1, 0, 1]);
    world.put(Slot::account(world.owner), flags);
    world.expect('b', Refused, "was suspended at block 40");
    world.shown_at = BLOCK + 9;
    world.expect('b', Unproven, "is suspended at block 49");
    world.put(Slot::account(world.owner), free);
    world.expect('b', Unproven, "nothing shows whether it was at block 40");
}

#[test]
fn what_came_behind_an_owners_own_anchor_in_its_block_counts() {
    let mut suspended = World::new();
    let mut flags = word(&[1, 0, 1]);
    flags[7] = 1;
    suspended.put(Slot::account(suspended.owner), flags);
    suspended.expect('b', Refused, "was suspended at block 40");
    // A later state does not say since when: it never shows more than the block's own state.
    suspended.shown_at = BLOCK + 9;
    suspended.expect('b', Unproven, "is suspended at block 49, but there is no proof since when");
    let mut free = World::new();
    free.shown_at = BLOCK + 9;
    free.expect('b', Proven, "was not suspended when this was anchored: it anchored this itself");

    let mut changed = World::new();
    changed.put(Slot::keys(changed.owner, 2), [3; 32]);
    changed.put(Slot::keys(changed.owner, 2).next(1), word(&[BLOCK, TIME]));
    changed.expect('b', Unproven, "was not the one in force at block 40");
}

#[test]
fn keys_count_for_the_blocks_in_which_they_were_in_force() {
    let mut world = anchored_by_the_gateway();
    world.put(Slot::keys(world.owner, 2), [3; 32]);
    world.put(Slot::keys(world.owner, 2).next(1), word(&[BLOCK, TIME]));
    world.expect('b', Unproven, "was not the one in force at block 40");
    world.put(Slot::keys(world.owner, 2).next(1), word(&[BLOCK + 1, TIME]));
    world.expect('b', Proven, "the key was");
    let mut stranger = World::new();
    stranger.put(Slot::keys(stranger.owner, 1), [3; 32]);
    stranger.expect('b', Unproven, "is not in the bundle");
}

#[test]
fn a_device_signs_while_it_is_lent() {
    let World { owner, keys, identity, .. } = World::new();
    let with = |loan: [u64; 3]| {
        let mut world = World::of(owner, keys.clone(), pair(), identity, owner);
        // Active, until, lent, recalled: the first is one byte.
        let mut packed = [0; 32];
        packed[31] = 1;
        for (at, field) in loan.iter().enumerate() {
            packed[23 - 8 * at..31 - 8 * at].copy_from_slice(&field.to_be_bytes());
        }
        world.put(Slot::loan(owner, &signer_id(&world.signer.public).0), packed);
        world
    };
    with([0, 12, 0]).expect('b', Proven, "to a device that");
    with([TIME + 1, 12, 0]).expect('b', Proven, "to a device that");
    with([TIME, 12, 0]).expect('b', Refused, "the device's authorisation had ended");
    with([0, 12, BLOCK]).expect('b', Refused, "revoked the device in block 40");
    with([0, 41, 0]).expect('b', Refused, "authorised the device only in block 41");
    let later = World { shown_at: BLOCK + 9, ..with([0, 41, 0]) };
    later.expect('b', Unproven, "authorised again later; what applied at block 40 is not shown");
    let mut timeless = World { shown_at: BLOCK + 9, ..with([TIME + 1, 12, 0]) };
    timeless.put(Slot::anchor(owner, root(&timeless.claim)), word(&[BLOCK, 5, 0, 1]));
    timeless.expect('b', Unproven, "the block's time is not shown");
    with([0, 0, 0]).expect('b', Refused, "neither registered nor authorised");
}

#[test]
fn one_record_is_disclosed_by_its_owner_and_by_nothing_else() {
    let mut world = World::new();
    let secret = RecordSecret::of(&world.topic_key, &world.record.header);
    world.disclose(&world.keys.clone(), secret.clone());
    world.expect('e', Proven, "opened by its owner's disclosure");
    let report = world.report();
    let disclosed = report.records[0].disclosed.as_ref().expect("disclosed");
    assert_eq!((disclosed.topic.as_str(), disclosed.length), ("/robot1/odom", 11));
    assert_eq!(report.messages[&world.record.digest].body, b"the message");

    let other = sealed(world.owner, &world.keys, &world.topic_key, 4, b"another");
    let wrong = RecordSecret::of(&world.topic_key, &other.header);
    world.disclose(&world.keys.clone(), wrong);
    world.expect('e', Refused, "does not open it");
    assert_eq!(world.report().outcome, Outcome::Refused);
    world.disclose(&pair(), secret);
    world.expect('e', Refused, "not signed by its owner");
    assert!(RecordSecret::from_slice(&[0; 33]).is_none() && RecordSecret::from_slice(&[0; 31]).is_none());
}

/// Anybody can make an identity for somebody else's account: only the state says whose it is.
#[test]
fn an_identity_that_the_state_does_not_show_speaks_for_nobody() {
    let mut world = World::new();
    let thief = pair();
    let forged = prove(ours(), &bound(), &world.owner, &thief, &pair().public, Token([5; 32])).expect("proves");
    let secret = RecordSecret::of(&world.topic_key, &world.record.header);
    world.disclose(&thief, secret);
    let mut packing = world.packing();
    packing.identity(&forged);
    let members = packing.sign(genesis(), world.owner, &thief, ours()).expect("packs");
    let report = verify(&Bundle::of_members(&members, ours()).expect("reads"), Some(&World::trust()), ours());
    assert_eq!((report.records[0].opened.standing, report.exporter.standing), (Unproven, Unproven));
    assert!(report.records[0].opened.text.contains("there is no proof that its owner disclosed it"));
}

#[test]
fn what_an_unsealed_state_says_of_keys_is_not_believed() {
    let unsealed = World { sealers: vec![1], ..World::new() };
    assert_eq!(unsealed.judged('b').0, [Proven, Unproven, Unproven, Absent]);
    unsealed.expect('b', Unproven, "too few of the signers you pinned");
    let report = unsealed.report();
    assert_eq!((report.exporter.standing, report.records[0].owner_key), (Unproven, None));
}

#[test]
fn two_records_with_one_number_are_two_histories() {
    let world = World::new();
    let mut packing = world.packing();
    let other = sealed(world.owner, &world.keys, &world.topic_key, 3, b"another");
    let later = sealed(world.owner, &world.keys, &world.topic_key, 7, b"later");
    for one in [other, later] {
        let (record, signature) = (one.blob, one.signature);
        packing.record(one.digest, BundledRecord { record, signature, anchor: None }).expect("added");
    }
    let members = packing.sign(genesis(), world.owner, &world.keys, ours()).expect("packs");
    let report = verify(&Bundle::of_members(&members, ours()).expect("reads"), Some(&World::trust()), ours());
    let stretch = &report.complete[0];
    // Its key is shown to be the owner's for one of the two; number 7, which is on no chain, closes no gap.
    assert_eq!((stretch.twice.as_slice(), stretch.standing, stretch.uncounted), (&[3][..], Refused, 2));
    assert_eq!((stretch.first, stretch.last, stretch.gaps.as_slice()), (Some(3), Some(3), &[][..]));
    assert_eq!(report.outcome, Outcome::Refused);
}

/// Each byte of each small member, and what its exporter would have to do for it to pass: sign the manifest again.
#[test]
fn every_flipped_byte_of_every_member_is_noticed() {
    let mut world = World::new();
    let secret = RecordSecret::of(&world.topic_key, &world.record.header);
    world.disclose(&world.keys.clone(), secret);
    let members = world.members();
    let trust = World::trust();
    for (name, bytes) in &members {
        for at in 0..bytes.len() {
            let mut changed = members.clone();
            changed.get_mut(name).expect("there")[at] ^= 1;
            let found =
                Bundle::of_members(&changed, ours()).map(|bundle| verify(&bundle, Some(&trust), ours()).outcome);
            assert!(!matches!(found, Ok(Outcome::Holds | Outcome::Incomplete)), "{name}, byte {at}: {found:?}");
        }
    }
    for name in members.keys() {
        let mut changed = members.clone();
        changed.remove(name);
        let found = Bundle::of_members(&changed, ours()).map(|bundle| bundle.signed);
        assert!(!matches!(found, Ok(true)), "{name} is missing");
    }
    let mut more = members.clone();
    more.insert("keys/more.pem".into(), Vec::new());
    assert!(Bundle::of_members(&more, ours()).expect_err("refused").to_string().contains("not named in the manifest"));
}

#[test]
fn a_stranger_who_signs_an_altered_bundle_anew_is_not_believed() {
    let world = World::new();
    let mut packing = world.packing();
    let mut record = world.record.blob.clone();
    *record.last_mut().expect("bytes") ^= 1;
    let (signature, anchor) = (world.record.signature, Some(world.claim.clone()));
    packing.record(world.record.digest, BundledRecord { record, signature, anchor }).expect("added");
    let members = packing.sign(genesis(), world.owner, &pair(), ours()).expect("packs");
    let report = verify(&Bundle::of_members(&members, ours()).expect("reads"), Some(&World::trust()), ours());
    assert_eq!((report.records[0].bytes.standing, report.exporter.standing), (Refused, Unproven));
    assert!(report.exporter.text.contains("which nothing here ties to"), "{}", report.exporter.text);
}

#[test]
fn the_same_parts_are_the_same_bytes_but_for_the_signature() {
    let world = World::new();
    let (mut one, mut other) = (world.members(), world.members());
    for members in [&mut one, &mut other] {
        members.remove("manifest.der").expect("signed");
    }
    assert_eq!(one, other);
}

#[test]
fn an_unpacked_bundle_is_read_as_the_file_is() {
    let folder = tempfile::tempdir().expect("directory");
    let members = World::new().members();
    for (name, bytes) in &members {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("made");
        std::fs::write(path, bytes).expect("written");
    }
    let read = Bundle::read(folder.path(), ours()).expect("reads");
    assert_eq!(verify(&read, Some(&World::trust()), ours()).outcome, Outcome::Holds);
    std::os::unix::fs::symlink("/etc/hostname", folder.path().join("more")).expect("linked");
    assert!(Bundle::read(folder.path(), ours()).expect_err("refused").to_string().contains("not a regular file"));
}

#[test]
fn openssl_checks_a_record_and_the_manifest_by_the_lines_of_the_read_me() {
    let (folder, mut world) = (tempfile::tempdir().expect("directory"), World::new());
    let secret = RecordSecret::of(&world.topic_key, &world.record.header);
    world.disclose(&world.keys.clone(), secret);
    for (name, bytes) in &world.members() {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("made");
        std::fs::write(path, bytes).expect("written");
    }
    // There is no stamp in it; the flow with an authority runs those lines.
    let (by_hand, _) = crate::READ_ME_TEXT.split_once("what an authority says").expect("stamps come last");
    let is_elsewhere = |line: &str| ["authros evidence verify", "authros-verify"].iter().any(|of| line.contains(of));
    let is_shell = |line: &&str| line.starts_with("    ") && !is_elsewhere(line);
    let lines: Vec<&str> = by_hand.lines().filter(is_shell).collect();
    let script = lines.join("\n").replace("DIGEST", &world.record.digest.to_hex());
    let script = script.replace("=KEY", &format!("={}", signer_id(&world.keys.public)));
    let run = || std::process::Command::new("sh").args(["-ec", &script]).current_dir(folder.path()).output();
    if std::process::Command::new("openssl").arg("version").output().is_err() {
        eprintln!("SKIPPED: no openssl");
        return;
    }
    let output = run().expect("a shell");
    let told = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{told}{}", String::from_utf8_lossy(&output.stderr));
    assert!(told.contains(&world.record.digest.to_hex()), "{told}");
    assert!(
        told.contains(&signer_id(&world.keys.public).to_hex()),
        "its key has the name that it is filed under: {told}"
    );
    let listed = std::fs::read_to_string(folder.path().join("manifest.json")).expect("read");
    let sum = told.lines().find(|line| line.contains("256(records/")).and_then(|line| line.split_once("= "));
    assert!(sum.is_some_and(|(_, sum)| listed.contains(sum)), "{told}");
    assert_eq!(told.matches("Signature Verified Successfully").count(), 3, "{told}");
    let manifest = folder.path().join("manifest.json");
    let text = std::fs::read_to_string(&manifest).expect("read") + " ";
    std::fs::write(manifest, text).expect("written");
    assert!(!run().expect("a shell").status.success(), "an altered manifest is not the signed one");
}

#[test]
fn pins_that_cannot_be_meant_are_refused() {
    let text = World::trust().to_text().expect("text");
    assert_eq!(Trust::parse(text.as_bytes()), Ok(World::trust()));
    let with = |line: &str| Trust::parse(text.replace("[chain]", &format!("[chain]\n{line}")).as_bytes());
    for line in ["quorum = 0", "quorum = 4", "more = 1"] {
        assert!(with(line).is_err(), "{line}");
    }
    let person = format!("\n[[person]]\naccount = \"{}\"\nname = \"harbour\"\n", Address([0x0e; 20]));
    assert!(Trust::parse(format!("{text}{person}").as_bytes()).is_ok());
    assert!(Trust::parse(format!("{text}{person}{person}").as_bytes()).is_err(), "two persons of one account");
    let unsaid: String =
        text.lines().filter(|line| !line.starts_with("sealed_by")).map(|line| format!("{line}\n")).collect();
    assert!(Trust::parse(unsaid.as_bytes()).expect_err("refused").to_string().contains("sealed_by_exporter"));
    assert_eq!(with("quorum = 3").expect("parses").quorum(), 3);
    assert!(Trust::parse(b"").is_err() && Trust::parse(&[0xff]).is_err());
}

proptest::proptest! {
    #[test]
    fn noise_never_panics(noise in proptest::collection::vec(proptest::prelude::any::<u8>(), 0..300), at in 0usize..10_000) {
        drop(crate::BlockHeader::parse(&noise));
        let nodes: Nodes = [noise.clone()].into_iter().collect();
        drop(nodes.look_up(Hash(keccak256(&[&noise])), b"key"));
        drop(Nodes::parse(&noise));
        let mut file = header(BLOCK, Hash([1; 32]), Hash([2; 32]), [0; 32], 1);
        let at = at % file.len();
        file[at] ^= noise.first().copied().unwrap_or(1) | 1;
        if let Some(parsed) = crate::BlockHeader::parse(&file) {
            proptest::prop_assert!(parsed.sealer() != Some(account(1).1));
        }
        committed::noise(&noise, at);
    }
}

//! The table of what is refused, or not proven, and in which words; by both verifiers. It is docs/refusals.md: what differs
//! from there is printed. With `AUTHROS_LONG` far more bytes are flipped.

mod forms;

use std::cell::Cell;
use std::collections::BTreeMap;

use authros_crypto::record::RecordSecret;
use authros_crypto::signer_id;
use authros_model::Hash;

use super::committed::Commit;
use super::hostile::unanchored;
use super::page::{self, Case};
use super::second::{exit_code, second_opinion};
use super::world::{BLOCK, TIME, World, genesis, ours, pair, sealed, word};
use crate::archive::Members;
use crate::{Anchoring, Bundle, Nodes, Outcome, Packing, Slot, Trust, pack, verify};

use Outcome::{Incomplete, Refused};

fn is_long() -> bool {
    std::env::var_os("AUTHROS_LONG").is_some()
}

/// Altered members, signed again by their exporter.
fn signed_again(members: Members, world: &World) -> Members {
    Packing::from(members).sign(genesis(), world.owner, &world.keys, ours()).expect("packs")
}

/// The outcome, with everything that is said about it.
fn judged(file: &[u8], trust: &Trust) -> (Outcome, String) {
    let bundle = match Bundle::parse(file, ours()) {
        Ok(bundle) => bundle,
        Err(error) => return (Refused, error.to_string()),
    };
    let report = verify(&bundle, Some(trust), ours());
    let mut told = vec![report.exporter.text.clone()];
    for record in &report.records {
        told.extend(record.levels().map(|(letter, level)| format!("({letter}) {}", level.text)));
    }
    told.extend(report.complete.iter().map(|stretch| stretch.text.clone()));
    told.extend(report.warnings.clone());
    (report.outcome, told.join("\n"))
}

/// The published table.
const TABLE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/refusals.md");

thread_local! {
    /// Rows of this test that are not in the table.
    static UNPUBLISHED: Cell<usize> = const { Cell::new(0) };
}

/// At the end of each test that has rows; the page is told them, too.
fn expect_published() {
    page::expect_the_same_in_chromium();
    assert_eq!(UNPUBLISHED.get(), 0, "rows are not in docs/refusals.md as they are printed above");
}

/// Without digests, keys and accounts, which are drawn anew each time; a cell of a table.
fn lasting(text: &str) -> String {
    let words = text.split_inclusive(|character: char| !character.is_ascii_alphanumeric());
    let is_drawn = |word: &str| {
        let digits = word.trim_end_matches(|character: char| !character.is_ascii_alphanumeric());
        let hex = digits.strip_prefix("0x").unwrap_or(digits);
        hex.len() >= 16 && hex.bytes().all(|byte| byte.is_ascii_hexdigit())
    };
    let shown = words.map(|word| match is_drawn(word) {
        true => "…".to_owned() + word.trim_start_matches(|character: char| character.is_ascii_alphanumeric()),
        false => word.to_owned(),
    });
    shown.collect::<String>().replace('|', "/")
}

/// Both verifiers come to this outcome, and ours in these words.
fn row(what: &str, members: &Members, trust: &Trust, outcome: Outcome, words: &str) {
    row_of_file(what, &pack(members).expect("packs"), trust, outcome, words);
}

/// The same of a file.
fn row_of_file(what: &str, file: &[u8], trust: &Trust, outcome: Outcome, words: &str) {
    let (found, told) = judged(file, trust);
    assert_eq!(found, outcome, "{what}: {told}");
    page::tell(Case::new(what, file, trust));
    let line = told.lines().find(|line| line.contains(words));
    let line = line.unwrap_or_else(|| panic!("{what}: nothing says '{words}' in\n{told}"));
    let Some((code, reasons)) = second_opinion(file, trust) else { return };
    assert_eq!(code, code_of(outcome), "{what}: the second verifier says '{reasons}', and ours '{line}'");
    let word = if outcome == Refused { "refused" } else { "not proven" };
    let published = format!("| {what} | {word} | {} | {} |", lasting(line), lasting(&reasons));
    if !std::fs::read_to_string(TABLE).expect("docs/refusals.md").lines().any(|line| line == published) {
        UNPUBLISHED.set(UNPUBLISHED.get() + 1);
        println!("{published}");
    }
}

fn code_of(outcome: Outcome) -> i32 {
    match outcome {
        Outcome::Holds => 0,
        Incomplete => 8,
        Refused => 6,
    }
}

fn name_of(members: &Members, part: &str) -> String {
    members.keys().find(|name| name.contains(part)).unwrap_or_else(|| panic!("no {part}")).clone()
}

/// One member in place of another.
fn swapped(mine: &World, theirs: &Members, part: &str) -> Members {
    let mut members = mine.members();
    let (name, other) = (name_of(&members, part), name_of(theirs, part));
    members.insert(name, theirs[&other].clone());
    signed_again(members, mine)
}

fn disclosing() -> World {
    let mut world = World::new();
    let secret = RecordSecret::of(&world.topic_key, &world.record.header);
    world.disclose(&world.keys.clone(), secret);
    world
}

#[test]
fn members_of_another_bundle_are_noticed_though_they_are_signed_for() {
    let (mine, other) = (disclosing(), disclosing());
    let theirs = other.members();
    let trust = World::trust();
    for (part, outcome, words) in [
        ("record.bin", Refused, "it is not the record it is filed as"),
        ("signature.der", Refused, "its signature was not made by the key"),
        ("anchor.json", Refused, "its path does not lead to the root it names"),
        ("chain/40.rlp", Incomplete, "the state after block 40 is not in the bundle"),
        ("chain/41.rlp", Incomplete, "sealed by 1 of 3 pinned signers; 2 are required"),
        ("chain/nodes.rlp", Incomplete, "the state after block 40 is not in the bundle"),
        ("disclosed.bin", Refused, "which is not in the bundle"),
        ("disclosed.der", Refused, "not signed by its owner"),
        ("identities/", Refused, "is filed under another identity's name"),
    ] {
        row(&format!("{part} of another bundle"), &swapped(&mine, &theirs, part), &trust, outcome, words);
        let mut unsigned = mine.members();
        let (name, source) = (name_of(&unsigned, part), name_of(&theirs, part));
        unsigned.insert(name.clone(), theirs[&source].clone());
        let (found, told) = judged(&pack(&unsigned).expect("packs"), &trust);
        assert_eq!(found, Refused, "{told}");
        assert!(told.contains(&name), "{told}");
    }
    let plain = World::new();
    let mut renamed = plain.members();
    let name = name_of(&renamed, "identities/");
    renamed.remove(&name);
    let (name, identity) = theirs.iter().find(|(name, _)| name.starts_with("identities/")).expect("there");
    renamed.insert(name.clone(), identity.clone());
    let words = "is not in the bundle";
    row("identity of another bundle, under its name", &signed_again(renamed, &plain), &trust, Incomplete, words);
    expect_published();
}

#[test]
fn every_lie_about_the_chain_is_refused_by_both_in_its_own_words() {
    let trust = World::trust();
    let root = |world: &World| world.claim.inclusion().expect("a batch").root;
    let say = |what: &str, world: &World, outcome: Outcome, words: &str| {
        row(what, &world.members(), &trust, outcome, words);
    };

    let mut world = World::new();
    if let Anchoring::Batch { index, .. } = &mut world.claim.anchor {
        *index = 3;
    }
    say("another place in its batch", &world, Refused, "its path does not lead to the root it names");

    let (mut world, other) = (World::new(), World::new());
    world.claim = other.claim.clone();
    say("the path of another batch", &world, Refused, "its path does not lead to the root it names");

    let mut world = World::new();
    if let Anchoring::Batch { root, count, index, path, .. } = &mut world.claim.anchor {
        (*count, *index) = (1, 0);
        path.clear();
        *root = Hash([0x77; 32]);
    }
    say("the root of another batch", &world, Refused, "its path does not lead to the root it names");

    let mut world = World { shown_at: BLOCK + 9, ..World::new() };
    world.put(Slot::anchor(world.owner, root(&world)), [0; 32]);
    say("a later head whose slot is cleared", &world, Refused, "the state after block 49 does not contain its anchor");

    let mut world = World::new();
    world.put(Slot::anchor(world.owner, root(&world)), word(&[BLOCK, 6, TIME, 1]));
    say("another number of leaves", &world, Refused, "made for a different number of leaves than the chain has");

    let mut world = World::new();
    world.put(Slot::anchor(world.owner, root(&world)), word(&[BLOCK - 1, 5, TIME, 1]));
    say("another block", &world, Refused, "the chain has it in block 39, the bundle says 40");

    let mut world = World::new();
    world.put(Slot::anchor(world.owner, root(&world)), word(&[BLOCK, 5, TIME + 1, 1]));
    say("an anchor later than its block", &world, Refused, "to a block later than the state itself");

    let with = |sealers: &[u8]| World { sealers: sealers.to_vec(), ..World::new() };
    say("unpinned signers", &with(&[9, 8]), Refused, "who is not a signer you pinned");
    say("1 of 3 seals", &with(&[1]), Incomplete, "sealed by 1 of 3 pinned signers; 2 are required");
    say("one signer twice", &with(&[1, 1]), Incomplete, "sealed by 1 of 3 pinned signers; 2 are required");
    say("a stranger builds on it", &with(&[1, 9]), Incomplete, "sealed by 1 of 3 pinned signers; 2 are required");
    say("no seal", &with(&[0]), Incomplete, "its header has no seal that this version can check");

    // The exporter's own signers and clock: it claims to be ten days older than the message in it.
    let mut world = with(&[9, 8]);
    world.put(Slot::anchor(world.owner, root(&world)), word(&[BLOCK, 5, TIME - 864_000, 1]));
    say("a forged chain of the exporter's, with an old clock", &world, Refused, "who is not a signer you pinned");
    let mut forged = World::trust();
    forged.chain.signers = [9, 8].map(|secret| super::world::account(secret).1).to_vec();
    forged.chain.sealed_by_exporter = true;
    let words = "captured after the block that anchors it: a clock was wrong";
    row("the same, its signers pinned as the exporter's", &world.members(), &forged, Incomplete, words);

    let mut pins = World::trust();
    pins.chain.code_hash = Hash([1; 32]);
    row(
        "another contract's code",
        &World::new().members(),
        &pins,
        Refused,
        "the contract's code is not the code you pinned",
    );
    let mut pins = World::trust();
    pins.chain.genesis = Hash([1; 32]);
    row(
        "another chain",
        &World::new().members(),
        &pins,
        Refused,
        "bound to a different chain or contract than the one you pinned",
    );

    let commit = Commit { named: vec![1, 2, 3], ..Commit::by(&[1, 2]) };
    let qbft = |commit: Commit| World { commit: Some(commit), sealers: vec![0], ..World::new() };
    row(
        "QBFT: altered after it was sealed",
        &qbft(Commit { later: 9, ..commit.clone() }).members(),
        &trust,
        Refused,
        "altered",
    );
    row("QBFT: a seal twice", &qbft(Commit { sealers: vec![1, 1, 2], ..commit }).members(), &trust, Refused, "twice");
    expect_published();
}

#[test]
fn every_lie_about_keys_and_disclosures_is_refused_by_both_in_its_own_words() {
    let trust = World::trust();
    let say = |what: &str, world: &World, outcome: Outcome, words: &str| {
        row(what, &world.members(), &trust, outcome, words);
    };
    let mut world = World::new();
    let mut flags = word(&[1, 0, 1]);
    flags[7] = 1;
    world.put(Slot::account(world.owner), flags);
    say("a suspended account", &world, Refused, "was suspended at block 40");

    let World { owner, keys, identity, .. } = World::new();
    let lent = |loan: [u64; 3]| {
        let mut world = World::of(owner, keys.clone(), pair(), identity, owner);
        let mut packed = [0; 32];
        packed[31] = 1;
        for (at, field) in loan.iter().enumerate() {
            packed[23 - 8 * at..31 - 8 * at].copy_from_slice(&field.to_be_bytes());
        }
        world.put(Slot::loan(owner, &signer_id(&world.signer.public).0), packed);
        let mut packing = world.packing();
        packing.key(&keys.public).expect("a point");
        packing.sign(genesis(), owner, &keys, ours()).expect("packs")
    };
    row("an expired device", &lent([TIME, 12, 0]), &trust, Refused, "the device's authorisation had ended");
    row("a revoked device", &lent([0, 12, BLOCK]), &trust, Refused, "revoked the device in block 40");
    row("a device authorised later", &lent([0, 41, 0]), &trust, Refused, "authorised the device only in block 41");
    row("a device never authorised", &lent([0, 0, 0]), &trust, Refused, "neither registered nor authorised");

    let mut world = World::new();
    world.put(Slot::keys(world.owner, 2), [3; 32]);
    world.put(Slot::keys(world.owner, 2).next(1), word(&[BLOCK, TIME]));
    say("keys that were replaced", &world, Incomplete, "was not the one in force at block 40");

    let mut world = World::new();
    let other = sealed(world.owner, &world.keys, &world.topic_key, 4, b"another");
    let wrong = RecordSecret::of(&world.topic_key, &other.header);
    world.disclose(&world.keys.clone(), wrong);
    say("a wrong reveal", &world, Refused, "does not open it");
    let right = RecordSecret::of(&world.topic_key, &world.record.header);
    world.disclose(&pair(), right);
    say("a reveal by somebody else", &world, Refused, "not signed by its owner");

    let world = World::new();
    let mut twice = world.packing();
    let other = sealed(world.owner, &world.keys, &world.topic_key, 3, b"another");
    twice.record(other.digest, unanchored(other)).expect("added");
    let members = twice.sign(genesis(), world.owner, &world.keys, ours()).expect("packs");
    row("two records with one number", &members, &trust, Refused, "TWO different records carry number 3");
    expect_published();
}

/// Its exporter signs for each flipped byte: it proves less, or is refused. What no verifier reads is left out.
#[test]
fn a_flipped_byte_that_its_exporter_signs_for_never_holds() {
    let world = disclosing();
    let (members, trust) = (world.members(), World::trust());
    let file = pack(&members).expect("packs");
    assert_eq!(judged(&file, &trust).0, Outcome::Holds);
    // Its own key is written anew when it signs; nodes have a test of their own.
    let unread = ["mimetype", "manifest.json", "manifest.der", "VERIFY.txt", "chain/nodes.rlp"];
    let is_read = |name: &str| !unread.contains(&name) && !name.starts_with("keys/");
    for (name, bytes) in members.iter().filter(|(name, _)| is_read(name)) {
        let step = if is_long() { 1 } else { bytes.len() / 12 + 1 };
        for at in (0..bytes.len()).step_by(step) {
            let mut changed = members.clone();
            changed.get_mut(name).expect("there")[at] ^= 1 << (at % 8);
            let file = pack(&signed_again(changed, &world)).expect("packs");
            let (outcome, told) = judged(&file, &trust);
            // The two spellings of a letter in JSON's hex mean the same; nothing else does.
            let spelling = at % 8 == 5 && bytes[at].is_ascii_alphabetic() && name.strip_suffix(".json").is_some();
            assert!(outcome != Outcome::Holds || spelling, "{name}, byte {at}: {told}");
            if at == step
                && let Some(code) = exit_code(&file, &trust)
            {
                assert_eq!(code, code_of(outcome), "{name}, byte {at}: {told}");
            }
        }
    }
}

/// But for the one that nobody asks for: a stranger's account.
#[test]
fn a_flipped_bit_in_any_node_that_is_asked_for_never_holds() {
    let world = disclosing();
    let (members, trust) = (world.members(), World::trust());
    let nodes: Vec<Vec<u8>> = rlp::decode_list(&members["chain/nodes.rlp"]);
    let mut spare = 0;
    for place in 0..nodes.len() {
        let mut other = nodes.clone();
        let at = place * 31 % other[place].len();
        other[place][at] ^= 1;
        let mut changed = members.clone();
        changed.insert("chain/nodes.rlp".into(), other.into_iter().collect::<Nodes>().encode());
        let (outcome, told) = judged(&pack(&signed_again(changed, &world)).expect("packs"), &trust);
        spare += usize::from(outcome == Outcome::Holds);
        assert!(outcome != Refused || told.contains("the node"), "{told}");
    }
    assert!(nodes.len() > 5 && spare == 1, "{spare} of {} nodes", nodes.len());
}

/// Of the file itself; nobody signs for these.
#[test]
fn flipped_bytes_of_a_file_are_refused_each() {
    let world = disclosing();
    let mut packing = world.packing();
    for seq in 10..60 {
        let one = sealed(world.owner, &world.keys, &world.topic_key, seq, &[7; 600]);
        packing.record(one.digest, unanchored(one)).expect("added");
    }
    let members = packing.sign(genesis(), world.owner, &world.keys, ours()).expect("packs");
    let (file, trust) = (pack(&members).expect("packs"), World::trust());
    let mut reasons: BTreeMap<String, usize> = BTreeMap::new();
    let mut draw = 7u64;
    for _ in 0..if is_long() { 100_000 } else { 500 } {
        draw = draw.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let at = usize::try_from(draw >> 33).expect("small") % file.len();
        let mut changed = file.clone();
        changed[at] ^= 1 << (draw >> 20 & 7);
        let (outcome, told) = judged(&changed, &trust);
        assert_eq!(outcome, Refused, "byte {at}: {told}");
        let (_, why) = told.lines().next().unwrap_or_default().split_once(": ").unwrap_or_default();
        *reasons.entry(why.to_owned()).or_default() += 1;
    }
    if is_long() {
        println!("{reasons:#?}");
    }
}

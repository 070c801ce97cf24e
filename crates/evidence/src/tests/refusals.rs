//! The table of lies: what is done to a bundle, and where every verifier finds it. docs/refusals.md is written from it. With
//! `AUTHROS_LONG` far more bytes are flipped.

mod forms;

use std::collections::BTreeMap;

use authros_crypto::record::RecordSecret;
use authros_crypto::signer_id;
use authros_model::Hash;
use serde_json::Value;

use super::committed::Commit;
use super::hostile::unanchored;
use super::page;
use super::verifiers::{self, Case};
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
const PAGE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/refusals.md");
const HEADING: &str = "| Done to a bundle | Outcome | Where | In words |\n|---|---|---|---|\n";

/// The outcome of a lie, and where it is found: `form` where the file is no bundle, `exporter`, or a level's letter with
/// the reason or the standing.
type Expected = (Outcome, &'static str);

/// What is done to bundles, and what every verifier makes of it.
#[derive(Default)]
struct Table {
    cases: Vec<Case>,
    expected: Vec<Expected>,
}

impl Table {
    fn add(&mut self, what: &str, members: &Members, trust: &Trust, expected: Expected) {
        self.add_file(what, &pack(members).expect("packs"), trust, expected);
    }

    fn add_file(&mut self, what: &str, file: &[u8], trust: &Trust, expected: Expected) {
        let trust = trust.to_text().expect("text").into_bytes();
        self.cases.push(Case { what: what.to_owned(), bundle: file.to_vec(), trust });
        self.expected.push(expected);
    }
}

/// The words at the place of a lie, if it is found there.
fn found_at(told: &Value, at: &str) -> Option<String> {
    let text = |of: &Value| Some(of["text"].as_str()?.to_owned());
    let list = |name: &str| told[name].as_array().cloned().unwrap_or_default();
    match at.split_once(' ') {
        None if at == "form" => told["exporter"].is_null().then(|| told["why"].as_str().unwrap_or_default().to_owned()),
        None => text(&told["exporter"]).filter(|_| told["exporter"]["standing"] == "refused"),
        Some((letter, word)) => {
            let names = [("a", "bytes"), ("b", "key"), ("c", "anchor"), ("d", "time"), ("e", "opened")];
            let levels: Vec<Value> = match names.into_iter().find(|(of, _)| *of == letter) {
                Some((_, name)) => list("records").into_iter().map(|record| record[name].clone()).collect(),
                None => list("complete"),
            };
            levels.iter().find(|one| one["reason"] == word || one["standing"] == word).and_then(text)
        }
    }
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

fn row(what: &str, (outcome, at): Expected, words: &str) -> String {
    let outcome = if outcome == Refused { "refused" } else { "not proven" };
    let place = match at.split_once(' ') {
        None if at == "form" => "the file".to_owned(),
        None => "the exporter".to_owned(),
        Some((letter, word)) => format!("({letter}) `{word}`"),
    };
    format!("| {what} | {outcome} | {place} | {} |\n", lasting(words))
}

/// With `AUTHROS_WRITE_REFUSALS` the page's table is written anew.
#[test]
fn every_lie_is_refused_by_all_verifiers_where_the_published_table_says() {
    let mut table = Table::default();
    lies_about_members(&mut table);
    lies_about_the_chain(&mut table);
    lies_about_keys_and_disclosures(&mut table);
    forms::files_that_are_no_bundle(&mut table);
    forms::members_of_another_form(&mut table);
    forms::stamps_of_another_form(&mut table);
    if !forms::lies_in_tokens(&mut table) {
        println!("SKIPPED the table of refusals: no openssl");
        return;
    }
    let told = verifiers::agree(&table.cases);
    page::expect_the_same_in_chromium(&table.cases);
    let mut rows = String::new();
    for ((Case { what, .. }, expected), told) in table.cases.iter().zip(table.expected).zip(&told) {
        let (outcome, at) = expected;
        assert_eq!(told["outcome"], serde_json::to_value(outcome).expect("a word"), "{what}: {told:#}");
        let words = found_at(told, at).unwrap_or_else(|| panic!("{what}: not at {at}: {told:#}"));
        rows.push_str(&row(what, expected, &words));
    }
    let page = std::fs::read_to_string(PAGE).expect("docs/refusals.md");
    let (before, published) = page.split_once(HEADING).expect("its table");
    if std::env::var_os("AUTHROS_WRITE_REFUSALS").is_some() {
        std::fs::write(PAGE, [before, HEADING, &rows].concat()).expect("written");
        return;
    }
    let differing = rows.lines().zip(published.lines()).find(|(own, published)| own != published);
    assert_eq!(differing, None, "run it with AUTHROS_WRITE_REFUSALS=1, and read what that changes");
    assert_eq!(rows.lines().count(), published.lines().count(), "run it with AUTHROS_WRITE_REFUSALS=1");
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

/// Members of another bundle, though they are signed for.
fn lies_about_members(table: &mut Table) {
    let (mine, other) = (disclosing(), disclosing());
    let theirs = other.members();
    let trust = World::trust();
    for (part, expected) in [
        ("record.bin", (Refused, "a not_as_filed")),
        ("signature.der", (Refused, "a bad_signature")),
        ("anchor.json", (Refused, "c wrong_path")),
        ("chain/40.rlp", (Incomplete, "c state_missing")),
        ("chain/41.rlp", (Incomplete, "c few_signers")),
        ("chain/nodes.rlp", (Incomplete, "c state_missing")),
        ("disclosed.bin", (Refused, "form")),
        ("disclosed.der", (Refused, "e foreign_disclosure")),
        ("identities/", (Refused, "form")),
    ] {
        table.add(&format!("{part} of another bundle"), &swapped(&mine, &theirs, part), &trust, expected);
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
    let members = signed_again(renamed, &plain);
    table.add("identity of another bundle, under its name", &members, &trust, (Incomplete, "b identity_missing"));
}

fn lies_about_the_chain(table: &mut Table) {
    let trust = World::trust();
    let root = |world: &World| world.claim.inclusion().expect("a batch").root;
    let mut say = |what: &str, world: &World, outcome: Outcome, at: &'static str| {
        table.add(what, &world.members(), &trust, (outcome, at));
    };

    let mut world = World::new();
    if let Anchoring::Batch { index, .. } = &mut world.claim.anchor {
        *index = 3;
    }
    say("another place in its batch", &world, Refused, "c wrong_path");

    let (mut world, other) = (World::new(), World::new());
    world.claim = other.claim.clone();
    say("the path of another batch", &world, Refused, "c wrong_path");

    let mut world = World::new();
    if let Anchoring::Batch { root, count, index, path, .. } = &mut world.claim.anchor {
        (*count, *index) = (1, 0);
        path.clear();
        *root = Hash([0x77; 32]);
    }
    say("the root of another batch", &world, Refused, "c wrong_path");

    let mut world = World { shown_at: BLOCK + 9, ..World::new() };
    world.put(Slot::anchor(world.owner, root(&world)), [0; 32]);
    say("a later head whose slot is cleared", &world, Refused, "c anchor_missing");

    let mut world = World::new();
    world.put(Slot::anchor(world.owner, root(&world)), word(&[BLOCK, 6, TIME, 1]));
    say("another number of leaves", &world, Refused, "c other_anchor");

    let mut world = World::new();
    world.put(Slot::anchor(world.owner, root(&world)), word(&[BLOCK - 1, 5, TIME, 1]));
    say("another block", &world, Refused, "c other_anchor");

    let mut world = World::new();
    world.put(Slot::anchor(world.owner, root(&world)), word(&[BLOCK, 5, TIME + 1, 1]));
    say("an anchor later than its block", &world, Refused, "c other_anchor");

    let with = |sealers: &[u8]| World { sealers: sealers.to_vec(), ..World::new() };
    say("unpinned signers", &with(&[9, 8]), Refused, "c other_signer");
    say("1 of 3 seals", &with(&[1]), Incomplete, "c few_signers");
    say("one signer twice", &with(&[1, 1]), Incomplete, "c few_signers");
    say("a stranger builds on it", &with(&[1, 9]), Incomplete, "c few_signers");
    say("no seal", &with(&[0]), Incomplete, "c no_seal");

    // The exporter's own signers and clock: it claims to be ten days older than the message in it.
    let mut world = with(&[9, 8]);
    world.put(Slot::anchor(world.owner, root(&world)), word(&[BLOCK, 5, TIME - 864_000, 1]));
    say("a forged chain of the exporter's, with an old clock", &world, Refused, "c other_signer");
    let mut forged = World::trust();
    forged.chain.signers = [9, 8].map(|secret| super::world::account(secret).1).to_vec();
    forged.chain.sealed_by_exporter = true;
    let expected = (Incomplete, "c own_chain");
    table.add("the same, its signers pinned as the exporter's", &world.members(), &forged, expected);

    let mut pins = World::trust();
    pins.chain.code_hash = Hash([1; 32]);
    table.add("another contract's code", &World::new().members(), &pins, (Refused, "c other_code"));
    let mut pins = World::trust();
    pins.chain.genesis = Hash([1; 32]);
    table.add("another chain", &World::new().members(), &pins, (Refused, "a other_chain"));

    let commit = Commit { named: vec![1, 2, 3], ..Commit::by(&[1, 2]) };
    let qbft = |commit: Commit| World { commit: Some(commit), sealers: vec![0], ..World::new() };
    let (broken, later) = ((Refused, "c broken_seals"), qbft(Commit { later: 9, ..commit.clone() }));
    table.add("QBFT: altered after it was sealed", &later.members(), &trust, broken);
    let twice = qbft(Commit { sealers: vec![1, 1, 2], ..commit });
    table.add("QBFT: a seal twice", &twice.members(), &trust, broken);
}

fn lies_about_keys_and_disclosures(table: &mut Table) {
    let trust = World::trust();
    let mut world = World::new();
    let mut flags = word(&[1, 0, 1]);
    flags[7] = 1;
    world.put(Slot::account(world.owner), flags);
    table.add("a suspended account", &world.members(), &trust, (Refused, "b suspended"));

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
    table.add("an expired device", &lent([TIME, 12, 0]), &trust, (Refused, "b no_right"));
    table.add("a revoked device", &lent([0, 12, BLOCK]), &trust, (Refused, "b no_right"));
    table.add("a device authorised later", &lent([0, 41, 0]), &trust, (Refused, "b no_right"));
    table.add("a device never authorised", &lent([0, 0, 0]), &trust, (Refused, "b no_right"));

    let mut world = World::new();
    world.put(Slot::keys(world.owner, 2), [3; 32]);
    world.put(Slot::keys(world.owner, 2).next(1), word(&[BLOCK, TIME]));
    table.add("keys that were replaced", &world.members(), &trust, (Incomplete, "b keys_replaced"));

    let mut world = World::new();
    let other = sealed(world.owner, &world.keys, &world.topic_key, 4, b"another");
    let wrong = RecordSecret::of(&world.topic_key, &other.header);
    world.disclose(&world.keys.clone(), wrong);
    table.add("a wrong reveal", &world.members(), &trust, (Refused, "e bad_disclosure"));
    let right = RecordSecret::of(&world.topic_key, &world.record.header);
    world.disclose(&pair(), right);
    table.add("a reveal by somebody else", &world.members(), &trust, (Refused, "e foreign_disclosure"));

    let world = World::new();
    let mut twice = world.packing();
    let other = sealed(world.owner, &world.keys, &world.topic_key, 3, b"another");
    twice.record(other.digest, unanchored(other)).expect("added");
    let members = twice.sign(genesis(), world.owner, &world.keys, ours()).expect("packs");
    table.add("two records with one number", &members, &trust, (Refused, "f two_histories"));
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
    let mut cases = Vec::new();
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
            if at == step {
                let pins = trust.to_text().expect("text").into_bytes();
                cases.push(Case { what: format!("{name}, byte {at}"), bundle: file, trust: pins });
            }
        }
    }
    verifiers::agree(&cases);
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

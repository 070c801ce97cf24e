//! Bundles that are not of the form: whatever one verifier refuses of it, the other does not accept.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use super::*;
use crate::manifest::{MANIFEST, Manifest};
use crate::time::StampTree;

/// One member changed, and signed for again.
fn with(world: &World, part: &str, change: impl FnOnce(&mut Vec<u8>)) -> Members {
    let mut members = world.members();
    let name = name_of(&members, part);
    change(members.get_mut(&name).expect("there"));
    signed_again(members, world)
}

/// The same member, under another name.
fn renamed(world: &World, part: &str, name: impl FnOnce(&str) -> String) -> Members {
    let mut members = world.members();
    let before = name_of(&members, part);
    let bytes = members.remove(&before).expect("there");
    members.insert(name(&before), bytes);
    signed_again(members, world)
}

fn without(world: &World, part: &str) -> Members {
    let mut members = world.members();
    members.remove(&name_of(&members, part));
    signed_again(members, world)
}

/// One member more.
fn more(world: &World, name: &str, bytes: &[u8]) -> Members {
    let mut members = world.members();
    members.insert(name.to_owned(), bytes.to_vec());
    signed_again(members, world)
}

fn edited(bytes: &mut Vec<u8>, from: &str, to: &str) {
    let text = String::from_utf8(std::mem::take(bytes)).expect("text");
    assert!(text.contains(from), "{text}");
    *bytes = text.replacen(from, to, 1).into_bytes();
}

#[test]
fn files_that_are_no_bundle_are_refused_by_both() {
    let (world, trust) = (disclosing(), World::trust());
    let members = world.members();
    let file = pack(&members).expect("packs");
    let say = |what: &str, file: &[u8], words: &str| row_of_file(what, file, &trust, Refused, words);
    say("an empty file", b"", "it is not an evidence bundle");
    say("the first half of a file", &file[..file.len() / 2], "in the middle of a member");
    say("bytes behind its end", &[&file[..], b"more"].concat(), "not in the exact form of a bundle");
    // The first member is mimetype, and its name begins at byte 30.
    let behind = 30 + "mimetype".len() + members["mimetype"].len();
    say(
        "bytes between its members",
        &[&file[..behind], b"more", &file[behind..]].concat(),
        "not in the exact form of a bundle",
    );
    let unsigned = |change: &dyn Fn(&mut Members)| {
        let mut members = members.clone();
        change(&mut members);
        pack(&members).expect("packs")
    };
    let record = name_of(&members, "record.bin");
    let altered = unsigned(&|members| members.get_mut(&record).expect("there")[200] ^= 1);
    say("a member altered, and not signed for", &altered, "does not match the manifest");
    let removed = unsigned(&|members| drop(members.remove(&record)));
    say("a member taken out", &removed, "is named in the manifest but missing");
    let added = unsigned(&|members| drop(members.insert("chain/99.rlp".into(), b"more".to_vec())));
    say("a member put in", &added, "is present but not named in the manifest");
    let moved = unsigned(&|members| members.get_mut("manifest.json").expect("there").push(b' '));
    say("a manifest with a space more", &moved, "the manifest is not signed by the key");
    let theirs = disclosing().members()["manifest.der"].clone();
    let swapped = unsigned(&|members| drop(members.insert("manifest.der".into(), theirs.clone())));
    say("the signature of another manifest", &swapped, "the manifest is not signed by the key");
    let manifest = Manifest::read(&members, ours()).expect("reads");
    let mut spelled = members.clone();
    let bytes = spelled.remove(&record).expect("there");
    spelled.insert(record.replace(&world.record.digest.to_hex(), &world.record.digest.to_hex().to_uppercase()), bytes);
    let listed = Manifest::of(&spelled, manifest.chain, manifest.exporter, ours());
    spelled.insert(MANIFEST.to_owned(), serde_json::to_vec(&listed).expect("JSON"));
    say("a digest in capital letters", &pack(&spelled).expect("packs"), "a name that is not a digest");
    expect_published();
}

#[test]
fn members_that_are_not_of_their_form_are_refused_by_both_though_they_are_signed_for() {
    let (world, trust) = (disclosing(), World::trust());
    let say = |what: &str, members: &Members, words: &str| row(what, members, &trust, Refused, words);
    let hex = |kind: &str| format!("{kind}{}", "ab".repeat(32));
    say("a manifest with a line more", &more_lines(&world), "unknown field");
    say(
        "an anchor of another form",
        &with(&world, "anchor.json", |bytes| edited(bytes, "anchor/1", "anchor/2")),
        "its form is not",
    );
    let field = |bytes: &mut Vec<u8>| edited(bytes, "\"keys\":", "\"more\": 1, \"keys\":");
    say("an anchor with a line more", &with(&world, "anchor.json", field), "unknown field");
    say("a record without its bytes", &without(&world, "record.bin"), "record.bin: is missing");
    say("a record without its signature", &without(&world, "signature.der"), "signature.der: is missing");
    say("a malformed signature", &with(&world, "signature.der", |bytes| bytes.push(0)), "signature.der");
    say("a disclosure without its signature", &without(&world, "disclosed.der"), "disclosed.der: is missing");
    say("a disclosure without its list", &without(&world, "disclosed.bin"), "disclosed.bin: is missing");
    let cut = |bytes: &mut Vec<u8>| bytes.truncate(63);
    say("a secret that is too short", &with(&world, "disclosed.bin", cut), "a list of digests and secrets");
    let twice = |bytes: &mut Vec<u8>| bytes.extend_from_within(..);
    say("a record disclosed twice", &with(&world, "disclosed.bin", twice), "in the order of its digests");
    let suite = |bytes: &mut Vec<u8>| edited(bytes, "SM4-GCM", "SM4-CCM");
    say("a manifest of another suite", &relisted(&world, suite), "or other algorithms");
    say(
        "a header under another number",
        &renamed(&world, "chain/41.rlp", |_| "chain/43.rlp".into()),
        "the number of another block",
    );
    say("one more header, malformed", &more(&world, "chain/99.rlp", &[0xc0]), "is not a block header");
    let backwards = |bytes: &mut Vec<u8>| {
        let nodes: Vec<Vec<u8>> = rlp::decode_list(bytes);
        let mut list = rlp::RlpStream::new_list(nodes.len());
        nodes.iter().rev().for_each(|node| {
            list.append(node);
        });
        *bytes = list.out().to_vec();
    };
    say(
        "nodes in another order",
        &with(&world, "chain/nodes.rlp", backwards),
        "distinct nodes in order of their hashes",
    );
    say("one more identity, malformed", &more(&world, &format!("{}.bin", hex("identities/")), b"x"), "identities/");
    let whole: Vec<u8> = world.members()[&name_of(&world.members(), "identities/")].clone();
    say(
        "an identity under another name",
        &more(&world, &format!("{}.bin", hex("identities/")), &whole),
        "another identity's name",
    );
    say(
        "a definition under another name",
        &more(&world, &format!("{}.txt", hex("definitions/")), b"x"),
        "another text's name",
    );
    say("a suggestion that is not text", &more(&world, "trust.toml", &[0xff, 0xfe]), "is not text");
    let pem = authros_crypto::keyfile::sm2_public_pem(&pair().public).expect("a point");
    say(
        "a key under another's name",
        &more(&world, &format!("{}.pem", hex("keys/")), pem.as_bytes()),
        "another key's name",
    );
    say("a malformed key", &more(&world, &format!("{}.pem", hex("keys/")), b"x"), "contains no SM2 public key");
    let (before, compressed) = (format!("a key\n{pem}"), compressed(&pem));
    let words = "not written in a bundle's one form";
    say("text before a key", &more(&world, &name_of_key(&pem), before.as_bytes()), words);
    say("a key whose point is compressed", &more(&world, &name_of_key(&pem), compressed.as_bytes()), words);
    let each = r#"{"format": "authros-anchor/1", "block": 40, "shown_at": 40, "keys": 1, "anchor": {"mode": "each", "index": 0}}"#;
    say(
        "a single anchor with one more line",
        &with(&world, "anchor.json", |bytes| *bytes = each.into()),
        "unknown field `index`",
    );
    say("a member that no bundle has", &more(&world, "chain/more.txt", b"x"), "chain/more.txt");
    let folder = format!("{}/roots.json", hex("witnesses/"));
    say("a folder that no bundle has", &more(&world, &folder, b"{}"), "does not belong in a bundle");
    expect_published();
}

/// The member of a key.
fn name_of_key(pem: &str) -> String {
    let key = authros_crypto::keyfile::sm2_public_from_pem(pem).expect("a key");
    format!("keys/{}.pem", signer_id(&key).to_hex())
}

/// The same key, with its point as SEC 1 compresses it: x, and whether y is odd.
fn compressed(pem: &str) -> String {
    let body: String = pem.lines().filter(|line| !line.starts_with('-')).collect();
    let info = STANDARD.decode(body).expect("base64");
    let (head, point) = info.split_at(info.len() - 65);
    // The lengths of the sequence and of the bit string: 32 bytes less each.
    let mut shorter = head.to_vec();
    shorter[1] -= 32;
    shorter[24] -= 32;
    shorter.push(2 | point[64] & 1);
    shorter.extend_from_slice(&point[1..33]);
    let text = STANDARD.encode(shorter);
    let (first, rest) = text.split_at(64);
    format!("-----BEGIN PUBLIC KEY-----\n{first}\n{rest}\n-----END PUBLIC KEY-----\n")
}

/// A manifest that says more than the form has, signed by its exporter.
fn more_lines(world: &World) -> Members {
    relisted(world, |text| edited(text, "\"format\":", "\"more\": 1, \"format\":"))
}

/// Another manifest, signed by its exporter.
fn relisted(world: &World, change: impl FnOnce(&mut Vec<u8>)) -> Members {
    let mut members = world.members();
    let text = members.get_mut(MANIFEST).expect("there");
    change(text);
    let signed = crate::manifest::signed_bytes(text);
    let signature = ours().sign(&world.keys.secret, &signed).expect("signs");
    members.insert("manifest.der".into(), authros_crypto::signature_der(&signature));
    members
}

#[test]
fn stamps_that_are_not_of_their_form_are_refused_by_both() {
    let (world, trust) = (World::new(), World::trust());
    let root = world.claim.inclusion().expect("a batch").root;
    let tree = StampTree::new(vec![Hash([1; 32]), root, Hash([2; 32])]).expect("a tree");
    let mut packing = world.packing();
    packing.stamps(&tree, &[root], &[vec![0x30, 0]]).expect("added");
    let members = packing.sign(genesis(), world.owner, &world.keys, ours()).expect("packs");
    let roots = name_of(&members, "/roots.json");
    let token = members.keys().find(|name| name.starts_with("stamps/") && **name != roots).expect("a token").clone();
    let say = |what: &str, words: &str, change: &dyn Fn(&mut Members)| {
        let mut members = members.clone();
        change(&mut members);
        row(what, &signed_again(members, &world), &trust, Refused, words);
    };
    say("a stamp without its roots", "roots.json: is missing", &|members| drop(members.remove(&roots)));
    say("a stamp without a token", "no token", &|members| drop(members.remove(&token)));
    say("a token under another's name", "SHA-256", &|members| drop(members.insert(token.clone(), vec![1])));
    let line = |from: &'static str, to: &'static str| {
        let name = roots.clone();
        move |members: &mut Members| edited(members.get_mut(&name).expect("there"), from, to)
    };
    say("a stamp over another number of roots", "another stamp's imprint", &line("\"count\": 3", "\"count\": 4"));
    say("a stamp of another form", "form", &line("authros-stamp/1", "authros-stamp/2"));
    say("a stamp over too many roots", "more than", &line("\"count\": 3", "\"count\": 30000"));
    expect_published();
}

/// Of the same content, but written as only a lenient reader takes it: each is refused by both.
#[test]
fn other_spellings_are_refused_by_both_though_they_are_signed_for() {
    let (world, trust) = (disclosing(), World::trust());
    let refused = |what: &str, members: &Members| {
        let file = pack(members).expect("packs");
        let (found, told) = judged(&file, &trust);
        assert_eq!(found, Refused, "{what}: {told}");
        let code = exit_code(&file, &trust);
        assert!(code.is_none_or(|code| code == 6), "{what}: the second verifier ends with {code:?}, ours says {told}");
    };
    let anchor = |change: &dyn Fn(String) -> Vec<u8>| {
        with(&world, "anchor.json", |bytes| *bytes = change(String::from_utf8(bytes.clone()).expect("text")))
    };
    refused("a line twice", &anchor(&|text| text.replacen("\"keys\":", "\"keys\": 9, \"keys\":", 1).into_bytes()));
    let wide = |text: String| -> Vec<u8> {
        std::iter::once(0xfeff).chain(text.encode_utf16()).flat_map(u16::to_le_bytes).collect()
    };
    refused("another encoding", &anchor(&wide));
    refused("an account without 0x", &anchor(&|text| changed(&text, "account", |value| value.replacen("0x", "", 1))));
    let swapped = |value: &str| -> String {
        let (prefix, digits) = value.split_at(2);
        let swap =
            |one: char| if one.is_ascii_uppercase() { one.to_ascii_lowercase() } else { one.to_ascii_uppercase() };
        prefix.chars().chain(digits.chars().map(swap)).collect()
    };
    refused("an account with another checksum", &anchor(&|text| changed(&text, "account", swapped)));
    let spaced = |value: &str| format!("{} {}", &value[..10], &value[10..]);
    refused("a space within a hash", &anchor(&|text| changed(&text, "root", spaced)));
    let pem = authros_crypto::keyfile::sm2_public_pem(&pair().public).expect("a point");
    let noisy = |pem: &str| pem.replacen("MFkw", "MFkw#", 1);
    assert_ne!(noisy(&pem), pem);
    refused("a key with a stray character", &more(&world, &name_of_key(&pem), noisy(&pem).as_bytes()));
    for (from, to, what) in [("\n", "\r\n", "a key of other lines"), ("-\n", "-\n\n", "a key with a line more")] {
        refused(what, &more(&world, &name_of_key(&pem), pem.replace(from, to).as_bytes()));
    }
}

/// The first text with this name, changed.
fn changed(text: &str, line: &str, change: impl Fn(&str) -> String) -> Vec<u8> {
    let (before, after) = text.split_once(&format!("\"{line}\":")).expect("there");
    let (space, value) = after.split_once('"').expect("a text");
    let (value, rest) = value.split_once('"').expect("its end");
    format!("{before}\"{line}\":{space}\"{}\"{rest}", change(value)).into_bytes()
}

//! Bundles that are not of the form, and stamps that are none: whatever one verifier refuses, no other accepts.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use super::super::authority::{Authority, P256};
use super::*;
use crate::manifest::{MANIFEST, Manifest};
use crate::time::StampTree;
use crate::trust::PinnedAuthority;

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

pub fn files_that_are_no_bundle(table: &mut Table) {
    let (world, trust) = (disclosing(), World::trust());
    let members = world.members();
    let file = pack(&members).expect("packs");
    let mut say = |what: &str, file: &[u8], at: &'static str| table.add_file(what, file, &trust, (Refused, at));
    say("an empty file", b"", "form");
    say("the first half of a file", &file[..file.len() / 2], "form");
    say("bytes behind its end", &[&file[..], b"more"].concat(), "form");
    // The first member is mimetype, and its name begins at byte 30.
    let behind = 30 + "mimetype".len() + members["mimetype"].len();
    say("bytes between its members", &[&file[..behind], b"more", &file[behind..]].concat(), "form");
    let unsigned = |change: &dyn Fn(&mut Members)| {
        let mut members = members.clone();
        change(&mut members);
        pack(&members).expect("packs")
    };
    let record = name_of(&members, "record.bin");
    let altered = unsigned(&|members| members.get_mut(&record).expect("there")[200] ^= 1);
    say("a member altered, and not signed for", &altered, "form");
    let removed = unsigned(&|members| drop(members.remove(&record)));
    say("a member taken out", &removed, "form");
    let added = unsigned(&|members| drop(members.insert("chain/99.rlp".into(), b"more".to_vec())));
    say("a member put in", &added, "form");
    let moved = unsigned(&|members| members.get_mut("manifest.json").expect("there").push(b' '));
    say("a manifest with a space more", &moved, "exporter");
    let theirs = disclosing().members()["manifest.der"].clone();
    let swapped = unsigned(&|members| drop(members.insert("manifest.der".into(), theirs.clone())));
    say("the signature of another manifest", &swapped, "exporter");
    let manifest = Manifest::read(&members, ours()).expect("reads");
    let mut spelled = members.clone();
    let bytes = spelled.remove(&record).expect("there");
    spelled.insert(record.replace(&world.record.digest.to_hex(), &world.record.digest.to_hex().to_uppercase()), bytes);
    let listed = Manifest::of(&spelled, manifest.chain, manifest.exporter, ours());
    spelled.insert(MANIFEST.to_owned(), serde_json::to_vec(&listed).expect("JSON"));
    say("a digest in capital letters", &pack(&spelled).expect("packs"), "form");
}

/// Members that are not of their form, though they are signed for.
pub fn members_of_another_form(table: &mut Table) {
    let (world, trust) = (disclosing(), World::trust());
    let mut say = |what: &str, members: &Members| table.add(what, members, &trust, (Refused, "form"));
    let hex = |kind: &str| format!("{kind}{}", "ab".repeat(32));
    say("a manifest with a line more", &more_lines(&world));
    say("an anchor of another form", &with(&world, "anchor.json", |bytes| edited(bytes, "anchor/1", "anchor/2")));
    let field = |bytes: &mut Vec<u8>| edited(bytes, "\"keys\":", "\"more\": 1, \"keys\":");
    say("an anchor with a line more", &with(&world, "anchor.json", field));
    say("a record without its bytes", &without(&world, "record.bin"));
    say("a record without its signature", &without(&world, "signature.der"));
    say("a malformed signature", &with(&world, "signature.der", |bytes| bytes.push(0)));
    say("a disclosure without its signature", &without(&world, "disclosed.der"));
    say("a disclosure without its list", &without(&world, "disclosed.bin"));
    let cut = |bytes: &mut Vec<u8>| bytes.truncate(63);
    say("a secret that is too short", &with(&world, "disclosed.bin", cut));
    let twice = |bytes: &mut Vec<u8>| bytes.extend_from_within(..);
    say("a record disclosed twice", &with(&world, "disclosed.bin", twice));
    let suite = |bytes: &mut Vec<u8>| edited(bytes, "SM4-GCM", "SM4-CCM");
    say("a manifest of another suite", &relisted(&world, suite));
    say("a header under another number", &renamed(&world, "chain/41.rlp", |_| "chain/43.rlp".into()));
    say("one more header, malformed", &more(&world, "chain/99.rlp", &[0xc0]));
    let backwards = |bytes: &mut Vec<u8>| {
        let nodes: Vec<Vec<u8>> = rlp::decode_list(bytes);
        let mut list = rlp::RlpStream::new_list(nodes.len());
        nodes.iter().rev().for_each(|node| {
            list.append(node);
        });
        *bytes = list.out().to_vec();
    };
    say("nodes in another order", &with(&world, "chain/nodes.rlp", backwards));
    say("one more identity, malformed", &more(&world, &format!("{}.bin", hex("identities/")), b"x"));
    let whole: Vec<u8> = world.members()[&name_of(&world.members(), "identities/")].clone();
    say("an identity under another name", &more(&world, &format!("{}.bin", hex("identities/")), &whole));
    say("a definition under another name", &more(&world, &format!("{}.txt", hex("definitions/")), b"x"));
    say("a suggestion that is not text", &more(&world, "trust.toml", &[0xff, 0xfe]));
    let pem = authros_crypto::keyfile::sm2_public_pem(&pair().public).expect("a point");
    say("a key under another's name", &more(&world, &format!("{}.pem", hex("keys/")), pem.as_bytes()));
    say("a malformed key", &more(&world, &format!("{}.pem", hex("keys/")), b"x"));
    let (before, compressed) = (format!("a key\n{pem}"), compressed(&pem));
    say("text before a key", &more(&world, &name_of_key(&pem), before.as_bytes()));
    say("a key whose point is compressed", &more(&world, &name_of_key(&pem), compressed.as_bytes()));
    let each = r#"{"format": "authros-anchor/1", "block": 40, "shown_at": 40, "keys": 1, "anchor": {"mode": "each", "index": 0}}"#;
    say("a single anchor with one more line", &with(&world, "anchor.json", |bytes| *bytes = each.into()));
    say("a member that no bundle has", &more(&world, "chain/more.txt", b"x"));
    let folder = format!("{}/roots.json", hex("witnesses/"));
    say("a folder that no bundle has", &more(&world, &folder, b"{}"));
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

pub fn stamps_of_another_form(table: &mut Table) {
    let (world, trust) = (World::new(), World::trust());
    let root = world.claim.inclusion().expect("a batch").root;
    let tree = StampTree::new(vec![Hash([1; 32]), root, Hash([2; 32])]).expect("a tree");
    let mut packing = world.packing();
    packing.stamps(&tree, &[root], &[vec![0x30, 0]]).expect("added");
    let members = packing.sign(genesis(), world.owner, &world.keys, ours()).expect("packs");
    let roots = name_of(&members, "/roots.json");
    let token = members.keys().find(|name| name.starts_with("stamps/") && **name != roots).expect("a token").clone();
    let mut say = |what: &str, change: &dyn Fn(&mut Members)| {
        let mut members = members.clone();
        change(&mut members);
        table.add(what, &signed_again(members, &world), &trust, (Refused, "form"));
    };
    say("a stamp without its roots", &|members| drop(members.remove(&roots)));
    say("a stamp without a token", &|members| drop(members.remove(&token)));
    say("a token under another's name", &|members| drop(members.insert(token.clone(), vec![1])));
    let line = |from: &'static str, to: &'static str| {
        let name = roots.clone();
        move |members: &mut Members| edited(members.get_mut(&name).expect("there"), from, to)
    };
    say("a stamp over another number of roots", &line("\"count\": 3", "\"count\": 4"));
    say("a stamp of another form", &line("authros-stamp/1", "authros-stamp/2"));
    say("a stamp over too many roots", &line("\"count\": 3", "\"count\": 30000"));
}

/// What a token or the way to it says falsely; `false` without openssl, which makes them.
pub fn lies_in_tokens(table: &mut Table) -> bool {
    let Some(authority) = Authority::new() else { return false };
    for (name, extensions) in [("good", "stamps"), ("plain", "plain")] {
        authority.issue((name, P256), "root", extensions, "");
    }
    let pinned = vec![PinnedAuthority { name: "The notary".to_owned(), certificate: authority.pem("root") }];
    let (world, trust) = (World::new(), Trust { authorities: pinned, ..World::trust() });
    let root = world.claim.inclusion().expect("a batch").root;
    let tree = StampTree::new(vec![Hash([1; 32]), root, Hash([2; 32])]).expect("a tree");
    let good = authority.token(tree.imprint(), "good", "sha256");
    authority.write("token", &good);
    authority.openssl("cms -verify -noverify -binary -inform DER -in token -out content");
    let other = authority.signed(&authority.read("content"), "plain", "-md sha256 -cades");
    let mut flipped = good.clone();
    *flipped.last_mut().expect("bytes") ^= 1;
    let mut say = |what: &str, token: Vec<u8>, change: &dyn Fn(&mut Members), at: &'static str| {
        let mut packing = world.packing();
        packing.stamps(&tree, &[root], &[token]).expect("added");
        let mut members = packing.sign(genesis(), world.owner, &world.keys, ours()).expect("packs");
        change(&mut members);
        table.add(what, &signed_again(members, &world), &trust, (Refused, at));
    };
    let nothing = |_: &mut Members| ();
    say("a token over something else", authority.token([7; 32], "good", "sha256"), &nothing, "d bad_stamp");
    say("a token with a flipped bit in its signature", flipped, &nothing, "d bad_stamp");
    say("a token by a certificate for other uses", other, &nothing, "d bad_stamp");
    say("a token with a byte behind it", [&good[..], &[0]].concat(), &nothing, "d bad_stamp");
    let elsewhere = |members: &mut Members| {
        let name = name_of(members, "/roots.json");
        edited(members.get_mut(&name).expect("there"), "\"index\": 1", "\"index\": 0");
    };
    say("another place under a stamp", good, &elsewhere, "d stamp_path");
    true
}

/// Of the same content, but written as only a lenient reader takes it: each is refused by all.
#[test]
fn other_spellings_are_refused_by_all_though_they_are_signed_for() {
    let (world, trust) = (disclosing(), World::trust());
    let mut cases = Vec::new();
    let mut refused = |what: &str, members: &Members| {
        let (bundle, trust) = (pack(members).expect("packs"), trust.to_text().expect("text").into_bytes());
        cases.push(Case { what: what.to_owned(), bundle, trust });
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
    let codes: Vec<i32> = verifiers::agree(&cases).iter().map(verifiers::code).collect();
    assert!(!codes.is_empty() && codes.iter().all(|code| *code == 6), "{codes:?}");
}

/// The first text with this name, changed.
fn changed(text: &str, line: &str, change: impl Fn(&str) -> String) -> Vec<u8> {
    let (before, after) = text.split_once(&format!("\"{line}\":")).expect("there");
    let (space, value) = after.split_once('"').expect("a text");
    let (value, rest) = value.split_once('"').expect("its end");
    format!("{before}\"{line}\":{space}\"{}\"{rest}", change(value)).into_bytes()
}

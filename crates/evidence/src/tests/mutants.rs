//! All verifiers over mutants of one bundle and one trust file: spellings of JSON, TOML and RLP that two readers could take
//! differently. Whatever they say, they say the same.

use std::path::Path;

use authros_crypto::signature_der;
use rlp::RlpStream;

use super::authority::Authority;
use super::verifiers::{self, Case};
use super::world::{Part, World, genesis, ours};
use crate::archive::Members;
use crate::manifest::{MANIFEST, signed_bytes};
use crate::time::StampTree;
use crate::{Packing, pack};
use authros_model::Hash;

/// Of these, as many as a run has time for: with `AUTHROS_LONG` all.
fn some(cases: Vec<Case>, most: usize) -> Vec<Case> {
    let step = if std::env::var_os("AUTHROS_LONG").is_some() { 1 } else { cases.len().div_ceil(most) };
    // Lists in place of lines are few, and were what one of the two took.
    let is_taken = |(at, case): &(usize, Case)| at % step == 0 || case.what.contains("a list for");
    cases.into_iter().enumerate().filter(is_taken).map(|(_, case)| case).collect()
}

/// All say the same of each case; returns how ours ended.
fn agree(cases: &[Case]) -> Vec<i32> {
    verifiers::agree(cases).iter().map(verifiers::code).collect()
}

fn trust_text() -> String {
    World::trust().to_text().expect("text")
}

/// A world with every kind of member in JSON.
fn members(world: &World) -> Members {
    // Of another batch, so that nothing asks for the token, which is none.
    let tree = StampTree::new(vec![Hash([1; 32]), Hash([2; 32])]).expect("a tree");
    let mut packing = world.packing();
    packing.stamps(&tree, &[Hash([1; 32])], &[vec![0x30, 0]]).expect("added");
    let heights = format!(
        "{{\"format\": \"authros-heights/1\", \"heights\": [{{\"heads\": \"{}\", \"topic\": \"{}\", \"number\": 3, \"index\": 0, \"path\": []}}]}}",
        "ab".repeat(32),
        "cd".repeat(16)
    );
    let mut members = packing.sign(genesis(), world.owner, &world.keys, ours()).expect("packs");
    members.insert("heights.json".to_owned(), heights.into_bytes());
    signed(members, world)
}

fn signed(members: Members, world: &World) -> Members {
    Packing::from(members).sign(genesis(), world.owner, &world.keys, ours()).expect("packs")
}

/// A manifest with other bytes, signed for as they are.
fn with_manifest(mut members: Members, world: &World, text: Vec<u8>) -> Members {
    let signature = ours().sign(&world.keys.secret, &signed_bytes(&text)).expect("signs");
    members.insert("manifest.der".into(), signature_der(&signature));
    members.insert(MANIFEST.to_owned(), text);
    members
}

/// Places of an object or list in a text of JSON without escapes: where it begins, and behind its end.
fn nested(text: &str, open: char, close: char) -> Vec<(usize, usize)> {
    let (mut begun, mut found) = (Vec::new(), Vec::new());
    for (at, character) in text.char_indices() {
        if character == open {
            begun.push(at);
        } else if character == close {
            found.extend(begun.pop().map(|begin| (begin, at + 1)));
        }
    }
    found
}

/// The object with these bytes as the list of its values, in their order.
fn as_list(object: &str) -> String {
    let (mut values, mut depth, mut part) = (Vec::new(), 0, String::new());
    for character in object[1..object.len() - 1].chars().chain([',']) {
        match character {
            '{' | '[' => depth += 1,
            '}' | ']' => depth -= 1,
            _ => {}
        }
        if character == ',' && depth == 0 {
            let value = part.split_once(':').map_or("", |(_, value)| value).trim().to_owned();
            values.push(value);
            part.clear();
        } else {
            part.push(character);
        }
    }
    format!("[{}]", values.join(", "))
}

/// Every such spelling of a text of JSON.
#[expect(clippy::too_many_lines, reason = "a list of spellings")]
fn spellings(text: &str) -> Vec<(String, Vec<u8>)> {
    let mut found: Vec<(String, Vec<u8>)> = Vec::new();
    let mut add = |what: String, text: String| found.push((what, text.into_bytes()));
    for (begin, end) in nested(text, '{', '}') {
        let object = &text[begin..end];
        add(format!("a list for {object:.60}"), format!("{}{}{}", &text[..begin], as_list(object), &text[end..]));
        if let Some((first, _)) = object[1..].split_once(':') {
            let twice = format!("{{{first}: 1, {}", &object[1..]);
            add(format!("a line twice in {object:.60}"), format!("{}{twice}{}", &text[..begin], &text[end..]));
            let escaped = first.replacen('"', "\"\\u0066", 1);
            let other = object.replacen(first, &escaped, 1);
            add(format!("an escape in {object:.60}"), format!("{}{other}{}", &text[..begin], &text[end..]));
        }
        add(format!("nothing for {object:.60}"), format!("{}{{}}{}", &text[..begin], &text[end..]));
    }
    for (begin, end) in nested(text, '[', ']') {
        for other in ["{}", "null", "\"\"", "[[]]", "[null]"] {
            add(format!("{other} for a list at {begin}"), format!("{}{other}{}", &text[..begin], &text[end..]));
        }
    }
    let bytes = text.as_bytes();
    let is_number = |at: usize| bytes[at].is_ascii_digit() && matches!(bytes[at - 1], b' ' | b':');
    for begin in (1..bytes.len()).filter(|at| is_number(*at)) {
        let end = (begin..bytes.len()).find(|at| !bytes[*at].is_ascii_digit()).unwrap_or(bytes.len());
        let number = &text[begin..end];
        let forms = [
            format!("{number}.0"),
            format!("{number}e0"),
            format!("{number}E+0"),
            format!("-{number}"),
            format!("0{number}"),
            format!("+{number}"),
            format!("\"{number}\""),
            format!("[{number}]"),
            format!("0x{number}"),
        ];
        let fixed = ["-0", "0", "-0.0", "1e400", "NaN", "Infinity", "null", "true", "18446744073709551615"];
        let large = ["18446744073709551616", "36893488147419103232", "9223372036854775808", "1e19"];
        let fixed = fixed.into_iter().chain(large).map(str::to_owned);
        for other in forms.into_iter().chain(fixed) {
            add(format!("{other} for {number} at {begin}"), format!("{}{other}{}", &text[..begin], &text[end..]));
        }
    }
    for (at, _) in text.match_indices('"') {
        let Some(length) = text[at + 1..].find('"') else { continue };
        let word = &text[at + 1..at + 1 + length];
        let digits = word.strip_prefix("0x").unwrap_or(word);
        if digits.len() < 32 || !digits.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            continue;
        }
        let (upper, lower) = (digits.to_ascii_uppercase(), digits.to_ascii_lowercase());
        let forms = [
            upper.clone(),
            lower.clone(),
            format!("0x{lower}"),
            format!("0x{upper}"),
            format!("0X{lower}"),
            format!("0x0x{lower}"),
            format!(" {lower}"),
            format!("{lower} "),
            format!("{lower}0"),
            digits[1..].to_owned(),
            digits[2..].to_owned(),
            format!("{}g", &digits[1..]),
            String::new(),
        ];
        for other in forms {
            add(
                format!("'{other}' for a word at {at}"),
                format!("{}{other}{}", &text[..=at], &text[at + 1 + length..]),
            );
        }
    }
    for (what, before, behind) in [
        ("a byte order mark", "\u{feff}", ""),
        ("two of them", "\u{feff}\u{feff}", ""),
        ("white space around it", " \t\r\n", " \n"),
        ("a space that is none", "\u{a0}", ""),
        ("something behind it", "", "{}"),
        ("a comma behind it", "", ","),
        ("a comment", "/* */", ""),
        ("a zero behind it", "", "\0"),
        ("a list around it", "[", "]"),
    ] {
        add(what.to_owned(), format!("{before}{text}{behind}"));
    }
    found.push(("UTF-16".to_owned(), text.encode_utf16().flat_map(u16::to_le_bytes).collect()));
    found.push(("a byte that is no text".to_owned(), [text.as_bytes(), &[0xff]].concat()));
    found.push(("nothing".to_owned(), Vec::new()));
    found
}

/// Numbers drawn always alike.
struct Draw(u64);

impl Draw {
    fn below(&mut self, most: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        usize::try_from(self.0 >> 33).expect("small") % most
    }

    /// Some bytes of this text replaced, put in, or left out.
    fn changed(&mut self, text: &[u8], signs: &[u8]) -> Vec<u8> {
        let mut changed = text.to_vec();
        for _ in 0..=self.below(2) {
            let at = self.below(changed.len());
            match self.below(3) {
                0 => changed[at] = signs[self.below(signs.len())],
                1 => changed.insert(at, signs[self.below(signs.len())]),
                _ => drop(changed.remove(at)),
            }
        }
        changed
    }
}

#[test]
fn both_say_the_same_of_every_spelling_of_json() {
    let world = World::new();
    let members = members(&world);
    let (trust, mut draw) = (trust_text().into_bytes(), Draw(7));
    let mut cases = Vec::new();
    let mut add = |what: String, members: &Members| {
        cases.push(Case { what, bundle: pack(members).expect("packs"), trust: trust.clone() });
    };
    add("as it is".to_owned(), &members);
    for name in members.keys().filter(|name| name.strip_suffix(".json").is_some()) {
        let text = String::from_utf8(members[name].clone()).expect("text");
        let drawn = (0..40).map(|number| {
            let changed = draw.changed(text.as_bytes(), b"{}[]:,\"0123456789.-+eEaAfxX \n\\u");
            (format!("drawn {number}"), changed)
        });
        let drawn: Vec<_> = drawn.collect();
        // Most members are named in the manifest alike.
        let spelled = spellings(&text).into_iter().enumerate();
        let spelled = spelled.filter(|(at, (what, _))| name != MANIFEST || at % 7 == 0 || what.starts_with("a list"));
        for (what, text) in spelled.map(|(_, one)| one).chain(drawn) {
            let what = format!("{name}: {what}");
            if name == MANIFEST {
                add(what, &with_manifest(members.clone(), &world, text));
            } else {
                let mut changed = members.clone();
                changed.insert(name.clone(), text);
                add(what, &signed(changed, &world));
            }
        }
    }
    assert!(cases.len() > 400, "{}", cases.len());
    let cases = some(cases, 250);
    let codes = agree(&cases);
    assert_eq!(codes.first(), Some(&0), "as it is");
    let lists = cases.iter().zip(&codes).filter(|(case, _)| case.what.contains("a list for"));
    assert!(lists.clone().count() > 10 && lists.clone().all(|(_, code)| *code == 6), "a list is no structure");
}

#[test]
#[expect(clippy::too_many_lines, reason = "a list of spellings")]
fn both_say_the_same_of_every_trust_file() {
    let world = World::new();
    let bundle = pack(&world.members()).expect("packs");
    let good = trust_text();
    let pem = Authority::new().map(|authority| authority.pem("root"));
    let authority =
        |name: &str, certificate: &str| format!("{good}\n[[authority]]\n{name}\ncertificate = '''\n{certificate}'''\n");
    let edit = |from: &str, to: &str| {
        assert!(good.contains(from), "{from} is not in {good}");
        good.replacen(from, to, 1)
    };
    let mut texts: Vec<(String, Vec<u8>)> = Vec::new();
    let mut add = |what: &str, text: String| texts.push((what.to_owned(), text.into_bytes()));
    add("as it is", good.clone());
    if let Some(pem) = &pem {
        add("an authority", authority("name = \"root\"", pem));
        add("an authority with a line more", authority("name = \"root\"\nmore = 1", pem));
        add("an authority without a name", authority("", pem));
        add("an authority whose name is a number", authority("name = 1", pem));
        add("words around a certificate", authority("name = \"root\"", &format!("words\n{pem}words\n")));
        add("half a certificate", authority("name = \"root\"", &pem[..pem.len() / 2]));
        add("a certificate cut short", authority("name = \"root\"", &pem.replacen("AA", "", 1)));
        add("another label", authority("name = \"root\"", &pem.replace("CERTIFICATE", "TRUSTED CERTIFICATE")));
        let more: String =
            (0..17).map(|at| format!("[[authority]]\nname = \"{at}\"\ncertificate = '''\n{pem}'''\n")).collect();
        add("seventeen authorities", format!("{good}\n{more}"));
        let drawn = (0..40).scan(Draw(3), |draw, _| {
            let body = pem.lines().nth(1)?.as_bytes().to_vec();
            let cut = draw.below(body.len());
            Some(pem.replacen(std::str::from_utf8(&body).ok()?, std::str::from_utf8(&body[..cut]).ok()?, 1))
        });
        for (at, broken) in drawn.enumerate() {
            add(&format!("a broken certificate, {at}"), authority("name = \"root\"", &broken));
        }
    }
    add("an authority that is none", authority("name = \"root\"", "none"));
    add("an authority without a certificate", format!("{good}\n[[authority]]\nname = \"root\"\n"));
    add("an authority that is no list", format!("{good}\n[authority]\nname = \"root\"\ncertificate = \"\"\n"));
    add("an unknown table", format!("{good}\n[[witness]]\nname = \"one\"\n"));
    add("a byte order mark", format!("\u{feff}{good}"));
    add("two byte order marks", format!("\u{feff}\u{feff}{good}"));
    for length in [65_535usize, 65_536, 65_537, 70_000] {
        add(&format!("{length} bytes"), format!("{good}#{}", " ".repeat(length - good.len() - 1)));
    }
    for id in [
        "0",
        "-0",
        "-1",
        "+7",
        "7.0",
        "\"7\"",
        "true",
        "0x7",
        "0o7",
        "0b111",
        "7_0",
        "_7",
        "07",
        "9223372036854775807",
        "9223372036854775808",
        "18446744073709551615",
        "18446744073709551616",
        "1e3",
        "inf",
        "nan",
        "[7]",
        "1979-05-27",
    ] {
        add(&format!("id = {id}"), edit("id = 7", &format!("id = {id}")));
    }
    for quorum in ["0", "1", "3", "4", "-1", "1.0", "true", "\"1\"", "18446744073709551616"] {
        add(&format!("quorum = {quorum}"), edit("[chain]", &format!("[chain]\nquorum = {quorum}")));
    }
    for other in ["0", "\"false\"", "False", "true"] {
        add(
            &format!("sealed_by_exporter = {other}"),
            edit("sealed_by_exporter = false", &format!("sealed_by_exporter = {other}")),
        );
    }
    add("a line twice", edit("[chain]", "[chain]\nid = 7"));
    add("a table twice", format!("{good}\n[chain]\n"));
    add("no signers", {
        let begin = good.find("signers").expect("there");
        let end = begin + good[begin..].find(']').expect("a list") + 1;
        format!("{}signers = []{}", &good[..begin], &good[end..])
    });
    add("lines that end in two bytes", good.replace('\n', "\r\n"));
    add("lines that end in the other byte", good.replace('\n', "\r"));
    add("a zero", format!("{good}\0"));
    add("nothing", String::new());
    add("deep lists", format!("{good}more = {}{}", "[".repeat(300), "]".repeat(300)));
    for person in [
        "person = []",
        "person = {}",
        "person = [[]]",
        "person = [\"one\"]",
        "person = 1",
        &format!("person = [[\"0x{0}\", \"one\"]]", "0e".repeat(20)),
        &format!("person = [{{account = \"0x{0}\", name = \"one\"}}]", "0e".repeat(20)),
        &format!("person = [{{account = \"0x{0}\", name = 1}}]", "0e".repeat(20)),
        &format!("person = [{{account = \"{0}\", name = \"one\"}}]", "0e".repeat(20)),
        &format!("person = [{{account = \"0x{0}\", name = \"one\", key = \"{1}\"}}]", "0e".repeat(20), "ab".repeat(31)),
        &format!("person = [{{account = \"0x{0}\", name = \"one\", key = \"{1}\"}}]", "0E".repeat(20), "aB".repeat(32)),
        &format!("person = [{{account = \"0x{0}\", name = \"one\", more = 1}}]", "0e".repeat(20)),
    ] {
        add(person, format!("{person}\n{good}"));
    }
    let zero = "09".repeat(32);
    for other in
        [zero.to_uppercase(), format!("0x{zero}"), format!("0X{zero}"), format!(" {zero}"), zero[2..].to_owned()]
    {
        let line = good.lines().find(|line| line.starts_with("genesis")).expect("a line");
        add(&format!("genesis {other}"), edit(line, &format!("genesis = \"{other}\"")));
    }
    let chain = World::trust().chain;
    let list = format!(
        "chain = [{}, \"{}\", \"{}\", \"{}\", [], 1, false]\n",
        chain.id,
        chain.genesis.to_hex(),
        chain.contract,
        chain.code_hash.to_hex()
    );
    add("a list for the chain", list);
    let mut draw = Draw(11);
    for number in 0..150 {
        let changed = draw.changed(good.as_bytes(), b"[]=\"0123456789abefxX_ \n#,.tru-");
        texts.push((format!("drawn {number}"), changed));
    }
    let cases: Vec<Case> =
        texts.into_iter().map(|(what, trust)| Case { what, bundle: bundle.clone(), trust }).collect();
    assert!(cases.len() > 200, "{}", cases.len());
    let codes = agree(&some(cases, 200));
    assert!(codes.contains(&0) && codes.contains(&3), "{codes:?}");
}

fn list_of(items: &[Vec<u8>]) -> Vec<u8> {
    let mut list = RlpStream::new_list(items.len());
    items.iter().for_each(|item| {
        list.append_raw(item, 1);
    });
    list.out().to_vec()
}

/// RLP of the same, or nearly the same, in other bytes.
fn respelled(item: &[u8]) -> Vec<(&'static str, Vec<u8>)> {
    let whole = rlp::Rlp::new(item);
    let info = whole.payload_info().expect("an item");
    let (content, base) = (&item[info.header_len..], if whole.is_list() { 0xc0u8 } else { 0x80 });
    let length = u32::try_from(content.len()).expect("short").to_be_bytes();
    let long = |digits: usize| {
        let mark = base + 55 + u8::try_from(digits).expect("few");
        [&[mark][..], &length[4 - digits..], content].concat()
    };
    let mut found = vec![
        ("a length with zeros before it", long(4)),
        ("a length of three bytes", long(3)),
        ("a byte behind it", [item, &[0]].concat()),
        ("its first half", item[..item.len() / 2].to_vec()),
        ("an empty list", vec![0xc0]),
        ("an empty text", vec![0x80]),
        ("a length without a text", vec![0xb8]),
        ("a length beyond all memory", vec![0xff; 9]),
    ];
    if content.len() < 256 {
        found.push(("a length of one byte", long(1)));
    }
    if whole.is_list() {
        let items: Vec<Vec<u8>> = whole.iter().map(|one| one.as_raw().to_vec()).collect();
        for (what, other) in [
            ("a small number in two bytes", vec![0x81, 5]),
            ("a zero in place of nothing", vec![0]),
            ("a zero in two bytes", vec![0x81, 0]),
            ("a list in place of a text", vec![0xc0]),
            ("a text of five bytes", vec![0x85, 1, 2, 3, 4, 5]),
            ("a number of nine bytes", vec![0x89, 1, 2, 3, 4, 5, 6, 7, 8, 9]),
            ("deep lists", (0..40).fold(vec![0xc0], |inner, _| list_of(&[inner]))),
        ] {
            for at in 0..items.len() {
                let mut changed = items.clone();
                changed[at].clone_from(&other);
                found.push((what, list_of(&changed)));
            }
        }
        found.push(("one item less", list_of(&items[1..])));
        found.push(("one item more", list_of(&[&items[..], &[vec![0x80]]].concat())));
    } else {
        found.push(("a list of it", list_of(&[item.to_vec()])));
        found.push(("33 bytes", rlp::encode(&vec![1u8; 33]).to_vec()));
        found.push(("a zero before it", rlp::encode(&[&[0], content].concat()).to_vec()));
    }
    found
}

/// The same of what a state holds; of a root also as something that leads to it.
fn spelled(part: Part, item: &[u8]) -> Vec<(&'static str, Vec<u8>)> {
    let mut found = respelled(item);
    if part == Part::Root {
        let hash = rlp::encode(&authros_crypto::keccak256(&[item]).to_vec()).to_vec();
        let down = |own: &[u8]| list_of(&[rlp::encode(&own.to_vec()).to_vec(), hash.clone()]);
        found.extend([
            ("an extension by nothing", down(&[0])),
            ("an unknown mark", down(&[0x40])),
            ("no mark", down(&[])),
        ]);
    }
    found
}

#[test]
fn both_say_the_same_of_rlp_in_other_bytes() {
    let trust = trust_text().into_bytes();
    let mut cases = Vec::new();
    let mut add = |what: String, members: &Members| {
        cases.push(Case { what, bundle: pack(members).expect("packs"), trust: trust.clone() });
    };
    let world = World::new();
    for part in [Part::Root, Part::Account, Part::Word] {
        let (told, heard) = std::sync::mpsc::channel();
        let asked = move |at, bytes: Vec<u8>| {
            if at == part {
                told.send(spelled(part, &bytes)).expect("heard");
            }
            bytes
        };
        drop(World { respell: Box::new(asked), ..World::new() }.members());
        for (number, (what, _)) in heard.recv().expect("it was asked").into_iter().enumerate() {
            let respell = move |at, bytes: Vec<u8>| match spelled(part, &bytes).into_iter().nth(number) {
                Some((_, other)) if at == part => other,
                _ => bytes,
            };
            add(
                format!("{part:?}: {what} ({number})"),
                &World { respell: Box::new(respell), ..World::new() }.members(),
            );
        }
    }
    let members = world.members();
    for name in members.keys().filter(|name| name.starts_with("chain/")) {
        for (number, (what, bytes)) in respelled(&members[name]).into_iter().enumerate() {
            let mut changed = members.clone();
            changed.insert(name.clone(), bytes.clone());
            add(format!("{name}: {what} ({number})"), &signed(changed, &world));
            if name == "chain/40.rlp" {
                // One that nothing asks for.
                let mut more = members.clone();
                more.insert("chain/77.rlp".to_owned(), bytes);
                add(format!("a spare header: {what} ({number})"), &signed(more, &world));
            }
        }
    }
    assert!(cases.len() > 200, "{}", cases.len());
    let codes = agree(&some(cases, 150));
    assert!(codes.contains(&6), "{codes:?}");
}

/// The files that one of the two once took.
#[test]
fn neither_takes_members_as_lists_or_a_stranger_for_the_owner() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/tests/bundles");
    for name in ["members-as-arrays.authros", "partial.authros"] {
        let bundle = std::fs::read(folder.join(name)).expect("in the repository");
        let codes = agree(&[Case { what: name.to_owned(), bundle, trust: trust_text().into_bytes() }]);
        assert_ne!(codes, [0], "{name}");
    }
}

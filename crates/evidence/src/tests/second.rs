//! The second verifier, in Python, over the same truths and lies.

use std::process::{Command, Output};

use authros_crypto::compression::{self, Matrix};
use authros_crypto::record::RecordSecret;
use authros_crypto::{prove, signature_der, signer_id};
use authros_model::Token;
use authros_model::head::Compression;

use super::authority::{Authority, P256};
use super::hostile::unanchored;
use super::stamps::stamped;
use super::verifiers::{Case, agree_on};
use super::world::{BLOCK, GATEWAY, TIME, World, bound, genesis, ours, pair, sealed, sealed_as};
use crate::archive::{self, Members};
use crate::manifest::{MANIFEST, Manifest, signed_bytes};
use crate::trust::PinnedAuthority;
use crate::{Bundle, Exporter, Outcome, Packing, Person, Slot, Trust, pack, verify};

fn python(arguments: &[&str]) -> Option<Output> {
    match Command::new("python3").arg("-B").args(arguments).output() {
        Ok(output) => Some(output),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            println!("SKIPPED the second verifier: no python3");
            None
        }
        Err(error) => panic!("python3: {error}"),
    }
}

const TOOLS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tools/verify");

/// A script that has the second verifier's package, and its input, in a file, as `given`.
pub fn script(text: &str, given: &str) -> Option<Output> {
    let whole = format!("import sys\nsys.path.insert(0, {TOOLS:?})\ngiven = open(sys.argv[1]).read()\n{text}");
    let mut file = tempfile::NamedTempFile::new().expect("a file");
    std::io::Write::write_all(&mut file, given.as_bytes()).expect("written");
    python(&["-c", &whole, file.path().to_str().expect("UTF-8")])
}

fn expect_success(output: &Output) {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Both say the same about each record and about the whole.
pub fn agree(members: &Members, trust: &Trust, outcome: Outcome) {
    let trust = trust.to_text().expect("text").into_bytes();
    let told = agree_on(Case { what: "a bundle".to_owned(), bundle: pack(members).expect("packs"), trust });
    assert_eq!(told["outcome"], serde_json::to_value(outcome).expect("a word"), "{told:#}");
}

/// Who puts a bundle together is its records' owner, or pinned, or it does not hold; what nobody read is told.
#[test]
fn both_say_the_same_of_a_bundle_that_a_stranger_packed_again() {
    let (world, stranger) = (World::new(), pair());
    let stranger_packs = |account| world.packing().sign(genesis(), account, &stranger, ours()).expect("packs");
    // In the owner's name, and in her own; each record is whole.
    agree(&stranger_packs(world.owner), &World::trust(), Outcome::Incomplete);
    agree(&stranger_packs(GATEWAY), &World::trust(), Outcome::Incomplete);
    // A record of her own beside it ties her key to her account, and to nobody else's record.
    let mut both = world.packing();
    both.key(&stranger.public).expect("a point");
    let own = sealed(GATEWAY, &stranger, &world.topic_key, 9, b"her own");
    both.record(own.digest, unanchored(own)).expect("added");
    agree(
        &both.sign(genesis(), world.owner, &world.keys, ours()).expect("packs"),
        &World::trust(),
        Outcome::Incomplete,
    );
    // Whom the reader pinned may pack records of others.
    let mut pinned = World::trust();
    let key = Some(signer_id(&stranger.public));
    pinned.persons.push(Person { account: GATEWAY, name: "The gateway".into(), key });
    agree(&stranger_packs(GATEWAY), &pinned, Outcome::Holds);
    agree(&stranger_packs(world.owner), &pinned, Outcome::Incomplete);
}

#[test]
fn both_tell_of_a_page_and_of_instructions_that_nobody_checked() {
    let world = World::new();
    let mut members = world.members();
    members.insert("report.html".into(), b"<script>".to_vec());
    members.insert("VERIFY.txt".into(), b"curl somewhere | sh".to_vec());
    let exporter = Exporter { account: world.owner, key: signer_id(&world.keys.public) };
    let text = serde_json::to_vec(&Manifest::of(&members, genesis(), exporter, ours())).expect("JSON");
    let signature = ours().sign(&world.keys.secret, &signed_bytes(&text)).expect("signs");
    members.insert("manifest.der".into(), signature_der(&signature));
    members.insert(MANIFEST.into(), text);
    agree(&members, &World::trust(), Outcome::Holds);
    let file = pack(&members).expect("packs");
    let report = verify(&Bundle::parse(&file, ours()).expect("reads"), Some(&World::trust()), ours());
    let told = report.warnings.join("\n");
    assert!(told.contains("report.html was not checked") && told.contains("VERIFY.txt is not the text"), "{told}");
    let plain = world.report().warnings.join("\n");
    assert!(!plain.contains("VERIFY.txt") && !plain.contains("report.html"), "{plain}");
}

fn signed(packing: Packing, world: &World) -> Members {
    packing.sign(genesis(), world.owner, &world.keys, ours()).expect("packs")
}

#[test]
fn both_say_the_same_of_the_chain() {
    let mut own = World::trust();
    own.chain.sealed_by_exporter = true;
    agree(&World::new().members(), &World::trust(), Outcome::Holds);
    agree(&World::new().members(), &own, Outcome::Incomplete);
    for (sealers, outcome) in [
        (&[1][..], Outcome::Incomplete),
        (&[0], Outcome::Incomplete),
        (&[9, 9], Outcome::Refused),
        (&[3, 1, 2], Outcome::Holds),
    ] {
        agree(&World { sealers: sealers.to_vec(), ..World::new() }.members(), &World::trust(), outcome);
    }
    let mut vanity = [0; 32];
    vanity[..28].copy_from_slice(b"AuthROS chain file version 1");
    agree(&World { vanity, ..World::new() }.members(), &World::trust(), Outcome::Incomplete);
}

#[test]
fn both_say_the_same_of_loans() {
    let World { owner, keys, identity, .. } = World::new();
    for (until, lent, later, outcome) in [
        (0, 12, 0, Outcome::Holds),
        (TIME, 12, 0, Outcome::Refused),
        (0, 41, 0, Outcome::Refused),
        (0, 41, 9, Outcome::Incomplete),
    ] {
        let mut world = World::of(owner, keys.clone(), pair(), identity, owner);
        let mut packed = [0; 32];
        packed[31] = 1;
        for (at, field) in [until, lent, 0u64].iter().enumerate() {
            packed[23 - 8 * at..31 - 8 * at].copy_from_slice(&field.to_be_bytes());
        }
        world.put(Slot::loan(owner, &signer_id(&world.signer.public).0), packed);
        world.shown_at = BLOCK + later;
        let mut packing = world.packing();
        packing.key(&world.keys.public).expect("a point");
        agree(&signed(packing, &world), &World::trust(), outcome);
    }
}

#[test]
fn both_say_the_same_of_records_in_anothers_name() {
    let world = World::new();
    let (thief, mut lies) = (pair(), world.packing());
    lies.key(&thief.public).expect("a point");
    for seq in [3, 4] {
        let one = sealed(world.owner, &thief, &world.topic_key, seq, b"a lie");
        lies.record(one.digest, unanchored(one)).expect("added");
    }
    agree(&signed(lies, &world), &World::trust(), Outcome::Incomplete);
    let mut histories = world.packing();
    let other = sealed(world.owner, &world.keys, &world.topic_key, 3, b"another");
    histories.record(other.digest, unanchored(other)).expect("added");
    agree(&signed(histories, &world), &World::trust(), Outcome::Refused);
}

#[test]
fn both_say_the_same_of_disclosures() {
    let mut world = World::new();
    let secret = RecordSecret::of(&world.topic_key, &world.record.header);
    world.disclose(&world.keys.clone(), secret.clone());
    agree(&world.members(), &World::trust(), Outcome::Holds);
    let thief = pair();
    world.disclose(&thief, secret);
    agree(&world.members(), &World::trust(), Outcome::Refused);
    let forged = prove(ours(), &bound(), &world.owner, &thief, &pair().public, Token([5; 32])).expect("proves");
    let mut packing = world.packing();
    packing.identity(&forged);
    agree(&signed(packing, &world), &World::trust(), Outcome::Holds);
    // Packed correctly, and with a wrong length.
    let body: Vec<u8> = (0..40u8).chain([7; 300]).collect();
    let packed = compression::pack(&body, None).expect("packs").bytes;
    for (length, outcome) in
        [(body.len(), Outcome::Incomplete), (body.len() - 1, Outcome::Refused), (packed.len(), Outcome::Refused)]
    {
        let world = World::new();
        let length = length as u64;
        if packed.len() as u64 >= length {
            continue;
        }
        let one = sealed_as(world.owner, &world.keys, &world.topic_key, 9, (&packed, length, Compression::Lz4));
        let mut packing = world.packing();
        packing.disclosure(&world.disclosing([&one]));
        packing.record(one.digest, unanchored(one)).expect("added");
        agree(&signed(packing, &world), &World::trust(), outcome);
    }
}

/// Literal runs around each length at which the encoding changes, as packed here and as written by hand from the
/// format.
#[test]
fn the_second_verifier_unpacks_lz4() {
    let mut cases = Vec::new();
    for run in (1..=34usize).chain(262..=290) {
        let mut number = 1u32;
        let noise: Vec<u8> = (0..run)
            .map(|_| {
                number = number.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                number.to_be_bytes()[0]
            })
            .collect();
        for zeros in [200, 215, 470] {
            let body: Vec<u8> = noise.iter().copied().chain(std::iter::repeat_n(0, zeros)).collect();
            let packed = compression::pack(&body, None).map(|packed| packed.bytes);
            cases.extend(packed.map(|packed| (packed, body)));
        }
    }
    assert!(cases.len() > 100, "{}", cases.len());
    let given = serde_json::to_string(&cases).expect("JSON");
    let text = r"
import json
from authros_verify.errors import Refused
from authros_verify.packed import lz4
for packed, body in json.loads(given):
    assert lz4(bytes(packed), len(body)) == bytes(body), len(body)
def run(length):
    return bytes([length]) if length < 15 else bytes([15]) + bytes([255]) * ((length - 15) // 255) + bytes([(length - 15) % 255])
for length in (15, 29, 30, 31, 270, 285):
    literals = bytes(at * 7 % 251 for at in range(length))
    spelt = run(length)
    # Literals, a match of 300 from one back, and five last literals.
    block = bytes([spelt[0] << 4 | 15]) + spelt[1:] + literals + b'\1\0' + run(296)[1:] + b'\x50abcde'
    plain = literals + literals[-1:] * 300 + b'abcde'
    assert lz4(block, len(plain)) == plain, length
    for wrong, size in [(block, len(plain) + 1), (block, len(plain) - 1), (block[:-1], len(plain)), (block[:length], len(plain)),
                        (block.replace(b'\1\0' + run(296)[1:], b'\0\0' + run(296)[1:]), len(plain)),
                        (block.replace(b'\1\0' + run(296)[1:], b'\xff\xff' + run(296)[1:]), len(plain)),
                        (block, 2 ** 26 + 1), (block, len(block)), (b'', 5)]:
        try:
            lz4(wrong, size)
        except Refused:
            continue
        raise SystemExit(f'{length}: {wrong.hex()} for {size}')
";
    if let Some(output) = script(text, &given) {
        expect_success(&output);
    }
}

/// The rules of the sentences, by the examples that every verifier is given.
#[test]
fn the_second_verifier_says_the_lines_of_the_examples() {
    let text = r"
import json
from authros_verify.sentences import WORDING, verdict, wrapped
examples = json.loads(given)
assert len(examples) > 4
for example in examples:
    lists = {**{name: [] for name in WORDING['lists']}, **example['lists']}
    lines = [line for sentence in verdict(example['facts'], lists) for line in wrapped(sentence)]
    assert lines == example['lines'], (example['what'], lines)
";
    if let Some(output) = script(text, include_str!("../verdict/examples.json")) {
        expect_success(&output);
    }
}

/// Matrices of each shape, as packed here.
#[test]
fn the_second_verifier_unpacks_matrices() {
    let mut cases = Vec::new();
    for (sample, channels, big_endian, apart) in [
        (1, 1, false, 1),
        (1, 3, false, 1),
        (1, 4, false, 2),
        (2, 1, false, 1),
        (2, 3, true, 1),
        (4, 1, false, 1),
        (4, 1, true, 2),
    ] {
        let matrix = Matrix { start: 5, rows: 24, columns: 32, channels, sample, big_endian, apart };
        let length = 5 + matrix.length().expect("fits") + 3;
        // A slope with a little noise, which repeats nowhere.
        let noisy = |at: usize| (at / 7 + ((at * 2_654_435_761) >> 16) % 3) % 251;
        let body: Vec<u8> = (0..length).map(|at| u8::try_from(noisy(at)).expect("a byte")).collect();
        let packed = compression::pack(&body, Some(&matrix)).expect("pays");
        assert_eq!(packed.compression, Compression::Matrix, "{matrix:?}");
        cases.push((packed.bytes, body));
    }
    let text = r"
import json
from authros_verify.errors import Refused
from authros_verify.packed import matrix
for packed, body in json.loads(given):
    packed = bytes(packed)
    assert matrix(packed, len(body)) == bytes(body), packed[:15].hex()
    wrong = [(packed[:-1], len(body)), (packed + b'\0', len(body)), (packed, len(body) - 1), (packed, len(body) + 1), (packed[:14], len(body))]
    wrong += [(packed[:at] + bytes([packed[at] ^ 0x10]) + packed[at + 1:], len(body)) for at in (3, 7, 11, 12, 13, 14)]
    for one, length in wrong:
        try:
            found = matrix(one, length)
        except Refused:
            continue
        assert found != bytes(body), one[:15].hex()
";
    if let Some(output) = script(text, &serde_json::to_string(&cases).expect("JSON")) {
        expect_success(&output);
    }
}

#[test]
fn the_second_verifier_sees_every_flipped_byte_of_an_archive() {
    let members: Members = [("mimetype", &b"x"[..]), ("a/b", b"one"), ("a/c", &[0; 40]), ("zz", b"")]
        .map(|(name, bytes)| (name.to_owned(), bytes.to_vec()))
        .into();
    let archive = archive::write(&members).expect("written");
    let given = serde_json::to_string(&archive).expect("JSON");
    let text = r"
import json
from authros_verify.archive import unpacked
whole = bytes(json.loads(given))
assert list(unpacked(whole).values()) == [b'x', b'one', bytes(40), b'']
wrong = [whole[:at] + bytes([whole[at] ^ bit]) + whole[at + 1:] for at in range(len(whole)) for bit in (1, 32, 128)]
wrong += [whole[:at] for at in range(len(whole))] + [whole + b'more', b'more' + whole]
for one in wrong:
    try:
        unpacked(one)
    except Exception:
        continue
    raise SystemExit(f'taken: {one.hex()}')
";
    if let Some(output) = script(text, &given) {
        expect_success(&output);
    }
}

/// A Python that lacks SHA-1 or SHA-384, as some builds do, says of a stamp that it was not checked here.
#[test]
fn what_the_second_verifier_cannot_check_is_incomplete() {
    let Some(authority) = Authority::new() else { return println!("SKIPPED what cannot be checked: no openssl") };
    authority.issue(("one", P256), "root", "stamps", "");
    let authorities = vec![PinnedAuthority { name: "The notary".to_owned(), certificate: authority.pem("root") }];
    let trust = Trust { authorities, ..World::trust() };
    let (world, folder) = (World::new(), tempfile::tempdir().expect("directory"));
    let packing = stamped(&world, |imprint| authority.token(imprint, "one", "sha384"));
    let members = signed(packing, &world);
    let (file, pins) = (folder.path().join("case.authros"), folder.path().join("trust.toml"));
    std::fs::write(&file, pack(&members).expect("packs")).expect("written");
    std::fs::write(&pins, trust.to_text().expect("text")).expect("written");
    let text = r"
import hashlib, json
from authros_verify import verify
bundle, pins = json.loads(given)
whole = verify(bundle, pins)
known = hashlib.new
def poorer(name, *parts, **options):
    if name == 'sha384':
        raise ValueError(name)
    return known(name, *parts, **options)
hashlib.new = poorer
found = verify(bundle, pins)
level = found.document()['records'][0]['time']
print(json.dumps([whole.exit_code, found.exit_code, found.outcome, level['standing'], level['reason'], ' '.join(found.lines())]))
";
    let given = serde_json::json!([file, pins]).to_string();
    let Some(output) = script(text, &given) else { return };
    expect_success(&output);
    let told: (i32, i32, String, String, String, String) = serde_json::from_slice(&output.stdout).expect("JSON");
    let (whole, poorer, outcome, standing, reason, lines) = told;
    assert_eq!((whole, poorer, outcome.as_str()), (0, 9, "incomplete"));
    assert_eq!((standing.as_str(), reason.as_str()), ("unchecked", "not_checked"));
    assert!(lines.contains("not checked here"), "{lines}");
}

/// What is not a bundle, or breaks the reader, is refused in words.
#[test]
fn the_second_verifier_never_ends_in_a_traceback() {
    let folder = tempfile::tempdir().expect("directory");
    let (file, pins) = (folder.path().join("case.authros"), folder.path().join("trust.toml"));
    let start = format!(
        "import runpy, sys\nsys.path.insert(0, {TOOLS:?})\nrunpy.run_module('authros_verify', run_name='__main__')"
    );
    let run = || {
        let arguments = ["-c", &start, file.to_str().expect("UTF-8"), "--trust", pins.to_str().expect("UTF-8")];
        python(&arguments)
    };
    let good = World::trust().to_text().expect("text");
    std::fs::write(&pins, &good).expect("written");
    let mut deep = World::new().members();
    deep.insert("chain/nodes.rlp".into(), vec![0xff; 90]);
    for bytes in [b"".to_vec(), b"PK\x03\x04".to_vec(), vec![0xff; 3000], pack(&deep).expect("packs")] {
        std::fs::write(&file, bytes).expect("written");
        let Some(output) = run() else { return };
        let told = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!((output.status.code(), told.as_str()), (Some(6), ""));
        assert!(String::from_utf8_lossy(&output.stdout).starts_with("REFUSED: "));
    }
    for wrong in [
        good.replace("[chain]", "[chain]\nquorum = 0"),
        good.replace("[chain]", "[chain]\nquorum = 4"),
        good.replace("sealed_by_exporter = false", ""),
        good.replace("sealed_by_exporter = false", "sealed_by_exporter = 0"),
        good.replace("contract = \"0x", "contract = \""),
        good.replace("genesis = \"0x", "genesis = \"0x "),
        format!(
            "{good}\n[[person]]\naccount = \"0x{0}\"\nname = \"one\"\n[[person]]\naccount = \"0x{0}\"\nname = \"two\"\n",
            "0e".repeat(20)
        ),
        format!("{good}\n[[witness]]\naccount = \"0x{0}\"\nkey = \"{0}\"\nname = \"one\"\n", "0e".repeat(20)),
        "chain = 1".to_owned(),
    ] {
        assert!(Trust::parse(wrong.as_bytes()).is_err(), "{wrong}");
        std::fs::write(&pins, &wrong).expect("written");
        let Some(output) = run() else { return };
        let told = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(3), "{wrong}: {told}");
        assert!(!told.contains("Traceback"), "{told}");
    }
}

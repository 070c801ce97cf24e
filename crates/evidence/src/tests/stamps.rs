//! Level (d): stamps made by openssl, of each kind, and each lie about them.

use std::sync::OnceLock;

use authros_model::{Hash, Timestamp};
use proptest::prelude::*;

use super::authority::{Authority, P256, P384, RSA, RSA_PSS};
use super::second::{agree, script};
use super::world::{World, genesis, ours};
use crate::time::{Certificate, Request, StampTree, Stamped, TimeError, check_token, token_of};
use crate::trust::PinnedAuthority;
use crate::{Bundle, Outcome, Packing, Report, Standing, Trust, verify};

const IMPRINT: [u8; 32] = [0x5a; 32];

macro_rules! authority {
    () => {
        match Authority::new() {
            Some(authority) => authority,
            None => return println!("SKIPPED {}: no openssl", module_path!()),
        }
    };
}

fn check(token: &[u8], pinned: &Certificate) -> Result<Stamped, TimeError> {
    check_token(token, &IMPRINT, None, std::slice::from_ref(pinned))
}

/// The signed part of a token: the one octet string of its content, as openssl reads it.
fn content(authority: &Authority, token: &[u8]) -> Vec<u8> {
    authority.write("token", token);
    authority.openssl("cms -verify -noverify -binary -inform DER -in token -out content");
    authority.read("content")
}

#[test]
fn stamps_of_each_kind_of_key_are_taken() {
    let authority = authority!();
    let (root, mut told) = (authority.certificate("root"), Vec::new());
    for (name, key) in [("rsa", RSA), ("p256", P256), ("p384", P384)] {
        authority.issue((name, key), "root", "stamps", "");
        for section in ["sha256", "sha384", "sha1"] {
            let token = authority.token(IMPRINT, name, section);
            let found = check(&token, &root);
            told.push((token, found.is_ok()));
            if (section, key == RSA) == ("sha1", false) {
                // It signs with SHA-512 there.
                assert_eq!(found, Err(TimeError::Algorithm("ECDSA with SHA-512")), "{name}");
                continue;
            }
            assert_eq!(found.map(|found| (found.signer, found.pinned)), Ok((name.to_owned(), Some(0))), "{section}");
        }
    }
    // First, or its certificate may begin after the second in which the content says it was made.
    authority.issue(("pss", RSA_PSS), "root", "stamps", "");
    let signed = content(&authority, &authority.token(IMPRINT, "rsa", "sha256"));
    let way = "-cades -keyopt rsa_padding_mode:pss -keyopt rsa_pss_saltlen:";
    for name in ["rsa", "pss"] {
        for (hash, salt) in [("sha256", 32), ("sha384", 48), ("sha512", 64)] {
            let token = authority.signed(&signed, name, &format!("-md {hash} {way}{salt}"));
            assert_eq!(check(&token, &root).map(|found| found.pinned), Ok(Some(0)), "{name} {hash}");
            told.push((token, true));
        }
        let token = authority.signed(&signed, name, &format!("-md sha256 {way}20"));
        assert!(matches!(check(&token, &root), Err(TimeError::Algorithm(_))), "another salt");
        told.push((token, false));
    }
    let (tokens, expected): (Vec<_>, Vec<bool>) = told.into_iter().unzip();
    let given: Vec<_> = tokens.into_iter().map(|token| (token, IMPRINT, authority.pem("root"))).collect();
    assert!(by_the_second(&given).is_none_or(|found| found == expected), "{expected:?}");
}

#[test]
fn the_way_leads_to_whichever_certificate_of_it_is_pinned() {
    let authority = authority!();
    authority.root("pssroot", RSA, "another root");
    authority.issue(("middle", RSA), "pssroot", "ca", "-sigopt rsa_padding_mode:pss -sigopt rsa_pss_saltlen:32");
    authority.issue(("own", P256), "middle", "stamps", "");
    let request = Request { imprint: IMPRINT, nonce: [0xff; 16] };
    let answer = authority.answer(&request.encode(), "own", "sha256", "-chain middle.pem");
    let token = token_of(&answer).expect("granted");
    for name in ["own", "middle", "pssroot"] {
        let pinned = [authority.certificate("root"), authority.certificate(name)];
        let found = check_token(token, &IMPRINT, Some(&request), &pinned);
        assert_eq!(found.and_then(|found| found.by_pinned()), Ok(1), "{name}");
    }
    let stranger = check(token, &authority.certificate("root")).expect("well made");
    assert_eq!((stranger.pinned, stranger.by_pinned()), (None, Err(TimeError::NotPinned("own".to_owned()))));
    // Another root that took the name, and an intermediate that may not issue.
    authority.root("liar", RSA, "another root");
    assert_eq!(check(token, &authority.certificate("liar")), Err(TimeError::Forged("middle".to_owned())));
    authority.issue(("nobody", P256), "root", "plain", "");
    authority.issue(("below", P256), "nobody", "stamps", "");
    let answer = authority.answer(&request.encode(), "below", "sha256", "-chain nobody.pem");
    let found = check(token_of(&answer).expect("granted"), &authority.certificate("root"));
    assert_eq!(found, Err(TimeError::NotAnIssuer("nobody".to_owned())));
}

#[test]
fn each_lie_about_a_stamp_is_refused_for_its_own_reason() {
    let authority = authority!();
    let root = authority.certificate("root");
    for (name, extensions) in
        [("good", "stamps"), ("plain", "plain"), ("loose", "loose"), ("both", "both"), ("odd", "odd")]
    {
        authority.issue((name, P256), "root", extensions, "");
    }
    let request = Request { imprint: IMPRINT, nonce: [9; 16] };
    let answer = authority.answer(&request.encode(), "good", "sha256", "");
    let token = token_of(&answer).expect("granted");
    let judged = |imprint: [u8; 32], request: &Request| {
        check_token(token, &imprint, Some(request), std::slice::from_ref(&root)).map(|found| found.pinned)
    };
    assert_eq!(judged(IMPRINT, &request), Ok(Some(0)));
    assert_eq!(judged([1; 32], &request), Err(TimeError::OtherImprint));
    assert_eq!(judged(IMPRINT, &Request { nonce: [8; 16], ..request }), Err(TimeError::OtherNonce));

    let signed = content(&authority, token);
    let by = |name: &str| check(&authority.signed(&signed, name, "-md sha256 -cades"), &root);
    assert_eq!(by("good").map(|found| found.pinned), Ok(Some(0)), "the same content signed by hand");
    for name in ["plain", "loose", "both"] {
        assert_eq!(by(name), Err(TimeError::NotForStamps), "{name}");
    }
    assert_eq!(by("odd"), Err(TimeError::Critical("odd".to_owned())));
    let unnamed = authority.signed(&signed, "good", "-md sha256");
    assert_eq!(check(&unnamed, &root), Err(TimeError::OtherCertificate));
    let bare = authority.signed(&signed, "good", "-md sha256 -cades -nocerts");
    assert_eq!(check(&bare, &root), Err(TimeError::NoCertificate));
    assert_eq!(check(&bare, &authority.certificate("good")).map(|found| found.pinned), Ok(Some(0)), "pinned itself");

    // Ten years later, by somebody who holds the key.
    let year = signed.windows(3).position(|three| three == b"\x18\x0f2").expect("a time") + 4;
    let mut late = signed.clone();
    late[year + 1] += 1;
    let late = authority.signed(&late, "good", "-md sha256 -cades");
    assert!(matches!(check(&late, &root), Err(TimeError::NotValid { .. })), "{:?}", check(&late, &root));

    authority.openssl("ts -query -data settings -sha512 -cert -out other");
    let answer = authority.answer(&authority.read("other"), "good", "sha256", "");
    assert_eq!(check(token_of(&answer).expect("granted"), &root), Err(TimeError::ImprintHash));
    // This section does not accept SHA-512: a refusal in the authority's own words.
    let answer = authority.answer(&authority.read("other"), "good", "sha384", "");
    assert!(matches!(token_of(&answer), Err(TimeError::NotGranted { status: 2, .. })), "{:?}", token_of(&answer));
    assert!(matches!(check(b"no token", &root), Err(TimeError::Form { .. })));
}

/// What a stranger may send as a stamp: what we say, and what openssl's own `ts -verify` says with the same pin. Where it is
/// more lenient, the last column says so.
#[test]
fn openssl_judges_stamps_as_we_do() {
    let authority = authority!();
    let of_root =
        [("good", "stamps"), ("middle", "ca"), ("leaf", "plain"), ("both", "both"), ("odd", "odd"), ("names", "names")];
    of_root.iter().for_each(|(name, extensions)| authority.issue((name, P256), "root", extensions, ""));
    [("below", "middle"), ("child", "leaf"), ("named", "names")]
        .iter()
        .for_each(|(name, by)| authority.issue((name, P256), by, "stamps", ""));
    authority.root("liar", P256, "the root");
    let request = Request { imprint: IMPRINT, nonce: [7; 16] }.encode();
    let through = |name: &str, by: &str| {
        let answer = authority.answer(&request, name, "sha256", &format!("-chain {by}.pem"));
        token_of(&answer).expect("granted").to_vec()
    };
    let good = authority.token(IMPRINT, "good", "sha256");
    let signed = content(&authority, &good);
    let by_hand = |name: &str, more: &str| authority.signed(&signed, name, &format!("{more} -cades"));
    let mut flipped = good.clone();
    flipped[good.len() - 9] ^= 1;
    let cases = [
        ("honest", good.clone(), IMPRINT, "root", true, true),
        ("through an intermediate", through("below", "middle"), IMPRINT, "root", true, true),
        ("the signer itself pinned", good.clone(), IMPRINT, "good", true, true),
        ("somebody else pinned", good.clone(), IMPRINT, "middle", false, false),
        ("an unknown critical extension", by_hand("odd", "-md sha256"), IMPRINT, "root", false, false),
        ("constraints of names", through("named", "names"), IMPRINT, "root", false, true),
        ("a leaf as issuer", through("child", "leaf"), IMPRINT, "root", false, false),
        ("another imprint", good.clone(), [1; 32], "root", false, false),
        ("signed over SHA-1", by_hand("good", "-md sha1"), IMPRINT, "root", false, true),
        ("a root of the same name", good.clone(), IMPRINT, "liar", false, false),
        ("a purpose too many", by_hand("both", "-md sha256"), IMPRINT, "root", false, false),
        ("a flipped bit", flipped, IMPRINT, "root", false, false),
        ("a trailing byte", [&good[..], &[0]].concat(), IMPRINT, "root", false, true),
    ];
    let told = cases.iter().map(|(name, token, imprint, pin, ..)| {
        let found = check_token(token, imprint, None, &[authority.certificate(pin)]);
        (*name, found.and_then(|found| found.by_pinned()).is_ok(), authority.accepts(token, *imprint, pin))
    });
    let expected = cases.iter().map(|(name, .., ours, theirs)| (*name, *ours, *theirs));
    assert_eq!(told.collect::<Vec<_>>(), expected.collect::<Vec<_>>());
    let given: Vec<_> =
        cases.iter().map(|(_, token, imprint, pin, ..)| (token.clone(), *imprint, authority.pem(pin))).collect();
    let expected: Vec<bool> = cases.iter().map(|(.., ours, _)| *ours).collect();
    assert!(by_the_second(&given).is_none_or(|found| found == expected), "{expected:?}");
}

/// Whether the second verifier takes each of these tokens for a stamp over its imprint by what is pinned.
fn by_the_second(cases: &[(Vec<u8>, [u8; 32], String)]) -> Option<Vec<bool>> {
    let text = r"
import json
from authros_verify.certificates import from_pem
from authros_verify.stamps import check_token
def is_taken(token, imprint, pin):
    try:
        return check_token(bytes(token), bytes(imprint), [from_pem(pin)])[2] == 0
    except ValueError:
        return False
print(json.dumps([is_taken(*one) for one in json.loads(given)]))
";
    let output = script(text, &serde_json::to_string(cases).expect("JSON"))?;
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(serde_json::from_slice(&output.stdout).expect("a list"))
}

#[test]
fn every_flipped_byte_of_a_token_is_refused() {
    let authority = authority!();
    let root = authority.certificate("root");
    for (name, key) in [("rsa", RSA), ("p256", P256)] {
        authority.issue((name, key), "root", "stamps", "");
        let token = authority.token(IMPRINT, name, "sha256");
        assert_eq!(check(&token, &root).map(|found| found.pinned), Ok(Some(0)));
        for at in 0..token.len() {
            for mask in [0x01, 0x20, 0x80] {
                let mut changed = token.clone();
                changed[at] ^= mask;
                assert!(check(&changed, &root).is_err(), "{name}: byte {at} by {mask:#x}");
            }
            assert!(check(&token[..at], &root).is_err(), "cut at {at}");
        }
    }
}

/// A token and its pin, made once.
fn sample() -> Option<&'static (Vec<u8>, Certificate)> {
    static SAMPLE: OnceLock<Option<(Vec<u8>, Certificate)>> = OnceLock::new();
    let make = || {
        let authority = Authority::new()?;
        authority.issue(("one", P256), "root", "stamps", "");
        Some((authority.token(IMPRINT, "one", "sha256"), authority.certificate("root")))
    };
    SAMPLE.get_or_init(make).as_ref()
}

proptest! {
    #[test]
    fn nothing_but_the_token_itself_is_taken(
        changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0u8..3), 1..4),
        noise in proptest::collection::vec(any::<u8>(), 0..200),
    ) {
        let Some((token, root)) = sample() else { return Ok(()) };
        prop_assert!(check(&noise, root).is_err());
        prop_assert!(token_of(&noise).is_err());
        drop(Certificate::parse(&noise));
        let mut changed = token.clone();
        for (at, byte, kind) in changes {
            let at = at.index(changed.len());
            match kind {
                0 => changed[at] = byte,
                1 => changed.insert(at, byte),
                _ => drop(changed.remove(at)),
            }
        }
        prop_assert_eq!(check(&changed, root).is_ok(), &changed == token);
    }
}

/// A bundle whose batch was stamped between two others.
pub fn stamped(world: &World, token: impl FnOnce([u8; 32]) -> Vec<u8>) -> Packing {
    let root = world.claim.inclusion().expect("a batch").root;
    let tree = StampTree::new(vec![Hash([1; 32]), root, Hash([2; 32])]).expect("a tree");
    let mut packing = world.packing();
    packing.stamps(&tree, &[root, Hash([9; 32])], &[token(tree.imprint())]).expect("added");
    packing
}

fn judged(world: &World, packing: Packing, trust: &Trust) -> Report {
    let members = packing.sign(genesis(), world.owner, &world.keys, ours()).expect("packs");
    verify(&Bundle::of_members(&members, ours()).expect("reads"), Some(trust), ours())
}

fn pinned(authority: &Authority, name: &str) -> Trust {
    let authorities = vec![PinnedAuthority { name: "The notary".to_owned(), certificate: authority.pem(name) }];
    let trust = Trust { authorities, ..World::trust() };
    Trust::parse(trust.to_text().expect("written").as_bytes()).expect("read again")
}

#[test]
fn a_record_existed_before_its_stamp() {
    let authority = authority!();
    authority.issue(("one", P384), "root", "stamps", "");
    let world = World::new();
    let packing = stamped(&world, |imprint| authority.token(imprint, "one", "sha256"));
    let trust = pinned(&authority, "root");
    let members = packing.sign(genesis(), world.owner, &world.keys, ours()).expect("packs");
    agree(&members, &trust, Outcome::Holds);
    let report = judged(&world, Packing::from(members), &trust);
    let record = &report.records[0];
    assert_eq!((record.time.standing, report.outcome), (Standing::Proven, Outcome::Holds), "{}", record.time.text);
    // openssl's own reading of the time, with the second and a half of accuracy it gives.
    let text = String::from_utf8(authority.openssl("ts -reply -in answer -text")).expect("text");
    let time = text.lines().find_map(|line| line.strip_prefix("Time stamp: ")).expect("a time");
    let date = std::process::Command::new("date").args(["-u", "-d", time, "+%s"]).output().expect("date").stdout;
    let seconds: u64 = String::from_utf8(date).expect("text").trim().parse().expect("seconds");
    let before = Timestamp::from_seconds(seconds + 2);
    assert_eq!(record.existed_before, Some(before));
    assert!(record.time.text.starts_with(&format!("existed before {before}, by the time stamp of The notary")));
    assert!(record.time.text.contains("revocation is not checked"));

    let unpinned =
        judged(&world, stamped(&world, |_| authority.token(other(&world), "one", "sha256")), &World::trust());
    let record = &unpinned.records[0];
    assert_eq!((record.time.standing, record.existed_before), (Standing::Unproven, None));
    assert!(record.time.text.contains("by one, whom you did not pin"), "{}", record.time.text);
    assert_eq!(unpinned.outcome, Outcome::Holds, "(d) is not needed");
}

/// The imprint of [`stamped`].
fn other(world: &World) -> [u8; 32] {
    let root = world.claim.inclusion().expect("a batch").root;
    StampTree::new(vec![Hash([1; 32]), root, Hash([2; 32])]).expect("a tree").imprint()
}

#[test]
fn a_stamp_over_something_else_is_refused_and_an_absent_one_is_told() {
    let authority = authority!();
    authority.issue(("one", P256), "root", "stamps", "");
    let (world, trust) = (World::new(), pinned(&authority, "root"));
    let told = |packing: Packing| {
        let report = judged(&world, packing, &trust);
        (report.records[0].time.standing, report.records[0].time.text.clone(), report.outcome)
    };
    let (standing, text, outcome) = told(stamped(&world, |_| authority.token(IMPRINT, "one", "sha256")));
    assert_eq!((standing, outcome), (Standing::Refused, Outcome::Refused));
    assert!(text.contains("stamps something else"), "{text}");
    let (standing, text, outcome) = told(world.packing());
    assert_eq!((standing, outcome), (Standing::Absent, Outcome::Holds), "{text}");

    // A root that the stamp does not cover, inserted with the path of another.
    let mut members = stamped(&world, |imprint| authority.token(imprint, "one", "sha256"))
        .sign(genesis(), world.owner, &world.keys, ours())
        .expect("packs");
    let name = members.keys().find(|name| name.ends_with("roots.json")).expect("roots").clone();
    let text = String::from_utf8(members[&name].clone()).expect("text").replace("\"index\": 1", "\"index\": 0");
    members.insert(name, text.into_bytes());
    let lie = Packing::from(members.clone()).sign(genesis(), world.owner, &world.keys, ours()).expect("packs");
    agree(&lie, &trust, Outcome::Refused);
    let (standing, text, _) = told(Packing::from(members));
    assert_eq!(standing, Standing::Refused);
    assert!(text.contains("does not lead to what was stamped"), "{text}");
}

#[test]
fn stamps_that_are_not_of_their_form_are_no_bundle() {
    let world = World::new();
    let packing = || stamped(&world, |_| vec![0x30, 0]);
    let sign = |packing: Packing| packing.sign(genesis(), world.owner, &world.keys, ours()).expect("packs");
    let members = sign(packing());
    assert!(Bundle::of_members(&members, ours()).is_ok());
    let folder = members.keys().find_map(|name| name.strip_suffix("/roots.json")).expect("a stamp").to_owned();
    let token = members
        .keys()
        .find(|name| name.strip_prefix(&folder).is_some_and(|rest| rest.contains(".der")))
        .expect("a token")
        .clone();
    let with = |change: &dyn Fn(&mut crate::archive::Members)| {
        let mut members = members.clone();
        change(&mut members);
        let error = Bundle::of_members(&sign(Packing::from(members)), ours()).expect_err("refused");
        error.why
    };
    let roots = format!("{folder}/roots.json");
    assert!(with(&|members| drop(members.remove(&roots))).contains("missing"));
    assert!(with(&|members| drop(members.remove(&token))).contains("no token"));
    assert!(with(&|members| drop(members.insert(token.clone(), vec![1]))).contains("SHA-256"));
    let edited = |from: &'static str, to: &'static str| {
        with(&|members| {
            let text = String::from_utf8(members[&roots].clone()).expect("text").replacen(from, to, 1);
            members.insert(roots.clone(), text.into_bytes());
        })
    };
    assert!(edited("\"count\": 3", "\"count\": 4").contains("another stamp's imprint"));
    assert!(edited("authros-stamp/1", "authros-stamp/2").contains("form"));
    assert!(edited("\"count\": 3", "\"count\": 30000").contains("more than"));
}

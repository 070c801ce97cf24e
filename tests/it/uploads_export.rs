//! An exported record is checked with OpenSSL alone: its digest, its signer, its signature.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;
use support::member::Member;
use support::process::output_of;
use support::{Home, Outcome, Running, hex, list, skipped, system_program, text, unhex};

/// The signed bytes: this label, the domain, the digest.
const LABEL: &[u8] = b"AuthROS/signature/1";

struct Exported {
    home: Home,
    directory: PathBuf,
    record: Value,
    signer: String,
    address: String,
}

fn export_one(provider: &str) -> Exported {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1", "--crypto-provider", provider]);
    let address = authros.enrol();
    let signer = text(&authros.json(&["identity", "show"]), "signing_key");
    authros.capture(&["/robot1/odom"], 2);
    let records = authros.records(&["records", "list", "--oldest"]);
    let record = records.into_iter().next_back().expect("a record");
    let directory = home.root().join("export");
    let place = directory.to_str().expect("UTF-8");
    authros.run(&["records", "export", &text(&record, "id"), "--dir", place, "--addresses"]).expect_code(0);
    Exported { home, directory, record, signer, address }
}

impl Exported {
    fn path(&self, name: &str) -> String {
        self.directory.join(name).to_str().expect("UTF-8").to_owned()
    }

    fn read(&self, name: &str) -> Vec<u8> {
        fs::read(self.directory.join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    fn verify(&self, message: &[u8], signature: &[u8]) -> Outcome {
        fs::write(self.directory.join("message"), message).expect("written");
        fs::write(self.directory.join("signature.der"), der(signature)).expect("written");
        let mut command = Command::new("openssl");
        command.args([
            "pkeyutl",
            "-verify",
            "-pubin",
            "-rawin",
            "-digest",
            "sm3",
            "-pkeyopt",
            "distid:1234567812345678",
        ]);
        command.args(["-inkey", &self.path("signer.pem"), "-in", &self.path("message")]);
        command.args(["-sigfile", &self.path("signature.der")]);
        Running::start(command).wait(30)
    }
}

/// OpenSSL reads signatures as DER; a raw r || s of 64 bytes is converted first.
fn der(signature: &[u8]) -> Vec<u8> {
    if signature.len() != 64 {
        return signature.to_vec();
    }
    let integer = |bytes: &[u8]| {
        let start = bytes.iter().position(|&byte| byte != 0).expect("not zero");
        let mut value = bytes[start..].to_vec();
        if value[0] >= 0x80 {
            value.insert(0, 0);
        }
        [vec![2, u8::try_from(value.len()).expect("at most 33")], value].concat()
    };
    let body = [integer(&signature[..32]), integer(&signature[32..])].concat();
    [vec![0x30, u8::try_from(body.len()).expect("at most 70")], body].concat()
}

fn sm3_of(path: &Path) -> String {
    let output = output_of("openssl", &["dgst", "-sm3", "-r", path.to_str().expect("UTF-8")]);
    output.split_whitespace().next().expect("a digest").to_owned()
}

fn expect_openssl_agrees(provider: &str) {
    let exported = export_one(provider);
    let digest = text(&exported.record, "digest");
    assert_eq!(sm3_of(&exported.directory.join("record.bin")), digest, "SM3 of the file is the digest on the chain");
    assert_eq!(exported.read("record.bin")[0], 0x89, "a record begins with its magic");

    let public = exported.path("public.der");
    output_of("openssl", &["pkey", "-pubin", "-in", &exported.path("signer.pem"), "-outform", "DER", "-out", &public]);
    let public = exported.read("public.der");
    assert_eq!(hex(&public[public.len() - 64..]), exported.signer, "the signer is the owner");

    let proof: Value = serde_json::from_slice(&exported.read("proof.json")).expect("the proof is JSON");
    let message = unhex(&text(&proof, "signed_message_hex"));
    assert_eq!(message.len(), LABEL.len() + 64, "label, domain and digest");
    assert!(message.starts_with(LABEL) && message.ends_with(&unhex(&digest)), "{proof}");
    for told in [&digest, &text(&exported.record, "transaction"), &exported.address] {
        assert!(proof.to_string().contains(told.as_str()), "the proof names {told}: {proof}");
    }

    let signature = exported.read("signature.bin");
    exported.verify(&message, &signature).expect_code(0);
    for position in [0, LABEL.len(), message.len() - 1] {
        let mut changed = message.clone();
        changed[position] ^= 1;
        let outcome = exported.verify(&changed, &signature);
        assert!(outcome.code != Some(0), "byte {position} changed: {outcome}");
    }
}

#[test]
fn openssl_checks_digest_and_signature_of_an_exported_record() {
    if system_program("openssl").is_none() {
        skipped!("no openssl");
    }
    expect_openssl_agrees("authros");
}

#[test]
fn openssl_checks_what_libsm_sealed_and_signed() {
    if system_program("openssl").is_none() {
        skipped!("no openssl");
    }
    expect_openssl_agrees("libsm");
}

#[test]
fn an_unknown_record_is_not_exported() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "0"]);
    authros.enrol();
    let directory = home.root().join("export");
    let outcome = authros.run(&["records", "export", "0123456789ab", "--dir", directory.to_str().expect("UTF-8")]);
    assert!(matches!(outcome.code, Some(3 | 6)), "{outcome}");
    assert!(!directory.join("record.bin").exists());
}

#[test]
fn a_record_shows_its_way_from_message_to_verified() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]);
    authros.enrol();
    authros.capture(&["/robot1/camera/compressed"], 1);
    let records = authros.records(&["records", "list", "--oldest"]);
    assert_eq!(records.len(), 1);
    let record = &records[0];
    assert_eq!(
        (&record["kind"], &record["state"], &record["simulated"]),
        (&"data".into(), &"verified, names unchecked".into(), &true.into())
    );
    assert_eq!(
        (&record["topic"], &record["type"]),
        (&"/robot1/camera/compressed".into(), &"sensor_msgs/CompressedImage".into())
    );
    assert!(
        record["bytes"].as_u64().is_some_and(|bytes| (20_000..200_000).contains(&bytes)),
        "a real picture: {record}"
    );
    assert!(record["block"].is_u64() && unhex(&text(record, "transaction")).len() == 32, "{record}");

    let definitions = authros.records(&["records", "list", "--oldest", "--kind", "definition"]);
    assert_eq!(definitions.len(), 1, "the definition travels once, as a record of its own");
    assert_eq!((&definitions[0]["seq"], &record["seq"]), (&1.into(), &2.into()), "and before its first use");

    let shown = authros.json(&["records", "show", &text(record, "id")]);
    assert_eq!(shown["digest"], record["digest"]);
    let steps = list(&shown, "steps");
    assert!(steps.len() >= 4 && steps.last().is_some_and(|step| step.to_string().contains("verified")), "{shown}");
}

#[test]
fn a_second_reader_written_from_the_document_opens_and_checks_a_record() {
    let Some(python) = system_program("python3") else { skipped!("no python3") };
    let exported = export_one("rustcrypto");
    let proof: Value = serde_json::from_slice(&exported.read("proof.json")).expect("JSON");
    let member = Member::of(&exported.home, "default", text(&proof, "domain").parse().expect("a domain"));
    let (epoch, index) = (hex(member.epoch_key().expose()), hex(member.index().expose()));
    let read = || {
        let mut command = Command::new(&python);
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/support/second_reader.py");
        command.args(["-B", script]).arg(&exported.directory).args([&epoch, &index]);
        Running::start(command).wait(120)
    };
    let found = read().expect_code(0).document();
    let out = exported.path("message");
    let id = text(&exported.record, "id");
    exported.home.authros().run(&["records", "open", &id, "--out", &out]).expect_code(0);
    assert_eq!(text(&found, "body"), hex(&exported.read("message")), "the same message");
    assert_eq!((&found["digest"], &found["seq"]), (&exported.record["digest"], &exported.record["seq"]), "{found}");
    let head = &found["head"];
    assert_eq!((&head["topic"], &head["type"]), (&exported.record["topic"], &exported.record["type"]), "{found}");
    assert_eq!((&head["plain_length"], &head["tags"]["simulated"]), (&exported.record["bytes"], &"true".into()));
    assert_eq!(found["anchor"], "batch", "its path was walked: {found}");

    let mut record = exported.read("record.bin");
    let last = record.len() - 1;
    record[last] ^= 1;
    fs::write(exported.path("record.bin"), record).expect("written");
    assert_ne!(read().code, Some(0), "an altered record is refused");
}

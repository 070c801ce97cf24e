//! Cross-checks with the openssl command, in both directions. Without it each test says that it was skipped.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use super::keyfile::{load_sm2, sm2_pem, sm2_public_from_pem, sm2_public_pem};
use super::private_file::write_private;
use super::record::{signed_bytes, tests::Sample};
use super::{ProviderName, SmKeyPair, provider, signature_der, signature_from_der, sm3};
use crate::model::bytes::hex;
use crate::model::{Digest, Domain};

const ID: [&str; 6] = ["-rawin", "-digest", "sm3", "-pkeyopt", "distid:1234567812345678", "-in"];

fn is_missing(test: &str) -> bool {
    let missing = Command::new("openssl").arg("version").output().is_err();
    if missing {
        println!("SKIPPED {test}: openssl is not installed");
    }
    missing
}

fn openssl(directory: &Path, arguments: &[&str]) -> Output {
    Command::new("openssl").args(arguments).current_dir(directory).output().expect("openssl runs")
}

fn succeeds(directory: &Path, arguments: &[&str]) -> String {
    let output = openssl(directory, arguments);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{arguments:?}: {text}{}", String::from_utf8_lossy(&output.stderr));
    text
}

fn pair() -> SmKeyPair {
    SmKeyPair::generate(provider(ProviderName::RustCrypto)).expect("pair")
}

#[test]
fn openssl_digest_of_a_blob_is_the_anchored_one() {
    if is_missing("openssl_digest_of_a_blob_is_the_anchored_one") {
        return;
    }
    let directory = tempfile::tempdir().expect("directory");
    let record = Sample::new(ProviderName::RustCrypto, b"the message").seal();
    fs::write(directory.path().join("record.bin"), &record.blob).expect("writes");
    let text = succeeds(directory.path(), &["dgst", "-sm3", "record.bin"]);
    assert!(text.trim().ends_with(&record.digest.to_hex()), "{text}");
}

#[test]
fn openssl_verifies_what_is_signed_here() {
    if is_missing("openssl_verifies_what_is_signed_here") {
        return;
    }
    let directory = tempfile::tempdir().expect("directory");
    let pair = pair();
    let message = signed_bytes(&Domain([1; 32]), &Digest([2; 32]));
    fs::write(directory.path().join("message"), &message).expect("writes");
    fs::write(directory.path().join("signer.pem"), sm2_public_pem(&pair.public).expect("pem")).expect("writes");
    for name in ProviderName::ALL {
        let signature = provider(name).sign(&pair.secret, &message).expect("signs");
        fs::write(directory.path().join("signature.der"), signature_der(&signature)).expect("writes");
        let arguments = [
            &["pkeyutl", "-verify", "-pubin", "-inkey", "signer.pem"][..],
            &ID,
            &["message", "-sigfile", "signature.der"],
        ];
        succeeds(directory.path(), &arguments.concat());
        let arguments =
            ["dgst", "-sm3", "-verify", "signer.pem", "-sigopt", ID[4], "-signature", "signature.der", "message"];
        succeeds(directory.path(), &arguments);
        fs::write(directory.path().join("message"), b"another").expect("writes");
        assert!(!openssl(directory.path(), &arguments).status.success());
        fs::write(directory.path().join("message"), &message).expect("writes");
    }
}

#[test]
fn openssl_signs_with_an_exported_key_what_verifies_here() {
    if is_missing("openssl_signs_with_an_exported_key_what_verifies_here") {
        return;
    }
    let directory = tempfile::tempdir().expect("directory");
    let pair = pair();
    write_private(&directory.path().join("key.pem"), sm2_pem(&pair.secret).expect("pem").as_bytes()).expect("writes");
    let text = succeeds(directory.path(), &["pkey", "-in", "key.pem", "-noout", "-text"]);
    let shown: String = text.chars().filter(char::is_ascii_hexdigit).collect();
    assert!(shown.contains(&hex(pair.secret.expose())), "openssl reads the same number");
    fs::write(directory.path().join("message"), b"signed by openssl").expect("writes");
    let arguments = [&["pkeyutl", "-sign", "-inkey", "key.pem"][..], &ID, &["message", "-out", "signature.der"]];
    succeeds(directory.path(), &arguments.concat());
    let signature = signature_from_der(&fs::read(directory.path().join("signature.der")).expect("reads")).expect("DER");
    for name in ProviderName::ALL {
        provider(name).verify(&pair.public, b"signed by openssl", &signature).expect("valid");
        assert!(provider(name).verify(&pair.public, b"signed by nobody", &signature).is_err());
    }
}

#[test]
fn openssl_keys_are_loaded_and_its_ciphertexts_opened() {
    if is_missing("openssl_keys_are_loaded_and_its_ciphertexts_opened") {
        return;
    }
    let directory = tempfile::tempdir().expect("directory");
    succeeds(directory.path(), &["genpkey", "-algorithm", "SM2", "-out", "key.pem"]);
    succeeds(directory.path(), &["pkey", "-in", "key.pem", "-pubout", "-out", "public.pem"]);
    let secret = load_sm2(&directory.path().join("key.pem")).expect("loads");
    let text = fs::read_to_string(directory.path().join("public.pem")).expect("reads");
    let public = sm2_public_from_pem(&text).expect("parses");
    assert_eq!(sm2_public_pem(&public).expect("encodes"), text, "the same PEM as openssl's");
    fs::write(directory.path().join("plain"), b"for your eyes").expect("writes");
    succeeds(
        directory.path(),
        &["pkeyutl", "-encrypt", "-pubin", "-inkey", "public.pem", "-in", "plain", "-out", "sealed"],
    );
    let sealed = fs::read(directory.path().join("sealed")).expect("reads");
    for name in ProviderName::ALL {
        let provider = provider(name);
        assert_eq!(&**provider.decrypt(&secret, &sealed).expect("decrypts"), b"for your eyes");
        fs::write(directory.path().join("back"), provider.encrypt(&public, b"and back").expect("encrypts"))
            .expect("writes");
        let text = succeeds(directory.path(), &["pkeyutl", "-decrypt", "-inkey", "key.pem", "-in", "back"]);
        assert_eq!(text, "and back");
    }
}

#[test]
fn openssl_hashes_alike_at_every_length() {
    if is_missing("openssl_hashes_alike_at_every_length") {
        return;
    }
    let directory = tempfile::tempdir().expect("directory");
    for length in [0usize, 1, 55, 56, 63, 64, 65, 1000, 100_000] {
        let data = vec![0x5a; length];
        fs::write(directory.path().join("data"), &data).expect("writes");
        let text = succeeds(directory.path(), &["dgst", "-sm3", "-r", "data"]);
        assert!(text.starts_with(&hex(&sm3::sm3(&[&data]))), "{length}: {text}");
    }
}

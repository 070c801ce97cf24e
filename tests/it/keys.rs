//! Keys: listed without secrets, loaded from files, rotated into epochs, exported for other programs.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;
use std::os::unix::fs::PermissionsExt;

use serde_json::Value;
use support::process::output_of;
use support::{Authros, Home, hex, list, skipped, system_program, text};

/// The published key and address of the first development account.
const KNOWN_EOA: &str = "ac0974bec39a17e36ba4a6b4d238ff944bacb478cbed5efcae784d7bf4f2ff80";
const KNOWN_ADDRESS: &str = "0xf39Fd6e51aad88F6F4ce6aB8827279cffFb92266";

/// The PBKDF2 vector of the Web3 Secret Storage definition.
const PBKDF2: &str = r#"{"crypto":{"cipher":"aes-128-ctr","cipherparams":{"iv":"6087dab2f9fdbbfaddc31a909735c1e6"},
    "ciphertext":"5318b4d5bcd28de64ee5559e671353e16f075ecae9f99c7a79a38af5f869aa46","kdf":"pbkdf2",
    "kdfparams":{"c":262144,"dklen":32,"prf":"hmac-sha256",
    "salt":"ae3cd4e7013836a3df6bd7241b12db061dbe2c6785853cce422d148a624ce0bd"},
    "mac":"517ead924a9d0dc3124507e3393d175ce3ff7c1e96529c6c555ce9e51205e9b2"},"version":3}"#;

fn quiet(home: &Home) -> Authros {
    home.authros().with(&["--robots", "0"])
}

fn current_epochs(keys: &Value) -> Vec<Value> {
    list(keys, "epochs").into_iter().filter(|epoch| epoch["current"] == true).collect()
}

/// x || y of a key file, as read by OpenSSL.
fn public_key(pem: &str) -> String {
    let der = format!("{pem}.der");
    output_of("openssl", &["pkey", "-in", pem, "-pubout", "-outform", "DER", "-out", &der]);
    let der = fs::read(der).expect("written by openssl");
    hex(&der[der.len() - 64..])
}

#[test]
fn a_rotation_begins_a_new_epoch_and_keeps_the_old_one() {
    let home = Home::new();
    let authros = quiet(&home);
    authros.enrol();
    let before = authros.json(&["keys", "list"]);
    assert_eq!(list(&before, "epochs").len(), 1, "{before}");
    let rotated = authros.json(&["keys", "rotate"]);
    assert_eq!(rotated["epoch"], 2, "{rotated}");
    assert!(rotated["transaction"].is_string() && rotated["block"].is_u64(), "{rotated}");

    let after = authros.json(&["keys", "list"]);
    assert_eq!(list(&after, "epochs").len(), 2, "{after}");
    let current = current_epochs(&after);
    assert_eq!(current.len(), 1, "{after}");
    assert_eq!(current[0]["epoch"], 2);
    let tokens: Vec<String> = list(&after, "epochs").iter().map(|epoch| text(epoch, "token")).collect();
    assert_ne!(tokens[0], tokens[1]);
    assert_eq!(
        text(&list(&before, "epochs")[0], "token"),
        tokens[usize::from(list(&after, "epochs")[0]["epoch"] != 1)]
    );
    for field in ["address", "signing_key", "envelope_key"] {
        assert_eq!(before[field], after[field], "{field} is no part of an epoch");
    }
}

#[test]
fn the_exported_signing_key_is_read_by_openssl() {
    if system_program("openssl").is_none() {
        skipped!("no openssl");
    }
    let home = Home::new();
    let authros = quiet(&home);
    let made = authros.json(&["identity", "create"]);
    let out = home.root().join("sm2.pem");
    let out = out.to_str().expect("UTF-8");
    authros.run(&["keys", "export", "sm2", "--out", out]).expect_code(0);
    assert_eq!(fs::metadata(out).expect("written").permissions().mode() & 0o777, 0o600);
    assert_eq!(public_key(out), text(&made, "signing_key"));

    let kept = fs::read(out).expect("written");
    let again = authros.run(&["keys", "export", "sm2", "--out", out]);
    assert!(again.code.is_some_and(|code| code != 0), "never over a file: {again}");
    assert_eq!(fs::read(out).expect("still there"), kept);
}

#[test]
fn a_saved_keyring_is_never_written_over_and_a_key_that_is_not_there_is_named() {
    let home = Home::new();
    let authros = quiet(&home);
    authros.json(&["identity", "create"]);
    let out = home.root().join("saved");
    let out = out.to_str().expect("UTF-8");
    authros.run(&["keys", "backup", "--out", out]).expect_code(0);
    let saved = fs::read(out).expect("saved");
    let told = authros.fails(3, &["keys", "backup", "--out", out]);
    assert!(told.contains(out) && told.contains("already exists"), "{told}");
    assert_eq!(fs::read(out).expect("there"), saved);

    let missing = home.root().join("mistyped.pem");
    let missing = missing.to_str().expect("UTF-8");
    for arguments in [&["keys", "load", "--sm2", missing, "--dry-run"][..], &["keys", "load", "--sm2", missing]] {
        let told = authros.fails(3, arguments);
        assert!(told.contains(missing), "{arguments:?}: {told}");
    }
    let told = authros.run(&["keys", "load", "--dry-run"]).expect_code(2);
    assert!(told.stderr.contains("--sm2"), "{told}");
}

#[test]
fn a_signing_key_made_by_openssl_is_loaded() {
    if system_program("openssl").is_none() {
        skipped!("no openssl");
    }
    let home = Home::new();
    let authros = quiet(&home);
    let made = authros.json(&["identity", "create"]);
    let pem = home.file("openssl.pem", "", 0o600);
    output_of("openssl", &["genpkey", "-algorithm", "SM2", "-out", &pem]);
    let loaded = authros.json(&["keys", "load", "--sm2", &pem]);
    assert_ne!(loaded["signing_key"], made["signing_key"]);
    assert_eq!(text(&loaded, "signing_key"), public_key(&pem));
    assert_eq!(loaded["envelope_key"], made["envelope_key"], "the envelope key is another key");
    assert_eq!(authros.json(&["identity", "register"])["signing_key"], loaded["signing_key"]);
}

/// As `openssl ecparam -genkey -name SM2` and `openssl pkey -text` write them, and an editor that puts a mark before them.
#[test]
fn signing_keys_of_openssl_are_loaded_in_each_of_its_forms() {
    if system_program("openssl").is_none() {
        skipped!("no openssl");
    }
    let home = Home::new();
    let authros = quiet(&home);
    authros.json(&["identity", "create"]);
    let pem = home.file("pkcs8.pem", "", 0o600);
    output_of("openssl", &["genpkey", "-algorithm", "SM2", "-out", &pem]);
    let [sec1, printed, public] = ["ecparam.pem", "printed.pem", "public.pem"].map(|name| home.file(name, "", 0o600));
    output_of("openssl", &["ecparam", "-genkey", "-name", "SM2", "-out", &sec1]);
    output_of("openssl", &["pkey", "-in", &pem, "-text", "-out", &printed]);
    output_of("openssl", &["pkey", "-in", &pem, "-pubout", "-out", &public]);
    let read = |path: &str| fs::read_to_string(path).expect("written");
    let marked = home.file("marked.pem", format!("\u{feff}{}", read(&pem)), 0o600);
    let both = home.file("both.pem", read(&public) + &read(&pem), 0o600);
    let parameters = "-----BEGIN SM2 PARAMETERS-----\nBggqgRzPVQGCLQ==\n-----END SM2 PARAMETERS-----\n";
    let whole = home.file("whole.pem", parameters.to_owned() + &read(&pem), 0o600);
    let other = home.file("other.pem", "", 0o600);
    let wanted = public_key(&pem);
    for (file, wanted) in [&printed, &marked, &both, &whole]
        .map(|file| (file, wanted.clone()))
        .into_iter()
        .chain([(&sec1, public_key(&sec1))])
    {
        // Another key in between, so that each file is seen to be read.
        output_of("openssl", &["genpkey", "-algorithm", "SM2", "-out", &other]);
        authros.json(&["keys", "load", "--sm2", &other]);
        assert_eq!(text(&authros.json(&["keys", "load", "--sm2", file]), "signing_key"), wanted, "{file}");
    }
    let twice = home.file("twice.pem", read(&pem) + &read(&other), 0o600);
    assert!(authros.fails(3, &["keys", "load", "--sm2", &twice]).contains("several private keys"));
}

#[test]
fn a_dry_run_reads_the_key_before_it_says_who_is_affected() {
    if system_program("openssl").is_none() {
        skipped!("no openssl");
    }
    let home = Home::new();
    let authros = quiet(&home);
    authros.json(&["identity", "create"]);
    let p256 = home.file("p256.pem", "", 0o600);
    output_of("openssl", &["genpkey", "-algorithm", "EC", "-pkeyopt", "ec_paramgen_curve:P-256", "-out", &p256]);
    let told = authros.fails(3, &["keys", "load", "--sm2", &p256, "--dry-run"]);
    assert!(told.contains("another curve"), "{told}");
    let der = home.file("key.der", "", 0o600);
    output_of("openssl", &["genpkey", "-algorithm", "SM2", "-outform", "DER", "-out", &der]);
    let told = authros.fails(3, &["keys", "load", "--sm2", &der, "--dry-run"]);
    assert!(told.contains("it is binary"), "{told}");
    let sm2 = home.file("sm2.pem", "", 0o600);
    output_of("openssl", &["genpkey", "-algorithm", "SM2", "-out", &sm2]);
    authros.run(&["keys", "load", "--sm2", &sm2, "--dry-run"]).expect_code(0);
}

#[test]
fn a_keystore_under_pbkdf2_is_loaded() {
    let home = Home::new();
    let authros = quiet(&home);
    authros.json(&["identity", "create"]);
    let keystore = home.file("keystore.json", PBKDF2, 0o600);
    let passphrase = home.file("keystore-passphrase", "testpassword\n", 0o600);
    let load = ["keys", "load", "--eoa", &keystore, "--keystore-passphrase-file", &passphrase];
    let loaded = authros.json(&load);
    assert_eq!(text(&loaded, "address").to_lowercase(), "0x008aeeda4d805471df9b2a5b0f38a0c3bcba786b");
    let endless = home.file("endless.json", PBKDF2.replace("262144", "4294967295"), 0o600);
    let told = authros.fails(3, &["keys", "load", "--eoa", &endless, "--keystore-passphrase-file", &passphrase]);
    assert!(told.contains("out of range"), "{told}");
}

#[test]
fn a_known_account_key_gives_its_known_address() {
    let home = Home::new();
    let authros = quiet(&home);
    authros.json(&["identity", "create"]);
    let file = home.file("eoa.hex", KNOWN_EOA, 0o600);
    assert_eq!(authros.json(&["keys", "load", "--eoa", &file])["address"], KNOWN_ADDRESS);
    assert_eq!(authros.json(&["identity", "register"])["address"], KNOWN_ADDRESS);
}

#[test]
fn an_account_key_travels_as_a_keystore_under_its_own_passphrase() {
    let home = Home::new();
    let alice = home.profile("alice").with(&["--robots", "0"]);
    let bob = home.profile("bob").with(&["--robots", "0"]);
    let address = text(&alice.json(&["identity", "create"]), "address");
    bob.json(&["identity", "create"]);
    let passphrase = home.file("keystore-passphrase", "a passphrase for the road\n", 0o600);
    let keystore = home.root().join("keystore.json");
    let keystore = keystore.to_str().expect("UTF-8");
    let with_passphrase = ["--keystore-passphrase-file", &passphrase];
    alice.run(&[&["keys", "export", "eoa", "--out", keystore][..], &with_passphrase].concat()).expect_code(0);
    let written: Value = serde_json::from_slice(&fs::read(keystore).expect("written")).expect("JSON");
    assert_eq!(written["version"], 3, "an Ethereum V3 keystore");

    let loaded = bob.json(&[&["keys", "load", "--eoa", keystore][..], &with_passphrase].concat());
    assert_eq!(text(&loaded, "address"), address);
}

#[test]
fn a_loaded_data_key_begins_an_epoch_and_is_what_is_exported() {
    let home = Home::new();
    let authros = quiet(&home);
    authros.enrol();
    let key: Vec<u8> = (1..=16).collect();
    let file = home.file("sm4.bin", &key, 0o600);
    let loaded = authros.json(&["keys", "load", "--sm4", &file]);
    assert_eq!(current_epochs(&loaded)[0]["epoch"], 2, "{loaded}");
    let out = home.root().join("sm4.hex");
    authros.run(&["keys", "export", "sm4", "--out", out.to_str().expect("UTF-8")]).expect_code(0);
    assert_eq!(fs::read_to_string(out).expect("written").trim(), hex(&key));
}

#[test]
fn no_list_of_keys_shows_a_secret() {
    let home = Home::new();
    let authros = quiet(&home);
    authros.enrol();
    let secret: [u8; 16] =
        [0x9e, 0xd1, 0x0b, 0xf7, 0x83, 0xac, 0x1e, 0xc5, 0xee, 0x04, 0xb9, 0xd8, 0x8f, 0x61, 0xfa, 0x97];
    let sm4 = home.file("sm4.bin", secret, 0o600);
    authros.json(&["keys", "load", "--sm4", &sm4]);
    let shown = authros.run(&["keys", "list"]).expect_code(0).stdout + &authros.json(&["keys", "list"]).to_string();
    assert!(!shown.to_lowercase().contains(&hex(&secret)), "{shown}");
    for path in support::authros::files_below(&home.path()) {
        let bytes = fs::read(&path).unwrap_or_default();
        let in_clear = support::holds(&bytes, &secret) || support::holds(&bytes, hex(&secret).as_bytes());
        assert!(!in_clear, "in clear in {}", path.display());
    }
}

//! `authros evidence verify`: a folder of `records export` in the hands of someone without home or keys.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::{INCOMPLETE, INPUT, TAMPERED, UNREACHABLE};
use crate::support::process::Running;
use crate::support::{Authros, Home, free_port, list, text};

struct Case {
    home: Home,
    /// A stranger: another HOME, without a home of AuthROS.
    stranger: Authros,
    _chain: Running,
    url: String,
    folder: PathBuf,
}

impl Case {
    fn new(options: &[&str]) -> Self {
        let home = Home::new();
        let authros = home.authros().with(&["--robots", "1"]).with(options);
        authros.enrol();
        authros.capture(&["/robot1/odom"], 3);
        let id = text(&authros.records(&["records", "list", "--oldest"])[1], "id");
        let folder = home.root().join("export");
        authros.run(&["records", "export", &id, "--dir", folder.to_str().expect("UTF-8")]).expect_code(0);
        let url = format!("127.0.0.1:{}", free_port());
        let mut chain = authros.spawn(&["chain", "serve", "--listen", &url]);
        chain.wait_for_text(&url, 60);
        let stranger = Authros::bare(&home.root().join("export"));
        Self { home, stranger, _chain: chain, url: format!("http://{url}"), folder }
    }

    fn verify(&self, folder: &Path, code: i32) -> Value {
        let arguments = ["evidence", "verify", folder.to_str().expect("UTF-8"), "--chain", &self.url, "--json"];
        self.stranger.run(&arguments).expect_code(code).document()
    }

    /// A copy of the folder, changed.
    fn changed(&self, change: impl FnOnce(&Path)) -> PathBuf {
        let copy = self.home.root().join("copy");
        drop(fs::remove_dir_all(&copy));
        fs::create_dir(&copy).expect("made");
        for name in ["record.bin", "message.bin", "signature.bin", "signer.pem", "proof.json"] {
            fs::copy(self.folder.join(name), copy.join(name)).expect("copied");
        }
        change(&copy);
        copy
    }

    fn proof(&self, change: impl FnOnce(&mut Value)) -> PathBuf {
        let mut proof: Value =
            serde_json::from_slice(&fs::read(self.folder.join("proof.json")).expect("read")).expect("JSON");
        change(&mut proof);
        self.changed(|copy| fs::write(copy.join("proof.json"), proof.to_string()).expect("written"))
    }
}

fn holds(found: &Value, step: &str) -> Value {
    let is = |one: &Value| one["name"] == step;
    list(found, "steps").into_iter().find(is).unwrap_or_else(|| panic!("no step '{step}': {found}"))["ok"].clone()
}

fn flip(path: &Path, at: impl FnOnce(usize) -> usize) {
    let mut bytes = fs::read(path).expect("read");
    let at = at(bytes.len());
    bytes[at] ^= 1;
    fs::write(path, bytes).expect("written");
}

#[test]
fn a_stranger_checks_an_exported_record_step_by_step() {
    let case = Case::new(&[]);
    let found = case.verify(&case.folder, 0);
    assert_eq!(found["ok"], true, "{found}");
    for step in ["digest", "header", "message", "signature", "proof", "chain", "contract", "anchor", "registration"] {
        assert_eq!(holds(&found, step), true, "{step}: {found}");
    }
    assert!(!case.home.root().join("export/.local").exists(), "no home was made");
    let words = case
        .stranger
        .run(&["evidence", "verify", case.folder.to_str().expect("UTF-8"), "--chain", &case.url])
        .expect_code(0);
    assert!(words.stdout.contains("VERIFIED") && words.stdout.contains("existed no later than 20"), "{words}");
    assert!(words.stdout.contains("the owner's claim") && words.stdout.contains("a single program seals"), "{words}");
    assert_eq!((&found["sealed_by"]["kind"], &found["sealed_by"]["alone"]), (&"embedded".into(), &true.into()));
    assert!(found["anchored"]["time"].is_string() && holds(&found, "time") == true, "{found}");
    let trusting =
        |found: &Value| list(found, "warnings").iter().any(|text| text.to_string().contains("folder's own claim"));
    assert!(trusting(&found), "{found}");
    let folder = case.folder.to_str().expect("UTF-8");
    let genesis = text(
        &serde_json::from_slice(&fs::read(case.folder.join("proof.json")).expect("read")).expect("JSON"),
        "genesis",
    );
    let arguments = ["evidence", "verify", folder, "--chain", &case.url, "--json", "--genesis", &genesis];
    assert!(!trusting(&case.stranger.run(&arguments).expect_code(0).document()), "its genesis was given");
    let arguments =
        ["evidence", "verify", folder, "--chain", &case.url, "--json", "--genesis", &format!("0x{}", "00".repeat(32))];
    assert_eq!(holds(&case.stranger.run(&arguments).expect_code(TAMPERED).document(), "chain"), false);

    let bytes = case.changed(|copy| flip(&copy.join("record.bin"), |length| length - 1));
    let found = case.verify(&bytes, TAMPERED);
    assert_eq!((holds(&found, "digest"), holds(&found, "signature")), (false.into(), false.into()), "{found}");
    let message = case.changed(|copy| flip(&copy.join("message.bin"), |length| length - 1));
    assert_eq!(holds(&case.verify(&message, TAMPERED), "message"), false);
    let signature = case.changed(|copy| flip(&copy.join("signature.bin"), |length| length - 1));
    assert_eq!(holds(&case.verify(&signature, TAMPERED), "signature"), false);

    let path = case.proof(|proof| proof["anchor"]["index"] = 9999.into());
    assert_eq!(holds(&case.verify(&path, TAMPERED), "proof"), false);
    let block = case.proof(|proof| proof["anchor"]["block"] = 1.into());
    assert_eq!(holds(&case.verify(&block, TAMPERED), "anchor"), false);
    let time = case.proof(|proof| proof["anchor"]["block_time"] = "2019-03-03T12:00:00Z".into());
    assert_eq!(holds(&case.verify(&time, TAMPERED), "time"), false);
    let number = case.proof(|proof| proof["seq"] = 77.into());
    assert_eq!(holds(&case.verify(&number, TAMPERED), "header"), false);
    let network = case.proof(|proof| proof["chain_id"] = 1.into());
    assert_eq!(holds(&case.verify(&network, TAMPERED), "chain"), false);
    let early = case.proof(|proof| proof["anchor"]["block"] = Value::Null);
    case.verify(&early, INCOMPLETE);

    let arguments = ["evidence", "verify", case.folder.to_str().expect("UTF-8"), "--json"];
    case.stranger.run(&arguments).expect_code(INCOMPLETE);
    let nowhere = format!("http://127.0.0.1:{}", free_port());
    case.stranger.with(&["--chain", &nowhere]).run(&arguments).expect_code(UNREACHABLE);
    let other = ["--chain", &case.url, "--contract", "0x00000000000000000000000000000000000000aa"];
    let found = case.stranger.with(&other).run(&arguments).expect_code(TAMPERED).document();
    assert_eq!(holds(&found, "contract"), false, "{found}");
}

#[test]
fn hostile_folders_are_refused_in_words() {
    let case = Case::new(&["--anchor-mode", "each"]);
    let found = case.verify(&case.folder, 0);
    assert_eq!((&found["ok"], holds(&found, "anchor")), (&true.into(), true.into()), "uploaded by itself: {found}");
    let refused = |change: &dyn Fn(&Path)| {
        let copy = case.changed(change);
        let found = case.verify(&copy, INPUT);
        assert!(text(&found["error"], "message").contains("ask the person who gave you the folder"), "{found}");
    };
    for name in ["record.bin", "message.bin", "signature.bin", "signer.pem", "proof.json"] {
        refused(&|copy| fs::remove_file(copy.join(name)).expect("removed"));
        refused(&|copy| {
            fs::remove_file(copy.join(name)).expect("removed");
            std::os::unix::fs::symlink("/dev/zero", copy.join(name)).expect("linked");
        });
        refused(&|copy| fs::File::create(copy.join(name)).and_then(|file| file.set_len(1 << 40)).expect("huge"));
    }
    for name in ["record.bin", "signature.bin", "signer.pem", "proof.json"] {
        refused(&|copy| {
            let bytes = fs::read(copy.join(name)).expect("read");
            fs::write(copy.join(name), &bytes[..bytes.len() / 2]).expect("cut");
        });
        refused(&|copy| fs::write(copy.join(name), b"").expect("emptied"));
    }
    for json in ["[]", "null", "{\"format\":\"authros-proof/1\"}", "{\"format\":\"authros-proof/2\"}", "\"\\ud800\""] {
        refused(&|copy| fs::write(copy.join("proof.json"), json).expect("written"));
    }
    refused(&|copy| fs::write(copy.join("proof.json"), "[".repeat(60_000)).expect("deep"));
    case.verify(&case.home.root().join("none"), INPUT);
}

//! External time: an openssl authority, queried over HTTP by a home, and its stamps checked by somebody without one.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::evidence::{expect_agreement, expect_same_levels, unzipped, verified};
use crate::support;

use std::fs;
use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex};

use serde_json::Value;
use support::{Authros, Home, list, skipped, system_program, text};

const SETTINGS: &str = "[req]\ndistinguished_name = dn\nprompt = no\n[dn]\nCN = unused\n\
    [ca]\nbasicConstraints = critical,CA:true\nkeyUsage = critical,keyCertSign\n\
    [stamps]\nbasicConstraints = CA:false\nkeyUsage = critical,digitalSignature\nextendedKeyUsage = critical,timeStamping\n\
    [one]\nserial = ./serial\ndefault_policy = 1.2.3.4.1\ndigests = sha256\nsigner_digest = sha256\naccuracy = secs:1\n\
    ess_cert_id_alg = sha256\n";

fn openssl(folder: &Path, line: &str) {
    let mut command = Command::new("openssl");
    command.args(line.split_whitespace()).current_dir(folder).env("OPENSSL_CONF", folder.join("settings"));
    let done = command.stdin(Stdio::null()).output().expect("openssl");
    assert!(done.status.success(), "openssl {line}: {}", String::from_utf8_lossy(&done.stderr));
}

/// A root, and a signer of stamps issued by it, both with the same name.
fn signer(folder: &Path, name: &str) {
    let key = "genpkey -algorithm EC -pkeyopt ec_paramgen_curve:P-256 -out";
    openssl(folder, &format!("{key} {name}root.key"));
    let settings = "-config settings -subj";
    openssl(
        folder,
        &format!(
            "req -x509 -new -key {name}root.key -days 9 -extensions ca {settings} /CN={name}root -out {name}root.pem"
        ),
    );
    openssl(folder, &format!("{key} {name}.key"));
    openssl(folder, &format!("req -new -key {name}.key {settings} /CN={name} -out {name}.csr"));
    openssl(
        folder,
        &format!(
            "x509 -req -in {name}.csr -CA {name}root.pem -CAkey {name}root.key -set_serial 7 -days 9 -extfile settings \
         -extensions stamps -out {name}.pem"
        ),
    );
}

/// How the authority answers.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Mood {
    Busy,
    /// It stamps with a key that nobody pinned.
    Other,
    /// It gives everyone what it gave the first.
    Same,
    Well,
}

struct Served {
    address: String,
    mood: Arc<Mutex<Mood>>,
}

/// Answers until the test is over.
fn serve(folder: PathBuf) -> Served {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("an address").to_string();
    let mood = Arc::new(Mutex::new(Mood::Busy));
    let served = Served { address, mood: Arc::clone(&mood) };
    std::thread::spawn(move || {
        while let Ok((stream, _)) = listener.accept() {
            let mood = *mood.lock().expect("mood");
            answer(stream, &folder, mood);
        }
    });
    served
}

fn answer(mut stream: TcpStream, folder: &Path, mood: Mood) {
    let mut bytes = Vec::new();
    let body = loop {
        let mut some = [0; 4096];
        let count = stream.read(&mut some).expect("a request");
        bytes.extend(&some[..count]);
        let Some(head) = bytes.windows(4).position(|four| four == b"\r\n\r\n") else { continue };
        let text = String::from_utf8_lossy(&bytes[..head]).to_lowercase();
        assert!(text.starts_with("post /tsa ") && text.contains("content-type: application/timestamp-query"), "{text}");
        let length = text.lines().find_map(|line| line.strip_prefix("content-length:")).expect("a length");
        if bytes.len() - head - 4 == length.trim().parse::<usize>().expect("a number") {
            break bytes.split_off(head + 4);
        }
    };
    let (status, body) = match mood {
        Mood::Busy => ("503 Service Unavailable", Vec::new()),
        Mood::Same => ("200 OK", fs::read(folder.join("reply")).expect("the one before")),
        Mood::Other | Mood::Well => {
            fs::write(folder.join("query"), body).expect("written");
            let name = if mood == Mood::Well { "notary" } else { "stranger" };
            let line = "ts -reply -queryfile query -config settings -section one -out reply";
            openssl(folder, &format!("{line} -signer {name}.pem -inkey {name}.key"));
            ("200 OK", fs::read(folder.join("reply")).expect("read"))
        }
    };
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: application/timestamp-reply\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    );
    stream.write_all(&[head.as_bytes(), &body].concat()).expect("answered");
}

/// An authority that answers everyone until the folder is dropped, and the setting that names it.
pub(crate) fn notary() -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(folder.path().join("settings"), SETTINGS).expect("written");
    fs::write(folder.path().join("serial"), "01\n").expect("written");
    signer(folder.path(), "notary");
    let served = serve(folder.path().to_owned());
    *served.mood.lock().expect("mood") = Mood::Well;
    let certificate = folder.path().join("notaryroot.pem");
    let setting = setting(&served, &certificate);
    (folder, setting)
}

fn setting(served: &Served, certificate: &Path) -> String {
    let (address, certificate) = (&served.address, certificate.display());
    format!("[{{ name = \"The notary\", url = \"http://{address}/tsa\", certificate = \"{certificate}\" }}]")
}

#[test]
fn batches_are_stamped_by_an_authority_and_the_stamps_are_checked_offline() {
    if system_program("openssl").is_none() || system_program("python3").is_none() {
        skipped!("no openssl, or no python3");
    }
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(folder.path().join("settings"), SETTINGS).expect("written");
    fs::write(folder.path().join("serial"), "01\n").expect("written");
    ["notary", "stranger"].iter().for_each(|name| signer(folder.path(), name));
    let served = serve(folder.path().to_owned());
    let becomes = |mood| *served.mood.lock().expect("mood") = mood;

    let home = Home::new();
    let certificate = folder.path().join("notaryroot.pem");
    let setting = setting(&served, &certificate);
    let bare = home.authros().with(&["--robots", "1"]).with_variable("AUTHROS_AUDIT_ANCHOR_EVERY", "86400");
    let authros = bare.with_variable("AUTHROS_TIME_AUTHORITIES", &setting);
    authros.enrol();
    assert!(bare.fails(3, &["evidence", "timestamp"]).contains("set time.authorities"));
    authros.capture(&["/robot1/odom"], 2);
    assert!(authros.fails(5, &["evidence", "timestamp"]).contains("answered 503"));
    becomes(Mood::Other);
    assert!(authros.fails(5, &["evidence", "timestamp"]).contains("no certificate in it links stranger"));
    becomes(Mood::Same);
    assert!(authros.fails(5, &["evidence", "timestamp"]).contains("its nonce differs"));
    let case = |name: &str| home.root().join(name).to_str().expect("UTF-8").to_owned();
    let export = |name: &str| authros.json(&["evidence", "export", &case(name), "--topic", "/robot1/odom"]);
    let without = export("without.authros");
    assert!(
        list(&without, "notes").iter().any(|note| note.to_string().contains("without a time stamp yet")),
        "{without}"
    );

    becomes(Mood::Well);
    let view = authros.json(&["evidence", "timestamp"]);
    let tokens = list(&view, "tokens");
    assert_eq!((tokens.is_empty(), &view["waiting"], &view["problem"]), (false, &0.into(), &().into()), "{view}");
    assert!(tokens.iter().all(|token| text(token, "authority") == "The notary"), "{view}");
    export("case.authros");
    let (bundle, trust) = (PathBuf::from(case("case.authros")), home.root().join("trust.toml"));
    let suggested = String::from_utf8(unzipped(&bundle, "trust.toml")).expect("text");
    fs::write(&trust, &suggested).expect("written");
    // The exporter seals its chain itself; the time is proven all the same.
    let report = verified(&bundle, Some(&trust)).expect_code(8).document();
    for record in list(&report, "records") {
        assert_eq!(
            (text(&record["time"], "standing"), text(&record["anchor"], "standing")),
            ("proven".into(), "own_chain".into())
        );
        assert!(text(&record["time"], "text").contains("by the time stamp of The notary, whom you pinned"), "{record}");
        assert!(tokens.iter().any(|token| token["before"] == record["existed_before"]), "{record} {view}");
    }
    expect_agreement(&bundle, Some(&trust));
    by_hand(folder.path(), &bundle);
    on_another_machine(&authros, &home, &bundle, &trust);
    let page = String::from_utf8(unzipped(&bundle, "report.html")).expect("text");
    let before = " UTC, by the clock of The notary.</li>";
    assert!(page.contains(before) && page.contains("openssl ts -verify"), "{page}");

    let (pins, _) = suggested.split_once("[[authority]]").expect("an authority is suggested");
    fs::write(&trust, pins).expect("written");
    let report = verified(&bundle, Some(&trust)).expect_code(8).document();
    let told: Vec<String> = list(&report, "records").iter().map(|record| text(&record["time"], "standing")).collect();
    assert!(told.iter().all(|standing| standing == "unproven"), "{told:?}");
}

/// A home restored from its backup exports the same: proofs and tokens are in it, and no authority is asked.
fn on_another_machine(authros: &Authros, home: &Home, bundle: &Path, trust: &Path) {
    let secret = home.file("secret", "a passphrase of it\n", 0o600);
    let backup = home.root().join("case.backup").to_str().expect("UTF-8").to_owned();
    authros.json(&["backup", "create", &backup, "--passphrase-file", &secret]);
    let other = Home::new();
    let restored = other.authros().with(&["--robots", "1"]);
    restored.json(&["backup", "restore", &backup, "--passphrase-file", &secret]);
    let again = other.root().join("again.authros");
    restored.json(&["evidence", "export", again.to_str().expect("UTF-8"), "--topic", "/robot1/odom"]);
    expect_same_levels(bundle, &again, trust);
}

/// The lines of `VERIFY.txt`, by openssl alone.
fn by_hand(folder: &Path, bundle: &Path) {
    let script = "import sys, zipfile\nfor n in zipfile.ZipFile(sys.argv[1]).namelist():\n    print(n)\n";
    let names = Command::new("python3").args(["-c", script]).arg(bundle).output().expect("python3").stdout;
    let names = String::from_utf8(names).expect("text");
    let is_token =
        |name: &&str| name.starts_with("stamps/") && Path::new(name).extension().is_some_and(|of| of == "der");
    let tokens: Vec<&str> = names.lines().filter(is_token).collect();
    assert!(!tokens.is_empty(), "{names}");
    for name in tokens {
        let imprint = name.split('/').nth(1).expect("a folder");
        fs::write(folder.join("token"), unzipped(bundle, name)).expect("written");
        openssl(
            folder,
            &format!("ts -verify -digest {imprint} -token_in -in token -CAfile notaryroot.pem -partial_chain"),
        );
        walked(folder, bundle, imprint);
    }
}

/// The lines that lead from a record to what was stamped, in a shell.
fn walked(folder: &Path, bundle: &Path, imprint: &str) {
    let place = folder.join(format!("unpacked-{imprint}"));
    let script = "import sys, zipfile\nzipfile.ZipFile(sys.argv[1]).extractall(sys.argv[2])\n";
    let unpacked = Command::new("python3").args(["-c", script]).arg(bundle).arg(&place).status().expect("python3");
    assert!(unpacked.success());
    let plain = |value: &Value| value.as_str().expect("hex").trim_start_matches("0x").to_owned();
    let words = |value: &Value| value.as_array().expect("a path").iter().map(plain).collect::<Vec<_>>().join(" ");
    let read = |name: PathBuf| -> Value { serde_json::from_slice(&fs::read(name).expect("read")).expect("JSON") };
    let roots = read(place.join("stamps").join(imprint).join("roots.json"));
    let stamped = list(&roots, "roots");
    let (digest, anchor, root) = fs::read_dir(place.join("records"))
        .expect("records")
        .find_map(|entry| {
            let entry = entry.expect("an entry");
            let anchor = read(entry.path().join("anchor.json"))["anchor"].clone();
            let root = stamped.iter().find(|one| plain(&one["root"]) == plain(&anchor["root"]))?;
            Some((entry.file_name().into_string().expect("hex"), anchor, root.clone()))
        })
        .expect("a record of a stamped batch");
    let instructions = fs::read_to_string(place.join("VERIFY.txt")).expect("read");
    let (_, block) = instructions.split_once("that this is about the record D").expect("the block");
    let lines: Vec<&str> = block.lines().filter(|line| line.starts_with("    ")).collect();
    let script = [
        ("TOTAL", roots["count"].to_string()),
        ("TOP", plain(&roots["top"])),
        ("INDEX", anchor["index"].to_string()),
        ("COUNT", anchor["count"].to_string()),
        ("PATH", words(&anchor["path"])),
        ("PLACE", root["index"].to_string()),
        ("STEPS", words(&root["path"])),
    ]
    .iter()
    .fold(lines.join("\n"), |script, (name, value)| script.replace(name, value));
    let script = format!("D={digest} S={imprint}\n{script}");
    let output = Command::new("sh").args(["-ec", &script]).current_dir(&place).output().expect("a shell");
    let told = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{told}{}", String::from_utf8_lossy(&output.stderr));
    for shown in [imprint.to_owned(), format!("{} 0", plain(&root["root"])), format!("{} 0", plain(&roots["top"]))] {
        assert!(told.lines().any(|line| line.ends_with(&shown)), "{shown} in {told}");
    }
}

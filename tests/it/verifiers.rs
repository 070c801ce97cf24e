//! All verifiers over one real bundle and its mutations by a seed: the program, the package in Python, the page's thread.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::evidence::{expect_agreement, printed, unzipped};
use crate::support;
use crate::time_stamps::notary;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use support::{Home, Running, heavy, length, long, skipped, system_program, wait_until};

const TOOLS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tools/verify");
const PAGE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tools/verify-page");
const MUTATE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/long/mutate.py");
/// Cases in every run; the long one goes on for twenty minutes.
const CASES: u32 = 200;

struct Exported {
    home: Home,
    bundle: PathBuf,
    trust: PathBuf,
    owner: PathBuf,
}

/// A bundle with every kind of member: all disclosed, stamped, and with a head of the recorder.
fn export() -> Exported {
    let (_authority, setting) = notary();
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]).with_variable("AUTHROS_AUDIT_ANCHOR_EVERY", "1");
    let authros = authros.with_variable("AUTHROS_TIME_AUTHORITIES", &setting);
    authros.enrol();
    authros.capture(&["/robot1/odom"], 2);
    let site = authros.serve(&home);
    let (trust, owner) = (home.root().join("trust.toml"), home.root().join("owner.pem"));
    let mut tries = 0;
    let bundle = wait_until(90, "a head of the recorder covers the topic, and all batches are stamped", || {
        tries += 1;
        let file = home.root().join(format!("case{tries}.authros"));
        authros.json(&["evidence", "timestamp"]);
        let place = file.to_str().expect("UTF-8");
        authros.json(&["evidence", "export", place, "--topic", "/robot1/odom", "--reveal", "all", "--yes"]);
        fs::write(&trust, unzipped(&file, "trust.toml")).expect("written");
        // Its lines end wherever 80 columns do.
        let verdict = printed(&file, &trust, &[]).split_whitespace().collect::<Vec<_>>().join(" ");
        let is_whole = ["Complete: 1 topic", "by the clock of The notary"].iter().all(|part| verdict.contains(part));
        is_whole.then_some(file)
    });
    site.stop("INT", 30).expect_code(0);
    authros.run(&["keys", "export", "sm2", "--out", owner.to_str().expect("UTF-8")]).expect_code(0);
    Exported { home, bundle, trust, owner }
}

#[test]
fn all_verifiers_say_the_same_of_a_bundle_and_of_its_mutations() {
    if system_program("openssl").is_none() || system_program("python3").is_none() {
        skipped!("no openssl, or no python3");
    }
    let _turn = heavy();
    let Exported { home, bundle, trust, owner } = export();
    expect_agreement(&bundle, Some(&trust));
    expect_agreement(&bundle, None);
    let folder = home.root().join("mutations");
    fs::create_dir(&folder).expect("made");
    let mut command = Command::new("python3");
    command.arg("-B").arg(MUTATE).args([&bundle, &trust, &owner, &folder]);
    command.args(["--verifier", concat!("program=program:", env!("CARGO_BIN_EXE_authros"))]);
    if system_program("node").is_some() && Path::new(PAGE).join("node_modules").exists() {
        command.args(["--verifier", &format!("page=node {PAGE}/test/judge.js")]);
    } else {
        println!("SKIPPED the page among the verifiers: no node, or its packages are not installed");
    }
    let seconds = length(Duration::ZERO, Duration::from_secs(1200)).as_secs();
    let seed = std::env::var("AUTHROS_SEED").unwrap_or_else(|_| "1".to_owned());
    command.args(["--seed", &seed, "--count", &CASES.to_string()]);
    if long() {
        command.args(["--seconds", &seconds.to_string()]);
    }
    let outcome = Running::start(command).wait(seconds + 600);
    assert_eq!(outcome.code, Some(0), "{outcome}");
    println!("{}", outcome.stdout.lines().last().unwrap_or_default());
}

/// Wheel and sdist of the release, and a clone as `pip install tools/verify` takes it, each without a network.
#[test]
fn the_second_verifier_is_installed_by_pip_and_says_what_the_program_says() {
    let Some(python) = system_program("python3") else { skipped!("no python3") };
    let exported = crate::evidence::export();
    let root = exported.home.root();
    let place = root.join("installed");
    let made = Command::new(&python).args(["-m", "venv"]).arg(&place).output().expect("python3");
    if !made.status.success() {
        skipped!("no python3-venv");
    }
    let built = |sources: &Path, folder: &Path| {
        fs::create_dir(folder).expect("made");
        let mut command = Command::new(&python);
        command.arg("-B").arg(sources.join("build_backend.py")).arg(folder);
        Running::start(command).wait(60).expect_code(0);
    };
    let release = root.join("release");
    built(Path::new(TOOLS), &release);
    let name = format!("authros_verify-{}", env!("CARGO_PKG_VERSION"));
    let (wheel, sdist) = (format!("{name}-py3-none-any.whl"), format!("{name}.tar.gz"));
    let mut unpack = Command::new("tar");
    unpack.arg("-xzf").arg(release.join(&sdist)).arg("-C").arg(root);
    Running::start(unpack).wait(60).expect_code(0);
    let again = root.join("again");
    built(&root.join(&name), &again);
    for file in [&wheel, &sdist] {
        let bytes = |folder: &Path| fs::read(folder.join(file)).expect("built");
        assert!(bytes(&release) == bytes(&again), "{file} is another one when it is built from the sdist");
    }
    let program = printed(&exported.bundle, &exported.trust, &[]);
    for source in [release.join(wheel), release.join(sdist), PathBuf::from(TOOLS)] {
        let mut install = Command::new(place.join("bin/pip"));
        install
            .args(["install", "--quiet", "--no-index", "--disable-pip-version-check", "--force-reinstall"])
            .arg(&source);
        Running::start(install).wait(120).expect_code(0);
        let mut command = Command::new(place.join("bin/authros-verify"));
        command.current_dir(root).arg(&exported.bundle).arg("--trust").arg(&exported.trust);
        let told = Running::start(command).wait(60).expect_code(8).stdout;
        assert_eq!(told.trim_end(), program.trim_end(), "{}", source.display());
    }
}

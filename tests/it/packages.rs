//! The installed packages: packed twice they are identical to the byte, and hold what the manual says. The program's
//! own bytes are not checked here: `packaging/build` makes them, and takes minutes.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use serde_json::Value;

use crate::support::{Home, Running, list, skipped, system_program, text};

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// Packs three small programs, with the pages of the real one.
fn packed(folder: &Path) -> PathBuf {
    let mut command = script("assemble");
    command.args(["/bin/true", "/bin/echo", "/bin/cat", "x86_64"]).arg(folder).arg(env!("CARGO_BIN_EXE_authros"));
    Running::start(command).wait(120).expect_code(0);
    folder.to_owned()
}

fn said(program: &str, arguments: &[&str], file: &Path) -> String {
    let mut command = Command::new(program);
    command.args(arguments).arg(file);
    Running::start(command).wait(60).expect_code(0).stdout
}

#[test]
fn a_package_is_the_same_twice_and_holds_what_the_manual_says() {
    if system_program("dpkg-deb").is_none() {
        skipped!("no dpkg-deb");
    }
    let home = Home::new();
    let first = packed(&home.root().join("first"));
    let second = packed(&home.root().join("second"));
    let sums = |folder: &Path| fs::read_to_string(folder.join("SHA256SUMS-x86_64")).expect("checksums");
    assert_eq!(sums(&first), sums(&second));
    assert_eq!(sums(&first).lines().count(), 12);

    let version = env!("CARGO_PKG_VERSION");
    let deb = first.join(format!("authros_{version}-1_amd64.deb"));
    let facts = said("dpkg-deb", &["--field"], &deb);
    for fact in ["Package: authros", "Architecture: amd64", "Depends: libc6 (>= 2.31)"] {
        assert!(facts.contains(fact), "no '{fact}' in {facts}");
    }
    let held = said("dpkg-deb", &["--contents"], &deb);
    for file in [
        "./usr/bin/authros",
        "./lib/systemd/system/authros-serve.service",
        "./lib/systemd/system/authros-gateway.service",
        "./lib/systemd/system/authros-agent.service",
        "./lib/systemd/system/authros-serve.service.d/account.conf",
        "./lib/systemd/system/authros-gateway.service.d/account.conf",
        "./lib/systemd/system/authros-backup.service.d/account.conf",
        "./usr/share/bash-completion/completions/authros",
        "./usr/share/zsh/vendor-completions/_authros",
        "./usr/share/fish/vendor_completions.d/authros.fish",
        "./usr/share/man/man1/authros.1.gz",
        "./usr/share/doc/authros/THIRD-PARTY.txt.gz",
        "./usr/share/authros/ros2/authros/package.xml",
        "./etc/authros/serve.env",
        "./etc/authros/gateway.env",
    ] {
        let line = held.lines().find(|line| line.ends_with(&format!(" {file}")));
        let line = line.unwrap_or_else(|| panic!("no {file} in {held}"));
        assert!(line.contains("root/root"), "{line}");
    }
    let archive = said("tar", &["-tzf"], &first.join(format!("authros-{version}-x86_64-linux.tar.gz")));
    for file in [
        "authros",
        "README.md",
        "LICENSE",
        "THIRD-PARTY.txt",
        "pages/authros.1",
        "ros2/authros/setup.py",
        "systemd/authros-serve.service",
    ] {
        assert!(archive.contains(&format!("authros-{version}-x86_64-linux/{file}\n")), "no {file} in {archive}");
    }
}

#[test]
fn programs_without_keys_come_by_themselves_and_only_with_their_own_version_of_the_site() {
    if system_program("dpkg-deb").is_none() {
        skipped!("no dpkg-deb");
    }
    let home = Home::new();
    let folder = packed(&home.root().join("packages"));
    let version = env!("CARGO_PKG_VERSION");
    let first = said("dpkg-deb", &["--contents"], &folder.join(format!("authros_{version}-1_amd64.deb")));
    for (name, original) in [("authros-ros2", "/bin/echo"), ("authros-rosrust", "/bin/cat")] {
        expect_beside(&folder, name);
        // Each holds its own program, and none another's.
        let program = format!("{name}-{version}-x86_64-linux/{name}");
        let mut command = Command::new("tar");
        let archive = folder.join(format!("{name}-{version}-x86_64-linux.tar.gz"));
        command.arg("-xzf").arg(&archive).arg("-C").arg(home.root()).arg(&program);
        Running::start(command).wait(60).expect_code(0);
        let bytes = |path: &Path| fs::read(path).expect("a program");
        assert_eq!(bytes(&home.root().join(program)), bytes(Path::new(original)));
        assert!(!first.contains(&format!("usr/bin/{name}")), "{first}");
    }
}

/// The package and the archive of a program that the site starts.
fn expect_beside(folder: &Path, name: &str) {
    let version = env!("CARGO_PKG_VERSION");
    let deb = folder.join(format!("{name}_{version}-1_amd64.deb"));
    let facts = said("dpkg-deb", &["--field"], &deb);
    let (own, depends) = (format!("Package: {name}\n"), format!("Depends: authros (= {version}-1), libc6 (>= 2.31)"));
    for fact in [&*own, "Architecture: amd64", &depends] {
        assert!(facts.contains(fact), "no '{fact}' in {facts}");
    }
    // The site looks beside its own executable.
    let held = said("dpkg-deb", &["--contents"], &deb);
    let documents = format!("./usr/share/doc/{name}");
    let list = format!("{name}.cdx.json");
    for file in ["copyright", "THIRD-PARTY.txt.gz", &format!("{list}.gz"), "changelog.Debian.gz"] {
        assert!(held.contains(&format!(" {documents}/{file}\n")), "no {file} in {held}");
    }
    for file in [format!("./usr/bin/{name}"), format!("./usr/share/man/man1/{name}.1.gz")] {
        assert!(held.contains(&format!(" {file}\n")), "no {file} in {held}");
    }
    assert!(!held.contains("systemd") && !held.contains("./etc"), "{held}");
    let archive = folder.join(format!("{name}-{version}-x86_64-linux.tar.gz"));
    let archived = said("tar", &["-tzf"], &archive);
    for file in [name, "LICENSE", "THIRD-PARTY.txt", &format!("{name}.1"), &list, "robots.md"] {
        assert!(archived.contains(&format!("{name}-{version}-x86_64-linux/{file}\n")), "no {file} in {archived}");
    }
}

/// The libraries in a list of what `program` holds. Each reference is of something listed, and nothing is listed in vain.
fn components(file: &Path, program: &str) -> Vec<Value> {
    let bytes = fs::read(file).expect("the list");
    let bill: Value = serde_json::from_slice(&bytes).expect("JSON");
    assert_eq!(bill["metadata"]["component"]["name"], program);
    assert_eq!(bill["metadata"]["timestamp"], "2023-11-14T22:13:20Z");
    let components = list(&bill, "components");
    let listed: BTreeSet<String> = components.iter().map(|one| text(one, "bom-ref")).collect();
    assert_eq!(listed.len(), components.len(), "{program}: something is listed twice");
    let mut used = BTreeSet::new();
    for one in list(&bill, "dependencies") {
        let owner = text(&one, "ref");
        assert!(owner == program || listed.contains(&owner), "{program}: {owner} is not listed");
        used.extend(list(&one, "dependsOn").iter().map(|other| other.as_str().expect("a reference").to_owned()));
    }
    assert_eq!(used, listed, "{program}");
    components
}

#[test]
fn every_library_of_a_program_is_in_its_list_with_the_checksum_of_the_lock_file() {
    if system_program("dpkg-deb").is_none() {
        skipped!("no dpkg-deb");
    }
    let home = Home::new();
    let folder = packed(&home.root().join("packages"));
    let lock = source("Cargo.lock");
    let site = ["revm", "ethers-core", "rusqlite", "ratatui", "libsm"];
    // Neither test-only dependencies nor our own crates, nor those of the other program.
    let held: [(&str, &[&str], &[&str]); 3] = [
        ("authros", &site, &["plotters", "proptest", "authros-model", "rustdds", "rosrust", "xml-rpc"]),
        (
            "authros-rosrust",
            &["rosrust", "xml-rpc", "serde_json"],
            &["revm", "ratatui", "libsm", "authros-pipe", "rustdds"],
        ),
        ("authros-ros2", &["rustdds", "mio", "serde_json"], &["revm", "ratatui", "libsm", "authros-pipe", "proptest"]),
    ];
    for (program, expected, foreign) in held {
        let file = format!("{program}-{}-x86_64-linux.cdx.json", env!("CARGO_PKG_VERSION"));
        let components = components(&folder.join(file), program);
        let among = |name: &&str| components.iter().any(|one| text(one, "name") == *name);
        assert!(expected.iter().all(among), "{program}: {expected:?} in {components:?}");
        assert!(!foreign.iter().any(among), "{program}: {foreign:?} in {components:?}");
        for one in &components {
            let (name, version) = (text(one, "name"), text(one, "version"));
            let checksum = text(&one["hashes"][0], "content");
            let entry = format!("name = \"{name}\"\nversion = \"{version}\"\n");
            let rest = lock.split(&entry).nth(1).unwrap_or_else(|| panic!("{name} {version} is not locked"));
            let own = rest.split("[[package]]").next().expect("an entry");
            assert!(own.contains(&format!("checksum = \"{checksum}\"")), "{name} {version}");
        }
    }
}

fn script(name: &str) -> Command {
    let mut command = Command::new(Path::new(ROOT).join("packaging").join(name));
    command.env("SOURCE_DATE_EPOCH", "1700000000");
    command
}

fn source(name: &str) -> String {
    fs::read_to_string(Path::new(ROOT).join(name)).expect("a file of the tree")
}

#[test]
fn the_lists_of_the_other_verifiers_name_what_is_in_them_with_the_checksum_of_the_lock_file() {
    if system_program("python3").is_none() {
        skipped!("no python3");
    }
    let home = Home::new();
    let listed = |program: &str| {
        let file = home.root().join(program);
        let mut command = script("cyclonedx.py");
        command.args([program, env!("CARGO_PKG_VERSION")]).arg(&file);
        Running::start(command).wait(60).expect_code(0);
        components(&file, program)
    };
    // Python's own library alone.
    assert!(listed("authros-verify").is_empty());
    let page = listed("verify.html");
    let named: BTreeSet<String> = page.iter().map(|one| text(one, "name")).collect();
    let manifest: Value = serde_json::from_str(&source("tools/verify-page/package.json")).expect("JSON");
    let wanted: BTreeSet<String> = manifest["dependencies"].as_object().expect("packages").keys().cloned().collect();
    assert!(named.is_superset(&wanted), "{named:?}");
    // What builds the page is not in it.
    assert!(!named.iter().any(|name| name.contains("esbuild")), "{named:?}");
    let lock: Value = serde_json::from_str(&source("tools/verify-page/package-lock.json")).expect("JSON");
    for one in &page {
        let locked = &lock["packages"][format!("node_modules/{}", text(one, "name"))];
        assert_eq!(one["version"], locked["version"]);
        let integrity = text(locked, "integrity");
        let digest = BASE64.decode(integrity.strip_prefix("sha512-").expect("SHA-512")).expect("base64");
        let hex: String = digest.iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(text(&one["hashes"][0], "content"), hex);
    }
}

#[test]
fn all_parts_have_the_version_of_the_program() {
    const VERSION: &str = env!("CARGO_PKG_VERSION");
    let manifest = format!("version = \"{VERSION}\"");
    let entry = format!("\"version\": \"{VERSION}\"");
    let lines: [(&str, String); 9] = [
        ("Cargo.toml", manifest.clone()),
        ("tools/verify/pyproject.toml", manifest),
        ("tools/verify-page/package.json", entry.clone()),
        ("tools/verify-page/package-lock.json", entry),
        ("packaging/ros2/authros/setup.py", format!("version=\"{VERSION}\"")),
        ("packaging/ros2/authros/package.xml", format!("<version>{VERSION}</version>")),
        ("CHANGELOG.md", format!("## [{VERSION}] - ")),
        ("docs/gateway.md", format!("authros_{VERSION}-1_amd64.deb")),
        ("tools/verify/README.md", format!("authros_verify-{VERSION}-py3-none-any.whl")),
    ];
    for (file, line) in &lines {
        assert!(source(file).contains(line), "{file} has no '{line}'");
    }
}

#[test]
fn a_program_that_wants_a_newer_libc_is_not_packed() {
    if system_program("objdump").is_none() {
        skipped!("no objdump");
    }
    let judged = |program: &str, most: &str, code: i32| {
        let mut command = script("libc");
        command.args([program, most]);
        Running::start(command).wait(60).expect_code(code)
    };
    // Everything linked to glibc on 64 bits requires at least 2.2.5, and nothing requires 99.
    let program = env!("CARGO_BIN_EXE_authros");
    assert!(judged(program, "99.0", 0).stdout.contains("wants GLIBC_2."));
    let refused = judged(program, "2.2", 1).stderr;
    assert!(refused.contains("2.2 at most") && refused.lines().count() > 1, "{refused}");
    // Compared as versions, not as texts: 2.200 is newer than any existing one.
    judged(program, "2.200", 0);
    let home = Home::new();
    judged(&home.file("text", "GLIBC_2.2.5", 0o600), "2.31", 2);
}

#[test]
fn a_build_for_a_machine_without_its_standard_library_is_refused_by_name_before_anything_is_compiled() {
    const TARGET: &str = "aarch64-unknown-linux-gnu";
    let folder = Command::new("rustc").args(["--print", "target-libdir", "--target", TARGET]).output();
    let Ok(folder) = folder else { skipped!("no rustc") };
    if Path::new(String::from_utf8_lossy(&folder.stdout).trim()).is_dir() {
        skipped!("the standard library of arm64 is installed here, so it would be built");
    }
    let home = Home::new();
    let out = home.root().join("out");
    let mut command = script("build");
    command.args(["--target", "aarch64", "--out"]).arg(&out);
    let refused = Running::start(command).wait(60).expect_code(3).stderr;
    assert!(refused.contains(TARGET) && refused.contains("rustup target add"), "{refused}");
    assert!(!out.exists());
    let mut command = script("build");
    command.args(["--target", "sparc"]);
    assert!(Running::start(command).wait(60).expect_code(2).stderr.contains("sparc"));
}

#[test]
fn an_account_that_cannot_be_made_fails_the_installation_and_says_what_to_do() {
    let home = Home::new();
    // A machine without an account of that name and without the two programs that create accounts.
    fs::create_dir(home.root().join("programs")).expect("made");
    home.file("programs/getent", "#!/bin/sh\nexit 2\n", 0o700);
    let mut command = Command::new("/bin/sh");
    command.arg(Path::new(ROOT).join("packaging/debian/postinst")).arg("configure");
    command.env("PATH", home.root().join("programs"));
    let refused = Running::start(command).wait(60).expect_code(1).stderr;
    assert!(refused.contains("useradd") && refused.contains("dpkg --configure authros"), "{refused}");
}

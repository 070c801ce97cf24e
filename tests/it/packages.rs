//! The installed packages: packed twice they are identical to the byte, and hold what the manual says. The program's
//! own bytes are not checked here: `packaging/build` makes them, and takes minutes.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::{Home, Running, list, skipped, system_program, text};

/// Packs three small programs, with the pages of the real one.
fn packed(folder: &Path) -> PathBuf {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("packaging/assemble");
    let mut command = Command::new(script);
    command.args(["/bin/true", "/bin/echo", "/bin/cat", "x86_64"]).arg(folder).arg(env!("CARGO_BIN_EXE_authros"));
    command.env("SOURCE_DATE_EPOCH", "1700000000");
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
    let sums = |folder: &Path| std::fs::read_to_string(folder.join("SHA256SUMS-x86_64")).expect("checksums");
    assert_eq!(sums(&first), sums(&second));
    assert_eq!(sums(&first).lines().count(), 9);

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
        "./etc/authros/serve.env",
        "./etc/authros/gateway.env",
    ] {
        let line = held.lines().find(|line| line.ends_with(&format!(" {file}")));
        let line = line.unwrap_or_else(|| panic!("no {file} in {held}"));
        assert!(line.contains("root/root"), "{line}");
    }
    let archive = said("tar", &["-tzf"], &first.join(format!("authros-{version}-x86_64-linux.tar.gz")));
    for file in
        ["authros", "README.md", "LICENSE", "THIRD-PARTY.txt", "pages/authros.1", "systemd/authros-serve.service"]
    {
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
        let bytes = |path: &Path| std::fs::read(path).expect("a program");
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

/// The libraries in the list that came with `program`.
fn components(folder: &Path, program: &str) -> Vec<serde_json::Value> {
    let name = format!("{program}-{}-x86_64-linux.cdx.json", env!("CARGO_PKG_VERSION"));
    let bytes = std::fs::read(folder.join(name)).expect("the list");
    let bill: serde_json::Value = serde_json::from_slice(&bytes).expect("JSON");
    assert_eq!(bill["metadata"]["component"]["name"], program);
    list(&bill, "components")
}

#[test]
fn every_library_of_a_program_is_in_its_list_with_the_checksum_of_the_lock_file() {
    if system_program("dpkg-deb").is_none() {
        skipped!("no dpkg-deb");
    }
    let home = Home::new();
    let folder = packed(&home.root().join("packages"));
    let lock =
        std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("Cargo.lock")).expect("the lock file");
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
        let components = components(&folder, program);
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
    Command::new(Path::new(env!("CARGO_MANIFEST_DIR")).join("packaging").join(name))
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
    std::fs::create_dir(home.root().join("programs")).expect("made");
    home.file("programs/getent", "#!/bin/sh\nexit 2\n", 0o700);
    let mut command = Command::new("/bin/sh");
    command.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("packaging/debian/postinst")).arg("configure");
    command.env("PATH", home.root().join("programs"));
    let refused = Running::start(command).wait(60).expect_code(1).stderr;
    assert!(refused.contains("useradd") && refused.contains("dpkg --configure authros"), "{refused}");
}

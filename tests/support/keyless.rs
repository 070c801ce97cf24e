//! Programs without keys, which a site starts: where they are, and that they hold and reach nothing that only the site may
//! know.

use std::fs;
use std::os::unix::fs::MetadataExt as _;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use super::authros::files_below;
use super::memory::{found_in, memory_of, secrets_below};
use super::process::Running;
use super::{tell_skipped, wait_until};

/// The user and the group `nobody` of Linux.
const NOBODY: u32 = 65534;

/// A program of the workspace, if it was built beside the one under test.
pub fn program(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_BIN_EXE_authros")).with_file_name(name);
    path.is_file().then_some(path)
}

/// The process of a program that a site runs with an argument that begins so.
pub fn process_of(site: &Running, name: &str, argument: &str) -> String {
    let own = |folder: &Path| -> Option<String> {
        let stat = fs::read_to_string(folder.join("stat")).ok()?;
        let (before, after) = stat.rsplit_once(')')?;
        let parent = after.split_whitespace().nth(1)?;
        let arguments = fs::read_to_string(folder.join("cmdline")).ok()?;
        // The system keeps fifteen characters of a name.
        let is_named = before.ends_with(&format!("({}", &name[..name.len().min(15)]));
        let is_it = is_named && arguments.split('\0').any(|one| one.starts_with(argument));
        // A run that says for a killed one that it is gone is another thing.
        let is_it = is_it && !arguments.split('\0').any(|one| one == "--bury");
        (is_it && parent == site.id().to_string()).then(|| before.split(' ').next().unwrap_or_default().to_owned())
    };
    let find = || fs::read_dir("/proc").expect("/proc").flatten().find_map(|entry| own(&entry.path()));
    wait_until(20, "the process without keys", find)
}

/// Searches environment, arguments, descriptors and memory of a process for what only the site of `home` may know, and
/// tries to reach that as its user. `arguments` are its first ones, `environment` its variables, `held` what its memory
/// does hold.
pub fn expect_no_key_in(home: &Path, process: &str, arguments: &str, environment: &[&str], held: &str) {
    let folder = Path::new("/proc").join(process);
    let read = |name: &str| fs::read(folder.join(name)).expect("of a process of ours");
    let variables = String::from_utf8_lossy(&read("environ")).into_owned();
    let mut names: Vec<&str> =
        variables.split_terminator('\0').filter_map(|one| Some(one.split_once('=')?.0)).collect();
    names.sort_unstable();
    assert_eq!(names, environment, "{variables}");
    let said = String::from_utf8_lossy(&read("cmdline")).replace('\0', " ");
    assert!(said.contains(arguments) && !said.contains(&*home.to_string_lossy()), "{said}");
    let entries = fs::read_dir(folder.join("fd")).expect("descriptors").flatten();
    let links: Vec<String> =
        entries.filter_map(|entry| Some(fs::read_link(entry.path()).ok()?.display().to_string())).collect();
    let own =
        |link: &String| ["pipe:", "socket:", "anon_inode:", "/dev/null"].iter().any(|kind| link.starts_with(kind));
    assert!(links.len() > 3 && links.iter().all(own), "{links:?}");
    let status = String::from_utf8_lossy(&read("status")).into_owned();
    expect_walls(home, &status, &folder);
    expect_another_user(home, &status, &folder);
    let secrets = secrets_below(home);
    assert!(secrets.len() >= 2 * 6 + 2, "two profiles with passphrase, keys and epochs: {}", secrets.len());
    for (name, secret) in &secrets {
        let is_in = |bytes: &[u8]| bytes.windows(secret.len()).any(|window| window == &secret[..]);
        assert!(!is_in(variables.as_bytes()) && !is_in(said.as_bytes()), "{name}");
    }
    let Some(memory) = memory_of(process) else {
        tell_skipped("expect_no_key_in", "this user may not read the memory of a process of its own");
        return;
    };
    let known = [("what it publishes".to_owned(), held.as_bytes().to_vec())];
    assert!(!found_in(&memory, &known).is_empty(), "what it does hold is found");
    assert_eq!(found_in(&memory, &secrets), Vec::<&str>::new());
}

/// What a program says when it tries to open each of `paths` as it began for a site: `reached`, or the kind of error.
/// `None`, and told, where this kernel raises no walls.
pub fn attempts(program: &Path, paths: &[PathBuf]) -> Option<Vec<String>> {
    let output = Command::new(program).arg("--attempt").args(paths).stdin(Stdio::null()).output().expect("it starts");
    let said = String::from_utf8(output.stdout).expect("UTF-8");
    let (first, rest) = said.split_once('\n').expect("a line");
    if first == "confined false" {
        tell_skipped("keyless::attempts", "this kernel has no Landlock or no seccomp");
        return None;
    }
    assert_eq!(first, "confined true", "{said}");
    Some(rest.lines().map(str::to_owned).collect())
}

/// A process of a program has raised its walls, and behind them the keyring and the socket of `home` are out of reach.
fn expect_walls(home: &Path, status: &str, folder: &Path) {
    let program = fs::read_link(folder.join("exe")).expect("its program");
    let wanted: Vec<PathBuf> = keyrings_and_sockets(home);
    let Some(outcomes) = attempts(&program, &wanted) else { return };
    let expected: Vec<String> = wanted.iter().map(|path| format!("PermissionDenied {}", path.display())).collect();
    assert_eq!(outcomes, expected);
    for line in ["NoNewPrivs:\t1", "Seccomp:\t2"] {
        assert!(status.lines().any(|own| own == line), "{line} in {status}");
    }
}

/// What nobody but a site may open.
pub fn keyrings_and_sockets(home: &Path) -> Vec<PathBuf> {
    files_below(home).into_iter().filter(|path| path.ends_with("keyring") || path.ends_with("site.sock")).collect()
}

/// Where the site may choose a user for it, and that one can read the program, it is nobody, who reaches neither keyring
/// nor socket.
fn expect_another_user(home: &Path, status: &str, folder: &Path) {
    let user = status.lines().find_map(|line| line.strip_prefix("Uid:")).expect("its user").split_whitespace().next();
    let program = fs::read_link(folder.join("exe")).expect("its program");
    if fs::metadata("/proc/self").expect("Linux").uid() != 0 || !runs_as_nobody(Command::new(program)) {
        tell_skipped("expect_another_user", "the site may not give its programs another user here");
        return;
    }
    assert_eq!(user, Some("65534"));
    for path in keyrings_and_sockets(home) {
        let mut look = Command::new("/usr/bin/test");
        look.arg("-r").arg(&path).uid(NOBODY).gid(NOBODY);
        assert!(!look.status().expect("it runs").success(), "nobody can open {}", path.display());
    }
}

/// Whether the user who owns nothing may run a program at all.
fn runs_as_nobody(mut command: Command) -> bool {
    command.uid(NOBODY).gid(NOBODY).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    command.status().is_ok()
}

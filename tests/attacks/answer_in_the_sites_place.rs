//! To be told a passphrase: another user of the machine puts a socket of his own into a home, or a home of his own where
//! somebody will look for hers.

use std::fs::{self, Permissions};
use std::os::unix::fs::{PermissionsExt as _, chown};
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use super::judge;
use super::parts::Parts;
use super::support::{Home, Outcome, Running, skipped, system_program};

/// A user that owns nothing here.
const NOBODY: u32 = 65534;
/// Listens at a socket as that user, greets who joins, and writes down what he says.
const ANSWERER: &str = r#"
import os, socket, sys, threading
path, log = sys.argv[1:]
heard = open(log, "wb", buffering=0)
listener = socket.socket(socket.AF_UNIX)
listener.bind(path)
os.chmod(path, 0o666)
if os.geteuid() == 0:
    os.setresgid(65534, 65534, 65534)
    os.setresuid(65534, 65534, 65534)
listener.listen(8)
print("listening", flush=True)
def answer(peer):
    peer.sendall(b'{"greeting":{"version":"0.1.0","settings":[],"stays":true}}\n')
    while True:
        said = peer.recv(65536)
        if not said:
            return
        heard.write(said)
while True:
    threading.Thread(target=answer, args=(listener.accept()[0],), daemon=True).start()
"#;

fn chmod(path: &Path, mode: u32) {
    fs::set_permissions(path, Permissions::from_mode(mode)).expect("its mode is set");
}

/// What was said must name the remedy or the stranger; a command that worked sent its passphrase.
fn note(parts: &mut Parts, what: &str, said: &Outcome, words: &str) {
    match said.code {
        Some(5) => parts.refused(what, &said.stderr, words),
        Some(0) => parts.reached(format!("{what}: it worked")),
        _ => parts.otherwise(format!("{what}: {}", said.stderr)),
    }
}

/// A home with an identity and its passphrase in a file, which no site serves.
fn owned() -> (Home, String) {
    let home = Home::new();
    let passphrase = home.file("passphrase.txt", "correct horse battery staple 42\n", 0o600);
    home.profile("alice").json(&["identity", "create", "--passphrase-file", &passphrase]);
    (home, passphrase)
}

#[test]
fn a_home_that_others_can_write_gets_no_secret() {
    let mut parts = Parts::default();
    let (home, passphrase) = owned();
    let alice = home.profile("alice");
    for mode in [0o777, 0o770, 0o702] {
        chmod(&home.path(), mode);
        for command in [["keys", "rotate"], ["identity", "show"], ["received", "list"]] {
            let said = alice.run(&[&command[..], &["--passphrase-file", &passphrase]].concat());
            note(&mut parts, &format!("{command:?} in a home of mode {mode:o}"), &said, "chmod go-w");
        }
    }
    let fresh = Home::new();
    fs::create_dir(fresh.path()).expect("a home");
    chmod(&fresh.path(), 0o777);
    let said = fresh.profile("alice").run(&["identity", "create"]);
    note(&mut parts, "identity create", &said, "chmod go-w");
    let left = fs::read_dir(fresh.path()).expect("there").count();
    if left > 0 {
        parts.reached(format!("{left} files were written into a home that others can write"));
    }
    chmod(&home.path(), 0o700);
    alice.run(&["keys", "list", "--passphrase-file", &passphrase]).expect_code(0);
    judge("answer_in_the_sites_place", parts.outcome());
}

#[test]
fn another_user_answers_at_the_socket() {
    let Some(python) = system_program("python3") else { skipped!("no python3") };
    if !rustix::process::geteuid().is_root() {
        skipped!("only root can act as two users");
    }
    let mut parts = Parts::default();
    let (home, passphrase) = owned();
    let alice = home.profile("alice").with(&["--passphrase-file", &passphrase]);
    let (socket, heard) = (home.path().join("site.sock"), home.root().join("heard"));
    drop(fs::remove_file(&socket));
    let mut command = Command::new(python);
    command.args(["-c", ANSWERER]).arg(&socket).arg(&heard);
    let mut answerer = Running::start(command);
    answerer.wait_for_text("listening", 10);
    let said = alice.run(&["keys", "rotate"]);
    std::thread::sleep(Duration::from_millis(200));
    let told = String::from_utf8_lossy(&fs::read(&heard).expect("his notes")).into_owned();
    note(&mut parts, "keys rotate beside another user's socket", &said, "nothing was sent");
    if !told.is_empty() {
        parts.reached(format!("he was told {told}"));
    }
    drop(answerer);

    chown(home.path(), Some(NOBODY), None).expect("given away");
    let said = alice.run(&["keys", "rotate"]);
    note(&mut parts, "keys rotate in another user's home", &said, "belongs to user 65534");
    chown(home.path(), Some(0), None).expect("taken back");
    judge("answer_in_the_sites_place", parts.outcome());
}

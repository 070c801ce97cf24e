//! Unix accounts of this machine for one test, in one group, removed at its end. Only root can make them.

use std::fs::{self, Permissions};
use std::io::{BufRead as _, BufReader, Write as _};
use std::os::unix::fs::{PermissionsExt as _, chown};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use serde_json::{Value, json};

use super::authros::program_under_test;
use super::{Authros, Home, system_program};

/// Passes lines between its own pipes and a socket.
const BRIDGE: &str = "
import os, socket, sys, threading
line = socket.socket(socket.AF_UNIX)
line.connect(sys.argv[1])
def tell():
    for told in line.makefile('rb'):
        sys.stdout.buffer.write(told)
        sys.stdout.buffer.flush()
    os._exit(0)
threading.Thread(target=tell, daemon=True).start()
for asked in sys.stdin.buffer:
    line.sendall(asked)
";

/// Accounts and their group.
pub struct Accounts {
    home: Home,
    /// The name of the group that all but the last are in.
    pub group: String,
    prefix: String,
    names: Vec<String>,
    program: PathBuf,
}

impl Accounts {
    /// One for each of these, all but the last in the group; the reason if that is not possible here.
    pub fn make(names: &[&str]) -> Result<Self, String> {
        static NEXT: AtomicUsize = AtomicUsize::new(0);
        if !rustix::process::geteuid().is_root() {
            return Err("only root can make accounts".to_owned());
        }
        for needed in ["useradd", "groupadd", "userdel", "groupdel", "setpriv", "python3"] {
            system_program(needed).ok_or_else(|| format!("no {needed}"))?;
        }
        let home = Home::new();
        fs::set_permissions(home.root(), Permissions::from_mode(0o755)).expect("its mode is set");
        // The folder of the build may be closed to other users.
        let program = home.root().join("authros");
        let built = program_under_test();
        fs::hard_link(&built, &program)
            .or_else(|_| fs::copy(&built, &program).map(drop))
            .expect("the program is there");
        let prefix = format!("at{}x{}", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed));
        let group = format!("{prefix}-lab");
        run("groupadd", &[&group]);
        let mut accounts = Self { home, group, prefix, names: Vec::new(), program };
        for (index, name) in names.iter().enumerate() {
            let name = format!("{}-{name}", accounts.prefix);
            run("useradd", &["--no-create-home", "--user-group", &name]);
            if index + 1 < names.len() {
                run("usermod", &["--append", "--groups", &accounts.group, &name]);
            }
            accounts.names.push(name.clone());
            accounts.folder(&name, &name, 0o700);
        }
        Ok(accounts)
    }

    /// The whole name of an account.
    pub fn name(&self, of: &str) -> String {
        format!("{}-{of}", self.prefix)
    }

    /// The home directory of an account.
    pub fn home(&self, of: &str) -> PathBuf {
        self.home.root().join(self.name(of))
    }

    /// A folder beside those of the accounts, with their group.
    pub fn folder(&self, name: &str, owner: &str, mode: u32) -> PathBuf {
        let path = self.home.root().join(name);
        fs::create_dir_all(&path).expect("a folder");
        chown(&path, Some(number(owner)), Some(self.group_number())).expect("its owner is set");
        fs::set_permissions(&path, Permissions::from_mode(mode)).expect("its mode is set");
        path
    }

    /// The number of the group.
    fn group_number(&self) -> u32 {
        let said = Command::new("getent").args(["group", &self.group]).output().expect("getent runs");
        let said = String::from_utf8_lossy(&said.stdout).into_owned();
        said.split(':').nth(2).and_then(|number| number.parse().ok()).expect("a group")
    }

    /// The program as an account with the groups that the user database gives it. Its own group is the shared one, as a
    /// unit's `Group=` makes it, for those who are in it.
    pub fn authros(&self, of: &str) -> Authros {
        let name = self.name(of);
        let identity = match self.names.last() {
            Some(last) if *last == name => ["--reuid", &name, "--regid", &name, "--init-groups"].map(str::to_owned),
            _ => ["--reuid", &name, "--regid", &self.group_number().to_string(), "--init-groups"].map(str::to_owned),
        };
        self.authros_as(&self.home(of), &identity)
    }

    /// The program with these identity options of setpriv.
    pub fn authros_as(&self, home: &Path, identity: &[String]) -> Authros {
        let identity = identity.iter().map(String::as_str);
        let prefix: Vec<&str> = identity.chain(["--", self.program.to_str().expect("UTF-8")]).collect();
        Authros::bare(home).with_program(&system_program("setpriv").expect("checked")).with_prefix(&prefix)
    }

    /// A user, by name or number, of whom the kernel says that the group is theirs, whatever the user database says.
    pub fn claims_the_group(&self, user: &str) -> Vec<String> {
        ["--reuid", user, "--regid", &self.group_number().to_string(), "--clear-groups"].map(str::to_owned).to_vec()
    }

    /// A connection of that user to a socket.
    pub fn line(&self, user: &str, socket: &Path) -> Line {
        Line::new(&self.claims_the_group(user), socket)
    }
}

impl Drop for Accounts {
    fn drop(&mut self) {
        for name in &self.names {
            // What is left behind disturbs no other test.
            drop(Command::new("userdel").args(["--force", name]).output());
        }
        drop(Command::new("groupdel").arg(&self.group).output());
    }
}

/// Runs a program of the user database; another one may be changing it at this moment.
fn run(program: &str, arguments: &[&str]) {
    let mut said = String::new();
    for _ in 0..20 {
        let ended = Command::new(program).args(arguments).output().expect("it runs");
        if ended.status.success() {
            return;
        }
        said = String::from_utf8_lossy(&ended.stderr).into_owned();
        std::thread::sleep(Duration::from_millis(500));
    }
    panic!("{program} {arguments:?}: {said}");
}

fn number(user: &str) -> u32 {
    let said = Command::new("id").args(["-u", user]).output().expect("id runs");
    String::from_utf8_lossy(&said.stdout).trim().parse().expect("a number")
}

/// A connection of a user to a site's socket.
pub struct Line {
    bridge: Child,
    asked: ChildStdin,
    told: BufReader<ChildStdout>,
    number: u64,
}

impl Line {
    fn new(identity: &[String], socket: &Path) -> Self {
        let mut command = Command::new("setpriv");
        let python = system_program("python3").expect("checked");
        command.args(identity).arg("--").arg(python).args(["-c", BRIDGE]).arg(socket).current_dir("/");
        let mut bridge = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("it runs");
        let (asked, told) = (bridge.stdin.take().expect("piped"), bridge.stdout.take().expect("piped"));
        Self { bridge, asked, told: BufReader::new(told), number: 0 }
    }

    /// The next message; `None` if the other end hung up.
    pub fn next(&mut self) -> Option<Value> {
        let mut line = String::new();
        let read = self.told.read_line(&mut line).expect("read");
        (read > 0).then(|| serde_json::from_str(&line).expect("JSON"))
    }

    /// The answer to one request.
    pub fn ask(&mut self, profile: &str, command: &Value) -> Value {
        self.number += 1;
        let request = json!({ "number": self.number, "profile": profile, "command": command });
        self.asked.write_all(format!("{request}\n").as_bytes()).expect("sent");
        loop {
            let message = self.next().expect("the site hung up");
            if message["answer"]["number"] == self.number {
                return message["answer"]["with"].clone();
            }
        }
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        // It may have ended already.
        drop(self.bridge.kill());
        drop(self.bridge.wait());
    }
}

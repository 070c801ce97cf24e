//! A machine of its own: a disk with the units of this repository, as the Debian package installs them, and systemd as its
//! first process. It runs in namespaces, so that cutting its power leaves nothing of it but the disk.

use std::fs;
use std::os::unix::fs::{MetadataExt as _, symlink};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use super::authros::files_below;
use super::{Home, Outcome, Running, system_program, wait_until};

const REPOSITORY: &str = env!("CARGO_MANIFEST_DIR");
const BOOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/support/boot.sh");
/// Where `boot.sh` puts the program.
const PROGRAM: &str = "/opt/authros/authros";
const TARGETS: [&str; 13] = [
    "multi-user",
    "basic",
    "sysinit",
    "network",
    "network-online",
    "sockets",
    "timers",
    "paths",
    "slices",
    "local-fs",
    "swap",
    "shutdown",
    "umount",
];

/// A machine with the gateway's unit and the agent's, neither of which is enabled.
pub struct Machine {
    home: Home,
    group: PathBuf,
    power: Option<Running>,
}

impl Machine {
    /// A new disk; without a reason why no machine can be booted here.
    ///
    /// # Errors
    /// That reason.
    pub fn new() -> Result<Self, String> {
        let programs = ["unshare", "nsenter", "setpriv", "systemctl", "systemd-creds", "systemd-sysusers"];
        if let Some(absent) = programs.into_iter().find(|name| system_program(name).is_none()) {
            return Err(format!("no {absent}"));
        }
        if fs::metadata("/proc/self").map_or(1, |about| about.uid()) != 0 {
            return Err("only root can boot a machine".to_owned());
        }
        let groups = if Path::new("/sys/fs/cgroup/cgroup.controllers").exists() { "" } else { "systemd" };
        let group = Path::new("/sys/fs/cgroup").join(groups).join(format!("authros-{}", std::process::id()));
        fs::create_dir(&group).map_err(|error| format!("no group of processes for a machine: {error}"))?;
        let machine = Self { home: Home::new(), group, power: None };
        machine.install();
        Ok(machine)
    }

    /// The folder that is its disk.
    pub fn disk(&self) -> PathBuf {
        self.home.root().join("disk")
    }

    fn install(&self) {
        let disk = self.disk();
        for folder in
            ["usr", "proc", "sys", "dev", "run", "tmp", "mnt", "opt/authros", "etc/authros", "var/lib", "var/log"]
        {
            fs::create_dir_all(disk.join(folder)).expect("a folder");
        }
        for folder in ["bin", "sbin", "lib", "lib64"] {
            symlink(format!("usr/{folder}"), disk.join(folder)).expect("a link");
        }
        self.write("etc/passwd", "root:x:0:0:root:/root:/bin/sh\n");
        self.write("etc/group", "root:x:0:\n");
        self.write("etc/nsswitch.conf", "passwd: files\ngroup: files\nhosts: files\n");
        self.write("etc/hosts", "127.0.0.1 localhost\n");
        // Without one it would be the first boot, at which systemd enables every unit.
        self.write("etc/machine-id", &format!("{}\n", "5a".repeat(16)));
        let users = Path::new(REPOSITORY).join("packaging/debian/sysusers");
        let disk = disk.to_str().expect("UTF-8");
        super::process::output_of("systemd-sysusers", &["--root", disk, users.to_str().expect("UTF-8")]);

        let copy = |from: &Path, to: &str| {
            let text = fs::read_to_string(from).expect("a file").replace("/usr/bin/authros", PROGRAM);
            self.write(&format!("etc/systemd/system/{to}"), &text);
        };
        for target in TARGETS.map(|name| format!("{name}.target")) {
            copy(&Path::new("/usr/lib/systemd/system").join(&target), &target);
        }
        for unit in ["authros-gateway.service", "authros-agent.service"] {
            copy(&Path::new(REPOSITORY).join("systemd").join(unit), unit);
            let account = Path::new(REPOSITORY).join("packaging/debian/account.conf");
            copy(&account, &format!("{unit}.d/account.conf"));
        }
        // There is no journal.
        self.write("etc/systemd/system/service.d/log.conf", "[Service]\nStandardOutput=append:/var/log/%N.log\n");
    }

    /// Writes a file that only root may read.
    pub fn write(&self, path: &str, text: &str) {
        use std::os::unix::fs::PermissionsExt as _;
        let path = self.disk().join(path);
        fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
        fs::write(&path, text).expect("written");
        let mode = if path.starts_with(self.disk().join("etc/authros")) { 0o600 } else { 0o644 };
        fs::set_permissions(&path, fs::Permissions::from_mode(mode)).expect("its mode is set");
    }

    /// What a unit has printed since the disk was made.
    pub fn log(&self, unit: &str) -> String {
        fs::read_to_string(self.disk().join("var/log").join(format!("{unit}.log"))).unwrap_or_default()
    }

    /// Switches it on and waits until systemd has started what is enabled.
    pub fn boot(&mut self) {
        assert!(self.power.is_none(), "it is on");
        let start = "echo $$ > \"$0/cgroup.procs\" && exec unshare -mpfuiC --kill-child sh \"$@\"";
        let mut command = Command::new("sh");
        command.args(["-c", start]).arg(&self.group).arg(BOOT).arg(self.disk()).arg(env!("CARGO_BIN_EXE_authros"));
        self.power = Some(Running::start(command));
        wait_until(60, "systemd is up", || {
            self.power.as_mut().expect("on").expect_running();
            self.first_process()?;
            (self.root(&["systemctl", "is-active", "multi-user.target"]).code == Some(0)).then_some(())
        });
    }

    /// Ends everything in it at once, as a power cut does.
    pub fn cut_power(&mut self) {
        self.power.take().expect("on").stop("KILL", 30);
        wait_until(30, "all processes are gone", || {
            let inside = files_below(&self.group).into_iter().filter(|path| path.ends_with("cgroup.procs"));
            inside.map(|path| fs::read_to_string(path).unwrap_or_default()).all(|ids| ids.is_empty()).then_some(())
        });
        remove_groups(&self.group, false);
    }

    /// The process that is its first, as it is called outside.
    fn first_process(&self) -> Option<String> {
        let id = self.power.as_ref().expect("on").id();
        let children = fs::read_to_string(format!("/proc/{id}/task/{id}/children")).ok()?;
        children.split_whitespace().next().map(str::to_owned)
    }

    /// Every process in it, as they are called outside, but for systemd.
    pub fn processes(&self) -> Vec<String> {
        let first = self.first_process().expect("on");
        let inside = files_below(&self.group).into_iter().filter(|path| path.ends_with("cgroup.procs"));
        let all: Vec<String> = inside.map(|path| fs::read_to_string(path).unwrap_or_default()).collect();
        let named =
            |id: &&str| fs::read_to_string(format!("/proc/{id}/comm")).is_ok_and(|name| name.trim() == "authros");
        all.iter().flat_map(|ids| ids.lines()).filter(|id| *id != first).filter(named).map(str::to_owned).collect()
    }

    /// Runs a command in it as root.
    pub fn root(&self, arguments: &[&str]) -> Outcome {
        let first = self.first_process().expect("on");
        let mut command = Command::new("nsenter");
        command.args(["--target", &first, "--mount", "--pid", "--root", "--wd=/"]).args(arguments);
        command.env_clear().envs([("PATH", "/usr/bin:/usr/sbin"), ("HOME", "/root"), ("LANG", "C.UTF-8")]);
        Running::start(command).wait(120)
    }

    /// Runs the program in it as the user of the units, at a home below /var/lib: `sudo -u authros authros --home ...`.
    pub fn authros(&self, home: &str, arguments: &[&str]) -> Outcome {
        let home = format!("/var/lib/{home}");
        let user =
            ["setpriv", "--reuid=authros", "--regid=authros", "--clear-groups", PROGRAM, "--home", &home, "--json"];
        self.root(&[&user[..], arguments].concat())
    }

    /// Puts a passphrase into an encrypted credential of a unit.
    pub fn encrypt_passphrase(&self, unit: &str, passphrase: &str, file: &str) {
        let encrypt = "printf %s \"$0\" | systemd-creds encrypt --name=passphrase - \"$1\"";
        self.root(&["sh", "-c", encrypt, passphrase, file]).expect_code(0);
        let setting = format!("[Service]\nLoadCredentialEncrypted=passphrase:{file}\n");
        self.write(&format!("etc/systemd/system/{unit}.service.d/override.conf"), &setting);
        self.root(&["systemctl", "daemon-reload"]).expect_code(0);
    }
}

impl Drop for Machine {
    #[allow(clippy::print_stdout, reason = "the output of a test")]
    fn drop(&mut self) {
        if self.power.is_some() {
            if std::thread::panicking() {
                println!("systemd said:\n{}", self.log("systemd"));
            }
            drop(self.power.take());
            std::thread::sleep(Duration::from_millis(500));
        }
        remove_groups(&self.group, true);
    }
}

/// Removes the groups that a machine left, deepest first.
fn remove_groups(folder: &Path, with_itself: bool) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    entries.filter_map(Result::ok).map(|entry| entry.path()).filter(|path| path.is_dir()).for_each(|path| {
        remove_groups(&path, true);
    });
    if with_itself {
        drop(fs::remove_dir(folder));
    }
}

//! A real PostgreSQL server on a free port, with an ordinary user who has a password. Run by root it runs as the user
//! postgres, because it refuses root.

use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use tempfile::TempDir;

use super::process::Running;
use super::{free_port, wait_until};

/// Of the user `authros`; nothing that the program says may have it.
pub const PASSWORD: &str = "hunter2-of-the-store";
/// Where distributions have the programs.
const PLACES: [&str; 2] = ["/usr/lib/postgresql", "/usr/pgsql"];

/// A server; it ends on drop.
#[derive(Debug)]
pub struct Postgres {
    server: Option<Running>,
    port: u16,
    folder: TempDir,
    programs: PathBuf,
    /// Number of its user and group, if not the test's.
    user: Option<(u32, u32)>,
}

impl Postgres {
    /// The reason if it cannot be had.
    pub fn start() -> Result<Self, &'static str> {
        let made = Self::empty()?;
        let mut command = made.program("initdb");
        command.args(["--auth-local=trust", "--auth-host=scram-sha-256", "-U", "postgres", "-E", "UTF8", "--locale=C"]);
        made.run(command.arg("-N").arg("-D").arg(made.data()));
        let made = made.serve();
        made.sql("postgres", &format!("CREATE ROLE authros LOGIN PASSWORD '{PASSWORD}'"));
        Ok(made)
    }

    /// Another server that follows this one.
    pub fn standby(&self) -> Self {
        let made = Self::empty().expect("as this one");
        self.copy_to(&made, &["-R"]);
        made.serve()
    }

    /// What this server has now, for [`Self::restore`].
    pub fn backup(&self) -> Self {
        let made = Self::empty().expect("as this one");
        self.copy_to(&made, &[]);
        made
    }

    fn copy_to(&self, other: &Self, options: &[&str]) {
        let mut command = other.program("pg_basebackup");
        command.args(["-U", "postgres", "-X", "stream", "-c", "fast", "-p", &self.port.to_string()]).args(options);
        other.run(command.arg("-h").arg(self.folder.path()).arg("-D").arg(other.data()));
    }

    /// Its postmaster is killed, and what runs under it ends.
    pub fn kill(&mut self) {
        self.server.take().expect("running").stop("KILL", 20);
    }

    /// Returns when it takes writes.
    pub fn promote(&self) {
        assert_eq!(self.sql("postgres", "SELECT pg_promote(wait_seconds => 60)"), "t", "it takes writes");
    }

    /// Goes on behind another primary.
    pub fn follow(&self, primary: &Self) {
        let (folder, port) = (primary.folder.path().display(), primary.port);
        let place = format!("user=postgres host={folder} port={port}");
        self.sql("postgres", &format!("ALTER SYSTEM SET primary_conninfo = '{place}'"));
        self.sql("postgres", "SELECT pg_reload_conf()");
    }

    /// A killed server returns at its address, as a standby with another's data.
    pub fn return_behind(&mut self, primary: &Self) {
        self.clear();
        primary.copy_to(self, &["-R"]);
        assert!(self.starts(), "it starts again");
    }

    /// A killed server returns at its address with what it had at the time of a backup.
    pub fn restore(&mut self, backup: &Self) {
        self.clear();
        std::fs::rename(backup.data(), self.data()).expect("on the same disk");
        assert!(self.starts(), "it starts again");
    }

    /// What ran under a killed postmaster may still write.
    fn clear(&self) {
        wait_until(20, "its data is removed", || {
            drop(std::fs::remove_dir_all(self.data()));
            (!self.data().exists()).then_some(())
        });
    }

    fn empty() -> Result<Self, &'static str> {
        let programs = programs().ok_or("no PostgreSQL; tests/run installs it")?;
        let folder = tempfile::Builder::new().prefix("postgres").tempdir().expect("a temporary directory");
        let user = user()?;
        if let Some((user, group)) = user {
            std::os::unix::fs::chown(folder.path(), Some(user), Some(group)).expect("its user's");
        }
        Ok(Self { server: None, port: 0, folder, programs, user })
    }

    fn serve(mut self) -> Self {
        // Another process may take a free port first: then others are tried.
        for _ in 0..5 {
            self.port = free_port();
            if self.starts() {
                return self;
            }
        }
        panic!("PostgreSQL finds no port to listen on");
    }

    /// Whether it did, at its port.
    fn starts(&mut self) -> bool {
        let port = self.port.to_string();
        let mut command = self.program("postgres");
        command.arg("-D").arg(self.data()).arg("-k").arg(self.folder.path());
        command.args(["-p", &port, "-c", "listen_addresses=127.0.0.1", "-c", "shared_buffers=32MB"]);
        let mut server = Running::start(command);
        let ready = wait_until(60, "PostgreSQL is up or has ended", || {
            let ready = self.asked("postgres", "SELECT 1").is_ok();
            (ready || !server.is_running()).then_some(ready)
        });
        self.server = ready.then_some(server);
        ready
    }

    /// The URL of a new database of the ordinary user.
    pub fn database(&self, name: &str) -> String {
        self.sql("postgres", &format!("CREATE DATABASE {name} OWNER authros"));
        self.url(name)
    }

    /// Runs a script, such as a dump, as the ordinary user.
    pub fn load(&self, database: &str, script: &Path) {
        let mut command = self.program("psql");
        command.args(["-X", "-q", "-v", "ON_ERROR_STOP=1", "-U", "authros", "-p", &self.port.to_string()]);
        command.arg("-h").arg(self.folder.path()).arg(database);
        self.run(command.stdin(std::fs::File::open(script).expect("a script")));
    }

    /// As the ordinary user.
    pub fn url(&self, database: &str) -> String {
        Self::url_of([self], database)
    }

    /// Of whichever of these takes writes.
    pub fn url_of<'a>(servers: impl IntoIterator<Item = &'a Self>, database: &str) -> String {
        let hosts: Vec<String> = servers.into_iter().map(|server| format!("127.0.0.1:{}", server.port)).collect();
        format!("postgres://authros:{PASSWORD}@{}/{database}", hosts.join(","))
    }

    /// What a statement of the superuser answers, without headings.
    pub fn sql(&self, database: &str, statement: &str) -> String {
        self.asked(database, statement).unwrap_or_else(|error| panic!("{statement}: {error}"))
    }

    fn asked(&self, database: &str, statement: &str) -> Result<String, String> {
        let mut command = self.program("psql");
        command.args(["-X", "-A", "-t", "-q", "-v", "ON_ERROR_STOP=1", "-U", "postgres", "-p", &self.port.to_string()]);
        let output = command.arg("-h").arg(self.folder.path()).args(["-c", statement, database]).output();
        let output = output.expect("psql");
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).trim().to_owned();
        if output.status.success() { Ok(text(&output.stdout)) } else { Err(text(&output.stderr)) }
    }

    fn data(&self) -> PathBuf {
        self.folder.path().join("data")
    }

    fn program(&self, name: &str) -> Command {
        let mut command = Command::new(self.programs.join(name));
        command.current_dir("/");
        if let Some((user, group)) = self.user {
            command.uid(user).gid(group);
        }
        command
    }

    fn run(&self, command: &mut Command) {
        let output = command.output().expect("it runs");
        assert!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
    }
}

impl Drop for Postgres {
    fn drop(&mut self) {
        if let Some(server) = self.server.take() {
            server.stop("QUIT", 20);
        }
    }
}

fn user() -> Result<Option<(u32, u32)>, &'static str> {
    let own = std::fs::metadata("/proc/self").map(|about| std::os::unix::fs::MetadataExt::uid(&about));
    if own.is_ok_and(|own| own != 0) {
        return Ok(None);
    }
    let users = std::fs::read_to_string("/etc/passwd").expect("users");
    let line =
        users.lines().find(|line| line.starts_with("postgres:")).ok_or("root runs this, and no user is postgres")?;
    let fields: Vec<&str> = line.split(':').collect();
    let number = |place: usize| fields.get(place).and_then(|field| field.parse().ok()).expect("a number");
    Ok(Some((number(2), number(3))))
}

fn programs() -> Option<PathBuf> {
    let versions = PLACES.iter().flat_map(|place| std::fs::read_dir(place).into_iter().flatten().flatten());
    let path = std::env::var_os("PATH").unwrap_or_default();
    let mut known = versions.map(|version| version.path().join("bin")).chain(std::env::split_paths(&path));
    let is_whole = |folder: &Path| ["postgres", "initdb", "psql"].iter().all(|name| folder.join(name).is_file());
    known.find(|folder| folder.is_absolute() && is_whole(folder))
}

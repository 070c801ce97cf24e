//! A PostgreSQL server for the tests of this process, with a schema for each ledger. Tests of stores that a gateway's desk
//! has run on a file, and by `on_a_server!` on it, too. Without PostgreSQL these say that they are skipped.

use std::cell::{Cell, RefCell};
use std::io::Write as _;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use crate::sql::postgres::{Client, Server};

/// Where distributions and `tests/run` have the programs, if they are not in the path.
const PLACES: [&str; 2] = ["/usr/lib/postgresql", "/usr/pgsql"];
/// Ends and removes the server when its standard input ends, with the process that has the other end.
const KEEP: &str = r#""$1/postgres" -D "$2/data" -k "$2" -c listen_addresses= -c fsync=off -c max_connections=200 \
    -c shared_buffers=32MB -c logging_collector=off >"$2/log" 2>&1 &
    pid=$!; read -r _; kill -QUIT $pid; wait $pid; rm -rf "$2""#;

pub(super) struct Cluster {
    folder: PathBuf,
    /// Its standard input is open as long as this process runs.
    _keeper: Child,
    schemas: AtomicU64,
}

thread_local! {
    static ON_A_SERVER: Cell<bool> = const { Cell::new(false) };
    /// Of this test's newest ledger.
    static SCHEMA: RefCell<String> = const { RefCell::new(String::new()) };
}

/// Whether this test's ledgers are to be on the server.
pub(crate) fn is_here() -> bool {
    ON_A_SERVER.get()
}

/// Of a new ledger, or the newest, if this test's are on the server.
pub(crate) fn address(is_new: bool) -> Option<String> {
    if !is_here() {
        return None;
    }
    if is_new {
        SCHEMA.set(shared().expect("it runs").schema());
    }
    Some(SCHEMA.with_borrow(Clone::clone))
}

/// Of the process, or why there is none.
pub(super) fn shared() -> Result<&'static Cluster, &'static str> {
    static SHARED: OnceLock<Result<Cluster, String>> = OnceLock::new();
    SHARED.get_or_init(Cluster::start).as_ref().map_err(String::as_str)
}

/// Runs a test whose ledgers are on the server.
pub(crate) fn run(name: &str, test: fn()) {
    if let Err(reason) = shared() {
        return skip(name, reason);
    }
    ON_A_SERVER.set(true);
    test();
    ON_A_SERVER.set(false);
}

pub(super) fn skip(name: &str, reason: &str) {
    let line = format!("\nSKIPPED store::{name}: {reason}\n");
    drop(std::io::stderr().write_all(line.as_bytes()));
}

macro_rules! on_a_server {
    ($($test:ident),* $(,)?) => {
        mod on_a_server {
            $(
                #[test]
                fn $test() {
                    $crate::ledger::tests::server::run(stringify!($test), super::$test);
                }
            )*
        }
    };
}
pub(crate) use on_a_server;

impl Cluster {
    pub fn start() -> Result<Self, String> {
        let programs = programs().ok_or("no PostgreSQL; tests/run installs it")?;
        let folder = tempfile::Builder::new().prefix("authros-pg").tempdir().expect("a folder").keep();
        let user = user()?;
        if let Some((user, group)) = user {
            std::os::unix::fs::chown(&folder, Some(user), Some(group)).map_err(|error| error.to_string())?;
        }
        let as_user = |command: &mut Command| {
            command.current_dir("/");
            if let Some((user, group)) = user {
                command.uid(user).gid(group);
            }
        };
        let mut made = Command::new(programs.join("initdb"));
        as_user(
            made.args(["-A", "trust", "-U", "postgres", "-E", "UTF8", "--locale=C", "-N", "-D"])
                .arg(folder.join("data")),
        );
        let made = made.output().map_err(|error| error.to_string())?;
        if !made.status.success() {
            return Err(format!("initdb failed: {}", String::from_utf8_lossy(&made.stderr)));
        }
        let mut keeper = Command::new("sh");
        as_user(keeper.args(["-c", KEEP, "sh"]).arg(programs).arg(&folder).stdin(Stdio::piped()));
        let keeper = keeper.spawn().map_err(|error| error.to_string())?;
        let cluster = Self { folder, _keeper: keeper, schemas: AtomicU64::new(0) };
        let deadline = Instant::now() + Duration::from_secs(60);
        loop {
            match cluster.admin() {
                Ok(client) => {
                    client.script("CREATE ROLE authros LOGIN").expect("an ordinary user");
                    return Ok(cluster);
                }
                Err(error) if Instant::now() > deadline => return Err(format!("it does not start: {error}")),
                Err(_) => std::thread::sleep(Duration::from_millis(30)),
            }
        }
    }

    fn server(&self, user: &str, schema: &str) -> String {
        let folder = self.folder.display().to_string().replace('/', "%2F");
        format!("postgres://{user}@{folder}/postgres?options=-csearch_path%3D{schema}")
    }

    /// A connection of the superuser.
    pub fn admin(&self) -> crate::sql::Result<Client> {
        Server::at(&self.server("postgres", "public"), None).expect("an address").connect()
    }

    /// What ALTER SYSTEM writes.
    pub fn settings(&self) -> PathBuf {
        self.folder.join("data/postgresql.auto.conf")
    }

    /// Without a connection.
    pub fn reload(&self) {
        let file = std::fs::read_to_string(self.folder.join("data/postmaster.pid")).expect("it runs");
        let server = file.lines().next().and_then(|line| line.parse().ok()).and_then(rustix::process::Pid::from_raw);
        rustix::process::kill_process(server.expect("a number"), rustix::process::Signal::HUP).expect("told");
    }

    /// The address of an empty schema of an ordinary user.
    pub fn schema(&self) -> String {
        let name = format!("t{}", self.schemas.fetch_add(1, Ordering::Relaxed));
        let admin = self.admin().expect("connects");
        admin.script(&format!("CREATE SCHEMA {name} AUTHORIZATION authros")).expect("a schema");
        self.server("authros", &name)
    }
}

/// PostgreSQL refuses to run as root.
fn user() -> Result<Option<(u32, u32)>, String> {
    if !rustix::process::geteuid().is_root() {
        return Ok(None);
    }
    let users = std::fs::read_to_string("/etc/passwd").map_err(|error| error.to_string())?;
    let line =
        users.lines().find(|line| line.starts_with("postgres:")).ok_or("root runs this, and no user is postgres")?;
    let fields: Vec<&str> = line.split(':').collect();
    let number = |place: usize| fields.get(place).and_then(|field| field.parse().ok());
    Ok(Some(number(2).zip(number(3)).ok_or("the user postgres has no number")?))
}

fn programs() -> Option<PathBuf> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let versions = PLACES.iter().flat_map(|place| std::fs::read_dir(place).into_iter().flatten().flatten());
    let known = versions.map(|version| version.path().join("bin"));
    let is_whole = |folder: &PathBuf| folder.join("postgres").is_file() && folder.join("initdb").is_file();
    known.chain(std::env::split_paths(&path)).find(is_whole).filter(|folder| Path::new(folder).is_absolute())
}

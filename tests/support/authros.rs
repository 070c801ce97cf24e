//! The program under test, run as by a user: its own home, no terminal, no inherited settings.

use std::fs;
use std::os::unix::fs::FileTypeExt;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;
use tempfile::TempDir;

use super::process::{Outcome, Running};
use super::text;

/// How long one command may take, in seconds, unless a test says otherwise.
const LIMIT: u64 = 120;

/// Exit codes: something is away; something is not whole yet.
const UNREACHABLE: i32 = 4;
const INCOMPLETE: i32 = 8;

/// The program under test: the one built beside the tests, or what `AUTHROS_TEST_BINARY` names.
pub fn program_under_test() -> PathBuf {
    std::env::var_os("AUTHROS_TEST_BINARY").map_or_else(|| env!("CARGO_BIN_EXE_authros").into(), PathBuf::from)
}

/// The program whose checks can be switched off and whose fail points end it, if `tests/run` has built it.
pub fn faulty() -> Option<PathBuf> {
    let built = Path::new(env!("CARGO_BIN_EXE_authros")).with_file_name("examples/authros-faulty");
    built.exists().then_some(built)
}

/// A fresh user account: an empty `HOME`, and in it the path of an AuthROS home that does not exist yet.
#[derive(Debug)]
pub struct Home {
    directory: TempDir,
}

impl Home {
    /// An empty one.
    pub fn new() -> Self {
        Self { directory: tempfile::Builder::new().prefix("authros").tempdir().expect("a temporary directory") }
    }

    /// The value of `HOME`.
    pub fn root(&self) -> &Path {
        self.directory.path()
    }

    /// The value of `--home`.
    pub fn path(&self) -> PathBuf {
        self.root().join("site")
    }

    /// Writes a file into `HOME`.
    pub fn file(&self, name: &str, bytes: impl AsRef<[u8]>, mode: u32) -> String {
        use std::os::unix::fs::PermissionsExt;
        let path = self.root().join(name);
        fs::write(&path, bytes).expect("the file is written");
        fs::set_permissions(&path, fs::Permissions::from_mode(mode)).expect("its mode is set");
        path.to_str().expect("UTF-8").to_owned()
    }

    /// The program without `--profile`.
    pub fn authros(&self) -> Authros {
        let site = self.path();
        Authros {
            program: program_under_test(),
            root: self.root().to_owned(),
            prefix: Vec::new(),
            options: vec!["--home".into(), site.to_str().expect("UTF-8").to_owned()],
            // Records that the site states on its own would be counted by tests that are not about them.
            environment: vec![("AUTHROS_AUDIT_ANCHOR_EVERY".to_owned(), "86400".to_owned())],
        }
    }

    /// The program for a named profile.
    pub fn profile(&self, name: &str) -> Authros {
        self.authros().with(&["--profile", name])
    }

    /// The site's socket, once it accepts connections.
    pub fn socket(&self) -> Option<PathBuf> {
        let is_open = |path: &PathBuf| is_socket(path) && UnixStream::connect(path).is_ok();
        files_below(&self.path()).into_iter().find(is_open)
    }
}

fn is_socket(path: &Path) -> bool {
    fs::symlink_metadata(path).is_ok_and(|about| about.file_type().is_socket())
}

/// Every file below a directory.
pub fn files_below(directory: &Path) -> Vec<PathBuf> {
    let Ok(entries) = fs::read_dir(directory) else { return Vec::new() };
    let paths = entries.filter_map(Result::ok).map(|entry| entry.path());
    paths.flat_map(|path| if path.is_dir() { files_below(&path) } else { vec![path] }).collect()
}

/// The program with the options a test gives to all of its commands.
#[derive(Debug, Clone)]
pub struct Authros {
    program: PathBuf,
    root: PathBuf,
    prefix: Vec<String>,
    options: Vec<String>,
    environment: Vec<(String, String)>,
}

impl Authros {
    /// With this `HOME` and without `--home`.
    pub fn bare(root: &Path) -> Self {
        let program = program_under_test();
        Self { program, root: root.to_owned(), prefix: Vec::new(), options: Vec::new(), environment: Vec::new() }
    }

    /// The same with more options, given after every command's own.
    pub fn with(&self, options: &[&str]) -> Self {
        let mut more = self.clone();
        more.options.extend(options.iter().map(|&option| option.to_owned()));
        more
    }

    /// The same with another build of the program.
    pub fn with_program(&self, program: &Path) -> Self {
        Self { program: program.to_owned(), ..self.clone() }
    }

    /// The same with arguments before every command's own, for a program that runs another one.
    pub fn with_prefix(&self, arguments: &[&str]) -> Self {
        Self { prefix: arguments.iter().map(|&argument| argument.to_owned()).collect(), ..self.clone() }
    }

    /// The same with an environment variable.
    pub fn with_variable(&self, name: &str, value: &str) -> Self {
        let mut more = self.clone();
        more.environment.push((name.to_owned(), value.to_owned()));
        more
    }

    /// The same for a user who has not asked for stored passphrases.
    pub fn storing_no_passphrase(&self) -> Self {
        self.with_variable("AUTHROS_STORE_PASSPHRASE", "")
    }

    /// The program's file.
    pub fn program(&self) -> &Path {
        &self.program
    }

    /// All arguments of a command.
    pub fn arguments(&self, arguments: &[&str]) -> Vec<String> {
        let prefix = self.prefix.iter().cloned();
        prefix
            .chain(arguments.iter().map(|&argument| argument.to_owned()))
            .chain(self.options.iter().cloned())
            .collect()
    }

    /// The whole environment of a command: nothing else is inherited.
    pub fn variables(&self) -> Vec<(String, String)> {
        let path = std::env::var("PATH").unwrap_or_default();
        let root = self.root.to_str().expect("UTF-8").to_owned();
        // Where a test gives no passphrase, nobody types one.
        let constant = [("LANG", "C.UTF-8"), ("RUST_BACKTRACE", "1"), ("AUTHROS_STORE_PASSPHRASE", "yes")];
        let constant = constant.map(|(name, value)| (name, value.to_owned()));
        let fixed = [("PATH", path), ("HOME", root)].into_iter().chain(constant);
        let fixed = fixed.map(|(name, value)| (name.to_owned(), value));
        fixed.chain(self.environment.iter().cloned()).collect()
    }

    /// Starts a command that runs beside the test.
    pub fn spawn(&self, arguments: &[&str]) -> Running {
        let mut command = Command::new(&self.program);
        command.args(self.arguments(arguments)).env_clear().envs(self.variables()).current_dir(&self.root);
        Running::start(command)
    }

    /// Runs a command to its end.
    pub fn run(&self, arguments: &[&str]) -> Outcome {
        self.spawn(arguments).wait(LIMIT)
    }

    /// Runs a command that must succeed, with `--json`. `status` also reports through its exit code, so 4 and 6 are
    /// allowed: a test that checks the code runs it itself.
    pub fn json(&self, arguments: &[&str]) -> Value {
        let outcome = self.with(&["--json"]).run(arguments);
        let tells = arguments == ["status"] && matches!(outcome.code, Some(4 | 6));
        if tells { outcome.document() } else { outcome.expect_code(0).document() }
    }

    /// The same, with a time limit in seconds.
    pub fn json_within(&self, seconds: u64, arguments: &[&str]) -> Value {
        self.with(&["--json"]).spawn(arguments).wait(seconds).expect_code(0).document()
    }

    /// Runs a command that must fail with `code`, as text and with `--json`; returns the message.
    pub fn fails(&self, code: i32, arguments: &[&str]) -> String {
        let outcome = self.with(&["--json"]).run(arguments).expect_code(code);
        let error = &outcome.document()["error"];
        let message = text(error, "message");
        assert!(!text(error, "kind").is_empty() && message.len() > 10, "says what and why: {outcome}");
        message
    }

    /// Runs a command on a record this profile may not read: refused, and nothing of the record shown.
    pub fn is_refused(&self, arguments: &[&str]) {
        let outcome = self.with(&["--json"]).run(arguments).expect_code(5);
        let document = outcome.document();
        let told = document["error"]["message"].is_string() || document["verdict"] == "no_key";
        let shown =
            document["message"].is_object() || document["fields"].as_array().is_some_and(|rows| !rows.is_empty());
        assert!(told && !shown, "{outcome}");
    }

    /// Registers the profile, whose identity is created if there is none; returns its address.
    pub fn enrol(&self) -> String {
        let registered = self.json(&["identity", "register"]);
        assert_eq!(registered["registered"], true, "{registered}");
        text(&registered, "address")
    }

    /// Starts a site, whose own profile is then registered, and waits until it reports that it serves.
    pub fn serve(&self, home: &Home) -> Running {
        let mut site = self.spawn(&["serve"]);
        site.wait_for_text("serving", 60);
        assert!(home.socket().is_some(), "others can join");
        site
    }

    /// Captures `count` messages of each topic, all verified and none lost.
    pub fn capture(&self, topics: &[&str], count: u64) -> Value {
        let number = count.to_string();
        let mut arguments = vec!["capture", "--count", &number];
        arguments.extend(topics.iter().flat_map(|topic| ["--topic", topic]));
        let summary = self.json(&arguments);
        let all = count * u64::try_from(topics.len()).expect("few topics");
        assert_eq!(
            (&summary["captured"], &summary["verified"], &summary["lost"]),
            (&all.into(), &all.into(), &0.into())
        );
        summary
    }

    /// All records of a list, page by page: `records(&["records", "list", "--oldest"])`.
    pub fn records(&self, command: &[&str]) -> Vec<Value> {
        self.pages(command, &[]).expect("an answer with an error would have failed the test")
    }

    /// [`Self::records`] at a home that joins a gateway: nothing while it is away or its list is still on its way.
    pub fn records_so_far(&self, command: &[&str]) -> Option<Vec<Value>> {
        self.pages(command, &[UNREACHABLE, INCOMPLETE])
    }

    /// Every page of a list; nothing if one of these exit codes comes instead.
    fn pages(&self, command: &[&str], later: &[i32]) -> Option<Vec<Value>> {
        let mut records = Vec::new();
        let mut cursor: Option<String> = None;
        loop {
            let mut arguments = [command, &["--limit", "1000"]].concat();
            arguments.extend(cursor.iter().flat_map(|cursor| ["--after", cursor]));
            let outcome = self.with(&["--json"]).run(&arguments);
            if outcome.code.is_some_and(|code| later.contains(&code)) {
                return None;
            }
            let page = outcome.expect_code(0).document();
            records.extend(super::list(&page, "records"));
            let next = page["next"].as_str().map(str::to_owned);
            assert!(next.is_none() || next != cursor, "the next page is another page");
            match next {
                Some(next) => cursor = Some(next),
                None => return Some(records),
            }
        }
    }
}

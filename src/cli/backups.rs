//! Scheduled backups, the restore drill, and the hand-over from a console to `authros serve`.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::{convert::Infallible, ffi::OsString, os::unix::process::CommandExt as _};

use authros_output::Output;
use clap::builder::RangedU64ValueParser;
use clap::{Args, Subcommand, ValueEnum as _};

use super::args::Global;
use super::audit::{self, AuditArguments};
use super::check::backed_up;
use super::connect::{Context, ProfileNeed};
use super::plan::{self, NEITHER};
use super::{parse::absolute, passphrase, printed, serve::OWN_PROGRAM};
use crate::crypto::unfinished::{self, UnfinishedFolder};
use crate::crypto::{Passphrase, UnlockedKeyring};
use crate::model::{ErrorKind, ProfileName, Timestamp};
use crate::paths::Home;
use crate::service::reply::{input, refused};
use crate::service::{Client, Failure, SecretText, command::BackUp, restoring};

/// Prefix and suffix of backup files; the time is in between.
const NAME: (&str, &str) = ("authros-", ".backup");

/// `backup …`
#[derive(Debug, Subcommand)]
pub enum BackupVerb {
    /// Write profiles, store and chain, settings and pins into one encrypted file
    Create(CreateArguments),
    /// Test a backup: restore it into a temporary folder, audit all of it, and remove that folder
    Check {
        /// The file; type its own passphrase, or pass it as for a keyring
        file: PathBuf,
    },
    /// Restore a home from a backup, into an empty folder
    Restore {
        /// The file; type its own passphrase, or pass it as for a keyring
        file: PathBuf,
    },
}

/// `backup create …`
#[derive(Debug, Args)]
pub struct CreateArguments {
    /// The file; type its own passphrase, or pass it as for a keyring
    #[arg(required_unless_present = "to")]
    pub file: Option<PathBuf>,
    /// Instead of a file: a folder to write one more backup to, named by the time
    #[arg(long, value_name = "DIR", conflicts_with = "file")]
    pub to: Option<PathBuf>,
    /// How many of the newest files in --to to keep; older backups there are removed
    #[arg(long, value_name = "N", requires = "to", value_parser = RangedU64ValueParser::<usize>::new().range(1..=10_000))]
    pub keep: Option<usize>,
}

pub async fn run(context: Context, verb: BackupVerb, output: &Output) -> Result<u8, Failure> {
    match verb {
        BackupVerb::Create(arguments) => create(context, arguments, output).await,
        BackupVerb::Check { file } => check(context, &file, output).await,
        BackupVerb::Restore { file } => super::check::run_restore(&context, &file, output),
    }
}

async fn create(context: Context, backup: CreateArguments, output: &Output) -> Result<u8, Failure> {
    let folder = backup.to.as_deref().map(absolute).transpose()?;
    let file = match (&backup.file, &folder) {
        (Some(file), _) => absolute(file)?,
        (None, Some(folder)) if folder.is_dir() => folder.join(name_at(Timestamp::now())),
        (None, Some(folder)) => {
            let advice = "create it, or mount the disk that holds it";
            return Err(input(format!("{} is not a folder; {advice}", folder.display())));
        }
        (None, None) => return Err(Failure::new(ErrorKind::Usage, "give a file, or a folder with --to")),
    };
    let passphrase = passphrase::of_backup(&context.global, true)?;
    let back_up = async |client: &Client| printed::told(client, client.ask(BackUp { file, passphrase }), output).await;
    let mut view = context.with(NEITHER, ProfileNeed::None, output, back_up).await?;
    if let (Some(folder), Some(keep)) = (folder, backup.keep) {
        let removed = remove_old(&folder, keep).map_err(|error| {
            let what = "the backup was written, but old ones in";
            Failure::new(ErrorKind::Home, format!("{what} {} could not be removed: {error}", folder.display()))
        })?;
        view.notes.extend(removed.iter().map(|name| format!("{name} was removed; {keep} newer ones remain")));
    }
    output.result(&view, || backed_up(&view));
    Ok(0)
}

/// `authros-20270131T120000Z.backup`: names sort by time.
fn name_at(now: Timestamp) -> String {
    let digits: String =
        now.to_string().split('.').next().unwrap_or_default().chars().filter(char::is_ascii_alphanumeric).collect();
    format!("{}{}Z{}", NAME.0, digits.trim_end_matches('Z'), NAME.1)
}

fn is_own(name: &str) -> bool {
    let Some(time) = name.strip_prefix(NAME.0).and_then(|rest| rest.strip_suffix(NAME.1)) else { return false };
    let fits = |(index, byte): (usize, u8)| match index {
        8 => byte == b'T',
        15 => byte == b'Z',
        _ => byte.is_ascii_digit(),
    };
    time.len() == 16 && time.bytes().enumerate().all(fits)
}

/// Keeps the newest `keep` backups and all other files; returns the removed names.
fn remove_old(folder: &Path, keep: usize) -> std::io::Result<Vec<String>> {
    let mut own = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if is_own(&name) && entry.file_type()?.is_file() {
            own.push(name);
        }
    }
    own.sort();
    own.truncate(own.len().saturating_sub(keep));
    own.iter().try_for_each(|name| std::fs::remove_file(folder.join(name)))?;
    Ok(own)
}

/// Restores into a temporary folder, audits every record, removes the folder.
async fn check(context: Context, file: &Path, output: &Output) -> Result<u8, Failure> {
    let passphrase = passphrase::of_backup(&context.global, false)?;
    let beside = absolute(context.home.root())?.parent().map_or_else(std::env::temp_dir, Path::to_path_buf);
    let unmade = |error: std::io::Error| {
        Failure::new(ErrorKind::Home, format!("a folder in {} cannot be created: {error}", beside.display()))
    };
    std::fs::create_dir_all(&beside).map_err(unmade)?;
    unfinished::sweep(&beside).map_err(unmade)?;
    let folder = UnfinishedFolder::new(&beside).map_err(unmade)?;
    let home: PathBuf = folder.path().join("home");
    let view = restoring::restore(file, &Home::new(home.clone()), &passphrase)?;
    output.note(&backed_up(&view));
    let mut drill = Context { home: Home::new(home), ..context };
    // A backup is of a file.
    drill.config.store_url = None;
    let arguments = AuditArguments { verb: None, deep: true, since: None };
    let plan = audit::plan(&drill, &arguments, output)?;
    let code = plan::run(drill, plan, output).await;
    folder.close().map_err(unmade)?;
    code
}

pub struct Successor {
    global: Global,
    home: Home,
    profile: ProfileName,
}

impl Successor {
    pub fn of(context: &Context) -> Self {
        Self { global: context.global.clone(), home: context.home.clone(), profile: context.profile.clone() }
    }

    /// The one that opens the keyring: given, or typed at the terminal, which the console has just left.
    pub fn passphrase(&self) -> Result<SecretText, Failure> {
        // First of all: what is typed meanwhile must not be shown.
        let mut hidden = passphrase::terminal::begin()?.ok_or_else(|| refused("there is no terminal"))?;
        let keyring = self.home.keyring(&self.profile);
        let open = |passphrase: &Passphrase| UnlockedKeyring::open(&keyring, passphrase).map(drop);
        // The descriptor was read at the start.
        let global = Global { passphrase_fd: None, ..self.global.clone() };
        if let Ok(Some(given)) = passphrase::given(&global, &self.home, &self.profile)
            && Passphrase::new(given.expose().to_owned()).is_ok_and(|given| open(&given).is_ok())
        {
            return Ok(given);
        }
        let question = format!("Passphrase of profile '{}' (enter alone: back to the console)", self.profile);
        passphrase::terminal::that_opens(&mut hidden, &question, open).map(|(typed, ())| typed)
    }

    /// Replaces this process; returns only on failure. The site must have been stopped.
    pub fn become_it(&self, secret: &SecretText) -> Failure {
        let start = || -> std::io::Result<Infallible> {
            let reader = passphrase::pipe(secret)?;
            let mut command = Command::new(OWN_PROGRAM);
            command.arg0("authros").arg("serve").args(words(&self.global, &self.home, &self.profile));
            Err(command.args(["--detach", "--passphrase-fd", "0"]).stdin(Stdio::from(reader)).exec())
        };
        let Err(error) = start();
        let text = format!("nothing was left running: {error}; capture has stopped, start it with `authros serve`");
        Failure::new(ErrorKind::Internal, text)
    }
}

/// The console's flags for its successor, without those of a passphrase and of an operator.
fn words(global: &Global, home: &Home, profile: &ProfileName) -> Vec<OsString> {
    let log = global.log.to_possible_value().map(|value| format!("--log={}", value.get_name()));
    let mut words: Vec<OsString> = vec!["--home".into(), home.root().into(), format!("--profile={profile}").into()];
    words.extend(global.json.then(|| OsString::from("--json")));
    words.extend(global.trust_first.then(|| OsString::from("--trust-first")));
    words.extend(log.map(OsString::from));
    let valued = global.valued().into_iter().filter_map(|(flag, _, value)| Some(format!("{flag}={}", value?)));
    words.extend(valued.map(OsString::from));
    words.extend(global.site.iter().map(|value| OsString::from(format!("--site={value}"))));
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_in_the_order_of_their_times_and_are_known_again() {
        let names: Vec<String> =
            [0, 1_000_000_000, 1_700_000_000].map(|seconds| name_at(Timestamp::from_seconds(seconds))).into();
        assert_eq!(
            names,
            ["authros-19700101T000000Z.backup", "authros-20010909T014640Z.backup", "authros-20231114T221320Z.backup"]
        );
        assert!(names.iter().all(|name| is_own(name)) && names.is_sorted());
    }

    #[test]
    fn only_the_oldest_of_ones_own_files_are_removed() {
        let folder = tempfile::tempdir().expect("a folder");
        let all = [
            "authros-20010909T014640Z.backup",
            "authros-20231114T221320Z.backup",
            "authros-20231115T221320Z.backup",
            "authros-20010909.backup",
            "authros-20010909T014640Z.backup.old",
            "authros-2001090xT014640Z.backup",
            "notes.txt",
        ];
        all.iter().for_each(|name| std::fs::write(folder.path().join(name), b"x").expect("written"));
        std::fs::create_dir(folder.path().join("authros-19990909T014640Z.backup")).expect("a folder of that name");
        assert_eq!(remove_old(folder.path(), 2).expect("removed"), [all[0]]);
        assert!(all[1..].iter().all(|name| folder.path().join(name).exists()));
        assert_eq!(remove_old(folder.path(), 2).expect("looked"), Vec::<String>::new());
    }
}

#[cfg(test)]
mod handover_tests {
    use super::*;
    use crate::cli::args::Arguments;
    use clap::Parser;

    #[test]
    fn the_successor_has_the_settings_of_the_console_and_no_passphrase() {
        let given = [
            "authros",
            "--robots",
            "1",
            "--ros2",
            "7",
            "--chain",
            "http://node:8545",
            "--confirmations",
            "3",
            "--cache",
            "redis://host:6379",
            "--site",
            "a:1",
            "--site",
            "b:2",
            "--passphrase-file",
            "/secret/place",
        ];
        let console = Arguments::try_parse_from(given).expect("arguments").global;
        let home = Home::new("/srv/a home".into());
        let words = words(&console, &home, &"bob".parse().expect("a name"));
        assert!(words.iter().all(|word| !word.to_string_lossy().contains("secret")), "{words:?}");
        let line = ["authros".into(), "serve".into()].into_iter().chain(words).chain(["--detach".into()]);
        let serve = Arguments::try_parse_from(line).expect("it parses").global;
        for setting in
            ["robots", "ros.domain", "chain.url", "confirmations", "cache.url", "site.address", "anchor.mode"]
        {
            assert_eq!(serve.setting(setting), console.setting(setting), "{setting}");
        }
        assert_eq!(serve.home.as_deref(), Some(Path::new("/srv/a home")));
        assert_eq!(serve.profile.as_deref(), Some("bob"));
    }
}

//! A console that leaves a site running in its place. The passphrase is asked for and tried while the site still
//! captures; then the site is stopped, everything acknowledged being on disk, and this process becomes `authros serve
//! --detach`. What is unlocked in memory is handed to nobody: the passphrase alone goes through a pipe.

use std::ffi::OsString;
use std::io::Write as _;
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::{Command, Stdio};

use clap::ValueEnum as _;

use super::args::Global;
use super::connect::Context;
use super::detach::OWN_PROGRAM;
use super::passphrase;
use crate::crypto::{Passphrase, UnlockedKeyring};
use crate::model::{ErrorKind, ProfileName};
use crate::paths::Home;
use crate::service::{Failure, SecretText};
use crate::term::ask;

/// How often a passphrase is asked for.
const ATTEMPTS: usize = 3;

/// What the successor of a console needs to know.
pub struct Successor {
    global: Global,
    home: Home,
    profile: ProfileName,
}

impl Successor {
    /// Of a console that begins with these settings.
    pub fn of(context: &Context) -> Self {
        Self { global: context.global.clone(), home: context.home.clone(), profile: context.profile.clone() }
    }

    /// The passphrase, which opens the keyring.
    ///
    /// # Errors
    /// If none is given that does.
    pub fn passphrase(&self) -> Result<SecretText, Failure> {
        let keyring = self.home.keyring(&self.profile);
        // A descriptor was read at the start.
        let global = Global { passphrase_fd: None, ..self.global.clone() };
        if let Ok(Some(given)) = passphrase::given(&global, &self.home, &self.profile)
            && opens(&keyring, &given).is_ok()
        {
            return Ok(given);
        }
        let mut refusal = None;
        for _ in 0..ATTEMPTS {
            let again = refusal.as_ref().map_or("", |_| "That one does not open it. ");
            let question = format!("{again}Passphrase of profile '{}'", self.profile);
            let typed = ask::secret(&question).ok().flatten().ok_or_else(none_given)?;
            let typed = SecretText::new(typed.to_string());
            match opens(&keyring, &typed) {
                Ok(()) => return Ok(typed),
                Err(failure) => refusal = Some(failure),
            }
        }
        Err(refusal.unwrap_or_else(none_given))
    }

    /// Becomes the successor; returns only if that fails. The site must have been stopped.
    pub fn become_it(&self, secret: &SecretText) -> Failure {
        let failed = |error: std::io::Error| {
            let text = format!("nothing was left running: {error}; capture has stopped, start it with `authros serve`");
            Failure::new(ErrorKind::Internal, text)
        };
        let (reader, mut writer) = match std::io::pipe() {
            Ok(ends) => ends,
            Err(error) => return failed(error),
        };
        // At most 4 KiB, which a pipe holds; what is written stays readable for the program that follows.
        if let Err(error) = writer.write_all(secret.expose().as_bytes()).and_then(|()| writer.write_all(b"\n")) {
            return failed(error);
        }
        drop(writer);
        let mut command = Command::new(OWN_PROGRAM);
        command.arg0("authros").arg("serve").args(words(&self.global, &self.home, &self.profile));
        failed(command.args(["--detach", "--passphrase-fd", "0"]).stdin(Stdio::from(reader)).exec())
    }
}

/// What to say when the passphrase was not given after all: the console was told to leave.
fn none_given() -> Failure {
    let text =
        "no passphrase was given, so nothing is left running; capture has stopped, start it with `authros serve`";
    Failure::new(ErrorKind::Refused, text)
}

fn opens(keyring: &Path, secret: &SecretText) -> Result<(), Failure> {
    let passphrase = Passphrase::new(secret.expose().to_owned())?;
    UnlockedKeyring::open(keyring, &passphrase)?;
    Ok(())
}

/// The flags of the console as those of its successor. Each has its place here, so that one that is forgotten does not
/// compile; those of a passphrase and of an operator, who leaves no site, are not passed on.
fn words(global: &Global, home: &Home, profile: &ProfileName) -> Vec<OsString> {
    let Global {
        home: _,
        profile: _,
        json,
        log,
        passphrase_file: _,
        passphrase_fd: _,
        site_socket: _,
        ros_master,
        ros2,
        chain,
        contract,
        consensus,
        vault,
        robots,
        robots_by,
        confirmations,
        crypto_provider,
        site,
        gateway_key,
        trust_first,
        also,
        anchor_mode,
    } = global;
    let log = log.to_possible_value().map(|value| value.get_name().to_owned());
    let mut words: Vec<OsString> = vec!["--home".into(), home.root().into(), format!("--profile={profile}").into()];
    words.extend(json.then(|| OsString::from("--json")));
    words.extend(trust_first.then(|| OsString::from("--trust-first")));
    let valued = [
        ("--log", &log),
        ("--ros-master", ros_master),
        ("--ros2", ros2),
        ("--chain", chain),
        ("--contract", contract),
        ("--consensus", consensus),
        ("--vault", vault),
        ("--robots", robots),
        ("--robots-by", robots_by),
        ("--confirmations", confirmations),
        ("--crypto-provider", crypto_provider),
        ("--site", site),
        ("--gateway-key", gateway_key),
        ("--anchor-mode", anchor_mode),
    ];
    for (flag, value) in valued {
        words.extend(value.as_ref().map(|value| OsString::from(format!("{flag}={value}"))));
    }
    words.extend(also.iter().map(|value| OsString::from(format!("--also={value}"))));
    words
}

#[cfg(test)]
mod tests {
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
            "--vault",
            "redis://host:6379",
            "--also",
            "a:1=00",
            "--also",
            "b:2=11",
            "--passphrase-file",
            "/secret/place",
        ];
        let console = Arguments::try_parse_from(given).expect("arguments").global;
        let home = Home::new("/srv/a home".into());
        let words = words(&console, &home, &"bob".parse().expect("a name"));
        assert!(words.iter().all(|word| !word.to_string_lossy().contains("secret")), "{words:?}");
        let line = ["authros".into(), "serve".into()].into_iter().chain(words).chain(["--detach".into()]);
        let serve = Arguments::try_parse_from(line).expect("it parses").global;
        for setting in ["robots", "ros.domain", "chain.url", "confirmations", "vault.url", "site.also", "anchor.mode"] {
            assert_eq!(serve.setting(setting), console.setting(setting), "{setting}");
        }
        assert_eq!(serve.home.as_deref(), Some(Path::new("/srv/a home")));
        assert_eq!(serve.profile.as_deref(), Some("bob"));
    }
}

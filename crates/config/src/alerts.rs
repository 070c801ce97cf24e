//! Who is notified of trouble, and what counts as trouble.

use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::crypto::hands::{self, Fault};
use crate::crypto::private_file;
use crate::model::clean;
use crate::read::{ConfigError, Source, Values, bytes, certificates, choice, number, source_of, span, value, wrong};

/// The shortest secret that may sign deliveries, bytes.
const SHORTEST_SECRET: usize = 16;
/// The longest file for it, bytes.
const LONGEST_SECRET: usize = 4096;
/// The most words in a command.
const MOST_WORDS: usize = 32;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AlertForm {
    /// One JSON object of our own format for each delivery.
    Authros,
    /// The format of an Alertmanager's API, version 2.
    Alertmanager,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum AlertPlace {
    Webhook {
        url: String,
        form: AlertForm,
        /// File with the secret that signs deliveries.
        secret: Option<PathBuf>,
        /// PEM file with the authorities to accept; `None` = those of this machine.
        roots: Option<PathBuf>,
    },
    Command(Vec<String>),
}

/// The thresholds of the alerts; `None` = that rule is off.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct AlertLimits {
    /// A robot has sent nothing for this long.
    pub robot_silent: Option<Duration>,
    /// A record has waited for a block this long.
    pub unanchored: Option<Duration>,
    /// Fewer bytes than this are free on the disk of the home.
    pub disk: u64,
    /// The clock differs by this much from the time by which rights are judged.
    pub clock: Option<Duration>,
    /// A grant ends within this time.
    pub grant_ends: Option<Duration>,
    /// A line of the audit log has waited for an anchored head this long.
    pub audit: Option<Duration>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AlertSettings {
    /// `None` = alerts are shown, not sent.
    pub place: Option<AlertPlace>,
    pub every: Duration,
    pub limits: AlertLimits,
}

impl AlertSettings {
    pub(super) fn read(values: &Values) -> Result<Self, ConfigError> {
        let limits = AlertLimits {
            robot_silent: span(values, "alerts.robot_silent", "never")?,
            unanchored: span(values, "alerts.unanchored", "never")?,
            disk: bytes(values, "alerts.disk", 0)?,
            clock: span(values, "alerts.clock", "never")?,
            grant_ends: span(values, "alerts.grant_ends", "never")?,
            audit: span(values, "alerts.audit", "never")?,
        };
        let every = Duration::from_secs(number(values, "alerts.every", 1, 3600)?);
        Ok(Self { place: place(values)?, every, limits })
    }
}

fn place(values: &Values) -> Result<Option<AlertPlace>, ConfigError> {
    let forms = [("authros", AlertForm::Authros), ("alertmanager", AlertForm::Alertmanager)];
    let form = choice(values, "alerts.form", forms)?;
    let (secret, roots) = (secret(values)?, certificates(values, "alerts.roots")?);
    match (webhook(values)?, command(values)?) {
        (Some(_), Some(_)) => {
            let what = "alerts.webhook is set as well; set only one of them (a program can call the webhook itself)";
            Err(wrong(values, "alerts.command", what))
        }
        (Some(url), None) => Ok(Some(AlertPlace::Webhook { url, form, secret, roots })),
        (None, Some(words)) => Ok(Some(AlertPlace::Command(words))),
        (None, None) => Ok(None),
    }
}

fn webhook(values: &Values) -> Result<Option<String>, ConfigError> {
    let Some(text) = value(values, "alerts.webhook") else { return Ok(None) };
    let wrong = |what| wrong(values, "alerts.webhook", what);
    let rest = text.strip_prefix("http://").or_else(|| text.strip_prefix("https://"));
    let rest = rest.filter(|rest| !rest.is_empty() && !rest.starts_with('/'));
    if rest.is_none() || text.len() > 500 || !text.bytes().all(|byte| byte.is_ascii_graphic()) {
        return Err(wrong("use http://HOST:PORT/PATH or https://"));
    }
    Ok(Some(text.to_owned()))
}

/// Checks at the start that the file, which is read on use, is readable.
fn secret(values: &Values) -> Result<Option<PathBuf>, ConfigError> {
    let Some(path) = value(values, "alerts.secret").map(PathBuf::from) else { return Ok(None) };
    let wrong = |what: &str| wrong(values, "alerts.secret", what);
    if !path.is_absolute() {
        // It may be the secret itself, so it is not repeated.
        let (name, value, source_name) = ("alerts.secret", "…".to_owned(), source_of(values, "alerts.secret"));
        let what = "give the absolute path of the file that holds the secret".to_owned();
        return Err(ConfigError::Value { name, value, source_name, what });
    }
    let bytes = private_file::read_private(&path, LONGEST_SECRET).map_err(|error| wrong(&error.to_string()))?;
    if bytes.trim_ascii().len() < SHORTEST_SECRET {
        return Err(wrong("the file holds fewer than 16 bytes; create a secret with `openssl rand -hex 32`"));
    }
    Ok(Some(path))
}

fn command(values: &Values) -> Result<Option<Vec<String>>, ConfigError> {
    let Some(text) = value(values, "alerts.command") else { return Ok(None) };
    let example = r#"["/usr/local/bin/page", "--site", "yard"]"#;
    command_words(text, example).map(Some).map_err(|what| wrong(values, "alerts.command", &what))
}

/// A program and its arguments, written as a list of texts; no shell reads them.
pub fn command_words(text: &str, example: &str) -> Result<Vec<String>, String> {
    let table: Option<toml::Table> = format!("words = {text}").parse().ok();
    let words = table.as_ref().and_then(|table| table.get("words")?.as_array());
    let words = words.and_then(|words| words.iter().map(|word| word.as_str().map(str::to_owned)).collect());
    let words = words.filter(|words: &Vec<String>| words.len() <= MOST_WORDS);
    let words = words.ok_or_else(|| format!("give the program and its arguments as {example}"))?;
    match words.first() {
        Some(program) if Path::new(program).is_absolute() => Ok(words),
        _ => Err("give the program's absolute path; no shell looks it up".to_owned()),
    }
}

/// Nobody else may be able to change the file that names the command, the program itself, or the folders above both.
pub(super) fn check_hands(values: &Values, file: Option<&Path>) -> Result<(), ConfigError> {
    let Some((_, source)) = values.get("alerts.command").filter(|(command, _)| !command.is_empty()) else {
        return Ok(());
    };
    let wrong = |what: String| wrong(values, "alerts.command", &what);
    if let (Source::File(_), Some(file)) = (source, file) {
        own_hands(file).map_err(wrong)?;
    }
    match command(values)?.and_then(|words| words.first().map(PathBuf::from)) {
        // A missing one is reported when it runs; its disk may not be there yet.
        Some(program) if program.exists() => own_hands(&program).map_err(wrong),
        _ => Ok(()),
    }
}

/// Checks that nobody else could run programs as this user through a file.
fn own_hands(file: &Path) -> Result<(), String> {
    let fault = hands::fault(file, rustix::process::geteuid().as_raw())
        .map_err(|error| format!("{} cannot be checked: {error}", shown(file)))?;
    match fault {
        None => Ok(()),
        Some(Fault::Foreign(path)) => Err(format!(
            "{} belongs to another user, who could run programs as you through it; chown it to yourself",
            shown(&path)
        )),
        Some(Fault::Open(path)) => {
            let path = shown(&path);
            Err(format!("others can write to {path} and could run programs as you; run chmod go-w on it"))
        }
    }
}

fn shown(path: &Path) -> String {
    clean(&path.display().to_string(), 200)
}

#[cfg(test)]
mod tests {
    use std::fs::{Permissions, set_permissions, write};
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;
    use crate::Config;

    fn none(_: &str) -> Option<String> {
        None
    }

    /// Settings from a file with this mode.
    fn alerts(text: &str, mode: u32) -> Result<AlertSettings, String> {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("config.toml");
        write(&path, text).expect("written");
        set_permissions(&path, Permissions::from_mode(mode)).expect("its mode");
        let config = Config::resolve(&none, &none, Some((&path, text)));
        config.map(|config| config.alerts).map_err(|error| error.to_string())
    }

    #[test]
    fn nobody_is_told_unless_somebody_is_named() {
        let settings = alerts("", 0o600).expect("defaults");
        assert_eq!(settings.place, None);
        assert_eq!((settings.every.as_secs(), settings.limits.disk), (10, 1 << 30));
        assert_eq!(settings.limits.robot_silent, Some(Duration::from_secs(600)));
        let off = alerts("[alerts]\nrobot_silent = \"never\"\ndisk = \"0\"", 0o600).expect("off");
        assert_eq!((off.limits.robot_silent, off.limits.disk), (None, 0));
    }

    #[test]
    fn a_webhook_is_an_address_and_its_secret_is_a_private_file() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("secret");
        let with = |bytes: &str, mode: u32| {
            write(&path, bytes).expect("written");
            set_permissions(&path, Permissions::from_mode(mode)).expect("its mode");
            let secret = path.display();
            alerts(&format!("[alerts]\nwebhook = \"http://127.0.0.1:9/x\"\nsecret = \"{secret}\""), 0o644)
        };
        let (url, form) = ("http://127.0.0.1:9/x".to_owned(), AlertForm::Authros);
        let wanted = AlertPlace::Webhook { url, form, secret: Some(path.clone()), roots: None };
        assert_eq!(with("0123456789abcdef\n", 0o600).expect("usable").place, Some(wanted));
        assert!(with("0123456789abcdef\n", 0o640).is_err(), "others read it");
        assert!(with("short\n", 0o600).expect_err("short").contains("16 bytes"));
        let tls = |roots: &str| alerts(&format!("[alerts]\nwebhook = \"https://h/\"\nroots = \"{roots}\""), 0o600);
        let place = tls(&path.display().to_string()).expect("usable").place;
        assert!(matches!(place, Some(AlertPlace::Webhook { roots: Some(_), .. })), "{place:?}");
        assert!(tls("/nowhere/at/all").is_err() && tls("roots.pem").is_err());
        assert!(alerts("[alerts]\nwebhook = \"http:///x\"", 0o600).is_err());
        assert!(alerts("[alerts]\nsecret = \"/nowhere/at/all\"", 0o600).is_err());
        assert!(alerts("[alerts]\nform = \"xml\"", 0o600).is_err());
    }

    #[test]
    fn a_program_that_others_could_replace_is_never_run() {
        let folder = tempfile::tempdir().expect("a folder");
        let program = folder.path().join("page");
        write(&program, "#!/bin/sh\n").expect("written");
        let words = format!("[\"{}\"]", program.display());
        let named = |name: &str| (name == "AUTHROS_ALERTS_COMMAND").then(|| words.clone());
        let read = |mode: u32, above: u32| {
            set_permissions(&program, Permissions::from_mode(mode)).expect("its mode");
            set_permissions(folder.path(), Permissions::from_mode(above)).expect("its mode");
            Config::resolve(&none, &named, None).map(|config| config.alerts.place).map_err(|error| error.to_string())
        };
        assert!(matches!(read(0o700, 0o700), Ok(Some(AlertPlace::Command(_)))));
        for (mode, above) in [(0o722, 0o700), (0o702, 0o700), (0o700, 0o720)] {
            let error = read(mode, above).expect_err("others write it");
            assert!(error.contains("chmod go-w"), "{mode:o} {above:o}: {error}");
        }
    }

    #[test]
    fn a_command_needs_a_settings_file_that_nobody_else_writes() {
        let text = "[alerts]\ncommand = [\"/bin/page\", \"a b\", \"$HOME\"]";
        let wanted = ["/bin/page", "a b", "$HOME"].map(str::to_owned).to_vec();
        assert_eq!(alerts(text, 0o600).expect("own").place, Some(AlertPlace::Command(wanted)));
        for mode in [0o620, 0o602, 0o666] {
            assert!(alerts(text, mode).expect_err("others write it").contains("chmod go-w"), "{mode:o}");
        }
        for bad in ["\"/bin/page\"", "[]", "[\"page\"]", "[1]"] {
            assert!(alerts(&format!("[alerts]\ncommand = {bad}"), 0o600).is_err(), "{bad}");
        }
        for (mode, folder) in [(0o777, true), (0o770, true), (0o1777, false)] {
            let place = tempfile::tempdir().expect("a folder");
            set_permissions(place.path(), Permissions::from_mode(mode)).expect("its mode");
            let path = place.path().join("config.toml");
            write(&path, text).expect("written");
            let read = Config::resolve(&none, &none, Some((&path, text))).map_err(|error| error.to_string());
            assert_eq!(read.is_err_and(|error| error.contains("chmod go-w")), folder, "a folder of {mode:o}");
        }
        let both = format!("{text}\nwebhook = \"http://h:1/\"");
        assert!(alerts(&both, 0o600).expect_err("both").contains("only one of them"));
    }
}

//! Passphrases: given by a file, a descriptor or a program, stored beside the keyring, or typed at the terminal. Never
//! from argv or the environment.

pub mod program;
pub mod terminal;

use std::io::{PipeReader, Read as _, Write as _};
use std::path::Path;

use super::{args::Global, connect::Context, parse::usage, plan::Plan};
use crate::crypto::{Passphrase, UnlockedKeyring, private_file};
use crate::model::{ErrorKind, ProfileName};
use crate::paths::Home;
use crate::service::reply::{input, refused};
use crate::service::{Failure, SecretText, command::ChangePassphrase};
use crate::store::{atomic_write, files};
use authros_output::Output;

/// The longest passphrase read, bytes.
const LONGEST: usize = 4096;
/// The options that give one.
pub const SOURCES: &str = "--passphrase-file, --passphrase-fd or --passphrase-command";

fn first_line(text: &str) -> SecretText {
    SecretText::new(text.lines().next().unwrap_or_default().to_owned())
}

/// The first line of a 0600 file.
pub fn from_file(path: &Path) -> Result<SecretText, Failure> {
    let bytes = private_file::read_private(path, LONGEST)?;
    let text = std::str::from_utf8(&bytes).map_err(|_| input(format!("{} is not text", path.display())))?;
    Ok(first_line(text))
}

fn from_descriptor(number: u32) -> Result<SecretText, Failure> {
    let unread = |error: std::io::Error| input(format!("no passphrase can be read from descriptor {number}: {error}"));
    let file = std::fs::File::open(format!("/proc/self/fd/{number}")).map_err(unread)?;
    let mut text = zeroize::Zeroizing::new(String::new());
    file.take(LONGEST as u64).read_to_string(&mut text).map_err(unread)?;
    Ok(first_line(&text))
}

fn owners_alone(global: &Global) -> Result<(), Failure> {
    if global.site_socket.is_none() {
        return Ok(());
    }
    let text = "an operator gives no passphrase: the owner of the site at --site-socket does this";
    Err(Failure::new(ErrorKind::Refused, text))
}

/// The passphrase passed in, or stored beside the keyring.
pub fn given(global: &Global, home: &Home, profile: &ProfileName) -> Result<Option<SecretText>, Failure> {
    owners_alone(global)?;
    of_source(global, &home.passphrase(profile))
}

/// With this command; does not read it.
pub fn is_passed(global: &Global) -> bool {
    global.passphrase_file.is_some() || global.passphrase_fd.is_some() || global.passphrase_command.is_some()
}

/// Does not read it.
pub fn is_given(global: &Global, home: &Home, profile: &ProfileName) -> bool {
    is_passed(global) || home.passphrase(profile).exists()
}

/// The one that opens the profile's keyring, typed at the terminal; `None` if there is no terminal.
pub fn typed(home: &Home, profile: &ProfileName) -> Result<Option<SecretText>, Failure> {
    let Some(mut hidden) = terminal::begin()? else { return Ok(None) };
    let keyring = home.keyring(profile);
    let question = format!("Passphrase of profile '{profile}'");
    let open = |passphrase: &Passphrase| UnlockedKeyring::open(&keyring, passphrase).map(drop);
    terminal::that_opens(&mut hidden, &question, open).map(|(typed, ())| Some(typed))
}

pub fn change(context: &Context, file: Option<&Path>, descriptor: Option<u32>) -> Result<Plan, Failure> {
    let (global, home, profile) = (&context.global, &context.home, &context.profile);
    owners_alone(global)?;
    if descriptor.is_some() && descriptor == global.passphrase_fd {
        return Err(usage("--passphrase-fd and --new-passphrase-fd name the same descriptor; use two"));
    }
    if !home.keyring(profile).exists() {
        return Err(refused(format!("profile '{profile}' has no identity yet, so there is no passphrase to change")));
    }
    let missing = |options: &str| usage(format!("no passphrase was given; use a terminal, or pass {options}"));
    let old = match given(global, home, profile)? {
        Some(old) => old,
        None => typed(home, profile)?.ok_or_else(|| missing(SOURCES))?,
    };
    let new = match (file, descriptor) {
        (Some(path), _) => from_file(path)?,
        (None, Some(number)) => from_descriptor(number)?,
        (None, None) => terminal::new_one(&new_question(profile))?.ok_or_else(|| missing("--new-passphrase-file"))?,
    };
    Ok(Plan::kept(ChangePassphrase { old, new }))
}

fn new_question(profile: &ProfileName) -> String {
    format!("New passphrase of profile '{profile}' (nobody can recover it)")
}

/// Removes the stored passphrase after a change: it opens nothing, and may be the reason for the change.
pub fn forget(home: &Home, profile: &ProfileName, output: &Output) -> Result<(), Failure> {
    let own = home.passphrase(profile);
    if !own.exists() {
        return Ok(());
    }
    std::fs::remove_file(&own).map_err(|error| {
        let text =
            format!("the passphrase was changed, but {} with the old one could not be removed: {error}", own.display());
        Failure::new(ErrorKind::Home, text)
    })?;
    output.note(&format!(
        "{} held the old passphrase and was removed; commands without a terminal need --passphrase-file from now on",
        own.display()
    ));
    Ok(())
}

/// The passphrase passed in, or in a file beside what it protects.
pub fn of_source(global: &Global, beside: &Path) -> Result<Option<SecretText>, Failure> {
    match (&global.passphrase_file, global.passphrase_fd, &global.passphrase_command) {
        (Some(path), ..) => from_file(path).map(Some),
        (None, Some(number), _) => from_descriptor(number).map(Some),
        (None, None, Some(program)) => program.passphrase().map(Some),
        (None, None, None) if beside.exists() => from_file(beside).map(Some),
        (None, None, None) => Ok(None),
    }
}

/// Of a backup: never the home's own. A new one is typed twice.
pub fn of_backup(global: &Global, is_new: bool) -> Result<SecretText, Failure> {
    of_its_own(global, "backup", is_new)
}

/// Of a file that goes to another machine: never the home's own. A new one is typed twice.
pub fn of_its_own(global: &Global, file: &str, is_new: bool) -> Result<SecretText, Failure> {
    let given = of_source(global, Path::new(""))?;
    let typed = || {
        if is_new {
            return terminal::new_one(&format!("New passphrase of this {file} (nobody can recover it)"));
        }
        terminal::once(&format!("Passphrase of the {file}"))
    };
    let secret = given.map_or_else(typed, |given| Ok(Some(given)))?;
    secret.ok_or_else(|| usage(format!("a {file} has a passphrase of its own: pass {SOURCES}")))
}

/// For a process of this program without a terminal: what it would ask for.
pub fn for_child(context: &Context) -> Result<Option<SecretText>, Failure> {
    let (global, home, profile) = (&context.global, &context.home, &context.profile);
    let is_new = !home.keyring(profile).exists();
    if is_given(global, home, profile) || is_new && global.store_passphrase {
        return Ok(None);
    }
    if is_new { terminal::new_one(&new_question(profile)) } else { typed(home, profile) }
}

/// A pipe that holds the passphrase: another program reads it there.
pub fn pipe(secret: &SecretText) -> std::io::Result<PipeReader> {
    let (reader, mut writer) = std::io::pipe()?;
    // A pipe holds at least 4 KiB, so the write does not block.
    writer.write_all(secret.expose().as_bytes())?;
    writer.write_all(b"\n")?;
    Ok(reader)
}

/// Deletes a new passphrase whose keys were not made; an older one may open a restored keyring.
pub fn forget_unused(is_new: bool, context: &Context) {
    let (home, profile) = (&context.home, &context.profile);
    if is_new && !home.keyring(profile).exists() {
        // Nothing is lost if it stays.
        drop(std::fs::remove_file(home.passphrase(profile)));
    }
}

/// For a new keyring: passed in, typed twice, or a random one if requested; `true` if it was stored.
pub fn given_or_new(context: &Context, output: &Output) -> Result<(SecretText, bool), Failure> {
    let (home, profile) = (&context.home, &context.profile);
    if let Some(secret) = given(&context.global, home, profile)? {
        return Ok((secret, false));
    }
    if context.global.store_passphrase {
        return store(home, profile, output).map(|secret| (secret, true));
    }
    let typed = terminal::new_one(&new_question(profile))?.ok_or_else(|| {
        refused(format!(
            "profile '{profile}' has no keyring yet, and a new one needs a passphrase: pass {SOURCES}, or \
             --store-passphrase to have a random one stored beside the keyring"
        ))
    })?;
    Ok((typed, false))
}

/// Writes a random one beside the keyring.
fn store(home: &Home, profile: &ProfileName, output: &Output) -> Result<SecretText, Failure> {
    let passphrase = Passphrase::random()?;
    let path = home.passphrase(profile);
    files::private_directory(home.root())?;
    files::private_directory(&home.root().join("profiles"))?;
    files::private_directory(&home.profile(profile))?;
    atomic_write(&path, format!("{}\n", passphrase.expose()).as_bytes())?;
    output.note(&format!(
        "a random passphrase for profile '{profile}' was written to {} (0600); anyone who can read that file and the \
         keyring has the keys",
        path.display()
    ));
    Ok(SecretText::new(passphrase.expose().to_owned()))
}

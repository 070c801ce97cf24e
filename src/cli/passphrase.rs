//! Passphrases for headless use: from a file, a descriptor, or the file stored beside the keyring. Never from argv or
//! the environment.

use std::{io::Read as _, path::Path};

use super::{args::Global, connect::Context, parse::usage, plan::Plan};
use crate::crypto::{Passphrase, private_file};
use crate::model::{ErrorKind, ProfileName};
use crate::service::{Failure, SecretText, command::ChangePassphrase, failure::input};
use crate::store::{atomic_write, files};
use crate::{paths::Home, term};
use authros_output::Output;

/// The longest passphrase read, bytes.
const LONGEST: usize = 4096;

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

/// The given passphrase, or the one stored by headless use.
pub fn given(global: &Global, home: &Home, profile: &ProfileName) -> Result<Option<SecretText>, Failure> {
    if global.site_socket.is_some() {
        let text = "an operator gives no passphrase: the owner of the site at --site-socket does this";
        return Err(Failure::new(ErrorKind::Refused, text));
    }
    of_file(global, &home.passphrase(profile))
}

/// Does not read it.
pub fn is_given(global: &Global, home: &Home, profile: &ProfileName) -> bool {
    global.passphrase_file.is_some() || global.passphrase_fd.is_some() || home.passphrase(profile).exists()
}

pub fn change(context: &Context, file: Option<&Path>, descriptor: Option<u32>) -> Result<Plan, Failure> {
    let (global, home, profile) = (&context.global, &context.home, &context.profile);
    if descriptor.is_some() && descriptor == global.passphrase_fd {
        return Err(usage("--passphrase-fd and --new-passphrase-fd name the same descriptor; use two"));
    }
    let old = match given(global, home, profile)? {
        Some(old) => old,
        None => asked(&format!("Current passphrase of profile '{profile}'"), "--passphrase-file")?,
    };
    let new = match (file, descriptor) {
        (Some(path), _) => from_file(path)?,
        (None, Some(number)) => from_descriptor(number)?,
        (None, None) => asked_twice("--new-passphrase-file")?,
    };
    Ok(Plan::kept(ChangePassphrase { old, new }))
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

fn asked(question: &str, option: &str) -> Result<SecretText, Failure> {
    let answer = term::secret(question).map_err(|error| input(format!("the terminal does not answer: {error}")))?;
    let answer =
        answer.ok_or_else(|| usage(format!("no passphrase was given; type it at a terminal, or pass {option}")))?;
    Ok(SecretText::new(answer.to_string()))
}

fn asked_twice(option: &str) -> Result<SecretText, Failure> {
    let new = asked("New passphrase, at least 8 characters", option)?;
    let again = asked("Repeat", option)?;
    if new.expose() == again.expose() {
        return Ok(new);
    }
    Err(input("the passphrases do not match; nothing was changed, try again"))
}

/// The given passphrase, or the one in a file beside what it protects.
pub fn of_file(global: &Global, beside: &Path) -> Result<Option<SecretText>, Failure> {
    match (&global.passphrase_file, global.passphrase_fd) {
        (Some(path), _) => from_file(path).map(Some),
        (None, Some(number)) => from_descriptor(number).map(Some),
        (None, None) if beside.exists() => from_file(beside).map(Some),
        (None, None) => Ok(None),
    }
}

/// Deletes a new passphrase whose keys were not made; an older one may open a restored keyring.
pub fn forget_unused(is_new: bool, context: &Context) {
    let (home, profile) = (&context.home, &context.profile);
    if is_new && !home.keyring(profile).exists() {
        // Nothing is lost if it stays.
        drop(std::fs::remove_file(home.passphrase(profile)));
    }
}

/// Stores a new random one beside the keyring if none is given; `true` if it is new.
pub fn given_or_new(context: &Context, output: &Output) -> Result<(SecretText, bool), Failure> {
    let (home, profile) = (&context.home, &context.profile);
    if let Some(secret) = given(&context.global, home, profile)? {
        return Ok((secret, false));
    }
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
    Ok((SecretText::new(passphrase.expose().to_owned()), true))
}

//! Where headless use finds a keyring's passphrase: a file, a descriptor, or the file it wrote
//! for itself beside the keyring. Never argv, never the environment.

use std::io::Read as _;
use std::path::Path;

use super::args::Global;
use super::output::Output;
use crate::crypto::{Passphrase, private_file};
use crate::model::{ErrorKind, ProfileName};
use crate::paths::Home;
use crate::service::{Failure, SecretText};
use crate::store::{atomic_write, files};

/// The longest passphrase read, bytes.
const LONGEST: usize = 4096;

fn first_line(text: &str) -> SecretText {
    SecretText::new(text.lines().next().unwrap_or_default().to_owned())
}

/// The first line of a 0600 file.
///
/// # Errors
/// Where the file cannot be read, or others may read it.
pub fn from_file(path: &Path) -> Result<SecretText, Failure> {
    let bytes = private_file::read_private(path, LONGEST)?;
    let text = std::str::from_utf8(&bytes)
        .map_err(|_| Failure::new(ErrorKind::Input, format!("{} is not text", path.display())))?;
    Ok(first_line(text))
}

fn from_descriptor(number: u32) -> Result<SecretText, Failure> {
    let unreadable = |error: std::io::Error| {
        Failure::new(ErrorKind::Input, format!("no passphrase can be read from descriptor {number}: {error}"))
    };
    let file = std::fs::File::open(format!("/proc/self/fd/{number}")).map_err(unreadable)?;
    let mut text = zeroize::Zeroizing::new(String::new());
    file.take(LONGEST as u64).read_to_string(&mut text).map_err(unreadable)?;
    Ok(first_line(&text))
}

/// The passphrase given, or the one that headless use wrote; `None` where there is neither.
///
/// # Errors
/// Where a file or descriptor that was named cannot be read.
pub fn given(global: &Global, home: &Home, profile: &ProfileName) -> Result<Option<SecretText>, Failure> {
    if let Some(path) = &global.passphrase_file {
        return from_file(path).map(Some);
    }
    if let Some(number) = global.passphrase_fd {
        return from_descriptor(number).map(Some);
    }
    let own = home.passphrase(profile);
    if own.exists() { from_file(&own).map(Some) } else { Ok(None) }
}

/// The passphrase given, or that in a file beside what it protects; `None` where there is neither.
///
/// # Errors
/// As [`given`].
pub fn of_file(global: &Global, beside: &Path) -> Result<Option<SecretText>, Failure> {
    match (&global.passphrase_file, global.passphrase_fd) {
        (Some(path), _) => from_file(path).map(Some),
        (None, Some(number)) => from_descriptor(number).map(Some),
        (None, None) if beside.exists() => from_file(beside).map(Some),
        (None, None) => Ok(None),
    }
}

/// The passphrase given, or a new random one written beside the keyring, which is said.
///
/// # Errors
/// Where the file cannot be written.
pub fn given_or_new(
    global: &Global,
    home: &Home,
    profile: &ProfileName,
    output: &Output,
) -> Result<SecretText, Failure> {
    if let Some(secret) = given(global, home, profile)? {
        return Ok(secret);
    }
    let passphrase = Passphrase::random()?;
    let path = home.passphrase(profile);
    files::private_directory(home.root())?;
    files::private_directory(&home.root().join("profiles"))?;
    files::private_directory(&home.profile(profile))?;
    atomic_write(&path, format!("{}\n", passphrase.expose()).as_bytes())?;
    output.note(&format!(
        "a random passphrase for profile '{profile}' was written to {} (0600); whoever reads that file and the keyring has the keys",
        path.display()
    ));
    Ok(SecretText::new(passphrase.expose().to_owned()))
}

//! The home itself: directories and modes, keyrings, the ledger, free space on the disk.

use std::path::Path;

use super::Sheet;
use crate::crypto::read_public;
use crate::paths::Home;
use crate::store::{files, snapshot};

/// Free space below which a site soon stops acknowledging, bytes.
const TIGHT: u64 = 1 << 30;
/// Free space below which it cannot work, bytes.
const FULL: u64 = 32 << 20;

/// Directory and modes.
pub(super) fn home(home: &Home, sheet: &mut Sheet) {
    let root = home.root();
    if !root.exists() {
        return sheet.ok("home", &format!("{} does not exist yet; it is created on first use", root.display()));
    }
    if let Err(error) = files::private_directory(root) {
        return sheet.fail("home", &error.to_string(), "make it writable for this user, or choose another --home");
    }
    let (mut open, mut looked) = (Vec::new(), 0);
    look_at_modes(root, &mut open, &mut looked, 0);
    match open.first() {
        None => sheet.ok("home", &format!("{} and its {looked} files and directories are private", root.display())),
        Some(first) => {
            let advice = format!("chmod -R go= '{}'", root.display());
            sheet.fail("home", &format!("{} of {looked} are accessible to others; {first}", open.len()), &advice);
        }
    }
}

fn look_at_modes(path: &Path, open: &mut Vec<String>, looked: &mut u64, depth: usize) {
    *looked += 1;
    match files::mode_advice(path) {
        // Settings and themes contain no secrets.
        Ok(Some(_)) if depth == 1 && !is_secret(path) => {}
        Ok(Some(advice)) => open.push(advice),
        Ok(None) | Err(_) => {}
    }
    let is_directory = path.symlink_metadata().is_ok_and(|about| about.is_dir());
    if is_directory && depth < 6 {
        for entry in std::fs::read_dir(path).into_iter().flatten().flatten() {
            look_at_modes(&entry.path(), open, looked, depth + 1);
        }
    }
}

fn is_secret(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    ["profiles", "vault", "chain", "gateway", "ledger.db"].iter().any(|begin| name.starts_with(begin))
}

/// Every profile's keyring.
pub(super) fn keys(home: &Home, sheet: &mut Sheet) {
    let profiles = home.profiles();
    if profiles.is_empty() {
        return sheet.warn("keys", "no profile has keys yet", "authros identity create");
    }
    for profile in profiles {
        let name = format!("keys {profile}");
        match read_public(&home.keyring(&profile)) {
            Ok(public) => sheet.ok(&name, &format!("account {}", public.address)),
            Err(error) => {
                sheet.fail(&name, &error.to_string(), "restore the keyring from a backup: authros restore FILE");
            }
        }
    }
}

/// Whether the ledger is well-formed.
pub(super) fn ledger(home: &Home, sheet: &mut Sheet) {
    database("ledger", &home.ledger(), sheet);
}

/// Whether a database is well-formed.
pub(super) fn database(name: &str, path: &Path, sheet: &mut Sheet) {
    if !path.exists() {
        return sheet.ok(name, &format!("{} does not exist yet", path.display()));
    }
    match snapshot::examine(path) {
        Ok(bytes) => sheet.ok(name, &format!("{} is well-formed, {bytes} bytes", path.display())),
        Err(error) => {
            let advice = "keep a copy of the home, then restore the last backup: authros restore FILE";
            sheet.fail(name, &error.to_string(), advice);
        }
    }
}

/// Room on the disk of the home.
pub(super) fn disk(home: &Home, sheet: &mut Sheet) {
    let mut place = home.root();
    while !place.exists() {
        let Some(parent) = place.parent() else { break };
        place = parent;
    }
    let place = if place.as_os_str().is_empty() { Path::new(".") } else { place };
    match rustix::fs::statvfs(place) {
        Ok(about) => {
            let free = about.f_bavail.saturating_mul(about.f_frsize);
            let text = format!("{} MiB are free at {}", free >> 20, place.display());
            match free {
                0..FULL => sheet.fail("disk", &text, "free some space; nothing is acknowledged on a full disk"),
                FULL..TIGHT => sheet.warn("disk", &text, "free some space before it is full"),
                _ => sheet.ok("disk", &text),
            }
        }
        Err(error) => sheet.warn("disk", &format!("{}: {error}", place.display()), "check with `df`"),
    }
}

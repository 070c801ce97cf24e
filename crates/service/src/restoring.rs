//! Restores a home from a backup: only where there is none, completely or not at all, and with a recorder of its own.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::DirBuilderExt as _;
use std::path::{Path, PathBuf};

use super::command::SecretText;
use super::failure::{input, refused};
use super::reply::{BackupView, Failure, Result};
use crate::crypto::sealed_stream::SealedReader;
use crate::crypto::unfinished::{self, UnfinishedFolder};
use crate::crypto::{Passphrase, fault, keyring::is_keyring_file};
use crate::model::{ErrorKind, clean};
use crate::paths::Home;
use crate::store::{archive, files, note_restored, snapshot};

/// Restores a backup as the home. The home and the places outside it that the backup has settings for must be empty or
/// absent; on failure the home is unchanged.
pub fn restore(file: &Path, home: &Home, secret: &SecretText) -> Result<BackupView> {
    let passphrase = Passphrase::new(secret.expose().to_owned())?;
    let place = FreePlace::of(home)?;
    let opened = File::open(file).map_err(|error| unread(file, &error))?;
    let mut sealed =
        SealedReader::open(io::BufReader::new(opened), &passphrase).map_err(|error| unread(file, &error))?;
    let folder = place.begin()?;
    let unpacked = archive::unpack(&mut sealed, folder.path()).map_err(|error| unread(file, &error))?;
    fault::point("restore-unpacked");
    let copied = Home::new(folder.path().to_owned());
    if !copied.ledger().exists() {
        let text = format!("{} contains no ledger, so it is not a backup", shown(file));
        return Err(Failure::new(ErrorKind::Tampered, text));
    }
    snapshot::renew_ledger(&copied.ledger())?;
    let has_ring = note_restored(&copied.ring())?;
    let profiles = copied.profiles().iter().map(ToString::to_string).collect();
    let apart = place.take(&folder)?;
    let files = u64::try_from(unpacked.names.len()).unwrap_or(u64::MAX);
    let mut notes = vec![
        "new records are numbered from 1 under a new recorder; nonces are read from the chain".to_owned(),
        "do not run this home and the one it was copied from at the same time on one chain".to_owned(),
    ];
    if has_ring {
        notes.push(
            "the robot's ring ages from the next start of its agent; request what is in it with `authros robot pull`"
                .to_owned(),
        );
    }
    notes.extend(apart);
    Ok(BackupView { file: shown(file), files, bytes: unpacked.bytes, profiles, notes })
}

/// Where a home may begin: it is absent or an empty folder.
pub(super) struct FreePlace<'a> {
    home: &'a Home,
    root: PathBuf,
}

impl<'a> FreePlace<'a> {
    pub fn of(home: &'a Home) -> Result<Self> {
        let root = std::path::absolute(home.root()).map_err(|error| unmade(home.root(), &error))?;
        is_free(&root)?;
        Ok(Self { home, root })
    }

    fn parent(&self) -> Result<&Path> {
        self.root.parent().ok_or_else(|| input("a home cannot be the root directory; choose another --home"))
    }

    /// A folder beside it, which is removed if it does not become the home.
    pub fn begin(&self) -> Result<UnfinishedFolder> {
        let parent = self.parent()?;
        fs::create_dir_all(parent).map_err(|error| unmade(parent, &error))?;
        unfinished::sweep(parent).map_err(|error| unmade(parent, &error))?;
        let folder = UnfinishedFolder::new(parent).map_err(|error| unmade(parent, &error))?;
        files::check_hands(folder.path())?;
        Ok(folder)
    }

    /// Makes the folder the home; returns what is to be said of settings that belong outside it.
    pub fn take(&self, folder: &UnfinishedFolder) -> Result<Vec<String>> {
        let (root, parent) = (&self.root, self.parent()?);
        is_free(root)?;
        let apart = settings_apart(self.home, folder.path())?;
        // Fails unless the target is an empty directory or absent.
        fs::rename(folder.path(), root).map_err(|error| unmade(root, &error))?;
        File::open(parent).and_then(|parent| parent.sync_all()).map_err(|error| unmade(parent, &error))?;
        // The home is complete by now: what cannot be moved is used in place.
        Ok(apart.into_iter().filter_map(|(name, place)| put_back(&root.join(name), place)).collect())
    }
}

fn is_free(root: &Path) -> Result<()> {
    let is_empty = match fs::read_dir(root) {
        Ok(mut entries) => entries.next().is_none(),
        Err(error) if error.kind() == io::ErrorKind::NotFound => true,
        Err(error) => return Err(unmade(root, &error)),
    };
    if is_empty { Ok(()) } else { Err(occupied(root, "is not empty")) }
}

/// Unpacked files that belong outside the home, by name and place; no place may be taken.
fn settings_apart<'a>(home: &'a Home, unpacked: &Path) -> Result<Vec<(&'static str, &'a Path)>> {
    let apart: Vec<_> = home.outside().into_iter().filter(|(name, _)| unpacked.join(name).exists()).collect();
    match apart.iter().find(|(_, place)| place.symlink_metadata().is_ok()) {
        Some((_, place)) => Err(occupied(place, "exists")),
        None => Ok(apart),
    }
}

fn occupied(place: &Path, how: &str) -> Failure {
    let advice = "move it away, or use another --home";
    refused(format!("{} {how} and will not be overwritten; {advice}", shown(place)))
}

/// Moves a file or folder to a free place; returns what to say if that fails.
fn put_back(from: &Path, place: &Path) -> Option<String> {
    let error = move_to(from, place).err()?;
    Some(format!("{} could not be moved to {}: {error}; it is used where it is", shown(from), shown(place)))
}

fn move_to(from: &Path, place: &Path) -> io::Result<()> {
    let parent = place.parent().ok_or(io::ErrorKind::InvalidInput)?;
    fs::DirBuilder::new().recursive(true).mode(0o700).create(parent)?;
    match fs::rename(from, place) {
        Err(error) if error.kind() == io::ErrorKind::CrossesDevices => {}
        done => return done,
    }
    let folder = UnfinishedFolder::new(parent)?;
    let copy = folder.path().join("copy");
    copy_all(from, &copy)?;
    fs::rename(&copy, place)?;
    if from.is_dir() { fs::remove_dir_all(from) } else { fs::remove_file(from) }
}

fn copy_all(from: &Path, to: &Path) -> io::Result<()> {
    if !from.is_dir() {
        return fs::copy(from, to).and_then(|_| File::open(to)?.sync_all());
    }
    fs::DirBuilder::new().mode(0o700).create(to)?;
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        copy_all(&entry.path(), &to.join(entry.file_name()))?;
    }
    Ok(())
}

fn shown(path: &Path) -> String {
    clean(&path.display().to_string(), 200)
}

fn unmade(path: &Path, error: &io::Error) -> Failure {
    Failure::new(ErrorKind::Home, format!("{} cannot be created: {error}; nothing was changed", shown(path)))
}

fn unread(path: &Path, error: &io::Error) -> Failure {
    let file = shown(path);
    match error.kind() {
        io::ErrorKind::PermissionDenied if error.get_ref().is_some() => {
            refused(format!("wrong passphrase for {file}; use the passphrase it was backed up with"))
        }
        io::ErrorKind::InvalidData | io::ErrorKind::UnexpectedEof if is_keyring_file(path) => input(format!(
            "{file} is a saved keyring, not a backup of a home; bring it back with `authros keys restore {file}`"
        )),
        io::ErrorKind::InvalidData | io::ErrorKind::UnexpectedEof => Failure::new(
            ErrorKind::Tampered,
            format!("{file} is damaged or not a backup ({error}); nothing was restored, use another copy"),
        ),
        _ => input(format!("{file} cannot be restored: {error}; nothing was restored")),
    }
}

//! Restores a home from a backup: only where there is none, completely or not at all, and with a recorder of its own.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::DirBuilderExt as _;
use std::path::{Path, PathBuf};

use crate::command::SecretText;
use crate::config::Config;
use crate::crypto::keyring::is_keyring_file;
use crate::crypto::private_file::{make_private_directory, write_private};
use crate::crypto::sealed_stream::SealedReader;
use crate::crypto::unfinished::{self, UnfinishedFolder};
use crate::crypto::{CryptoError, JoinFile, JoinKey, Passphrase, Provider, fault, keyring, provider, read_public};
use crate::model::{Address, Domain, ErrorKind, clean, without_secrets};
use crate::paths::Home;
use crate::pipeline::network_pin_at;
use crate::reply::{BackupView, Failure, JoinStanding, JoinedView, Result, input, refused};
use crate::site::opened_system_keys;
use crate::store::notes::{ProfileAccounts, SealedSystemKeys, SharedSystemKeys};
use crate::store::{Glance, archive, files, note_restored, snapshot};

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

pub fn open(file: &Path, secret: &SecretText) -> Result<JoinFile> {
    Ok(JoinFile::open(file, &Passphrase::new(secret.expose().to_owned())?)?)
}

/// `config`: the settings of the file and of this machine.
pub fn join(file: &JoinFile, home: &Home, config: &Config) -> Result<JoinedView> {
    let public = keyring::public_of(&file.keyring);
    let account = public.ok_or_else(|| CryptoError::DamagedKeyring("of this join file".to_owned()))?.address;
    let found = look(config)?;
    compare(file, account, &found, provider(config.provider))?;
    let (standing, notes) =
        if is_worker(home, file, account) { (renew(file, home)?, Vec::new()) } else { write(file, home)? };
    let (profile, store, gateway) = (file.profile.clone(), found.store, file.gateway);
    Ok(JoinedView { standing, profile, account, gateway, store, addresses: config.gateway_addresses.clone(), notes })
}

/// What a database says of its gateway.
struct Found {
    /// Its place, for people.
    store: String,
    accounts: Vec<Address>,
    domain: Option<Domain>,
    keys: Option<SealedSystemKeys>,
}

/// Changes nothing there.
fn look(config: &Config) -> Result<Found> {
    let url = config.store_url.as_deref();
    let url = url.ok_or_else(|| input("the join file names no database; name the gateway's in AUTHROS_STORE"))?;
    let (glance, _) = Glance::on_server(url, config.store_roots.as_deref(), None)?;
    let shown = without_secrets(url);
    let Some(glance) = glance else {
        let text = "has no gateway's tables, so it is not that gateway's database; name the right one in AUTHROS_STORE";
        return Err(refused(format!("{} {text}", clean(&shown, 200))));
    };
    let accounts = glance.note(&ProfileAccounts {})?.unwrap_or_default().into_values().flatten().collect();
    let domain = network_pin_at(&glance)?.map(|pin| pin.domain());
    let keys = glance.note(&SharedSystemKeys {})?;
    Ok(Found { store: glance.path().display().to_string(), accounts, domain, keys })
}

/// Refuses the file of another gateway, of another network, and of an earlier join key.
fn compare(file: &JoinFile, account: Address, found: &Found, provider: &dyn Provider) -> Result<()> {
    let store = &found.store;
    if !found.accounts.contains(&account) {
        let others: Vec<String> = found.accounts.iter().map(ToString::to_string).collect();
        return Err(refused(format!(
            "{store} is the database of another gateway, whose account is {}, and this join file is of {account}; name that \
             gateway's database in AUTHROS_STORE",
            others.join(", ")
        )));
    }
    if found.domain != Some(file.domain) {
        let there = found.domain.map_or_else(|| "not set".to_owned(), |domain| domain.to_string());
        return Err(refused(format!(
            "this join file is of another network: its domain is {}, that of {store} is {there}; make one at a worker of this \
             gateway with `authros gateway join-file --out FILE`",
            file.domain
        )));
    }
    let unserved =
        || refused(format!("{store} has no system keys; run `authros gateway serve` at its first worker once"));
    let keys = found.keys.as_ref().ok_or_else(unserved)?;
    if keys.join != file.join.number {
        return Err(refused(format!(
            "this join file has join key {}, and the workers of its gateway have join key {}: make a new one at one of them \
             with `authros gateway join-file --out FILE`",
            file.join.number, keys.join
        )));
    }
    opened_system_keys(provider, (&file.domain, &file.gateway), &file.join, keys).map(drop)
}

fn is_worker(home: &Home, file: &JoinFile, account: Address) -> bool {
    read_public(&home.keyring(&file.profile)).is_ok_and(|public| public.address == account)
}

fn renew(file: &JoinFile, home: &Home) -> Result<JoinStanding> {
    let folder = home.gateway();
    if JoinKey::load(&folder, file.join.number)?.as_ref() == Some(&file.join) {
        return Ok(JoinStanding::Unchanged);
    }
    file.join.save(&folder)?;
    Ok(JoinStanding::Renewed)
}

fn write(file: &JoinFile, home: &Home) -> Result<(JoinStanding, Vec<String>)> {
    let place = FreePlace::of(home)?;
    let folder = place.begin()?;
    let made = Home::new(folder.path().to_owned());
    make_private_directory(&made.profile(&file.profile))?;
    write_private(&made.keyring(&file.profile), &file.keyring)?;
    file.join.save(&made.gateway())?;
    write_private(&made.config(), file.settings.as_bytes())?;
    Ok((JoinStanding::Joined, place.take(&folder)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crypto::{Keyring, ProviderName, SmKeyPair, signer_id};
    use crate::gateway::{Kept, Schedule, Shelf};
    use crate::model::{ErrorKind, Timestamp};

    const DOMAIN: Domain = Domain([1; 32]);

    /// Keeps what a cabinet writes.
    struct Memory(std::sync::Arc<std::sync::Mutex<Option<Kept>>>);

    impl Shelf for Memory {
        fn read(&mut self) -> Result<Option<Kept>, crate::gateway::GatewayError> {
            Ok(self.0.lock().expect("not poisoned").clone())
        }

        fn write(&mut self, kept: &Kept) -> Result<bool, crate::gateway::GatewayError> {
            *self.0.lock().expect("not poisoned") = Some(kept.clone());
            Ok(true)
        }

        fn is_shared(&self) -> bool {
            true
        }
    }

    /// A file and what the database of its gateway says.
    fn scene() -> (JoinFile, Address, Found) {
        let provider = provider(ProviderName::RustCrypto);
        let (identity, join) = (SmKeyPair::generate(provider).expect("keys"), JoinKey::generate(2).expect("a key"));
        let (gateway, kept) = (signer_id(&identity.public), std::sync::Arc::default());
        let (shelf, now) = (Memory(std::sync::Arc::clone(&kept)), Timestamp::from_seconds(2_000_000_000));
        let context = crate::gateway::Context { provider, domain: DOMAIN };
        crate::gateway::Cabinet::on(Box::new(shelf), context, identity, Schedule::default(), now).expect("opens");
        let kept = kept.lock().expect("not poisoned").clone().expect("written");
        let keys = crate::site::sealed_system_keys(provider, (&DOMAIN, &gateway), &join, &kept).expect("seals");
        let account = Address([7; 20]);
        let file = JoinFile::new(DOMAIN, 31_337, gateway, "keeper".parse().expect("a name"), join);
        let store = "postgres://db/fleet".to_owned();
        (file, account, Found { store, accounts: vec![account], domain: Some(DOMAIN), keys: Some(keys) })
    }

    #[test]
    fn a_join_file_is_compared_with_the_database_of_its_gateway() {
        let provider = provider(ProviderName::RustCrypto);
        let (file, account, found) = scene();
        compare(&file, account, &found, provider).expect("its own");
        let refused = |file: &JoinFile, found: &Found, words: &str| {
            let failure = compare(file, account, found, provider).expect_err(words);
            assert!(failure.message.contains(words), "{words}: {}", failure.message);
            failure.kind
        };
        let (_, _, other) = scene();
        let of_other = Found { accounts: vec![Address([8; 20])], ..scene().2 };
        assert_eq!(refused(&file, &of_other, "the database of another gateway"), ErrorKind::Refused);
        let away = Found { domain: Some(Domain([2; 32])), ..scene().2 };
        assert_eq!(refused(&file, &away, "of another network"), ErrorKind::Refused);
        assert_eq!(refused(&file, &Found { keys: None, ..scene().2 }, "gateway serve"), ErrorKind::Refused);
        let mut old = file.clone();
        old.join.number = 1;
        assert_eq!(
            refused(&old, &found, "has join key 1, and the workers of its gateway have join key 2"),
            ErrorKind::Refused
        );
        assert_eq!(refused(&file, &other, "do not open"), ErrorKind::Tampered, "another key of the same number");
    }

    #[test]
    fn a_home_is_written_whole_once_and_gets_newer_join_keys() {
        let parent = tempfile::tempdir().expect("a folder");
        let home = Home::new(parent.path().join("worker"));
        let (mut file, ..) = scene();
        let saved = parent.path().join("first/keyring");
        let keys = Keyring::generate(provider(ProviderName::RustCrypto)).expect("keys");
        let account = keys.eoa.address();
        let passphrase = Passphrase::new("correct horse".to_owned()).expect("long enough");
        crate::crypto::UnlockedKeyring::create(keys, &saved, &passphrase).expect("writes");
        file.keyring = std::fs::read(&saved).expect("reads");
        file.settings = "confirmations = \"3\"\n".to_owned();
        assert_eq!(keyring::public_of(&file.keyring).map(|public| public.address), Some(account));

        assert!(!is_worker(&home, &file, account));
        assert_eq!(write(&file, &home).expect("writes").0, JoinStanding::Joined);
        assert!(is_worker(&home, &file, account));
        assert_eq!(std::fs::read_to_string(home.config()).expect("reads"), file.settings);
        assert!(home.profiles() == [file.profile.clone()] && !home.ledger().exists());
        assert!(write(&file, &home).expect_err("never over a home").message.contains("will not be overwritten"));
        assert_eq!(renew(&file, &home), Ok(JoinStanding::Unchanged));
        file.join = JoinKey::generate(3).expect("a key");
        assert_eq!(renew(&file, &home), Ok(JoinStanding::Renewed));
        assert_eq!(JoinKey::load(&home.gateway(), 3).expect("reads"), Some(file.join));
        let left = std::fs::read_dir(parent.path()).expect("lists").count();
        assert_eq!(left, 2, "the worker's home and the first keyring alone");
    }
}

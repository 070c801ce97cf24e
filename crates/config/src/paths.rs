//! Paths: what a site holds in its home, what its operator writes, and what a console remembers.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use directories::ProjectDirs;

use crate::model::{ErrorKind, ProfileName};

/// The name of our folder inside each of the user's folders.
const FOLDER: &str = "authros";
/// The home if neither `HOME` nor `XDG_DATA_HOME` is set.
const WITHOUT_HOME: &str = "authros-home";
/// What lies outside a standard home, by its name in a single-folder home.
const SETTINGS: &str = "config.toml";
const KEYMAP: &str = "keymap.toml";
const THEMES: &str = "themes";
const CONSOLE: &str = "console";

/// Why the standard places cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PlaceError {
    /// The same item exists in its new and in its old place.
    #[error(
        "both {} and {} exist, but only one can be used; keep one and move the other away",
        old.display(), new.display()
    )]
    Twice {
        /// The one in the data folder.
        old: PathBuf,
        /// The one in its own folder.
        new: PathBuf,
    },
    /// A variable that must hold an absolute path does not.
    #[error("{0} is '{1}', which is not an absolute path; correct it, or give --home")]
    Relative(&'static str, String),
}

impl PlaceError {
    /// Determines the exit code.
    pub fn kind(&self) -> ErrorKind {
        ErrorKind::Input
    }
}

/// The directory that holds everything of one site, and the paths of what people write for it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Home {
    root: PathBuf,
    settings: PathBuf,
    keymap: PathBuf,
    themes: PathBuf,
    console: PathBuf,
}

/// An environment variable that is set and not empty.
fn set(name: &str) -> Option<OsString> {
    std::env::var_os(name).filter(|value| !value.is_empty())
}

/// The folders given by `HOME` and the XDG base directory variables; `None` if there is no `HOME`.
fn folders() -> Result<Option<ProjectDirs>, PlaceError> {
    for name in ["XDG_DATA_HOME", "XDG_CONFIG_HOME", "XDG_STATE_HOME"] {
        // The library would ignore it, and a home would seem to be empty.
        if let Some(value) = set(name).filter(|value| Path::new(value).is_relative()) {
            return Err(PlaceError::Relative(name, crate::model::clean(&value.to_string_lossy(), 200)));
        }
    }
    // Without HOME the library would take a folder from the user database that nobody specified.
    Ok(set("HOME").and_then(|_| ProjectDirs::from("", "", FOLDER)))
}

/// The old place of an item if only that is in use, otherwise the new one.
fn in_use(old: PathBuf, new: PathBuf) -> Result<PathBuf, PlaceError> {
    let is_there = |path: &Path| path.symlink_metadata().is_ok();
    let is_one = || old.canonicalize().is_ok_and(|old| new.canonicalize().is_ok_and(|new| new == old));
    match (is_there(&old), is_there(&new)) {
        (true, true) if !is_one() => Err(PlaceError::Twice { old, new }),
        (true, false) => Ok(old),
        _ => Ok(new),
    }
}

impl Home {
    /// A single-folder home at `root`, for `--home`.
    pub fn new(root: PathBuf) -> Self {
        let [settings, keymap, themes, console] = [SETTINGS, KEYMAP, THEMES, CONSOLE].map(|name| root.join(name));
        Self { root, settings, keymap, themes, console }
    }

    /// The user's own: data, settings and console memory, each in its folder. Without `HOME` a single-folder home,
    /// `$XDG_DATA_HOME/authros` or `./authros-home`.
    ///
    /// # Errors
    /// [`PlaceError`] if a variable is wrong or something exists in two places.
    pub fn standard() -> Result<Self, PlaceError> {
        let root = Self::standard_root()?;
        let Some(folders) = folders()? else { return Ok(Self::new(root)) };
        let (config, state) = (folders.config_dir(), folders.state_dir().unwrap_or(&root));
        Self::apart(&root, config, state)
    }

    /// Only the data folder of [`Self::standard`].
    ///
    /// # Errors
    /// [`PlaceError::Relative`].
    pub fn standard_root() -> Result<PathBuf, PlaceError> {
        let alone = || set("XDG_DATA_HOME").map_or_else(|| WITHOUT_HOME.into(), |data| Path::new(&data).join(FOLDER));
        Ok(folders()?.map_or_else(alone, |folders| folders.data_dir().to_owned()))
    }

    fn apart(root: &Path, config: &Path, state: &Path) -> Result<Self, PlaceError> {
        let place = |name: &str, folder: &Path| in_use(root.join(name), folder.join(name));
        Ok(Self {
            settings: place(SETTINGS, config)?,
            keymap: place(KEYMAP, config)?,
            themes: place(THEMES, config)?,
            console: place(CONSOLE, state)?,
            root: root.to_owned(),
        })
    }

    /// What lies outside [`Self::root`], each with its name in a single-folder home.
    pub fn outside(&self) -> Vec<(&'static str, &Path)> {
        let all =
            [(SETTINGS, &self.settings), (KEYMAP, &self.keymap), (THEMES, &self.themes), (CONSOLE, &self.console)];
        all.map(|(name, path)| (name, path.as_path()))
            .into_iter()
            .filter(|(_, path)| !path.starts_with(&self.root))
            .collect()
    }

    /// The directory itself.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Whether there is anything at its place; an empty folder is no home yet.
    pub fn is_there(&self) -> bool {
        match self.root.read_dir() {
            Ok(mut entries) => entries.next().is_some(),
            Err(error) => !matches!(error.kind(), std::io::ErrorKind::NotFound),
        }
    }

    /// The settings file.
    pub fn config(&self) -> PathBuf {
        self.settings.clone()
    }

    /// Changes to the console's default keys.
    pub fn keymap(&self) -> PathBuf {
        self.keymap.clone()
    }

    /// The operator's own themes, one file each.
    pub fn themes(&self) -> PathBuf {
        self.themes.clone()
    }

    /// What the console of a profile remembers from its last run.
    pub fn console(&self, profile: &ProfileName) -> PathBuf {
        self.console.join(format!("{profile}.json"))
    }

    /// Held by the process that is the site.
    pub fn site_lock(&self) -> PathBuf {
        self.root.join("site.lock")
    }

    /// What a site that was started in the background tells.
    pub fn serve_log(&self) -> PathBuf {
        self.root.join("serve.log")
    }

    /// Where further processes join.
    pub fn socket(&self) -> PathBuf {
        self.root.join("site.sock")
    }

    /// Records and their states.
    pub fn ledger(&self) -> PathBuf {
        self.root.join("ledger.db")
    }

    /// Space reserved for a revoke on a full disk.
    pub fn reserve(&self) -> PathBuf {
        self.root.join("reserve")
    }

    /// Space reserved for the states of records on a full disk.
    pub fn working_reserve(&self) -> PathBuf {
        self.root.join("reserve.states")
    }

    /// Active alerts, and those not delivered yet.
    pub fn alerts(&self) -> PathBuf {
        self.root.join("alerts.queue")
    }

    /// Ciphertext of the embedded vault.
    pub fn vault(&self) -> PathBuf {
        self.root.join("vault")
    }

    /// The ring of a robot: sealed records of topics that nobody watches.
    pub fn ring(&self) -> PathBuf {
        self.root.join("ring")
    }

    /// System keys of the gateway.
    pub fn gateway(&self) -> PathBuf {
        self.root.join("gateway")
    }

    /// Blocks of the embedded chain.
    pub fn chain(&self) -> PathBuf {
        self.root.join("chain")
    }

    /// The chain and contract this home is bound to.
    pub fn pin(&self) -> PathBuf {
        self.root.join("chain-pin.json")
    }

    /// What is known about the gateway through which this home joins.
    pub fn gateway_trust(&self) -> PathBuf {
        self.root.join("gateway-trust.json")
    }

    /// The transport key of a profile at that gateway, sealed under its keyring.
    pub fn transport_key(&self, profile: &ProfileName) -> PathBuf {
        self.profile(profile).join("transport-key")
    }

    /// The directory of a profile.
    pub fn profile(&self, profile: &ProfileName) -> PathBuf {
        self.root.join("profiles").join(profile.as_str())
    }

    /// The encrypted keys of a profile.
    pub fn keyring(&self, profile: &ProfileName) -> PathBuf {
        self.profile(profile).join("keyring")
    }

    /// The passphrase that headless use stored for itself.
    pub fn passphrase(&self, profile: &ProfileName) -> PathBuf {
        self.profile(profile).join("passphrase")
    }

    /// Names of the profiles that have a keyring.
    pub fn profiles(&self) -> Vec<ProfileName> {
        let entries = std::fs::read_dir(self.root.join("profiles")).into_iter().flatten().flatten();
        let mut names: Vec<ProfileName> = entries
            .filter(|entry| entry.path().join("keyring").exists())
            .filter_map(|entry| entry.file_name().to_str().and_then(|name| name.parse().ok()))
            .collect();
        names.sort();
        names
    }
}

/// The beginning of a gateway's fingerprint, for the name of a file.

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_folder_is_no_home_and_one_with_settings_is() {
        let folder = tempfile::tempdir().expect("a folder");
        let home = Home::new(folder.path().join("site"));
        assert!(!home.is_there());
        std::fs::create_dir(home.root()).expect("made");
        assert!(!home.is_there());
        std::fs::write(home.config(), "").expect("written");
        assert!(home.is_there());
    }

    #[test]
    fn each_thing_has_its_folder_and_an_old_place_goes_on() {
        let user = tempfile::tempdir().expect("a directory");
        let [data, config, state] = ["data", "config", "state"].map(|name| user.path().join(name));
        let home = || Home::apart(&data, &config, &state);
        let new = home().expect("nothing is there");
        let names: Vec<_> = new.outside().into_iter().map(|(name, path)| (name, path.to_owned())).collect();
        let [settings, keymap, themes] = [SETTINGS, KEYMAP, THEMES].map(|name| (name, config.join(name)));
        assert_eq!(names, [settings, keymap, themes, (CONSOLE, state.join(CONSOLE))]);
        std::fs::create_dir_all(&data).expect("made");
        std::fs::write(data.join(SETTINGS), "").expect("written");
        let old = home().expect("the old place alone");
        assert_eq!((old.config(), old.keymap()), (data.join(SETTINGS), config.join(KEYMAP)));
        assert_eq!(old.outside().len(), 3);
        std::fs::create_dir_all(&config).expect("made");
        std::os::unix::fs::symlink(data.join(SETTINGS), config.join(SETTINGS)).expect("linked");
        assert_eq!(home().expect("one file").config(), config.join(SETTINGS));
        std::fs::remove_file(config.join(SETTINGS)).expect("removed");
        std::fs::write(config.join(SETTINGS), "").expect("written");
        let twice = PlaceError::Twice { old: data.join(SETTINGS), new: config.join(SETTINGS) };
        assert_eq!(home(), Err(twice));
    }

    #[test]
    fn a_home_of_one_folder_has_nothing_outside() {
        let home = Home::new("/h".into());
        assert_eq!((home.config(), home.outside().len()), (PathBuf::from("/h/config.toml"), 0));
        assert_eq!(home.console(&"bob".parse().expect("a name")), Path::new("/h/console/bob.json"));
    }
}

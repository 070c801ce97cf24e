//! Paths: what a site holds in its home, what its operator writes, and what a console remembers.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use directories::ProjectDirs;

use crate::model::{ErrorKind, ProfileName, natural};

const FOLDER: &str = "authros";
/// The home if neither `HOME` nor `XDG_DATA_HOME` is set.
const WITHOUT_HOME: &str = "authros-home";
/// Names, in a single-folder home, of what a standard home keeps elsewhere.
const SETTINGS: &str = "config.toml";
const KEYMAP: &str = "keymap.toml";
const THEMES: &str = "themes";
const CONSOLE: &str = "console";

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0} is '{1}', which is not an absolute path; correct it, or give --home")]
pub struct PlaceError(&'static str, String);

impl PlaceError {
    pub fn kind(&self) -> ErrorKind {
        ErrorKind::Input
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Home {
    root: PathBuf,
    settings: PathBuf,
    keymap: PathBuf,
    themes: PathBuf,
    console: PathBuf,
    /// The read-only folder that this is a working copy of.
    original: Option<PathBuf>,
}

fn set(name: &str) -> Option<OsString> {
    std::env::var_os(name).filter(|value| !value.is_empty())
}

/// The folders given by `HOME` and the XDG base directory variables; `None` if there is no `HOME`.
fn folders() -> Result<Option<ProjectDirs>, PlaceError> {
    for name in ["XDG_DATA_HOME", "XDG_CONFIG_HOME", "XDG_STATE_HOME"] {
        // The library would ignore it, and a home would seem to be empty.
        if let Some(value) = set(name).filter(|value| Path::new(value).is_relative()) {
            return Err(PlaceError(name, crate::model::clean(&value.to_string_lossy(), 200)));
        }
    }
    // Without HOME the library would take a folder from the user database that nobody specified.
    Ok(set("HOME").and_then(|_| ProjectDirs::from("", "", FOLDER)))
}

impl Home {
    /// A single-folder home, for `--home`.
    pub fn new(root: PathBuf) -> Self {
        Self::apart(&root, &root, &root)
    }

    /// The same home with its data in `copy`; no change leaves the copy.
    #[must_use]
    pub fn copied_to(&self, copy: PathBuf) -> Self {
        Self { root: copy, original: Some(self.root.clone()), ..self.clone() }
    }

    pub fn original(&self) -> Option<&Path> {
        self.original.as_deref()
    }

    /// The user's own home. Without `HOME` a single-folder home, `$XDG_DATA_HOME/authros` or `./authros-home`.
    pub fn standard() -> Result<Self, PlaceError> {
        let root = Self::standard_root()?;
        let Some(folders) = folders()? else { return Ok(Self::new(root)) };
        let (config, state) = (folders.config_dir(), folders.state_dir().unwrap_or(&root));
        Ok(Self::apart(&root, config, state))
    }

    /// The home whose data is in `root`: a single-folder home, or the user's own with its settings where these are.
    pub fn at(root: &Path) -> Result<Self, PlaceError> {
        if root == Self::standard_root()? { Self::standard() } else { Ok(Self::new(root.to_owned())) }
    }

    pub fn standard_root() -> Result<PathBuf, PlaceError> {
        let alone = || set("XDG_DATA_HOME").map_or_else(|| WITHOUT_HOME.into(), |data| Path::new(&data).join(FOLDER));
        Ok(folders()?.map_or_else(alone, |folders| folders.data_dir().to_owned()))
    }

    fn apart(root: &Path, config: &Path, state: &Path) -> Self {
        Self {
            root: root.to_owned(),
            settings: config.join(SETTINGS),
            keymap: config.join(KEYMAP),
            themes: config.join(THEMES),
            console: state.join(CONSOLE),
            original: None,
        }
    }

    /// Paths outside [`Self::root`], each with its name in a single-folder home.
    pub fn outside(&self) -> Vec<(&'static str, &Path)> {
        let all =
            [(SETTINGS, &self.settings), (KEYMAP, &self.keymap), (THEMES, &self.themes), (CONSOLE, &self.console)];
        all.map(|(name, path)| (name, path.as_path()))
            .into_iter()
            .filter(|(_, path)| !path.starts_with(&self.root))
            .collect()
    }

    pub fn root(&self) -> &Path {
        &self.root
    }

    /// False for an empty folder.
    pub fn is_there(&self) -> bool {
        match self.root.read_dir() {
            Ok(mut entries) => entries.next().is_some(),
            Err(error) => !matches!(error.kind(), std::io::ErrorKind::NotFound),
        }
    }

    pub fn config(&self) -> PathBuf {
        self.settings.clone()
    }

    pub fn keymap(&self) -> PathBuf {
        self.keymap.clone()
    }

    pub fn themes(&self) -> PathBuf {
        self.themes.clone()
    }

    pub fn console(&self, profile: &ProfileName) -> PathBuf {
        self.console.join(format!("{profile}.json"))
    }

    /// The transport key of a profile at that gateway, sealed under its keyring.
    pub fn transport_key(&self, profile: &ProfileName) -> PathBuf {
        self.profile(profile).join("transport-key")
    }

    pub fn profile(&self, profile: &ProfileName) -> PathBuf {
        self.root.join("profiles").join(profile.as_str())
    }

    pub fn keyring(&self, profile: &ProfileName) -> PathBuf {
        self.profile(profile).join("keyring")
    }

    /// The passphrase that headless use stored for itself.
    pub fn passphrase(&self, profile: &ProfileName) -> PathBuf {
        self.profile(profile).join("passphrase")
    }

    pub fn profiles(&self) -> Vec<ProfileName> {
        let entries = std::fs::read_dir(self.root.join("profiles")).into_iter().flatten().flatten();
        let mut names: Vec<ProfileName> = entries
            .filter(|entry| entry.path().join("keyring").exists())
            .filter_map(|entry| entry.file_name().to_str().and_then(|name| name.parse().ok()))
            .collect();
        names.sort_by(|one, other| natural(one.as_str(), other.as_str()));
        names
    }
}

/// Paths inside a home's folder.
macro_rules! paths {
    ($($(#[$doc:meta])* $name:ident: $place:literal;)*) => {
        impl Home {
            $($(#[$doc])* pub fn $name(&self) -> PathBuf {
                self.root.join($place)
            })*
        }
    };
}

paths! {
    site_lock: "site.lock";
    serve_log: "serve.log";
    socket: "site.sock";
    ledger: "ledger.db";
    /// Space for a revoke on a full disk.
    reserve: "reserve";
    /// Space for the states of records on a full disk.
    working_reserve: "reserve.states";
    /// Counts what waits in memory for a full disk; allocated beforehand.
    waiting: "waiting";
    alerts: "alerts.queue";
    /// The ring of a robot: sealed records of topics that nobody watches.
    ring: "ring";
    /// How far this home has seen its database.
    watermark: "watermark";
    gateway: "gateway";
    chain: "chain";
    gateway_trust: "gateway-trust.json";
}

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
    fn each_thing_has_its_folder() {
        let [data, config, state] = ["/data", "/config", "/state"].map(Path::new);
        let home = Home::apart(data, config, state);
        let [settings, keymap, themes] = [SETTINGS, KEYMAP, THEMES].map(|name| (name, config.join(name)));
        let names: Vec<_> = home.outside().into_iter().map(|(name, path)| (name, path.to_owned())).collect();
        assert_eq!(names, [settings, keymap, themes, (CONSOLE, state.join(CONSOLE))]);
        assert_eq!(Home::apart(data, data, data).outside(), []);
    }

    #[test]
    fn a_home_of_one_folder_has_nothing_outside() {
        let home = Home::new("/h".into());
        assert_eq!((home.config(), home.outside().len()), (PathBuf::from("/h/config.toml"), 0));
        assert_eq!(home.console(&"bob".parse().expect("a name")), Path::new("/h/console/bob.json"));
    }
}

//! What the console is started with.

use std::path::PathBuf;

use crate::app::{keymap::Keymap, tour::Cast};
use crate::model::{ProfileName, Zone};

#[derive(Debug, Clone, Default)]
pub struct Settings {
    pub profile: ProfileName,
    /// The operator who speaks, unless it is the profile's owner.
    pub operator: Option<String>,
    /// Hides what changes keys, grants or records.
    pub read_only: bool,
    /// Base of relative paths.
    pub directory: PathBuf,
    /// The meaning of `~`.
    pub home: Option<PathBuf>,
    pub keymap: Keymap,
    pub themes: Vec<String>,
    /// Nanoseconds without a key after which the keyring locks; `None` = never.
    pub lock_after: Option<u64>,
    pub zone: Zone,
    pub process: u32,
    /// Asks for the passphrase of a locked keyring at the start.
    pub asks_passphrase: bool,
    /// The home's profiles at the start.
    pub profiles: Vec<ProfileName>,
    pub tour: Option<Cast>,
    /// Whether a site can continue after this console.
    pub leaves_site: bool,
}

//! Where things lie in a home.

use std::path::{Path, PathBuf};

use crate::model::ProfileName;

/// The directory that holds everything of one site.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Home {
    root: PathBuf,
}

impl Home {
    /// A home at `root`.
    pub fn new(root: PathBuf) -> Self {
        Self { root }
    }

    /// `$XDG_DATA_HOME/authros`, else `$HOME/.local/share/authros`, else `./authros-home`.
    pub fn standard(environment: &dyn Fn(&str) -> Option<String>) -> Self {
        let set = |name: &str| environment(name).filter(|value| !value.is_empty()).map(PathBuf::from);
        let base = set("XDG_DATA_HOME").or_else(|| set("HOME").map(|home| home.join(".local/share")));
        Self::new(base.map_or_else(|| PathBuf::from("authros-home"), |base| base.join("authros")))
    }

    /// The directory itself.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The settings file.
    pub fn config(&self) -> PathBuf {
        self.root.join("config.toml")
    }

    /// What differs from the console's preset keys.
    pub fn keymap(&self) -> PathBuf {
        self.root.join("keymap.toml")
    }

    /// The operator's own themes, one file each.
    pub fn themes(&self) -> PathBuf {
        self.root.join("themes")
    }

    /// What the console of a profile remembers of its last run.
    pub fn console(&self, profile: &ProfileName) -> PathBuf {
        self.root.join("console").join(format!("{profile}.json"))
    }

    /// Held by the process that is the site.
    pub fn site_lock(&self) -> PathBuf {
        self.root.join("site.lock")
    }

    /// Further processes join here.
    pub fn socket(&self) -> PathBuf {
        self.root.join("site.sock")
    }

    /// Records and their states.
    pub fn ledger(&self) -> PathBuf {
        self.root.join("ledger.db")
    }

    /// Space set aside for a revoke on a full disk.
    pub fn reserve(&self) -> PathBuf {
        self.root.join("reserve")
    }

    /// Space set aside for the states of records on a full disk.
    pub fn working_reserve(&self) -> PathBuf {
        self.root.join("reserve.states")
    }

    /// Ciphertext of the embedded vault.
    pub fn vault(&self) -> PathBuf {
        self.root.join("vault")
    }

    /// System keys of the gateway.
    pub fn gateway(&self) -> PathBuf {
        self.root.join("gateway")
    }

    /// Blocks of the embedded chain.
    pub fn chain(&self) -> PathBuf {
        self.root.join("chain")
    }

    /// Which chain and contract this home is bound to.
    pub fn pin(&self) -> PathBuf {
        self.root.join("chain-pin.json")
    }

    /// What is known of the gateway that this home joins through.
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

    /// The passphrase that headless use wrote for itself.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn standard_homes() {
        let with = |pairs: &'static [(&str, &str)]| {
            Home::standard(&move |name| {
                pairs.iter().find(|(key, _)| *key == name).map(|(_, value)| (*value).to_owned())
            })
        };
        assert_eq!(with(&[("HOME", "/h")]).root(), Path::new("/h/.local/share/authros"));
        assert_eq!(with(&[("HOME", "/h"), ("XDG_DATA_HOME", "/x")]).root(), Path::new("/x/authros"));
        assert_eq!(with(&[]).root(), Path::new("authros-home"));
    }
}

//! The basis of the features' tests: the shared parts of a home in a temporary folder, and a whole site with the
//! embedded chain.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use std::path::Path;
use std::sync::Arc;

use super::parts::Opened;
use crate::config::Config;
use crate::crypto::{Keyring, Passphrase, UnlockedKeyring};
use crate::model::{Address, Digest, ProfileName, RecordKind, RecordState, Signature, SignerId, Timestamp, TopicId};
use crate::paths::Home;
use crate::pipeline::Owner;
use crate::site::{Needs, Parts, Site};
use crate::store::{AuditQuery, NewRecord, SiteLock};

/// The passphrase of every keyring made here.
pub const PASSPHRASE: &str = "correct horse battery";

/// The shared parts of a home in a temporary folder.
pub struct Ground {
    pub(super) parts: Parts,
    _opened: Opened,
    pub folder: tempfile::TempDir,
}

impl Ground {
    /// A home without a chain, with these settings.
    pub fn with(settings: &[(&str, &str)]) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let (parts, opened, _) = Parts::open(home(folder.path()), config(settings), false).expect("opens");
        Self { parts, _opened: opened, folder }
    }

    pub fn home(&self) -> &Home {
        &self.parts.home
    }

    /// The same home, closed and opened again.
    pub fn again(self) -> Self {
        let Self { parts, _opened, folder } = self;
        let config = Config::clone(&parts.config);
        drop(parts.plant.ledger.clone().close());
        drop(parts);
        let (parts, opened, _) = Parts::open(home(folder.path()), config, false).expect("opens again");
        Self { parts, _opened: opened, folder }
    }

    /// Makes and opens a profile.
    pub fn owner(&self, name: &str) -> Arc<Owner> {
        let profile = profile(name);
        let path = self.parts.home.keyring(&profile);
        let keyring = Keyring::generate(self.parts.plant.provider).expect("keys");
        let passphrase = Passphrase::new(PASSPHRASE.to_owned()).expect("long enough");
        let owner = Owner::new(profile, UnlockedKeyring::create(keyring, &path, &passphrase).expect("a keyring"));
        let owner = Arc::new(owner);
        self.parts.owners.insert(&owner);
        owner
    }

    /// Acknowledges a message, as the sealer does.
    pub fn capture(&self, owner: Address, signer: SignerId, topic: &str, second: u64) {
        let digest = Digest(crate::crypto::sm3::sm3(&[&owner.0, &signer.0, topic.as_bytes(), &second.to_be_bytes()]));
        let record = NewRecord {
            digest,
            owner,
            topic_id: TopicId(digest.0[..16].try_into().expect("16 bytes")),
            seq: second,
            foreign: None,
            epoch: 1,
            kind: RecordKind::Data,
            signer,
            signature: Signature([7; 64]),
            filters: Vec::new(),
            topic: topic.to_owned(),
            type_name: "a/B".to_owned(),
            bytes: 9,
            captured_at: Timestamp::from_seconds(second),
            simulated: false,
            state: RecordState::Stored,
            blob: None,
        };
        self.parts.plant.ledger.records.append(vec![record]).expect("acknowledged");
    }

    /// Subjects and outcomes of the log's lines about an action, oldest first.
    pub fn audited(&self, action: &str) -> Vec<(String, String)> {
        let query = AuditQuery { action: Some(action.to_owned()), limit: 1000, ..AuditQuery::default() };
        let lines = self.parts.log.lines().list(&query).expect("lines");
        lines.into_iter().map(|line| (line.entry.subject, line.entry.outcome)).collect()
    }
}

pub fn profile(name: &str) -> ProfileName {
    name.parse().expect("a name")
}

/// The given settings, and the defaults of all others.
pub fn config(settings: &[(&str, &str)]) -> Config {
    let given = |name: &str| settings.iter().find(|(other, _)| *other == name).map(|(_, value)| (*value).to_owned());
    Config::resolve(&given, &|_| None, None).expect("settings")
}

fn home(folder: &Path) -> Home {
    Home::new(folder.join("home"))
}

/// A site without ROS on an embedded chain of its own. Its folder is removed with the value.
pub fn site_with_chain() -> (Arc<Site>, tempfile::TempDir) {
    site_of(&[], Needs { ros: false, chain: true })
}

/// A site with these settings and these parts.
pub fn site_of(settings: &[(&str, &str)], needs: Needs) -> (Arc<Site>, tempfile::TempDir) {
    let folder = tempfile::tempdir().expect("a folder");
    let home = home(folder.path());
    std::fs::create_dir_all(home.root()).expect("a home");
    let lock = SiteLock::acquire(&home.site_lock()).expect("a lock").expect("nobody else's");
    let site = Site::start(home, config(settings), lock, needs).expect("starts");
    (site, folder)
}

/// Makes and opens a profile of this site.
pub async fn made(site: &Arc<Site>, name: &str) -> Arc<Owner> {
    let secret = crate::command::SecretText::new(PASSPHRASE.to_owned());
    site.profiles.create(profile(name), secret).await.expect("an identity");
    site.unlocked(&profile(name)).expect("open")
}

/// Makes, opens and registers a profile of this site.
pub async fn registered(site: &Arc<Site>, name: &str) -> Arc<Owner> {
    let owner = made(site, name).await;
    site.profiles.register(&owner).await.expect("registers");
    owner
}

/// A site with a chain and two registered owners, alice and bob.
pub async fn site_of_two() -> (Arc<Site>, tempfile::TempDir, Arc<Owner>, Arc<Owner>) {
    let (site, folder) = site_with_chain();
    let (alice, bob) = (registered(&site, "alice").await, registered(&site, "bob").await);
    (site, folder, alice, bob)
}

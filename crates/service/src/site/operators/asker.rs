//! Who asks through a connection: what it has proven so far. It never forgets, so that nothing asked at the very end of a
//! connection counts as asked by somebody else.

use std::collections::BTreeSet;
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::model::{OperatorName, ProfileName, PublicKey};

/// The operator as which a connection acts.
#[derive(Debug, Clone)]
pub(in crate::site) struct Acting {
    /// The profile it is an operator of.
    pub profile: ProfileName,
    /// Its name there.
    pub name: OperatorName,
    /// The key it proved to have.
    pub key: PublicKey,
}

/// What is known of one connection.
#[derive(Default)]
struct Known {
    challenge: Option<[u8; 32]>,
    acting: Option<Acting>,
    /// The operator was found to be one no more.
    ended: bool,
    /// Profiles whose passphrase was given.
    proven: BTreeSet<ProfileName>,
}

/// Who asks through one connection.
#[derive(Default)]
pub(crate) struct Asker {
    /// Another process, through the socket.
    joined: bool,
    known: Mutex<Known>,
}

impl Asker {
    /// Another process, of which nothing is known yet.
    pub fn joined() -> Self {
        Self { joined: true, known: Mutex::default() }
    }

    fn known(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// From now on this is to be signed.
    pub(super) fn challenge(&self, challenge: [u8; 32]) {
        self.known().challenge = Some(challenge);
    }

    /// What was to be signed; each serves once.
    pub(super) fn take_challenge(&self) -> Option<[u8; 32]> {
        self.known().challenge.take()
    }

    /// The operator as which it acts.
    pub(super) fn acting(&self) -> Option<Acting> {
        self.known().acting.clone()
    }

    /// Acts as an operator from now on; `false` if it acts as one already.
    pub(super) fn act(&self, acting: Acting) -> bool {
        let mut known = self.known();
        let is_first = known.acting.is_none();
        if is_first {
            known.acting = Some(acting);
        }
        is_first
    }

    /// Its operator is one no more.
    pub(super) fn end(&self) {
        self.known().ended = true;
    }

    /// Whether it is the site's own process, or gave the passphrase of a profile.
    pub(super) fn is_owner(&self, profile: &ProfileName) -> bool {
        !self.joined || self.known().proven.contains(profile)
    }

    /// The passphrase of a profile was given.
    pub(super) fn prove(&self, profile: &ProfileName) {
        self.known().proven.insert(profile.clone());
    }

    /// Whether it has shown who it is, and is that still as far as was seen.
    pub fn is_known(&self) -> bool {
        let known = self.known();
        !self.joined || !known.ended && (known.acting.is_some() || !known.proven.is_empty())
    }
}

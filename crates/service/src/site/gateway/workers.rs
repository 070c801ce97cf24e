//! What the workers of a gateway on a server share beside its records: the system keys, in the database under the join key,
//! which lies in each worker's home; and the join file that makes a further worker.

use tokio::task::block_in_place;

use super::Gateway;
use crate::command::{SecretBytes, SecretText};
use crate::crypto::join_file::SharedUse;
use crate::crypto::{CryptoError, JoinFile, JoinKey, Passphrase, Provider};
use crate::failure::{input, refused};
use crate::gateway::system_keys::SystemKeyList;
use crate::gateway::{GatewayError, Kept, Shelf};
use crate::model::bytes::{hex, unhex};
use crate::model::{Domain, ErrorKind, ProfileName, SignerId};
use crate::paths::Home;
use crate::pipeline::network_pin;
use crate::reply::{Failure, Result};
use crate::store::Notes;
use crate::store::notes::{SealedSystemKeys, SharedSystemKeys};

const DAMAGED: &str = "the system keys in the database do not open under this home's join key: join again with a new file \
                       (`authros gateway join-file` at a worker that serves), or restore the database";

/// The system keys in the database of all workers.
pub(super) struct SharedShelf {
    pub notes: Notes,
    pub home: Home,
    pub provider: &'static dyn Provider,
    pub domain: Domain,
    pub gateway: SignerId,
    /// As last read; [`Shelf::write`] replaces nothing else.
    pub seen: Option<SealedSystemKeys>,
}

fn unshared(failure: Failure) -> GatewayError {
    GatewayError::Shelf { kind: failure.kind, text: failure.message }
}

impl Shelf for SharedShelf {
    fn read(&mut self) -> Result<Option<Kept>, GatewayError> {
        self.seen = self.notes.read(&SharedSystemKeys {}).map_err(|error| unshared(error.into()))?;
        let Some(sealed) = &self.seen else { return Ok(None) };
        let join = join_key(&self.home, sealed.join).map_err(unshared)?;
        let kept = opened(self.provider, (&self.domain, &self.gateway), &join, sealed).map_err(unshared)?;
        Ok(Some(kept))
    }

    fn write(&mut self, kept: &Kept) -> Result<bool, GatewayError> {
        let join = match &self.seen {
            Some(sealed) => join_key(&self.home, sealed.join).map_err(unshared)?,
            None => first_join_key(&self.home)?,
        };
        let sealed = sealed(self.provider, (&self.domain, &self.gateway), &join, kept)?;
        let replaced = self.notes.replace(&SharedSystemKeys {}, self.seen.as_ref(), &sealed);
        let replaced = replaced.map_err(|error| unshared(error.into()))?;
        if replaced {
            self.seen = Some(sealed);
        }
        Ok(replaced)
    }

    fn is_shared(&self) -> bool {
        true
    }
}

/// The first worker makes it, and keeps it before anything is sealed under it.
fn first_join_key(home: &Home) -> Result<JoinKey, CryptoError> {
    if let Some(made) = JoinKey::load(&home.gateway(), 1)? {
        return Ok(made);
    }
    let join = JoinKey::generate(1)?;
    join.save(&home.gateway())?;
    Ok(join)
}

pub(crate) fn join_key(home: &Home, number: u64) -> Result<JoinKey> {
    JoinKey::load(&home.gateway(), number)?.ok_or_else(|| {
        refused(format!(
            "the workers of this gateway have join key {number}, and {} does not have it: make a join file at another worker \
             (`authros gateway join-file --out FILE`), then run `authros gateway join FILE` here",
            home.root().display()
        ))
    })
}

pub(crate) fn sealed(
    provider: &dyn Provider,
    (domain, gateway): (&Domain, &SignerId),
    join: &JoinKey,
    kept: &Kept,
) -> Result<SealedSystemKeys, CryptoError> {
    let list = kept.list.encode();
    let secrets = join.seal(provider, SharedUse { domain, gateway, beside: &list }, kept.secrets())?;
    Ok(SealedSystemKeys { join: join.number, list: hex(&list), secrets: hex(&secrets) })
}

/// Refuses what another join key, gateway or network sealed, and what was altered.
pub(crate) fn opened(
    provider: &dyn Provider,
    (domain, gateway): (&Domain, &SignerId),
    join: &JoinKey,
    sealed: &SealedSystemKeys,
) -> Result<Kept> {
    let damaged = || Failure::new(ErrorKind::Tampered, DAMAGED);
    let (list, secrets) = unhex(&sealed.list).zip(unhex(&sealed.secrets)).ok_or_else(damaged)?;
    let plain = join.open(provider, SharedUse { domain, gateway, beside: &list }, &secrets).map_err(|_| damaged())?;
    Kept::parse(&list, &plain).map_err(|_| damaged())
}

impl Gateway {
    /// The file that makes another machine a worker; with `renew` under a new join key, which older files do not have.
    pub async fn join_file(&self, profile: &ProfileName, secret: &SecretText, renew: bool) -> Result<SecretBytes> {
        let passphrase = Passphrase::new(secret.expose().to_owned())?;
        let make = || -> Result<Vec<u8>> { Ok(self.made_join_file(profile, renew)?.seal(&passphrase)?) };
        let made = async { block_in_place(make) };
        let act = if renew { "renew join key" } else { "make join file" };
        self.parts.log.deed(profile, act, "gateway", made).await.map(SecretBytes::new)
    }

    fn made_join_file(&self, profile: &ProfileName, renew: bool) -> Result<JoinFile> {
        let config = &self.parts.config;
        if config.store_url.is_none() {
            let text = "a gateway whose records are in a file of its home has no further workers; one on PostgreSQL has \
                        (store.url)";
            return Err(refused(text));
        }
        if config.chain_url.is_none() {
            let text = "the chain is in this home, where no other worker reaches it; serve it with `authros chain serve` in a \
                        home of its own, and set chain.url to what that prints";
            return Err(refused(text));
        }
        let notes = &self.parts.plant.ledger.notes;
        let unserved =
            || input("this gateway was never served; run `authros gateway serve` once, then make the join file");
        let pin = network_pin(&self.parts.plant.ledger.rights)?.ok_or_else(unserved)?;
        let (keyring, home) = (self.parts.home.keyring(profile), &self.parts.home);
        if !keyring.exists() {
            let text =
                format!("profile '{profile}' has no keyring here; name the one that keeps the gateway with --profile");
            return Err(input(text));
        }
        let seen = notes.read(&SharedSystemKeys {})?.ok_or_else(unserved)?;
        let list = unhex(&seen.list).and_then(|list| SystemKeyList::parse(&list).ok());
        let gateway = list.ok_or_else(|| Failure::new(ErrorKind::Tampered, DAMAGED))?.gateway;
        let join = if renew {
            let (notes, home, provider) = (notes.clone(), home.clone(), self.parts.plant.provider);
            SharedShelf { notes, home, provider, domain: pin.domain(), gateway, seen: None }.renewed()?
        } else {
            join_key(home, seen.join)?
        };
        let mut file = JoinFile::new(pin.domain(), pin.chain_id, gateway, profile.clone(), join);
        file.keyring = std::fs::read(&keyring).map_err(CryptoError::read(&keyring))?;
        file.settings = config.of_workers();
        Ok(file)
    }
}

/// Times that other workers may write first.
const ATTEMPTS: usize = 10;

impl SharedShelf {
    /// A new join key, kept here before the secrets are sealed under it.
    fn renewed(&mut self) -> Result<JoinKey> {
        let folder = self.home.gateway();
        for _ in 0..ATTEMPTS {
            let kept = self.read()?.ok_or_else(|| refused("this gateway has no system keys yet; serve it once"))?;
            let number = self.seen.as_ref().map_or(0, |seen| seen.join) + 1;
            let next = JoinKey::generate(number)?;
            next.save(&folder)?;
            let sealed = sealed(self.provider, (&self.domain, &self.gateway), &next, &kept)?;
            // After an error it may be in use, so it stays; so do older ones, for a database restored to an earlier moment.
            if self.notes.replace(&SharedSystemKeys {}, self.seen.as_ref(), &sealed)? {
                return Ok(next);
            }
            next.forget(&folder)?;
        }
        Err(refused("other workers keep changing the gateway's system keys; try again"))
    }
}

//! A gateway's store on a server: opened, and refused if it is another gateway's. The store knows the accounts of the
//! gateway's profiles; a home of the same gateway has their keyrings.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crate::crypto::{JoinKey, read_public};
use crate::failure::refused;
use crate::model::{Address, ProfileName};
use crate::paths::Home;
use crate::reply::Result;
use crate::site::parts::Parts;
use crate::store::notes::{ProfileAccounts, SharedSystemKeys};
use crate::store::{Ledger, StoreError};

type Accounts = BTreeMap<ProfileName, Vec<Address>>;

/// The second value: the database was restored to an earlier time than this home has seen, and `works` accepts it. What only
/// looks is refused: it changes nothing.
pub(in crate::site) fn open_on_server(
    home: &Home,
    url: &str,
    roots: Option<&Path>,
    works: bool,
) -> Result<(Ledger, bool)> {
    if home.ledger().exists() {
        return Err(refused(format!(
            "{} has records in a file already, and a gateway on a server begins in a new home: give another --home, or \
             leave store.url empty",
            home.root().display()
        )));
    }
    let watermark = home.watermark();
    let (ledger, restored) = match Ledger::on_server_of(url, roots, &watermark) {
        Err(StoreError::ServerRestored { .. }) if works => {
            // Another gateway's never had what this home has seen.
            check_gateway(&Ledger::on_server(url, roots)?, home)?;
            Ledger::renew_on_server(url, roots, &watermark)?;
            (Ledger::on_server_of(url, roots, &watermark)?, true)
        }
        opened => (opened?, false),
    };
    check_gateway(&ledger, home)?;
    Ok((ledger, restored))
}

fn check_gateway(ledger: &Ledger, home: &Home) -> Result<()> {
    match other_gateway(&known(ledger)?, ledger.path(), home) {
        // Without a profile, a saved keyring may still be restored.
        Some(text) if !own(home).is_empty() => Err(refused(text)),
        _ => Ok(()),
    }
}

/// A home without keys may open another gateway's store, to restore them, but does no work there; nor does one without the
/// present join key.
pub(in crate::site) fn may_hold(ledger: &Ledger, home: &Home) -> Result<bool> {
    if !ledger.lease.is_shared() {
        return Ok(true);
    }
    let is_shut_out = match ledger.notes.read(&SharedSystemKeys {})? {
        Some(sealed) => JoinKey::load(&home.gateway(), sealed.join)?.is_none(),
        None => false,
    };
    Ok(!is_shut_out && other_gateway(&known(ledger)?, ledger.path(), home).is_none())
}

/// Refuses a new profile where the store is another gateway's.
pub(in crate::site) fn check_unused(parts: &Parts) -> Result<()> {
    let ledger = &parts.plant.ledger;
    let other = if parts.is_on_server() { other_gateway(&known(ledger)?, ledger.path(), &parts.home) } else { None };
    other.map_or(Ok(()), |text| Err(refused(text)))
}

/// Refuses to serve if another home with accounts of its own uses the same store.
pub(in crate::site) fn check_all_accounts(parts: &Parts) -> Result<()> {
    if !parts.is_on_server() {
        return Ok(());
    }
    let (ledger, own) = (&parts.plant.ledger, own(&parts.home));
    let mut others = known(ledger)?;
    others.retain(|_, accounts| !accounts.iter().any(|account| own.contains(account)));
    if others.is_empty() { Ok(()) } else { Err(refused(text(&others, ledger.path(), &parts.home))) }
}

/// What to say if a store that knows these accounts is not this home's.
pub(crate) fn other_gateway(known: &Accounts, store: &Path, home: &Home) -> Option<String> {
    let own = own(home);
    let is_own = known.is_empty() || known.values().flatten().any(|account| own.contains(account));
    (!is_own).then(|| text(known, store, home))
}

fn known(ledger: &Ledger) -> Result<Accounts> {
    Ok(ledger.notes.read(&ProfileAccounts {})?.unwrap_or_default())
}

fn own(home: &Home) -> BTreeSet<Address> {
    let public = |profile| read_public(&home.keyring(&profile)).ok();
    home.profiles().into_iter().filter_map(public).map(|public| public.address).collect()
}

fn text(accounts: &Accounts, store: &Path, home: &Home) -> String {
    let accounts: Vec<String> = accounts.values().flatten().map(ToString::to_string).collect();
    format!(
        "{} is the database of another gateway, whose account is {}, and {} has no keyring of it; name a database of its own in \
         store.url, or bring that keyring here with `authros keys restore FILE`",
        store.display(),
        accounts.join(", "),
        home.root().display()
    )
}

//! The account of a profile of this home, for a bench that borrows ether from it.

use authros_bench::Purse;

use super::connect::Context;
use super::{parse, passphrase};
use crate::crypto::{Keyring, Passphrase};
use crate::model::{ErrorKind, ProfileName, clean};
use crate::service::Failure;

/// Opens the profile's keyring, and keeps its home from everybody else for as long as the purse is held: a running site
/// sends from the same account, and one would take the other's nonces.
///
/// # Errors
/// If there is no such profile, its passphrase is not given or wrong, or the home is in use.
pub fn of_profile(context: &Context, named: &str) -> Result<Purse, Failure> {
    let unknown = || {
        let text = format!(
            "--funder {}: there is neither a file nor a profile of that name in {}; name a profile (`authros identity \
             create`), or a file with the key of an account",
            clean(named, 80),
            context.home.root().display()
        );
        Failure::new(ErrorKind::Input, text)
    };
    let profile: ProfileName = parse::value(named).map_err(|_| unknown())?;
    let keyring = context.home.keyring(&profile);
    if !keyring.exists() {
        return Err(unknown());
    }
    let lock = context.lock()?.ok_or_else(|| {
        let text = format!(
            "--funder {profile}: a site runs in {}, and sends from the same account; stop it for as long as this takes, \
             or name a file with the key of another account",
            context.home.root().display()
        );
        Failure::new(ErrorKind::Refused, text)
    })?;
    let secret = passphrase::given_or_asked(&context.global, &context.home, &profile)?;
    let secret = Passphrase::new(secret.expose().to_owned())?;
    let eoa = Keyring::load(&keyring, &secret)?.eoa.clone();
    Ok(Purse { eoa, home: Some(lock) })
}

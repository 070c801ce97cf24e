//! The name that an owner's site gives itself at a gateway: anyone else who took it would keep the site from bringing its
//! owner's notices.

use crate::gateway::{Code, Refusal};
use crate::model::{Address, ProfileName};

/// How an owner's site calls itself that brings notices to robots.
const COURIER: &str = "courier-";
/// Digits of the account in such a name.
const DIGITS: usize = 16;

/// The name of an owner's courier.
pub(in crate::site) fn courier_of(account: &Address) -> String {
    let digits: String = account.to_string().chars().filter(char::is_ascii_hexdigit).skip(1).take(DIGITS).collect();
    format!("{COURIER}{}", digits.to_lowercase())
}

/// Whether no robot may be called so: `courier-0123456789abcdef`. Other names that begin like it are nobody's.
pub(in crate::site) fn is_reserved(name: &ProfileName) -> bool {
    let digits = name.as_str().strip_prefix(COURIER);
    digits.is_some_and(|digits| digits.len() == DIGITS && digits.bytes().all(|byte| byte.is_ascii_hexdigit()))
}

/// Whether an account may have this name.
///
/// # Errors
/// [`Refusal`] with `NameBound`.
pub(super) fn check(name: &ProfileName, account: &Address) -> Result<(), Refusal> {
    if !is_reserved(name) || name.as_str() == courier_of(account) {
        return Ok(());
    }
    Err(Refusal::new(Code::NameBound, format_args!("{name} is the name of another account's own site")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_name_of_a_courier_is_its_accounts_own() {
        let (alice, eve) = (Address([0xab; 20]), Address([0xcd; 20]));
        let may = |name: &str, account| {
            let name: ProfileName = name.parse().expect("a name");
            check(&name, account).map_err(|refusal| refusal.code)
        };
        assert_eq!(courier_of(&alice), "courier-abababababababab");
        assert_eq!(may("courier-abababababababab", &alice), Ok(()));
        assert_eq!(may("courier-abababababababab", &eve), Err(Code::NameBound));
        for free in ["courier-1", "scout-1", "courier-abababababababax"] {
            assert_eq!(may(free, &eve), Ok(()), "{free}");
        }
    }
}

//! Names at a gateway that programs choose for themselves: whoever else took one would keep a site from bringing its owner's
//! notices, or a gateway from reconciling.

use crate::gateway::{Code, Refusal};
use crate::model::{Address, ProfileName, SignerId};

/// How an owner's site calls itself that brings notices to robots.
const COURIER: &str = "courier-";
/// How a gateway of a fleet calls itself at the others.
const GATEWAY: &str = "gateway-";
/// Digits of the account or key in such a name.
const DIGITS: usize = 16;

/// The name of an owner's courier.
pub(in crate::site) fn courier_of(account: &Address) -> String {
    let digits: String = account.to_string().chars().filter(char::is_ascii_hexdigit).skip(1).take(DIGITS).collect();
    format!("{COURIER}{}", digits.to_lowercase())
}

/// The name of a gateway, by SM3 of its identity key.
pub(in crate::site) fn gateway_of(key: &SignerId) -> String {
    format!("{GATEWAY}{}", key.to_hex().get(..DIGITS).unwrap_or_default())
}

/// Whether no robot may be called so.
pub(in crate::site) fn is_reserved(name: &ProfileName) -> bool {
    is_of_a_program(name, COURIER) || is_of_a_program(name, GATEWAY)
}

/// `courier-0123456789abcdef`: other names that begin like it are nobody's.
fn is_of_a_program(name: &ProfileName, prefix: &str) -> bool {
    let digits = name.as_str().strip_prefix(prefix);
    digits.is_some_and(|digits| digits.len() == DIGITS && digits.bytes().all(|byte| byte.is_ascii_hexdigit()))
}

/// Whether an account with these identity keys may have this name.
///
/// # Errors
/// [`Refusal`] with `NameBound`.
pub(super) fn check(name: &ProfileName, account: &Address, keys: impl Fn() -> Vec<SignerId>) -> Result<(), Refusal> {
    let own = match name.as_str() {
        _ if !is_reserved(name) => true,
        courier if courier.starts_with(COURIER) => courier == courier_of(account),
        gateway => keys().iter().any(|key| gateway_of(key) == gateway),
    };
    if own {
        return Ok(());
    }
    Err(Refusal::new(Code::NameBound, format_args!("{name} is the name of another account's own program")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_names_of_programs_are_their_accounts_and_gateways_own() {
        let (alice, eve) = (Address([0xab; 20]), Address([0xcd; 20]));
        let (key, other) = (SignerId([0x12; 32]), SignerId([0x34; 32]));
        let may = |name: &str, account, key| {
            let name: ProfileName = name.parse().expect("a name");
            check(&name, account, || vec![key]).map_err(|refusal| refusal.code)
        };
        assert_eq!(courier_of(&alice), "courier-abababababababab");
        assert_eq!(may("courier-abababababababab", &alice, other), Ok(()));
        assert_eq!(may("courier-abababababababab", &eve, other), Err(Code::NameBound));
        assert_eq!(may("gateway-1212121212121212", &alice, key), Ok(()));
        assert_eq!(may("gateway-1212121212121212", &alice, other), Err(Code::NameBound));
        for free in ["courier-1", "gateway-harbour", "scout-1", "courier-abababababababax", "gateway-12121212121212"] {
            assert_eq!(may(free, &eve, other), Ok(()), "{free}");
        }
    }
}

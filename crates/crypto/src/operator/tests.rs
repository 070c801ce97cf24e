use std::fs;
use std::os::unix::fs::PermissionsExt as _;

use super::*;
use crate::crypto::{Passphrase, ProviderName, provider};

const ACCOUNT: Address = Address([2; 20]);

fn owner() -> SmKeyPair {
    SmKeyPair::generate(provider(ProviderName::RustCrypto)).expect("a pair")
}

fn name(text: &str) -> OperatorName {
    text.parse().expect("a name")
}

fn terms(operator: &OperatorKey) -> OperatorTerms {
    let rights = "look,grant".parse().expect("rights");
    let until = Some(Timestamp(9));
    OperatorTerms { name: operator.name.clone(), key: operator.pair.public, rights, from: Timestamp(5), until }
}

#[test]
fn only_the_owners_key_certifies_and_every_byte_counts() {
    let provider = provider(ProviderName::RustCrypto);
    let (alice, mallory) = (owner(), owner());
    let bob = OperatorKey::generate(provider, name("bob")).expect("a key");
    let signed = OperatorStatement::sign(provider, &alice, &ACCOUNT, terms(&bob)).expect("signs");
    assert!(signed.check(provider, &alice.public, &ACCOUNT).is_ok());
    assert!(signed.check(provider, &alice.public, &Address([3; 20])).is_err(), "of another account");
    let forged = OperatorStatement::sign(provider, &mallory, &ACCOUNT, terms(&bob)).expect("signs");
    assert!(forged.check(provider, &alice.public, &ACCOUNT).is_err(), "by somebody else");
    let own = OperatorStatement::sign(provider, &bob.pair, &ACCOUNT, terms(&bob)).expect("signs");
    assert!(own.check(provider, &alice.public, &ACCOUNT).is_err(), "by the operator");

    let list = OperatorList(vec![signed]);
    let bytes = list.encode();
    assert_eq!(OperatorList::parse(&bytes), Ok(list));
    assert!((0..bytes.len()).all(|cut| OperatorList::parse(&bytes[..cut]).is_err()));
    for at in 0..bytes.len() {
        let mut altered = bytes.clone();
        altered[at] ^= 1;
        if let Ok(altered) = OperatorList::parse(&altered) {
            let stands = altered.0.first().is_some_and(|one| one.check(provider, &alice.public, &ACCOUNT).is_ok());
            assert!(!stands, "byte {at}");
        }
    }
    let twice = OperatorList([list_of(&alice, &bob), list_of(&alice, &bob)].concat());
    assert!(OperatorList::parse(&twice.encode()).is_err(), "a name is there once");
}

fn list_of(owner: &SmKeyPair, operator: &OperatorKey) -> Vec<OperatorStatement> {
    let provider = provider(ProviderName::RustCrypto);
    vec![OperatorStatement::sign(provider, owner, &ACCOUNT, terms(operator)).expect("signs")]
}

#[test]
fn a_proof_is_of_one_challenge_profile_and_operator() {
    let provider = provider(ProviderName::RustCrypto);
    let [bob, eve] = ["bob", "eve"].map(|who| OperatorKey::generate(provider, name(who)).expect("a key"));
    let here = (&[7; 32], &ACCOUNT, "alice");
    let proof = bob.prove(provider, here).expect("signs");
    let check = |terms: &OperatorTerms, asked| check_operator(provider, terms, asked, &proof);
    assert!(check(&terms(&bob), here).is_ok());
    assert!(check(&terms(&bob), (&[8; 32], &ACCOUNT, "alice")).is_err(), "of another connection");
    assert!(check(&terms(&bob), (&[7; 32], &ACCOUNT, "carol")).is_err(), "for another profile");
    assert!(check(&terms(&bob), (&[7; 32], &Address([3; 20]), "alice")).is_err(), "of another account");
    assert!(check(&terms(&eve), here).is_err(), "another operator's");
    let renamed = OperatorTerms { name: name("eve"), ..terms(&bob) };
    assert!(check(&renamed, here).is_err(), "under another name");
}

#[test]
fn the_file_opens_by_its_passphrase_only_and_holds_no_secret_in_clear() {
    let provider = provider(ProviderName::RustCrypto);
    let home = tempfile::tempdir().expect("a folder");
    let path = home.path().join("bob.operator");
    let passphrase = |text: &str| Passphrase::new(text.to_owned()).expect("long enough");
    let bob = OperatorKey::generate(provider, name("bob")).expect("a key");
    bob.create(provider, &path, &passphrase("correct horse")).expect("written");
    assert_eq!(fs::metadata(&path).expect("there").permissions().mode() & 0o777, 0o600);
    assert_eq!(OperatorKey::open(provider, &path, &passphrase("correct horse")).expect("opens"), bob);
    let wrong = OperatorKey::open(provider, &path, &passphrase("wrong horse"));
    assert!(matches!(wrong, Err(CryptoError::WrongPassphrase(_))));
    assert!(bob.create(provider, &path, &passphrase("correct horse")).is_err(), "never over another");
    let bytes = fs::read(&path).expect("bytes");
    assert!(!bytes.windows(32).any(|window| window == bob.pair.secret.expose()), "never in clear");
    for at in [0, 8, bytes.len() - 20, bytes.len() - 1] {
        let mut altered = bytes.clone();
        altered[at] ^= 1;
        fs::write(&path, &altered).expect("written");
        assert!(OperatorKey::open(provider, &path, &passphrase("correct horse")).is_err(), "byte {at}");
    }
}

//! The example of this crate's page.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use crate as authros_crypto;

use authros_crypto::{CryptoError, ProviderName, SmKeyPair, provider};

fn example() -> Result<(), CryptoError> {
    let ours = provider(ProviderName::default());
    let pair = SmKeyPair::generate(ours)?;
    let signature = ours.sign(&pair.secret, b"photo 17 of the scene")?;
    // Another implementation comes to the same verdict.
    let libsm = provider(ProviderName::Libsm);
    libsm.verify(&pair.public, b"photo 17 of the scene", &signature)?;
    assert!(libsm.verify(&pair.public, b"photo 18 of the scene", &signature).is_err());
    Ok(())
}

#[test]
fn the_example_of_the_page_runs() {
    example().expect("it runs");
    // What the page shows is what ran here.
    let shown = include_str!("../README.md").split("```").nth(1).expect("an example");
    let here = include_str!("readme_tests.rs");
    for line in shown.lines().map(str::trim).filter(|line| !line.is_empty()) {
        assert!(here.contains(line), "{line}");
    }
}

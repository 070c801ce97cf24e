//! The example of this crate's page.
#![allow(clippy::expect_used, clippy::print_stdout, reason = "a test fails by panicking, and the example prints")]

use crate as authros_evidence;

use authros_crypto::SmKeyPair;
use authros_crypto::{ProviderName, provider};
use authros_evidence::ClaimedChain;
use authros_evidence::{Bundle, Outcome, Packing, Trust, pack, verify};
use authros_model::{Address, Hash};

fn example() -> Result<(), Box<dyn std::error::Error>> {
    let provider = provider(ProviderName::default());
    let chain = ClaimedChain { id: 7, genesis: Hash([1; 32]), contract: Address([2; 20]) };
    let key = SmKeyPair::generate(provider)?;
    let file = pack(&Packing::default().sign(chain, Address([3; 20]), &key, provider)?)?;
    // `file` is what the archive has, as bytes.
    let trust = Trust::parse(
        br#"
        [chain]
        id = 7
        genesis = "0x0101010101010101010101010101010101010101010101010101010101010101"
        contract = "0x0202020202020202020202020202020202020202"
        code_hash = "0x0303030303030303030303030303030303030303030303030303030303030303"
        signers = ["0x0404040404040404040404040404040404040404"]
        sealed_by_exporter = false
    "#,
    )?;
    let bundle = Bundle::parse(&file, provider)?;
    let report = verify(&bundle, Some(&trust), provider);
    for record in &report.records {
        for (letter, level) in record.levels() {
            println!("{} ({letter}) {}: {}", record.digest, level.standing.word(), level.text);
        }
    }
    // There is no record in it, so nothing is proven.
    assert_eq!(report.outcome, Outcome::Incomplete);
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

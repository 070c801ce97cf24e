//! Verifies a bundle with the library alone: `verify_bundle BUNDLE TRUST`. Exits 0 if it holds, 8 if something is not
//! proven, 6 if something is contradicted, 1 if a file cannot be read.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a program for a terminal")]

use std::error::Error;
use std::path::Path;
use std::process::ExitCode;

use authros_crypto::{ProviderName, provider};
use authros_evidence::{Bundle, Outcome, Trust, verify};

fn run(bundle: &Path, trust: &Path) -> Result<Outcome, Box<dyn Error>> {
    let provider = provider(ProviderName::default());
    let trust = Trust::parse(&std::fs::read(trust)?)?;
    let report = verify(&Bundle::read(bundle, provider)?, Some(&trust), provider);
    for record in &report.records {
        println!("{}", record.digest);
        for (letter, level) in record.levels() {
            println!("  ({letter}) {}: {}", level.standing.word(), level.text);
        }
    }
    report.lines().iter().for_each(|line| println!("{line}"));
    Ok(report.outcome)
}

fn main() -> ExitCode {
    let arguments: Vec<_> = std::env::args_os().skip(1).collect();
    let [bundle, trust] = arguments.as_slice() else {
        eprintln!("usage: verify_bundle BUNDLE TRUST");
        return ExitCode::FAILURE;
    };
    match run(Path::new(bundle), Path::new(trust)) {
        Ok(Outcome::Holds) => ExitCode::SUCCESS,
        Ok(Outcome::Incomplete) => ExitCode::from(8),
        Ok(Outcome::Refused) => ExitCode::from(6),
        Err(error) => {
            eprintln!("verify_bundle: {error}");
            ExitCode::FAILURE
        }
    }
}

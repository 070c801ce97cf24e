//! `authros bench`: the paper's measurements, repeated on this machine. No home and no site: everything is in temporary
//! directories that are removed with the command.

pub mod args;

mod account;
mod algorithms;
mod all;
mod batcher;
mod consensus;
mod evidence;
mod funder;
mod gas;
mod gateway;
mod growth;
mod judgement;
mod lane;
mod machine;
mod memory;
mod mined;
mod network;
mod outlet;
mod pictures;
mod pipeline;
mod progress;
mod prototype;
mod record;
mod report;
mod ros;
mod size;
mod spread;
mod storer;
mod svg;
mod uploads;
mod usage;
mod yardstick;

use std::fmt::Display;
use std::future::Future;
use std::str::FromStr;

use self::algorithms::Algorithm;
use self::funder::Funder;
pub use self::funder::Purse;
use self::judgement::Judgement;
use self::outlet::{Form, Outlet};
use crate::args::{Bench, BenchArguments, BenchVerb};
use authros_crypto::{Provider, ProviderName, provider};
use authros_model::ErrorKind;
use authros_output::Output;
use authros_service::Failure;

/// The global flags that concern a bench.
#[derive(Clone, Copy)]
pub struct Global<'a> {
    /// One JSON document on stdout.
    pub json: bool,
    /// The SM provider.
    pub provider: ProviderName,
    /// The flags' values for settings.
    pub settings: &'a (dyn Fn(&str) -> Option<String> + Sync),
    /// Opens the account of a profile of the home.
    pub purse: &'a (dyn Fn(&str) -> Result<Purse, Failure> + Sync),
}

/// Runs one bench, or all, and returns the exit code: 0 whatever the figures are, unless they are to be judged. `stop`
/// ends it early; ether that was lent is taken back then, too.
///
/// # Errors
/// Errors of the bench or the arguments, or that it was stopped.
pub async fn run(
    global: Global<'_>,
    arguments: BenchArguments,
    output: &Output,
    stop: impl Future<Output = ()>,
) -> Result<u8, Failure> {
    let form = match (arguments.csv, global.json) {
        (true, true) => return Err(Failure::new(ErrorKind::Usage, "give --json or --csv, not both")),
        (true, false) => Form::Csv,
        (false, true) => Form::Json,
        (false, false) => Form::Text,
    };
    let provider = provider(global.provider);
    let outlet = Outlet::open(form, *output, arguments.svg)?;
    let funder = Funder::of(&arguments.verb, global.purse)?;
    let (judge, verb) = (arguments.judge, arguments.verb);
    let lender = funder.as_ref();
    let work = async move {
        match verb {
            BenchVerb::One(bench) => Ok(measure(global, bench, provider, &outlet, lender).await?.ended(judge)),
            BenchVerb::All(all) => all::run(global, all, provider, outlet, judge).await,
        }
    };
    let done = tokio::select! {
        done = work => done,
        () = stop => Err(stopped()),
    };
    let given_back = match &funder {
        Some(funder) => funder.take_back().await,
        None => Ok(()),
    };
    match (done, given_back) {
        (Ok(code), given_back) => given_back.map(|()| code),
        (Err(failure), Ok(())) => Err(failure),
        (Err(failure), Err(kept)) => {
            output.note(&format!("authros: {}", kept.message));
            Err(failure)
        }
    }
}

fn stopped() -> Failure {
    let text = "the benchmark was stopped before it finished; run it again for its figures";
    Failure::new(ErrorKind::Incomplete, text)
}

/// Reads a name given by a setting or an environment variable.
fn read<T: FromStr<Err: Display>>(text: &str) -> Result<T, Failure> {
    text.parse().map_err(|error: T::Err| Failure::new(ErrorKind::Input, error.to_string()))
}

async fn measure(
    global: Global<'_>,
    bench: Bench,
    provider: &'static dyn Provider,
    outlet: &Outlet,
    funder: Option<&Funder>,
) -> Result<Judgement, Failure> {
    match bench {
        Bench::Sm2(runs) => algorithms::run(Algorithm::Sm2, runs, provider, outlet).await,
        Bench::Sm3(runs) => algorithms::run(Algorithm::Sm3, runs, provider, outlet).await,
        Bench::Sm4(runs) => algorithms::run(Algorithm::Sm4, runs, provider, outlet).await,
        Bench::Record(runs) => record::run(runs.runs, provider, outlet).await,
        Bench::Consensus(consensus) => consensus::run(consensus, provider, outlet, funder).await,
        Bench::Size(size) => size::run(size, provider, outlet, funder).await,
        Bench::Pictures => tokio::task::block_in_place(|| pictures::run(provider, outlet)),
        Bench::Gas => gas::run(provider, outlet).await,
        Bench::Growth(growth) => growth::run(growth, outlet).await,
        Bench::Ros(ros) => tokio::task::block_in_place(|| ros::run(&ros, outlet)),
        Bench::Pipeline(pipeline) => pipeline::run(global, pipeline, outlet).await,
        Bench::Memory(memory) => memory::run(global, memory, provider, outlet).await,
        Bench::Gateway(gateway) => gateway::run(gateway, provider, outlet).await,
        Bench::Evidence(evidence) => evidence::run(evidence, provider, outlet).await,
    }
}

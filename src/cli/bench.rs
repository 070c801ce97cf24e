//! `authros bench`: the paper's measurements, repeated on this machine. No home and no site: everything
//! lies in temporary directories that go with the command.

mod account;
mod algorithms;
mod all;
mod batcher;
mod consensus;
mod gas;
mod gateway;
mod growth;
mod lane;
mod libgcrypt;
mod machine;
mod mined;
mod network;
mod outlet;
mod pictures;
mod pipeline;
mod progress;
mod prototype;
mod record;
mod report;
mod size;
mod spread;
mod storer;
mod svg;
mod uploads;
mod usage;

use self::algorithms::Algorithm;
use self::outlet::{Form, Outlet};
use super::args::{Bench, BenchArguments, BenchVerb, Global};
use super::output::Output;
use super::{parse, serve};
use crate::crypto::{Provider, ProviderName, provider};
use crate::model::ErrorKind;
use crate::service::Failure;

/// Runs one bench, or all; Ctrl-C ends it.
///
/// # Errors
/// What the bench or the arguments say.
pub async fn run(global: &Global, arguments: BenchArguments, output: &Output) -> Result<u8, Failure> {
    let form = match (arguments.csv, global.json) {
        (true, true) => return Err(Failure::new(ErrorKind::Usage, "give --json or --csv, not both")),
        (true, false) => Form::Csv,
        (false, true) => Form::Json,
        (false, false) => Form::Text,
    };
    let name: ProviderName = global.crypto_provider.as_deref().map(parse::value).transpose()?.unwrap_or_default();
    let provider = provider(name);
    let outlet = Outlet::open(form, *output, arguments.svg)?;
    let work = async {
        match arguments.verb {
            BenchVerb::One(bench) => measure(global, bench, provider, &outlet).await,
            BenchVerb::All(all) => all::run(global, all, provider, outlet).await,
        }
    };
    tokio::select! {
        done = work => done,
        _ = serve::asked_to_end() => Err(Failure::new(ErrorKind::Incomplete, "the bench was ended before it was done; run it again for its figures")),
    }
}

async fn measure(
    global: &Global,
    bench: Bench,
    provider: &'static dyn Provider,
    outlet: &Outlet,
) -> Result<u8, Failure> {
    match bench {
        Bench::Sm2(runs) => algorithms::run(Algorithm::Sm2, runs, provider, outlet).await,
        Bench::Sm3(runs) => algorithms::run(Algorithm::Sm3, runs, provider, outlet).await,
        Bench::Sm4(runs) => algorithms::run(Algorithm::Sm4, runs, provider, outlet).await,
        Bench::Record(runs) => record::run(runs.runs, provider, outlet).await,
        Bench::Consensus(consensus) => consensus::run(consensus, provider, outlet).await,
        Bench::Size(size) => size::run(size, provider, outlet).await,
        Bench::Pictures => tokio::task::block_in_place(|| pictures::run(provider, outlet)),
        Bench::Gas => gas::run(provider, outlet).await,
        Bench::Growth(growth) => growth::run(growth, outlet).await,
        Bench::Pipeline(pipeline) => pipeline::run(global, pipeline, outlet).await,
        Bench::Gateway(gateway) => gateway::run(gateway, provider, outlet).await,
    }
}

//! `authros bench`: the paper's measurements, repeated on this machine. No home and no site: everything
//! lies in temporary directories that go with the command.

mod account;
mod algorithms;
mod batcher;
mod consensus;
mod gas;
mod gateway;
mod lane;
mod libgcrypt;
mod machine;
mod mined;
mod network;
mod pictures;
mod pipeline;
mod progress;
mod record;
mod report;
mod spread;
mod storer;
mod uploads;
mod usage;

use self::algorithms::Algorithm;
use super::args::{BenchArguments, BenchVerb, Global};
use super::output::Output;
use super::{parse, serve};
use crate::crypto::{ProviderName, provider};
use crate::model::ErrorKind;
use crate::service::Failure;

/// Runs one bench; Ctrl-C ends it.
///
/// # Errors
/// What the bench or the arguments say.
pub async fn run(global: &Global, arguments: BenchArguments, output: &Output) -> Result<u8, Failure> {
    if arguments.csv && global.json {
        return Err(Failure::new(ErrorKind::Usage, "give --json or --csv, not both"));
    }
    let name: ProviderName = global.crypto_provider.as_deref().map(parse::value).transpose()?.unwrap_or_default();
    let (provider, csv, output) = (provider(name), arguments.csv, *output);
    let work = async {
        match arguments.verb {
            BenchVerb::Sm2(runs) => algorithms::run(Algorithm::Sm2, runs.runs, provider, csv, output).await,
            BenchVerb::Sm3(runs) => algorithms::run(Algorithm::Sm3, runs.runs, provider, csv, output).await,
            BenchVerb::Sm4(runs) => algorithms::run(Algorithm::Sm4, runs.runs, provider, csv, output).await,
            BenchVerb::Record(runs) => record::run(runs.runs, provider, csv, output).await,
            BenchVerb::Consensus(consensus) => consensus::run(consensus, provider, csv, output).await,
            BenchVerb::Pictures => tokio::task::block_in_place(|| pictures::run(provider, csv, output)),
            BenchVerb::Gas => gas::run(provider, csv, output).await,
            BenchVerb::Pipeline(pipeline) => pipeline::run(global, pipeline, csv, output).await,
            BenchVerb::Gateway(gateway) => gateway::run(gateway, provider, csv, output).await,
        }
    };
    tokio::select! {
        done = work => done,
        _ = serve::asked_to_end() => Err(Failure::new(ErrorKind::Incomplete, "the bench was ended before it was done; run it again for its figures")),
    }
}

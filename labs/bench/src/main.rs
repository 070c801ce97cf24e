//! `authros-bench`: the measurements of the paper, repeated on this machine. No home and no settings: everything is in
//! temporary directories that are removed at the end, and nothing but `--node` leaves the machine.

mod account;
mod algorithms;
mod all;
mod args;
mod batcher;
mod consensus;
mod foreign;
mod funder;
mod gas;
mod gateway;
mod judgement;
mod lane;
mod machine;
mod mined;
mod network;
mod outlet;
mod pages;
mod pipeline;
mod plot;
mod progress;
mod prototype;
mod record;
mod report;
mod size;
mod spread;
mod storer;
mod uploads;
mod usage;

use std::process::ExitCode;

use clap::Parser as _;
use tokio::signal::unix::{SignalKind, signal};

use self::algorithms::Algorithm;
use self::args::{Arguments, Bench};
use self::funder::Funder;
use self::judgement::Judgement;
use self::outlet::Outlet;
use authros_crypto::{Provider, ProviderName, provider};
use authros_model::ErrorKind;
use authros_output::Output;
use authros_service::Failure;
use authros_service::reply::internal;

/// What all benches share.
struct Lab {
    name: ProviderName,
    provider: &'static dyn Provider,
    outlet: Outlet,
    funder: Option<Funder>,
}

fn main() -> ExitCode {
    let output = Output::new(false);
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
    let runtime = runtime.map_err(|error| internal(format!("the runtime cannot start: {error}")));
    match runtime.and_then(|runtime| runtime.block_on(run(Arguments::parse(), output))) {
        Ok(code) => ExitCode::from(code),
        Err(failure) => {
            output.note(&format!("authros-bench: {}", failure.message));
            ExitCode::from(failure.kind.exit_code())
        }
    }
}

/// Runs one bench or all until it is done or a signal ends it; the exit code is 0 unless the figures are judged. Ether
/// that was lent is taken back in any case.
async fn run(arguments: Arguments, output: Output) -> Result<u8, Failure> {
    let lab = Lab {
        name: arguments.provider,
        provider: provider(arguments.provider),
        outlet: Outlet::open(arguments.out, output)?,
        funder: Funder::of(&arguments.bench)?,
    };
    let work = async {
        match &arguments.bench {
            Bench::All(all) => all::run(&lab, all, arguments.judge).await,
            bench => Ok(measure(&lab, bench).await?.ended(arguments.judge)),
        }
    };
    let done = tokio::select! {
        done = work => done,
        () = told_to_end() => Err(stopped()),
    };
    let given_back = match &lab.funder {
        Some(funder) => funder.take_back().await,
        None => Ok(()),
    };
    match (done, given_back) {
        (Ok(code), given_back) => given_back.map(|()| code),
        (Err(failure), Ok(())) => Err(failure),
        (Err(failure), Err(kept)) => {
            output.note(&format!("authros-bench: {}", kept.message));
            Err(failure)
        }
    }
}

async fn measure(lab: &Lab, bench: &Bench) -> Result<Judgement, Failure> {
    match bench {
        Bench::Sm2(runs) => algorithms::run(lab, Algorithm::Sm2, runs.runs).await,
        Bench::Sm3(runs) => algorithms::run(lab, Algorithm::Sm3, runs.runs).await,
        Bench::Sm4(runs) => algorithms::run(lab, Algorithm::Sm4, runs.runs).await,
        Bench::Record(runs) => record::run(lab, runs.runs).await,
        Bench::Gas => gas::run(lab).await,
        Bench::Consensus(consensus) => consensus::run(lab, consensus).await,
        Bench::Size(size) => size::run(lab, size).await,
        Bench::Gateway(gateway) => gateway::run(lab, gateway).await,
        Bench::Pipeline(pipeline) => pipeline::run(lab, pipeline).await,
        Bench::Pages(pages) => pages::run(lab, pages).await,
        Bench::All(_) => Err(internal("all benches within one")),
    }
}

/// Waits for SIGINT, SIGTERM or SIGHUP.
async fn told_to_end() {
    let wait = |kind| async move {
        match signal(kind) {
            Ok(mut stream) => drop(stream.recv().await),
            Err(_) => std::future::pending().await,
        }
    };
    tokio::select! {
        () = wait(SignalKind::interrupt()) => {}
        () = wait(SignalKind::terminate()) => {}
        () = wait(SignalKind::hangup()) => {}
    }
}

fn stopped() -> Failure {
    let text = "the benchmark was stopped before it finished; run it again for its figures";
    Failure::new(ErrorKind::Incomplete, text)
}

//! Arguments in, results out: the headless twin of the console, over the same commands.
//!
//! stdout carries the result and nothing else, stderr the rest; `--json` changes the format,
//! never the channel. Nothing here does work of its own but the demo's story.

mod adopt;
mod agent;
pub mod args;
mod audit;
mod capture;
mod chain;
mod check;
mod connect;
mod console;
mod demo;
mod follow;
mod gateway;
mod lists;
mod looks;
mod memory;
mod parse;
mod parties;
mod passphrase;
mod plans;
mod policy;
mod printed;
mod quarantine;
mod recordings;
mod serve;
mod show;
mod status;
mod twins;
mod verbs;
mod viewing;

use std::process::ExitCode;

use clap::Parser;

use self::args::{Arguments, ChainVerb, SharedVerb, UploadsVerb, Verb};
use self::connect::Context;
use crate::model::ErrorKind;
use crate::service::Failure;
use authros_output::Output;

/// Runs the program; the exit code follows from the kind of error.
pub fn main() -> ExitCode {
    memory::keep_private();
    serve::note_hangup();
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            let code = error.exit_code();
            // A closed stdout or stderr leaves nobody to tell.
            drop(error.print());
            return ExitCode::from(u8::try_from(code).unwrap_or(2));
        }
    };
    let output = Output::new(arguments.global.json);
    let result = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|error| Failure::new(crate::model::ErrorKind::Internal, format!("threads cannot be started: {error}")))
        .and_then(|runtime| {
            let result = run(&runtime, arguments, &output);
            // All is flushed; tasks that still wait end with the process, not one by one.
            std::mem::forget(runtime);
            result
        });
    match result {
        Ok(code) => ExitCode::from(code),
        Err(failure) => {
            output.failure(&failure);
            ExitCode::from(failure.kind.exit_code())
        }
    }
}

fn run(runtime: &tokio::runtime::Runtime, arguments: Arguments, output: &Output) -> Result<u8, Failure> {
    // It needs no home, and its --consensus is no setting.
    if let Some(Verb::Chain(ChainVerb::Genesis(genesis))) = &arguments.verb {
        return chain::genesis(genesis, output);
    }
    if let Some(text) = printed::text(&arguments)? {
        output.raw(&text);
        return Ok(0);
    }
    let verb = match arguments.verb {
        // Needs no home, so it does not look at one.
        // Its home follows from its enrolment.
        Some(Verb::Agent(args::AgentVerb::Run(run))) => {
            return runtime.block_on(agent::run(arguments.global, run, output));
        }
        Some(Verb::Bench(bench)) => return runtime.block_on(run_bench(&arguments.global, bench, output)),
        other => other,
    };
    if let Some(Verb::Verify { dir, genesis }) = &verb {
        return runtime.block_on(check::run_verify(&arguments.global, dir, genesis.as_deref(), output));
    }
    let context = Context::new(arguments.global, output)?;
    match verb {
        None => console::run(runtime, context, args::ConsoleArguments::default()),
        Some(Verb::Console(console)) => console::run(runtime, context, console),
        Some(Verb::Agent(args::AgentVerb::Enrol(enrol))) => runtime.block_on(agent::enrol(context, enrol, output)),
        Some(Verb::Serve) => runtime.block_on(serve::run(context, output)),
        Some(Verb::Demo(demo)) => runtime.block_on(demo::run(context, demo, output)),
        Some(Verb::Gateway(args::GatewayVerb::Serve { listen, open })) => {
            runtime.block_on(gateway::serve(context, listen, open, output))
        }
        Some(Verb::Chain(ChainVerb::Serve { listen })) => runtime.block_on(chain::serve(context, listen, output)),
        Some(Verb::Doctor) => runtime.block_on(check::run_doctor(context, output)),
        Some(Verb::Backup { file }) => runtime.block_on(check::run_backup(context, &file, output)),
        Some(Verb::Restore { file }) => check::run_restore(&context, &file, output),
        Some(Verb::Capture(capture)) => runtime.block_on(capture::run(context, capture, output)),
        Some(Verb::Bag(recordings::BagVerb::Import(import))) => {
            runtime.block_on(recordings::import(context, import, output))
        }
        Some(Verb::Shared(SharedVerb::Export(export))) => runtime.block_on(recordings::export(context, export, output)),
        Some(Verb::Uploads(UploadsVerb::List(list))) if list.follow => {
            runtime.block_on(follow::run(context, follow::Which::Uploads, parse::query(&list)?, output))
        }
        Some(Verb::Shared(SharedVerb::List(list))) if list.follow => {
            runtime.block_on(follow::run(context, follow::Which::Shared, parse::query(&list)?, output))
        }
        Some(verb) => runtime.block_on(verbs::run(context, verb, output)),
    }
}

/// Measures until it is done or somebody asks for the end.
async fn run_bench(
    global: &args::Global,
    arguments: authros_bench::args::BenchArguments,
    output: &Output,
) -> Result<u8, Failure> {
    let provider = global.crypto_provider.as_deref().map(parse::value).transpose()?.unwrap_or_default();
    let settings = |name: &str| global.setting(name);
    let global = authros_bench::Global { json: global.json, provider, settings: &settings };
    tokio::select! {
        done = authros_bench::run(global, arguments, output) => done,
        _ = serve::asked_to_end() => {
            Err(Failure::new(ErrorKind::Incomplete, "the bench was ended before it was done; run it again for its figures"))
        }
    }
}

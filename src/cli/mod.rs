//! Arguments in, results out: the headless twin of the console, over the same commands.
//!
//! stdout carries the result and nothing else, stderr the rest; `--json` changes the format, never the channel. Nothing
//! here does work of its own except the demo's story.

mod agent;
pub mod args;
mod audit;
mod backups;
mod capture;
mod chain;
mod check;
mod complete;
mod connect;
mod console;
mod coverage;
mod demo;
mod evidence;
mod follow;
mod following;
mod gateway;
mod incidents;
mod lists;
mod logging;
mod memory;
mod parse;
mod parties;
mod passphrase;
mod plans;
mod playing;
mod printed;
mod quarantine;
mod reading;
mod recorded;
mod recordings;
mod retention;
mod robots;
mod serve;
mod show;
mod status;
mod twins;
mod verbs;

use std::process::ExitCode;

use clap::Parser as _;
use tokio::runtime::Runtime;

use self::args::{Arguments, Global, Verb};
use self::connect::{Context, ProfileNeed};
use self::verbs::{CHAIN, Plan};
use crate::model::ErrorKind;
use crate::service::{Failure, command};
use authros_output::Output;

/// Runs the program; the exit code follows from the kind of error.
pub fn main() -> ExitCode {
    memory::keep_few_arenas();
    memory::keep_private();
    serve::note_hangup();
    let arguments = match Arguments::try_parse_from(args::with_values_joined(std::env::args_os())) {
        Ok(arguments) => arguments,
        Err(error) => {
            if error.use_stderr() && std::env::args_os().any(|argument| argument == "--json") {
                Output::new(true).failure(&misused(&error));
                return ExitCode::from(ErrorKind::Usage.exit_code());
            }
            let code = error.exit_code();
            // If stdout or stderr is closed there is nobody to inform.
            drop(error.print());
            return ExitCode::from(u8::try_from(code).unwrap_or(2));
        }
    };
    let output = Output::new(arguments.global.json).logging(arguments.global.log.into());
    if output.log() == authros_output::Log::Json {
        logging::panics_too();
    }
    let result = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|error| Failure::new(crate::model::ErrorKind::Internal, format!("threads cannot be started: {error}")))
        .and_then(|runtime| {
            let there = reading::needs_a_home(&arguments.global, arguments.verb.as_ref());
            let result = there.and_then(|()| run(&runtime, arguments, &output));
            // Everything is flushed; tasks that still wait end with the process, not one by one.
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

/// What the parser of arguments says, in one line.
fn misused(error: &clap::Error) -> Failure {
    let text = error.to_string();
    let lines: Vec<&str> = text.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    let text = lines.join("; ");
    Failure::new(ErrorKind::Usage, text.strip_prefix("error: ").unwrap_or(&text))
}

/// Every verb has its arm here, so one that nothing runs does not compile. Some need no home and do not touch one.
#[deny(clippy::wildcard_enum_match_arm)]
fn run(runtime: &Runtime, arguments: Arguments, output: &Output) -> Result<u8, Failure> {
    if let Some(text) = printed::defaults(&arguments.print)? {
        output.raw(&text);
        return Ok(0);
    }
    let global = arguments.global;
    match arguments.verb.unwrap_or_else(|| Verb::Console(args::ConsoleArguments::default())) {
        Verb::Console(console) => console::run(runtime, Context::new(global, output)?, console, None),
        Verb::Tour(arguments) => console::run_tour(runtime, Context::new(global, output)?, arguments),
        Verb::Completions { shell } => {
            output.raw(&printed::completions(shell));
            Ok(0)
        }
        Verb::Complete { what, begun } => {
            output.raw(&complete::candidates(&global, what, &begun));
            Ok(0)
        }
        Verb::Man => {
            output.raw(&printed::manual()?);
            Ok(0)
        }
        Verb::Profiles => Ok(lists::profiles(&Context::new(global, output)?, output)),
        Verb::Config(verb) => verbs::config(&Context::new(global, output)?, &verb, output),
        Verb::Restore { file, check: true } => {
            runtime.block_on(backups::check(Context::new(global, output)?, &file, output))
        }
        Verb::Restore { file, check: false } => check::run_restore(&Context::new(global, output)?, &file, output),
        Verb::Evidence(verb) => runtime.block_on(evidence::run(Context::new(global, output)?, verb, output)),
        Verb::Verify { path, trust, recording, genesis: None, verbose }
            if trust.is_some() || recording.is_some() || evidence::is_bundle(&path) =>
        {
            evidence::run_verify((&path, recording.as_deref()), trust.as_deref(), verbose, output)
        }
        Verb::Verify { path, trust: _, recording: _, genesis, verbose: _ } => {
            runtime.block_on(check::run_verify(&global, &path, genesis.as_deref(), output))
        }
        Verb::Agent(verb) => runtime.block_on(agent::run(global, verb, output)),
        Verb::Chain(verb) => runtime.block_on(chain::run(global, verb, output)),
        Verb::Serve(serve) => runtime.block_on(serve::run(Context::new(global, output)?, serve, output)),
        Verb::Demo(demo) => runtime.block_on(demo::run(Context::new(global, output)?, demo, output)),
        Verb::Gateway(verb) => runtime.block_on(gateway::run(Context::new(global, output)?, verb, output)),
        Verb::Doctor => runtime.block_on(check::run_doctor(Context::new(global, output)?, output)),
        Verb::Backup(backup) => runtime.block_on(back_up(Context::new(global, output)?, backup, output)),
        Verb::Status { watch: true } => runtime.block_on(status::watch(Context::new(global, output)?, output)),
        Verb::Status { watch: false } => runtime.block_on(status::run(Context::new(global, output)?, output)),
        Verb::Capture(capture) => runtime.block_on(capture::run(Context::new(global, output)?, capture, output)),
        Verb::Bag(recordings::BagVerb::Import(import)) => {
            runtime.block_on(recordings::import(Context::new(global, output)?, import, output))
        }
        Verb::Bag(recordings::BagVerb::Follow(follow)) => {
            runtime.block_on(following::run(Context::new(global, output)?, follow, output))
        }
        Verb::Uploads(verb) => runtime.block_on(verbs::uploads(Context::new(global, output)?, verb, output)),
        Verb::Shared(verb) => runtime.block_on(verbs::shared(Context::new(global, output)?, verb, output)),
        Verb::Identity(verb) => identity(runtime, global, verb, output),
        Verb::Keys(verb) => asked(runtime, global, output, |context| plans::keys(context, verb)),
        Verb::Register => {
            asked(runtime, global, output, |_| Ok(Plan::new(CHAIN, ProfileNeed::Made, command::Register)))
        }
        Verb::Topics(verb) => asked(runtime, global, output, |_| verbs::topics(verb)),
        Verb::Quarantine(verb) => asked(runtime, global, output, |_| verbs::quarantine(verb)),
        Verb::Grant(arguments) => {
            asked(runtime, global, output, |_| Ok(Plan::new(CHAIN, ProfileNeed::Unlocked, plans::grant(&arguments)?)))
        }
        Verb::Revoke { address } => asked(runtime, global, output, |_| {
            Ok(Plan::new(CHAIN, ProfileNeed::Unlocked, command::Revoke { grantee: parse::value(&address)? }))
        }),
        Verb::Grants(verb) => asked(runtime, global, output, |_| verbs::grants(verb)),
        Verb::Contacts(verb) => {
            asked(runtime, global, output, |_| Ok(Plan::new(CHAIN, ProfileNeed::None, parties::contacts(verb)?)))
        }
        Verb::Devices(verb) => {
            asked(runtime, global, output, |_| Ok(Plan::new(CHAIN, ProfileNeed::Unlocked, robots::question(&verb)?)))
        }
        Verb::Alerts(verb) => asked(runtime, global, output, |_| Ok(status::plan(&verb))),
        Verb::Robots(verb) => asked(runtime, global, output, |_| robots::plan(verb)),
        Verb::Incident(verb) => asked(runtime, global, output, |_| incidents::plan(verb)),
        Verb::Retention(verb) => runtime.block_on(retention::run(Context::new(global, output)?, verb, output)),
        Verb::Audit(arguments) => asked(runtime, global, output, |context| plans::audit(context, &arguments)),
    }
}

/// `identity …`
fn identity(runtime: &Runtime, global: Global, verb: args::IdentityVerb, output: &Output) -> Result<u8, Failure> {
    match verb {
        args::IdentityVerb::List => lists::identities(&Context::new(global, output)?, output),
        args::IdentityVerb::Create => runtime.block_on(verbs::create_identity(Context::new(global, output)?, output)),
        verb @ (args::IdentityVerb::Show
        | args::IdentityVerb::Compare { .. }
        | args::IdentityVerb::Recovery { .. }
        | args::IdentityVerb::Lock) => asked(runtime, global, output, |_| verbs::identity(verb)),
    }
}

/// `backup …`
async fn back_up(context: Context, backup: args::BackupArguments, output: &Output) -> Result<u8, Failure> {
    match (backup.file, backup.to) {
        (Some(file), _) => check::run_backup(context, &file, output).await,
        (None, Some(folder)) => backups::run(context, &folder, backup.keep, output).await,
        (None, None) => Err(Failure::new(ErrorKind::Usage, "give a file, or a folder with --to")),
    }
}

/// Runs a plain verb: one request, and its answer printed.
fn asked(
    runtime: &Runtime,
    global: Global,
    output: &Output,
    plan: impl FnOnce(&Context) -> Result<Plan, Failure>,
) -> Result<u8, Failure> {
    let context = Context::new(global, output)?;
    let plan = plan(&context)?;
    runtime.block_on(verbs::run(context, plan, output))
}

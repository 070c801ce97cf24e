//! Arguments in, results out: the headless twin of the console.
//!
//! stdout carries the result, stderr the rest; `--json` changes the format, never the channel.

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
mod grants;
mod help;
mod identity;
mod incidents;
mod keys;
mod memory;
mod parse;
mod parties;
mod passphrase;
mod plan;
mod playing;
mod printed;
mod quarantine;
#[cfg(test)]
mod quoted;
mod reading;
mod recordings;
mod records;
mod retention;
mod robots;
mod rules;
mod serve;
mod settings;
mod show;
mod status;
mod topics;
mod twins;

use std::process::ExitCode;

use tokio::runtime::Runtime;

use self::args::{Arguments, Verb};
use self::connect::Context;
use self::identity::IdentityVerb;
use self::plan::Plan;
use self::recordings::BagVerb;
use crate::model::{ErrorKind, Timestamp};
use crate::service::{Failure, NoticeLevel};
use authros_output::{Log, Output, log_line};

pub fn main() -> ExitCode {
    memory::keep_few_arenas();
    memory::keep_private();
    serve::note_hangup();
    let arguments = match args::read(std::env::args_os()) {
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
    if output.log() == Log::Json {
        panics_too();
    }
    let result = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|error| Failure::new(ErrorKind::Internal, format!("threads cannot be started: {error}")))
        .and_then(|runtime| {
            let there = reading::needs_a_home(&arguments.global, arguments.verb.as_ref());
            let result = parse::names_on_one_line(std::env::args_os())
                .and(there)
                .and_then(|()| run(&runtime, arguments, &output));
            // Data is flushed; tasks that still wait end with the process.
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

fn misused(error: &clap::Error) -> Failure {
    let text = error.to_string();
    let lines: Vec<&str> = text.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    let text = lines.join("; ");
    Failure::new(ErrorKind::Usage, text.strip_prefix("error: ").unwrap_or(&text))
}

/// Panics of tasks take the same form.
fn panics_too() {
    std::panic::set_hook(Box::new(|about| {
        use std::io::Write as _;
        let line = log_line(Timestamp::now(), NoticeLevel::Error, "panic", &about.to_string());
        // If that fails there is nobody to inform.
        drop(writeln!(std::io::stderr().lock(), "{line}"));
    }));
}

/// Exhaustive: a verb that nothing runs does not compile.
#[deny(clippy::wildcard_enum_match_arm)]
fn run(runtime: &Runtime, arguments: Arguments, output: &Output) -> Result<u8, Failure> {
    if let Some(text) = printed::asked_for(&arguments.print)? {
        return Ok(print(output, &text));
    }
    let global = arguments.global;
    let context = || Context::new(global.clone(), output);
    let ask = |context: Context, plan: Plan| runtime.block_on(plan::run(context, plan, output));
    match arguments.verb.unwrap_or_else(|| Verb::Console(args::ConsoleArguments::default())) {
        Verb::Tour(tour) if tour.plain => runtime.block_on(demo::run(context()?, tour.seconds, output)),
        Verb::Tour(tour) => console::run_tour(runtime, context()?, tour),
        Verb::Console(console) => console::run(runtime, context()?, console, None),
        Verb::Serve(serve) => runtime.block_on(serve::run(context()?, serve, output)),
        Verb::Status { watch: true } => runtime.block_on(status::watch(context()?, output)),
        Verb::Status { watch: false } => runtime.block_on(status::run(context()?, output)),
        Verb::Doctor => runtime.block_on(check::run_doctor(context()?, output)),
        Verb::Topics(verb) => ask(context()?, topics::plan(verb, output)?),
        Verb::Capture(capture) => runtime.block_on(capture::run(context()?, capture, output)),
        Verb::Records(verb) => runtime.block_on(records::own(context()?, verb, output)),
        Verb::Bag(BagVerb::Import(import)) => runtime.block_on(recordings::import(context()?, import, output)),
        Verb::Bag(BagVerb::Follow(follow)) => runtime.block_on(following::run(context()?, follow, output)),
        Verb::Bag(BagVerb::Export(export)) => runtime.block_on(recordings::export(context()?, export, output)),
        Verb::Identity(IdentityVerb::List) => identity::list(&context()?, output),
        Verb::Identity(IdentityVerb::Create) => runtime.block_on(identity::create(context()?, output)),
        Verb::Identity(verb) => ask(context()?, identity::plan(verb)?),
        Verb::Keys(verb) => {
            let context = context()?;
            let plan = keys::plan(&context, verb)?;
            ask(context, plan)
        }
        Verb::Grant(verb) => ask(context()?, grants::plan(verb, output)?),
        Verb::Received(verb) => runtime.block_on(records::received(context()?, verb, output)),
        Verb::Contacts(verb) => ask(context()?, Plan::public(parties::contacts(verb)?)),
        Verb::Robot(verb) => runtime.block_on(robots::run(global, verb, output)),
        Verb::Gateway(verb) => runtime.block_on(gateway::run(context()?, verb, output)),
        Verb::Incident(verb) => ask(context()?, incidents::plan(verb, output)?),
        Verb::Evidence(verb) => runtime.block_on(evidence::run(global, verb, output)),
        Verb::Audit(arguments) => {
            let context = context()?;
            let plan = audit::plan(&context, &arguments, output)?;
            ask(context, plan)
        }
        Verb::Chain(verb) => runtime.block_on(chain::run(global, verb, output)),
        Verb::Alerts(verb) => ask(context()?, status::plan(&verb)),
        Verb::Backup(verb) => runtime.block_on(backups::run(context()?, verb, output)),
        Verb::Config(verb) => settings::run(&context()?, &verb, output),
        Verb::Help { words } => Ok(print(output, &help::page(&words)?)),
        Verb::Complete { what, begun } => Ok(print(output, &complete::candidates(&global, what, &begun))),
    }
}

fn print(output: &Output, text: &str) -> u8 {
    output.raw(text);
    0
}

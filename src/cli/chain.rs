//! `authros chain`: its plain verbs and the administrator's, `chain serve` and `chain genesis`.

#![deny(clippy::wildcard_enum_match_arm)]

use std::fs::{DirBuilder, OpenOptions};
use std::io::{ErrorKind as IoKind, Write as _};
use std::{net::SocketAddr, path::Path};

use super::args::{ChainVerb, GenesisArguments, Global, SuccessionVerb};
use super::connect::{Context, ProfileNeed};
use super::verbs::{CHAIN, Plan};
use super::{parse, show::not_written};
use crate::chain::{GUIDE, Genesis, GenesisKind};
use crate::model::ErrorKind;
use crate::service::command::{self, Administration};
use crate::service::{Client, Failure, Needs, failure::input, reply::ServedView};
use authros_output::Output;

pub async fn run(global: Global, verb: ChainVerb, output: &Output) -> Result<u8, Failure> {
    let unlocked = |act: Administration| Plan::unlocked(command::Administer(act));
    let plan = match verb {
        ChainVerb::Genesis(arguments) => return genesis(&arguments, output),
        ChainVerb::Serve { listen } => return serve(Context::new(global, output)?, listen, output).await,
        ChainVerb::Status => Plan::public(command::ChainStatus),
        ChainVerb::Deploy { delay } => {
            let delay = delay.as_deref().map(seconds).transpose()?;
            Plan::new(CHAIN, ProfileNeed::Made, command::DeployContract { delay })
        }
        ChainVerb::Cancel { nonce, account, yes: true } => {
            let account = parse::optional(account.as_deref())?;
            Plan::unlocked(command::CancelTransaction { nonce, account })
        }
        ChainVerb::Cancel { .. } => {
            let text = "what the transaction was for does not happen unless it anchors records; add --yes to confirm";
            return Err(Failure::new(ErrorKind::Usage, text));
        }
        ChainVerb::Succession(SuccessionVerb::List) => Plan::public(command::ListSuccessions),
        ChainVerb::Succession(SuccessionVerb::Propose { lost, successor }) => {
            unlocked(Administration::Propose { lost: parse::value(&lost)?, successor: parse::value(&successor)? })
        }
        ChainVerb::Succession(SuccessionVerb::Cancel { lost }) => {
            unlocked(Administration::Cancel { lost: parse::value(&lost)? })
        }
        ChainVerb::Succession(SuccessionVerb::Complete { lost }) => {
            unlocked(Administration::Complete { lost: parse::value(&lost)? })
        }
        ChainVerb::Dismiss { account } => unlocked(Administration::Dismiss { account: parse::value(&account)? }),
        ChainVerb::Admit { account } => unlocked(Administration::Admit { account: parse::value(&account)? }),
        ChainVerb::Suspend { account } => unlocked(Administration::Suspend { account: parse::value(&account)? }),
        ChainVerb::Restore { account } => unlocked(Administration::Restore { account: parse::value(&account)? }),
        ChainVerb::Open => unlocked(Administration::Open { open: true }),
        ChainVerb::Close => unlocked(Administration::Open { open: false }),
        ChainVerb::Pause { length } => {
            let seconds = length.as_deref().map(seconds).transpose()?;
            unlocked(Administration::Pause { paused: true, seconds })
        }
        ChainVerb::Resume => unlocked(Administration::Pause { paused: false, seconds: None }),
        ChainVerb::HandOver { account } => unlocked(Administration::HandOver { account: parse::value(&account)? }),
        ChainVerb::Accept => unlocked(Administration::Accept),
    };
    super::verbs::run(Context::new(global, output)?, plan, output).await
}

fn seconds(text: &str) -> Result<u64, Failure> {
    parse::duration(text).map(|length| length.as_secs())
}

async fn serve(context: Context, listen: SocketAddr, output: &Output) -> Result<u8, Failure> {
    if !listen.ip().is_loopback() {
        // Refuses before a site is started.
        drop(crate::chain::serve::listen(listen).await?);
    }
    let connection = context.connect(Needs { ros: true, chain: true }).await?;
    let begin = async |client: &Client| client.ask(command::ServeChain { address: listen }).await;
    super::serve::until_signal(connection, output, begin, |served: ServedView, joined| {
        let place = if joined { "the running site" } else { "this process, the site" };
        output.result(&serde_json::json!({ "serving": &served, "joined": joined }), || {
            format!("chain {} at {}, served by {place}; stop it with Ctrl-C", served.chain_id, served.url)
        });
    })
    .await
}

fn genesis(arguments: &GenesisArguments, output: &Output) -> Result<u8, Failure> {
    let Some(consensus) = &arguments.consensus else {
        output.result(&serde_json::json!({ "guide": GUIDE }), || GUIDE.to_owned());
        return Ok(0);
    };
    let kind: GenesisKind = parse::value(consensus)?;
    let (signers, allocations) = (parse::values(&arguments.signers)?, parse::values(&arguments.allocations)?);
    let GenesisArguments { chain_id, period, .. } = *arguments;
    let genesis = Genesis { kind, chain_id, signers, period, allocations };
    let file = genesis.file()?;
    let text = serde_json::to_string_pretty(&file).unwrap_or_default();
    let Some(directory) = &arguments.out else {
        output.result(&serde_json::json!({ "consensus": kind.to_string(), "genesis": file }), || text);
        return Ok(0);
    };
    DirBuilder::new().recursive(true).create(directory).map_err(|error| not_written(directory, &error))?;
    for (name, text) in [("genesis.json", text.as_str()), ("README.md", GUIDE)] {
        write_new(&directory.join(name), text)?;
    }
    let id = &file["config"]["chainId"];
    let written = serde_json::json!({
        "consensus": kind.to_string(), "chain_id": id, "directory": directory.display().to_string(),
        "files": ["genesis.json", "README.md"],
    });
    output.result(&written, || {
        format!("genesis.json ({kind}, chain id {id}) and README.md written to {}", directory.display())
    });
    Ok(0)
}

/// Never overwrites: the genesis file of a network must not be lost by accident.
fn write_new(path: &Path, text: &str) -> Result<(), Failure> {
    let mut file = match OpenOptions::new().write(true).create_new(true).open(path) {
        Ok(file) => file,
        Err(error) if error.kind() == IoKind::AlreadyExists => {
            return Err(input(format!("{} already exists; choose another directory with --out", path.display())));
        }
        Err(error) => return Err(not_written(path, &error)),
    };
    writeln!(file, "{}", text.trim_end()).map_err(|error| not_written(path, &error))
}

//! `authros chain`: its plain verbs, `chain admin`, `chain serve` and `chain genesis`.

#![deny(clippy::wildcard_enum_match_arm)]

use std::fs::{DirBuilder, OpenOptions};
use std::io::{ErrorKind as IoKind, Write as _};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};

use super::args::Global;
use super::connect::{Context, ProfileNeed};
use super::plan::{self, CHAIN, Plan};
use super::show::{not_written, or_dash};
use super::{parse, parties};
use crate::chain::{Genesis, GenesisKind, network_guide};
use crate::model::{Address, ErrorKind};
use crate::pipeline::sender::LaneState;
use crate::service::command::{self, Administration};
use crate::service::reply::{self, ServedView, input};
use crate::service::{Client, Failure, Needs};
use authros_output::{Output, pairs};

/// `chain …`
#[derive(Debug, Subcommand)]
pub enum ChainVerb {
    /// Show node, consensus, contract, block, balance and pending transactions
    Status,
    /// Deploy the contract with this profile's account, and pin it
    Deploy {
        /// Delay of a succession if the lost account named a recovery account; otherwise twice this [default: 7d]
        #[arg(long, value_name = "1d TO 365d")]
        delay: Option<String>,
    },
    /// Cancel a transaction that is in no block: an empty one at a higher price takes its nonce
    ///
    /// Records that it anchors wait to be anchored again. `chain status` lists the transactions that wait.
    Cancel {
        /// Its nonce
        nonce: u64,
        /// Account that signed it, if it is an extra anchoring account
        #[arg(long)]
        account: Option<String>,
        /// Confirm that it is cancelled
        #[arg(long)]
        yes: bool,
    },
    /// Successor of a lost account: the administrator proposes one, and it can be stopped during a delay
    #[command(subcommand)]
    Succession(SuccessionVerb),
    /// The administrator's acts: who may register, suspensions, pauses, the next administrator
    #[command(subcommand)]
    Admin(AdminVerb),
    /// Serve the embedded chain's JSON-RPC to other tools (cast, web3, curl) on this machine only
    Serve {
        /// Loopback address and port; port 0 = any free port
        #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:8545")]
        listen: SocketAddr,
    },
    /// Write a genesis file for a private geth or Besu network
    Genesis(GenesisArguments),
}

/// `chain admin …`
#[derive(Debug, Subcommand)]
pub enum AdminVerb {
    /// Let an account register while registration is closed
    Allow {
        /// Account, or its name
        account: String,
    },
    /// No longer let an account register
    Deny {
        /// Account, or its name
        account: String,
    },
    /// Suspend an account; it can then only withdraw rights
    Suspend {
        /// Account, or its name
        account: String,
    },
    /// Lift an account's suspension
    Restore {
        /// Account, or its name
        account: String,
    },
    /// Let anyone register
    Open,
    /// Let only allowed accounts register
    Close,
    /// Pause all changes except those that withdraw rights
    Pause {
        /// How long, at most 3d; the next pause is possible after a week [default: 1d]
        #[arg(long = "for", value_name = "TIME")]
        length: Option<String>,
    },
    /// End the pause early
    Resume,
    /// Nominate the next administrator, who takes over with `chain admin accept`
    HandOver {
        /// Account, or its name
        account: String,
    },
    /// Take over as administrator, if nominated
    Accept,
}

/// `chain succession …`
#[derive(Debug, Subcommand)]
pub enum SuccessionVerb {
    /// Administrator: propose the successor of a lost account; takes effect after the contract's delay
    Propose {
        /// Account whose key is lost or stolen, or its name
        lost: String,
        /// Succeeding account, or its name; must be registered
        successor: String,
    },
    /// Recovery account or administrator: cancel a pending succession
    Cancel {
        /// The lost account, or its name
        lost: String,
    },
    /// Complete a succession whose delay has passed; the lost account is suspended permanently
    Complete {
        /// The lost account, or its name
        lost: String,
    },
    /// List pending and completed successions, and this profile's recovery account
    List,
}

/// `chain genesis …`
#[derive(Debug, Args)]
pub struct GenesisArguments {
    /// Consensus: clique (geth before 1.14), ethash (geth before 1.12) or qbft (Besu)
    // This hides the global flag of the same name, and must have the same type.
    #[arg(long, value_name = "NAME", value_parser = ["clique", "ethash", "qbft"], required_unless_present = "guide")]
    pub consensus: Option<String>,
    /// Account that seals blocks, as 0x and 40 hex digits; repeatable
    #[arg(long = "signer", value_name = "ADDRESS")]
    pub signers: Vec<String>,
    /// Chain id [default: random]
    #[arg(long, value_name = "N")]
    pub chain_id: Option<u64>,
    /// Seconds between blocks [default: 2]
    #[arg(long, value_name = "N")]
    pub period: Option<u64>,
    /// Initial balance in wei; repeatable
    #[arg(long = "alloc", value_name = "ADDRESS=WEI")]
    pub allocations: Vec<String>,
    /// Directory to write genesis.json and README.md to [default: genesis.json to stdout]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print a guide to running three nodes instead
    #[arg(long, conflicts_with_all = ["consensus", "signers", "chain_id", "period", "allocations", "out"])]
    pub guide: bool,
}

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
            let text = "a cancelled transaction has no effect, and records it anchors are anchored again; add --yes to \
                        confirm";
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
        ChainVerb::Admin(verb) => Plan::unlocked(command::Administer(administration(verb)?)),
    };
    plan::run(Context::new(global, output)?, plan, output).await
}

fn administration(verb: AdminVerb) -> Result<Administration, Failure> {
    Ok(match verb {
        AdminVerb::Allow { account } => Administration::Admit { account: parse::value(&account)? },
        AdminVerb::Deny { account } => Administration::Dismiss { account: parse::value(&account)? },
        AdminVerb::Suspend { account } => Administration::Suspend { account: parse::value(&account)? },
        AdminVerb::Restore { account } => Administration::Restore { account: parse::value(&account)? },
        AdminVerb::Open => Administration::Open { open: true },
        AdminVerb::Close => Administration::Open { open: false },
        AdminVerb::Pause { length } => {
            Administration::Pause { paused: true, seconds: length.as_deref().map(seconds).transpose()? }
        }
        AdminVerb::Resume => Administration::Pause { paused: false, seconds: None },
        AdminVerb::HandOver { account } => Administration::HandOver { account: parse::value(&account)? },
        AdminVerb::Accept => Administration::Accept,
    })
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
        output.result(&serde_json::json!({ "guide": network_guide() }), || network_guide().to_owned());
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
    for (name, text) in [("genesis.json", text.as_str()), ("README.md", network_guide())] {
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

pub fn status(view: &reply::ChainView) -> String {
    let paused = |lane: &LaneState| lane.paused.as_ref().map(|reason| ("paused", reason.text(lane.account)));
    let mut rows = vec![
        ("kind", view.kind.clone()),
        ("client", view.client.clone()),
        ("consensus", view.consensus.clone()),
        ("chain id", view.chain_id.to_string()),
        ("genesis", view.genesis.to_string()),
        ("block", view.block.to_string()),
        ("contract", or_dash(view.contract)),
        ("balance", format!("{} wei", view.balance)),
        ("nonce", view.nonce.to_string()),
        ("pending", view.pending.to_string()),
        ("chain.min_price", format!("{} per gas", view.prices.min_price)),
        ("chain.max_fee", view.prices.max_fee.map_or_else(|| "no cap".to_owned(), |cap| format!("{cap} per gas"))),
        ("period", or_dash(view.sealing.period.map(|period| format!("at least {period} ms between blocks")))),
        ("difficulty", or_dash(view.sealing.difficulty.as_ref().map(|hashes| format!("{hashes} hashes per block")))),
        ("sealers", listed(&view.sealing.sealers)),
    ];
    rows.extend(view.through.clone().map(|text| ("seen", text)));
    rows.extend(parties::administration(&view.administration));
    let waits = |one: &reply::WaitingView| {
        let is_first = view.lanes.first().is_none_or(|lane| lane.account == one.account);
        let of = if is_first { String::new() } else { format!(" of {}", one.account) };
        ("waits", format!("nonce {}{of}: {}, at {} per gas", one.nonce, one.purpose, one.price))
    };
    rows.extend(view.waiting.iter().map(waits));
    rows.extend(view.lacks.map(|shortfall| ("lacks", shortfall.to_string())));
    rows.extend(view.lanes.iter().filter_map(paused));
    pairs(&rows)
}

fn listed(accounts: &[Address]) -> String {
    let listed: Vec<String> = accounts.iter().map(Address::to_string).collect();
    or_dash((!listed.is_empty()).then(|| listed.join(" ")))
}

pub fn deployed(view: &reply::DeployedView) -> String {
    pairs(&[
        ("contract", view.pin.contract.to_string()),
        ("administrator", view.administrator.to_string()),
        ("chain id", view.pin.chain_id.to_string()),
        ("genesis", view.pin.genesis.to_string()),
        ("block", view.pin.deployed_at.to_string()),
        ("code hash", view.pin.code_hash.to_string()),
    ])
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::super::args::{Arguments, Verb};
    use super::*;

    #[test]
    fn a_genesis_has_a_consensus_of_its_own() {
        let parse = |words: &[&str]| Arguments::try_parse_from([&["authros", "chain"], words].concat());
        let parsed = parse(&["genesis", "--consensus", "qbft", "--signer", "0x1", "--signer", "0x2"]).expect("parses");
        let Some(Verb::Chain(ChainVerb::Genesis(genesis))) = parsed.verb else { panic!("no genesis") };
        assert_eq!((genesis.consensus.as_deref(), genesis.signers.len()), (Some("qbft"), 2));
        assert!(parse(&["genesis", "--consensus", "pow"]).is_err());
        assert!(parse(&["genesis"]).is_err() && parse(&["genesis", "--guide"]).is_ok());
        let status = parse(&["status", "--consensus", "pow"]).expect("parses");
        assert_eq!(status.global.consensus.as_deref(), Some("pow"));
        assert!(parse(&["serve", "--listen", "8545"]).is_err() && parse(&["serve"]).is_ok());
    }
}

//! `chain …`: the words of the chain's verbs.

use std::{net::SocketAddr, path::PathBuf};

use clap::{Args, Subcommand};

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
    /// Administrator: let an account register while registration is closed
    Admit {
        /// Account, or its name
        account: String,
    },
    /// Administrator: withdraw an admission
    Dismiss {
        /// Account, or its name
        account: String,
    },
    /// Administrator: suspend an account; it can then only withdraw rights
    Suspend {
        /// Account, or its name
        account: String,
    },
    /// Administrator: lift an account's suspension
    Restore {
        /// Account, or its name
        account: String,
    },
    /// Administrator: let anyone register
    Open,
    /// Administrator: let only admitted accounts register
    Close,
    /// Administrator: pause all changes except those that withdraw rights
    Pause {
        /// How long, at most 3d; the next pause is possible after a week [default: 1d]
        #[arg(long = "for", value_name = "TIME")]
        length: Option<String>,
    },
    /// Administrator: end the pause early
    Resume,
    /// Administrator: nominate the next administrator, who takes over with `chain accept`
    HandOver {
        /// Account, or its name
        account: String,
    },
    /// Take over as administrator, if nominated
    Accept,
    /// Serve the embedded chain's JSON-RPC to other tools (cast, web3, curl) on this machine only
    Serve {
        /// Loopback address and port; port 0 = any free port
        #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:8545")]
        listen: SocketAddr,
    },
    /// Write a genesis file for a private geth or Besu network
    Genesis(GenesisArguments),
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

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::super::{Arguments, Verb};
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

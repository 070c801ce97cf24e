//! `chain …`: the words of the chain's verbs.

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::{Args, Subcommand};

/// `chain …`
#[derive(Debug, Subcommand)]
pub enum ChainVerb {
    /// Node, consensus, contract, block, balance, pending transactions
    Status,
    /// Go on with the chain that is there now, in place of the one this home is bound to
    Adopt,
    /// Put the contract on the chain with this profile's account, and pin it
    Deploy {
        /// How long a succession waits where the lost account named a recovery account, else twice as long [default: 7d]
        #[arg(long, value_name = "1d TO 365d")]
        delay: Option<String>,
        /// An earlier revision of the contract
        #[arg(long, value_name = "N", hide = true)]
        revision: Option<u8>,
    },
    /// Who is to continue for a lost account: proposed by the administrator, it waits and can be stopped
    #[command(subcommand)]
    Succession(SuccessionVerb),
    /// Administrator, on a contract of the first revision: name at once the account that continues for a lost one
    Succeed {
        /// Account whose key is lost, or its name
        lost: String,
        /// Account that continues, or its name; registered
        successor: String,
    },
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
    /// Administrator: stop an account's changes, but those that take rights away
    Suspend {
        /// Account, or its name
        account: String,
    },
    /// Administrator: free a suspended account
    Restore {
        /// Account, or its name
        account: String,
    },
    /// Administrator: let anyone register
    Open,
    /// Administrator: let only admitted accounts register
    Close,
    /// Administrator: stop all changes for a while, but those that take rights away
    Pause {
        /// How long, at most 3d; the next pause must wait a week [default: 1d]
        #[arg(long = "for", value_name = "TIME")]
        length: Option<String>,
    },
    /// Administrator: let changes go on before the pause's end
    Resume,
    /// Administrator: name the next one, who takes over with `chain accept`
    HandOver {
        /// Account, or its name
        account: String,
    },
    /// Take over as administrator, as the one that was named
    Accept,
    /// Answer other tools' JSON-RPC (cast, web3, curl) over the embedded chain, on this machine only
    Serve {
        /// Loopback address and port; port 0 = any free one
        #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:8545")]
        listen: SocketAddr,
    },
    /// Genesis file for a private network of geth or Besu
    Genesis(GenesisArguments),
}

/// `chain succession …`
#[derive(Debug, Subcommand)]
pub enum SuccessionVerb {
    /// Administrator: propose the account that is to continue for a lost one; it waits for the contract's delay
    Propose {
        /// Account whose key is lost or stolen, or its name
        lost: String,
        /// Account that is to continue, or its name; registered
        successor: String,
    },
    /// Recovery account or administrator: stop a succession that waits
    Cancel {
        /// Account whose succession it is, or its name
        lost: String,
    },
    /// Complete a succession whose time has come; the lost account is suspended for good
    Complete {
        /// Account whose succession it is, or its name
        lost: String,
    },
    /// Successions that wait and that came about, and this profile's recovery account
    List,
}

/// `chain genesis …`
#[derive(Debug, Args)]
pub struct GenesisArguments {
    /// How the network agrees: clique (geth before 1.14), ethash (geth before 1.12) or qbft (Besu)
    // This hides the global flag of the same name, and must have the same type.
    #[arg(long, value_name = "NAME", value_parser = ["clique", "ethash", "qbft"], required_unless_present = "guide")]
    pub consensus: Option<String>,
    /// Account that seals blocks, as 0x and 40 hex; may be repeated
    #[arg(long = "signer", value_name = "ADDRESS")]
    pub signers: Vec<String>,
    /// Chain id [default: drawn]
    #[arg(long, value_name = "N")]
    pub chain_id: Option<u64>,
    /// Seconds between blocks [default: 2]
    #[arg(long, value_name = "N")]
    pub period: Option<u64>,
    /// Ether from the beginning, in wei; may be repeated
    #[arg(long = "alloc", value_name = "ADDRESS=WEI")]
    pub allocations: Vec<String>,
    /// Directory to write genesis.json and README.md to [default: genesis.json to stdout]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// How to run three nodes: print the guide instead
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

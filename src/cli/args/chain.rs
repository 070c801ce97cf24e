//! `chain …`: the words of the chain's verbs.

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};

/// `chain …`
#[derive(Debug, Subcommand)]
pub enum ChainVerb {
    /// Node, consensus, contract, block, balance, pending transactions
    Status,
    /// Put the contract on the chain with this profile's account, and pin it
    Deploy,
    /// Answer other tools' JSON-RPC (cast, web3, curl) over the embedded chain, on this machine only
    Serve {
        /// Loopback address and port; port 0 = any free one
        #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:8545")]
        listen: SocketAddr,
    },
    /// Genesis file for a private network of geth or Besu
    Genesis(GenesisArguments),
}

/// How a private network agrees.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum GenesisChoice {
    /// Proof of authority, geth before 1.14
    Clique,
    /// Proof of work, geth before 1.12
    Ethash,
    /// Proof of authority, Besu
    Qbft,
}

/// `chain genesis …`
#[derive(Debug, Args)]
pub struct GenesisArguments {
    /// How the network agrees
    #[arg(long, value_enum, required_unless_present = "guide")]
    pub consensus: Option<GenesisChoice>,
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

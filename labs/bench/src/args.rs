//! The command line of `authros-bench`.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Parser, Subcommand, ValueEnum};

use super::network::Place;
use authros_chain::Consensus;
use authros_crypto::ProviderName;

/// Repeats the measurements of the AuthROS paper on this machine, and our own.
#[derive(Debug, Parser)]
#[command(name = "authros-bench", version)]
pub struct Arguments {
    /// Folder for the results: NAME.csv, NAME.json and NAME.svg of each bench
    #[arg(long, global = true, value_name = "DIR", default_value = "authros-bench")]
    pub out: PathBuf,
    /// Provider of the SM algorithms: authros, rustcrypto or libsm
    #[arg(long, global = true, value_name = "NAME", default_value_t)]
    pub provider: ProviderName,
    /// Exit with 1 if a target was missed, and with 8 if messages were lost or uploads failed
    #[arg(long, global = true)]
    pub judge: bool,
    /// What to measure
    #[command(subcommand)]
    pub bench: Bench,
}

/// What can be measured.
#[derive(Debug, Subcommand)]
pub enum Bench {
    /// SM2: signatures and envelopes by ours, the crate, libsm and the openssl command
    Sm2(RunsArguments),
    /// SM3: digests of 1 KB to 800 KB by ours, libsm and the openssl command (the paper's figure 17)
    Sm3(RunsArguments),
    /// SM4-GCM: sealing and opening by ours, the crates, libsm and the openssl command (figure 16)
    Sm4(RunsArguments),
    /// One record sealed, then checked and opened, on one core: each step, and all of it by each provider
    Record(RunsArguments),
    /// Gas per record: one by one, in batches, and the prototype's way
    Gas,
    /// 300, 500 and 700 uploads at once on PoA and PoW (figure 11)
    Consensus(ConsensusArguments),
    /// Uploads of 1, 2, 4 and 8 KB on PoA and PoW: ours, and all bytes on the chain (figure 12)
    Size(SizeArguments),
    /// Records that a gateway accepts per second, beside SM2 and SM3 alone; memory of idle connections
    Gateway(GatewayArguments),
    /// Messages from publisher to verified at a held rate: losses, latency, memory, cost of each stage
    Pipeline(PipelineArguments),
    /// Pages of a list on many records beside the same on few
    Pages(PagesArguments),
    /// All of them: the paper's figures 11, 12, 16 and 17, and our own tables; some minutes
    All(AllArguments),
}

/// `sm2`, `sm3`, `sm4` and `record`
#[derive(Debug, Args)]
pub struct RunsArguments {
    /// How often each piece of work is timed
    #[arg(long, value_name = "N", default_value_t = 300, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub runs: u32,
}

/// An embedded network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum NetworkChoice {
    /// Proof of authority
    Poa,
    /// Proof of work
    Pow,
}

/// Where `consensus` and `size` measure.
#[derive(Debug, Clone, Args)]
pub struct NetworkArguments {
    /// Embedded networks; several, with commas
    #[arg(long, value_enum, value_name = "NAME", value_delimiter = ',', default_values = ["poa", "pow"])]
    pub networks: Vec<NetworkChoice>,
    /// Least time between two blocks of the embedded PoA chain, milliseconds
    #[arg(long, value_name = "MS", default_value_t = Self::PERIOD,
          value_parser = clap::value_parser!(u64).range(1..=60_000))]
    pub period: u64,
    /// Hashes that a block of the embedded PoW chain takes on average; the paper's unless given
    #[arg(long, value_name = "N", default_value_t = Consensus::PAPER_DIFFICULTY,
          value_parser = clap::value_parser!(u64).range(1..=Consensus::HIGHEST_DIFFICULTY))]
    pub difficulty: u64,
    /// This node and its lender, in place of the embedded networks.
    #[command(flatten)]
    pub node: NodeArguments,
}

/// A node to measure on.
#[derive(Debug, Clone, Args)]
pub struct NodeArguments {
    /// Only on this node, which must give ether to test accounts or ask no fees, unless --funder does
    #[arg(long, value_name = "URL")]
    pub node: Option<String>,
    /// Lends the test accounts ether on that node, and gets the rest back: a file with the key of an account (64 hex
    /// digits, readable by you alone)
    #[arg(long, value_name = "FILE", requires = "node")]
    pub funder: Option<PathBuf>,
}

impl NetworkArguments {
    /// The period unless given, milliseconds.
    pub const PERIOD: u64 = 25;

    /// The networks in the order in which they are measured.
    pub fn places(&self) -> Vec<Place> {
        if let Some(url) = &self.node.node {
            return vec![Place::Node(url.clone())];
        }
        let place = |choice: &NetworkChoice| match choice {
            NetworkChoice::Poa => Consensus::Poa { signers: 1, period: Duration::from_millis(self.period) },
            NetworkChoice::Pow => Consensus::Pow { difficulty: self.difficulty },
        };
        self.networks.iter().map(|choice| Place::Embedded(place(choice))).collect()
    }
}

/// `consensus`
#[derive(Debug, Args)]
pub struct ConsensusArguments {
    /// How many upload at once; several, with commas, one after the other
    #[arg(long, value_name = "N", value_delimiter = ',', default_values_t = [300, 500, 700],
          value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub uploaders: Vec<u32>,
    /// Where.
    #[command(flatten)]
    pub network: NetworkArguments,
}

/// `size`
#[derive(Debug, Args)]
pub struct SizeArguments {
    /// Uploads of each size, all at once
    #[arg(long, value_name = "N", default_value_t = 300, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub runs: u32,
    /// Where.
    #[command(flatten)]
    pub network: NetworkArguments,
}

/// `gateway`
#[derive(Debug, Args)]
pub struct GatewayArguments {
    /// Records of 1 KiB in each run; of 58 KB, an eighth of that
    #[arg(long, value_name = "N", default_value_t = 1024, value_parser = clap::value_parser!(u32).range(8..=100_000))]
    pub records: u32,
    /// Idle connections; as many as open files allow
    #[arg(long, value_name = "N", default_value_t = 5000, value_parser = clap::value_parser!(u32).range(0..=50_000))]
    pub idle: u32,
}

/// Which load the line gets.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum LoadChoice {
    /// Small messages at `--rate`
    Messages,
    /// 58 KB pictures, 30 a second from each publisher
    Pictures,
    /// One after the other
    Both,
}

/// `pipeline`
#[derive(Debug, Args)]
pub struct PipelineArguments {
    /// How long to publish, as 20s or 15m
    #[arg(long = "for", value_name = "TIME", default_value = "20s")]
    pub length: String,
    /// Which load
    #[arg(long, value_enum, default_value = "both")]
    pub load: LoadChoice,
    /// Small messages a second, of all publishers together
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub rate: u32,
    /// Bytes of a small message
    #[arg(long, value_name = "N", default_value_t = 1024, value_parser = clap::value_parser!(u32).range(64..=67_108_864))]
    pub bytes: u32,
    /// Records that are in the store before the load begins
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u64).range(0..=10_000_000))]
    pub before: u64,
    /// Publishers, each a ROS node with a topic of its own
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u16).range(1..=64))]
    pub publishers: u16,
}

/// `pages`
#[derive(Debug, Args)]
pub struct PagesArguments {
    /// Records of the smaller ledger
    #[arg(long, value_name = "N", default_value_t = 100_000, value_parser = clap::value_parser!(u64).range(25_000..=10_000_000))]
    pub few: u64,
    /// Records of the larger one; 250 bytes on disk each
    #[arg(long, value_name = "N", default_value_t = 10_000_000, value_parser = clap::value_parser!(u64).range(25_000..=100_000_000))]
    pub many: u64,
    /// How often each page is timed
    #[arg(long, value_name = "N", default_value_t = 51, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub rounds: u32,
}

/// `all`
#[derive(Debug, Args)]
pub struct AllArguments {
    /// Small counts: shows that everything works; its figures say little
    #[arg(long)]
    pub quick: bool,
    /// The node for consensus and size; gas and pipeline, which need the embedded chain, are left out.
    #[command(flatten)]
    pub node: NodeArguments,
}

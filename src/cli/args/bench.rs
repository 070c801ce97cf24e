//! Arguments of `authros bench`.

use clap::{Args, Subcommand};

/// `bench …`
#[derive(Debug, Args)]
pub struct BenchArguments {
    /// Print one line per result, comma-separated, on stdout
    #[arg(long, global = true)]
    pub csv: bool,
    /// What to measure
    #[command(subcommand)]
    pub verb: BenchVerb,
}

/// What can be measured.
#[derive(Debug, Subcommand)]
pub enum BenchVerb {
    /// Concurrent uploads on the embedded chain (PoA, PoW) and a node, beside the paper's
    Consensus(ConsensusArguments),
    /// Gas per record: one by one, in batches, and the prototype's way
    Gas,
    /// Records that a gateway accepts per second, beside SM2 and SM3 alone; memory of idle connections
    Gateway(GatewayArguments),
}

/// `bench consensus …`
#[derive(Debug, Args)]
pub struct ConsensusArguments {
    /// How many upload at once; several, with commas, one after the other
    #[arg(long, value_name = "N", value_delimiter = ',', default_values_t = [300, 500, 700],
          value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub uploaders: Vec<u32>,
    /// Also on this node, which must give ether to test accounts or ask no fees
    #[arg(long, value_name = "URL")]
    pub node: Option<String>,
}

/// `bench gateway …`
#[derive(Debug, Args)]
pub struct GatewayArguments {
    /// Records of 1 KiB in each run; of 58 KB, an eighth of that
    #[arg(long, value_name = "N", default_value_t = 1024, value_parser = clap::value_parser!(u32).range(8..=100_000))]
    pub records: u32,
    /// Idle connections; as many as open files allow
    #[arg(long, value_name = "N", default_value_t = 5000, value_parser = clap::value_parser!(u32).range(0..=50_000))]
    pub idle: u32,
}

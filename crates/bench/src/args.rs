//! Arguments of `authros bench`.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};

use authros_chain::Consensus;

/// `bench …`
#[derive(Debug, Args)]
pub struct BenchArguments {
    /// Print one line per result, comma-separated, on stdout
    #[arg(long, global = true)]
    pub csv: bool,
    /// Also draw plots: writes DIR/BENCH.svg
    #[arg(long, global = true, value_name = "DIR")]
    pub svg: Option<PathBuf>,
    /// End with an exit code that says whether what was promised was reached; else figures are figures, and it is 0
    #[arg(long, global = true)]
    pub judge: bool,
    /// What to measure
    #[command(subcommand)]
    pub verb: BenchVerb,
}

/// One bench, or all.
#[derive(Debug, Subcommand)]
pub enum BenchVerb {
    /// One of them.
    #[command(flatten)]
    One(Bench),
    /// All of them, one after the other, each short: some minutes together
    All(AllArguments),
}

/// What can be measured.
#[derive(Debug, Subcommand)]
pub enum Bench {
    /// Signing, verifying and envelopes by SM2: ours, for strangers and known signers, the crate, libsm and OpenSSL
    Sm2(AlgorithmArguments),
    /// Digests by SM3 of 1 KB to 800 KB: ours, libsm and libgcrypt, beside the paper's
    Sm3(AlgorithmArguments),
    /// Sealing and opening by SM4-GCM, and whole records: ours, the crates, libsm and libgcrypt
    Sm4(AlgorithmArguments),
    /// One record sealed, opened and verified on one core: what each step costs, messages and bytes a second
    Record(RecordArguments),
    /// Concurrent uploads on the embedded chain (PoA, PoW) and a node, beside the paper's
    Consensus(ConsensusArguments),
    /// Uploads of 1, 2, 4 and 8 KB: sealed, stored and anchored, and the prototype's way, all bytes on the chain
    Size(SizeArguments),
    /// Gas per record: one by one, in batches, and the prototype's way
    Gas,
    /// Messages from publisher to verified at a held rate: losses, latency, memory, what each stage costs
    Pipeline(PipelineArguments),
    /// Records that a gateway accepts per second, beside SM2 and SM3 alone; memory of idle connections
    Gateway(GatewayArguments),
    /// Memory of an idle robot at a gateway, of a watched topic, of a record in the ledger
    Memory(MemoryArguments),
    /// Raw pictures, clouds and small messages compressed, sealed and restored, per codec
    Pictures,
    /// What a record, a page of a list and a frame of the console cost while the ledger grows
    Growth(GrowthArguments),
    /// Bundles of evidence: bytes per record, proof bytes per batch, and verification beside SM2 and SM3 alone
    Evidence(EvidenceArguments),
    /// Messages to 8 ROS 1 subscribers, by our own publisher and by rosrust: losses, latency, processor; not part of all
    Ros(RosArguments),
}

/// The benches by their names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[allow(missing_docs, reason = "same names as the benchmarks")]
pub enum BenchName {
    Sm2,
    Sm3,
    Sm4,
    Record,
    Consensus,
    Size,
    Gas,
    Pipeline,
    Gateway,
    Memory,
    Pictures,
    Growth,
    Evidence,
}

/// `bench all …`
#[derive(Debug, Args)]
pub struct AllArguments {
    /// Only tell what would be measured
    #[arg(long)]
    pub plan: bool,
    /// Leave these out; several, with commas
    #[arg(long, value_enum, value_name = "BENCH", value_delimiter = ',')]
    pub skip: Vec<BenchName>,
    /// How often sm2, sm3 and sm4 time each piece of work, and uploads of each size
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub runs: u32,
    /// Consensus and size also on this node
    #[arg(long, value_name = "URL")]
    pub node: Option<String>,
}

/// An embedded network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum NetworkChoice {
    /// Proof of authority
    Poa,
    /// Proof of work at the paper's difficulty
    Pow,
}

impl From<NetworkChoice> for Consensus {
    fn from(choice: NetworkChoice) -> Self {
        match choice {
            NetworkChoice::Poa => Self::POA,
            NetworkChoice::Pow => Self::POW,
        }
    }
}

/// `bench size …`
#[derive(Debug, Args)]
pub struct SizeArguments {
    /// Uploads of each size, all at once
    #[arg(long, value_name = "N", default_value_t = 300, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub runs: u32,
    /// Embedded networks to measure on; several, with commas
    #[arg(long, value_enum, value_name = "NAME", value_delimiter = ',', default_values = ["poa", "pow"])]
    pub networks: Vec<NetworkChoice>,
    /// Also on this node, which must give ether to test accounts or ask no fees, unless --funder does
    #[arg(long, value_name = "URL")]
    pub node: Option<String>,
    /// Who lends the test accounts ether on that node, and gets the rest back: a profile of this home, or a file with the
    /// key of an account (hex, readable by you alone)
    #[arg(long, value_name = "PROFILE|FILE", requires = "node")]
    pub funder: Option<PathBuf>,
}

/// `bench growth …`
#[derive(Debug, Args)]
pub struct GrowthArguments {
    /// The most records; figures are taken at each power of ten from 1,000 on, and at the end
    #[arg(long, value_name = "N", default_value_t = 100_000,
          value_parser = clap::value_parser!(u64).range(1_000..=10_000_000))]
    pub records: u64,
}

/// `bench sm2 …`, `bench sm3 …`, `bench sm4 …`
#[derive(Debug, Args)]
pub struct AlgorithmArguments {
    /// How often each piece of work is timed
    #[arg(long, value_name = "N", default_value_t = 300, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub runs: u32,
}

/// `bench record …`
#[derive(Debug, Args)]
pub struct RecordArguments {
    /// How often each piece of work is timed
    #[arg(long, value_name = "N", default_value_t = 300, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub runs: u32,
}

/// `bench consensus …`
#[derive(Debug, Args)]
pub struct ConsensusArguments {
    /// How many upload at once; several, with commas, one after the other
    #[arg(long, value_name = "N", value_delimiter = ',', default_values_t = [300, 500, 700],
          value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub uploaders: Vec<u32>,
    /// Also on this node, which must give ether to test accounts or ask no fees, unless --funder does
    #[arg(long, value_name = "URL")]
    pub node: Option<String>,
    /// Who lends the test accounts ether on that node, and gets the rest back: a profile of this home, or a file with the
    /// key of an account (hex, readable by you alone)
    #[arg(long, value_name = "PROFILE|FILE", requires = "node")]
    pub funder: Option<PathBuf>,
    /// Least time between two blocks of the PoA chain, milliseconds
    #[arg(long, value_name = "MS", default_value_t = Self::PERIOD,
          value_parser = clap::value_parser!(u64).range(1..=60_000))]
    pub period: u64,
    /// Hashes that a block of the PoW chain takes on average; the paper's unless given
    #[arg(long, value_name = "N", default_value_t = Consensus::PAPER_DIFFICULTY,
          value_parser = clap::value_parser!(u64).range(1..=Consensus::HIGHEST_DIFFICULTY))]
    pub difficulty: u64,
}

impl ConsensusArguments {
    /// The period where none is given, milliseconds.
    pub const PERIOD: u64 = 25;
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

/// `bench pipeline …`
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
    /// Records that are in ledger and vault before the load begins
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u64).range(0..=10_000_000))]
    pub before: u64,
    /// Double the rate of small messages until it is not held any more, each for the same time
    #[arg(long)]
    pub doubling: bool,
    /// Publishers, each a ROS node with a topic of its own
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u16).range(1..=64))]
    pub publishers: u16,
}

/// Which publishers are measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PublisherChoice {
    /// Our own, in this process
    Own,
    /// rosrust, in the program authros-rosrust
    Rosrust,
    /// Both, in turn
    Both,
}

/// `bench ros …`
#[derive(Debug, Args)]
pub struct RosArguments {
    /// Which publishers
    #[arg(long, value_enum, default_value = "both")]
    pub publisher: PublisherChoice,
    /// How long each load is published in each round, as 5s or 1m
    #[arg(long = "for", value_name = "TIME", default_value = "5s")]
    pub length: String,
    /// Rounds; in each, every publisher has every load once
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub rounds: u32,
    /// Subscribers of the topic
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u16).range(1..=64))]
    pub subscribers: u16,
    /// Path of authros-rosrust [default: beside this program]
    #[arg(long, value_name = "FILE", env = "AUTHROS_ROSRUST_PROGRAM")]
    pub program: Option<PathBuf>,
}

/// `bench memory …`
#[derive(Debug, Args)]
pub struct MemoryArguments {
    /// Idle robots at a gateway; as many as open files allow
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u32).range(1..=50_000))]
    pub idle_robots: u32,
    /// Watched topics that nobody publishes
    #[arg(long, value_name = "N", default_value_t = 500, value_parser = clap::value_parser!(u16).range(2..=10_000))]
    pub topics: u16,
    /// Records in the ledger
    #[arg(long, value_name = "N", default_value_t = 1_000_000,
          value_parser = clap::value_parser!(u64).range(10_000..=10_000_000))]
    pub records: u64,
}

/// `bench evidence …`
#[derive(Debug, Args)]
pub struct EvidenceArguments {
    /// Records of the largest bundle, which is verified
    #[arg(long, value_name = "N", default_value_t = 10_000, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub records: u32,
    /// Batches of the bundle whose proof bytes are counted: as many as an hour has seconds
    #[arg(long, value_name = "N", default_value_t = 3600, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub batches: u32,
    /// Signers of one batch, each a registered account
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub signers: u32,
    /// How often reading, checking and the reference are timed
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub runs: u32,
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

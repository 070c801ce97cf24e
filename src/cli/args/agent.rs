//! `agent …`

use std::path::PathBuf;

use clap::{Args, Subcommand};

/// `agent …`
#[derive(Debug, Subcommand)]
pub enum AgentVerb {
    /// Enrol a robot as a device of this profile at a gateway; writes the robot's enrolment file
    Enrol(EnrolArguments),
    /// Capture on a robot and forward everything to its gateway, without a chain
    Run(RunArguments),
}

/// `agent enrol …`
#[derive(Debug, Args)]
#[command(group(clap::ArgGroup::new("trust").required(true)))]
pub struct EnrolArguments {
    /// The gateway; repeat it for further addresses of the same gateway: the robot uses the first that answers
    #[arg(long = "gateway", value_name = "HOST:PORT", required = true)]
    pub addresses: Vec<String>,
    /// The gateway's fingerprint (64 hex), as its operator shows it
    #[arg(long, value_name = "FINGERPRINT", group = "trust")]
    pub gateway_key: Option<String>,
    /// Pin whatever gateway answers; compare the fingerprint afterwards
    #[arg(long, group = "trust")]
    pub trust_first: bool,
    /// Name of the robot at the gateway
    #[arg(long, value_name = "NAME")]
    pub name: String,
    /// Topic the robot may record; repeatable
    #[arg(long = "topic", value_name = "TOPIC", conflicts_with = "all_topics")]
    pub topics: Vec<String>,
    /// Let it record every topic: it then holds the epoch's key and the index key, which a thief would get too
    #[arg(long)]
    pub all_topics: bool,
    /// End of the loan: 30d, 12h, or a time such as 2027-01-31T12:00:00Z
    #[arg(long, value_name = "TIME")]
    pub until: Option<String>,
    /// Enrolment file to write; must not exist
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// File with the passphrase for the enrolment file [default: a random passphrase, written to FILE.passphrase]
    #[arg(long, value_name = "FILE")]
    pub robot_passphrase_file: Option<PathBuf>,
}

/// `agent run …`
#[derive(Debug, Args)]
pub struct RunArguments {
    /// The enrolment file
    #[arg(value_name = "ENROLMENT")]
    pub enrolment: PathBuf,
    /// Topic to capture; repeatable [default: those the enrolment is limited to]
    #[arg(long = "topic", value_name = "TOPIC")]
    pub topics: Vec<String>,
    /// Tag for every record, such as mission=harbour; repeatable
    #[arg(long = "tag", value_name = "KEY=VALUE")]
    pub tags: Vec<String>,
    /// Stop after this many messages per topic
    #[arg(long, value_name = "N")]
    pub count: Option<u64>,
    /// Stop after capturing for this long
    #[arg(long, value_name = "S", conflicts_with = "count")]
    pub seconds: Option<u64>,
}

//! Arguments about topics, captures and records.

use std::path::PathBuf;

use clap::{Args, Subcommand};

/// `topics …`
#[derive(Debug, Subcommand)]
pub enum TopicsVerb {
    /// Every topic of the ROS graph
    List,
    /// Capture a topic as long as a site runs
    Watch {
        /// Topic, as /robot1/odom
        topic: String,
        /// Refuse messages of other types
        #[arg(long = "type", value_name = "TYPE")]
        type_name: Option<String>,
    },
    /// Stop capturing a topic
    Unwatch {
        /// Topic
        topic: String,
    },
    /// Accept publishers of a topic; messages of others are quarantined
    Pin(crate::cli::quarantine::PinArguments),
    /// Accepted publishers, and alarms about others
    Pins {
        /// Only this topic
        #[arg(long, value_name = "TOPIC")]
        topic: Option<String>,
    },
    /// When there are own records of a topic, where messages were lost, and what was quarantined
    Coverage(crate::cli::coverage::CoverageArguments),
    /// The rule of each topic; --learn drafts rules from the live graph
    Policy(crate::cli::policy::PolicyArguments),
    /// No longer accept a publisher of a topic
    Unpin {
        /// Topic
        topic: String,
        /// Node name, as /driver
        caller_id: String,
    },
}

/// `capture …`
#[derive(Debug, Args)]
pub struct CaptureArguments {
    /// Topic to capture; may be repeated
    #[arg(long = "topic", value_name = "TOPIC", required = true)]
    pub topics: Vec<String>,
    /// Refuse messages of other types
    #[arg(long = "type", value_name = "TYPE")]
    pub type_name: Option<String>,
    /// End after so many messages of each topic
    #[arg(long, value_name = "N", conflicts_with = "duration")]
    pub count: Option<u64>,
    /// End after this time, as 10s, 5m, 1h
    #[arg(long = "for", value_name = "TIME", id = "duration")]
    pub duration: Option<String>,
    /// Tag for the sealed head, as mission=harbour; may be repeated
    #[arg(long = "tag", value_name = "KEY=VALUE")]
    pub tags: Vec<String>,
}

/// Filters of record lists.
#[derive(Debug, Args)]
pub struct ListArguments {
    /// Only this topic
    #[arg(long, value_name = "TOPIC")]
    pub topic: Option<String>,
    /// Only this message type, as nav_msgs/Odometry
    #[arg(long = "type", value_name = "TYPE")]
    pub type_name: Option<String>,
    /// Only with this tag, as mission=harbour; may be repeated
    #[arg(long = "tag", value_name = "KEY=VALUE")]
    pub tags: Vec<String>,
    /// Only this state (uploads)
    #[arg(long, value_name = "STATE")]
    pub state: Option<String>,
    /// Kind of record: data, definition, …
    #[arg(long, value_name = "KIND")]
    pub kind: Option<String>,
    /// Only of this owner (shared), or of that name
    #[arg(long, value_name = "ADDRESS_OR_NAME")]
    pub owner: Option<String>,
    /// Captured at or after: a time as 2026-11-21T08:30:00Z, a day, or so long ago, as 10m
    #[arg(long, value_name = "TIME")]
    pub since: Option<String>,
    /// Captured before, written in the same way
    #[arg(long, value_name = "TIME")]
    pub until: Option<String>,
    /// Only in this incident of the profile (uploads)
    #[arg(long, value_name = "NAME")]
    pub incident: Option<String>,
    /// Continue behind `next` of the page before
    #[arg(long, value_name = "CURSOR")]
    pub after: Option<String>,
    /// Records a page, 1 to 1000
    #[arg(long, value_name = "N", default_value_t = 100)]
    pub limit: usize,
    /// Newest first
    #[arg(long)]
    pub newest: bool,
    /// Go on: one line for each record whenever its state changes
    #[arg(long, conflicts_with_all = ["after", "newest"])]
    pub follow: bool,
}

/// `uploads …`
#[derive(Debug, Subcommand)]
#[allow(clippy::large_enum_variant, reason = "there is one in a process")]
pub enum UploadsVerb {
    /// List own records
    List(ListArguments),
    /// One record with its provenance
    Show {
        /// Record id, or the beginning of one
        id: String,
    },
    /// Files for others to check with openssl
    Export {
        /// Record id, or the beginning of one
        id: String,
        /// Directory to write record.bin, signature.bin, signer.pem, proof.json to
        #[arg(long, value_name = "DIR")]
        dir: PathBuf,
        /// Addresses in full in proof.json; the record itself holds its owner's in any case
        #[arg(long)]
        addresses: bool,
    },
}

/// `shared …`
#[derive(Debug, Subcommand)]
pub enum SharedVerb {
    /// Records shared with this profile
    List(ListArguments),
    /// Digest against the chain, signature (the paper's `Data_Check`)
    Check {
        /// Record id, or the beginning of one
        id: String,
    },
    /// Write what this profile may read as a bag or MCAP, each record checked and verified first
    Export(crate::cli::recordings::ExportArguments),
    /// Publish in a ROS graph what others share with this profile, each record checked and verified first
    Play(crate::cli::playing::PlayArguments),
    /// Check, decrypt, decode
    Open {
        /// Record id, or the beginning of one
        id: String,
        /// Also write it to a file: .json, .bin, pictures also .png, .jpg, .npy; of another name = a picture's own
        /// bytes where it is one, else the message's
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
    /// Where the robot was, over the records of a topic that lead to one
    Path {
        /// Record id, or the beginning of one
        id: String,
        /// Records at most
        #[arg(long, value_name = "N", default_value_t = 200)]
        records: usize,
    },
}

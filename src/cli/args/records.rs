//! Arguments about topics, captures and records.

use std::path::PathBuf;

use clap::{Args, Subcommand};

/// `topics …`
#[derive(Debug, Subcommand)]
pub enum TopicsVerb {
    /// List every topic of the ROS graph
    List,
    /// Capture a topic whenever a site runs
    Watch {
        /// Topic, such as /robot1/odom
        topic: String,
        /// Reject messages of other types
        #[arg(long = "type", value_name = "TYPE")]
        type_name: Option<String>,
    },
    /// Stop capturing a topic
    Unwatch {
        /// Topic
        topic: String,
    },
    /// Pin publishers of a topic; messages from others are quarantined
    Pin(crate::cli::quarantine::PinArguments),
    /// List pinned publishers, and alarms about others
    Pins {
        /// Only this topic
        #[arg(long, value_name = "TOPIC")]
        topic: Option<String>,
    },
    /// Show over time where a topic has records, losses or quarantined messages
    Coverage(crate::cli::coverage::CoverageArguments),
    /// Show the rule for each topic; --learn drafts rules from the live graph
    Policy(crate::cli::robots::PolicyArguments),
    /// Unpin a publisher of a topic
    Unpin {
        /// Topic
        topic: String,
        /// Node name, such as /driver
        caller_id: String,
    },
}

/// `capture …`
#[derive(Debug, Args)]
pub struct CaptureArguments {
    /// Topic to capture; repeatable
    #[arg(long = "topic", value_name = "TOPIC", required = true)]
    pub topics: Vec<String>,
    /// Reject messages of other types
    #[arg(long = "type", value_name = "TYPE")]
    pub type_name: Option<String>,
    /// Stop after this many messages per topic
    #[arg(long, value_name = "N", conflicts_with = "duration")]
    pub count: Option<u64>,
    /// Stop after this time: 10s, 5m, 1h
    #[arg(long = "for", value_name = "TIME", id = "duration")]
    pub duration: Option<String>,
    /// Tag, sealed with each record, such as mission=harbour; repeatable
    #[arg(long = "tag", value_name = "KEY=VALUE")]
    pub tags: Vec<String>,
}

/// Filters of record lists.
#[derive(Debug, Args)]
pub struct ListArguments {
    /// Only this topic
    #[arg(long, value_name = "TOPIC")]
    pub topic: Option<String>,
    /// Only this message type, such as nav_msgs/Odometry
    #[arg(long = "type", value_name = "TYPE")]
    pub type_name: Option<String>,
    /// Only with this tag, such as mission=harbour; repeatable
    #[arg(long = "tag", value_name = "KEY=VALUE")]
    pub tags: Vec<String>,
    /// Only this state (uploads)
    #[arg(long, value_name = "STATE")]
    pub state: Option<String>,
    /// Kind of record: data, definition, …
    #[arg(long, value_name = "KIND")]
    pub kind: Option<String>,
    /// Only this owner's, by account or name (shared)
    #[arg(long, value_name = "ADDRESS_OR_NAME")]
    pub owner: Option<String>,
    /// Captured at or after: a time such as 2026-11-21T08:30:00Z, a date, or a duration ago such as 10m
    #[arg(long, value_name = "TIME")]
    pub since: Option<String>,
    /// Captured before; same format
    #[arg(long, value_name = "TIME")]
    pub until: Option<String>,
    /// Only records of this incident (uploads)
    #[arg(long, value_name = "NAME")]
    pub incident: Option<String>,
    /// Continue after `next` from the previous page
    #[arg(long, value_name = "CURSOR")]
    pub after: Option<String>,
    /// Records per page, 1 to 1000
    #[arg(long, value_name = "N", default_value_t = 100)]
    pub limit: usize,
    /// Newest first
    #[arg(long)]
    pub newest: bool,
    /// Keep running: print one line whenever a record changes state
    #[arg(long, conflicts_with_all = ["after", "newest"])]
    pub follow: bool,
}

/// `uploads …`
#[derive(Debug, Subcommand)]
#[allow(clippy::large_enum_variant, reason = "there is one in a process")]
pub enum UploadsVerb {
    /// List your own records: of --profile, without it of all profiles of this home
    List(ListArguments),
    /// Show one record with its provenance
    Show {
        /// Record id, or its first characters
        id: String,
    },
    /// Seal every message of another home in this one, with its capture time; brings its keyring if this home has none
    Import {
        /// The other home's folder; stop its site first
        #[arg(value_name = "HOME")]
        other: PathBuf,
    },
    /// Export a record as files that others can check with openssl
    Export {
        /// Record id, or its first characters
        id: String,
        /// Directory for record.bin, signature.bin, signer.pem and proof.json
        #[arg(long, value_name = "DIR")]
        dir: PathBuf,
        /// Write full addresses to proof.json; the record itself always contains its owner's
        #[arg(long)]
        addresses: bool,
    },
}

/// `shared …`
#[derive(Debug, Subcommand)]
pub enum SharedVerb {
    /// List records shared with this profile
    List(ListArguments),
    /// Check a record's digest, its signature and the right to read it (the paper's `Data_Check` and `dataQuery`)
    Check {
        /// Record id, or its first characters
        id: String,
    },
    /// Export all readable records as a bag or MCAP file, each one verified first
    Export(crate::cli::recordings::ExportArguments),
    /// Publish shared records in a ROS graph, each one verified first
    Play(crate::cli::playing::PlayArguments),
    /// Check, decrypt and decode a record
    Open {
        /// Record id, or its first characters
        id: String,
        /// Also write it to a file: .json or .bin, for pictures also .png, .jpg, .npy; any other name = the picture's
        /// own bytes, or the message's if it is not a picture
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
    /// Show the robot's path over the records up to this one
    Path {
        /// Record id, or its first characters
        id: String,
        /// Maximum number of records
        #[arg(long, value_name = "N", default_value_t = 200)]
        records: usize,
    },
}

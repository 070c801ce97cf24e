//! Types without I/O: the vocabulary shared by all other crates.
//!
//! Identities, topics, record headers, digests, grants, states, kinds of error and the sanitiser for untrusted text.
//! Nothing here touches a key, a file or a socket.

pub mod address;
pub mod anchor_mode;
pub mod audit_head;
pub mod base64_text;
pub mod byte_size;
pub mod bytes;
pub mod consensus;
pub mod disk_ring;
mod display;
pub mod error_kind;
pub mod gap;
pub mod grant;
pub mod head;
pub mod header;
pub mod identity;
mod incident;
pub mod instant;
mod operator;
pub mod party;
pub mod profile;
pub mod publisher;
pub mod quarantine;
mod recorder_id;
pub mod recorder_words;
pub mod retention;
mod robot_policy;
pub mod span;
pub mod state;
pub mod steady_clock;
pub mod topic;
pub mod topic_rule;
mod wei;
pub mod wire;

pub use address::{Address, redact_addresses};
pub use anchor_mode::AnchorMode;
pub use audit_head::AuditHead;
pub use byte_size::ByteSize;
pub use bytes::{
    Commit, Digest, Domain, FilterId, Hash, PublicKey, RecorderId, Salt, Signature, SignerId, Token, TopicId,
};
pub use consensus::Consensus;
pub use disk_ring::{RingLimits, RingSpan, TopicPatterns};
pub use display::{address_without_secrets, clean, clean_lines, is_shown, spelt_out, without_secrets};
pub use error_kind::ErrorKind;
pub use gap::{GapReport, LossReason};
pub use grant::{GrantTerms, Scope};
pub use head::Head;
pub use header::{Header, RecordKind};
pub use identity::Identity;
pub use incident::{IncidentName, IncidentNameError};
pub use instant::Timestamp;
pub use operator::{OperatorName, OperatorNameError, OperatorRight, OperatorRights};
pub use party::{ContactName, Party};
pub use profile::ProfileName;
pub use publisher::{Doubt, ListedPublishers, PinMode, Publisher, pinned_name};
pub use quarantine::QuarantineReport;
pub use recorder_id::RecorderPrefix;
pub use recorder_words::{Birth, Heads, Heights};
pub use retention::{Keeping, RetentionReport, RetentionRule, RetentionRules};
pub use robot_policy::PolicyReport;
pub use span::{SpanError, positive_span, time_span};
pub use state::{RecordState, Verdict};
pub use topic::{TopicName, TypeName, is_record_topic};
pub use topic_rule::{TopicPattern, TopicRule, TopicRules};
pub use wei::Wei;

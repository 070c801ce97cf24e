//! Types without I/O, shared by all other crates.

pub mod base64_text;
pub mod bytes;
pub mod consensus;
mod display;
pub mod gap;
pub mod grant;
pub mod head;
pub mod header;
pub mod moment;
pub mod party;
pub mod publisher;
pub mod recorder_words;
pub mod relay;
pub mod retention;
mod robot_policy;
pub mod span;
pub mod state;
pub mod steady_clock;
mod text;
pub mod topic;
pub mod topic_rule;
pub mod watch_rules;
pub mod wire;

pub use crate::bytes::{
    Commit, Digest, Domain, FilterId, Hash, PublicKey, RecorderId, Salt, Signature, SignerId, Token, TopicId, hex,
    unhex,
};
pub use crate::consensus::{AnchorMode, AuditHead, Consensus};
pub use crate::display::{
    address_without_secrets, clean, clean_lines, columns, counted, grouped, is_shown, natural, spelt_out,
    without_secrets,
};
pub use crate::gap::{GapReport, LossReason, QuarantineReport};
pub use crate::grant::{GrantTerms, Scope};
pub use crate::head::Head;
pub use crate::header::{Header, RecordKind};
pub use crate::moment::{Clock, Direction, MomentError, Zone};
pub use crate::party::{
    Address, ContactName, Identity, OperatorName, OperatorNameError, OperatorRight, OperatorRights, Party, ProfileName,
    redact_addresses,
};
pub use crate::publisher::{Doubt, ListedPublishers, PinMode, Publisher, pinned_name};
pub use crate::recorder_words::{Birth, Heads, Heights, RecorderPrefix};
pub use crate::retention::{
    IncidentName, IncidentNameError, Keeping, RetentionReport, RetentionRule, RetentionRules, RingLimits, RingSpan,
    TopicPatterns,
};
pub use crate::robot_policy::PolicyReport;
pub use crate::span::{ByteSize, SpanError, Timestamp, Wei, coarse, positive_span, time_span};
pub use crate::state::{ErrorKind, Fact, RecordState, Verdict};
pub use crate::topic::{TopicName, TypeName, is_record_topic};
pub use crate::topic_rule::{Sampling, TopicPattern, TopicRule, TopicRules};
pub use crate::watch_rules::{WatchRule, WatchRules};

/// The guard, also after a panic of a holder: what it guards is whole between any two statements.
pub fn locked<T>(mutex: &std::sync::Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

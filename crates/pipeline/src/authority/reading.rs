//! Who may read: the owner, and those with a grant on the chain, judged by a named policy.
//!
//! The keys in a grant's envelope determine which epochs it opens, not the chain: one envelope may hold keys of earlier
//! epochs too. A policy therefore takes owner, reader and topic.

use crate::chain::BlockRef;
use crate::model::{Address, Scope, Timestamp, TopicId};
use crate::pipeline::directory::{Directory, Granted};

/// What is required for reading.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Policy {
    /// A reader's own site: a grant in force by the clock here, and the reader not suspended.
    OwnSite,
    /// A gateway serving others: a recent head, a grant with enough confirmations and in force by the later of the
    /// head's time and the clock here, no announced revoke, and the reader not suspended.
    Gateway {
        /// The newest block; `None` if there was none lately.
        head: Option<BlockRef>,
        /// Required confirmations of a grant, its own block included.
        confirmations: u64,
        /// Whether the owner has announced a revoke that is not on the chain yet.
        revoke_announced: bool,
    },
}

/// The right by which someone reads.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ReadingRight {
    /// The records are the reader's own.
    Own,
    /// By this grant.
    Granted(Box<Granted>),
}

impl ReadingRight {
    /// What the grant covers.
    pub fn scope(&self) -> &Scope {
        match self {
            Self::Own => &Scope::All,
            Self::Granted(grant) => &grant.terms.scope,
        }
    }

    /// Whether records of a topic are covered.
    pub fn covers(&self, topic: TopicId) -> bool {
        self.scope().covers(topic)
    }
}

/// Why someone may not read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "each variant's line names its fields")]
pub enum ReadRefused {
    /// No grant is in force.
    #[error("{reader} has no grant of {owner}")]
    NotGranted { owner: Address, reader: Address },
    /// A grant is in force but does not cover the topic.
    #[error("the grant of {owner} to {reader} does not cover this topic")]
    NotCovered { owner: Address, reader: Address },
    /// The reader is suspended.
    #[error("{reader} has been suspended since block {since}")]
    Suspended { reader: Address, since: u64 },
    /// There was no head lately, so nobody's right is known.
    #[error("no recent block from the chain")]
    Stale,
}

/// Whether `reader` may read `owner`'s records of a topic (of any topic, if `topic` is `None`).
///
/// # Errors
/// [`ReadRefused`] with the reason.
pub fn may_read(
    directory: &Directory,
    reader: Address,
    owner: Address,
    topic: Option<TopicId>,
    policy: Policy,
) -> Result<ReadingRight, ReadRefused> {
    if reader == owner {
        return Ok(ReadingRight::Own);
    }
    let now = match policy {
        Policy::OwnSite => directory.now(),
        Policy::Gateway { head, .. } => {
            let head = head.ok_or(ReadRefused::Stale)?;
            directory.now().max(Timestamp::from_seconds(head.timestamp))
        }
    };
    not_suspended(directory, reader)?;
    let grant = directory.grant_between(owner, reader).filter(|grant| stands(grant, now, policy));
    let grant = grant.ok_or(ReadRefused::NotGranted { owner, reader })?;
    if topic.is_some_and(|topic| !grant.terms.scope.covers(topic)) {
        return Err(ReadRefused::NotCovered { owner, reader });
    }
    Ok(ReadingRight::Granted(Box::new(grant)))
}

fn not_suspended(directory: &Directory, reader: Address) -> Result<(), ReadRefused> {
    let since = directory.with_account(reader, |account| {
        account.and_then(|account| account.suspended_at(None)).map(|interval| interval.from)
    });
    since.map_or(Ok(()), |since| Err(ReadRefused::Suspended { reader, since }))
}

fn stands(grant: &Granted, now: Timestamp, policy: Policy) -> bool {
    let demanded = match policy {
        Policy::OwnSite => true,
        Policy::Gateway { head, confirmations, revoke_announced } => {
            let deep = head.is_some_and(|head| grant.block.saturating_add(confirmations) <= head.number + 1);
            deep && !revoke_announced
        }
    };
    demanded && grant.is_active(now)
}

/// The grants by which others currently let `reader` read on its own site.
pub fn shared_with(directory: &Directory, reader: Address) -> Vec<Granted> {
    if not_suspended(directory, reader).is_err() {
        return Vec::new();
    }
    let now = directory.now();
    directory.grants_to(reader).into_iter().filter(|grant| grant.is_active(now)).collect()
}

/// The grant of `owner` to `grantee` currently in force, for the owner's own management.
pub fn standing_grant(directory: &Directory, owner: Address, grantee: Address) -> Option<Granted> {
    directory.grant_between(owner, grantee).filter(|grant| grant.is_active(directory.now()))
}

/// All grants by `owner` currently in force.
pub fn standing_grants(directory: &Directory, owner: Address) -> Vec<Granted> {
    let now = directory.now();
    directory.grants_of(owner).into_iter().filter(|grant| grant.is_active(now)).collect()
}

//! Asks one gateway for all that it lists of some owners, page by page and within bounds: a list may be as long as a
//! gateway likes, and take as long.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, Instant};

use async_trait::async_trait;
use tokio::task::block_in_place;

use super::remote::Remote;
use super::{Joined, PAGE, QUIET, TICK};
use crate::gateway::{Client, Code, GatewayError, Page, Query, Selection};
use crate::model::{Address, ErrorKind, Scope, Timestamp, TopicId, clean};
use crate::pipeline::mirror::lacking::{Gathering, Listing};
use crate::pipeline::reader::Reader;
use crate::pipeline::{Network, Owner};
use crate::service::failure::refused;
use crate::service::reply::Failure;

/// How long one gateway may take for its lists.
const LONGEST: Duration = Duration::from_secs(10 * 60);
/// The most pages of one owner: ten million records.
const MOST_PAGES: usize = 20_000;

/// An owner whose records are asked for.
#[derive(Clone)]
pub(super) struct Wanted {
    pub owner: Address,
    /// What the reader may read of it.
    pub scope: Scope,
    /// Only these topics; `None` = all.
    pub topics: Option<BTreeSet<TopicId>>,
}

impl Wanted {
    /// Whether a topic was asked for, and may be read.
    pub fn covers(&self, topic: TopicId) -> bool {
        self.scope.covers(topic) && self.topics.as_ref().is_none_or(|topics| topics.contains(&topic))
    }

    /// What is sent: one for each topic, or one for all.
    fn selections(&self) -> Vec<Selection> {
        let all = Selection::all(self.owner);
        match &self.topics {
            None => vec![all],
            Some(topics) => {
                let of = |topic: &TopicId| Selection { topic_id: Some(*topic), ..all.clone() };
                topics.iter().filter(|topic| self.scope.covers(**topic)).map(of).collect()
            }
        }
    }
}

/// Who asks, and for what.
#[derive(Clone)]
pub(super) struct Asking {
    pub owner: Arc<Owner>,
    pub network: Network,
    pub wanted: Vec<Wanted>,
}

/// What a gateway told.
#[derive(Default)]
pub(super) struct Listed {
    pub listing: Listing,
    /// Owners that it tells this reader nothing of, and why.
    pub untold: Vec<(Address, Failure)>,
}

/// A gateway that is asked for lists.
#[async_trait]
pub(super) trait Lister: Send {
    /// Its address, for people.
    fn address(&self) -> &str;

    /// A page of what it lists.
    async fn page(&mut self, query: &Query) -> Result<Page, GatewayError>;
}

/// A session with one.
struct Session<'a> {
    remote: &'a Remote,
    client: Client,
}

#[async_trait]
impl Lister for Session<'_> {
    fn address(&self) -> &str {
        self.remote.address()
    }

    async fn page(&mut self, query: &Query) -> Result<Page, GatewayError> {
        self.client.query(query).await
    }
}

/// From which epoch on the reader was granted a topic of an owner.
pub(super) type Granted<'a> = dyn Fn(Address, TopicId) -> Option<u64> + Sync + 'a;

/// Why a list was not read to its end.
enum Unread {
    Gateway(GatewayError),
    TooMuch,
}

impl From<GatewayError> for Unread {
    fn from(error: GatewayError) -> Self {
        Self::Gateway(error)
    }
}

impl Joined {
    /// Everything that a gateway lists of the owners asked for.
    ///
    /// # Errors
    /// Why it does not tell: it does not answer, refuses, or does not come to an end.
    pub(super) async fn listed(&self, remote: &Remote, asking: &Asking) -> Result<Listed, Failure> {
        let Asking { owner, network, wanted } = asking;
        let listing = async {
            let client = remote.connect(&self.home, owner, network).await?;
            let reader = Reader { plant: &self.plant, network, reader: owner };
            // What cannot be read here says nothing about holes.
            let granted = |owner, topic| block_in_place(|| reader.first_epoch(owner, topic)).unwrap_or_default();
            list(&mut Session { remote, client }, wanted, &granted).await
        };
        tokio::time::timeout(LONGEST, listing).await.unwrap_or_else(|_| {
            let (address, minutes) = (clean(remote.address(), 255), LONGEST.as_secs() / 60);
            let text = format!(
                "the gateway {address} did not list its records within {minutes} minutes; ask for less with --owner and \
                 --topic"
            );
            Err(Failure::new(ErrorKind::Unreachable, text))
        })
    }
}

/// All lists of a gateway.
///
/// # Errors
/// Why one of them was not read to its end.
pub(super) async fn list(
    gateway: &mut dyn Lister,
    wanted: &[Wanted],
    granted: &Granted<'_>,
) -> Result<Listed, Failure> {
    let mut listed = Listed::default();
    for one in wanted {
        match list_one(gateway, one, granted).await {
            Ok(gathering) => listed.listing.add(gathering.listing([one.owner].into())),
            // Its chain knows no grant of this owner, or not yet.
            Err(Unread::Gateway(error @ GatewayError::Refused(Code::NotAuthorised))) => {
                listed.untold.push((one.owner, error.into()));
            }
            Err(Unread::Gateway(error)) => return Err(error.into()),
            Err(Unread::TooMuch) => {
                return Err(refused(format!(
                    "the gateway {} lists more of {} than can be compared here; ask for one topic with --topic",
                    clean(gateway.address(), 255),
                    one.owner
                )));
            }
        }
    }
    Ok(listed)
}

/// The list of one owner's records, to its end.
async fn list_one(gateway: &mut dyn Lister, wanted: &Wanted, granted: &Granted<'_>) -> Result<Gathering, Unread> {
    let (mut gathering, mut pages) = (Gathering::default(), 0);
    for selection in wanted.selections() {
        let mut query = Query { selection, from: Timestamp(0), until: Timestamp(u64::MAX), cursor: 0, limit: PAGE };
        loop {
            let page = page(gateway, &query).await?;
            pages += 1;
            for entry in &page.entries {
                if entry.owner != wanted.owner || !wanted.covers(entry.topic_id) {
                    return Err(GatewayError::Unexpected("a record in a list that was not asked for").into());
                }
                if !gathering.add(entry, || granted(entry.owner, entry.topic_id)) {
                    return Err(Unread::TooMuch);
                }
            }
            let Some(next) = page.next else { break };
            if pages >= MOST_PAGES {
                return Err(Unread::TooMuch);
            }
            query.cursor = next;
        }
    }
    Ok(gathering)
}

/// A page; a gateway that does not know its chain at the moment is asked again for a while.
async fn page(gateway: &mut dyn Lister, query: &Query) -> Result<Page, GatewayError> {
    let begun = Instant::now();
    loop {
        match gateway.page(query).await {
            Err(GatewayError::Refused(Code::Stale)) if begun.elapsed() < QUIET => tokio::time::sleep(TICK).await,
            page => return page,
        }
    }
}

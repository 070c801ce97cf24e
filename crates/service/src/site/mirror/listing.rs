//! Reads a gateway's list of an owner's records from where it was read before, or hears of new ones, and fetches what
//! is missing here.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::mpsc;
use tokio::task::block_in_place;

use super::pacing::{Missed, Patience};
use super::{Broken, Joined, SILENCE};
use crate::event::{NoticeLevel, Part};
use crate::gateway::{Client, Code, Entry, ErasedRecord, Fetched, GatewayError, Query, Selection, Standing, Stood};
use crate::model::{Address, Hash, Timestamp};
use crate::pipeline::PipelineError;
use crate::pipeline::mirror::Mirror;
use crate::reply::Failure;
use crate::store::Notes;
use crate::store::notes::{Listed, ListedUntil};

/// Entries per page.
const PAGE: u16 = 500;
/// Digests checked at a time.
const CHECKED: usize = 500;
/// How far before the newest record seen a listing begins: outboxes of robots may be hours old.
const LATE: u64 = 24 * 3600;
/// How often a listing starts from the very beginning.
const WHOLE: u64 = 24 * 3600;

/// How far an owner's records were listed for one grant.
struct Place {
    note: Listed,
    until: ListedUntil,
}

impl Place {
    /// The one of this grant, zero for the reader's own records. Another grant than the one that was listed for begins
    /// anew: it may cover more topics and earlier epochs.
    ///
    /// # Errors
    /// Errors of the ledger.
    fn load(notes: &Notes, mirror: &Mirror<'_>, (source, grant): (Address, &Hash)) -> Result<Self, Failure> {
        let (domain, reader, keeper) = (mirror.network.domain, mirror.reader.address, mirror.keeper);
        let note = Listed { domain, keeper, reader, source };
        let grant = grant.0.first_chunk().map_or(0, |first| u64::from_be_bytes(*first));
        let known = block_in_place(|| notes.read(&note))?.filter(|known| known.grant == grant);
        Ok(Self { note, until: known.unwrap_or(ListedUntil { grant, ..ListedUntil::default() }) })
    }

    /// Stores it.
    ///
    /// # Errors
    /// Errors of the ledger.
    fn save(&self, notes: &Notes) -> Result<(), Failure> {
        Ok(block_in_place(|| notes.write(&self.note, &self.until))?)
    }
}

/// Where the next listing begins: a day before the newest record seen, and now and then at the beginning.
fn begin(until: &ListedUntil, now: Timestamp) -> u64 {
    let due = now.seconds().saturating_sub(until.whole) >= WHOLE;
    if due { 0 } else { until.newest.saturating_sub(LATE) }
}

/// A listing from there was done; a record from the future does not move the place beyond now.
fn listed(mut until: ListedUntil, begin: u64, now: Timestamp) -> ListedUntil {
    until.newest = until.newest.min(now.seconds());
    if begin == 0 {
        until.whole = now.seconds();
    }
    until
}

impl Joined {
    /// Lists the gateway's records of an owner, and fetches what is missing here.
    pub(super) async fn catch_up(
        self: &Arc<Self>,
        client: &mut Client,
        mirror: &Mirror<'_>,
        (source, grant): (&Address, &Hash),
        missed: &mut Missed,
    ) -> Result<(), Broken> {
        let source = *source;
        let mut place = Place::load(&self.plant.ledger.notes, mirror, (source, grant))?;
        let begin = begin(&place.until, Timestamp::now());
        let from = Timestamp::from_seconds(begin);
        let selection = Selection::all(source);
        let mut query = Query { selection, from, until: Timestamp(u64::MAX), cursor: 0, limit: PAGE };
        let mut patience = Patience::default();
        loop {
            let page = match client.query(&query).await {
                // A grant ended meanwhile: the chain will say so, or the next round asks again.
                Err(GatewayError::Refused(Code::NotAuthorised)) => return Ok(()),
                page => page?,
            };
            let mut new = false;
            for entry in &page.entries {
                place.until.newest = place.until.newest.max(entry.captured_at.seconds());
                if mirror.wants(entry)? {
                    // What cannot be taken in is nothing new, however often it is handed over.
                    let was_here = self.has(entry)?;
                    self.fetch(client, mirror, (source, entry), missed).await?;
                    new |= !was_here && self.has(entry)?;
                }
            }
            let Some(next) = page.next else { break };
            query.cursor = next;
            if let Some(pause) = patience.after(page.entries.len(), new)? {
                tokio::time::sleep(pause).await;
            }
        }
        place.until = listed(place.until, begin, Timestamp::now());
        Ok(place.save(&self.plant.ledger.notes)?)
    }

    pub(super) async fn fetch(
        &self,
        client: &mut Client,
        mirror: &Mirror<'_>,
        (source, entry): (Address, &Entry),
        missed: &mut Missed,
    ) -> Result<(), Broken> {
        match client.fetch(&entry.digest).await {
            Ok(record) => {
                if !self.take(mirror, source, entry, record).await? {
                    missed.add(source, entry, Instant::now());
                }
                Ok(())
            }
            Err(GatewayError::Erased(erased)) => self.take_erased(mirror, source, entry, *erased).await,
            Err(GatewayError::Refused(Code::NotFound | Code::NotAuthorised | Code::Tampered)) => Ok(()),
            Err(GatewayError::Crypto(error)) => {
                self.hub.notice(NoticeLevel::Error, &PipelineError::from(error).to_string());
                Ok(())
            }
            Err(error) => Err(error.into()),
        }
    }

    /// Fetches again the records that have a proof by now. Returns whether the gateway was asked anything.
    pub(super) async fn settle_proofs(
        &self,
        client: &mut Client,
        mirror: &Mirror<'_>,
        sources: &BTreeMap<Address, Hash>,
    ) -> Result<bool, Broken> {
        let mut asked = false;
        for source in sources.keys() {
            let waiting = mirror.unproven(*source, CHECKED)?;
            if waiting.is_empty() {
                continue;
            }
            asked = true;
            let standings = client.check(&waiting).await?;
            let anchored = |stood: &Stood| matches!(stood.standing, Standing::Anchored | Standing::Verified);
            for (digest, _) in waiting.iter().zip(&standings.stood).filter(|(_, stood)| anchored(stood)) {
                match client.fetch(digest).await {
                    Ok(record) => {
                        if mirror.take(*source, *digest, record).await? {
                            self.hub.confirmed.notify_one();
                            self.hub.changed(Part::Uploads);
                        }
                    }
                    Err(
                        GatewayError::Erased(_)
                        | GatewayError::Refused(Code::NotFound | Code::NotAuthorised | Code::Tampered),
                    ) => {}
                    Err(error) => return Err(error.into()),
                }
            }
        }
        Ok(asked)
    }

    /// Takes in what the owner states of a record that was erased.
    async fn take_erased(
        &self,
        mirror: &Mirror<'_>,
        source: Address,
        entry: &Entry,
        erased: ErasedRecord,
    ) -> Result<(), Broken> {
        let anchored = matches!(entry.standing, Standing::Anchored | Standing::Verified);
        if !anchored || !entry.kind.is_content() {
            return Ok(());
        }
        match mirror.take_erased(source, entry.digest, erased).await {
            Ok(true) => {
                self.hub.changed(Part::Grants);
                self.hub.changed(Part::Uploads);
                self.hub.confirmed.notify_one();
                Ok(())
            }
            Ok(false) => Ok(()),
            // One bad record must not keep the others away.
            Err(error @ (PipelineError::NotTakenIn { .. } | PipelineError::Crypto(_))) => {
                self.hub.notice(NoticeLevel::Error, &error.to_string());
                Ok(())
            }
            Err(error) => Err(error.into()),
        }
    }
}

/// The first pause before the gateway is asked again whether it gives an owner's records, and the longest.
const PAUSES: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(10));

/// A reader is told that he waits once the pauses are so long: some four seconds after the first refusal.
const SUBSCRIBING_LATE: Duration = Duration::from_secs(4);

/// A record of a subscription with its entry, or why there are no more.
pub(super) type Fed = Result<(Entry, Fetched), GatewayError>;

/// Owners whose records the gateway did not give when it was asked.
#[derive(Debug)]
pub(super) struct Refused {
    owners: BTreeSet<Address>,
    again: Instant,
    pause: Duration,
    said: bool,
}

impl Refused {
    /// As of now.
    pub fn new(owners: BTreeSet<Address>, now: Instant) -> Self {
        Self { owners, again: now + PAUSES.0, pause: PAUSES.0, said: false }
    }

    /// The owners, once, if it takes longer than a gateway needs to see a block: it may want a grant to be deeper in the chain.
    pub fn is_late(&mut self) -> Option<&BTreeSet<Address>> {
        let late =
            !self.owners.is_empty() && self.pause >= SUBSCRIBING_LATE && !std::mem::replace(&mut self.said, true);
        late.then_some(&self.owners)
    }

    /// Asks again if it is time to; `true` = the gateway gives the records of one of them now.
    ///
    /// # Errors
    /// [`GatewayError`], but for the refusal.
    pub async fn is_given(&mut self, client: &mut Client, now: Instant) -> Result<bool, GatewayError> {
        if self.owners.is_empty() || now < self.again {
            return Ok(false);
        }
        for owner in &self.owners {
            let selection = Selection::all(*owner);
            let query = Query { selection, from: Timestamp(0), until: Timestamp(u64::MAX), cursor: 0, limit: 1 };
            match client.query(&query).await {
                Ok(_) => return Ok(true),
                Err(GatewayError::Refused(Code::NotAuthorised)) => {}
                Err(error) => return Err(error),
            }
        }
        self.pause = (self.pause * 2).min(PAUSES.1);
        self.again = now + self.pause;
        Ok(false)
    }
}

/// Subscribes to each owner's records; returns those whose records the gateway does not give, too.
///
/// # Errors
/// [`GatewayError`], but for that refusal.
pub(super) async fn subscribe(
    mut client: Client,
    owners: &[Address],
) -> Result<(Client, BTreeSet<Address>), GatewayError> {
    let mut refused = BTreeSet::new();
    for owner in owners {
        match client.subscribe(&Selection::all(*owner)).await {
            Ok(_) => {}
            Err(GatewayError::Refused(Code::NotAuthorised)) => {
                refused.insert(*owner);
            }
            Err(error) => return Err(error),
        }
    }
    Ok((client, refused))
}

/// Passes on what comes, until the connection or a subscription ends.
pub(super) async fn follow(mut client: Client, feed: mpsc::Sender<Fed>) {
    loop {
        let next = match client.next_event(SILENCE).await {
            Ok((_, entry, record)) => Ok((entry, record)),
            Err(GatewayError::TimedOut) => match client.ping().await {
                Ok(_) if !client.is_spent() => continue,
                Ok(_) => Err(GatewayError::Closed),
                Err(error) => Err(error),
            },
            Err(error) => Err(error),
        };
        let ended = next.is_err();
        if feed.send(next).await.is_err() || ended {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: u64 = 2_000_000_000;

    #[test]
    fn a_listing_goes_on_a_day_before_its_end_and_begins_anew_each_day() {
        let now = Timestamp::from_seconds(NOW);
        assert_eq!(begin(&ListedUntil::default(), now), 0);
        let until = ListedUntil { newest: NOW + 60, whole: 0, grant: 7 };
        let until = listed(until, 0, Timestamp::from_seconds(NOW - 60));
        assert_eq!(begin(&until, now), NOW - 60 - LATE);
        assert_eq!(begin(&ListedUntil { whole: NOW - WHOLE, ..until }, now), 0);
    }
}

#[cfg(test)]
mod subscribing_tests {
    use super::*;

    #[test]
    fn a_reader_is_told_once_and_not_of_a_moment() {
        let mut none = Refused::new(BTreeSet::new(), Instant::now());
        none.pause = PAUSES.1;
        assert_eq!(none.is_late(), None);
        let owners = BTreeSet::from([Address([1; 20])]);
        let mut refused = Refused::new(owners.clone(), Instant::now());
        for pause in [500, 1_000, 2_000] {
            refused.pause = Duration::from_millis(pause);
            assert_eq!(refused.is_late(), None, "{pause}");
        }
        refused.pause = SUBSCRIBING_LATE;
        assert_eq!(refused.is_late(), Some(&owners));
        assert_eq!(refused.is_late(), None, "once");
    }
}

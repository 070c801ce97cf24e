//! What a gateway's callers may read at this moment: pages of the feed, and records.

use std::time::{Duration, Instant};

use tokio::time::timeout;

use super::GatewayDesk;
use super::desk::Result;
use crate::gateway::feed::MOST_ENTRIES;
use crate::gateway::{Caller, Code, Feed, FeedEntry, FeedPage, Fetched, Found, Place, Refusal};
use crate::model::{Address, Digest, RecordState, Scope, SignerId, Timestamp, TopicId};
use crate::pipeline::Network;
use crate::pipeline::authority::{
    Moment, NoRight, Policy, ReadRefused, ReadingRight, SigningRight, key_of, may_read, may_sign,
};
use crate::pipeline::chain_proofs::anchor_proof;
use crate::site::chain::link::GRACE;
use crate::store::notes::AnnouncedRevoke;
use crate::store::{self, FeedFilter, FeedPlace, FeedRow, RecordRow};

/// Silence of the chain after which nothing is stored or passed on; reading ends sooner, see
/// [`GatewayDesk::fresh_network`].
pub(super) const LONGEST_SILENCE: Duration = Duration::from_secs(30);

/// Bytes of records per answer, unless a single one is larger.
const MOST_BYTES: usize = 4 * 1024 * 1024;

fn not_authorised(owner: &Address, reader: &Address) -> Refusal {
    Refusal::new(Code::NotAuthorised, format_args!("{reader} has no grant of {owner}"))
}

impl GatewayDesk {
    /// The network, if the chain's state of at most two seconds ago is known here: only then is it known who may read.
    /// Call [`Self::freshen`] before.
    pub fn fresh_network(&self) -> Result<Network> {
        let network = self.known_network()?;
        self.gateway.parts.link.view().map_err(Refusal::because(Code::Stale))?;
        Ok(network)
    }

    /// Queries the chain's newest block, unless it did lately, and waits until it is read; `Stale` if that takes too
    /// long.
    pub async fn freshen(&self) -> Result<()> {
        let link = &self.gateway.parts.link;
        if link.view().is_ok() {
            return Ok(());
        }
        let (network, asked) = (self.known_network()?, Instant::now());
        if let Ok(Ok(head)) = timeout(GRACE, network.chain.head()).await
            && !link.is_named(&head, asked)
        {
            // The result shows below.
            drop(timeout(GRACE, link.scanned(head.number)).await);
        }
        link.view().map(drop).map_err(Refusal::because(Code::Stale))
    }

    /// The network, if the chain reported a head recently: enough for storing, which the anchoring block judges again.
    pub fn known_network(&self) -> Result<Network> {
        let network = self.gateway.parts.link.network_now().filter(|network| network.domain == self.place.domain);
        let fresh = self.gateway.parts.link.fresh_head(LONGEST_SILENCE);
        network.filter(|_| fresh.is_some()).ok_or_else(|| Refusal::new(Code::Stale, "no recent block from the chain"))
    }

    /// The right by which `reader` reads `owner`'s records here, now. Waits for the ledger: not on the network's
    /// threads.
    pub fn reach(&self, network: &Network, reader: &Address, owner: &Address) -> Result<ReadingRight> {
        if reader == owner {
            return Ok(ReadingRight::Own);
        }
        let policy = Policy::Gateway {
            head: self.gateway.parts.link.view().ok(),
            confirmations: network.confirmations,
            revoke_announced: self.is_revoke_announced(network, owner, reader)?,
        };
        let right = may_read(&network.directory, *reader, *owner, None, policy);
        right.map_err(|why| match why {
            ReadRefused::Stale => Refusal::new(Code::Stale, why),
            ReadRefused::Suspended { .. } => Refusal::new(Code::Suspended, why),
            ReadRefused::NotGranted { .. } | ReadRefused::NotCovered { .. } => Refusal::new(Code::NotAuthorised, why),
        })
    }

    /// The right by which a key signs for `owner` now: the later of the head's time and this clock decides.
    pub fn may_sign_now(&self, owner: &Address, signer: &SignerId) -> Result<Result<SigningRight, NoRight>> {
        let network = self.known_network()?;
        let head = self.gateway.parts.link.fresh_head(LONGEST_SILENCE).map_or(0, |head| head.timestamp);
        let at = Moment::newest(network.directory.now().max(Timestamp::from_seconds(head)));
        Ok(may_sign(&network.directory, *owner, *signer, at))
    }

    fn is_revoke_announced(&self, network: &Network, owner: &Address, reader: &Address) -> Result<bool> {
        let announced = AnnouncedRevoke { owner: *owner, reader: *reader };
        let epoch = self.gateway.parts.plant.ledger.notes.read(&announced).map_err(Refusal::internal)?;
        // The chain has caught up: its own state decides again.
        if epoch.is_some_and(|epoch| network.directory.epoch(*owner) < epoch) {
            return Ok(true);
        }
        let owners = self.gateway.parts.owners.all();
        let Some(local) = owners.iter().find(|local| local.address == *owner) else { return Ok(false) };
        let owed = self.gateway.sharing.owed_revocations(local, network);
        Ok(owed.map_err(Refusal::internal)?.contains(reader))
    }

    /// A record's bytes, compared with its digest before any of them leave.
    pub fn record(&self, caller: &Caller, digest: &Digest) -> Result<Fetched> {
        let plant = &self.gateway.parts.plant;
        let network = self.fresh_network()?;
        let row = self.readable(&network, caller, digest)?;
        let placed = plant.ledger.records.placed(row.digest).map_err(Refusal::internal)?;
        let blob = plant.stored_bytes(&row).map_err(Refusal::internal)?;
        let blob = blob.ok_or_else(|| Refusal::new(Code::NotFound, format_args!("record {} is missing", row.id)))?;
        if Digest(plant.provider.sm3(&[&blob])) != row.digest {
            return Err(Refusal::new(Code::Tampered, format_args!("record {} was altered", row.id)));
        }
        let signer = key_of(plant, &network, &row).map_err(Refusal::internal)?;
        let unknown = || Refusal::new(Code::Tampered, format_args!("the signer of record {} is unknown", row.id));
        let proof = placed.and_then(anchor_proof).map(|proof| proof.encode()).unwrap_or_default();
        Ok(Fetched { signer: signer.ok_or_else(unknown)?, signature: row.signature, proof, blob })
    }

    pub fn readable(&self, network: &Network, caller: &Caller, digest: &Digest) -> Result<RecordRow> {
        let row = self.gateway.parts.plant.ledger.records.find(*digest).map_err(Refusal::internal)?;
        let row = row.filter(is_offered);
        let row = row.ok_or_else(|| Refusal::new(Code::NotFound, format_args!("no record {digest}")))?;
        self.check_loan(network, caller)?;
        let beyond = caller.device.is_some_and(|device| !device.is_for(row.kind, row.topic_id));
        if beyond || !self.reach(network, &caller.account, &row.owner)?.covers(row.topic_id) {
            return Err(not_authorised(&row.owner, &caller.account));
        }
        Ok(row)
    }

    /// Requested owners whose records the reader may have now.
    pub fn followed(&self, reader: &Address, asked: &Feed) -> Result<Vec<Address>> {
        let network = self.fresh_network()?;
        let (places, refused) = self.places(&network, reader, asked)?;
        match refused.into_iter().next() {
            Some((_, refusal)) if places.is_empty() => Err(refusal),
            _ => Ok(places.into_iter().map(|place| place.owner).collect()),
        }
    }

    /// The reader's place with each owner, limited by the reader's right; and the owners who grant nothing.
    #[allow(clippy::type_complexity, reason = "who is refused, and why")]
    fn places(
        &self,
        network: &Network,
        reader: &Address,
        asked: &Feed,
    ) -> Result<(Vec<FeedPlace>, Vec<(Address, Refusal)>)> {
        let (mut places, mut refused) = (Vec::new(), Vec::new());
        for Place { owner, after, grant } in &asked.places {
            match self.reach(network, reader, owner) {
                // Rows seen under another grant may be fewer than the current one gives.
                Ok(right) => match covered(&right, &asked.topics).filter(|_| is_by(&right, *grant)) {
                    Some(topics) => places.push(FeedPlace { owner: *owner, after: *after, topics }),
                    None => refused.push((*owner, not_authorised(owner, reader))),
                },
                Err(refusal) if refusal.code == Code::Stale => return Err(refusal),
                // One owner's refusal does not affect the others.
                Err(refusal) => refused.push((*owner, refusal)),
            }
        }
        Ok((places, refused))
    }

    /// What is new for the caller after the requested places.
    pub fn page_of_feed(&self, caller: &Caller, asked: &Feed) -> Result<FeedPage> {
        let of_own = caller.device.is_some() && !asked.recorders.is_empty();
        let network = if of_own { self.known_network()? } else { self.fresh_network()? };
        self.check_loan(&network, caller)?;
        let (places, refused) = self.places(&network, &caller.account, asked)?;
        if places.is_empty() {
            return Err(refused
                .into_iter()
                .next()
                .map_or_else(|| Refusal::new(Code::Malformed, "nobody is asked about"), |(_, refusal)| refusal));
        }
        let filter = FeedFilter { places, kind: asked.kind, recorders: asked.recorders.clone() };
        let page = self.gateway.parts.plant.ledger.feed.page(&asked.id, &filter, MOST_ENTRIES);
        let store::FeedPage { id, is_anew, head, upto, mut rows } = page.map_err(Refusal::internal)?;
        // A device knows its owner's recorder from the owner's notices.
        rows.retain(|row| !of_own || is_a_device(&network, caller, &row.placed.row.signer));
        let refused = refused.into_iter().map(|(owner, refusal)| (owner, refusal.code)).collect();
        let page = FeedPage::new(id, (head, upto), refused, rows.into_iter().map(entry_of).collect());
        Ok(FeedPage { is_anew, ..page })
    }

    /// The first of these records, as many as fit.
    pub fn found(&self, caller: &Caller, digests: &[Digest], bytes: bool) -> Result<Vec<Found>> {
        if !bytes {
            let network = if caller.device.is_some() { self.known_network()? } else { self.fresh_network()? };
            self.check_loan(&network, caller)?;
            return digests.iter().map(|digest| self.is_here(&network, caller, digest)).collect();
        }
        let (mut found, mut length) = (Vec::new(), 0);
        for digest in digests {
            let one = match self.record(caller, digest) {
                Ok(record) => Found::Held(record),
                // Notices to a device are not erased.
                Err(refusal) if refusal.code == Code::NotFound && caller.device.is_none() => {
                    match self.erased(caller, digest) {
                        Ok(erased) => Found::Erased(erased),
                        Err(refusal) => missing(refusal)?,
                    }
                }
                Err(refusal) => missing(refusal)?,
            };
            length += if let Found::Held(record) = &one { record.blob.len() } else { 0 };
            if !found.is_empty() && length > MOST_BYTES {
                break;
            }
            found.push(one);
        }
        Ok(found)
    }

    /// Whether a record is here, as far as the caller may know.
    fn is_here(&self, network: &Network, caller: &Caller, digest: &Digest) -> Result<Found> {
        let row = self.gateway.parts.plant.ledger.records.find(*digest).map_err(Refusal::internal)?;
        let Some(row) = row else { return Ok(Found::Missing(Code::NotFound)) };
        let own = caller.device.is_none() || is_a_device(network, caller, &row.signer);
        let may_know = match self.reach(network, &caller.account, &row.owner) {
            Ok(right) => own && right.covers(row.topic_id),
            Err(refusal) if matches!(refusal.code, Code::Stale | Code::Internal) => return Err(refusal),
            Err(_) => false,
        };
        Ok(match row.state {
            _ if !may_know => Found::Missing(Code::NotFound),
            RecordState::Tampered => Found::Missing(Code::Tampered),
            _ => Found::Here,
        })
    }
}

/// One missing record does not keep back the others.
fn missing(refusal: Refusal) -> Result<Found> {
    match refusal.code {
        Code::Stale => Err(refusal),
        code => Ok(Found::Missing(code)),
    }
}

/// The requested topics that a right covers: `Some(None)` = all, `None` = none.
#[allow(clippy::option_option, reason = "no topic is not any topic")]
fn covered(right: &ReadingRight, asked: &[TopicId]) -> Option<Option<Vec<TopicId>>> {
    let topics = match right.scope() {
        Scope::All if asked.is_empty() => return Some(None),
        Scope::All => asked.to_vec(),
        Scope::Topics(topics) => topics.iter().filter(|id| asked.is_empty() || asked.contains(id)).copied().collect(),
    };
    (!topics.is_empty()).then_some(Some(topics))
}

/// Whether a right comes from the grant whose transaction hash begins with `grant`; 0 = any.
fn is_by(right: &ReadingRight, grant: u64) -> bool {
    match right {
        ReadingRight::Granted(granted) => grant == 0 || Place::grant_of(&granted.transaction) == grant,
        ReadingRight::Own => true,
    }
}

/// Whether a key is the calling device's or was lent by the same owner: a re-enrolled robot has another key.
fn is_a_device(network: &Network, caller: &Caller, signer: &SignerId) -> bool {
    let own = caller.device.is_some_and(|device| device.id == *signer);
    let account = network.directory.account(caller.account);
    own || account.is_some_and(|account| account.devices.iter().any(|loan| loan.device == *signer))
}

fn entry_of(row: FeedRow) -> FeedEntry {
    let FeedRow { number, fact, placed } = row;
    let RecordRow { digest, owner, recorder, seq, topic_id, epoch, captured_at, bytes: length, kind, .. } = placed.row;
    let proof = anchor_proof(placed).map(|proof| proof.encode()).unwrap_or_default();
    FeedEntry { number, fact, digest, owner, recorder, seq, topic_id, epoch, captured_at, length, kind, proof }
}

/// Quarantined and altered records stay here.
fn is_offered(row: &RecordRow) -> bool {
    use RecordState::{Captured, Dropped, Quarantined, Tampered};
    !matches!(row.state, Captured | Dropped | Quarantined | Tampered)
}

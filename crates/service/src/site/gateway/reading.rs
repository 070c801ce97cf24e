//! Queries of a gateway's callers: what they may read at this moment, pages, checks, one record, and new ones as they
//! come.

use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::broadcast::error::RecvError;
use tokio::sync::mpsc;
use tokio::time::timeout;

use super::GatewayDesk;
use crate::gateway::{Caller, Code, Entry, Fetched, Page, Query, Refusal, Selection, Standing, Stood};
use crate::model::{Address, Digest, PublicKey, RecordState, Scope, SignerId, Timestamp};
use crate::pipeline::Network;
use crate::pipeline::authority::{
    Moment, NoRight, Policy, ReadRefused, ReadingRight, SigningRight, key_of, may_read, may_sign,
};
use crate::pipeline::chain_proofs::anchor_proof;
use crate::site::chain::link::GRACE;
use crate::store::notes::AnnouncedRevoke;
use crate::store::{RecordQuery, RecordRow};

/// How long the chain may be silent before nothing is stored or passed on any more. Reading ends sooner, see
/// [`GatewayDesk::fresh_network`].
pub(super) const LONGEST_SILENCE: Duration = Duration::from_secs(30);

fn not_authorised(owner: &Address, reader: &Address) -> Refusal {
    Refusal::new(Code::NotAuthorised, format_args!("{reader} has no grant of {owner}"))
}

impl GatewayDesk {
    /// The network, if everything that is on the chain is known here, as of two seconds ago at most: only then is it known
    /// who may read. Who asks calls [`Self::freshen`] before.
    pub(super) fn fresh_network(&self) -> Result<Network, Refusal> {
        let network = self.known_network()?;
        self.gateway.link.view().map_err(Refusal::because(Code::Stale))?;
        Ok(network)
    }

    /// Asks the chain for its newest block unless it was asked lately, and waits until that was read.
    ///
    /// # Errors
    /// [`Refusal`] with `Stale` if the chain does not answer, is cut off, or reading its block takes too long.
    pub(super) async fn freshen(&self) -> Result<(), Refusal> {
        let link = &self.gateway.link;
        if link.view().is_ok() {
            return Ok(());
        }
        let (network, asked) = (self.known_network()?, Instant::now());
        if let Ok(Ok(head)) = timeout(GRACE, network.chain.head()).await
            && !link.is_named(&head, asked)
        {
            // Whether it has is seen below.
            drop(timeout(GRACE, link.scanned(head.number)).await);
        }
        link.view().map(drop).map_err(Refusal::because(Code::Stale))
    }

    /// The network, if the chain has reported a head recently: enough for storing, since what is stored is judged again by
    /// the block that anchors it.
    pub(super) fn known_network(&self) -> Result<Network, Refusal> {
        let network = self.gateway.link.network_now().filter(|network| network.domain == self.domain);
        let fresh = self.gateway.link.fresh_head(LONGEST_SILENCE);
        network.filter(|_| fresh.is_some()).ok_or_else(|| Refusal::new(Code::Stale, "no recent block from the chain"))
    }

    /// The right by which `reader` reads `owner`'s records here, now. Waits for the ledger: not on the network's
    /// threads.
    pub(super) fn reach(&self, network: &Network, reader: &Address, owner: &Address) -> Result<ReadingRight, Refusal> {
        if reader == owner {
            return Ok(ReadingRight::Own);
        }
        let policy = Policy::Gateway {
            head: self.gateway.link.view().ok(),
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

    /// The right by which a key signs for `owner` now: the later of the head's time and the clock here decides.
    pub(super) fn may_sign_now(
        &self,
        owner: &Address,
        signer: &SignerId,
    ) -> Result<Result<SigningRight, NoRight>, Refusal> {
        let network = self.known_network()?;
        let head = self.gateway.link.fresh_head(LONGEST_SILENCE).map_or(0, |head| head.timestamp);
        let at = Moment::newest(network.directory.now().max(Timestamp::from_seconds(head)));
        Ok(may_sign(&network.directory, *owner, *signer, at))
    }

    fn is_revoke_announced(&self, network: &Network, owner: &Address, reader: &Address) -> Result<bool, Refusal> {
        let announced = AnnouncedRevoke { owner: *owner, reader: *reader };
        let epoch = self.gateway.plant.ledger.notes.read(&announced).map_err(Refusal::because(Code::Internal))?;
        // The chain has caught up: its own state decides again.
        if epoch.is_some_and(|epoch| network.directory.epoch(*owner) < epoch) {
            return Ok(true);
        }
        let owners = self.gateway.owners.all();
        let Some(local) = owners.iter().find(|local| local.address == *owner) else { return Ok(false) };
        let owed = self.gateway.sharing.owed_revocations(local, network);
        Ok(owed.map_err(|failure| Refusal::new(Code::Internal, failure.message))?.contains(reader))
    }

    pub(super) fn page(&self, caller: &Caller, query: &Query) -> Result<Page, Refusal> {
        let network = self.fresh_network()?;
        self.check_loan(&network, caller)?;
        let reach = self.reach(&network, &caller.account, &query.selection.owner)?;
        let asked = record_query(query, &reach, &caller.account)?;
        let found = self.gateway.plant.ledger.list(&asked).map_err(Refusal::because(Code::Internal))?;
        let next = found.next.as_deref().and_then(|cursor| u128::from_str_radix(cursor, 16).ok());
        Ok(Page { entries: found.rows.iter().map(entry).collect(), next })
    }

    pub(super) fn standings(&self, caller: &Caller, digests: &[Digest]) -> Result<Vec<Standing>, Refusal> {
        // A robot asks about its own records, and learns nothing that its recall should end.
        let network = if caller.device.is_some() { self.known_network()? } else { self.fresh_network()? };
        self.check_loan(&network, caller)?;
        let mut known: Vec<(Address, Option<ReadingRight>)> = Vec::new();
        let mut standings = Vec::with_capacity(digests.len());
        for row in self.gateway.plant.ledger.records(digests).map_err(Refusal::because(Code::Internal))? {
            let Some(row) = row else {
                standings.push(Standing::Unknown);
                continue;
            };
            if !known.iter().any(|(owner, _)| *owner == row.owner) {
                known.push((row.owner, self.reach(&network, &caller.account, &row.owner).ok()));
            }
            let reach = known.iter().find(|(owner, _)| *owner == row.owner).and_then(|(_, reach)| reach.as_ref());
            let own = caller.device.is_none_or(|device| is_of_a_device(&network, &row, &device.id));
            let seen = own && reach.is_some_and(|reach| reach.covers(row.topic_id));
            standings.push(if seen { standing(row.state) } else { Standing::Unknown });
        }
        Ok(standings)
    }

    /// The state of digests, each with its place on the chain.
    pub(super) fn proven(&self, caller: &Caller, digests: &[Digest]) -> Result<Vec<Stood>, Refusal> {
        let standings = self.standings(caller, digests)?;
        let is_proven = |standing: &Standing| matches!(standing, Standing::Anchored | Standing::Verified);
        let proven: Vec<Digest> = digests
            .iter()
            .zip(&standings)
            .filter(|(_, standing)| is_proven(standing))
            .map(|(digest, _)| *digest)
            .collect();
        let (ledger, internal) = (&self.gateway.plant.ledger, Refusal::because(Code::Internal));
        let mut found = ledger.placed_all(&proven).map_err(&internal)?.into_iter();
        let mut stood = Vec::with_capacity(digests.len());
        for standing in standings {
            let found = if is_proven(&standing) { found.next().flatten() } else { None };
            let proof = found.and_then(anchor_proof);
            stood.push(Stood { standing, proof: proof.map(|proof| proof.encode()).unwrap_or_default() });
        }
        Ok(stood)
    }

    /// A record's bytes, compared with its digest before any of them leave.
    pub(super) fn record(&self, caller: &Caller, digest: &Digest) -> Result<Fetched, Refusal> {
        let (plant, internal) = (&self.gateway.plant, Refusal::because(Code::Internal));
        let network = self.fresh_network()?;
        let row = self.readable(&network, caller, digest)?;
        let placed = plant.ledger.placed(row.digest).map_err(&internal)?;
        let blob = plant.stored_bytes(&row).map_err(&internal)?;
        let blob = blob.ok_or_else(|| Refusal::new(Code::NotFound, format_args!("record {} is missing", row.id)))?;
        if Digest(plant.provider.sm3(&[&blob])) != row.digest {
            return Err(Refusal::new(Code::Tampered, format_args!("record {} was altered", row.id)));
        }
        let signer = key_of(plant, &network, &row).map_err(Refusal::because(Code::Internal))?;
        let unknown = || Refusal::new(Code::Tampered, format_args!("the signer of record {} is unknown", row.id));
        let proof = placed.and_then(anchor_proof).map(|proof| proof.encode()).unwrap_or_default();
        Ok(Fetched { signer: signer.ok_or_else(unknown)?, signature: row.signature, proof, blob })
    }

    /// A record that the caller may read now.
    pub(super) fn readable(&self, network: &Network, caller: &Caller, digest: &Digest) -> Result<RecordRow, Refusal> {
        let row = self.gateway.plant.ledger.record(*digest).map_err(Refusal::because(Code::Internal))?;
        let row = row.filter(is_offered);
        let row = row.ok_or_else(|| Refusal::new(Code::NotFound, format_args!("no record {digest}")))?;
        self.check_loan(network, caller)?;
        let beyond = caller.device.is_some_and(|device| !device.is_for(row.kind, row.topic_id));
        if beyond || !self.reach(network, &caller.account, &row.owner)?.covers(row.topic_id) {
            return Err(not_authorised(&row.owner, &caller.account));
        }
        Ok(row)
    }
}

/// Whether a device signed a record: the asking one, or another one of the same owner, because a robot that is enrolled
/// again has another key. Somebody who does not have a record does not know its digest.
fn is_of_a_device(network: &Network, row: &RecordRow, asking: &SignerId) -> bool {
    let account = network.directory.account(row.owner);
    row.signer == *asking || account.is_some_and(|account| account.devices.iter().any(|loan| loan.device == row.signer))
}

/// Whether a record may leave: quarantined or altered records are only listed.
fn is_offered(row: &RecordRow) -> bool {
    !matches!(standing(row.state), Standing::Unknown | Standing::Tampered | Standing::Quarantined)
}

fn record_query(query: &Query, reach: &ReadingRight, reader: &Address) -> Result<RecordQuery, Refusal> {
    let Selection { owner, topic_id, kind, filters } = &query.selection;
    let topic_ids = match (topic_id, reach.scope()) {
        (Some(topic), scope) if !scope.covers(*topic) => return Err(not_authorised(owner, reader)),
        (Some(topic), _) => Some(vec![*topic]),
        (None, Scope::All) => None,
        (None, Scope::Topics(topics)) => Some(topics.clone()),
    };
    Ok(RecordQuery {
        owner: Some(*owner),
        topic_ids,
        filters: filters.iter().copied().map(Into::into).collect(),
        kind: *kind,
        since: (query.from.0 > 0).then_some(query.from),
        until: (query.until.0 <= i64::MAX.unsigned_abs()).then_some(query.until),
        after: (query.cursor != 0).then(|| format!("{:032x}", query.cursor)),
        limit: usize::from(query.limit),
        ..RecordQuery::default()
    })
}

/// The standing of a record in this state.
fn standing(state: RecordState) -> Standing {
    match state {
        RecordState::Captured | RecordState::Dropped => Standing::Unknown,
        RecordState::Stored | RecordState::Batched | RecordState::Submitted | RecordState::RightEnded => {
            Standing::Acknowledged
        }
        RecordState::Mined | RecordState::Confirmed => Standing::Anchored,
        RecordState::Verified => Standing::Verified,
        RecordState::Tampered => Standing::Tampered,
        RecordState::Quarantined => Standing::Quarantined,
    }
}

/// A record's entry in a list.
pub(super) fn entry(row: &RecordRow) -> Entry {
    Entry {
        digest: row.digest,
        owner: row.owner,
        recorder: row.recorder,
        seq: row.seq,
        topic_id: row.topic_id,
        epoch: row.epoch,
        captured_at: row.captured_at,
        length: row.bytes,
        kind: row.kind,
        standing: standing(row.state),
    }
}

/// P_S and P_E of a caller that is no device.
type Keys = Option<(PublicKey, PublicKey)>;

/// Entries that may wait for a slow reader; beyond that, the subscription waits for it.
const AHEAD: usize = 64;

/// How often to check whether the chain is fresh again.
const AGAIN: Duration = Duration::from_millis(500);

/// One running subscription.
pub(super) struct Watch {
    pub desk: Arc<GatewayDesk>,
    pub caller: Caller,
    pub selection: Selection,
}

impl Watch {
    /// Begins; the caller is authorised now, or refused.
    pub(super) fn begin(self) -> Result<mpsc::Receiver<Entry>, Refusal> {
        let (mut reach, keys) = (self.reach()?, self.keys()?);
        let mut settled = self.desk.gateway.hub.settled.subscribe();
        let mut authority = self.desk.gateway.hub.authority.subscribe();
        let (sender, receiver) = mpsc::channel(AHEAD);
        tokio::spawn(async move {
            loop {
                tokio::select! {
                    // Whether the caller may read is decided before looking at what there is to read.
                    biased;
                    changed = authority.changed() => {
                        match self.right(&keys, &sender).await {
                            Some(now) => reach = now,
                            None => return,
                        }
                        if changed.is_err() {
                            return;
                        }
                    }
                    () = sender.closed() => return,
                    digests = settled.recv() => match digests {
                        Ok(digests) => {
                            if self.desk.freshen().await.is_err() {
                                match self.right(&keys, &sender).await {
                                    Some(now) => reach = now,
                                    None => return,
                                }
                            }
                            let entries = tokio::task::block_in_place(|| self.entries(&digests, &reach));
                            for entry in entries {
                                if sender.send(entry).await.is_err() {
                                    return;
                                }
                            }
                        }
                        // What was missed is in the list: the reader requests it and subscribes again.
                        Err(RecvError::Lagged(_) | RecvError::Closed) => return,
                    },
                }
            }
        });
        Ok(receiver)
    }

    /// The right as it is now. While it is not known, because the chain is silent, nothing is delivered and nothing ends.
    /// `None` = it is gone, or nobody listens any more.
    async fn right(&self, keys: &Keys, sender: &mpsc::Sender<Entry>) -> Option<ReadingRight> {
        while !sender.is_closed() {
            let found =
                self.desk.freshen().await.and_then(|()| {
                    tokio::task::block_in_place(|| self.reach().and_then(|now| Ok((now, self.keys()?))))
                });
            match found {
                Ok((now, same)) if same == *keys => return Some(now),
                Err(refusal) if refusal.code == Code::Stale => tokio::time::sleep(AGAIN).await,
                Ok(_) | Err(_) => return None,
            }
        }
        None
    }

    fn reach(&self) -> Result<ReadingRight, Refusal> {
        let network = self.desk.fresh_network()?;
        self.desk.check_loan(&network, &self.caller)?;
        self.desk.reach(&network, &self.caller.account, &self.selection.owner)
    }

    /// The caller's keys on the chain: a change ends what was begun under the old ones. None for a device, which is
    /// valid as long as its loan, whatever keys its owner has.
    fn keys(&self) -> Result<Keys, Refusal> {
        if self.caller.device.is_some() {
            return Ok(None);
        }
        let network = self.desk.fresh_network()?;
        let identity = network.directory.identity(self.caller.account);
        identity.map(|known| Some((known.signing, known.envelope))).map_err(Refusal::because(Code::NotRegistered))
    }

    fn entries(&self, digests: &[Digest], reach: &ReadingRight) -> Vec<Entry> {
        let ledger = &self.desk.gateway.plant.ledger;
        let rows = digests.iter().filter_map(|digest| ledger.record(*digest).ok().flatten());
        rows.filter(|row| self.wants(row, reach)).map(|row| entry(&row)).collect()
    }

    fn wants(&self, row: &RecordRow, reach: &ReadingRight) -> bool {
        let Selection { owner, topic_id, kind, filters } = &self.selection;
        let ledger = &self.desk.gateway.plant.ledger;
        row.owner == *owner
            && row.state == RecordState::Verified
            && reach.covers(row.topic_id)
            && topic_id.is_none_or(|topic| topic == row.topic_id)
            && kind.is_none_or(|kind| kind == row.kind)
            && filters.iter().all(|filter| ledger.has_filter(row.digest, *filter).unwrap_or(false))
    }
}

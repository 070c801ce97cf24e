//! Live subscriptions: verified records as they come, ended the moment the right to them is gone.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::broadcast::error::RecvError;
use tokio::sync::mpsc;

use super::GatewayDesk;
use super::reading::entry;
use crate::gateway::{Caller, Code, Entry, Refusal, Selection};
use crate::model::{Digest, PublicKey, RecordState};
use crate::pipeline::authority::ReadingRight;
use crate::store::RecordRow;

/// P_S and P_E of a caller that is no device.
type Keys = Option<(PublicKey, PublicKey)>;

/// Entries that may wait for a slow reader; beyond that, the subscription waits for it.
const AHEAD: usize = 64;

/// How often it is looked whether the chain is fresh again.
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

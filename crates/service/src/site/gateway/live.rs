//! Live subscriptions: verified records as they come, ended the moment the right to them is gone.

use std::sync::Arc;

use tokio::sync::broadcast::error::RecvError;
use tokio::sync::mpsc;

use super::GatewayDesk;
use super::standing::entry;
use crate::gateway::{Caller, Code, Entry, Refusal, Selection};
use crate::model::{Digest, PublicKey, RecordState};
use crate::pipeline::authority::ReadingRight;
use crate::store::RecordRow;

/// Entries that may wait for a slow reader; beyond that, the subscription waits for it.
const AHEAD: usize = 64;

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
                        let now = tokio::task::block_in_place(|| self.reach().and_then(|now| Ok((now, self.keys()?))));
                        match now {
                            Ok((now, same)) if same == keys => reach = now,
                            _ => return,
                        }
                        if changed.is_err() {
                            return;
                        }
                    }
                    () = sender.closed() => return,
                    digests = settled.recv() => match digests {
                        Ok(digests) => {
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

    fn reach(&self) -> Result<ReadingRight, Refusal> {
        let network = self.desk.fresh_network()?;
        self.desk.check_loan(&network, &self.caller)?;
        self.desk.reach(&network, &self.caller.account, &self.selection.owner)
    }

    /// The caller's keys on the chain: a change ends what was begun under the old ones. None for a device, which is
    /// valid as long as its loan, whatever keys its owner has.
    fn keys(&self) -> Result<Option<(PublicKey, PublicKey)>, Refusal> {
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

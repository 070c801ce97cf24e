//! The audit of a whole chain: every block is run again, a little at a time, so that requests and blocks do not have to
//! wait.

use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use super::founding;
use super::node::Node;
use super::replay::Again;
use crate::chain::ChainError;
use crate::model::Hash;

/// How long an audit runs at a time.
const SHARE: Duration = Duration::from_millis(20);

/// An audit in progress.
pub struct Auditing {
    again: Again,
    /// The newest block when it began.
    newest: u64,
    /// The nodes of the newest state still to be read from the file; `None` until all blocks have run.
    nodes: Option<Vec<Hash>>,
    reply: oneshot::Sender<Result<u64, ChainError>>,
}

impl Node {
    /// Begins an audit.
    pub fn begin_audit(&mut self, reply: oneshot::Sender<Result<u64, ChainError>>) {
        match founding::open(&self.file, None) {
            Ok(founded) => {
                let again = Again::new(&self.file, founded);
                self.audits.push_back(Auditing { again, newest: self.head.number, nodes: None, reply });
            }
            Err(error) => drop(reply.send(Err(error))),
        }
    }

    /// Continues the audit that has waited longest.
    pub fn go_on_auditing(&mut self) {
        let Some(auditing) = self.audits.pop_front().filter(|auditing| !auditing.reply.is_closed()) else { return };
        if let Some(unfinished) = self.share_of(auditing) {
            self.audits.push_back(unfinished);
        }
    }

    /// Returns the audit if it is not finished.
    fn share_of(&self, mut auditing: Auditing) -> Option<Auditing> {
        let begun = Instant::now();
        while begun.elapsed() < SHARE {
            if auditing.again.last.number < auditing.newest {
                match auditing.again.step() {
                    Ok(again) => auditing.again = again,
                    Err(error) => {
                        drop(auditing.reply.send(Err(error)));
                        return None;
                    }
                }
                continue;
            }
            // Blocks mined meanwhile may have removed some of this state's nodes.
            let nodes = auditing.nodes.get_or_insert_with(|| auditing.again.state_nodes());
            let Some(hash) = nodes.pop() else {
                drop(auditing.reply.send(Ok(auditing.newest)));
                return None;
            };
            if let Err(error) = self.file.look_at(hash, self.head.number > auditing.newest) {
                drop(auditing.reply.send(Err(error)));
                return None;
            }
        }
        Some(auditing)
    }
}

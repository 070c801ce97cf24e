//! Revoking a grant, also on a full disk: then with the space that was set aside for it.

use super::Sharing;
use std::sync::Arc;
use std::time::Duration;

use crate::chain::Call;
use crate::gateway::RevokeNotice;
use crate::model::{Address, ErrorKind};
use crate::pipeline::{Network, Owner};
use crate::service::event::NoticeLevel;
use crate::service::failure::refused;
use crate::service::reply::{Failure, TransactionView};
use crate::site::blocking;

/// How long the watcher may take to see the transactions of a first attempt.
const PATIENCE: Duration = Duration::from_secs(30);

impl Sharing {
    /// Stops sharing with an account. What it has read cannot be recalled.
    pub(in crate::site) async fn revoke(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        grantee: Address,
    ) -> Result<TransactionView, Failure> {
        let network = self.link.network().await?;
        let _one_at_a_time = owner.changes.lock().await;
        if self.active_grant(&network, owner.address, grantee).is_none() {
            return Err(refused(format!(
                "{grantee} has no active grant from {}; `authros grants list` shows who has",
                owner.address
            )));
        }
        let failure = match self.revoke_once(owner, &network, grantee).await {
            Ok(view) => return Ok(view),
            Err(failure) => failure,
        };
        // Space helps only if the disk is full.
        if failure.kind != ErrorKind::Home || !blocking(self, |sharing| Ok(sharing.reserve.release()?)).await? {
            return Err(failure);
        }
        let _space_is_for_this = self.plant.ledger.hold_records();
        self.hub.notice(
            NoticeLevel::Error,
            "the disk is full: the reserved space was used for a revoke; free some space, records wait in memory",
        );
        self.revoke_again(owner, &network, grantee).await
    }

    async fn revoke_once(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        network: &Network,
        grantee: Address,
    ) -> Result<TransactionView, Failure> {
        self.owe_revocation(owner, grantee)?;
        let call = |new_token, envelope| Call::AuthorityRevoke { grantee, new_token, envelope };
        let sent = self.begin_epoch(owner, network, &format!("revoke {grantee}"), call).await;
        let view = sent.map_err(|failure| {
            let noted = "the revocation is stored and is resent until the chain has it";
            Failure { message: format!("{}; {noted}", failure.message), ..failure }
        })?;
        if let (Some(transaction), Some(token)) = (view.transaction, owner.token(network.domain, view.epoch)) {
            let notice = RevokeNotice { grantee, epoch: view.epoch, token, transaction };
            self.joined.tell_of_revoke(owner, network, notice).await;
        }
        self.settle_revocation(owner, grantee)?;
        Ok(told(grantee, view))
    }

    /// Resumes what is left of an attempt that the full disk interrupted at any point.
    async fn revoke_again(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        network: &Network,
        grantee: Address,
    ) -> Result<TransactionView, Failure> {
        self.settle_open(owner, network).await?;
        let head = network.chain.head().await?.number;
        drop(tokio::time::timeout(PATIENCE, self.link.scanned(head)).await);
        if self.active_grant(network, owner.address, grantee).is_some() {
            return self.revoke_once(owner, network, grantee).await;
        }
        let epoch = network.directory.epoch(owner.address);
        self.log.write(&owner.profile, "revoke", &format!("{grantee} epoch {epoch}"), "done").await?;
        owner.confirm_epoch(network.domain, epoch)?;
        self.settle_revocation(owner, grantee)?;
        let view = TransactionView { transaction: None, block: None, epoch, text: String::new() };
        Ok(told(grantee, view))
    }
}

fn told(grantee: Address, view: TransactionView) -> TransactionView {
    let epoch = view.epoch;
    let text = format!(
        "{grantee} can no longer read new records (epoch {epoch} begins); what was already read cannot be recalled"
    );
    TransactionView { text, ..view }
}

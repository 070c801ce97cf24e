//! The administrator's acts, and what everybody is told of them: above all who continues for a lost account.

use std::collections::HashSet;
use std::sync::Arc;

use super::Site;
use crate::chain::Call;
use crate::model::Address;
use crate::pipeline::{Network, Owner};
use crate::service::command::Administration;
use crate::service::event::{NoticeLevel, Part};
use crate::service::failure::refused;
use crate::service::reply::{AdministrationView, Failure, SuccessionView, TransactionView};

impl Site {
    /// Does one act of the administrator; the contract refuses it to anybody else.
    pub(super) async fn administer(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        act: &Administration,
    ) -> Result<TransactionView, Failure> {
        let network = self.network().await?;
        let _one_at_a_time = owner.changes.lock().await;
        let (call, text) = self.act(&network, act)?;
        if let Some(administrator) = network.directory.administration().administrator
            && administrator != owner.address
            && call != Call::AcceptAdministrator
        {
            return Err(refused(format!(
                "{administrator} administers this contract, not {}; only the administrator can do this",
                owner.address
            )));
        }
        let name = call.name();
        self.audit_first(owner, name, &text).await?;
        let sent = self.sender.send(&network.chain, &owner.eoa(), call, name).await.map_err(Failure::from);
        let (transaction, receipt) = self.audit_end(owner, name, &text, sent).await?;
        self.scanned(receipt.block).await;
        self.changed(Part::Chain);
        let epoch = network.directory.epoch(owner.address);
        Ok(TransactionView { transaction: Some(transaction), block: Some(receipt.block), epoch, text })
    }

    fn act(&self, network: &Network, act: &Administration) -> Result<(Call, String), Failure> {
        Ok(match act {
            Administration::Admit { account } => {
                let account = self.resolve(account)?;
                (Call::Admit { account }, format!("{account} may register"))
            }
            Administration::Suspend { account } => {
                let account = self.resolve(account)?;
                (Call::Suspend { account }, format!("{account} may change nothing but take rights away"))
            }
            Administration::Restore { account } => {
                let account = self.resolve(account)?;
                (Call::Restore { account }, format!("{account} is free again"))
            }
            Administration::Open { open } => {
                let text = if *open { "anyone may register" } else { "only admitted accounts may register" };
                (Call::SetOpen { open: *open }, text.to_owned())
            }
            Administration::Pause { paused } => {
                let text =
                    if *paused { "all changes are stopped but those that take rights away" } else { "changes go on" };
                (Call::SetPaused { paused: *paused }, text.to_owned())
            }
            Administration::HandOver { account } => {
                let account = self.resolve(account)?;
                (Call::Nominate { account }, format!("{account} is to administer; it takes over with `chain accept`"))
            }
            Administration::Accept => (Call::AcceptAdministrator, "this profile administers the contract".to_owned()),
            Administration::Succeed { lost, successor } => {
                let (lost, successor) = (self.resolve(lost)?, self.resolve(successor)?);
                network.directory.identity(successor)?;
                let text = format!("{successor} continues for {lost}, which is suspended for good");
                (Call::Succeed { lost, successor }, text)
            }
        })
    }

    /// What the administrator decided, with the names of the address book.
    pub(super) fn administration_view(&self, network: &Network) -> AdministrationView {
        let decided = network.directory.administration();
        let names = self.names();
        let name = |account: &Address| names.get(account).cloned();
        let successions = decided.successions.iter().map(|named| SuccessionView {
            lost: named.lost,
            lost_name: name(&named.lost),
            successor: named.successor,
            successor_name: name(&named.successor),
            block: named.block,
        });
        AdministrationView {
            administrator: decided.administrator,
            nominee: decided.nominee,
            open: decided.open,
            paused: decided.paused,
            suspended: decided.suspended.iter().copied().collect(),
            successions: successions.collect(),
        }
    }

    /// Tells of successors and of contacts with other keys as soon as the chain does, each once a run.
    pub(super) async fn keep_parties_known(self: Arc<Self>) {
        let mut scanned = self.scanned.subscribe();
        let (mut seen, mut told) = (None, HashSet::new());
        while !self.is_stopping() {
            tokio::select! {
                changed = scanned.changed() => if changed.is_err() { return },
                () = self.stopped() => return,
            }
            let Some(network) = self.network_now() else { continue };
            let newest = (network.domain, network.directory.newest());
            if seen.replace(newest) == Some(newest) {
                continue;
            }
            let mut texts = self.succession_texts(&network);
            match self.changed_contacts(&network) {
                Ok(changed) => texts.extend(changed),
                Err(failure) => texts.push(failure.message),
            }
            for text in texts {
                if told.insert(text.clone()) {
                    self.hub.notice(NoticeLevel::Error, &text);
                }
            }
        }
    }

    fn succession_texts(&self, network: &Network) -> Vec<String> {
        let view = self.administration_view(network);
        let shown = |account: Address, name: &Option<String>| {
            name.as_ref().map_or_else(|| account.to_string(), |name| format!("{name} ({account})"))
        };
        let text = |named: &SuccessionView| {
            let (lost, successor) =
                (shown(named.lost, &named.lost_name), shown(named.successor, &named.successor_name));
            format!(
                "the administrator named {successor} the successor of {lost}, which is lost (block {})",
                named.block
            )
        };
        view.successions.iter().map(text).collect()
    }
}

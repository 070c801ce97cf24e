//! What an operator asks of the site itself: locking, a backup of the keys, a look at the gateway.

use std::collections::BTreeMap;
use std::sync::{Arc, PoisonError};
use std::time::Duration;

use tokio::task::block_in_place;

use super::Site;
use crate::gateway::ServerWatch;
use crate::gateway::tally::Sender;
use crate::model::{Address, ProfileName, Timestamp};
use crate::pipeline::Owner;
use crate::service::command::{self as ask, Ask, Operation, SecretBytes};
use crate::service::event::Part;
use crate::service::failure::{input, internal};
use crate::service::reply::{
    Failure, GatewayStatusView, GatewayView, IdentityView, RefusedView, Reply, SenderView, SystemKeyView,
};

/// How long a change under way may hold up the locking.
const PATIENCE: Duration = Duration::from_secs(10);

/// A gateway at work: what is told of it, and a look at its server.
pub(super) struct Serving {
    /// What is told.
    pub view: GatewayView,
    /// Its server.
    pub watch: ServerWatch,
    /// What transport keys lie under.
    pub under: super::gateway::KeptUnder,
}

impl Site {
    /// Answers one of an operator's requests; none needs the keyring open.
    pub(super) async fn operate(
        self: &Arc<Self>,
        profile: &ProfileName,
        operation: Operation,
    ) -> Result<Reply, Failure> {
        match operation {
            Operation::Lock => self.lock_profile(profile).await.map(ask::Lock::told),
            Operation::HoldCapture { hold } => {
                self.hold_capture(profile, hold);
                Ok(ask::HoldCapture::told(()))
            }
            Operation::BackUpKeys => self.back_up_keys(profile).await.map(ask::BackUpKeys::told),
            Operation::GatewayStatus => self.gateway_status().map(ask::GatewayStatus::told),
            Operation::Admit { owner } => self.admit(profile, &owner).await.map(ask::Admit::told),
            Operation::Dismiss { owner } => self.dismiss(profile, &owner).await.map(ask::Dismiss::told),
            Operation::ListAdmitted => self.admitted_rows().map(ask::ListAdmitted::told),
        }
    }

    /// Wipes what decrypts, grants and revokes. A change of epochs or grants under way is waited for a moment: without
    /// its keys it could not be finished.
    async fn lock_profile(self: &Arc<Self>, profile: &ProfileName) -> Result<IdentityView, Failure> {
        if let Some(owner) = self.owner(profile).filter(|owner| !owner.is_locked()) {
            {
                // One that hangs is cut: what it leaves open is taken up at the next unlock.
                let _one_at_a_time = tokio::time::timeout(PATIENCE, owner.changes.lock()).await.ok();
                if let Some(network) = self.network_now() {
                    block_in_place(|| self.foresee_locked(&owner, &network))?;
                }
                owner.lock(self.plant.provider)?;
                self.heads.forget();
            }
            self.changed(Part::Identity);
            self.record_audit(profile, "lock", "keyring", "done").await?;
        }
        self.identity_view(profile).await
    }

    async fn back_up_keys(self: &Arc<Self>, profile: &ProfileName) -> Result<SecretBytes, Failure> {
        let path = self.home.keyring(profile);
        if !path.exists() {
            return Err(input(format!("profile '{profile}' has no identity yet; there is nothing to back up")));
        }
        self.record_audit(profile, "back up keys", "keyring", "begun").await?;
        let read = move |_: &Self| {
            std::fs::read(&path).map_err(|error| internal(format!("the keyring cannot be read: {error}")))
        };
        Ok(SecretBytes::new(self.blocking(read).await?))
    }

    /// What the transport keys of the gateway that this owner serves here lie under.
    pub(super) fn kept_under(&self, owner: &Owner) -> Option<super::gateway::KeptUnder> {
        let serving = self.served_gateway.lock().unwrap_or_else(PoisonError::into_inner);
        serving
            .as_ref()
            .filter(|serving| serving.view.account == owner.address)
            .map(|serving| Arc::clone(&serving.under))
    }

    fn gateway_status(&self) -> Result<GatewayStatusView, Failure> {
        let bound = block_in_place(|| self.plant.ledger.bound_names())?;
        let through = self.remote.as_ref().map(|remote| crate::model::clean(&remote.chain_text(), 300));
        let serving = self.served_gateway.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(serving) = &*serving else {
            let senders = sender_rows(bound, Vec::new());
            return Ok(GatewayStatusView { through, senders, ..GatewayStatusView::default() });
        };
        let (list, now) = (serving.watch.system_keys(), Timestamp::now());
        let keys = list.keys.iter().map(|key| SystemKeyView {
            id: key.id(),
            not_before: key.not_before,
            not_after: key.not_after,
            current: key.is_in_use(now),
        });
        let refused = serving.watch.refused().into_iter();
        let mut refused: Vec<RefusedView> = refused
            .map(|(code, count)| RefusedView { code: code.number(), text: code.text().to_owned(), count })
            .collect();
        refused.sort_by_key(|row| std::cmp::Reverse(row.count));
        Ok(GatewayStatusView {
            served: Some(serving.view.clone()),
            through,
            connections: u64::try_from(serving.watch.connections()).unwrap_or(u64::MAX),
            senders: sender_rows(bound, serving.watch.senders()),
            keys: keys.collect(),
            list_version: list.version,
            list_expires: Some(list.expires_at),
            refused,
        })
    }
}

/// Every bound name with the sum of its sessions; those connected first.
fn sender_rows(bound: Vec<(String, Address)>, connected: Vec<Sender>) -> Vec<SenderView> {
    let unknown = |name: ProfileName, account| SenderView {
        name,
        account,
        sessions: 0,
        peer: None,
        since: None,
        last: None,
        frames: 0,
        bytes: 0,
    };
    let known = bound.into_iter().filter_map(|(name, account)| Some((name.parse::<ProfileName>().ok()?, account)));
    let mut rows: BTreeMap<ProfileName, SenderView> =
        known.map(|(name, account)| (name.clone(), unknown(name, account))).collect();
    for sender in connected {
        let row = rows.entry(sender.name.clone()).or_insert_with(|| unknown(sender.name.clone(), sender.account));
        row.sessions += 1;
        row.peer = Some(sender.peer.to_string());
        row.since = Some(row.since.map_or(sender.since, |since| since.min(sender.since)));
        row.last = Some(row.last.map_or(sender.last, |last| last.max(sender.last)));
        row.frames += sender.frames;
        row.bytes = row.bytes.saturating_add(sender.bytes);
    }
    let mut rows: Vec<SenderView> = rows.into_values().collect();
    rows.sort_by_key(|row| row.sessions == 0);
    rows
}

//! The state of this site's gateway: who is connected, what was refused.

use super::Gateway;
use std::collections::BTreeMap;
use std::sync::{Arc, PoisonError};

use tokio::task::block_in_place;

use crate::gateway::ServerWatch;
use crate::gateway::server::Sender;
use crate::model::{Address, ProfileName, Timestamp};
use crate::pipeline::Owner;
use crate::service::reply::{Failure, GatewayStatusView, GatewayView, RefusedView, SenderView, SystemKeyView};

/// A running gateway: what is reported about it, and its server.
pub(in crate::site) struct Serving {
    /// The report.
    pub view: GatewayView,
    /// Its server.
    pub watch: ServerWatch,
    /// The keys that encrypt the transport keys.
    pub under: super::KeptUnder,
}

impl Gateway {
    /// The keys that encrypt the transport keys of the gateway that this owner serves here.
    pub(in crate::site) fn kept_under(&self, owner: &Owner) -> Option<super::KeptUnder> {
        let serving = self.serving.lock().unwrap_or_else(PoisonError::into_inner);
        serving
            .as_ref()
            .filter(|serving| serving.view.account == owner.address)
            .map(|serving| Arc::clone(&serving.under))
    }

    pub(in crate::site) fn status(&self) -> Result<GatewayStatusView, Failure> {
        let bound = block_in_place(|| self.plant.ledger.bindings.bound_names())?;
        let through = self.remote.as_ref().map(|remote| crate::model::clean(&remote.chain_text(), 300));
        let serving = self.serving.lock().unwrap_or_else(PoisonError::into_inner);
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

/// Every bound name with the sum of its sessions; connected ones first.
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

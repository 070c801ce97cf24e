//! The audit of records as the site runs it, and the scrubber that does a little of it all the time.

use std::sync::Arc;
use std::time::Duration;

use tokio::runtime::Handle;

use crate::crypto::read_public;
use crate::model::{Address, Timestamp};
use crate::pipeline::record_audit::{self, RecordAudit, Scope, scrub_round};
use crate::service::event::NoticeLevel;
use crate::service::reply::Failure;
use crate::site::Site;

/// How often the scrubber does its share.
const SHARE_EVERY: Duration = Duration::from_secs(5);
/// Most records that it does at once.
const MOST_AT_ONCE: usize = 256;

impl Site {
    /// The accounts of all profiles of the home; a keyring that cannot be read has none.
    pub(in crate::site) fn accounts(&self) -> Vec<Address> {
        let profiles = self.home.profiles();
        profiles.iter().filter_map(|profile| Some(read_public(&self.home.keyring(profile)).ok()?.address)).collect()
    }

    /// Audits all records of the home.
    pub(in crate::site) async fn audit_records(
        self: &Arc<Self>,
        deep: bool,
        since: Option<Timestamp>,
    ) -> Result<RecordAudit, Failure> {
        let pinned = self.pin()?.is_some();
        let network = if pinned { Some(self.network().await) } else { None };
        let runtime = Handle::current();
        self.blocking(move |site| {
            let indices = site.all_owners().into_iter().map(|owner| (owner.address, owner.index())).collect();
            let scope = Scope { deep, since: since.unwrap_or_default(), accounts: site.accounts(), indices };
            let chain = network.as_ref().map(|network| network.as_ref().map_err(|failure| failure.message.clone()));
            Ok(record_audit::audit(&site.plant, chain, &site.audit, &scope, &runtime)?)
        })
        .await
    }

    /// Re-hashes the share of the stored records that `audit.scrub` asks for, until the site ends.
    pub(in crate::site) async fn keep_scrubbing(self: Arc<Self>) {
        let percent = self.config.scrub_percent;
        let mut due = 0.0_f64;
        while percent > 0 && !self.is_stopping() {
            tokio::select! {
                () = tokio::time::sleep(SHARE_EVERY) => {}
                () = self.stopped() => return,
            }
            let Some(network) = self.network_now() else { continue };
            let Ok(records) = self.blocking(|site| Ok(site.plant.ledger.size()?)).await else { continue };
            #[expect(clippy::cast_precision_loss, reason = "a share of them")]
            let (records, percent) = (records as f64, percent as f64);
            due = (due + records * percent / 100.0 * SHARE_EVERY.as_secs_f64() / 3600.0).min(records);
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "small and not negative")]
            let mut share = due as usize;
            while share > 0 && !self.is_stopping() {
                let (most, network) = (share.min(MOST_AT_ONCE), network.clone());
                let done = self.blocking(move |site| Ok(scrub_round(&site.plant, &network, most)?)).await;
                if let Err(failure) = done {
                    let text = format!("the scrubber waits: {}", failure.message);
                    self.hub.notice(NoticeLevel::Warning, &text);
                    break;
                }
                share -= most;
                #[expect(clippy::cast_precision_loss, reason = "at most a few hundred")]
                let most = most as f64;
                due -= most;
            }
        }
    }
}

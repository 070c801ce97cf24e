//! The audit of records as the site runs it, and the scrubber that does a little of it all the time.

use std::sync::Arc;
use std::time::Duration;

use tokio::runtime::Handle;

use super::Audit;

use crate::model::{ProfileName, Timestamp};
use crate::pipeline::record_audit::{self, RecordAudit, Scope, scrub_round};
use crate::service::event::NoticeLevel;
use crate::service::reply::Failure;
use crate::site::blocking;
use crate::site::reading::view::OwnKeys;

/// How often the scrubber does its share.
const SHARE_EVERY: Duration = Duration::from_secs(5);
/// The most records it checks at once.
const MOST_AT_ONCE: usize = 256;

impl Audit {
    /// Audits all records of the home, for a profile that asks how far it is.
    pub(in crate::site) async fn records(
        self: &Arc<Self>,
        profile: &ProfileName,
        is_pinned: bool,
        deep: bool,
        since: Option<Timestamp>,
    ) -> Result<RecordAudit, Failure> {
        let network = if is_pinned { Some(self.link.network().await) } else { None };
        let runtime = Handle::current();
        let running = self.runs.begin_counted(profile, "this home", "auditing", "records");
        blocking(self, move |audit| {
            let keys = Arc::new(OwnKeys::of(&audit.owners));
            // How many are younger is known when they are read.
            running.run.expect(if since.is_none() { audit.plant.ledger.size()? } else { 0 });
            let (since, looked_at) = (since.unwrap_or_default(), running.run.counter());
            let scope = Scope { deep, since, accounts: audit.owners.accounts(), keys, looked_at };
            let chain = network.as_ref().map(|network| network.as_ref().map_err(|failure| failure.message.clone()));
            Ok(record_audit::audit(&audit.plant, chain, audit.log.lines(), &scope, &runtime)?)
        })
        .await
    }

    /// Re-hashes the share of the stored records set by `audit.scrub`, until the site ends.
    pub(in crate::site) async fn keep_scrubbing(self: Arc<Self>) {
        let percent = self.config.scrub_percent;
        let mut due = 0.0_f64;
        while percent > 0 && !self.life.is_stopping() {
            tokio::select! {
                () = tokio::time::sleep(SHARE_EVERY) => {}
                () = self.life.stopped() => return,
            }
            let Some(network) = self.link.network_now() else { continue };
            let Ok(records) = blocking(&self, |audit| Ok(audit.plant.ledger.size()?)).await else { continue };
            #[expect(clippy::cast_precision_loss, reason = "a share of them")]
            let (records, percent) = (records as f64, percent as f64);
            due = (due + records * percent / 100.0 * SHARE_EVERY.as_secs_f64() / 3600.0).min(records);
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "small and not negative")]
            let mut share = due as usize;
            while share > 0 && !self.life.is_stopping() {
                let (most, network) = (share.min(MOST_AT_ONCE), network.clone());
                let done = blocking(&self, move |audit| Ok(scrub_round(&audit.plant, &network, most)?)).await;
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

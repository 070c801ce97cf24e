//! Retention at work: rules applied, deletions written into the audit log, local copies beside a cache deleted.

use super::Storage;
use std::sync::Arc;
use std::time::Duration;

use crate::model::Timestamp;
use crate::pipeline::Owner;
use crate::pipeline::retention::{Retention, Round};
use crate::service::event::NoticeLevel;
use crate::service::reply::Failure;
use crate::site::blocking;

/// Interval between looks.
const LOOK: Duration = Duration::from_secs(1);
/// Local copies deleted at a time.
const COPIES: usize = 1024;

impl Storage {
    /// Applies the rules until the site ends.
    pub(in crate::site) async fn keep_retention(self: Arc<Self>) {
        let keeping = self.config.keeping();
        let mut retention = Some(Retention::new(keeping.clone()));
        while !self.life.is_stopping() {
            if !self.life.beat(LOOK).await {
                return;
            }
            self.drop_copies().await;
            if keeping.is_empty() {
                continue;
            }
            for owner in self.owners.all() {
                if let Err(failure) = self.apply(&owner, &mut retention).await {
                    let text = format!("retention of {} is waiting: {}", owner.profile, failure.message);
                    self.hub.notice(NoticeLevel::Error, &text);
                }
            }
        }
    }

    async fn apply(self: &Arc<Self>, owner: &Arc<Owner>, retention: &mut Option<Retention>) -> Result<(), Failure> {
        let mut rules = retention.take().unwrap_or_else(|| Retention::new(self.config.keeping()));
        let asked = Arc::clone(owner);
        let (round, rules) = blocking(self, move |storage| {
            let round = rules.round(&storage.plant, &asked);
            Ok((round, rules))
        })
        .await?;
        *retention = Some(rules);
        self.tell(owner, &round?).await
    }

    async fn tell(self: &Arc<Self>, owner: &Owner, round: &Round) -> Result<(), Failure> {
        for (topic, count) in &round.named {
            self.log.write(&owner.profile, "retention", &format!("{topic}: {count} records"), "named").await?;
        }
        if round.deleted > 0 {
            self.log.write(&owner.profile, "retention", &format!("{} records", round.deleted), "deleted").await?;
        }
        Ok(())
    }

    /// Copies of verified records that no rule keeps beside the vault any longer.
    async fn drop_copies(self: &Arc<Self>) {
        let Some(span) = self.config.vault_local.filter(|_| !self.plant.vault.durable()) else { return };
        let age = u64::try_from(span.as_nanos()).unwrap_or(u64::MAX);
        let before = Timestamp(Timestamp::now().0.saturating_sub(age));
        let dropped = blocking(self, move |storage| Ok(storage.plant.ledger.drop_old_copies(before, COPIES)?)).await;
        if let Err(failure) = dropped {
            self.hub.notice(NoticeLevel::Warning, &format!("local copies are kept for now: {}", failure.message));
        }
    }
}

//! Retention at work: rules applied, deletions written into the audit log, local copies beside a cache deleted.

use super::Storage;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use crate::model::Timestamp;
use crate::pipeline::Owner;
use crate::pipeline::retention::{self, Retention, Round};
use crate::service::event::NoticeLevel;
use crate::service::reply::Failure;
use crate::site::blocking;

/// Interval between looks.
const LOOK: Duration = Duration::from_secs(1);
/// Looks after which names are learned anew: what robots bring arrives without those that rules are about.
const LEARN: u32 = 10;
/// Local copies deleted at a time.
const COPIES: usize = 1024;

impl Storage {
    /// Applies the rules until the site ends.
    pub(in crate::site) async fn keep_retention(self: Arc<Self>) {
        let keeping = self.config.keeping();
        let (mut retention, mut looks) = (Some(Retention::new(keeping.clone())), 0u32);
        while !self.life.is_stopping() {
            if !self.life.beat(LOOK).await {
                return;
            }
            self.drop_copies().await;
            let learns = !keeping.is_empty() && looks.is_multiple_of(LEARN);
            looks = looks.wrapping_add(1);
            for owner in self.owners.all() {
                if learns && let Err(failure) = self.reading.learn_own_names(&owner.profile).await {
                    self.hub.notice(NoticeLevel::Warning, &failure.message);
                }
                let applied = match keeping.is_empty() {
                    true => self.sweep(&owner).await,
                    false => self.apply(&owner, &mut retention).await,
                };
                if let Err(failure) = applied {
                    let text = format!("retention of {} is waiting: {}", owner.profile, failure.message);
                    self.hub.notice(NoticeLevel::Error, &text);
                }
            }
            if let Err(failure) = self.sweep_told().await {
                let text =
                    format!("what owners had erased elsewhere is still here, it is tried again: {}", failure.message);
                self.hub.notice(NoticeLevel::Error, &text);
            }
            if let Err(failure) = self.look_for_named().await {
                self.hub.notice(NoticeLevel::Warning, &failure.message);
            }
        }
    }

    /// Without rules only what a person had erased is left to delete, and mostly there is nothing.
    async fn sweep(self: &Arc<Self>, owner: &Arc<Owner>) -> Result<(), Failure> {
        if !self.has_named.load(Ordering::Acquire) {
            return Ok(());
        }
        // Not while an erasure takes over what a rule has named.
        let _one_at_a_time = self.naming.lock().await;
        let asked = Arc::clone(owner);
        let deleted = blocking(self, move |storage| Ok(retention::delete(&storage.plant, &asked)?)).await?;
        self.tell(owner, &Round { deleted, ..Round::default() }).await
    }

    /// What owners whose homes join this gateway had erased, whichever profile is open here.
    async fn sweep_told(self: &Arc<Self>) -> Result<(), Failure> {
        let named = self.plant.ledger.named_elsewhere();
        if self.seen.0.swap(named, Ordering::AcqRel) != named {
            self.has_named.store(true, Ordering::Release);
        }
        if !self.has_named.load(Ordering::Acquire) {
            return Ok(());
        }
        let _one_at_a_time = self.naming.lock().await;
        let held = blocking(self, |storage| {
            retention::delete_told(&storage.plant)?;
            Ok(storage.plant.ledger.held_although_erased()?)
        })
        .await?;
        if self.seen.1.swap(held, Ordering::AcqRel) < held {
            let text = format!(
                "{held} records that their owner had erased elsewhere stay here, because an incident holds them; `authros \
                 incident remove NAME --yes` lets them go"
            );
            self.hub.notice(NoticeLevel::Warning, &text);
        }
        Ok(())
    }

    async fn look_for_named(self: &Arc<Self>) -> Result<(), Failure> {
        if self.has_named.load(Ordering::Acquire) {
            let _one_at_a_time = self.naming.lock().await;
            let left = blocking(self, |storage| Ok(storage.plant.ledger.has_named()?)).await?;
            self.has_named.store(left, Ordering::Release);
        }
        Ok(())
    }

    async fn apply(self: &Arc<Self>, owner: &Arc<Owner>, retention: &mut Option<Retention>) -> Result<(), Failure> {
        let _one_at_a_time = self.naming.lock().await;
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

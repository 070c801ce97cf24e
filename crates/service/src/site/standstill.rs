//! Stages that have work and make no progress are reported and their tasks restarted. A stage that waits for the chain
//! or a key is not judged.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::blocking;
use super::chain::lanes::Lanes;
use super::parts::Parts;
use crate::model::{RecordState, Timestamp};
use crate::pipeline::{Network, Owner};
use crate::service::event::Part;
use crate::service::reply::{HealthLevel, PartHealth, Result};

const LOOK: Duration = Duration::from_secs(10);
/// Part of the health.
pub(super) const PART: &str = "stages";

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Stage {
    Anchorer,
    Watcher,
    Verifier,
}

impl Stage {
    const ALL: [Self; 3] = [Self::Anchorer, Self::Watcher, Self::Verifier];

    /// Name of its tasks, or the beginning of it.
    fn task(self) -> &'static str {
        match self {
            Self::Anchorer => "anchorer",
            Self::Watcher => "watcher",
            Self::Verifier => "verifier",
        }
    }

    fn work(self) -> &'static str {
        match self {
            Self::Anchorer => "records wait to be anchored",
            Self::Watcher => "blocks wait to be read",
            Self::Verifier => "records wait to be verified",
        }
    }

    /// Longest time with work and no progress: many times the need of a busy machine.
    fn patience(self) -> Duration {
        match self {
            Self::Watcher | Self::Verifier => Duration::from_secs(60),
            Self::Anchorer => Duration::from_secs(180),
        }
    }
}

/// Waiting work, and a number that changes with any progress.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Work {
    waiting: u64,
    done: u64,
}

/// One stage's work when it last made progress.
#[derive(Debug, Clone, Copy)]
struct Progress {
    since: Instant,
    work: Work,
    /// When it was found standing, and when its task was last restarted.
    standing: Option<(Timestamp, Instant)>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Found {
    Going,
    /// It stands, and its task must be restarted.
    Restart,
    Standing,
}

#[derive(Debug, Default)]
pub struct Judge(BTreeMap<Stage, Progress>);

impl Judge {
    /// `work` is `None` while the stage waits for somebody else.
    fn look(&mut self, stage: Stage, work: Option<Work>, now: Instant) -> Found {
        let Some(work) = work.filter(|work| work.waiting > 0) else {
            self.0.remove(&stage);
            return Found::Going;
        };
        let begun = Progress { since: now, work, standing: None };
        let known = self.0.entry(stage).or_insert(begun);
        let moved = work.done != known.work.done || work.waiting < known.work.waiting;
        if moved {
            *known = begun;
            return Found::Going;
        }
        known.work = work;
        if now.duration_since(known.since) < stage.patience() {
            return Found::Going;
        }
        match &mut known.standing {
            Some((_, restarted)) if now.duration_since(*restarted) < stage.patience() => Found::Standing,
            Some((_, restarted)) => {
                *restarted = now;
                Found::Restart
            }
            none => {
                *none = Some((Timestamp::now(), now));
                Found::Restart
            }
        }
    }

    /// With since when, and how much waits.
    fn standing(&self) -> impl Iterator<Item = (Stage, Timestamp, u64)> {
        self.0.iter().filter_map(|(stage, progress)| Some((*stage, progress.standing?.0, progress.work.waiting)))
    }
}

pub struct Standstill {
    pub parts: Parts,
    pub lanes: Arc<Lanes>,
    pub judge: Mutex<Judge>,
}

impl Standstill {
    pub async fn keep(self: Arc<Self>) {
        while self.parts.life.beat(LOOK).await {
            let network = self.parts.link.network_now().filter(|_| !self.parts.link.is_silent());
            let blocks = match &network {
                Some(network) => self.unread(network).await,
                None => None,
            };
            let found = blocking(&self, move |stages| stages.work(network.as_ref())).await;
            // Others report an unreadable ledger.
            let Ok(mut works) = found else { continue };
            works.insert(Stage::Watcher, blocks);
            for stage in Stage::ALL {
                self.judge_one(stage, works.get(&stage).copied().flatten());
            }
        }
    }

    /// The stages are another process's now.
    pub fn forget(&self) {
        *self.judge.lock().unwrap_or_else(PoisonError::into_inner) = Judge::default();
    }

    /// Blocks of the chain that the watcher has not read.
    async fn unread(&self, network: &Network) -> Option<Work> {
        let head = network.chain.head().await.ok()?.number;
        let read = *self.parts.link.scans().borrow();
        Some(Work { waiting: head.saturating_sub(read), done: read })
    }

    fn work(&self, network: Option<&Network>) -> Result<BTreeMap<Stage, Option<Work>>> {
        let states = self.parts.plant.ledger.counts.in_each_state()?;
        let of = |state: RecordState| states.get(&state).copied().unwrap_or(0);
        let beyond = |last: RecordState| -> u64 {
            states.iter().filter(|(state, _)| **state > last && **state <= RecordState::Verified).map(|(_, n)| n).sum()
        };
        let checked = network.map(|_| Work {
            waiting: of(RecordState::Confirmed),
            done: of(RecordState::Verified) + of(RecordState::Tampered),
        });
        let anchored = match network {
            // A transaction in flight keeps the next ones waiting.
            Some(network) if of(RecordState::Submitted) == 0 => {
                Some(Work { waiting: self.unbatched(network)?, done: beyond(RecordState::Stored) })
            }
            _ => None,
        };
        Ok([(Stage::Verifier, checked), (Stage::Anchorer, anchored)].into())
    }

    /// Records in no batch that an open owner anchors whose lanes are not paused.
    fn unbatched(&self, network: &Network) -> Result<u64> {
        let owners = self.parts.owners.all();
        let pauses = self.lanes.pauses(network);
        let is_going =
            |owner: &Owner| pauses.iter().any(|(account, pause)| *account == owner.address && pause.is_none());
        let open = owners
            .iter()
            .filter(|owner| !owner.is_locked() && is_going(owner) && network.directory.identity(owner.address).is_ok());
        open.map(|owner| Ok(self.parts.plant.ledger.batches.unbatched(owner.address)?.0)).sum()
    }

    fn judge_one(&self, stage: Stage, work: Option<Work>) {
        let mut judge = self.judge.lock().unwrap_or_else(PoisonError::into_inner);
        let before = judge.standing().any(|(standing, ..)| standing == stage);
        let found = judge.look(stage, work, Instant::now());
        drop(judge);
        match found {
            Found::Restart => {
                self.parts.hub.alarm(&self.text().unwrap_or_default());
                self.parts.supervisor.restart(stage.task(), "it had work but made no progress");
            }
            Found::Going if before => {
                self.parts.hub.inform(&format!("the {} makes progress again", stage.task()));
            }
            Found::Going | Found::Standing => return,
        }
        self.parts.hub.changed(Part::Health);
    }

    fn text(&self) -> Option<String> {
        let judge = self.judge.lock().unwrap_or_else(PoisonError::into_inner);
        let standing: Vec<String> = judge
            .standing()
            .map(|(stage, since, waiting)| {
                format!(
                    "{waiting} {}, and the {} has done nothing since {} UTC",
                    stage.work(),
                    stage.task(),
                    since.clock()
                )
            })
            .collect();
        (!standing.is_empty()).then(|| {
            format!(
                "{}; nothing acknowledged is lost; it is restarted automatically; if that does not help, stop the site, \
                 start it again and report this with its log",
                standing.join("; ")
            )
        })
    }

    pub fn health(&self) -> Option<PartHealth> {
        let since =
            self.judge.lock().unwrap_or_else(PoisonError::into_inner).standing().map(|(_, since, _)| since).min();
        Some(PartHealth { since, ..PartHealth::new(PART, HealthLevel::Failed, &self.text()?) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn work(waiting: u64, done: u64) -> Work {
        Work { waiting, done }
    }

    #[test]
    fn a_stage_with_work_and_without_progress_is_reported_and_restarted_and_no_other_is() {
        let (mut judge, begun) = (Judge::default(), Instant::now());
        let at = |seconds: u64| begun + Duration::from_secs(seconds);
        let mut look = |seconds: u64, work: Work| {
            // Without a chain nothing is known of its work.
            let known = Some(work).filter(|_| seconds != 251);
            let found = judge.look(Stage::Verifier, known, at(seconds));
            (found, judge.standing().count())
        };
        assert_eq!(look(0, work(602, 100)), (Found::Going, 0));
        assert_eq!(look(59, work(900, 100)), (Found::Going, 0), "more came");
        assert_eq!(look(60, work(4_295, 100)), (Found::Restart, 1));
        assert_eq!(look(65, work(4_300, 100)), (Found::Standing, 1));
        assert_eq!(look(120, work(4_300, 100)), (Found::Restart, 1), "and again");
        assert_eq!(look(121, work(4_300, 101)), (Found::Going, 0), "one is enough");
        assert_eq!(look(190, work(4_299, 101)), (Found::Going, 0), "or one less");
        assert_eq!(look(251, work(4_299, 101)), (Found::Going, 0), "the chain is away, which is reported");
        assert_eq!(look(252, work(4_299, 101)), (Found::Going, 0), "the time begins anew");
        assert_eq!(look(311, work(0, 101)), (Found::Going, 0));
        assert_eq!(look(400, work(1, 101)), (Found::Going, 0), "without work nothing stands");
    }
}

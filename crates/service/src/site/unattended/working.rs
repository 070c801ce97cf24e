//! What works while nobody is there: topics are followed, the end is foreseen, records are anchored by an account that can
//! do nothing else. All of it stops where the owner takes over.

use std::collections::BTreeSet;
use std::sync::{Arc, PoisonError};
use std::time::Duration;

use tokio::task::block_in_place;

use super::standing::Reach;
use super::{Unattended, Working};
use crate::model::steady_clock::steady_now;
use crate::model::{AnchorMode, Timestamp};
use crate::pipeline::anchorer::Anchorer;
use crate::pipeline::authority::{Moment, NoRight, SigningRight, may_sign};
use crate::pipeline::{Network, recorder_heads};
use crate::service::event::{NoticeLevel, Part};
use crate::service::reply::Failure;

/// The ends, in words.
pub(super) const LOAN: &str = "the loan of its device ends";
const EPOCH: &str = "the epoch ends with a grant";
/// What to do about it.
const ANOTHER: &str = "write another credential with `authros unattended prepare`";

/// How often to look whether anything has changed.
const LOOK: Duration = Duration::from_secs(1);
/// The shortest pause between two rounds of anchoring, and the first and longest after a failure.
const BETWEEN_ROUNDS: Duration = Duration::from_millis(25);
const PAUSES: (Duration, Duration) = (Duration::from_millis(250), Duration::from_secs(5));
/// How long to wait for a chain.
const WITHOUT_CHAIN: Duration = Duration::from_millis(200);

impl Unattended {
    /// Starts the tasks.
    pub(super) fn work(self: &Arc<Self>) {
        let alone = |part: &Arc<Self>| part.working().is_some_and(|working| !part.is_taken_over(&working.standing));
        self.supervisor.keep_while("unattended", self, alone, Self::keep);
        let anchors = move |part: &Arc<Self>| {
            let alone = alone(part);
            // However its work ended: the owner's anchoring does not wait any longer.
            part.working().iter().filter(|_| !alone).for_each(|working| working.standing.anchored_last());
            alone
        };
        self.supervisor.keep_while("unattended anchorer", self, anchors, Self::anchor);
    }

    async fn keep(self: Arc<Self>) {
        let mut seen = None;
        while self.life.beat(LOOK).await {
            let Some(working) = self.working().filter(|working| !self.is_taken_over(&working.standing)) else { return };
            let stated = block_in_place(|| {
                self.look()?;
                let author = &working.standing.author;
                let Some(keys) = author.sealing().filter(|keys| keys.domain == working.domain) else { return Ok(None) };
                let every = self.config.audit_every;
                Ok::<_, Failure>(recorder_heads::state(&self.plant, author.address, &keys, every, &mut seen)?)
            });
            match stated {
                Ok(None) => {}
                Ok(Some(_)) => self.hub.stored.notify_waiters(),
                Err(failure) => self.hub.notice(NoticeLevel::Error, &failure.message),
            }
        }
    }

    /// Follows what the profile watches for as long as that is possible, and tells when it ends.
    pub(super) fn look(&self) -> Result<(), Failure> {
        let Some(working) = self.working() else { return Ok(()) };
        let standing = &working.standing;
        let _held = standing.hold();
        if self.is_taken_over(standing) {
            return Ok(());
        }
        if standing.note(self.reach_of(&working)?) {
            let level = match standing.reach() {
                Reach::Until(..) => NoticeLevel::Info,
                Reach::Ended(_) => NoticeLevel::Error,
            };
            self.hub.notice(level, &format!("profile '{}' is locked; {}", standing.profile, standing.text()));
            self.hub.changed(Part::Health);
        }
        let goes_on = matches!(standing.reach(), Reach::Until(..));
        let keys = standing.author.sealing().filter(|_| goes_on);
        let mut wanted = self.watches.of(&standing.profile)?;
        wanted.retain(|(topic, _)| keys.as_ref().is_some_and(|keys| keys.topic(topic.as_str()).is_some()));
        let names: BTreeSet<String> = wanted.iter().map(|(topic, _)| topic.to_string()).collect();
        let mut followed = self.followed.lock().unwrap_or_else(PoisonError::into_inner);
        if *followed == names {
            return Ok(());
        }
        for topic in followed.difference(&names) {
            self.recorder.unwatch(topic, &standing.author);
        }
        for (topic, type_name) in wanted.into_iter().filter(|(topic, _)| !followed.contains(topic.as_str())) {
            self.recorder.watch(topic.as_str(), &standing.author, type_name);
        }
        *followed = names;
        drop(followed);
        self.ros.wishes_changed();
        self.hub.changed(Part::Topics);
        Ok(())
    }

    /// Until when it can go on: the end of the loan or of the epoch, whichever comes first.
    fn reach_of(&self, working: &Working) -> Result<Reach, Failure> {
        let author = &working.standing.author;
        let Some(keys) = author.sealing() else {
            return Ok(Reach::Ended(
                "the epoch of its keys is over, because a grant has ended; unlock the profile, which begins the next one"
                    .to_owned(),
            ));
        };
        let loan = match self.loan_of(working)? {
            Ok(until) => until,
            Err(why) => return Ok(Reach::Ended(why)),
        };
        // Keys of a later epoch that are known already take their turn.
        let ends = author.next().map_or(keys.ends, |(_, next)| next.ends);
        Ok(match ends.filter(|ends| *ends < loan) {
            Some(ends) => Reach::Until(ends, EPOCH),
            None => Reach::Until(loan, LOAN),
        })
    }

    /// When the loan ends, by the chain if that is known; otherwise why there is none.
    fn loan_of(&self, working: &Working) -> Result<Result<Timestamp, String>, Failure> {
        let standing = &working.standing;
        let network = self.link.network_now().filter(|network| network.domain == working.domain);
        if let Some(Network { directory, .. }) = network {
            match may_sign(&directory, standing.author.address, standing.device, Moment::newest(directory.now())) {
                Ok(SigningRight::Device(lending)) => return Ok(Ok(lending.until.unwrap_or(Timestamp(u64::MAX)))),
                // The chain was not read that far yet.
                Ok(SigningRight::Owner(_))
                | Err(NoRight::Unregistered { .. } | NoRight::Unknown { .. } | NoRight::LentLater { .. }) => {}
                Err(
                    why @ (NoRight::Unproven { .. }
                    | NoRight::Suspended { .. }
                    | NoRight::Succeeded { .. }
                    | NoRight::Replaced { .. }
                    | NoRight::Recalled { .. }
                    | NoRight::Ended { .. }
                    | NoRight::KeyUnknown { .. }),
                ) => return Ok(Err(format!("{why}; {ANOTHER}"))),
            }
        }
        if self.enrolments.was_recalled(standing.author.address, standing.device)? {
            return Ok(Err(format!("its device was recalled; {ANOTHER}")));
        }
        if working.until <= steady_now() {
            return Ok(Err(format!("the loan of its device ended at {}; {ANOTHER}", working.until)));
        }
        Ok(Ok(working.until))
    }

    async fn anchor(self: Arc<Self>) {
        let (mut anchorer, mut pause) = (Anchorer::new(AnchorMode::Batch), PAUSES.0);
        let mut scanned = self.link.scans();
        while !self.life.is_stopping() {
            let Some(working) = self.working() else { return };
            if self.is_taken_over(&working.standing) {
                // What is on its way is finished by the owner's own lanes.
                working.standing.anchored_last();
                return;
            }
            let network = self.link.network_now().filter(|network| network.domain == working.domain);
            let Some(network) = network else {
                tokio::time::sleep(WITHOUT_CHAIN).await;
                continue;
            };
            // What is stored while this round looks is not missed.
            let stored = self.hub.stored.notified();
            let (owner, lanes) = (working.standing.author.address, [working.witness.clone()]);
            match anchorer.round(&self.plant, &network, &self.sender, owner, &lanes).await {
                Ok(round) => {
                    pause = PAUSES.0;
                    if round.submitted > 0 {
                        self.hub.changed(Part::Uploads);
                    }
                    let rest = round.next.min(BETWEEN_ROUNDS);
                    tokio::time::sleep(rest).await;
                    tokio::select! {
                        () = stored => {}
                        _ = scanned.changed() => {}
                        () = tokio::time::sleep(round.next.saturating_sub(rest)) => {}
                    }
                }
                Err(error) => {
                    let profile = &working.standing.profile;
                    let text = format!("records of {profile} are waiting to be anchored: {error}");
                    self.hub.notice(NoticeLevel::Error, &text);
                    tokio::time::sleep(pause).await;
                    pause = (pause * 2).min(PAUSES.1);
                }
            }
        }
    }

    /// Maintains the lane of the account that anchors: after each block, and while none comes.
    pub(in crate::site) async fn tend(&self, network: &Network) {
        let Some(working) = self.working().filter(|working| !self.is_taken_over(&working.standing)) else { return };
        match self.sender.tend(&network.chain, &working.witness).await {
            Ok(reasons) => {
                for reason in reasons {
                    let text = format!(
                        "the contract rejected an unattended transaction of {}: {reason}",
                        working.standing.profile
                    );
                    self.hub.notice(NoticeLevel::Error, &text);
                }
            }
            Err(error) => {
                let text = format!("unattended transactions of {} are waiting: {error}", working.standing.profile);
                self.hub.notice(NoticeLevel::Error, &text);
            }
        }
    }
}

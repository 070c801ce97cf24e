//! Reports the owner's erasures to the joined gateway, which overwrites its copies, with the owner's statement under
//! both keys.

use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use super::Broken;
use crate::gateway::command::MOST_ERASURES;
use crate::gateway::{Client, Code, ErasureNotice, ErasureOutcome, GatewayError};
use crate::model::{Address, Digest, PublicKey, clean, counted, hex};
use crate::pipeline::retention::{self, is_owners, notice_of};
use crate::pipeline::{Network, Owner, PipelineError};
use crate::reply::{ErasureView, Result};
use crate::site::{Joined, Remote};
use crate::store::notes::ErasuresTold;

/// How often everything is reported again: a gateway may have been restored from a backup.
const WHOLE: Duration = Duration::from_secs(3600);
/// The same after a gateway left something that it may take later.
const SOON: Duration = Duration::from_secs(60);
/// Pages reported before anything else gets a turn.
const MOST_PAGES: usize = 8;

/// Progress over all sessions with the gateway.
#[derive(Debug, Default)]
pub(super) struct OwnErasures {
    after: u64,
    /// Numbers after this were never reported.
    known: Option<u64>,
    begun: Option<Instant>,
    at_end: bool,
    left: bool,
    /// The key under which all of it is stated.
    stated_under: Option<PublicKey>,
    will: Will,
}

/// A gateway that no longer serves the owner takes none of it.
#[derive(Debug, Default, PartialEq, Eq)]
enum Will {
    #[default]
    Unknown,
    /// In this session; already reported.
    Refuses,
    /// In an earlier session.
    Refused,
}

#[derive(Debug, Default, PartialEq, Eq)]
struct Told {
    taken: u64,
    left: u64,
    refused: u64,
}

impl Told {
    fn of(outcomes: &[ErasureOutcome]) -> Self {
        let count = |wanted| outcomes.iter().filter(|outcome| **outcome == wanted).count() as u64;
        Self {
            taken: count(ErasureOutcome::Taken),
            left: count(ErasureOutcome::Left),
            refused: count(ErasureOutcome::Refused),
        }
    }
}

impl OwnErasures {
    /// A new session may serve the owner again.
    pub fn connected(&mut self) {
        if self.will == Will::Refuses {
            self.will = Will::Refused;
        }
    }

    fn begin(&mut self, now: Instant) {
        let pause = if self.left { SOON } else { WHOLE };
        if self.begun.is_some_and(|begun| self.at_end && now.duration_since(begun) >= pause) {
            (self.after, self.left, self.begun) = (0, false, None);
        }
        if self.begun.is_none() {
            (self.begun, self.at_end) = (Some(now), false);
        }
    }

    /// The place behind which nothing was reported, as of the last run.
    fn load(&mut self, joined: &Joined, note: &ErasuresTold) -> Result<u64> {
        if let Some(known) = self.known {
            return Ok(known);
        }
        let known = joined.parts.plant.ledger.notes.read(note)?.unwrap_or(0);
        (self.known, self.after) = (Some(known), known);
        Ok(known)
    }
}

impl Joined {
    /// Reports what is new to the gateway, and everything again from time to time.
    pub(super) async fn tell_erasures(
        &self,
        client: &mut Client,
        (remote, owner, network): (&Remote, &Owner, &Network),
        told: &mut OwnErasures,
    ) -> Result<(), Broken> {
        if told.will == Will::Refuses || !self.stated(owner, network, told)? {
            return Ok(());
        }
        let keeper = remote.keeper(network)?;
        // Numbers are the ledger's own: a restored home counts anew.
        let ledger = hex(self.parts.plant.ledger.records.recorder().as_bytes());
        let note = ErasuresTold { domain: network.domain, ledger, keeper, owner: owner.address };
        let mut known = told.load(self, &note)?;
        told.begin(Instant::now());
        for _ in 0..MOST_PAGES {
            let page = self.parts.plant.ledger.erasures.list(told.after, MOST_ERASURES).map_err(PipelineError::from)?;
            let records = block_in_place(|| self.own(owner.address, network, &page.erasures))?;
            let Some(outcome) = self.tell_some(client, remote, records, &mut told.will).await? else { return Ok(()) };
            told.left |= outcome.left > 0;
            let Some(last) = page.last else {
                told.at_end = true;
                return Ok(());
            };
            if last > known {
                self.note(remote, owner, &outcome).await;
                (known, told.known, told.will) = (last, Some(last), Will::Unknown);
                if !told.left {
                    let kept = self.parts.plant.ledger.notes.write(&note, &last);
                    kept.map_err(PipelineError::from)?;
                }
            }
            (told.after, told.at_end) = (last, !page.more);
            if !page.more {
                return Ok(());
            }
        }
        Ok(())
    }

    /// Reports one page; `None` if the gateway takes none of it in this session.
    async fn tell_some(
        &self,
        client: &mut Client,
        remote: &Remote,
        records: Vec<ErasureNotice>,
        will: &mut Will,
    ) -> Result<Option<Told>, Broken> {
        if records.is_empty() {
            return Ok(Some(Told::default()));
        }
        let count = records.len();
        match client.erase(records).await {
            Ok(outcomes) => Ok(Some(Told::of(&outcomes))),
            Err(GatewayError::Refused(code)) if code != Code::Stale => {
                if std::mem::replace(will, Will::Refuses) == Will::Unknown {
                    self.warn_of_copies(remote, code, count);
                }
                Ok(None)
            }
            Err(error) => Err(error.into()),
        }
    }

    /// Once per key of the owner, restates erasures stated under an earlier key or without the account. Returns whether
    /// all are stated.
    fn stated(&self, owner: &Owner, network: &Network, told: &mut OwnErasures) -> Result<bool, PipelineError> {
        let keys = owner.sealing().filter(|keys| is_owners(network, owner.address, &keys.signing.public));
        let Some(keys) = keys else { return Ok(false) };
        if told.stated_under == Some(keys.signing.public) {
            return Ok(true);
        }
        let done = block_in_place(|| retention::restate(&self.parts.plant, owner, &keys.signing))?;
        told.stated_under = done.then_some(keys.signing.public);
        Ok(done)
    }

    fn own(
        &self,
        owner: Address,
        network: &Network,
        erasures: &[(Digest, Vec<u8>, Vec<u8>)],
    ) -> Result<Vec<ErasureNotice>, PipelineError> {
        let mut own = Vec::with_capacity(erasures.len());
        for (digest, statement, account) in erasures {
            let one = notice_of(&self.parts.plant, network, (*digest, statement, account))?;
            own.extend(one.filter(|one| one.is_of(owner)));
        }
        Ok(own)
    }

    async fn note(&self, remote: &Remote, owner: &Owner, outcome: &Told) {
        let address = remote.address();
        let Told { taken, left, refused } = outcome;
        if *taken > 0 {
            let (subject, heard) = (counted(*taken, "record"), format!("the gateway {address} erases its copies"));
            if let Err(failure) = self.parts.log.write(&owner.profile, "erase elsewhere", &subject, &heard).await {
                self.parts.hub.warn(&failure.message);
            }
        }
        if left + refused > 0 {
            self.parts.hub.warn(&format!(
                "the gateway {address} keeps its copies of {} that '{}' had erased: it may erase {left} later \
                 and is asked again, and refuses to erase {refused}",
                counted(left + refused, "record"),
                owner.profile
            ));
        }
    }

    fn warn_of_copies(&self, remote: &Remote, code: Code, count: usize) {
        let (address, why) = (remote.address(), clean(&GatewayError::Refused(code).to_string(), 300));
        let text = format!("the gateway {address} was notified of the erasure but keeps its copies ({count}): {why}");
        self.parts.hub.warn(&text);
    }

    /// Names the gateway among what an erasure does not reach.
    pub fn names_who_is_told(&self, mut view: ErasureView) -> ErasureView {
        if let (Some(remote), Some(copies)) = (&self.remote, view.stays.first_mut()) {
            *copies = format!("copies that readers have fetched; the gateway {} erases its own", remote.address());
        }
        view
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_is_told_again_after_an_hour_and_soon_where_something_was_left() {
        let now = Instant::now();
        let mut told = OwnErasures { after: 7, at_end: true, begun: Some(now), ..OwnErasures::default() };
        told.begin(now + WHOLE / 2);
        assert_eq!((told.after, told.at_end), (7, true), "what is new is told from there");
        told.begin(now + WHOLE);
        assert_eq!((told.after, told.at_end), (0, false));
        (told.after, told.at_end, told.left) = (7, true, true);
        told.begin(now + WHOLE + SOON / 2);
        assert_eq!(told.after, 7);
        told.begin(now + WHOLE + SOON);
        assert_eq!((told.after, told.left), (0, false));
        told.after = 3;
        told.begin(now + WHOLE * 9);
        assert_eq!(told.after, 3, "not while it is being told");
    }

    #[test]
    fn outcomes_are_counted() {
        use ErasureOutcome::{Left, Refused, Taken};
        let expected = Told { taken: 2, left: 1, refused: 1 };
        assert_eq!(Told::of(&[Taken, Left, Refused, Taken]), expected);
    }
}

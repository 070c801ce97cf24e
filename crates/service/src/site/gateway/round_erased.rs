//! The part of a round about what was erased at the other gateway: read on from where the last round ended, bounded like the
//! rest, and from the beginning now and then. It comes first, so that nobody takes bytes that were erased meanwhile.

use std::time::{Duration, Instant};

use super::round::{Ended, Here, Other, Round, is_a_lie};
use super::visit::{MOST_PAGES, MOST_REFUSED};
use crate::gateway::{ErasurePlace, GatewayError, Refusal};

/// How often all of it is read again: statements under an owner's new key are told anew, others may come to hold again.
const WHOLE: Duration = Duration::from_secs(3600);
/// The same after something was left that may be taken later.
const SOON: Duration = Duration::from_secs(600);
/// After so many rounds an anchor that the chain here does not have is passed over.
const MOST_WAITS: u32 = 60;

/// What became of records that were erased there.
#[derive(Debug, Default)]
pub(super) struct TookErased {
    /// How many may be taken another time.
    pub left: u64,
    /// Whether the chain here does not have the block of an anchor yet; what followed was not looked at.
    pub waits: bool,
    /// Why others are not taken.
    pub refused: Vec<Refusal>,
}

/// How far what was erased at a gateway was read.
#[derive(Debug, Default)]
pub(super) struct ErasureCourse {
    after: ErasurePlace,
    begun: Option<Instant>,
    at_end: bool,
    left: bool,
    waits: u32,
    /// It is of an earlier version, and says so once in a session.
    silent: bool,
}

impl ErasureCourse {
    /// Another session has begun: perhaps with a later version.
    pub fn connected(&mut self) {
        self.silent = false;
    }

    fn begin(&mut self, now: Instant) {
        let pause = if self.left { SOON } else { WHOLE };
        if self.begun.is_none_or(|begun| self.at_end && now.duration_since(begun) >= pause) {
            let silent = self.silent;
            *self = Self { begun: Some(now), silent, ..Self::default() };
        }
    }
}

/// Reads on; what was done is in `round` even if it ends early.
///
/// # Errors
/// [`Ended`].
pub(super) async fn read_erasures(
    other: &mut impl Other,
    here: &impl Here,
    course: &mut ErasureCourse,
    round: &mut Round,
) -> Result<(), Ended> {
    if course.silent {
        return Ok(());
    }
    course.begin(Instant::now());
    let (mut refusals, mut anew) = (MOST_REFUSED, false);
    for _ in 0..MOST_PAGES {
        let page = match other.erasures(course.after).await {
            Ok(Some(page)) => page,
            Ok(None) => {
                course.silent = true;
                return Ok(());
            }
            // Whether it tells what it holds does not depend on it, and what it refuses of both is told of that.
            Err(GatewayError::Refused(_)) => return Ok(()),
            Err(error) => return Err(error.into()),
        };
        let (same, number) = (page.next.ledger == course.after.ledger, page.next.number);
        let stands = page.more && number == course.after.number || number < course.after.number;
        if same && stands || !same && std::mem::replace(&mut anew, true) {
            return Err(Ended::Lies("its list of what was erased does not advance".to_owned()));
        }
        let patient = course.waits < MOST_WAITS;
        let took = here.erase(page.told, patient, round).await.map_err(Ended::Here)?;
        for refusal in took.refused {
            *round.refused.entry(refusal.code).or_default() += 1;
            if is_a_lie(refusal.code) {
                refusals -= 1;
            }
            if refusals == 0 {
                let why =
                    format!("{MOST_REFUSED} of the records it says were erased do not hold, the last one: {refusal}");
                return Err(Ended::Lies(why));
            }
        }
        if took.waits {
            // The same part is told again; what was taken of it is known by then.
            course.waits += 1;
            return Ok(());
        }
        course.left |= took.left > 0;
        (course.after, course.waits, course.at_end) = (page.next, 0, !page.more);
        if !page.more {
            return Ok(());
        }
    }
    round.more = true;
    Ok(())
}

#[cfg(test)]
#[path = "round_erased_tests.rs"]
mod tests;

//! Patience with a gateway's list, which may bring nothing for as long as that gateway likes: its pages are asked for ever more
//! slowly, and not without end.

use std::time::Duration;

use crate::gateway::GatewayError;

/// Pages in a row without anything new that are asked for one after the other: what another gateway gave before, or what was
/// listed a moment ago.
const FREE: usize = 100;
/// The pause before each further one.
const PAUSE: Duration = Duration::from_millis(10);
/// The most of them: ten million records.
const MOST: usize = 20_000;
/// The most pages in a row without any entry. Ours have one, unless they are the last.
const MOST_EMPTY: usize = 16;

/// Counts the pages of one list that bring nothing.
#[derive(Debug, Default)]
pub(super) struct Patience {
    idle: usize,
    empty: usize,
}

impl Patience {
    /// How long to wait before the page after one with so many entries, of which something was `new`.
    ///
    /// # Errors
    /// The list is not going to end.
    pub fn after(&mut self, entries: usize, new: bool) -> Result<Duration, GatewayError> {
        self.idle = if new { 0 } else { self.idle + 1 };
        self.empty = if entries > 0 { 0 } else { self.empty + 1 };
        if self.empty > MOST_EMPTY || self.idle > MOST {
            return Err(GatewayError::Unexpected("a list that goes on and brings nothing"));
        }
        Ok(if self.idle > FREE { PAUSE } else { Duration::ZERO })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_known_already_is_read_through_slowly_and_what_brings_nothing_ends() {
        let mut patience = Patience::default();
        let pauses: Vec<_> = (0..MOST).map(|_| patience.after(500, false).ok()).collect();
        assert!(pauses.iter().take(FREE).all(|pause| *pause == Some(Duration::ZERO)));
        assert!(pauses.iter().skip(FREE).all(|pause| *pause == Some(PAUSE)));
        assert!(patience.after(1, true).is_ok_and(|pause| pause.is_zero()), "something came");
        let known = (0..=MOST).find(|_| patience.after(1, false).is_err());
        assert_eq!(known, Some(MOST));

        let mut patience = Patience::default();
        let empty = (0..MOST).find(|_| patience.after(0, false).is_err());
        assert_eq!(empty, Some(MOST_EMPTY));
    }
}

//! Patience with a gateway's list, which may bring nothing for as long as that gateway likes: its pages are asked for ever more
//! slowly. A list of what is here already may be long and honest; one of empty pages is not.

use std::time::Duration;

use crate::gateway::GatewayError;

/// Pauses before the next page, by how many in a row brought nothing new: what another gateway gave before, or what was listed
/// a day ago. A page has 500 records.
const PAUSES: [(usize, Duration); 2] = [(10_000, Duration::from_millis(100)), (100, Duration::from_millis(10))];
/// The most pages in a row without any entry. Ours have one, unless they are the last.
const MOST_EMPTY: usize = 16;

/// Counts the pages of one list that bring nothing.
#[derive(Debug, Default)]
pub(super) struct Patience {
    idle: usize,
    empty: usize,
}

impl Patience {
    /// How long to wait, if at all, before the page after one with so many entries, of which something was `new`.
    ///
    /// # Errors
    /// One empty page follows another.
    pub fn after(&mut self, entries: usize, new: bool) -> Result<Option<Duration>, GatewayError> {
        self.idle = if new { 0 } else { self.idle + 1 };
        self.empty = if entries > 0 { 0 } else { self.empty + 1 };
        if self.empty > MOST_EMPTY {
            return Err(GatewayError::Unexpected("a list that goes on and brings nothing"));
        }
        Ok(PAUSES.iter().find(|(pages, _)| self.idle > *pages).map(|(_, pause)| *pause))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used, reason = "a test fails by panicking")]

    use super::*;

    #[test]
    fn what_is_known_already_is_read_through_slowly_and_empty_pages_end() {
        let mut patience = Patience::default();
        let mut after = |_| patience.after(500, false).expect("it may be honest").map_or(0, |pause| pause.as_millis());
        let pauses: Vec<u128> = (0..30_000).map(&mut after).collect();
        assert_eq!([99, 100, 9_999, 10_000, 29_999].map(|page| pauses[page]), [0, 10, 10, 100, 100]);
        assert!(patience.after(1, true).is_ok_and(|pause| pause.is_none()), "something came");
        let empty = (0..100).find(|_| patience.after(0, false).is_err());
        assert_eq!(empty, Some(MOST_EMPTY));
    }
}

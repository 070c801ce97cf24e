//! How far the list of an owner's records was read at a gateway, durably.

use tokio::task::block_in_place;

use crate::model::{Address, Hash, Timestamp};
use crate::pipeline::mirror::Mirror;
use crate::service::reply::Failure;
use crate::store::Ledger;

/// How far before the newest record seen a listing begins: outboxes of robots may be hours old.
const LATE: u64 = 24 * 3600;
/// How often a listing starts from the very beginning.
const WHOLE: u64 = 24 * 3600;

/// The position of an owner's mirror: capture times in seconds.
pub(super) struct Place {
    name: String,
    /// Of the newest record that was listed.
    pub newest: u64,
    /// When a listing that began at the very beginning was done.
    whole: u64,
    /// The beginning of the hash of the grant's transaction.
    grant: u64,
}

impl Place {
    /// The one of this grant, zero for the reader's own records.
    ///
    /// # Errors
    /// Errors of the ledger.
    pub fn load(ledger: &Ledger, mirror: &Mirror<'_>, (source, grant): (Address, &Hash)) -> Result<Self, Failure> {
        let (domain, me, keeper) = (mirror.network.domain, mirror.reader.address, mirror.keeper);
        let name = format!("mirror:{domain}:{keeper}:{me}:{source}");
        let text = block_in_place(|| ledger.setting(&name))?.unwrap_or_default();
        let grant = grant.0.first_chunk().map_or(0, |first| u64::from_be_bytes(*first));
        Ok(Self::read(name, &text, grant))
    }

    /// Another grant than the one that was listed for begins anew: it may cover more topics and earlier epochs.
    fn read(name: String, text: &str, grant: u64) -> Self {
        let mut numbers = text.split(' ').map(|text| text.parse().unwrap_or(0));
        let mut next = || numbers.next().unwrap_or(0);
        let (newest, whole, listed) = (next(), next(), next());
        let (newest, whole) = if listed == grant { (newest, whole) } else { (0, 0) };
        Self { name, newest, whole, grant }
    }

    fn text(&self) -> String {
        format!("{} {} {}", self.newest, self.whole, self.grant)
    }

    /// Where the next listing begins: a day before the newest record seen, and now and then at the beginning.
    pub fn begin(&self, now: Timestamp) -> u64 {
        let due = now.seconds().saturating_sub(self.whole) >= WHOLE;
        if due { 0 } else { self.newest.saturating_sub(LATE) }
    }

    /// A listing from there was done; a record from the future does not move the place beyond now.
    pub fn listed(mut self, begin: u64, now: Timestamp) -> Self {
        self.newest = self.newest.min(now.seconds());
        if begin == 0 {
            self.whole = now.seconds();
        }
        self
    }

    /// Stores it.
    ///
    /// # Errors
    /// Errors of the ledger.
    pub fn save(&self, ledger: &Ledger) -> Result<(), Failure> {
        Ok(block_in_place(|| ledger.put_setting(&self.name, &self.text()))?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: u64 = 2_000_000_000;

    fn begin(text: &str, grant: u64) -> u64 {
        Place::read("mirror".to_owned(), text, grant).begin(Timestamp::from_seconds(NOW))
    }

    #[test]
    fn a_listing_goes_on_a_day_before_its_end_and_begins_anew_each_day_and_for_another_grant() {
        let place = Place { name: "mirror".to_owned(), newest: NOW + 60, whole: 0, grant: 7 };
        let listed = place.listed(0, Timestamp::from_seconds(NOW - 60)).text();
        assert_eq!(begin(&listed, 7), NOW - 60 - LATE);
        assert_eq!(begin(&listed, 8), 0, "it may cover what the earlier one did not");
        assert_eq!(begin(&format!("{} {} 7", NOW - 60, NOW - WHOLE), 7), 0);
        for unknown in ["", "x", "1 2 3 4", "-1 99999999999999999999 7"] {
            assert_eq!(begin(unknown, 7), 0);
        }
    }

    #[test]
    fn what_an_earlier_version_wrote_counts_for_own_records_alone() {
        let earlier = format!("{} {}", NOW - 60, NOW - 3600);
        assert_eq!((begin(&earlier, 0), begin(&earlier, 7)), (NOW - 60 - LATE, 0));
    }
}

//! The comparison as it is told: with addresses, names and ranges, of which there is a limit.

use std::collections::BTreeMap;

use super::listing::Listed;
use super::remotes::Remotes;
use crate::model::{Address, Ranges, TopicId, clean};
use crate::pipeline::mirror::lacking::{Compared, Lack, Series};
use crate::service::reply::{Failure, GatewayHoldings, GatewaysView, HoleView, LackView, UntoldView};
use crate::store::RecordRow;

/// The most ranges told in all.
const MOST_RANGES: usize = 100_000;

/// Names that this home has.
pub(super) struct Named<'a> {
    /// Of accounts.
    pub owners: &'a BTreeMap<Address, String>,
    /// Of topics.
    pub topics: &'a BTreeMap<(Address, TopicId), String>,
}

impl Named<'_> {
    fn owner(&self, owner: Address) -> Option<String> {
        self.owners.get(&owner).cloned()
    }

    fn topic(&self, series: Series) -> String {
        let name = self.topics.get(&(series.owner, series.topic_id));
        name.map_or_else(|| RecordRow::unnamed(series.topic_id), |name| clean(name, 255))
    }
}

/// How many ranges may still be told, and how many were not.
struct Room {
    left: usize,
    left_out: u64,
}

impl Room {
    /// As many of these ranges as there is room for; `None` if there is none at all.
    fn take(&mut self, numbers: &Ranges) -> Option<Vec<(u64, u64)>> {
        let ranges: Vec<(u64, u64)> = numbers.iter().take(self.left).collect();
        self.left -= ranges.len();
        self.left_out += (numbers.iter().len() - ranges.len()) as u64;
        (!ranges.is_empty()).then_some(ranges)
    }
}

/// What was found, for people and programs.
pub(super) fn view(
    remotes: &Remotes,
    told: &BTreeMap<usize, Result<Listed, Failure>>,
    found: &Compared,
    copies: Option<u32>,
    named: &Named<'_>,
) -> GatewaysView {
    let asked = told.values().filter(|one| one.is_ok()).count();
    let copies = copies.map_or(asked, |copies| usize::try_from(copies).unwrap_or(usize::MAX).min(asked));
    let mut room = Room { left: MOST_RANGES, left_out: 0 };
    let mut gateways = Vec::with_capacity(told.len());
    for (place, remote) in remotes.all().iter().enumerate() {
        let lacks = found.lacking.get(place).map(Vec::as_slice).unwrap_or_default();
        let (mut problem, mut untold, mut records, mut verified) = (None, Vec::new(), 0, 0);
        match told.get(&place) {
            Some(Ok(listed)) => {
                let numbers = || listed.listing.series.values();
                records = numbers().map(|one| one.held.count()).sum();
                verified = numbers().map(|one| one.verified.count()).sum();
                untold = listed.untold.iter().map(|(owner, failure)| untold_of(*owner, failure, named)).collect();
            }
            Some(Err(failure)) => problem = Some(failure.message.clone()),
            None => {}
        }
        gateways.push(GatewayHoldings {
            address: clean(remote.address(), 255),
            key: remote.key(),
            problem,
            untold,
            records,
            verified,
            lacking: lacks.iter().map(|lack| lack.numbers.count()).sum(),
            waiting: found.waiting.get(place).copied().unwrap_or_default(),
            lacks: lacks.iter().filter_map(|lack| lack_of(lack, remotes, named, &mut room)).collect(),
        });
    }
    let short = found.short_of(copies);
    let nowhere = found.nowhere.iter().map(|(_, numbers)| numbers.count()).sum();
    let all = gateways.iter().all(|one| one.problem.is_none() && one.untold.is_empty());
    let holes =
        found.nowhere.iter().filter_map(|(series, numbers)| hole_of(*series, numbers, named, &mut room)).collect();
    let ok = all && short == 0 && nowhere == 0;
    GatewaysView { ok, copies: copies as u64, short, nowhere, gateways, holes, left_out: room.left_out }
}

fn untold_of(owner: Address, failure: &Failure, named: &Named<'_>) -> UntoldView {
    UntoldView { owner, owner_name: named.owner(owner), problem: failure.message.clone() }
}

fn lack_of(lack: &Lack, remotes: &Remotes, named: &Named<'_>, room: &mut Room) -> Option<LackView> {
    let address = |place: &usize| remotes.all().get(*place).map(|remote| clean(remote.address(), 255));
    let ranges = room.take(&lack.numbers)?;
    Some(LackView {
        owner: lack.series.owner,
        owner_name: named.owner(lack.series.owner),
        topic: named.topic(lack.series),
        topic_id: lack.series.topic_id,
        recorder: lack.series.recorder,
        records: lack.numbers.count(),
        ranges,
        held_by: lack.holders.iter().filter_map(address).collect(),
        here: lack.is_here,
    })
}

fn hole_of(series: Series, numbers: &Ranges, named: &Named<'_>, room: &mut Room) -> Option<HoleView> {
    let ranges = room.take(numbers)?;
    Some(HoleView {
        owner: series.owner,
        owner_name: named.owner(series.owner),
        topic: named.topic(series),
        topic_id: series.topic_id,
        recorder: series.recorder,
        numbers: numbers.count(),
        ranges,
    })
}

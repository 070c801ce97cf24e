//! What each gateway that this site joins lacks: asked of all of them, compared with one another and with this home.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use tokio::task::JoinSet;

use super::Joined;
use super::listing::{Asking, Listed, Wanted};
use super::remotes::{FIRST_ROUND, Remotes};
use super::telling::{Named, view};
use crate::model::{Address, Digest, Party, Ranges, TopicId, TopicName};
use crate::pipeline::mirror::lacking::{Compared, Here, Listing, Numbers, Series, compare};
use crate::pipeline::mirror::sources;
use crate::pipeline::reader::Reader;
use crate::pipeline::retention::erasing::is_stated;
use crate::pipeline::{Network, Owner};
use crate::service::failure::{input, internal, refused};
use crate::service::reply::{Failure, GatewaysView};
use crate::site::blocking;
use crate::site::contacts::Contacts;
use crate::site::reading::Reading;
use crate::store::{HeldNumbers, RecordRow};

/// How long after its first list a gateway that lacks something is asked once more: others take what is verified within
/// a second or two.
const AGAIN: Duration = Duration::from_secs(3);
/// The most deleted records whose statements are checked; of more it is told that they are lacking.
const MOST_STATEMENTS: usize = 100_000;

/// What is to be compared.
pub(in crate::site) struct Wishes {
    /// Only records of this owner.
    pub owner: Option<Party>,
    /// Only of this topic.
    pub topic: Option<TopicName>,
    /// At how many gateways each record is to be; `None` = at all.
    pub copies: Option<u32>,
}

/// What this home has of the owners that are asked for.
#[derive(Default)]
struct Home {
    here: Here,
    /// Deleted records, of which nothing is proven yet.
    deleted: BTreeMap<Series, Vec<(u64, Digest)>>,
    names: BTreeMap<(Address, TopicId), String>,
}

impl Joined {
    /// What each gateway lacks.
    ///
    /// # Errors
    /// If this site joins none, none of them tells anything, or nobody shares what was asked for.
    pub(in crate::site) async fn compared(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        (reading, contacts): (&Arc<Reading>, &Arc<Contacts>),
        wishes: Wishes,
    ) -> Result<GatewaysView, Failure> {
        let Some(remotes) = self.remotes.clone() else {
            let why = "this home joins no gateway, so there is none to ask; name one with --site HOST:PORT and --gateway-key \
                       KEY. The keeper of a gateway asks `authros fleet status`";
            return Err(input(why));
        };
        let network = self.link.network().await?;
        network.directory.identity(owner.address)?;
        // Two sessions at once would each allocate a transport key where there is none yet.
        let settled = async {
            for remote in remotes.all() {
                drop(Remotes::settled(remote, &owner.profile).await);
            }
        };
        drop(tokio::time::timeout(FIRST_ROUND, settled).await);

        let only = wishes.owner.as_ref().map(|party| contacts.resolve(party)).transpose()?;
        let reader = Reader { plant: &self.plant, network: &network, reader: owner };
        let mut wanted = Vec::new();
        for source in sources(&network, owner).into_keys().filter(|source| only.is_none_or(|only| only == *source)) {
            let Some(scope) = reader.scope(source) else { continue };
            reading.learn_names(&reader, source).await?;
            wanted.push(Wanted { owner: source, scope, topics: None });
        }
        if wanted.is_empty() {
            let whose = only.map_or_else(|| "nobody shares".to_owned(), |only| format!("{only} does not share"));
            let text = format!("{whose} records with '{}' now; `authros grants list` shows who does", owner.profile);
            return Err(refused(text));
        }
        let home = self.home_of(owner, &network, &mut wanted, wishes.topic.as_ref()).await?;
        let asking = Asking { owner: Arc::clone(owner), network, wanted };
        let every: Vec<usize> = (0..remotes.all().len()).collect();
        let mut told = self.ask(&remotes, &every, &asking).await;
        if let Some(Err(failure)) = told.values().find(|one| one.is_err())
            && told.values().all(Result::is_err)
        {
            return Err(failure.clone());
        }
        let (found, home) = self.settle(&remotes, &mut told, home, &asking).await?;
        let names = contacts.names();
        let named = Named { owners: &names, topics: &home.names };
        Ok(view(&remotes, &told, &found, wishes.copies, &named))
    }

    /// Compares; what seems to be lacking is asked for once more, and what was deleted with a proof is not lacking.
    async fn settle(
        self: &Arc<Self>,
        remotes: &Arc<Remotes>,
        told: &mut BTreeMap<usize, Result<Listed, Failure>>,
        mut home: Home,
        asking: &Asking,
    ) -> Result<(Compared, Home), Failure> {
        let mut found = compare(&listings(told), &home.here);
        let lacking = |found: &Compared| -> Vec<usize> {
            (0..).zip(&found.lacking).filter(|(_, lacks)| !lacks.is_empty()).map(|(place, _)| place).collect()
        };
        if lacking(&found).is_empty() {
            return Ok((found, home));
        }
        home.here.gone = self.gone(&found, &mut home.deleted, &asking.network).await?;
        found = compare(&listings(told), &home.here);
        let again = lacking(&found);
        if !again.is_empty() {
            tokio::time::sleep(AGAIN).await;
            for (place, later) in self.ask(remotes, &again, asking).await {
                // One that is away by now has told what it lists.
                if let (Some(Ok(listed)), Ok(later)) = (told.get_mut(&place), later) {
                    listed.listing.add(later.listing);
                }
            }
            found = compare(&listings(told), &home.here);
        }
        Ok((found, home))
    }

    /// Asks gateways for their lists, all at once.
    async fn ask(
        self: &Arc<Self>,
        remotes: &Arc<Remotes>,
        places: &[usize],
        asking: &Asking,
    ) -> BTreeMap<usize, Result<Listed, Failure>> {
        let mut asked = JoinSet::new();
        for (place, remote) in remotes.all().iter().enumerate().filter(|(place, _)| places.contains(place)) {
            let (joined, remote, asking) = (Arc::clone(self), Arc::clone(remote), asking.clone());
            asked.spawn(async move { (place, joined.listed(&remote, &asking).await) });
        }
        let mut told = BTreeMap::new();
        while let Some(one) = asked.join_next().await {
            told.extend(one.ok());
        }
        // Of one whose task failed nothing is known, like of one that is away.
        for place in places {
            told.entry(*place).or_insert_with(|| Err(internal("asking it failed; please report this")));
        }
        told
    }

    /// What this home has of the owners; narrows what is wanted to a topic if there is one.
    async fn home_of(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        network: &Network,
        wanted: &mut [Wanted],
        asked: Option<&TopicName>,
    ) -> Result<Home, Failure> {
        let (owner, network, topic) = (Arc::clone(owner), network.clone(), asked.cloned());
        let mut narrowed = wanted.to_vec();
        let (home, narrowed) = blocking(self, move |joined| {
            let reader = Reader { plant: &joined.plant, network: &network, reader: &owner };
            let mut home = Home::default();
            for one in &mut narrowed {
                let numbers = joined.plant.ledger.numbers(one.owner)?;
                if let Some(topic) = &topic {
                    let mut ids = reader.ids_of(one.owner, topic.as_str())?;
                    ids.extend(numbers.iter().filter(|held| held.topic == topic.as_str()).map(|held| held.topic_id));
                    one.topics = Some(ids);
                }
                let named = reader.granted_names(one.owner)?;
                home.names.extend(named.into_iter().map(|(id, name)| ((one.owner, id), name)));
                for held in numbers.into_iter().filter(|held| one.covers(held.topic_id)) {
                    home.add(one.owner, held, &reader)?;
                }
                if let (Some(topic), Some(ids)) = (&topic, &one.topics) {
                    home.names.extend(ids.iter().map(|id| ((one.owner, *id), topic.as_str().to_owned())));
                }
            }
            Ok((home, narrowed))
        })
        .await?;
        for (one, narrowed) in wanted.iter_mut().zip(narrowed) {
            *one = narrowed;
        }
        if let Some(topic) = asked
            && wanted.iter().all(|one| one.topics.as_ref().is_some_and(BTreeSet::is_empty))
        {
            return Err(input(format!(
                "nobody shares a topic {topic} with this profile; `authros grants list` shows the topics that are shared"
            )));
        }
        Ok(home)
    }

    /// Of the lacking numbers, those whose records were deleted as a retention record on the chain or their owner states.
    async fn gone(
        self: &Arc<Self>,
        found: &Compared,
        deleted: &mut BTreeMap<Series, Vec<(u64, Digest)>>,
        network: &Network,
    ) -> Result<BTreeMap<Series, Ranges>, Failure> {
        let mut lacking: BTreeMap<Series, Ranges> = BTreeMap::new();
        for lack in found.lacking.iter().flatten() {
            let numbers = lacking.entry(lack.series).or_default();
            *numbers = numbers.union(&lack.numbers);
        }
        let (deleted, network) = (std::mem::take(deleted), network.clone());
        blocking(self, move |joined| {
            let (mut gone, mut checked) = (BTreeMap::new(), 0);
            for (series, rows) in deleted {
                let Some(lacking) = lacking.get(&series) else { continue };
                let mut proven = Vec::new();
                for (number, digest) in rows {
                    if !lacking.contains(number) || checked >= MOST_STATEMENTS {
                        continue;
                    }
                    checked += 1;
                    let retained = joined.plant.ledger.retained(digest)?;
                    let stands = retained.is_some_and(|retained| {
                        retained.anchored || is_stated(&joined.plant, Some(&network), digest, &retained)
                    });
                    if stands {
                        proven.push(number);
                    }
                }
                gone.insert(series, Ranges::of(proven));
            }
            Ok(gone)
        })
        .await
    }
}

/// The lists, in the order of the gateways; none of those that told nothing.
fn listings(told: &BTreeMap<usize, Result<Listed, Failure>>) -> Vec<Option<&Listing>> {
    told.values().map(|one| one.as_ref().ok().map(|listed| &listed.listing)).collect()
}

impl Home {
    /// Adds what the ledger has of a topic that one recorder numbered.
    fn add(&mut self, owner: Address, held: HeldNumbers, reader: &Reader<'_>) -> Result<(), Failure> {
        let series = Series { owner, recorder: held.recorder, topic_id: held.topic_id };
        let granted = reader.first_epoch(owner, held.topic_id)?;
        let first = granted.and_then(|granted| held.epochs.range(granted..).map(|(_, number)| *number).min());
        if held.topic != RecordRow::unnamed(held.topic_id) {
            self.names.insert((owner, held.topic_id), held.topic);
        }
        if held.is_own {
            self.here.own.insert(series);
        }
        if !held.deleted.is_empty() {
            self.deleted.insert(series, held.deleted);
        }
        let numbers = Numbers { known: held.known, held: held.held, verified: held.verified, first };
        self.here.series.insert(series, numbers);
        Ok(())
    }
}

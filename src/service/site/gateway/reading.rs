//! Queries of a gateway's callers: what they may read at this moment, pages, checks, one record.

use std::time::Duration;

use super::GatewayDesk;
use super::standing::{entry, proof, standing};
use crate::gateway::{Caller, Code, Fetched, Page, Query, Refusal, Selection, Standing};
use crate::model::{Address, Digest, Scope, Timestamp, TopicId};
use crate::pipeline::{Network, signers};
use crate::store::{RecordQuery, RecordRow};

/// How long the chain may be silent before nobody is authorised any more.
const LONGEST_SILENCE: Duration = Duration::from_secs(30);

/// What a caller may read of an owner.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Reach {
    /// Everything.
    All,
    /// These topics.
    Topics(Vec<TopicId>),
}

impl Reach {
    /// Whether a topic is within it.
    pub(super) fn covers(&self, topic: TopicId) -> bool {
        match self {
            Self::All => true,
            Self::Topics(topics) => topics.contains(&topic),
        }
    }
}

/// The setting that holds a revoke announced and not on the chain yet: the epoch that it begins.
pub(super) fn announced_key(owner: &Address, grantee: &Address) -> String {
    format!("announced revoke:{owner}:{grantee}")
}

fn not_authorised(owner: &Address, reader: &Address) -> Refusal {
    Refusal::new(Code::NotAuthorised, format_args!("{reader} has no grant of {owner}"))
}

impl GatewayDesk {
    /// The network, where the chain has told a head lately.
    pub(super) fn fresh_network(&self) -> Result<Network, Refusal> {
        let network = self.site.network_now().filter(|network| network.domain == self.domain);
        let fresh = self.site.fresh_head(LONGEST_SILENCE);
        network.filter(|_| fresh.is_some()).ok_or_else(|| Refusal::new(Code::Stale, "no fresh head of the chain"))
    }

    /// What `reader` may read of `owner` now: by confirmed grants, unexpired by the later of block time and clock,
    /// and denied at the first sign of a revoke. Waits for the ledger: not on the network's threads.
    pub(super) fn reach(&self, network: &Network, reader: &Address, owner: &Address) -> Result<Reach, Refusal> {
        if reader == owner {
            return Ok(Reach::All);
        }
        let head = self.site.fresh_head(LONGEST_SILENCE);
        let head = head.ok_or_else(|| Refusal::new(Code::Stale, "no fresh head of the chain"))?;
        let now = Timestamp::now().max(Timestamp::from_seconds(head.timestamp));
        let deep = |block: u64| block + network.confirmations <= head.number + 1;
        let grants = network.directory.grants(|grant| {
            let terms = &grant.terms;
            terms.owner == *owner && terms.grantee == *reader && grant.is_active(now) && deep(grant.block)
        });
        let Some(grant) = grants.last() else { return Err(not_authorised(owner, reader)) };
        if self.is_revoke_announced(network, owner, reader)? {
            return Err(not_authorised(owner, reader));
        }
        Ok(match &grant.terms.scope {
            Scope::All => Reach::All,
            Scope::Topics(topics) => Reach::Topics(topics.clone()),
        })
    }

    fn is_revoke_announced(&self, network: &Network, owner: &Address, reader: &Address) -> Result<bool, Refusal> {
        let ledger = &self.site.plant.ledger;
        let internal = Refusal::because(Code::Internal);
        let announced = ledger.setting(&announced_key(owner, reader)).map_err(&internal)?;
        let epoch: Option<u64> = announced.and_then(|text| text.parse().ok());
        // The chain is as far by now: its own word counts again.
        if epoch.is_some_and(|epoch| network.directory.epoch(*owner) < epoch) {
            return Ok(true);
        }
        let owners = self.site.all_owners();
        let Some(local) = owners.iter().find(|local| local.address == *owner) else { return Ok(false) };
        let owed = self.site.owed_revocations(local, network);
        Ok(owed.map_err(|failure| Refusal::new(Code::Internal, failure.message))?.contains(reader))
    }

    pub(super) fn page(&self, caller: &Caller, query: &Query) -> Result<Page, Refusal> {
        let network = self.fresh_network()?;
        let reach = self.reach(&network, &caller.account, &query.selection.owner)?;
        let asked = record_query(query, &reach, &caller.account)?;
        let found = self.site.plant.ledger.list(&asked).map_err(Refusal::because(Code::Internal))?;
        let next = found.next.as_deref().and_then(|cursor| u128::from_str_radix(cursor, 16).ok());
        Ok(Page { entries: found.rows.iter().map(entry).collect(), next })
    }

    pub(super) fn standings(&self, caller: &Caller, digests: &[Digest]) -> Result<Vec<Standing>, Refusal> {
        let network = self.fresh_network()?;
        let mut known: Vec<(Address, Option<Reach>)> = Vec::new();
        let mut standings = Vec::with_capacity(digests.len());
        for digest in digests {
            let row = self.site.plant.ledger.record(*digest).map_err(Refusal::because(Code::Internal))?;
            let Some(row) = row else {
                standings.push(Standing::Unknown);
                continue;
            };
            if !known.iter().any(|(owner, _)| *owner == row.owner) {
                known.push((row.owner, self.reach(&network, &caller.account, &row.owner).ok()));
            }
            let reach = known.iter().find(|(owner, _)| *owner == row.owner).and_then(|(_, reach)| reach.as_ref());
            let seen = reach.is_some_and(|reach| reach.covers(row.topic_id));
            standings.push(if seen { standing(row.state) } else { Standing::Unknown });
        }
        Ok(standings)
    }

    /// A record's bytes, compared with its digest before any of them leaves.
    pub(super) fn record(&self, caller: &Caller, digest: &Digest) -> Result<Fetched, Refusal> {
        let internal = Refusal::because(Code::Internal);
        let network = self.fresh_network()?;
        let plant = &self.site.plant;
        let row = plant.ledger.record(*digest).map_err(&internal)?;
        let row = row.filter(is_offered);
        let row = row.ok_or_else(|| Refusal::new(Code::NotFound, format_args!("no record {digest}")))?;
        if !self.reach(&network, &caller.account, &row.owner)?.covers(row.topic_id) {
            return Err(not_authorised(&row.owner, &caller.account));
        }
        let stored = plant.vault.get(row.digest).map_err(&internal)?;
        let blob = match stored {
            Some(blob) => Some(blob),
            None => plant.ledger.local_copy(row.digest).map_err(&internal)?,
        };
        let blob = blob.ok_or_else(|| Refusal::new(Code::NotFound, format_args!("record {} is gone", row.id)))?;
        if Digest(plant.provider.sm3(&[&blob])) != row.digest {
            return Err(Refusal::new(Code::Tampered, format_args!("record {} is not what it was", row.id)));
        }
        let signer = signers::key_of(plant, &network, &row).map_err(Refusal::because(Code::Internal))?;
        let unknown = || Refusal::new(Code::Tampered, format_args!("the signer of record {} is not known", row.id));
        let place = plant.ledger.batch_place(row.digest).map_err(&internal)?;
        let proof = proof(&row, place).map(|proof| proof.encode()).unwrap_or_default();
        Ok(Fetched { signer: signer.ok_or_else(unknown)?, signature: row.signature, proof, blob })
    }
}

/// Whether a record may leave: what is quarantined or found altered is only listed.
fn is_offered(row: &RecordRow) -> bool {
    !matches!(standing(row.state), Standing::Unknown | Standing::Tampered | Standing::Quarantined)
}

fn record_query(query: &Query, reach: &Reach, reader: &Address) -> Result<RecordQuery, Refusal> {
    let Selection { owner, topic_id, kind, filters } = &query.selection;
    let topic_ids = match (topic_id, reach) {
        (Some(topic), reach) if !reach.covers(*topic) => return Err(not_authorised(owner, reader)),
        (Some(topic), _) => Some(vec![*topic]),
        (None, Reach::All) => None,
        (None, Reach::Topics(topics)) => Some(topics.clone()),
    };
    Ok(RecordQuery {
        owner: Some(*owner),
        topic_ids,
        filters: filters.clone(),
        kind: *kind,
        since: (query.from.0 > 0).then_some(query.from),
        until: (query.until.0 <= i64::MAX.unsigned_abs()).then_some(query.until),
        after: (query.cursor != 0).then(|| format!("{:032x}", query.cursor)),
        limit: usize::from(query.limit),
        ..RecordQuery::default()
    })
}

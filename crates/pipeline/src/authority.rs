//! The only place that decides who may sign and who may read. A right to sign is judged at the anchoring block: by the
//! state after all its events, at its own time. A right to read is judged when reading, by a named policy.

use tokio::task::block_in_place;

use crate::chain::{BlockRef, QueryAnswer};
use crate::directory::{Account, Directory, Granted, Lending, kept};
use crate::model::{Address, PublicKey, Scope, SignerId, Timestamp, TopicId, counted};
use crate::store::{RecordRow, StoreError, WaitingSigner};
use crate::{Network, PipelineError, Plant, Result, crypto::signer_id};

/// Whether the contract lets `reader` read `owner`'s epoch. `None` without a token of that epoch, or without a chain.
/// [`PipelineError::Contradicted`] if the answer differs from what the events say.
pub async fn ask_contract(
    plant: &Plant,
    network: &Network,
    reader: Address,
    owner: Address,
    epoch: u64,
) -> Result<Option<QueryAnswer>> {
    if network.absent.is_some() {
        return Ok(None);
    }
    let token = block_in_place(|| kept::token(&plant.ledger.rights, &network.directory, owner, epoch))?;
    let Some(token) = token else { return Ok(None) };
    let answer = network.chain.data_query(reader, token, owner).await?;
    let expected = block_in_place(|| is_covered(plant, network, reader, owner, epoch))?;
    let claim = match answer {
        QueryAnswer { epoch: found, .. } if found != epoch => {
            format!("names epoch {found} for the token that {owner} registered for epoch {epoch}")
        }
        QueryAnswer { authorised: true, .. } if !expected => format!("lets {reader} read epoch {epoch} of {owner}"),
        QueryAnswer { authorised: false, .. } if expected => {
            format!("does not let {reader} read epoch {epoch} of {owner}")
        }
        QueryAnswer { .. } => return Ok(Some(answer)),
    };
    Err(PipelineError::Contradicted { claim, block: network.directory.newest() })
}

/// The contract's rule, applied to the events: a grant covers the epochs from its own on, and earlier ones that have an
/// envelope of their own. Keys of earlier epochs may also be inside a later envelope, which the contract cannot know.
fn is_covered(plant: &Plant, network: &Network, reader: Address, owner: Address, epoch: u64) -> Result<bool> {
    let directory = &network.directory;
    match may_read(directory, reader, owner, None, Policy::OwnSite) {
        Ok(ReadingRight::Own) => Ok(true),
        Ok(ReadingRight::Granted(grant)) => Ok(epoch >= grant.terms.epoch
            || kept::envelopes(&plant.ledger.rights, &grant)?.iter().any(|envelope| envelope.epoch == epoch)),
        Err(_) => Ok(false),
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Policy {
    /// A reader's own site: a grant in force by the clock here, and the reader not suspended.
    OwnSite,
    /// A gateway serving others: a recent head, a grant with enough confirmations and in force by the later of the
    /// head's time and the clock here, no announced revoke, and the reader not suspended.
    Gateway {
        /// The newest block; `None` if there was none lately.
        head: Option<BlockRef>,
        /// Required confirmations of a grant, its own block included.
        confirmations: u64,
        /// Whether the owner has announced a revoke that is not on the chain yet.
        revoke_announced: bool,
    },
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ReadingRight {
    Own,
    Granted(Box<Granted>),
}

impl ReadingRight {
    pub fn scope(&self) -> &Scope {
        match self {
            Self::Own => &Scope::All,
            Self::Granted(grant) => &grant.terms.scope,
        }
    }

    pub fn covers(&self, topic: TopicId) -> bool {
        self.scope().covers(topic)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ReadRefused {
    #[error("{reader} has no grant of {owner}")]
    NotGranted { owner: Address, reader: Address },
    #[error("the grant of {owner} to {reader} does not cover this topic")]
    NotCovered { owner: Address, reader: Address },
    #[error("{reader} has been suspended since block {since}")]
    Suspended { reader: Address, since: u64 },
    #[error("no recent block from the chain")]
    Stale,
}

/// Whether `reader` may read `owner`'s records of a topic (of any topic, if `topic` is `None`).
pub fn may_read(
    directory: &Directory,
    reader: Address,
    owner: Address,
    topic: Option<TopicId>,
    policy: Policy,
) -> Result<ReadingRight, ReadRefused> {
    if reader == owner {
        return Ok(ReadingRight::Own);
    }
    let now = match policy {
        Policy::OwnSite => directory.now(),
        Policy::Gateway { head, .. } => {
            let head = head.ok_or(ReadRefused::Stale)?;
            directory.now().max(Timestamp::from_seconds(head.timestamp))
        }
    };
    not_suspended(directory, reader)?;
    let grant = directory.grant_between(owner, reader).filter(|grant| stands(grant, now, policy));
    let grant = grant.ok_or(ReadRefused::NotGranted { owner, reader })?;
    if topic.is_some_and(|topic| !grant.terms.scope.covers(topic)) {
        return Err(ReadRefused::NotCovered { owner, reader });
    }
    Ok(ReadingRight::Granted(Box::new(grant)))
}

fn not_suspended(directory: &Directory, reader: Address) -> Result<(), ReadRefused> {
    let since = directory.with_account(reader, |account| {
        account.and_then(|account| account.suspended_at(None)).map(|interval| interval.from)
    });
    since.map_or(Ok(()), |since| Err(ReadRefused::Suspended { reader, since }))
}

fn stands(grant: &Granted, now: Timestamp, policy: Policy) -> bool {
    let demanded = match policy {
        Policy::OwnSite => true,
        Policy::Gateway { head, confirmations, revoke_announced } => {
            let deep = head.is_some_and(|head| grant.block.saturating_add(confirmations) <= head.number + 1);
            deep && !revoke_announced
        }
    };
    demanded && grant.is_active(now)
}

pub fn shared_with(directory: &Directory, reader: Address) -> Vec<Granted> {
    if not_suspended(directory, reader).is_err() {
        return Vec::new();
    }
    let now = directory.now();
    directory.grants_to(reader).into_iter().filter(|grant| grant.is_active(now)).collect()
}

pub fn standing_grant(directory: &Directory, owner: Address, grantee: Address) -> Option<Granted> {
    directory.grant_between(owner, grantee).filter(|grant| grant.is_active(directory.now()))
}

pub fn standing_grants(directory: &Directory, owner: Address) -> Vec<Granted> {
    let now = directory.now();
    directory.grants_of(owner).into_iter().filter(|grant| grant.is_active(now)).collect()
}

/// The moment at which a right is judged: the state after all events of a block, and that block's own time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Moment {
    /// The block; `None` = after every known event.
    pub block: Option<u64>,
    /// The block's time, as stated by its maker.
    pub time: Timestamp,
}

impl Moment {
    pub fn of_block(block: u64, time: Timestamp) -> Self {
        Self { block: Some(block), time }
    }

    pub fn newest(time: Timestamp) -> Self {
        Self { block: None, time }
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SigningRight {
    Owner(PublicKey),
    Device(Lending),
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NoRight {
    #[error("{owner} was not registered yet {}", when(.block))]
    Unregistered { owner: Address, block: Option<u64> },
    #[error("the identity that {owner} had registered does not verify")]
    Unproven { owner: Address },
    #[error("{owner} was suspended {}, since block {since}", when(.block))]
    Suspended { owner: Address, since: u64, block: Option<u64> },
    #[error("{owner} was declared lost {}, and {successor} is its successor since block {since}", when(.block))]
    Succeeded { owner: Address, successor: Address, since: u64, block: Option<u64> },
    #[error("{owner} had replaced the signer's key {}, in block {since}", when(.block))]
    Replaced { owner: Address, since: u64, block: Option<u64> },
    #[error("the signer is a device that {owner} authorised only in block {from}, after the record was anchored")]
    LentLater { owner: Address, from: u64 },
    #[error("the signer is a device that {owner} had revoked in block {recalled}")]
    Recalled { owner: Address, recalled: u64 },
    #[error(
        "the signer is a device that {owner} had authorised until {until}, but the anchoring block is dated {time}"
    )]
    Ended { owner: Address, until: Timestamp, time: Timestamp },
    #[error("{owner} had neither registered nor authorised the signer's key {}", when(.block))]
    Unknown { owner: Address, block: Option<u64> },
    #[error("the signer is a device of {owner} whose key is unknown here; ask its owner for an export")]
    KeyUnknown { owner: Address },
}

#[allow(clippy::ref_option, reason = "as the messages above hand it over")]
fn when(block: &Option<u64>) -> String {
    block.map_or_else(|| "by now".to_owned(), |block| format!("at block {block}"))
}

/// Whether an account is currently suspended: then no gateway admits it, and nothing of it is passed on.
pub fn is_suspended(directory: &Directory, account: Address) -> bool {
    directory.account(account).is_some_and(|account| account.suspended_at(None).is_some())
}

/// By the chain's clock.
pub fn is_lent(directory: &Directory, lending: &Lending) -> bool {
    lending.recalled.is_none() && lending.until.is_none_or(|until| until > directory.now())
}

pub fn may_sign(directory: &Directory, owner: Address, signer: SignerId, at: Moment) -> Result<SigningRight, NoRight> {
    let right = directory.with_account(owner, |account| by_block(account, owner, signer, at.block))?;
    in_time(right, owner, at.time)
}

/// As far as blocks decide; a loan may also expire.
fn by_block(
    account: Option<&Account>,
    owner: Address,
    signer: SignerId,
    block: Option<u64>,
) -> Result<SigningRight, NoRight> {
    let unregistered = NoRight::Unregistered { owner, block };
    let account = account.ok_or(unregistered.clone())?;
    let begun = |from: u64| block.is_none_or(|block| from <= block);
    let identities = account.identities.iter().filter(|identity| begun(identity.block));
    let current = identities.clone().next_back().ok_or(unregistered)?;
    if let Some(interval) = account.suspended_at(block) {
        let since = interval.from;
        return Err(match interval.successor {
            Some(successor) => NoRight::Succeeded { owner, successor, since, block },
            None => NoRight::Suspended { owner, since, block },
        });
    }
    if signer_id(&current.signing) == signer {
        return match current.proven {
            true => Ok(SigningRight::Owner(current.signing)),
            false => Err(NoRight::Unproven { owner }),
        };
    }
    let mut loans = account.devices.iter().filter(|lending| lending.device == signer);
    if let Some(lending) = loans.clone().rfind(|lending| begun(lending.from)) {
        return match lending.recalled.filter(|recalled| begun(*recalled)) {
            Some(recalled) => Err(NoRight::Recalled { owner, recalled }),
            None => Ok(SigningRight::Device(lending.clone())),
        };
    }
    if let Some(lending) = loans.next() {
        return Err(NoRight::LentLater { owner, from: lending.from });
    }
    let mut before = identities.rev().skip_while(|identity| signer_id(&identity.signing) != signer);
    Err(match before.next() {
        Some(_) => NoRight::Replaced { owner, since: current.block, block },
        None => NoRight::Unknown { owner, block },
    })
}

fn in_time(right: SigningRight, owner: Address, time: Timestamp) -> Result<SigningRight, NoRight> {
    match &right {
        SigningRight::Device(Lending { until: Some(until), .. }) if *until <= time => {
            Err(NoRight::Ended { owner, until: *until, time })
        }
        _ => Ok(right),
    }
}

/// Asks for the block's time only if it matters.
pub fn right_of(
    network: &Network,
    owner: Address,
    signer: SignerId,
    block: u64,
) -> Result<Result<SigningRight, NoRight>> {
    let right = match network.directory.with_account(owner, |account| by_block(account, owner, signer, Some(block))) {
        Ok(right) => right,
        Err(why) => return Ok(Err(why)),
    };
    // Without the chain nobody knows the block's time; nothing is called verified then.
    if matches!(right, SigningRight::Device(Lending { until: Some(_), .. })) && network.absent.is_none() {
        return Ok(in_time(right, owner, network.time_of(block)?));
    }
    Ok(Ok(right))
}

/// The key that signed a record, if its signer had the right at the anchoring block; before it is anchored, any key
/// that its owner ever registered or lent. The chain has only the ids of devices; their keys come from the ledger.
pub fn signer_of(plant: &Plant, network: &Network, row: &RecordRow) -> Result<Result<PublicKey, NoRight>> {
    let right = match row.block {
        Some(block) => right_of(network, row.owner, row.signer, block)?,
        None => network.directory.with_account(row.owner, |account| ever(account, row.owner, row.signer)),
    };
    Ok(match right {
        Ok(SigningRight::Owner(key)) => Ok(key),
        Ok(SigningRight::Device(_)) => {
            let key = plant.ledger.bindings.signer(row.signer)?.filter(|key| signer_id(key) == row.signer);
            key.ok_or(NoRight::KeyUnknown { owner: row.owner })
        }
        Err(why) => Err(why),
    })
}

pub fn key_of(plant: &Plant, network: &Network, row: &RecordRow) -> Result<Option<PublicKey>> {
    Ok(signer_of(plant, network, row)?.ok())
}

fn ever(account: Option<&Account>, owner: Address, signer: SignerId) -> Result<SigningRight, NoRight> {
    let account = account.ok_or(NoRight::Unregistered { owner, block: None })?;
    let own = account.identities.iter().find(|known| known.proven && signer_id(&known.signing) == signer);
    if let Some(identity) = own {
        return Ok(SigningRight::Owner(identity.signing));
    }
    let lent = account.devices.iter().find(|lending| lending.device == signer);
    lent.map(|lending| SigningRight::Device(lending.clone())).ok_or(NoRight::Unknown { owner, block: None })
}

/// Holds back what may not be signed now, and releases what waited for a right that is back. Call before anchoring.
pub fn settle_waiting(plant: &Plant, network: &Network, keeper: Address) -> Result<()> {
    for waiting in plant.ledger.batches.waiting_signers(keeper)? {
        let now = Moment::newest(network.directory.now());
        match may_sign(&network.directory, waiting.owner, waiting.signer, now) {
            Ok(_) if waiting.held => free(plant, keeper, waiting)?,
            // Before an owner is registered its records wait for that, like all others.
            Ok(_) | Err(NoRight::Unregistered { .. }) => {}
            Err(why) if waiting.ready => hold(plant, keeper, waiting, &why)?,
            Err(_) => {}
        }
    }
    Ok(())
}

fn hold(plant: &Plant, keeper: Address, waiting: WaitingSigner, why: &NoRight) -> Result<()> {
    let held = all(|| plant.ledger.batches.hold_signer(keeper, waiting.owner, waiting.signer))?;
    // Messages captured meanwhile join the waiting ones; this is reported once.
    if held > 0 && !waiting.held {
        plant.observer.alert(true, format!("records are kept but not anchored: {why}"));
    }
    if held > 0 {
        plant.observer.records_changed();
    }
    Ok(())
}

fn free(plant: &Plant, keeper: Address, waiting: WaitingSigner) -> Result<()> {
    let freed = all(|| plant.ledger.batches.free_signer(keeper, waiting.owner, waiting.signer))?;
    if freed > 0 {
        let owner = waiting.owner;
        plant
            .observer
            .alert(false, format!("{} of {owner} resumed: the signer may sign again", counted(freed, "record")));
        plant.observer.records_changed();
    }
    Ok(())
}

/// Repeats `some` until it moves no further records.
fn all(some: impl Fn() -> Result<u64, StoreError>) -> Result<u64> {
    let mut moved = 0;
    loop {
        match some()? {
            0 => return Ok(moved),
            more => moved += more,
        }
    }
}

#[cfg(test)]
mod tests;

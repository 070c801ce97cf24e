//! Who may sign: the owner with the key registered at that block, or a device lent at that block; nobody for a
//! suspended owner.

use crate::crypto::signer_id;
use crate::model::{Address, PublicKey, SignerId, Timestamp};
use crate::pipeline::directory::{Account, Directory, Lending};
use crate::pipeline::{Network, PipelineError, Plant};
use crate::store::RecordRow;

/// The moment at which a right is judged: the state after all events of a block, and that block's own time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Moment {
    /// The block; `None` = after every known event.
    pub block: Option<u64>,
    /// The block's time, as stated by its maker.
    pub time: Timestamp,
}

impl Moment {
    /// After a block's events.
    pub fn of_block(block: u64, time: Timestamp) -> Self {
        Self { block: Some(block), time }
    }

    /// After every known event.
    pub fn newest(time: Timestamp) -> Self {
        Self { block: None, time }
    }
}

/// The right by which a record was signed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SigningRight {
    /// With the owner's own key.
    Owner(PublicKey),
    /// With the key of a device lent by the owner.
    Device(Lending),
}

/// Why a signer had no right to sign for an owner.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "each variant's line names its fields")]
pub enum NoRight {
    /// The owner had not registered an identity yet.
    #[error("{owner} was not registered yet {}", when(.block))]
    Unregistered { owner: Address, block: Option<u64> },
    /// The owner's identity has no valid proof.
    #[error("the identity that {owner} had registered does not verify")]
    Unproven { owner: Address },
    /// The owner was suspended.
    #[error("{owner} was suspended {}, since block {since}", when(.block))]
    Suspended { owner: Address, since: u64, block: Option<u64> },
    /// The owner's account was lost and another account took over.
    #[error("{owner} was declared lost {}, and {successor} is its successor since block {since}", when(.block))]
    Succeeded { owner: Address, successor: Address, since: u64, block: Option<u64> },
    /// The key had been the owner's, but was replaced.
    #[error("{owner} had replaced the signer's key {}, in block {since}", when(.block))]
    Replaced { owner: Address, since: u64, block: Option<u64> },
    /// The device was lent later.
    #[error("the signer is a device that {owner} lent only in block {from}, after the record was anchored")]
    LentLater { owner: Address, from: u64 },
    /// The device was recalled.
    #[error("the signer is a device that {owner} had recalled in block {recalled}")]
    Recalled { owner: Address, recalled: u64 },
    /// The device's loan had ended.
    #[error("the signer is a device that {owner} had lent until {until}, but the anchoring block is dated {time}")]
    Ended { owner: Address, until: Timestamp, time: Timestamp },
    /// None of these.
    #[error("{owner} had not registered the signer's key {}, nor lent it", when(.block))]
    Unknown { owner: Address, block: Option<u64> },
    /// The device was lent, but its public key is not known here.
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

/// Whether a loan is currently in force, by the chain's clock.
pub fn is_lent(directory: &Directory, lending: &Lending) -> bool {
    lending.recalled.is_none() && lending.until.is_none_or(|until| until > directory.now())
}

/// Whether the key with this id could sign for `owner` at a given moment.
///
/// # Errors
/// [`NoRight`] with the reason.
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

/// The right by which a key signed for `owner`, at a block of the chain; the block's time is requested only if it
/// matters.
///
/// # Errors
/// Errors of the chain; lack of a right is part of the answer.
pub fn right_of(
    network: &Network,
    owner: Address,
    signer: SignerId,
    block: u64,
) -> Result<Result<SigningRight, NoRight>, PipelineError> {
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

/// The key that signed a record, if its signer had the right at the anchoring block. Before a record is anchored
/// nothing is decided: then any key that its owner ever registered or lent. The chain has only the ids of devices;
/// their keys are those known to the ledger.
///
/// # Errors
/// Errors of chain and ledger; lack of a right is part of the answer.
pub fn signer_of(
    plant: &Plant,
    network: &Network,
    row: &RecordRow,
) -> Result<Result<PublicKey, NoRight>, PipelineError> {
    let right = match row.block {
        Some(block) => right_of(network, row.owner, row.signer, block)?,
        None => network.directory.with_account(row.owner, |account| ever(account, row.owner, row.signer)),
    };
    Ok(match right {
        Ok(SigningRight::Owner(key)) => Ok(key),
        Ok(SigningRight::Device(_)) => {
            let key = plant.ledger.signer(row.signer)?.filter(|key| signer_id(key) == row.signer);
            key.ok_or(NoRight::KeyUnknown { owner: row.owner })
        }
        Err(why) => Err(why),
    })
}

/// Like [`signer_of`], without the reason.
///
/// # Errors
/// See [`signer_of`].
pub fn key_of(plant: &Plant, network: &Network, row: &RecordRow) -> Result<Option<PublicKey>, PipelineError> {
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

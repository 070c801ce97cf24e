//! Level (b): whether the owner was entitled to sign with the key when the record was anchored.

use authros_crypto::signer_id;
use authros_model::{Header, PublicKey, Timestamp};

use crate::anchoring::Anchored;
use crate::report::{Level, Standing};
use crate::state::Unproven;
use crate::verify::Check;

/// What the state shows about the signer of a record.
#[derive(Clone)]
pub(crate) struct Signed {
    /// Level (b), as far as the state itself is trusted.
    pub level: Level,
    /// The key that the owner had registered at the anchoring block.
    pub owner_key: Option<PublicKey>,
}

/// Level (b) of a record whose anchor is shown by the state.
pub(crate) fn signing_right(check: &Check<'_>, header: &Header, anchored: &Anchored<'_>) -> Signed {
    check.known.right(header.owner, header.signer, anchored, || right(check, header, anchored))
}

fn right(check: &Check<'_>, header: &Header, anchored: &Anchored<'_>) -> Signed {
    match owner_key(check, header, anchored) {
        Ok(Own::Unknown(why)) => Signed { level: Level::new(Standing::Unproven, why), owner_key: None },
        Ok(Own::Registered(key)) => {
            let level = judged(check, header, anchored, &key).unwrap_or_else(|why| unshown(why, anchored));
            Signed { level, owner_key: Some(key) }
        }
        Err(why) => Signed { level: unshown(why, anchored), owner_key: None },
    }
}

fn unshown(why: Unproven, anchored: &Anchored<'_>) -> Level {
    let at = anchored.shown_at;
    match why {
        Unproven::Missing(_) => Level::new(
            Standing::Unproven,
            format!("the part of the state after block {at} that holds the key's registration is not in the bundle"),
        ),
        why => Level::new(Standing::Refused, format!("the key's registration: {why}")),
    }
}

fn refused(text: impl Into<String>) -> Level {
    Level::new(Standing::Refused, text)
}

fn judged(
    check: &Check<'_>,
    header: &Header,
    anchored: &Anchored<'_>,
    registered: &PublicKey,
) -> Result<Level, Unproven> {
    let (owner, block, at) = (header.owner, anchored.block, anchored.shown_at);
    let how = match signer_id(registered) == header.signer {
        true => format!("the key was {owner}'s at block {block}"),
        false => match lent(header, anchored)? {
            Ok(()) => {
                format!("the key {} belongs to a device that {owner} had on loan at block {block}", header.signer)
            }
            Err(level) => return Ok(level),
        },
    };
    // The contract lets no suspended account anchor, which holds for the moment of anchoring. A right is the state
    // after the block, so the block's own state is used if present: the owner may have been suspended later in that
    // block. A later state in which the owner is suspended does not show that this came after the block.
    let suspended = check.known.is_suspended((at, &anchored.storage), owner)?;
    Ok(match (suspended, at == block) {
        (true, true) => refused(format!("{owner} was suspended at block {block}")),
        (false, true) => Level::new(Standing::Proven, format!("{how}, and {owner} was not suspended")),
        (true, false) => Level::new(
            Standing::Unproven,
            format!("{how}; {owner} is suspended at block {at}, but there is no proof since when"),
        ),
        (false, false) if anchored.account == owner => Level::new(
            Standing::Proven,
            format!("{how}, and {owner} was not suspended when this was anchored: it anchored this itself"),
        ),
        (false, false) => Level::new(
            Standing::Unproven,
            format!("{how}; {owner} is not suspended at block {at}, but nothing shows whether it was at block {block}"),
        ),
    })
}

enum Own {
    /// This one.
    Registered(PublicKey),
    /// The state does not show which key it was.
    Unknown(String),
}

/// The key that the owner had registered at the anchoring block.
fn owner_key(check: &Check<'_>, header: &Header, anchored: &Anchored<'_>) -> Result<Own, Unproven> {
    let (owner, block, state) = (header.owner, anchored.block, (anchored.shown_at, &anchored.storage));
    let version = anchored.keys.filter(|_| anchored.account == owner).unwrap_or(anchored.claimed_keys);
    let Some(keys) = check.known.keys(state, owner, version)? else {
        return Ok(Own::Unknown(format!("{owner} has no version {version} of its keys on this chain")));
    };
    // The contract notes the version with the owner's own anchor, but the keys may have changed later in that block.
    let after = version.checked_add(1).map(|next| check.known.keys(state, owner, next)).transpose()?.flatten();
    if keys.block > block || after.is_some_and(|after| after.block <= block) {
        return Ok(Own::Unknown(format!(
            "version {version} of {owner}'s keys was not the one in force at block {block}"
        )));
    }
    let Some(identity) = check.identity(keys.identity, owner) else {
        return Ok(Own::Unknown(format!(
            "the identity {} of {owner} is not in the bundle, or its own proof fails",
            keys.identity
        )));
    };
    let pinned = check.trust.and_then(|trust| trust.person(owner)).and_then(|person| person.key);
    if pinned.is_some_and(|pinned| pinned != signer_id(&identity.signing)) {
        return Ok(Own::Unknown(format!("the key that {owner} had registered is not the one you pinned")));
    }
    Ok(Own::Registered(identity.signing))
}

/// Whether the signer is a device that its owner had lent at the anchoring block.
fn lent(header: &Header, anchored: &Anchored<'_>) -> Result<Result<(), Level>, Unproven> {
    let (owner, block) = (header.owner, anchored.block);
    let unproven = |text: String| Ok(Err(Level::new(Standing::Unproven, text)));
    let refused = |text: String| Ok(Err(refused(text)));
    let Some(loan) = anchored.storage.loan(owner, &header.signer.0)? else {
        return refused(format!("{owner} had neither registered nor lent the key at block {block}"));
    };
    if loan.lent > block && anchored.shown_at > block {
        return unproven(format!("the device was lent again later; what applied at block {block} is not shown"));
    }
    if loan.lent > block {
        return refused(format!("{owner} lent the device only in block {}, after block {block}", loan.lent));
    }
    if loan.recalled != 0 && loan.recalled <= block {
        return refused(format!("{owner} had recalled the device in block {}", loan.recalled));
    }
    match anchored.time {
        _ if loan.until == 0 => Ok(Ok(())),
        Some(time) if time < loan.until => Ok(Ok(())),
        Some(_) => refused(format!("the loan of the device had ended by {}", Timestamp::from_seconds(loan.until))),
        None => unproven("the loan of the device had an end, but the block's time is not shown".to_owned()),
    }
}

//! Level (b): whether a key was its owner's to sign with when the record was anchored.

use authros_crypto::signer_id;
use authros_model::{Header, Timestamp};

use crate::anchoring::Anchored;
use crate::report::{Level, Standing};
use crate::state::Unproven;
use crate::verify::Check;

/// Level (b) of a record whose anchor the state shows.
pub(crate) fn signing_right(check: &Check<'_>, header: &Header, anchored: &Anchored<'_>) -> Level {
    match judged(check, header, anchored) {
        Ok(level) => level,
        Err(Unproven::Missing(_)) => Level::new(
            Standing::Unproven,
            format!(
                "the part of the state after block {} that has the key's registration is not in the bundle",
                anchored.shown_at
            ),
        ),
        Err(why) => Level::new(Standing::Refused, format!("the key's registration: {why}")),
    }
}

fn refused(text: impl Into<String>) -> Level {
    Level::new(Standing::Refused, text)
}

fn judged(check: &Check<'_>, header: &Header, anchored: &Anchored<'_>) -> Result<Level, Unproven> {
    let (owner, block, at) = (header.owner, anchored.block, anchored.shown_at);
    let Some(device) = check.bundle.keys.get(&header.signer) else { return Ok(refused("its key is missing")) };
    let own = owner_key(check, header, anchored)?;
    let how = match own {
        Own::Signs => format!("the key was {owner}'s at block {block}"),
        Own::Unknown(why) => return Ok(Level::new(Standing::Unproven, why)),
        Own::Another => match lent(header, anchored)? {
            Ok(()) => format!("the key {} is of a device that {owner} had lent at block {block}", signer_id(device)),
            Err(why) => return Ok(refused(why)),
        },
    };
    // The contract lets no suspended account anchor.
    if anchored.account == owner {
        return Ok(Level::new(
            Standing::Proven,
            format!("{how}, and {owner} was not suspended: it anchored this itself"),
        ));
    }
    let suspended = anchored.storage.is_suspended(owner)?;
    Ok(match (suspended, at == block) {
        (true, true) => refused(format!("{owner} was suspended at block {block}")),
        (false, true) => Level::new(Standing::Proven, format!("{how}, and {owner} was not suspended")),
        (true, false) => Level::new(
            Standing::Unproven,
            format!("{how}; {owner} is suspended at block {at}, and since when is not shown"),
        ),
        (false, false) => Level::new(
            Standing::Unproven,
            format!("{how}; {owner} is not suspended at block {at}, and nothing shows whether it was at block {block}"),
        ),
    })
}

enum Own {
    /// The key is the owner's.
    Signs,
    /// The owner's key is another.
    Another,
    /// The state does not show which it was.
    Unknown(String),
}

/// Whether the signer's key is the one that the owner had registered at the anchoring block.
fn owner_key(check: &Check<'_>, header: &Header, anchored: &Anchored<'_>) -> Result<Own, Unproven> {
    let (owner, block, storage) = (header.owner, anchored.block, &anchored.storage);
    let version = anchored.keys.filter(|_| anchored.account == owner).unwrap_or(anchored.claimed_keys);
    if version == 0 {
        return Ok(Own::Unknown(
            "the contract is of revision 1, which keeps no history of keys; nothing shows it".to_owned(),
        ));
    }
    let Some(keys) = storage.keys(owner, version)? else {
        return Ok(Own::Unknown(format!("{owner} has no version {version} of its keys on this chain")));
    };
    // The contract notes the version with the anchor; for another account's anchor the blocks have to say it.
    if anchored.account != owner || anchored.keys.is_none() {
        let after = version.checked_add(1).map(|next| storage.keys(owner, next)).transpose()?.flatten();
        if keys.block > block || after.is_some_and(|after| after.block <= block) {
            return Ok(Own::Unknown(format!(
                "version {version} of {owner}'s keys was not the one in force at block {block}"
            )));
        }
    }
    let Some(identity) = check.identity(keys.identity, owner) else {
        return Ok(Own::Unknown(format!(
            "the identity {} of {owner} is not in the bundle, or does not prove itself",
            keys.identity
        )));
    };
    let pinned = check.trust.and_then(|trust| trust.person(owner)).and_then(|person| person.key);
    if pinned.is_some_and(|pinned| pinned != signer_id(&identity.signing)) {
        return Ok(Own::Unknown(format!("the key that {owner} had registered is not the one you pinned")));
    }
    Ok(if signer_id(&identity.signing) == header.signer { Own::Signs } else { Own::Another })
}

/// Whether the signer is a device that its owner had lent at the anchoring block.
fn lent(header: &Header, anchored: &Anchored<'_>) -> Result<Result<(), String>, Unproven> {
    let (owner, block) = (header.owner, anchored.block);
    let Some(loan) = anchored.storage.loan(owner, &header.signer.0)? else {
        return Ok(Err(format!("{owner} had neither registered nor lent the key at block {block}")));
    };
    if loan.lent > block {
        return Ok(Err(format!("{owner} lent the device only in block {}, after block {block}", loan.lent)));
    }
    if loan.recalled != 0 && loan.recalled <= block {
        return Ok(Err(format!("{owner} had recalled the device in block {}", loan.recalled)));
    }
    match anchored.time {
        _ if loan.until == 0 => Ok(Ok(())),
        Some(time) if time < loan.until => Ok(Ok(())),
        Some(_) => Ok(Err(format!("the loan of the device was over at {}", Timestamp::from_seconds(loan.until)))),
        None => Ok(Err("the loan of the device had an end, and the block's time is not shown".to_owned())),
    }
}

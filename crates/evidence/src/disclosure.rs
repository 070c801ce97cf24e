//! Level (e): the owner signed the disclosure, and its secret is the record's.

use authros_crypto::record::{Revealed, open_revealed_within, reveal_bytes};
use authros_model::{Digest, Header, PublicKey};

use crate::bundle::{BundledRecord, Disclosure};
use crate::report::{Level, Standing};
use crate::verify::Check;

/// The most bytes of messages produced from one file.
pub(crate) const MOST_PLAIN: u64 = 256 * 1024 * 1024;
/// The most identities tried for one owner.
const MOST_IDENTITIES: usize = 16;

/// Level (e), as far as the state itself is trusted, and the message if it was opened. The signer is checked first:
/// nothing is produced that nobody vouches for.
pub(crate) fn opened(
    check: &Check<'_>,
    digest: Digest,
    record: &BundledRecord,
    header: &Header,
    owner_key: Option<PublicKey>,
) -> (Level, Option<Revealed>) {
    let Some(disclosure) = &record.disclosure else {
        return (Level::new(Standing::Absent, "sealed: its owner did not disclose it"), None);
    };
    let level = signed(check, digest, disclosure, header, owner_key);
    if level.standing == Standing::Refused {
        return (level, None);
    }
    let mut left = check.known.plain_left.get();
    let opened = open_revealed_within(check.provider, &record.record, &disclosure.secret, &mut left);
    check.known.plain_left.set(left);
    match opened {
        Ok(Some(revealed)) => (level, Some(revealed)),
        Ok(None) => {
            let text = "its message is not opened: too much is disclosed in a single file";
            (Level::new(Standing::Unproven, text), None)
        }
        Err(error) => (Level::new(Standing::Refused, format!("the disclosed secret does not open it: {error}")), None),
    }
}

/// The signer of a disclosure. An identity proves that its key made it, and not whose account it is: only the state or
/// a pin ties the key to the owner.
fn signed(
    check: &Check<'_>,
    digest: Digest,
    disclosure: &Disclosure,
    header: &Header,
    owner_key: Option<PublicKey>,
) -> Level {
    let message = reveal_bytes(&header.domain, &digest, &disclosure.secret);
    let is_owners = |key: &PublicKey| check.provider.verify(key, &message, &disclosure.signature).is_ok();
    let pinned = check.trust.and_then(|trust| trust.person(header.owner)).and_then(|person| person.key);
    let pinned = pinned.and_then(|key| check.bundle.keys.get(&key)).copied();
    if [owner_key, pinned].iter().flatten().any(is_owners) {
        return Level::new(Standing::Proven, "opened by its owner's disclosure");
    }
    let identities = &check.bundle.identities;
    let mut claimed = identities.iter().take(MOST_IDENTITIES);
    let claims = claimed.any(|(hash, identity)| {
        check.known.is_of(check, (*hash, identity), header.owner) && is_owners(&identity.signing)
    });
    if claims || identities.len() > MOST_IDENTITIES {
        let text = "it opens, and this is the message; there is no proof that its owner disclosed it";
        return Level::new(Standing::Unproven, text);
    }
    Level::new(Standing::Refused, "the disclosure is not signed by its owner")
}

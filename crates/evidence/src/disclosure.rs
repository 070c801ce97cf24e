//! Level (e): the owner signed the disclosure, and its secret is the record's.

use authros_crypto::Provider;
use authros_crypto::record::{Revealed, open_revealed_within, reveal_bytes};
use authros_model::{Digest, Header, PublicKey};

use crate::bundle::{BundledRecord, Disclosure};
use crate::report::{Level, Standing};
use crate::verify::Check;

/// The most bytes of messages produced from one file.
pub(crate) const MOST_PLAIN: u64 = 256 * 1024 * 1024;
/// The most identities tried for one owner.
const MOST_IDENTITIES: usize = 16;

/// Level (e) before the message is opened, as far as the state itself is trusted: who signed the disclosure.
pub(crate) fn vouched(
    check: &Check<'_>,
    digest: Digest,
    record: &BundledRecord,
    header: &Header,
    owner_key: Option<PublicKey>,
) -> Level {
    let disclosure = record.disclosure.as_ref();
    disclosure.map_or_else(
        || Level::new(Standing::Absent, "sealed: its owner did not disclose it"),
        |disclosure| signed(check, digest, disclosure, header, owner_key),
    )
}

/// Level (e), and the message if it was opened; at most `left` bytes are produced, and counted there. The signer was
/// checked first: nothing is produced that nobody vouches for.
pub(crate) fn opened(
    provider: &dyn Provider,
    record: &BundledRecord,
    level: Level,
    left: &mut u64,
) -> (Level, Option<Revealed>) {
    let Some(disclosure) = record.disclosure.as_ref().filter(|_| level.standing != Standing::Refused) else {
        return (level, None);
    };
    match open_revealed_within(provider, &record.record, &disclosure.secret, left) {
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

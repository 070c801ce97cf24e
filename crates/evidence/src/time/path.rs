//! The way from a certificate up to one that is pinned, through those that came with the stamp (RFC 5280, section 6, with
//! names compared byte by byte). Whether one was revoked is not looked up.

use super::TimeError;
use super::certificate::Certificate;

/// The most certificates between the first and the pinned one.
const LONGEST: usize = 6;

/// Checks the way; each certificate on it was valid at this time, seconds.
pub(super) fn check(
    first: &Certificate,
    others: &[Certificate],
    pinned: &Certificate,
    at: u64,
) -> Result<(), TimeError> {
    let mut last = first;
    let mut fault = None;
    for below in 0..LONGEST {
        last.valid_at(at)?;
        if last.uses.unknown {
            return Err(TimeError::Critical(last.name()));
        }
        if last.der == pinned.der {
            return Ok(());
        }
        let known = std::iter::once(pinned).chain(others);
        let mut above = known.filter(|above| above.subject == last.issuer && above.der != last.der);
        let issuer = above.find(|above| match issued(above, last, below) {
            Ok(()) => true,
            Err(error) => {
                fault.get_or_insert(error);
                false
            }
        });
        last = issuer.ok_or_else(|| fault.take().unwrap_or_else(|| TimeError::NotPinned(first.name())))?;
    }
    Err(TimeError::NotPinned(first.name()))
}

/// Whether one certificate issued the other, with so many between that one and the first.
fn issued(above: &Certificate, below: &Certificate, between: usize) -> Result<(), TimeError> {
    if !above.uses.may_issue() || above.uses.issuer.is_some_and(|most| most < between as u64) {
        return Err(TimeError::NotAnIssuer(above.name()));
    }
    above.key.verify(below.scheme.clone()?, &below.signed, &below.signature).map_err(|error| match error {
        TimeError::Signature => TimeError::Forged(below.name()),
        other => other,
    })
}

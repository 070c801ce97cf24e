//! When the newest notice that a robot took was sealed, as its ledger remembers it. The enrolment has the notice's number
//! only, in a format that earlier versions read.

use crate::model::{RecorderId, Timestamp};
use crate::store::{Ledger, StoreError};

/// The setting of the ledger.
const TAKEN: &str = "notice-taken";

fn name((recorder, number): (RecorderId, u64)) -> String {
    format!("{recorder} {number}")
}

/// Remembers that the notice of this recorder and number, sealed at `at`, is the newest one taken.
pub(super) fn remember(ledger: &Ledger, newest: (RecorderId, u64), at: Timestamp) -> Result<(), StoreError> {
    ledger.put_setting(TAKEN, &format!("{} {}", name(newest), at.0))
}

/// When it was sealed; `None` if another one is remembered, or none.
pub(super) fn sealed_at(ledger: &Ledger, newest: (RecorderId, u64)) -> Option<Timestamp> {
    let text = ledger.setting(TAKEN).ok()??;
    let (known, at) = text.rsplit_once(' ')?;
    if known == name(newest) { at.parse().ok().map(Timestamp) } else { None }
}

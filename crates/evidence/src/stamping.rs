//! Level (d): a pinned authority stamped the root of the record's batch.

use std::collections::BTreeMap;

use authros_crypto::merkle::Leaf;
use authros_model::{Digest, Hash, Header, Timestamp, clean};

use crate::bundle::{Bundle, BundledRecord};
use crate::report::{Level, Standing};
use crate::time::{BundledStamp, Certificate, StampedRoot, TimeError, check_token};
use crate::trust::{PinnedAuthority, Trust};

/// The combined result of the tokens over the same roots.
#[derive(Default)]
struct Finding {
    /// The earliest by a pinned authority: before when, and who.
    proven: Option<(Timestamp, String)>,
    /// The earliest by the authority's own word.
    claimed: Option<(Timestamp, String)>,
    /// What contradicts one of them.
    refused: Option<TimeError>,
}

/// The stamps of a bundle, checked once for all records.
#[derive(Default)]
pub(crate) struct Stamps<'a> {
    /// By the roots that they cover.
    roots: BTreeMap<Hash, Vec<(usize, &'a BundledStamp, &'a StampedRoot)>>,
    findings: Vec<Finding>,
}

impl<'a> Stamps<'a> {
    /// Those of a bundle, by the pinned authorities.
    pub fn new(bundle: &'a Bundle, trust: Option<&Trust>) -> Self {
        let pinned = trust.map(|trust| trust.authorities.as_slice()).unwrap_or_default();
        let read = |authority: &PinnedAuthority| Certificate::from_pem(&authority.certificate).ok();
        let (names, certificates): (Vec<_>, Vec<_>) =
            pinned.iter().filter_map(|authority| Some((clean(&authority.name, 80), read(authority)?))).unzip();
        let mut stamps = Self::default();
        for (imprint, stamp) in &bundle.stamps {
            for place in &stamp.roots {
                stamps.roots.entry(place.root).or_default().push((stamps.findings.len(), stamp, place));
            }
            stamps.findings.push(finding(&imprint.0, stamp, &names, &certificates));
        }
        stamps
    }

    /// Level (d) of a record, and before when it existed, if that is proven.
    pub fn level(&self, digest: Digest, header: &Header, record: &BundledRecord) -> (Level, Option<Timestamp>) {
        let absent = |text: &str| (Level::new(Standing::Absent, text), None);
        let Some(inclusion) = record.anchor.as_ref().and_then(|claim| claim.inclusion()) else {
            return absent("no authority's time stamp: the record is not in a batch");
        };
        let Some(found) = self.roots.get(&inclusion.root) else {
            return absent("no authority's time stamp over its batch is in the bundle");
        };
        if !inclusion.proves(&Leaf::of(header, digest)) {
            return (Level::new(Standing::Refused, "its path does not lead to the stamped root"), None);
        }
        let mut best = Finding::default();
        for (at, stamp, place) in found {
            let Some(finding) = self.findings.get(*at) else { continue };
            if !stamp.leads(place) {
                let text = "the path of its batch's root does not lead to what was stamped";
                return (Level::new(Standing::Refused, text), None);
            }
            best.take(finding);
        }
        best.told()
    }
}

impl Finding {
    fn take(&mut self, other: &Self) {
        self.proven = earlier(self.proven.take(), other.proven.clone());
        self.claimed = earlier(self.claimed.take(), other.claimed.clone());
        self.refused = self.refused.take().or_else(|| other.refused.clone());
    }

    fn told(self) -> (Level, Option<Timestamp>) {
        if let Some(error) = self.refused {
            return (Level::new(Standing::Refused, format!("a time stamp: {error}")), None);
        }
        if let Some((before, who)) = self.proven {
            let text = format!(
                "existed before {before}, by the time stamp of {who}, whom you pinned; certificate revocation is not \
                 checked"
            );
            return (Level::new(Standing::Proven, text), Some(before));
        }
        let text = self.claimed.map_or_else(
            || "it contains no time stamp".to_owned(),
            |(before, who)| format!("stamped before {before} by {who}, whom you did not pin: this proves nothing yet"),
        );
        (Level::new(Standing::Unproven, text), None)
    }
}

fn earlier(one: Option<(Timestamp, String)>, other: Option<(Timestamp, String)>) -> Option<(Timestamp, String)> {
    match (one, other) {
        (Some(one), Some(other)) => Some(if other.0 < one.0 { other } else { one }),
        (one, other) => one.or(other),
    }
}

fn finding(imprint: &[u8; 32], stamp: &BundledStamp, names: &[String], pinned: &[Certificate]) -> Finding {
    let mut finding = Finding::default();
    for token in &stamp.tokens {
        match check_token(token, imprint, None, pinned) {
            Ok(stamped) => match stamped.pinned.and_then(|place| names.get(place)) {
                Some(name) => finding.proven = earlier(finding.proven.take(), Some((stamped.before, name.clone()))),
                None => finding.claimed = earlier(finding.claimed.take(), Some((stamped.before, stamped.signer))),
            },
            Err(error) => drop(finding.refused.get_or_insert(error)),
        }
    }
    finding
}

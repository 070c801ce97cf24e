//! The words of a check by `verify`: from when on a record existed at the latest, by whose clock, and what is only its
//! owner's claim.

use std::time::Duration;

use crate::chain::SealedBy;
use crate::model::{ErrorKind, Timestamp};

use super::verification::{AnchoredAt, FolderCheck};

/// Seconds between the claimed capture and the anchor that need no comment.
const USUAL: u64 = 10 * 60;
/// Seconds that a capture may claim to be after its anchor: clocks differ, and block times are whole seconds.
const AFTER: u64 = 15;

/// What the reader of the verdict has to know besides.
pub(super) fn warnings(
    captured_at: Timestamp,
    anchored: Option<AnchoredAt>,
    sealed_by: Option<&SealedBy>,
    folders_word: &[&str],
) -> Vec<String> {
    let mut warnings = Vec::new();
    if let Some(sealed_by) = sealed_by.filter(|sealed_by| sealed_by.alone) {
        warnings.push(format!(
            "against the person who runs this chain its anchor proves nothing: {}; they could have created it at any \
             time and dated its blocks as they like",
            sealed_by.text
        ));
    }
    if let Some(anchored) = anchored {
        let (claimed, block) = (captured_at.seconds(), anchored.time.seconds());
        if block > claimed.saturating_add(USUAL) {
            let apart = span(block - claimed);
            warnings.push(format!(
                "it was anchored {apart} after its owner claims it was captured; nothing proves that time"
            ));
        } else if claimed > block.saturating_add(AFTER) {
            let apart = span(claimed - block);
            warnings
                .push(format!("its owner claims it was captured {apart} after it was anchored, so that time is wrong"));
        }
    }
    if !folders_word.is_empty() {
        let given: Vec<String> = folders_word.iter().map(|word| format!("--{word}")).collect();
        warnings.push(format!(
            "relying on the folder's own claim for {}: whoever made the folder could have made a chain for it; pass {}",
            folders_word.join(" and "),
            given.join(" or ")
        ));
    }
    warnings
}

/// The verdict in words; a record is never called verified without the time shown by its anchor.
pub fn verdict(check: &FolderCheck) -> String {
    let first = match (check.worst, check.anchored) {
        (None, Some(anchored)) => format!(
            "VERIFIED: unaltered, and signed with a key that was its owner's or lent by them; it existed no later than {} \
             (block {}), by the clock of this chain's sealers; captured {} is the owner's claim",
            anchored.time, anchored.block, check.captured_at
        ),
        (None, None) => "NOT VERIFIED: the chain did not give the time of its anchor".to_owned(),
        (Some(ErrorKind::Tampered), _) => "NOT VERIFIED: do not trust this record".to_owned(),
        (Some(_), _) => "NOT VERIFIED: not all of it was checked against the chain".to_owned(),
    };
    let sealed = check.sealed_by.iter().map(|sealed_by| format!("sealed by: {}", sealed_by.text));
    let warnings = check.warnings.iter().map(|warning| format!("WARNING: {warning}"));
    std::iter::once(first).chain(sealed).chain(warnings).collect::<Vec<_>>().join("\n")
}

/// A span of seconds for people, in its two largest units.
fn span(seconds: u64) -> String {
    let units = [(86_400, "d"), (3_600, "h"), (60, "min"), (1, "s")];
    let mut rest = Duration::from_secs(seconds).as_secs();
    let mut parts = Vec::new();
    for (length, unit) in units {
        if rest >= length && parts.len() < 2 {
            parts.push(format!("{} {unit}", rest / length));
        }
        rest %= length;
    }
    if parts.is_empty() { "0 s".to_owned() } else { parts.join(" ") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chain::SealerKind;
    use crate::model::Hash;

    #[test]
    fn each_doubt_has_its_own_words() {
        let at = |seconds| AnchoredAt { block: 3, hash: Hash([0; 32]), time: Timestamp::from_seconds(seconds) };
        let captured = Timestamp::from_seconds(1_000_000);
        let alone = SealedBy { kind: SealerKind::Embedded, alone: true, text: "one program".to_owned() };
        let many = SealedBy { alone: false, ..alone.clone() };
        let of =
            |seconds, sealed: &SealedBy, words: &[&str]| warnings(captured, Some(at(seconds)), Some(sealed), words);
        assert!(of(1_000_100, &many, &[]).is_empty());
        assert!(of(1_000_000, &alone, &[])[0].contains("one program"));
        assert!(of(1_093_784, &many, &[])[0].contains("1 d 2 h after its owner claims"));
        assert!(of(999_900, &many, &[])[0].contains("1 min 40 s after it was anchored"));
        assert!(of(1_000_000, &many, &["genesis", "contract"])[0].contains("--genesis or --contract"));
        assert!(warnings(captured, None, None, &[]).is_empty());
        assert_eq!((span(0), span(59), span(3_601)), ("0 s".into(), "59 s".into(), "1 h 1 s".into()));
    }
}

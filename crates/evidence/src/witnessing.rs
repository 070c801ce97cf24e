//! Level (g): a pinned witness countersigned the owner's statement that covers the record's batch, and nothing in the
//! bundle contradicts that statement.

use std::collections::BTreeMap;

use authros_crypto::merkle::Leaf;
use authros_crypto::record::Revealed;
use authros_crypto::{Provider, signer_id};
use authros_model::{Contradiction, Countersignature, Digest, Domain, Hash, Header, Heads, Position, Timestamp, clean};

use crate::bundle::{Anchoring, Bundle, BundledRecord};
use crate::heights::TOPIC;
use crate::report::{Level, Standing};
use crate::time::StampedRoot;
use crate::trust::Trust;
use crate::witness::{BundledCountersignature, check_countersignature, network_of};

/// What a countersignature is worth by itself.
enum Finding {
    /// By a pinned witness.
    Proven(String),
    /// Nothing contradicts it; why it proves nothing yet.
    Claimed(String),
    /// What contradicts it.
    Refused(String),
}

/// A place under a countersignature.
type Place<'a> = (usize, &'a BundledCountersignature, &'a StampedRoot);

/// The countersignatures of a bundle, checked once for all records.
pub(crate) struct Witnessed<'a> {
    /// By the roots that they cover.
    roots: BTreeMap<Hash, Vec<Place<'a>>>,
    findings: Vec<Finding>,
    /// Those by pinned witnesses.
    pinned: Vec<&'a Countersignature>,
}

impl<'a> Witnessed<'a> {
    /// Those of a bundle, by the pinned witnesses.
    pub fn new(bundle: &'a Bundle, trust: Option<&Trust>, bound: &Domain, provider: &dyn Provider) -> Self {
        let (mut roots, mut findings): (BTreeMap<_, Vec<_>>, _) = (BTreeMap::new(), Vec::new());
        let mut pinned = Vec::new();
        for found in bundle.countersignatures.values() {
            for place in &found.roots {
                roots.entry(place.root).or_default().push((findings.len(), found, place));
            }
            let finding = finding(&found.countersignature, (bundle, trust), bound, provider);
            if matches!(finding, Finding::Proven(_)) {
                pinned.push(&found.countersignature);
            }
            findings.push(finding);
        }
        let mut witnessed = Self { roots, findings, pinned };
        witnessed.compare();
        witnessed
    }

    /// Two positions that pinned witnesses saw, and that cannot both be true, whichever was first: witnesses' clocks
    /// differ.
    fn compare(&mut self) {
        let (mut blocks, mut heads) = (BTreeMap::new(), BTreeMap::new());
        let two = self.pinned.iter().find_map(|found| {
            let position = &found.stated.position;
            let (chain, key) = (network_of(position), signer_id(&position.key));
            let blocks_of = [Some((position.block, position.block_hash)), position.earlier].into_iter().flatten();
            for (block, hash) in blocks_of {
                if *blocks.entry((chain, key, block)).or_insert(hash) != hash {
                    return Some(Contradiction::TwoBlocks(block));
                }
            }
            let (number, head) = position.head?;
            let known = *heads.entry((chain, key, position.recorder, number)).or_insert(head);
            (known != head).then_some(Contradiction::TwoHeads(number))
        });
        if let Some(contradiction) = two {
            let text = format!("TWO histories of one owner are countersigned: {contradiction}");
            let proven = self.findings.iter_mut().filter(|finding| matches!(finding, Finding::Proven(_)));
            proven.for_each(|finding| *finding = Finding::Refused(text.clone()));
        }
    }

    /// Level (g) of a record, and when a pinned witness saw the statement about its batch.
    pub fn level(&self, digest: Digest, header: &Header, record: &BundledRecord) -> (Level, Option<Timestamp>) {
        let absent = |text: &str| (Level::new(Standing::Absent, text), None);
        let refused = |text: String| (Level::new(Standing::Refused, text), None);
        let Some((claim, inclusion)) = record.anchor.as_ref().and_then(|claim| Some((claim, claim.inclusion()?)))
        else {
            return absent("no witness: the record is in no batch");
        };
        let Some(places) = self.roots.get(&inclusion.root) else {
            return absent("no witness's countersignature over its batch is in the bundle");
        };
        let Header { owner, recorder, topic_id, seq, .. } = *header;
        if !inclusion.proves(&Leaf { owner, recorder, topic_id, seq, digest }) {
            return refused("its path does not lead to the root that was countersigned".to_owned());
        }
        let mut best: Option<(Timestamp, String)> = None;
        let mut claimed = None;
        for (at, found, place) in places {
            let Countersignature { stated, at: seen, witness, .. } = &found.countersignature;
            let position = &stated.position;
            if !found.leads(place) {
                return refused("the path of its batch's root does not lead to what was countersigned".to_owned());
            }
            let anchored_by = match &claim.anchor {
                Anchoring::Batch { account, .. } => *account,
                Anchoring::Each {} => owner,
            };
            if position.owner != owner && position.owner != anchored_by {
                let text = format!(
                    "{witness} countersigned a statement of {}, who neither owns the record nor anchored it",
                    position.owner
                );
                return refused(text);
            }
            if claim.block > position.block {
                return refused(format!(
                    "anchored in block {}, as the bundle says; its owner stated to {witness} that it was by block {}",
                    claim.block, position.block
                ));
            }
            match self.findings.get(*at) {
                Some(Finding::Refused(why)) => return refused(why.clone()),
                Some(Finding::Proven(text)) if best.as_ref().is_none_or(|(known, _)| seen < known) => {
                    best = Some((*seen, text.clone()));
                }
                Some(Finding::Claimed(text)) => drop(claimed.get_or_insert_with(|| text.clone())),
                Some(Finding::Proven(_)) | None => {}
            }
        }
        match (best, claimed) {
            (Some((seen, text)), _) => (Level::new(Standing::Proven, text), Some(seen)),
            (None, Some(text)) => (Level::new(Standing::Unproven, text), None),
            (None, None) => absent("no witness's countersignature over its batch is in the bundle"),
        }
    }

    /// The reason if this opened record is a head of a recorder that stated another one, of that number, to a pinned
    /// witness.
    pub fn other_head(&self, digest: Digest, header: &Header, revealed: &Revealed) -> Option<String> {
        if revealed.head.topic != TOPIC || revealed.head.type_name != Heads::TYPE {
            return None;
        }
        self.pinned.iter().find_map(|found| {
            let Position { owner, recorder, head, .. } = found.stated.position;
            let (number, stated) = head?;
            let same = (owner, recorder, number) == (header.owner, header.recorder, header.seq);
            (same && stated != digest).then(|| {
                format!("its recorder stated another head of number {number} to {}: two histories", found.witness)
            })
        })
    }
}

fn finding(
    found: &Countersignature,
    (bundle, trust): (&Bundle, Option<&Trust>),
    bound: &Domain,
    provider: &dyn Provider,
) -> Finding {
    if let Err(error) = check_countersignature(found, provider) {
        return Finding::Refused(format!("a countersignature: {error}"));
    }
    let (position, witness, at) = (&found.stated.position, found.witness, found.at);
    if network_of(position) != *bound {
        return Finding::Refused(format!("the countersignature of {witness} is about another chain or contract"));
    }
    for (block, hash) in [Some((position.block, position.block_hash)), position.earlier].into_iter().flatten() {
        if bundle.headers.get(&block).is_some_and(|header| header.hash != hash) {
            return Finding::Refused(format!(
                "block {block} is another one than its owner stated to {witness}, who countersigned it at {at}: the chain \
                 was written anew"
            ));
        }
    }
    let pinned = trust.and_then(|trust| trust.witness(witness));
    let key = signer_id(&found.key);
    let Some(pinned) = pinned else {
        let text = format!("countersigned at {at} by {witness}, whom you did not pin: this proves nothing yet");
        return Finding::Claimed(text);
    };
    if pinned.key != key {
        return Finding::Refused(format!(
            "countersigned as {witness} by the key {key}, which is not the one you pinned"
        ));
    }
    if witness == position.owner || found.key == position.key {
        return Finding::Claimed(format!("countersigned at {at} by its owner himself: this proves nothing"));
    }
    let shown = match bundle.headers.contains_key(&position.block) {
        true => "the one that is here",
        false => "which is not in the bundle",
    };
    Finding::Proven(format!(
        "by {at}, on the clock of {} whom you pinned, {} had stated its batch and block {} of the chain, {shown}",
        clean(&pinned.name, 80),
        position.owner,
        position.block
    ))
}

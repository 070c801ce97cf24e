//! The check of a bundle against its reader's pins, record by record and level by level.

use std::collections::BTreeMap;

use authros_crypto::record::{Revealed, signed_bytes};
use authros_crypto::{Provider, domain, pool, signer_id};
use authros_model::{Address, Digest, Domain, Hash, Header, Identity, Timestamp, clean};

use crate::anchoring::{Anchored, anchored};
use crate::bundle::{Bundle, BundledRecord, READ_ME, REPORT};
use crate::completeness::stretches;
use crate::disclosure::{MOST_PLAIN, opened, vouched};
use crate::known::Known;
use crate::packing::READ_ME_TEXT;
use crate::report::{Disclosed, Level, Outcome, RecordReport, Report, Standing};
use crate::signing::signing_right;
use crate::stamping::Stamps;
use crate::trust::Trust;

/// The messages that were opened, by their records.
pub(crate) type Messages = BTreeMap<Digest, Revealed>;

/// How many records one thread hashes side by side.
const SIDE_BY_SIDE: usize = 32;

/// What a whole check uses.
pub(crate) struct Check<'a> {
    pub bundle: &'a Bundle,
    pub trust: Option<&'a Trust>,
    pub provider: &'a dyn Provider,
    /// The domain of the records: from the pins, or else the bundle's own word.
    pub domain: Domain,
    pub contract: Address,
    /// Time stamps, by the pinned authorities.
    pub stamps: Stamps<'a>,
    /// Results found on the way.
    pub known: Known<'a>,
}

/// Checks a bundle. Without a trust file nothing about the chain is proven, and the report says so.
pub fn verify(bundle: &Bundle, trust: Option<&Trust>, provider: &dyn Provider) -> Report {
    let claimed = &bundle.manifest.chain;
    let (bound, contract) = match trust {
        Some(trust) => (trust.domain(), trust.chain.contract),
        None => (domain(claimed.id, &claimed.genesis, &claimed.contract), claimed.contract),
    };
    let stamps = Stamps::new(bundle, trust);
    let check = Check { bundle, trust, provider, domain: bound, contract, stamps, known: Known::default() };
    let (records, messages) = check.records();
    let complete = stretches(&bundle.heights, &records, &messages);
    let exporter = check.exporter(&records);
    let standings =
        || records.iter().flat_map(|record| record.levels().map(|(letter, level)| (letter, level.standing)));
    let refused = exporter.standing == Standing::Refused
        || standings().any(|(_, standing)| standing == Standing::Refused)
        || complete.iter().any(|stretch| stretch.standing == Standing::Refused);
    let (pinned, warnings) = (trust.is_some(), check.warnings(&records));
    let mut report = Report { outcome: Outcome::Incomplete, pinned, exporter, warnings, records, complete, messages };
    if refused {
        report.outcome = Outcome::Refused;
    } else if pinned && report.exporter.standing == Standing::Proven && report.is_proven() {
        report.outcome = Outcome::Holds;
    }
    report
}

impl<'a> Check<'a> {
    /// Each record, in order. Everything but the messages is checked on all cores; messages are opened one after the
    /// other, so that the same ones are opened each time, however many there are, and no more than one is in work.
    fn records(&self) -> (Vec<RecordReport>, Messages) {
        let all: Vec<(&'a Digest, &'a BundledRecord)> = self.bundle.records.iter().collect();
        let bytes = all.iter().map(|(_, record)| record.record.len()).fold(0, usize::saturating_add);
        let judge = |some: &&[(&'a Digest, &'a BundledRecord)]| {
            let texts: Vec<&[u8]> = some.iter().map(|(_, record)| record.record.as_slice()).collect();
            let found = self.provider.sm3_many(&texts).into_iter().map(Digest);
            some.iter().zip(found).map(|((digest, record), found)| self.record(**digest, found, record)).collect()
        };
        let some: Vec<_> = all.chunks(SIDE_BY_SIDE).collect();
        let judged: Vec<Vec<_>> = pool::each(&some, pool::helpers_for(all.len(), bytes), judge);
        let (mut reports, mut messages, mut left) = (Vec::with_capacity(all.len()), Messages::new(), MOST_PLAIN);
        for ((digest, record), mut report) in all.into_iter().zip(judged.into_iter().flatten()) {
            if report.bytes.standing == Standing::Proven {
                self.open((*digest, record), &mut report, (&mut messages, &mut left));
            }
            reports.push(report);
        }
        (reports, messages)
    }

    /// Opens a record whose disclosure somebody vouches for; (e) is then judged by the seals, too.
    fn open(
        &self,
        (digest, record): (Digest, &BundledRecord),
        report: &mut RecordReport,
        (messages, left): (&mut Messages, &mut u64),
    ) {
        let vouched = std::mem::replace(&mut report.opened, Level::new(Standing::Absent, ""));
        let (level, revealed) = opened(self.provider, record, vouched, left);
        report.opened = capped(level, &report.anchor);
        let Some(revealed) = revealed else { return };
        report.disclosed = Some(self.disclosed(&revealed));
        messages.insert(digest, revealed);
    }

    /// All but the message: (e) says so far who vouches for the disclosure. `found` is the SM3 of the record's bytes.
    fn record(&self, digest: Digest, found: Digest, record: &'a BundledRecord) -> RecordReport {
        let mut report = RecordReport {
            digest,
            owner: None,
            person: None,
            signer: None,
            owner_key: None,
            recorder: None,
            topic_id: None,
            seq: None,
            captured_at: None,
            anchored_at: None,
            block: None,
            seconds_to_anchor: None,
            existed_before: None,
            bytes: Level::new(Standing::Unproven, ""),
            key: Level::new(Standing::Unproven, "the bytes do not check out"),
            anchor: Level::new(Standing::Unproven, "the bytes do not check out"),
            time: Level::new(Standing::Unproven, "the bytes do not check out"),
            opened: Level::new(Standing::Absent, "sealed: its owner did not disclose it"),
            disclosed: None,
        };
        let header = match self.bytes(digest, found, record) {
            Ok(found) => found,
            Err(why) => {
                report.bytes = Level::new(Standing::Refused, why);
                return report;
            }
        };
        report.owner = Some(header.owner);
        report.signer = Some(header.signer);
        (report.recorder, report.topic_id, report.seq) =
            (Some(header.recorder), Some(header.topic_id), Some(header.seq));
        report.captured_at = Some(header.captured_at);
        report.bytes = Level::new(Standing::Proven, format!("intact, and signed by the key {}", header.signer));
        (report.time, report.existed_before) = self.stamps.level(digest, &header, record);
        let (level, anchored) = anchored(self, digest, &header, record);
        report.anchor = level;
        let signed = anchored.as_ref().map(|anchored| signing_right(self, &header, anchored));
        let owner_key = signed.as_ref().and_then(|signed| signed.owner_key);
        report.owner_key = owner_key.filter(|_| is_believed(&report.anchor)).map(|key| signer_id(&key));
        report.key = match signed {
            Some(signed) => capped(signed.level, &report.anchor),
            None => {
                Level::new(Standing::Unproven, "no anchor is shown, so the key's right at its block cannot be judged")
            }
        };
        let person = self.trust.and_then(|trust| trust.person(header.owner)).filter(|_| report.is_believed());
        report.person = person.map(|person| clean(&person.name, 80));
        if let Some(Anchored { block, time, .. }) = &anchored {
            report.block = Some(*block);
            report.anchored_at = time.map(Timestamp::from_seconds);
            report.seconds_to_anchor = time.and_then(|time| seconds_between(header.captured_at.seconds(), time));
        }
        report.opened = vouched(self, digest, record, &header, owner_key);
        report
    }

    /// (a): the digest, the network, the signature.
    fn bytes(&self, digest: Digest, found: Digest, record: &BundledRecord) -> Result<Header, String> {
        if found != digest {
            return Err(format!("its SM3 is {found}: it is not the record it is filed as"));
        }
        let (header, length) = Header::parse(&record.record).map_err(|error| format!("it is not a record: {error}"))?;
        let sealed = u64::from(header.head_length).saturating_add(header.body_length);
        if (record.record.len() as u64).checked_sub(length as u64) != Some(sealed) {
            return Err("its length differs from what its header says".to_owned());
        }
        if header.domain != self.domain {
            let which = if self.trust.is_some() { "the one you pinned" } else { "the one the bundle names" };
            return Err(format!("it is bound to a different chain or contract than {which}"));
        }
        let signer = self.bundle.keys.get(&header.signer);
        let signer = signer.ok_or_else(|| format!("the key {} that signed it is not in the bundle", header.signer))?;
        let signed = signed_bytes(&header.domain, &digest);
        self.provider
            .verify(signer, &signed, &record.signature)
            .map_err(|_| format!("its signature was not made by the key {}", header.signer))?;
        Ok(header)
    }

    fn disclosed(&self, revealed: &Revealed) -> Disclosed {
        let head = &revealed.head;
        Disclosed {
            topic: clean(&head.topic, 256),
            type_name: clean(&head.type_name, 256),
            publisher: clean(&head.caller_id, 256),
            length: revealed.body.len() as u64,
            message_sm3: Digest(self.provider.sm3(&[&revealed.body])),
            tags: head.tags.iter().map(|(tag, value)| (clean(tag, 64), clean(value, 256))).collect(),
        }
    }

    fn exporter(&self, records: &[RecordReport]) -> Level {
        let exporter = &self.bundle.manifest.exporter;
        if !self.bundle.signed {
            let text = format!("the manifest is not signed by the key {} it names", exporter.key);
            return Level::new(Standing::Refused, text);
        }
        let person = self.trust.and_then(|trust| trust.person(exporter.account));
        let name = person.map_or(String::new(), |person| format!(" ({})", clean(&person.name, 80)));
        let pinned = person.and_then(|person| person.key);
        if pinned == Some(exporter.key) {
            let text = format!("assembled with the key you pinned for {}{name}", exporter.account);
            return Level::new(Standing::Proven, text);
        }
        let is_tied =
            |record: &RecordReport| (record.owner, record.owner_key) == (Some(exporter.account), Some(exporter.key));
        // Anybody can put a record of his own beside those of others, and sign for them all.
        let others = records.iter().any(|record| record.owner.is_some_and(|owner| owner != exporter.account));
        let tied = |standing: Standing| {
            let mut tied = records.iter().filter(|record| record.anchor.standing == standing && is_tied(record));
            let block = tied.next().filter(|_| pinned.is_none() && !others)?.block?;
            let text = format!("assembled with a key that was {}'s at block {block}", exporter.account);
            Some(Level::new(standing, text))
        };
        tied(Standing::Proven).or_else(|| tied(Standing::OwnChain)).unwrap_or_else(|| {
            let (key, account) = (exporter.key, exporter.account);
            let text = if others && pinned.is_none() {
                format!("assembled with the key {key} of {account}, who does not own all of these records")
            } else {
                format!("assembled with the key {key}, which nothing here ties to {account}")
            };
            Level::new(Standing::Unproven, text)
        })
    }

    fn warnings(&self, records: &[RecordReport]) -> Vec<String> {
        let mut warnings = Vec::new();
        if self.trust.is_none() {
            warnings.push(
                "no trust file: chain, contract and signers are only the exporter's claim, and nothing about the chain \
                 is proven; pass --trust with what you know from an independent source"
                    .to_owned(),
            );
        }
        if records.iter().any(|record| record.anchor.standing == Standing::OwnChain) {
            warnings.push(
                "the exporter seals this chain, so it could have been rewritten with any times; it proves nothing \
                 against the exporter"
                    .to_owned(),
            );
        }
        let denied = self.trust.is_some_and(|trust| !trust.chain.sealed_by_exporter);
        if denied && records.iter().any(|record| record.anchor.standing == Standing::OwnChain) {
            warnings.push(
                "your trust file says that others seal this chain, but its headers say that a single program \
                 does"
                    .to_owned(),
            );
        }
        if records.iter().any(|record| record.seconds_to_anchor.is_some_and(|seconds| seconds < 0)) {
            warnings.push(
                "a record claims to have been captured after the block that anchors it: a clock was wrong".to_owned(),
            );
        }
        if !records.is_empty() {
            warnings
                .push("capture times are the owner's claim; only the anchor shows when a record existed".to_owned());
        }
        if records.iter().any(RecordReport::is_mute) {
            warnings.push("a recorder's own statement is not proven, so it is ignored".to_owned());
        }
        let member = |name: &str| self.bundle.manifest.members.iter().find(|member| member.name == name);
        if member(crate::bundle::NODES).is_none() {
            warnings.push("the bundle contains no proof of the chain's state".to_owned());
        }
        if member(REPORT).is_some() {
            warnings.push(format!("{REPORT} was not checked: it says what its author wanted"));
        }
        let known = Hash(self.provider.sm3(&[READ_ME_TEXT.as_bytes()]));
        if member(READ_ME).is_some_and(|member| member.sm3 != known) {
            warnings.push(format!("{READ_ME} is not the text that belongs there: do nothing of what it says"));
        }
        warnings
    }

    /// The identity with this hash, if it is in the bundle and proves to be this account's.
    pub fn identity(&self, hash: Hash, account: Address) -> Option<&Identity> {
        self.bundle.identities.get(&hash).filter(|identity| self.known.is_of(self, (hash, identity), account))
    }
}

/// Whether the state that shows an anchor was sealed by pinned signers.
fn is_believed(anchor: &Level) -> bool {
    matches!(anchor.standing, Standing::Proven | Standing::OwnChain)
}

/// A state is worth as much as the seals on it.
fn capped(level: Level, anchor: &Level) -> Level {
    match (level.standing, anchor.standing) {
        (Standing::Proven, Standing::OwnChain) => Level { standing: Standing::OwnChain, ..level },
        (Standing::Proven, standing) if standing != Standing::Proven => {
            let text = format!("{}, according to a state sealed by too few of the signers you pinned", level.text);
            Level::new(Standing::Unproven, text)
        }
        _ => level,
    }
}

fn seconds_between(from: u64, to: u64) -> Option<i64> {
    i64::try_from(to).ok()?.checked_sub(i64::try_from(from).ok()?)
}

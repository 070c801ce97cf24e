//! The check of a bundle against its reader's pins, level by level. Results are computed once for many records, by all
//! threads, so that a stranger's file costs no more than its length.

use std::collections::BTreeMap;
use std::sync::{PoisonError, RwLock};

use crate::bundle::{
    AnchorClaim, Anchoring, Bundle, BundledRecord, Disclosure, MOST_PLAIN, READ_ME, READ_ME_TEXT, REPORT, opened,
    vouched,
};
use crate::committed::{Anchored, Seals, anchored};
use crate::completeness::stretches;
use crate::report::{Disclosed, Level, Outcome, Reason, RecordReport, Report, Standing};
use crate::state::{AnchorWord, KeysWord, Storage, Unproven};
use crate::time::{BundledStamp, Certificate, StampedRoot, TimeError, check_token};
use crate::trust::{PinnedAuthority, Trust};
use crate::verdict::{Context, verdict};
use authros_crypto::merkle::{KnownPaths, Leaf};
use authros_crypto::record::{Revealed, signed_bytes};
use authros_crypto::{Provider, domain, pool, signer_id};
use authros_model::{Address, Digest, Domain, Hash, Header, Identity, PublicKey, SignerId, Timestamp, clean};

pub(crate) type Messages = BTreeMap<Digest, Revealed>;

const SIDE_BY_SIDE: usize = 32;

pub(crate) struct Check<'a> {
    pub bundle: &'a Bundle,
    pub trust: Option<&'a Trust>,
    pub provider: &'a dyn Provider,
    /// The domain of the records: from the pins, or else the bundle's own word.
    pub domain: Domain,
    pub contract: Address,
    pub stamps: Stamps<'a>,
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
    let (outcome, verdict) = (Outcome::Incomplete, Vec::new());
    let mut report = Report { outcome, verdict, pinned, exporter, warnings, records, complete, messages };
    if refused {
        report.outcome = Outcome::Refused;
    } else if pinned && report.exporter.standing == Standing::Proven && report.is_proven() {
        report.outcome = Outcome::Holds;
    }
    report.verdict = self::verdict(&report, &check.context(&report));
    report
}

impl<'a> Check<'a> {
    /// Opens messages one after the other: the same ones each time, and only one is in memory while it is opened.
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

    fn open(
        &self,
        (digest, record): (Digest, &BundledRecord),
        report: &mut RecordReport,
        (messages, left): (&mut Messages, &mut u64),
    ) {
        let vouched = std::mem::replace(&mut report.opened, Level::new(Standing::Absent, ""));
        let (level, revealed) = opened(self, (digest, record), vouched, left);
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
            authority: None,
            bytes: Level::follows(""),
            key: Level::follows("the bytes do not check out"),
            anchor: Level::follows("the bytes do not check out"),
            time: Level::follows("the bytes do not check out"),
            opened: Level::new(Standing::Absent, "sealed: its owner did not disclose it"),
            disclosed: None,
        };
        let header = match self.bytes(digest, found, record) {
            Ok(found) => found,
            Err((reason, why)) => {
                report.bytes = Level::refused(reason, why);
                return report;
            }
        };
        report.owner = Some(header.owner);
        report.signer = Some(header.signer);
        (report.recorder, report.topic_id, report.seq) =
            (Some(header.recorder), Some(header.topic_id), Some(header.seq));
        report.captured_at = Some(header.captured_at);
        report.bytes = Level::proven(format!("intact, and signed by the key {}", header.signer));
        let (time, existed) = self.stamps.level(digest, &header, record);
        (report.existed_before, report.authority) = existed.unzip();
        report.time = time;
        let (level, anchored) = anchored(self, digest, &header, record);
        report.anchor = level;
        let signed = anchored.as_ref().map(|anchored| signing_right(self, &header, anchored));
        let owner_key = signed.as_ref().and_then(|signed| signed.owner_key);
        report.owner_key = owner_key.filter(|_| is_believed(&report.anchor)).map(|key| signer_id(&key));
        report.key = match signed {
            Some(signed) => capped(signed.level, &report.anchor),
            None => Level::follows("no anchor is shown, so the key's right at its block cannot be judged"),
        };
        let person = self.trust.and_then(|trust| trust.person(header.owner)).filter(|_| report.is_believed());
        report.person = person.map(|person| clean(&person.name, 80));
        if let Some(Anchored { block, time, .. }) = &anchored {
            report.block = Some(*block);
            report.anchored_at = time.map(Timestamp::from_seconds);
            report.seconds_to_anchor = time.and_then(|time| seconds_between(header.captured_at.seconds(), time));
        }
        report.opened = vouched(self, digest, &header, owner_key);
        report
    }

    fn bytes(&self, digest: Digest, found: Digest, record: &BundledRecord) -> Result<Header, (Reason, String)> {
        if found != digest {
            let text = format!("its SM3 is {found}: it is not the record it is filed as");
            return Err((Reason::NotAsFiled, text));
        }
        let parsed = Header::parse(&record.record);
        let (header, length) = parsed.map_err(|error| (Reason::NotARecord, format!("it is not a record: {error}")))?;
        let sealed = u64::from(header.head_length).saturating_add(header.body_length);
        if (record.record.len() as u64).checked_sub(length as u64) != Some(sealed) {
            return Err((Reason::NotARecord, "its length differs from what its header says".to_owned()));
        }
        if header.domain != self.domain {
            let which = if self.trust.is_some() { "the one you pinned" } else { "the one the bundle names" };
            return Err((Reason::OtherChain, format!("it is bound to a different chain or contract than {which}")));
        }
        let signer = self.bundle.keys.get(&header.signer);
        let missing = || format!("the key {} that signed it is not in the bundle", header.signer);
        let signer = signer.ok_or_else(|| (Reason::SignerMissing, missing()))?;
        let signed = signed_bytes(&header.domain, &digest);
        self.provider
            .verify(signer, &signed, &record.signature)
            .map_err(|_| (Reason::BadSignature, format!("its signature was not made by the key {}", header.signer)))?;
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
            return Level::proven(text);
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
            Level::follows(text)
        })
    }

    fn warnings(&self, records: &[RecordReport]) -> Vec<String> {
        let mut warnings = Vec::new();
        let mut warn = |applies: bool, text: &str| warnings.extend(applies.then(|| text.to_owned()));
        warn(
            self.trust.is_none(),
            "no trust file: chain, contract and signers are only the exporter's claim, and nothing about the chain is \
             proven; pass --trust with what you know from an independent source",
        );
        let by_own_chain = records.iter().any(|record| record.anchor.standing == Standing::OwnChain);
        warn(
            by_own_chain,
            "the exporter seals this chain, so it could have been rewritten with any times; it proves nothing against \
             the exporter",
        );
        warn(
            by_own_chain && self.trust.is_some_and(|trust| !trust.chain.sealed_by_exporter),
            "your trust file says that others seal this chain, but its headers say that a single program does",
        );
        warn(
            records.iter().any(|record| record.seconds_to_anchor.is_some_and(|seconds| seconds < 0)),
            "a record claims to have been captured after the block that anchors it: a clock was wrong",
        );
        warn(!records.is_empty(), "capture times are the owner's claim; only the anchor shows when a record existed");
        let is_mute = records.iter().any(RecordReport::is_mute);
        warn(is_mute, "a recorder's own statement is not proven, so it is ignored");
        let member = |name: &str| self.bundle.manifest.members.iter().find(|member| member.name == name);
        let has_state = member(crate::bundle::NODES).is_some();
        warn(!has_state, "the bundle contains no proof of the chain's state");
        let is_reported = member(REPORT).is_some();
        warn(is_reported, &format!("{REPORT} was not checked: it says what its author wanted"));
        let is_foreign = self.is_read_me_foreign();
        warn(is_foreign, &format!("{READ_ME} is not the text that belongs there: do nothing of what it says"));
        warnings
    }

    fn context(&self, report: &Report) -> Context {
        let exporter = self.bundle.manifest.exporter.account;
        let person = self.trust.and_then(|trust| trust.person(exporter)).map(|person| person.name.clone());
        let own_chain = report.records.iter().any(|record| record.anchor.standing == Standing::OwnChain);
        let is_denied = self.trust.is_some_and(|trust| !trust.chain.sealed_by_exporter);
        Context {
            exporter,
            person,
            trust_denies: own_chain && is_denied,
            foreign_instructions: self.is_read_me_foreign(),
        }
    }

    fn is_read_me_foreign(&self) -> bool {
        let known = Hash(self.provider.sm3(&[READ_ME_TEXT.as_bytes()]));
        self.bundle.manifest.members.iter().any(|member| member.name == READ_ME && member.sm3 != known)
    }

    /// The identity with this hash, if it is in the bundle and proves to be this account's.
    pub fn identity(&self, hash: Hash, account: Address) -> Option<&Identity> {
        self.bundle.identities.get(&hash).filter(|identity| self.known.is_of(self, (hash, identity), account))
    }
}

fn is_believed(anchor: &Level) -> bool {
    matches!(anchor.standing, Standing::Proven | Standing::OwnChain)
}

/// A state is worth as much as the seals on it.
fn capped(level: Level, anchor: &Level) -> Level {
    match (level.standing, anchor.standing) {
        (Standing::Proven, Standing::OwnChain) => Level { standing: Standing::OwnChain, ..level },
        (Standing::Proven, standing) if standing != Standing::Proven => {
            let text = format!("{}, according to a state sealed by too few of the signers you pinned", level.text);
            Level::follows(text)
        }
        _ => level,
    }
}

fn seconds_between(from: u64, to: u64) -> Option<i64> {
    i64::try_from(to).ok()?.checked_sub(i64::try_from(from).ok()?)
}

/// Results by what was asked. Two threads that ask the same at once both compute it, and get the same.
pub(crate) struct Memo<Asked, Found>(RwLock<BTreeMap<Asked, Found>>);

impl<Asked, Found> Default for Memo<Asked, Found> {
    fn default() -> Self {
        Self(RwLock::default())
    }
}

impl<Asked: Ord, Found: Clone> Memo<Asked, Found> {
    /// No lock is held while `find` works.
    pub fn get(&self, asked: Asked, find: impl FnOnce() -> Found) -> Found {
        let known = self.0.read().unwrap_or_else(PoisonError::into_inner).get(&asked).cloned();
        known.unwrap_or_else(|| {
            let found = find();
            self.0.write().unwrap_or_else(PoisonError::into_inner).entry(asked).or_insert(found).clone()
        })
    }
}

/// Blocks are those whose state is read.
#[derive(Default)]
pub(crate) struct Known<'a> {
    pub storages: Memo<u64, Result<Storage<'a>, Unproven>>,
    pub seals: Memo<u64, Seals>,
    identities: Memo<(Hash, Address), bool>,
    pub anchors: Memo<(u64, Address, Hash), Result<Option<AnchorWord>, Unproven>>,
    keys: Memo<(u64, Address, u64), Result<Option<KeysWord>, Unproven>>,
    suspensions: Memo<(u64, Address), Result<bool, Unproven>>,
    rights: Memo<(Address, SignerId, Place), Signed>,
    disclosers: Memo<SignerId, bool>,
    /// Level (c) of the records that were anchored alike.
    pub sealings: Memo<(u64, u64, Option<u64>), Level>,
    paths: KnownPaths<'a>,
}

type Place = (u64, u64, Option<u64>, Address, Option<u64>, u64);

impl<'a> Known<'a> {
    pub fn is_of(&self, check: &Check<'_>, (hash, identity): (Hash, &Identity), account: Address) -> bool {
        let prove = || authros_crypto::check_identity(check.provider, &check.domain, &account, identity).is_ok();
        self.identities.get((hash, account), prove)
    }

    /// Whether this key signed what is disclosed.
    pub fn has_signed(&self, check: &Check<'_>, disclosure: &Disclosure, key: &PublicKey) -> bool {
        self.disclosers.get(signer_id(key), || disclosure.is_signed(&check.domain, key, check.provider))
    }

    fn keys(
        &self,
        (shown_at, storage): (u64, &Storage<'_>),
        account: Address,
        version: u64,
    ) -> Result<Option<KeysWord>, Unproven> {
        self.keys.get((shown_at, account, version), || storage.keys(account, version))
    }

    /// A claim without a path has nothing to show.
    pub fn leads(&self, leaf: &Leaf, claim: &'a AnchorClaim) -> bool {
        let Anchoring::Batch { root, index, count, path, .. } = &claim.anchor else { return true };
        self.paths.lead(leaf.hash(), (*index, *count), path, *root)
    }
}

/// Before when, and according to whom.
type Existed = (Timestamp, String);

#[derive(Default)]
struct Finding {
    /// The earliest by a pinned authority.
    proven: Option<Existed>,
    /// The earliest by the authority's own word.
    claimed: Option<Existed>,
    refused: Option<TimeError>,
}

#[derive(Default)]
pub(crate) struct Stamps<'a> {
    roots: BTreeMap<Hash, Vec<(usize, &'a BundledStamp, &'a StampedRoot)>>,
    findings: Vec<Finding>,
}

impl<'a> Stamps<'a> {
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

    pub fn level(&self, digest: Digest, header: &Header, record: &BundledRecord) -> (Level, Option<Existed>) {
        let absent = |text: &str| (Level::new(Standing::Absent, text), None);
        let Some(inclusion) = record.anchor.as_ref().and_then(|claim| claim.inclusion()) else {
            return absent("no authority's time stamp: the record is not in a batch");
        };
        let Some(found) = self.roots.get(&inclusion.root) else {
            return absent("no authority's time stamp over its batch is in the bundle");
        };
        if !inclusion.proves(&Leaf::of(header, digest)) {
            return (Level::refused(Reason::StampPath, "its path does not lead to the stamped root"), None);
        }
        let mut best = Finding::default();
        for (at, stamp, place) in found {
            let Some(finding) = self.findings.get(*at) else { continue };
            if !stamp.leads(place) {
                let text = "the path of its batch's root does not lead to what was stamped";
                return (Level::refused(Reason::StampPath, text), None);
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

    fn told(self) -> (Level, Option<Existed>) {
        if let Some(error) = self.refused {
            return (Level::refused(Reason::BadStamp, format!("a time stamp: {error}")), None);
        }
        if let Some((before, who)) = self.proven {
            let text = format!(
                "existed before {before}, by the time stamp of {who}, whom you pinned; certificate revocation is not \
                 checked"
            );
            return (Level::proven(text), Some((before, who)));
        }
        let text = self.claimed.map_or_else(
            || "it contains no time stamp".to_owned(),
            |(before, who)| format!("stamped before {before} by {who}, whom you did not pin: this proves nothing yet"),
        );
        (Level::unproven(Reason::UnknownAuthority, text), None)
    }
}

fn earlier(one: Option<Existed>, other: Option<Existed>) -> Option<Existed> {
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

#[derive(Clone)]
pub(crate) struct Signed {
    /// Level (b), as far as the state itself is trusted.
    pub level: Level,
    /// The key that the owner had registered at the anchoring block.
    pub owner_key: Option<PublicKey>,
}

fn signing_right(check: &Check<'_>, header: &Header, anchored: &Anchored<'_>) -> Signed {
    let Anchored { shown_at, block, time, account, keys, claimed_keys, .. } = *anchored;
    let place = (shown_at, block, time, account, keys, claimed_keys);
    check.known.rights.get((header.owner, header.signer, place), || right(check, header, anchored))
}

fn right(check: &Check<'_>, header: &Header, anchored: &Anchored<'_>) -> Signed {
    match owner_key(check, header, anchored) {
        Ok(key) => {
            let (Ok(level) | Err(level)) = judged(check, header, anchored, &key);
            Signed { level, owner_key: Some(key) }
        }
        Err(level) => Signed { level, owner_key: None },
    }
}

fn unshown(why: Unproven, anchored: &Anchored<'_>) -> Level {
    let at = anchored.shown_at;
    match why {
        Unproven::Missing(_) => {
            let text = format!(
                "the part of the state after block {at} that holds the key's registration is not in the bundle"
            );
            Level::unproven(Reason::RegistrationMissing, text)
        }
        why => Level::refused(Reason::RegistrationBroken, format!("the key's registration: {why}")),
    }
}

fn judged(check: &Check<'_>, header: &Header, anchored: &Anchored<'_>, registered: &PublicKey) -> Result<Level, Level> {
    let (owner, block, at) = (header.owner, anchored.block, anchored.shown_at);
    let how = if signer_id(registered) == header.signer {
        format!("the key was {owner}'s at block {block}")
    } else {
        lent(header, anchored)?;
        format!("the key {} belongs to a device that {owner} had authorised at block {block}", header.signer)
    };
    // The contract lets no suspended account anchor, but the state is that after the block, in which the owner may have
    // been suspended later. A later state with a suspension does not show that it came after the block.
    let suspended = check.known.suspensions.get((at, owner), || anchored.storage.is_suspended(owner));
    let suspended = suspended.map_err(|why| unshown(why, anchored))?;
    Ok(match (suspended, at == block) {
        (true, true) => Level::refused(Reason::Suspended, format!("{owner} was suspended at block {block}")),
        (false, true) => Level::proven(format!("{how}, and {owner} was not suspended")),
        (true, false) => {
            let text = format!("{how}; {owner} is suspended at block {at}, but there is no proof since when");
            Level::unproven(Reason::SuspensionUnknown, text)
        }
        (false, false) if anchored.account == owner => Level::proven(format!(
            "{how}, and {owner} was not suspended when this was anchored: it anchored this itself"
        )),
        (false, false) => {
            let text = format!(
                "{how}; {owner} is not suspended at block {at}, but nothing shows whether it was at block {block}"
            );
            Level::unproven(Reason::SuspensionUnknown, text)
        }
    })
}

/// The key that the owner had registered at the anchoring block.
fn owner_key(check: &Check<'_>, header: &Header, anchored: &Anchored<'_>) -> Result<PublicKey, Level> {
    let (owner, block, state) = (header.owner, anchored.block, (anchored.shown_at, &anchored.storage));
    let unknown = |reason, why: String| Err(Level::unproven(reason, why));
    let keys_of = |version| check.known.keys(state, owner, version).map_err(|why| unshown(why, anchored));
    let version = anchored.keys.filter(|_| anchored.account == owner).unwrap_or(anchored.claimed_keys);
    let Some(keys) = keys_of(version)? else {
        let text = format!("{owner} has no version {version} of its keys on this chain");
        return unknown(Reason::NoKeys, text);
    };
    // The contract notes the version with the owner's own anchor, but the keys may have changed later in that block.
    let after = version.checked_add(1).map(keys_of).transpose()?.flatten();
    if keys.block > block || after.is_some_and(|after| after.block <= block) {
        let text = format!("version {version} of {owner}'s keys was not the one in force at block {block}");
        return unknown(Reason::KeysReplaced, text);
    }
    let Some(identity) = check.identity(keys.identity, owner) else {
        let hash = keys.identity;
        let text = format!("the identity {hash} of {owner} is not in the bundle, or its own proof fails");
        return unknown(Reason::IdentityMissing, text);
    };
    let pinned = check.trust.and_then(|trust| trust.person(owner)).and_then(|person| person.key);
    if pinned.is_some_and(|pinned| pinned != signer_id(&identity.signing)) {
        return unknown(Reason::OtherKey, format!("the key that {owner} had registered is not the one you pinned"));
    }
    Ok(identity.signing)
}

fn lent(header: &Header, anchored: &Anchored<'_>) -> Result<(), Level> {
    let (owner, block) = (header.owner, anchored.block);
    let unproven = |text: String| Err(Level::unproven(Reason::DeviceUnknown, text));
    let refused = |text: String| Err(Level::refused(Reason::NoRight, text));
    let loan = anchored.storage.loan(owner, &header.signer.0).map_err(|why| unshown(why, anchored))?;
    let Some(loan) = loan else {
        return refused(format!("{owner} had neither registered nor authorised the key at block {block}"));
    };
    if loan.lent > block && anchored.shown_at > block {
        return unproven(format!("the device was authorised again later; what applied at block {block} is not shown"));
    }
    if loan.lent > block {
        return refused(format!("{owner} authorised the device only in block {}, after block {block}", loan.lent));
    }
    if loan.recalled != 0 && loan.recalled <= block {
        return refused(format!("{owner} had revoked the device in block {}", loan.recalled));
    }
    match anchored.time {
        _ if loan.until == 0 => Ok(()),
        Some(time) if time < loan.until => Ok(()),
        Some(_) => refused(format!("the device's authorisation had ended by {}", Timestamp::from_seconds(loan.until))),
        None => unproven("the device's authorisation had an end, but the block's time is not shown".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use authros_crypto::merkle::Tree;
    use authros_model::{Digest, RecorderId, SignerId, TopicId};
    use proptest::prelude::*;

    use super::*;

    fn leaf(seq: u64) -> Leaf {
        let digest = Digest([u8::try_from(seq % 251).expect("small"); 32]);
        let (owner, signer) = (Address([1; 20]), SignerId([4; 32]));
        Leaf { owner, signer, recorder: RecorderId([2; 16]), topic_id: TopicId([3; 16]), seq, digest }
    }

    /// A claim of leaf `seq`, altered in one of eight ways or not at all.
    fn claim(tree: &Tree, leaves: u64, (seq, how, at): (u64, u8, usize)) -> AnchorClaim {
        let (mut root, mut index, mut count) = (tree.root(), seq, leaves);
        let mut path = tree.path(usize::try_from(seq).expect("small"));
        let place = at.checked_rem(path.len());
        match (how, place) {
            (0, _) => index = at as u64 % (leaves + 2),
            (1, _) => count = at as u64 % (leaves + 9),
            (2, _) => root.0[at % 32] ^= 1,
            (3, Some(place)) => path[place].0[at % 32] ^= 1,
            (4, Some(place)) => drop(path.remove(place)),
            (5, Some(place)) => path.insert(place, tree.root()),
            (6, _) => path.push(tree.root()),
            (7, Some(place)) => path.swap(place, 0),
            _ => {}
        }
        AnchorClaim::new(1, 1, 1, Anchoring::Batch { account: Address([1; 20]), root, index, count, path })
    }

    proptest! {
        #[test]
        fn a_path_that_meets_others_is_judged_as_it_is_by_itself(
            leaves in 1_u64..70,
            asked in proptest::collection::vec((any::<u64>(), 0_u8..24, any::<usize>()), 1..80),
        ) {
            let tree = Tree::new((0..leaves).map(|seq| leaf(seq).hash()).collect()).expect("within bounds");
            let asked: Vec<_> = asked.into_iter().map(|(seq, how, at)| (seq % leaves, how, at)).collect();
            let claims: Vec<AnchorClaim> = asked.iter().map(|asked| claim(&tree, leaves, *asked)).collect();
            let known = Known::default();
            for ((seq, how, _), claim) in asked.iter().zip(&claims) {
                let alone = claim.inclusion().expect("a batch").proves(&leaf(*seq));
                prop_assert_eq!(known.leads(&leaf(*seq), claim), alone, "way {}", how);
                prop_assert!(alone || *how < 8, "unaltered");
            }
        }
    }
}

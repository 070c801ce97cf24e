//! A bundle in its parts: each is within its bounds and well-formed, or the bundle is refused with the part's name.
#![allow(clippy::missing_errors_doc, reason = "`BundleError` and `PackingError` say what is wrong")]

use std::collections::{BTreeMap, BTreeSet};
use std::{io::Read as _, path::Path};

use authros_crypto::merkle::{Inclusion, LONGEST_PATH};
use authros_crypto::record::{RecordSecret, Revealed, open_revealed_within, reveal_bytes};
use authros_crypto::{CryptoError, Provider, SmKeyPair, keyfile, signature_der, signature_from_der, signer_id};
use authros_model::header::{LARGEST_BODY, LARGEST_HEAD};
use authros_model::{Address, Digest, Domain, Hash, Header, Identity, PublicKey, Signature, SignerId, clean};
use serde::{Deserialize, Serialize};

use crate::archive::{self, LARGEST, MIMETYPE, MOST_MEMBERS, Members, is_name};
use crate::completeness::{self, HEIGHTS, Height};
use crate::manifest::{self, ClaimedChain, Exporter, MANIFEST, MEDIA_TYPE, Manifest, SIGNATURE, signed_bytes};
use crate::report::{Level, Reason, Standing};
use crate::time::{self, BundledStamp, DraftStamp, StampTree};
use crate::{committed::BlockHeader, state::Nodes, trust::Trust, verify::Check};

/// The trust file that a bundle may suggest, and that is never trusted.
pub const SUGGESTED: &str = "trust.toml";
pub const NODES: &str = "chain/nodes.rlp";
/// Instructions for somebody who finds the file without us.
pub const READ_ME: &str = "VERIFY.txt";
/// The page for people; never read by a verifier.
pub const REPORT: &str = "report.html";
/// The most records in a bundle.
pub const MOST_RECORDS: usize = 10_000;
/// Digests and secrets of the disclosed records.
const DISCLOSED: &str = "disclosed.bin";
/// Its owner's signature.
const DISCLOSURE: &str = "disclosed.der";
/// Length of a digest and a secret.
const ENTRY: usize = 64;
const ANCHOR_FORMAT: &str = "authros-anchor/1";
const LONGEST_REPORT: usize = 16 << 20;
const LONGEST_SMALL: usize = 64 * 1024;

/// Why a bundle cannot be checked.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{member}: {why}")]
pub struct BundleError {
    /// Which member, or the bundle.
    pub member: String,
    /// What is wrong with it, cleaned.
    pub why: String,
}

impl BundleError {
    /// About one member.
    pub fn of(member: &str, why: &str) -> Self {
        Self { member: clean(member, 200), why: clean(why, 300) }
    }

    /// About all of it.
    pub fn whole(why: &str) -> Self {
        Self::of("the bundle", why)
    }
}

/// How a record was anchored.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "snake_case", tag = "mode")]
#[allow(missing_docs, reason = "each variant's line names its fields")]
pub enum Anchoring {
    /// Its digest alone, by its owner. The braces refuse further lines, which serde takes beside a bare word.
    Each {},
    /// The root of its batch: the leaf's index from 0, the number of leaves, and the hashes from the leaf up.
    Batch { account: Address, root: Hash, index: u64, count: u64, path: Vec<Hash> },
}

/// The exporter's claim of where a record is anchored, and after which block the state shows that.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AnchorClaim {
    /// Names this format.
    pub format: String,
    /// The anchoring block.
    pub block: u64,
    /// The block whose state shows it; the same one, or a later one.
    pub shown_at: u64,
    /// Which version of the owner's keys was in force.
    pub keys: u64,
    /// How it was anchored.
    pub anchor: Anchoring,
}

impl AnchorClaim {
    /// A claim in this program's format.
    pub fn new(block: u64, shown_at: u64, keys: u64, anchor: Anchoring) -> Self {
        Self { format: ANCHOR_FORMAT.to_owned(), block, shown_at, keys, anchor }
    }

    /// The path, if the record is in a batch.
    pub fn inclusion(&self) -> Option<Inclusion> {
        match &self.anchor {
            Anchoring::Each {} => None,
            Anchoring::Batch { root, index, count, path, .. } => {
                Some(Inclusion { index: *index, count: *count, path: path.clone(), root: *root })
            }
        }
    }

    fn parse(name: &str, text: &[u8]) -> Result<Self, BundleError> {
        let wrong = |why: &str| BundleError::of(name, why);
        let claim: Self = manifest::from_json(text).map_err(|error| wrong(&error))?;
        if claim.format != ANCHOR_FORMAT {
            return Err(wrong(&format!("its form is not {ANCHOR_FORMAT}")));
        }
        if claim.inclusion().is_some_and(|inclusion| inclusion.path.len() > LONGEST_PATH) {
            return Err(wrong("its path is longer than in any batch"));
        }
        Ok(claim)
    }
}

/// The records that their owner disclosed, under one signature.
#[derive(Debug, Clone)]
pub struct Disclosure {
    /// The secrets from which the records' keys are derived.
    pub(crate) secrets: BTreeMap<Digest, RecordSecret>,
    /// SM3 of their list. A file may name a key a record: none of them costs the whole list.
    list: Digest,
    /// SM2 by the owner.
    signature: Signature,
}

impl Disclosure {
    /// Signs the list of these secrets.
    pub fn sign(
        secrets: BTreeMap<Digest, RecordSecret>,
        domain: &Domain,
        signer: &SmKeyPair,
        provider: &dyn Provider,
    ) -> Result<Self, PackingError> {
        let list = Digest(provider.sm3(&[&listed(&secrets)]));
        let signature = provider.sign(&signer.secret, &reveal_bytes(domain, &list))?;
        Ok(Self { secrets, list, signature })
    }

    fn parse(bytes: &[u8], signature: Signature, provider: &dyn Provider) -> Result<Self, BundleError> {
        let wrong = |why: &str| BundleError::of(DISCLOSED, why);
        let (pairs, rest) = bytes.as_chunks::<ENTRY>();
        if !rest.is_empty() || pairs.is_empty() || pairs.len() > MOST_RECORDS {
            return Err(wrong("is not a list of digests and secrets"));
        }
        let mut secrets = BTreeMap::new();
        for pair in pairs {
            let (digest, secret) = pair.split_at(ENTRY / 2);
            let (digest, secret) = (Digest::from_slice(digest), RecordSecret::from_slice(secret));
            let (digest, secret) = digest.zip(secret).ok_or_else(|| wrong("is not a list of digests and secrets"))?;
            if secrets.last_key_value().is_some_and(|(last, _)| *last >= digest) {
                return Err(wrong("is not in the order of its digests"));
            }
            secrets.insert(digest, secret);
        }
        Ok(Self { secrets, list: Digest(provider.sm3(&[bytes])), signature })
    }

    /// Whether this key signed the list.
    pub(crate) fn is_signed(&self, domain: &Domain, key: &PublicKey, provider: &dyn Provider) -> bool {
        provider.verify(key, &reveal_bytes(domain, &self.list), &self.signature).is_ok()
    }
}

/// The bytes of `disclosed.bin`.
fn listed(secrets: &BTreeMap<Digest, RecordSecret>) -> Vec<u8> {
    secrets.iter().flat_map(|(digest, secret)| digest.0.iter().chain(secret.expose()).copied()).collect()
}

/// One record of a bundle.
#[derive(Debug, Clone)]
pub struct BundledRecord {
    /// The record as stored.
    pub record: Vec<u8>,
    /// Its signature.
    pub signature: Signature,
    /// Where it is anchored; `None` if it was on no chain.
    pub anchor: Option<AnchorClaim>,
}

/// A bundle whose members match its manifest, each well-formed.
#[derive(Debug, Clone)]
pub struct Bundle {
    /// The manifest.
    pub manifest: Manifest,
    /// Whether its exporter's key signed it.
    pub signed: bool,
    /// Records by the digest that they are filed under.
    pub records: BTreeMap<Digest, BundledRecord>,
    /// Which of them are disclosed.
    pub disclosure: Option<Disclosure>,
    /// Keys of signers.
    pub keys: BTreeMap<SignerId, PublicKey>,
    /// Identities by their Keccak-256.
    pub identities: BTreeMap<Hash, Identity>,
    /// Headers by number.
    pub headers: BTreeMap<u64, BlockHeader>,
    /// Nodes of the state.
    pub nodes: Nodes,
    /// Texts of message definitions by their SM3.
    pub definitions: BTreeMap<Digest, String>,
    /// Paths from heads of recorders to the highest numbers of topics.
    pub heights: Vec<Height>,
    /// Stamps of authorities by their imprints.
    pub stamps: BTreeMap<Hash, BundledStamp>,
    /// The trust file that its exporter suggests.
    pub suggested: Option<String>,
}

#[derive(Default)]
struct Drafts {
    records: BTreeMap<Digest, Draft>,
    stamps: BTreeMap<Hash, DraftStamp>,
    disclosed: Option<Vec<u8>>,
    disclosure: Option<Signature>,
}

impl Bundle {
    /// Reads a bundle: the file, or the folder that it was unpacked into.
    pub fn read(path: &Path, provider: &dyn Provider) -> Result<Self, BundleError> {
        if path.is_dir() {
            return Self::of_members(&folder(path)?, provider);
        }
        Self::parse(&file(path, "the bundle")?, provider)
    }

    /// From a file's bytes.
    pub fn parse(bytes: &[u8], provider: &dyn Provider) -> Result<Self, BundleError> {
        Self::of_members(&archive::read(bytes)?, provider)
    }

    /// From its members.
    pub fn of_members(members: &Members, provider: &dyn Provider) -> Result<Self, BundleError> {
        let manifest = Manifest::read(members, provider)?;
        let (mut drafts, mut bundle) = (Drafts::default(), Self::empty(manifest));
        for (name, bytes) in members {
            bundle.take(name, bytes, &mut drafts, provider)?;
        }
        if drafts.records.len() > MOST_RECORDS || drafts.stamps.len() > MOST_RECORDS {
            return Err(BundleError::whole(&format!("it has more than {MOST_RECORDS} records, or time stamps")));
        }
        for (digest, draft) in drafts.records {
            bundle.records.insert(digest, draft.finish(&digest)?);
        }
        for (imprint, draft) in drafts.stamps {
            bundle.stamps.insert(imprint, draft.finish(&imprint)?);
        }
        bundle.disclosure = match (drafts.disclosed, drafts.disclosure) {
            (None, None) => None,
            (Some(list), Some(signature)) => Some(Disclosure::parse(&list, signature, provider)?),
            (Some(_), None) => return Err(BundleError::of(DISCLOSURE, "is missing")),
            (None, Some(_)) => return Err(BundleError::of(DISCLOSED, "is missing")),
        };
        let mut disclosed = bundle.disclosure.iter().flat_map(|disclosure| disclosure.secrets.keys());
        if let Some(digest) = disclosed.find(|digest| !bundle.records.contains_key(digest)) {
            let text = format!("discloses record {digest}, which is not in the bundle");
            return Err(BundleError::of(DISCLOSED, &text));
        }
        let key = bundle.keys.get(&bundle.manifest.exporter.key);
        bundle.signed =
            key.is_some_and(|key| crate::manifest::is_signed(members, &bundle.manifest.exporter, key, provider));
        Ok(bundle)
    }

    fn empty(manifest: Manifest) -> Self {
        Self {
            manifest,
            signed: false,
            records: BTreeMap::new(),
            disclosure: None,
            keys: BTreeMap::new(),
            identities: BTreeMap::new(),
            headers: BTreeMap::new(),
            nodes: Nodes::default(),
            definitions: BTreeMap::new(),
            heights: Vec::new(),
            stamps: BTreeMap::new(),
            suggested: None,
        }
    }

    fn take(
        &mut self,
        name: &str,
        bytes: &[u8],
        drafts: &mut Drafts,
        provider: &dyn Provider,
    ) -> Result<(), BundleError> {
        let wrong = |why: &str| BundleError::of(name, why);
        let parts: Vec<&str> = name.split('/').collect();
        let file = parts.last().copied().unwrap_or_default();
        let filed = |under: String, why: &str| if file == under { Ok(()) } else { Err(wrong(why)) };
        let longest = match parts.as_slice() {
            ["records", _, "record.bin"]
            | ["chain", "nodes.rlp"]
            | ["stamps", _, "roots.json"]
            | [MANIFEST | HEIGHTS | DISCLOSED] => usize::MAX,
            [REPORT] => LONGEST_REPORT,
            _ => LONGEST_SMALL,
        };
        if bytes.len() > longest {
            return Err(wrong("is longer than such a member can be"));
        }
        match parts.as_slice() {
            [MIMETYPE | MANIFEST | SIGNATURE | READ_ME | REPORT] => {}
            [HEIGHTS] => self.heights = completeness::parse(bytes)?,
            [DISCLOSED] => drafts.disclosed = Some(bytes.to_vec()),
            [DISCLOSURE] => {
                drafts.disclosure = Some(signature_from_der(bytes).map_err(|error| wrong(&error.to_string()))?);
            }
            [SUGGESTED] => self.suggested = Some(text(name, bytes)?),
            ["records", digest, part] => {
                // One spelling: 0x and capital letters would file a second part under the same record.
                let filed = digest.parse().ok().filter(|filed: &Digest| filed.to_hex() == **digest);
                let digest = filed.ok_or_else(|| wrong("is filed under a name that is not a digest"))?;
                drafts.records.entry(digest).or_default().take(name, part, bytes)?;
            }
            ["stamps", imprint, part] => {
                let filed = imprint.parse().ok().filter(|filed: &Hash| filed.to_hex() == **imprint);
                let imprint = filed.ok_or_else(|| wrong("is filed under a name that is not an imprint"))?;
                drafts.stamps.entry(imprint).or_default().take(name, part, bytes)?;
            }
            ["keys", _] => {
                let pem = std::str::from_utf8(bytes).ok().and_then(|text| keyfile::sm2_public_from_pem(text).ok());
                let key = pem.ok_or_else(|| wrong("contains no SM2 public key"))?;
                if keyfile::sm2_public_pem(&key).ok().is_none_or(|written| written.as_bytes() != bytes) {
                    return Err(wrong("contains an SM2 public key that is not written in a bundle's one form"));
                }
                let id = signer_id(&key);
                filed(format!("{}.pem", id.to_hex()), "is filed under another key's name")?;
                self.keys.insert(id, key);
            }
            ["identities", _] => {
                let hash = Hash(authros_crypto::keccak256(&[bytes]));
                let identity = Identity::parse(bytes).map_err(|error| wrong(&error.to_string()))?;
                filed(format!("{}.bin", hash.to_hex()), "is filed under another identity's name")?;
                self.identities.insert(hash, identity);
            }
            ["chain", "nodes.rlp"] => {
                self.nodes = Nodes::parse(bytes)
                    .ok_or_else(|| wrong("is not a list of distinct nodes in order of their hashes"))?;
            }
            ["chain", _] => {
                let header = BlockHeader::parse(bytes).ok_or_else(|| wrong("is not a block header"))?;
                filed(format!("{}.rlp", header.number), "is filed under the number of another block")?;
                self.headers.insert(header.number, header);
            }
            ["definitions", _] => {
                let digest = Digest(provider.sm3(&[bytes]));
                filed(format!("{}.txt", digest.to_hex()), "is filed under another text's name")?;
                self.definitions.insert(digest, text(name, bytes)?);
            }
            _ => return Err(wrong("does not belong in a bundle")),
        }
        Ok(())
    }
}

#[derive(Default)]
struct Draft {
    record: Option<Vec<u8>>,
    signature: Option<Signature>,
    anchor: Option<AnchorClaim>,
}

impl Draft {
    fn take(&mut self, name: &str, part: &str, bytes: &[u8]) -> Result<(), BundleError> {
        match part {
            "record.bin" if bytes.len() as u64 > LARGEST_BODY + u64::from(LARGEST_HEAD) + 1024 => {
                return Err(BundleError::of(name, "is longer than any record can be"));
            }
            "record.bin" => self.record = Some(bytes.to_vec()),
            "signature.der" => {
                let signature = signature_from_der(bytes);
                self.signature = Some(signature.map_err(|error| BundleError::of(name, &error.to_string()))?);
            }
            "anchor.json" => self.anchor = Some(AnchorClaim::parse(name, bytes)?),
            _ => return Err(BundleError::of(name, "does not belong to a record")),
        }
        Ok(())
    }

    fn finish(self, digest: &Digest) -> Result<BundledRecord, BundleError> {
        let missing = |file: &str| BundleError::of(&format!("records/{digest}/{file}"), "is missing");
        Ok(BundledRecord {
            record: self.record.ok_or_else(|| missing("record.bin"))?,
            signature: self.signature.ok_or_else(|| missing("signature.der"))?,
            anchor: self.anchor,
        })
    }
}

fn text(name: &str, bytes: &[u8]) -> Result<String, BundleError> {
    std::str::from_utf8(bytes).map(str::to_owned).map_err(|_| BundleError::of(name, "is not text"))
}

fn file(path: &Path, name: &str) -> Result<Vec<u8>, BundleError> {
    let failed = |error: std::io::Error| BundleError::of(name, &format!("cannot be read: {error}"));
    // Checked before it is opened, since opening a pipe would wait for its writer.
    if !path.metadata().map_err(failed)?.is_file() {
        return Err(BundleError::of(name, "is not a regular file"));
    }
    let mut bytes = Vec::new();
    std::fs::File::open(path).map_err(failed)?.take(LARGEST + 1).read_to_end(&mut bytes).map_err(failed)?;
    if bytes.len() as u64 > LARGEST {
        return Err(BundleError::of(name, "is longer than any bundle can be"));
    }
    Ok(bytes)
}

/// The members of an unpacked bundle; links are refused.
fn folder(root: &Path) -> Result<Members, BundleError> {
    let (mut members, mut size) = (Members::new(), 0u64);
    let mut waiting = BTreeSet::from([String::new()]);
    while let Some(below) = waiting.pop_first() {
        let failed = |error: std::io::Error| BundleError::of(&below, &format!("cannot be read: {error}"));
        for entry in std::fs::read_dir(root.join(&below)).map_err(failed)? {
            let entry = entry.map_err(failed)?;
            let part = entry.file_name();
            let name =
                part.to_str().map(|part| if below.is_empty() { part.to_owned() } else { format!("{below}/{part}") });
            let name = name.filter(|name| is_name(name) && name.split('/').count() <= 3);
            let name = name.ok_or_else(|| BundleError::of(&part.to_string_lossy(), "does not belong in a bundle"))?;
            match entry.file_type().map_err(failed)? {
                kind if kind.is_dir() => drop(waiting.insert(name)),
                kind if kind.is_file() => {
                    let bytes = file(&root.join(&name), &name)?;
                    size = size.saturating_add(bytes.len() as u64);
                    members.insert(name, bytes);
                }
                _ => return Err(BundleError::of(&name, "is not a regular file")),
            }
            if size > LARGEST || members.len() + waiting.len() > MOST_MEMBERS {
                return Err(BundleError::whole("it is larger than any bundle can be"));
            }
        }
    }
    Ok(members)
}

/// The text of `VERIFY.txt`, for somebody who finds the file without the program.
pub const READ_ME_TEXT: &str = include_str!("VERIFY.txt");

/// A bundle being assembled.
#[derive(Debug, Default)]
pub struct Packing {
    members: Members,
}

impl From<Members> for Packing {
    /// Signed members, to which something is to be added before they are signed again.
    fn from(members: Members) -> Self {
        Self { members }
    }
}

/// Why a bundle cannot be assembled.
#[derive(Debug, thiserror::Error)]
pub enum PackingError {
    /// It would be too large.
    #[error(transparent)]
    Bundle(#[from] BundleError),
    /// A key cannot be used.
    #[error(transparent)]
    Crypto(#[from] CryptoError),
}

impl Packing {
    /// Adds a record.
    pub fn record(&mut self, digest: Digest, record: BundledRecord) -> Result<(), PackingError> {
        let mut put = |part: &str, bytes: Vec<u8>| {
            self.members.insert(format!("records/{}/{part}", digest.to_hex()), bytes);
        };
        if let Some(anchor) = &record.anchor {
            put("anchor.json", manifest::to_json("anchor.json", anchor)?);
        }
        put("signature.der", signature_der(&record.signature));
        put("record.bin", record.record);
        Ok(())
    }

    /// Adds what an owner disclosed.
    pub fn disclosure(&mut self, disclosure: &Disclosure) {
        self.members.insert(DISCLOSED.to_owned(), listed(&disclosure.secrets));
        self.members.insert(DISCLOSURE.to_owned(), signature_der(&disclosure.signature));
    }

    /// Adds a signer's key.
    pub fn key(&mut self, key: &PublicKey) -> Result<(), PackingError> {
        let pem = keyfile::sm2_public_pem(key)?;
        self.members.insert(format!("keys/{}.pem", signer_id(key).to_hex()), pem.into_bytes());
        Ok(())
    }

    /// Adds an identity as on the chain.
    pub fn identity(&mut self, identity: &Identity) {
        let bytes = identity.encode();
        let hash = Hash(authros_crypto::keccak256(&[&bytes]));
        self.members.insert(format!("identities/{}.bin", hash.to_hex()), bytes);
    }

    /// Adds a block's header, RLP.
    pub fn header(&mut self, number: u64, bytes: Vec<u8>) {
        self.members.insert(format!("chain/{number}.rlp"), bytes);
    }

    /// The nodes of the states that the headers name.
    pub fn nodes(&mut self, nodes: &Nodes) {
        self.members.insert(NODES.to_owned(), nodes.encode());
    }

    /// Adds the text of a message definition.
    pub fn definition(&mut self, text: &str, provider: &dyn Provider) {
        let digest = Digest(provider.sm3(&[text.as_bytes()]));
        self.members.insert(format!("definitions/{}.txt", digest.to_hex()), text.as_bytes().to_vec());
    }

    /// Adds the paths from heads of recorders to the highest numbers of topics.
    pub fn heights(&mut self, heights: Vec<Height>) -> Result<(), PackingError> {
        self.members.insert(HEIGHTS.to_owned(), completeness::to_text(heights)?);
        Ok(())
    }

    /// Adds an authority's stamps over these roots; all of them were stamped together.
    pub fn stamps(&mut self, tree: &StampTree, wanted: &[Hash], tokens: &[Vec<u8>]) -> Result<(), PackingError> {
        if !tokens.is_empty() {
            self.members.extend(time::files(tree, wanted, tokens)?);
        }
        Ok(())
    }

    /// Adds the page for people, which proves nothing.
    pub fn report(&mut self, page: String) {
        self.members.insert(REPORT.to_owned(), page.into_bytes());
    }

    /// Suggests what to pin.
    pub fn suggest(&mut self, trust: &Trust) -> Result<(), PackingError> {
        let text = trust.to_text().map_err(|error| BundleError::of(SUGGESTED, &error.to_string()))?;
        let note = "# What the exporter says. Compare each line with what you know from an independent source, then \
                    keep your own copy.\n";
        self.members.insert(SUGGESTED.to_owned(), [note, &text].concat().into_bytes());
        Ok(())
    }

    /// The members with the manifest, signed by its exporter.
    pub fn sign(
        mut self,
        chain: ClaimedChain,
        account: Address,
        signer: &SmKeyPair,
        provider: &dyn Provider,
    ) -> Result<Members, PackingError> {
        self.key(&signer.public)?;
        self.members.insert(MIMETYPE.to_owned(), MEDIA_TYPE.as_bytes().to_vec());
        self.members.insert(READ_ME.to_owned(), READ_ME_TEXT.as_bytes().to_vec());
        let exporter = Exporter { account, key: signer_id(&signer.public) };
        let manifest = Manifest::of(&self.members, chain, exporter, provider);
        let mut text = manifest::to_json(MANIFEST, &manifest)?;
        text.push(b'\n');
        let signature = provider.sign(&signer.secret, &signed_bytes(&text))?;
        self.members.insert(SIGNATURE.to_owned(), signature_der(&signature));
        self.members.insert(MANIFEST.to_owned(), text);
        Ok(self.members)
    }
}

/// The file of these members.
pub fn pack(members: &Members) -> Result<Vec<u8>, PackingError> {
    Ok(archive::write(members)?)
}

/// The most bytes of messages produced from one file.
pub(crate) const MOST_PLAIN: u64 = 256 * 1024 * 1024;
/// The most identities tried for one owner.
const MOST_IDENTITIES: usize = 16;

/// Level (e) before the message is opened, as far as the state itself is trusted: who signed the disclosure.
pub(crate) fn vouched(check: &Check<'_>, digest: Digest, header: &Header, owner_key: Option<PublicKey>) -> Level {
    let disclosure = check.bundle.disclosure.as_ref().filter(|disclosure| disclosure.secrets.contains_key(&digest));
    disclosure.map_or_else(
        || Level::new(Standing::Absent, "sealed: its owner did not disclose it"),
        |disclosure| signed(check, disclosure, header.owner, owner_key),
    )
}

/// Level (e), and the message if it was opened. Takes its bytes from `left`; the signer was checked first.
pub(crate) fn opened(
    check: &Check<'_>,
    (digest, record): (Digest, &BundledRecord),
    level: Level,
    left: &mut u64,
) -> (Level, Option<Revealed>) {
    let disclosure = check.bundle.disclosure.as_ref().filter(|_| level.standing != Standing::Refused);
    let Some(secret) = disclosure.and_then(|disclosure| disclosure.secrets.get(&digest)) else {
        return (level, None);
    };
    match open_revealed_within(check.provider, &record.record, secret, left) {
        Ok(Some(revealed)) => (level, Some(revealed)),
        Ok(None) => {
            let text = "its message is not opened: too much is disclosed in a single file";
            (Level::unproven(Reason::TooMuchDisclosed, text), None)
        }
        Err(error) => {
            let text = format!("the disclosed secret does not open it: {error}");
            (Level::refused(Reason::BadDisclosure, text), None)
        }
    }
}

/// An identity proves that its key made the disclosure, not whose account it is: only the state or a pin shows that.
fn signed(check: &Check<'_>, disclosure: &Disclosure, owner: Address, owner_key: Option<PublicKey>) -> Level {
    let is_owners = |key: &PublicKey| check.known.has_signed(check, disclosure, key);
    let pinned = check.trust.and_then(|trust| trust.person(owner)).and_then(|person| person.key);
    let pinned = pinned.and_then(|key| check.bundle.keys.get(&key)).copied();
    if [owner_key, pinned].iter().flatten().any(is_owners) {
        return Level::proven("opened by its owner's disclosure");
    }
    let identities = &check.bundle.identities;
    let mut claimed = identities.iter().take(MOST_IDENTITIES);
    let claims = claimed
        .any(|(hash, identity)| check.known.is_of(check, (*hash, identity), owner) && is_owners(&identity.signing));
    if claims || identities.len() > MOST_IDENTITIES {
        let text = "it opens, and this is the message; there is no proof that its owner disclosed it";
        return Level::unproven(Reason::UnprovenDisclosure, text);
    }
    Level::refused(Reason::ForeignDisclosure, "the disclosure is not signed by its owner")
}

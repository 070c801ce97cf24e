//! External time: an authority's stamp (RFC 3161, CMS SignedData of RFC 5652) over the roots of batches, and the path
//! from its certificate to a pinned one (RFC 5280, 6, with names compared byte by byte). Revocation is not looked up.

mod certificate;

use std::collections::BTreeMap;

use crate::BundleError;
use authros_crypto::der::{
    BOOLEAN, Der, DerError, Element, GENERALIZED_TIME, INTEGER, NULL, OBJECT, OCTETS, SEQUENCE, SET, UTC_TIME, UTF8,
    context, primitive, put, small,
};
use authros_crypto::merkle::{LONGEST_PATH, MOST_LEAVES, Tree, root_of, stamp_hash};
use authros_model::{Hash, Timestamp, clean};
use certificate::{HashKind, Scheme};
use ring::digest::{SHA1_FOR_LEGACY_USE_ONLY, digest};
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};
use time::Date;

pub use certificate::Certificate;

/// The longest text in DER that is read, bytes.
pub const LARGEST_DER: usize = 64 * 1024;

/// Why a stamp is not accepted.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the variants and their messages name the fields")]
pub enum TimeError {
    #[error("the {part} is malformed: {why}")]
    Form { part: &'static str, why: &'static str },
    /// The authority gave none: PKIStatus of RFC 3161, and its text, cleaned.
    #[error("the authority gave no stamp: status {status}{}", .text.as_ref().map_or(String::new(), |text| format!(", {text}")))]
    NotGranted { status: u64, text: Option<String> },
    #[error("it stamps something else: its message imprint differs")]
    OtherImprint,
    #[error("its message imprint is not SHA-256")]
    ImprintHash,
    #[error("it answers another request: its nonce differs")]
    OtherNonce,
    #[error("it does not include its signer's certificate")]
    NoCertificate,
    #[error("its signature covers different content")]
    OtherContent,
    #[error("its signature does not name its certificate (ESSCertID)")]
    OtherCertificate,
    #[error("its signature is invalid")]
    Signature,
    #[error("it is signed with {0}, which this program cannot check")]
    Algorithm(&'static str),
    #[error("its certificate is not restricted to time stamping (critical extended key usage timeStamping)")]
    NotForStamps,
    #[error("the certificate of {name} was not valid at {at}; it is valid from {from} to {until}")]
    NotValid { name: String, at: Timestamp, from: Timestamp, until: Timestamp },
    #[error("no certificate in it links {0} to a pinned certificate")]
    NotPinned(String),
    #[error("the certificate of {0}, in the chain, may not issue others")]
    NotAnIssuer(String),
    #[error("the certificate of {0}, in the chain, is not signed by the one above it")]
    Forged(String),
    #[error("the certificate of {0} has an unknown critical extension")]
    Critical(String),
}

fn form(part: &'static str, why: &'static str) -> TimeError {
    TimeError::Form { part, why }
}

impl From<DerError> for TimeError {
    fn from(DerError { part, why }: DerError) -> Self {
        Self::Form { part, why }
    }
}

fn outer<'a>(part: &'static str, bytes: &'a [u8]) -> Result<Der<'a>, TimeError> {
    if bytes.len() > LARGEST_DER {
        return Err(form(part, "it is too long"));
    }
    Ok(Der::only(part, bytes, SEQUENCE)?)
}

/// Seconds since 1970, UTC. Fractions of a second are rounded up if `up` is set, otherwise down.
fn seconds(element: Element<'_>, part: &'static str, up: bool) -> Result<u64, TimeError> {
    moment(element, up).ok_or_else(|| form(part, "a time is not valid"))
}

fn moment(element: Element<'_>, up: bool) -> Option<u64> {
    let text = element.content.strip_suffix(b"Z")?;
    let two = |at: usize| match text.get(at..at + 2)? {
        [tens @ b'0'..=b'9', ones @ b'0'..=b'9'] => Some((tens - b'0') * 10 + (ones - b'0')),
        _ => None,
    };
    let first = i32::from(two(0)?);
    let (year, at) = match element.tag {
        GENERALIZED_TIME => (first * 100 + i32::from(two(2)?), 4),
        // RFC 5280, 4.1.2.5.1.
        UTC_TIME => (if first < 50 { 2000 + first } else { 1900 + first }, 2),
        _ => return None,
    };
    let date = Date::from_calendar_date(year, two(at)?.try_into().ok()?, two(at + 2)?).ok()?;
    let time = date.with_hms(two(at + 4)?, two(at + 6)?, two(at + 8)?).ok()?.assume_utc();
    let fraction = match text.get(at + 10..).unwrap_or_default() {
        [] => 0,
        // X.690, 11.7.3: no zeros at the end.
        [b'.', digits @ ..] if element.tag == GENERALIZED_TIME && digits.len() <= 9 => {
            let is_number = digits.iter().all(u8::is_ascii_digit);
            digits.last().filter(|last| is_number && **last != b'0').map(|_| u64::from(up))?
        }
        _ => return None,
    };
    Some(u64::try_from(time.unix_timestamp()).ok()? + fraction)
}

/// The content of a valid token.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Stamped {
    /// When, by the authority's clock; fractions of a second dropped.
    pub at: Timestamp,
    /// The time by which it certainly existed, by the accuracy that the authority states.
    pub before: Timestamp,
    /// The signer's name in the certificate, cleaned.
    pub signer: String,
    /// The pinned certificate that it leads to; `None` if none: then all this is only its own word.
    pub pinned: Option<usize>,
}

impl Stamped {
    /// Which of the pinned certificates it leads to.
    /// # Errors
    /// [`TimeError::NotPinned`] if it leads to none.
    pub fn by_pinned(&self) -> Result<usize, TimeError> {
        self.pinned.ok_or_else(|| TimeError::NotPinned(self.signer.clone()))
    }
}

/// Checks form, imprint (SHA-256), nonce, signed content (RFC 5652, 5.6), name of the certificate (RFC 5816),
/// signature, purpose, validity at the stamped time, and the path to a pinned certificate.
/// # Errors
/// [`TimeError`] with the first contradiction.
pub fn check_token(
    token: &[u8],
    imprint: &[u8; 32],
    request: Option<&Request>,
    pinned: &[Certificate],
) -> Result<Stamped, TimeError> {
    let token = Token::parse(token)?;
    if token.info.imprint != imprint {
        return Err(TimeError::OtherImprint);
    }
    if request.is_some_and(|request| token.info.nonce != Some(&request.nonce_integer()[..])) {
        return Err(TimeError::OtherNonce);
    }
    let signer = &token.signer;
    let mut known = token.certificates.iter().chain(pinned);
    let is_signers = |known: &&Certificate| known.issuer == signer.issuer && known.serial == signer.serial;
    let certificate = known.find(is_signers).ok_or(TimeError::NoCertificate)?;
    content(signer, token.content)?;
    named(signer, certificate)?;
    certificate.key.verify(signer.scheme, &signer.signed, signer.signature)?;
    if !certificate.uses.may_stamp() {
        return Err(TimeError::NotForStamps);
    }
    certificate.valid_at(token.info.at)?;
    let leads = way(certificate, &token.certificates, pinned, token.info.at)?;
    let [at, before] = [token.info.at, token.info.before].map(Timestamp::from_seconds);
    Ok(Stamped { at, before, signer: certificate.name(), pinned: leads })
}

fn way(
    first: &Certificate,
    others: &[Certificate],
    pinned: &[Certificate],
    at: u64,
) -> Result<Option<usize>, TimeError> {
    let mut fault = None;
    for (place, pinned) in pinned.iter().enumerate() {
        match check(first, others, pinned, at) {
            Ok(()) => return Ok(Some(place)),
            Err(TimeError::NotPinned(_)) => {}
            Err(error) => drop(fault.get_or_insert(error)),
        }
    }
    fault.map_or(Ok(None), Err)
}

fn content(signer: &Signer<'_>, content: &[u8]) -> Result<(), TimeError> {
    let missing = || form("signer's part", "a required attribute is missing");
    let mut kind = signer.attribute(certificate::CONTENT_TYPE).ok_or_else(missing)?;
    let is_stamp = kind.element(OBJECT)?.content == certificate::STAMP;
    kind.end()?;
    let mut hash = signer.attribute(certificate::MESSAGE_DIGEST).ok_or_else(missing)?;
    let is_this = hash.element(OCTETS)?.content == signer.hash.of(content).as_ref();
    hash.end()?;
    if is_stamp && is_this { Ok(()) } else { Err(TimeError::OtherContent) }
}

/// So that no other certificate with the same key can take its place. SHA-1 (RFC 2634) is accepted: many authorities
/// still write it, and substituting a certificate needs a second preimage.
fn named(signer: &Signer<'_>, certificate: &Certificate) -> Result<(), TimeError> {
    let (second, first) = (certificate::SIGNING_CERTIFICATE_2, certificate::SIGNING_CERTIFICATE);
    let mut found = false;
    for (name, is_second) in [(second, true), (first, false)] {
        let Some(mut value) = signer.attribute(name) else { continue };
        let mut outer = value.inside(SEQUENCE)?;
        value.end()?;
        // The first is the signer's own; policies may follow.
        let mut own = outer.inside(SEQUENCE)?.inside(SEQUENCE)?;
        let hash = match (is_second, own.next_tag()) {
            (true, Some(SEQUENCE)) => HashKind::read(&mut own, SEQUENCE)?.of(&certificate.der),
            (true, _) => HashKind::Sha256.of(&certificate.der),
            (false, _) => digest(&SHA1_FOR_LEGACY_USE_ONLY, &certificate.der),
        };
        if own.element(OCTETS)?.content != hash.as_ref() {
            return Err(TimeError::OtherCertificate);
        }
        found = true;
    }
    if found { Ok(()) } else { Err(TimeError::OtherCertificate) }
}

/// The media type of a request.
pub const REQUEST_TYPE: &str = "application/timestamp-query";
/// The longest answer that is read, bytes.
pub const LONGEST_ANSWER: usize = LARGEST_DER;

/// A request for a stamp.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Request {
    /// SHA-256 of the stamped data.
    pub imprint: [u8; 32],
    /// Random, repeated by the answer.
    pub nonce: [u8; 16],
}

impl Request {
    /// As DER: SHA-256, the nonce, and a request for the authority's certificate.
    pub fn encode(&self) -> Vec<u8> {
        let hash = put(SEQUENCE, &[&put(OBJECT, &[certificate::SHA_256]), &put(NULL, &[])]);
        let imprint = put(SEQUENCE, &[&hash, &put(OCTETS, &[&self.imprint])]);
        let (version, nonce) = (put(INTEGER, &[&[1]]), put(INTEGER, &[&self.nonce_integer()]));
        put(SEQUENCE, &[&version, &imprint, &nonce, &put(BOOLEAN, &[&[0xff]])])
    }

    fn nonce_integer(&self) -> Vec<u8> {
        let mut bytes = self.nonce;
        // Positive, and never shorter.
        bytes[0] = bytes[0] & 0x7f | 0x40;
        bytes.to_vec()
    }
}

/// The token in an authority's answer.
/// # Errors
/// [`TimeError::NotGranted`] with its text, [`TimeError::Form`] if it is not an answer.
pub fn token_of(answer: &[u8]) -> Result<&[u8], TimeError> {
    let mut outer = outer("answer", answer)?;
    let mut about = outer.inside(SEQUENCE)?;
    let status = about.small()?;
    // granted, and grantedWithMods.
    if status > 1 {
        let texts = about.inside_optional(SEQUENCE)?;
        let text = texts.and_then(|mut texts| texts.element(UTF8).ok());
        let text = text.and_then(|text| std::str::from_utf8(text.content).ok()).map(|text| clean(text, 200));
        return Err(TimeError::NotGranted { status, text });
    }
    let token = outer.element(SEQUENCE)?.whole;
    outer.end()?;
    Ok(token)
}

/// The most certificates between the first and the pinned one.
const LONGEST: usize = 6;

/// Each certificate on the way was valid at this time, seconds.
fn check(first: &Certificate, others: &[Certificate], pinned: &Certificate, at: u64) -> Result<(), TimeError> {
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

/// Whether one certificate issued the other, with this many between that one and the first.
fn issued(above: &Certificate, below: &Certificate, between: usize) -> Result<(), TimeError> {
    if !above.uses.may_issue() || above.uses.issuer.is_some_and(|most| most < between as u64) {
        return Err(TimeError::NotAnIssuer(above.name()));
    }
    above.key.verify(below.scheme.clone()?, &below.signed, &below.signature).map_err(|error| match error {
        TimeError::Signature => TimeError::Forged(below.name()),
        other => other,
    })
}

const PART: &str = "token";
const INFO: &str = "stamp";
const SIGNER: &str = "signer's part";
const MOST_CERTIFICATES: usize = 8;
const MOST_ATTRIBUTES: usize = 16;

struct Token<'a> {
    pub info: Info<'a>,
    pub content: &'a [u8],
    pub certificates: Vec<Certificate>,
    pub signer: Signer<'a>,
}

struct Info<'a> {
    pub imprint: &'a [u8],
    /// When, seconds; fractions dropped.
    pub at: u64,
    /// The second by which it certainly existed, by its own accuracy.
    pub before: u64,
    pub nonce: Option<&'a [u8]>,
}

struct Signer<'a> {
    pub issuer: &'a [u8],
    pub serial: &'a [u8],
    pub hash: HashKind,
    pub scheme: Scheme,
    pub signature: &'a [u8],
    /// The data that the signature covers: the attributes as a SET.
    pub signed: Vec<u8>,
    attributes: Vec<(&'a [u8], Der<'a>)>,
}

impl<'a> Signer<'a> {
    pub fn attribute(&self, name: &[u8]) -> Option<Der<'a>> {
        self.attributes.iter().find(|(known, _)| *known == name).map(|(_, values)| *values)
    }
}

impl<'a> Token<'a> {
    pub fn parse(bytes: &'a [u8]) -> Result<Self, TimeError> {
        let mut outer = outer(PART, bytes)?;
        if outer.object()? != certificate::SIGNED_DATA {
            return Err(form(PART, "it is not signed data"));
        }
        let mut data = outer.within(context(0), |wrapped| wrapped.inside(SEQUENCE))?;
        outer.end()?;
        // RFC 5652, 5.1: content other than plain data.
        if data.small()? != 3 {
            return Err(form(PART, "its version is not 3"));
        }
        let hash = data.within(SET, |hashes| HashKind::read(hashes, SEQUENCE))?;
        let mut about = data.inside(SEQUENCE)?;
        if about.object()? != certificate::STAMP {
            return Err(form(PART, "it is signed data, but not a time stamp"));
        }
        let content = about.within(context(0), |explicit| explicit.element(OCTETS))?.content;
        about.end()?;
        let certificates = certificates(&mut data)?;
        if data.next_tag() == Some(context(1)) {
            return Err(form(PART, "it includes certificate revocation lists, which are not supported"));
        }
        let signer = data.within(SET, Signer::parse)?;
        data.end()?;
        if signer.hash != hash {
            return Err(form(PART, "it names a different hash than its signer does"));
        }
        Ok(Self { info: Info::parse(content)?, content, certificates, signer })
    }
}

fn certificates(data: &mut Der<'_>) -> Result<Vec<Certificate>, TimeError> {
    let mut found = Vec::new();
    let Some(mut all) = data.inside_optional(context(0))? else { return Ok(found) };
    while !all.is_empty() {
        if found.len() >= MOST_CERTIFICATES {
            return Err(form(PART, "it includes more than 8 certificates"));
        }
        found.push(Certificate::parse(all.element(SEQUENCE)?.whole)?);
    }
    Ok(found)
}

impl<'a> Info<'a> {
    fn parse(bytes: &'a [u8]) -> Result<Self, TimeError> {
        let mut info = Der::only(INFO, bytes, SEQUENCE)?;
        if info.small()? != 1 {
            return Err(form(INFO, "its version is not 1"));
        }
        info.element(OBJECT)?;
        let mut over = info.inside(SEQUENCE)?;
        if HashKind::read(&mut over, SEQUENCE) != Ok(HashKind::Sha256) {
            return Err(TimeError::ImprintHash);
        }
        let imprint = over.element(OCTETS)?.content;
        over.end()?;
        info.integer()?;
        let time = info.element(GENERALIZED_TIME)?;
        let late = match info.inside_optional(SEQUENCE)? {
            Some(accuracy) => spread(accuracy)?,
            None => 0,
        };
        if info.next_tag() == Some(BOOLEAN) {
            info.boolean()?;
        }
        let nonce = if info.next_tag() == Some(INTEGER) { Some(info.integer()?) } else { None };
        info.optional(context(0))?;
        if info.next_tag() == Some(context(1)) {
            return Err(form(INFO, "it has extensions, which are not supported"));
        }
        info.end()?;
        let (at, before) = (seconds(time, INFO, false)?, seconds(time, INFO, true)?);
        Ok(Self { imprint, at, before: before + late, nonce })
    }
}

/// Accuracy in whole seconds, rounded up.
fn spread(mut accuracy: Der<'_>) -> Result<u64, TimeError> {
    let whole = if accuracy.next_tag() == Some(INTEGER) { accuracy.small()? } else { 0 };
    let mut part = 0;
    for number in [0, 1] {
        if let Some(fraction) = accuracy.optional(primitive(number))? {
            let fraction = small(fraction.content).filter(|fraction| (1..=999).contains(fraction));
            part |= fraction.ok_or_else(|| accuracy.wrong("its accuracy is invalid"))?;
        }
    }
    accuracy.end()?;
    Ok(whole + u64::from(part != 0))
}

impl<'a> Signer<'a> {
    fn parse(signers: &mut Der<'a>) -> Result<Self, TimeError> {
        let mut one = signers.inside(SEQUENCE)?;
        if one.small()? != 1 {
            return Err(form(SIGNER, "it does not name its certificate by issuer and serial number"));
        }
        let (issuer, serial) =
            one.within(SEQUENCE, |sid| Ok::<_, TimeError>((sid.element(SEQUENCE)?.whole, sid.integer()?)))?;
        let hash = HashKind::read(&mut one, SEQUENCE)?;
        let listed = one.element(context(0))?;
        let signed = std::iter::once(SET).chain(listed.whole.iter().skip(1).copied()).collect();
        let scheme = Scheme::read(&mut one)?;
        let scheme = scheme.with_hash(hash).ok_or_else(|| form(SIGNER, "it names two hashes"))?;
        let signature = one.element(OCTETS)?.content;
        if !one.is_empty() {
            return Err(form(SIGNER, "it has attributes that nobody signed"));
        }
        Ok(Self { issuer, serial, hash, scheme, signature, signed, attributes: attributes(listed.content)? })
    }
}

fn attributes(bytes: &[u8]) -> Result<Vec<(&[u8], Der<'_>)>, TimeError> {
    let (mut all, mut found) = (Der::new(SIGNER, bytes), Vec::new());
    while !all.is_empty() {
        let mut one = all.inside(SEQUENCE)?;
        let name = one.object()?;
        let value = Der::new(SIGNER, one.within(SET, |values| values.any())?.whole);
        one.end()?;
        if found.len() >= MOST_ATTRIBUTES || found.iter().any(|(known, _)| *known == name) {
            return Err(form(SIGNER, "an attribute is a duplicate, or one too many"));
        }
        found.push((name, value));
    }
    Ok(found)
}

const STAMPS: &str = "stamps";
/// The most roots under one stamp.
pub const MOST_ROOTS: usize = MOST_LEAVES;
/// The most tokens over the same roots: one from each authority.
pub const MOST_TOKENS: usize = 4;
/// The format name in `roots.json`, which also separates the imprint from any other use of SHA-256.
const FORMAT: &str = "authros-stamp/1";
const LABEL: &[u8] = b"AuthROS/stamp/1";
const ROOTS: &str = "roots.json";
const TOKEN_DIGITS: usize = 32;

/// SHA-256(`AuthROS/stamp/1` || top || count, 8 bytes big endian): the data that an authority stamps.
fn imprint_of(top: &Hash, count: u64) -> [u8; 32] {
    Sha256::new().chain_update(LABEL).chain_update(top.0).chain_update(count.to_be_bytes()).finalize().into()
}

/// The tree over roots of batches.
#[derive(Debug, Clone)]
pub struct StampTree {
    tree: Tree,
    roots: Vec<Hash>,
}

impl StampTree {
    /// Over these roots in this order; `None` if there are none, or more than [`MOST_ROOTS`].
    pub fn new(roots: Vec<Hash>) -> Option<Self> {
        Some(Self { tree: Tree::new(roots.iter().map(stamp_hash).collect())?, roots })
    }

    /// The data that an authority stamps.
    pub fn imprint(&self) -> [u8; 32] {
        imprint_of(&self.tree.root(), self.count())
    }

    fn count(&self) -> u64 {
        self.roots.len() as u64
    }

    /// `roots.json` and the imprint under which it is filed; roots that are not in the tree are left out.
    pub(crate) fn listed(&self, wanted: &[Hash]) -> Result<(Hash, Vec<u8>), BundleError> {
        let places: BTreeMap<&Hash, usize> = self.roots.iter().enumerate().map(|(at, root)| (root, at)).collect();
        let wanted: std::collections::BTreeSet<&Hash> = wanted.iter().collect();
        let roots = wanted.into_iter().filter_map(|root| {
            let index = *places.get(root)?;
            Some(StampedRoot { root: *root, index: index as u64, path: self.tree.path(index) })
        });
        let listed =
            Listed { format: FORMAT.to_owned(), top: self.tree.root(), count: self.count(), roots: roots.collect() };
        Ok((Hash(self.imprint()), crate::manifest::to_json(ROOTS, &listed)?))
    }
}

/// A root under a stamp.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StampedRoot {
    /// The batch's root.
    pub root: Hash,
    /// Its place, from 0.
    pub index: u64,
    /// Hashes from it up to the top.
    pub path: Vec<Hash>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Listed {
    format: String,
    top: Hash,
    count: u64,
    roots: Vec<StampedRoot>,
}

/// The name of a token's file: half of its SHA-256, since names of members are no longer than 120 bytes.
fn token_name(token: &[u8]) -> String {
    let digits = Hash(Sha256::digest(token).into()).to_hex();
    format!("{}.der", digits.get(..TOKEN_DIGITS).unwrap_or_default())
}

pub(crate) fn files(tree: &StampTree, of: &[Hash], tokens: &[Vec<u8>]) -> Result<Vec<(String, Vec<u8>)>, BundleError> {
    let (imprint, text) = tree.listed(of)?;
    let folder = format!("{STAMPS}/{}", imprint.to_hex());
    let tokens =
        tokens.iter().take(MOST_TOKENS).map(|token| (format!("{folder}/{}", token_name(token)), token.clone()));
    Ok(std::iter::once((format!("{folder}/{ROOTS}"), text)).chain(tokens).collect())
}

/// A stamp in a bundle: roots, each with its path to the stamped data, and the tokens over it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BundledStamp {
    /// The root of the tree over the roots.
    pub top: Hash,
    /// The number of roots under it.
    pub count: u64,
    /// Those shown by the bundle, each once, in their order.
    pub roots: Vec<StampedRoot>,
    /// One or more, DER; none is checked yet.
    pub tokens: Vec<Vec<u8>>,
}

impl BundledStamp {
    pub(crate) fn leads(&self, place: &StampedRoot) -> bool {
        root_of(stamp_hash(&place.root), place.index, self.count, &place.path) == Some(self.top)
    }
}

#[derive(Default)]
pub(crate) struct DraftStamp {
    listed: Option<Listed>,
    tokens: Vec<Vec<u8>>,
}

impl DraftStamp {
    pub fn take(&mut self, name: &str, part: &str, bytes: &[u8]) -> Result<(), BundleError> {
        let wrong = |why: &str| BundleError::of(name, why);
        if part == ROOTS {
            let listed: Listed = crate::manifest::from_json(bytes).map_err(|error| wrong(&error))?;
            if listed.format != FORMAT {
                return Err(wrong(&format!("its format is not {FORMAT}")));
            }
            if listed.count > MOST_ROOTS as u64 || listed.roots.len() > MOST_ROOTS {
                return Err(wrong(&format!("it has more than {MOST_ROOTS} roots")));
            }
            if !listed.roots.is_sorted_by(|one, next| one.root < next.root) {
                return Err(wrong("its roots are not in order, each once"));
            }
            if listed.roots.iter().any(|place| place.path.len() > LONGEST_PATH) {
                return Err(wrong("a path is longer than in any stamp"));
            }
            self.listed = Some(listed);
            return Ok(());
        }
        if bytes.len() > LARGEST_DER || part != token_name(bytes) {
            return Err(wrong("is not a token named by its SHA-256"));
        }
        if self.tokens.len() >= MOST_TOKENS {
            return Err(wrong(&format!("exceeds the limit of {MOST_TOKENS} tokens")));
        }
        self.tokens.push(bytes.to_vec());
        Ok(())
    }

    pub fn finish(self, imprint: &Hash) -> Result<BundledStamp, BundleError> {
        let name = format!("{STAMPS}/{}/{ROOTS}", imprint.to_hex());
        let listed = self.listed.ok_or_else(|| BundleError::of(&name, "is missing"))?;
        if imprint_of(&listed.top, listed.count) != imprint.0 {
            return Err(BundleError::of(&name, "is filed under another stamp's imprint"));
        }
        if self.tokens.is_empty() {
            return Err(BundleError::of(&name, "has no token with it"));
        }
        let Listed { top, count, roots, .. } = listed;
        Ok(BundledStamp { top, count, roots, tokens: self.tokens })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_has_a_bound() {
        assert!(outer("test", &vec![0; LARGEST_DER + 1]).is_err());
    }

    #[test]
    fn times_are_those_of_the_calendar() {
        let at = |tag, text: &str| {
            let (content, whole) = (text.as_bytes(), text.as_bytes());
            seconds(Element { tag, content, whole }, "test", true).ok()
        };
        // date -u -d TIME +%s
        assert_eq!(at(GENERALIZED_TIME, "20240229235959Z"), Some(1_709_251_199));
        assert_eq!(at(GENERALIZED_TIME, "20000301000000Z"), Some(951_868_800));
        assert_eq!(at(GENERALIZED_TIME, "20261123113000.5Z"), Some(1_795_433_401));
        assert_eq!(at(UTC_TIME, "491231235959Z"), Some(2_524_607_999));
        assert_eq!(at(UTC_TIME, "700101000000Z"), Some(0));
        for bad in [
            "20230229000000Z",
            "20261323000000Z",
            "20261123240000Z",
            "20261123113000",
            "20261123113000.50Z",
            "2026Z",
            "",
        ] {
            assert_eq!(at(GENERALIZED_TIME, bad), None, "{bad}");
        }
    }
}

//! A token: CMS SignedData (RFC 5652) over TSTInfo (RFC 3161), by one signer, with the signer's certificate.

use super::certificate::Certificate;
use super::der::{
    BOOLEAN, Der, GENERALIZED_TIME, INTEGER, OBJECT, OCTETS, SEQUENCE, SET, context, primitive, seconds, small,
};
use super::signature::{HashKind, Scheme};
use super::{TimeError, form, names};

const PART: &str = "token";
const INFO: &str = "stamp";
const SIGNER: &str = "signer's part";
/// The most certificates in a token.
const MOST_CERTIFICATES: usize = 8;
/// The most signed attributes.
const MOST_ATTRIBUTES: usize = 16;

/// A token in its parts; nothing has been checked yet.
pub(super) struct Token<'a> {
    pub info: Info<'a>,
    /// The signed content.
    pub content: &'a [u8],
    pub certificates: Vec<Certificate>,
    pub signer: Signer<'a>,
}

/// The authority's statement.
pub(super) struct Info<'a> {
    pub imprint: &'a [u8],
    /// When, seconds; fractions dropped.
    pub at: u64,
    /// The second by which it certainly existed, by its own accuracy.
    pub before: u64,
    pub nonce: Option<&'a [u8]>,
}

/// Who signed it, and how.
pub(super) struct Signer<'a> {
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
    /// The only value of an attribute.
    pub fn attribute(&self, name: &[u8]) -> Option<Der<'a>> {
        self.attributes.iter().find(|(known, _)| *known == name).map(|(_, values)| *values)
    }
}

impl<'a> Token<'a> {
    pub fn parse(bytes: &'a [u8]) -> Result<Self, TimeError> {
        let mut outer = Der::only(PART, bytes, SEQUENCE)?;
        if outer.object()? != names::SIGNED_DATA {
            return Err(form(PART, "it is not signed data"));
        }
        let mut wrapped = outer.inside(context(0))?;
        outer.end()?;
        let mut data = wrapped.inside(SEQUENCE)?;
        wrapped.end()?;
        // RFC 5652, 5.1: content other than plain data.
        if data.small()? != 3 {
            return Err(form(PART, "its version is not 3"));
        }
        let mut hashes = data.inside(SET)?;
        let hash = HashKind::read(&mut hashes, SEQUENCE)?;
        hashes.end()?;
        let mut about = data.inside(SEQUENCE)?;
        if about.object()? != names::STAMP {
            return Err(form(PART, "it is signed data, but not a time stamp"));
        }
        let mut explicit = about.inside(context(0))?;
        about.end()?;
        let content = explicit.element(OCTETS)?.content;
        explicit.end()?;
        let certificates = certificates(&mut data)?;
        if data.next_tag() == Some(context(1)) {
            return Err(form(PART, "it includes certificate revocation lists, which are not supported"));
        }
        let mut signers = data.inside(SET)?;
        data.end()?;
        let signer = Signer::parse(&mut signers)?;
        signers.end()?;
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
        let mut sid = one.inside(SEQUENCE)?;
        let (issuer, serial) = (sid.element(SEQUENCE)?.whole, sid.integer()?);
        sid.end()?;
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
    let (mut all, mut found) = (Der::new(SIGNER, bytes)?, Vec::new());
    while !all.is_empty() {
        let mut one = all.inside(SEQUENCE)?;
        let name = one.object()?;
        let mut values = one.inside(SET)?;
        one.end()?;
        let value = Der::new(SIGNER, values.any()?.whole)?;
        values.end()?;
        if found.len() >= MOST_ATTRIBUTES || found.iter().any(|(known, _)| *known == name) {
            return Err(form(SIGNER, "an attribute is a duplicate, or one too many"));
        }
        found.push((name, value));
    }
    Ok(found)
}

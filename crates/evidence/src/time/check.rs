//! The check of a token from its imprint up to the pinned certificate, without a network.

use authros_model::Timestamp;
use ring::digest::{SHA1_FOR_LEGACY_USE_ONLY, digest};

use super::certificate::Certificate;
use super::der::{OBJECT, OCTETS, SEQUENCE};
use super::request::Request;
use super::signature::HashKind;
use super::token::{Signer, Token};
use super::{TimeError, form, names, path};

/// The content of a valid token.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Stamped {
    /// When, by the authority's clock; fractions of a second dropped.
    pub at: Timestamp,
    /// The time by which it certainly existed, by the accuracy that the authority states.
    pub before: Timestamp,
    /// The signer's name in the certificate, cleaned.
    pub signer: String,
    /// Which of the pinned certificates it leads to; `None` if it leads to none, and then all this is only its own
    /// word.
    pub pinned: Option<usize>,
}

impl Stamped {
    /// Which of the pinned certificates it leads to.
    ///
    /// # Errors
    /// [`TimeError::NotPinned`] if it leads to none.
    pub fn by_pinned(&self) -> Result<usize, TimeError> {
        self.pinned.ok_or_else(|| TimeError::NotPinned(self.signer.clone()))
    }
}

/// Checks a token (DER, at most [`super::LARGEST_DER`] bytes): form, imprint (SHA-256), nonce if the request is known,
/// signed content (RFC 5652, 5.6), that the signature names its certificate (RFC 5816), the signature itself, the
/// certificate's purpose, validity at the stamped time, and the path to one of the pinned certificates. Whether a
/// certificate was revoked is not looked up.
///
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

/// Which pinned certificate it leads to.
fn way(
    first: &Certificate,
    others: &[Certificate],
    pinned: &[Certificate],
    at: u64,
) -> Result<Option<usize>, TimeError> {
    let mut fault = None;
    for (place, pinned) in pinned.iter().enumerate() {
        match path::check(first, others, pinned, at) {
            Ok(()) => return Ok(Some(place)),
            Err(TimeError::NotPinned(_)) => {}
            Err(error) => drop(fault.get_or_insert(error)),
        }
    }
    fault.map_or(Ok(None), Err)
}

/// The signed content is a stamp, and this one.
fn content(signer: &Signer<'_>, content: &[u8]) -> Result<(), TimeError> {
    let missing = || form("signer's part", "a required attribute is missing");
    let mut kind = signer.attribute(names::CONTENT_TYPE).ok_or_else(missing)?;
    let is_stamp = kind.element(OBJECT)?.content == names::STAMP;
    kind.end()?;
    let mut hash = signer.attribute(names::MESSAGE_DIGEST).ok_or_else(missing)?;
    let is_this = hash.element(OCTETS)?.content == signer.hash.of(content).as_ref();
    hash.end()?;
    if is_stamp && is_this { Ok(()) } else { Err(TimeError::OtherContent) }
}

/// The signature names its certificate, so that no other one with the same key can take its place. SHA-1 (RFC 2634) is
/// accepted, too: substituting a certificate needs a second preimage, and many authorities still write that.
fn named(signer: &Signer<'_>, certificate: &Certificate) -> Result<(), TimeError> {
    let (second, first) = (names::SIGNING_CERTIFICATE_2, names::SIGNING_CERTIFICATE);
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

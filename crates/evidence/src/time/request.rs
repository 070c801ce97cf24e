//! The request to an authority, and the token in its answer (RFC 3161, 2.4).

use super::TimeError;
use super::der::{self, BOOLEAN, Der, INTEGER, NULL, OBJECT, OCTETS, SEQUENCE, UTF8};
use super::names;

/// The media type of a request.
pub const REQUEST_TYPE: &str = "application/timestamp-query";
/// The longest answer that is read, bytes.
pub const LONGEST_ANSWER: usize = der::LARGEST_DER;

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
        let hash = der::put(SEQUENCE, &[&der::put(OBJECT, &[names::SHA_256]), &der::put(NULL, &[])]);
        let imprint = der::put(SEQUENCE, &[&hash, &der::put(OCTETS, &[&self.imprint])]);
        let (version, nonce) = (der::put(INTEGER, &[&[1]]), der::put(INTEGER, &[&self.nonce_integer()]));
        der::put(SEQUENCE, &[&version, &imprint, &nonce, &der::put(BOOLEAN, &[&[0xff]])])
    }

    /// The nonce as a positive integer in the shortest form.
    pub(super) fn nonce_integer(&self) -> Vec<u8> {
        let mut bytes = self.nonce;
        // Positive, and never shorter.
        bytes[0] = bytes[0] & 0x7f | 0x40;
        bytes.to_vec()
    }
}

/// The token in an authority's answer.
///
/// # Errors
/// [`TimeError::NotGranted`] with its text, [`TimeError::Form`] if it is not an answer.
pub fn token_of(answer: &[u8]) -> Result<&[u8], TimeError> {
    let mut outer = Der::only("answer", answer, SEQUENCE)?;
    let mut about = outer.inside(SEQUENCE)?;
    let status = about.small()?;
    // granted, and grantedWithMods.
    if status > 1 {
        let texts = about.inside_optional(SEQUENCE)?;
        let text = texts.and_then(|mut texts| texts.element(UTF8).ok());
        return Err(TimeError::not_granted(status, text.and_then(|text| std::str::from_utf8(text.content).ok())));
    }
    let token = outer.element(SEQUENCE)?.whole;
    outer.end()?;
    Ok(token)
}

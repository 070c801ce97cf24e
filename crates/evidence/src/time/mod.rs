//! External time: an authority's stamp (RFC 3161) over the roots of batches, requested and checked without a network.
//! The pin is a certificate; whether one was revoked is not looked up.

mod certificate;
mod check;
mod der;
mod names;
mod path;
mod request;
mod signature;
mod stamp;
mod token;

pub use certificate::Certificate;
pub use check::{Stamped, check_token};
pub use der::LARGEST_DER;
pub use request::{LONGEST_ANSWER, REQUEST_TYPE, Request, token_of};
pub use stamp::{BundledStamp, MOST_ROOTS, MOST_TOKENS, StampTree, StampedRoot};
pub(crate) use stamp::{DraftStamp, members};

use authros_model::{Timestamp, clean};

/// Why a stamp is not accepted.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the variants and their messages name the fields")]
pub enum TimeError {
    /// It is malformed.
    #[error("the {part} is malformed: {why}")]
    Form { part: &'static str, why: &'static str },
    /// The authority gave none: PKIStatus of RFC 3161, and its text, cleaned.
    #[error("the authority gave no stamp: status {status}{}", .text.as_ref().map_or(String::new(), |text| format!(", {text}")))]
    NotGranted { status: u64, text: Option<String> },
    /// It covers something else.
    #[error("it stamps something else: its message imprint differs")]
    OtherImprint,
    /// The imprint uses another hash than requested.
    #[error("its message imprint is not SHA-256")]
    ImprintHash,
    /// It answers another request.
    #[error("it answers another request: its nonce differs")]
    OtherNonce,
    /// The certificate that signed it is missing.
    #[error("it does not include its signer's certificate")]
    NoCertificate,
    /// The signed attributes are not those of this content.
    #[error("its signature covers different content")]
    OtherContent,
    /// The signature covers no name of the certificate, or another one's.
    #[error("its signature does not name its certificate (ESSCertID)")]
    OtherCertificate,
    /// The signature is not valid.
    #[error("its signature is invalid")]
    Signature,
    /// Signed in a way unknown to this program.
    #[error("it is signed with {0}, which this program cannot check")]
    Algorithm(&'static str),
    /// The certificate is not for time stamps only.
    #[error("its certificate is not restricted to time stamping (critical extended key usage timeStamping)")]
    NotForStamps,
    /// A certificate was not valid then.
    #[error("the certificate of {name} was not valid at {at}; it is valid from {from} to {until}")]
    NotValid { name: String, at: Timestamp, from: Timestamp, until: Timestamp },
    /// There is no path from the certificate to the pinned one.
    #[error("no certificate in it links {0} to a pinned one")]
    NotPinned(String),
    /// A certificate on the path may not issue others.
    #[error("the certificate of {0}, in the chain, may not issue others")]
    NotAnIssuer(String),
    /// A certificate on the path is not signed by the one above.
    #[error("the certificate of {0}, in the chain, is not signed by the one above it")]
    Forged(String),
    /// A certificate has a critical extension unknown to this program.
    #[error("the certificate of {0} has an unknown critical extension")]
    Critical(String),
}

impl TimeError {
    fn not_granted(status: u64, text: Option<&str>) -> Self {
        Self::NotGranted { status, text: text.map(|text| clean(text, 200)) }
    }
}

/// A malformed part.
fn form(part: &'static str, why: &'static str) -> TimeError {
    TimeError::Form { part, why }
}

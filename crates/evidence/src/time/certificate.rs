//! Certificates (X.509) as far as time stamp authorities need them.

use authros_crypto::der::{BITS, BOOLEAN, Der, Element, NULL, OCTETS, SEQUENCE, SET, context, primitive};
use authros_model::{Timestamp, clean};
use base64::{Engine as _, engine::general_purpose::STANDARD};
use ring::digest::{self, SHA256, SHA384, SHA512};
use ring::signature::{
    ECDSA_P256_SHA256_ASN1, ECDSA_P256_SHA384_ASN1, ECDSA_P384_SHA256_ASN1, ECDSA_P384_SHA384_ASN1,
    RSA_PKCS1_2048_8192_SHA256, RSA_PKCS1_2048_8192_SHA384, RSA_PKCS1_2048_8192_SHA512, RSA_PSS_2048_8192_SHA256,
    RSA_PSS_2048_8192_SHA384, RSA_PSS_2048_8192_SHA512, UnparsedPublicKey, VerificationAlgorithm,
};

use super::{TimeError, form, outer, seconds};

const PART: &str = "certificate";
const BEGIN: &str = "-----BEGIN CERTIFICATE-----";
const END: &str = "-----END CERTIFICATE-----";
/// keyCertSign, the sixth bit of keyUsage.
const MAY_SIGN_CERTIFICATES: u8 = 0x04;
/// digitalSignature and nonRepudiation.
const MAY_SIGN: u8 = 0xc0;

/// A certificate.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Certificate {
    pub(super) der: Vec<u8>,
    pub(super) signed: Vec<u8>,
    /// Not every scheme is checked here.
    pub(super) scheme: Result<Scheme, TimeError>,
    pub(super) signature: Vec<u8>,
    pub(super) serial: Vec<u8>,
    pub(super) issuer: Vec<u8>,
    pub(super) subject: Vec<u8>,
    pub(super) from: u64,
    pub(super) until: u64,
    pub(super) key: Key,
    pub(super) uses: Uses,
}

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Uses {
    /// It may issue others, with at most this number between it and the last; without a limit, that is `u64::MAX`.
    pub issuer: Option<u64>,
    pub key: Option<u8>,
    /// A critical extended key usage that names timeStamping and nothing else.
    pub stamps: bool,
    /// It has a critical extension that nothing here knows.
    pub unknown: bool,
}

impl Uses {
    pub fn may_issue(&self) -> bool {
        self.issuer.is_some() && self.key.is_none_or(|bits| bits & MAY_SIGN_CERTIFICATES != 0)
    }

    pub fn may_stamp(&self) -> bool {
        self.stamps && self.key.is_none_or(|bits| bits & MAY_SIGN != 0)
    }
}

impl Certificate {
    /// From DER.
    /// # Errors
    /// [`TimeError`] where it is none, or signed in an unknown way.
    pub fn parse(der: &[u8]) -> Result<Self, TimeError> {
        let mut outer = outer(PART, der)?;
        let signed = outer.element(SEQUENCE)?;
        let algorithm = outer.element(SEQUENCE)?.whole;
        let scheme = match Scheme::read(&mut Der::new(PART, algorithm)) {
            Err(error @ TimeError::Form { .. }) => return Err(error),
            found => found,
        };
        let signature = outer.bits()?.to_vec();
        outer.end()?;
        let mut inner = Der::new(PART, signed.content);
        if let Some(mut version) = inner.inside_optional(context(0))? {
            version.small()?;
            version.end()?;
        }
        let serial = inner.integer()?.to_vec();
        if inner.element(SEQUENCE)?.whole != algorithm {
            return Err(form(PART, "it names two signature algorithms"));
        }
        let issuer = inner.element(SEQUENCE)?.whole.to_vec();
        let (from, until) =
            inner.within(SEQUENCE, |validity| Ok::<_, TimeError>((validity.any()?, validity.any()?)))?;
        let subject = inner.element(SEQUENCE)?.whole.to_vec();
        let key = Key::read(&mut inner)?;
        for unique in [1, 2] {
            inner.optional(primitive(unique))?;
        }
        let uses = match inner.inside_optional(context(3))? {
            Some(extensions) => uses(extensions)?,
            None => Uses::default(),
        };
        inner.end()?;
        let (from, until) = (seconds(from, PART, false)?, seconds(until, PART, false)?);
        let (der, signed) = (der.to_vec(), signed.whole.to_vec());
        Ok(Self { der, signed, scheme, signature, serial, issuer, subject, from, until, key, uses })
    }

    /// From PEM: the first certificate of it.
    /// # Errors
    /// [`TimeError`] where there is none.
    pub fn from_pem(text: &str) -> Result<Self, TimeError> {
        let after = text.split_once(BEGIN).map(|(_, after)| after);
        let body = after.and_then(|after| after.split_once(END)).map(|(body, _)| body);
        let body = body.ok_or_else(|| form(PART, "it is not a PEM certificate"))?;
        let plain: String = body.split_ascii_whitespace().collect();
        let bytes = STANDARD.decode(plain).map_err(|_| form(PART, "its PEM is broken"))?;
        Self::parse(&bytes)
    }

    /// As DER.
    pub fn der(&self) -> &[u8] {
        &self.der
    }

    /// What names it: the common name of its subject, else its serial number, for people.
    pub fn name(&self) -> String {
        common_name(&self.subject).unwrap_or_else(|| {
            let digits: String = self.serial.iter().take(20).map(|byte| format!("{byte:02x}")).collect();
            format!("serial number {digits}")
        })
    }

    pub(super) fn valid_at(&self, at: u64) -> Result<(), TimeError> {
        if (self.from..=self.until).contains(&at) {
            return Ok(());
        }
        let [at, from, until] = [at, self.from, self.until].map(Timestamp::from_seconds);
        Err(TimeError::NotValid { name: self.name(), at, from, until })
    }
}

fn uses(mut der: Der<'_>) -> Result<Uses, TimeError> {
    let (mut uses, mut seen) = (Uses::default(), Vec::new());
    let mut all = der.inside(SEQUENCE)?;
    der.end()?;
    while !all.is_empty() {
        let mut one = all.inside(SEQUENCE)?;
        let name = one.object()?;
        if seen.contains(&name) {
            return Err(form(PART, "an extension appears twice"));
        }
        seen.push(name);
        let is_critical = if one.next_tag() == Some(BOOLEAN) { one.boolean()? } else { false };
        let value = one.element(OCTETS)?;
        one.end()?;
        uses.take(name, is_critical, value)?;
    }
    Ok(uses)
}

impl Uses {
    fn take(&mut self, name: &[u8], is_critical: bool, value: Element<'_>) -> Result<(), TimeError> {
        match name {
            BASIC_CONSTRAINTS => {
                let mut inner = Der::only(PART, value.content, SEQUENCE)?;
                let issues = inner.next_tag() == Some(BOOLEAN) && inner.boolean()?;
                let most = if inner.is_empty() { u64::MAX } else { inner.small()? };
                inner.end()?;
                self.issuer = issues.then_some(most);
            }
            KEY_USAGE => {
                let mut outer = Der::new(PART, value.content);
                let bits = outer.element(BITS)?.content;
                outer.end()?;
                self.key = Some(bits.get(1).copied().unwrap_or(0));
            }
            EXTENDED_KEY_USAGE => {
                let mut inner = Der::only(PART, value.content, SEQUENCE)?;
                let first = inner.object()?;
                self.stamps = is_critical && first == TIME_STAMPING && inner.is_empty();
            }
            POLICIES => {}
            _ => self.unknown |= is_critical,
        }
        Ok(())
    }
}

fn common_name(name: &[u8]) -> Option<String> {
    const COMMON_NAME: &[u8] = b"\x55\x04\x03";
    let mut parts = Der::only(PART, name, SEQUENCE).ok()?;
    let mut found = None;
    while !parts.is_empty() {
        let mut set = parts.inside(SET).ok()?;
        while !set.is_empty() {
            let mut one = set.inside(SEQUENCE).ok()?;
            if one.object().ok()? == COMMON_NAME {
                found = Some(clean(&String::from_utf8_lossy(one.any().ok()?.content), 80));
            }
        }
    }
    found
}

/// id-signedData (RFC 5652).
pub(super) const SIGNED_DATA: &[u8] = b"\x2a\x86\x48\x86\xf7\x0d\x01\x07\x02";
/// id-ct-TSTInfo (RFC 3161).
pub(super) const STAMP: &[u8] = b"\x2a\x86\x48\x86\xf7\x0d\x01\x09\x10\x01\x04";
pub(super) const CONTENT_TYPE: &[u8] = b"\x2a\x86\x48\x86\xf7\x0d\x01\x09\x03";
pub(super) const MESSAGE_DIGEST: &[u8] = b"\x2a\x86\x48\x86\xf7\x0d\x01\x09\x04";
/// id-aa-signingCertificate (RFC 2634), by SHA-1.
pub(super) const SIGNING_CERTIFICATE: &[u8] = b"\x2a\x86\x48\x86\xf7\x0d\x01\x09\x10\x02\x0c";
/// id-aa-signingCertificateV2 (RFC 5035).
pub(super) const SIGNING_CERTIFICATE_2: &[u8] = b"\x2a\x86\x48\x86\xf7\x0d\x01\x09\x10\x02\x2f";

pub(super) const SHA_256: &[u8] = b"\x60\x86\x48\x01\x65\x03\x04\x02\x01";
const SHA_384: &[u8] = b"\x60\x86\x48\x01\x65\x03\x04\x02\x02";
const SHA_512: &[u8] = b"\x60\x86\x48\x01\x65\x03\x04\x02\x03";

/// rsaEncryption: a key, and a signature whose hash is named elsewhere.
pub(super) const RSA: &[u8] = b"\x2a\x86\x48\x86\xf7\x0d\x01\x01\x01";
const RSA_SHA_256: &[u8] = b"\x2a\x86\x48\x86\xf7\x0d\x01\x01\x0b";
const RSA_SHA_384: &[u8] = b"\x2a\x86\x48\x86\xf7\x0d\x01\x01\x0c";
const RSA_SHA_512: &[u8] = b"\x2a\x86\x48\x86\xf7\x0d\x01\x01\x0d";
/// id-RSASSA-PSS.
pub(super) const RSA_PSS: &[u8] = b"\x2a\x86\x48\x86\xf7\x0d\x01\x01\x0a";
/// id-mgf1.
const MASK: &[u8] = b"\x2a\x86\x48\x86\xf7\x0d\x01\x01\x08";

/// id-ecPublicKey.
const CURVE_KEY: &[u8] = b"\x2a\x86\x48\xce\x3d\x02\x01";
const P_256: &[u8] = b"\x2a\x86\x48\xce\x3d\x03\x01\x07";
const P_384: &[u8] = b"\x2b\x81\x04\x00\x22";
const ECDSA_SHA_256: &[u8] = b"\x2a\x86\x48\xce\x3d\x04\x03\x02";
const ECDSA_SHA_384: &[u8] = b"\x2a\x86\x48\xce\x3d\x04\x03\x03";
const ECDSA_SHA_512: &[u8] = b"\x2a\x86\x48\xce\x3d\x04\x03\x04";

/// keyUsage (RFC 5280).
const KEY_USAGE: &[u8] = b"\x55\x1d\x0f";
const BASIC_CONSTRAINTS: &[u8] = b"\x55\x1d\x13";
const POLICIES: &[u8] = b"\x55\x1d\x20";
const EXTENDED_KEY_USAGE: &[u8] = b"\x55\x1d\x25";
/// id-kp-timeStamping.
const TIME_STAMPING: &[u8] = b"\x2b\x06\x01\x05\x05\x07\x03\x08";

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum HashKind {
    Sha256,
    Sha384,
    Sha512,
}

impl HashKind {
    /// From an AlgorithmIdentifier: nothing or NULL after the name.
    pub fn read(der: &mut Der<'_>, tag: u8) -> Result<Self, TimeError> {
        let mut inner = der.inside(tag)?;
        let kind =
            Self::named(inner.object()?).ok_or(TimeError::Algorithm("a hash other than SHA-256, -384 or -512"))?;
        nothing(&mut inner)?;
        Ok(kind)
    }

    fn named(name: &[u8]) -> Option<Self> {
        [(SHA_256, Self::Sha256), (SHA_384, Self::Sha384), (SHA_512, Self::Sha512)]
            .into_iter()
            .find_map(|(known, kind)| (known == name).then_some(kind))
    }

    fn algorithm(self) -> &'static digest::Algorithm {
        match self {
            Self::Sha256 => &SHA256,
            Self::Sha384 => &SHA384,
            Self::Sha512 => &SHA512,
        }
    }

    pub fn of(self, bytes: &[u8]) -> digest::Digest {
        digest::digest(self.algorithm(), bytes)
    }
}

fn nothing(der: &mut Der<'_>) -> Result<(), TimeError> {
    if let Some(null) = der.optional(NULL)?
        && !null.content.is_empty()
    {
        return Err(der.wrong("NULL is not empty").into());
    }
    Ok(der.end()?)
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scheme {
    /// RSA; the hash is named elsewhere.
    Rsa,
    Pkcs1(HashKind),
    Pss(HashKind),
    Ecdsa(HashKind),
}

impl Scheme {
    pub fn read(der: &mut Der<'_>) -> Result<Self, TimeError> {
        let mut inner = der.inside(SEQUENCE)?;
        let name = inner.object()?;
        if name == RSA_PSS {
            return pss(&mut inner);
        }
        nothing(&mut inner)?;
        let known = [
            (RSA, Self::Rsa),
            (RSA_SHA_256, Self::Pkcs1(HashKind::Sha256)),
            (RSA_SHA_384, Self::Pkcs1(HashKind::Sha384)),
            (RSA_SHA_512, Self::Pkcs1(HashKind::Sha512)),
            (ECDSA_SHA_256, Self::Ecdsa(HashKind::Sha256)),
            (ECDSA_SHA_384, Self::Ecdsa(HashKind::Sha384)),
            (ECDSA_SHA_512, Self::Ecdsa(HashKind::Sha512)),
        ];
        let found = known.into_iter().find_map(|(known, scheme)| (known == name).then_some(scheme));
        found.ok_or(TimeError::Algorithm("an algorithm other than RSA or ECDSA with SHA-256, -384 or -512"))
    }

    /// With the hash that the signer names for the signed data; `None` if the two contradict each other.
    pub fn with_hash(self, hash: HashKind) -> Option<Self> {
        match self {
            Self::Rsa => Some(Self::Pkcs1(hash)),
            Self::Pkcs1(own) | Self::Pss(own) | Self::Ecdsa(own) => (own == hash).then_some(self),
        }
    }
}

/// RFC 4055, 3.1: the same hash twice, and a salt of the same length.
fn pss(der: &mut Der<'_>) -> Result<Scheme, TimeError> {
    let other = TimeError::Algorithm("RSA-PSS with parameters other than a single hash and a salt of its length");
    let mut inner = der.inside(SEQUENCE)?;
    der.end()?;
    // Without it, the hash is SHA-1.
    let mut hash = inner.inside_optional(context(0))?.ok_or_else(|| other.clone())?;
    let kind = HashKind::read(&mut hash, SEQUENCE)?;
    hash.end()?;
    let mut mask = inner.inside_optional(context(1))?.ok_or_else(|| other.clone())?;
    let mut generator = mask.inside(SEQUENCE)?;
    mask.end()?;
    let is_known = generator.object()? == MASK;
    let same = HashKind::read(&mut generator, SEQUENCE)? == kind;
    generator.end()?;
    let mut salt = inner.inside_optional(context(2))?.ok_or_else(|| other.clone())?;
    let fits = salt.small()? == kind.algorithm().output_len() as u64;
    salt.end()?;
    if let Some(mut trailer) = inner.inside_optional(context(3))? {
        if trailer.small()? != 1 {
            return Err(other);
        }
        trailer.end()?;
    }
    inner.end()?;
    if is_known && same && fits { Ok(Scheme::Pss(kind)) } else { Err(other) }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Key {
    /// RSAPublicKey of PKCS#1; whether it is for PSS alone.
    Rsa(Vec<u8>, bool),
    P256(Vec<u8>),
    P384(Vec<u8>),
    Other,
}

impl Key {
    pub fn read(der: &mut Der<'_>) -> Result<Self, TimeError> {
        let mut info = der.inside(SEQUENCE)?;
        let mut algorithm = info.inside(SEQUENCE)?;
        let name = algorithm.object()?;
        let curve = if name == CURVE_KEY { Some(algorithm.any()?.content) } else { None };
        let bytes = info.bits()?.to_vec();
        info.end()?;
        Ok(match (name, curve) {
            (RSA, _) => Self::Rsa(bytes, false),
            (RSA_PSS, _) => Self::Rsa(bytes, true),
            (_, Some(P_256)) => Self::P256(bytes),
            (_, Some(P_384)) => Self::P384(bytes),
            _ => Self::Other,
        })
    }

    pub fn verify(&self, scheme: Scheme, message: &[u8], signature: &[u8]) -> Result<(), TimeError> {
        use HashKind::{Sha256, Sha384, Sha512};
        let (algorithm, key): (&'static dyn VerificationAlgorithm, _) = match (self, scheme) {
            (Self::Rsa(key, false), Scheme::Pkcs1(Sha256)) => (&RSA_PKCS1_2048_8192_SHA256, key),
            (Self::Rsa(key, false), Scheme::Pkcs1(Sha384)) => (&RSA_PKCS1_2048_8192_SHA384, key),
            (Self::Rsa(key, false), Scheme::Pkcs1(Sha512)) => (&RSA_PKCS1_2048_8192_SHA512, key),
            (Self::Rsa(key, _), Scheme::Pss(Sha256)) => (&RSA_PSS_2048_8192_SHA256, key),
            (Self::Rsa(key, _), Scheme::Pss(Sha384)) => (&RSA_PSS_2048_8192_SHA384, key),
            (Self::Rsa(key, _), Scheme::Pss(Sha512)) => (&RSA_PSS_2048_8192_SHA512, key),
            (Self::P256(key), Scheme::Ecdsa(Sha256)) => (&ECDSA_P256_SHA256_ASN1, key),
            (Self::P256(key), Scheme::Ecdsa(Sha384)) => (&ECDSA_P256_SHA384_ASN1, key),
            (Self::P384(key), Scheme::Ecdsa(Sha256)) => (&ECDSA_P384_SHA256_ASN1, key),
            (Self::P384(key), Scheme::Ecdsa(Sha384)) => (&ECDSA_P384_SHA384_ASN1, key),
            (_, Scheme::Ecdsa(Sha512)) => return Err(TimeError::Algorithm("ECDSA with SHA-512")),
            (Self::Other, _) => return Err(TimeError::Algorithm("a key that is neither RSA nor on P-256 or P-384")),
            _ => return Err(form("signature", "its algorithm does not fit its key")),
        };
        UnparsedPublicKey::new(algorithm, key).verify(message, signature).map_err(|_| TimeError::Signature)
    }
}

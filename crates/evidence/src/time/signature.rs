//! Signatures of authorities: RSA (PKCS#1 v1.5 and PSS, at least 2048 bits), ECDSA over P-256 and P-384. Verified by
//! `ring`, which comes with TLS; nothing is ever signed here.

use ring::digest::{self, SHA256, SHA384, SHA512};
use ring::signature::{
    ECDSA_P256_SHA256_ASN1, ECDSA_P256_SHA384_ASN1, ECDSA_P384_SHA256_ASN1, ECDSA_P384_SHA384_ASN1,
    RSA_PKCS1_2048_8192_SHA256, RSA_PKCS1_2048_8192_SHA384, RSA_PKCS1_2048_8192_SHA512, RSA_PSS_2048_8192_SHA256,
    RSA_PSS_2048_8192_SHA384, RSA_PSS_2048_8192_SHA512, UnparsedPublicKey, VerificationAlgorithm,
};

use super::der::{Der, NULL, SEQUENCE, context};
use super::{TimeError, form, names};

/// A hash.
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
        [(names::SHA_256, Self::Sha256), (names::SHA_384, Self::Sha384), (names::SHA_512, Self::Sha512)]
            .into_iter()
            .find_map(|(known, kind)| (known == name).then_some(kind))
    }

    /// The hash of these bytes.
    pub fn of(self, bytes: &[u8]) -> digest::Digest {
        let algorithm = match self {
            Self::Sha256 => &SHA256,
            Self::Sha384 => &SHA384,
            Self::Sha512 => &SHA512,
        };
        digest::digest(algorithm, bytes)
    }

    fn length(self) -> u64 {
        match self {
            Self::Sha256 => 32,
            Self::Sha384 => 48,
            Self::Sha512 => 64,
        }
    }
}

fn nothing(der: &mut Der<'_>) -> Result<(), TimeError> {
    if let Some(null) = der.optional(NULL)?
        && !null.content.is_empty()
    {
        return Err(der.wrong("NULL is not empty"));
    }
    der.end()
}

/// How something is signed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scheme {
    /// RSA; the hash is named elsewhere.
    Rsa,
    /// RSA by PKCS#1 v1.5.
    Pkcs1(HashKind),
    /// RSA by PSS.
    Pss(HashKind),
    /// ECDSA.
    Ecdsa(HashKind),
}

impl Scheme {
    /// From an AlgorithmIdentifier.
    pub fn read(der: &mut Der<'_>) -> Result<Self, TimeError> {
        let mut inner = der.inside(SEQUENCE)?;
        let name = inner.object()?;
        if name == names::RSA_PSS {
            return pss(&mut inner);
        }
        nothing(&mut inner)?;
        let known = [
            (names::RSA, Self::Rsa),
            (names::RSA_SHA_256, Self::Pkcs1(HashKind::Sha256)),
            (names::RSA_SHA_384, Self::Pkcs1(HashKind::Sha384)),
            (names::RSA_SHA_512, Self::Pkcs1(HashKind::Sha512)),
            (names::ECDSA_SHA_256, Self::Ecdsa(HashKind::Sha256)),
            (names::ECDSA_SHA_384, Self::Ecdsa(HashKind::Sha384)),
            (names::ECDSA_SHA_512, Self::Ecdsa(HashKind::Sha512)),
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
    let is_known = generator.object()? == names::MASK;
    let same = HashKind::read(&mut generator, SEQUENCE)? == kind;
    generator.end()?;
    let mut salt = inner.inside_optional(context(2))?.ok_or_else(|| other.clone())?;
    let fits = salt.small()? == kind.length();
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

/// A key as its certificate has it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Key {
    /// RSAPublicKey of PKCS#1; whether it is for PSS alone.
    Rsa(Vec<u8>, bool),
    /// A point of P-256.
    P256(Vec<u8>),
    /// A point of P-384.
    P384(Vec<u8>),
    /// Of a kind that is not supported here.
    Other,
}

impl Key {
    /// From a SubjectPublicKeyInfo.
    pub fn read(der: &mut Der<'_>) -> Result<Self, TimeError> {
        let mut info = der.inside(SEQUENCE)?;
        let mut algorithm = info.inside(SEQUENCE)?;
        let name = algorithm.object()?;
        let curve = if name == names::CURVE_KEY { Some(algorithm.any()?.content) } else { None };
        let bytes = info.bits()?.to_vec();
        info.end()?;
        Ok(match (name, curve) {
            (names::RSA, _) => Self::Rsa(bytes, false),
            (names::RSA_PSS, _) => Self::Rsa(bytes, true),
            (_, Some(names::P_256)) => Self::P256(bytes),
            (_, Some(names::P_384)) => Self::P384(bytes),
            _ => Self::Other,
        })
    }

    /// Whether this key signed the message.
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

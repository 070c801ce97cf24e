//! Object identifiers used in stamps and certificates, as DER content.

/// id-signedData (RFC 5652).
pub(super) const SIGNED_DATA: &[u8] = b"\x2a\x86\x48\x86\xf7\x0d\x01\x07\x02";
/// id-ct-TSTInfo (RFC 3161).
pub(super) const STAMP: &[u8] = b"\x2a\x86\x48\x86\xf7\x0d\x01\x09\x10\x01\x04";
/// id-contentType.
pub(super) const CONTENT_TYPE: &[u8] = b"\x2a\x86\x48\x86\xf7\x0d\x01\x09\x03";
/// id-messageDigest.
pub(super) const MESSAGE_DIGEST: &[u8] = b"\x2a\x86\x48\x86\xf7\x0d\x01\x09\x04";
/// id-aa-signingCertificate (RFC 2634), by SHA-1.
pub(super) const SIGNING_CERTIFICATE: &[u8] = b"\x2a\x86\x48\x86\xf7\x0d\x01\x09\x10\x02\x0c";
/// id-aa-signingCertificateV2 (RFC 5035).
pub(super) const SIGNING_CERTIFICATE_2: &[u8] = b"\x2a\x86\x48\x86\xf7\x0d\x01\x09\x10\x02\x2f";

/// SHA-256.
pub(super) const SHA_256: &[u8] = b"\x60\x86\x48\x01\x65\x03\x04\x02\x01";
/// SHA-384.
pub(super) const SHA_384: &[u8] = b"\x60\x86\x48\x01\x65\x03\x04\x02\x02";
/// SHA-512.
pub(super) const SHA_512: &[u8] = b"\x60\x86\x48\x01\x65\x03\x04\x02\x03";

/// rsaEncryption: a key, and a signature whose hash is named elsewhere.
pub(super) const RSA: &[u8] = b"\x2a\x86\x48\x86\xf7\x0d\x01\x01\x01";
/// sha256WithRSAEncryption.
pub(super) const RSA_SHA_256: &[u8] = b"\x2a\x86\x48\x86\xf7\x0d\x01\x01\x0b";
/// sha384WithRSAEncryption.
pub(super) const RSA_SHA_384: &[u8] = b"\x2a\x86\x48\x86\xf7\x0d\x01\x01\x0c";
/// sha512WithRSAEncryption.
pub(super) const RSA_SHA_512: &[u8] = b"\x2a\x86\x48\x86\xf7\x0d\x01\x01\x0d";
/// id-RSASSA-PSS.
pub(super) const RSA_PSS: &[u8] = b"\x2a\x86\x48\x86\xf7\x0d\x01\x01\x0a";
/// id-mgf1.
pub(super) const MASK: &[u8] = b"\x2a\x86\x48\x86\xf7\x0d\x01\x01\x08";

/// id-ecPublicKey.
pub(super) const CURVE_KEY: &[u8] = b"\x2a\x86\x48\xce\x3d\x02\x01";
/// P-256.
pub(super) const P_256: &[u8] = b"\x2a\x86\x48\xce\x3d\x03\x01\x07";
/// P-384.
pub(super) const P_384: &[u8] = b"\x2b\x81\x04\x00\x22";
/// ecdsa-with-SHA256.
pub(super) const ECDSA_SHA_256: &[u8] = b"\x2a\x86\x48\xce\x3d\x04\x03\x02";
/// ecdsa-with-SHA384.
pub(super) const ECDSA_SHA_384: &[u8] = b"\x2a\x86\x48\xce\x3d\x04\x03\x03";
/// ecdsa-with-SHA512.
pub(super) const ECDSA_SHA_512: &[u8] = b"\x2a\x86\x48\xce\x3d\x04\x03\x04";

/// keyUsage (RFC 5280).
pub(super) const KEY_USAGE: &[u8] = b"\x55\x1d\x0f";
/// basicConstraints.
pub(super) const BASIC_CONSTRAINTS: &[u8] = b"\x55\x1d\x13";
/// certificatePolicies.
pub(super) const POLICIES: &[u8] = b"\x55\x1d\x20";
/// extKeyUsage.
pub(super) const EXTENDED_KEY_USAGE: &[u8] = b"\x55\x1d\x25";
/// id-kp-timeStamping.
pub(super) const TIME_STAMPING: &[u8] = b"\x2b\x06\x01\x05\x05\x07\x03\x08";

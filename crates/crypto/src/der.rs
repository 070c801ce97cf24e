//! The small part of DER that SM2 needs, read strictly: signatures (GB/T 35276) and ciphertexts (GM/T 0009). Lengths
//! and integers must be minimal, integers positive, and no bytes may be left over.

use crate::model::Signature;
use crate::model::wire::{Reader, WireError};

use super::CryptoError;

const INTEGER: u8 = 0x02;
const OCTETS: u8 = 0x04;
const SEQUENCE: u8 = 0x30;

/// The parts of an SM2 ciphertext: C1 = (x, y), the check value C3, the masked text C2.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CipherParts {
    /// x of C1.
    pub x: [u8; 32],
    /// y of C1.
    pub y: [u8; 32],
    /// C3.
    pub check: [u8; 32],
    /// C2.
    pub text: Vec<u8>,
}

impl CipherParts {
    /// GM/T 0009-2012, 7.2: SEQUENCE { x INTEGER, y INTEGER, hash OCTET STRING, text OCTET STRING }.
    pub fn encode(&self) -> Vec<u8> {
        let mut body = Vec::with_capacity(self.text.len() + 112);
        put_integer(&mut body, &self.x);
        put_integer(&mut body, &self.y);
        put(&mut body, OCTETS, &self.check);
        put(&mut body, OCTETS, &self.text);
        sequence(&body)
    }

    /// Reads exactly one ciphertext.
    ///
    /// # Errors
    /// [`CryptoError::Malformed`] if it is not canonical DER or its text is empty.
    pub fn parse(der: &[u8]) -> Result<Self, CryptoError> {
        parse_cipher(der).map_err(CryptoError::malformed("SM2 ciphertext"))
    }
}

fn parse_cipher(der: &[u8]) -> Result<CipherParts, WireError> {
    let mut reader = Reader::new(der);
    let mut body = Reader::new(take(&mut reader, SEQUENCE, "sequence")?);
    reader.end()?;
    let x = integer(&mut body, "x")?;
    let y = integer(&mut body, "y")?;
    let check = take(&mut body, OCTETS, "hash")?.try_into().map_err(|_| WireError::Value("hash"))?;
    let text = take(&mut body, OCTETS, "text")?.to_vec();
    body.end()?;
    if text.is_empty() { Err(WireError::Value("text")) } else { Ok(CipherParts { x, y, check, text }) }
}

/// A signature as OpenSSL writes it: SEQUENCE { r INTEGER, s INTEGER }.
pub fn signature_der(signature: &Signature) -> Vec<u8> {
    let (r, s) = signature.0.split_at(32);
    let mut body = Vec::with_capacity(72);
    put_integer(&mut body, r);
    put_integer(&mut body, s);
    sequence(&body)
}

/// A signature from DER; its range is checked when it is verified.
///
/// # Errors
/// [`CryptoError::Malformed`] if it is not canonical DER of two 256-bit integers.
pub fn signature_from_der(der: &[u8]) -> Result<Signature, CryptoError> {
    parse_signature(der).map_err(CryptoError::malformed("SM2 signature"))
}

fn parse_signature(der: &[u8]) -> Result<Signature, WireError> {
    let mut reader = Reader::new(der);
    let mut body = Reader::new(take(&mut reader, SEQUENCE, "sequence")?);
    reader.end()?;
    let mut raw = [0; 64];
    raw[..32].copy_from_slice(&integer(&mut body, "r")?);
    raw[32..].copy_from_slice(&integer(&mut body, "s")?);
    body.end()?;
    Ok(Signature(raw))
}

fn take<'a>(reader: &mut Reader<'a>, tag: u8, field: &'static str) -> Result<&'a [u8], WireError> {
    if reader.u8(field)? != tag {
        return Err(WireError::Value(field));
    }
    let length = length(reader, field)?;
    reader.take(length, field)
}

fn length(reader: &mut Reader<'_>, field: &'static str) -> Result<usize, WireError> {
    let (length, least) = match reader.u8(field)? {
        short @ 0..=0x7f => (usize::from(short), 0),
        0x81 => (usize::from(reader.u8(field)?), 0x80),
        0x82 => (usize::from(reader.u16(field)?), 0x100),
        0x83 => (usize::from(reader.u8(field)?) << 16 | usize::from(reader.u16(field)?), 0x1_0000),
        _ => return Err(WireError::Value(field)),
    };
    if length < least { Err(WireError::Value(field)) } else { Ok(length) }
}

fn integer(reader: &mut Reader<'_>, field: &'static str) -> Result<[u8; 32], WireError> {
    let bytes = take(reader, INTEGER, field)?;
    let magnitude = match bytes {
        [] | [0x80..=0xff, ..] | [0, 0..=0x7f, ..] => return Err(WireError::Value(field)),
        [0, rest @ ..] if !rest.is_empty() => rest,
        all => all,
    };
    if magnitude.len() > 32 {
        return Err(WireError::Value(field));
    }
    let mut out = [0; 32];
    out[32 - magnitude.len()..].copy_from_slice(magnitude);
    Ok(out)
}

fn sequence(body: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(body.len() + 5);
    put(&mut out, SEQUENCE, body);
    out
}

fn put_integer(out: &mut Vec<u8>, big_endian: &[u8]) {
    let zeros = big_endian.iter().take_while(|byte| **byte == 0).count().min(big_endian.len().saturating_sub(1));
    let magnitude = &big_endian[zeros..];
    if magnitude.first().is_some_and(|byte| *byte >= 0x80) {
        put(out, INTEGER, &[&[0], magnitude].concat());
    } else {
        put(out, INTEGER, magnitude);
    }
}

fn put(out: &mut Vec<u8>, tag: u8, content: &[u8]) {
    out.push(tag);
    let length = content.len().to_be_bytes();
    let zeros = length.iter().take_while(|byte| **byte == 0).count();
    let minimal = &length[zeros..];
    match minimal {
        [] => out.push(0),
        [short @ 0..=0x7f] => out.push(*short),
        long => {
            out.push(0x80 | u8::try_from(long.len()).unwrap_or(8));
            out.extend_from_slice(long);
        }
    }
    out.extend_from_slice(content);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn integers_that_are_not_minimal_or_not_positive_are_refused() {
        let wrap =
            |integer: &[u8]| [&[0x30, u8::try_from(integer.len() + 3).expect("short")], integer, &[2, 1, 1]].concat();
        assert!(signature_from_der(&wrap(&[2, 1, 5])).is_ok());
        assert!(signature_from_der(&wrap(&[2, 1, 0])).is_ok());
        assert!(signature_from_der(&wrap(&[2, 2, 0, 0x80])).is_ok());
        for bad in [&[2, 0][..], &[2, 1, 0x80], &[2, 2, 0, 5], &[2, 2, 0, 0], &[2, 3, 0, 0, 0x80], &[3, 1, 5]] {
            assert!(signature_from_der(&wrap(bad)).is_err(), "{bad:02x?}");
        }
        assert!(signature_from_der(&wrap(&[&[2, 33, 1][..], &[0; 32]].concat())).is_err());
        assert!(signature_from_der(&[0x30, 0x81, 6, 2, 1, 1, 2, 1, 1]).is_err(), "length not minimal");
        assert!(signature_from_der(&[0x30, 0x80, 2, 1, 1, 2, 1, 1, 0, 0]).is_err(), "indefinite length");
        assert!(signature_from_der(&[0x30, 6, 2, 1, 1, 2, 1, 1, 0]).is_err(), "left over");
        assert!(signature_from_der(&[]).is_err());
    }

    proptest! {
        #[test]
        fn ciphertexts_round_trip(x in any::<[u8; 32]>(), y in any::<[u8; 32]>(), check in any::<[u8; 32]>(),
                                  length in prop_oneof![1usize..300, 65_400usize..66_000]) {
            let parts = CipherParts { x, y, check, text: vec![7; length] };
            prop_assert_eq!(CipherParts::parse(&parts.encode()).expect("parses"), parts);
        }

        #[test]
        fn what_parses_is_written_the_same_way(noise in proptest::collection::vec(any::<u8>(), 0..120),
                                               raw in any::<[[u8; 32]; 2]>(), at in 0usize..72, bit in 0u8..8) {
            let _ = CipherParts::parse(&noise);
            let _ = signature_from_der(&noise);
            let mut der = signature_der(&Signature(raw.concat().try_into().expect("64")));
            prop_assert!(signature_from_der(&der).is_ok());
            let at = at % der.len();
            der[at] ^= 1 << bit;
            if let Ok(signature) = signature_from_der(&der) {
                prop_assert_eq!(signature_der(&signature), der);
            }
        }
    }
}

//! DER (X.690, 10 and 11), read strictly: definite and shortest lengths only, nothing left over, nothing copied.
//! Integers of SM2 structures (GB/T 35276, GM/T 0009) are positive.

use crate::model::Signature;
use crate::model::wire::WireError;

use super::secret::joined;
use super::{CryptoError, Result};

/// A truth value.
pub const BOOLEAN: u8 = 0x01;
/// A number.
pub const INTEGER: u8 = 0x02;
/// Bits.
pub const BITS: u8 = 0x03;
/// Bytes.
pub const OCTETS: u8 = 0x04;
/// Nothing.
pub const NULL: u8 = 0x05;
/// An object identifier.
pub const OBJECT: u8 = 0x06;
/// Text.
pub const UTF8: u8 = 0x0c;
/// A time with two digits of its year.
pub const UTC_TIME: u8 = 0x17;
/// A time.
pub const GENERALIZED_TIME: u8 = 0x18;
/// Elements in order.
pub const SEQUENCE: u8 = 0x30;
/// Elements in any order.
pub const SET: u8 = 0x31;

/// The tag of a constructed element numbered by its structure.
pub const fn context(number: u8) -> u8 {
    0xa0 | number
}

/// The tag of a primitive element numbered by its structure.
pub const fn primitive(number: u8) -> u8 {
    0x80 | number
}

/// One element.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Element<'a> {
    /// Its kind.
    pub tag: u8,
    /// Its content.
    pub content: &'a [u8],
    /// All of it, with tag and length.
    pub whole: &'a [u8],
}

/// Takes elements one after the other.
#[derive(Debug, Clone, Copy)]
pub struct Der<'a> {
    part: &'static str,
    rest: &'a [u8],
}

#[allow(clippy::missing_errors_doc, reason = "`DerError` says what is not as it must be")]
impl<'a> Der<'a> {
    /// Over the elements in `bytes`; `part` is the name used in errors.
    pub fn new(part: &'static str, bytes: &'a [u8]) -> Self {
        Self { part, rest: bytes }
    }

    /// Over the one element in `bytes`, which must have this tag.
    pub fn only(part: &'static str, bytes: &'a [u8], tag: u8) -> Result<Self, DerError> {
        let mut outer = Self::new(part, bytes);
        let inner = outer.inside(tag)?;
        outer.end()?;
        Ok(inner)
    }

    /// Whether nothing is left.
    pub fn is_empty(&self) -> bool {
        self.rest.is_empty()
    }

    /// An error in this part.
    pub fn wrong(&self, why: &'static str) -> DerError {
        DerError { part: self.part, why }
    }

    /// The tag of the next element.
    pub fn next_tag(&self) -> Option<u8> {
        self.rest.first().copied()
    }

    /// The next element, whatever its tag.
    pub fn any(&mut self) -> Result<Element<'a>, DerError> {
        let short = || self.wrong("it ends too early");
        let (tag, after) = self.rest.split_first().ok_or_else(short)?;
        if tag & 0x1f == 0x1f {
            return Err(self.wrong("it has a tag of several bytes"));
        }
        let (first, after) = after.split_first().ok_or_else(short)?;
        let (length, after) = match first {
            0..=0x7f => (usize::from(*first), after),
            0x81..=0x83 => {
                let (bytes, after) = after.split_at_checked(usize::from(first & 0x7f)).ok_or_else(short)?;
                let length = bytes.iter().fold(0, |length, byte| length << 8 | usize::from(*byte));
                if bytes.first() == Some(&0) || length < 0x80 {
                    return Err(self.wrong("a length is not in its shortest form"));
                }
                (length, after)
            }
            _ => return Err(self.wrong("a length is indefinite or too large")),
        };
        let (content, rest) = after.split_at_checked(length).ok_or_else(short)?;
        let whole = self.rest.get(..self.rest.len() - rest.len()).ok_or_else(short)?;
        self.rest = rest;
        Ok(Element { tag: *tag, content, whole })
    }

    /// The next element, which must have this tag.
    pub fn element(&mut self, tag: u8) -> Result<Element<'a>, DerError> {
        match self.any()? {
            element if element.tag == tag => Ok(element),
            _ => Err(self.wrong("it has an element of the wrong type")),
        }
    }

    /// The next element if it has this tag.
    pub fn optional(&mut self, tag: u8) -> Result<Option<Element<'a>>, DerError> {
        if self.next_tag() == Some(tag) { self.any().map(Some) } else { Ok(None) }
    }

    /// The content of the next element, which must have this tag.
    pub fn inside(&mut self, tag: u8) -> Result<Self, DerError> {
        Ok(Self::new(self.part, self.element(tag)?.content))
    }

    /// What is read of the next element's content, which is read to its end; it must have this tag.
    pub fn within<T, E: From<DerError>>(
        &mut self,
        tag: u8,
        read: impl FnOnce(&mut Self) -> Result<T, E>,
    ) -> Result<T, E> {
        let mut inner = self.inside(tag)?;
        let found = read(&mut inner)?;
        inner.end()?;
        Ok(found)
    }

    /// The content of the next element if it has this tag.
    pub fn inside_optional(&mut self, tag: u8) -> Result<Option<Self>, DerError> {
        Ok(self.optional(tag)?.map(|element| Self::new(self.part, element.content)))
    }

    /// An integer's bytes, two's complement, in the shortest form.
    pub fn integer(&mut self) -> Result<&'a [u8], DerError> {
        let bytes = self.element(INTEGER)?.content;
        match bytes {
            [] | [0, 0..=0x7f, ..] | [0xff, 0x80..=0xff, ..] => {
                Err(self.wrong("an integer is not in its shortest form"))
            }
            _ => Ok(bytes),
        }
    }

    /// An integer from 0 to 2^32 - 1.
    pub fn small(&mut self) -> Result<u64, DerError> {
        let bytes = self.integer()?;
        small(bytes).ok_or_else(|| self.wrong("an integer is too large or negative"))
    }

    /// An object identifier's content.
    pub fn object(&mut self) -> Result<&'a [u8], DerError> {
        Ok(self.element(OBJECT)?.content)
    }

    /// Whole bytes of a bit string.
    pub fn bits(&mut self) -> Result<&'a [u8], DerError> {
        match self.element(BITS)?.content {
            [0, bytes @ ..] => Ok(bytes),
            _ => Err(self.wrong("a bit string is not a whole number of bytes")),
        }
    }

    /// A boolean, which DER writes as 0 or 255.
    pub fn boolean(&mut self) -> Result<bool, DerError> {
        match self.element(BOOLEAN)?.content {
            [0] => Ok(false),
            [0xff] => Ok(true),
            _ => Err(self.wrong("a boolean is neither true nor false")),
        }
    }

    /// Checks that nothing is left.
    pub fn end(&self) -> Result<(), DerError> {
        if self.rest.is_empty() { Ok(()) } else { Err(self.wrong("there is data left over")) }
    }
}

/// Why a text is not DER, or not of the expected form.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the {part} is malformed: {why}")]
pub struct DerError {
    /// The name of what was read.
    pub part: &'static str,
    /// The reason.
    pub why: &'static str,
}

/// An integer's bytes as a number from 0 to 2^32 - 1.
pub fn small(bytes: &[u8]) -> Option<u64> {
    let is_negative = bytes.first().is_some_and(|byte| *byte >= 0x80);
    (!is_negative && bytes.len() <= 5).then(|| bytes.iter().fold(0, |number, byte| number << 8 | u64::from(*byte)))
}

/// Writes an element.
pub fn put(tag: u8, parts: &[&[u8]]) -> Vec<u8> {
    let length: usize = parts.iter().map(|part| part.len()).sum();
    let bytes = length.to_be_bytes();
    let zeros = bytes.iter().take_while(|byte| **byte == 0).count();
    let mut out = vec![tag];
    match bytes.get(zeros..).unwrap_or_default() {
        [] => out.push(0),
        [short @ 0..=0x7f] => out.push(*short),
        long => {
            out.push(0x80 | u8::try_from(long.len()).unwrap_or(8));
            out.extend_from_slice(long);
        }
    }
    parts.iter().for_each(|part| out.extend_from_slice(part));
    out
}

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
        let (check, text) = (put(OCTETS, &[&self.check]), put(OCTETS, &[&self.text]));
        put(SEQUENCE, &[&put_integer(&self.x), &put_integer(&self.y), &check, &text])
    }

    /// Reads exactly one ciphertext.
    /// # Errors
    /// [`CryptoError::Malformed`] if it is not canonical DER or its text is empty.
    pub fn parse(der: &[u8]) -> Result<Self> {
        parse_cipher(der).map_err(CryptoError::malformed("SM2 ciphertext"))
    }
}

fn parse_cipher(der: &[u8]) -> Result<CipherParts, WireError> {
    let mut body = Der::only("SM2 ciphertext", der, SEQUENCE).map_err(of("sequence"))?;
    let (x, y) = (number(&mut body, "x")?, number(&mut body, "y")?);
    let check = body.element(OCTETS).map_err(of("hash"))?.content.try_into().map_err(|_| WireError::Value("hash"))?;
    let text = body.element(OCTETS).map_err(of("text"))?.content.to_vec();
    body.end().map_err(of("sequence"))?;
    if text.is_empty() { Err(WireError::Value("text")) } else { Ok(CipherParts { x, y, check, text }) }
}

/// A signature as OpenSSL writes it: SEQUENCE { r INTEGER, s INTEGER }.
pub fn signature_der(signature: &Signature) -> Vec<u8> {
    let (r, s) = signature.0.split_at(32);
    put(SEQUENCE, &[&put_integer(r), &put_integer(s)])
}

/// A signature from DER; its range is checked when it is verified.
/// # Errors
/// [`CryptoError::Malformed`] if it is not canonical DER of two 256-bit integers.
pub fn signature_from_der(der: &[u8]) -> Result<Signature> {
    parse_signature(der).map_err(CryptoError::malformed("SM2 signature"))
}

fn parse_signature(der: &[u8]) -> Result<Signature, WireError> {
    let mut body = Der::only("SM2 signature", der, SEQUENCE).map_err(of("sequence"))?;
    let raw = joined(&number(&mut body, "r")?, &number(&mut body, "s")?);
    body.end().map_err(of("sequence"))?;
    Ok(Signature(raw))
}

fn of(field: &'static str) -> impl Fn(DerError) -> WireError {
    move |_| WireError::Value(field)
}

/// A number from 0 to 2^256 - 1.
fn number(body: &mut Der<'_>, field: &'static str) -> Result<[u8; 32], WireError> {
    let magnitude = match body.integer().map_err(of(field))? {
        [0x80..=0xff, ..] => return Err(WireError::Value(field)),
        [0, rest @ ..] if !rest.is_empty() => rest,
        all => all,
    };
    let mut out = [0; 32];
    let place = out.len().checked_sub(magnitude.len()).ok_or(WireError::Value(field))?;
    out[place..].copy_from_slice(magnitude);
    Ok(out)
}

fn put_integer(big_endian: &[u8]) -> Vec<u8> {
    let zeros = big_endian.iter().take_while(|byte| **byte == 0).count().min(big_endian.len().saturating_sub(1));
    let magnitude = &big_endian[zeros..];
    let sign: &[u8] = if magnitude.first().is_some_and(|byte| *byte >= 0x80) { &[0] } else { &[] };
    put(INTEGER, &[sign, magnitude])
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

    #[test]
    fn only_the_shortest_definite_form_is_read() {
        let read = |bytes: &[u8]| Der::only("test", bytes, SEQUENCE).and_then(|mut inner| inner.any().map(|_| ()));
        assert!(read(&[0x30, 2, 5, 0]).is_ok());
        assert!(read(&put(SEQUENCE, &[&put(OCTETS, &[&[7; 300]])])).is_ok());
        for bad in [
            &[0x30, 0x80, 5, 0, 0, 0][..],
            &[0x30, 0x81, 2, 5, 0],
            &[0x30, 0x82, 0, 2, 5, 0],
            &[0x30, 2, 5, 0, 0],
            &[0x30, 3, 5, 0],
            &[0x30, 2, 0x1f, 0],
            &[0x30, 0x84, 0, 0, 0, 2, 5, 0],
            &[],
        ] {
            assert!(read(bad).is_err(), "{bad:02x?}");
        }
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

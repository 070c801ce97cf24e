//! DER (X.690, 10 and 11), as much of it as stamps and certificates need, read strictly: only definite and shortest
//! lengths, nothing left over. Nothing is copied, and nothing is longer than [`LARGEST_DER`].

use super::{TimeError, form};

/// The longest text that is read, bytes.
pub const LARGEST_DER: usize = 64 * 1024;

pub(super) const BOOLEAN: u8 = 0x01;
pub(super) const INTEGER: u8 = 0x02;
pub(super) const BITS: u8 = 0x03;
pub(super) const OCTETS: u8 = 0x04;
pub(super) const NULL: u8 = 0x05;
pub(super) const OBJECT: u8 = 0x06;
pub(super) const UTF8: u8 = 0x0c;
pub(super) const UTC_TIME: u8 = 0x17;
pub(super) const GENERALIZED_TIME: u8 = 0x18;
pub(super) const SEQUENCE: u8 = 0x30;
pub(super) const SET: u8 = 0x31;

/// The tag of a constructed element numbered by its structure.
pub(super) const fn context(number: u8) -> u8 {
    0xa0 | number
}

/// The tag of a primitive element numbered by its structure.
pub(super) const fn primitive(number: u8) -> u8 {
    0x80 | number
}

/// One element.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Element<'a> {
    pub tag: u8,
    /// Its content.
    pub content: &'a [u8],
    /// All of it, with tag and length.
    pub whole: &'a [u8],
}

/// Takes elements one after the other.
#[derive(Debug, Clone, Copy)]
pub(super) struct Der<'a> {
    part: &'static str,
    rest: &'a [u8],
}

impl<'a> Der<'a> {
    /// Over the elements in `bytes`; `part` is the name used in errors.
    pub fn new(part: &'static str, bytes: &'a [u8]) -> Result<Self, TimeError> {
        if bytes.len() > LARGEST_DER {
            return Err(form(part, "it is too long"));
        }
        Ok(Self { part, rest: bytes })
    }

    /// Over the one element in `bytes`, which must have this tag.
    pub fn only(part: &'static str, bytes: &'a [u8], tag: u8) -> Result<Self, TimeError> {
        let mut outer = Self::new(part, bytes)?;
        let inner = outer.inside(tag)?;
        outer.end()?;
        Ok(inner)
    }

    pub fn is_empty(&self) -> bool {
        self.rest.is_empty()
    }

    pub fn wrong(&self, why: &'static str) -> TimeError {
        form(self.part, why)
    }

    /// The tag of the next element.
    pub fn next_tag(&self) -> Option<u8> {
        self.rest.first().copied()
    }

    /// The next element, whatever its tag.
    pub fn any(&mut self) -> Result<Element<'a>, TimeError> {
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
    pub fn element(&mut self, tag: u8) -> Result<Element<'a>, TimeError> {
        match self.any()? {
            element if element.tag == tag => Ok(element),
            _ => Err(self.wrong("it has an element of the wrong type")),
        }
    }

    /// The next element if it has this tag.
    pub fn optional(&mut self, tag: u8) -> Result<Option<Element<'a>>, TimeError> {
        if self.next_tag() == Some(tag) { self.any().map(Some) } else { Ok(None) }
    }

    /// The content of the next element, which must have this tag.
    pub fn inside(&mut self, tag: u8) -> Result<Self, TimeError> {
        let element = self.element(tag)?;
        Self::new(self.part, element.content)
    }

    /// The content of the next element if it has this tag.
    pub fn inside_optional(&mut self, tag: u8) -> Result<Option<Self>, TimeError> {
        self.optional(tag)?.map(|element| Self::new(self.part, element.content)).transpose()
    }

    /// An integer's bytes, two's complement, in the shortest form.
    pub fn integer(&mut self) -> Result<&'a [u8], TimeError> {
        let bytes = self.element(INTEGER)?.content;
        match bytes {
            [] | [0, 0..=0x7f, ..] | [0xff, 0x80..=0xff, ..] => {
                Err(self.wrong("an integer is not in its shortest form"))
            }
            _ => Ok(bytes),
        }
    }

    /// An integer from 0 to 2^32 - 1.
    pub fn small(&mut self) -> Result<u64, TimeError> {
        let bytes = self.integer()?;
        small(bytes).ok_or_else(|| self.wrong("an integer is too large or negative"))
    }

    /// An object identifier's content.
    pub fn object(&mut self) -> Result<&'a [u8], TimeError> {
        Ok(self.element(OBJECT)?.content)
    }

    /// Whole bytes of a bit string.
    pub fn bits(&mut self) -> Result<&'a [u8], TimeError> {
        match self.element(BITS)?.content {
            [0, bytes @ ..] => Ok(bytes),
            _ => Err(self.wrong("a bit string is not a whole number of bytes")),
        }
    }

    /// A boolean, which DER writes as 0 or 255.
    pub fn boolean(&mut self) -> Result<bool, TimeError> {
        match self.element(BOOLEAN)?.content {
            [0] => Ok(false),
            [0xff] => Ok(true),
            _ => Err(self.wrong("a boolean is neither true nor false")),
        }
    }

    /// Checks that nothing is left.
    pub fn end(&self) -> Result<(), TimeError> {
        if self.rest.is_empty() { Ok(()) } else { Err(self.wrong("there is data left over")) }
    }
}

/// An integer's bytes as a number from 0 to 2^32 - 1.
pub(super) fn small(bytes: &[u8]) -> Option<u64> {
    let is_negative = bytes.first().is_some_and(|byte| *byte >= 0x80);
    (!is_negative && bytes.len() <= 5).then(|| bytes.iter().fold(0, |number, byte| number << 8 | u64::from(*byte)))
}

/// Writes an element.
pub(super) fn put(tag: u8, parts: &[&[u8]]) -> Vec<u8> {
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

/// Seconds since 1970 of a time in the form of certificates (`UTCTime` or `GeneralizedTime`) and stamps, always UTC.
/// Fractions of a second are rounded up if `up` is set, otherwise down.
pub(super) fn seconds(element: Element<'_>, part: &'static str, up: bool) -> Result<u64, TimeError> {
    let wrong = || form(part, "a time is not valid");
    let text = element.content.strip_suffix(b"Z").ok_or_else(wrong)?;
    let two = |at: usize| -> Option<u64> {
        match text.get(at..at + 2)? {
            [tens @ b'0'..=b'9', ones @ b'0'..=b'9'] => Some(u64::from(tens - b'0') * 10 + u64::from(ones - b'0')),
            _ => None,
        }
    };
    let (year, at) = match element.tag {
        GENERALIZED_TIME => (two(0).zip(two(2)).map(|(high, low)| high * 100 + low), 4),
        // RFC 5280, 4.1.2.5.1.
        UTC_TIME => (two(0).map(|year| if year < 50 { 2000 + year } else { 1900 + year }), 2),
        _ => return Err(wrong()),
    };
    let fields: Option<Vec<u64>> = (0..5).map(|field| two(at + field * 2)).collect();
    let Some(([month, day, hour, minute, second], year)) =
        fields.and_then(|fields| <[u64; 5]>::try_from(fields).ok()).zip(year)
    else {
        return Err(wrong());
    };
    let fraction = match text.get(at + 10..).unwrap_or_default() {
        [] => 0,
        [b'.', digits @ ..] if element.tag == GENERALIZED_TIME => {
            // X.690, 11.7.3: no zeros at the end.
            let is_number = digits.len() <= 9 && digits.iter().all(u8::is_ascii_digit);
            digits.last().filter(|last| is_number && **last != b'0').ok_or_else(wrong)?;
            u64::from(up)
        }
        _ => return Err(wrong()),
    };
    let in_range =
        (1970..=9999).contains(&year) && (1..=12).contains(&month) && hour < 24 && minute < 60 && second < 60;
    if !in_range || day == 0 || day > days_in(year, month) {
        return Err(wrong());
    }
    let days = (1970..year).map(|year| if is_leap(year) { 366 } else { 365 }).sum::<u64>()
        + (1..month).map(|month| days_in(year, month)).sum::<u64>()
        + day
        - 1;
    Ok(days * 86_400 + hour * 3600 + minute * 60 + second + fraction)
}

fn is_leap(year: u64) -> bool {
    year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400))
}

fn days_in(year: u64, month: u64) -> u64 {
    match month {
        2 => 28 + u64::from(is_leap(year)),
        4 | 6 | 9 | 11 => 30,
        _ => 31,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        assert!(Der::new("test", &vec![0; LARGEST_DER + 1]).is_err());
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
